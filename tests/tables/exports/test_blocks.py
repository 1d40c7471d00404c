"""Blocks for bundle adjustment, written from a block that is projected here, read by others.

Truth: that of `projected_block`, pycolmap for COLMAP's files.
"""

from __future__ import annotations

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
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.checks import assert_within, refused_with
from tests.tables.exports.export_runs import DOWN, Written, read_table, write_export
from tests.tables.exports.projected_block import (
    IMAGES,
    NADIR,
    SIDE,
    SIGMA_HEIGHT,
    SIGMA_HORIZONTAL,
    frame_of,
    point_names,
)
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import FORMATS, find_format
from unbend.tables.exports.bingo import short_names
from unbend.tables.refraction_mark import refuse_marked

BLOCKS = ["colmap", "colmap-database", "bundler", "opensfm", "bingo"]
PIXELS = ["x_px", "y_px"]


# ---------------------------------------------------------------- COLMAP


def test_a_model_that_pycolmap_reads_loses_nothing(block, tmp_path):
    written = write_export(block.run(), "colmap", tmp_path)
    model = pycolmap.Reconstruction(written.path)
    frame = frame_of(written)
    names = point_names(written.path)
    images = [model.images[number] for number in range(1, IMAGES + 1)]
    assert [image.name for image in images] == block.image.tolist()
    assert [model.cameras[k].model.name for k in (1, 2)] == ["FULL_OPENCV", "PINHOLE"]
    centres = [image.projection_center() for image in images]
    assert_within(centres, frame(block.centre), 1e-6)
    turns = [image.cam_from_world().rotation.matrix() for image in images]
    assert_within(turns, block.turn @ block.axes(frame), 1e-9)
    for image in images:
        rows = block.of_image(image.name)
        pixels = np.array([point.xy for point in image.points2D])
        # Half a pixel there and back: 1 ulp of 14,000 px.
        assert_within(pixels, rows[PIXELS], 2e-12)
        for point, name in zip(image.points2D, rows.point, strict=True):
            assert point.has_point3D() == (name in block.tied)
            if point.has_point3D():
                number = point.point3D_id
                assert names.get(number, str(number)) == name
    ids = list(model.points3D)
    tied = [names.get(number, str(number)) for number in ids]
    assert set(tied) == block.tied
    positions = [model.points3D[number].xyz for number in ids]
    assert_within(positions, frame(block.places(tied)), 1e-3)
    for number in ids:
        for view in model.points3D[number].track.elements:
            keypoint = model.images[view.image_id].points2D[view.point2D_idx]
            assert keypoint.point3D_id == number


def test_a_model_says_what_it_holds(block, tmp_path):
    written = write_export(block.run(), "colmap", tmp_path)
    names = point_names(written.path)
    points = set(block.rows.point)
    assert set(names.values()) == {name for name in points if not name.isdigit()}
    assert written.message("EXPORT-CAMERAS").what == "camera 1 nadir, 2 side"
    assert written.message("EXPORT-POINTS").count == len(block.rows)
    assert f"of {len(points):,} points in 12 images" in written.message("EXPORT-POINTS").what
    assert written.message("EXPORT-SINGLE").count == len(points - block.tied)


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        (BrownConrady(), "PINHOLE"),
        (BrownConrady(k1=-0.02, p2=1e-4), "OPENCV"),
        (GeneralFrame(k1=0.02, q2=0.01, px=1e-4, py=-2e-4), "FULL_OPENCV"),
        (OpenCVFisheye(0.01, -0.002, 0.0003, 1e-5), "OPENCV_FISHEYE"),
    ],
)
def test_colmap_projects_as_the_camera_does(block, tmp_path, distortion, model):
    camera = replace(SIDE, distortion=distortion)
    written = write_export(block.with_side_camera(camera), "colmap", tmp_path)
    read = pycolmap.Reconstruction(written.path).cameras[2]
    assert read.model.name == model
    u, v = np.random.default_rng(2).uniform(-0.3, 0.3, (2, 50))
    rays = np.stack([u, v, np.ones(50)], axis=1)
    expected = np.stack(camera.project(u, v), axis=1)
    assert_within(read.img_from_cam(rays), expected, 1e-8)


