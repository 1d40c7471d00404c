"""Each distortion model against COLMAP's, over the image and to 85 degrees off the axis."""

import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from unbend.errors import PhysicsError
from unbend.refraction import Camera
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera import DISTORTION_MODELS
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye

pycolmap = pytest.importorskip("pycolmap")

FRAME = (1100.0, 1130.0, 2010.0, 1490.0)  # fx, fy, cx, cy of 4000 x 3000 pixels
BROWN = BrownConrady(k1=-0.08, k2=0.012, p1=4e-4, p2=-7e-4)
GENERAL = GeneralFrame(
    k1=0.09,
    k2=-0.03,
    py=5e-4,
    px=-3e-4,
    k3=0.004,
    q1=0.12,
    q2=-0.021,
    q3=0.003,
)
FISHEYE = OpenCVFisheye(-0.03, 0.008, -0.002, 3e-4)
OF_COLMAP = {
    "OPENCV": (-0.08, 0.012, 4e-4, -7e-4),
    "FULL_OPENCV": (0.09, -0.03, 5e-4, -3e-4, 0.004, 0.12, -0.021, 0.003),
    "OPENCV_FISHEYE": (-0.03, 0.008, -0.002, 3e-4),
}


def pixels_of_colmap(name, u, v):
    """(2, n) pixels of ideal image coordinates."""
    camera = pycolmap.Camera(
        model=name,
        width=4000,
        height=3000,
        params=[*FRAME, *OF_COLMAP[name]],
    )
    rays = np.stack([u, v, np.ones_like(u)], axis=1)
    return camera.img_from_cam(rays).T


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("OPENCV", BROWN),
        ("FULL_OPENCV", GENERAL),
        ("OPENCV_FISHEYE", FISHEYE),
    ],
)
def test_a_model_is_colmaps(name, parameters):
    camera = Camera(4000, 3000, *FRAME, parameters)
    x = np.tile(np.linspace(0, 4000, 41), 31)
    y = np.repeat(np.linspace(0, 3000, 31), 41)
    u, v, covered = camera.rays(x, y)
    assert covered.mean() > 0.6
    u = u[covered]
    v = v[covered]
    pixels = pixels_of_colmap(name, u, v)
    assert_near(pixels, (x[covered], y[covered]), 1e-9)
    assert_near(camera.project(u, v), pixels, 1e-9)


def directions(u, v):
    """(3, n) unit vectors of ideal image coordinates."""
    rays = np.stack([u, v, np.ones_like(u)])
    return rays / np.linalg.norm(rays, axis=0)


def test_a_fisheye_to_85_degrees():
    theta = np.tile(np.radians(np.linspace(0.0, 85.0, 86)), 32)
    azimuth = np.repeat(np.linspace(0, 6.2, 32), 86)
    u = np.tan(theta) * np.cos(azimuth)
    v = np.tan(theta) * np.sin(azimuth)

    pixels = Camera(4000, 3000, *FRAME, FISHEYE).project(u, v)

    assert_near(pixels, pixels_of_colmap("OPENCV_FISHEYE", u, v), 1e-9)
    wide = Camera(
        4000,
        3600,
        1100.0,
        1130.0,
        2010.0,
        1800.0,
        FISHEYE,
    )
    x, y = wide.project(u, v)
    inside = (x >= 0.0) & (x <= 4000.0) & (y >= 0.0) & (y <= 3600.0)
    assert np.degrees(theta[inside].max()) == 85.0
    u_again, v_again, covered = wide.rays(x[inside], y[inside])
    assert covered.all()
    # 1e-9 px: at 85 degrees a tangent of 11.4 changes by 130 for 1 of the image coordinate.
    expected = directions(u[inside], v[inside])
    assert_near(directions(u_again, v_again), expected, 2e-14)


# Every coefficient of a calibration report; a correction, which is inverted, has no denominator.
REPORT = {
    "k0": 0.01,
    "k1": 0.02,
    "k2": -0.015,
    "k3": 0.006,
    "k4": 0.003,
    "px": 3e-4,
    "py": -5e-4,
    "offset_u": 0.002,
    "offset_v": -0.003,
}


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        (
            "brown_conrady",
            BrownConrady(
                k1=-0.08,
                k2=0.012,
                k3=0.1,
                p1=4e-4,
                p2=-7e-4,
            ),
        ),
        ("general_frame", GENERAL),
        ("opencv_fisheye", FISHEYE),
        ("general_frame", GeneralFrame(**REPORT, q1=0.01, q2=-0.004, q3=0.002)),
        ("general_frame", GeneralFrame(**REPORT, sense=-1.0, steps=60.0)),
    ],
)
def test_slopes_are_the_derivatives(model, parameters):
    functions = DISTORTION_MODELS[model]
    rng = np.random.default_rng(4)
    u, v = rng.uniform(-0.9, 0.9, (2, 200))
    step = 1e-6

    def difference(du, dv):
        plus = functions.distort(u + du, v + dv, parameters)
        minus = functions.distort(u - du, v - dv, parameters)
        return np.subtract(plus, minus) / (2.0 * step)

    uu, uv, vv = functions.slopes(u, v, parameters)
    assert_near(difference(step, 0.0), (uu, uv), 1e-9)
    assert_near(difference(0.0, step), (uv, vv), 1e-9)


def test_the_axis_of_a_fisheye_is_no_special_place():
    functions = DISTORTION_MODELS["opencv_fisheye"]
    assert functions.distort(0.0, 0.0, FISHEYE) == (0.0, 0.0)
    assert functions.slopes(0.0, 0.0, FISHEYE) == (1.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("parameters", "degrees"),
    [
        (GeneralFrame(q1=1.0), 45.0),  # r / (1 + r^2) turns back at r = 1
        (GeneralFrame(q1=-4.0), np.degrees(np.arctan(0.5))),  # a pole
        (OpenCVFisheye(k1=-1.0 / 3.0), np.degrees(1.0)),  # theta - theta^3 / 3
    ],
)
def test_a_distortion_that_turns_back_ends_there(parameters, degrees):
    camera = Camera(4000, 3000, *FRAME, parameters)
    field = np.degrees(np.arctan(camera.largest_radius))
    assert_near(field, degrees, 1e-9)
    x = np.linspace(0.0, 4000.0, 400)
    u, v, covered = camera.rays(x, np.full(400, 1490.0))
    assert np.hypot(u, v)[covered].max() <= camera.largest_radius


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("FOV", [900.0, 900.0, 50.0, 50.0, 0.1]),
        ("PINHOLE", [900.0]),
        ("PINHOLE", [np.nan] * 4),
    ],
)
def test_models_and_parameters_that_are_not_known(model, parameters):
    with refused("CAMERA-MODEL", PhysicsError):
        camera_of_model(model, 100, 100, parameters)
