"""Comparisons of arrays, for the tests of refraction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def assert_near(values: ArrayLike, expected: ArrayLike, atol: float) -> None:
    """Values differ by no more than ``atol``, whatever their size."""
    np.testing.assert_allclose(values, expected, rtol=0.0, atol=atol)
