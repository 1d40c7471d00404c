"""Blocks that our own imports read again; Pix4D's and BlocksExchange's numbers by own formulas."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pytest

from tests.helpers import refused
from tests.tables.exports.export_runs import DOWN, write_export
from tests.tables.exports.projected_block import SIDE, SQUARE, distorted, frame_of, point_names
from unbend.flight.rotations import matrices_of
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import ExportCamera
from unbend.tables.imports.blocks import block_rows, read_block_images, read_camera

LARGEST_PX = {
    "colmap": 2e-12,
    "colmap-database": 5e-4,  # float32
    "opensfm": 1e-5,  # nine decimals
    "pix4d": 1e-8,
    "blocksexchange": 1e-8,
}


@pytest.mark.parametrize("name", LARGEST_PX)
def test_image_points_come_back(square, tmp_path, name):
    written = write_export(square.run(), name, tmp_path)
    batches = block_rows(written.path, name.partition("-")[0])
    read = pa.Table.from_batches(batches).to_pandas().sort_values(["image", "x_px"])
    expected = square.rows.sort_values(["image", "x_px"])
    is_tied = expected.point.isin(square.tied).to_numpy()
    if name == "blocksexchange":
        expected = expected[is_tied]
    assert read.image.tolist() == expected.image.tolist()
    pixels = ["x_px", "y_px"]
    np.testing.assert_allclose(read[pixels], expected[pixels], rtol=0.0, atol=LARGEST_PX[name])
    numbers = {"opensfm": point_names, "colmap": point_names}.get(name, lambda _: {})
    names = {str(number): point for number, point in numbers(written.path).items()}
    points = read.point.replace(names).to_numpy()
    if name == "colmap":
        np.testing.assert_array_equal(points[is_tied], expected.point[is_tied])
    elif name != "colmap-database":
        np.testing.assert_array_equal(points, expected.point)


@pytest.mark.parametrize("name", ["colmap", "opensfm", "pix4d", "blocksexchange"])
def test_places_and_attitudes_come_back(square, tmp_path, name):
    written = write_export(square.run(), name, tmp_path)
    frame = frame_of(written)
    centre = frame(square.centre)
    if name == "blocksexchange":
        centre[:, 2] += frame.origin[2]
    images = read_block_images(written.path, name)
    order = [list(images.image).index(image) for image in square.image]
    np.testing.assert_allclose(images.position[order], centre, atol=1e-6)
    turns = matrices_of(images.angles[order])
    np.testing.assert_allclose(turns, square.turn @ square.axes(frame), atol=1e-8)


@pytest.mark.parametrize(
    ("name", "cameras"),
    [
        ("colmap", ("1", "2")),
        ("colmap-database", ("1", "2")),
        ("opensfm", ("nadir", "side")),
        ("pix4d", ("1", "2")),
        ("blocksexchange", ("nadir", "side")),
    ],
)
def test_cameras_come_back(square, tmp_path, name, cameras):
    path = write_export(square.run(), name, tmp_path).path
    if name == "opensfm":
        path = path / "camera_models.json"
    u, v = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, -0.25]])
    for number, expected in zip(cameras, (SQUARE, SIDE), strict=True):
        camera = read_camera(path, name.partition("-")[0], number)
        np.testing.assert_allclose(camera.project(u, v), distorted(expected, u, v), atol=1e-8)


def test_numbers_of_pix4d_are_those_of_its_formula(square, tmp_path):
    """m = K [R | -R t] X for a point, and angles by the textbook."""
    written = write_export(square.run(), "pix4d", tmp_path)
    image = square.image[0]
    text = (written.path / "unbend_calibrated_camera_parameters.txt").read_text()
    lines = text.partition(f"{image} ")[2].splitlines()
    k = np.array([line.split() for line in lines[1:4]], float)
    t = np.array(lines[6].split(), float)
    r = np.array([line.split() for line in lines[7:10]], float)
    row = square.of_image(image).iloc[0]
    (place,) = frame_of(written)(square.places([row.point]))
    m = k @ r @ (place - t)
    ideal = k @ [row.u, row.v, 1.0]
    np.testing.assert_allclose(m[:2] / m[2], ideal[:2], atol=1e-4)
    external = written.path / "unbend_calibrated_external_camera_parameters.txt"
    fields = external.read_text().splitlines()[1].split()
    np.testing.assert_allclose(np.array(fields[1:4], float), t, rtol=0.0, atol=1e-6)
    omega, phi, kappa = np.radians(np.array(fields[4:], float))
    photo = DOWN @ r  # x right, y up, z back
    assert photo[2, 0] == pytest.approx(np.sin(phi), abs=1e-9)
    assert photo[2, 1] == pytest.approx(-np.sin(omega) * np.cos(phi), abs=1e-9)
    assert photo[1, 0] == pytest.approx(-np.cos(phi) * np.sin(kappa), abs=1e-9)


def test_numbers_of_blocks_exchange(square, tmp_path):
    """Half a pixel, the tangential coefficients, and heights from the ellipsoid."""
    written = write_export(square.run(), "blocksexchange", tmp_path)
    root = ElementTree.parse(written.path).getroot()
    lat, lon, _ = frame_of(written).origin
    assert root.findtext("SpatialReferenceSystems/SRS/Definition") == f"ENU:{lat!r},{lon!r}"
    group = root.find("Block/Photogroups/Photogroup")
    assert float(group.findtext("PrincipalPoint/x")) == SQUARE.cx_px - 0.5
    assert float(group.findtext("Distortion/P1")) == SQUARE.distortion.p2
    assert float(group.findtext("Distortion/P2")) == SQUARE.distortion.p1
    heights = [float(z.text) for z in root.iter("z")]
    assert 300.0 < min(heights) < 700.0, "of the points, above the ellipsoid"
    singles = int((~square.rows.point.isin(square.tied)).sum())
    assert ("note", "EXPORT-SINGLE", singles) in written.counts
    assert written.count == len(square.rows) - singles


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("pix4d", {"distortion": OpenCVFisheye(0.01, 0.0, 0.0, 0.0)}),
        ("blocksexchange", {"distortion": OpenCVFisheye(0.01, 0.0, 0.0, 0.0)}),
        ("blocksexchange", {"fy_px": 19_990.0}),
    ],
)
def test_cameras_that_the_formats_do_not_hold_are_refused(square, tmp_path, name, change):
    run = square.run()
    cameras = {**run.cameras, "nadir": ExportCamera(replace(SQUARE, **change), False)}
    with refused("EXPORT-DISTORTION"):
        write_export(replace(run, cameras=cameras), name, tmp_path)
