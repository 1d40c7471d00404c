"""Missions whose observations, cameras and orientations come from the block of another program.

The answer is that of the mission by its log, whose stations and points were written by that
program, or by its published formulas.
"""

from contextlib import closing
from itertools import combinations

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from numpy.testing import assert_allclose

from tests.dbat_project import write_project
from tests.helpers import codes_of, entry_of, one_line
from tests.logs import REPOSITORY, SHARED
from tests.stages.block_files import CABIN, write_colmap
from tests.stages.corrected_rows import shift
from tests.stages.small_missions import enu_at, mission_of, rows_of, run
from unbend.batch.runs import run_mission

pycolmap = pytest.importorskip("pycolmap")

ORIGIN = (47.0, 8.5, 500.0)
NADIR = [
    20000.0,
    20000.0,
    7012.4,
    5291.7,
    -0.018,
    0.009,
    0.00015,
    -0.0001,
    -0.002,
    0.0,
    0.0,
    0.0,
]
OBLIQUE = [
    20000.0,
    20000.0,
    6989.2,
    5308.1,
    -0.015,
    0.007,
    -0.00012,
    0.00008,
    -0.001,
    0.0,
    0.0,
    0.0,
]
CAMERAS = {
    "nadir": ("FULL_OPENCV", 14000, 10600, NADIR),
    "oblique": ("FULL_OPENCV", 14000, 10600, OBLIQUE),
}
"""Of the simulated mission, with parameters in COLMAP's order."""

OUTSIDE = [-900.0, 50.0]
"""A keypoint outside its image."""

MATCHED = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
PIXEL = ["x_px", "y_px"]
SHIFT_PX = ["dx", "dy"]


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
    section = {"calibration": "laboratory", "window": {"cabin": CABIN}}
    config["cameras"] = {
        "nadir": section | {"camera": 1},
        "oblique": section | {"camera": 2},
    }
    config["stations"] = {"orientation": {"frame": enu_at(*ORIGIN)}}
    config["ground"] = {"height": "block"}
    mission.database = mission.folder / "database.db"
    return mission


@pytest.fixture
def colmap(block, by_log, flown):
    """Writes the model of the mission; returns the names of its points by their numbers."""

    def write(**options):
        numbers = write_colmap(
            block.folder / "sparse",
            CAMERAS,
            by_log.station_rows(),
            by_log.measured_rows(),
            pq.read_table(flown.truth / "points.parquet").to_pandas(),
            origin=ORIGIN,
            **options,
        )
        return {str(number): name for name, number in numbers.items()}

    return write


def shifts(mission):
    table = mission.result_rows()
    table[SHIFT_PX] = shift(table)
    return table


def matching(rows, key, table):
    """The rows of a table that have the image and the key of these rows, in their order."""
    keys = ["image", key]
    index = pd.MultiIndex.from_frame(rows[keys])
    return table.set_index(keys).loc[index].reset_index()


def assert_same(block, by_log, names):
    """The corrections of every row, found again by image and point, are those by the log."""
    rows = shifts(block)
    rows["point"] = rows["point"].map(names)
    by_log_rows = shifts(by_log)
    assert len(rows) == len(by_log_rows)
    expected = matching(rows, "point", by_log_rows)
    assert np.abs(expected["dx"]).max() > 0.3
    assert_allclose(rows[SHIFT_PX], expected[SHIFT_PX], rtol=0.0, atol=2e-6)
    assert_allclose(rows[PIXEL], expected[PIXEL], rtol=0.0, atol=1e-9)


def assert_near(rows, expected, share):
    """Corrections differ by less than a share of them, as the heights of the ground do."""
    expected_px = expected[SHIFT_PX].to_numpy()
    difference_px = rows[SHIFT_PX] - expected_px
    size_px = np.linalg.norm(expected_px, axis=1)
    error_px = np.linalg.norm(difference_px, axis=1)
    assert (error_px < share * size_px).all()


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_a_model_of_colmap(block, by_log, colmap, text):
    names = colmap(text=text)

    manifest = block.run_to_manifest()

    assert_same(block, by_log, names)
    roles = {entry["role"] for entry in manifest["inputs"]}
    assert roles == {"observations", "orientation", "camera nadir", "camera oblique"}
    images = block.result_rows().groupby("image")
    assert images["keypoint"].is_monotonic_increasing.all()
    assert "GROUND-BLOCK" in codes_of(manifest)


def test_the_mission_of_the_page(block, by_log, colmap):
    page = REPOSITORY / "docs/pages/guide/oriented_block.md"
    examples = page.read_text("utf-8").split("```")
    (text,) = [part for part in examples if "sparse/0" in part and part.startswith("yaml\n")]
    text = text.removeprefix("yaml\n")
    assert text.count("\n") < 20
    names = colmap()
    sparse = block.folder / "sparse"
    model = sparse.rename(block.folder / "model")
    sparse.mkdir()
    model.rename(sparse / "0")
    block.file.write_text(text)

    outcome = run_mission(block.file)

    assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
    block.config = yaml.load(text, yaml.BaseLoader)
    rows = block.result_rows()
    assert (rows["status"] == "ok").all()
    # The climatology of the day in place of the US 1976 atmosphere.
    rows["point"] = rows["point"].map(names)
    by_log_rows = by_log.result_rows()
    expected = matching(rows, "point", by_log_rows)
    ratio = rows["r_c_rad"] / expected["r_c_rad"]
    assert ratio.between(0.93, 1.07).all()
    assert np.abs(ratio - 1.0).median() > 1e-3


