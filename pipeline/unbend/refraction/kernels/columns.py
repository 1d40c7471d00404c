"""Columns in which Python hands work to compiled functions, which take no keywords.

Importing this compiles nothing and needs no numba. All arrays of one tuple have one length, unless
stated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.units import Array, Integers, Mask, Rows

# Rows of a matrix of rays (RAY_ROWS, n).
IDEAL_U = 0  # ideal image coordinates: the ray is (u, v, 1) in the frame of the camera
IDEAL_V = 1
WINDOW_CHANGE = 2  # three: change of the unit vector at the window, in the frame of the camera
DIRECTION = 5  # three: unit vector of the apparent ray outside; east, north and up
NADIR_SINE = 8  # of the apparent nadir angle
NADIR_COSINE = 9
SPHERE_RADIUS = 10  # [m]
CAMERA_HEIGHT = 11  # [m]
RAY_ROWS = 12

# Columns of a matrix of stations (s, STATION_COLUMNS): what sigmas need to know of each exposure.
REFRACTIVITY = 0  # N outside
RELATIVE_GRADIENT = 1  # (dN/dh) / n outside [1/m]
TABLE_NODE = 2  # number of the node of `AirTables` below the camera, on their axis of cameras
NODE_SHARE = 3  # share of the way from that node to the next
HEIGHT_SHARE = 4  # share of the way from the lowest camera height to the highest
TILT_VARIANCE = 5  # [rad2]
YAW_EXCESS_VARIANCE = 6  # variance of yaw less that of tilt [rad2]
YAW_AXIS_EAST = 7  # of the unit vector of the yaw axis: its part to the east,
YAW_AXIS_NORTH = 8  # and to the north
SIGMA_HEIGHT = 9  # [m]
WINDOW_KIND = 10  # number of its kind of window in the tables, -1 without a plane window
WINDOW_GRADIENT = 11  # `RELATIVE_GRADIENT` less dN/dh of a cabin that follows the outside [1/m]
WINDOW_NORMAL = 12  # three: the normal of the window in the camera frame
CABIN_SIGMAS = 15  # two: change of N in the cabin by one sigma of its pressure, of its temperature
LENS_SIGMAS = 17  # two: change of the principal distance [px] by the same
STATION_COLUMNS = 19

FOR_NEXT_KERNEL = 255
"""Status of a ray that this kernel does not decide: the next one has to bend it."""

WORTH_A_TABLE = 24
"""Number of rays from one height from which on a table of moments is made: that takes as long as to
bend this many rays one by one."""


class IndexTable(NamedTuple):
    """The columns of a `RayTable`: N as a polynomial of degree 7 in each of m pieces of height.

    The variable of a polynomial is (h - lower edge) / (upper edge - lower edge).
    """

    edge: Array  # (m + 1,) heights [m]
    coefficient: Array  # (m, 8) lowest power first


class FineTable(NamedTuple):
    """N as a polynomial of degree 5 in each of k intervals of at most 62.5 m.

    The variable of a polynomial is (h - lower edge) / (upper edge - lower edge). N differs by 1e-15
    of itself from that of `IndexTable`. `kernels.moments` keeps moments of the air for these
    intervals.
    """

    edge: Array  # (k + 1,) heights [m]
    coefficient: Array  # (k, 6) lowest power first
    hint: Rows  # number of the interval at every `HINT_M` above the bottom: a search begins there


HINT_M = 125.0  # about two intervals


class RayColumns(NamedTuple):
    """Rays from cameras to the heights of their targets."""

    h_c: Array  # height of the camera [m]
    h_g: Array  # height of the target [m]
    sin_c: Array  # sine of the apparent nadir angle at the camera
    cos_c: Array
    r_e: Array  # radius of the sphere [m]
    distance: Array  # slant range [m], NaN where unknown


class CameraConstants(NamedTuple):
    """A camera. The type of ``distortion`` names the model of its lens."""

    width: float  # of the format [px]
    height: float
    fx: float  # principal distance [px]
    fy: float
    cx: float  # principal point [px]
    cy: float
    largest_radius: float  # tangent of the field angle up to which the distortion can be inverted
    distortion: Any  # parameters of one of `DISTORTION_MODELS`


class ExposureColumns(NamedTuple):
    """What rays need to know of each of s exposures."""

    usable: Mask  # False where position, attitude or the cabin's air is unknown
    rotation: Array  # (s, 3, 3) from east-north-up to the camera frame
    curvature: Array  # (s, 2) 1/radius in the meridian and in the prime vertical [1/m]
    height: Array  # [m]
    outside: Array  # N outside the window, NaN where the camera is outside the profile
    cabin: Array  # N behind the window
    normal: Array  # (s, 3) unit vector out of the window, in the camera frame
    change_px: Array  # what the air in the lens adds to the principal distance [px]


class ObservationColumns(NamedTuple):
    """Measured points of images."""

    x: Array  # [px]
    y: Array
    h_g: Array  # height of the target [m]
    sigma_h_g: Array  # standard deviation of that height [m]
    exposure: Integers  # row of `ExposureColumns`, -1 where the image has no exposure

    def part(self, rows: slice) -> ObservationColumns:
        """The observations of some rows, as views."""
        return ObservationColumns._make(values[rows] for values in self)


def observation_columns(
    x: Array, y: Array, h_g: Array, sigma_h_g: Array, exposure: Integers
) -> ObservationColumns:
    """`ObservationColumns` of contiguous, writable arrays; other arrays are copied.

    Kernels are compiled for types of arguments, and a read-only array has a different type.
    """
    return ObservationColumns(
        x=_writable(x),
        y=_writable(y),
        h_g=_writable(h_g),
        sigma_h_g=_writable(sigma_h_g),
        exposure=np.require(exposure, np.int64, ["C_CONTIGUOUS", "WRITEABLE"]),
    )


def _writable(values: Array) -> Array:
    """The values as a contiguous, writable float64 array; copied only if they are not one."""
    return np.require(values, np.float64, ["C_CONTIGUOUS", "WRITEABLE"])


class OutgoingRays(NamedTuple):
    """Rays of observations outside the window; all numbers are NaN where the status is not ok."""

    rays: Array  # (RAY_ROWS, n)
    r_cc: Array  # refraction angle at the window [rad]
    status: NDArray[np.uint8]


class TracedColumns(NamedTuple):
    """Rays of observations that were followed to the ground."""

    rays: Array  # (RAY_ROWS, n)
    angle: Array  # refraction angle R_c [rad]
    status: NDArray[np.uint8]


class Shifts(NamedTuple):
    """How far the correction moves observations."""

    dx: Array  # in the image [px]
    dy: Array
    ground: Array  # between the points where the raw and the true straight ray land [m]


class AirTables(NamedTuple):
    """Tables of what the air does to rays, for c heights of cameras and w ways to the target.

    A way is the height of the camera above the target. The square roots of ways are evenly spaced.
    The factors are given at f evenly spaced heights from the lowest camera to the highest, at j
    coarser ways and at k values of the incidence 1 / sqrt(cos z_g), z_g the nadir angle of the ray
    at the ground. There are v kinds of windows. x and y are the two quantities of the air that
    `uncertainty.sigmas` defines, not coordinates of pixels. Without a covariance all sigmas and the
    mode are NaN.
    """

    way_first: float  # root of the first way [m^0.5]
    way_step: float  # between roots of ways [m^0.5]
    coarse_step: float  # between roots of the coarser ways [m^0.5], which begin with ``way_first``
    incidence_step: float  # between values of the incidence, which begin at 1
    sigma: Array  # (c, w) sigma_R / (tan(zeta) way) in the plane [rad/m]
    angle: Array  # (c, w) R / (tan(zeta) way) in the plane [rad/m]
    factors: Array  # (f, j, k, 3) by `SIGMA_FACTOR`, `ANGLE_FACTOR`, `MODE_SUMMAND`
    behind: Array  # (v, 2, c, w) sigma of x, and its covariance with y over sigma of y
    lean: Array  # (v, c) sigma of y
    ground_m: float  # lowest height of ``refractivity`` [m]
    spacing_m: float  # between heights of ``refractivity`` [m]
    refractivity: Array  # (n,) N by height
    mode: Array  # (c, w) what one sigma of the leading mode changes in R / (tan(zeta) way)
    mode_lean: Array  # (v, c) what it changes in y
    mode_sigma: float  # one sigma of the leading mode, in the units of its parameter s


# Last axis of `AirTables.factors`: what the sphere does to values of the plane.
SIGMA_FACTOR = 0  # times sigma_R
ANGLE_FACTOR = 1  # times dR/dzeta
MODE_SUMMAND = 2  # added to ``mode`` of the tables


TILE = 512
"""Cells of a terrain's tile in either direction."""

