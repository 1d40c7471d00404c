"""Rays at the edges: exactly down, level and up, past grazing, out of the air, not a number."""

import math
from math import inf, nan, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from tests.refraction.images import RADIUS
from tests.refraction.rays import AIR, TABLE, bent, touching_angle
from unbend.atmosphere import standard_atmosphere
from unbend.errors import PhysicsError
from unbend.refraction import RayTable, bend, refraction_angle
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)
from unbend.units import ARCSEC, DEGREE

SETTINGS = settings(max_examples=100, deadline=None)

heights = st.floats(-430.0, 30_000.0)


def test_exactly_at_the_nadir_and_at_the_zenith_nothing_bends():
    assert refraction_angle(AIR, 3000.0, 0.0, 0.0) == 0.0
    assert abs(refraction_angle(AIR, 1000.0, 3000.0, pi)) < 1e-18
    r_c, status = bend(
        TABLE,
        1000.0,
        3000.0,
        0.0,
        -1.0,
        radius=RADIUS,
    )
    assert r_c == 0.0
    assert status == OK


def test_the_zenith_in_single_precision_is_the_zenith():
    zenith = np.float32(pi)  # above pi

    r_c = refraction_angle(
        AIR,
        1000.0,
        3000.0,
        zenith,
    )

    assert abs(r_c) < 1e-18


def test_exactly_level():
    # cos(90 deg) is 6e-17, or 0 exactly from a rotation matrix: both must do.
    cosine = [0.0, 6e-17, -6e-17]
    r_c, status = bend(
        TABLE,
        1000.0,
        1500.0,
        1.0,
        cosine,
        radius=RADIUS,
    )
    assert status.tolist() == [OK] * 3
    arcsec = r_c / ARCSEC
    assert np.ptp(arcsec) < 1e-8
    assert 60.0 < arcsec[0] < 400.0
    _, status = bend(
        TABLE,
        1000.0,
        500.0,
        1.0,
        0.0,
        radius=RADIUS,
    )
    assert status == MISSES_GROUND


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 135.0, 180.0])
def test_a_target_at_the_camera(degrees):
    r_c, status = bent(TABLE, 1234.5, 1234.5, degrees * DEGREE)
    assert r_c == 0.0
    assert status == OK


HIGH = AIR.top_m + 10.0
TO_1000_M = touching_angle(AIR, 5000.0, 1000.0)
UNDER_ALL_LAND = touching_angle(AIR, 5000.0, -500.0)


@pytest.mark.parametrize(
    ("h_c", "h_g", "zeta", "expected"),
    [
        (3000.0, 0.0, 90.0 * DEGREE, MISSES_GROUND),
        (3000.0, 0.0, 100.0 * DEGREE, MISSES_GROUND),
        (3000.0, 0.0, pi, MISSES_GROUND),
        (5000.0, 1000.0, TO_1000_M + 1e-7, MISSES_GROUND),
        # The ray goes on down, turns, and rises to 1000 m again ...
        (5000.0, 1000.0, TO_1000_M - 1e-7, BEYOND_GRAZING),
        (5000.0, 1000.0, UNDER_ALL_LAND + 1e-6, BEYOND_GRAZING),
        # ... where it does not meet land before; it turns 1.2 km lower here, far from grazing.
        (5000.0, 1000.0, UNDER_ALL_LAND - 1e-6, OK),
        (3000.0, 2800.0, 89.0 * DEGREE, BEYOND_GRAZING),
        (HIGH, 0.0, 0.5, OUTSIDE_PROFILE),
        (3000.0, -6000.0, 0.5, OUTSIDE_PROFILE),
        (0.0, HIGH, 0.5, OUTSIDE_PROFILE),
    ],
)
def test_a_ray_has_the_status_of_what_it_meets(h_c, h_g, zeta, expected):
    r_c, status = bent(TABLE, h_c, h_g, zeta)
    assert status == expected
    assert np.isfinite(r_c) == (expected in (OK, BEYOND_GRAZING))


BAD_VALUES = [(4, 0.0), (4, -RADIUS)]
for number in range(5):
    for no_number in (nan, inf, -inf):
        BAD_VALUES.append((number, no_number))


@pytest.mark.parametrize(("argument", "bad"), BAD_VALUES)
def test_what_is_no_number_is_flagged_and_its_neighbours_are_untouched(argument, bad):
    good = [3000.0, 0.0, 0.6, 0.8, RADIUS]
    values = np.tile(good, (3, 1))
    values[1, argument] = bad
    *ray, radius = values.T
    r_c, status = bend(TABLE, *ray, radius=radius)
    assert status.tolist() == [OK, BAD_MEASUREMENT, OK]
    assert np.isnan(r_c[1])
    alone, _ = bend(TABLE, *good[:4], radius=RADIUS)
    assert r_c[[0, 2]].tolist() == [alone, alone]


@pytest.mark.parametrize(
    ("code", "ray"),
    [
        ("RAY-MISSES-GROUND", (3000.0, 0.0, 100.0 * DEGREE)),
        ("RAY-OUTSIDE-PROFILE", (3000.0, -9000.0, 0.3)),
        ("RAY-BAD-MEASUREMENT", (nan, 0.0, 0.3)),
    ],
)
def test_scalars_are_refused_with_a_reason(code, ray):
    with refused(code, PhysicsError):
        refraction_angle(AIR, *ray)


