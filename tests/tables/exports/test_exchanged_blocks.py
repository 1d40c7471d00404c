"""Blocks that our own imports read again; those are tested by other programs' files."""

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.tables.checks import assert_within
from tests.tables.exports.export_runs import DOWN, rotation_to_photo, write_export
from tests.tables.exports.projected_block import (
    SIDE,
    SQUARE,
    distorted,
    frame_of,
    names_of_points,
)
from unbend.flight.rotations import matrices_of
from unbend.tables.imports.blocks import (
    block_rows,
    read_block_images,
    read_block_points,
    read_camera,
)

FORMATS = ["opensfm", "pix4d", "blocksexchange"]


def names_in_file(points, path, program):
    """Names of points by those in a file, which are numbers in OpenSfM's."""
    if program == "opensfm":
        return names_of_points(path, map(int, points))
    return list(points)


@pytest.mark.parametrize("program", FORMATS)
def test_image_points_come_back(square, program):
    expected = square.rows.sort_values(["image", "x_px"])
    if program == "blocksexchange":
        expected = expected[expected.point.isin(square.tied)]

    path = write_export(square.run(), program).path
    rows = pa.Table.from_batches(block_rows(path, program)).to_pandas()

    rows = rows.sort_values(["image", "x_px"])
    assert rows.image.tolist() == expected.image.tolist()
    assert names_in_file(rows.point, path, program) == expected.point.tolist()
    pixels = ["x_px", "y_px"]
    largest_px = 1e-5 if program == "opensfm" else 1e-8  # of nine decimals
    assert_within(rows[pixels], expected[pixels], largest_px)


@pytest.mark.parametrize("program", FORMATS)
def test_images_come_back(square, program):
    written = write_export(square.run(), program)

    images = read_block_images(written.path, program)

    frame = frame_of(written)
    order = [list(images.image).index(image) for image in square.image]
    cameras = pd.Series(square.camera)
    if program == "pix4d":
        cameras = cameras.map({"nadir": "1", "side": "2"})
    assert images.camera[order].tolist() == cameras.tolist()
    assert_within(images.position[order], frame(square.centre), 1e-6)
    turns = matrices_of(images.angles[order])
    assert_within(turns, square.turn @ square.axes(frame), 1e-8)


@pytest.mark.parametrize("program", ["opensfm", "blocksexchange"])
def test_object_points_come_back(square, program):
    written = write_export(square.run(), program)

    points, positions = read_block_points(written.path, program)

    names = names_in_file(points.to_pylist(), written.path, program)
    assert set(names) == square.tied
    frame = frame_of(written)
    assert_within(positions, frame(square.places(names)), 1e-3)


@pytest.mark.parametrize(
    ("program", "file", "names"),
    [
        (
            "opensfm",
            "camera_models.json",
            ("nadir", "side"),
        ),
        (
            "opensfm",
            "reconstruction.json",
            ("nadir", "side"),
        ),
        (
            "pix4d",
            "",
            ("1", "2"),
        ),
        (
            "blocksexchange",
            "",
            ("nadir", "side"),
        ),
    ],
)
def test_cameras_come_back(square, program, file, names):
    u = np.array([0.1, -0.2, 0.3])
    v = np.array([0.2, 0.1, -0.25])

    path = write_export(square.run(), program).path / file

    for name, expected in zip(names, (SQUARE, SIDE), strict=True):
        camera = read_camera(path, program, name)
        assert_within(camera.project(u, v), distorted(expected, u, v), 1e-8)


def test_the_matrix_of_a_camera_of_pix4d_has_no_skew(square):
    written = write_export(square.run(), "pix4d")

    text = (written.path / "unbend_calibrated_camera_parameters.txt").read_text("utf-8")

    image = square.image[0]
    _, of_image = text.split(f"{image} {SQUARE.width_px} {SQUARE.height_px}\n")
    rows = [[float(word) for word in line.split()] for line in of_image.splitlines()[:3]]
    assert rows == [
        [SQUARE.fx_px, 0.0, SQUARE.cx_px],
        [0.0, SQUARE.fy_px, SQUARE.cy_px],
        [0.0, 0.0, 1.0],
    ]


def test_angles_of_pix4d_are_those_of_the_textbook(square):
    """In the file of X, Y, Z, omega, phi and kappa, which is not that of the matrices."""
    written = write_export(square.run(), "pix4d")

    file = written.path / "unbend_calibrated_external_camera_parameters.txt"
    table = pd.read_csv(file, sep=" ")

    frame = frame_of(written)
    assert table.imageName.tolist() == square.image.tolist()
    assert_within(table[["X", "Y", "Z"]], frame(square.centre), 1e-6)
    angles = table.rename(columns=lambda name: f"{name.lower()}_deg")
    photos = [rotation_to_photo(row) for _, row in angles.iterrows()]
    turns = square.turn @ square.axes(frame)
    assert_within(photos, DOWN @ turns, 1e-9)


def test_blocks_exchange_says_its_system_and_what_it_lacks(square):
    written = write_export(square.run(), "blocksexchange")

    root = ElementTree.parse(written.path).getroot()
    lat, lon, height = frame_of(written).origin
    assert height == 0.0  # z is above the ellipsoid
    assert root.findtext("SpatialReferenceSystems/SRS/Definition") == f"ENU:{lat!r},{lon!r}"
    tied = square.rows.point.isin(square.tied)
    assert written.count == tied.sum()
    assert ("note", "EXPORT-SINGLE", (~tied).sum()) in written.counts
    points = written.message("EXPORT-POINTS")
    assert points.count == tied.sum()
    assert f"of {len(square.tied):,} points in" in points.what
