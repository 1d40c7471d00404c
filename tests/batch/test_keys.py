"""Keys of the stages: nothing that a number depends on is missing, and nothing far away is in."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import unbend
from unbend.batch import keys
from unbend.batch.plan import make_plan
from unbend.config import load_mission

PACKAGE = Path(unbend.__file__).parent
ALL = {"ingest", "air", "correction", "report"}

# Distributions that no number depends on: they read the mission file, lock folders, talk, or
# copy and distribute what is compared by its hash.
# Drawings of methods compared, which no run makes, are matplotlib's.
NO_NUMBERS = {"pydantic", "PyYAML", "rich", "filelock", "typer", "matplotlib", "obstore", "dask",
              "distributed"}  # fmt: skip


def sources(root: Path = PACKAGE) -> dict[str, str]:
    return {
        ".".join(path.relative_to(root.parent).with_suffix("").parts).removesuffix(".__init__"):
        path.read_text(encoding="utf-8")
        for path in root.rglob("*.py")
    }  # fmt: skip


def reached() -> dict[str, set[str]]:
    """The modules of each stage."""
    texts = sources()
    edges = {name: keys.imported(text) & texts.keys() for name, text in texts.items()}
    edges |= {"unbend": set(), "unbend.batch.keys": {"unbend"}}
    modules = keys.stage_modules(edges["unbend.batch.runs"])
    return {stage: keys.closure(names, edges) for stage, names in modules.items()}


@pytest.fixture
def copied(tmp_path) -> Path:
    ignore = shutil.ignore_patterns("__pycache__")
    return Path(shutil.copytree(PACKAGE, tmp_path / "unbend", ignore=ignore))


# Where an edit is planted, and the stages whose code it is. Modules that are imported inside
# functions (h5netcdf's reader, elevation models, kernels), tables, texts and templates among them.
PLANTED = {
    "ingest/dataflash/dataflash_records.py": ALL - {"report"},
    "ingest/ulog/px4_log.py": ALL - {"report"},
    "ingest/data/field_maps.toml": ALL - {"report"},
    "units.py": ALL,
    "texts.toml": ALL,
    "geodesy.py": ALL,
    "atmosphere/data/afgl1986.csv": ALL,
    "atmosphere/soundings/formats.py": {"air", "correction"},
    "atmosphere/estimate/solver.py": {"air", "correction", "report"},
    "tables/weather_files.py": {"air", "correction"},
    "tables/geodata/elevation.py": {"air", "correction"},
    "tables/data/egm96_15.gtx.zst": {"air", "correction"},
    "tables/imports/blocks/metashape.py": {"air", "correction"},
    "refraction/kernels/moments.py": {"air", "correction", "report"},
    "stages/statistics.py": {"correction"},
    "stages/plausibility.py": {"correction"},
    "report/data/report.html.j2": {"report"},
    "report/data/report.css": {"report"},
    "report/summary.py": {"report"},
    "report/codes.toml": {"report"},
    "cli/missions.py": set(),
    "simulate/flight.py": set(),
    "library.py": set(),
    "batch/mission_proposal.py": set(),
    "tables/exports/station_files.py": set(),
}


def test_an_edit_changes_the_stages_that_reach_it(copied):
    before = keys.code_below(copied)
    assert {stage: before[stage] for stage in keys.STAGES} == keys.code_of_stages()
    for name, stages in PLANTED.items():
        content = (copied / name).read_bytes()
        (copied / name).write_bytes(content + b"\n")
        after = keys.code_below(copied)
        assert {stage for stage in ALL if after[stage] != before[stage]} >= stages, name
        if name.startswith(("report/", "cli/", "simulate/", "library")):
            assert {stage for stage in ALL if after[stage] != before[stage]} == stages, name
        (copied / name).write_bytes(content)
    (copied / "atmosphere" / "data" / "afgl1986.csv").rename(copied / "atmosphere" / "data" / "a")
    assert keys.code_below(copied)["ingest"] != before["ingest"]


def test_what_is_remembered_of_the_code_is_that_of_the_files(copied, tmp_path, monkeypatch):
    """After each edit, and back again; and what was edited while it was found is not remembered."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(keys.resources, "files", lambda package: copied)
    monkeypatch.setattr(keys, "code_hash", lambda: keys.hash_of_files(copied))
    original, remembered = keys.imported, keys.code_of_package.__wrapped__
    units, added = copied / "units.py", copied / "ingest/added.py"
    source = units.read_bytes()

    def edited(text: str, package: str) -> set[str]:
        units.write_bytes(source + b"\n")
        return original(text, package)

    monkeypatch.setattr(keys, "imported", edited)
    remembered()
    monkeypatch.setattr(keys, "imported", original)
    units.write_bytes(source)
    first = remembered()
    assert first == keys.code_below(copied)
    for path in (units, copied / "report/codes.toml", added):
        content = path.read_bytes() if path != added else b""
        path.write_bytes(content + b"\n")
        assert (remembered() == first) == (path == added), path
        path.write_bytes(content)
    assert remembered() == first
    monkeypatch.setattr(keys, "code_below", lambda root: {})
    assert remembered() == first, "nothing is read again"


