"""Properties that hold for any ray, window and camera (hypothesis)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    RayTable,
    apply_refraction,
    bend,
    correct_observations,
    ray_table,
)
from unbend.refraction.status_codes import OK
from unbend.refraction.window import refract_at_window

RADIUS = 6_371_000.0
AIR = standard_atmosphere("us1976")
TABLE = ray_table(AIR)
CAMERA = Camera(14_000, 10_600, 11_000.0, 11_000.0, 7000.0, 5300.0, BrownConrady(-0.018, 0.009))
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
unit_vectors = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)).map(
    lambda t: np.array([[*t, math.sqrt(1.0 - t[0] ** 2 - t[1] ** 2)]])
)
heights = st.floats(-400.0, 12_000.0)
short = settings(max_examples=50, deadline=None)


def bent(table, h_c, h_g, zeta):
    r_c, status = bend(table, h_c, h_g, np.sin(zeta), np.cos(zeta), radius=RADIUS)
    return r_c, status


@short
@given(st.floats(100.0, 12_000.0), st.floats(0.001, 1.0), st.floats(0.0, 80.0), st.floats(0.1, 5.0))
def test_r_c_grows_with_the_nadir_angle(h_c, share, degrees, more):
    h_g = h_c - share * (h_c + 400.0)
    (less, greater), status = bent(TABLE, h_c, h_g, np.radians([degrees, degrees + more]))
    assert status.tolist() == [OK, OK]
    assert 0.0 <= less < greater


@short
@given(st.floats(0.0, 4e-4), heights, heights, st.floats(0.0, 80.0))
def test_air_of_one_index_bends_nothing(n, h_c, h_g, degrees):
    constant = np.zeros((40, 8))
    constant[:, 0] = n
    table = RayTable(np.linspace(-1000.0, 19_000.0, 41), constant)
    zeta = math.radians(degrees if h_g <= h_c else 180.0 - degrees)
    r_c, status = bent(table, h_c, h_g, zeta)
    assert status == OK
    assert abs(float(r_c)) < 1e-15


@short
@given(heights, heights, st.floats(1.0, 80.0))
def test_both_ends_of_a_ray_have_one_chord(h_c, h_g, degrees):
    """Seen from its target a ray goes back where it came from: n r sin(zeta) is kept (Eq. 1)."""
    low, high = sorted((h_c, h_g))
    if high - low < 1.0:
        high = low + 1.0
    zeta_high = math.radians(degrees)  # downwards
    r_low = RADIUS + low
    r_high = RADIUS + high
    n_low, n_high = (1.0 + float(AIR.refractivity(h)) for h in (low, high))
    r_c, _ = bent(TABLE, high, low, zeta_high)
    ray_at_low = math.asin(n_high * r_high * math.sin(zeta_high) / (n_low * r_low))
    chord_at_low = math.asin(r_high * math.sin(zeta_high - float(r_c)) / r_low)
    back, _ = bent(TABLE, low, high, math.pi - ray_at_low)
    assert float(back) == pytest.approx(chord_at_low - ray_at_low, abs=1e-13)


@short
@given(unit_vectors, unit_vectors, st.floats(0.0, 4e-4))
def test_a_window_between_like_air_does_nothing(ray, normal, n):
    assume(float(ray[0] @ normal[0]) > 0.0)  # others do not cross it
    change, angle = refract_at_window(ray, n, n, normal[0])
    assert not change.any()
    assert angle.tolist() == [0.0]


@short
@given(unit_vectors, unit_vectors, st.floats(0.0, 4e-4), st.floats(0.0, 4e-4))
def test_out_of_a_window_and_in_again(ray, normal, inside, outside):
    assume(float(ray[0] @ normal[0]) > 0.1)  # others do not cross it, or not from both sides
    out, angle = refract_at_window(ray, inside, outside, normal[0])
    back, returned = refract_at_window(ray + out, outside, inside, normal[0])
    np.testing.assert_allclose(back, -out, rtol=0.0, atol=1e-15)
    assert returned[0] == pytest.approx(-angle[0], abs=1e-15)
    # n sin(angle to the normal) is kept, and the ray stays in one plane with the normal.
    before, after = (np.cross(normal[0], d) for d in (ray[0], ray[0] + out[0]))
    np.testing.assert_allclose((1.0 + inside) * before, (1.0 + outside) * after, atol=1e-15)


def exposures(cabin: float = 0.0, change_px: float = 0.0, tilt: float = 0.0) -> Exposures:
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, math.cos(tilt), -math.sin(tilt)],
            [0.0, math.sin(tilt), math.cos(tilt)],
        ]
    )
    outside = np.atleast_1d(AIR.refractivity(3000.0))
    return Exposures(
        np.array([True]),
        (turn @ DOWN)[None],
        np.array([0.8]),
        np.array([3000.0]),
        outside,
        outside + cabin,
        principal_change_px=np.array([change_px]),
        radius_m=RADIUS,
    )


@short
@given(st.floats(0.0, 7000.0), st.floats(0.0, 5300.0), st.floats(0.0, 1e-4))
def test_the_shifts_of_a_vertical_image_are_symmetric(x, y, cabin):
    both = correct_observations(
        np.array([x, 14_000.0 - x]),
        np.array([y, 10_600.0 - y]),
        np.zeros(2),
        np.zeros(2, np.int64),
        exposures(cabin),
        camera=CAMERA,
        table=TABLE,
    )
    # One unit in the last place of u = x/f, up to 5.6e-17 here, is 1.1e-12 px; several add up.
    assert both.dx_px[0] == pytest.approx(-both.dx_px[1], abs=5e-12)
    assert both.dy_px[0] == pytest.approx(-both.dy_px[1], abs=5e-12)


@short
@given(
    st.floats(500.0, 13_500.0),
    st.floats(500.0, 10_100.0),
    st.floats(-1e-4, 1e-4),
    st.floats(-30.0, 30.0),
    st.floats(-0.4, 0.4),
)
def test_what_is_applied_is_removed_again(x, y, cabin, change_px, tilt):
    setup = exposures(cabin, change_px, tilt)
    where = (np.zeros(1), np.zeros(1, np.int64), setup)
    seen = apply_refraction(np.array([x]), np.array([y]), *where, camera=CAMERA, table=TABLE)
    back = correct_observations(
        seen.x_corrected_px, seen.y_corrected_px, *where, camera=CAMERA, table=TABLE
    )
    assert back.x_corrected_px[0] == pytest.approx(x, abs=1e-9)
    assert back.y_corrected_px[0] == pytest.approx(y, abs=1e-9)
