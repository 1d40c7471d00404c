"""The compiled part of `ray`: one ray at a time, in double precision.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1. Imported only
when the first ray is computed, because importing numba costs most of a second.
"""

from __future__ import annotations

import math
import os

import numba
import numpy as np

from pipeline.refraction.status import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)


def _user_cache() -> str | None:
    """A folder of the user's for compiled code; never site-packages, which may be read-only."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = numba.config.CACHE_DIR or os.path.join(base, "unbend", "numba")
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_CACHE = _user_cache()
# numba looks for the folder when a function is decorated; others in this process keep their own.
_CACHE_OF_OTHERS, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE or ""
_jit = numba.njit(cache=_CACHE is not None, error_model="numpy")

# The difference form is left where the ray comes this near to grazing the lower of its two ends:
# (r cos zeta)^2 there is less than half of that at the upper end. Over a single piece of the table
# its eight nodes err by 6e-7 arcsec at 0.3, by 2e-10 at 0.5.
_GRAZING_GUARD = 0.5

# Within this depth of its lowest point [m] a ray follows closed form to 1e-9 arcsec, while n - n_c
# has lost its digits.
_LEVEL_M = 1e-4

# No dry land lies lower. A ray whose lowest point is deeper meets the ground before it.
_LOWEST_TERRAIN_M = -500.0

_X2, _W2 = (0.5 * a for a in np.polynomial.legendre.leggauss(2))
_X4, _W4 = (0.5 * a for a in np.polynomial.legendre.leggauss(4))
_X8, _W8 = (0.5 * a for a in np.polynomial.legendre.leggauss(8))
_X2, _X4, _X8 = 0.5 + _X2, 0.5 + _X4, 0.5 + _X8


@_jit
def _piece(edge, h):  # type: ignore[no-untyped-def]
    """Number of the piece of the table that holds height h."""
    return min(max(np.searchsorted(edge, h, side="right") - 1, 0), edge.size - 2)


@_jit
def _refractivity(edge, coefficient, i, h):  # type: ignore[no-untyped-def]
    """N at height h by the polynomial of piece i."""
    u = (h - edge[i]) / (edge[i + 1] - edge[i])
    value = coefficient[i, 7]
    for j in range(6, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@_jit
def _gradient(edge, coefficient, i, h):  # type: ignore[no-untyped-def]
    """dN/dh at height h."""
    width = edge[i + 1] - edge[i]
    u = (h - edge[i]) / width
    value = 7.0 * coefficient[i, 7]
    for j in range(6, 0, -1):
        value = value * u + j * coefficient[i, j]
    return value / width


@_jit
def _excess(edge, coefficient, i, h, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """n r - k without cancellation; ``lift`` is n_c r_c (1 - sin zeta_c)."""
    n = _refractivity(edge, coefficient, i, h)
    return (r_e + h) * (n - n_c) + (1.0 + n_c) * (h - h_c) + lift


@_jit
def _bend_difference(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e
):
    """R_c from the difference between straight and bent ray, both on their way to h_g.

    NaN where the bent ray turns before it gets there.
    """
    r_c, r_g = r_e + h_c, r_e + h_g
    n_c = _refractivity(edge, coefficient, _piece(edge, h_c), h_c)
    index_c = 1.0 + n_c
    s = r_c * sin_c
    # (r cos z)^2 along the straight line is linear in r^2.
    b2_c = (r_c * cos_c) ** 2
    b2_g = b2_c - (h_c - h_g) * (r_c + r_g)
    steep = min(b2_g, b2_c) > 0.9 * max(b2_g, b2_c)
    steepest = min(b2_g, b2_c) > 0.98 * max(b2_g, b2_c)
    low, high = min(h_c, h_g), max(h_c, h_g)
    integral = 0.0
    for i in range(_piece(edge, low), _piece(edge, high) + 1):
        h_0, h_1 = max(low, edge[i]), min(high, edge[i + 1])
        width = h_1 - h_0
        if width <= 0.0:
            continue
        # Far from grazing the integrand is nearly linear across a layer: the error of two nodes
        # over 60 m, and of four over 260 m, is 1e-13 of the whole.
        if steepest and width < 60.0:
            x, w, count = _X2, _W2, 2
        elif steep and width < 260.0:
            x, w, count = _X4, _W4, 4
        else:
            x, w, count = _X8, _W8, 8
        part = 0.0
        for j in range(count):
            h = h_0 + width * x[j]
            r = r_e + h
            n = _refractivity(edge, coefficient, i, h)
            straight2 = b2_c - (h_c - h) * (r_c + r)
            squares = (n - n_c) * (2.0 + n + n_c)  # n^2 - n_c^2
            bent2 = index_c * index_c * straight2 + squares * r * r
            if not (bent2 > 0.0 and straight2 > 0.0):
                return math.nan
            a = math.sqrt(bent2)
            b = index_c * math.sqrt(straight2)
            part += w[j] * squares * r / (a * b * (a + b))
        integral += part * width
    # Upwards the bent ray subtends the larger angle, and both signs turn over.
    sense = 1.0 if h_g < h_c else -1.0
    half = 0.5 * sense * index_c * s * integral
    q = math.sqrt(b2_g)
    z = math.atan2(s, q)
    chord = abs(h_c - h_g) * (r_c + r_g) / (r_c * abs(cos_c) + q)
    across = 2.0 * r_g * math.sin(half)
    return math.atan2(across * math.cos(z - half), chord - sense * across * math.sin(z - half))


@_jit
def _turning_height(edge, coefficient, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """h_90 at or below the camera, where n r = k (Gyer 1996, Eq. 16); NaN below the profile."""
    i = _piece(edge, h_c)
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


@_jit
def _level_height(edge, coefficient, i, h, n_c, h_c, r_e, lift):  # type: ignore[no-untyped-def]
    """Where, at or below h, the ray would be level if piece i of the table went on."""
    excess = _excess(edge, coefficient, i, h, n_c, h_c, r_e, lift)
    if not excess > 0.0:
        return h
    n = _refractivity(edge, coefficient, i, h)
    slope = 1.0 + n + (r_e + h) * _gradient(edge, coefficient, i, h)
    if slope <= 0.0:
        return h - excess
    depth = excess / slope
    # Farther down the integrand is smooth whatever the substitution; nearer, digits run out.
    if _LEVEL_M < depth < 0.5 * (edge[i + 1] - edge[i]):
        for _ in range(5):
            depth += _excess(edge, coefficient, i, h - depth, n_c, h_c, r_e, lift) / slope
    return h - max(depth, 0.0)


@_jit
def _subtended(  # type: ignore[no-untyped-def]
    edge, coefficient, low, high, n_c, h_c, r_e, lift, level_at_low
):
    """Angle the ray subtends between two heights (Gyer 1996, Eq. 12) with h = turn + s^2.

    ``turn`` is where the ray would be level by each piece of the table; the substitution takes
    the singularity out of the integrand. With ``level_at_low`` that is ``low`` itself, which
    rounding would miss: 1e-13 m of depth there are 3e-5 arcsec. NaN where the ray turns in between.
    """
    k = (1.0 + n_c) * (r_e + h_c) - lift
    total = 0.0
    for i in range(_piece(edge, low), _piece(edge, high) + 1):
        h_0, h_1 = max(low, edge[i]), min(high, edge[i + 1])
        if h_1 <= h_0:
            continue
        turn = h_0
        if not (level_at_low and h_0 == low):
            turn = _level_height(edge, coefficient, i, h_0, n_c, h_c, r_e, lift)
        s_0, s_1 = math.sqrt(max(h_0 - turn, 0.0)), math.sqrt(max(h_1 - turn, 0.0))
        part = 0.0
        for j in range(_X8.size):
            s = s_0 + (s_1 - s_0) * _X8[j]
            h = turn + s * s
            excess = _excess(edge, coefficient, i, h, n_c, h_c, r_e, lift)
            if not excess > 0.0:
                return math.nan
            part += _W8[j] * 2.0 * s * k / ((r_e + h) * math.sqrt(excess * (excess + 2.0 * k)))
        total += part * (s_1 - s_0)
    return total


@_jit
def _subtended_through_turn(  # type: ignore[no-untyped-def]
    edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
):
    """Angle from the camera down to P_90 and up to the camera's height again; NaN below land."""
    i = _piece(edge, h_c)
    if i > 0 and h_c <= edge[i]:
        i -= 1
    slope = 1.0 + n_c + (r_e + h_c) * _gradient(edge, coefficient, i, h_c)
    if slope > 0.0 and lift < _LEVEL_M * slope:
        return 2.0 * (1.0 + n_c) * sin_c * cos_c / slope
    turn = _turning_height(edge, coefficient, n_c, h_c, r_e, lift)
    if not turn >= _LOWEST_TERRAIN_M:
        return math.nan
    return 2.0 * _subtended(edge, coefficient, turn, h_c, n_c, h_c, r_e, lift, True)


