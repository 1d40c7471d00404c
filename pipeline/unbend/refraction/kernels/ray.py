"""R_c of rays, and heights at distances along rays, compiled: one ray at a time.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c (Eq. 1), N = n - 1; indices c
and g are the camera and the target. Both the bent ray and the straight line that leaves the camera
in its direction subtend an angle at the earth's centre on their way to h_g (Eq. 12). With
s = r_c sin zeta_c, a = sqrt(n^2 r^2 - k^2) and b = n_c sqrt(r^2 - s^2) the difference of the two,
straight less bent, is

    delta = k integral_{h_g}^{h_c} (N - N_c) (2 + N + N_c) r / (a b (a + b)) dh

without cancellation: the difference form. The integral, without the factor k, is called the
difference integral. With the angle z of the straight line to the vertical at the target,
sin z = s / r_g and cos z = q / r_g, q = sqrt(r_g^2 - s^2), and the length D of that line,

    D = (h_c - h_g) (r_c + r_g) / (r_c cos zeta_c + q),
    tan R_c = 2 r_g sin(delta / 2) cos(z - delta / 2)
              / (D - 2 r_g sin(delta / 2) sin(z - delta / 2)),

which is Eq. 11. Near grazing b goes to zero, and `kernels.grazing` serves the ray.
"""

import math
from typing import NamedTuple

from unbend.refraction.kernels.columns import FOR_NEXT_KERNEL
from unbend.refraction.kernels.grazing import (
    chord2,
    crosses_once,
    excess,
    gauss_legendre,
    piece_at,
    ray_at,
    refractivity,
    subtended,
    subtended_to_rise,
    turning_height,
)
from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE

# The difference form is not used where the ray comes this near to grazing at its lower end:
# (r cos zeta)^2 there is less than half of that at the upper end. Over a single piece of the table
# its eight nodes err by 6e-7 arcsec at 0.3, by 2e-10 at 0.5.
_GRAZING_GUARD = 0.5

# The difference form is also not used where the bent ray is much nearer to level than the straight
# line, that is where a^2 of the module's equations is less than half of b^2.
_BENT_GUARD = 0.5

# The search for the height at a distance ends with a step that is shorter than this [m]: heights
# themselves are rounded to 1e-12 m.
_SHORTEST_STEP_M = 1e-10

# Nodes and weights of Gauss and Legendre between 0 and 1. Four serve the part of a steep ray in one
# piece of the table, to 1e-13 of the whole, where that part is no higher than `_WIDEST_M`. A
# ray is steep if its (r cos zeta)^2 is at one end more than `_STEEP_SHARE` of that at the other.
_X4, _W4 = gauss_legendre(4)
_X8, _W8 = gauss_legendre(8)
_WIDEST_M = 260.0
_STEEP_SHARE = 0.9

_SLACK_M = 1e-6  # heights so far outside the profile are rounding
_SMALL_ANGLE = 0.01  # up to which the series of `small_arctangent` is good
_MOST_STEPS = 100  # of the search for a height, Newton's and bisections together

# A ray still reaches its distance if the chord at the end of the profile is too short by half of
# this [m]: distance^2 - chord^2 is 2 distance times what the chord lacks.
_TWICE_SHORT_M = 2e-6


class Triangle(NamedTuple):
    """The straight line in the ray's direction from the camera to the target's height; in m."""

    sense: float  # 1 downwards, -1 upwards
    s: float  # r_c sin zeta_c, the distance of the line from the earth's centre
    rise: float  # |h_c - h_g|
    along_c: float  # r_c |cos zeta_c|
    along2_g: float  # q^2 = r_g^2 - s^2
    r_c: float
    r_g: float


class _Search(NamedTuple):
    """Where along a ray a height is sought."""

    low: float  # limits of the height [m]
    high: float
    base: float  # height where s is 0 [m]: h_90, or a height that replaces it
    start: float  # first guess [m]
    theta_to_rise: float  # angle from the camera through P_90 up to h_c [rad]; 0 before P_90
    sense: float  # 1 where the ray rises on the part that is searched, -1 where it falls


