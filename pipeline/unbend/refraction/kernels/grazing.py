"""Rays near grazing, compiled: the angle they subtend at the earth's centre, and which crossing.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c, N = n - 1. Compiled functions
take no keywords: what belongs together travels in named tuples.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, MISSES_GROUND, OK
from unbend.units import Array

# Within this depth of its lowest point [m] a ray follows closed form to 1e-9 arcsec, while n - n_c
# has lost its digits.
_LEVEL_M = 1e-4

# Where n r grows less than this with height the ray bends nearly as the earth does, and may be
# level at the upper end of a layer, or within it: such layers are integrated in graded panels.
_COMMON_SLOPE = 0.2
_HALVINGS = 44  # of a layer, down to 1e-12 m

LOWEST_TERRAIN_M = -500.0
"""No dry land lies lower. A ray whose lowest point is deeper meets the ground before it."""

_HALVINGS_OF_HEIGHT = 80  # of the search for the height of the lowest point
_HALVINGS_OF_LAYER = 60  # of the search for the smallest n r in a layer
_DEPTH_STEPS = 5  # of the iteration for the depth of the level point below a layer
_DEGREE = 7  # of the polynomials of the table

_LEVEL_COSINE = 1e-9  # at the camera's own height: the far crossing of a level ray is the near one
_DEPTH_TO_SPARE_M = 100.0


def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss and Legendre for the interval from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


_X8, _W8 = gauss_legendre(8)


class Ray(NamedTuple):
    """A ray at its camera, and what stays the same along it."""

    h_c: float  # height of the camera [m]
    sin_c: float  # of the apparent nadir angle
    cos_c: float
    r_e: float  # radius of the sphere [m]
    n_c: float  # N at the camera
    lift: float  # n_c r_c (1 - sin zeta_c) [m]
    k: float


class _Base(NamedTuple):
    """Where panels begin."""

    piece: int  # of the table
    height: float
    excess: float  # n r - k there
    sense: float  # up (1) or down (-1)


@jit
def piece(edge, h):  # type: ignore[no-untyped-def]
    """Number of the piece of the table that holds height h."""
    low = 0
    high = edge.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edge[middle] <= h:
            low = middle
        else:
            high = middle
    return low


@jit
def refractivity(table, i, h):  # type: ignore[no-untyped-def]
    """N at height h by the polynomial of piece i."""
    edge, coefficient = table
    u = (h - edge[i]) / (edge[i + 1] - edge[i])
    value = coefficient[i, _DEGREE]
    for j in range(_DEGREE - 1, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@jit
def ray_at(table, h_c, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """The `Ray` that leaves a camera; ``lift`` without cancellation."""
    n_c = refractivity(table, piece(table.edge, h_c), h_c)
    lift = (1.0 + n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)
    k = (1.0 + n_c) * (r_e + h_c) - lift
    return Ray(h_c, sin_c, cos_c, r_e, n_c, lift, k)


@jit
def excess(table, ray, i, h):  # type: ignore[no-untyped-def]
    """n r - k at height h in piece i, without cancellation."""
    n = refractivity(table, i, h)
    return (ray.r_e + h) * (n - ray.n_c) + (1.0 + ray.n_c) * (h - ray.h_c) + ray.lift


@jit
def _slope(table, i, h, r_e):  # type: ignore[no-untyped-def]
    """d(n r)/dh at height h; about 0.8 in common air, below zero in a duct."""
    edge, coefficient = table
    width = edge[i + 1] - edge[i]
    u = (h - edge[i]) / width
    gradient = 7.0 * coefficient[i, _DEGREE]
    for j in range(_DEGREE - 1, 0, -1):
        gradient = gradient * u + j * coefficient[i, j]
    return 1.0 + refractivity(table, i, h) + (r_e + h) * (gradient / width)


@jit
def turning_height(table, ray):  # type: ignore[no-untyped-def]
    """h_90 at or below the camera, where n r = k (Gyer 1996, Eq. 16); NaN below the profile."""
    i = piece(table.edge, ray.h_c)
    high = ray.h_c
    while i >= 0:
        low = table.edge[i]
        if excess(table, ray, i, low) <= 0.0:
            for _ in range(_HALVINGS_OF_HEIGHT):
                middle = 0.5 * (low + high)
                if middle <= low or middle >= high:
                    break
                if excess(table, ray, i, middle) > 0.0:
                    high = middle
                else:
                    low = middle
            return high
        high = low
        i -= 1
    return math.nan


@jit
def _excess_near(table, ray, base, y):  # type: ignore[no-untyped-def]
    """n r - k at the height of ``base`` + y; y may be as small as it likes."""
    edge, coefficient = table
    i = base.piece
    width = edge[i + 1] - edge[i]
    u_0 = (base.height - edge[i]) / width
    u = u_0 + y / width
    # The divided difference of the polynomial, by Horner's scheme beside that of its value.
    value = coefficient[i, _DEGREE]
    quotient = coefficient[i, _DEGREE]
    for j in range(_DEGREE - 1, 0, -1):
        value = value * u_0 + coefficient[i, j]
        quotient = quotient * u + value
    value = value * u_0 + coefficient[i, 0]
    r = ray.r_e + base.height + y
    return base.excess + (1.0 + value) * y + r * (y / width) * quotient


@jit
def _panel(table, ray, base, span, depth):  # type: ignore[no-untyped-def]
    """Angle subtended between the two distances ``span`` from ``base``.

    With s^2 = distance + ``depth`` as the variable; NaN where the ray turns in between.
    """
    s_0 = math.sqrt(span[0] + depth)
    s_1 = math.sqrt(span[1] + depth)
    total = 0.0
    for j in range(_X8.size):
        s = s_0 + (s_1 - s_0) * _X8[j]
        y = base.sense * (s * s - depth)
        above = _excess_near(table, ray, base, y)
        if not above > 0.0:
            return math.nan
        r = ray.r_e + base.height + y
        total += _W8[j] * 2.0 * s * ray.k / (r * math.sqrt(above * (above + 2.0 * ray.k)))
    return total * (s_1 - s_0)


@jit
def _graded(table, ray, base, width):  # type: ignore[no-untyped-def]
    """Angle subtended over ``width`` from ``base``, in panels that halve towards it.

    For air in which n r hardly grows, or falls, away from its smallest value in the layer.
    """
    total = 0.0
    far = width
    for _ in range(_HALVINGS):
        near = 0.5 * far
        total += _panel(table, ray, base, (near, far), 0.0)
        far = near
    return total + _panel(table, ray, base, (0.0, far), 0.0)


@jit
def _flat_layer(table, ray, i, ends, at_0):  # type: ignore[no-untyped-def]
    """Angle subtended between two heights of piece i where n r hardly grows, or falls."""
    h_0, h_1 = ends
    at_1 = ray.lift if h_1 == ray.h_c else excess(table, ray, i, h_1)
    if not _slope(table, i, h_0, ray.r_e) < 0.0 < _slope(table, i, h_1, ray.r_e):
        half = 0.5 * (h_1 - h_0)
        lower_half = _graded(table, ray, _Base(i, h_0, at_0, 1.0), half)
        upper_half = _graded(table, ray, _Base(i, h_1, at_1, -1.0), half)
        return lower_half + upper_half
    least = h_0  # n r is smallest in between
    high = h_1
    for _ in range(_HALVINGS_OF_LAYER):
        middle = 0.5 * (least + high)
        if _slope(table, i, middle, ray.r_e) < 0.0:
            least = middle
        else:
            high = middle
    at_least = excess(table, ray, i, least)
    below = _graded(table, ray, _Base(i, least, at_least, -1.0), least - h_0)
    above = _graded(table, ray, _Base(i, least, at_least, 1.0), h_1 - least)
    return below + above


@jit
def subtended(table, ray, low, high, level_at_low):  # type: ignore[no-untyped-def]
    """Angle the ray subtends between two heights (Gyer 1996, Eq. 12), with h = turn + s^2.

    ``turn`` is where the ray would be level by each piece of the table; the substitution takes
    the singularity out of the integrand. With ``level_at_low`` that is ``low`` itself, which
    rounding would miss: 1e-13 m of depth there are 3e-5 arcsec. NaN where the ray turns in between.
    """
    edge = table.edge
    total = 0.0
    for i in range(piece(edge, low), piece(edge, high) + 1):
        h_0 = max(low, edge[i])
        h_1 = min(high, edge[i + 1])
        if h_1 <= h_0:
            continue
        at_0 = ray.lift
        if level_at_low and h_0 == low:
            at_0 = 0.0
        elif h_0 != ray.h_c:
            at_0 = excess(table, ray, i, h_0)
        slope = _slope(table, i, h_0, ray.r_e)
        if not min(slope, _slope(table, i, h_1, ray.r_e)) > _COMMON_SLOPE:
            total += _flat_layer(table, ray, i, (h_0, h_1), at_0)
            continue
        # How far below h_0 the ray would be level if piece i of the table went on.
        base = _Base(i, h_0, at_0, 1.0)
        depth = 0.0
        if at_0 > 0.0:
            depth = at_0 / slope
            # Farther down the integrand is smooth whatever the substitution; nearer, digits end.
            if _LEVEL_M < depth < 0.5 * (edge[i + 1] - edge[i]):
                for _ in range(_DEPTH_STEPS):
                    depth += _excess_near(table, ray, base, -depth) / slope
            depth = max(depth, 0.0)
        total += _panel(table, ray, base, (0.0, h_1 - h_0), depth)
    return total


@jit
def subtended_through_turn(table, ray):  # type: ignore[no-untyped-def]
    """Angle from the camera down to P_90 and up to the camera's height again; NaN below land."""
    i = piece(table.edge, ray.h_c)
    if i > 0 and ray.h_c <= table.edge[i]:
        i -= 1
    slope = _slope(table, i, ray.h_c, ray.r_e)
    if slope > 0.0 and ray.lift < _LEVEL_M * slope:
        return 2.0 * (1.0 + ray.n_c) * ray.sin_c * ray.cos_c / slope
    turn = turning_height(table, ray)
    if not turn >= LOWEST_TERRAIN_M:
        return math.nan
    return 2.0 * subtended(table, ray, turn, ray.h_c, True)


