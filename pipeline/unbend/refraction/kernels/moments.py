"""R_c of many steep rays from one camera, by moments of the air that all of them share, compiled.

The difference integral of `kernels.ray` is split at the upper end of the interval of `FineTable`
that contains the target. From that end up to the camera the moments give the integral. From the
target up to that end, less than one interval, three nodes of Gauss and Legendre give it.

With x = 1/r_c, y = h_c - h, u = y x (2 - y x) = 1 - (r/r_c)^2, w = 1/cos^2 zeta_c and
m = n^2 - n_c^2, the difference form of `kernels.ray` expands, where w u and w m are small, into

    delta = x tan zeta_c  sum_p w^p  sum_k (w x)^k  M_pk
    M_pk = c_p b_pk / n_c^(2p)  integral_{h_g}^{h_c}  m^p (1 - y x)^(2p-1) y^k (2 - y x)^k  dh

for p from 1 and k from 0, with c_p the coefficient of s^p in 1 - 1/sqrt(1 + s), and
b_pk = binomial(p - 1/2 + k, k). The angle does not enter the moments M_pk, and the radius hardly:
they are kept with their derivative by x. One table of them, from the camera down, serves all rays
of an exposure, however many layers they cross.

In arrays by order the index q = p - 1 is that of the order p.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.refraction.kernels.columns import FOR_NEXT_KERNEL, HINT_M, WORTH_A_TABLE
from unbend.refraction.kernels.grazing import gauss_legendre
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.kernels.ray import Triangle, small_arctangent, tangent_fraction
from unbend.refraction.status_codes import OK
from unbend.units import Array

# At most so many rays from one height are taken together: their columns fit into a core's cache.
_MOST_TOGETHER = 4096

# Rays that may turn above land are bent by `kernels.ray`. The test is that of `crosses_once`, with
# land down to this depth below sea level [m]: 700 m more than there is.
_DEEP_M = 1200.0

# The series is not used where its terms fall too slowly: beyond these w u and w m at the target.
_LARGEST_W_U = 0.06
_LARGEST_W_M = 5e-3

# The derivative by x is good for radii within this share of each other: over 30 km of height the
# next term is then 1e-11 of the whole.
_SAME_RADIUS = 0.01

# How many moments of each order the series needs for 1e-12 of itself: a row for each class of rays,
# with w u and w m up to these values. Most rays of a camera are in the first class.
_COUNT = np.array([[6, 4, 3, 1, 0], [8, 6, 4, 3, 1], [12, 9, 7, 5, 4]])
_W_U_OF_CLASS = np.array([0.005, 0.02, _LARGEST_W_U])
_W_M_OF_CLASS = np.array([6e-4, 2e-3, _LARGEST_W_M])
_CLASSES = _W_U_OF_CLASS.size

_ORDERS = _COUNT.shape[1]
_MOST_MOMENTS = _COUNT[-1]  # moments of each order in the last class, which has the most
_FIRST_MOMENT = np.concatenate([[0], np.cumsum(_MOST_MOMENTS)])  # its number, of each order


def _factors() -> Array:
    """The factors c_p b_pk of the module's equations, (orders, k); row p - 1 is that of order p."""
    factors = np.zeros((_ORDERS, int(_MOST_MOMENTS.max())))
    for p in range(1, _ORDERS + 1):
        c_p = -math.prod(-(0.5 + i) / (1.0 + i) for i in range(p))
        for k in range(factors.shape[1]):
            factors[p - 1, k] = c_p * math.prod((p + 0.5 + i) / (1.0 + i) for i in range(k))
    return factors


_FACTOR = _factors()

# Columns of the table of moments: each moment, followed by its derivative by x, and at last the
# largest |m| from there up to the camera.
_COLUMN_OF_LARGEST_M = 2 * int(_FIRST_MOMENT[-1])
_COLUMNS = _COLUMN_OF_LARGEST_M + 1

