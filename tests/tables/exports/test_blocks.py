"""Blocks for bundle adjustment, written from a block that is projected here, read by others.

Truth: that of `projected_block`, pycolmap for COLMAP's files.
"""

import functools
import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import one_line, refused, with_code
from tests.tables.checks import assert_within, refused_with
from tests.tables.exports.export_runs import DOWN, read_table, write_export
from tests.tables.exports.projected_block import (
    IMAGES,
    NADIR,
    SIDE,
    SIGMA_HEIGHT,
    SIGMA_HORIZONTAL,
    frame_of,
    names_of_points,
    point_names,
)
from tests.tables.observed import COLUMNS
from unbend.messages import Ledger
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import FORMATS, ExportCamera, find_format
from unbend.tables.exports.bingo import short_names
from unbend.tables.observations import open_observations
from unbend.tables.refraction_mark import refuse_marked

BLOCKS = ["colmap", "colmap-database", "bundler", "opensfm", "bingo"]
READ_AGAIN = ["colmap", "colmap-database", "opensfm"]
PIXELS = ["x_px", "y_px"]
NAN_OF_IMAGES = np.full(IMAGES, np.nan)


@pytest.fixture(scope="module")
def written(block, tmp_path_factory):
    """The block as a format writes it, once for all tests."""

    @functools.cache
    def write(name):
        return write_export(block.run(), name, tmp_path_factory.mktemp(name))

    return write


def read_json(path):
    return json.loads(path.read_text())


# ---------------------------------------------------------------- COLMAP


def test_a_model_that_pycolmap_reads_loses_nothing(block, written):
    colmap = written("colmap")
    frame = frame_of(colmap)

    model = pycolmap.Reconstruction(colmap.path)

    assert model.cameras[1].model.name == "FULL_OPENCV"
    assert model.cameras[2].model.name == "PINHOLE"
    images = []
    for number in range(1, IMAGES + 1):
        images.append(model.images[number])
    assert [image.name for image in images] == block.image.tolist()
    centres = [image.projection_center() for image in images]
    assert_within(centres, frame(block.centre), 1e-6)
    poses = [image.cam_from_world() for image in images]
    turns = [pose.rotation.matrix() for pose in poses]
    assert_within(turns, block.turn @ block.axes(frame), 1e-9)


def test_points_that_pycolmap_reads_lose_nothing(block, written):
    colmap = written("colmap")
    frame = frame_of(colmap)

    model = pycolmap.Reconstruction(colmap.path)

    for image in model.images.values():
        rows = block.of_image(image.name)
        pixels = [point.xy for point in image.points2D]
        # Half a pixel there and back: 1 ulp of 14,000 px.
        assert_within(pixels, rows[PIXELS], 2e-12)
        has_point = [point.has_point3D() for point in image.points2D]
        is_tied = rows.point.isin(block.tied)
        assert has_point == is_tied.tolist()
        tied = [point.point3D_id for point in image.points2D if point.has_point3D()]
        names = names_of_points(colmap.path, tied)
        assert names == rows.point[is_tied].tolist()
    names = names_of_points(colmap.path, model.points3D)
    assert set(names) == block.tied
    positions = [point.xyz for point in model.points3D.values()]
    assert_within(positions, frame(block.places(names)), 1e-3)
    for number, point in model.points3D.items():
        for view in point.track.elements:
            keypoints = model.images[view.image_id].points2D
            assert keypoints[view.point2D_idx].point3D_id == number


def test_a_model_says_what_it_holds(block, written):
    colmap = written("colmap")
    points = set(block.rows.point)
    named = {point for point in points if not point.isdigit()}

    assert set(point_names(colmap.path).values()) == named
    assert colmap.message("EXPORT-CAMERAS").what == "camera 1 nadir, 2 side"
    message = colmap.message("EXPORT-POINTS")
    assert message.count == len(block.rows)
    assert f"of {len(points):,} points in 12 images" in message.what
    assert colmap.message("EXPORT-SINGLE").count == len(points - block.tied)


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        (BrownConrady(), "PINHOLE"),
        (
            BrownConrady(k1=-0.02, p2=1e-4),
            "OPENCV",
        ),
        (
            GeneralFrame(k1=0.02, q2=0.01, px=1e-4, py=-2e-4),
            "FULL_OPENCV",
        ),
        (
            OpenCVFisheye(0.01, -0.002, 0.0003, 1e-5),
            "OPENCV_FISHEYE",
        ),
    ],
)
def test_colmap_has_the_camera_itself(block, distortion, model):
    camera = replace(SIDE, distortion=distortion)
    run = block.with_side_camera(camera)

    colmap = write_export(run, "colmap")

    read = pycolmap.Reconstruction(colmap.path).cameras[2]
    assert read.model.name == model
    assert camera_of_model(model, read.width, read.height, read.params) == camera
    rng = np.random.default_rng(2)
    x = rng.uniform(-0.3, 0.3, 50)
    y = rng.uniform(-0.3, 0.3, 50)
    rays = np.column_stack([x, y, np.ones(50)])
    expected = np.column_stack(camera.project(x, y))
    assert_within(read.img_from_cam(rays), expected, 1e-8)


