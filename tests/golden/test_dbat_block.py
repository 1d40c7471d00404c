"""A block of five images: its known solution against pycolmap's, by our readers.

Everywhere one that is written here without error but for noise of its image points; and where
../shared is, a real one, Strasbourg, with the solution of DBAT.

The report of the Damped Bundle Adjustment Toolbox is the truth: point marking residuals of 1.101 px
and two check points. Its control has 2, 2 and 4 cm, which pycolmap cannot take: here it is held,
and moves the height of check point 351 by 4.4 cm.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.dbat_project import (
    CHECKS,
    FOCAL_MM,
    NOISE_PX,
    PIXEL_MM,
    PRINCIPAL_MM,
    SIZE_PX,
    write_project,
)
from tests.logs import SHARED
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction import Camera, Exposures
from unbend.refraction.ray import rays_by
from unbend.simulate.optics import enu_axes, height_and_up, to_ecef
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun
from unbend.tables.imports.blocks import block_reader, dbat
from unbend.tables.pixels import COLMAP

pytest.importorskip("pycolmap")

import pycolmap

from .bundle_adjustment import Adjustment

STRASBOURG_FOLDER = SHARED / "ba" / "dbat_sxb"
WIDTH_PX, HEIGHT_PX = SIZE_PX
PLACE = np.radians(48.58), np.radians(7.75)  # for formats that need a latitude and a longitude
ORIGIN = np.array([1_000_000.0, 112_400.0, 0.0])
GROUND_M = 140.0  # of all points, to 10 m or so
WITHIN_M = 0.05  # the control is held: this moves a check point by 4.4 cm
PIXELS = ["x_px", "y_px"]
Array = np.ndarray
Poses = dict[str, tuple[Array, Array]]


@dataclass(frozen=True)
class Solution:
    """Number of image points, their RMS residual within two bounds, and adjusted check points."""

    image_points: int
    least_rms_px: float
    most_rms_px: float
    checks: dict[str, Array]


STRASBOURG = Solution(
    image_points=1196,  # of DBAT's 2392 coordinates
    least_rms_px=1.08,
    most_rms_px=1.12,
    checks={  # report.txt, check measurements, posterior
        "351": np.array([1_000_551.437, 112_275.288, 139.401]),
        "410": np.array([999_974.528, 112_476.597, 139.856]),
    },
)


def known_solution(points: dict[str, Array], marks):
    """Of the block that is written here: the true check points, and what is left of the noise.

    Five cameras and all points but the control take their share of it; the rest is known to a
    percent or two, by some thousand coordinates.
    """
    tie_points = {point for point in marks["point"] if int(point) >= 1000}
    unknowns = 5 * 6 + 3 * len(tie_points | {*CHECKS})
    redundancy = 1.0 - unknowns / (2 * len(marks))
    rms_px = NOISE_PX * np.sqrt(2.0 * redundancy)
    checks = {name: points[name] for name in CHECKS}
    return Solution(len(marks), 0.92 * rms_px, 1.08 * rms_px, checks)


@dataclass(frozen=True)
class Block:
    """A folder with a project of DBAT, and its solution."""

    folder: Path
    solution: Solution


@pytest.fixture(
    scope="module",
    params=["written", "strasbourg"] if STRASBOURG_FOLDER.is_dir() else ["written"],
)
def block(request, tmp_path_factory):
    if request.param == "strasbourg":
        return Block(STRASBOURG_FOLDER, STRASBOURG)

    folder = tmp_path_factory.mktemp("dbat")
    written = write_project(folder)
    return Block(folder, known_solution(written.points, written.marks))


@dataclass(frozen=True)
class Project:
    """f, cx, cy [px], poses by image (rotation to the camera, centre), image points, control."""

    camera: tuple[float, float, float]
    poses: Poses
    rows: pd.DataFrame
    control: dict[str, Array]
    solution: Solution


def table(path):
    """The cells of the rows of a file; from # on a line is a comment."""
    rows = []
    for line in path.read_text("utf-8").splitlines():
        row = line.partition("#")[0]
        if row.strip():
            rows.append([cell.strip() for cell in row.split(",")])
    return rows