_X3, _W3 = gauss_legendre(3)
_FINE_DEGREE = 5  # of the polynomials of `FineTable`

# Rows of the rays to one interval.
_H_G = 0  # height of the target [m]
_SIN_C = 1  # of zeta_c
_COS_C = 2
_R_E = 3  # radius of the sphere [m]
_W = 4  # w = 1/cos^2 zeta_c
_X = 5  # x = 1/r_c [1/m]
_BELOW = 6  # the difference integral from the target to the upper end of its interval
_ABOVE = 7  # delta / (x tan zeta_c) from the upper end of that interval to the camera
_W_X = 8  # w x
_X_CHANGE = 9  # x less that of the table of moments
_SUM_OF_ORDER = 10  # of the terms of one order p, without w^p
_HALF_DELTA = 11  # delta / 2 [rad]
_ANGLE = 12  # R_c [rad]
_ROWS = 13


class _Camera(NamedTuple):
    """The camera of some rays, and the moments of the air below it."""

    h_c: float  # height [m]
    big_n_c: float  # N_c, the refractivity at the camera
    x: float  # 1/r_c for which the moments are made [1/m]
    moments: Array  # (k + 1, _COLUMNS) from each edge of the `FineTable` up to the camera


class _Group(NamedTuple):
    """Rays from one height, with their results."""

    h_c: float  # height of the camera [m]
    h_g: Array  # height of the target [m]
    sin_c: Array  # of the apparent nadir angle
    cos_c: Array
    r_e: Array  # radius of the sphere [m]
    angle: Array  # R_c [rad]
    status: NDArray[np.uint8]


class _WorkArrays(NamedTuple):
    """Work arrays, used for one group of rays after the other."""

    moments: Array  # (k + 1, _COLUMNS)
    steps_down: NDArray[np.int64]  # (n,) intervals between the camera's and that of a target
    order: NDArray[np.int64]  # (n,) numbers of rays, sorted by steps_down
    rays: Array  # (_ROWS, n) the rays to one interval


