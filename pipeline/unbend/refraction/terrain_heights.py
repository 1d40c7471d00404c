"""Heights of targets where curved rays first meet a terrain.

A ray is given by R_c at some straight distances from the camera, its knots (`_BentPaths`). About
each exposure a chart, polynomials in east and north of it, gives row and column in the grid of the
terrain (`_charts`). Compiled functions follow the rays over the grid (`_follow`) and stop where a
tile is not in memory; the tiles are read, and the rays go on.
"""

from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from unbend.geodesy import euler_radius, offset_geodetic
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures, straight_reach
from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    CHART_DEGREE,
    DIRECTION,
    EMERGES,
    HIDDEN,
    LANDED,
    NADIR_COSINE,
    NADIR_SINE,
    NO_TERRAIN,
    PASSES,
    RAY_ROWS,
    SPHERE_RADIUS,
    WAITS,
    TerrainGrid,
    TerrainRays,
    TerrainState,
)
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.ray import PublishedRays, bend
from unbend.refraction.ray_table import RayTable, ray_table
from unbend.refraction.status_codes import (
    MISSES_GROUND,
    NO_GROUND,
    OK,
    OUTSIDE_PROFILE,
    SEVERAL_CROSSINGS,
)
from unbend.refraction.target_heights import height_at_distance, target_rays
from unbend.units import Array, Integers, Rows

_MAX_RAYS_IN_MEMORY = 65_536  # each takes some hundred bytes

# Every 64th ray is followed first. Most tiles are read for these, so that the others seldom wait.
_SCOUT_SPACING = 64

_LOWEST_LAND_M = -500.0
_HIGHEST_LAND_M = 9_000.0

# Cosine of the nadir angle above which a ray reaches the lowest land from any height below 50 km.
_STEEP_COSINE = 0.17
_FARTHEST_M = 200_000.0  # distance to which other rays are followed at most

# Knots along a ray: of a steep one as shares of its drop, of another as shares of its distance.
_STEEP_ANGLES = np.pi * np.arange(1, 5) / 4
_LEVEL_ANGLES = np.pi * np.arange(1, 9) / 8
_STEEP_SHARES = 0.5 - 0.5 * np.cos(_STEEP_ANGLES)
_LEVEL_SHARES = 0.5 - 0.5 * np.cos(_LEVEL_ANGLES)

# Powers of east and north in the 15 terms of a polynomial of degree 4, by rising degree.
_POWERS: list[tuple[int, int]] = []
for _degree in range(CHART_DEGREE + 1):
    for _power in range(_degree + 1):
        _POWERS.append((_degree - _power, _power))


def _square_of(side: Array) -> Array:
    """(n * n, 2) east and north of a square grid with the n values of ``side`` in each."""
    east_and_north = np.meshgrid(side, side)
    return np.stack(east_and_north, axis=-1).reshape(-1, 2)


# East and north in units of the reach of a chart: the distance to which it can be used.
_NODE_ANGLES = np.pi * (np.arange(6) + 0.5) / 6
_NODES = _square_of(np.cos(_NODE_ANGLES))  # charts are fitted to these points
_CHECKS = _square_of(np.linspace(-0.95, 0.95, 5))  # errors of charts are measured at these

_MAX_TRIALS = 12  # of a chart, each with half the reach of the one before
_USED_SHARE_OF_REACH = 0.98  # rays end there
_LARGEST_ERROR = 0.01  # of row and column [cells]; a chart with more gets half the reach
_REACH_MARGIN = 1.01  # wanted reach over the longest arc of a ray, and 1 m more


class Terrain(Protocol):
    """A terrain of heights above sea level in tiles, whatever they are read from."""

    @property
    def grid(self) -> TerrainGrid:
        """The grid, with the tiles that are in memory."""

    @property
    def lock(self) -> AbstractContextManager[object]:
        """The lock that is held while tiles are read and rays go over them."""

    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """Row and column (fractional numbers of nodes) in the grid of places on WGS 84 [rad]."""

    def load(self, tiles: Integers) -> None:
        """Read tiles into memory, as many as fit, those at the front of ``tiles`` first.

        ``tiles`` are numbers of tiles, counted row by row.
        """