def test_compiled_code_does_not_count(copied):
    before = keys.code_below(copied)
    (copied / "__pycache__").mkdir()
    (copied / "__pycache__" / "units.cpython-311.pyc").write_bytes(b"compiled")
    assert keys.code_below(copied) == before


@pytest.mark.parametrize(
    "planted",
    [
        "def f():\n    from unbend.batch import rehearsal\n",
        "def f():\n    import unbend.batch.rehearsal\n",
        "from unbend.batch import (  # (as text)\n    campaigns,\n    rehearsal as other,\n)\n",
        'KINDS = {"x": "unbend.batch.rehearsal"}\n',
        "if True: from unbend.batch.rehearsal import check\n",
        "from ..batch import rehearsal\n",
        "from .. import batch\nfrom ..batch.rehearsal import check\n",
        "import numpy, unbend.batch.rehearsal\n",
        "from unbend.batch \\\n    import rehearsal\n",
        "from unbend.batch import campaigns, \\\n    rehearsal\n",
    ],
    ids=[
        "inside",
        "module",
        "lines",
        "text",
        "one-line",
        "relative",
        "above",
        "second",
        "continued",
        "later",
    ],
)
def test_a_module_that_is_newly_reached_counts(copied, planted):
    """However it is imported: afterwards an edit of it changes the keys."""
    module = copied / "ingest" / "registry.py"
    module.write_text(module.read_text(encoding="utf-8") + "\n\n" + planted, encoding="utf-8")
    before = keys.code_below(copied)
    edited = copied / "batch" / "rehearsal.py"
    edited.write_text(edited.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    after = keys.code_below(copied)
    assert {stage for stage in ALL if after[stage] != before[stage]} >= ALL - {"report"}


def test_imports_are_those_that_python_sees():
    """By Python's own parser, of every module; and no module is imported by a computed name."""
    texts = sources()
    run = set.union(*reached().values()) | {"unbend.batch.runs"}
    for name, text in texts.items():
        seen = keys.imported(text)
        for node in ast.walk(ast.parse(keys._TYPES.sub("", text))):
            if isinstance(node, ast.Import):
                assert {a.name for a in node.names if a.name in texts} <= seen, name
            elif isinstance(node, ast.ImportFrom) and node.module in texts:
                members = {f"{node.module}.{a.name}" for a in node.names}
                assert {node.module, *(members & texts.keys())} <= seen, name
                assert node.module != "unbend", f"{name} has the package import by name"
            elif isinstance(node, ast.Name | ast.Attribute) and name in run - {"unbend"}:
                called = node.id if isinstance(node, ast.Name) else node.attr
                assert called not in ("import_module", "__import__", "exec", "eval"), name


def test_all_that_is_read_before_the_correction_is_of_the_air():
    """The names in `prepare_mission` come from modules that the air reaches."""
    tree = ast.parse((PACKAGE / "stages" / "story.py").read_text(encoding="utf-8"))
    origin = {
        alias.name: node.module
        for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names
    }  # fmt: skip
    (prepare,) = (n for n in tree.body if getattr(n, "name", "") == "prepare_mission")
    used = {node.id for node in ast.walk(prepare) if isinstance(node, ast.Name)} & origin.keys()
    modules = {str(origin[name]) for name in used if str(origin[name]).startswith("unbend.")}
    assert len(modules) > 8
    assert modules - reached()["air"] <= {"unbend.report.progress"}


@pytest.mark.parametrize("stage", sorted(ALL))
def test_every_library_is_known(stage):
    """What a stage imports of others is in a key, or no number depends on it."""
    texts = sources()
    tops = {
        name.partition(".")[0]
        for module in reached()[stage]
        for node in ast.walk(ast.parse(texts[module]))
        for name in (
            [alias.name for alias in node.names] if isinstance(node, ast.Import)
            else [str(node.module)] if isinstance(node, ast.ImportFrom) else []
        )
    } - {*sys.stdlib_module_names, "unbend"}  # fmt: skip
    of_module = metadata.packages_distributions()
    known = {name.lower() for names in keys.TABLES["libraries"].values() for name in names}
    known |= {name.lower() for names in keys.TABLES["libraries_of"].values() for name in names}
    for top in tops:
        distributions = {name.lower() for name in of_module[top]}
        assert distributions & (known | {name.lower() for name in NO_NUMBERS}), top


# What a run has imported at its end, and which files of the package it has opened.
WATCHED = """
import json, sys
opened = set()
def watch(event, words):
    if event == "open" and isinstance(words[0], str):
        opened.add(words[0])
from unbend.batch import keys, plan
keys.code_of_stages(), keys.code_hash()  # these read everything
sys.addaudithook(watch)
from unbend.batch.runs import run_mission
run_mission(sys.argv[1])
modules = [name for name in sys.modules if name.partition(".")[0] == "unbend"]
print(json.dumps([modules, sorted(opened)]))
"""


def test_a_run_reaches_nothing_that_no_key_holds(mission):
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(mission.save())],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    modules, opened = json.loads(done.stdout.splitlines()[-1])
    held = set.union(*reached().values()) | {"unbend.batch.runs"}
    assert {*modules} - held <= keys._AFTERWARDS | {
        name for name in modules if name.startswith("unbend.tables.exports")
    }
    data = {
        path.relative_to(PACKAGE)
        for path in map(Path, opened)
        if path.is_relative_to(PACKAGE)
        and path.suffix != ".py"
        and path.parent.name != "__pycache__"
    }
    assert len(data) >= 5, "tables, texts and templates"
    for path in data:
        owner = path.parent if path.parent.name != "data" else path.parent.parent
        assert ".".join(("unbend", *owner.parts)) in held, path