@jit
def chord2(ray, theta, h):  # type: ignore[no-untyped-def]
    """Square of the straight distance to a point at height h that the ray sees theta away."""
    drop = ray.h_c - h
    half = math.sin(0.5 * theta)
    return drop * drop + 4.0 * (ray.r_e + ray.h_c) * (ray.r_e + h) * (half * half)


@jit
def angle_to(ray, theta, h_g):  # type: ignore[no-untyped-def]
    """R_c of the point at height h_g where the ray has subtended theta (Gyer 1996, Eq. 11)."""
    across = math.sin(theta)
    half = math.sin(0.5 * theta)
    along = (ray.h_c - h_g) / (ray.r_e + h_g) + 2.0 * (half * half)
    aside = ray.sin_c * along - ray.cos_c * across
    ahead = ray.cos_c * along + ray.sin_c * across
    return math.atan2(aside, ahead)


@jit
def crosses_once(table, ray, h_g):  # type: ignore[no-untyped-def]
    """Whether a ray meets a height once only, or is so steep that this needs no further test."""
    h_c = ray.h_c
    if not (h_g < h_c or (h_g == h_c and ray.cos_c > _LEVEL_COSINE)):
        return True
    # Whether the ray turns above the ground, and so meets heights below h_c twice. The straight
    # line's lowest point lies deeper than the ray's, by less than a fifth in any air in which n
    # falls with height; a line that goes far below the floor needs no further test.
    floor = max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))
    depth = h_c - floor + _DEPTH_TO_SPARE_M
    return (ray.r_e + h_c) * ray.cos_c * ray.cos_c > 2.0 * (1.0 + ray.sin_c) * depth


