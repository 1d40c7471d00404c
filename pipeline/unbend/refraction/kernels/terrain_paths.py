"""The ways of curved rays over the grid of a terrain, compiled.

The point of a ray at the straight distance t from the camera is seen from there at the nadir angle
zeta_c - R_c(t). R_c / t is Newton's polynomial through some knots. Row and column of the grid are
polynomials in the arc along the sphere from the camera.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import CHART_DEGREE
from unbend.refraction.kernels.jit import entry, jit


class Path(NamedTuple):
    """A ray, and the way it takes over the grid."""

    sin_c: float  # of the apparent nadir angle at the camera
    cos_c: float
    h_c: float  # height of the camera [m]
    r_e: float  # radius of the sphere [m]
    r_c: float  # r_e + h_c
    knot: np.ndarray  # (k,) straight distances from the camera [m]
    bend: np.ndarray  # (k,) divided differences of R_c / distance at the knots
    # Coefficients of row and column of the grid by powers of the arc from the camera, from 0 on.
    row: np.ndarray
    column: np.ndarray


class RayPlace(NamedTuple):
    """Where a ray is at one distance from the camera."""

    row: float  # of the grid
    column: float
    height: float  # [m]
    arc: float  # along the sphere from the camera [m]
    sine: float  # of the angle between the ray's own direction there and the camera's nadir
    cosine: float


class Velocity(NamedTuple):
    """Changes of row, column and height of a ray per metre of its way."""

    row: float  # of the row of the grid
    column: float
    rise: float  # of the height [m/m]


@jit
def _angle_at(path, t):  # type: ignore[no-untyped-def]
    """R_c [rad] of the point at the straight distance t [m] on a `Path`, and t dR_c/dt [rad]."""
    knot = path.knot
    bend = path.bend
    # Newton's polynomial for R_c / t, and its derivative.
    angle_by_t = bend[-1]
    slope = 0.0
    for k in range(bend.size - 2, -1, -1):
        slope = angle_by_t + (t - knot[k]) * slope
        angle_by_t = bend[k] + (t - knot[k]) * angle_by_t
    return angle_by_t * t, (angle_by_t + t * slope) * t


@jit
def place_at(path, t):  # type: ignore[no-untyped-def]
    """The `RayPlace` on a `Path` at the straight distance t [m] from the camera."""
    angle, turn = _angle_at(path, t)
    # The direction of the straight line there, at the nadir angle zeta_c - R_c. R_c is below 0.01.
    cos_angle = 1.0 - 0.5 * angle * angle
    sine = path.sin_c * cos_angle - path.cos_c * angle
    cosine = path.cos_c * cos_angle + path.sin_c * angle
    # The end of that line, in the vertical plane of the ray from the earth's centre.
    across = t * sine
    down = path.r_c - t * cosine
    r = math.sqrt(across * across + down * down)
    height = path.h_c - t * cosine + across * across / (r + down)
    tangent = across / down  # of the angle at the earth's centre, which follows by a series
    square = tangent * tangent
    arc = path.r_e * tangent * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square / 7.0)))
    row = path.row[-1]
    column = path.column[-1]
    for k in range(path.row.size - 2, -1, -1):
        row = row * arc + path.row[k]
        column = column * arc + path.column[k]
    # The ray's own direction is that of the line, turned by t dR_c/dt.
    return RayPlace(
        row=row,
        column=column,
        height=height,
        arc=arc,
        sine=sine - cosine * turn,
        cosine=cosine + sine * turn,
    )


@jit
def velocity_at(path, place):  # type: ignore[no-untyped-def]
    """The `Velocity` of a ray at a `RayPlace` on its `Path`.

    The ray's nadir angle at the place is the angle between its direction there and the camera's
    nadir, plus theta, the angle at the earth's centre. Sine and cosine of that sum are taken to
    first order in theta.
    """
    arc = place.arc
    theta = arc / path.r_e
    arc_per_metre = (place.sine + theta * place.cosine) / (1.0 + place.height / path.r_e)
    row = 0.0
    column = 0.0
    for k in range(path.row.size - 1, 0, -1):
        row = row * arc + k * path.row[k]
        column = column * arc + k * path.column[k]
    rise = theta * place.sine - place.cosine
    return Velocity(row * arc_per_metre, column * arc_per_metre, rise)


@jit
def fill_path(rays, i, row, column, powers):  # type: ignore[no-untyped-def]
    """Fill ``row`` and ``column`` (`CHART_DEGREE` + 1,), polynomials of ray i in the arc.

    They follow from the ray's chart, polynomials in east and north of its station. Along the ray
    east and north are the arc times the components of its azimuth, so that all terms of one degree
    make one power of the arc. ``powers`` (2, `CHART_DEGREE` + 1) is a work array for powers of east
    and of north, with 1 in its first column.
    """
    easts = powers[0]
    norths = powers[1]
    chart = rays.chart[i]
    east = rays.east[i] / rays.reach[chart]
    north = rays.north[i] / rays.reach[chart]
    for power in range(CHART_DEGREE):
        easts[power + 1] = east * easts[power]
        norths[power + 1] = north * norths[power]
    row[:] = 0.0
    column[:] = 0.0
    term = 0
    for degree in range(CHART_DEGREE + 1):
        for power in range(degree + 1):
            monomial = easts[degree - power] * norths[power]
            row[degree] += rays.charts[chart, 0, term] * monomial
            column[degree] += rays.charts[chart, 1, term] * monomial
            term += 1


@entry
def divide_differences(knot, value):  # type: ignore[no-untyped-def]
    """Replace each row of ``value`` (n, k), in place, by Newton's divided differences.

    ``knot`` (n, k) are the places of the values.
    """
    for i in range(knot.shape[0]):
        for order in range(1, knot.shape[1]):
            for k in range(knot.shape[1] - 1, order - 1, -1):
                value[i, k] = (value[i, k] - value[i, k - 1]) / (knot[i, k] - knot[i, k - order])
