"""Radial tables against check values, the Manual's formula by hand, and 40-digit geometry."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from tests.helpers import refused
from unbend.atmosphere import standard_atmosphere
from unbend.errors import PhysicsError
from unbend.refraction.angle import angles_to, radial_table
from unbend.refraction.status_codes import MISSES_GROUND, OK
from unbend.units import ARCSEC, DEGREE

AIR = standard_atmosphere("us1976", index="gyer")
RADIUS = 6_371_000.0


def test_k_is_the_angle_at_45_degrees_beside_the_manual_by_hand():
    table = radial_table(AIR, 10_000.0, 0.0, np.array([75.0, 45.0]) * DEGREE)
    # Check values of `unbend angle`.
    assert table.r_c_rad / ARCSEC == pytest.approx([61.778543, 16.378452], abs=1e-6)
    assert table.k_rad / ARCSEC == pytest.approx(16.378452, abs=1e-6)
    assert table.k_manual_rad * 1e6 == pytest.approx(2410 * 10 / (100 - 60 + 250), rel=1e-12)
    raised = radial_table(AIR, 3_000.0, 1_000.0, angles_to(60.0))
    by_hand = 2410 * 3 / (9 - 18 + 250) - (1 / 3) * 2410 / (1 - 6 + 250)
    assert raised.k_manual_rad * 1e6 == pytest.approx(by_hand, rel=1e-12)


def landing(h_c, h_g, zeta):
    """East and up [m] of where a straight ray reaches a height."""
    r_c = mp.mpf(RADIUS) + h_c
    r_g = mp.mpf(RADIUS) + h_g
    along = r_c * mp.cos(zeta)
    reach = along - mp.sqrt(along**2 - (r_c**2 - r_g**2))
    return mp.matrix([reach * mp.sin(zeta), -reach * mp.cos(zeta)])


def test_shift_in_the_image_and_on_the_ground():
    f = 20_000.0
    h_c = 6_000.0
    h_g = 1_500.0
    table = radial_table(AIR, h_c, h_g, angles_to(80.0, 7.0), focal_px=f)
    assert table.radius_px == pytest.approx(f * np.tan(table.nadir_angle_rad), rel=1e-14)
    with mp.workdps(40):
        for i, zeta in enumerate(map(mp.mpf, table.nadir_angle_rad)):
            straight = zeta - mp.mpf(table.r_c_rad[i])
            dr = f * (mp.tan(straight) - mp.tan(zeta))
            assert table.dr_px[i] == pytest.approx(float(dr), rel=1e-12, abs=1e-15)
            away = mp.norm(landing(h_c, h_g, zeta) - landing(h_c, h_g, straight))
            assert table.shift_ground_m[i] == pytest.approx(float(away), rel=1e-6, abs=1e-8)
    assert not np.signbit(table.dr_px[0])


def test_without_a_principal_distance_there_are_no_pixels():
    table = radial_table(AIR, 6_000.0, 0.0, angles_to(60.0))
    assert np.isnan(table.dr_px).all()
    assert np.isnan(table.radius_px).all()


def test_a_ray_that_misses_the_ground_says_so_and_metres_end_at_the_horizon():
    """The straight horizon is at asin(6371 / 6381), 86.792 degrees; the bent one is beyond."""
    table = radial_table(AIR, 10_000.0, 0.0, np.array([86.79, 86.8, 86.9, 89.0]) * DEGREE)
    assert table.status.tolist() == [OK, OK, OK, MISSES_GROUND]
    assert np.isnan(table.r_c_rad).tolist() == [False, False, False, True]
    assert np.isnan(table.shift_ground_m).tolist() == [False, True, True, True]


@pytest.mark.parametrize(
    ("largest", "degrees"),
    [
        (60.0, [0.0, 15.0, 30.0, 45.0, 60.0]),
        (50.0, [0.0, 15.0, 30.0, 45.0, 50.0]),
    ],
)
def test_angles_end_with_the_largest(largest, degrees):
    assert angles_to(largest, 15.0) / DEGREE == pytest.approx(degrees, abs=1e-12)


def test_many_small_steps_end_with_the_largest():
    assert angles_to(80.0, 0.1).size == 801


@pytest.mark.parametrize(
    ("h_c", "h_g", "angle", "options", "code"),
    [
        (3000.0, 3000.0, 0.1, {}, "RADIAL-HEIGHTS"),
        (math.nan, 0.0, 0.1, {}, "RADIAL-HEIGHTS"),
        (3000.0, 0.0, math.pi / 2.0, {}, "RADIAL-ANGLE"),
        (3000.0, 0.0, -0.1, {}, "RADIAL-ANGLE"),
        (3000.0, 0.0, math.nan, {}, "RADIAL-ANGLE"),
        (3000.0, 0.0, 0.1, {"focal_px": 0.0}, "RADIAL-FOCAL"),
        (3000.0, 0.0, 0.1, {"focal_px": math.nan}, "RADIAL-FOCAL"),
        (1e9, 0.0, 0.1, {}, "RAY-OUTSIDE-PROFILE"),
    ],
    ids=str,
)
def test_a_table_that_does_not_exist(h_c, h_g, angle, options, code):
    with refused(code, PhysicsError):
        radial_table(AIR, h_c, h_g, np.array([angle]), **options)


@pytest.mark.parametrize(
    "arguments",
    [
        (90.0, 5.0),
        (0.0, 5.0),
        (60.0, 0.0),
        (math.nan, 5.0),
    ],
)
def test_steps_that_make_no_table(arguments):
    with refused("RADIAL-ANGLE", PhysicsError):
        angles_to(*arguments)
