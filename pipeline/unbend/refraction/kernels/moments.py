"""Many steep rays from one camera: moments down to the target's interval, and the rest there.

With x = 1/r_c, y = h_c - h, u = y x (2 - y x) = 1 - (r/r_c)^2, w = 1/cos^2 zeta_c and
m = n^2 - n_c^2, the difference form of `kernels.ray` expands, where w u and w m are small, into

    delta = x tan zeta_c  sum_p w^p  sum_k (w x)^k  M_pk
    M_pk = c_p b_pk / n_c^(2p)  integral_{h_g}^{h_c}  m^p (1 - y x)^(2p-1) y^k (2 - y x)^k  dh

with c_p from 1/sqrt(1 + s) and b_pk = binomial(p - 1/2 + k, k). The angle does not enter the
moments M_pk, and the radius hardly: they are kept with their derivative by x. One table of them,
from the camera down, serves all rays of an exposure, however many layers they cross.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.refraction.kernels.columns import HINT_M, LEFT, WORTH_A_TABLE
from unbend.refraction.kernels.grazing import gauss_legendre
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.kernels.ray import Triangle, sides_of, small_angle
from unbend.refraction.status_codes import OK
from unbend.units import Array

# As many rays from one height are taken together: their columns fit into a core's cache.
_TOGETHER = 4096

# A ray whose straight line would go this far down [m] before it is level passes no lowest point
# above land, whatever the air: 500 m of depth, and more again for the bending.
_DEEP_M = 1200.0

# The series is left where its terms fall too slowly: w u and w m at the target.
_LARGEST_DROP = 0.06
_LARGEST_BEND = 5e-3

# The derivative by x is good for radii within this share of each other: over 30 km of height the
# next term is then 1e-11 of the whole.
_SAME_RADIUS = 0.01

# How many moments of each order p the series needs for 1e-12 of itself, and up to which w u and
# w m: three classes, most rays of a camera are in the first.
_COUNT = np.array([[6, 4, 3, 1, 0], [8, 6, 4, 3, 1], [12, 9, 7, 5, 4]])
_DROP_OF_CLASS = np.array([0.005, 0.02, _LARGEST_DROP])
_BEND_OF_CLASS = np.array([6e-4, 2e-3, _LARGEST_BEND])
_CLASSES = _DROP_OF_CLASS.size

_ORDERS = _COUNT.shape[1]
_LONGEST = _COUNT[-1]
_START = np.concatenate([[0], np.cumsum(_LONGEST)])
_FACTOR = np.zeros((_ORDERS, int(_LONGEST.max())))
for _p in range(1, _ORDERS + 1):
    _c = math.prod(-(0.5 + i) / (1.0 + i) for i in range(_p))
    for _k in range(_FACTOR.shape[1]):
        _FACTOR[_p - 1, _k] = -_c * math.prod((_p + 0.5 + i) / (1.0 + i) for i in range(_k))

# Columns of the table: the moments with their derivatives, and the largest |m| above.
_MOMENTS = 2 * int(_START[-1]) + 1

_X3, _W3 = gauss_legendre(3)
_FINE_DEGREE = 5  # of the polynomials of `FineTable`

# Rows of the rays to one interval.
_H_G = 0  # target height
_SIN = 1  # of zeta_c
_COS = 2
_R_E = 3  # radius
_W = 4  # w and x as above
_X = 5
_REST = 6  # the difference integral below the interval's upper end
_ABOVE = 7  # and above it
_SCRATCH = 8  # three rows
_ANGLE = 11
_ROWS = 12


class _Camera(NamedTuple):
    """The camera of some rays."""

    h_c: float  # height [m]
    n_c: float  # N there
    x: float  # 1/r_c of the table
    table: Array  # of moments


class _Group(NamedTuple):
    """Columns of rays from one height ``h_c``, with their results."""

    h_c: float
    h_g: Array
    sin_c: Array
    cos_c: Array
    r_e: Array
    angle: Array
    status: NDArray[np.uint8]


@jit
def _refractivity_in(coefficient, i, u):  # type: ignore[no-untyped-def]
    """N at the share u of interval i, by its polynomial of degree 5."""
    value = coefficient[i, _FINE_DEGREE]
    for j in range(_FINE_DEGREE - 1, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@jit
def _fill_moments(air, camera, first, last):  # type: ignore[no-untyped-def]
    """Moments from ``edge[i]`` up to the camera into ``table[i]``, for i from first down to last.

    ``table[first + 1]`` must hold those of the height above.
    """
    edge, coefficient, _ = air
    h_c, n_c, x, table = camera
    index2 = (1.0 + n_c) * (1.0 + n_c)
    for i in range(first, last - 1, -1):
        moments = table[i]
        for column in range(_MOMENTS):
            moments[column] = table[i + 1, column]
        low = edge[i]
        high = edge[i + 1] if edge[i + 1] < h_c else h_c
        share = (high - low) / (edge[i + 1] - low)
        for j in range(_X3.size):
            n = _refractivity_in(coefficient, i, share * _X3[j])
            m = (n - n_c) * (2.0 + n + n_c)
            if abs(m) > moments[-1]:
                moments[-1] = abs(m)
            y = h_c - (low + (high - low) * _X3[j])
            inside = 1.0 - y * x
            along = y * (2.0 - y * x)
            power = _W3[j] * (high - low) / inside
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
def _series(n, moments, c, x_table, rays):  # type: ignore[no-untyped-def]
    """Fill delta / (x tan zeta_c) of n rays between one height and the camera, by class c.

    ``moments`` is the height's row of the table, made for ``x_table``.
    """
    w = rays[_W]
    x = rays[_X]
    total = rays[_ABOVE]
    t = rays[_SCRATCH]
    change = rays[_SCRATCH + 1]
    part = rays[_SCRATCH + 2]
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
            value = moments[column]
            slope = moments[column + 1]
            for i in range(n):
                part[i] = part[i] * t[i] + (value + change[i] * slope)
        for i in range(n):
            total[i] = (total[i] + part[i]) * w[i]


@jit
def _interval(edge, hint, h):  # type: ignore[no-untyped-def]
    """Number of the fine interval that holds height h."""
    k = int((h - edge[0]) / HINT_M)
    last = hint.size - 1
    i = hint[k if k < last else last]
    while i < edge.size - 2 and edge[i + 1] <= h:
        i += 1
    return i


@jit
def _by_interval(air, group, top, at, order):  # type: ignore[no-untyped-def]
    """Fill ``order`` with the rays that the series may serve, by the interval of their targets.

    They get the status OK, others and what is no ray LEFT. Gives where in ``order`` those of each
    interval begin, counted from ``top`` downwards.
    """
    h_c = group.h_c
    h_g = group.h_g
    sin_c = group.sin_c
    cos_c = group.cos_c
    r_e = group.r_e
    status = group.status
    edge, _, hint = air
    deepest = -1
    r_table = r_e[0] + h_c
    for i in range(h_g.size):
        r_c = r_e[i] + h_c
        level = r_c * cos_c[i] * cos_c[i]
        ray = (cos_c[i] > 0.0) & (cos_c[i] <= 1.0) & (sin_c[i] >= 0.0) & (sin_c[i] <= 1.0)
        downwards = (edge[0] <= h_g[i]) & (h_g[i] < h_c)
        same_radius = abs(r_c - r_table) < _SAME_RADIUS * r_table
        near = 2.0 * (h_c - h_g[i]) <= _LARGEST_DROP * level
        # Only then can the ray turn above land; the other kernel decides about those.
        deep = level > 2.0 * (1.0 + sin_c[i]) * (h_c + _DEEP_M)
        status[i] = OK if ray & downwards & same_radius & near & deep else LEFT
        if status[i] == OK:
            at[i] = top - _interval(edge, hint, h_g[i])
            if at[i] > deepest:
                deepest = at[i]
    start = np.empty(deepest + 2, np.int64)
    place = np.empty(deepest + 2, np.int64)
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
def _rest(n, air, interval, camera, rays):  # type: ignore[no-untyped-def]
    """Fill the difference integral from the targets up to the end of an interval, by itself.

    The integrand of the difference form, expanded in the bending, which is below 5e-3 here, and
    about the middle, from where b^2 differs by less than 1e-3 of itself.
    """
    low = air.edge[interval]
    h_1 = air.edge[interval + 1]
    h_c = camera.h_c
    n_c = camera.n_c
    high = h_1 if h_1 < h_c else h_c
    h_g = rays[_H_G]
    cos_c = rays[_COS]
    r_e = rays[_R_E]
    rest = rays[_REST]
    index2 = (1.0 + n_c) * (1.0 + n_c)
    per_metre = 1.0 / (h_1 - low)
    polynomial = air.coefficient[interval]
    a_0 = polynomial[0]
    a_1 = polynomial[1]
    a_2 = polynomial[2]
    a_3 = polynomial[3]
    a_4 = polynomial[4]
    a_5 = polynomial[5]
    for i in range(n):
        r_c = r_e[i] + h_c
        middle = 0.5 * (h_g[i] + high)
        b2 = index2 * (r_c * cos_c[i] * r_c * cos_c[i] - (h_c - middle) * (r_c + r_e[i] + middle))
        inverse = 1.0 / b2
        total = 0.0
        for j in range(_X3.size):
            h = h_g[i] + (high - h_g[i]) * _X3[j]
            u = (h - low) * per_metre
            r = r_e[i] + h
            index = a_0 + u * (a_1 + u * (a_2 + u * (a_3 + u * (a_4 + u * a_5))))
            m = (index - n_c) * (2.0 + index + n_c)
            off = index2 * (h - middle) * (r + r_e[i] + middle) * inverse
            cube = 1.0 - off * (1.5 - off * (1.875 - off * 2.1875))
            x = m * r * r * inverse * (1.0 - off * (1.0 - off))
            bent = 0.5 - x * (0.375 - x * (0.3125 - x * (0.2734375 - x * 0.24609375)))
            total += _W3[j] * m * r * cube * bent
        rest[i] = total * (high - h_g[i]) * inverse * math.sqrt(inverse)


@jit
def _class_of(n, largest, h_c, rays):  # type: ignore[no-untyped-def]
    """Class of lengths of the series that is enough for all rays it serves; `_CLASSES` for none.

    ``largest`` is that |m| above the interval.
    """
    h_g = rays[_H_G]
    w = rays[_W]
    x = rays[_X]
    drop = -1.0
    bend = -1.0
    for j in range(n):
        if largest * w[j] <= _LARGEST_BEND:
            fall = 2.0 * (h_c - h_g[j]) * w[j] * x[j]
            bend = largest * w[j] if largest * w[j] > bend else bend
            drop = fall if fall > drop else drop
    if bend < 0.0:
        return _CLASSES
    for c in range(_CLASSES):
        if drop <= _DROP_OF_CLASS[c] and bend <= _BEND_OF_CLASS[c]:
            return c
    return _CLASSES


@within
def _to_interval(n, air, i, camera, rays):  # type: ignore[no-untyped-def]
    """The angles of n rays whose targets lie in interval i; False where the series serves none."""
    h_g = rays[_H_G]
    sin_c = rays[_SIN]
    cos_c = rays[_COS]
    r_e = rays[_R_E]
    w = rays[_W]
    x = rays[_X]
    rest = rays[_REST]
    above = rays[_ABOVE]
    angle = rays[_ANGLE]
    h_c = camera.h_c
    n_c = camera.n_c
    for j in range(n):
        w[j] = 1.0 / (cos_c[j] * cos_c[j])
        x[j] = 1.0 / (r_e[j] + h_c)
    size = _class_of(n, camera.table[i, -1], h_c, rays)
    if size == _CLASSES:
        return False
    _series(n, camera.table[i + 1], size, camera.x, rays)
    _rest(n, air, i, camera, rays)
    for j in range(n):
        straight = (1.0 + n_c) * (r_e[j] + h_c) * sin_c[j] * rest[j]
        rest[j] = 0.5 * (straight + sin_c[j] / cos_c[j] * x[j] * above[j])
    # Angles are below 0.01 wherever the series holds.
    for j in range(n):
        r_c = r_e[j] + h_c
        r_g = r_e[j] + h_g[j]
        b2_g = r_c * cos_c[j] * r_c * cos_c[j] - (h_c - h_g[j]) * (r_c + r_g)
        line = Triangle(1.0, r_c * sin_c[j], h_c - h_g[j], r_c * cos_c[j], b2_g, r_c, r_g)
        aside, ahead = sides_of(rest[j], line)
        angle[j] = small_angle(aside / ahead)
    return True


@within
def _bend_group(air, group, table, numbers, rays):  # type: ignore[no-untyped-def]
    """Rays from one height, those to the same interval together in passes over all of them.

    Short loops keep the processor busy, and without a branch run four rays at a time. ``table`` is
    scratch for the moments, ``numbers`` (2, n) and ``rays`` (_ROWS, n) for the rays.
    """
    edge, coefficient, hint = air
    h_c = group.h_c
    order = numbers[1]
    top = _interval(edge, hint, h_c)
    start = _by_interval(air, group, top, numbers[0], order)
    share = (h_c - edge[top]) / (edge[top + 1] - edge[top])
    n_c = _refractivity_in(coefficient, top, share)
    camera = _Camera(h_c, n_c, 1.0 / (group.r_e[0] + h_c), table)
    for column in range(_MOMENTS):
        table[top + 1, column] = 0.0
    _fill_moments(air, camera, top, top - start.size + 2)
    for k in range(start.size - 1):
        n = start[k + 1] - start[k]
        if n == 0:
            continue
        for j in range(n):
            i = order[start[k] + j]
            rays[_H_G, j] = group.h_g[i]
            rays[_SIN, j] = group.sin_c[i]
            rays[_COS, j] = group.cos_c[i]
            rays[_R_E, j] = group.r_e[i]
        served = _to_interval(n, air, top - k, camera, rays)
        largest = table[top - k, -1]
        for j in range(n):
            i = order[start[k] + j]
            if served and largest * rays[_W, j] <= _LARGEST_BEND:
                group.angle[i] = rays[_ANGLE, j]
            else:
                group.status[i] = LEFT


@entry
def bend_steep_rays(air, rays, angle, status):  # type: ignore[no-untyped-def]
    """Fill ``angle`` [rad] and ``status`` of the steep rays among many from the same heights.

    ``air`` is a `FineTable`, ``rays`` are `RayColumns`. Rays from one height that follow each other
    share a table of moments, filled downwards as far as their targets lie. The others get the
    status `LEFT`.
    """
    edge = air.edge
    h_c = rays.h_c
    table = np.empty((edge.size, _MOMENTS))
    room = h_c.size if h_c.size < _TOGETHER else _TOGETHER
    numbers = np.empty((2, room), np.int64)
    columns = np.empty((_ROWS, room))
    first = 0
    while first < h_c.size:
        last = first + 1
        while last < h_c.size and last - first < room and h_c[last] == h_c[first]:
            last += 1
        if last - first >= WORTH_A_TABLE and edge[0] <= h_c[first] <= edge[-1]:
            rows = slice(first, last)
            group = _Group(
                h_c[first],
                rays.h_g[rows],
                rays.sin_c[rows],
                rays.cos_c[rows],
                rays.r_e[rows],
                angle[rows],
                status[rows],
            )
            _bend_group(air, group, table, numbers, columns)
        else:
            for i in range(first, last):
                status[i] = LEFT
        first = last
