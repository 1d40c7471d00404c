"""Pixel, undistort, window, air, project, distort: in this order, against a chain of its own."""

from dataclasses import replace

import numpy as np
import pytest

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import DOWN, RADIUS, corrected, exposure, turned
from tests.refraction.rays import AIR, TABLE
from unbend.refraction import BrownConrady, Camera, refraction_angle
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.status_codes import OK, OUTSIDE_CAMERA

H_C = 6000.0
H_G = 300.0
OUTSIDE = float(AIR.refractivity(H_C))
CABIN_EXCESS = 2.4e-4 - OUTSIDE
OBLIQUE = turned("ZXY", [25.0, 180.0 - 28.0, 9.0])

BROWN = Camera(
    8000,
    6000,
    7000.0,
    7010.0,
    4020.0,
    2980.0,
    BrownConrady(-0.06, 0.02, -0.003, 4e-4, -3e-4),
)
FISHEYE = replace(
    BROWN,
    fx_px=4200.0,
    fy_px=4210.0,
    distortion=OpenCVFisheye(-0.03, 0.004),
)
REPORT = replace(
    BROWN,
    distortion=GeneralFrame(
        k1=0.05,
        k2=-0.01,
        px=3e-4,
        py=-2e-4,
        offset_u=0.004,
        offset_v=-0.003,
        skew_x=1e-3,
        sense=-1.0,
    ),
)
CAMERAS = {
    "brown": BROWN,
    "fisheye": FISHEYE,
    "report": REPORT,
}
WIDE = Camera(
    7000,
    7000,
    2200.0,
    2200.0,
    3500.0,
    3500.0,
    OpenCVFisheye(0.01, -0.002),
)
PIXELS = np.array(
    [
        [500.0, 700.0],
        [4000.0, 3000.0],
        [7400.0, 900.0],
        [6900.0, 5500.0],
    ]
)


def window(rays):
    """Snell's law at a plane square to the optical axis."""
    ratio = (1.0 + OUTSIDE + CABIN_EXCESS) / (1.0 + OUTSIDE)
    across = ratio * rays[:, :2]
    along = np.sqrt(1.0 - np.sum(across**2, axis=1))
    return np.column_stack([across, along])


def air(rays, rotation):
    """Lowers directions towards the nadir by R."""
    up = rotation[:, 2]
    zeta = np.arccos(-(rays @ up))
    r_c = refraction_angle(AIR, H_C, H_G, zeta, radius=RADIUS)
    straight = zeta - r_c
    level = rays + np.outer(np.cos(zeta), up)
    level /= np.linalg.norm(level, axis=1)[:, None]
    return np.sin(straight)[:, None] * level - np.outer(np.cos(straight), up)


def shifts_by_chain(pixels, camera, rotation):
    """(n, 2) what undistortion, window, air and distortion do to pixels, one after the other.

    `test_camera.py` and `test_camera_models.py` compare distortions with other programs.
    """
    u, v, _ = camera.rays(*pixels.T)
    rays = np.column_stack([u, v, np.ones_like(u)])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    x, y, z = air(window(rays), rotation).T
    end = camera.project(x / z, y / z)
    return np.transpose(end) - pixels


def corrections_of(pixels, camera, rotation):
    setup = exposure(AIR, rotation, h_c=H_C, cabin_excess=CABIN_EXCESS)
    return corrected(
        *pixels.T,
        setup,
        TABLE,
        camera=camera,
        h_g=H_G,
    )


def assert_shifts(corrections, pixels, camera, rotation, atol):
    """Pixels move as by the chain."""
    expected = shifts_by_chain(pixels, camera, rotation)
    moved = np.stack([corrections.dx_px, corrections.dy_px], axis=1)
    assert np.hypot(*moved.T).min() > 0.01
    assert_near(moved, expected, atol)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_order_of_effects(name):
    camera = CAMERAS[name]
    corrections = corrections_of(PIXELS, camera, OBLIQUE)
    assert (corrections.status == OK).all()
    assert_shifts(corrections, PIXELS, camera, OBLIQUE, atol=1e-7)


def test_a_fisheye_that_sees_to_85_degrees_off_the_axis():
    """The nadir angle outside the window, its bending and the shift, against the same chain."""
    theta = np.radians([20.0, 60.0, 80.0, 84.0, 85.0])
    u = np.tan(theta) * np.cos(0.7)
    v = np.tan(theta) * np.sin(0.7)
    pixels = np.stack(WIDE.project(u, v), axis=1)

    corrections = corrections_of(pixels, WIDE, DOWN)

    assert (corrections.status == OK).all()
    outside = np.arcsin(np.sin(theta) * (1.0 + OUTSIDE + CABIN_EXCESS) / (1.0 + OUTSIDE))
    assert_near(corrections.zeta_c_rad, outside, 1e-13)
    # R_cc from the camera's direction to the one outside.
    assert_near(corrections.r_cc_rad, outside - theta, 1e-13)
    r_c = refraction_angle(AIR, H_C, H_G, outside, radius=RADIUS)
    assert_close(corrections.r_c_rad, r_c, rtol=1e-9)
    assert_shifts(corrections, pixels, WIDE, DOWN, atol=2e-7)


def test_a_pixel_of_a_ray_along_the_window_is_outside():
    theta = np.radians(89.9)
    radius_px = 2200.0 * theta * (1.0 + 0.01 * theta**2 - 0.002 * theta**4)
    pixel = np.array([[3500.0 + radius_px, 3500.0]])
    corrections = corrections_of(pixel, WIDE, DOWN)
    assert corrections.status.tolist() == [OUTSIDE_CAMERA]
