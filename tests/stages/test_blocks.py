"""Missions whose observations, cameras and orientations come from the block of another program.

The answer is that of the mission by its log, whose stations and points were written by that
program, or by its published formulas.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))
from block_files import write_colmap

pytestmark = pytest.mark.usefixtures("plain_report")

CABIN = {"pressure_hpa": 812.0, "temperature_c": 21.0, "relative_humidity": 0.3}
ORIGIN = (47.0, 8.5, 500.0)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "ba"
CAMERAS = {  # of the simulated mission, in COLMAP's order
    "nadir": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 7012.4, 5291.7, -0.018, 0.009,
                                            0.00015, -0.0001, -0.002, 0.0, 0.0, 0.0]),
    "oblique": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 6989.2, 5308.1, -0.015, 0.007,
                                              -0.00012, 0.00008, -0.001, 0.0, 0.0, 0.0]),
}  # fmt: skip


@pytest.fixture(scope="module")
def by_log(mission_factory, tmp_path_factory):
    """The mission by its log, in the standard atmosphere behind windows of constant air."""
    mission = mission_factory(tmp_path_factory.mktemp("by_log") / "mission")
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    ended = mission.run()
    assert ended.code == 0, ended.text
    return mission


@pytest.fixture(scope="module")
def points(flown):
    return pq.read_table(flown.truth / "points.parquet").to_pandas()


@pytest.fixture
def block(mission_factory, tmp_path):
    """The same without its log, its cameras and its table."""
    mission = mission_factory(tmp_path / "mission")
    config = mission.config
    for section in ("log", "mount", "events"):
        del config[section]
    config["mission"]["undulation_m"] = 47.6
    config["atmosphere"] = {"adjust": False}
    config["observations"] = {"path": "sparse", "format": "colmap"}
    same = {"calibration": "laboratory", "window": {"cabin": CABIN}}
    config["cameras"] = {"nadir": {"camera": 1} | same, "oblique": {"camera": 2} | same}
    config["stations"] = {"orientation": {"frame": enu(ORIGIN)}}
    config["ground"] = {"height": "block"}
    return mission


def enu(origin) -> dict:
    return {"enu": dict(zip(("lat_deg", "lon_deg", "h_ellipsoid_m"), origin, strict=True))}


def colmap(block, by_log, points, **options) -> dict[str, int]:
    observations = by_log.measurements().to_pandas()
    return write_colmap(block.folder / "sparse", CAMERAS, by_log.stations().to_pandas(),
                        observations, points, origin=ORIGIN, **options)  # fmt: skip


def ran(mission, code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def shift(mission) -> pd.DataFrame:
    table = mission.results().to_pandas()
    for axis in "xy":
        table[f"d{axis}"] = table[f"{axis}_corrected_px"] - table[f"{axis}_px"]
    return table


def assert_same(block, by_log, names: dict[str, str], atol: float) -> None:
    """The corrections of every row, found again by image and point, are those by the log."""
    wanted = shift(by_log).set_index(["image", "point"])
    found = shift(block)
    assert len(found) == len(wanted)
    wanted = wanted.loc[list(zip(found["image"], found["point"].map(names), strict=True))]
    assert np.abs(wanted["dx"]).max() > 0.3
    for column, most in (("dx", atol), ("dy", atol), ("x_px", 1e-9), ("y_px", 1e-9)):
        np.testing.assert_allclose(found[column], wanted[column], rtol=0.0, atol=most)


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_a_model_of_colmap(block, by_log, points, text):
    numbers = colmap(block, by_log, points, text=text)
    manifest = ran(block)
    assert_same(block, by_log, {str(k): name for name, k in numbers.items()}, 2e-6)
    assert {i["role"] for i in manifest["inputs"]} == {
        "observations", "orientation", "camera nadir", "camera oblique",
    }  # fmt: skip
    found = block.results().to_pandas()
    assert (found.groupby("image")["keypoint"].apply(list).apply(lambda k: k == sorted(k))).all()
    assert "GROUND-BLOCK" in {entry["code"] for entry in manifest["ledger"]}


def test_keypoints_without_a_point_keep_their_rows(block, by_log, points):
    without = frozenset(range(0, 59, 7))
    colmap(block, by_log, points, without_point=without)
    ran(block)
    found = shift(block)
    own = found[found["point"].str.contains(":")]
    assert len(found) == 59
    assert len(own) == len(without)
    assert (own["point"] == own["image"] + ":" + own["keypoint"].astype(str)).all()
    assert (own["status"] == "ok").all()
    # The heights of the points differ by less than 100 m from 2500 m below: under 4 % of each.
    wanted = shift(by_log)
    wanted = wanted.set_index([wanted["image"], wanted["x_px"].round(6)]).loc[
        list(zip(own["image"], own["x_px"].round(6), strict=True))
    ]
    size = np.hypot(wanted["dx"], wanted["dy"]).to_numpy()
    off = np.hypot(own["dx"].to_numpy() - wanted["dx"], own["dy"].to_numpy() - wanted["dy"])
    assert (off.to_numpy() < 0.04 * size).all()


def refused(mission, code: str, *words: str) -> None:
    ended = mission.run()
    assert ended.code in (2, 6), ended.text
    assert "Traceback" not in ended.text
    text = " ".join(ended.err.split())
    for word in (code, *words):
        assert word in text, ended.err


def test_what_a_block_does_not_say_is_asked_for(block, by_log, points):
    colmap(block, by_log, points)
    block.config["stations"]["orientation"] = {"heights": "msl"}
    refused(block, "ORIENTATION-FRAME", "stations.orientation.frame: ecef")
    block.config["stations"]["orientation"] = {"frame": enu(ORIGIN)}
    del block.config["cameras"]["oblique"]
    refused(block, "BLOCK-CAMERA", "3 images, the first oblique_00001, are of camera '2'")


def test_a_point_twice_in_an_image_is_a_loss(block, by_log, points):
    colmap(block, by_log, points, text=True)
    file = block.folder / "sparse" / "images.txt"
    lines = file.read_text().splitlines()
    row = next(k for k, line in enumerate(lines) if line.endswith("nadir_00001")) + 1
    fields = lines[row].split()
    first, fields[5] = fields[2], fields[2]
    lines[row] = " ".join(fields)
    file.write_text("\n".join(lines) + "\n")
    entries = {e["code"]: e for e in ran(block, 3)["ledger"] if e["kind"] == "loss"}
    assert f"the first is {first} in nadir_00001" in entries["OBS-REPEATED-POINT"]["what"]


@pytest.mark.parametrize("program", ["dbat", "metashape"])
def test_a_real_block_as_a_mission_without_a_log(tmp_path, program):
    """Five images over Strasbourg: DBAT's script and the archive of PhotoScan."""
    from pipeline.stages.story import run_mission

    folder = SHARED / "dbat_sxb"
    if not folder.is_dir():
        pytest.skip("no blocks beside the checkout")
    mission = {
        "mission": {"name": "sxb"},
        "observations": {"path": str(folder / {"dbat": "sxb.xml", "metashape": "sxb.psz"}[program]),
                         "format": program},
        "cameras": {"aerial": {"calibration": "laboratory"}},
        "stations": {"orientation": {"frame": "projected", "crs": "EPSG:27561", "heights": "msl",
                                     "date": "2013-08-22"}},
        "ground": {"height": "block"},
        "output": {"path": str(tmp_path / "out")},
    }  # fmt: skip
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(mission))
    outcome = run_mission(tmp_path / "m.yaml")
    assert outcome.exit_code == 0, outcome.manifest["ledger"]
    found = pd.read_parquet(outcome.output / "observations")
    assert (found["status"] == "ok").all()
    assert len(found) == {"dbat": 1196, "metashape": 4066}[program]
    size = np.hypot(
        found["x_corrected_px"] - found["x_px"], found["y_corrected_px"] - found["y_px"]
    )
    assert 0.05 < size.median() < 0.12
    # Strasbourg, 1.8 km above the town, in NTF to 2 m.
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    assert stations["lat_deg"].between(48.579, 48.587).all()
    assert stations["lon_deg"].between(7.757, 7.770).all()
    assert stations["h_msl_m"].between(1906, 1938).all()
