"""Cameras that cannot be, and their fields of view."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import PhysicsError
from unbend.refraction import BrownConrady, Camera
from unbend.refraction.calibration import (
    field_of_view,
    refuse_impossible,
)
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye

SOUND = [
    Camera(14000, 10600, 20000.0, 20000.0, 7012.0, 5290.0, BrownConrady(-0.018, 0.009, -0.002)),
    Camera(4000, 3000, 2700.0, 2700.0, 2010.0, 1490.0, BrownConrady(-0.3, 0.12, -0.02, 1e-3)),
    Camera(3264, 2448, 2838.6, 2838.6, 1632.0, 1224.0, BrownConrady(0.0885, -0.2324)),
    # A circular fisheye: its corners lie beyond 90 degrees, which is a status and no refusal.
    Camera(3000, 3000, 950.0, 950.0, 1500.0, 1500.0, OpenCVFisheye(-0.01, 0.002)),
    Camera(9000, 9000, 7500.0, 7500.0, 4500.0, 4500.0, GeneralFrame(k1=-0.02, sense=-1.0)),
    # A calibration that ends inside the image.
    Camera(9000, 9000, 7500.0, 7500.0, 4500.0, 4500.0, GeneralFrame(k1=-0.1, limit=0.5)),
]


@pytest.mark.parametrize("camera", SOUND)
def test_sound_cameras_pass(camera):
    refuse_impossible(camera)


@pytest.mark.parametrize(
    ("camera", "code", "what"),
    [
        (Camera(4000, 3000, 35.0, 35.0, 2000.0, 1500.0), "CAMERA-FIELD", "178 degrees"),
        (Camera(4000, 3000, 35.0, 35.0, 2000.0, 1500.0, OpenCVFisheye()), "CAMERA-FIELD", "6548"),
        # r - r^3 / 3 turns at r = 1, 45 degrees, where the image reaches 0.67: r_d = 0.73.
        (
            Camera(4000, 3000, 3000.0, 3000.0, 2000.0, 1500.0, BrownConrady(k1=-1.0 / 3.0)),
            "CAMERA-TURNS",
            "45.0 degrees",
        ),
        (
            Camera(4000, 3000, 3000.0, 3000.0, 2000.0, 1500.0, BrownConrady(p1=0.3)),
            "CAMERA-TURNS",
            "off the axis",
        ),
        (
            Camera(4000, 3000, 1700.0, 1700.0, 2000.0, 1500.0, OpenCVFisheye(k1=-1.0 / 3.0)),
            "CAMERA-TURNS",
            "57.3 degrees",
        ),
        (
            Camera(4000, 3000, 3000.0, 3000.0, 2000.0, 1500.0, GeneralFrame(k1=-0.5, sense=-1.0)),
            "CAMERA-TURNS",
            "30 %",
        ),
    ],
)
def test_what_cannot_be_is_refused(camera, code, what):
    with pytest.raises(PhysicsError, match=what) as refused:
        refuse_impossible(camera)
    assert refused.value.code == code


def test_a_turn_in_a_corner_is_found_and_just_outside_is_not():
    """r - r^3 / 3 turns at r_d = 2/3: half a diagonal of 2500 px at f = 3750 px."""
    for focal, refused in ((3740.0, True), (3760.0, False)):
        camera = Camera(4000, 3000, focal, focal, 2000.0, 1500.0, BrownConrady(k1=-1.0 / 3.0))
        try:
            refuse_impossible(camera)
            assert not refused
        except PhysicsError:
            assert refused


def test_fields_of_view():
    camera = Camera(3000, 2000, 1500.0, 1500.0, 1500.0, 1000.0, OpenCVFisheye())
    across, down = field_of_view(camera)
    assert (across, down) == pytest.approx((2.0, 4.0 / 3.0), abs=1e-15)
    assert np.degrees(field_of_view(SOUND[2])) == pytest.approx([59.79, 46.66], abs=0.01)