@jit
def tangent_fraction(half_delta, line):  # type: ignore[no-untyped-def]
    """Numerator and denominator of tan R_c, both times r_c |cos zeta_c| + q [m2].

        tan R_c = 2 r_g sin(delta / 2) cos(z - delta / 2)
                  / (D - 2 r_g sin(delta / 2) sin(z - delta / 2))

    with the symbols of the module. ``half_delta`` is delta / 2 [rad], below 0.01; ``line`` is a
    `Triangle`.
    """
    q = math.sqrt(line.along2_g)
    sum_of_sides = line.along_c + q
    # Sine and cosine by their series; the next terms are 1e-14 of the whole.
    square = half_delta * half_delta
    sin_half = half_delta - half_delta * square * (1.0 / 6.0 - square / 120.0)
    cos_half = 1.0 - square * (0.5 - square / 24.0)
    # r_g sin(z - delta / 2) and r_g cos(z - delta / 2) follow from r_g sin z = s and r_g cos z = q.
    twice_sine = 2.0 * sin_half * sum_of_sides
    subtrahend = line.sense * twice_sine * (line.s * cos_half - q * sin_half)
    denominator = line.rise * (line.r_c + line.r_g) - subtrahend
    numerator = twice_sine * (q * cos_half + line.s * sin_half)
    return numerator, denominator


@jit
def small_arctangent(tangent):  # type: ignore[no-untyped-def]
    """The arctangent [rad] of a number up to 0.01 by its series, to 1e-16 of itself."""
    square = tangent * tangent
    return tangent - tangent * square * (1.0 / 3.0 - square * (0.2 - square / 7.0))


@jit
def _integral_over_layer(table, ray, i, ends, is_steep):  # type: ignore[no-untyped-def]
    """Integral of (N - N_c) (2 + N + N_c) r / (a b (a + b)) dh between two heights in piece i.

    The difference integral of the module. ``ray`` is a `Ray`, ``ends`` are the lower and the upper
    height [m]; ``is_steep`` states that four nodes are enough, instead of eight, in a thin layer.
    NaN where the bent ray is nearly level between the ends.
    """
    h_0, h_1 = ends
    width = h_1 - h_0
    big_n_c = ray.big_n_c
    r_c = ray.r_e + ray.h_c
    index2 = (1.0 + big_n_c) * (1.0 + big_n_c)
    along2_c = (r_c * ray.cos_c) * (r_c * ray.cos_c)
    if is_steep and width < _WIDEST_M:
        nodes = _X4
        weights = _W4
    else:
        nodes = _X8
        weights = _W8
    total = 0.0
    for j in range(nodes.size):
        h = h_0 + width * nodes[j]
        n = refractivity(table, i, h)
        r = ray.r_e + h
        # n^2 - n_c^2 of the indices of refraction.
        index2_change = (n - big_n_c) * (2.0 + n + big_n_c)
        b2 = index2 * (along2_c - (ray.h_c - h) * (r_c + r))
        a2 = b2 + index2_change * r * r
        if not (b2 > 0.0 and a2 > _BENT_GUARD * b2):
            return math.nan
        a = math.sqrt(a2)
        b = math.sqrt(b2)
        total += weights[j] * (index2_change * r / (a * b * (a + b)))
    return total * width


@jit
def _difference_integral(table, ray, h_g, is_steep):  # type: ignore[no-untyped-def]
    """The difference integral of the module between h_c and h_g, piece by piece of the table.

    ``is_steep`` as in `_integral_over_layer`. NaN where the bent ray is nearly level before it
    reaches h_g.
    """
    edge = table.edge
    low = min(ray.h_c, h_g)
    high = max(ray.h_c, h_g)
    total = 0.0
    for i in range(piece_at(edge, low), piece_at(edge, high) + 1):
        h_0 = max(low, edge[i])
        h_1 = min(high, edge[i + 1])
        if h_1 <= h_0:
            continue
        in_layer = _integral_over_layer(table, ray, i, (h_0, h_1), is_steep)
        if math.isnan(in_layer):
            return math.nan
        total += in_layer
    return total