FISHEYE = OpenCVFisheye(0.01, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("colmap", {"distortion": GeneralFrame(k4=0.1)}, "k4"),
        ("colmap", {"distortion": GeneralFrame(k1=0.1, sense=-1.0)}, "sense"),
        ("colmap-database", {"distortion": GeneralFrame(skew_x=1e-4)}, "skew_x"),
        ("opensfm", {"distortion": GeneralFrame(k1=0.1, q1=0.01)}, "k4"),
        ("pix4d", {"distortion": FISHEYE}, "fisheye"),
        ("blocksexchange", {"distortion": FISHEYE}, "fisheye"),
        ("blocksexchange", {"fy_px": 14_990.0}, "different fx and fy"),
    ],
)
def test_lenses_that_a_format_cannot_hold(square, tmp_path, name, change, words):
    run = square.with_side_camera(replace(SIDE, **change))
    with refused_with("EXPORT-DISTORTION", rf"camera side \(with {words}"):
        write_export(run, name, tmp_path)
    # Without distortion there is a way.
    assert write_export(run, "bundler", tmp_path).count > 100


@pytest.fixture(scope="module")
def written_database(block, tmp_path_factory) -> Written:
    return write_export(block.run(), "colmap-database", tmp_path_factory.mktemp("database"))


def test_rigs_keypoints_and_matches_that_pycolmap_reads(block, written_database):
    with closing(pycolmap.Database.open(written_database.path)) as database:
        assert [rig.ref_sensor_id.id for rig in database.read_all_rigs()] == [1, 2]
        frames = database.read_all_frames()
        assert [frame.rig_id for frame in frames] == [1, 2] * 6
        names = {image.image_id: image.name for image in database.read_all_images()}
        assert names == dict(enumerate(block.image, 1))
        rows = {number: block.of_image(name) for number, name in names.items()}
        lost = []
        for number, rows_of_image in rows.items():
            keypoints = database.read_keypoints(number)[:, :2]
            lost.append(np.abs(keypoints - rows_of_image[PIXELS]).to_numpy().max())
        assert 0.0 < max(lost) <= 0.0005, "float32"
        for pair in combinations(names, 2):
            first, second = (rows[number].point.to_numpy() for number in pair)
            matches = database.read_matches(*pair)
            matched = first[matches[:, 0]]
            assert_array_equal(second[matches[:, 1]], matched)
            assert sorted(matched) == sorted(set(first) & set(second))
            if len(matches):
                verified = database.read_two_view_geometry(*pair)
                assert_array_equal(verified.inlier_matches, matches)
                assert verified.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED


def test_pose_priors_are_the_stations_with_their_sigmas(block, written_database):
    frame = frame_of(written_database)
    with closing(pycolmap.Database.open(written_database.path)) as database:
        priors = database.read_all_pose_priors()
        images = database.read_all_images()
    assert [prior.corr_data_id for prior in priors] == [image.data_id for image in images]
    for prior in priors:
        assert prior.coordinate_system == pycolmap.PosePriorCoordinateSystem.CARTESIAN
    assert_within([p.position for p in priors], frame(block.centre), 1e-6)
    variances = np.diag([SIGMA_HORIZONTAL**2, SIGMA_HORIZONTAL**2, SIGMA_HEIGHT**2])
    axes = block.axes(frame)
    expected = axes.transpose(0, 2, 1) @ variances @ axes
    covariances = [prior.position_covariance for prior in priors]
    assert_within(covariances, expected, 1e-8)


def test_the_schema_is_that_of_colmap(written_database, tmp_path):
    empty = tmp_path / "empty.db"
    pycolmap.Database.open(empty).close()

    def schema(file: Path) -> list[str]:
        with closing(sqlite3.connect(file)) as database:
            tables = database.execute("SELECT name, sql FROM sqlite_master WHERE sql NOT NULL")
            texts = sorted(re.sub(r"\s+", "", sql) for name, sql in tables if name != "unbend")
            return [*texts, *database.execute("PRAGMA user_version").fetchone()]

    assert schema(written_database.path) == schema(empty)


