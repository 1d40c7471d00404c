"""The compiled part of `ray`: one ray at a time, in double precision.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction._jit import entry, jit
from pipeline.refraction._polynomials import gradient, piece, refractivity
from pipeline.refraction.status import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)

# The difference form is left where the ray comes this near to grazing the lower of its two ends:
# (r cos zeta)^2 there is less than half of that at the upper end. Over a single piece of the table
# its eight nodes err by 6e-7 arcsec at 0.3, by 2e-10 at 0.5.
_GRAZING_GUARD = 0.5

# Within this depth of its lowest point [m] a ray follows closed form to 1e-9 arcsec, while n - n_c
# has lost its digits.
_LEVEL_M = 1e-4

# Where n r grows less than this with height the ray bends nearly as the earth does, and may be
# level at the upper end of a layer, or within it: such layers are integrated in graded panels.
_COMMON_SLOPE = 0.2
_HALVINGS = 44  # of a layer, down to 1e-12 m

# The difference form is also left where the ray is bent to half the slope of the straight line.
_BENT_GUARD = 0.5

# No dry land lies lower. A ray whose lowest point is deeper meets the ground before it.
_LOWEST_TERRAIN_M = -500.0

_X4, _W4 = (0.5 * a for a in np.polynomial.legendre.leggauss(4))
_X8, _W8 = (0.5 * a for a in np.polynomial.legendre.leggauss(8))
_X4, _X8 = 0.5 + _X4, 0.5 + _X8


@jit
def _excess(edge, coefficient, i, h, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """n r - k without cancellation; ``lift`` is n_c r_c (1 - sin zeta_c)."""
    n = refractivity(edge, coefficient, i, h)
    return (r_e + h) * (n - n_c) + (1.0 + n_c) * (h - h_c) + lift


@jit
def integrand(n, n_c, h, h_c, b2_c, r_c, r_e):  # type: ignore[no-untyped-def]
    """(n^2 - n_c^2) r / (a b (a + b)) of the difference form; NaN near and past a turning point."""
    r = r_e + h
    index2 = (1.0 + n_c) * (1.0 + n_c)
    straight2 = index2 * (b2_c - (h_c - h) * (r_c + r))
    squares = (n - n_c) * (2.0 + n + n_c)
    bent2 = straight2 + squares * r * r
    if not (straight2 > 0.0 and bent2 > _BENT_GUARD * straight2):
        return math.nan
    a, b = math.sqrt(bent2), math.sqrt(straight2)
    return squares * r / (a * b * (a + b))


@entry
def _bend_difference(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e
):
    """R_c from the difference between straight and bent ray, both on their way to h_g.

    NaN where the bent ray is nearly level before it gets there.
    """
    r_c, r_g = r_e + h_c, r_e + h_g
    n_c = refractivity(edge, coefficient, piece(edge, h_c), h_c)
    index_c = 1.0 + n_c
    s = r_c * sin_c
    # (r cos z)^2 along the straight line is linear in r^2.
    b2_c = (r_c * cos_c) ** 2
    b2_g = b2_c - (h_c - h_g) * (r_c + r_g)
    steep = min(b2_g, b2_c) > 0.9 * max(b2_g, b2_c)
    low, high = min(h_c, h_g), max(h_c, h_g)
    integral = 0.0
    for i in range(piece(edge, low), piece(edge, high) + 1):
        h_0, h_1 = max(low, edge[i]), min(high, edge[i + 1])
        width = h_1 - h_0
        if width <= 0.0:
            continue
        # Far from grazing the integrand is smooth across a layer: the error of four nodes over
        # 260 m is 1e-13 of the whole.
        if steep and width < 260.0:
            x, w, count = _X4, _W4, 4
        else:
            x, w, count = _X8, _W8, 8
        part = 0.0
        for j in range(count):
            h = h_0 + width * x[j]
            n = refractivity(edge, coefficient, i, h)
            part += w[j] * integrand(n, n_c, h, h_c, b2_c, r_c, r_e)
        integral += part * width
    # Upwards the bent ray subtends the larger angle, and both signs turn over.
    sense = 1.0 if h_g < h_c else -1.0
    half = 0.5 * sense * index_c * s * integral
    return angle_of(half, sense, s, abs(h_c - h_g), r_c * abs(cos_c), b2_g, r_c, r_g)


@jit
def sides_of(half, sense, s, rise, along, b2_g, r_c, r_g):  # type: ignore[no-untyped-def]
    """Two lengths, across and ahead, whose ratio is tan R_c.

    ``half`` is half the difference of the subtended angles, ``sense`` is -1 upwards.
    """
    q = math.sqrt(b2_g)
    upon = along + q
    # half is below 0.01: the next terms are 1e-14 of these.
    square = half * half
    sin_half = half - half * square * (1.0 / 6.0 - square / 120.0)
    cos_half = 1.0 - square * (0.5 - square / 24.0)
    across = 2.0 * sin_half * upon
    ahead = rise * (r_c + r_g) - sense * across * (s * cos_half - q * sin_half)
    return across * (q * cos_half + s * sin_half), ahead


@jit
def small_angle(tangent):  # type: ignore[no-untyped-def]
    """Arctangent of up to 0.01, to 1e-16 of it."""
    square = tangent * tangent
    return tangent - tangent * square * (1.0 / 3.0 - square * (0.2 - square / 7.0))


@jit
def angle_of(half, sense, s, rise, along, b2_g, r_c, r_g):  # type: ignore[no-untyped-def]
    """R_c from half the difference of the subtended angles; ``sense`` is -1 upwards."""
    aside, ahead = sides_of(half, sense, s, rise, along, b2_g, r_c, r_g)
    if abs(aside) < 0.01 * ahead:
        return small_angle(aside / ahead)
    return math.atan2(aside, ahead)


@jit
def _turning_height(edge, coefficient, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """h_90 at or below the camera, where n r = k (Gyer 1996, Eq. 16); NaN below the profile."""
    i = piece(edge, h_c)
    high = h_c
    while i >= 0:
        low = edge[i]
        if _excess(edge, coefficient, i, low, n_c, h_c, r_e, lift) <= 0.0:
            for _ in range(80):
                middle = 0.5 * (low + high)
                if middle <= low or middle >= high:
                    break
                if _excess(edge, coefficient, i, middle, n_c, h_c, r_e, lift) > 0.0:
                    high = middle
                else:
                    low = middle
            return high
        high = low
        i -= 1
    return math.nan


@jit
def _slope(edge, coefficient, i, h, r_e):  # type: ignore[no-untyped-def]
    """d(n r)/dh at height h; about 0.8 in common air, below zero in a duct."""
    n = refractivity(edge, coefficient, i, h)
    return 1.0 + n + (r_e + h) * gradient(edge, coefficient, i, h)


@jit
def _excess_near(edge, coefficient, i, base, at_base, y, r_e):  # type: ignore[no-untyped-def]
    """n r - k at ``base`` + y, where it is ``at_base`` at y = 0; y may be as small as it likes."""
    width = edge[i + 1] - edge[i]
    u_0 = (base - edge[i]) / width
    u = u_0 + y / width
    # The divided difference of the polynomial, by Horner's scheme beside that of its value.
    value = quotient = coefficient[i, 7]
    for j in range(6, 0, -1):
        value = value * u_0 + coefficient[i, j]
        quotient = quotient * u + value
    value = value * u_0 + coefficient[i, 0]
    return at_base + (1.0 + value) * y + (r_e + base + y) * (y / width) * quotient


@jit
def _panel(  # type: ignore[no-untyped-def]
    edge, coefficient, i, base, at_base, sense, near, far, depth, k, r_e
):
    """Angle subtended between ``near`` and ``far`` from ``base``, up (sense 1) or down (-1).

    With s^2 = distance + ``depth`` as the variable; NaN where the ray turns in between.
    """
    s_0, s_1 = math.sqrt(near + depth), math.sqrt(far + depth)
    total = 0.0
    for j in range(_X8.size):
        s = s_0 + (s_1 - s_0) * _X8[j]
        y = sense * (s * s - depth)
        excess = _excess_near(edge, coefficient, i, base, at_base, y, r_e)
        if not excess > 0.0:
            return math.nan
        total += _W8[j] * 2.0 * s * k / ((r_e + base + y) * math.sqrt(excess * (excess + 2.0 * k)))
    return total * (s_1 - s_0)


@jit
def _graded(edge, coefficient, i, base, at_base, sense, width, k, r_e):  # type: ignore[no-untyped-def]
    """Angle subtended over ``width`` from ``base``, in panels that halve towards it.

    For air in which n r hardly grows, or falls, away from its smallest value in the layer.
    """
    total, far = 0.0, width
    for _ in range(_HALVINGS):
        near = 0.5 * far
        total += _panel(edge, coefficient, i, base, at_base, sense, near, far, 0.0, k, r_e)
        far = near
    return total + _panel(edge, coefficient, i, base, at_base, sense, 0.0, far, 0.0, k, r_e)


@jit
def _depth(edge, coefficient, i, base, at_base, slope, r_e):  # type: ignore[no-untyped-def]
    """How far below ``base`` the ray would be level if piece i of the table went on."""
    depth = at_base / slope
    # Farther down the integrand is smooth whatever the substitution; nearer, digits run out.
    if _LEVEL_M < depth < 0.5 * (edge[i + 1] - edge[i]):
        for _ in range(5):
            depth += _excess_near(edge, coefficient, i, base, at_base, -depth, r_e) / slope
    return max(depth, 0.0)


@jit
def _flattest(edge, coefficient, i, low, high, r_e):  # type: ignore[no-untyped-def]
    """Where n r is smallest between heights at whose ends it falls inwards."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        if _slope(edge, coefficient, i, middle, r_e) < 0.0:
            low = middle
        else:
            high = middle
    return low