@jit
def bend_by_difference(table, ray, h_g):  # type: ignore[no-untyped-def]
    """R_c [rad] of a `Ray` to the height h_g [m], by the difference form of the module.

    That is from delta, the angle that the straight line subtends at the earth's centre less that of
    the bent ray. NaN where the bent ray is nearly level before it reaches h_g.
    """
    h_c = ray.h_c
    r_c = ray.r_e + h_c
    r_g = ray.r_e + h_g
    s = r_c * ray.sin_c
    # Along the straight line r^2 - s^2 = (r cos zeta)^2.
    along2_c = (r_c * ray.cos_c) * (r_c * ray.cos_c)
    along2_g = along2_c - (h_c - h_g) * (r_c + r_g)
    is_steep = min(along2_g, along2_c) > _STEEP_SHARE * max(along2_g, along2_c)
    integral = _difference_integral(table, ray, h_g, is_steep)
    if math.isnan(integral):
        return math.nan
    # Upwards the bent ray subtends the larger angle in common air: delta is then bent less
    # straight, and the sign in the denominator of tan R_c is reversed too.
    sense = 1.0 if h_g < h_c else -1.0
    half_delta = 0.5 * sense * (1.0 + ray.big_n_c) * s * integral
    line = Triangle(
        sense=sense,
        s=s,
        rise=abs(h_c - h_g),
        along_c=r_c * abs(ray.cos_c),
        along2_g=along2_g,
        r_c=r_c,
        r_g=r_g,
    )
    numerator, denominator = tangent_fraction(half_delta, line)
    if abs(numerator) < _SMALL_ANGLE * denominator:
        return small_arctangent(numerator / denominator)
    return math.atan2(numerator, denominator)


@jit
def _is_far_from_grazing(ray, h_g):  # type: ignore[no-untyped-def]
    """Whether both ends of a ray to the height h_g are far from grazing: see `_GRAZING_GUARD`."""
    if h_g > ray.h_c and ray.cos_c > 0.0:  # down through P_90 and up again
        return False
    along_c = (ray.r_e + ray.h_c) * ray.cos_c
    along2_c = along_c * along_c
    along2_g = along2_c - (ray.h_c - h_g) * (2.0 * ray.r_e + ray.h_c + h_g)
    return min(along2_c, along2_g) >= _GRAZING_GUARD * max(along2_c, along2_g)


@jit
def _status_of_input(table, rays, i):  # type: ignore[no-untyped-def]
    """The status of ray i of `RayColumns` before it is followed: `OK`, or why there is no angle."""
    h_c = rays.h_c[i]
    h_g = rays.h_g[i]
    r_e = rays.r_e[i]
    cos_c = rays.cos_c[i]
    is_finite = math.isfinite(h_c) and math.isfinite(h_g) and math.isfinite(r_e)
    if not (is_finite and 0.0 <= rays.sin_c[i] <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0):
        return BAD_MEASUREMENT
    if min(h_c, h_g) < table.edge[0] - _SLACK_M or max(h_c, h_g) > table.edge[-1] + _SLACK_M:
        return OUTSIDE_PROFILE
    if h_g < h_c and cos_c <= 0.0:  # a ray that leaves upwards
        return MISSES_GROUND
    return OK


@entry
def bend_rays(table, rays, which, angle, status):  # type: ignore[no-untyped-def]
    """Fill R_c, ``angle`` [rad], and ``status`` of the rays with the row numbers ``which``.

    ``rays`` are `RayColumns`, ``table`` is an `IndexTable`. The status is `FOR_NEXT_KERNEL` for a
    ray that the difference form does not serve, with the angle NaN, and for a ray that may meet its
    target's height twice, with the angle of the near crossing.
    """
    for i in which:
        angle[i] = math.nan
        status[i] = _status_of_input(table, rays, i)
        if status[i] != OK:
            continue
        h_g = rays.h_g[i]
        ray = ray_at(table, rays.h_c[i], rays.sin_c[i], rays.cos_c[i], rays.r_e[i])
        if h_g == ray.h_c:  # the near crossing is at the camera
            angle[i] = 0.0
        elif _is_far_from_grazing(ray, h_g):
            angle[i] = bend_by_difference(table, ray, h_g)
        is_only_crossing = not math.isnan(angle[i]) and crosses_once(table, ray, h_g)
        status[i] = OK if is_only_crossing else FOR_NEXT_KERNEL


