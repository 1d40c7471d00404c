"""Missions by Pix4D's parameters and by BlocksExchange XML, written here by their descriptions."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.helpers import refused
from tests.small_block import SmallBlock, largest_difference
from unbend.batch.runs import run_mission
from unbend.errors import InputError
from unbend.flight.rotations import matrices_of
from unbend.tables.imports.blocks import block_reader, block_rows, read_block_images, read_camera

pytestmark = pytest.mark.usefixtures("plain_report")

OFFSET = np.array([382_000.0, 5_200_000.0, 0.0])


def run(folder, observed: str, program: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Stations and observations of a run that finds nothing to object."""
    config = {
        "mission": {"name": "small"},
        "observations": {"path": observed, "format": program},
        "cameras": {"c": {"calibration": "laboratory"}},
        "stations": {"orientation": {"date": "2026-05-14", "heights": "ellipsoid"}},
        "ground": {"height": 530, "reference": "ellipsoid"},
        "atmosphere": {"adjust": False},
        "output": {"path": "results"},
    }
    (folder / "m.yaml").write_text(yaml.safe_dump(config))
    outcome = run_mission(folder / "m.yaml")
    assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    return stations, pd.read_parquet(outcome.output / "observations")


@pytest.fixture(scope="module")
def block() -> SmallBlock:
    return SmallBlock.make()


def everything(path, program: str) -> None:
    """All that a mission reads of a block."""
    read_block_images(path, program)
    for name in block_reader(program).read_cameras(path):
        read_camera(path, program, name)
    for _ in block_rows(path, program):
        pass


def refusal(path, program: str) -> str:
    with pytest.raises(InputError) as caught:
        everything(path, program)
    return str(caught.value)


def assert_pixels(path, program: str, block: SmallBlock, name) -> None:
    """Image points are those of the block, whose points ``name`` calls otherwise."""
    found = pd.concat([rows.to_pandas() for rows in block_rows(path, program)])
    found = found.sort_values(["image", "x_px"], ignore_index=True)
    wanted = block.observations.assign(point=block.observations["point"].map(name))
    wanted = wanted.sort_values(["image", "x_px"], ignore_index=True)
    assert found["image"].tolist() == wanted["image"].tolist()
    assert found["point"].tolist() == wanted["point"].tolist()
    np.testing.assert_allclose(found[["x_px", "y_px"]], wanted[["x_px", "y_px"]], atol=1e-6)


def assert_camera(path, program: str, name: str, block: SmallBlock) -> None:
    """Rays of the camera that is read meet the pixels of the block."""
    camera = read_camera(path, program, name)
    centres, rotations, points = block.in_enu()
    row = block.observations.iloc[7]
    k = block.names.index(row["image"])
    x, y, z = rotations[k] @ (points[int(row["point"]) - 1] - centres[k])
    seen = camera.project(np.array([x / z]), np.array([y / z]))
    np.testing.assert_allclose(np.ravel(seen), [row["x_px"], row["y_px"]], atol=1e-6)


# Pix4D


@pytest.fixture
def params(block, tmp_path):
    """The folder of parameters of a project of Pix4D."""
    folder = tmp_path / "params"
    block.write_pix4d(folder, 32632, offset=OFFSET)
    return folder


def test_a_project_of_pix4d(block, params):
    stations, observations = run(params.parent, "params", "pix4d")
    away, turned = largest_difference(stations, block)
    assert away < 2e-3  # the external parameters have micrometres, the offset millimetres
    assert turned < 2e-4
    assert (observations["status"] == "ok").all()
    assert_pixels(params, "pix4d", block, lambda point: str(1000 + int(point)))
    assert_camera(params, "pix4d", "1", block)


