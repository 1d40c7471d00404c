"""The ways of curved rays over the grid of a terrain, compiled.

A ray is a straight line from the camera at each distance t, turned by R_c(t); R_c / t is Newton's
polynomial through some knots. Row and column of the grid are polynomials in the arc along the
sphere from the camera.
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
    row: (
        np.ndarray
    )  # row of the grid as a polynomial in the arc from the camera, lowest power first
    column: np.ndarray


class RayPlace(NamedTuple):
    """Where a ray is at one distance from the camera."""

    row: float  # of the grid
    column: float
    height: float  # [m]
    arc: float  # along the sphere from the camera [m]
    sine: float  # of the nadir angle, at the camera, of the ray's own direction there
    cosine: float


class Velocity(NamedTuple):
    """Changes per metre of the way."""

    row: float
    column: float
    rise: float  # of the height [m/m]


@jit
def place_at(path, t):  # type: ignore[no-untyped-def]
    """The `RayPlace` of a ray at the straight distance t [m] from the camera.

    The end of the straight line at the nadir angle zeta_c - R_c(t). Where it moves on, the ray's
    own direction is that of the line, turned by t dR_c/dt.
    """
    knot = path.knot
    bend = path.bend
    r_c_by_t = bend[-1]  # R_c / t by Newton's polynomial, and its derivative
    slope = 0.0
    for k in range(bend.size - 2, -1, -1):
        slope = r_c_by_t + (t - knot[k]) * slope
        r_c_by_t = bend[k] + (t - knot[k]) * r_c_by_t
    turned = (r_c_by_t + t * slope) * t
    angle = r_c_by_t * t
    cos_angle = 1.0 - 0.5 * angle * angle
    sine = path.sin_c * cos_angle - path.cos_c * angle
    cosine = path.cos_c * cos_angle + path.sin_c * angle
    across = t * sine
    down = path.r_c - t * cosine
    r = math.sqrt(across * across + down * down)
    height = path.h_c - t * cosine + across * across / (r + down)
    tangent = across / down  # of the angle at the earth's centre
    square = tangent * tangent
    arc = path.r_e * tangent * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square / 7.0)))
    row = path.row[-1]
    column = path.column[-1]
    for k in range(path.row.size - 2, -1, -1):
        row = row * arc + path.row[k]
        column = column * arc + path.column[k]
    return RayPlace(
        row=row,
        column=column,
        height=height,
        arc=arc,
        sine=sine - cosine * turned,
        cosine=cosine + sine * turned,
    )


@jit
def velocity_at(path, at):  # type: ignore[no-untyped-def]
    """The `Velocity` of a ray at the `RayPlace` ``at``."""
    arc = at.arc
    theta = arc / path.r_e  # at the earth's centre
    arc_per_metre = (at.sine + theta * at.cosine) / (1.0 + at.height / path.r_e)
    row = 0.0
    column = 0.0
    for k in range(path.row.size - 1, 0, -1):
        row = row * arc + k * path.row[k]
        column = column * arc + k * path.column[k]
    rise = theta * at.sine - at.cosine
    return Velocity(row * arc_per_metre, column * arc_per_metre, rise)


@jit
def fill_path(rays, i, row, column, powers):  # type: ignore[no-untyped-def]
    """Fill row and column of ray i as polynomials in the arc, from those of its chart.

    ``powers`` (2, `CHART_DEGREE` + 1) is room for powers of east and of north; the first are 1.
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
            share = easts[degree - power] * norths[power]
            row[degree] += rays.charts[chart, 0, term] * share
            column[degree] += rays.charts[chart, 1, term] * share
            term += 1


@entry
def divide_differences(knot, value):  # type: ignore[no-untyped-def]
    """Newton's divided differences of ``value`` (n, k) at ``knot`` (n, k), in its place."""
    for i in range(knot.shape[0]):
        for order in range(1, knot.shape[1]):
            for k in range(knot.shape[1] - 1, order - 1, -1):
                value[i, k] = (value[i, k] - value[i, k - 1]) / (knot[i, k] - knot[i, k - order])
