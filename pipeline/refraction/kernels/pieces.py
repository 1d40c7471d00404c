"""Intervals cut into pieces that are short enough for a quadrature or a polynomial."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cut(edge: Array, longest: float | Array) -> Array:
    """Edges with as few more evenly between them that no piece is longer than ``longest``.

    ``edge`` (k + 1,) rising; ``longest`` one length for all intervals or (k,).

    >>> cut(np.array([0.0, 1.0, 4.0]), 1.5).tolist()
    [0.0, 1.0, 2.5, 4.0]
    """
    parts = np.maximum(1, np.ceil(np.diff(edge) / longest)).astype(int)
    pieces = [
        np.linspace(low, high, count, endpoint=False)
        for low, high, count in zip(edge[:-1], edge[1:], parts, strict=True)
    ]
    return np.concatenate([*pieces, edge[-1:]])