@pytest.mark.parametrize("leave_out", ["offset.xyz", "calibrated_camera_parameters.txt"])
def test_half_of_the_files_of_pix4d_do(block, tmp_path, leave_out):
    """The other file has the absolute positions; alone it has no cameras."""
    folder = tmp_path / "params"
    block.write_pix4d(folder, 32632, offset=OFFSET, leave_out=[leave_out])
    table = read_block_images(folder, "pix4d")
    centres, rotations, _ = block.in_grid(32632)
    np.testing.assert_allclose(table.position, centres, atol=1e-5)
    np.testing.assert_allclose(matrices_of(table.angles), rotations, atol=1e-9)


def test_a_file_of_pix4d_stands_for_its_project(params):
    """Another project may lie in the same folder."""
    path = params / "survey_calibrated_camera_parameters.txt"
    names = [file.name.removeprefix("survey_") for file in block_reader("pix4d").block_files(path)]
    assert names == [
        "calibrated_camera_parameters.txt",
        "calibrated_external_camera_parameters.txt",
        "offset.xyz",
        "wkt.prj",
        "tp_pix4d.txt",
    ]
    shutil.copy(path, params / "other_calibrated_camera_parameters.txt")
    assert len(read_block_images(path, "pix4d").image) == 12
    assert "2 files" in refusal(params, "pix4d")


CAMERAS = "survey_calibrated_camera_parameters.txt"


def with_skew(text: str) -> str:
    return text.replace("5000.0 0 3011.5", "5000.0 1.5 3011.5", 1)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("survey_offset.xyz", lambda _: "382000.5 5200000.0 0.0", "0.5 m away"),
        ("survey_offset.xyz", lambda _: "382000.5 5200000.0", "offset.xyz"),
        (CAMERAS, with_skew, "skew"),
        (CAMERAS, lambda text: text[: len(text) // 2], "is not"),
        (CAMERAS, lambda text: text[:-30], "is not"),
        (CAMERAS, lambda text: text[:20], "is not"),
    ],
)
def test_what_of_pix4d_cannot_be_read(params, name, change, words):
    path = params / name
    path.write_text(change(path.read_text()))
    said = refusal(params, "pix4d")
    assert words in said
    assert words != "is not" or re.search(r"line \d+ is not", said)


def test_files_of_pix4d_that_are_not_there(block, params, tmp_path):
    (params / "survey_tp_pix4d.txt").unlink()
    assert "tp_pix4d.txt" in refusal(params, "pix4d")
    external = "calibrated_external_camera_parameters.txt"
    half = tmp_path / "half"
    block.write_pix4d(half, 32632, offset=OFFSET, leave_out=["offset.xyz", external])
    assert "offset" in refusal(half, "pix4d")
    with refused("INPUT-MISSING"):
        block_reader("pix4d").block_files(tmp_path)


# BlocksExchange


@pytest.fixture
def xml(block, tmp_path):
    """A block in the axes of one place."""
    path = tmp_path / "b.xml"
    block.write_blocks_exchange(path, "ENU:46.95,7.45")
    return path


@pytest.mark.parametrize("system", ["ENU:46.95,7.45", "EPSG:32632", "WGS84"])
def test_a_block_of_blocks_exchange(block, tmp_path, system):
    path = tmp_path / "b.xml"
    known = np.stack([block.lat, block.lon, block.h - 47.0], axis=1)
    block.write_blocks_exchange(path, system, known=known)
    stations, observations = run(tmp_path, "b.xml", "blocksexchange")
    away, turned = largest_difference(stations, block)
    assert away < 1e-3
    assert turned < 1e-4
    assert (observations["status"] == "ok").all()
    assert_pixels(path, "blocksexchange", block, lambda point: f"tie:{point}")
    assert_camera(path, "blocksexchange", "c", block)
    names, places = block_reader("blocksexchange").read_points(path)
    assert names[8].as_py() == "tie:9"
    assert len(places) == 60