@jit
def _subtended_to_height(table, ray, h, theta_to_rise):  # type: ignore[no-untyped-def]
    """Angle [rad] at the earth's centre from the camera to where the height of the ray is h [m].

    ``theta_to_rise`` is the angle from the camera through P_90, the lowest point, up to the
    camera's height again; zero where h is reached before P_90.
    """
    theta_between = subtended(table, ray, min(h, ray.h_c), max(h, ray.h_c), is_level_at_low=False)
    if not theta_to_rise > 0.0:
        return theta_between
    if h >= ray.h_c:
        return theta_to_rise + theta_between
    return theta_to_rise - theta_between  # it is still to rise from h to the camera's height


@jit
def _chord2_slope(table, ray, theta, h, sense):  # type: ignore[no-untyped-def]
    """d(chord^2)/dh [m] along a ray that has subtended ``theta`` where its height is h.

    The derivative of `chord2`, (h - h_c)^2 + 4 r_c r sin^2(theta / 2), with d(theta)/dh =
    ``sense`` k / (r sqrt(n^2 r^2 - k^2)) (Gyer 1996, Eq. 12). With the excess E = n r - k the root
    is that of E (E + 2 k). ``sense`` is 1 where the ray rises, -1 where it falls.
    """
    excess_h = excess(table, ray, piece_at(table.edge, h), h)
    r_c = ray.r_e + ray.h_c
    r_h = ray.r_e + h
    theta_slope = sense * ray.k / (r_h * math.sqrt(excess_h * (excess_h + 2.0 * ray.k)))
    sin_half = math.sin(0.5 * theta)
    slope = 2.0 * (h - ray.h_c) + 4.0 * r_c * (sin_half * sin_half)
    slope += 2.0 * r_c * r_h * math.sin(theta) * theta_slope
    return slope


@jit
def _step_in_s(s, s_0, s_1, too_long_m2, slope):  # type: ignore[no-untyped-def]
    """The next step in s [m^0.5] of the search between ``s_0`` and ``s_1``, with h = base + s^2.

    At ``s`` the square of the chord is ``too_long_m2`` [m2] too large, and ``slope`` [m] is its
    derivative by h. The step is Newton's, or leads to the middle of the interval where Newton's
    would leave the interval.
    """
    step = -too_long_m2 / (slope * 2.0 * s) if s > 0.0 else math.nan  # dh/ds is 2 s
    is_inside = s_0 < s + step < s_1  # False for NaN
    return step if is_inside else 0.5 * (s_0 + s_1) - s


@jit
def _search_height(table, ray, distance, search):  # type: ignore[no-untyped-def]
    """The height [m] at which the chord from the camera is ``distance`` [m] long, and the status.

    ``search`` is a `_Search`. Newton's iteration in s with h = base + s^2: in s the chord is smooth
    through P_90, in h it is not. The height is NaN unless the status is `OK`.
    """
    low = search.low
    high = search.high
    base = search.base
    # The first guess is the start height, or the middle of the interval if that is outside.
    s_0 = math.sqrt(max(low - base, 0.0))
    s_1 = math.sqrt(max(high - base, 0.0))
    s = 0.5 * (s_0 + s_1)
    if low < search.start < high:
        s = math.sqrt(search.start - base)
    is_reached = False  # a chord was at least as long as the distance
    for _ in range(_MOST_STEPS):
        h = min(max(base + s * s, low), high)
        theta = _subtended_to_height(table, ray, h, search.theta_to_rise)
        too_long_m2 = chord2(ray, theta, h) - distance * distance
        if math.isnan(too_long_m2):
            return math.nan, MISSES_GROUND  # the ray turns on its way
        is_reached = is_reached or too_long_m2 >= 0.0
        # Where the ray rises the chord grows with s, where it falls it shrinks.
        if too_long_m2 * search.sense > 0.0:
            s_1 = s
        else:
            s_0 = s
        slope = _chord2_slope(table, ray, theta, h, search.sense)
        step = _step_in_s(s, s_0, s_1, too_long_m2, slope)
        s += step
        # |step| (2 s + |step|) is at least the change of s^2, which is that of the height.
        if abs(step) * (2.0 * s + abs(step)) < _SHORTEST_STEP_M:
            break
    if is_reached or abs(too_long_m2) < _TWICE_SHORT_M * distance:
        return min(max(base + s * s, low), high), OK
    return math.nan, OUTSIDE_PROFILE  # the chord is too short even at the end of the profile


