"""Pix4D's parameters and BlocksExchange XML: what is written, by own formulas, and back again."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial.transform import Rotation

from unbend.errors import MissionError
from unbend.flight.rotations import matrices_of
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import ExportCamera
from unbend.tables.imports.blocks import block_rows, read_block_images, read_camera

sys.path.insert(0, str(Path(__file__).parent))
import test_blocks
from test_blocks import Block, distorted, in_frame, origin_of, table_of, written

SQUARE = replace(test_blocks.NADIR, fy_px=test_blocks.NADIR.fx_px)
NAMES = {"pix4d": "pix4d", "blocksexchange": "blocksexchange"}


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(test_blocks, "NADIR", SQUARE)
        yield Block(tmp_path_factory.mktemp("block"))


@pytest.fixture
def run(block, monkeypatch):
    monkeypatch.setattr(test_blocks, "NADIR", SQUARE)
    return block.run()


def frame_axes(block: Block, origin) -> list[np.ndarray]:
    """(3, 3) from the frame to the east, north, up of each station, by PROJ."""
    to_frame = block.frame(origin)
    axes = []
    for lon, lat, centre in zip(block.lon, block.lat, block.centre, strict=True):
        enu = Rotation.from_euler("ZX", [90.0 + lon, 90.0 - lat], degrees=True).as_matrix()
        ends = [np.array(to_frame.transform(*(centre + 1e3 * enu[:, k]))) for k in range(3)]
        here = np.array(to_frame.transform(*centre))
        axes.append(np.array([(end - here) * 1e-3 for end in ends]))
    return axes


@pytest.mark.parametrize("name", NAMES)
def test_there_and_back(block, run, tmp_path, name):
    path, ledger = written(run, name, tmp_path)
    origin = origin_of(ledger)
    found = read_block_images(path, name)
    order = [list(found.image).index(image) for image in block.image]
    centre = in_frame(block, origin, block.centre)
    if name == "blocksexchange":
        centre = centre + np.array([0.0, 0.0, origin[2]])
    np.testing.assert_allclose(found.position[order], centre, atol=1e-6)
    turns = matrices_of(found.angles[order])
    for turn, given, axes in zip(turns, block.turn, frame_axes(block, origin), strict=True):
        np.testing.assert_allclose(turn, given @ axes, atol=1e-8)
    table = pa.Table.from_batches(block_rows(path, name)).to_pandas()
    kept = [row for row in block.rows if name == "pix4d" or row[1] in block.tied]
    assert len(table) == len(kept)
    pixels = {(row[0], row[1]): row[2:4] for row in kept}
    for row in table.itertuples():
        wanted = pixels[row.image, row.point]
        np.testing.assert_allclose([row.x_px, row.y_px], wanted, atol=1e-8)
    camera = read_camera(path, name, "1" if name == "pix4d" else "nadir")
    u, v = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, -0.25]])
    np.testing.assert_allclose(camera.project(u, v), distorted(SQUARE, u, v), atol=1e-8)


def test_numbers_of_pix4d_are_those_of_its_formula(block, run, tmp_path):
    """m = K [R | -R t] X for a point, and angles by the textbook."""
    path, ledger = written(run, "pix4d", tmp_path)
    lines = (path / "unbend_calibrated_camera_parameters.txt").read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(f"{block.image[0]} "))
    k = np.array([line.split() for line in lines[start + 1 : start + 4]], float)
    t = np.array(lines[start + 6].split(), float)
    r = np.array([line.split() for line in lines[start + 7 : start + 10]], float)
    row = block.of_image[block.image[0]][0]
    (place,) = in_frame(block, origin_of(ledger), [block.place[row[1]]])
    m = k @ r @ (place - t)
    u = row[5]
    v = row[6]
    np.testing.assert_allclose(m[:2] / m[2], k[:2, :2] @ [u, v] + k[:2, 2], atol=1e-4)
    external = (path / "unbend_calibrated_external_camera_parameters.txt").read_text()
    fields = external.splitlines()[1].split()
    omega, phi, kappa = np.radians(np.array(fields[4:], float))
    image = np.diag([1.0, -1.0, -1.0]) @ r  # x right, y up, z back
    np.testing.assert_allclose(image[2, 0], np.sin(phi), atol=1e-9)
    np.testing.assert_allclose(image[2, 1], -np.sin(omega) * np.cos(phi), atol=1e-9)
    np.testing.assert_allclose(image[1, 0], -np.cos(phi) * np.sin(kappa), atol=1e-9)


def test_numbers_of_blocks_exchange(block, run, tmp_path):
    """Half a pixel, the tangential coefficients, and heights from the ellipsoid."""
    path, ledger = written(run, "blocksexchange", tmp_path)
    root = ElementTree.parse(path).getroot()
    lat, lon, _ = origin_of(ledger)
    assert root.findtext("SpatialReferenceSystems/SRS/Definition") == f"ENU:{lat!r},{lon!r}"
    group = root.find("Block/Photogroups/Photogroup")
    assert float(group.findtext("PrincipalPoint/x")) == SQUARE.cx_px - 0.5
    assert float(group.findtext("Distortion/P1")) == SQUARE.distortion.p2
    assert float(group.findtext("Distortion/P2")) == SQUARE.distortion.p1
    heights = [float(z.text) for z in root.iter("z")]
    assert 300.0 < min(heights) < 700.0  # of the points, above the ellipsoid
    singles = sum(row[1] not in block.tied for row in block.rows)
    (told,) = [entry for entry in ledger if entry.code == "EXPORT-SINGLE"]
    assert (told.kind, told.count) == ("note", singles)
    assert singles > 0


def test_cameras_that_the_formats_do_not_hold_are_refused(block, run, tmp_path):
    fisheye = replace(SQUARE, distortion=OpenCVFisheye(0.01, 0.0, 0.0, 0.0))
    for name, camera in (
        ("pix4d", fisheye),
        ("blocksexchange", fisheye),
        ("blocksexchange", replace(SQUARE, fy_px=19_990.0)),
    ):
        cameras = dict(run.cameras) | {"nadir": ExportCamera(camera, False)}
        with pytest.raises(MissionError) as refused:
            written(replace(run, cameras=cameras), name, tmp_path)
        assert refused.value.code == "EXPORT-DISTORTION"
        if (tmp_path / "pix4d").exists():
            (tmp_path / "pix4d").rmdir()


def test_names_that_pix4d_cannot_tell_apart_are_refused(block, run, tmp_path):
    import pyarrow.parquet as pq

    names = {old: f"same.{k}" for k, old in enumerate(block.image)}
    path = tmp_path / "again.parquet"
    pq.write_table(table_of([(names[i], *rest) for i, *rest in block.rows]), path)
    image = np.array([names[old] for old in block.image], object)
    changed = replace(run, parts=(path,), stations=replace(run.stations, image=image))
    with pytest.raises(MissionError) as refused:
        written(changed, "pix4d", tmp_path)
    assert refused.value.code == "EXPORT-NAMES"