def changed(mission, before: dict[str, str]) -> list[str]:
    now = make_plan(load_mission(mission.save()), mission.folder).keys
    return [stage for stage in keys.STAGES if now[stage] != before[stage]]


def test_each_input_and_section_has_a_first_stage(mission, monkeypatch):
    before = make_plan(load_mission(mission.save()), mission.folder).keys
    assert changed(mission, before) == []
    mission.config["output"]["batch_rows"] = 1000
    assert changed(mission, before) == []
    mission.config["output"]["path"] = "elsewhere"
    assert changed(mission, before) == ["report"]
    mission.config["accept"] = [{"code": "GROUND-FLAT", "reason": "a test"}]
    assert changed(mission, before) == ["correction", "report"]
    mission.config["ground"]["sigma_m"] = 1.5
    assert changed(mission, before) == ["air", "correction", "report"]
    with mission.log.open("ab") as log:
        log.write(b"\0")
    assert changed(mission, before) == list(keys.STAGES)


@pytest.mark.parametrize(
    ("library", "first"),
    [("numpy", 0), ("numba", 0), ("pymavlink", 0), ("metar", 1), ("exifread", 1), ("jinja2", 3)],
)
def test_a_library_of_another_version_begins_its_stage_again(mission, monkeypatch, library, first):
    before = make_plan(load_mission(mission.save()), mission.folder).keys
    original = keys.version
    monkeypatch.setattr(keys, "version", lambda name: "0" if name == library else original(name))
    assert changed(mission, before) == list(keys.STAGES[first:])


def test_libraries_that_read_some_inputs_only():
    plain = keys.libraries(["log", "observations", "sounding 1"], "us1976")["air"]
    assert plain.keys() == {*keys.TABLES["libraries"]["air"]}
    model = keys.libraries(["weather model"], "us1976")["air"]
    assert {"xarray", "cfgrib", "eccodes"} <= model.keys()
    raised = keys.libraries(["elevation model 2"], "us1976")["air"]
    assert {"rasterio", "grids of pyproj"} <= raised.keys()
    for role in ("orientation", "events of nadir", "object points", "trajectory"):
        assert keys.GRIDS in keys.libraries(["log", role], "us1976")["air"], role
    assert "pymsis" in keys.libraries(["log"], "nrlmsis2.1")["air"]
    assert keys.version("no such library") is None


def test_a_grid_that_is_installed_later_counts(monkeypatch, tmp_path):
    import pyproj

    monkeypatch.setattr(pyproj.datadir, "get_user_data_dir", lambda: str(tmp_path))
    before = keys.grids_of_proj.__wrapped__()
    (tmp_path / "us_noaa_g2018u0.tif").write_bytes(b"grid")
    assert keys.grids_of_proj.__wrapped__() != before
