"""Rays near grazing, compiled: the angle a ray subtends at the earth's centre, and R_c from it.

Symbols are those of Gyer 1996: r = r_e + h, k = n_c r_c sin zeta_c (Eq. 1), N = n - 1. Between two
heights a ray subtends at the earth's centre the angle

    theta = integral of k dh / (r sqrt(n^2 r^2 - k^2))   (Eq. 12)
          = integral of k dh / (r sqrt(E (E + 2 k))),   E = n r - k.

E, the excess [m], is zero where the ray is level: at P_90, its lowest point, at the height h_90.
The ray does not reach heights where E would be negative: it turns before. Computed as
r (N - N_c) + n_c (h - h_c) + lift, with lift = n_c r_c (1 - sin zeta_c), E loses no digits. The
substitution h = h_90 + s^2 takes the singularity at h_90 out of the integrand.

A ray is symmetric about P_90: on its way up it passes each height as it did on its way down.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, MISSES_GROUND, OK
from unbend.units import Array

# Within this height above its lowest point [m] a ray follows the closed form for air in which n r
# grows evenly, to 1e-9 arcsec; the integral does not: n - n_c has lost its digits.
_LEVEL_M = 1e-4

# Where d(n r)/dh is less than this the ray bends nearly as much as the earth, or more, and may be
# level at the upper end of a layer, or within it. In common air it is about 0.8.
_COMMON_SLOPE = 0.2
_HALVINGS = 44  # of the panels of such a layer: the narrowest is 6e-14 of it

LOWEST_TERRAIN_M = -500.0
"""No dry land is lower. A ray with a deeper lowest point meets the ground before that."""

_HALVINGS_OF_HEIGHT = 80  # at most, in the search for the height of the lowest point
_HALVINGS_OF_LAYER = 60  # in the search for the smallest n r in a layer
_DEPTH_STEPS = 5  # of the iteration for the depth of the level point below a layer
_DEGREE = 7  # of the polynomials of the table

# Up to this cosine of its nadir angle a ray leaves the camera level: it crosses the camera's height
# once, at the camera.
_LEVEL_COSINE = 1e-9

_SPARE_DEPTH_M = 100.0  # below the lowest land, in the test by the straight line's lowest point

UPWARDS = 1.0
DOWNWARDS = -1.0


def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss and Legendre for the interval from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


_X8, _W8 = gauss_legendre(8)


class Ray(NamedTuple):
    """A ray at its camera, and what stays the same along it."""

    h_c: float  # height of the camera [m]
    sin_c: float  # of the apparent nadir angle zeta_c
    cos_c: float
    r_e: float  # radius of the sphere [m]
    big_n_c: float  # N_c, the refractivity at the camera
    lift: float  # n_c r_c (1 - sin zeta_c) [m], the excess at the camera
    k: float  # n_c r_c sin zeta_c [m]


class _Origin(NamedTuple):
    """A height within one piece of the table, from which distances in height are counted."""

    piece: int  # number of the piece
    height: float  # [m]
    excess: float  # n r - k at this height [m]
    sense: float  # of the distances: `UPWARDS` or `DOWNWARDS`


@jit
def piece_at(edge, h):  # type: ignore[no-untyped-def]
    """Number of the piece of the table that contains height h, by bisection in ``edge``.

    At an edge it is the piece above; outside the table the lowest or the highest piece.
    """
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
    """N at height h [m] by the polynomial of piece i of an `IndexTable`."""
    edge, coefficient = table
    u = (h - edge[i]) / (edge[i + 1] - edge[i])
    value = coefficient[i, _DEGREE]
    for j in range(_DEGREE - 1, -1, -1):
        value = value * u + coefficient[i, j]
    return value


@jit
def ray_at(table, h_c, sin_c, cos_c, r_e):  # type: ignore[no-untyped-def]
    """The `Ray` that leaves a camera at the height h_c [m]; its arguments are fields of `Ray`.

    The lift is n_c r_c cos^2 zeta_c / (1 + sin zeta_c), which loses no digits for level rays.
    """
    big_n_c = refractivity(table, piece_at(table.edge, h_c), h_c)
    lift = (1.0 + big_n_c) * (r_e + h_c) * cos_c * cos_c / (1.0 + sin_c)
    k = (1.0 + big_n_c) * (r_e + h_c) - lift
    return Ray(h_c=h_c, sin_c=sin_c, cos_c=cos_c, r_e=r_e, big_n_c=big_n_c, lift=lift, k=k)


@jit
def excess(table, ray, i, h):  # type: ignore[no-untyped-def]
    """The excess n r - k [m] of a `Ray` at height h [m] in piece i, without cancellation."""
    n = refractivity(table, i, h)
    return (ray.r_e + h) * (n - ray.big_n_c) + (1.0 + ray.big_n_c) * (h - ray.h_c) + ray.lift


@jit
def _n_r_slope(table, i, h, r_e):  # type: ignore[no-untyped-def]
    """d(n r)/dh at height h in piece i; about 0.8 in common air, below zero in a duct."""
    edge, coefficient = table
    width = edge[i + 1] - edge[i]
    u = (h - edge[i]) / width
    gradient = _DEGREE * coefficient[i, _DEGREE]  # dN/du
    for j in range(_DEGREE - 1, 0, -1):
        gradient = gradient * u + j * coefficient[i, j]
    return 1.0 + refractivity(table, i, h) + (r_e + h) * (gradient / width)


@jit
def _level_between(table, ray, i, low, high):  # type: ignore[no-untyped-def]
    """Height [m] between two heights in piece i where the ray is level, n r = k, by bisection.

    The excess n r - k is above zero at ``high``, and zero or below at ``low``.
    """
    for _ in range(_HALVINGS_OF_HEIGHT):
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:  # no floating-point number is between them
            break
        if excess(table, ray, i, middle) > 0.0:
            high = middle
        else:
            low = middle
    return high


@jit
def turning_height(table, ray):  # type: ignore[no-untyped-def]
    """h_90 [m], the height up to the camera's where a ray is level, n r = k (Gyer 1996, Eq. 16).

    The pieces of the table are searched from the camera down. NaN where the ray leaves the profile
    before it is level.
    """
    i = piece_at(table.edge, ray.h_c)
    high = ray.h_c
    while i >= 0:
        low = table.edge[i]
        if excess(table, ray, i, low) <= 0.0:
            return _level_between(table, ray, i, low, high)
        high = low
        i -= 1
    return math.nan


@jit
def _excess_near(table, ray, origin, y):  # type: ignore[no-untyped-def]
    """n r - k [m] at the height of an `_Origin` + y [m], without cancellation however small y is.

    With N_0 and u_0 the origin's N and share of the piece, n r - k grows over y by

        (1 + N_0) y + r (N - N_0),   N - N_0 = (y / width) (N - N_0) / (u - u_0),

    and Horner's scheme gives the quotient (N - N_0) / (u - u_0) of the polynomial without a
    difference, in the same loop as N_0.
    """
    edge, coefficient = table
    i = origin.piece
    width = edge[i + 1] - edge[i]
    u_0 = (origin.height - edge[i]) / width
    u = u_0 + y / width
    n_0 = coefficient[i, _DEGREE]
    quotient = coefficient[i, _DEGREE]
    for j in range(_DEGREE - 1, 0, -1):
        n_0 = n_0 * u_0 + coefficient[i, j]
        quotient = quotient * u + n_0
    n_0 = n_0 * u_0 + coefficient[i, 0]
    r = ray.r_e + origin.height + y
    return origin.excess + (1.0 + n_0) * y + r * (y / width) * quotient


@jit
def _subtended_in_panel(table, ray, origin, ends, depth):  # type: ignore[no-untyped-def]
    """Angle [rad] that the ray subtends between two distances in height, ``ends`` [m].

    The distances count from an `_Origin`, in its sense. Eight nodes of Gauss and Legendre in s,
    with s^2 = distance + ``depth``. ``depth`` [m] is the distance from the origin, against its
    sense, at which the ray would be level, or zero. NaN where the ray turns between the ends.
    """
    s_0 = math.sqrt(ends[0] + depth)
    s_1 = math.sqrt(ends[1] + depth)
    total = 0.0
    for j in range(_X8.size):
        s = s_0 + (s_1 - s_0) * _X8[j]
        y = origin.sense * (s * s - depth)
        excess_at_node = _excess_near(table, ray, origin, y)
        if not excess_at_node > 0.0:
            return math.nan
        r = ray.r_e + origin.height + y
        root = math.sqrt(excess_at_node * (excess_at_node + 2.0 * ray.k))
        total += _W8[j] * 2.0 * s * ray.k / (r * root)  # dh is 2 s ds
    return total * (s_1 - s_0)


@jit
def _subtended_from(table, ray, origin, width):  # type: ignore[no-untyped-def]
    """Angle [rad] that the ray subtends over ``width`` [m] of height from an `_Origin`, in panels.

    Beginning at the far end, each of `_HALVINGS` panels takes half of the remaining width, and a
    last one the remainder. The narrow panels at the origin serve the steep integrand near a height
    where the ray is, or nearly is, level.
    """
    total = 0.0
    far = width
    for _ in range(_HALVINGS):
        near = 0.5 * far
        total += _subtended_in_panel(table, ray, origin, (near, far), 0.0)
        far = near
    return total + _subtended_in_panel(table, ray, origin, (0.0, far), 0.0)


@jit
def _height_of_smallest_n_r(table, i, h_0, h_1, r_e):  # type: ignore[no-untyped-def]
    """Height [m] between two heights in piece i where n r is smallest, by bisection.

    n r falls with height at ``h_0`` and grows at ``h_1``.
    """
    falling = h_0
    growing = h_1
    for _ in range(_HALVINGS_OF_LAYER):
        middle = 0.5 * (falling + growing)
        if _n_r_slope(table, i, middle, r_e) < 0.0:
            falling = middle
        else:
            growing = middle
    return falling


@jit
def _subtended_in_flat_layer(table, ray, i, ends, excess_0):  # type: ignore[no-untyped-def]
    """Angle [rad] subtended between two heights of piece i where n r hardly grows, or falls.

    ``ends`` are the lower and the upper height [m], ``excess_0`` is n r - k [m] at the lower end.
    The layer is cut in two, so that the narrow panels are where the ray may be level: at the
    smallest n r between the ends, or else at both ends.
    """
    h_0, h_1 = ends
    excess_1 = ray.lift if h_1 == ray.h_c else excess(table, ray, i, h_1)
    if _n_r_slope(table, i, h_0, ray.r_e) < 0.0 < _n_r_slope(table, i, h_1, ray.r_e):
        h_least = _height_of_smallest_n_r(table, i, h_0, h_1, ray.r_e)
        least_excess = excess(table, ray, i, h_least)
        down = _Origin(i, h_least, least_excess, DOWNWARDS)
        up = _Origin(i, h_least, least_excess, UPWARDS)
        theta_below = _subtended_from(table, ray, down, h_least - h_0)
        theta_above = _subtended_from(table, ray, up, h_1 - h_least)
        return theta_below + theta_above
    half_width = 0.5 * (h_1 - h_0)
    up = _Origin(i, h_0, excess_0, UPWARDS)
    down = _Origin(i, h_1, excess_1, DOWNWARDS)
    theta_lower_half = _subtended_from(table, ray, up, half_width)
    theta_upper_half = _subtended_from(table, ray, down, half_width)
    return theta_lower_half + theta_upper_half


@jit
def _depth_of_level(table, ray, origin, slope):  # type: ignore[no-untyped-def]
    """How far [m] below an `_Origin` the ray would be level if its piece of the table went on.

    ``slope`` is d(n r)/dh at the origin. Zero if the ray is level at the origin.
    """
    if not origin.excess > 0.0:
        return 0.0
    edge = table.edge
    depth = origin.excess / slope  # if n r went on with this slope
    # A large depth needs no better value, because the integrand is smooth with any substitution;
    # nor does a tiny one, because the excess has no more digits.
    if _LEVEL_M < depth < 0.5 * (edge[origin.piece + 1] - edge[origin.piece]):
        for _ in range(_DEPTH_STEPS):
            depth += _excess_near(table, ray, origin, -depth) / slope
    return max(depth, 0.0)


@jit
def _subtended_in_layer(table, ray, i, ends, excess_0):  # type: ignore[no-untyped-def]
    """Angle [rad] subtended between two heights of piece i.

    ``ends`` are the lower and the upper height [m], ``excess_0`` is n r - k [m] at the lower end.
    The integral is over s with h = h_90 + s^2, where h_90 is the height at which the ray would be
    level if the piece of the table went on.
    """
    h_0, h_1 = ends
    slope = _n_r_slope(table, i, h_0, ray.r_e)
    rises_as_in_common_air = min(slope, _n_r_slope(table, i, h_1, ray.r_e)) > _COMMON_SLOPE
    if not rises_as_in_common_air:
        return _subtended_in_flat_layer(table, ray, i, ends, excess_0)
    origin = _Origin(i, h_0, excess_0, UPWARDS)
    depth = _depth_of_level(table, ray, origin, slope)
    return _subtended_in_panel(table, ray, origin, (0.0, h_1 - h_0), depth)


@jit
def subtended(table, ray, low, high, is_level_at_low):  # type: ignore[no-untyped-def]
    """Angle theta [rad] that a ray subtends between the heights low and high (Gyer 1996, Eq. 12).

    ``is_level_at_low`` states that the ray is level at ``low``, so that the excess there is zero;
    an excess computed from ``low``, which is rounded to 1e-13 m, would change theta by 3e-5 arcsec.
    NaN where the ray turns in between.
    """
    edge = table.edge
    total = 0.0
    for i in range(piece_at(edge, low), piece_at(edge, high) + 1):
        h_0 = max(low, edge[i])
        h_1 = min(high, edge[i + 1])
        if h_1 <= h_0:
            continue
        if is_level_at_low and h_0 == low:
            excess_0 = 0.0
        elif h_0 == ray.h_c:
            excess_0 = ray.lift  # the excess at the camera, without a rounding error
        else:
            excess_0 = excess(table, ray, i, h_0)
        total += _subtended_in_layer(table, ray, i, (h_0, h_1), excess_0)
    return total


@jit
def subtended_to_rise(table, ray):  # type: ignore[no-untyped-def]
    """Angle [rad] from the camera through P_90 to where the ray rises to the camera's height.

    Twice the angle down to P_90 (Gyer 1996, Eq. 15). NaN where P_90 is below all land.
    """
    # The ray goes down: at an edge of the table the piece below counts.
    i = piece_at(table.edge, ray.h_c)
    if i > 0 and ray.h_c <= table.edge[i]:
        i -= 1
    slope = _n_r_slope(table, i, ray.h_c, ray.r_e)
    # lift / slope is the depth of P_90 below the camera. Over less than `_LEVEL_M` n r grows
    # evenly, and Eq. 12 has a closed form.
    if slope > 0.0 and ray.lift < _LEVEL_M * slope:
        return 2.0 * (1.0 + ray.big_n_c) * ray.sin_c * ray.cos_c / slope
    h_90 = turning_height(table, ray)
    if not h_90 >= LOWEST_TERRAIN_M:
        return math.nan
    return 2.0 * subtended(table, ray, h_90, ray.h_c, is_level_at_low=True)


@jit
def chord2(ray, theta, h):  # type: ignore[no-untyped-def]
    """Square of the chord [m2] from the camera to the point at height h, after the angle theta.

    ``theta`` [rad] is the angle that the ray has subtended there:
    (h_c - h)^2 + 4 r_c r sin^2(theta / 2), the law of cosines without cancellation.
    """
    drop = ray.h_c - h
    sin_half = math.sin(0.5 * theta)
    return drop * drop + 4.0 * (ray.r_e + ray.h_c) * (ray.r_e + h) * (sin_half * sin_half)


@jit
def angle_to(ray, theta, h_g):  # type: ignore[no-untyped-def]
    """R_c [rad] of the point at height h_g after the subtended angle theta (Gyer 1996, Eq. 11).

    Eq. 11's r_c / r_g - cos(theta) is (h_c - h_g) / r_g + 2 sin^2(theta / 2), without cancellation.
    """
    # The target from the camera, level and down, in units of r_g.
    level = math.sin(theta)
    sin_half = math.sin(0.5 * theta)
    down = (ray.h_c - h_g) / (ray.r_e + h_g) + 2.0 * (sin_half * sin_half)
    # The target along the apparent direction, and square to it (positive towards the nadir).
    along = ray.cos_c * down + ray.sin_c * level
    towards_nadir = ray.sin_c * down - ray.cos_c * level
    return math.atan2(towards_nadir, along)


@jit
def _lowest_ground(table, h_g):  # type: ignore[no-untyped-def]
    """Height [m] of the lowest land, or of a target below it, but not below the profile."""
    return max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))


@jit
def crosses_once(table, ray, h_g):  # type: ignore[no-untyped-def]
    """Whether it is certain that a ray meets the height h_g once only; False where it may do twice.

    A ray that goes down meets a height below the camera twice, going down and rising again, if it
    turns above the lowest ground. The straight line in its direction is level
    r_c (1 - sin zeta_c) = r_c cos^2 zeta_c / (1 + sin zeta_c) below the camera. The ray is level
    deeper, at that depth over the mean of d(n r)/dh on the way, 0.8 in common air. So the ray needs
    no further test if the line is level twice as deep as the lowest ground: to turn above that
    ground, n would have to grow with height by 157e-6 a kilometre all the way.
    """
    h_c = ray.h_c
    # Every ray that goes down and rises again meets the camera's height a second time.
    may_cross_twice = h_g < h_c or (h_g == h_c and ray.cos_c > _LEVEL_COSINE)
    if not may_cross_twice:
        return True
    depth = h_c - _lowest_ground(table, h_g) + _SPARE_DEPTH_M
    return (ray.r_e + h_c) * ray.cos_c * ray.cos_c > 2.0 * (1.0 + ray.sin_c) * depth


@jit
def _choose_crossing(table, ray, angle, h_g, distance):  # type: ignore[no-untyped-def]
    """R_c [rad] and status of a ray at the crossing of the height h_g that the slant range fits.

    ``angle`` is R_c at the near crossing. A ray with its lowest point below h_g but above the
    lowest ground meets h_g twice, going down and rising again. Chosen is the crossing with the
    slant range nearer to ``distance`` [m]: `OK` for the near one, `FAR_BRANCH` for the far one. If
    ``distance`` is NaN, the near one is returned with the status `BEYOND_GRAZING`.
    """
    if crosses_once(table, ray, h_g):
        return angle, OK
    # The ray does not reach heights with a negative excess: it turns before.
    h_lowest = _lowest_ground(table, h_g)
    turns_above_ground = excess(table, ray, piece_at(table.edge, h_lowest), h_lowest) < 0.0
    if not turns_above_ground:
        return angle, OK
    if not distance > 0.0:
        return angle, BEYOND_GRAZING
    # The ray is symmetric about its lowest point P_90: it rises from h_g to h_c over the same angle
    # over which it came down from h_c to h_g.
    near_theta = subtended(table, ray, h_g, ray.h_c, is_level_at_low=False)
    theta_back_to_h_c = subtended_to_rise(table, ray)  # from h_c through P_90 up to h_c again
    far_theta = theta_back_to_h_c - near_theta
    near = math.sqrt(chord2(ray, near_theta, h_g))
    far = math.sqrt(chord2(ray, far_theta, h_g))
    if abs(far - distance) < abs(near - distance):
        return angle_to(ray, far_theta, h_g), FAR_BRANCH
    return angle, OK


@jit
def bend_by_subtended(table, ray, h_g):  # type: ignore[no-untyped-def]
    """R_c [rad] from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing.

    Where the ray crosses h_g twice, it is that of the near crossing. NaN where the ray does not
    reach h_g.
    """
    h_c = ray.h_c
    if h_g > h_c and ray.cos_c > 0.0:
        # From h_c down through P_90 and up to h_c again, then on to h_g.
        theta_back_to_h_c = subtended_to_rise(table, ray)
        theta = theta_back_to_h_c + subtended(table, ray, h_c, h_g, is_level_at_low=False)
    else:
        low = min(h_c, h_g)
        high = max(h_c, h_g)
        if not excess(table, ray, piece_at(table.edge, low), low) >= 0.0:
            return math.nan  # the ray turns above this height
        theta = subtended(table, ray, low, high, is_level_at_low=False)
    return angle_to(ray, theta, h_g)


@entry
def bend_grazing_rays(table, rays, which, angle, status):  # type: ignore[no-untyped-def]
    """Fill R_c, ``angle`` [rad], and ``status`` of the rays that `bend_rays` has not decided.

    ``rays`` are `RayColumns`, ``which`` the row numbers of those rays. An ``angle`` that is not NaN
    at the call is R_c of the near crossing, by the difference form.
    """
    for i in which:
        h_g = rays.h_g[i]
        ray = ray_at(table, rays.h_c[i], rays.sin_c[i], rays.cos_c[i], rays.r_e[i])
        near_angle = angle[i]
        if math.isnan(near_angle):
            near_angle = bend_by_subtended(table, ray, h_g)
        angle[i] = math.nan
        status[i] = MISSES_GROUND
        if not math.isnan(near_angle):
            angle[i], status[i] = _choose_crossing(table, ray, near_angle, h_g, rays.distance[i])
