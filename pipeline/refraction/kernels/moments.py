"""Many steep rays from one camera: the difference integral as a series in moments of the air.

With x = 1/r_c, y = h_c - h, u = y x (2 - y x) = 1 - (r/r_c)^2, w = 1/cos^2 zeta_c and
m = n^2 - n_c^2, the difference form of `_ray_kernel` expands, where w u and w m are small, into

    delta = x tan zeta_c  sum_p w^p  sum_k (w x)^k  M_pk
    M_pk = c_p b_pk / n_c^(2p)  integral_{h_g}^{h_c}  m^p (1 - y x)^(2p-1) y^k (2 - y x)^k  dh

with c_p from 1/sqrt(1 + s) and b_pk = binomial(p - 1/2 + k, k). The angle does not enter the
moments M_pk, and the radius hardly: they are kept with their derivative by x. One table of them,
from the camera down, serves all rays of an exposure, however many layers they cross.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction.kernels.jit import jit

# The series is left where its terms fall too slowly: w u and w m at the target.
LARGEST_DROP = 0.06
LARGEST_BEND = 5e-3

# The derivative by x is good for radii within this share of each other: over 30 km of height the
# next term is then 1e-11 of the whole.
SAME_RADIUS = 0.01

# How many moments of each order p the series needs for 1e-12 of itself, and up to which w u and
# w m: three classes, most rays of a camera are in the first.
_COUNT = np.array([[6, 4, 3, 1, 0], [8, 6, 4, 3, 1], [12, 9, 7, 5, 4]])
_DROP = np.array([0.005, 0.02, LARGEST_DROP])
_BEND = np.array([6e-4, 2e-3, LARGEST_BEND])

_ORDERS = _COUNT.shape[1]
_LONGEST = _COUNT[-1]
_START = np.concatenate([[0], np.cumsum(_LONGEST)])
_FACTOR = np.zeros((_ORDERS, int(_LONGEST.max())))
for _p in range(1, _ORDERS + 1):
    _c = math.prod(-(0.5 + i) / (1.0 + i) for i in range(_p))
    for _k in range(_FACTOR.shape[1]):
        _FACTOR[_p - 1, _k] = -_c * math.prod((_p + 0.5 + i) / (1.0 + i) for i in range(_k))

WIDTH = 2 * int(_START[-1]) + 1
"""Columns of the table: the moments with their derivatives, and the largest |m| above."""

X3, W3 = (0.5 * a for a in np.polynomial.legendre.leggauss(3))
X3 = 0.5 + X3


@jit
def refractivity_near(local, i, u):  # type: ignore[no-untyped-def]
    """N at the share u of interval i, by its polynomial of degree 5."""
    value = local[i, 5]
    for j in range(4, -1, -1):
        value = value * u + local[i, j]
    return value


@jit
def _add(fine, local, i, high, h_c, n_c, x, moments):  # type: ignore[no-untyped-def]
    """Add the moments of the air of interval i, up to ``high``."""
    low, index2 = fine[i], (1.0 + n_c) * (1.0 + n_c)
    share = (high - low) / (fine[i + 1] - low)
    for j in range(X3.size):
        n = refractivity_near(local, i, share * X3[j])
        m = (n - n_c) * (2.0 + n + n_c)
        if abs(m) > moments[-1]:
            moments[-1] = abs(m)
        y = h_c - (low + (high - low) * X3[j])
        inside = 1.0 - y * x
        along = y * (2.0 - y * x)
        power = W3[j] * (high - low) / inside
        for p in range(_ORDERS):
            power *= m / index2 * inside * inside
            term = power
            # Of the logarithm by x: of (1 - y x)^(2p - 1), and of (2 - y x)^k.
            slope = -(2 * p + 1) * y / inside
            step = -y / (2.0 - y * x)
            for k in range(_LONGEST[p]):
                value = _FACTOR[p, k] * term
                column = 2 * (_START[p] + k)
                moments[column] += value
                moments[column + 1] += value * (slope + k * step)
                term *= along


@jit
def fill(fine, local, h_c, n_c, x, first, last, table):  # type: ignore[no-untyped-def]
    """Moments from ``fine[i]`` up to the camera into ``table[i]``, for i from first down to last.

    ``table[first + 1]`` must hold those of the height above.
    """
    for i in range(first, last - 1, -1):
        for column in range(WIDTH):
            table[i, column] = table[i + 1, column]
        high = fine[i + 1] if fine[i + 1] < h_c else h_c
        _add(fine, local, i, high, h_c, n_c, x, table[i])


@jit
def class_of(drop, bend):  # type: ignore[no-untyped-def]
    """Which class of lengths of the series is enough; -1 where none is."""
    for c in range(_DROP.size):
        if drop <= _DROP[c] and bend <= _BEND[c]:
            return c
    return -1


@jit
def series(n, moments, c, w, x, x_table, scratch, total):  # type: ignore[no-untyped-def]
    """Fill delta / (x tan zeta_c) of n rays between one height and the camera, by class c.

    ``moments`` is the height's row of the table, made for ``x_table``; ``scratch`` (3, n) or
    longer is room to work in.
    """
    t, change, part = scratch[0], scratch[1], scratch[2]
    for i in range(n):
        t[i] = w[i] * x[i]
    for i in range(n):
        change[i] = x[i] - x_table
        total[i] = 0.0
    # Term by term over all rays: the short loops run four rays at a time.
    for p in range(_ORDERS - 1, -1, -1):
        for i in range(n):
            part[i] = 0.0
        for k in range(_COUNT[c, p] - 1, -1, -1):
            column = 2 * (_START[p] + k)
            value, slope = moments[column], moments[column + 1]
            for i in range(n):
                part[i] = part[i] * t[i] + (value + change[i] * slope)
        for i in range(n):
            total[i] = (total[i] + part[i]) * w[i]