def keypoints_of(rows: pd.DataFrame) -> pd.DataFrame:
    """Points as a database of keypoints gives them, each with a name of its own."""
    numbers = np.arange(len(rows)).astype(str)
    return rows.assign(point=rows.image + ":" + numbers)


@pytest.mark.parametrize("missing", ["images", "matches", "two_view_geometries"])
def test_a_database_without_a_table_of_matches_is_refused(block, tmp_path, missing):
    source = tmp_path / "source.db"
    pycolmap.Database.open(source).close()
    with closing(sqlite3.connect(source)) as database, database:
        database.execute(f"DROP TABLE {missing}")
    run = block.run(keypoints_of(block.rows), database=lambda: source)
    with refused("IMPORT-FORMAT") as refusal:
        write_export(run, "colmap-database", tmp_path)
    assert refusal.value.where == str(source)
    assert f"no such table: {missing}" in refusal.value.what


def test_without_ties_a_database_says_so(block, tmp_path):
    written = write_export(block.run(keypoints_of(block.rows)), "colmap-database", tmp_path)
    assert written.message("EXPORT-NO-TIES").kind == "loss"


def test_priors_without_a_sigma_have_no_covariance(block, tmp_path):
    run = block.run()
    stations = replace(run.stations, sigma_height_m=np.full(IMAGES, np.nan))
    written = write_export(replace(run, stations=stations), "colmap-database", tmp_path)
    assert ("fallback", "EXPORT-NO-SIGMA", IMAGES) in written.counts
    with closing(pycolmap.Database.open(written.path)) as database:
        prior = database.read_all_pose_priors()[0]
    assert prior.has_position()
    assert not prior.has_position_cov()


def test_keypoints_far_from_the_corner_are_rounded(block, written_database, tmp_path):
    far = block.rows.assign(x_px=block.rows.x_px + 50000.0)
    camera = replace(SIDE, width_px=60000, cx_px=55000.0)
    run = replace(block.with_side_camera(camera), parts=block.run(far).parts)
    written = write_export(run, "colmap-database", tmp_path)
    assert written.message("EXPORT-ROUNDED").kind == "warning"
    assert "EXPORT-ROUNDED" not in [code for _, code, _ in written_database.counts]


# ---------------------------------------------------------------- Bundler


def test_bundler_is_undistorted_and_centred(block, tmp_path):
    """By its definition: P = R X + t, p = -P / P_z, x = f p, the centre (0, 0), y up."""
    written = write_export(block.run(), "bundler", tmp_path)
    frame = frame_of(written)
    head, counts, *lines = (written.path / "bundle.out").read_text().splitlines()
    assert head == "# Bundle file v0.3"
    assert counts == f"{IMAGES} {len(block.tied)}"
    assert (written.path / "list.txt").read_text().split() == block.image.tolist()
    end = 5 * IMAGES
    cameras = np.loadtxt(lines[:end]).reshape(IMAGES, 5, 3)
    assert_array_equal(cameras[:, 0], [[20000.0, 0, 0], [15000.0, 0, 0]] * 6)
    turns = cameras[:, 1:4]
    assert_within(turns, DOWN @ block.turn @ block.axes(frame), 1e-9)
    moved = -np.einsum("nij,nj->ni", turns, frame(block.centre))
    assert_within(cameras[:, 4], moved, 1e-6)
    rows = block.ordered
    first_row = np.searchsorted(pd.Categorical(rows.image, block.image).codes, range(IMAGES))
    points = []
    for track in lines[end + 2 :: 3]:
        image, key, x, y = np.reshape(track.split()[1:], (-1, 4)).astype(float).T
        image = image.astype(int)
        seen = rows.iloc[first_row[image] + key.astype(int)]
        focal = cameras[image, 0, 0]
        assert_within(x, focal * seen.u, 1e-6)
        assert_within(y, -focal * seen.v, 1e-6)
        (point,) = set(seen.point)
        assert len(seen) == (rows.point == point).sum()
        points.append(point)
    assert set(points) == block.tied
    places = np.loadtxt(lines[end::3])
    assert_within(places, frame(block.places(points)), 1e-3)
    singles = len(set(rows.point) - block.tied)
    assert written.count == len(rows) - singles
    assert written.message("EXPORT-SINGLE").count == singles