def test_keypoints_without_a_point_keep_their_rows(block, by_log, colmap):
    without = frozenset(range(0, 59, 7))
    colmap(without_point=without)

    block.run_to_manifest()

    rows = shifts(block).round({"x_px": 6})
    assert len(rows) == 59
    unnamed = rows[rows["point"].str.contains(":")]
    assert len(unnamed) == len(without)
    keypoints = unnamed["keypoint"].astype(str)
    assert (unnamed["point"] == unnamed["image"] + ":" + keypoints).all()
    assert (unnamed["status"] == "ok").all()
    # The heights of the points differ by less than 100 m from 2500 m below: under 4 % of each.
    by_log_rows = shifts(by_log).round({"x_px": 6})
    expected = matching(unnamed, "x_px", by_log_rows)
    assert_near(unnamed, expected, 0.04)


def test_cameras_of_the_mission_file_and_by_their_names(block, by_log, colmap):
    """Numbers in the mission file, found by the camera's number; and entries called by theirs."""
    names = colmap()
    nadir = by_log.config["cameras"]["nadir"]
    cameras = block.config["cameras"]
    cameras["nadir"] = nadir | {"camera": 1}
    block.run_to_manifest()
    assert_same(block, by_log, names)

    oblique = cameras["oblique"]
    del oblique["camera"]
    block.config["cameras"] = {"1": nadir, "2": oblique}
    block.run_to_manifest()
    assert_same(block, by_log, names)


def test_what_a_block_does_not_say_is_asked_for(block, colmap):
    colmap()
    stations = block.config["stations"]
    complete = stations["orientation"]
    stations["orientation"] = {"heights": "msl"}
    assert "stations.orientation.frame: is missing" in block.refusal("CONFIG-INVALID", 2)

    stations["orientation"] = {"frame": "ecef"}
    text = one_line(block.refusal("ORIENTATION-FRAME"))
    assert "m above sea level" in text
    assert "a local frame is not ecef" in text

    stations["orientation"] = complete
    del block.config["cameras"]["oblique"]
    text = one_line(block.refusal("BLOCK-CAMERA"))
    assert "3 images, the first oblique_00001, are of camera '2'" in text


def test_a_model_without_points_has_no_ground(block, colmap):
    colmap(without_point=frozenset(range(59)))
    assert "ground.height" in block.refusal("POINTS-EMPTY")


def test_a_point_twice_in_an_image_is_a_loss(block, colmap):
    colmap(text=True)
    file = block.folder / "sparse" / "images.txt"
    before, name, after = file.read_text().partition("nadir_00001\n")
    keypoints = after.split(" ")  # x, y and point of the first, of the second, ...
    point = keypoints[2]
    keypoints[5] = point
    file.write_text(before + name + " ".join(keypoints))

    manifest = block.run_to_manifest(3)

    entry = entry_of(manifest, "OBS-REPEATED-POINT")
    assert entry["kind"] == "loss"
    assert f"{point} in nadir_00001" in entry["what"]


# ---- databases of COLMAP


def database(path):
    return closing(pycolmap.Database.open(str(path)))


@pytest.fixture
def with_database(block, by_log, colmap):
    """Lets the mission have its keypoints from a database, its orientations from a model."""
    colmap()
    block.config["observations"]["path"] = "database.db"
    orientation = block.config["stations"]["orientation"]
    orientation["path"] = "sparse"
    orientation["format"] = "colmap"
    with database(block.database) as content:
        for camera in CAMERAS.values():
            write_camera(content, *camera)
    return block


def write_camera(content, model, width, height, params):
    camera = pycolmap.Camera(
        model=model,
        width=width,
        height=height,
        params=params,
    )
    content.write_camera(camera)


def write_keypoints(content, name, pixels):
    """Write an image of the database and its keypoints; returns its number."""
    camera, _ = name.split("_")
    camera_id = list(CAMERAS).index(camera) + 1
    image = pycolmap.Image(name=name, camera_id=camera_id)
    number = content.write_image(image)
    content.write_keypoints(number, pixels.astype(np.float32))
    return number


def test_a_database_beside_a_model(with_database, by_log):
    """Keypoints of the database, float32; orientations, heights and cameras of the model."""
    block = with_database
    measured = by_log.measured_rows()
    with database(block.database) as content:
        for image, rows in measured.groupby("image"):
            write_keypoints(content, image, rows[PIXEL].to_numpy())

    block.run_to_manifest()

    rows = shifts(block)
    assert rows["point"].str.fullmatch(r"(nadir|oblique)_\d+:\d+").all()
    by_log_rows = shifts(by_log)
    by_log_rows["keypoint"] = by_log_rows.groupby("image").cumcount()
    expected = matching(rows, "keypoint", by_log_rows)
    assert_allclose(rows["x_px"], expected["x_px"], rtol=0.0, atol=0.0005)
    # Heights are medians of the images here, tens of metres from those of 2500 m below.
    assert_near(rows, expected, 0.05)
    del block.config["stations"]["orientation"]["path"]
    text = one_line(block.refusal("neither orientations nor object points"))
    assert "a model, as sparse/0" in text


