"""The JSON schema: every key has a text, numbers a unit, and it takes what the models take."""

import re

import jsonschema
import pytest
import yaml

from tests.config.test_mission_file import FULL, SECTIONS_OF_NAMES, at, changed, keys_of
from tests.logs import REPOSITORY
from unbend.config.keys import mission_keys
from unbend.config.schema import all_sections, campaign_schema, mission_schema, nodes_at
from unbend.config.yaml_text import MissionLoader

KEYS = {key.path: key for key in mission_keys()}


def missions():
    """The mission files of configs, and those in the documents."""
    texts = [path.read_text("utf-8") for path in sorted(REPOSITORY.glob("configs/*.yaml"))]
    for page in (REPOSITORY / "README.md", *REPOSITORY.glob("docs/**/*.md")):
        text = page.read_text("utf-8")
        for block in re.findall(r"^```yaml\n(.*?)^```", text, re.S | re.M):
            if "output:" in block and "mission:" in block and "missions:" not in block:
                texts.append(block)
    return texts


MISSIONS = missions()


@pytest.fixture(scope="module")
def validator():
    jsonschema.Draft7Validator.check_schema(mission_schema())
    return jsonschema.Draft7Validator(mission_schema())


def test_every_key_at_every_level_has_a_text_of_its_own():
    assert len(KEYS) > 300
    for name, section in all_sections().items():
        for key, field in section.model_fields.items():
            assert field.description, f"{name}.{key}"
    for path, key in KEYS.items():
        assert len(key.text) > 10, path
        assert key.text[0] not in " ,;", path


def test_keys_of_numbers_have_a_unit_and_its_name_says_the_same():
    ends = {
        "_m": "m",
        "_px": "px",
        "_deg": "deg",
        "_hpa": "hPa",
        "_c": "degC",
        "_k": "K",
        "_s": "s",
        "_mm": "mm",
        "_um": "um",
        "_ppm": "ppm",
        "_px_per_hpa": "px/hPa",
        "_px_per_k": "px/K",
    }
    for path, key in KEYS.items():
        is_name = path == "cameras.*.camera"  # or a number
        assert bool(key.unit) == ("number" in key.allowed) - is_name, path
        suffix = max((end for end in ends if path.endswith(end)), key=len, default="")
        if key.unit and suffix:
            assert key.unit == ends[suffix], path


def test_who_changes_a_schema_changes_a_copy():
    for schema_of in (mission_schema, campaign_schema):
        changed = schema_of()
        changed["properties"].clear()
        changed["$defs"].clear()
        assert schema_of()["properties"]
        assert schema_of()["$defs"]


def test_every_default_is_stated_and_every_example_is_taken():
    whole = dict(mission_schema())
    for key in ("properties", "required", "type", "additionalProperties"):
        whole.pop(key, None)
    for path, key in KEYS.items():
        assert key.default, path
        names = path.split(".")
        if "soundings" in path:
            names = [0 if name == "*" else name for name in names]
        for node in nodes_at(tuple(names)):
            validator_of_node = jsonschema.Draft7Validator(whole | node)
            for example in node.get("examples", ()):
                assert not list(validator_of_node.iter_errors(example)), path


@pytest.mark.parametrize("text", MISSIONS, ids=lambda t: re.search(r"name: *(\S+)", t)[1])
def test_missions_of_configs_and_of_the_documents_are_valid(text, validator, load):
    load(text)
    values = yaml.load(text, MissionLoader)
    assert [str(error) for error in validator.iter_errors(values)] == []


def test_there_are_missions_with_and_without_a_log():
    assert len(MISSIONS) >= 6
    assert sum("stations:" in text and "log:" not in text for text in MISSIONS) >= 2


def test_the_schema_takes_no_unknown_key_at_any_level(validator):
    """As the models do: `test_a_misspelt_key_is_refused_with_its_line_and_the_right_one`."""
    assert not list(validator.iter_errors(FULL))
    tried = 0
    for key in keys_of(FULL):
        if isinstance(at(FULL, key), dict) and key not in SECTIONS_OF_NAMES:
            spoilt = changed(FULL, f"{key}.no_such_key", 1)
            assert list(validator.iter_errors(spoilt)), key
            tried += 1
    assert tried > 50
