"""The refractivity of a profile as polynomials in height, the form that the kernels read."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from unbend.atmosphere.profile import Profile
from unbend.refraction.kernels.columns import HINT_M, FineTable, IndexTable
from unbend.units import Array

# Longest piece of the profile on which n - 1 is a polynomial of degree 7 in height: pieces of
# 500 m reproduce a troposphere to 1e-13 of n - 1.
_PIECE_M = 500.0
_DEGREE = 7

# Longest interval of the fine table: three nodes in it integrate the moments of the air to 1e-12,
# sharp inversions included.
_FINE_M = 62.5
_FINE_DEGREE = 5


@dataclass(frozen=True, eq=False)
class RayTable:
    """A profile's refractivity as polynomials, the form the ray kernel reads.

    ``edge_m`` is (m + 1,) heights [m]; ``coefficient`` is (m, 8): refractivity in piece i is the
    polynomial in u = (h - edge[i]) / (edge[i + 1] - edge[i]), lowest power first.
    """

    edge_m: Array
    coefficient: Array

    @property
    def pieces(self) -> IndexTable:
        """The same table as a tuple for compiled functions."""
        return IndexTable(self.edge_m, self.coefficient)

    @cached_property
    def fine(self) -> FineTable:
        """The same refractivity in intervals of at most 62.5 m, by polynomials of degree 5."""
        edge = cut(self.edge_m, _FINE_M)
        lower_end = edge[:-1]
        nodes = _chebyshev_nodes(_FINE_DEGREE)
        height = _heights_of_nodes(edge, nodes)
        edges_below = np.searchsorted(self.edge_m, lower_end, side="right")
        piece = edges_below - 1  # the piece that contains each interval
        bottom = self.edge_m[piece, None]
        thickness = np.diff(self.edge_m)[piece, None]
        share = (height - bottom) / thickness  # u of the nodes in their piece
        coefficients = self.coefficient[piece].T
        refractivity = np.polynomial.polynomial.polyval(
            share,
            coefficients[..., None],
            tensor=False,
        )
        values = np.asarray(refractivity, np.float64)
        # For searches: the interval at each of many evenly spaced heights.
        marks = np.arange(edge[0], edge[-1], HINT_M)
        interval = np.searchsorted(edge, marks, side="right") - 1
        return FineTable(
            edge=edge,
            coefficient=_polynomials(nodes, values),
            hint=np.clip(interval, 0, edge.size - 2),
        )


@lru_cache(maxsize=64)
def ray_table(profile: Profile) -> RayTable:
    """The refractivity of a profile as polynomials, which agree with it to 1e-13 of n - 1."""
    edge = cut(profile.break_heights_m, _PIECE_M)
    nodes = _chebyshev_nodes(_DEGREE)
    # Nodes stay inside their piece, so each is evaluated in its own layer.
    refractivity = profile.refractivity(_heights_of_nodes(edge, nodes))
    return RayTable(edge, _polynomials(nodes, refractivity))


def cut(edge: Array, longest: float | Array) -> Array:
    """The edges, and between them as few evenly spaced ones as make no piece exceed ``longest``.

    ``edge`` (k + 1,) rising; ``longest`` is one length for all k intervals, or (k,).

    >>> cut(np.array([0.0, 1.0, 4.0]), 1.5).tolist()
    [0.0, 1.0, 2.5, 4.0]
    """
    parts = np.ceil(np.diff(edge) / longest)
    parts = np.maximum(1, parts).astype(int)
    pieces = []
    intervals = pairwise(edge)
    for (low, high), count in zip(intervals, parts, strict=True):
        ends = np.linspace(low, high, count, endpoint=False)
        pieces.append(ends)
    return np.concatenate([*pieces, edge[-1:]])


def _heights_of_nodes(edge: Array, nodes: Array) -> Array:
    """(m, d + 1) heights of the nodes in m pieces between edges (m + 1,).

    ``nodes`` (d + 1,) are shares of a piece, 0 to 1.
    """
    thickness = np.diff(edge)
    return edge[:-1, None] + thickness[:, None] * nodes


def _chebyshev_nodes(degree: int) -> Array:
    """degree + 1 nodes between 0 and 1: the zeros of a Chebyshev polynomial."""
    count = degree + 1
    angles = np.pi * (np.arange(count) + 0.5) / count
    return 0.5 - 0.5 * np.cos(angles)


def _polynomials(nodes: Array, values: Array) -> Array:
    """(m, d + 1) coefficients, lowest power first, of m polynomials through d + 1 points each.

    ``nodes`` (d + 1,) are the abscissas of all, ``values`` (m, d + 1) the ordinates.
    """
    count = nodes.size
    vandermonde = np.vander(nodes, count, increasing=True)
    coefficients = np.linalg.solve(vandermonde, values.T)
    return np.ascontiguousarray(coefficients.T)