class TerrainHeights(NamedTuple):
    """Where rays (n,) land.

    Numbers are NaN unless the status is ``ok`` or ``several_crossings`` (the ray would come out of
    the ground again).
    """

    h_m: Array  # above sea level
    factor: Array  # d(h_m) / d(height of the terrain)
    distance_m: Array  # slant range
    status: NDArray[np.uint8]


class _RaysOverGrid(NamedTuple):
    """Rays over the grid of a terrain, and where they end."""

    rays: TerrainRays
    end_m: Array  # (n,) straight distance from the camera to which a ray is followed
    status_at_end: NDArray[np.uint8]  # (n,) of a ray that does not land before


class _BentPaths(NamedTuple):
    """R_c at k knots along each of n rays."""

    knot_m: Array  # (n, k) straight distances of the knots from the camera
    r_c_rad: Array  # (n, k) R_c of a target at the knot
    status_at_end: NDArray[np.uint8]  # (n,) of a ray that goes beyond the last knot


def terrain_heights(  # noqa: PLR0913
    x_px: Array,
    y_px: Array,
    exposure: Integers,
    exposures: Exposures,
    places: tuple[Array, Array],
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
    terrain: Terrain,
    ideal: bool = False,
) -> TerrainHeights:
    """Heights where the rays of image observations first meet the terrain.

    x_px, y_px : (n,) pixels: measured, or those of the straight chord where ``ideal``.
    exposure, exposures, camera, table : as for `correct_observations`.
    places : (s,) latitude and longitude [rad] of the exposures.
    terrain : from `unbend.tables.geodata.elevation`.

    The status is ``no_ground`` where a ray leaves the terrain, lands in a hole of it, or was
    followed for 200 km; ``misses_ground`` where it passes over all land or starts under the
    terrain; ``outside_profile`` where it comes below the lowest air of ``table``. Pixels without a
    ray have the status ``ok`` and the height NaN: `correct_observations` finds the reason.

    The point of a ray at a straight distance is the end of a chord of that length at the nadir
    angle zeta_c - R_c, with R_c interpolated by distance. Accuracy against an integrated ray: 1 mm
    at nadir angles below 60 degrees, 1 cm below 75.
    """
    n = x_px.size
    heights = TerrainHeights(
        h_m=np.full(n, np.nan),
        factor=np.full(n, np.nan),
        distance_m=np.full(n, np.nan),
        status=np.full(n, OK, np.uint8),
    )
    if isinstance(table, PublishedRays):
        table = ray_table(table.profile)
    air = None if ideal else table  # straight chords have no refraction
    for first in range(0, n, _MAX_RAYS_IN_MEMORY):
        block = slice(first, min(first + _MAX_RAYS_IN_MEMORY, n))
        rays = _rays_of_pixels(
            x_px[block], y_px[block], exposure[block], exposures, camera=camera, ideal=ideal
        )
        is_steep = rays[NADIR_COSINE] > _STEEP_COSINE
        has_ray = ~np.isnan(rays[NADIR_COSINE])
        for steep in (True, False):
            rows = np.flatnonzero((is_steep == steep) & has_ray)
            if rows.size == 0:
                continue
            observations = first + rows
            paths = _bent_paths(rays[:, rows], air, steep=steep)
            over_grid = _rays_over_grid(
                rays[:, rows], paths, exposure[observations], places, terrain
            )
            landings = _follow(over_grid, terrain)
            heights.h_m[observations] = landings.h_m
            heights.factor[observations] = landings.factor
            heights.distance_m[observations] = landings.distance_m
            heights.status[observations] = landings.status
    return heights


def _rays_of_pixels(
    x: Array, y: Array, exposure: Integers, exposures: Exposures, *, camera: Camera, ideal: bool
) -> Array:
    """The matrix of rays (RAY_ROWS, n) from `target_rays`, computed on several cores."""
    rays = np.empty((RAY_ROWS, x.size))

    def fill(rows: slice) -> None:
        rays[:, rows] = target_rays(
            x[rows], y[rows], exposure[rows], exposures, camera=camera, ideal=ideal
        )

    in_blocks(fill, x.size)
    return rays


