"""Columns in which Python hands work to compiled functions, which take no keywords.

Importing this compiles nothing and needs no numba. All arrays of one tuple have one length, unless
stated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of a matrix of rays (RAY_ROWS, n): ideal image coordinates; change of direction in the window
# (camera frame); direction outside (east, north, up); sine and cosine of the nadir angle, radius of
# the sphere [m], height of the camera [m].
U, V, THROUGH, APPARENT, SIN, COS, RADIUS, H_C = 0, 1, 2, 5, 8, 9, 10, 11
RAY_ROWS = 12

# Columns of a matrix of stations (s, STATION_COLUMNS): refractivity N outside and N'/n [1/m] there;
# node below it among the cameras of the table, share of the way to the next, share of the way from
# the lowest to the highest camera; variance of tilt, by what that of yaw exceeds it [rad2], east
# and north of the yaw axis; sigma of height [m]; number of its kind of window in the tables, -1
# without a plane window; N'/n less the cabin's share that follows it [1/m]; the normal of the
# window in the camera frame; what the sigmas of pressure and of temperature in the cabin do to its
# refractivity, and to the principal distance [px].
N, BEND, NODE, SHARE, SPAN, TILT2, YAW2, AXIS_E, AXIS_N, SIGMA_H = range(10)
WINDOW, WINDOW_BEND, NORMAL = 10, 11, 12
CABIN = NORMAL + 3
STATION_COLUMNS = CABIN + 4


class IndexTable(NamedTuple):
    """`RayTable`: ``edge`` (m + 1,) [m], ``coefficient`` (m, 8)."""

    edge: Array
    coefficient: Array


class FineTable(NamedTuple):
    """Intervals of at most 62.5 m, in which moments of the air are kept for many rays.

    ``edge`` (k + 1,) [m]; ``coefficient`` (k, 6) refractivity in each interval as a polynomial of
    degree 5 in the share of it, lowest power first (1e-15 of n - 1 apart from `RayTable`);
    ``hint`` the number of the interval at every `HINT_M` from the bottom.
    """

    edge: Array
    coefficient: Array
    hint: NDArray[np.intp]


HINT_M = 125.0


class RayColumns(NamedTuple):
    """Rays: heights of camera and target [m], the apparent nadir angle at the camera, the radius of
    the sphere [m], the slant range [m], NaN where unknown."""

    h_c: Array
    h_g: Array
    sin_c: Array
    cos_c: Array
    r_e: Array
    distance: Array


class CameraConstants(NamedTuple):
    """A camera [px]; ``distortion`` are the parameters of a model, whose type names the model."""

    width: float
    height: float
    fx: float
    fy: float
    cx: float
    cy: float
    largest_radius: float
    distortion: Any


class ExposureColumns(NamedTuple):
    """Exposures; ``curvature`` (s, 2) is 1/radius in the meridian and in the prime vertical,
    ``normal`` (s, 3) that of the window, ``change_px`` is added to the principal distance."""

    usable: NDArray[np.bool_]
    rotation: Array
    curvature: Array
    height: Array
    outside: Array
    cabin: Array
    normal: Array
    change_px: Array


class ObservationColumns(NamedTuple):
    """Observations: pixels, height of the target [m] with its sigma, row of the exposure."""

    x: Array
    y: Array
    h_g: Array
    sigma_h_g: Array
    exposure: NDArray[np.int64]

    def part(self, rows: slice) -> ObservationColumns:
        """Some of the rows."""
        return ObservationColumns(
            self.x[rows], self.y[rows], self.h_g[rows], self.sigma_h_g[rows], self.exposure[rows]
        )


class TracedColumns(NamedTuple):
    """Observations followed to the ground: matrix of rays, refraction angle [rad], status."""

    rays: Array
    r_c: Array
    status: NDArray[np.uint8]


class ShiftColumns(NamedTuple):
    """Shifts in the image [px] and on the ground [m], to be filled."""

    dx: Array
    dy: Array
    ground: Array


class AirTables(NamedTuple):
    """Tables of sigma_R and dR/dzeta, of c cameras, w ways and v kinds of windows.

    Parameters
    ----------
    way_first : root of the first way [m^0.5], ``way_step`` before the next.
    coarse_step, incidence_step : spacing of the factors in the root of the way and in
        1 / sqrt(cos z) at the ground, from 1.
    sigma, angle : (c, w) sigma_R / (tan(zeta) way) and R / (tan(zeta) way) in the plane [rad/m].
    factors : (f, j, k, 2) what the sphere multiplies sigma_R and dR/dzeta by, at even heights
        from the lowest camera to the highest.
    behind : (v, 2, c, w) sigma of x, and its covariance with y over sigma of y, in the plane.
    lean : (v, c) sigma of y.
    ground_m, spacing_m : lowest height [m] and spacing of ``refractivity`` (n,).

    The sigmas are NaN throughout without a covariance.
    """

    way_first: float
    way_step: float
    coarse_step: float
    incidence_step: float
    sigma: Array
    angle: Array
    factors: Array
    behind: Array
    lean: Array
    ground_m: float
    spacing_m: float
    refractivity: Array
