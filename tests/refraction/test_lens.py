"""The lens in the air, with the figures of Meier. Expected values by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import PINHOLE, RADIUS, corrected, exposure, looking
from tests.refraction.rays import AIR, TABLE
from unbend.refraction import BrownConrady, LensInAir
from unbend.refraction.camera.camera import is_impossible_change, principal_change

# A lens of 153 mm on pixels of 7.65 um, calibrated on the ground.
PITCH_MM = 0.00765
REFERENCE_PA = 101_325.0
REFERENCE_K = 293.15
# At 6 km in US 1976, and in a cabin kept at 701.2 hPa and 21.1 degC.
AT_6_KM = (47_217.6, 249.187)
IN_CABIN = (70_120.0, 294.26)

# Heights of a camera and of the ground [m].
H_C = 3450.0
H_G = 500.0


@pytest.mark.parametrize(
    ("mm_per_k", "in_the_open_mm"),
    [
        (3.1e-5, -0.036),
        (2.8e-4, -0.047),
    ],
    ids=["least", "most"],
)
def test_meiers_figures_follow_from_one_pair_of_derivatives(mm_per_k, in_the_open_mm):
    """-0.020 mm behind a window: 312 hPa less; the cold of 6 km makes the rest."""
    lens = LensInAir(
        principal_distance_px=153.0 / PITCH_MM,
        reference_pressure_pa=REFERENCE_PA,
        reference_temperature_k=REFERENCE_K,
        px_per_pa=6.4e-5 / PITCH_MM / 100.0,
        px_per_k=mm_per_k / PITCH_MM,
    )
    behind_window = principal_change(lens, *IN_CABIN) * PITCH_MM
    in_the_open = principal_change(lens, *AT_6_KM) * PITCH_MM
    assert_near(behind_window, -0.020, 0.0005)
    assert_near(in_the_open, in_the_open_mm, 0.0005)


def test_the_reference_changes_nothing_and_each_derivative_acts_alone():
    lens = LensInAir(20_000.0, 90_000.0, 280.0, px_per_pa=1e-4, px_per_k=-0.02)
    pressure = np.array([90_000.0, 80_000.0, 90_000.0, 80_000.0, math.nan])
    temperature = np.array([280.0, 280.0, 300.0, 300.0, 300.0])
    change = principal_change(lens, pressure, temperature)
    expected = [0.0, -1.0, -0.4, -1.4, math.nan]
    assert_near(change, expected, 1e-12, equal_nan=True)


def test_more_than_one_percent_is_absurd():
    lens = LensInAir(20_000.0, REFERENCE_PA, REFERENCE_K, 0.0, 0.0)
    sound_px = [0.0, 199.0, -199.0, 200.0, math.nan]
    assert is_impossible_change(lens, sound_px).tolist() == [False] * 5
    assert is_impossible_change(lens, [201.0, -201.0]).tolist() == [True] * 2


def test_a_longer_principal_distance_puts_the_same_ray_farther_out():
    """By hand: u = 0.3 is at cx + 11000 * 0.3 calibrated, 12 * 0.3 px farther in flight."""
    u = 0.3
    v = -0.2

    def of_change(change_px):
        x = PINHOLE.cx_px + (PINHOLE.fx_px + change_px) * u
        y = PINHOLE.cy_px + (PINHOLE.fy_px + change_px) * v
        setup = exposure(AIR, change_px=change_px)
        return corrected(x, y, setup, TABLE)

    changed = of_change(12.0)
    calibrated = of_change(0.0)
    assert_near(changed.x_corrected_px, calibrated.x_corrected_px, 1e-9)
    assert_near(changed.y_corrected_px, calibrated.y_corrected_px, 1e-9)
    assert_near(changed.dx_px - calibrated.dx_px, -12.0 * u, 1e-9)
    assert_near(changed.dy_px - calibrated.dy_px, -12.0 * v, 1e-9)
    assert_close(changed.r_c_rad, calibrated.r_c_rad, rtol=1e-12)


def on_the_ground(rotation, u, v):
    """Where a straight line of the camera meets the ground, from the earth's centre [m]."""
    length = math.sqrt(u * u + v * v + 1.0)
    inside = np.array([u, v, 1.0]) / length
    direction = rotation.T @ inside

    from_centre = RADIUS + H_C
    along = from_centre * direction[2]
    square_difference = (H_C - H_G) * (2.0 * RADIUS + H_C + H_G)
    reach = -along - math.sqrt(along**2 - square_difference)

    camera = np.array([0.0, 0.0, from_centre])
    return camera + reach * direction


def ideal(camera, k1, x_px, y_px):
    """The ideal u, v of a pixel by the stated calibration."""
    u_d = (x_px - camera.cx_px) / camera.fx_px
    v_d = (y_px - camera.cy_px) / camera.fy_px
    r_d = math.hypot(u_d, v_d)

    def excess(r):
        return r * (1.0 + k1 * r * r) - r_d

    r = brentq(excess, 0.0, 2.0 * r_d, xtol=1e-15)
    return u_d * r / r_d, v_d * r / r_d


@pytest.mark.parametrize("k1", [0.0, -0.03])
def test_metres_on_the_ground_are_those_of_the_shift_in_the_image(k1):
    """From where the stated calibration sees the measured pixel to where it sees the corrected."""
    camera = replace(PINHOLE, distortion=BrownConrady(k1=k1))
    rotation = looking(
        30.0,
        azimuth_deg=60.0,
        swing_deg=20.0,
    )
    setup = exposure(
        AIR,
        rotation,
        cabin_excess=2e-5,
        change_px=1.2,
    )
    x = np.array([PINHOLE.cx_px + 3000.0])
    y = np.array([PINHOLE.cy_px - 2000.0])

    made = corrected(
        x,
        y,
        setup,
        TABLE,
        camera=camera,
        h_g=H_G,
    )

    u, v = ideal(camera, k1, x[0], y[0])
    measured = on_the_ground(rotation, u, v)
    x_corrected = made.x_corrected_px[0]
    y_corrected = made.y_corrected_px[0]
    u, v = ideal(camera, k1, x_corrected, y_corrected)
    true = on_the_ground(rotation, u, v)
    expected = np.linalg.norm(measured - true)
    assert made.shift_ground_m[0] == pytest.approx(expected, rel=2e-3)