def poses_of_report(path):
    """Angles and places of the photos, from the part before the qualities."""
    report = path.read_text("utf-8").partition("\n   Quality")[0]
    poses = {}
    for photo in report.split(" Photo ")[1:]:
        name = photo.partition(": ")[2].split()[0]
        numbers = re.findall(r"(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", photo)
        omega_phi_kappa = np.array(numbers[:3], float)
        centre = np.array(numbers[3:], float)
        # M = Rx Ry Rz turns a camera with y up and z back to the world.
        matrix = Rotation.from_euler("XYZ", omega_phi_kappa, degrees=True).as_matrix()
        poses[name] = ((matrix * [1.0, -1.0, -1.0]).T, centre)
    return poses


@pytest.fixture(scope="module")
def raw(block):
    """The files as they are, by a parser of this test."""
    names = {}
    for number, path in table(block.folder / "images.txt"):
        names[number] = path.rpartition("/")[2]

    rows = []
    for file in ("markpts.txt", "smartpts.txt"):
        for point, image, x, y in table(block.folder / file):
            rows.append((names[image], point, float(x), float(y)))

    control = {}
    for point, _, *position, _, _, _ in table(block.folder / "sxb-control.txt"):
        control[point] = np.array(position, float)

    cx_mm, cy_mm = PRINCIPAL_MM
    return Project(
        camera=(FOCAL_MM / PIXEL_MM, cx_mm / PIXEL_MM, cy_mm / PIXEL_MM),
        poses=poses_of_report(block.folder / "report.txt"),
        rows=pd.DataFrame(rows, columns=["image", "point", *PIXELS]),
        control=control,
        solution=block.solution,
    )


@pytest.fixture(scope="module")
def read(block):
    """The same by the package."""
    script = block.folder / "sxb.xml"
    (make_camera,) = dbat.read_cameras(script).values()
    camera = make_camera()
    assert camera.fx_px == camera.fy_px
    images = dbat.read_images(script)
    names, positions = dbat.read_points(script)
    poses = poses_by_image(images.image, rotations_of(images.angles), images.position)
    return Project(
        camera=(camera.fx_px, camera.cx_px, camera.cy_px),
        poses=poses,
        rows=joined(dbat.read_rows(script)),
        control=dict(zip(names.to_pylist(), positions, strict=True)),
        solution=block.solution,
    )


def rotations_of(quaternions):
    return Rotation.from_quat(quaternions, scalar_first=True).as_matrix()


def poses_by_image(images, turns, centres):
    poses = zip(turns, centres, strict=True)
    return dict(zip(images, poses, strict=True))


def joined(batches):
    return pd.concat([batch.to_pandas() for batch in batches], ignore_index=True)


def adjust(project):
    """Point RMS [px], how many image points, and the adjusted check points.

    DBAT's sigmas are 0.5 px of marked points (their numbers are small) and 1 px of the others: a
    marked point is observed four times here.
    """
    adjustment = Adjustment()
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE",
        width=WIDTH_PX,
        height=HEIGHT_PX,
        params=project.camera,
        camera_id=1,
    )
    adjustment.add_camera(camera)
    on_ground = {}
    images = {}
    for name, rows in project.rows.groupby("image"):
        rotation, position = project.poses[name]
        centre = position - ORIGIN
        is_marked = rows["point"].astype(int) < 1000
        weighted = rows.loc[rows.index.repeat(np.where(is_marked, 4, 1))]
        pixels = weighted[PIXELS].to_numpy()
        image = adjustment.add_image(
            name,
            1,
            pixels,
            weighted["point"],
            rotation,
            centre,
        )
        images[name] = adjustment.model.images[image.image_id]

        tangents = camera.cam_from_img(pixels)
        rays = np.column_stack([tangents, np.ones(len(pixels))]) @ rotation
        distances = (GROUND_M - centre[2]) / rays[:, 2:]
        landed = centre + distances * rays
        on_ground |= dict(zip(weighted["point"], landed, strict=True))

    control = set(project.control) - set(CHECKS)
    assert len(control) == 14
    for point, track in adjustment.tracks.items():
        if point in control:
            adjustment.add_point(point, project.control[point] - ORIGIN, constant=True)
        elif len(track) > 1:
            adjustment.add_point(point, on_ground[point])
    adjustment.solve()

    residuals = []
    for row in project.rows.itertuples():
        if row.point in adjustment.numbers:
            projected = images[row.image].project_point(adjustment.position(row.point))
            assert projected is not None, "a point behind its camera"
            residuals.append(projected - [row.x_px, row.y_px])
    squares = np.square(residuals).sum(axis=1)
    rms_px = np.sqrt(squares.mean())
    checks = {point: adjustment.position(point) + ORIGIN for point in CHECKS}
    return rms_px, len(residuals), checks