FISHEYE = OpenCVFisheye(0.01, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (
            "colmap",
            {"distortion": GeneralFrame(k4=0.1)},
            "k4",
        ),
        (
            "colmap",
            {"distortion": GeneralFrame(k1=0.1, sense=-1.0)},
            "sense",
        ),
        (
            "colmap-database",
            {"distortion": GeneralFrame(skew_x=1e-4)},
            "skew_x",
        ),
        (
            "opensfm",
            {"distortion": GeneralFrame(k1=0.1, q1=0.01)},
            "k4",
        ),
        (
            "pix4d",
            {"distortion": FISHEYE},
            "fisheye",
        ),
        (
            "blocksexchange",
            {"distortion": FISHEYE},
            "fisheye",
        ),
        (
            "blocksexchange",
            {"fy_px": 14_990.0},
            "different fx and fy",
        ),
    ],
)
def test_lenses_that_a_format_cannot_hold(square, name, change, words):
    camera = replace(SIDE, **change)
    run = square.with_side_camera(camera)

    with refused_with("EXPORT-DISTORTION", rf"camera side \(with {words}"):
        write_export(run, name)

    # Without distortion there is a way.
    assert write_export(run, "bundler").count > 100


def opened_database(written):
    return closing(pycolmap.Database.open(written.path))


def test_rigs_and_keypoints_that_pycolmap_reads(block, written):
    with opened_database(written("colmap-database")) as database:
        rigs = database.read_all_rigs()
        frames = database.read_all_frames()
        images = database.read_all_images()
        keypoints = [database.read_keypoints(image.image_id) for image in images]

    assert [rig.ref_sensor_id.id for rig in rigs] == [1, 2]
    assert [frame.rig_id for frame in frames] == [1, 2] * 6
    names = {image.image_id: image.name for image in images}
    assert names == dict(enumerate(block.image, 1))
    lost_px = []
    for image, pixels in zip(images, keypoints, strict=True):
        rows = block.of_image(image.name)
        lost = pixels[:, :2] - rows[PIXELS].to_numpy()
        lost_px.append(np.abs(lost).max())
    assert 0.0 < max(lost_px) <= 0.0005, "float32"


def test_matches_that_pycolmap_reads(block, written):
    points = {}
    for number, image in enumerate(block.image, 1):
        points[number] = block.of_image(image).point.to_numpy()

    with opened_database(written("colmap-database")) as database:
        for pair in combinations(points, 2):
            first, second = (points[number] for number in pair)
            matches = database.read_matches(*pair)
            tied = first[matches[:, 0]]
            assert_array_equal(second[matches[:, 1]], tied)
            assert sorted(tied) == sorted(set(first) & set(second))
            if len(matches):
                verified = database.read_two_view_geometry(*pair)
                assert_array_equal(verified.inlier_matches, matches)
                assert verified.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED


def test_pose_priors_are_the_stations_with_their_sigmas(block, written):
    written_database = written("colmap-database")
    frame = frame_of(written_database)

    with opened_database(written_database) as database:
        priors = database.read_all_pose_priors()
        images = database.read_all_images()

    for prior, image in zip(priors, images, strict=True):
        assert prior.corr_data_id == image.data_id
        assert prior.coordinate_system == pycolmap.PosePriorCoordinateSystem.CARTESIAN
    positions = [prior.position for prior in priors]
    assert_within(positions, frame(block.centre), 1e-6)
    sigmas = [
        SIGMA_HORIZONTAL,
        SIGMA_HORIZONTAL,
        SIGMA_HEIGHT,
    ]
    variances = np.diag(np.square(sigmas))
    axes = block.axes(frame)
    expected = axes.transpose(0, 2, 1) @ variances @ axes
    covariances = [prior.position_covariance for prior in priors]
    assert_within(covariances, expected, 1e-8)