def test_bundler_has_the_calibrations_beside(block, tmp_path):
    written = write_export(block.run(), "bundler", tmp_path)
    calibrations = json.loads((written.path / "calibration.json").read_text())
    assert calibrations["side"]["images"] == block.image[1::2].tolist()
    nadir = calibrations["nadir"]
    assert nadir["taken_with"]["distortion"]["k1"] == -0.018
    assert nadir["taken_with"]["cx_px"] == NADIR.cx_px
    ideal = {"f_px": 20000.0, "k1": 0.0, "k2": 0.0, "cx_px": 0.0, "cy_px": 0.0}
    assert nadir["written"] == ideal


# ---------------------------------------------------------------- OpenSfM


def test_opensfm_keeps_nine_digits_and_the_stations(block, tmp_path):
    written = write_export(block.run(), "opensfm", tmp_path)
    head, *tracks = (written.path / "tracks.csv").read_text().splitlines()
    assert head == "OPENSFM_TRACKS_VERSION_v2"
    places = "\n".join("\t".join(track.split("\t")[3:5]) for track in tracks)
    assert re.fullmatch(r"(-?0\.\d{9}[\t\n]?)+", places)
    frame = frame_of(written)
    reference = json.loads((written.path / "reference_lla.json").read_text())
    origin = [reference[key] for key in ("latitude", "longitude", "altitude")]
    assert origin == pytest.approx(frame.origin, abs=1e-7)
    (model,) = json.loads((written.path / "reconstruction.json").read_text())
    assert model["reference_lla"] == reference
    assert model["cameras"] == json.loads((written.path / "camera_models.json").read_text())
    assert list(model["shots"]) == block.image.tolist()
    shots = pd.DataFrame(model["shots"].values())
    assert shots.camera.tolist() == block.camera.tolist()
    centres = np.array(shots.gps_position.tolist())
    assert_within(centres, frame(block.centre), 1e-6)
    assert shots.gps_dop.tolist() == pytest.approx([SIGMA_HORIZONTAL] * IMAGES, rel=1e-5)


# ---------------------------------------------------------------- BINGO


def read_bingo(path: Path) -> pd.DataFrame:
    rows = []
    image = camera = None
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 2:
            image, camera = words
        elif len(words) == 3:
            point, x, y = words
            rows.append([image, camera, point, float(x), float(y)])
        else:
            assert line == "-99"
    return pd.DataFrame(rows, columns=["image", "camera", "point", "x", "y"])


def test_bingo_counts_millimetres_from_the_centre(block, tmp_path):
    written = write_export(block.run(), "bingo", tmp_path, pixel_um=4.0)
    table = read_bingo(written.path / "image.dat")
    changed = read_table(written.path / "names.csv")
    names = dict(zip(changed.written, changed.name, strict=True))
    assert set(changed.kind) == {"image"}
    assert set(names.values()) == set(block.image)
    assert table.image.str.len().max() <= 15
    expected = block.ordered
    assert table.image.replace(names).tolist() == expected.image.tolist()
    assert table.point.tolist() == expected.point.tolist()
    width = table.camera.map({"nadir": 14000, "side": 9000}).to_numpy()
    height = table.camera.map({"nadir": 10600, "side": 12000}).to_numpy()
    x = (expected.x_px - 0.5 * width) * 0.004
    y = (0.5 * height - expected.y_px) * 0.004
    assert_within(table.x, x, 6e-8)
    assert_within(table.y, y, 6e-8)
    assert frame_of(written)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_quarter_turns_of_bingo_turn_counter_clockwise(block, tmp_path, turns):
    """The axes turn, by hand: what was to the right is below after one."""
    tables = []
    for quarter_turns in (0, turns):
        written = write_export(
            block.run(), "bingo", tmp_path, pixel_um=4.0, quarter_turns=quarter_turns
        )
        tables.append(read_bingo(written.path / "image.dat"))
    upright, turned = tables
    x = upright.x
    y = upright.y
    expected = {1: (y, -x), 2: (-x, -y), 3: (-y, x)}[turns]
    assert_array_equal([turned.x, turned.y], expected)


