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

from tests.dbat_project import (
    CHECKS,
    FOCAL_MM,
    NOISE_PX,
    PIXEL_MM,
    PRINCIPAL_MM,
    SIZE_PX,
    write_project,
)
from unbend.tables.imports.blocks import dbat

from .conftest import SHARED

pytest.importorskip("pycolmap")

import pycolmap

from .bundle_adjustment import Adjustment

STRASBOURG_FOLDER = SHARED / "ba" / "dbat_sxb"
WIDTH_PX, HEIGHT_PX = SIZE_PX
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


def known_solution(points: dict[str, Array], marks: pd.DataFrame) -> Solution:
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
def block(request, tmp_path_factory) -> Block:
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


def table(path: Path) -> list[list[str]]:
    """The cells of the rows of a file; from # on a line is a comment."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        row = line.partition("#")[0]
        if row.strip():
            rows.append([cell.strip() for cell in row.split(",")])
    return rows


def poses_of_report(path: Path) -> Poses:
    """Angles and places of the photos, from the part before the qualities."""
    report = path.read_text(encoding="utf-8").partition("\n   Quality")[0]
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
def raw(block) -> Project:
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
def read(block) -> Project:
    """The same by the package."""
    script = block.folder / "sxb.xml"
    (make_camera,) = dbat.read_cameras(script).values()
    camera = make_camera()
    assert camera.fx_px == camera.fy_px
    images = dbat.read_images(script)
    names, positions = dbat.read_points(script)
    turns = Rotation.from_quat(images.angles, scalar_first=True).as_matrix()
    poses = zip(turns, images.position, strict=True)
    rows = [batch.to_pandas() for batch in dbat.read_rows(script)]
    return Project(
        camera=(camera.fx_px, camera.cx_px, camera.cy_px),
        poses=dict(zip(images.image, poses, strict=True)),
        rows=pd.concat(rows, ignore_index=True),
        control=dict(zip(names.to_pylist(), positions, strict=True)),
        solution=block.solution,
    )


def adjust(project: Project) -> tuple[float, int, dict[str, Array]]:
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


def assert_is_dbats(project: Project) -> None:
    rms_px, image_points, checks = adjust(project)

    solution = project.solution
    assert image_points == solution.image_points
    assert solution.least_rms_px < rms_px < solution.most_rms_px
    for point, position in solution.checks.items():
        assert np.abs(checks[point] - position).max() < WITHIN_M


def test_what_is_read_gives_dbats_solution(raw, read):
    assert read.camera == pytest.approx(raw.camera, abs=1e-9)
    assert list(read.poses) == list(raw.poses)
    for name, (rotation, centre) in raw.poses.items():
        read_rotation, read_centre = read.poses[name]
        np.testing.assert_allclose(read_rotation, rotation, atol=1e-12)
        np.testing.assert_allclose(read_centre, centre, atol=1e-6)
    pairs = read.rows.merge(
        raw.rows,
        on=["image", "point"],
        suffixes=("", "_raw"),
    )
    assert len(pairs) == len(read.rows) == len(raw.rows)
    for name in PIXELS:
        of_raw = pairs[f"{name}_raw"]
        assert (pairs[name] == of_raw).all()
    assert list(read.control) == list(raw.control)
    for point, position in raw.control.items():
        assert read.control[point].tolist() == position.tolist()
    assert_is_dbats(read)


def test_it_notices_other_axes(raw):
    """Rows counted from below."""
    mirrored = raw.rows.assign(y_px=HEIGHT_PX - raw.rows["y_px"])
    with pytest.raises(AssertionError):
        assert_is_dbats(replace(raw, rows=mirrored))
