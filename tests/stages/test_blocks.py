"""Missions whose observations, cameras and orientations come from the block of another program.

The answer is that of the mission by its log, whose stations and points were written by that
program, or by its published formulas.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

from tests.dbat_project import write_project
from tests.helpers import codes_of, entry_of
from tests.stages.block_files import CABIN, write_colmap
from tests.stages.small_missions import enu_at, mission_of, rows_of, run
from unbend.batch.runs import run_mission

pycolmap = pytest.importorskip("pycolmap")

ORIGIN = (47.0, 8.5, 500.0)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "ba"
CAMERAS = {  # of the simulated mission, in COLMAP's order
    "nadir": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 7012.4, 5291.7, -0.018, 0.009,
                                            0.00015, -0.0001, -0.002, 0.0, 0.0, 0.0]),
    "oblique": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 6989.2, 5308.1, -0.015, 0.007,
                                              -0.00012, 0.00008, -0.001, 0.0, 0.0, 0.0]),
}  # fmt: skip
MATCHED = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED


@pytest.fixture
def block(mission_factory, tmp_path):
    """The mission without its log, its cameras and its table."""
    mission = mission_factory(tmp_path / "mission")
    config = mission.config
    for section in ("log", "mount", "events"):
        del config[section]
    config["mission"]["undulation_m"] = 47.6
    config["atmosphere"] = {"adjust": False}
    config["observations"] = {"path": "sparse", "format": "colmap"}
    same = {"calibration": "laboratory", "window": {"cabin": CABIN}}
    config["cameras"] = {"nadir": {"camera": 1} | same, "oblique": {"camera": 2} | same}
    config["stations"] = {"orientation": {"frame": enu_at(*ORIGIN)}}
    config["ground"] = {"height": "block"}
    return mission


@pytest.fixture
def colmap(block, by_log, flown):
    """Writes the model of the mission; returns the names of its points by their numbers."""

    def write(**options) -> dict[str, str]:
        numbers = write_colmap(
            block.folder / "sparse",
            CAMERAS,
            by_log.stations().to_pandas(),
            by_log.measurements().to_pandas(),
            pq.read_table(flown.truth / "points.parquet").to_pandas(),
            origin=ORIGIN,
            **options,
        )
        return {str(number): name for name, number in numbers.items()}

    return write


def shifts(mission) -> pd.DataFrame:
    table = mission.results().to_pandas()
    table["dx"] = table["x_corrected_px"] - table["x_px"]
    table["dy"] = table["y_corrected_px"] - table["y_px"]
    return table


def assert_same(block, by_log, names: dict[str, str]) -> None:
    """The corrections of every row, found again by image and point, are those by the log."""
    rows = shifts(block)
    by_name = shifts(by_log).set_index(["image", "point"])
    assert len(rows) == len(by_name)
    expected = by_name.loc[list(zip(rows["image"], rows["point"].map(names), strict=True))]
    assert np.abs(expected["dx"]).max() > 0.3
    for column, tolerance_px in (("dx", 2e-6), ("dy", 2e-6), ("x_px", 1e-9), ("y_px", 1e-9)):
        np.testing.assert_allclose(rows[column], expected[column], rtol=0.0, atol=tolerance_px)


def assert_near(rows: pd.DataFrame, expected: pd.DataFrame, share: float) -> None:
    """Corrections differ by less than a share of them, as the heights of the ground do."""
    size = np.hypot(expected["dx"], expected["dy"]).to_numpy()
    dx = rows["dx"].to_numpy() - expected["dx"].to_numpy()
    dy = rows["dy"].to_numpy() - expected["dy"].to_numpy()
    assert (np.hypot(dx, dy) < share * size).all()


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_a_model_of_colmap(block, by_log, colmap, text):
    names = colmap(text=text)
    manifest = block.run_to_manifest()
    assert_same(block, by_log, names)
    roles = {entry["role"] for entry in manifest["inputs"]}
    assert roles == {"observations", "orientation", "camera nadir", "camera oblique"}
    for _, keypoints in block.results().to_pandas().groupby("image")["keypoint"]:
        assert keypoints.is_monotonic_increasing
    assert "GROUND-BLOCK" in codes_of(manifest)


def test_the_mission_of_the_page(block, by_log, colmap):
    page = Path(__file__).resolve().parents[2] / "docs/pages/guide/oriented_block.md"
    missions = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    (text,) = [mission for mission in missions if "sparse/0" in mission]
    assert text.count("\n") < 20
    names = colmap()
    (block.folder / "sparse").rename(block.folder / "model")
    (block.folder / "sparse").mkdir()
    (block.folder / "model").rename(block.folder / "sparse" / "0")
    block.file.write_text(text)
    outcome = run_mission(block.file)
    assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
    block.config = yaml.load(text, yaml.BaseLoader)
    rows = block.results().to_pandas()
    assert (rows["status"] == "ok").all()
    # The climatology of the day in place of the US 1976 atmosphere.
    by_name = by_log.results().to_pandas().set_index(["image", "point"])["r_c_rad"]
    expected = by_name.loc[list(zip(rows["image"], rows["point"].map(names), strict=True))]
    ratio = rows["r_c_rad"].to_numpy() / expected
    assert ratio.between(0.93, 1.07).all()
    assert np.abs(ratio - 1.0).median() > 1e-3


def test_keypoints_without_a_point_keep_their_rows(block, by_log, colmap):
    without = frozenset(range(0, 59, 7))
    colmap(without_point=without)
    block.run_to_manifest()
    rows = shifts(block)
    assert len(rows) == 59
    unnamed = rows[rows["point"].str.contains(":")]
    assert len(unnamed) == len(without)
    assert (unnamed["point"] == unnamed["image"] + ":" + unnamed["keypoint"].astype(str)).all()
    assert (unnamed["status"] == "ok").all()
    # The heights of the points differ by less than 100 m from 2500 m below: under 4 % of each.
    by_pixel = shifts(by_log).assign(x_px=lambda table: table["x_px"].round(6))
    pixels = list(zip(unnamed["image"], unnamed["x_px"].round(6), strict=True))
    assert_near(unnamed, by_pixel.set_index(["image", "x_px"]).loc[pixels], 0.04)


def test_cameras_of_the_mission_file_and_by_their_names(block, by_log, colmap):
    """Numbers in the mission file, found by the camera's number; and entries called by theirs."""
    names = colmap()
    stated = by_log.config["cameras"]["nadir"]
    cameras = block.config["cameras"]
    cameras["nadir"] = stated | {"camera": 1}
    block.run_to_manifest()
    assert_same(block, by_log, names)
    del cameras["oblique"]["camera"]
    block.config["cameras"] = {"1": stated, "2": cameras["oblique"]}
    block.run_to_manifest()
    assert_same(block, by_log, names)


