"""Missions by Pix4D's parameters and by BlocksExchange XML, written here by their descriptions."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import refused
from tests.small_block import SmallBlock, largest_difference
from tests.stages.small_missions import mission_of, rows_of, run
from unbend.errors import InputError
from unbend.flight.rotations import matrices_of
from unbend.tables.imports.blocks import (
    block_reader,
    block_rows,
    read_block_images,
    read_camera,
)

OFFSET = np.array([382_000.0, 5_200_000.0, 0.0])
EXCHANGE = "blocksexchange"
KEY = ["image", "x_px"]


def stations_of(folder, observed, program):
    """The stations of a run that corrects all observations and objects to nothing."""
    mission = mission_of(observed, program, heights="ellipsoid")
    mission["ground"] = {"height": 530, "reference": "ellipsoid"}
    stations, _ = run(folder, mission)
    assert (rows_of(folder)["status"] == "ok").all()
    return stations


@pytest.fixture(scope="module")
def block():
    return SmallBlock.make()


def read_all(path, program):
    """All that a mission reads of a block."""
    read_block_images(path, program)
    for name in block_reader(program).read_cameras(path):
        read_camera(path, program, name)
    for _ in block_rows(path, program):
        pass


def refusal(path, program):
    with pytest.raises(InputError) as caught:
        read_all(path, program)
    return str(caught.value)


def tie(point):
    return f"tie:{point}"


def assert_pixels(path, program, block, name):
    """Image points are those of the block, whose points ``name`` calls otherwise."""
    rows = pd.concat([rows.to_pandas() for rows in block_rows(path, program)])
    rows = rows.sort_values(KEY, ignore_index=True)
    expected = block.observations.sort_values(KEY, ignore_index=True)
    assert rows["image"].tolist() == expected["image"].tolist()
    assert rows["point"].tolist() == expected["point"].map(name).tolist()
    pixels = ["x_px", "y_px"]
    assert_allclose(rows[pixels], expected[pixels], atol=1e-6)


def assert_camera(path, program, name, block):
    """Rays of the camera that is read meet the pixels of the block."""
    camera = read_camera(path, program, name)
    centres, rotations, points = block.in_enu()
    row = block.observations.iloc[7]
    k = block.names.index(row["image"])
    point = points[int(row["point"]) - 1]
    x, y, z = rotations[k] @ (point - centres[k])
    pixel = camera.project(np.array([x / z]), np.array([y / z]))
    assert_allclose(np.ravel(pixel), [row["x_px"], row["y_px"]], atol=1e-6)


# Pix4D

CAMERAS = "survey_calibrated_camera_parameters.txt"


@pytest.fixture
def params(block, tmp_path):
    """The folder of parameters of a project of Pix4D."""
    folder = tmp_path / "params"
    block.write_pix4d(folder, 32632, offset=OFFSET)
    return folder


def number_of_pix4d(point):
    return str(1000 + int(point))


def test_a_project_of_pix4d(block, params):
    stations = stations_of(params.parent, "params", "pix4d")
    away_m, turned_deg = largest_difference(stations, block)
    assert away_m < 2e-3  # the external parameters have micrometres, the offset millimetres
    assert turned_deg < 2e-4
    assert_pixels(params, "pix4d", block, number_of_pix4d)
    assert_camera(params, "pix4d", "1", block)


@pytest.mark.parametrize("leave_out", ["offset.xyz", "calibrated_camera_parameters.txt"])
def test_half_of_the_files_of_pix4d_do(block, tmp_path, leave_out):
    """The other file has the absolute positions; alone it has no cameras."""
    folder = tmp_path / "params"
    block.write_pix4d(folder, 32632, offset=OFFSET, leave_out=[leave_out])
    table = read_block_images(folder, "pix4d")
    centres, rotations, _ = block.in_grid(32632)
    assert_allclose(table.position, centres, atol=1e-5)
    assert_allclose(matrices_of(table.angles), rotations, atol=1e-9)


def test_a_file_of_pix4d_stands_for_its_project(params):
    """Another project may lie in the same folder."""
    path = params / CAMERAS
    files = block_reader("pix4d").block_files(path)
    assert [file.name for file in files] == [
        CAMERAS,
        "survey_calibrated_external_camera_parameters.txt",
        "survey_offset.xyz",
        "survey_wkt.prj",
        "survey_tp_pix4d.txt",
    ]
    shutil.copy(path, params / "other_calibrated_camera_parameters.txt")
    assert len(read_block_images(path, "pix4d").image) == 12
    assert "2 files" in refusal(params, "pix4d")


@pytest.mark.parametrize(
    ("offset", "words"),
    [
        ("382000.5 5200000.0 0.0", "0.5 m away"),
        ("382000.5 5200000.0", "offset.xyz"),
    ],
)
def test_an_offset_of_pix4d_that_cannot_be_used(params, offset, words):
    (params / "survey_offset.xyz").write_text(offset)
    assert words in refusal(params, "pix4d")


def test_pixels_of_pix4d_that_are_not_square(params):
    path = params / CAMERAS
    text = path.read_text()
    path.write_text(text.replace("5000.0 0 3011.5", "5000.0 1.5 3011.5", 1))
    assert "skew" in refusal(params, "pix4d")


@pytest.mark.parametrize("end", ["half", -30, 20])
def test_parameters_of_pix4d_that_end_too_early(params, end):
    path = params / CAMERAS
    text = path.read_text()
    if end == "half":
        end = len(text) // 2
    path.write_text(text[:end])
    assert re.search(r"line \d+ is not", refusal(params, "pix4d"))


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


ENU = "ENU:46.95,7.45"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "b.xml"


@pytest.fixture
def xml(block, path):
    """A block in the axes of one place."""
    block.write_blocks_exchange(path, ENU)
    return path


@pytest.mark.parametrize("system", [ENU, "EPSG:32632", "WGS84"])
def test_a_block_of_blocks_exchange(block, path, system):
    references = np.column_stack([block.lat, block.lon, block.h - 47.0])
    block.write_blocks_exchange(path, system, known=references)
    stations = stations_of(path.parent, path.name, EXCHANGE)
    away_m, turned_deg = largest_difference(stations, block)
    assert away_m < 1e-3
    assert turned_deg < 1e-4
    assert_pixels(path, EXCHANGE, block, tie)
    assert_camera(path, EXCHANGE, "c", block)
    names, places = block_reader(EXCHANGE).read_points(path)
    assert names[8].as_py() == "tie:9"
    assert len(places) == 60


@pytest.mark.parametrize("orientation", ["XRightYUp", "XLeftYDown", "XDownYRight"])
@pytest.mark.parametrize("angles", [False, True])
def test_axes_of_the_camera(block, path, orientation, angles):
    """Poses, the principal point and measurements in millimetres follow them."""
    block.write_blocks_exchange(
        path,
        ENU,
        orientation=orientation,
        angles=angles,
        millimetres=True,
    )
    table = read_block_images(path, EXCHANGE)
    centres, rotations, _ = block.in_enu()
    assert_allclose(matrices_of(table.angles), rotations, atol=1e-9)
    assert_allclose(table.position, centres, atol=1e-9)
    assert_pixels(path, EXCHANGE, block, tie)
    assert_camera(path, EXCHANGE, "c", block)


def test_the_example_of_the_vendor(block, path):
    """Omega, phi and kappa of the commented example are those of its matrix, of French Paris."""
    matrix = np.array(
        [
            [-0.9999982912233401, -0.001636319085375301, -0.0008602425863163225],
            [-0.001631068695467463, 0.9999802528616577, -0.00606906089589293],
            [0.0008701565192966738, -0.006067647409696231, -0.9999812130648239],
        ]
    )
    rotation = (
        "<Rotation><Omega>179.6523471469934</Omega><Phi>0.04985630236313049</Phi>"
        "<Kappa>179.9065465708369</Kappa></Rotation>"
    )
    block.write_blocks_exchange(path, "EPSG:2154", angles=True)
    text = re.sub(r"<Rotation>.*?</Rotation>", rotation, path.read_text(), count=1)
    path.write_text(text)

    first, *_ = matrices_of(read_block_images(path, EXCHANGE).angles)

    turned_rad = Rotation.from_matrix(first @ matrix.T).magnitude()
    assert np.degrees(turned_rad) < 1e-6


def test_photos_without_an_estimated_pose_have_none(xml):
    text = xml.read_text()
    xml.write_text(text.replace("</Rotation>", "<Accurate> False </Accurate></Rotation>", 1))
    first, *later = read_block_images(xml, EXCHANGE).angles
    assert np.isnan(first).all()
    assert np.isfinite(later).all()


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
    assert words in refusal(xml, EXCHANGE)


def test_a_folder_is_no_blocks_exchange(tmp_path):
    with pytest.raises(InputError, match="it is a folder"):
        block_reader(EXCHANGE).block_files(tmp_path)


def test_names_that_repeat_have_their_folder(xml):
    text = xml.read_text()
    xml.write_text(text.replace("flight\\IMG_0007", "other\\IMG_0001"))
    names = read_block_images(xml, EXCHANGE).image
    assert names[0] == "flight/IMG_0001.JPG"
    assert names[6] == "other/IMG_0001.JPG"
    assert names[7] == "IMG_0008.JPG"
