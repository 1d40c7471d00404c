"""The compiled parts of `ray` and `chord`: one ray at a time, in double precision.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1.
"""

import math
from typing import NamedTuple

from unbend.refraction.kernels.columns import LEFT
from unbend.refraction.kernels.grazing import (
    chord2,
    crosses_once,
    excess,
    gauss_legendre,
    piece,
    ray_at,
    refractivity,
    subtended,
    subtended_through_turn,
    turning_height,
)
from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE

# The difference form is left where the ray comes this near to grazing the lower of its two ends:
# (r cos zeta)^2 there is less than half of that at the upper end. Over a single piece of the table
# its eight nodes err by 6e-7 arcsec at 0.3, by 2e-10 at 0.5.
_GRAZING_GUARD = 0.5

# The difference form is also left where the ray is bent to half the slope of the straight line.
_BENT_GUARD = 0.5

# The height at a distance is known when the step is shorter [m]: a height is rounded to 1e-12 m.
_SHORTEST_STEP_M = 1e-10

# Nodes and weights of Gauss and Legendre between 0 and 1, and of how many a piece takes.
_X4, _W4 = gauss_legendre(4)
_X8, _W8 = gauss_legendre(8)
_WIDEST_M = 260.0  # up to which four are enough for a steep ray
_STEEP_SHARE = 0.9  # of (r cos zeta)^2 at one end to that at the other

_SLACK_M = 1e-6  # heights so far outside the profile are rounding
_SMALL_ANGLE = 0.01  # up to which the series of `small_angle` is good
_MOST_STEPS = 100  # of the search for a height, bisections among them
_REACHED = 2e-6  # of the distance: what a ray may lack of it at the end of the profile


class Triangle(NamedTuple):
    """The straight line from camera to target height."""

    sense: float  # -1 upwards
    s: float  # r_c sin zeta_c
    rise: float  # of one end over the other
    along: float  # r_c |cos zeta_c|
    b2_g: float  # (r_g cos)^2
    r_c: float
    r_g: float


class _Search(NamedTuple):
    """Where a height is sought."""

    low: float  # limits [m]
    high: float
    turn: float  # lowest point of the ray [m]
    start: float  # first guess [m]
    around: float  # angle subtended through P_90 and up again, 0 without
    sense: float  # sign of d(chord)/dh


@jit
def sides_of(half, line):  # type: ignore[no-untyped-def]
    """Two lengths, across and ahead, whose ratio is tan R_c.

    ``half`` is half the difference of the subtended angles, ``line`` a `Triangle`.
    """
    q = math.sqrt(line.b2_g)
    upon = line.along + q
    # half is below 0.01: the next terms are 1e-14 of these.
    square = half * half
    sin_half = half - half * square * (1.0 / 6.0 - square / 120.0)
    cos_half = 1.0 - square * (0.5 - square / 24.0)
    chord = 2.0 * sin_half * upon
    turned = line.sense * chord * (line.s * cos_half - q * sin_half)
    ahead = line.rise * (line.r_c + line.r_g) - turned
    across = chord * (q * cos_half + line.s * sin_half)
    return across, ahead


@jit
def small_angle(tangent):  # type: ignore[no-untyped-def]
    """Arctangent of up to 0.01, to 1e-16 of it."""
    square = tangent * tangent
    return tangent - tangent * square * (1.0 / 3.0 - square * (0.2 - square / 7.0))


