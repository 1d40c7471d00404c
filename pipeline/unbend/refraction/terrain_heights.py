"""Heights of targets where curved rays first meet a terrain."""

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

_ROWS_AT_ONCE = 65_536  # rays over a terrain that are kept in memory: some hundred bytes each

# One ray in so many goes first, for which tiles are read: the others seldom wait.
_SCOUTS = 64

# From here on down [m] a ray is under all land.
_LOWEST_M = -500.0
_HIGHEST_M = 9_000.0  # and above this over all land

# Rays steeper than this reach the lowest land from any height below 50 km.
_STEEP = 0.17
_FARTHEST_M = 200_000.0

# Knots of R_c / distance along a ray, as shares of the drop or of the distance.
_STEEP_ANGLES = np.pi * np.arange(1, 5) / 4
_LEVEL_ANGLES = np.pi * np.arange(1, 9) / 8
_STEEP_SHARES = 0.5 - 0.5 * np.cos(_STEEP_ANGLES)
_LEVEL_SHARES = 0.5 - 0.5 * np.cos(_LEVEL_ANGLES)

# Powers of east and north in the terms of polynomials of degree 4, by rising degree.
_POWERS: list[tuple[int, int]] = []
for _degree in range(CHART_DEGREE + 1):
    for _power in range(_degree + 1):
        _POWERS.append((_degree - _power, _power))


def _square_of(side: Array) -> Array:
    """(n * n, 2) the points whose east and north are among n values."""
    east_and_north = np.meshgrid(side, side)
    return np.stack(east_and_north, axis=-1).reshape(-1, 2)


# East and north in units of a chart's reach.
_NODE_ANGLES = np.pi * (np.arange(6) + 0.5) / 6
_NODES = _square_of(np.cos(_NODE_ANGLES))  # that charts are fitted to
_CHECKS = _square_of(np.linspace(-0.95, 0.95, 5))  # where their errors are measured

_MOST_HALVINGS = 12  # of the reach of a chart
_PART_OF_REACH = 0.98  # of a chart, that rays are followed for
_LARGEST_ERROR = 0.01  # of row and column [cells]; a chart that is worse gets half the reach
_ARC_TO_SPARE = 1.01  # factor, and 1 m more, of the reach over the longest arc


class Terrain(Protocol):
    """A terrain of heights above sea level in tiles, whatever they are read from."""

    @property
    def grid(self) -> TerrainGrid:
        """The grid, which says which tiles are in memory."""

    @property
    def lock(self) -> AbstractContextManager[object]:
        """The lock that is held while tiles are read and rays go over them."""

    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """Row and column, in nodes of the grid, of places on WGS 84 [rad]."""

    def load(self, tiles: Integers) -> None:
        """Read tiles into memory, as many as fit there, the first ones first."""


class TerrainHeights(NamedTuple):
    """Where rays (n,) land.

    The status is ``several_crossings`` where a ray would come out of the ground again; rays of
    other statuses than that and ``ok`` have no height.
    """

    h_m: Array  # above sea level
    factor: Array  # d(h_m) / d(height of the terrain)
    distance_m: Array  # slant range
    status: NDArray[np.uint8]


class _Ways(NamedTuple):
    """Rays over the grid of a terrain, and where they end."""

    rays: TerrainRays
    end_m: Array  # (n,) distance to which a ray is followed
    status_at_end: NDArray[np.uint8]  # (n,) of a ray that does not land before


class _BentPaths(NamedTuple):
    """R_c at some distances along rays (n,)."""

    knot_m: Array  # (n, k) straight distances from the camera
    r_c_rad: Array  # (n, k) there
    status_at_end: NDArray[np.uint8]  # (n,) of a ray that goes beyond the last distance


