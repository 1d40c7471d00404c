"""Cameras that cannot be, and their fields of view."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from unbend.errors import PhysicsError
from unbend.refraction import BrownConrady, Camera
from unbend.refraction.calibration import camera_of_model, field_of_view, refuse_impossible
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye

UNDISTORTED = BrownConrady()


def camera(width, height, focal, distortion=UNDISTORTED):
    return Camera(
        width,
        height,
        focal,
        focal,
        width / 2,
        height / 2,
        distortion,
    )


PHONE = camera(3264, 2448, 2838.6, BrownConrady(0.0885, -0.2324))
THIRD = -1.0 / 3.0  # r - r^3 / 3 turns at r = 1


@pytest.mark.parametrize(
    "sound",
    [
        replace(
            camera(14000, 10600, 20000.0, BrownConrady(-0.018, 0.009, -0.002)),
            cx_px=7012.0,
            cy_px=5290.0,
        ),
        replace(
            camera(4000, 3000, 2700.0, BrownConrady(-0.3, 0.12, -0.02, 1e-3)),
            cx_px=2010.0,
            cy_px=1490.0,
        ),
        PHONE,
        # A lens of 2.3 degrees, whose large coefficients are 0.2 % of its image.
        camera(2400, 1600, 60000.0, BrownConrady(k1=2.5, k2=6e3, k3=1e6)),
        # A circular fisheye: its corners are beyond 90 degrees, which is a status and no refusal.
        camera(3000, 3000, 950.0, OpenCVFisheye(-0.01, 0.002)),
        camera(9000, 9000, 7500.0, GeneralFrame(k1=-0.02, sense=-1.0)),
        # A calibration that ends inside the image.
        camera(9000, 9000, 7500.0, GeneralFrame(k1=-0.1, limit=0.5)),
        camera(4000, 3000, 545.0),  # sees 149.5 degrees
        # r_d = 2/3 is half a diagonal of 2500 px at f = 3750 px: the turn is just outside.
        camera(4000, 3000, 3760.0, BrownConrady(k1=THIRD)),
    ],
)
def test_sound_cameras_pass(sound):
    refuse_impossible(sound)


@pytest.mark.parametrize(
    ("focal", "distortion", "code", "number"),
    [
        (35.0, UNDISTORTED, "CAMERA-FIELD", "178 degrees"),
        (500.0, UNDISTORTED, "CAMERA-FIELD", "152 degrees"),
        (35.0, OpenCVFisheye(), "CAMERA-FIELD", "6548"),
        # 45 degrees, where the image reaches 0.67: r_d = 0.73.
        (3000.0, BrownConrady(k1=THIRD), "CAMERA-TURNS", "45.0 degrees"),
        (3740.0, BrownConrady(k1=THIRD), "CAMERA-TURNS", "45.0 degrees"),
        (3000.0, BrownConrady(p1=0.3), "CAMERA-TURNS", "off the axis"),
        (1700.0, OpenCVFisheye(k1=THIRD), "CAMERA-TURNS", "57.3 degrees"),
        (3000.0, GeneralFrame(k1=-0.5, sense=-1.0), "CAMERA-TURNS", "30 %"),
    ],
)
def test_impossible_fields_and_distortions_that_turn_back_are_refused(
    focal, distortion, code, number
):
    with refused(code, PhysicsError) as refusal:
        refuse_impossible(camera(4000, 3000, focal, distortion))
    assert refusal.match(number)


# The corners are 0.5 from the principal point in units of the principal distance.
@pytest.mark.parametrize(
    ("distortion", "radius_px"),
    [
        (BrownConrady(k1=4.1), 2500 * (1 + 4.1 * 0.25)),
        (BrownConrady(k3=1e15), 2500 * 1e15 * 0.5**6),
        # p2 (r^2 + 2 u^2), p2 2 u v with u = -0.4, v = -0.3
        (BrownConrady(p2=-3.0), 5000 * math.hypot(-0.4 - 3 * (0.25 + 0.32), -0.3 - 3 * 0.24)),
        (OpenCVFisheye(k1=4.1), 2500 * (1 + 4.1 * 0.25)),
        (GeneralFrame(k4=1e9), 2500 * 1e9 * 0.5**8),
    ],
    ids=["k1", "k3", "decentring", "fisheye", "general"],
)
def test_distortions_that_double_a_distance_are_refused(distortion, radius_px):
    with refused("CAMERA-DISTORTION", PhysicsError) as refusal:
        refuse_impossible(camera(4000, 3000, 5000.0, distortion))
    values = refusal.value.values
    assert (values["x"], values["y"]) == (0.0, 0.0)
    assert values["distance_px"] == pytest.approx(2500.0)
    assert values["distorted_px"] == pytest.approx(radius_px, rel=1e-5)


def test_a_distortion_may_nearly_double_a_distance():
    refuse_impossible(camera(4000, 3000, 5000.0, BrownConrady(k1=3.9)))


@pytest.mark.parametrize("value", [1.1e15, -7e276, math.inf, math.nan])
def test_parameters_beyond_any_lens_are_refused(value):
    with refused("CAMERA-MODEL", PhysicsError):
        camera_of_model("SIMPLE_RADIAL", 4000, 3000, [5000.0, 2000.0, 1500.0, value])


@pytest.mark.parametrize(
    ("seen_by", "radians", "within"),
    [
        (camera(3000, 2000, 1500.0, OpenCVFisheye()), (2.0, 4.0 / 3.0), 1e-15),
        (PHONE, np.radians([59.79, 46.66]), 1.7e-4),
    ],
)
def test_fields_of_view(seen_by, radians, within):
    assert_near(field_of_view(seen_by), radians, within)