@jit
def bend_by_difference(table, ray, h_g):  # type: ignore[no-untyped-def]
    """R_c from the difference between straight and bent ray, both on their way to h_g.

    NaN where the bent ray is nearly level before it gets there.
    """
    edge = table.edge
    h_c = ray.h_c
    n_c = ray.n_c
    r_e = ray.r_e
    r_c = r_e + h_c
    r_g = r_e + h_g
    index_c = 1.0 + n_c
    index2 = index_c * index_c
    s = r_c * ray.sin_c
    # (r cos z)^2 along the straight line is linear in r^2.
    b2_c = (r_c * ray.cos_c) * (r_c * ray.cos_c)
    b2_g = b2_c - (h_c - h_g) * (r_c + r_g)
    steep = min(b2_g, b2_c) > _STEEP_SHARE * max(b2_g, b2_c)
    low = min(h_c, h_g)
    high = max(h_c, h_g)
    integral = 0.0
    for i in range(piece(edge, low), piece(edge, high) + 1):
        h_0 = max(low, edge[i])
        h_1 = min(high, edge[i + 1])
        width = h_1 - h_0
        if width <= 0.0:
            continue
        # Far from grazing the integrand is smooth across a layer: the error of four nodes over
        # 260 m is 1e-13 of the whole.
        if steep and width < _WIDEST_M:
            nodes = _X4
            weights = _W4
        else:
            nodes = _X8
            weights = _W8
        part = 0.0
        for j in range(nodes.size):
            h = h_0 + width * nodes[j]
            n = refractivity(table, i, h)
            r = r_e + h
            # (n^2 - n_c^2) r / (a b (a + b)), a along the bent and b along the straight line.
            squares = (n - n_c) * (2.0 + n + n_c)
            straight2 = index2 * (b2_c - (h_c - h) * (r_c + r))
            bent2 = straight2 + squares * r * r
            if not (straight2 > 0.0 and bent2 > _BENT_GUARD * straight2):
                return math.nan
            a = math.sqrt(bent2)
            b = math.sqrt(straight2)
            part += weights[j] * (squares * r / (a * b * (a + b)))
        integral += part * width
    # Upwards the bent ray subtends the larger angle, and both signs turn over.
    sense = 1.0 if h_g < h_c else -1.0
    half = 0.5 * sense * index_c * s * integral
    line = Triangle(sense, s, abs(h_c - h_g), r_c * abs(ray.cos_c), b2_g, r_c, r_g)
    aside, ahead = sides_of(half, line)
    if abs(aside) < _SMALL_ANGLE * ahead:
        return small_angle(aside / ahead)
    return math.atan2(aside, ahead)


@jit
def _is_far_from_grazing(ray, h_g):  # type: ignore[no-untyped-def]
    """Whether the difference form serves a ray to height h_g."""
    if h_g > ray.h_c and ray.cos_c > 0.0:  # down through P_90 and up again
        return False
    level = (ray.r_e + ray.h_c) * ray.cos_c
    b2_c = level * level
    b2_g = b2_c - (ray.h_c - h_g) * (2.0 * ray.r_e + ray.h_c + h_g)
    return min(b2_c, b2_g) >= _GRAZING_GUARD * max(b2_c, b2_g)


@entry
def bend_rays(table, rays, which, angle, status):  # type: ignore[no-untyped-def]
    """Fill ``angle`` [rad] and ``status`` for the rays of `RayColumns` that ``which`` numbers.

    Those that the difference form does not serve, or that may meet their height twice, get the
    status `LEFT`, and the angle NaN or of the near crossing.
    """
    bottom = table.edge[0] - _SLACK_M
    top = table.edge[-1] + _SLACK_M
    for i in which:
        h_c = rays.h_c[i]
        h_g = rays.h_g[i]
        r_e = rays.r_e[i]
        sin_c = rays.sin_c[i]
        cos_c = rays.cos_c[i]
        angle[i] = math.nan
        finite = math.isfinite(h_c) and math.isfinite(h_g) and math.isfinite(r_e)
        if not (finite and 0.0 <= sin_c <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0):
            status[i] = BAD_MEASUREMENT
        elif min(h_c, h_g) < bottom or max(h_c, h_g) > top:
            status[i] = OUTSIDE_PROFILE
        elif h_g < h_c and cos_c <= 0.0:
            status[i] = MISSES_GROUND
        else:
            ray = ray_at(table, h_c, sin_c, cos_c, r_e)
            if h_g == h_c:
                angle[i] = 0.0
            elif _is_far_from_grazing(ray, h_g):
                angle[i] = bend_by_difference(table, ray, h_g)
            once = not math.isnan(angle[i]) and crosses_once(table, ray, h_g)
            status[i] = OK if once else LEFT


