"""The change of an interior orientation that stands for a correction.

Truth: closed forms of R = K tan(zeta), cameras changed by hand, and arithmetic written out.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.block.calibration_fit import (
    ALL_PARAMETERS,
    CORRECTION_TERMS,
    NADIR_PARAMETERS,
    CorrectionChange,
    SeenRays,
    correction_change,
    fitted_camera,
)
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera

K = 59e-6
F = 20_000.0
CX = 7012.0
CY = 5291.0
SIZE_PX = (14_000, 10_600)
PLAIN = Camera(*SIZE_PX, F, F, CX, CY)
BROWN_LENS = [-0.02, 0.009, -0.002, 1.5e-4, -1e-4]
BROWN = camera_of_model("BROWN", *SIZE_PX, [F, F * 1.0002, CX, CY, *BROWN_LENS])
LENS = [
    1e-4,
    -0.02,
    0.01,
    0,
    1e-3,
    0,
    0,
    0,
    1e-4,
    -2e-4,
    1e-4,
    0,
    1e-4,
    0,
    -1,
    1e9,
    30,
]
GENERAL = camera_of_model("GENERAL_FRAME", *SIZE_PX, [F, F, CX, CY, *LENS])
FISHEYE_PARAMETERS = [3000, 3000, 3000, 3010, 0.01, -0.002, 0, 0]
FISHEYE = camera_of_model("OPENCV_FISHEYE", 6000, 6000, FISHEYE_PARAMETERS)


def seen(camera, bend):
    """Pixels of a grid, and the straight rays that a bend (of tangents) makes of what is seen."""
    columns = np.linspace(60, camera.width_px - 60, 21)
    rows = np.linspace(60, camera.height_px - 60, 17)
    x_px, y_px = np.meshgrid(columns, rows)
    measured_px = np.column_stack([x_px.ravel(), y_px.ravel()])
    u, v, ok = camera.rays(*measured_px.T)
    straight = bend(np.column_stack([u, v])[ok])
    return SeenRays(straight, measured_px[ok], np.ones(len(straight)))


def not_at_all(tangents):
    return tangents


def nadir(tangents):
    """R = K tan(zeta), the apparent ray farther from the nadir, about the optical axis."""
    tangent = np.linalg.norm(
        tangents,
        axis=1,
        keepdims=True,
    )
    straight = np.tan(np.arctan(tangent) - K * tangent)
    return tangents / tangent * straight


def turned(tangents, rotation):
    rays = np.column_stack([tangents, np.ones(len(tangents))])
    x, y, z = rotation.apply(rays).T
    return np.column_stack([x / z, y / z])


def oblique(tangents):
    """The same of a head that looks 45 degrees up in the image, rows of which are level."""
    to_level = Rotation.from_euler("x", 45.0, degrees=True)
    level = turned(tangents, to_level)
    return turned(nadir(level), to_level.inv())


def rms(values):
    return np.sqrt(np.mean(np.sum(values**2, axis=1)))


def left_px(rays, camera):
    """What a camera leaves of rays."""
    return rms(rays.residual_px(camera))


def test_straight_down_f_and_k1_grow_by_k():
    """Forward: r (1 + K (1 + r^2)); as a correction: c (1 + K) and -K r^3."""
    rays = seen(PLAIN, nadir)

    camera = fitted_camera(PLAIN, rays, NADIR_PARAMETERS)
    change, left = correction_change(PLAIN, rays, ("c", "k1"))

    assert camera.fx_px == pytest.approx(F * (1.0 + K), abs=1e-4 * F * K)
    assert camera.fy_px == camera.fx_px
    assert camera.distortion.k1 == pytest.approx(K, rel=1e-3)
    assert camera.cx_px == CX
    assert camera.cy_px == CY
    assert left_px(rays, PLAIN) > 0.1
    assert left_px(rays, camera) < 1e-6
    assert change.c == pytest.approx(K, rel=1e-3)
    assert change.k1 == pytest.approx(-K, rel=1e-3)
    assert rms(left) < 1e-6
    radius = np.array([0.1, 0.4])
    np.testing.assert_allclose(change.radial(radius), -K * radius**3, rtol=1e-3)


@pytest.mark.parametrize(
    "camera",
    [BROWN, GENERAL, FISHEYE],
    ids=["brown", "general", "fisheye"],
)
def test_a_camera_that_was_changed_by_hand_is_found(camera):
    """Whatever its model: rays that the changed camera sees are those of the changed camera."""
    lens = camera.distortion
    moved = replace(
        camera,
        fx_px=camera.fx_px * 1.0001,
        fy_px=camera.fy_px * 1.00008,
        cx_px=camera.cx_px - 1.0,
        cy_px=camera.cy_px + 0.5,
        distortion=lens._replace(
            k1=lens.k1 + 5e-5,
            k2=lens.k2 - 2e-5,
        ),
    )
    rays = seen(moved, not_at_all)
    fitted = fitted_camera(camera, rays, ALL_PARAMETERS)
    assert left_px(rays, fitted) < 1e-7
    assert fitted.cx_px == pytest.approx(moved.cx_px, abs=1e-4)
    assert fitted.fy_px == pytest.approx(moved.fy_px, rel=1e-8)


@pytest.mark.parametrize(
    "camera",
    [PLAIN, BROWN, GENERAL],
    ids=["plain", "brown", "general"],
)
def test_a_head_that_looks_aside_takes_the_full_set(camera):
    rays = seen(camera, oblique)
    before_px = left_px(rays, camera)
    assert before_px > 1.0  # f K at 45 degrees

    full = fitted_camera(camera, rays, ALL_PARAMETERS)
    few = fitted_camera(camera, rays, NADIR_PARAMETERS)
    _, left = correction_change(camera, rays)

    assert left_px(rays, full) < 0.03 * before_px
    assert rms(left) < 0.03 * before_px
    assert left_px(rays, few) > 0.3 * before_px
    # What is seen too high is seen by a principal point that lies higher: y grows downwards.
    assert full.cy_px < camera.cy_px - 1.0


def test_what_a_correction_adds_is_what_its_formula_says():
    """Measured points, corrected by the sum written out in millimetres, are the straight rays."""
    rays = seen(BROWN, oblique)
    change, left = correction_change(BROWN, rays, CORRECTION_TERMS)
    for name in CORRECTION_TERMS:
        assert getattr(change, name) != 0.0
    c = 92.0
    x_px, y_px = rays.measured_px.T
    x = (x_px - CX) * c / F
    y = (CY - y_px) * c / BROWN.fy_px
    u, v, _ = BROWN.rays(x_px, y_px)
    k1 = change.k1 / c**2
    k2 = change.k2 / c**4
    k3 = change.k3 / c**6
    p1 = change.p1 / c
    p2 = change.p2 / c
    r2 = x * x + y * y
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
    dx = -change.x0 * c + x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    dy = -change.y0 * c + y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    x_corrected = u * c + dx + change.b1 * x + change.b2 * y
    y_corrected = v * -c + dy
    corrected = np.column_stack([x_corrected, -y_corrected]) / (c * (1.0 + change.c))
    # (1 + c) on the straight ray, of which the residual is reckoned: a ten-thousandth of it.
    off_px = (corrected - rays.straight) * F
    np.testing.assert_allclose(
        off_px,
        left,
        rtol=1e-3,
        atol=1e-6,
    )
    assert rms(left) < 0.04


def test_rows_count_by_their_weights():
    rays = seen(PLAIN, nadir)
    is_spoilt = np.arange(len(rays.straight)) % 3 == 0
    measured_px = rays.measured_px + 5.0 * is_spoilt[:, None]
    weighted = SeenRays(rays.straight, measured_px, 1.0 - is_spoilt)
    fitted = fitted_camera(PLAIN, weighted, NADIR_PARAMETERS)
    assert fitted.fx_px == pytest.approx(F * (1.0 + K), abs=1e-4 * F * K)
    change, _ = correction_change(PLAIN, weighted, ("c", "k1"))
    assert change.c == pytest.approx(K, rel=1e-3)


def test_no_change_is_none():
    rays = seen(BROWN, not_at_all)
    same = fitted_camera(BROWN, rays, ALL_PARAMETERS)
    assert left_px(rays, same) < 1e-9
    change, left = correction_change(BROWN, rays)
    for name in CORRECTION_TERMS:
        assert abs(getattr(change, name)) < 1e-10
    assert rms(left) < 1e-9
    assert CorrectionChange().radial(np.ones(1))[0] == 0.0
