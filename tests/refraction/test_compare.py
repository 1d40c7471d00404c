"""The comparison of the methods: differences, and the angle to which a method is good."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction.angle import Comparison, compare_methods
from unbend.units import ARCSEC, DEGREE


def test_good_to_counts_from_the_nadir_up_to_the_first_failure():
    nan = np.nan
    errors = [
        [[0.0, 0.05, -0.2, 0.0], [0.0, -0.05, 0.1, 5.0]],
        [[0.3, 0.0, 0.0, 0.0], [nan, nan, nan, nan]],
        [[0.0, 0.0, nan, 0.0], [0.0, 0.0, 0.0, 0.0]],
    ]
    found = Comparison(
        ("a", "b", "c"),
        np.array([1e3, 2e3]),
        0.0,
        np.array([0.0, 10.0, 20.0, 30.0]),
        np.ones((2, 4)),
        np.array(errors),
    )
    good = found.good_to(0.1)
    assert np.array_equal(good, [[10.0, 20.0], [-1.0, nan], [10.0, 30.0]], equal_nan=True)


def test_errors_are_method_minus_spherical():
    """At 10 km over the sea, 45 degrees: the Manual's K by hand against the check value."""
    air = standard_atmosphere("us1976", index="gyer")
    angles = np.array([45.0, 75.0]) * DEGREE
    found = compare_methods(air, np.array([10_000.0]), 0.0, angles, methods=("manual",))
    assert (found.exact_rad / ARCSEC)[0] == pytest.approx([16.378452, 61.778543], abs=1e-6)
    manual = 2410e-6 * 10 / 290 * np.tan(angles) / ARCSEC
    assert (found.error_rad / ARCSEC)[0, 0] == pytest.approx(
        manual - [16.378452, 61.778543], abs=1e-6
    )


def test_where_a_method_is_not_defined_it_is_not_good():
    air = standard_atmosphere("us1976", index="gyer")
    found = compare_methods(
        air, np.array([6e3, 12e3]), 0.0, np.array([0.5]), methods=("saastamoinen1974_quadratic",)
    )
    assert np.isfinite(found.good_to(1.0)).tolist() == [[True, False]]