@jit
def crossing_meant(table, ray, angle, h_g, distance):  # type: ignore[no-untyped-def]
    """R_c [rad] and status of a ray to h_g, of which ``angle`` is R_c at the near crossing.

    A ray that turns above the ground meets a height twice. ``distance`` is the slant range [m] that
    decides which crossing is meant; NaN where unknown: the near one, status `BEYOND_GRAZING`.
    """
    h_c = ray.h_c
    if crosses_once(table, ray, h_g):
        return angle, OK
    floor = max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))
    if not excess(table, ray, piece(table.edge, floor), floor) < 0.0:
        return angle, OK
    if not distance > 0.0:
        return angle, BEYOND_GRAZING
    # The crossing whose slant range is nearer to the one that was given.
    theta = subtended(table, ray, h_g, h_c, False)
    around = subtended_through_turn(table, ray)
    far = math.sqrt(chord2(ray, around - theta, h_g))
    near = math.sqrt(chord2(ray, theta, h_g))
    if abs(far - distance) < abs(near - distance):
        return angle_to(ray, around - theta, h_g), FAR_BRANCH
    return angle, OK


@jit
def bend_by_subtended(table, ray, h_g):  # type: ignore[no-untyped-def]
    """R_c from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing."""
    h_c = ray.h_c
    if h_g > h_c and ray.cos_c > 0.0:  # down through P_90 and up again
        around = subtended_through_turn(table, ray)
        theta = around + subtended(table, ray, h_c, h_g, False)
    else:
        low = min(h_c, h_g)
        high = max(h_c, h_g)
        if not excess(table, ray, piece(table.edge, low), low) >= 0.0:
            return math.nan
        theta = subtended(table, ray, low, high, False)
    return angle_to(ray, theta, h_g)


@entry
def bend_grazing_rays(table, rays, which, angle, status):  # type: ignore[no-untyped-def]
    """Fill ``angle`` [rad] and ``status`` for rays that `bend_rays` has left."""
    for i in which:
        h_g = rays.h_g[i]
        ray = ray_at(table, rays.h_c[i], rays.sin_c[i], rays.cos_c[i], rays.r_e[i])
        bent = angle[i]
        if math.isnan(bent):
            bent = bend_by_subtended(table, ray, h_g)
        angle[i] = math.nan
        status[i] = MISSES_GROUND
        if not math.isnan(bent):
            meant, code = crossing_meant(table, ray, bent, h_g, rays.distance[i])
            angle[i] = meant
            status[i] = code
