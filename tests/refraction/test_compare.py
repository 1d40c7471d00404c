"""The comparison of the methods: differences, and the angle to which a method is good."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction.angle import Comparison, compare_methods
from unbend.units import ARCSEC, DEGREE


@pytest.mark.parametrize(
    ("errors", "good"),
    [
        ([0.0, 0.05, -0.2, 0.0], 10.0),
        ([0.0, -0.05, 0.1, 5.0], 20.0),  # the limit itself is good
        ([0.3, 0.0, 0.0, 0.0], -1.0),
        ([np.nan, np.nan, np.nan, np.nan], np.nan),
        ([0.0, 0.0, np.nan, 0.0], 10.0),
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
    np.testing.assert_array_equal(comparison.good_to(0.1), [[good]])


AIR = standard_atmosphere("us1976", index="gyer")


def test_errors_are_method_minus_spherical():
    """At 10 km over the sea: the Manual's K by hand against the check value."""
    angles = np.array([45.0, 75.0]) * DEGREE
    comparison = compare_methods(AIR, np.array([10_000.0]), 0.0, angles, methods=("manual",))
    exact = np.array([16.378452, 61.778543])
    assert comparison.exact_rad[0] / ARCSEC == pytest.approx(exact, abs=1e-6)
    manual = 2410e-6 * 10 / 290 * np.tan(angles) / ARCSEC
    assert comparison.error_rad[0, 0] / ARCSEC == pytest.approx(manual - exact, abs=1e-6)


def test_where_a_method_is_not_defined_it_is_not_good():
    heights = np.array([6e3, 12e3])
    methods = ("saastamoinen1974_quadratic",)
    comparison = compare_methods(AIR, heights, 0.0, np.array([0.5]), methods=methods)
    assert np.isfinite(comparison.good_to(1.0)).tolist() == [[True, False]]