def _rays_over_grid(
    rays: Array,
    paths: _BentPaths,
    exposure: Integers,
    places: tuple[Array, Array],
    terrain: Terrain,
) -> _RaysOverGrid:
    """Rays (RAY_ROWS, n) with their paths and the charts of their exposures.

    ``exposure`` (n,) are rows of ``places``, latitude and longitude (s,) [rad] of exposures. A ray
    ends at its last knot, or before where its chart does; then ``paths.status_at_end`` is changed.
    """
    end_m = paths.knot_m[:, -1].copy()
    status_at_end = paths.status_at_end
    arc_m = _arcs(rays, end_m)
    latitude, longitude = places
    station, chart = np.unique(exposure, return_inverse=True)  # one chart for each station
    wanted_m = np.zeros(station.size)
    np.fmax.at(wanted_m, chart, _REACH_MARGIN * arc_m)
    charts, reach_m = _charts(latitude[station], longitude[station], wanted_m + 1.0, terrain)
    usable_m = _USED_SHARE_OF_REACH * reach_m[chart]
    is_cut_short = usable_m < arc_m
    end_m[is_cut_short] *= usable_m[is_cut_short] / arc_m[is_cut_short]
    status_at_end[is_cut_short] = NO_GROUND
    east, north = _level_directions(rays)
    terrain_rays = TerrainRays(
        sin_c=rays[NADIR_SINE],
        cos_c=rays[NADIR_COSINE],
        h_c=rays[CAMERA_HEIGHT],
        r_e=rays[SPHERE_RADIUS],
        east=east,
        north=north,
        knot=paths.knot_m,
        bend=paths.r_c_rad / paths.knot_m,
        chart=chart,
        charts=charts,
        reach=reach_m,
    )
    return _RaysOverGrid(terrain_rays, end_m, status_at_end)


def _arcs(rays: Array, distance_m: Array) -> Array:
    """(n,) lengths [m] of the arcs at sea level under straight rays of lengths ``distance_m``."""
    radius = rays[SPHERE_RADIUS]
    across_m = distance_m * rays[NADIR_SINE]
    from_centre_m = radius + rays[CAMERA_HEIGHT] - distance_m * rays[NADIR_COSINE]
    return np.asarray(radius * np.arctan2(across_m, from_centre_m))


def _level_directions(rays: Array) -> Array:
    """(2, n) unit vectors (east, north) along the horizontal directions of rays.

    They are 0, 0 for vertical rays.
    """
    sine = rays[NADIR_SINE]
    length = np.where(sine > 0, sine, 1)  # the east and north parts of a vertical ray are 0
    return np.asarray(rays[DIRECTION : DIRECTION + 2] / length)


def _bent_paths(rays: Array, air: RayTable | None, *, steep: bool) -> _BentPaths:
    """R_c along rays (RAY_ROWS, n), which are all steep or all nearly level.

    Knots of steep rays go down to the lowest land; those of others to where the ray is below or
    above all land, and at most to 200 km. R_c is 0 without ``air``, and NaN where the air does not
    reach as far.
    """
    n = rays.shape[1]
    count = _STEEP_SHARES.size if steep else _LEVEL_SHARES.size
    paths = _BentPaths(
        knot_m=np.empty((n, count)),
        r_c_rad=np.zeros((n, count)),
        status_at_end=np.full(n, OUTSIDE_PROFILE, np.uint8),
    )
    bottom_m = _LOWEST_LAND_M
    if air is not None:
        bottom_m = max(_LOWEST_LAND_M, float(air.edge_m[0]))

    def fill(rows: slice) -> None:
        part = _BentPaths._make(column[rows] for column in paths)  # views, which are filled
        if steep:
            _fill_steep_paths(part, rays[:, rows], air, bottom_m)
        else:
            _fill_level_paths(part, rays[:, rows], air, bottom_m)

    in_blocks(fill, n)
    return paths


def _fill_steep_paths(
    paths: _BentPaths, rays: Array, air: RayTable | None, bottom_m: float
) -> None:
    """Fill knots and R_c where steep rays reach some heights, the last of them ``bottom_m``."""
    sine = rays[NADIR_SINE]
    cosine = rays[NADIR_COSINE]
    radius = rays[SPHERE_RADIUS]
    h_c = rays[CAMERA_HEIGHT]
    for k, share in enumerate(_STEEP_SHARES):
        h_k = h_c - share * (h_c - bottom_m)
        if air is not None:
            paths.r_c_rad[:, k], _ = bend(air, h_c, h_k, sine, cosine, radius=radius)
        r_c = paths.r_c_rad[:, k]
        cos_chord = cosine * np.cos(r_c) + sine * np.sin(r_c)
        paths.knot_m[:, k] = straight_reach(h_c, h_k, cos_chord, radius=radius, far=False)