def assert_is_dbats(project):
    rms_px, image_points, checks = adjust(project)

    solution = project.solution
    assert image_points == solution.image_points
    assert solution.least_rms_px < rms_px < solution.most_rms_px
    for point, position in solution.checks.items():
        assert np.abs(checks[point] - position).max() < WITHIN_M


def assert_same_image_points(rows, project, within_px):
    pairs = rows.merge(
        project.rows,
        on=["image", "point"],
        suffixes=("", "_before"),
    )
    assert len(pairs) == len(rows) == len(project.rows)
    before = pairs[["x_px_before", "y_px_before"]]
    np.testing.assert_allclose(pairs[PIXELS], before, rtol=0.0, atol=within_px)


def test_what_is_read_gives_dbats_solution(raw, read):
    assert read.camera == pytest.approx(raw.camera, abs=1e-9)
    assert list(read.poses) == list(raw.poses)
    for name, (rotation, centre) in raw.poses.items():
        read_rotation, read_centre = read.poses[name]
        np.testing.assert_allclose(read_rotation, rotation, atol=1e-12)
        np.testing.assert_allclose(read_centre, centre, atol=1e-6)
    assert_same_image_points(read.rows, raw, within_px=0.0)
    assert list(read.control) == list(raw.control)
    for point, position in raw.control.items():
        assert read.control[point].tolist() == position.tolist()
    assert_is_dbats(read)


def test_it_notices_other_axes(raw):
    """Rows counted from below."""
    mirrored = raw.rows.assign(y_px=HEIGHT_PX - raw.rows["y_px"])
    with pytest.raises(AssertionError):
        assert_is_dbats(replace(raw, rows=mirrored))


def exported(project, name, folder):
    """The block in a format of other programs, as if it stood at Strasbourg, free of refraction."""
    rotations, centres = zip(*project.poses.values(), strict=True)
    rotation = np.stack(rotations)
    centre = np.stack(centres)
    axes = enu_axes(*PLACE)
    ecef = to_ecef(*PLACE, np.array(0.0)) + (centre - ORIGIN) @ axes
    height_m, up = height_and_up(ecef)
    lat_rad = np.arcsin(up[:, 2])
    lon_rad = np.arctan2(up[:, 1], up[:, 0])
    camera_from_enu = rotation @ axes @ np.swapaxes(enu_axes(lat_rad, lon_rad), 1, 2)
    quaternions = Rotation.from_matrix(camera_from_enu).as_quat(
        canonical=True,
        scalar_first=True,
    )
    count = len(project.poses)
    images = np.array(list(project.poses), object)
    stations = replace(
        empty_stations(images, np.full(count, "aerial", object), "ok"),
        lat_rad=lat_rad,
        lon_rad=lon_rad,
        h_ellipsoid_m=height_m,
        h_msl_m=height_m,
        sigma_horizontal_m=np.full(count, 0.05),
        sigma_height_m=np.full(count, 0.05),
        quaternion=quaternions,
    )
    air = standard_atmosphere("us1976")
    outside = air.refractivity(height_m)
    usable = np.full(count, True)
    exposures = Exposures(usable, camera_from_enu, lat_rad, height_m, outside, outside)

    part = folder / "part.parquet"
    corrected = project.rows.assign(
        x_corrected_px=project.rows["x_px"],
        y_corrected_px=project.rows["y_px"],
        h_g_m=GROUND_M,
        status="ok",
    )
    corrected.to_parquet(part)

    f_px, cx_px, cy_px = project.camera
    camera = Camera(WIDTH_PX, HEIGHT_PX, f_px, f_px, cx_px, cy_px)
    run = FinishedRun(
        "strasbourg",
        stations,
        exposures,
        constant_series(TimedProfile(None, air), count),
        (rays_by(air, "spherical"),),
        "spherical",
        {"aerial": ExportCamera(camera, False, PIXEL_MM)},
        lambda _: np.full(count, GROUND_M),
        COLMAP,
        (part,),
        {},
    )
    form = FORMATS[name]
    out = folder / f"block{form.ending}"
    if not form.ending:
        out.mkdir()
    written = form.write(
        run,
        form.values({}),
        out,
        Ledger(),
    )

    points_of_one_image = 1 if name == "bundler" else 0  # which it leaves out
    assert written == len(project.rows) - points_of_one_image
    return out


