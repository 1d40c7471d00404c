"""The compartment window against scalar Snell's law with 40 digits."""

import math

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from unbend.errors import PhysicsError
from unbend.refraction import Cabin, Window
from unbend.refraction.window import (
    OPTICAL_AXIS,
    SCHEDULE_TEMPERATURE_K,
    refract_at_window,
    scheduled_pressure,
)

OUTSIDE = 93.57e-6
CABIN = 187.84e-6


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


@pytest.mark.parametrize(
    ("cabin", "outside"),
    [
        (CABIN, OUTSIDE),
        (OUTSIDE, CABIN),
        (2e-4, 2e-4),
    ],
)
@pytest.mark.parametrize("degrees", [0.0, 1e-3, 20.0, 45.0, 70.0, 85.0])
@pytest.mark.parametrize(
    "normal",
    [
        OPTICAL_AXIS,
        unit(0.2, -0.1, 1.0),
        unit(0.0, 1.0, 0.3),
    ],
)
def test_against_scalar_snell(normal, degrees, cabin, outside):
    # A ray at the angle from the normal, in some plane through it.
    across = unit(*np.cross(normal, [0.3, 0.7, -0.2]))
    zeta = math.radians(degrees)
    ray = math.cos(zeta) * normal + math.sin(zeta) * across

    change, r_cc = refract_at_window(ray[None], cabin, outside, normal)

    with mp.workdps(40):
        sine = mp.norm(np.cross(ray, normal).tolist())
        inside = mp.atan2(sine, float(ray @ normal))
        bent = mp.asin(mp.sin(inside) * (1 + mp.mpf(cabin)) / (1 + mp.mpf(outside)))
        expected = float(bent - inside)
    # The cosine of the oracle's angle is known to 1e-16.
    assert_near(r_cc[0], expected, 2e-17 + 1e-11 * abs(expected))
    out = ray + change[0]
    assert_near(np.linalg.norm(out), 1.0, 4e-16)
    # In the plane of incidence, at the angle that Snell's law has.
    assert abs(np.dot(out, np.cross(normal, across))) < 1e-15
    assert_near(math.atan2(out @ across, out @ normal), float(bent), 4e-16)


def test_each_ray_has_its_index_and_its_normal():
    rays = np.array(
        [
            unit(0.3, 0.1, 1.0),
            unit(-0.2, 0.4, 1.0),
            unit(0.5, 0.0, 1.0),
        ]
    )
    normals = np.array(
        [
            unit(0.1, 0.0, 1.0),
            unit(0.0, -0.3, 1.0),
            unit(0.0, 0.0, 1.0),
        ]
    )
    cabin = np.array([CABIN, 0.0, OUTSIDE])
    change, r_cc = refract_at_window(rays, cabin, OUTSIDE, normals)
    for i in range(3):
        alone, angle = refract_at_window(rays[[i]], cabin[i], OUTSIDE, normals[i])
        assert_array_equal(change[[i]], alone)
        assert_array_equal(r_cc[[i]], angle)
    assert np.sign(r_cc).tolist() == [1.0, -1.0, 0.0]
    assert not change[2].any()


def test_total_reflection_is_nan():
    change, r_cc = refract_at_window(unit(1.0, 0.0, 1e-4)[None], 3e-4, 0.0)
    assert np.isnan(r_cc).all()
    assert np.isnan(change).all()


@pytest.mark.parametrize("cabin", [CABIN, OUTSIDE, 0.0])
def test_a_ray_along_the_window_or_from_outside_has_no_number(cabin):
    rays = np.array(
        [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0],
            unit(0.5, 0.0, -1.0),
            [0.0, 0.0, -1.0],
        ]
    )
    change, r_cc = refract_at_window(rays, cabin, OUTSIDE)
    assert np.isfinite(r_cc[0])
    assert np.isfinite(change[0]).all()
    assert np.isnan(r_cc[1:]).all()
    assert np.isnan(change[1:]).all()


def test_the_schedule_is_gyers():
    """His words below Table 6: ambient to 3 km, 701.2 mbar above; 70 F."""
    outside = np.array([101_325.0, 79_500.0, 70_121.0, 70_119.0, 26_500.0])
    expected = [101_325.0, 79_500.0, 70_121.0, 70_120.0, 70_120.0]
    assert scheduled_pressure(outside) == pytest.approx(expected)
    assert_near(SCHEDULE_TEMPERATURE_K, (70.0 + 459.67) / 1.8, 2e-3)


@pytest.mark.parametrize(
    "normal",
    [
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 2.0),
        (0.0, math.nan, 1.0),
        (0.0, 0.0, math.inf),
        (0.0, 0.0, -1.0),
        (1.0, 0.0, 0.0),
    ],
)
def test_a_normal_is_a_unit_vector_out_of_the_compartment(normal):
    with refused("WINDOW-NORMAL", PhysicsError):
        Window(Cabin("log"), normal)


def test_in_the_frame_of_the_body_a_normal_may_point_anywhere():
    assert Window(Cabin("log"), (0.0, 0.0, -1.0), frame="body").section == "window"


def test_a_plane_window_needs_the_air_behind_it():
    with refused("WINDOW-AIR", PhysicsError):
        Window(None)
    assert Window(None, shape="spherical").cabin is None