def test_the_size_of_pixels_must_be_known(block, tmp_path):
    run = block.run()
    half = run.cameras | {"nadir": replace(run.cameras["nadir"], pixel_mm=0.005)}
    with refused_with("EXPORT-OPTION", "camera side"):
        write_export(replace(run, cameras=half), "bingo", tmp_path)


def test_the_size_of_pixels_is_that_of_the_camera(block, tmp_path):
    run = block.run()
    sizes = {"nadir": 0.005, "side": 0.006}
    cameras = {name: replace(run.cameras[name], pixel_mm=size) for name, size in sizes.items()}
    written = write_export(replace(run, cameras=cameras), "bingo", tmp_path)
    table = read_bingo(written.path / "image.dat")
    rows = block.of_image(block.image[1])
    x = table[table.image == block.image[1][-15:]].x
    assert_within(x, (rows.x_px - 4500.0) * 0.006, 6e-8)


# ---------------------------------------------------------------- names


def test_names_that_become_the_same_in_bingo_are_refused():
    with refused_with("EXPORT-NAMES", "'a/strip/DSC_00012345.tif' and 'b/strip/DSC_00012345.tif'"):
        short_names(["a/strip/DSC_00012345.tif", "b/strip/DSC_00012345.tif"], "image")
    assert short_names(["strip 7", "strip\t8"], "image") == ["strip_7", "strip_8"]


@pytest.mark.parametrize(
    ("name", "image"),
    [("bundler", "a b.tif"), ("opensfm", "a\tb.tif"), ("pix4d", "a b.tif"), ("pix4d", "0.jpg")],
)
def test_names_that_files_cannot_tell_apart_are_refused(block, tmp_path, name, image):
    """By blanks in columns, or Pix4D's by two images that differ in their ending."""
    names = [f"{number}.tif" for number in range(IMAGES)]
    names[2] = image
    with refused("EXPORT-NAMES"):
        write_export(block.renamed(names), name, tmp_path)


def test_endings_of_files_and_folders(tmp_path):
    assert find_format("colmap", Path("model")).name == "colmap"
    assert find_format("colmap", Path("model.v2")).ending == ""
    with refused_with("EXPORT-ENDING", "a folder"):
        find_format("bundler", Path("out.csv"))
    with refused_with("EXPORT-ENDING", r"a file that ends in \.db"):
        find_format("colmap-database", Path("model"))


# ---------------------------------------------------------------- what is left out, and refused


@pytest.mark.parametrize("name", ["colmap", "bundler"])
def test_what_is_not_ok_is_left_out_and_counted(block, tmp_path, name):
    rows = block.rows.assign(status="ok")
    rows.loc[:6, "status"] = "beyond_grazing"
    rows.loc[7:8, "point"] = None
    repeated = rows.iloc[[20]].assign(x_px=1.0, y_px=2.0)
    rows = pd.concat([rows, repeated], ignore_index=True)
    run = block.run(rows)
    status = run.stations.status.copy()
    status[4] = "in_gap"
    run = replace(run, stations=replace(run.stations, status=status))
    written = write_export(run, name, tmp_path)
    left_out = 7 + 2 + 1 + int((rows.image[9:] == block.image[4]).sum())
    of_stations, of_rows = [m for m in written.ledger if m.kind == "loss"]
    without = "without a usable position, attitude and ellipsoidal height"
    assert f"left out: 1 station {without}" in of_stations.what
    assert of_stations.count == 1
    assert f"{left_out} of {len(rows)} observations" in of_rows.what
    assert of_rows.count == left_out
    unwritten = sum(m.count for m in written.ledger if "not written" in m.what)
    assert written.count == len(rows) - left_out - unwritten
    assert (unwritten > 0) == (name == "bundler")
    if name == "colmap":
        images = pycolmap.Reconstruction(written.path).images.values()
        pixels = [tuple(point.xy) for image in images for point in image.points2D]
        assert (1.0, 2.0) not in pixels, "the second measurement of a point"