def in_dbats_frame(poses, turns, places):
    """Orientations in another frame, turned back by the places of the cameras: the same poses."""
    centres = np.stack([centre for _, centre in poses.values()])
    middle = centres.mean(axis=0)
    offsets = places - places.mean(axis=0)
    frame, _ = Rotation.align_vectors(offsets, centres - middle)

    moved = frame.inv().apply(offsets) + middle
    turned = turns @ frame.as_matrix()

    np.testing.assert_allclose(moved, centres, atol=1e-3)
    np.testing.assert_allclose(
        turned,
        [turn for turn, _ in poses.values()],
        atol=1e-6,
    )
    return poses_by_image(poses, turned, moved)


@pytest.mark.parametrize(
    ("name", "within_px"),
    [("colmap", 0.0), ("colmap-database", 0.0005), ("opensfm", 1e-5)],
)
def test_a_round_trip_gives_dbats_solution(read, tmp_path, name, within_px):
    """Written, read again, and turned back into DBAT's frame by the places of the cameras."""
    path = exported(read, name, tmp_path)

    form = block_reader(name.partition("-")[0])
    (make_camera,) = form.read_cameras(path).values()
    camera = make_camera()
    rows = joined(form.read_rows(path))
    poses = read.poses
    if name != "colmap-database":  # which has no orientations
        images = form.read_images(path)
        order = [list(images.image).index(image) for image in poses]
        turns = rotations_of(images.angles[order])
        poses = in_dbats_frame(poses, turns, images.position[order])

    # COLMAP has no name of a point of one image, and a database of none, but keypoints keep places.
    is_nameless = rows["point"].str.contains(":")
    expected_nameless = {"colmap": 1, "colmap-database": len(rows), "opensfm": 0}
    assert is_nameless.sum() == expected_nameless[name]
    keypoints = ["image", "keypoint"]
    name_of = read.rows.set_index(keypoints)["point"]
    nameless = pd.MultiIndex.from_frame(rows.loc[is_nameless, keypoints])
    rows.loc[is_nameless, "point"] = name_of.reindex(nameless).to_numpy()
    assert_same_image_points(rows, read, within_px)
    interior = (camera.fx_px, camera.cx_px, camera.cy_px)
    assert interior == pytest.approx(read.camera, abs=1e-4)
    assert_is_dbats(
        replace(
            read,
            camera=interior,
            poses=poses,
            rows=rows,
        )
    )


@dataclass(frozen=True)
class BundlerBlock:
    """Image points are from the middle of the image, x to the right, y up [px]."""

    focal_px: float
    names: list[str]
    turns: Array  # to COLMAP's axes
    centres: Array
    rows: pd.DataFrame


