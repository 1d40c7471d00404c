"""The angle that a ray subtends at the earth's centre, compiled: good at and beyond grazing.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1; ``lift`` is
n_c r_c (1 - sin zeta_c).
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction.kernels.jit import jit
from pipeline.refraction.kernels.polynomials import gradient, piece, refractivity

# Within this depth of its lowest point [m] a ray follows closed form to 1e-9 arcsec, while n - n_c
# has lost its digits.
_LEVEL_M = 1e-4

# Where n r grows less than this with height the ray bends nearly as the earth does, and may be
# level at the upper end of a layer, or within it: such layers are integrated in graded panels.
_COMMON_SLOPE = 0.2
_HALVINGS = 44  # of a layer, down to 1e-12 m

LOWEST_TERRAIN_M = -500.0
"""No dry land lies lower. A ray whose lowest point is deeper meets the ground before it."""

_X8, _W8 = (0.5 * a for a in np.polynomial.legendre.leggauss(8))
_X8 = 0.5 + _X8


@jit
def lift_of(edge, coefficient, h_c, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """N_c, and n_c r_c (1 - sin zeta_c) without cancellation."""
    n_c = refractivity(edge, coefficient, piece(edge, h_c), h_c)
    return n_c, (1.0 + n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)


@jit
def excess(edge, coefficient, i, h, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """n r - k without cancellation; ``lift`` is n_c r_c (1 - sin zeta_c)."""
    n = refractivity(edge, coefficient, i, h)
    return (r_e + h) * (n - n_c) + (1.0 + n_c) * (h - h_c) + lift


@jit
def _slope(edge, coefficient, i, h, r_e):  # type: ignore[no-untyped-def]
    """d(n r)/dh at height h; about 0.8 in common air, below zero in a duct."""
    n = refractivity(edge, coefficient, i, h)
    return 1.0 + n + (r_e + h) * gradient(edge, coefficient, i, h)


@jit
def turning_height(edge, coefficient, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """h_90 at or below the camera, where n r = k (Gyer 1996, Eq. 16); NaN below the profile."""
    i = piece(edge, h_c)
    high = h_c
    while i >= 0:
        low = edge[i]
        if excess(edge, coefficient, i, low, n_c, h_c, r_e, lift) <= 0.0:
            for _ in range(80):
                middle = 0.5 * (low + high)
                if middle <= low or middle >= high:
                    break
                if excess(edge, coefficient, i, middle, n_c, h_c, r_e, lift) > 0.0:
                    high = middle
                else:
                    low = middle
            return high
        high = low
        i -= 1
    return math.nan


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
        above = _excess_near(edge, coefficient, i, base, at_base, y, r_e)
        if not above > 0.0:
            return math.nan
        total += _W8[j] * 2.0 * s * k / ((r_e + base + y) * math.sqrt(above * (above + 2.0 * k)))
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
def subtended(  # type: ignore[no-untyped-def]
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
            at_0 = excess(edge, coefficient, i, h_0, n_c, h_c, r_e, lift)
        slope_0 = _slope(edge, coefficient, i, h_0, r_e)
        slope_1 = _slope(edge, coefficient, i, h_1, r_e)
        if min(slope_0, slope_1) > _COMMON_SLOPE:
            depth = _depth(edge, coefficient, i, h_0, at_0, slope_0, r_e) if at_0 > 0.0 else 0.0
            total += _panel(edge, coefficient, i, h_0, at_0, 1.0, 0.0, h_1 - h_0, depth, k, r_e)
            continue
        if h_1 != h_c:
            at_1 = excess(edge, coefficient, i, h_1, n_c, h_c, r_e, lift)
        if slope_0 < 0.0 < slope_1:  # n r is smallest in between
            least = _flattest(edge, coefficient, i, h_0, h_1, r_e)
            at_least = excess(edge, coefficient, i, least, n_c, h_c, r_e, lift)
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
def subtended_through_turn(  # type: ignore[no-untyped-def]
    edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
):
    """Angle from the camera down to P_90 and up to the camera's height again; NaN below land."""
    i = piece(edge, h_c)
    if i > 0 and h_c <= edge[i]:
        i -= 1
    slope = _slope(edge, coefficient, i, h_c, r_e)
    if slope > 0.0 and lift < _LEVEL_M * slope:
        return 2.0 * (1.0 + n_c) * sin_c * cos_c / slope
    turn = turning_height(edge, coefficient, n_c, h_c, r_e, lift)
    if not turn >= LOWEST_TERRAIN_M:
        return math.nan
    return 2.0 * subtended(edge, coefficient, turn, h_c, n_c, h_c, r_e, lift, True)


@jit
def chord2(theta, h_c, h_g, r_e):  # type: ignore[no-untyped-def]
    """Square of the straight distance between two heights that subtend theta."""
    return (h_c - h_g) ** 2 + 4.0 * (r_e + h_c) * (r_e + h_g) * math.sin(0.5 * theta) ** 2


@jit
def angle_to(theta, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """R_c of the point at height h_g where the ray has subtended theta (Gyer 1996, Eq. 11)."""
    across = math.sin(theta)
    along = (h_c - h_g) / (r_e + h_g) + 2.0 * math.sin(0.5 * theta) ** 2
    return math.atan2(sin_c * along - cos_c * across, cos_c * along + sin_c * across)