@jit
def _start_height(ray, distance):  # type: ignore[no-untyped-def]
    """Height [m] at a distance [m] along the straight line in the ray's direction at the camera.

    A first guess: it differs from the height of the ray by tenths of a metre for steep rays, by
    kilometres for level ones.
    """
    r_c = ray.r_e + ray.h_c
    square_change = distance * (distance - 2.0 * r_c * ray.cos_c)  # r^2 - r_c^2
    return ray.h_c + square_change / (r_c + math.sqrt(max(r_c * r_c + square_change, 0.0)))


@jit
def _chord_to_lowest(table, ray, h_90):  # type: ignore[no-untyped-def]
    """Length [m] of the chord to the lowest point of a ray."""
    theta = subtended(table, ray, h_90, ray.h_c, is_level_at_low=True)
    return math.sqrt(chord2(ray, theta, h_90))


@jit
def _ray_height(table, ray, distance):  # type: ignore[no-untyped-def]
    """Height [m] and status of a `Ray` at the length ``distance`` [m] of the chord from its camera.

    The height is NaN unless the status is `OK`.
    """
    h_c = ray.h_c
    bottom = table.edge[0]
    top = table.edge[-1]
    start = _start_height(ray, distance)
    h_90 = turning_height(table, ray) if ray.cos_c > 0.0 else math.nan
    # The search is in s = sqrt(h - base), in which the chord is smooth if the ray is level at the
    # base. A ray without a lowest point gets, instead of h_90, the height at which it would be
    # level if n r grew by a metre for each metre of height.
    level_height = h_c - ray.lift
    if ray.cos_c <= 0.0:  # the ray rises from the camera on
        search = _Search(
            low=h_c, high=top, base=level_height, start=start, theta_to_rise=0.0, sense=1.0
        )
    elif math.isnan(h_90):  # it falls to the end of the table
        search = _Search(
            low=bottom,
            high=h_c,
            base=min(level_height, bottom),
            start=start,
            theta_to_rise=0.0,
            sense=-1.0,
        )
    elif _chord_to_lowest(table, ray, h_90) >= distance:  # reached before P_90
        search = _Search(low=h_90, high=h_c, base=h_90, start=start, theta_to_rise=0.0, sense=-1.0)
    else:  # reached behind P_90, where the ray rises again
        theta_to_rise = subtended_to_rise(table, ray)
        if not theta_to_rise > 0.0:
            return math.nan, MISSES_GROUND  # its lowest point is below all land
        search = _Search(
            low=h_90, high=top, base=h_90, start=start, theta_to_rise=theta_to_rise, sense=1.0
        )
    return _search_height(table, ray, distance, search)


@entry
def ray_heights(table, rays, height, status):  # type: ignore[no-untyped-def]
    """Fill ``height`` [m] and ``status`` of the points of `RayColumns` at ``distance``.

    That is the length of the straight chord from the camera; h_g is not read. A height is NaN
    unless its status is `OK`.
    """
    edge = table.edge
    for i in range(rays.h_c.size):
        h_c = rays.h_c[i]
        sin_c = rays.sin_c[i]
        cos_c = rays.cos_c[i]
        r_e = rays.r_e[i]
        height[i] = math.nan
        status[i] = BAD_MEASUREMENT
        is_ray = 0.0 <= sin_c <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0
        if not (is_ray and 0.0 < rays.distance[i] < math.inf and math.isfinite(h_c + r_e)):
            continue
        if not edge[0] <= h_c <= edge[-1]:
            status[i] = OUTSIDE_PROFILE
            continue
        ray = ray_at(table, h_c, sin_c, cos_c, r_e)
        height[i], status[i] = _ray_height(table, ray, rays.distance[i])
