"""Many steep rays from one camera: moments down to the target's interval, and the rest there."""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction.kernels.jit import entry, jit, within
from pipeline.refraction.kernels.moments import (
    LARGEST_BEND,
    LARGEST_DROP,
    SAME_RADIUS,
    W3,
    WIDTH,
    X3,
    class_of,
    fill,
    refractivity_near,
    series,
)
from pipeline.refraction.kernels.ray import sides_of, small_angle
from pipeline.refraction.status import OK

LEFT = 255
"""Mark of a ray that must be integrated by itself."""

# A table of moments costs as much as this many integrals.
WORTH_A_TABLE = 24

# As many rays from one height are taken together: their columns fit into a core's cache.
_TOGETHER = 4096

# Columns of the rays to one interval; which of them are 1/cos^2 zeta_c and the angle.
ROWS, W, ANGLE = 12, 4, 11

# A ray whose straight line would go this far down [m] before it is level passes no lowest point
# above land, whatever the air: 500 m of depth, and more again for the bending.
_DEEP_M = 1200.0


@jit
def _interval(fine, hint, h):  # type: ignore[no-untyped-def]
    """Number of the fine interval that holds height h."""
    k, last = int((h - fine[0]) / 125.0), hint.size - 1
    i = hint[k if k < last else last]
    while i < fine.size - 2 and fine[i + 1] <= h:
        i += 1
    return i


@jit
def _mark_steep(bottom, h_c, h_g, sin_c, cos_c, r_e, status):  # type: ignore[no-untyped-def]
    """Give rays that the series may serve the status OK, and LEFT to others and what is no ray."""
    r_table = r_e[0] + h_c
    for i in range(h_g.size):
        r_c = r_e[i] + h_c
        level = r_c * cos_c[i] * cos_c[i]
        ray = (cos_c[i] > 0.0) & (cos_c[i] <= 1.0) & (sin_c[i] >= 0.0) & (sin_c[i] <= 1.0)
        downwards = (bottom <= h_g[i]) & (h_g[i] < h_c)
        served = (abs(r_c - r_table) < SAME_RADIUS * r_table) & (
            2.0 * (h_c - h_g[i]) <= LARGEST_DROP * level
        )
        # Only then can the ray turn above land; the other kernel knows what to do about it.
        deep = level > 2.0 * (1.0 + sin_c[i]) * (h_c + _DEEP_M)
        status[i] = OK if ray & downwards & served & deep else LEFT


@jit
def _by_interval(fine, hint, h_g, top, status, at, order):  # type: ignore[no-untyped-def]
    """Fill ``order`` with the rays of status OK by the interval of their targets.

    Gives where in it those of each interval begin, counted from ``top`` downwards.
    """
    deepest = -1
    for i in range(h_g.size):
        if status[i] == OK:
            at[i] = top - _interval(fine, hint, h_g[i])
            if at[i] > deepest:
                deepest = at[i]
    start, place = np.empty(deepest + 2, np.int64), np.empty(deepest + 2, np.int64)
    for k in range(deepest + 2):
        start[k] = 0
    for i in range(h_g.size):
        if status[i] == OK:
            start[at[i] + 1] += 1
    for k in range(deepest + 1):
        start[k + 1] += start[k]
        place[k] = start[k]
    for i in range(h_g.size):
        if status[i] == OK:
            order[place[at[i]]] = i
            place[at[i]] += 1
    return start


@jit
def _rest(n, air, low, h_1, high, h_c, n_c, cos_c, h_g, r_e, rest):  # type: ignore[no-untyped-def]
    """Fill the difference integral from the targets up to ``high``, by itself.

    ``air`` is the polynomial of the interval from ``low`` to ``h_1``. `integrand` of `_ray_kernel`,
    expanded in the bending, which is below 5e-3 here, and about the middle, from where b^2 differs
    by less than 1e-3 of itself.
    """
    index2, per_metre = (1.0 + n_c) * (1.0 + n_c), 1.0 / (h_1 - low)
    a_0, a_1, a_2, a_3, a_4, a_5 = air[0], air[1], air[2], air[3], air[4], air[5]
    for i in range(n):
        r_c, middle = r_e[i] + h_c, 0.5 * (h_g[i] + high)
        b2 = index2 * (r_c * cos_c[i] * r_c * cos_c[i] - (h_c - middle) * (r_c + r_e[i] + middle))
        inverse = 1.0 / b2
        total = 0.0
        for j in range(X3.size):
            h = h_g[i] + (high - h_g[i]) * X3[j]
            u, r = (h - low) * per_metre, r_e[i] + h
            index = a_0 + u * (a_1 + u * (a_2 + u * (a_3 + u * (a_4 + u * a_5))))
            m = (index - n_c) * (2.0 + index + n_c)
            off = index2 * (h - middle) * (r + r_e[i] + middle) * inverse
            cube = 1.0 - off * (1.5 - off * (1.875 - off * 2.1875))
            x = m * r * r * inverse * (1.0 - off * (1.0 - off))
            bent = 0.5 - x * (0.375 - x * (0.3125 - x * (0.2734375 - x * 0.24609375)))
            total += W3[j] * m * r * cube * bent
        rest[i] = total * (high - h_g[i]) * inverse * math.sqrt(inverse)