def pairs_of(first, second):
    """The places in two lists of the points that both have, in the order of the first."""
    return [[k, second.index(point)] for k, point in enumerate(first) if point in second]


def write_matches(content, first, second, pairs):
    """The matches of two images, all but the last of which were verified."""
    matches = np.array(pairs, np.uint32)
    content.write_matches(first, second, matches)
    verified = pycolmap.TwoViewGeometry()
    verified.config = MATCHED
    verified.inlier_matches = matches[:-1]
    content.write_two_view_geometry(first, second, verified)


def test_matches_of_a_database_come_out_with_its_keypoints(with_database, by_log, unbend):
    """By name of the points, which the program never sees: with a keypoint outside the image as the
    first of each, and images numbered the other way round."""
    block = with_database
    measured = by_log.measured_rows()
    names = {}
    numbers = {}
    with database(block.database) as content:
        for image in sorted(measured["image"].unique(), reverse=True):
            rows = measured[measured["image"] == image]
            pixels = np.vstack([OUTSIDE, rows[PIXEL]])
            numbers[image] = write_keypoints(content, image, pixels)
            names[image] = ["outside", *rows["point"]]
        for first, second in combinations(names, 2):
            # First the one outside with one inside.
            pairs = pairs_of(names[first], names[second])
            pairs.insert(0, [0, 1])
            write_matches(content, numbers[first], numbers[second], pairs)
    block.run_to_manifest(3)  # a loss: keypoints outside the image
    export = ("export", block.output, "--format", "colmap-database", "--out")

    exported = unbend(*export, block.folder / "out.db")

    assert "EXPORT-NO-TIES" not in exported.text
    rows = block.result_rows().query("status == 'ok'")
    count = 0
    with database(block.folder / "out.db") as content:
        ids = {image.name: image.image_id for image in content.read_all_images()}
        assert sorted(ids, key=ids.get) != sorted(numbers, key=numbers.get)
        points = {}
        for image, of_image in rows.sort_values("keypoint").groupby("image"):
            corrected = of_image[["x_corrected_px", "y_corrected_px"]]
            pixels = content.read_keypoints(ids[image])[:, :2]
            assert_allclose(pixels, corrected, rtol=0.0, atol=0.0006)
            points[image] = [names[image][keypoint] for keypoint in of_image["keypoint"]]
            assert "outside" not in points[image]
        for first, second in combinations(names, 2):
            pairs = pairs_of(points[first], points[second])
            matches = content.read_matches(ids[first], ids[second])
            assert matches.tolist() == pairs
            count += len(pairs)
            # All in both lists were verified but the last.
            last = [name for name in names[first] if name in names[second]][-1]
            expected = [pair for pair in pairs if points[first][pair[0]] != last]
            verified = content.read_two_view_geometry(ids[first], ids[second])
            assert verified.inlier_matches.tolist() == expected
            if expected:
                assert verified.config == MATCHED
    assert count > 30

    with database(block.database) as content:
        write_camera(content, "PINHOLE", 9, 9, [9] * 4)
    exported = unbend(*export, block.folder / "again.db")
    assert exported.code == 3
    assert "EXPORT-NO-TIES" in exported.text


# ---- DBAT and PhotoScan


def assert_strasbourg(folder, file, program, count):
    """The mission of five images over Strasbourg has all rows, a small shift, and its place."""
    mission = mission_of(
        str(file),
        program,
        frame="projected",
        crs="EPSG:27561",
        heights="msl",
        date="2013-08-22",
    )
    del mission["atmosphere"]

    stations, _ = run(folder, mission)

    rows = rows_of(folder)
    assert (rows["status"] == "ok").all()
    assert len(rows) == count
    assert 0.05 < np.median(np.hypot(*shift(rows).T)) < 0.12
    # Strasbourg, 1.8 km above the town, in NTF to 2 m.
    assert stations["lat_deg"].between(48.579, 48.587).all()
    assert stations["lon_deg"].between(7.757, 7.770).all()
    assert stations["h_msl_m"].between(1906, 1938).all()


def test_a_block_as_a_mission_without_a_log_that_is_written(tmp_path):
    marks = write_project(tmp_path).marks
    assert_strasbourg(tmp_path, tmp_path / "sxb.xml", "dbat", len(marks))


@pytest.mark.shared("ba")
@pytest.mark.parametrize(
    ("name", "program", "count"),
    [
        ("sxb.xml", "dbat", 1196),
        ("sxb.psz", "metashape", 4066),
    ],
)
def test_a_block_as_a_mission_without_a_log(tmp_path, name, program, count):
    """DBAT's script, and PhotoScan's archive."""
    assert_strasbourg(tmp_path, SHARED / "ba" / "dbat_sxb" / name, program, count)
