"""Refractivity from a `RayTable`, compiled: pieces of the profile as polynomials in height."""

from __future__ import annotations

from pipeline.refraction.kernels.jit import jit


@jit
def piece(edge, h):  # type: ignore[no-untyped-def]
    """Number of the piece of the table that holds height h."""
    low, high = 0, edge.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edge[middle] <= h:
            low = middle
        else:
            high = middle
    return low


@jit
def refractivity(edge, coefficient, i, h):  # type: ignore[no-untyped-def]
    """N at height h by the polynomial of piece i."""
    u = (h - edge[i]) / (edge[i + 1] - edge[i])
    value = coefficient[i, 7]
    for j in range(6, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@jit
def gradient(edge, coefficient, i, h):  # type: ignore[no-untyped-def]
    """dN/dh at height h."""
    width = edge[i + 1] - edge[i]
    u = (h - edge[i]) / width
    value = 7.0 * coefficient[i, 7]
    for j in range(6, 0, -1):
        value = value * u + j * coefficient[i, j]
    return value / width
