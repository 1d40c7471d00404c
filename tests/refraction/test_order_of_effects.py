"""Pixel, undistort, window, air, project, distort: in this order, against a chain of its own."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.lens import brown
from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import AHEAD, DOWN, RADIUS, corrected, exposure, turned
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
FORWARD = np.array(AHEAD)

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


def distorted_by_brown(p, point):
    return np.array(brown(*point, p.k1, p.k2, p.p1, p.p2, p.k3))


def distorted_by_fisheye(p, point):
    r = np.hypot(*point)
    theta = np.arctan(r)
    radial = 1.0 + p.k1 * theta**2 + p.k2 * theta**4
    return theta * radial / r * point


def corrected_by_report(p, point):
    """Ideal coordinates of measured ones."""
    x = point[0] - p.skew_x * point[1] + p.offset_u
    y = point[1] + p.offset_v
    r2 = x * x + y * y
    radial = 1.0 + p.k1 * r2 + p.k2 * r2**2
    u = x * radial + p.px * (r2 + 2.0 * x * x) + 2.0 * p.py * x * y - p.offset_u
    v = y * radial + p.py * (r2 + 2.0 * y * y) + 2.0 * p.px * x * y - p.offset_v
    return np.array([u, v])


def inverse(function, value):
    """The argument of a function, by Newton's method with differences."""
    argument = np.array(value)
    for _ in range(40):
        slope = np.empty((2, 2))
        for axis, step in enumerate(1e-6 * np.eye(2)):
            difference = function(argument + step) - function(argument - step)
            slope[:, axis] = difference / 2e-6
        error = value - function(argument)
        argument = argument + np.linalg.solve(slope, error)
    return argument


def distorted(camera, point):
    """Written down from the definitions, for one point."""
    parameters = camera.distortion
    if isinstance(parameters, GeneralFrame):
        return inverse(partial(corrected_by_report, parameters), point)
    if isinstance(parameters, OpenCVFisheye):
        return distorted_by_fisheye(parameters, point)
    return distorted_by_brown(parameters, point)


def undistort(ray, camera, _):
    measured = ray[:2] / ray[2]
    if isinstance(camera.distortion, GeneralFrame):
        ideal = corrected_by_report(camera.distortion, measured)
    else:
        ideal = inverse(partial(distorted, camera), measured)
    return np.append(ideal, 1.0)


def window(ray, *_):
    """Snell's law at a plane square to the optical axis."""
    d = ray / np.linalg.norm(ray)
    ratio = (1.0 + OUTSIDE + CABIN_EXCESS) / (1.0 + OUTSIDE)
    across = ratio * (d - (d @ FORWARD) * FORWARD)
    return across + np.sqrt(1.0 - across @ across) * FORWARD


def air(ray, _, rotation):
    """Lowers a direction towards the nadir by R."""
    up = rotation[:, 2]
    d = ray / np.linalg.norm(ray)
    zeta = np.arccos(-(d @ up))
    r_c = refraction_angle(AIR, H_C, H_G, zeta, radius=RADIUS)
    straight = zeta - r_c
    level = d + np.cos(zeta) * up
    level /= np.linalg.norm(level)
    return np.sin(straight) * level - np.cos(straight) * up


def shifts_by(steps, pixels, camera, rotation):
    """(n, 2) what a chain of steps does to pixels."""
    focal = np.array([camera.fx_px, camera.fy_px])
    principal = np.array([camera.cx_px, camera.cy_px])
    shifts = []
    for pixel in pixels:
        ray = np.append((pixel - principal) / focal, 1.0)
        for step in steps:
            ray = step(ray, camera, rotation)
        end = distorted(camera, ray[:2] / ray[2])
        shifts.append(focal * end + principal - pixel)
    return np.array(shifts)


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
    expected = shifts_by([undistort, window, air], pixels, camera, rotation)
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