def schema_of(file):
    """Statements that make the tables, without white space, and the version."""
    query = "SELECT sql FROM sqlite_master WHERE sql NOT NULL AND name != 'unbend'"
    statements = []
    with closing(sqlite3.connect(file)) as database:
        for (sql,) in database.execute(query):
            words = sql.split()
            statements.append("".join(words))
        version = database.execute("PRAGMA user_version").fetchone()
    return [*sorted(statements), *version]


def test_the_schema_is_that_of_colmap(written, tmp_path):
    empty = tmp_path / "empty.db"
    pycolmap.Database.open(empty).close()

    assert schema_of(written("colmap-database").path) == schema_of(empty)


def keypoints_of(rows):
    """Points as a database of keypoints gives them, each with a name of its own."""
    numbers = np.arange(len(rows)).astype(str)
    return rows.assign(point=rows.image + ":" + numbers)


@pytest.mark.parametrize(
    "missing",
    ["images", "matches", "two_view_geometries"],
)
def test_a_database_without_a_table_of_matches_is_refused(block, tmp_path, missing):
    source = tmp_path / "source.db"
    pycolmap.Database.open(source).close()
    with closing(sqlite3.connect(source)) as database, database:
        database.execute(f"DROP TABLE {missing}")
    run = block.run(keypoints_of(block.rows), database=lambda: source)

    with refused("IMPORT-FORMAT") as refusal:
        write_export(run, "colmap-database")
    assert refusal.value.where == str(source)
    assert f"no such table: {missing}" in refusal.value.what


def test_without_ties_a_database_says_so(block):
    run = block.run(keypoints_of(block.rows))
    exported = write_export(run, "colmap-database")
    assert exported.message("EXPORT-NO-TIES").kind == "loss"


def test_priors_without_a_sigma_have_no_covariance(block):
    run = block.with_stations(sigma_height_m=NAN_OF_IMAGES)

    exported = write_export(run, "colmap-database")

    assert ("fallback", "EXPORT-NO-SIGMA", IMAGES) in exported.counts
    with opened_database(exported) as database:
        prior = database.read_all_pose_priors()[0]
    assert prior.has_position()
    assert not prior.has_position_cov()


def test_keypoints_far_from_the_corner_are_rounded(block, written):
    far = block.rows.assign(x_px=block.rows.x_px + 50000.0)
    camera = replace(SIDE, width_px=60000, cx_px=55000.0)
    run = block.with_side_camera(camera, far)

    exported = write_export(run, "colmap-database")

    assert exported.message("EXPORT-ROUNDED").kind == "warning"
    ledger = written("colmap-database").ledger
    assert not with_code(ledger, "EXPORT-ROUNDED")


# ---------------------------------------------------------------- Bundler


def test_bundler_is_undistorted_and_centred(block, written):
    """By its definition: P = R X + t, p = -P / P_z, x = f p, the centre (0, 0), y up."""
    bundler = written("bundler")
    frame = frame_of(bundler)
    rows_of_image = [block.of_image(image) for image in block.image]

    text = (bundler.path / "bundle.out").read_text()
    head, counts, *lines = text.splitlines()
    lines_of_cameras = lines[: 5 * IMAGES]
    cameras = np.loadtxt(lines_of_cameras).reshape(IMAGES, 5, 3)
    points = lines[5 * IMAGES :]

    assert head == "# Bundle file v0.3"
    assert counts == f"{IMAGES} {len(block.tied)}"
    images = bundler.path / "list.txt"
    assert images.read_text().split() == block.image.tolist()
    focal_px = np.tile([20000.0, 15000.0], 6)
    assert_array_equal(cameras[:, 0, 0], focal_px)
    assert_array_equal(cameras[:, 0, 1:], 0.0)
    turns = cameras[:, 1:4]
    assert_within(turns, DOWN @ block.turn @ block.axes(frame), 1e-9)
    moved = -np.einsum("nij,nj->ni", turns, frame(block.centre))
    assert_within(cameras[:, 4], moved, 1e-6)
    names = []
    for track in points[2::3]:
        words = track.split()[1:]
        for image, key, x_px, y_px in np.reshape(words, (-1, 4)):
            number = int(image)
            row = rows_of_image[number].iloc[int(key)]
            assert_within(float(x_px), focal_px[number] * row.u, 1e-6)
            assert_within(float(y_px), -focal_px[number] * row.v, 1e-6)
            names.append(row.point)
        views = len(words) // 4
        assert set(names[-views:]) == {row.point}
    tied = block.rows.point.isin(block.tied)
    assert sorted(names) == sorted(block.rows.point[tied])
    places = block.places(dict.fromkeys(names))
    assert_within(np.loadtxt(points[::3]), frame(places), 1e-3)
    assert bundler.count == tied.sum()
    assert bundler.message("EXPORT-SINGLE").count == (~tied).sum()
    points = bundler.message("EXPORT-POINTS")
    assert points.count == tied.sum()
    assert f"of {len(block.tied):,} points in 12 images" in points.what


