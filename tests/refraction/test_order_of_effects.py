"""Pixel, undistort, window, air, project, distort: in this order, against a chain of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import unbend
from unbend.atmosphere import standard_atmosphere
from unbend.refraction import STATUS_NAMES, Camera, correct_observations, ray_table
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.image import Exposures

H_C = 6000.0
H_G = 300.0
RADIUS = 6371000.0
AIR = standard_atmosphere("us1976")
CABIN = 2.4e-4  # n - 1 inside
OUTSIDE = float(AIR.refractivity(np.array([H_C]))[0])
# East-north-up to a camera that looks obliquely.
TO_CAMERA = Rotation.from_euler("ZXY", [25.0, 180.0 - 28.0, 9.0], degrees=True).as_matrix()
FORWARD = np.array([0.0, 0.0, 1.0])

CAMERAS = {
    "brown": Camera(8000, 6000, 7000.0, 7010.0, 4020.0, 2980.0, BrownConrady(
        -0.06, 0.02, -0.003, 4e-4, -3e-4)),
    "fisheye": Camera(8000, 6000, 4200.0, 4210.0, 4020.0, 2980.0, OpenCVFisheye(-0.03, 0.004)),
    "report": Camera(8000, 6000, 7000.0, 7010.0, 4020.0, 2980.0, GeneralFrame(
        k1=0.05, k2=-0.01, px=3e-4, py=-2e-4, offset_u=0.004, offset_v=-0.003, skew_x=1e-3,
        sense=-1.0)),
}  # fmt: skip
PIXELS = np.array([[500.0, 700.0], [4000.0, 3000.0], [7400.0, 900.0], [6900.0, 5500.0]])


def distorted(u, v, p):
    """Written down from the definitions, for one point."""
    if isinstance(p, OpenCVFisheye):
        r = np.hypot(u, v)
        theta = np.arctan(r)
        by = theta * (1.0 + p.k1 * theta**2 + p.k2 * theta**4) / r
        return np.array([u * by, v * by])
    if isinstance(p, BrownConrady):
        r2 = u * u + v * v
        by = 1.0 + p.k1 * r2 + p.k2 * r2**2 + p.k3 * r2**3
        return np.array(
            [
                u * by + 2.0 * p.p1 * u * v + p.p2 * (r2 + 2.0 * u * u),
                v * by + 2.0 * p.p2 * u * v + p.p1 * (r2 + 2.0 * v * v),
            ]
        )
    return inverse(lambda d: corrected(d, p), np.array([u, v]))


def corrected(d, p):
    """Ideal coordinates of measured ones by a report's formulas."""
    x = d[0] - p.skew_x * d[1] + p.offset_u
    y = d[1] + p.offset_v
    r2 = x * x + y * y
    by = 1.0 + p.k1 * r2 + p.k2 * r2**2
    return np.array(
        [
            x * by + p.px * (r2 + 2.0 * x * x) + 2.0 * p.py * x * y - p.offset_u,
            y * by + p.py * (r2 + 2.0 * y * y) + 2.0 * p.px * x * y - p.offset_v,
        ]
    )


def inverse(function, wanted):
    """By Newton's method with differences."""
    at = np.array(wanted)
    for _ in range(40):
        slope = np.stack(
            [(function(at + s) - function(at - s)) / 2e-6 for s in 1e-6 * np.eye(2)], axis=1
        )
        at = at + np.linalg.solve(slope, wanted - function(at))
    return at


def undistort(ray, camera):
    wanted = np.array([ray[0], ray[1]]) / ray[2]
    p = camera.distortion
    ideal = (
        corrected(wanted, p)
        if isinstance(p, GeneralFrame)
        else inverse(lambda d: distorted(*d, p), wanted)
    )
    return np.append(ideal, 1.0)


def window(ray, _):
    """Snell's law at a plane square to the optical axis."""
    d = ray / np.linalg.norm(ray)
    across = (1.0 + CABIN) / (1.0 + OUTSIDE) * (d - (d @ FORWARD) * FORWARD)
    return across + np.sqrt(1.0 - across @ across) * FORWARD


def air(ray, _):
    """Lowers a direction towards the nadir by R."""
    up = TO_CAMERA[:, 2]
    d = ray / np.linalg.norm(ray)
    zeta = np.arccos(-(d @ up))
    r = float(unbend.refraction_angle(AIR, H_C, H_G, zeta, radius=RADIUS))
    level = d + np.cos(zeta) * up
    level /= np.linalg.norm(level)
    return np.sin(zeta - r) * level - np.cos(zeta - r) * up