@jit
def _subtended(  # type: ignore[no-untyped-def]
    edge, coefficient, low, high, n_c, h_c, r_e, lift, level_at_low
):
    """Angle the ray subtends between two heights (Gyer 1996, Eq. 12), with h = turn + s^2.

    ``turn`` is where the ray would be level by each piece of the table; the substitution takes
    the singularity out of the integrand. With ``level_at_low`` that is ``low`` itself, which
    rounding would miss: 1e-13 m of depth there are 3e-5 arcsec. NaN where the ray turns in between.
    """
    k = (1.0 + n_c) * (r_e + h_c) - lift
    total = 0.0
    for i in range(piece(edge, low), piece(edge, high) + 1):
        h_0, h_1 = max(low, edge[i]), min(high, edge[i + 1])
        if h_1 <= h_0:
            continue
        at_0 = at_1 = lift
        if level_at_low and h_0 == low:
            at_0 = 0.0
        elif h_0 != h_c:
            at_0 = _excess(edge, coefficient, i, h_0, n_c, h_c, r_e, lift)
        slope_0 = _slope(edge, coefficient, i, h_0, r_e)
        slope_1 = _slope(edge, coefficient, i, h_1, r_e)
        if min(slope_0, slope_1) > _COMMON_SLOPE:
            depth = _depth(edge, coefficient, i, h_0, at_0, slope_0, r_e) if at_0 > 0.0 else 0.0
            total += _panel(edge, coefficient, i, h_0, at_0, 1.0, 0.0, h_1 - h_0, depth, k, r_e)
            continue
        if h_1 != h_c:
            at_1 = _excess(edge, coefficient, i, h_1, n_c, h_c, r_e, lift)
        if slope_0 < 0.0 < slope_1:  # n r is smallest in between
            least = _flattest(edge, coefficient, i, h_0, h_1, r_e)
            at_least = _excess(edge, coefficient, i, least, n_c, h_c, r_e, lift)
            total += _graded(
                edge, coefficient, i, least, at_least, -1.0, least - h_0, k, r_e
            ) + _graded(edge, coefficient, i, least, at_least, 1.0, h_1 - least, k, r_e)
        else:
            half = 0.5 * (h_1 - h_0)
            total += _graded(edge, coefficient, i, h_0, at_0, 1.0, half, k, r_e) + _graded(
                edge, coefficient, i, h_1, at_1, -1.0, half, k, r_e
            )
    return total


