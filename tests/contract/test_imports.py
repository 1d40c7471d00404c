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


def modules_after(statement):
    """Names of the modules that an import loads."""
    code = f"import sys, json; {statement}; print(json.dumps(sorted(sys.modules)))"
    return set(json.loads(python(code)))


HEAVY = ("numba", "pyarrow", "pandas", "scipy", "numpy", "matplotlib", "pymavlink", "yaml")


def test_importing_the_package_loads_nothing_heavy():
    modules = modules_after("import unbend")
    assert not set(HEAVY) & modules
    assert [name for name in modules if name.startswith("unbend.")] == []


def test_the_command_line_is_light_until_it_works():
    assert not set(HEAVY) & modules_after("import unbend.cli")


def test_the_physics_needs_numpy_and_numba_alone():
    """And numba not before the first ray."""
    modules = modules_after("import unbend.atmosphere, unbend.refraction")
    assert "numpy" in modules
    assert not {"numba", "pyarrow", "pandas", "pymavlink", "mcap", "yaml", "pydantic"} & modules


@pytest.mark.parametrize(
    "module", ["unbend.batch.runs", "unbend.cli", "unbend.simulate", "unbend.ingest"]
)
def test_importing_warns_of_nothing(module):
    python(f"import {module}", "-W", "error")