def _fill_level_paths(
    paths: _BentPaths, rays: Array, air: RayTable | None, bottom_m: float
) -> None:
    """Fill knots, R_c there and the status at the end of nearly level rays.

    A ray ends at the height ``bottom_m`` [m], or beyond the horizon where it leaves the height of
    the highest land upwards, or at 200 km.
    """
    sine = rays[NADIR_SINE]
    cosine = rays[NADIR_COSINE]
    radius = rays[SPHERE_RADIUS]
    h_c = rays[CAMERA_HEIGHT]
    with np.errstate(invalid="ignore"):
        down = straight_reach(h_c, bottom_m, cosine, radius=radius, far=False)
        down = np.where(cosine > 0.0, down, np.nan)
        up = straight_reach(h_c, _HIGHEST_LAND_M, cosine, radius=radius, far=True)
        up = np.nan_to_num(up)  # a ray that never comes down to land ends at once
        end_m = np.fmin(down, up)
        paths.status_at_end[:] = np.where(end_m == up, MISSES_GROUND, OUTSIDE_PROFILE)
        paths.status_at_end[end_m > _FARTHEST_M] = NO_GROUND
        end_m = np.clip(end_m, 1.0, _FARTHEST_M)
        for k, share in enumerate(_LEVEL_SHARES):
            knot_m = share * end_m
            paths.knot_m[:, k] = knot_m
            if air is None:
                continue
            h_k, _ = height_at_distance(air, h_c, sine, cosine, knot_m, radius=radius)
            # The law of cosines in the triangle of camera, chord's end and earth's centre.
            square_difference = (h_c - h_k) * (2.0 * radius + h_c + h_k)
            cos_chord = (knot_m * knot_m + square_difference) / (2.0 * (radius + h_c) * knot_m)
            zeta_c = np.arctan2(sine, cosine)
            paths.r_c_rad[:, k] = zeta_c - np.arccos(cos_chord)


def _charts(
    lat_rad: Array, lon_rad: Array, wanted_m: Array, terrain: Terrain
) -> tuple[Array, Array]:
    """Charts (m, 2, 15) of `TerrainRays` about (m,) places, and the reach (m,) [m] of each.

    A chart is fitted by least squares to the exact rows and columns of `_NODES`, for the reach
    ``wanted_m`` (m,). While it errs by more than 0.01 cell at `_CHECKS` the reach is halved; a
    chart that never succeeds is NaN, with the reach 0.
    """
    reach = wanted_m.copy()
    charts = np.empty((wanted_m.size, 2, len(_POWERS)))
    to_coefficients = np.linalg.pinv(_terms(_NODES))
    unfinished = np.arange(wanted_m.size)  # rows of charts
    for _ in range(_MAX_TRIALS):
        points = np.concatenate([_NODES, _CHECKS]) * reach[unfinished, None, None]
        lat, lon = _places_about(lat_rad[unfinished], lon_rad[unfinished], points)
        row_and_column = np.stack(terrain.nodes(lat, lon), axis=-1)
        row_and_column = row_and_column.reshape(unfinished.size, -1, 2)
        if terrain.grid.around:
            _unwrap_columns(row_and_column[..., 1], terrain.grid.around)
        at_nodes = row_and_column[:, : len(_NODES)]
        at_checks = row_and_column[:, len(_NODES) :]
        charts[unfinished] = np.einsum("tk,mkc->mct", to_coefficients, at_nodes)
        by_chart = np.einsum("kt,mct->mkc", _terms(_CHECKS), charts[unfinished])
        error = np.abs(by_chart - at_checks).max(axis=(1, 2))
        unfinished = unfinished[~(error < _LARGEST_ERROR)]
        if unfinished.size == 0:
            break
        reach[unfinished] *= 0.5
    reach[unfinished] = 0.0
    charts[unfinished] = np.nan
    return charts, reach


def _unwrap_columns(column: Array, around: float) -> None:
    """Change ``column`` (m, k): numbers next to the first of their row by whole turns of a grid.

    ``around`` is the number of columns once round the earth.
    """
    turns = (column - column[:, :1]) / around
    column -= around * np.round(turns)