@jit
def _subtended_through_turn(  # type: ignore[no-untyped-def]
    edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
):
    """Angle from the camera down to P_90 and up to the camera's height again; NaN below land."""
    i = piece(edge, h_c)
    if i > 0 and h_c <= edge[i]:
        i -= 1
    slope = 1.0 + n_c + (r_e + h_c) * gradient(edge, coefficient, i, h_c)
    if slope > 0.0 and lift < _LEVEL_M * slope:
        return 2.0 * (1.0 + n_c) * sin_c * cos_c / slope
    turn = _turning_height(edge, coefficient, n_c, h_c, r_e, lift)
    if not turn >= _LOWEST_TERRAIN_M:
        return math.nan
    return 2.0 * _subtended(edge, coefficient, turn, h_c, n_c, h_c, r_e, lift, True)


@jit
def _chord2(theta, h_c, h_g, r_e):  # type: ignore[no-untyped-def]
    """Square of the straight distance between two heights that subtend theta."""
    return (h_c - h_g) ** 2 + 4.0 * (r_e + h_c) * (r_e + h_g) * math.sin(0.5 * theta) ** 2


@jit
def _angle_to(theta, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """R_c of the point at height h_g where the ray has subtended theta (Gyer 1996, Eq. 11)."""
    across = math.sin(theta)
    along = (h_c - h_g) / (r_e + h_g) + 2.0 * math.sin(0.5 * theta) ** 2
    return math.atan2(sin_c * along - cos_c * across, cos_c * along + sin_c * across)


@jit
def _lift(edge, coefficient, h_c, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """N_c, and n_c r_c (1 - sin zeta_c) without cancellation."""
    n_c = refractivity(edge, coefficient, piece(edge, h_c), h_c)
    return n_c, (1.0 + n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)


@entry
def _bend_subtended(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e
):
    """R_c from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing."""
    n_c, lift = _lift(edge, coefficient, h_c, sin_c, cos_c, r_e)
    low, high = min(h_c, h_g), max(h_c, h_g)
    if h_g > h_c and cos_c > 0.0:  # down through P_90 and up again
        theta = _subtended_through_turn(
            edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
        ) + _subtended(edge, coefficient, h_c, h_g, n_c, h_c, r_e, lift, False)
    else:
        if not _excess(edge, coefficient, piece(edge, low), low, n_c, h_c, r_e, lift) >= 0.0:
            return math.nan
        theta = _subtended(edge, coefficient, low, high, n_c, h_c, r_e, lift, False)
    return _angle_to(theta, h_c, h_g, sin_c, cos_c, r_e)


@jit
def two_crossings(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """Whether a downward ray turns above the ground, and so meets heights below h_c twice."""
    floor = max(edge[0], min(_LOWEST_TERRAIN_M, h_g))
    # The straight line's lowest point lies deeper than the ray's, by less than a fifth in any air
    # in which n falls with height; far below the floor there is nothing to look at.
    if (r_e + h_c) * cos_c * cos_c > 2.0 * (1.0 + sin_c) * (h_c - floor + 100.0):
        return False
    n_c, lift = _lift(edge, coefficient, h_c, sin_c, cos_c, r_e)
    i = piece(edge, floor)
    return _excess(edge, coefficient, i, floor, n_c, h_c, r_e, lift) < 0.0


@jit
def _choose_crossing(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, distance, near
):
    """The crossing whose slant range is nearer to the one that was given, and its status."""
    n_c, lift = _lift(edge, coefficient, h_c, sin_c, cos_c, r_e)
    theta = _subtended(edge, coefficient, h_g, h_c, n_c, h_c, r_e, lift, False)
    around = _subtended_through_turn(edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift)
    far = math.sqrt(_chord2(around - theta, h_c, h_g, r_e))
    if abs(far - distance) < abs(math.sqrt(_chord2(theta, h_c, h_g, r_e)) - distance):
        return _angle_to(around - theta, h_c, h_g, sin_c, cos_c, r_e), FAR_BRANCH
    return near, OK


@jit
def impossible(edge, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """Why there can be no angle, or OK."""
    finite = math.isfinite(h_c) and math.isfinite(h_g) and math.isfinite(r_e)
    if not (finite and 0.0 <= sin_c <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0):
        return BAD_MEASUREMENT
    slack = 1e-6
    if min(h_c, h_g) < edge[0] - slack or max(h_c, h_g) > edge[-1] + slack:
        return OUTSIDE_PROFILE
    if h_g < h_c and cos_c <= 0.0:
        return MISSES_GROUND
    return OK


@jit
def _bend_one(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, distance
):
    """R_c and status of one ray, by itself."""
    b2_c = ((r_e + h_c) * cos_c) ** 2
    b2_g = b2_c - (h_c - h_g) * (2.0 * r_e + h_c + h_g)
    r_angle = 0.0 if h_g == h_c else math.nan
    through_turn = h_g > h_c and cos_c > 0.0
    if h_g != h_c and not through_turn and min(b2_c, b2_g) >= _GRAZING_GUARD * max(b2_c, b2_g):
        r_angle = _bend_difference(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e)
    if math.isnan(r_angle):
        r_angle = _bend_subtended(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e)
    if math.isnan(r_angle):
        return math.nan, MISSES_GROUND
    # At the camera's own height the far crossing of a level ray is the near one.
    down = h_g < h_c or (h_g == h_c and cos_c > 1e-9)
    if down and two_crossings(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e):
        if distance > 0.0:
            return _choose_crossing(
                edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, distance, r_angle
            )
        return r_angle, BEYOND_GRAZING
    return r_angle, OK


@entry
def bend_rays(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, distance, which, angle, status
):
    """Fill ``angle`` [rad] and ``status`` for the rays of vectors that ``which`` numbers."""
    for i in which:
        status[i] = impossible(edge, h_c[i], h_g[i], sin_c[i], cos_c[i], r_e[i])
        angle[i] = math.nan
        if status[i] == OK:
            angle[i], status[i] = _bend_one(
                edge, coefficient, h_c[i], h_g[i], sin_c[i], cos_c[i], r_e[i], distance[i]
            )