def chain(pixel, camera, steps):
    ray = np.array(
        [(pixel[0] - camera.cx_px) / camera.fx_px, (pixel[1] - camera.cy_px) / camera.fy_px, 1.0]
    )
    for step in steps:
        ray = step(ray, camera)
    u, v = distorted(ray[0] / ray[2], ray[1] / ray[2], camera.distortion)
    return np.array([camera.fx_px * u + camera.cx_px, camera.fy_px * v + camera.cy_px])


@pytest.mark.parametrize("name", CAMERAS)
def test_the_order_of_effects(name):
    camera = CAMERAS[name]
    exposures = Exposures(
        np.array([True]),
        TO_CAMERA[None],
        np.array([0.8]),
        np.array([H_C]),
        np.array([OUTSIDE]),
        np.array([CABIN]),
        radius_m=RADIUS,
    )
    rows = len(PIXELS)
    found = correct_observations(
        PIXELS[:, 0].copy(),
        PIXELS[:, 1].copy(),
        np.full(rows, H_G),
        np.zeros(rows, np.int64),
        exposures,
        camera=camera,
        table=ray_table(AIR),
    )
    assert (found.status == 0).all()
    moved = np.stack([found.dx_px, found.dy_px], axis=1)
    assert np.hypot(*moved.T).min() > 0.01

    def by(*steps):
        return np.array([chain(pixel, camera, steps) for pixel in PIXELS]) - PIXELS

    np.testing.assert_allclose(moved, by(undistort, window, air), rtol=0.0, atol=1e-7)
    for wrong in (
        (window, undistort, air),
        (window, air, undistort),
        (air, undistort, window),
        (undistort, air, window),
        (undistort, air),
    ):
        assert np.abs(by(*wrong) - moved).max() > 2e-6, [step.__name__ for step in wrong]


def test_a_fisheye_that_sees_to_85_degrees_off_the_axis(monkeypatch):
    """The nadir angle outside the window, its bending and the shift, against the same chain."""
    down = np.diag([1.0, -1.0, -1.0])
    monkeypatch.setitem(globals(), "TO_CAMERA", down)
    camera = Camera(7000, 7000, 2200.0, 2200.0, 3500.0, 3500.0, OpenCVFisheye(0.01, -0.002))
    theta = np.radians([20.0, 60.0, 80.0, 84.0, 85.0])
    u = np.tan(theta) * np.cos(0.7)
    v = np.tan(theta) * np.sin(0.7)
    pixels = np.stack(camera.project(u, v), axis=1)
    rows = len(pixels)
    exposures = Exposures(
        np.array([True]),
        down[None],
        np.array([0.8]),
        np.array([H_C]),
        np.array([OUTSIDE]),
        np.array([CABIN]),
        radius_m=RADIUS,
    )
    found = correct_observations(
        pixels[:, 0].copy(),
        pixels[:, 1].copy(),
        np.full(rows, H_G),
        np.zeros(rows, np.int64),
        exposures,
        camera=camera,
        table=ray_table(AIR),
    )
    assert (found.status == 0).all()
    outside = np.arcsin(np.sin(theta) * (1.0 + CABIN) / (1.0 + OUTSIDE))  # Snell, by angles
    np.testing.assert_allclose(found.zeta_c_rad, outside, rtol=0.0, atol=1e-13)
    # R_cc from the camera's direction to the one outside.
    np.testing.assert_allclose(found.r_cc_rad, outside - theta, rtol=0.0, atol=1e-13)
    r = [float(unbend.refraction_angle(AIR, H_C, H_G, z, radius=RADIUS)) for z in outside]
    np.testing.assert_allclose(found.r_c_rad, r, rtol=1e-9)
    wanted = np.array([chain(p, camera, (undistort, window, air)) for p in pixels]) - pixels
    np.testing.assert_allclose(
        np.stack([found.dx_px, found.dy_px], axis=1), wanted, rtol=0.0, atol=2e-7
    )
    t = np.radians(89.9)
    beyond = 2200.0 * t * (1.0 + 0.01 * t**2 - 0.002 * t**4)
    late = correct_observations(
        np.array([3500.0 + beyond]),
        np.array([3500.0]),
        np.array([H_G]),
        np.zeros(1, np.int64),
        exposures,
        camera=camera,
        table=ray_table(AIR),
    )
    assert STATUS_NAMES[late.status[0]] == "outside_camera"
