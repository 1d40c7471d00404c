"""Cameras of other programs, against those programs' own formulas, libraries and blocks."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from tests.helpers import refused
from tests.lens import brown, metashape_pixels
from tests.tables.checks import assert_within, refused_with
from unbend.refraction.calibration import camera_of_model
from unbend.tables.imports.blocks import read_camera

U = np.linspace(-0.5, 0.5, 9)
V = np.linspace(-0.4, 0.4, 7)
RAYS = np.reshape(np.meshgrid(U, V), (2, -1))


def projected(camera):
    return np.transpose(camera.project(*RAYS))


# COLMAP

COLMAP = {
    1: ("SIMPLE_RADIAL", [3200.0, 2001.5, 1502.25, -0.05]),
    2: (
        "FULL_OPENCV",
        [3200.0, 3210.0, 1990.0, 1510.0, 0.08, -0.02, 2e-4, -3e-4, 1e-3, 0.1, -0.01, 1e-3],
    ),
    7: ("OPENCV_FISHEYE", [1500.0, 1510.0, 1990.0, 1510.0, -0.02, 0.004, -1e-3, 1e-4]),
    9: ("FOV", [1500.0, 1510.0, 1990.0, 1510.0, 0.9]),
    11: ("PINHOLE", [3200.0, 3201.0, 2001.5, 1502.25]),
}


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("cameras.txt", pycolmap.Reconstruction.write_text),
        ("cameras.bin", pycolmap.Reconstruction.write_binary),
    ],
)
def test_what_pycolmap_writes(name, write):
    """Models and parameters; that they project as COLMAP's is tested with the mission file's."""
    path = Path(name)
    block = pycolmap.Reconstruction()
    for number, (model, params) in COLMAP.items():
        camera = pycolmap.Camera(
            model=model,
            width=4000,
            height=3000,
            params=params,
            camera_id=number,
        )
        block.add_camera(camera)
    write(block, ".")

    for number in (1, 2, 7, 11):
        model, params = COLMAP[number]
        expected = camera_of_model(model, 4000, 3000, params)
        assert read_camera(path, None, str(number)) == expected
    with refused("CAMERA-MODEL"):
        read_camera(path, None, "9")
    with refused_with("CAMERA-NAME", "'1', '2', '7', '9', '11'"):
        read_camera(path, None, None)


# OpenSfM

COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2", "c_x", "c_y")


def opensfm_projection(camera, u, v):
    """(n, 2) image points of (u, v, 1), in units of the longer side, from the image's centre."""
    k1, k2, k3, k4, p1, p2, c_x, c_y = (camera.get(name, 0.0) for name in COEFFICIENTS)
    r2 = u * u + v * v
    if "fisheye" in camera["projection_type"]:
        theta = np.arctan(np.sqrt(r2))
        series = 1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8
        bent = theta * series / np.sqrt(r2 + 1e-300)
        x = u * bent
        y = v * bent
    else:
        x, y = brown(u, v, k1, k2, p1, p2, k3)
    focal_x = camera.get("focal", camera.get("focal_x"))
    focal_y = camera.get("focal", camera.get("focal_y"))
    return np.transpose([focal_x * x + c_x, focal_y * y + c_y])


MODELS = {
    "brown": """{"projection_type": "brown", "width": 4000, "height": 3000,
        "focal_x": 0.85, "focal_y": 0.852, "c_x": 0.003, "c_y": -0.002,
        "k1": -0.03, "k2": 0.01, "k3": -0.002, "p1": 4e-4, "p2": -7e-4}""",
    "upright": """{"projection_type": "brown", "width": 3000, "height": 4000,
        "focal_x": 0.85, "focal_y": 0.852, "c_x": 0.003, "c_y": -0.002,
        "k1": -0.03, "k2": 0.01, "k3": -0.002, "p1": 4e-4, "p2": -7e-4}""",
    "perspective": """{"projection_type": "perspective", "width": 3264, "height": 2448,
        "focal": 0.87, "k1": 0.0885, "k2": -0.2324}""",
    "fisheye": """{"projection_type": "fisheye", "width": 4000, "height": 3000,
        "focal": 0.5, "k1": -0.02, "k2": 0.003}""",
    "fisheye_opencv": """{"projection_type": "fisheye_opencv", "width": 4000, "height": 3000,
        "focal_x": 0.5, "focal_y": 0.501, "c_x": 0.01, "c_y": 0.002,
        "k1": -0.02, "k2": 0.003, "k3": 1e-3, "k4": -1e-4}""",
}


