"""Many steep rays from one camera: moments down to the target's interval, and the rest there."""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction._jit import entry, jit
from pipeline.refraction._moments import (
    LARGEST_DROP,
    SAME_RADIUS,
    WIDTH,
    class_of,
    fill,
    refractivity_near,
    series,
)
from pipeline.refraction._ray_kernel import sides_of, small_angle
from pipeline.refraction.status import OK

LEFT = 255
"""Mark of a ray that must be integrated by itself."""

# A table of moments costs as much as this many integrals.
WORTH_A_TABLE = 24

# A ray whose straight line would go this far down [m] before it is level passes no lowest point
# above land, whatever the air: 500 m of depth, and more again for the bending.
_DEEP_M = 1200.0

_X3, _W3 = (0.5 * a for a in np.polynomial.legendre.leggauss(3))
_X3 = 0.5 + _X3


@jit
def _interval(fine, hint, h):  # type: ignore[no-untyped-def]
    """Number of the fine interval that holds height h."""
    i = hint[min(max(int((h - fine[0]) / 125.0), 0), hint.size - 1)]
    while i < fine.size - 2 and fine[i + 1] <= h:
        i += 1
    return i


@jit
def _steep(fine, h_c, h_g, sin_c, cos_c, r_c, r_table):  # type: ignore[no-untyped-def]
    """Whether the series can serve a ray; False for what is no ray at all."""
    level = r_c * cos_c * cos_c
    return (
        0.0 < cos_c <= 1.0
        and 0.0 <= sin_c <= 1.0
        and fine[0] <= h_g < h_c
        and abs(r_c - r_table) < SAME_RADIUS * r_table
        and 2.0 * (h_c - h_g) <= LARGEST_DROP * level
        # Only then can the ray turn above land; the other kernel knows what to do about it.
        and level > 2.0 * (1.0 + sin_c) * (h_c + _DEEP_M)
    )


@jit
def _rest(fine, local, i, low, high, h_c, n_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """The difference integral between two heights of interval i, by itself.

    `integrand` of `_ray_kernel`, expanded in the bending, which is below 5e-3 here, and about the
    middle, from where b^2 differs by less than 1e-3 of itself.
    """
    r_c, middle = r_e + h_c, 0.5 * (low + high)
    index2 = (1.0 + n_c) * (1.0 + n_c)
    b2 = index2 * ((r_c * cos_c) ** 2 - (h_c - middle) * (r_c + r_e + middle))
    inverse = 1.0 / b2
    per_metre = 1.0 / (fine[i + 1] - fine[i])
    total = 0.0
    for j in range(_X3.size):
        h = low + (high - low) * _X3[j]
        r = r_e + h
        n = refractivity_near(local, i, (h - fine[i]) * per_metre)
        m = (n - n_c) * (2.0 + n + n_c)
        off = index2 * (h - middle) * (r + r_e + middle) * inverse
        cube = 1.0 - off * (1.5 - off * (1.875 - off * 2.1875))
        x = m * r * r * inverse * (1.0 - off * (1.0 - off))
        bent = 0.5 - x * (0.375 - x * (0.3125 - x * (0.2734375 - x * 0.24609375)))
        total += _W3[j] * m * r * cube * bent
    return total * (high - low) * inverse * math.sqrt(inverse)


@jit
def _run(  # type: ignore[no-untyped-def]
    fine, local, hint, first, last, table, h_c, h_g, sin_c, cos_c, r_e, at, half, angle, status
):
    """Rays from one height, in passes over all of them: short loops keep the processor busy.

    ``table`` is scratch for the moments, ``at`` and ``half`` for one number a ray.
    """
    top = lowest = _interval(fine, hint, h_c) + 1
    n_c = refractivity_near(local, top - 1, (h_c - fine[top - 1]) / (fine[top] - fine[top - 1]))
    r_table = r_e[first] + h_c
    for i in range(first, last):
        status[i], at[i] = LEFT, top - 1
        if _steep(fine, h_c, h_g[i], sin_c[i], cos_c[i], r_e[i] + h_c, r_table):
            status[i], at[i] = OK, _interval(fine, hint, h_g[i])
            lowest = min(lowest, at[i])
    for column in range(WIDTH):
        table[top, column] = 0.0
    fill(fine, local, h_c, n_c, 1.0 / r_table, top - 1, lowest, table)
    # No branch, whatever it computes for the others: this loop and the last run four at a time.
    for i in range(first, last):
        high = min(fine[at[i] + 1], h_c)
        rest = _rest(fine, local, at[i], h_g[i], high, h_c, n_c, cos_c[i], r_e[i])
        half[i] = 0.5 * (1.0 + n_c) * (r_e[i] + h_c) * sin_c[i] * rest
    for i in range(first, last):
        if status[i] == OK:
            w, x = 1.0 / (cos_c[i] * cos_c[i]), 1.0 / (r_e[i] + h_c)
            size = class_of(2.0 * (h_c - h_g[i]) * w * x, table[at[i], -1] * w)
            if size >= 0:
                above = series(table, at[i] + 1, size, w, x, 1.0 / r_table)
                half[i] += 0.5 * sin_c[i] / cos_c[i] * x * above
            else:
                status[i] = LEFT
    # Angles are below 0.01 wherever the series holds.
    for i in range(first, last):
        r_c, r_g = r_e[i] + h_c, r_e[i] + h_g[i]
        b2_g = (r_c * cos_c[i]) ** 2 - (h_c - h_g[i]) * (r_c + r_g)
        aside, ahead = sides_of(
            half[i], 1.0, r_c * sin_c[i], h_c - h_g[i], r_c * cos_c[i], b2_g, r_c, r_g
        )
        angle[i] = small_angle(aside / ahead)


@entry
def bend_steep_rays(  # type: ignore[no-untyped-def]
    fine, local, hint, h_c, h_g, sin_c, cos_c, r_e, angle, status
):
    """Fill ``angle`` [rad] and ``status`` of the steep rays among many from the same heights.

    Rays from one height that follow each other share a table of moments (`_moments`), filled
    downwards as far as their targets lie. The others get the status `LEFT`.
    """
    table = np.empty((fine.size, WIDTH))
    at, half = np.empty(h_c.size, np.int64), np.empty(h_c.size)
    first = 0
    while first < h_c.size:
        last = first + 1
        while last < h_c.size and h_c[last] == h_c[first]:
            last += 1
        if last - first >= WORTH_A_TABLE and fine[0] <= h_c[first] <= fine[-1]:
            _run(
                fine, local, hint, first, last, table, h_c[first], h_g, sin_c, cos_c, r_e, at,
                half, angle, status,
            )  # fmt: skip
        else:
            for i in range(first, last):
                status[i] = LEFT
        first = last
