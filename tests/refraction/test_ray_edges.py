"""Rays at the edges: exactly down, level and up, past grazing, out of the air, not a number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend.atmosphere import standard_atmosphere
from unbend.errors import PhysicsError
from unbend.refraction import RayTable, bend, ray_table, refraction_angle
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
    STATUS_NAMES,
)
from unbend.units import ARCSEC, DEGREE

AIR = standard_atmosphere("us1976", index="gyer")
RADIUS = 6_371_000.0
SETTINGS = settings(max_examples=150, deadline=None)

heights = st.floats(-430.0, 30_000.0)
nadir_angles = st.floats(0.0, math.pi)


def bent(h_c, h_g, zeta, table=None):
    return bend(table or ray_table(AIR), h_c, h_g, np.sin(zeta), np.cos(zeta), radius=RADIUS)


def constant_index(value: float) -> RayTable:
    coefficient = np.zeros((2, 8))
    coefficient[:, 0] = value
    return RayTable(np.array([-500.0, 10_000.0, 40_000.0]), coefficient)


def test_exactly_at_the_nadir_and_at_the_zenith_nothing_bends():
    assert refraction_angle(AIR, 3000.0, 0.0, 0.0) == 0.0
    assert abs(refraction_angle(AIR, 1000.0, 3000.0, math.pi)) < 1e-18
    r_c, status = bend(ray_table(AIR), 1000.0, 3000.0, 0.0, -1.0, radius=RADIUS)
    assert (float(r_c), int(status)) == (0.0, OK)


def test_exactly_level():
    # cos(90 deg) is 6e-17, or 0 exactly from a rotation matrix: both must do.
    r_c, status = bend(ray_table(AIR), 1000.0, 1500.0, 1.0, [0.0, 6e-17, -6e-17], radius=RADIUS)
    assert status.tolist() == [OK, OK, OK]
    assert np.ptp(r_c) / ARCSEC < 1e-8
    assert 60.0 < r_c[0] / ARCSEC < 400.0
    _, status = bend(ray_table(AIR), 1000.0, 500.0, 1.0, 0.0, radius=RADIUS)
    assert int(status) == MISSES_GROUND


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 135.0, 180.0])
def test_a_target_at_the_camera(degrees):
    r_c, status = bent(1234.5, 1234.5, degrees * DEGREE)
    assert float(r_c) == 0.0
    assert int(status) == OK


def test_above_the_horizon_no_ground():
    r_c, status = bent(3000.0, 0.0, np.array([90.0, 100.0, 180.0]) * DEGREE)
    assert np.isnan(r_c).all()
    assert set(status.tolist()) == {MISSES_GROUND}


def grazing_angle(h_c: float, h_g: float) -> float:
    n_c, n_g = (1.0 + float(AIR.refractivity(h)) for h in (h_c, h_g))
    return math.asin(n_g * (RADIUS + h_g) / (n_c * (RADIUS + h_c)))


def test_the_ray_that_misses_the_ground():
    limit = grazing_angle(5000.0, 1000.0)
    _, status = bent(5000.0, 1000.0, limit + 1e-7)
    assert int(status) == MISSES_GROUND
    r_c, status = bent(5000.0, 1000.0, limit - 1e-7)
    assert int(status) == BEYOND_GRAZING  # the ray goes on down, turns, and rises to 1000 m again
    assert np.isfinite(r_c)


def test_beyond_grazing_is_said_only_where_a_far_branch_exists():
    # A ray whose lowest point lies below all land meets the ground before it can rise again.
    limit = grazing_angle(5000.0, -500.0)
    _, status = bent(5000.0, 1000.0, np.array([limit - 1e-6, limit + 1e-6]))
    assert status.tolist() == [OK, BEYOND_GRAZING]


def test_refraction_lets_one_see_beyond_the_straight_horizon():
    # A straight line would miss; the bent ray arrives. The apparent horizon is the nearer one
    # to the nadir: the bent ray grazes the ground sooner than the straight one.
    straight = math.asin((RADIUS + 0.0) / (RADIUS + 3000.0))
    assert grazing_angle(3000.0, 0.0) > straight
    r_c, status = bent(3000.0, 0.0, 0.5 * (straight + grazing_angle(3000.0, 0.0)))
    assert int(status) in (OK, BEYOND_GRAZING)
    assert 200.0 < float(r_c) / ARCSEC < 600.0


def test_outside_the_profile():
    high = AIR.top_m + 10.0
    for h_c, h_g in ((high, 0.0), (3000.0, -6000.0), (0.0, high)):
        r_c, status = bent(h_c, h_g, 0.5)
        assert np.isnan(r_c)
        assert int(status) == OUTSIDE_PROFILE


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_flagged(bad):
    table = ray_table(AIR)
    good = [3000.0, 0.0, 0.6, 0.8, RADIUS]
    for i in range(5):
        values = good.copy()
        values[i] = bad
        r_c, status = bend(table, *values[:4], radius=values[4])
        assert np.isnan(r_c)
        assert int(status) == BAD_MEASUREMENT
    for radius in (0.0, -RADIUS):
        assert int(bend(table, 3000.0, 0.0, 0.6, 0.8, radius=radius)[1]) == BAD_MEASUREMENT


def test_neighbours_of_bad_rows_are_untouched():
    r_c, status = bent(np.array([3000.0, np.nan, 3000.0]), 0.0, np.array([0.7, 0.7, 0.7]))
    assert status.tolist() == [OK, BAD_MEASUREMENT, OK]
    assert r_c[0] == r_c[2] == refraction_angle(AIR, 3000.0, 0.0, 0.7)


def test_scalars_are_refused_with_a_reason():
    cases = {
        "RAY-MISSES-GROUND": (3000.0, 0.0, 100.0 * DEGREE),
        "RAY-OUTSIDE-PROFILE": (3000.0, -9000.0, 0.3),
        "RAY-BAD-MEASUREMENT": (math.nan, 0.0, 0.3),
    }
    for code, (h_c, h_g, zeta) in cases.items():
        with pytest.raises(PhysicsError) as refusal:
            refraction_angle(AIR, h_c, h_g, zeta)
        assert refusal.value.code == code
    with pytest.raises(PhysicsError) as refusal:
        refraction_angle(AIR, 3000.0, 0.0, 45.0)  # degrees for radians
    assert refusal.value.code == "RAY-BAD-MEASUREMENT"
    assert "radians" in refusal.value.remedy
    with pytest.raises(PhysicsError) as refusal:
        refraction_angle(AIR, 3000.0, 0.0, 0.5, method="cubic")
    assert refusal.value.code == "METHOD-NAME"


def test_arguments_broadcast():
    r_c = refraction_angle(AIR, np.array([[1000.0], [2000.0]]), 0.0, np.array([0.1, 0.5, 1.0]))
    assert r_c.shape == (2, 3)
    assert r_c[1, 2] == refraction_angle(AIR, 2000.0, 0.0, 1.0)
    assert refraction_angle(AIR, np.empty(0), 0.0, np.empty(0)).shape == (0,)


@SETTINGS
@given(heights, heights, nadir_angles)
def test_a_number_or_a_reason(h_c, h_g, zeta):
    r_c, status = bent(h_c, h_g, zeta)
    if int(status) in (OK, BEYOND_GRAZING):
        assert abs(float(r_c)) < 1.5 * DEGREE
        assert float(r_c) >= -1e-15  # air thins upwards: the apparent ray is always the higher
    else:
        assert int(status) == MISSES_GROUND
        assert np.isnan(r_c)


@SETTINGS
@given(heights, heights, nadir_angles, st.sampled_from([0.0, 3e-4]))
def test_no_gradient_no_bending(h_c, h_g, zeta, value):
    r_c, status = bent(h_c, h_g, zeta, constant_index(value))
    if int(status) in (OK, BEYOND_GRAZING):
        assert abs(float(r_c)) / ARCSEC < nearly_nothing(h_c, h_g, zeta)


def nearly_nothing(h_c, h_g, zeta):
    """Arcseconds by which rays in constant air may err: 2 to 4 times what millions reached.

    2.3e-11; through a lowest point, which keeps 4e-12 m of its height, 3.4e-9, and 4.2e-8 within
    0.01 degrees of level.
    """
    turning = (h_g > h_c) & (zeta < 0.5 * np.pi)
    level = turning & (zeta > 89.99 * DEGREE)
    return np.where(level, 1e-7, np.where(turning, 1e-8, 1e-10))


@pytest.mark.parametrize("value", [0.0, 3e-4])
@pytest.mark.parametrize("level", [False, True])
def test_no_gradient_no_bending_of_very_many_rays(value, level):
    rng = np.random.default_rng(1621)
    h_c, h_g = rng.uniform(-430.0, 30_000.0, (2, 100_000))
    zeta = rng.uniform(0.0, np.pi, h_c.size)
    if level:
        off = rng.choice([-1.0, 1.0], h_c.size) * 10.0 ** rng.uniform(-12.0, -1.0, h_c.size)
        zeta = 0.5 * np.pi + off
    r_c, _ = bent(h_c, h_g, zeta, constant_index(value))
    known = np.isfinite(r_c)
    assert known.sum() > 45_000
    assert np.all(np.abs(r_c / ARCSEC)[known] < nearly_nothing(h_c, h_g, zeta)[known])


@SETTINGS
@given(heights, heights, st.floats(0.0, 80.0), st.floats(1e-3, 5.0))
def test_grows_with_the_nadir_angle(h_c, h_g, degrees, more):
    h_c, h_g = max(h_c, h_g), min(h_c, h_g)
    wider = min(degrees + more, 80.0)
    if h_c - h_g < 1.0 or wider - degrees < 1e-4:
        return
    one, two = (refraction_angle(AIR, h_c, h_g, d * DEGREE) for d in (degrees, wider))
    assert two > one >= 0.0


@SETTINGS
@given(st.floats(0.0, 25_000.0), st.floats(1e-6, 100.0), st.floats(0.0, 80.0))
def test_vanishes_with_the_distance(h_c, rise, degrees):
    # N falls by less than 3.1e-8 a metre, so R is under half of that a metre times tan zeta.
    below = refraction_angle(AIR, h_c, h_c - rise, degrees * DEGREE)
    above = refraction_angle(AIR, h_c, h_c + rise, math.pi - degrees * DEGREE)
    bound = 1.7e-8 * rise * math.tan(degrees * DEGREE) + 1e-15
    assert 0.0 <= below < bound
    assert abs(above) < bound


@SETTINGS
@given(st.floats(20.0, 20_000.0), st.floats(-400.0, 0.0), st.floats(0.0, 85.0))
def test_seen_from_the_other_end(h_c, h_g, degrees):
    """The ray back from the ground has the same ends: the two angles sum to the whole bending.

    With the straight chord between them, zeta_c - R_c + (chord at the ground) and the angle at the
    centre close the triangle; computed here from the two refraction angles alone.
    """
    zeta = degrees * DEGREE
    down, status = bent(h_c, h_g, zeta)
    if int(status) != OK:
        return
    n_c, n_g = (1.0 + float(AIR.refractivity(h)) for h in (h_c, h_g))
    sine = n_c * (RADIUS + h_c) * math.sin(zeta) / (n_g * (RADIUS + h_g))
    if sine >= 0.999:
        return
    at_ground = math.pi - math.asin(sine)
    up, status = bent(h_g, h_c, at_ground)
    assert int(status) == OK
    chord_c = zeta - float(down)
    chord_g = at_ground - float(up)
    # Law of sines in the triangle camera - centre - ground.
    left = (RADIUS + h_c) * math.sin(chord_c)
    right = (RADIUS + h_g) * math.sin(math.pi - chord_g)
    assert left == pytest.approx(right, abs=3e-8 * RADIUS * 1e-3 + 1e-3)


def test_the_dense_end_bends_more():
    # The same layer of air, seen from above and from below: the chord's law of sines.
    h_c = 10_000.0
    h_g = 0.0
    zeta = 60.0 * DEGREE
    down = refraction_angle(AIR, h_c, h_g, zeta)
    n_c, n_g = (1.0 + float(AIR.refractivity(h)) for h in (h_c, h_g))
    sine = n_c * (RADIUS + h_c) * math.sin(zeta) / (n_g * (RADIUS + h_g))
    up = refraction_angle(AIR, h_g, h_c, math.pi - math.asin(sine))
    assert up > down > 0.0


def test_a_ray_that_turns_below_a_near_target_may_mean_the_second_crossing():
    """1 degree below the horizon from 3 km it turns 1.2 km lower: far from grazing at 2800 m."""
    sine = np.sin(np.radians(89.0))
    cosine = np.cos(np.radians(89.0))
    near, status = bend(ray_table(AIR), 3000.0, 2800.0, sine, cosine)
    assert STATUS_NAMES[int(status)] == "beyond_grazing"
    again, status = bend(ray_table(AIR), 3000.0, 2800.0, sine, cosine, distance=12_000.0)
    assert (STATUS_NAMES[int(status)], again) == ("ok", near)
    far, status = bend(ray_table(AIR), 3000.0, 2800.0, sine, cosine, distance=240_000.0)
    assert STATUS_NAMES[int(status)] == "far_branch"
    assert far > 5.0 * near
