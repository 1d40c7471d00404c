"""What a result depends on: a change of any of it makes another fingerprint."""

import hashlib
import os
import shutil
from pathlib import Path

import pytest

import unbend
from tests.helpers import refused
from unbend.batch.fingerprint import code_hash, hash_of_files
from unbend.batch.input_files import check_unchanged, named_inputs
from unbend.config import load_mission

from .conftest import plan_of

PACKAGE = Path(unbend.__file__).parent


@pytest.fixture
def plan(mission):
    return plan_of(mission)


@pytest.fixture
def copied(tmp_path):
    """The package's sources and data in a folder of the test's own."""
    folder = tmp_path / "unbend"
    shutil.copytree(
        PACKAGE,
        folder,
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    return folder


def test_the_code_and_every_table_of_the_package_count(copied):
    before = hash_of_files(copied)
    assert before == hash_of_files(PACKAGE) == code_hash()
    tables = sorted(copied.rglob("*.csv"))
    assert len(tables) >= 15, "the climatologies and constants"
    for path in (*tables, copied / "units.py", copied / "cli" / "entry.py"):
        content = path.read_bytes()
        path.write_bytes(content.replace(b"1", b"2", 1))
        assert hash_of_files(copied) != before, path
        path.write_bytes(content)
    assert hash_of_files(copied) == before
    tables[0].rename(tables[0].with_name("renamed.csv"))
    assert hash_of_files(copied) != before


def test_compiled_code_does_not_count(copied):
    before = hash_of_files(copied)
    (copied / "__pycache__").mkdir()
    (copied / "__pycache__" / "units.cpython-311.pyc").write_bytes(b"compiled")
    assert hash_of_files(copied) == before


def test_a_file_that_is_written_to_is_changed_even_if_its_content_is_there_again(mission, plan):
    """Another content may have been there in between, and read."""
    check_unchanged(plan.inputs)
    content = mission.log.read_bytes()
    status = mission.log.stat()
    mission.log.write_bytes(content[:-9])
    mission.log.write_bytes(content)
    # As programs that copy files do.
    os.utime(mission.log, ns=(status.st_atime_ns, status.st_mtime_ns))
    with refused("INPUT-CHANGED"):
        check_unchanged(plan.inputs)


def test_inputs_have_their_roles_and_their_places_in_the_mission_file(mission):
    mission.config["atmosphere"] = {"soundings": [{"path": "a.csv"}, {"path": "b.csv"}]}
    inputs = named_inputs(load_mission(mission.save()))
    assert {item.role: item.name for item in inputs} == {
        "log": mission.config["log"]["path"],
        "observations": mission.config["observations"]["path"],
        "sounding 1": "a.csv",
        "sounding 2": "b.csv",
    }
    (mission.folder / "a.csv").write_text("h")
    with refused("INPUT-MISSING") as refusal:
        plan_of(mission)
    assert refusal.value.where == str(mission.folder / "b.csv")
    assert "atmosphere.soundings" in str(refusal.value)
    mission.log.unlink()
    with refused("INPUT-MISSING", says="check log.path"):
        plan_of(mission)


SIDECARS = ["dem.tif.aux.xml", "dem.tif.msk", "dem.tif.ovr", "dem.tfw", "DEM.prj", "dem"]
OF_OTHERS = ["dem.yaml", "dem.log", "dem_2.tif.aux.xml", "demo.tfw"]


def test_files_beside_a_raster_count_with_it(mission):
    """A raster alone has the hash of its bytes."""
    mission.config["ground"]["height"] = {"dem": "dem.tif"}
    mission.config["mission"]["geoid"] = "sea.tif"
    for name in ("dem.tif", "sea.tif", *OF_OTHERS):
        (mission.folder / name).write_bytes(b"raster")
    plan = plan_of(mission)
    alone = hashlib.sha256(b"raster").hexdigest()
    assert plan.input("elevation model 1").sha256 == alone
    assert plan.input("geoid").sha256 == alone
    hashes = {alone}
    for name in SIDECARS:
        sidecar = mission.folder / name
        for content in (b"x", b"y"):
            sidecar.write_bytes(content)
            hashes.add(plan_of(mission).input("elevation model 1").sha256)
            with refused("INPUT-CHANGED"):
                check_unchanged(plan.inputs)
        sidecar.unlink()
    assert len(hashes) == 1 + 2 * len(SIDECARS)
    (mission.folder / "sea.tif.aux.xml").write_bytes(b"x")
    plan = plan_of(mission)
    assert plan.input("elevation model 1").sha256 == alone
    assert plan.input("geoid").sha256 != alone


@pytest.mark.parametrize("section", ["window", "temperature"])
def test_a_key_with_null_is_not_an_absent_key(mission, section):
    """`window: null` says that a camera is outside, `temperature: null` that no sensor is used."""
    camera = mission.config["cameras"]["nadir"]
    channels = mission.config["log"]["channels"]
    camera.pop("window")
    channels.pop("temperature", None)
    absent = plan_of(mission)
    changed = camera if section == "window" else channels
    changed[section] = None
    stated = plan_of(mission)
    assert stated.config == absent.config
    assert stated.fingerprint != absent.fingerprint
