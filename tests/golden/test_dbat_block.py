"""A block of five images: its known solution against pycolmap's, by our readers.

Everywhere one that is written here without error but for noise of its image points; and where
../shared is, a real one, Strasbourg, with the solution of DBAT.

The report of the Damped Bundle Adjustment Toolbox is the truth: point marking residuals of 1.101 px
and two check points. Its control has 2, 2 and 4 cm, which pycolmap cannot take: here it is held,
and moves the height of check point 351 by 4.4 cm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.dbat_project import CHECKS, NOISE_PX, write_project
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

from .conftest import SHARED

pycolmap = pytest.importorskip("pycolmap")

FOLDER = SHARED / "ba" / "dbat_sxb"
PLACE = np.radians(48.58), np.radians(7.75)
ORIGIN = np.array([1_000_000.0, 112_400.0, 0.0])
Poses = dict[str, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Solution:
    """How many image points, their RMS [px] (least, most), and adjusted check points."""

    count: int
    rms_px: tuple[float, float]
    checks: dict[str, np.ndarray]


STRASBOURG = Solution(
    1196,  # of DBAT's 2392 coordinates
    (1.08, 1.12),
    # report.txt, check measurements, posterior
    {
        "351": np.array([1_000_551.437, 112_275.288, 139.401]),
        "410": np.array([999_974.528, 112_476.597, 139.856]),
    },
)


def known_solution(points: dict[str, np.ndarray], marks: pd.DataFrame) -> Solution:
    """Of the block that is written here: the true check points, and what is left of the noise.

    Five cameras and all points but the control take their share of it; the rest is known to a
    percent or two, by some thousand coordinates.
    """
    free = {point for point in marks["point"] if int(point) >= 1000} | {*CHECKS}
    left = 1.0 - (5 * 6 + 3 * len(free)) / (2 * len(marks))
    rms = NOISE_PX * np.sqrt(2.0 * left)
    return Solution(len(marks), (0.92 * rms, 1.08 * rms), {name: points[name] for name in CHECKS})


@dataclass(frozen=True)
class Block:
    """A folder with a project of DBAT, and its solution."""

    folder: Path
    solution: Solution


@pytest.fixture(
    scope="module", params=["written", "strasbourg"] if FOLDER.is_dir() else ["written"]
)
def block(request, tmp_path_factory) -> Block:
    """The blocks that are at hand."""
    if request.param == "strasbourg":
        return Block(FOLDER, STRASBOURG)
    folder = tmp_path_factory.mktemp("dbat")
    written = write_project(folder)
    return Block(folder, known_solution(written.points, written.marks))


@dataclass(frozen=True)
class Project:
    """f, cx, cy [px], poses by image (rotation to the camera, centre), image points, control."""

    camera: tuple[float, float, float]
    poses: Poses
    rows: pd.DataFrame
    control: dict[str, np.ndarray]
    solution: Solution


def table(path: Path) -> list[list[str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = (line.partition("#")[0] for line in lines)
    return [[cell.strip() for cell in row.split(",")] for row in rows if row.strip()]


@pytest.fixture(scope="module")
def raw(block) -> Project:
    """The files as they are, by a parser of this test."""
    names = {number: path.rpartition("/")[2] for number, path in table(block.folder / "images.txt")}
    rows = [
        (names[image], point, float(x), float(y))
        for name in ("markpts.txt", "smartpts.txt")
        for point, image, x, y in table(block.folder / name)
    ]
    report = (block.folder / "report.txt").read_text(encoding="utf-8").partition("\n   Quality")[0]
    poses = {}
    for photo in report.split(" Photo ")[1:]:
        name = photo.partition(": ")[2].split()[0]
        numbers = re.findall(r"(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", photo)
        opk = np.array(numbers[:3], float)
        centre = np.array(numbers[3:], float)
        # M = Rx Ry Rz turns a camera with y up and z back to the world.
        matrix = Rotation.from_euler("XYZ", opk, degrees=True).as_matrix()
        poses[name] = ((matrix * [1.0, -1.0, -1.0]).T, centre)
    control = {row[0]: np.array(row[2:5], float) for row in table(block.folder / "sxb-control.txt")}
    return Project(
        (123.9392 / 0.006, 26.577 / 0.006, 38.811 / 0.006),
        poses,
        pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"]),
        control,
        block.solution,
    )


@pytest.fixture(scope="module")
def read(block) -> Project:
    """The same by the package."""
    script = block.folder / "sxb.xml"
    (make,) = dbat.read_cameras(script).values()
    camera = make()
    assert camera.fx_px == camera.fy_px
    images = dbat.read_images(script)
    turns = Rotation.from_quat(images.angles[:, [1, 2, 3, 0]]).as_matrix()
    names, places = dbat.read_points(script)
    rows = [batch.to_pandas() for batch in dbat.read_rows(script)]
    return Project(
        (camera.fx_px, camera.cx_px, camera.cy_px),
        dict(zip(images.image, zip(turns, images.position, strict=True), strict=True)),
        pd.concat(rows, ignore_index=True),
        dict(zip(names.to_pylist(), places, strict=True)),
        block.solution,
    )


def adjust(project: Project) -> tuple[float, int, dict[str, np.ndarray]]:
    """Point RMS [px], how many observations, and the adjusted check points.

    DBAT's sigmas are 0.5 px of marked points (their numbers are small) and 1 px of the others: a
    marked point is observed four times here.
    """
    model = pycolmap.Reconstruction()
    config = pycolmap.BundleAdjustmentConfig()
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=8858, height=12996, params=project.camera, camera_id=1
    )
    model.add_camera_with_trivial_rig(camera)
    config.set_constant_cam_intrinsics(1)
    tracks: dict[str, list[pycolmap.TrackElement]] = {}
    rays: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for number, (name, rows) in enumerate(project.rows.groupby("image"), start=1):
        rotation, place = project.poses[name]
        centre = place - ORIGIN
        rows = rows.loc[rows.index.repeat(np.where(rows["point"].astype(int) < 1000, 4, 1))]
        pixels = rows[["x_px", "y_px"]].to_numpy()
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=1, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        model.add_image_with_trivial_frame(image, pose)
        config.add_image(number)
        directions = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))]) @ rotation
        for i, point in enumerate(rows["point"]):
            tracks.setdefault(point, []).append(pycolmap.TrackElement(number, i))
            rays.setdefault(point, []).append((centre, directions[i]))
    held = set(project.control) - set(CHECKS)
    assert len(held) == 14
    ids = {}
    for point, track in tracks.items():
        if len(track) < 2:
            continue
        if point in held:
            start = project.control[point] - ORIGIN
        else:
            planes = [np.eye(3) - np.outer(d, d) / (d @ d) for _, d in rays[point]]
            right = sum(p @ c for p, (c, _) in zip(planes, rays[point], strict=True))
            start = np.linalg.solve(sum(planes), right)
        ids[point] = model.add_point3D(start, pycolmap.Track(track))
        if point in held:
            config.add_constant_point(ids[point])
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    squares: dict[tuple[str, int], float] = {}
    for point, i in ids.items():
        for e in model.points3D[i].track.elements:
            image = model.images[e.image_id]
            projected = image.project_point(model.points3D[i].xyz)
            assert projected is not None, "a point behind its camera"
            residual = projected - image.points2D[e.point2D_idx].xy
            squares[point, e.image_id] = float(residual @ residual)
    checks = {point: model.points3D[ids[point]].xyz + ORIGIN for point in CHECKS}
    return float(np.sqrt(np.mean(list(squares.values())))), len(squares), checks


def assert_is_dbats(project: Project) -> None:
    rms, count, checks = adjust(project)
    solution = project.solution
    least, most = solution.rms_px
    assert count == solution.count
    assert least < rms < most
    for point, place in solution.checks.items():
        assert np.abs(checks[point] - place).max() < 0.05


def test_the_files_give_dbats_solution(raw):
    assert_is_dbats(raw)


def test_what_is_read_gives_dbats_solution(raw, read):
    assert read.camera == pytest.approx(raw.camera, abs=1e-9)
    assert list(read.poses) == list(raw.poses)
    for name, (rotation, centre) in raw.poses.items():
        np.testing.assert_allclose(read.poses[name][0], rotation, atol=1e-12)
        np.testing.assert_allclose(read.poses[name][1], centre, atol=1e-6)
    order = ["image", "point"]
    pd.testing.assert_frame_equal(
        read.rows[raw.rows.columns].sort_values(order, ignore_index=True),
        raw.rows.sort_values(order, ignore_index=True),
        check_dtype=False,
    )
    assert {k: v.tolist() for k, v in read.control.items()} == {
        k: v.tolist() for k, v in raw.control.items()
    }
    assert_is_dbats(read)


def test_it_notices_other_axes(raw):
    """Rows counted from below."""
    mirrored = raw.rows.assign(y_px=12996.0 - raw.rows["y_px"])
    with pytest.raises(AssertionError):
        assert_is_dbats(replace(raw, rows=mirrored))


def exported(project: Project, name: str, folder: Path) -> Path:
    """The block in a format of other programs, as if it stood at Strasbourg, free of refraction."""
    images = np.array(list(project.poses), object)
    rotation, centre = (np.stack(each) for each in zip(*project.poses.values(), strict=True))
    axes = enu_axes(*PLACE)
    ecef = to_ecef(*PLACE, np.array(0.0)) + (centre - ORIGIN) @ axes
    height, up = height_and_up(ecef)
    lat = np.arcsin(up[:, 2])
    lon = np.arctan2(up[:, 1], up[:, 0])
    turn = rotation @ axes @ np.swapaxes(enu_axes(lat, lon), 1, 2)
    n = len(images)
    air = standard_atmosphere("us1976")
    stations = replace(
        empty_stations(images, np.full(n, "aerial", object), "ok"),
        lat_rad=lat,
        lon_rad=lon,
        h_ellipsoid_m=height,
        h_msl_m=height,
        sigma_horizontal_m=np.full(n, 0.05),
        sigma_height_m=np.full(n, 0.05),
        quaternion=Rotation.from_matrix(turn).as_quat(canonical=True, scalar_first=True),
    )
    outside = air.refractivity(height)
    part = folder / "part.parquet"
    project.rows.assign(
        x_corrected_px=project.rows["x_px"],
        y_corrected_px=project.rows["y_px"],
        h_g_m=140.0,
        status="ok",
    ).to_parquet(part)
    f, cx, cy = project.camera
    camera = ExportCamera(Camera(8858, 12996, f, f, cx, cy), False, 0.006)
    run = FinishedRun(
        "strasbourg",
        stations,
        Exposures(np.full(n, True), turn, lat, height, outside, outside),
        constant_series(TimedProfile(None, air), n),
        (rays_by(air, "spherical"),),
        "spherical",
        {"aerial": camera},
        lambda _: np.full(n, 140.0),
        COLMAP,
        (part,),
        {},
    )
    form = FORMATS[name]
    out = folder / f"block{form.ending}"
    if not form.ending:
        out.mkdir()
    written = form.write(run, form.values({}), out, Ledger())
    assert written == len(project.rows) - (name == "bundler")  # a point of one image
    return out


def in_dbats_frame(poses: Poses, turns: np.ndarray, place: np.ndarray) -> Poses:
    """Orientations in another frame, turned back by the places of the cameras: the same poses."""
    centre = np.stack([c for _, c in poses.values()])
    back, _ = Rotation.align_vectors(place - place.mean(axis=0), centre - centre.mean(axis=0))
    moved = back.inv().apply(place - place.mean(axis=0)) + centre.mean(axis=0)
    np.testing.assert_allclose(moved, centre, atol=1e-3)
    turns = turns @ back.as_matrix()
    np.testing.assert_allclose(turns, [turn for turn, _ in poses.values()], atol=1e-6)
    return dict(zip(poses, zip(turns, moved, strict=True), strict=True))


@pytest.mark.parametrize(
    ("name", "within_px"), [("colmap", 0.0), ("colmap-database", 0.0005), ("opensfm", 1e-5)]
)
def test_a_round_trip_gives_dbats_solution(read, tmp_path, name, within_px):
    """Written, read again, and turned back into DBAT's frame by the places of the cameras."""
    path = exported(read, name, tmp_path)
    form = block_reader(name.partition("-")[0])
    (make,) = form.read_cameras(path).values()
    camera = make()
    poses = read.poses
    if name != "colmap-database":  # which has no orientations
        images = form.read_images(path)
        order = [list(images.image).index(image) for image in poses]
        turns = Rotation.from_quat(images.angles[order][:, [1, 2, 3, 0]]).as_matrix()
        poses = in_dbats_frame(poses, turns, images.position[order])
    rows = pd.concat([b.to_pandas() for b in form.read_rows(path)], ignore_index=True)
    # COLMAP has no name of a point of one image, and a database of none, but keypoints keep places.
    nameless = rows["point"].str.contains(":")
    assert nameless.sum() == {"colmap": 1, "colmap-database": len(rows), "opensfm": 0}[name]
    place_of = read.rows.set_index(["image", "keypoint"])["point"]
    index = pd.MultiIndex.from_frame(rows.loc[nameless, ["image", "keypoint"]])
    rows.loc[nameless, "point"] = place_of.reindex(index).to_numpy()
    gap = rows.merge(read.rows, on=["image", "point"], suffixes=("", "_before"))
    assert len(gap) == len(rows) == len(read.rows)
    for axis in ("x_px", "y_px"):
        assert np.abs(gap[axis] - gap[f"{axis}_before"]).max() <= within_px
    project = replace(
        read, camera=(camera.fx_px, camera.cx_px, camera.cy_px), poses=poses, rows=rows
    )
    assert project.camera == pytest.approx(read.camera, abs=1e-4)
    assert_is_dbats(project)


