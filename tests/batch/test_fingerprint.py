"""The fingerprint of a mission: nothing that a number depends on is missing."""

import ast
import platform
import sys
from importlib import metadata
from pathlib import Path

import pytest

import unbend
from unbend.batch import fingerprint

from .conftest import plan_of

PACKAGE = Path(unbend.__file__).parent

# Distributions that no number depends on: they read the mission file, lock folders, talk, or
# copy and distribute what is compared by its hash. Drawings of methods compared, which no run
# makes, are matplotlib's; models of other programs are read back by pycolmap.
NO_NUMBERS = {
    "pydantic",
    "pyyaml",
    "rich",
    "filelock",
    "typer",
    "matplotlib",
    "obstore",
    "dask",
    "distributed",
    "pycolmap",
}


def imported(path):
    """The names of the top-level packages that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(str(node.module).partition(".")[0])
    return names


def test_every_library_is_known():
    """What the package imports of others is in the fingerprint, or no number depends on it."""
    listed = {*fingerprint.LIBRARIES, *NO_NUMBERS}
    listed.update(*fingerprint.LIBRARIES_OF_INPUTS.values())
    listed.update(*fingerprint.LIBRARIES_OF_ATMOSPHERES.values())
    distributions = metadata.packages_distributions()
    for path in PACKAGE.rglob("*.py"):
        for name in imported(path) - {*sys.stdlib_module_names, "unbend"}:
            names = {distribution.lower() for distribution in distributions.get(name, [name])}
            assert names & listed, f"{path} imports {name}"


def fingerprint_now(mission):
    return plan_of(mission).fingerprint


def test_what_is_accepted_and_where_results_go_count(mission):
    """Other sections and inputs: `test_each_change_is_named` of test_differences."""
    seen = [fingerprint_now(mission)]
    mission.config["output"]["path"] = "elsewhere"
    seen.append(fingerprint_now(mission))
    mission.config["accept"] = [{"code": "GROUND-FLAT", "reason": "a test"}]
    seen.append(fingerprint_now(mission))
    assert len(set(seen)) == 3


@pytest.mark.parametrize("library", ["numpy", "numba", "pymavlink", "metar", "exifread", "jinja2"])
def test_a_library_of_another_version_counts(mission, monkeypatch, library):
    before = fingerprint_now(mission)
    original = fingerprint.version
    monkeypatch.setattr(fingerprint, "version", lambda n: "0" if n == library else original(n))
    assert fingerprint_now(mission) != before


def test_another_python_and_other_code_count(mission, monkeypatch):
    fingerprints = {fingerprint_now(mission)}
    monkeypatch.setattr(platform, "python_version", lambda: "3.99.0")
    fingerprints.add(fingerprint_now(mission))
    monkeypatch.setattr(fingerprint, "code_hash", lambda: "other")
    fingerprints.add(fingerprint_now(mission))
    assert len(fingerprints) == 3


def test_libraries_that_read_some_inputs_only():
    plain = fingerprint.versions_of(["log", "observations", "sounding 1"], "us1976")
    assert plain.keys() == {"unbend", "code_sha256", "python", *fingerprint.LIBRARIES}
    for role, libraries in {
        "weather model": {"xarray", "cfgrib", "eccodes"},
        "elevation model 2": {"rasterio", "grids of pyproj"},
        "orientation": {"grids of pyproj"},
        "events of nadir": {"grids of pyproj"},
        "object points": {"grids of pyproj"},
        "trajectory": {"grids of pyproj"},
    }.items():
        assert libraries <= fingerprint.versions_of(["log", role], "us1976").keys(), role
    assert "pymsis" in fingerprint.versions_of(["log"], "nrlmsis2.1")
    assert fingerprint.version("no such library") is None


def test_a_grid_that_is_installed_later_counts(monkeypatch, tmp_path):
    import pyproj

    monkeypatch.setattr(pyproj.datadir, "get_user_data_dir", lambda: str(tmp_path))
    before = fingerprint.grids_of_proj.__wrapped__()
    (tmp_path / "us_noaa_g2018u0.tif").write_bytes(b"grid")
    assert fingerprint.grids_of_proj.__wrapped__() != before