@pytest.mark.parametrize("name", ["bundler", "colmap"])
def test_a_block_whose_points_are_mostly_of_one_image_is_a_warning(block, name):
    """As a table whose points are row numbers: nothing ties the images."""
    image_points = block.rows.groupby("point", sort=False)
    several = block.rows[image_points.image.transform("size") > 1]
    tied = several[several.point == several.point.iloc[0]]
    others = block.rows.drop(tied.index)
    row_numbers = [f"row {number}" for number in range(len(others))]
    single_rows = others.assign(point=row_numbers)
    rows = pd.concat([tied, single_rows], ignore_index=True)

    exported = write_export(block.run(rows), name)

    single = exported.message("EXPORT-SINGLE")
    assert single.kind == "warning"
    assert single.count == len(others)
    percent = 100.0 * len(others) / len(rows)
    assert f"{percent:.0f} % of the {len(rows)} image points" in single.what
    assert "observations.columns.point" in single.what


def test_bundler_has_the_calibrations_beside(block, written):
    calibrations = read_json(written("bundler").path / "calibration.json")

    assert calibrations["side"]["images"] == block.image[1::2].tolist()
    nadir = calibrations["nadir"]
    assert nadir["taken_with"]["distortion"]["k1"] == -0.018
    assert nadir["taken_with"]["cx_px"] == NADIR.cx_px
    assert nadir["taken_with"]["fx_px"] == NADIR.fx_px
    assert nadir["written"] == {
        "f_px": 20000.0,
        "k1": 0.0,
        "k2": 0.0,
        "cx_px": 0.0,
        "cy_px": 0.0,
    }


# ---------------------------------------------------------------- OpenSfM


def test_opensfm_keeps_nine_digits_and_the_stations(block, written):
    opensfm = written("opensfm")
    frame = frame_of(opensfm)

    text = (opensfm.path / "tracks.csv").read_text()
    head, *tracks = text.splitlines()
    reference = read_json(opensfm.path / "reference_lla.json")
    cameras = read_json(opensfm.path / "camera_models.json")
    (model,) = read_json(opensfm.path / "reconstruction.json")

    assert head == "OPENSFM_TRACKS_VERSION_v2"
    assert len(tracks) == len(block.rows)
    for track in tracks:
        place = "\t".join(track.split("\t")[3:5])
        assert re.fullmatch(r"-?0\.\d{9}\t-?0\.\d{9}", place)
    origin = [
        reference["latitude"],
        reference["longitude"],
        reference["altitude"],
    ]
    assert origin == pytest.approx(frame.origin, abs=1e-7)
    assert model["reference_lla"] == reference
    assert model["cameras"] == cameras
    shots = pd.DataFrame.from_dict(model["shots"], orient="index")
    assert_array_equal(shots.index, block.image)
    assert_array_equal(shots.camera, block.camera)
    assert_within(shots.gps_position.tolist(), frame(block.centre), 1e-6)
    assert_allclose(shots.gps_dop, SIGMA_HORIZONTAL, rtol=1e-5)


# ---------------------------------------------------------------- BINGO


def read_bingo(path):
    rows = []
    image = camera = None
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 2:
            image, camera = words
        elif len(words) == 3:
            rows.append([image, camera, *words])
        else:
            assert line == "-99"
    table = pd.DataFrame(
        rows,
        columns=["image", "camera", "point", "x", "y"],
    )
    return table.astype({"x": float, "y": float})