def bundler_block(folder: Path) -> tuple[float, list[str], np.ndarray, np.ndarray, pd.DataFrame]:
    """f, names, rotations to COLMAP's axes, centres and image points, as Bundler defines them.

    A point X is P = R X + t in a camera that looks along -z, y up, and f (-P / P_z) in pixels from
    the middle of the image, x to the right, y up. Two lines of numbers before the cameras, five
    lines for each camera, three for each point.
    """
    lines = (folder / "bundle.out").read_text(encoding="ascii").splitlines()
    assert lines[0] == "# Bundle file v0.3"
    cameras, points = map(int, lines[1].split())
    numbers = np.array(" ".join(lines[2 : 2 + 5 * cameras]).split(), float).reshape(cameras, 15)
    assert np.all(numbers[:, 1:3] == 0.0)
    assert len(set(numbers[:, 0])) == 1
    turns = numbers[:, 3:12].reshape(-1, 3, 3)
    moves = numbers[:, 12:]
    centres = -np.einsum("nji,nj->ni", turns, moves)
    names = (folder / "list.txt").read_text(encoding="ascii").split()
    rows = []
    for point in range(points):
        count, *views = lines[2 + 5 * cameras + 3 * point + 2].split()
        assert len(views) == 4 * int(count)
        for k in range(0, len(views), 4):
            rows.append((names[int(views[k])], point, float(views[k + 2]), float(views[k + 3])))
    assert len(lines) == 2 + 5 * cameras + 3 * points
    table = pd.DataFrame(rows, columns=["image", "number", "x", "y"])
    return numbers[0, 0], names, turns * [[1.0], [-1.0], [-1.0]], centres, table


