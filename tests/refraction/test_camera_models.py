"""Each distortion model against COLMAP's, over the image and to 85 degrees off the axis."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import PhysicsError
from unbend.refraction import Camera
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera import DISTORTION_MODELS
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye

pycolmap = pytest.importorskip("pycolmap")

FRAME = (1100.0, 1130.0, 2010.0, 1490.0)  # fx, fy, cx, cy of 4000 x 3000 pixels
CASES = [
    ("OPENCV", BrownConrady(k1=-0.08, k2=0.012, p1=4e-4, p2=-7e-4), (-0.08, 0.012, 4e-4, -7e-4)),
    (
        "FULL_OPENCV",
        GeneralFrame(k1=0.09, k2=-0.03, py=5e-4, px=-3e-4, k3=0.004, q1=0.12, q2=-0.021, q3=0.003),
        (0.09, -0.03, 5e-4, -3e-4, 0.004, 0.12, -0.021, 0.003),
    ),
    ("OPENCV_FISHEYE", OpenCVFisheye(-0.03, 0.008, -0.002, 3e-4), (-0.03, 0.008, -0.002, 3e-4)),
]  # fmt: skip


def both(name, parameters, theirs):
    camera = Camera(4000, 3000, *FRAME, parameters)
    reference = pycolmap.Camera(model=name, width=4000, height=3000, params=[*FRAME, *theirs])
    return camera, reference


@pytest.mark.parametrize(("name", "parameters", "theirs"), CASES)
def test_a_model_is_colmaps(name, parameters, theirs):
    camera, reference = both(name, parameters, theirs)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 4000, 41), np.linspace(0, 3000, 31)))
    u, v, covered = camera.rays(x, y)
    assert covered.mean() > 0.6
    there = reference.img_from_cam(np.stack([u, v, np.ones_like(u)], axis=1)[covered])
    np.testing.assert_allclose(there, np.stack([x, y], axis=1)[covered], rtol=0.0, atol=1e-9)
    again = np.stack(camera.project(u[covered], v[covered]), axis=1)
    np.testing.assert_allclose(again, there, rtol=0.0, atol=1e-9)


def test_a_fisheye_to_85_degrees():
    camera, reference = both(*CASES[2])
    theta, azimuth = np.meshgrid(np.radians(np.linspace(0.0, 85.0, 86)), np.linspace(0, 6.2, 32))
    u = np.tan(theta) * np.cos(azimuth)
    v = np.tan(theta) * np.sin(azimuth)
    u = u.ravel()
    v = v.ravel()
    there = reference.img_from_cam(np.stack([u, v, np.ones_like(u)], axis=1))
    x, y = camera.project(u, v)
    np.testing.assert_allclose(np.stack([x, y], axis=1), there, rtol=0.0, atol=1e-9)
    wide = Camera(4000, 3600, 1100.0, 1130.0, 2010.0, 1800.0, CASES[2][1])
    x, y = wide.project(u, v)
    u_again, v_again, covered = wide.rays(x, y)
    inside = (x >= 0.0) & (x <= 4000.0) & (y >= 0.0) & (y <= 3600.0)
    assert np.degrees(theta.ravel()[inside].max()) == 85.0
    assert covered[inside].all()
    # 1e-9 px: at 85 degrees a tangent of 11.4 changes by 130 for 1 of the image coordinate.
    direction = np.stack([u, v, np.ones_like(u)]) / np.sqrt(1.0 + u * u + v * v)
    found = np.stack([u_again, v_again, np.ones_like(u)]) / np.sqrt(1 + u_again**2 + v_again**2)
    np.testing.assert_allclose(found[:, inside], direction[:, inside], rtol=0.0, atol=2e-14)


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
    "parameters",
    [
        *(case[1] for case in CASES),
        GeneralFrame(**REPORT, q1=0.01, q2=-0.004, q3=0.002),
        GeneralFrame(**REPORT, sense=-1.0, steps=60.0),
    ],
)
def test_slopes_are_the_derivatives(parameters):
    model = next(m for m in DISTORTION_MODELS.values() if m.Parameters is type(parameters))
    rng = np.random.default_rng(4)
    step = 1e-6
    u, v = rng.uniform(-0.9, 0.9, (2, 200))
    by_u = np.subtract(
        model.distort(u + step, v, parameters), model.distort(u - step, v, parameters)
    ) / (2.0 * step)
    by_v = np.subtract(
        model.distort(u, v + step, parameters), model.distort(u, v - step, parameters)
    ) / (2.0 * step)
    uu, uv, vv = model.slopes(u, v, parameters)
    for got, wanted in ((by_u[0], uu), (by_u[1], uv), (by_v[0], uv), (by_v[1], vv)):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-9)


def test_the_axis_of_a_fisheye_is_no_special_place():
    assert [
        float(c) for c in DISTORTION_MODELS["opencv_fisheye"].distort(0.0, 0.0, CASES[2][1])
    ] == [0.0, 0.0]
    slopes = DISTORTION_MODELS["opencv_fisheye"].slopes(0.0, 0.0, CASES[2][1])
    assert [float(s) for s in slopes] == [1.0, 0.0, 1.0]


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
    assert np.degrees(np.arctan(camera.largest_radius)) == pytest.approx(degrees, abs=1e-9)
    x = np.linspace(0.0, 4000.0, 400)
    y = np.full(400, 1490.0)
    u, v, covered = camera.rays(x, y)
    assert np.hypot(u, v)[covered].max() <= camera.largest_radius


@pytest.mark.parametrize(
    ("model", "params"),
    [("FOV", [900.0, 900.0, 50.0, 50.0, 0.1]), ("PINHOLE", [900.0]), ("PINHOLE", [np.nan] * 4)],
)
def test_models_and_parameters_that_are_not_known(model, params):
    with pytest.raises(PhysicsError) as refused:
        camera_of_model(model, 100, 100, params)
    assert refused.value.code == "CAMERA-MODEL"
