"""Comparisons of arrays, for the tests of refraction."""

import numpy as np


def assert_near(values, expected, atol, **options):
    """Values differ by no more than the third argument, whatever their size."""
    assert_close(values, expected, rtol=0.0, atol=atol, **options)


def assert_close(
    values,
    expected,
    rtol,
    atol=0.0,
    *,
    equal_nan=False,
):
    """Values differ by no more than ``rtol`` of what is expected, and ``atol`` more."""
    np.testing.assert_allclose(
        values,
        expected,
        rtol=rtol,
        atol=atol,
        equal_nan=equal_nan,
    )
