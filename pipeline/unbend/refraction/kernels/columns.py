"""Columns in which Python hands work to compiled functions, which take no keywords.

Importing this compiles nothing and needs no numba. All arrays of one tuple have one length, unless
stated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from unbend.units import Array, Integers, Mask, Rows

# Rows of a matrix of rays (RAY_ROWS, n).
IDEAL_U = 0  # ideal image coordinates
IDEAL_V = 1
WINDOW_CHANGE = 2  # three: change of direction in the window, in the frame of the camera
DIRECTION = 5  # three: direction outside, east, north and up
NADIR_SINE = 8  # of the apparent nadir angle
NADIR_COSINE = 9
SPHERE_RADIUS = 10  # [m]
CAMERA_HEIGHT = 11  # [m]
RAY_ROWS = 12

# Columns of a matrix of stations (s, STATION_COLUMNS).
REFRACTIVITY = 0  # N outside
RELATIVE_GRADIENT = 1  # N'/n there [1/m]
TABLE_NODE = 2  # node below it among the cameras of the table
NODE_SHARE = 3  # share of the way to the next
HEIGHT_SHARE = 4  # share of the way from the lowest to the highest camera
TILT_VARIANCE = 5  # [rad2]
YAW_EXCESS_VARIANCE = 6  # by what that of yaw exceeds that of tilt [rad2]
YAW_AXIS_EAST = 7
YAW_AXIS_NORTH = 8
SIGMA_HEIGHT = 9  # [m]
WINDOW_KIND = 10  # number of its kind of window in the tables, -1 without a plane window
WINDOW_GRADIENT = 11  # N'/n less the cabin's share that follows it [1/m]
WINDOW_NORMAL = 12  # three: the normal of the window in the camera frame
CABIN_SIGMAS = 15  # two: what the sigmas of pressure and temperature in the cabin do to N there
LENS_SIGMAS = 17  # two: and what they do to the principal distance [px]
STATION_COLUMNS = 19

LEFT = 255
"""Status of a ray that one kernel leaves to another."""

WORTH_A_TABLE = 24
"""Rays from one height for which a table of moments is made: it costs as many integrals."""


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
    hint: Rows


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

    usable: Mask
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
    exposure: Integers

    def part(self, rows: slice) -> ObservationColumns:
        """Some of the rows."""
        return ObservationColumns._make(values[rows] for values in self)


def observation_columns(
    x: Array, y: Array, h_g: Array, sigma_h_g: Array, exposure: Integers
) -> ObservationColumns:
    """Observations as kernels take them; what is read-only is copied.

    Kernels are compiled for types, and a read-only array is a type of its own.
    """
    return ObservationColumns(
        x=_writable(x, np.float64),
        y=_writable(y, np.float64),
        h_g=_writable(h_g, np.float64),
        sigma_h_g=_writable(sigma_h_g, np.float64),
        exposure=_writable(exposure, np.int64),
    )


def _writable(values: Array | Integers, dtype: DTypeLike) -> Any:
    """The values in one piece that may be written to: themselves where they are that."""
    return np.require(values, dtype, ["C_CONTIGUOUS", "WRITEABLE"])


class TracedColumns(NamedTuple):
    """Observations followed to the ground: matrix of rays, refraction angle [rad], status."""

    rays: Array
    r_c: Array
    status: NDArray[np.uint8]


class AirTables(NamedTuple):
    """Tables of sigma_R, dR/dzeta and the leading mode, of c cameras, w ways, v kinds of windows.

    way_first : root of the first way [m^0.5], ``way_step`` before the next.
    coarse_step, incidence_step : spacing of the factors in the root of the way and in
        1 / sqrt(cos z) at the ground, from 1.
    sigma, angle : (c, w) sigma_R / (tan(zeta) way) and R / (tan(zeta) way) in the plane [rad/m].
    factors : (f, j, k, 3) what the sphere multiplies sigma_R and dR/dzeta by, and what it adds to
        ``mode``, at even heights from the lowest camera to the highest.
    behind : (v, 2, c, w) sigma of x, and its covariance with y over sigma of y, in the plane.
    lean : (v, c) sigma of y.
    ground_m, spacing_m : lowest height [m] and spacing of ``refractivity`` (n,).
    mode : (c, w) what one sigma of the leading mode changes in R / (tan(zeta) way) in the plane.
    mode_lean : (v, c) and in N at the camera, less its part in the cabin.
    mode_sigma : that sigma, in the units of the parameter s.

    The sigmas and the mode are NaN throughout without a covariance.
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
    mode: Array
    mode_lean: Array
    mode_sigma: float


TILE = 512
"""Cells of a terrain's tile in either direction."""

BLOCK = 16
"""Cells of a block of a tile in either direction."""

CHART_DEGREE = 4

# What becomes of a ray over a terrain.
LANDED = 0
EMERGES = 1  # it would come out of the ground again
PASSES = 2  # it never lands
HIDDEN = 3  # it starts under the ground
NO_TERRAIN = 4  # it ends where no terrain is known
WAITS = 5  # for a tile


class TerrainGrid(NamedTuple):
    """Tiles of a terrain, (p, q) of `TILE` cells, of which some are in memory.

    ``low``, ``high`` (p, q) are the lowest and highest node of a tile [m], NaN where it was not
    read yet, infinite where it has none; ``slot`` (p, q) its place among the next three, or -1.
    ``tiles`` (s, TILE + 1, TILE + 1) nodes [m], NaN in holes; ``block_low``, ``block_high``
    (s, TILE / BLOCK, TILE / BLOCK) likewise. ``around`` columns go round the earth, 0 where
    they do not.
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    slot: NDArray[np.int32]
    tiles: NDArray[np.float32]
    block_low: NDArray[np.float32]
    block_high: NDArray[np.float32]
    around: int


class TerrainRays(NamedTuple):
    """Rays (n,) and the way they take over a grid.

    ``east``, ``north`` of the unit vector of the azimuth; ``knot``, ``bend`` (n, k) distances [m]
    and the divided differences of R_c / distance there; ``chart`` (n,) numbers ``charts``
    (m, 2, 15): row and column of the grid as polynomials of degree 4 in east and north of a
    station, in units of its ``reach`` (m,) [m].
    """

    sin_c: Array
    cos_c: Array
    h_c: Array
    r_e: Array
    east: Array
    north: Array
    knot: Array
    bend: Array
    chart: Integers
    charts: Array
    reach: Array


class TerrainState(NamedTuple):
    """How far rays (n,) were followed, and what was found.

    ``end`` and ``t`` are distances from the camera [m], ``side`` 1 above and -1 under the terrain
    and 0 where unknown, ``gap`` whether it is unknown at ``t``; ``distance`` and ``height`` [m]
    of the first crossing, NaN without one, and ``factor`` what it changes by with the height of the
    terrain; ``wanted`` is the tile a ray waits for, or -1; ``result`` what becomes of it.
    """

    end: Array
    t: Array
    side: NDArray[np.int8]
    gap: Mask
    distance: Array
    height: Array
    factor: Array
    wanted: Integers
    result: NDArray[np.uint8]