@pytest.mark.parametrize(
    ("zeta", "where", "count"),
    [
        (45.0, "zeta_c", 1),
        (-0.1, "zeta_c", 1),
        ([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5], "zeta_c[6]", 1),
        (np.linspace(0.0, 75.0, 16), "zeta_c[1]", 15),
        ([[0.0, nan], [inf, 15.0]], "zeta_c[1, 1]", 1),
    ],
)
def test_degrees_for_radians_are_refused_with_the_unit(zeta, where, count):
    with refused("RAY-BAD-MEASUREMENT", PhysicsError, remedy="numpy.radians") as refusal:
        refraction_angle(AIR, 3000.0, 0.0, zeta)
    assert refusal.value.where == where
    assert refusal.value.count == count


def test_angles_that_are_no_numbers_stay_so_in_arrays():
    r_c = refraction_angle(AIR, 3000.0, 0.0, [0.0, nan, pi])
    assert np.isnan(r_c).tolist() == [False, True, True]


def test_the_name_of_a_standard_atmosphere_is_that_atmosphere():
    by_name = refraction_angle("us1976", 3000.0, 0.0, 0.5)
    assert by_name == refraction_angle(standard_atmosphere("us1976"), 3000.0, 0.0, 0.5)
    with refused("ATMOSPHERE-NAME", PhysicsError):
        refraction_angle("us1977", 3000.0, 0.0, 0.5)


def test_an_unknown_method_is_refused():
    with refused("METHOD-NAME", PhysicsError):
        refraction_angle(AIR, 3000.0, 0.0, 0.5, method="cubic")


def test_arguments_broadcast():
    h_c = np.array([[1000.0], [2000.0]])
    zeta = np.array([0.1, 0.5, 1.0])
    r_c = refraction_angle(AIR, h_c, 0.0, zeta)
    assert r_c.shape == (2, 3)
    assert r_c[1, 2] == refraction_angle(AIR, 2000.0, 0.0, 1.0)
    nothing = np.empty(0)
    r_c = refraction_angle(AIR, nothing, 0.0, nothing)
    assert r_c.shape == (0,)


@SETTINGS
@given(heights, heights, st.floats(0.0, pi))
def test_a_number_or_a_reason(h_c, h_g, zeta):
    r_c, status = bent(TABLE, h_c, h_g, zeta)
    if status in (OK, BEYOND_GRAZING):
        assert r_c < 1.5 * DEGREE
        assert r_c >= -1e-15  # air thins upwards: the apparent ray is always the higher
    else:
        assert status == MISSES_GROUND
        assert np.isnan(r_c)


def constant_index(value):
    coefficient = np.zeros((2, 8))
    coefficient[:, 0] = value
    edge_m = np.array([-500.0, 10_000.0, 40_000.0])
    return RayTable(edge_m, coefficient)


@pytest.mark.parametrize("value", [0.0, 3e-4])
@pytest.mark.parametrize("near_level", [False, True])
def test_no_gradient_no_bending(value, near_level):
    """The limits are 2 to 4 times what millions of rays reached.

    2.3e-11 arcsec; through a lowest point, which keeps 4e-12 m of its height, 3.4e-9, and 4.2e-8
    within 0.01 degrees of level.
    """
    rng = np.random.default_rng(1621)
    h_c, h_g = rng.uniform(-430.0, 30_000.0, (2, 100_000))
    zeta = rng.uniform(0.0, pi, h_c.size)
    if near_level:
        above_or_below = rng.choice([-1.0, 1.0], h_c.size)
        from_level = 10.0 ** rng.uniform(-12.0, -1.0, h_c.size)
        zeta = 0.5 * pi + above_or_below * from_level
    r_c, _ = bent(constant_index(value), h_c, h_g, zeta)
    turns = (h_g > h_c) & (zeta < 0.5 * pi)
    limit = np.full(zeta.shape, 1e-10)
    limit[turns] = 1e-8
    limit[turns & (zeta > 89.99 * DEGREE)] = 1e-7
    has_angle = np.isfinite(r_c)
    assert has_angle.sum() > 45_000
    arcsec = np.abs(r_c) / ARCSEC
    assert np.all((arcsec < limit)[has_angle])


@SETTINGS
@given(st.floats(0.0, 25_000.0), st.floats(1e-6, 100.0), st.floats(0.0, 80.0))
def test_vanishes_with_the_distance(h_c, rise, degrees):
    # N falls by less than 3.1e-8 a metre, so R is under half of that a metre times tan zeta.
    zeta = degrees * DEGREE
    bound = 1.7e-8 * rise * math.tan(zeta) + 1e-15
    below = refraction_angle(AIR, h_c, h_c - rise, zeta)
    above = refraction_angle(AIR, h_c, h_c + rise, pi - zeta)
    assert 0.0 <= below < bound
    assert abs(above) < bound


@SETTINGS
@given(st.floats(-400.0, 6_000.0), st.floats(1.0, 12_000.0), st.floats(1.0, 80.0))
def test_both_ends_of_a_ray_have_one_chord(low, rise, degrees):
    """Seen from its target a ray goes back where it came from: n r sin(zeta) is kept (Eq. 1)."""
    high = low + rise
    zeta_high = math.radians(degrees)  # downwards
    r_ratio = (RADIUS + high) / (RADIUS + low)
    n_low, n_high = 1.0 + AIR.refractivity([low, high])
    down, _ = bent(TABLE, high, low, zeta_high)
    ray_at_low = math.asin(n_high / n_low * r_ratio * math.sin(zeta_high))
    chord_at_low = math.asin(r_ratio * math.sin(zeta_high - down))
    up, _ = bent(TABLE, low, high, pi - ray_at_low)
    assert_near(up, chord_at_low - ray_at_low, 1e-13)