def bundler_block(folder):
    """A block as Bundler defines it.

    A point X is P = R X + t in a camera that looks along -z, y up, and f (-P / P_z) in pixels from
    the middle of the image, x to the right, y up. Two lines of numbers before the cameras, five
    lines for each camera, three for each point.
    """
    lines = (folder / "bundle.out").read_text(encoding="ascii").splitlines()
    assert lines[0] == "# Bundle file v0.3"
    cameras, points = map(int, lines[1].split())
    first_point = 2 + 5 * cameras
    assert len(lines) == first_point + 3 * points

    numbers = np.array(" ".join(lines[2:first_point]).split(), float).reshape(cameras, 15)
    focals_px = set(numbers[:, 0])
    assert np.all(numbers[:, 1:3] == 0.0)
    assert len(focals_px) == 1
    turns = numbers[:, 3:12].reshape(-1, 3, 3)
    centres = -np.einsum("nji,nj->ni", turns, numbers[:, 12:])

    names = (folder / "list.txt").read_text(encoding="ascii").split()
    rows = []
    for point, line in enumerate(lines[first_point + 2 :: 3]):
        count, *views = line.split()
        assert len(views) == 4 * int(count)
        for camera, _, x, y in np.reshape(views, (-1, 4)):
            rows.append((names[int(camera)], point, float(x), float(y)))
    return BundlerBlock(
        focal_px=focals_px.pop(),
        names=names,
        turns=turns * [[1.0], [-1.0], [-1.0]],
        centres=centres,
        rows=pd.DataFrame(rows, columns=["image", "number", "x", "y"]),
    )


def test_bundler_gives_dbats_solution(read, tmp_path):
    """Points of an ideal camera; they have numbers, and their names by their places."""
    bundler = bundler_block(exported(read, "bundler", tmp_path))

    assert bundler.names == list(read.poses)
    focal_px, cx_px, cy_px = read.camera
    assert bundler.focal_px == focal_px
    by_place = ["image", "x_px"]
    rows = bundler.rows
    rows["x_px"] = rows["x"] + cx_px
    rows["y_px"] = cy_px - rows["y"]
    rows = rows.sort_values(by_place)
    is_tied = read.rows.groupby("point")["image"].transform("size") > 1
    tied = read.rows[is_tied].sort_values(by_place)
    assert rows["image"].tolist() == tied["image"].tolist()
    np.testing.assert_allclose(
        rows[PIXELS],
        tied[PIXELS],
        rtol=0.0,
        atol=1e-6,
    )
    names = rows.assign(point=tied["point"].to_numpy())
    pairs = names[["number", "point"]].drop_duplicates()
    assert pairs["number"].is_unique
    assert pairs["point"].is_unique
    # One image alone sees a control point, which Bundler's points have no place for: without it the
    # adjustment itself ends 7 cm elsewhere, so it is measured again.
    lone = read.rows[~is_tied]
    assert len(lone) == 1
    poses = in_dbats_frame(read.poses, bundler.turns, bundler.centres)
    measured_again = pd.concat([names, lone])
    assert_is_dbats(replace(read, poses=poses, rows=measured_again))


def test_bingo_gives_dbats_solution(read, tmp_path):
    """Millimetres from the middle of the image, y up; it has no orientations."""
    folder = exported(read, "bingo", tmp_path)

    assert not (folder / "names.csv").exists()  # no name was too long
    rows = []
    image = None
    for line in (folder / "image.dat").read_text(encoding="ascii").splitlines():
        if line == "-99":
            image = None
        elif image is None:
            image, camera = line.split()
            assert camera == "aerial"
        else:
            point, x_mm, y_mm = line.split()
            x_px = WIDTH_PX / 2 + float(x_mm) / PIXEL_MM
            y_px = HEIGHT_PX / 2 - float(y_mm) / PIXEL_MM
            rows.append((image, point, x_px, y_px))
    table = pd.DataFrame(rows, columns=["image", "point", *PIXELS])
    assert_same_image_points(table, read, within_px=1e-5)
    assert_is_dbats(replace(read, rows=table))
