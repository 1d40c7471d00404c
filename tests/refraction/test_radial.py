"""Radial tables against check values, the Manual's formula by hand, and 40-digit geometry."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.errors import PhysicsError
from unbend.refraction.angle import angles_to, radial_table
from unbend.units import ARCSEC, DEGREE

AIR = standard_atmosphere("us1976", index="gyer")
RADIUS = 6_371_000.0

# Check values of `unbend angle`, US 1976 with Gyer's index: arcsec at (h_c, zeta).
KNOWN = {(10_000.0, 75.0): 61.778543, (10_000.0, 45.0): 16.378452, (3_000.0, 45.0): 7.088778}


def landing(h_c, h_g, zeta):
    """East of the nadir point where a straight ray reaches a height [m], and its height."""
    r_c = mp.mpf(RADIUS) + h_c
    r_g = mp.mpf(RADIUS) + h_g
    c = mp.cos(zeta)
    s = r_c * c - mp.sqrt((r_c * c) ** 2 - (r_c**2 - r_g**2))
    return s * mp.sin(zeta), -s * c


@pytest.mark.parametrize(("h_c", "zeta"), KNOWN, ids=str)
def test_the_angles_are_the_known_ones(h_c, zeta):
    table = radial_table(AIR, h_c, 0.0, np.array([zeta]) * DEGREE)
    assert table.r_c_rad[0] / ARCSEC == pytest.approx(KNOWN[h_c, zeta], abs=1e-6)


def test_k_is_the_angle_at_45_degrees_beside_the_manual_by_hand():
    table = radial_table(AIR, 10_000.0, 0.0, angles_to(60.0))
    assert table.k_rad / ARCSEC == pytest.approx(16.378452, abs=1e-6)
    assert table.k_manual_rad * 1e6 == pytest.approx(2410 * 10 / (100 - 60 + 250), rel=1e-12)
    raised = radial_table(AIR, 3_000.0, 1_000.0, angles_to(60.0))
    by_hand = 2410 * 3 / (9 - 18 + 250) - (1 / 3) * 2410 / (1 - 6 + 250)
    assert raised.k_manual_rad * 1e6 == pytest.approx(by_hand, rel=1e-12)


def test_shift_in_the_image_and_on_the_ground():
    f = 20_000.0
    h_c = 6_000.0
    h_g = 1_500.0
    table = radial_table(AIR, h_c, h_g, angles_to(80.0, 7.0), focal_px=f)
    with mp.workdps(40):
        for i, zeta in enumerate(table.nadir_angle_rad.tolist()):
            straight = mp.mpf(zeta) - mp.mpf(table.r_c_rad[i].item())
            dr = f * (mp.tan(straight) - mp.tan(mp.mpf(zeta)))
            assert table.dr_px[i] == pytest.approx(float(dr), rel=1e-12, abs=1e-15)
            assert table.radius_px[i] == pytest.approx(f * math.tan(zeta), rel=1e-14)
            (x_0, z_0), (x_1, z_1) = landing(h_c, h_g, mp.mpf(zeta)), landing(h_c, h_g, straight)
            away = float(mp.hypot(x_0 - x_1, z_0 - z_1))
            assert table.shift_ground_m[i] == pytest.approx(away, rel=1e-6, abs=1e-8)
    assert np.all(table.dr_px[1:] < 0.0)
    assert np.signbit(table.dr_px[0]) == np.False_


def test_without_a_principal_distance_there_are_no_pixels():
    table = radial_table(AIR, 6_000.0, 0.0, angles_to(60.0))
    assert np.isnan(table.dr_px).all()
    assert np.isnan(table.radius_px).all()


def test_a_ray_that_misses_the_ground_says_so():
    table = radial_table(AIR, 10_000.0, 0.0, angles_to(89.0, 1.0))
    assert table.status[45] == 0
    assert table.status[-1] == 5  # misses_ground
    assert np.array_equal(np.isnan(table.r_c_rad), table.status == 5)
    assert np.array_equal(np.isnan(table.shift_ground_m), table.status == 5)


def test_over_the_horizon_there_are_no_metres():
    """asin(6371 / 6381) is 86.792 degrees."""
    table = radial_table(AIR, 10_000.0, 0.0, np.array([86.79, 86.8, 86.9]) * DEGREE)
    assert table.status.tolist() == [0, 0, 0]
    assert np.isfinite(table.r_c_rad).all()
    assert np.isnan(table.shift_ground_m).tolist() == [False, True, True]


def test_angles_end_with_the_largest():
    assert (angles_to(60.0, 15.0) / DEGREE).round(12).tolist() == [0.0, 15.0, 30.0, 45.0, 60.0]
    assert (angles_to(50.0, 15.0) / DEGREE).round(12).tolist() == [0.0, 15.0, 30.0, 45.0, 50.0]
    assert angles_to(80.0, 0.1).size == 801


@pytest.mark.parametrize(
    ("arguments", "options", "code"),
    [
        ((3000.0, 3000.0, [0.1]), {}, "RADIAL-HEIGHTS"),
        ((math.nan, 0.0, [0.1]), {}, "RADIAL-HEIGHTS"),
        ((3000.0, 0.0, [math.pi / 2.0]), {}, "RADIAL-ANGLE"),
        ((3000.0, 0.0, [-0.1]), {}, "RADIAL-ANGLE"),
        ((3000.0, 0.0, [math.nan]), {}, "RADIAL-ANGLE"),
        ((3000.0, 0.0, [0.1]), {"focal_px": 0.0}, "RADIAL-FOCAL"),
        ((3000.0, 0.0, [0.1]), {"focal_px": math.nan}, "RADIAL-FOCAL"),
        ((1e9, 0.0, [0.1]), {}, "RAY-OUTSIDE-PROFILE"),
    ],
    ids=str,
)
def test_a_table_that_does_not_exist(arguments, options, code):
    h_c, h_g, angles = arguments
    with pytest.raises(PhysicsError) as refusal:
        radial_table(AIR, h_c, h_g, np.array(angles), **options)
    assert refusal.value.code == code


@pytest.mark.parametrize("arguments", [(90.0, 5.0), (0.0, 5.0), (60.0, 0.0), (math.nan, 5.0)])
def test_steps_that_make_no_table(arguments):
    with pytest.raises(PhysicsError) as refusal:
        angles_to(*arguments)
    assert refusal.value.code == "RADIAL-ANGLE"