@jit
def _refractivity_in(coefficient, i, u):  # type: ignore[no-untyped-def]
    """N in interval i of `FineTable`, at the share u of the way from its lower edge up."""
    value = coefficient[i, _FINE_DEGREE]
    for j in range(_FINE_DEGREE - 1, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@jit
def _fill_moments(air, camera, top, bottom):  # type: ignore[no-untyped-def]
    """Fill the moments M_pk and their derivatives by x, for intervals from ``top`` to ``bottom``.

    ``camera`` is a `_Camera` in interval ``top`` of ``air``, a `FineTable`. Row i of its moments is
    filled with those from ``edge[i]`` up to the camera, and with the largest |m| on the way: that
    is row i + 1 and what interval i adds. Row top + 1 must be zero at the call.
    """
    edge = air.edge
    h_c = camera.h_c
    for i in range(top, bottom - 1, -1):
        moments = camera.moments[i]
        for column in range(_COLUMNS):
            moments[column] = camera.moments[i + 1, column]
        low = edge[i]
        high = edge[i + 1] if edge[i + 1] < h_c else h_c
        share = (high - low) / (edge[i + 1] - low)
        for j in range(_X3.size):
            refractivity = _refractivity_in(air.coefficient, i, share * _X3[j])
            # m = n^2 - n_c^2, from refractivities, which keep their digits.
            m = (refractivity - camera.big_n_c) * (2.0 + refractivity + camera.big_n_c)
            if abs(m) > moments[_COLUMN_OF_LARGEST_M]:
                moments[_COLUMN_OF_LARGEST_M] = abs(m)
            y = h_c - (low + (high - low) * _X3[j])
            _add_node(moments, camera, m, y, _W3[j] * (high - low))


@jit
def _add_node(moments, camera, m, y, weight):  # type: ignore[no-untyped-def]
    """Add one node of the integrals to ``moments``, a row of M_pk and their derivatives by x.

    m = n^2 - n_c^2 and y = h_c - h [m] are those at the node, ``weight`` [m] is that of the node.
    """
    x = camera.x
    index2 = (1.0 + camera.big_n_c) * (1.0 + camera.big_n_c)
    radius_ratio = 1.0 - y * x  # r / r_c
    factor_of_k = y * (2.0 - y * x)
    power = weight / radius_ratio
    for q in range(_ORDERS):
        power *= m / index2 * radius_ratio * radius_ratio
        # d ln(term)/dx: of (1 - y x)^(2p - 1), p = q + 1, and of each of the k factors (2 - y x).
        slope = -(2 * q + 1) * y / radius_ratio
        slope_of_factor = -y / (2.0 - y * x)
        term = power
        for k in range(_MOST_MOMENTS[q]):
            value = _FACTOR[q, k] * term
            column = 2 * (_FIRST_MOMENT[q] + k)
            moments[column] += value
            moments[column + 1] += value * (slope + k * slope_of_factor)
            term *= factor_of_k


@jit
def _fill_above(n, moments, length_class, x_table, rays):  # type: ignore[no-untyped-def]
    """Fill `_ABOVE`, delta / (x tan zeta_c) from one height up to the camera, of n rays.

    ``moments`` are those from that height up, made for 1/r_c = ``x_table``; ``length_class`` is the
    row of `_COUNT` that gives how many are used. Horner's scheme, in w over the orders and in w x
    within each, goes term by term over all rays: the short loops run four rays at a time.
    """
    w = rays[_W]
    x = rays[_X]
    total = rays[_ABOVE]
    w_x = rays[_W_X]
    x_change = rays[_X_CHANGE]
    of_order = rays[_SUM_OF_ORDER]
    for i in range(n):
        w_x[i] = w[i] * x[i]
    for i in range(n):
        x_change[i] = x[i] - x_table
        total[i] = 0.0
    for q in range(_ORDERS - 1, -1, -1):
        for i in range(n):
            of_order[i] = 0.0
        for k in range(_COUNT[length_class, q] - 1, -1, -1):
            column = 2 * (_FIRST_MOMENT[q] + k)
            value = moments[column]
            slope = moments[column + 1]
            for i in range(n):
                of_order[i] = of_order[i] * w_x[i] + (value + x_change[i] * slope)
        for i in range(n):
            total[i] = (total[i] + of_order[i]) * w[i]


@jit
def _interval(edge, hint, h):  # type: ignore[no-untyped-def]
    """Number of the interval of `FineTable` that contains height h: a hint, and steps upwards."""
    hint_number = int((h - edge[0]) / HINT_M)
    i = hint[min(hint_number, hint.size - 1)]
    while i < edge.size - 2 and edge[i + 1] <= h:
        i += 1
    return i


@jit
def _mark_served(air, group, top, steps_down):  # type: ignore[no-untyped-def]
    """Set the status `OK` of rays that the series may serve, `FOR_NEXT_KERNEL` of all others.

    ``steps_down`` of served rays is filled with the number of intervals from ``top``, the camera's,
    down to that of the target. Returns the largest number, -1 where the series serves no ray.
    The conditions are joined by &, which evaluates all of them, because branches are slower.
    """
    h_c = group.h_c
    h_g = group.h_g
    sin_c = group.sin_c
    cos_c = group.cos_c
    r_e = group.r_e
    status = group.status
    edge = air.edge
    most_steps = -1
    r_table = r_e[0] + h_c
    for i in range(h_g.size):
        r_c = r_e[i] + h_c
        r_c_cos2 = r_c * cos_c[i] * cos_c[i]
        is_ray = (cos_c[i] > 0.0) & (cos_c[i] <= 1.0) & (sin_c[i] >= 0.0) & (sin_c[i] <= 1.0)
        is_downwards = (edge[0] <= h_g[i]) & (h_g[i] < h_c)
        is_same_radius = abs(r_c - r_table) < _SAME_RADIUS * r_table
        # 2 y x w is at least w u, because u = y x (2 - y x).
        is_small_w_u = 2.0 * (h_c - h_g[i]) <= _LARGEST_W_U * r_c_cos2
        # The straight line becomes level at this depth below the camera. Where it is twice as deep
        # as all land, the bent ray meets the height of its target once only: see `crosses_once`.
        depth_of_level = r_c_cos2 / (1.0 + sin_c[i])
        is_deep = depth_of_level > 2.0 * (h_c + _DEEP_M)
        is_served = is_ray & is_downwards & is_same_radius & is_small_w_u & is_deep
        status[i] = OK if is_served else FOR_NEXT_KERNEL
        if is_served:
            steps_down[i] = top - _interval(edge, air.hint, h_g[i])
            if steps_down[i] > most_steps:
                most_steps = steps_down[i]
    return most_steps


@jit
def _fill_order(status, steps_down, most_steps, order):  # type: ignore[no-untyped-def]
    """Fill ``order`` with the numbers of the rays of status `OK`, sorted by rising ``steps_down``.

    Returns ``start`` (most_steps + 2,): the rays of k steps are order[start[k] : start[k + 1]].
    """
    start = np.zeros(most_steps + 2, np.int64)
    place = np.empty(most_steps + 2, np.int64)  # where the next ray of each number of steps goes
    # The rays of k steps are counted in start[k + 1]; the running sums are then their beginnings.
    for i in range(status.size):
        if status[i] == OK:
            start[steps_down[i] + 1] += 1
    for k in range(most_steps + 1):
        start[k + 1] += start[k]
        place[k] = start[k]
    for i in range(status.size):
        if status[i] == OK:
            order[place[steps_down[i]]] = i
            place[steps_down[i]] += 1
    return start


@jit
def _fill_below(n, air, interval, camera, rays):  # type: ignore[no-untyped-def]
    """Fill `_BELOW`, the difference integral from the target up to the end of its interval.

    The n rays have their targets in ``interval``. The integrand m r / (a b (a + b)), a and b as in
    `kernels.ray`, is expanded in two small numbers: b^2 = b_m^2 (1 + off), b_m in the middle of the
    way, ``off`` below 1e-3; a^2 = b^2 (1 + bending), bending = m r^2 / b^2 below 5e-3.
    """
    low = air.edge[interval]
    width = air.edge[interval + 1] - low
    h_c = camera.h_c
    high = min(air.edge[interval + 1], h_c)
    h_g = rays[_H_G]
    cos_c = rays[_COS_C]
    r_e = rays[_R_E]
    below = rays[_BELOW]
    index2 = (1.0 + camera.big_n_c) * (1.0 + camera.big_n_c)
    per_metre = 1.0 / width
    # The interval's polynomial as single numbers, so that the loop reads them once.
    polynomial = air.coefficient[interval]
    p_0 = polynomial[0]
    p_1 = polynomial[1]
    p_2 = polynomial[2]
    p_3 = polynomial[3]
    p_4 = polynomial[4]
    p_5 = polynomial[5]
    for i in range(n):
        r_c = r_e[i] + h_c
        middle = 0.5 * (h_g[i] + high)
        along2_c = r_c * cos_c[i] * r_c * cos_c[i]
        # 1 / b_m^2, r_c^2 - r_m^2 as a product.
        inverse_b2 = 1.0 / (index2 * (along2_c - (h_c - middle) * (r_c + r_e[i] + middle)))
        total = 0.0
        for j in range(_X3.size):
            h = h_g[i] + (high - h_g[i]) * _X3[j]
            u = (h - low) * per_metre
            r = r_e[i] + h
            refractivity = p_0 + u * (p_1 + u * (p_2 + u * (p_3 + u * (p_4 + u * p_5))))
            m = (refractivity - camera.big_n_c) * (2.0 + refractivity + camera.big_n_c)
            off = index2 * (h - middle) * (r + r_e[i] + middle) * inverse_b2
            # (1 + off)^(-3/2), and the bending with 1 / (1 + off), by their series.
            off_factor = 1.0 - off * (1.5 - off * (1.875 - off * 2.1875))
            bending = m * r * r * inverse_b2 * (1.0 - off * (1.0 - off))
            # 1 / (sqrt(1 + bending) (1 + sqrt(1 + bending))), by its series.
            tail = bending * (0.3125 - bending * (0.2734375 - bending * 0.24609375))
            bending_factor = 0.5 - bending * (0.375 - tail)
            total += _W3[j] * m * r * off_factor * bending_factor
        below[i] = total * (high - h_g[i]) * inverse_b2 * math.sqrt(inverse_b2)  # b_m^-3


@jit
def _length_class(n, largest_m, h_c, rays):  # type: ignore[no-untyped-def]
    """The first row of `_COUNT` that is enough for all of the n rays that the series serves.

    ``largest_m`` is the largest |m| above the targets, ``h_c`` the height of the camera [m].
    Returns `_CLASSES`, one beyond the last row, where the series serves no ray.
    """
    h_g = rays[_H_G]
    w = rays[_W]
    x = rays[_X]
    largest_w_u = -1.0
    largest_w_m = -1.0
    # Rays with a larger w m are not served, and do not count.
    for j in range(n):
        w_m = largest_m * w[j]
        if w_m <= _LARGEST_W_M:
            w_u = 2.0 * (h_c - h_g[j]) * w[j] * x[j]  # at least w u: u = y x (2 - y x)
            largest_w_m = w_m if w_m > largest_w_m else largest_w_m
            largest_w_u = w_u if w_u > largest_w_u else largest_w_u
    if largest_w_m < 0.0:
        return _CLASSES
    for c in range(_CLASSES):
        if largest_w_u <= _W_U_OF_CLASS[c] and largest_w_m <= _W_M_OF_CLASS[c]:
            return c
    # `_mark_served` has excluded all rays beyond the last class: only rounding leads here.
    return _CLASSES


@within
def _bend_to_interval(n, air, i, camera, rays):  # type: ignore[no-untyped-def]
    """Fill R_c, `_ANGLE`, of n rays with targets in interval i; False where the series serves none.

    ``camera`` is their `_Camera`, ``rays`` a matrix of `_ROWS` rows. R_c follows from delta as in
    `kernels.ray`.
    """
    h_g = rays[_H_G]
    sin_c = rays[_SIN_C]
    cos_c = rays[_COS_C]
    r_e = rays[_R_E]
    w = rays[_W]
    x = rays[_X]
    below = rays[_BELOW]
    above = rays[_ABOVE]
    half_delta = rays[_HALF_DELTA]
    angle = rays[_ANGLE]
    h_c = camera.h_c
    for j in range(n):
        w[j] = 1.0 / (cos_c[j] * cos_c[j])
        x[j] = 1.0 / (r_e[j] + h_c)
    length_class = _length_class(n, camera.moments[i, _COLUMN_OF_LARGEST_M], h_c, rays)
    if length_class == _CLASSES:
        return False
    _fill_above(n, camera.moments[i + 1], length_class, camera.x, rays)
    _fill_below(n, air, i, camera, rays)
    for j in range(n):
        k = (1.0 + camera.big_n_c) * (r_e[j] + h_c) * sin_c[j]
        delta_below = k * below[j]
        half_delta[j] = 0.5 * (delta_below + sin_c[j] / cos_c[j] * x[j] * above[j])
    # The angles are below 0.01 where the series of moments is used: `small_arctangent` is enough.
    for j in range(n):
        r_c = r_e[j] + h_c
        r_g = r_e[j] + h_g[j]
        along2_g = r_c * cos_c[j] * r_c * cos_c[j] - (h_c - h_g[j]) * (r_c + r_g)
        line = Triangle(
            sense=1.0,
            s=r_c * sin_c[j],
            rise=h_c - h_g[j],
            along_c=r_c * cos_c[j],
            along2_g=along2_g,
            r_c=r_c,
            r_g=r_g,
        )
        numerator, denominator = tangent_fraction(half_delta[j], line)
        angle[j] = small_arctangent(numerator / denominator)
    return True


@within
def _bend_group(air, group, work):  # type: ignore[no-untyped-def]
    """Fill R_c and status of a `_Group` of rays from one height; ``work`` is a `_WorkArrays`.

    Rays to the same interval are taken together, in passes over all of them: short loops keep the
    processor busy, and without a branch run four rays at a time.
    """
    edge = air.edge
    h_c = group.h_c
    order = work.order
    rays = work.rays
    # The rays that the series serves, in the order of the intervals of their targets.
    top = _interval(edge, air.hint, h_c)
    most_steps = _mark_served(air, group, top, work.steps_down)
    start = _fill_order(group.status, work.steps_down, most_steps, order)

    # The moments from the camera down to the lowest of these intervals.
    share = (h_c - edge[top]) / (edge[top + 1] - edge[top])
    big_n_c = _refractivity_in(air.coefficient, top, share)
    camera = _Camera(h_c, big_n_c, 1.0 / (group.r_e[0] + h_c), work.moments)
    for column in range(_COLUMNS):
        work.moments[top + 1, column] = 0.0
    _fill_moments(air, camera, top, top - most_steps)

    # The rays to one interval after the other: copied together, bent, and copied back.
    for steps in range(most_steps + 1):
        n = start[steps + 1] - start[steps]
        if n == 0:
            continue
        for j in range(n):
            i = order[start[steps] + j]
            rays[_H_G, j] = group.h_g[i]
            rays[_SIN_C, j] = group.sin_c[i]
            rays[_COS_C, j] = group.cos_c[i]
            rays[_R_E, j] = group.r_e[i]
        is_served = _bend_to_interval(n, air, top - steps, camera, rays)
        largest_m = work.moments[top - steps, _COLUMN_OF_LARGEST_M]
        for j in range(n):
            i = order[start[steps] + j]
            if is_served and largest_m * rays[_W, j] <= _LARGEST_W_M:
                group.angle[i] = rays[_ANGLE, j]
            else:
                group.status[i] = FOR_NEXT_KERNEL


@entry
def bend_steep_rays(air, rays, angle, status):  # type: ignore[no-untyped-def]
    """Fill ``angle`` [rad] and ``status`` of those `RayColumns` that the series of moments serves.

    ``air`` is a `FineTable`. `WORTH_A_TABLE` or more consecutive rays from one height share a table
    of moments, filled down to the lowest target. The other rays get the status `FOR_NEXT_KERNEL`,
    and their angles are not set.
    """
    edge = air.edge
    h_c = rays.h_c
    most_rays = h_c.size if h_c.size < _MOST_TOGETHER else _MOST_TOGETHER
    work = _WorkArrays(
        moments=np.empty((edge.size, _COLUMNS)),
        steps_down=np.empty(most_rays, np.int64),
        order=np.empty(most_rays, np.int64),
        rays=np.empty((_ROWS, most_rays)),
    )
    first = 0
    while first < h_c.size:
        end = first + 1
        while end < h_c.size and end - first < most_rays and h_c[end] == h_c[first]:
            end += 1
        if end - first >= WORTH_A_TABLE and edge[0] <= h_c[first] <= edge[-1]:
            rows = slice(first, end)
            group = _Group(
                h_c=h_c[first],
                h_g=rays.h_g[rows],
                sin_c=rays.sin_c[rows],
                cos_c=rays.cos_c[rows],
                r_e=rays.r_e[rows],
                angle=angle[rows],
                status=status[rows],
            )
            _bend_group(air, group, work)
        else:
            for i in range(first, end):
                status[i] = FOR_NEXT_KERNEL
        first = end
