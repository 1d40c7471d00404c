"""Mission files that tests of the configuration write, load and see refused."""

import time

import pytest
import yaml

from unbend.config import load_mission
from unbend.errors import ConfigError

# libyaml where PyYAML was built with it: ten times as fast.
C_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
C_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def dumped(tree):
    return yaml.dump(tree, Dumper=C_DUMPER, sort_keys=False)


@pytest.fixture
def written(tmp_path):
    """Writes a mission file of these values, or this text."""

    def write(content):
        path = tmp_path / "mission.yaml"
        if not isinstance(content, str):
            content = dumped(content)
        path.write_text(content, "utf-8")
        return path

    return write


@pytest.fixture
def load(written):
    """Loads a mission file of these values, or this text."""

    def load_written(content):
        return load_mission(written(content))

    return load_written


@pytest.fixture
def refusal(written):
    """The refusal of a mission file; fails when there is none or it took ten seconds."""

    def attempt(content):
        path = written(content)
        begin = time.process_time()
        with pytest.raises(ConfigError) as caught:
            load_mission(path)
        assert time.process_time() - begin < 10.0
        assert str(path) in caught.value.where
        assert caught.value.remedy
        assert "pydantic" not in str(caught.value).lower()
        assert "http" not in str(caught.value)
        return caught.value

    return attempt


@pytest.fixture
def invalid(refusal):
    """What is said of a mission file whose keys are known and whose values are not possible."""

    def attempt(content):
        error = refusal(content)
        assert error.code == "CONFIG-INVALID"
        return error.what

    return attempt