def _places_about(lat_rad: Array, lon_rad: Array, points: Array) -> tuple[Array, Array]:
    """Latitude and longitude (m * k,) [rad] of k points about each of m places.

    ``points`` (m, k, 2) are east and north [m], measured along an arc of the ellipsoid from the
    place; the arc is taken as a circle of Euler's radius.
    """
    lat = np.repeat(lat_rad, points.shape[1])
    lon = np.repeat(lon_rad, points.shape[1])
    east, north = points.reshape(-1, 2).T
    azimuth = np.arctan2(east, north)
    radius = euler_radius(lat, azimuth)
    angle = np.hypot(east, north) / radius
    across = radius * np.sin(angle)
    chord_enu = [
        across * np.sin(azimuth),
        across * np.cos(azimuth),
        -2.0 * radius * np.sin(0.5 * angle) ** 2,
    ]
    enu = np.stack(chord_enu, axis=-1)
    lat, lon, _ = offset_geodetic(lat, lon, np.zeros(lat.size), enu)
    return lat, lon


def _terms(points: Array) -> Array:
    """(k, 15) the terms of a chart's polynomials at ``points`` (k, 2), in units of its reach."""
    east = points[:, 0]
    north = points[:, 1]
    terms = [east**i * north**j for i, j in _POWERS]
    return np.stack(terms, axis=1)


def _follow(over_grid: _RaysOverGrid, terrain: Terrain) -> TerrainHeights:
    """Follow rays to where they land; tiles are read as rays come to them.

    ``over_grid.rays.bend`` is changed into its divided differences.
    """
    from unbend.refraction.kernels.terrain_paths import divide_differences

    rays = over_grid.rays
    n = over_grid.end_m.size
    divide_differences(rays.knot, rays.bend)
    has_bends = np.isfinite(rays.bend).all(axis=1)
    is_usable = has_bends & np.isfinite(over_grid.end_m)
    is_followed = is_usable & (rays.reach[rays.chart] > 0.0)
    state = TerrainState(
        end=over_grid.end_m,
        t=np.zeros(n),
        side=np.zeros(n, np.int8),
        gap=np.zeros(n, bool),
        distance=np.full(n, np.nan),
        height=np.full(n, np.nan),
        factor=np.full(n, np.nan),
        wanted=np.full(n, -1),
        result=np.where(is_followed, np.uint8(WAITS), np.uint8(NO_TERRAIN)),
    )
    followed = np.flatnonzero(is_followed)
    with terrain.lock:
        _follow_to_end(rays, followed[::_SCOUT_SPACING], state, terrain)
        _follow_to_end(rays, followed, state, terrain)
    status_of_result = np.empty(WAITS + 1, np.uint8)
    status_of_result[LANDED] = OK
    status_of_result[EMERGES] = SEVERAL_CROSSINGS
    status_of_result[HIDDEN] = MISSES_GROUND
    status_of_result[NO_TERRAIN] = NO_GROUND
    has_passed = state.result == PASSES  # its status depends on the ray
    status_on_way = status_of_result[state.result]
    status = np.where(has_passed, over_grid.status_at_end, status_on_way).astype(np.uint8)
    status[~is_usable] = OUTSIDE_PROFILE
    has_landed = (status == OK) | (status == SEVERAL_CROSSINGS)
    state.height[~has_landed] = np.nan
    state.distance[~has_landed] = np.nan
    return TerrainHeights(
        h_m=state.height,
        factor=state.factor,
        distance_m=state.distance,
        status=status,
    )


def _follow_to_end(
    rays: TerrainRays, followed: Rows, state: TerrainState, terrain: Terrain
) -> None:
    """Follow the rays with the numbers ``followed`` until each has a result in ``state``.

    Tiles that rays wait for are read, those that most rays wait for first.
    """
    from unbend.refraction.kernels.terrain import follow_rays

    waiting = followed[state.result[followed] == WAITS]
    while waiting.size:

        def follow_block(rows: slice, waiting: Rows = waiting) -> None:
            follow_rays(rays, waiting[rows], terrain.grid, state)

        in_blocks(follow_block, waiting.size)
        tiles, count = np.unique(state.wanted[waiting], return_counts=True)
        tiles = tiles[np.argsort(-count, kind="stable")]
        terrain.load(tiles[tiles >= 0])
        waiting = followed[state.result[followed] == WAITS]
