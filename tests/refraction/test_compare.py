"""The comparison of the methods: differences, and the angle to which a method is good."""

from math import nan

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_near
from tests.refraction.rays import AIR
from unbend.refraction.angle import Comparison, compare_methods
from unbend.units import ARCSEC


@pytest.mark.parametrize(
    ("errors", "good"),
    [
        ([0.0, 0.05, -0.2, 0.0], 10.0),
        ([0.0, -0.05, 0.1, 5.0], 20.0),  # the limit itself is good
        ([0.3, 0.0, 0.0, 0.0], -1.0),
        ([nan] * 4, nan),
        ([0.0, 0.0, nan, 0.0], 10.0),
        ([0.0, 0.0, 0.0, 0.0], 30.0),
    ],
)
def test_good_to_counts_from_the_nadir_up_to_the_first_failure(errors, good):
    comparison = Comparison(
        methods=("a",),
        h_c_m=np.array([1e3]),
        h_g_m=0.0,
        nadir_angle_rad=np.array([0.0, 10.0, 20.0, 30.0]),
        exact_rad=np.ones((1, 4)),
        error_rad=np.array([[errors]]),
    )
    assert_array_equal(comparison.good_to(0.1), [[good]])


def test_errors_are_method_minus_spherical():
    """At 10 km over the sea: the Manual's K by hand against the check value."""
    angles = np.radians([45.0, 75.0])
    heights = np.array([10_000.0])
    comparison = compare_methods(
        AIR,
        heights,
        0.0,
        angles,
        methods=("manual",),
    )
    exact = np.array([16.378452, 61.778543])
    assert_near(comparison.exact_rad[0] / ARCSEC, exact, 1e-6)
    manual = 2410e-6 * 10 / 290 * np.tan(angles) / ARCSEC
    assert_near(comparison.error_rad[0, 0] / ARCSEC, manual - exact, 1e-6)


def test_where_a_method_is_not_defined_it_is_not_good():
    heights = np.array([6e3, 12e3])
    methods = ("saastamoinen1974_quadratic",)
    angles = np.array([0.5])
    comparison = compare_methods(AIR, heights, 0.0, angles, methods=methods)
    good_to = comparison.good_to(1.0)
    assert np.isfinite(good_to).tolist() == [[True, False]]
