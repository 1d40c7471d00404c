"""Blocks that our own imports read again; those are tested by other programs' files."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.tables.checks import assert_within
from tests.tables.exports.export_runs import DOWN, rotation_to_photo, write_export
from tests.tables.exports.projected_block import SIDE, SQUARE, distorted, frame_of, point_names
from unbend.flight.rotations import matrices_of
from unbend.tables.imports.blocks import (
    block_rows,
    read_block_images,
    read_block_points,
    read_camera,
)

FORMATS = ["opensfm", "pix4d", "blocksexchange"]


def named(points, path, name) -> list[str]:
    """Points by their names, of which OpenSfM's are numbers."""
    names = {}
    if name == "opensfm":
        names = {str(number): point for number, point in point_names(path).items()}
    return [names.get(point, point) for point in points]


@pytest.mark.parametrize("name", FORMATS)
def test_image_points_come_back(square, tmp_path, name):
    path = write_export(square.run(), name, tmp_path).path
    read = pa.Table.from_batches(block_rows(path, name)).to_pandas()
    read = read.sort_values(["image", "x_px"])
    expected = square.rows.sort_values(["image", "x_px"])
    if name == "blocksexchange":
        expected = expected[expected.point.isin(square.tied)]
    assert read.image.tolist() == expected.image.tolist()
    assert named(read.point, path, name) == expected.point.tolist()
    pixels = ["x_px", "y_px"]
    largest = 1e-5 if name == "opensfm" else 1e-8  # of nine decimals
    assert_within(read[pixels], expected[pixels], largest)


@pytest.mark.parametrize("name", FORMATS)
def test_images_come_back(square, tmp_path, name):
    written = write_export(square.run(), name, tmp_path)
    frame = frame_of(written)
    centre = frame(square.centre)
    if name == "blocksexchange":
        centre[:, 2] += frame.origin[2]
    images = read_block_images(written.path, name)
    order = [list(images.image).index(image) for image in square.image]
    numbers = {"nadir": "1", "side": "2"}
    cameras = [numbers[camera] if name == "pix4d" else camera for camera in square.camera]
    assert images.camera[order].tolist() == cameras
    assert_within(images.position[order], centre, 1e-6)
    turns = matrices_of(images.angles[order])
    assert_within(turns, square.turn @ square.axes(frame), 1e-8)


@pytest.mark.parametrize("name", ["opensfm", "blocksexchange"])
def test_object_points_come_back(square, tmp_path, name):
    written = write_export(square.run(), name, tmp_path)
    frame = frame_of(written)
    points, positions = read_block_points(written.path, name)
    points = named(points.to_pylist(), written.path, name)
    assert set(points) == square.tied
    places = frame(square.places(points))
    if name == "blocksexchange":
        places[:, 2] += frame.origin[2]
    assert_within(positions, places, 1e-3)


@pytest.mark.parametrize(
    ("name", "file", "cameras"),
    [
        ("opensfm", "camera_models.json", ("nadir", "side")),
        ("opensfm", "reconstruction.json", ("nadir", "side")),
        ("pix4d", "", ("1", "2")),
        ("blocksexchange", "", ("nadir", "side")),
    ],
)
def test_cameras_come_back(square, tmp_path, name, file, cameras):
    path = write_export(square.run(), name, tmp_path).path / file
    u, v = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, -0.25]])
    for number, expected in zip(cameras, (SQUARE, SIDE), strict=True):
        camera = read_camera(path, name, number)
        assert_within(camera.project(u, v), distorted(expected, u, v), 1e-8)


def test_angles_of_pix4d_are_those_of_the_textbook(square, tmp_path):
    """In the file of X, Y, Z, omega, phi and kappa, which is not that of the matrices."""
    written = write_export(square.run(), "pix4d", tmp_path)
    frame = frame_of(written)
    file = written.path / "unbend_calibrated_external_camera_parameters.txt"
    table = pd.read_csv(file, sep=" ")
    assert table.imageName.tolist() == square.image.tolist()
    assert_within(table[["X", "Y", "Z"]], frame(square.centre), 1e-6)
    angles = table.rename(columns=lambda name: f"{name.lower()}_deg")
    photos = [rotation_to_photo(row) for _, row in angles.iterrows()]
    expected = DOWN @ square.turn @ square.axes(frame)
    assert_within(photos, expected, 1e-9)


def test_blocks_exchange_says_its_system_and_what_it_lacks(square, tmp_path):
    written = write_export(square.run(), "blocksexchange", tmp_path)
    root = ElementTree.parse(written.path).getroot()
    lat, lon, _ = frame_of(written).origin
    assert root.findtext("SpatialReferenceSystems/SRS/Definition") == f"ENU:{lat!r},{lon!r}"
    singles = int((~square.rows.point.isin(square.tied)).sum())
    assert ("note", "EXPORT-SINGLE", singles) in written.counts
    assert written.count == len(square.rows) - singles