def terrain_heights(
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

    ``no_ground`` is where a ray leaves the terrain, lands in a hole of it, or was followed for 200
    km, ``misses_ground`` where it passes over all of it or starts below it, ``outside_profile``
    where it leaves the air under it. Rays that see no exposure have ``ok`` and no height.

    A ray is its straight chord at each distance, turned by the R_c there; R_c by distance is
    interpolated. Against steps of an integrated ray: 1 mm below 60 degrees, 1 cm below 75.
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
    air = None if ideal else table
    for first in range(0, n, _ROWS_AT_ONCE):
        block = slice(first, min(first + _ROWS_AT_ONCE, n))
        rays = _rays_in_blocks(
            x_px[block],
            y_px[block],
            exposure[block],
            exposures,
            camera=camera,
            ideal=ideal,
        )
        is_steep = rays[NADIR_COSINE] > _STEEP
        has_ray = ~np.isnan(rays[NADIR_COSINE])
        for steep in (True, False):
            rows = np.flatnonzero((is_steep == steep) & has_ray)
            if rows.size == 0:
                continue
            observations = first + rows
            paths = _bent_paths(rays[:, rows], air, steep=steep)
            ways = _ways_over(rays[:, rows], paths, exposure[observations], places, terrain)
            landings = _follow(ways, terrain)
            heights.h_m[observations] = landings.h_m
            heights.factor[observations] = landings.factor
            heights.distance_m[observations] = landings.distance_m
            heights.status[observations] = landings.status
    return heights


def _rays_in_blocks(
    x: Array,
    y: Array,
    exposure: Integers,
    exposures: Exposures,
    *,
    camera: Camera,
    ideal: bool,
) -> Array:
    """The matrix of rays as of `target_rays`, on several cores."""
    rays = np.empty((RAY_ROWS, x.size))

    def fill(rows: slice) -> None:
        rays[:, rows] = target_rays(
            x[rows],
            y[rows],
            exposure[rows],
            exposures,
            camera=camera,
            ideal=ideal,
        )

    in_blocks(fill, x.size)
    return rays


def _ways_over(
    rays: Array,
    paths: _BentPaths,
    exposure: Integers,
    places: tuple[Array, Array],
    terrain: Terrain,
) -> _Ways:
    """The ways of rays over a terrain's grid.

    ``exposure`` (n,) are rows of ``places``, latitude and longitude (s,) [rad] of exposures. Each
    exposure has a chart of the grid; a ray ends where the chart does.
    """
    end_m = paths.knot_m[:, -1].copy()
    status_at_end = paths.status_at_end
    arc_m = _arcs(rays, end_m)
    latitude, longitude = places
    station, chart = np.unique(exposure, return_inverse=True)
    longest_m = np.zeros(station.size)
    np.fmax.at(longest_m, chart, _ARC_TO_SPARE * arc_m)
    charts, reach_m = _charts(latitude[station], longitude[station], longest_m + 1.0, terrain)
    usable_m = _PART_OF_REACH * reach_m[chart]
    is_short = usable_m < arc_m
    end_m[is_short] *= usable_m[is_short] / arc_m[is_short]
    status_at_end[is_short] = NO_GROUND
    east, north = _level_directions(rays)
    way = TerrainRays(
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
    return _Ways(way, end_m, status_at_end)


def _arcs(rays: Array, distance_m: Array) -> Array:
    """(n,) arcs [m] on the sphere under straight rays to some distance."""
    radius = rays[SPHERE_RADIUS]
    across_m = distance_m * rays[NADIR_SINE]
    from_centre_m = radius + rays[CAMERA_HEIGHT] - distance_m * rays[NADIR_COSINE]
    return np.asarray(radius * np.arctan2(across_m, from_centre_m))


def _level_directions(rays: Array) -> Array:
    """(2, n) east and north of the unit vector along which a ray goes over the ground."""
    sine = rays[NADIR_SINE]
    divisor = np.where(sine > 0, sine, 1)
    with np.errstate(invalid="ignore"):
        return np.asarray(rays[DIRECTION : DIRECTION + 2] / divisor)


def _bent_paths(rays: Array, air: RayTable | None, *, steep: bool) -> _BentPaths:
    """R_c along rays: steep ones to the lowest land, others to where they leave all land.

    Others at most for 200 km. R_c is zero without ``air``, and NaN where the air does not reach as
    far.
    """
    n = rays.shape[1]
    count = _STEEP_SHARES.size if steep else _LEVEL_SHARES.size
    paths = _BentPaths(
        knot_m=np.empty((n, count)),
        r_c_rad=np.zeros((n, count)),
        status_at_end=np.full(n, OUTSIDE_PROFILE, np.uint8),
    )
    bottom_m = _LOWEST_M
    if air is not None:
        bottom_m = max(_LOWEST_M, float(air.edge_m[0]))

    def fill(rows: slice) -> None:
        part = _BentPaths._make(column[rows] for column in paths)
        if steep:
            _fill_steep_paths(part, rays[:, rows], air, bottom_m)
        else:
            _fill_level_paths(part, rays[:, rows], air, bottom_m)

    in_blocks(fill, n)
    return paths


def _fill_steep_paths(
    paths: _BentPaths, rays: Array, air: RayTable | None, bottom_m: float
) -> None:
    """Fill the distances at which steep rays reach some heights down to ``bottom_m``, and R_c."""
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
    """Fill distances along nearly level rays, R_c there, and the status beyond the last.

    They end at ``bottom_m``, or beyond the horizon where all land is below them.
    """
    sine = rays[NADIR_SINE]
    cosine = rays[NADIR_COSINE]
    radius = rays[SPHERE_RADIUS]
    h_c = rays[CAMERA_HEIGHT]
    with np.errstate(invalid="ignore"):
        down = straight_reach(h_c, bottom_m, cosine, radius=radius, far=False)
        down = np.where(cosine > 0.0, down, np.nan)
        up = straight_reach(h_c, _HIGHEST_M, cosine, radius=radius, far=True)
        up = np.nan_to_num(up)
        end_m = np.fmin(down, up)
        paths.status_at_end[:] = np.where(end_m == up, MISSES_GROUND, OUTSIDE_PROFILE)
        paths.status_at_end[end_m > _FARTHEST_M] = NO_GROUND
        end_m = np.clip(end_m, 1.0, _FARTHEST_M)
        for k, share in enumerate(_LEVEL_SHARES):
            t = share * end_m
            paths.knot_m[:, k] = t
            if air is None:
                continue
            h_k, _ = height_at_distance(air, h_c, sine, cosine, t, radius=radius)
            # The law of cosines in the triangle of camera, chord's end and earth's centre.
            square_difference = (h_c - h_k) * (2.0 * radius + h_c + h_k)
            cos_chord = (t * t + square_difference) / (2.0 * (radius + h_c) * t)
            zeta_c = np.arctan2(sine, cosine)
            paths.r_c_rad[:, k] = zeta_c - np.arccos(cos_chord)


def _charts(
    lat_rad: Array,
    lon_rad: Array,
    needed: Array,
    terrain: Terrain,
) -> tuple[Array, Array]:
    """Charts (m, 2, 15) of `TerrainRays` about (m,) places, and how far each is good [m].

    Least squares over exact nodes, checked between them; a chart for ``needed`` (m,) that errs by
    more than 0.01 cell is made for half the distance.
    """
    reach = needed.copy()
    charts = np.empty((needed.size, 2, len(_POWERS)))
    to_coefficients = np.linalg.pinv(_terms(_NODES))
    left = np.arange(needed.size)  # charts that are not good yet
    for _ in range(_MOST_HALVINGS):
        points = np.concatenate([_NODES, _CHECKS]) * reach[left, None, None]
        lat, lon = _places_about(lat_rad[left], lon_rad[left], points)
        row_and_column = np.stack(terrain.nodes(lat, lon), axis=-1)
        row_and_column = row_and_column.reshape(left.size, -1, 2)
        if terrain.grid.around:
            _unwrap_columns(row_and_column[..., 1], terrain.grid.around)
        at_nodes = row_and_column[:, : len(_NODES)]
        at_checks = row_and_column[:, len(_NODES) :]
        charts[left] = np.einsum("tk,mkc->mct", to_coefficients, at_nodes)
        by_chart = np.einsum("kt,mct->mkc", _terms(_CHECKS), charts[left])
        error = np.abs(by_chart - at_checks).max(axis=(1, 2))
        left = left[~(error < _LARGEST_ERROR)]
        if left.size == 0:
            break
        reach[left] *= 0.5
    reach[left] = 0.0
    charts[left] = np.nan
    return charts, reach


def _unwrap_columns(column: Array, around: float) -> None:
    """Move columns (m, k) of a grid around the earth by whole turns to the first of their row."""
    turns = (column - column[:, :1]) / around
    column -= around * np.round(turns)


def _places_about(lat_rad: Array, lon_rad: Array, points: Array) -> tuple[Array, Array]:
    """Latitude and longitude (m * k,) [rad] of the ends of arcs from places (m,).

    ``points`` (m, k, 2) are east and north [m] along arcs in the vertical planes of the places.
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
    """(k, 15) terms of the polynomials at (k, 2) east and north in units of the reach."""
    east = points[:, 0]
    north = points[:, 1]
    terms = [east**i * north**j for i, j in _POWERS]
    return np.stack(terms, axis=1)


def _follow(ways: _Ways, terrain: Terrain) -> TerrainHeights:
    """Where rays land, with the tiles read that they come to."""
    from unbend.refraction.kernels.terrain_paths import divide_differences

    rays = ways.rays
    n = ways.end_m.size
    divide_differences(rays.knot, rays.bend)
    has_bends = np.isfinite(rays.bend).all(axis=1)
    is_usable = has_bends & np.isfinite(ways.end_m)
    is_followed = is_usable & (rays.reach[rays.chart] > 0.0)
    state = TerrainState(
        end=ways.end_m,
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
        _follow_to_end(rays, followed[::_SCOUTS], state, terrain)
        _follow_to_end(rays, followed, state, terrain)
    status_of = np.empty(WAITS + 1, np.uint8)
    status_of[LANDED] = OK
    status_of[EMERGES] = SEVERAL_CROSSINGS
    status_of[HIDDEN] = MISSES_GROUND
    status_of[NO_TERRAIN] = NO_GROUND
    has_passed = state.result == PASSES
    status_on_way = status_of[state.result]
    status = np.where(has_passed, ways.status_at_end, status_on_way).astype(np.uint8)
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
    rays: TerrainRays,
    followed: Rows,
    state: TerrainState,
    terrain: Terrain,
) -> None:
    """Follow the rays of these rows until none waits; read the tiles they wait for.

    The tiles that most rays wait for are read first.
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