BLOCK = 16
"""Cells of a block of a tile in either direction."""

CHART_DEGREE = 4
"""Of the polynomials that give rows and columns of a terrain about a station."""

# What becomes of a ray over a terrain.
LANDED = 0
EMERGES = 1  # it would come out of the ground again
PASSES = 2  # it never lands
HIDDEN = 3  # it starts under the ground
NO_TERRAIN = 4  # it ends where no terrain is known
WAITS = 5  # for a tile


class TerrainGrid(NamedTuple):
    """A terrain of p times q tiles of `TILE` cells, of which s are in memory."""

    low: NDArray[np.float32]  # (p, q) lowest node [m]; NaN: not read yet, infinite: no node
    high: NDArray[np.float32]  # (p, q) highest node [m], likewise
    slot: NDArray[np.int32]  # (p, q) place of the tile in memory, -1 without
    tiles: NDArray[np.float32]  # (s, TILE + 1, TILE + 1) nodes [m], NaN in holes
    block_low: NDArray[np.float32]  # (s, TILE / BLOCK, TILE / BLOCK) lowest node of a block [m]
    block_high: NDArray[np.float32]  # and highest
    around: int  # columns once round the earth; 0 where the grid does not go round it


class TerrainRays(NamedTuple):
    """Rays (n,) and the way they take over a grid."""

    sin_c: Array  # of the apparent nadir angle at the camera
    cos_c: Array
    h_c: Array  # height of the camera [m]
    r_e: Array  # radius of the sphere [m]
    east: Array  # of the unit vector of the azimuth
    north: Array
    knot: Array  # (n, k) distances from the camera [m]
    bend: Array  # (n, k) divided differences of R_c / distance there
    chart: Integers  # number of the ray's chart
    charts: Array  # (m, 2, 15) coefficients of row and column by east and north of a station
    reach: Array  # (m,) unit of this east and north [m]


class TerrainState(NamedTuple):
    """How far rays (n,) were followed over a terrain, and where they landed."""

    end: Array  # distance from the camera to which the ray is to be followed [m]
    t: Array  # distance to which it was followed so far [m]
    side: NDArray[np.int8]  # where terrain was last known: 1 above it, -1 under it, 0 never known
    gap: Mask  # whether the terrain is unknown since then
    distance: Array  # to the first crossing [m], NaN without a crossing
    height: Array  # of the first crossing [m], NaN without a crossing
    factor: Array  # d(height of the crossing) / d(height of the terrain)
    wanted: Integers  # number of the tile that the ray waits for, -1 without
    result: NDArray[np.uint8]  # what becomes of the ray, `LANDED` to `WAITS`; `WAITS` at first
