"""The compiled part of `ray`: one ray at a time, in double precision.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction.kernels.jit import entry, jit
from pipeline.refraction.kernels.polynomials import piece, refractivity
from pipeline.refraction.kernels.subtended import (
    LOWEST_TERRAIN_M,
    angle_to,
    chord2,
    excess,
    lift_of,
    subtended,
    subtended_through_turn,
)
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

# The difference form is also left where the ray is bent to half the slope of the straight line.
_BENT_GUARD = 0.5

_X4, _W4 = (0.5 * a for a in np.polynomial.legendre.leggauss(4))
_X8, _W8 = (0.5 * a for a in np.polynomial.legendre.leggauss(8))
_X4, _X8 = 0.5 + _X4, 0.5 + _X8


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


@entry
def _bend_subtended(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e
):
    """R_c from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing."""
    n_c, lift = lift_of(edge, coefficient, h_c, sin_c, cos_c, r_e)
    low, high = min(h_c, h_g), max(h_c, h_g)
    if h_g > h_c and cos_c > 0.0:  # down through P_90 and up again
        theta = subtended_through_turn(
            edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
        ) + subtended(edge, coefficient, h_c, h_g, n_c, h_c, r_e, lift, False)
    else:
        if not excess(edge, coefficient, piece(edge, low), low, n_c, h_c, r_e, lift) >= 0.0:
            return math.nan
        theta = subtended(edge, coefficient, low, high, n_c, h_c, r_e, lift, False)
    return angle_to(theta, h_c, h_g, sin_c, cos_c, r_e)


@jit
def two_crossings(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """Whether a downward ray turns above the ground, and so meets heights below h_c twice."""
    floor = max(edge[0], min(LOWEST_TERRAIN_M, h_g))
    # The straight line's lowest point lies deeper than the ray's, by less than a fifth in any air
    # in which n falls with height; far below the floor there is nothing to look at.
    if (r_e + h_c) * cos_c * cos_c > 2.0 * (1.0 + sin_c) * (h_c - floor + 100.0):
        return False
    n_c, lift = lift_of(edge, coefficient, h_c, sin_c, cos_c, r_e)
    i = piece(edge, floor)
    return excess(edge, coefficient, i, floor, n_c, h_c, r_e, lift) < 0.0


@jit
def _choose_crossing(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, distance, near
):
    """The crossing whose slant range is nearer to the one that was given, and its status."""
    n_c, lift = lift_of(edge, coefficient, h_c, sin_c, cos_c, r_e)
    theta = subtended(edge, coefficient, h_g, h_c, n_c, h_c, r_e, lift, False)
    around = subtended_through_turn(edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift)
    far = math.sqrt(chord2(around - theta, h_c, h_g, r_e))
    if abs(far - distance) < abs(math.sqrt(chord2(theta, h_c, h_g, r_e)) - distance):
        return angle_to(around - theta, h_c, h_g, sin_c, cos_c, r_e), FAR_BRANCH
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