def test_bingo_counts_millimetres_from_the_centre(block):
    expected = block.ordered

    exported = write_export(
        block.run(),
        "bingo",
        pixel_um=4.0,
    )
    table = read_bingo(exported.path / "image.dat")
    changed = read_table(exported.path / "names.csv")

    assert set(changed.kind) == {"image"}
    assert set(table.camera) == {"nadir", "side"}
    assert set(changed.name) == set(block.image)
    assert table.image.str.len().max() <= 15
    names = dict(zip(changed.written, changed.name, strict=True))
    assert_array_equal(table.image.replace(names), expected.image)
    assert_array_equal(table.point, expected.point)
    is_nadir = table.camera == "nadir"
    width_px = np.where(is_nadir, 14000, 9000)
    height_px = np.where(is_nadir, 10600, 12000)
    x_px = expected.x_px - 0.5 * width_px
    y_px = 0.5 * height_px - expected.y_px
    assert_within(table.x, x_px * 0.004, 6e-8)
    assert_within(table.y, y_px * 0.004, 6e-8)
    assert frame_of(exported)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_quarter_turns_of_bingo_turn_counter_clockwise(block, turns):
    """The axes turn, by hand: what was to the right is below after one."""
    tables = []
    for quarter_turns in (0, turns):
        options = {"pixel_um": 4.0, "quarter_turns": quarter_turns}
        exported = write_export(block.run(), "bingo", **options)
        tables.append(read_bingo(exported.path / "image.dat"))

    upright, turned = tables
    x = upright.x
    y = upright.y
    expected = {
        1: (y, -x),
        2: (-x, -y),
        3: (-y, x),
    }
    assert_array_equal((turned.x, turned.y), expected[turns])


def test_the_size_of_pixels_must_be_known(block):
    cameras = {
        "nadir": ExportCamera(NADIR, False, pixel_mm=0.005),
        "side": ExportCamera(SIDE, False),
    }
    with refused_with("EXPORT-OPTION", "camera side"):
        write_export(block.run(cameras=cameras), "bingo")


def test_the_size_of_pixels_is_that_of_the_camera(block):
    cameras = {
        "nadir": ExportCamera(NADIR, False, pixel_mm=0.005),
        "side": ExportCamera(SIDE, False, pixel_mm=0.006),
    }
    image_of_side = block.image[1]

    exported = write_export(block.run(cameras=cameras), "bingo")

    table = read_bingo(exported.path / "image.dat")
    x = table.x[table.image == image_of_side[-15:]]
    x_px = block.of_image(image_of_side).x_px - 4500.0
    assert_within(x, x_px * 0.006, 6e-8)


# ---------------------------------------------------------------- names


def test_names_that_become_the_same_in_bingo_are_refused():
    first = "a/strip/DSC_00012345.tif"
    second = "b/strip/DSC_00012345.tif"
    with refused_with("EXPORT-NAMES", f"'{first}' and '{second}'"):
        short_names([first, second], "image")

    names = short_names(["strip 7", "strip\t8"], "image")
    assert names == ["strip_7", "strip_8"]


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("bundler", "a b.tif"),
        ("opensfm", "a\tb.tif"),
        ("pix4d", "a b.tif"),
        ("pix4d", "0.jpg"),
    ],
)
def test_names_that_files_cannot_tell_apart_are_refused(block, name, image):
    """By blanks in columns, or Pix4D's by two images that differ in their ending."""
    names = [f"{number}.tif" for number in range(IMAGES)]
    names[2] = image
    with refused("EXPORT-NAMES"):
        write_export(block.renamed(names), name)


def test_endings_of_files_and_folders():
    assert find_format("colmap", Path("model")).name == "colmap"
    assert find_format("colmap", Path("model.v2")).ending == ""
    with refused_with("EXPORT-ENDING", "a folder"):
        find_format("bundler", Path("out.csv"))
    with refused_with("EXPORT-ENDING", r"a file that ends in \.db"):
        find_format("colmap-database", Path("model"))


# ---------------------------------------------------------------- what is left out, and refused


@pytest.mark.parametrize("name", ["colmap", "bundler"])
def test_what_is_not_ok_is_left_out_and_counted(block, name):
    rows = block.rows.assign(status="ok")
    rows.loc[:6, "status"] = "beyond_grazing"
    rows.loc[7:8, "point"] = None
    repeated = rows.iloc[[20]].assign(x_px=1.0, y_px=2.0)
    rows = pd.concat([rows, repeated], ignore_index=True)
    status = np.full(IMAGES, "ok", object)
    status[4] = "in_gap"
    run = block.with_stations(rows, status=status)

    exported = write_export(run, name)

    in_gap = rows.image[9:] == block.image[4]
    left_out = 7 + 2 + 1 + in_gap.sum()
    losses = [message for message in exported.ledger if message.kind == "loss"]
    of_stations, of_rows = losses
    without = "without a usable position, attitude and ellipsoidal height"
    assert f"left out: 1 station {without}" in of_stations.what
    assert of_stations.count == 1
    assert f"{left_out} of {len(rows)} observations" in of_rows.what
    assert of_rows.count == left_out
    counts = [message.count for message in exported.ledger if "not written" in message.what]
    unwritten = sum(counts)
    assert exported.count == len(rows) - left_out - unwritten
    assert (unwritten > 0) == (name == "bundler")
    if name == "colmap":
        for image in pycolmap.Reconstruction(exported.path).images.values():
            pixels = [tuple(point.xy) for point in image.points2D]
            assert (1.0, 2.0) not in pixels, "the second measurement of a point"


