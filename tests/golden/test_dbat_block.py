"""A real block, Strasbourg, five images: DBAT's own solution against pycolmap's, by our readers.

The report of the Damped Bundle Adjustment Toolbox is the truth: point marking residuals of 1.101 px
and two check points. Its control has 2, 2 and 4 cm, which pycolmap cannot take: here it is held,
and moves the height of check point 351 by 4.4 cm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.tables.imports.blocks import dbat

from .conftest import SHARED

pycolmap = pytest.importorskip("pycolmap")

FOLDER = SHARED / "ba" / "dbat_sxb"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="../shared/ba is not beside this checkout"
)
ORIGIN = np.array([1_000_000.0, 112_400.0, 0.0])
ADJUSTED_BY_DBAT = {
    "351": (1_000_551.437, 112_275.288, 139.401),
    "410": (999_974.528, 112_476.597, 139.856),
}  # report.txt, check measurements, posterior


@dataclass(frozen=True)
class Project:
    """f, cx, cy [px], poses by image (rotation to the camera, centre), image points, control."""

    camera: tuple[float, float, float]
    poses: dict[str, tuple[np.ndarray, np.ndarray]]
    rows: pd.DataFrame
    control: dict[str, np.ndarray]


def table(name: str) -> list[list[str]]:
    lines = (FOLDER / name).read_text(encoding="utf-8").splitlines()
    rows = (line.partition("#")[0] for line in lines)
    return [[cell.strip() for cell in row.split(",")] for row in rows if row.strip()]


@pytest.fixture(scope="module")
def raw() -> Project:
    """The files as they are, by a parser of this test."""
    names = {number: path.rpartition("/")[2] for number, path in table("images.txt")}
    rows = [
        (names[image], point, float(x), float(y))
        for name in ("markpts.txt", "smartpts.txt")
        for point, image, x, y in table(name)
    ]
    report = (FOLDER / "report.txt").read_text(encoding="utf-8").partition("\n   Quality")[0]
    poses = {}
    for photo in report.split(" Photo ")[1:]:
        name = photo.partition(": ")[2].split()[0]
        found = re.findall(r"(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", photo)
        opk, centre = np.array(found[:3], float), np.array(found[3:], float)
        # M = Rx Ry Rz turns a camera with y up and z back to the world.
        matrix = Rotation.from_euler("XYZ", opk, degrees=True).as_matrix()
        poses[name] = ((matrix * [1.0, -1.0, -1.0]).T, centre)
    control = {row[0]: np.array(row[2:5], float) for row in table("sxb-control.txt")}
    return Project(
        (123.9392 / 0.006, 26.577 / 0.006, 38.811 / 0.006),
        poses,
        pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"]),
        control,
    )


@pytest.fixture(scope="module")
def read() -> Project:
    """The same by the package."""
    script = FOLDER / "sxb.xml"
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
    )


def adjust(project: Project) -> tuple[float, int, dict[str, np.ndarray]]:
    """Point RMS [px], how many observations, and the adjusted check points.

    DBAT's sigmas are 0.5 px of marked points (their numbers are small) and 1 px of the others: a
    marked point is observed four times here.
    """
    model, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
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
    held = set(project.control) - set(ADJUSTED_BY_DBAT)
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
    checks = {point: model.points3D[ids[point]].xyz + ORIGIN for point in ADJUSTED_BY_DBAT}
    return float(np.sqrt(np.mean(list(squares.values())))), len(squares), checks


def assert_is_dbats(project: Project) -> None:
    rms, count, checks = adjust(project)
    assert count == 1196  # of DBAT's 2392 coordinates
    assert 1.08 < rms < 1.12
    for point, place in ADJUSTED_BY_DBAT.items():
        assert np.abs(checks[point] - place).max() < 0.05


def test_the_files_give_dbats_solution(raw: Project) -> None:
    assert_is_dbats(raw)


def test_what_is_read_gives_dbats_solution(raw: Project, read: Project) -> None:
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


def test_it_notices_other_axes(raw: Project) -> None:
    """Rows counted from below."""
    mirrored = raw.rows.assign(y_px=12996.0 - raw.rows["y_px"])
    with pytest.raises(AssertionError):
        assert_is_dbats(replace(raw, rows=mirrored))