def test_bundler_gives_dbats_solution(read, tmp_path):
    """Points of an ideal camera; they have numbers, and their names by their places."""
    f, names, turns, centres, rows = bundler_block(exported(read, "bundler", tmp_path))
    assert names == list(read.poses)
    focal, cx, cy = read.camera
    assert f == focal
    rows = rows.assign(x_px=rows["x"] + cx, y_px=cy - rows["y"]).sort_values(["image", "x_px"])
    tied = read.rows[read.rows.groupby("point")["image"].transform("size") > 1]
    tied = tied.sort_values(["image", "x_px"])
    assert rows["image"].tolist() == tied["image"].tolist()
    for axis in ("x_px", "y_px"):
        np.testing.assert_allclose(rows[axis], tied[axis], rtol=0.0, atol=1e-6)
    numbers = rows["number"].to_numpy()
    point = tied["point"].to_numpy()
    assert len(set(zip(numbers, point, strict=True))) == len(set(numbers)) == len(set(point))
    # One image alone sees a control point, which Bundler's points have no place for: without it the
    # adjustment itself ends 7 cm elsewhere, so it is measured again.
    lone = read.rows.drop(tied.index)
    assert len(lone) == 1
    rows = pd.concat([rows.assign(point=point), lone])
    rows = rows.assign(x_px=rows["x_px"] - cx + 4429.0, y_px=rows["y_px"] - cy + 6498.0)
    poses = in_dbats_frame(read.poses, turns, centres)
    assert_is_dbats(replace(read, camera=(f, 4429.0, 6498.0), poses=poses, rows=rows))