def test_points_that_cannot_be_undistorted_are_a_loss(block):
    """The distortion turns back within the image; what is beyond has no ideal coordinates."""
    turning = replace(NADIR, distortion=BrownConrady(k1=-4.0))
    camera = ExportCamera(turning, False)
    run = block.run(cameras=dict.fromkeys(block.cameras, camera))

    exported = write_export(run, "bundler")

    beyond = exported.message("EXPORT-LEFT-OUT").count
    singles = exported.message("EXPORT-SINGLE").count
    assert exported.count == len(block.rows) - singles - beyond
    assert 0 < beyond < len(block.rows)


def test_a_run_without_places_and_a_camera_without_calibration(block):
    without_heights = block.with_stations(h_ellipsoid_m=NAN_OF_IMAGES)
    with refused("EXPORT-NO-STATIONS"):
        write_export(without_heights, "bingo")

    nadir = ExportCamera(NADIR, False)
    only_nadir = block.run(cameras={"nadir": nadir})
    with refused_with("EXPORT-CAMERA", "'side'"):
        write_export(only_nadir, "bingo")


def test_points_whose_rays_do_not_meet_lie_on_the_ground(block):
    """Two images of one place: the point is where its ray reaches the height that was taken."""
    rows = block.of_image(block.image[0])
    twin = rows.assign(image="twin")
    run = block.run(pd.concat([rows, twin]))
    stations = run.stations.rows(np.array([0, 0]))
    stations.image[1] = "twin"

    exported = write_export(replace(run, stations=stations), "colmap")

    assert ("fallback", "EXPORT-POINT-HEIGHT", len(rows)) in exported.counts
    points = pycolmap.Reconstruction(exported.path).points3D
    names = names_of_points(exported.path, points)
    truth = frame_of(exported)(block.places(names))
    places = [point.xyz for point in points.values()]
    # A sphere for the ellipsoid, over 3 km.
    assert_within(places, truth, 0.02)


# ---------------------------------------------------------------- the command


@pytest.mark.parametrize("name", BLOCKS)
def test_from_the_command_line_with_its_mark(unbend, baseline, tmp_path, name):
    """What is read by the imports of blocks is refused by them, under another name too."""
    form = FORMATS[name]
    out = tmp_path / f"out{form.ending}"
    words = [
        "export",
        baseline.output,
        "--format",
        name,
        "--out",
        out,
    ]
    if name == "bingo":
        words += ["--pixel-um", 5]
    rows = baseline.result_rows()

    ended = unbend(*words)

    text = one_line(ended.text)
    expected_code = 3 if "EXPORT-LEFT-OUT" in text else 0
    assert ended.code == expected_code, text
    assert "neither earth curvature nor a map projection is applied" in text
    assert form.use in text
    assert f"{len(rows)} observations of {rows['point'].nunique()} points in " in text
    assert ("camera 1 nadir, 2 oblique" in text) == name.startswith("colmap")
    marked = [out / file for file in form.marked]
    sidecar = read_json(marked[0].with_name(f"{marked[0].name}.unbend.json"))
    names = [item["name"] for item in sidecar["files"]]
    assert names == [file.name for file in marked]
    assert form.use in sidecar["notes"]
    assert any("neither earth curvature" in note for note in sidecar["notes"])
    assert not list(tmp_path.glob(".*")), "a draft"

    again = unbend(*words, "--force")

    assert ("EXPORT-EXISTS" in again.err) == (form.ending == "")
    for file in marked:
        with refused("OBS-ALREADY-CORRECTED"):
            refuse_marked(file)
    if name in READ_AGAIN:
        measured = out.rename(tmp_path / f"measured{form.ending}")
        program, *_ = name.split("-")
        with refused("OBS-ALREADY-CORRECTED"):
            open_observations(measured, COLUMNS, None, Ledger(), file_format=program)
