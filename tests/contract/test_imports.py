"""How light the package is to import."""

import json
import subprocess
import sys

import pytest

from tests.contract.sources import ROOT


def python(code, *options):
    done = subprocess.run(
        [sys.executable, *options, "-c", code], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


HEAVY = ("numba", "pyarrow", "pandas", "scipy", "numpy", "matplotlib", "pymavlink", "yaml")


def test_importing_the_package_loads_nothing_heavy():
    modules = json.loads(
        python("import sys, json; import unbend; print(json.dumps(sorted(sys.modules)))")
    )
    assert not set(HEAVY) & set(modules)
    assert [name for name in modules if name.startswith("unbend.")] == []


def test_the_command_line_is_light_until_it_works():
    modules = json.loads(
        python("import sys, json; import unbend.cli; print(json.dumps(sorted(sys.modules)))")
    )
    assert not set(HEAVY) & set(modules)


def test_the_physics_needs_numpy_and_numba_alone():
    """And numba not before the first ray."""
    code = (
        "import sys, json\nimport unbend.atmosphere, unbend.refraction\n"
        "print(json.dumps(sorted(m.split('.')[0] for m in sys.modules)))"
    )
    modules = set(json.loads(python(code)))
    assert "numpy" in modules
    assert not {"numba", "pyarrow", "pandas", "pymavlink", "mcap", "yaml", "pydantic"} & modules


@pytest.mark.parametrize(
    "module", ["unbend.batch.runs", "unbend.cli", "unbend.simulate", "unbend.ingest"]
)
def test_importing_warns_of_nothing(module):
    python(f"import {module}", "-W", "error")
