"""Intervals cut into pieces that are short enough for a quadrature or a polynomial."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cut(edge: Array, longest: float) -> Array:
    """Edges with as few more evenly between them that no piece is longer than ``longest``.

    >>> cut(np.array([0.0, 1.0, 4.0]), 1.5).tolist()
    [0.0, 1.0, 2.5, 4.0]
    """
    pieces = [
        np.linspace(low, high, max(1, math.ceil((high - low) / longest)), endpoint=False)
        for low, high in pairwise(edge)
    ]
    return np.concatenate([*pieces, edge[-1:]])