def test_what_a_block_does_not_say_is_asked_for(block, colmap):
    colmap()
    orientation = block.config["stations"]["orientation"]
    block.config["stations"]["orientation"] = {"heights": "msl"}
    assert "stations.orientation.frame: is missing" in block.refusal("CONFIG-INVALID", 2)
    block.config["stations"]["orientation"] = {"frame": "ecef"}
    text = " ".join(block.refusal("ORIENTATION-FRAME").split())
    assert "m above sea level" in text
    assert "a local frame is not ecef" in text
    block.config["stations"]["orientation"] = orientation
    del block.config["cameras"]["oblique"]
    text = " ".join(block.refusal("BLOCK-CAMERA").split())
    assert "3 images, the first oblique_00001, are of camera '2'" in text


def test_a_model_without_points_has_no_ground(block, colmap):
    colmap(without_point=frozenset(range(59)))
    assert "ground.height" in block.refusal("POINTS-EMPTY")


def test_a_point_twice_in_an_image_is_a_loss(block, colmap):
    colmap(text=True)
    file = block.folder / "sparse" / "images.txt"
    lines = file.read_text().splitlines()
    (image,) = [row for row, line in enumerate(lines) if line.endswith("nadir_00001")]
    fields = lines[image + 1].split()
    fields[5] = fields[2]
    lines[image + 1] = " ".join(fields)
    file.write_text("\n".join(lines) + "\n")
    entry = entry_of(block.run_to_manifest(3), "OBS-REPEATED-POINT")
    assert entry["kind"] == "loss"
    assert f"{fields[2]} in nadir_00001" in entry["what"]


# ---- databases of COLMAP


@contextmanager
def database(path: Path) -> Iterator[pycolmap.Database]:
    with closing(pycolmap.Database.open(str(path))) as content:
        yield content


@pytest.fixture
def with_database(block, by_log, colmap):
    """Lets the mission have its keypoints from a database, its orientations from a model."""
    colmap()
    block.config["observations"]["path"] = "database.db"
    block.config["stations"]["orientation"] |= {"path": "sparse", "format": "colmap"}
    with database(block.folder / "database.db") as content:
        for model, width, height, params in CAMERAS.values():
            camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
            content.write_camera(camera)
    return block


def write_keypoints(content, image: str, pixels: np.ndarray) -> int:
    """Write an image of the database and its keypoints; returns its number."""
    camera_id = 2 if image.startswith("oblique") else 1
    number = content.write_image(pycolmap.Image(name=image, camera_id=camera_id))
    content.write_keypoints(number, pixels.astype(np.float32))
    return number


def test_a_database_beside_a_model(with_database, by_log):
    """Keypoints of the database, float32; orientations, heights and cameras of the model."""
    block = with_database
    measured = by_log.measurements().to_pandas()
    with database(block.folder / "database.db") as content:
        for image, rows in measured.groupby("image"):
            write_keypoints(content, image, rows[["x_px", "y_px"]].to_numpy())
    block.run_to_manifest()
    rows = shifts(block)
    assert rows["point"].str.fullmatch(r"(nadir|oblique)_\d+:\d+").all()
    by_log_rows = shifts(by_log)
    by_log_rows["keypoint"] = by_log_rows.groupby("image").cumcount()
    keypoints = list(zip(rows["image"], rows["keypoint"], strict=True))
    expected = by_log_rows.set_index(["image", "keypoint"]).loc[keypoints]
    np.testing.assert_allclose(rows["x_px"], expected["x_px"], rtol=0.0, atol=0.0005)
    # Heights are medians of the images here, tens of metres from those of 2500 m below.
    assert_near(rows, expected, 0.05)
    del block.config["stations"]["orientation"]["path"]
    text = " ".join(block.refusal("neither orientations nor object points").split())
    assert "a model, as sparse/0" in text


