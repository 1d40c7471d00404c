"""Radial tables against check values, the Manual's formula by hand, and 40-digit geometry."""

from math import nan, pi

import mpmath as mp
import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.rays import AIR
from tests.refraction.straight_lines import metres_apart
from unbend.errors import PhysicsError
from unbend.refraction.angle import angles_to, radial_table
from unbend.refraction.status_codes import MISSES_GROUND, OK
from unbend.units import ARCSEC


def test_k_is_the_angle_at_45_degrees_beside_the_manual_by_hand():
    angles = np.radians([75.0, 45.0])
    table = radial_table(AIR, 10_000.0, 0.0, angles)
    # Check values of `unbend angle`.
    assert_near(table.r_c_rad / ARCSEC, [61.778543, 16.378452], 1e-6)
    assert_near(table.k_rad / ARCSEC, 16.378452, 1e-6)
    raised = radial_table(AIR, 3_000.0, 1_000.0, angles_to(60.0))
    by_hand = 2410 * 3 / (9 - 18 + 250) - (1 / 3) * 2410 / (1 - 6 + 250)
    assert_close(raised.k_manual_rad * 1e6, by_hand, rtol=1e-12)


def test_shift_in_the_image_and_on_the_ground():
    f = 20_000.0
    h_c = 6_000.0
    h_g = 1_500.0
    table = radial_table(
        AIR,
        h_c,
        h_g,
        angles_to(80.0, 7.0),
        focal_px=f,
    )
    assert_close(table.radius_px, f * np.tan(table.nadir_angle_rad), rtol=1e-14)
    with mp.workdps(40):
        for i, zeta in enumerate(map(mp.mpf, table.nadir_angle_rad)):
            straight = zeta - table.r_c_rad[i]
            dr = f * (mp.tan(straight) - mp.tan(zeta))
            assert table.dr_px[i] == pytest.approx(float(dr), rel=1e-12, abs=1e-15)
            away = metres_apart(h_c, h_g, zeta, straight)
            assert table.shift_ground_m[i] == pytest.approx(away, rel=1e-6, abs=1e-8)
    assert not np.signbit(table.dr_px[0])


def test_without_a_principal_distance_there_are_no_pixels():
    table = radial_table(
        AIR,
        6_000.0,
        0.0,
        angles_to(60.0),
    )
    assert np.isnan(table.dr_px).all()
    assert np.isnan(table.radius_px).all()


def test_a_ray_that_misses_the_ground_says_so_and_metres_end_at_the_horizon():
    """The straight horizon is at asin(6371 / 6381), 86.792 degrees; the bent one is beyond."""
    angles = np.radians([86.79, 86.8, 86.9, 89.0])
    table = radial_table(AIR, 10_000.0, 0.0, angles)
    assert table.status.tolist() == [OK, OK, OK, MISSES_GROUND]
    assert np.isnan(table.r_c_rad).tolist() == [False, False, False, True]
    assert np.isnan(table.shift_ground_m).tolist() == [False, True, True, True]


@pytest.mark.parametrize(
    ("largest", "step", "expected"),
    [
        (60.0, 15.0, [0.0, 15.0, 30.0, 45.0, 60.0]),
        (50.0, 15.0, [0.0, 15.0, 30.0, 45.0, 50.0]),
        (80.0, 0.1, np.linspace(0.0, 80.0, 801)),
    ],
)
def test_angles_end_with_the_largest(largest, step, expected):
    degrees = np.degrees(angles_to(largest, step))
    assert_near(degrees, expected, 1e-12)


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("h_g", 3000.0, "RADIAL-HEIGHTS"),
        ("h_c", nan, "RADIAL-HEIGHTS"),
        ("nadir_angle", pi / 2.0, "RADIAL-ANGLE"),
        ("nadir_angle", -0.1, "RADIAL-ANGLE"),
        ("nadir_angle", nan, "RADIAL-ANGLE"),
        ("focal_px", 0.0, "RADIAL-FOCAL"),
        ("focal_px", nan, "RADIAL-FOCAL"),
        ("h_c", 1e9, "RAY-OUTSIDE-PROFILE"),
    ],
)
def test_a_table_that_does_not_exist(name, value, code):
    sound = {"h_c": 3000.0, "h_g": 0.0, "nadir_angle": 0.1}
    arguments = sound | {name: value}
    arguments["nadir_angle"] = np.array([arguments["nadir_angle"]])
    with refused(code, PhysicsError):
        radial_table(AIR, **arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        (90.0, 5.0),
        (0.0, 5.0),
        (60.0, 0.0),
        (nan, 5.0),
    ],
)
def test_steps_that_make_no_table(arguments):
    with refused("RADIAL-ANGLE", PhysicsError):
        angles_to(*arguments)