def test_points_that_cannot_be_undistorted_are_a_loss(block, tmp_path):
    """The distortion turns back within the image; what is beyond has no ideal coordinates."""
    run = block.run()
    turning = replace(NADIR, distortion=BrownConrady(k1=-4.0))
    cameras = {name: replace(camera, camera=turning) for name, camera in run.cameras.items()}
    written = write_export(replace(run, cameras=cameras), "bundler", tmp_path)
    beyond = written.message("EXPORT-LEFT-OUT").count
    assert written.count == len(block.rows) - written.message("EXPORT-SINGLE").count - beyond
    assert 0 < beyond < len(block.rows)


def test_a_run_without_places_and_a_camera_without_calibration(block, tmp_path):
    run = block.run()
    stations = replace(run.stations, h_ellipsoid_m=np.full(IMAGES, np.nan))
    with refused("EXPORT-NO-STATIONS"):
        write_export(replace(run, stations=stations), "bingo", tmp_path)
    with refused_with("EXPORT-CAMERA", "'side'"):
        write_export(replace(run, cameras={"nadir": run.cameras["nadir"]}), "bingo", tmp_path)


def test_points_whose_rays_do_not_meet_lie_on_the_ground(block, tmp_path):
    """Two images of one place: the point is where its ray reaches the height that was taken."""
    rows = block.of_image(block.image[0])
    run = block.run(pd.concat([rows, rows.assign(image="twin")]))
    stations = run.stations.rows(np.array([0, 0]))
    stations = replace(stations, image=np.array([block.image[0], "twin"], object))
    written = write_export(replace(run, stations=stations), "colmap", tmp_path)
    assert ("fallback", "EXPORT-POINT-HEIGHT", len(rows)) in written.counts
    names = point_names(written.path)
    points = pycolmap.Reconstruction(written.path).points3D
    truth = frame_of(written)(block.places([names.get(k, str(k)) for k in points]))
    # A sphere for the ellipsoid, over 3 km.
    assert_within([point.xyz for point in points.values()], truth, 0.02)


# ---------------------------------------------------------------- the command


@pytest.mark.parametrize("name", BLOCKS)
def test_from_the_command_line_with_its_mark(unbend, baseline, tmp_path, name):
    form = FORMATS[name]
    out = tmp_path / f"out{form.ending}"
    words = ["export", baseline.output, "--format", name, "--out", out]
    words += ["--pixel-um", 5] if name == "bingo" else []
    ended = unbend(*words)
    text = " ".join(ended.text.split())
    assert ended.code == (3 if "EXPORT-LEFT-OUT" in text else 0), text
    assert "neither earth curvature nor a map projection is applied" in text
    assert form.use in text
    rows = baseline.results().to_pandas()
    assert f"{len(rows)} observations of {rows['point'].nunique()} points in " in text
    assert ("camera 1 nadir, 2 oblique" in text) == name.startswith("colmap")
    marked = [out / file for file in form.marked]
    sidecar = json.loads(marked[0].with_name(marked[0].name + ".unbend.json").read_text())
    assert [item["name"] for item in sidecar["files"]] == [file.name for file in marked]
    assert form.use in sidecar["notes"]
    assert any("neither earth curvature" in note for note in sidecar["notes"])
    assert not list(tmp_path.glob(".*")), "a draft"
    again = unbend(*words, "--force")
    assert ("EXPORT-EXISTS" in again.err) == (form.ending == "")
    for file in marked:
        with refused("OBS-ALREADY-CORRECTED"):
            refuse_marked(file)


@pytest.mark.parametrize("name", ["colmap", "colmap-database", "opensfm"])
def test_run_refuses_what_was_exported(unbend, baseline, mission, tmp_path, name):
    """By the imports of blocks, a folder under another name too."""
    out = tmp_path / f"out{FORMATS[name].ending}"
    unbend("export", baseline.output, "--format", name, "--out", out)
    if out.is_dir():
        out = out.rename(tmp_path / "measured")
    mission.config["observations"] = {"path": str(out), "format": name.partition("-")[0]}
    mission.refusal("OBS-ALREADY-CORRECTED")
    ended = unbend("check", mission.file)
    assert ended.code == 6
    assert "OBS-ALREADY-CORRECTED" in ended.err, ended.text