def pairs_of(first: list[str], second: list[str]) -> list[tuple[int, int]]:
    """Where the points of one list stand in both, in the order of the first."""
    return [(k, second.index(point)) for k, point in enumerate(first) if point in second]


def test_matches_of_a_database_come_out_with_its_keypoints(with_database, by_log, unbend):
    """By name of the points, which the program never sees: with a keypoint outside the image as the
    first of each, and images numbered the other way round."""
    block = with_database
    source = block.folder / "database.db"
    measured = by_log.measurements().to_pandas()
    names = {}
    numbers = {}
    with database(source) as content:
        for image, rows in reversed([*measured.groupby("image")]):
            pixels = np.vstack([[-900.0, 50.0], rows[["x_px", "y_px"]]])
            numbers[image] = write_keypoints(content, image, pixels)
            names[image] = ["outside", *rows["point"]]
        for first, second in combinations(names, 2):
            # First the one outside with one inside.
            pairs = [(0, 1), *pairs_of(names[first], names[second])]
            content.write_matches(numbers[first], numbers[second], np.array(pairs, np.uint32))
            verified = pycolmap.TwoViewGeometry()
            verified.config = MATCHED
            verified.inlier_matches = np.array(pairs[:-1], np.uint32)
            content.write_two_view_geometry(numbers[first], numbers[second], verified)
    block.run_to_manifest(3)  # a loss: keypoints outside the image
    words = ("export", block.output, "--format", "colmap-database", "--out")
    assert "EXPORT-NO-TIES" not in unbend(*words, block.folder / "out.db").text

    rows = block.results().to_pandas().query("status == 'ok'").sort_values("keypoint")
    count = 0
    with database(block.folder / "out.db") as content:
        ids = {image.name: image.image_id for image in content.read_all_images()}
        assert sorted(ids, key=ids.get) != sorted(numbers, key=numbers.get)
        points = {}
        for image, of_image in rows.groupby("image"):
            corrected = of_image[["x_corrected_px", "y_corrected_px"]]
            pixels = content.read_keypoints(ids[image])[:, :2]
            np.testing.assert_allclose(pixels, corrected, rtol=0.0, atol=0.0006)
            points[image] = [names[image][keypoint] for keypoint in of_image["keypoint"]]
            assert "outside" not in points[image]
        for first, second in combinations(names, 2):
            pairs = pairs_of(points[first], points[second])
            matches = content.read_matches(ids[first], ids[second])
            assert matches.tolist() == [list(pair) for pair in pairs]
            count += len(pairs)
            # All in both lists were verified but the last.
            verified = content.read_two_view_geometry(ids[first], ids[second])
            last, _ = pairs_of(names[first], names[second])[-1]
            kept = [pair for pair in pairs if points[first][pair[0]] != names[first][last]]
            assert verified.inlier_matches.tolist() == [list(pair) for pair in kept]
            if kept:
                assert verified.config == MATCHED
    assert count > 30
    with database(source) as content:
        content.write_camera(pycolmap.Camera(model="PINHOLE", width=9, height=9, params=[9] * 4))
    changed = unbend(*words, block.folder / "again.db")
    assert changed.code == 3
    assert "EXPORT-NO-TIES" in changed.text


# ---- DBAT and PhotoScan


REAL_BLOCKS = {"dbat": ("sxb.xml", 1196), "metashape": ("sxb.psz", 4066)}


@pytest.mark.parametrize("program", ["written", *(REAL_BLOCKS if SHARED.is_dir() else [])])
def test_a_block_as_a_mission_without_a_log(tmp_path, program):
    """Five images over Strasbourg: DBAT's script, real and written, and PhotoScan's archive."""
    if program == "written":
        count = len(write_project(tmp_path).marks)
        file = tmp_path / "sxb.xml"
        program = "dbat"
    else:
        name, count = REAL_BLOCKS[program]
        file = SHARED / "dbat_sxb" / name
    orientation = {"frame": "projected", "crs": "EPSG:27561", "heights": "msl"}
    mission = mission_of(str(file), program, **orientation, date="2013-08-22")
    del mission["atmosphere"]
    stations, _ = run(tmp_path, mission)
    rows = rows_of(tmp_path)
    assert (rows["status"] == "ok").all()
    assert len(rows) == count
    dx = rows["x_corrected_px"] - rows["x_px"]
    dy = rows["y_corrected_px"] - rows["y_px"]
    assert 0.05 < np.hypot(dx, dy).median() < 0.12
    # Strasbourg, 1.8 km above the town, in NTF to 2 m.
    assert stations["lat_deg"].between(48.579, 48.587).all()
    assert stations["lon_deg"].between(7.757, 7.770).all()
    assert stations["h_msl_m"].between(1906, 1938).all()