@pytest.mark.parametrize("orientation", ["XRightYUp", "XLeftYDown", "XDownYRight"])
@pytest.mark.parametrize("angles", [False, True])
def test_axes_of_the_camera(block, tmp_path, orientation, angles):
    """Poses, the principal point and measurements in millimetres follow them."""
    path = tmp_path / "b.xml"
    block.write_blocks_exchange(
        path, "ENU:46.95,7.45", orientation=orientation, angles=angles, millimetres=True
    )
    table = read_block_images(path, "blocksexchange")
    centres, rotations, _ = block.in_enu()
    np.testing.assert_allclose(matrices_of(table.angles), rotations, atol=1e-9)
    np.testing.assert_allclose(table.position, centres, atol=1e-9)
    assert_pixels(path, "blocksexchange", block, lambda point: f"tie:{point}")
    assert_camera(path, "blocksexchange", "c", block)


def test_the_example_of_the_vendor(block, tmp_path):
    """Omega, phi and kappa of the commented example are those of its matrix, of French Paris."""
    matrix = np.array(
        [
            [-0.9999982912233401, -0.001636319085375301, -0.0008602425863163225],
            [-0.001631068695467463, 0.9999802528616577, -0.00606906089589293],
            [0.0008701565192966738, -0.006067647409696231, -0.9999812130648239],
        ]
    )
    path = tmp_path / "b.xml"
    block.write_blocks_exchange(path, "EPSG:2154", angles=True)
    angles = "<Omega>179.6523471469934</Omega><Phi>0.04985630236313049</Phi>"
    angles += "<Kappa>179.9065465708369</Kappa>"
    rotation = f"<Rotation>{angles}</Rotation>"
    path.write_text(re.sub(r"<Rotation>.*?</Rotation>", rotation, path.read_text(), count=1))
    read = matrices_of(read_block_images(path, "blocksexchange").angles)[0]
    assert np.degrees(Rotation.from_matrix(read @ matrix.T).magnitude()) < 1e-6


def test_photos_without_an_estimated_pose_have_none(xml):
    text = xml.read_text()
    xml.write_text(text.replace("</Rotation>", "<Accurate> False </Accurate></Rotation>", 1))
    table = read_block_images(xml, "blocksexchange")
    assert np.isnan(table.angles[0]).all()
    assert np.isfinite(table.angles[1:]).all()


@pytest.mark.parametrize(
    ("pattern", "replacement", "words"),
    [
        (r"<M_00>.*?</M_22>", "<Yaw>1</Yaw><Pitch>2</Pitch><Roll>3</Roll>", "Yaw, Pitch, Roll"),
        ("Perspective", "Fisheye", "Fisheye"),
        ("<Skew>0", "<Skew>0.1", "Skew"),
        ("<PhotoId>5<", "<PhotoId>99<", "photo 99"),
        ("BlocksExchange", "Other", "Other"),
        (r"<Block>(.*)</Block>", r"<Block>\1</Block><Block/>", "2 blocks"),
        ("<Photogroup>", "<Photogroup><SRSId>9</SRSId>", "another spatial reference"),
        ("XRightYDown", "XRightYLeft", "XRightYLeft"),
        ("</Id><ImagePath>", "</Id><Path>", "not valid XML"),
    ],
)
def test_what_of_blocks_exchange_cannot_be_read(xml, pattern, replacement, words):
    text = xml.read_text()
    changed = re.sub(pattern, replacement, text)
    assert changed != text
    xml.write_text(changed)
    assert words in refusal(xml, "blocksexchange")


def test_a_folder_is_no_blocks_exchange(tmp_path):
    with pytest.raises(InputError, match="it is a folder"):
        block_reader("blocksexchange").block_files(tmp_path)


def test_names_that_repeat_have_their_folder(xml):
    xml.write_text(xml.read_text().replace("flight\\IMG_0007", "other\\IMG_0001"))
    names = read_block_images(xml, "blocksexchange").image.tolist()
    assert names[0] == "flight/IMG_0001.JPG"
    assert names[6] == "other/IMG_0001.JPG"
    assert names[7] == "IMG_0008.JPG"