def test_bingo_gives_dbats_solution(read, tmp_path):
    """Millimetres from the middle of the image, y up; it has no orientations."""
    folder = exported(read, "bingo", tmp_path)
    changed = folder / "names.csv"
    given = pd.read_csv(changed, dtype=str) if changed.exists() else pd.DataFrame()
    long = {tuple(row[:2]): row[2] for row in given.itertuples(index=False)}
    rows = []
    image = None
    for line in (folder / "image.dat").read_text(encoding="ascii").splitlines():
        if line == "-99":
            image = None
        elif image is None:
            image, camera = line.split()
            assert (len(image) <= 15, camera) == (True, "aerial")
            image = long.get(("image", image), image)
        else:
            point, x, y = line.split()
            point = long.get(("point", point), point)
            x_px = 4429.0 + float(x) / 0.006
            y_px = 6498.0 - float(y) / 0.006
            rows.append((image, point, x_px, y_px))
    table = pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])
    gap = table.merge(read.rows, on=["image", "point"], suffixes=("", "_before"))
    assert len(gap) == len(table) == len(read.rows)
    for axis in ("x_px", "y_px"):
        assert np.abs(gap[axis] - gap[f"{axis}_before"]).max() <= 1e-5
    assert_is_dbats(replace(read, rows=table))
