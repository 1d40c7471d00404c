"""The compiled part of `chord`: the height at which a ray is a given straight distance away."""

from __future__ import annotations

import math

from pipeline.refraction.kernels.jit import entry, jit
from pipeline.refraction.kernels.polynomials import piece
from pipeline.refraction.kernels.subtended import (
    chord2,
    excess,
    lift_of,
    subtended,
    subtended_through_turn,
    turning_height,
)
from pipeline.refraction.status import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE

# The height is known when the step is shorter [m]: the rounding of a height is 1e-12 m.
_SHORTEST_STEP_M = 1e-10


@jit
def _theta_at(edge, coefficient, h, n_c, h_c, r_e, lift, around):  # type: ignore[no-untyped-def]
    """Angle subtended up to height h; ``around`` is that through P_90 and up again, else 0."""
    if around > 0.0 and h >= h_c:
        return around + subtended(edge, coefficient, h_c, h, n_c, h_c, r_e, lift, False)
    low, high = min(h, h_c), max(h, h_c)
    theta = subtended(edge, coefficient, low, high, n_c, h_c, r_e, lift, False)
    return around - theta if around > 0.0 else theta


@jit
def _slope(edge, coefficient, h, theta, n_c, h_c, r_e, lift, sense):  # type: ignore[no-untyped-def]
    """d(chord^2)/dh along the ray; ``sense`` is the sign of d(theta)/dh."""
    k = (1.0 + n_c) * (r_e + h_c) - lift
    above = excess(edge, coefficient, piece(edge, h), h, n_c, h_c, r_e, lift)
    turning = sense * k / ((r_e + h) * math.sqrt(above * (above + 2.0 * k)))
    r_c, r_h = r_e + h_c, r_e + h
    return (
        2.0 * (h - h_c)
        + 4.0 * r_c * math.sin(0.5 * theta) ** 2
        + 2.0 * r_c * r_h * math.sin(theta) * turning
    )


@jit
def _solve(  # type: ignore[no-untyped-def]
    edge, coefficient, distance, low, high, turn, start, n_c, h_c, r_e, lift, around, sense
):
    """The height between ``low`` and ``high`` at which the chord is ``distance`` long, and status.

    Newton's iteration from ``start`` in s with h = turn + s^2, in which the chord is smooth through
    P_90, and bisection where it would leave the interval. ``sense`` is the sign of d(chord)/dh.
    """
    s_0, s_1 = math.sqrt(max(low - turn, 0.0)), math.sqrt(max(high - turn, 0.0))
    s = math.sqrt(start - turn) if low < start < high else 0.5 * (s_0 + s_1)
    reached = False
    for _ in range(100):
        h = min(max(turn + s * s, low), high)
        theta = _theta_at(edge, coefficient, h, n_c, h_c, r_e, lift, around)
        miss = chord2(theta, h_c, h, r_e) - distance * distance
        if math.isnan(miss):
            return math.nan, MISSES_GROUND
        reached = reached or miss >= 0.0
        if miss * sense > 0.0:
            s_1 = s
        else:
            s_0 = s
        slope = _slope(edge, coefficient, h, theta, n_c, h_c, r_e, lift, sense)
        step = -miss / (slope * 2.0 * s) if s > 0.0 else math.nan
        if not s_0 < s + step < s_1:  # also where the slope is no number
            step = 0.5 * (s_0 + s_1) - s
        s += step
        if abs(step) * (2.0 * s + abs(step)) < _SHORTEST_STEP_M:
            break
    if reached or abs(miss) < 2e-6 * distance:
        return min(max(turn + s * s, low), high), OK
    return math.nan, OUTSIDE_PROFILE  # not even at the end of the profile is it so far


@jit
def _ray_height(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, sin_c, cos_c, r_e, distance
):
    """Height and status of one ray at one distance."""
    n_c, lift = lift_of(edge, coefficient, h_c, sin_c, cos_c, r_e)
    top, level = edge[-1], h_c - lift
    # Along the straight line: tenths of a metre off for steep rays, kilometres for level ones.
    r_c = r_e + h_c
    fall = distance * (distance - 2.0 * r_c * cos_c)
    start = h_c + fall / (r_c + math.sqrt(max(r_c * r_c + fall, 0.0)))
    if cos_c <= 0.0:
        return _solve(
            edge, coefficient, distance, h_c, top, level, start, n_c, h_c, r_e, lift, 0.0, 1.0
        )
    turn = turning_height(edge, coefficient, n_c, h_c, r_e, lift)
    if math.isnan(turn):
        low = edge[0]
        below = min(level, low)
        return _solve(
            edge, coefficient, distance, low, h_c, below, start, n_c, h_c, r_e, lift, 0.0, -1.0
        )
    half = subtended(edge, coefficient, turn, h_c, n_c, h_c, r_e, lift, True)
    if math.sqrt(chord2(half, h_c, turn, r_e)) >= distance:
        return _solve(
            edge, coefficient, distance, turn, h_c, turn, start, n_c, h_c, r_e, lift, 0.0, -1.0
        )
    around = subtended_through_turn(edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift)
    if not around > 0.0:
        return math.nan, MISSES_GROUND  # its lowest point lies under all land
    return _solve(
        edge, coefficient, distance, turn, top, turn, start, n_c, h_c, r_e, lift, around, 1.0
    )


@entry
def ray_heights(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, sin_c, cos_c, r_e, distance, height, status
):
    """Fill ``height`` [m] and ``status`` for vectors of rays."""
    for i in range(h_c.size):
        height[i], status[i] = math.nan, BAD_MEASUREMENT
        sound = 0.0 <= sin_c[i] <= 1.0 and abs(cos_c[i]) <= 1.0 and r_e[i] > 0.0
        if not (sound and 0.0 < distance[i] < math.inf and math.isfinite(h_c[i] + r_e[i])):
            continue
        if not edge[0] <= h_c[i] <= edge[-1]:
            status[i] = OUTSIDE_PROFILE
            continue
        height[i], status[i] = _ray_height(
            edge, coefficient, h_c[i], sin_c[i], cos_c[i], r_e[i], distance[i]
        )