@_jit
def _bend_subtended(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """R_c from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing."""
    n_c = _refractivity(edge, coefficient, _piece(edge, h_c), h_c)
    lift = (1.0 + n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)
    low, high = min(h_c, h_g), max(h_c, h_g)
    if h_g > h_c and cos_c > 0.0:  # down through P_90 and up again
        theta = _subtended_through_turn(
            edge, coefficient, n_c, h_c, sin_c, cos_c, r_e, lift
        ) + _subtended(edge, coefficient, h_c, h_g, n_c, h_c, r_e, lift, False)
    else:
        if not _excess(edge, coefficient, _piece(edge, low), low, n_c, h_c, r_e, lift) >= 0.0:
            return math.nan
        theta = _subtended(edge, coefficient, low, high, n_c, h_c, r_e, lift, False)
    across = math.sin(theta)
    along = (h_c - h_g) / (r_e + h_g) + 2.0 * math.sin(0.5 * theta) ** 2
    return math.atan2(sin_c * along - cos_c * across, cos_c * along + sin_c * across)


@_jit
def _bend_one(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """R_c and status of one ray."""
    finite = math.isfinite(h_c) and math.isfinite(h_g) and math.isfinite(r_e)
    if not (finite and 0.0 <= sin_c <= 1.0 and abs(cos_c) <= 1.0 and r_e > 0.0):
        return math.nan, BAD_MEASUREMENT
    slack = 1e-6
    if min(h_c, h_g) < edge[0] - slack or max(h_c, h_g) > edge[-1] + slack:
        return math.nan, OUTSIDE_PROFILE
    if h_g < h_c and cos_c <= 0.0:
        return math.nan, MISSES_GROUND
    if h_g == h_c:
        return 0.0, OK
    b2_c = ((r_e + h_c) * cos_c) ** 2
    b2_g = b2_c - (h_c - h_g) * (2.0 * r_e + h_c + h_g)
    through_turn = h_g > h_c and cos_c > 0.0
    if through_turn or min(b2_c, b2_g) < _GRAZING_GUARD * max(b2_c, b2_g):
        r_angle = _bend_subtended(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e)
    else:
        r_angle = _bend_difference(edge, coefficient, h_c, h_g, sin_c, cos_c, r_e)
    if math.isnan(r_angle):
        return math.nan, MISSES_GROUND
    if h_g < h_c:
        floor = max(edge[0], min(_LOWEST_TERRAIN_M, h_g))
        n_c = _refractivity(edge, coefficient, _piece(edge, h_c), h_c)
        lift = (1.0 + n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)
        i = _piece(edge, floor)
        if _excess(edge, coefficient, i, floor, n_c, h_c, r_e, lift) < 0.0:
            return r_angle, BEYOND_GRAZING
    return r_angle, OK


@_jit
def bend_rays(  # type: ignore[no-untyped-def]
    edge, coefficient, h_c, h_g, sin_c, cos_c, r_e, r_angle, status
):
    """Fill ``r_angle`` [rad] and ``status`` for vectors of rays."""
    for i in range(h_c.size):
        r_angle[i], status[i] = _bend_one(
            edge, coefficient, h_c[i], h_g[i], sin_c[i], cos_c[i], r_e[i]
        )


numba.config.CACHE_DIR = _CACHE_OF_OTHERS