@pytest.mark.parametrize("name", MODELS)
def test_opensfm(name):
    """Normalised by the longer side, from the centre of the image."""
    path = Path("camera_models.json")
    path.write_text(f'{{"v2 dji fc 1": {MODELS[name]}}}')
    model = json.loads(MODELS[name])

    camera = read_camera(path, None, None)

    size_px = np.array([model["width"], model["height"]])
    expected = opensfm_projection(model, *RAYS) * size_px.max() + size_px / 2
    assert_within(projected(camera), expected, 1e-9)


# Metashape

FRAME = {
    "width": 5472,
    "height": 3648,
    "f": 3666.5,
    "cx": 12.75,
    "cy": -20.5,
    "b1": 1.25,
    "b2": -0.75,
    "k1": -0.05,
    "k2": 0.02,
    "k3": -0.004,
    "k4": 0.0006,
    "p1": 4e-4,
    "p2": -9e-4,
}


def calibration(numbers, kind="frame"):
    tags = "".join(f"<{name}>{value!r}</{name}>" for name, value in numbers.items())
    return f"<calibration><projection>{kind}</projection>{tags}</calibration>"


@pytest.mark.parametrize(
    ("left_out", "kind"),
    [
        ((), "frame"),
        (("k4",), "frame"),
        (("b2",), "frame"),
        (("k4", "b2"), "frame"),
        (("p1", "p2", "b2"), "fisheye"),
    ],
)
def test_metashape(left_out, kind):
    numbers = {name: value for name, value in FRAME.items() if name not in left_out}
    path = Path("calibration.xml")
    path.write_text(calibration(numbers, kind))

    camera = read_camera(path, None, None)

    expected = metashape_pixels(numbers, kind, *RAYS).T
    assert_within(projected(camera), expected, 1e-9)
    u, v, covered = camera.rays(*expected.T)
    assert covered.sum() > 40
    assert_within((u[covered], v[covered]), RAYS[:, covered], 1e-12)


def document(*calibrations):
    sensors = "".join(
        f'<sensor id="{i}" label="FC6310">{text}</sensor>' for i, text in enumerate(calibrations)
    )
    return f'<document version="2.0"><chunk><sensors>{sensors}</sensors></chunk></document>'


def of_class(name, f):
    return (
        f'<calibration type="frame" class="{name}"><resolution width="100" height="80"/>'
        f"<f>{f}</f></calibration>"
    )


def test_the_adjusted_calibration_counts():
    path = Path("cameras.xml")
    initial = of_class("initial", 90.0)
    adjusted = of_class("adjusted", 95.0)

    path.write_text(document(initial + adjusted))
    assert read_camera(path, None, None).fx_px == 95.0

    path.write_text(document(initial))
    with refused_with("IMPORT-FORMAT", "no adjusted calibration"):
        read_camera(path, None, None)

    path.write_text(document('<property name="fixed" value="true"/>' + initial))
    assert read_camera(path, None, None).fx_px == 90.0

    path.write_text(document(adjusted, of_class("adjusted", 96.0)))
    assert read_camera(path, None, "FC6310 1").fx_px == 96.0


# What is no file of a program


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("cameras.txt", "1 PINHOLE 4000\n", "IMPORT-FORMAT"),
        ("cameras.txt", "1 PINHOLE 4000 3000 1.0\n", "CAMERA-MODEL"),
        ("cameras.txt", "# nothing\n", "CAMERA-NAME"),
        ("cameras.bin", "text", "IMPORT-FORMAT"),
        ("models.json", "{", "IMPORT-FORMAT"),
        ("models.json", '{"a": {"width": 5}}', "IMPORT-FORMAT"),
        ("models.json", '[{"cameras": {}}, {"cameras": {}}]', "IMPORT-FORMAT"),
        (
            "models.json",
            '{"a": {"projection_type": "spherical", "width": 9, "height": 4}}',
            "CAMERA-MODEL",
        ),
        ("calibration.xml", "<calibration>", "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME | {"p3": 0.1}), "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME, "fisheye"), "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME, "spherical"), "CAMERA-MODEL"),
        ("block.psz", "no archive", "IMPORT-FORMAT"),
        ("camera.cal", "", "IMPORT-FORMAT"),
    ],
)
def test_what_cannot_be_read_is_refused(name, content, code):
    path = Path(name)
    path.write_text(content)
    with refused(code) as refusal:
        read_camera(path, None, None)
    file, _, camera = refusal.value.where.partition(", camera ")
    assert file == str(path)
    if code == "CAMERA-MODEL":
        assert camera in {"1, line 1", "a", "calibration"}, "which of them"