@jit
def _search_height(table, ray, distance, search):  # type: ignore[no-untyped-def]
    """The height at which the chord is ``distance`` long, and status.

    Newton's iteration from ``start`` in s with h = turn + s^2, in which the chord is smooth through
    P_90, and bisection where it would leave the interval from ``low`` to ``high``.
    """
    low = search.low
    high = search.high
    turn = search.turn
    around = search.around
    sense = search.sense
    s_0 = math.sqrt(max(low - turn, 0.0))
    s_1 = math.sqrt(max(high - turn, 0.0))
    s = 0.5 * (s_0 + s_1)
    if low < search.start < high:
        s = math.sqrt(search.start - turn)
    reached = False
    for _ in range(_MOST_STEPS):
        h = min(max(turn + s * s, low), high)
        if around > 0.0 and h >= ray.h_c:  # through P_90 and up again
            theta = around + subtended(table, ray, ray.h_c, h, False)
        else:
            theta = subtended(table, ray, min(h, ray.h_c), max(h, ray.h_c), False)
            theta = around - theta if around > 0.0 else theta
        miss = chord2(ray, theta, h) - distance * distance
        if math.isnan(miss):
            return math.nan, MISSES_GROUND
        reached = reached or miss >= 0.0
        if miss * sense > 0.0:
            s_1 = s
        else:
            s_0 = s
        # d(chord^2)/dh along the ray.
        above = excess(table, ray, piece(table.edge, h), h)
        r_c = ray.r_e + ray.h_c
        r_h = ray.r_e + h
        turning = sense * ray.k / (r_h * math.sqrt(above * (above + 2.0 * ray.k)))
        half = math.sin(0.5 * theta)
        slope = 2.0 * (h - ray.h_c) + 4.0 * r_c * (half * half)
        slope += 2.0 * r_c * r_h * math.sin(theta) * turning
        step = -miss / (slope * 2.0 * s) if s > 0.0 else math.nan
        if not s_0 < s + step < s_1:  # also where the slope is no number
            step = 0.5 * (s_0 + s_1) - s
        s += step
        if abs(step) * (2.0 * s + abs(step)) < _SHORTEST_STEP_M:
            break
    if reached or abs(miss) < _REACHED * distance:
        return min(max(turn + s * s, low), high), OK
    return math.nan, OUTSIDE_PROFILE  # not even at the end of the profile is it so far


@jit
def _ray_height(table, ray, distance):  # type: ignore[no-untyped-def]
    """Height and status of one ray at one distance."""
    h_c = ray.h_c
    bottom = table.edge[0]
    top = table.edge[-1]
    level = h_c - ray.lift
    # Along the straight line: tenths of a metre off for steep rays, kilometres for level ones.
    r_c = ray.r_e + h_c
    fall = distance * (distance - 2.0 * r_c * ray.cos_c)
    start = h_c + fall / (r_c + math.sqrt(max(r_c * r_c + fall, 0.0)))
    turn = turning_height(table, ray) if ray.cos_c > 0.0 else math.nan
    if ray.cos_c <= 0.0:
        search = _Search(h_c, top, level, start, 0.0, 1.0)
    elif math.isnan(turn):
        search = _Search(bottom, h_c, min(level, bottom), start, 0.0, -1.0)
    elif math.sqrt(chord2(ray, subtended(table, ray, turn, h_c, True), turn)) >= distance:
        search = _Search(turn, h_c, turn, start, 0.0, -1.0)
    else:
        around = subtended_through_turn(table, ray)
        if not around > 0.0:
            return math.nan, MISSES_GROUND  # its lowest point lies under all land
        search = _Search(turn, top, turn, start, around, 1.0)
    return _search_height(table, ray, distance, search)


@entry
def ray_heights(table, rays, height, status):  # type: ignore[no-untyped-def]
    """Fill ``height`` [m] and ``status`` for `RayColumns` at their distances; h_g is not read."""
    edge = table.edge
    for i in range(rays.h_c.size):
        h_c = rays.h_c[i]
        sin_c = rays.sin_c[i]
        cos_c = rays.cos_c[i]
        r_e = rays.r_e[i]
        height[i] = math.nan
        status[i] = BAD_MEASUREMENT
        sound = 0.0 <= sin_c <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0
        if not (sound and 0.0 < rays.distance[i] < math.inf and math.isfinite(h_c + r_e)):
            continue
        if not edge[0] <= h_c <= edge[-1]:
            status[i] = OUTSIDE_PROFILE
            continue
        ray = ray_at(table, h_c, sin_c, cos_c, r_e)
        height[i], status[i] = _ray_height(table, ray, rays.distance[i])