@jit
def _longest_class(n, h_c, h_g, w, x, largest):  # type: ignore[no-untyped-def]
    """Class of lengths of the series that is enough for all rays it serves; -1 without any."""
    drop = bend = -1.0
    for i in range(n):
        if largest * w[i] <= LARGEST_BEND:
            fall = 2.0 * (h_c - h_g[i]) * w[i] * x[i]
            bend = largest * w[i] if largest * w[i] > bend else bend
            drop = fall if fall > drop else drop
    return class_of(drop, bend) if bend >= 0.0 else -1


@within
def _one_interval(  # type: ignore[no-untyped-def]
    n, fine, local, i, table, x_table, h_c, n_c, rays
):
    """The angles of n rays whose targets lie in interval i; False where the series serves none.

    ``rays`` (ROWS, n) or longer: h_g, sine and cosine of zeta_c, r_e, room to work in, and at last
    the angles.
    """
    h_g, sin_c, cos_c, r_e = rays[0], rays[1], rays[2], rays[3]
    w, x, rest, above, angle = rays[W], rays[5], rays[6], rays[7], rays[ANGLE]
    for j in range(n):
        w[j] = 1.0 / (cos_c[j] * cos_c[j])
        x[j] = 1.0 / (r_e[j] + h_c)
    size = _longest_class(n, h_c, h_g, w, x, table[i, -1])
    if size < 0:
        return False
    series(n, table[i + 1], size, w, x, x_table, rays[8:], above)
    high = fine[i + 1] if fine[i + 1] < h_c else h_c
    _rest(n, local[i], fine[i], fine[i + 1], high, h_c, n_c, cos_c, h_g, r_e, rest)
    for j in range(n):
        straight = (1.0 + n_c) * (r_e[j] + h_c) * sin_c[j] * rest[j]
        rest[j] = 0.5 * (straight + sin_c[j] / cos_c[j] * x[j] * above[j])
    # Angles are below 0.01 wherever the series holds.
    for j in range(n):
        r_c, r_g = r_e[j] + h_c, r_e[j] + h_g[j]
        b2_g = r_c * cos_c[j] * r_c * cos_c[j] - (h_c - h_g[j]) * (r_c + r_g)
        aside, ahead = sides_of(
            rest[j], 1.0, r_c * sin_c[j], h_c - h_g[j], r_c * cos_c[j], b2_g, r_c, r_g
        )
        angle[j] = small_angle(aside / ahead)
    return True


@within
def _run(  # type: ignore[no-untyped-def]
    fine, local, hint, table, h_c, h_g, sin_c, cos_c, r_e, angle, status, numbers, rays
):
    """Rays from one height, those to the same interval together in passes over all of them.

    Short loops keep the processor busy, and without a branch run four rays at a time. ``table`` is
    scratch for the moments, ``numbers`` (2, n) and ``rays`` (ROWS, n) for the rays.
    """
    at, order = numbers[0], numbers[1]
    _mark_steep(fine[0], h_c, h_g, sin_c, cos_c, r_e, status)
    top = _interval(fine, hint, h_c)
    start = _by_interval(fine, hint, h_g, top, status, at, order)
    n_c = refractivity_near(local, top, (h_c - fine[top]) / (fine[top + 1] - fine[top]))
    x_table = 1.0 / (r_e[0] + h_c)
    for column in range(WIDTH):
        table[top + 1, column] = 0.0
    fill(fine, local, h_c, n_c, x_table, top, top - start.size + 2, table)
    for k in range(start.size - 1):
        n = start[k + 1] - start[k]
        if n == 0:
            continue
        for j in range(n):
            i = order[start[k] + j]
            rays[0, j], rays[1, j], rays[2, j], rays[3, j] = h_g[i], sin_c[i], cos_c[i], r_e[i]
        served = _one_interval(n, fine, local, top - k, table, x_table, h_c, n_c, rays)
        largest = table[top - k, -1]
        for j in range(n):
            i = order[start[k] + j]
            if served and largest * rays[W, j] <= LARGEST_BEND:
                angle[i] = rays[ANGLE, j]
            else:
                status[i] = LEFT


@entry
def bend_steep_rays(  # type: ignore[no-untyped-def]
    fine, local, hint, h_c, h_g, sin_c, cos_c, r_e, angle, status
):
    """Fill ``angle`` [rad] and ``status`` of the steep rays among many from the same heights.

    Rays from one height that follow each other share a table of moments (`_moments`), filled
    downwards as far as their targets lie. The others get the status `LEFT`.
    """
    table = np.empty((fine.size, WIDTH))
    room = h_c.size if h_c.size < _TOGETHER else _TOGETHER
    numbers, rays = np.empty((2, room), np.int64), np.empty((ROWS, room))
    first = 0
    while first < h_c.size:
        last = first + 1
        while last < h_c.size and last - first < room and h_c[last] == h_c[first]:
            last += 1
        if last - first >= WORTH_A_TABLE and fine[0] <= h_c[first] <= fine[-1]:
            some = slice(first, last)
            _run(
                fine, local, hint, table, h_c[first], h_g[some], sin_c[some], cos_c[some],
                r_e[some], angle[some], status[some], numbers, rays,
            )  # fmt: skip
        else:
            for i in range(first, last):
                status[i] = LEFT
        first = last
