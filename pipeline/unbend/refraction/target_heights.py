"""Heights of targets along curved rays: at a straight distance, or where they meet a terrain."""

import math
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.geodesy import euler_radius, offset_geodetic
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures, outgoing_rays, straight_reach
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
    SPHERE_RADIUS,
    WAITS,
    RayColumns,
    TerrainGrid,
    TerrainRays,
    TerrainState,
    observation_columns,
)
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.ray import DEFAULT_RADIUS_M, PublishedRays, as_columns, bend
from unbend.refraction.ray_table import RayTable, ray_table
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    MISSES_GROUND,
    NO_GROUND,
    OK,
    OUTSIDE_PROFILE,
    SEVERAL_CROSSINGS,
)
from unbend.units import Array, Integers, Rows

# Rounds for a published method: each gains three digits, and they go no nearer to grazing.
_ROUNDS = 12
_CLOSE_M = 1e-7

# More than refraction moves a point into the format.
_MARGIN_PX = 500


def height_at_distance(
    table: RayTable | PublishedRays,
    h_c: ArrayLike,
    sin_zeta_c: ArrayLike,
    cos_zeta_c: ArrayLike,
    distance: ArrayLike,
    *,
    radius: ArrayLike = DEFAULT_RADIUS_M,
) -> tuple[Array, NDArray[np.uint8]]:
    """Heights of targets whose slant range is known, along the bent rays that show them.

    distance : length [m] of the straight chord from camera to target, over 0; before or beyond the
        lowest point P_90 of the ray. The rest as for `bend`; all broadcast.

    Returns the height h_g of the target above sea level [m], NaN where there is none, and the
    status: ``outside_profile`` where the chord ends outside it, ``misses_ground`` where the ray
    passes under all land on its way, ``bad_measurement`` for what is no distance or angle.

    A millionth of a metre against 30-digit arithmetic, through P_90 too: unlike the distance of a
    given height, the height at a given distance is well determined there. For a published method
    the nadir angle of the chord is found by repetition, to the method's own accuracy.
    Source: Gyer 1996, Eq. 12, 15, 16, solved for h_g.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.refraction.ray import ray_table
    >>> air = ray_table(standard_atmosphere("us1976"))
    >>> h_g, status = height_at_distance(air, 3000.0, 0.6, 0.8, 3000.0)
    >>> h_g.round(4).item(), status.item()
    (600.2176, 0)
    """
    shape, columns = as_columns(h_c, sin_zeta_c, cos_zeta_c, distance, radius)
    h_c, sin_z, cos_z, distance, radius = columns
    height = np.empty(h_c.shape)
    status = np.empty(h_c.shape, np.uint8)
    rays = RayColumns(
        h_c=h_c,
        h_g=height,  # is not read
        sin_c=sin_z,
        cos_c=cos_z,
        r_e=radius,
        distance=distance,
    )
    if isinstance(table, PublishedRays):
        height, status = _by_repetition(table, rays)
    else:
        from unbend.refraction.kernels.ray import ray_heights

        pieces = table.pieces

        def heights_of_block(rows: slice) -> None:
            part = RayColumns(*(column[rows] for column in rays))
            ray_heights(pieces, part, height[rows], status[rows])

        in_blocks(heights_of_block, h_c.size)
    return height.reshape(shape), status.reshape(shape)


def target_heights(
    x_px: Array,
    y_px: Array,
    distance_m: Array,
    exposure: Integers,
    exposures: Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
    ideal: bool = False,
) -> Array:
    """Heights of the targets of image observations whose slant range is known.

    x_px, y_px : (n,) pixels: measured, or those of the straight chord where ``ideal``.
    The rest as for `correct_observations`.

    Returns the heights above sea level [m], (n,), NaN where the observation lacks something that
    `correct_observations` will name, or its chord ends outside the profile.
    """
    rays = target_rays(x_px, y_px, exposure, exposures, camera=camera, ideal=ideal)
    h_c, radius = rays[CAMERA_HEIGHT], rays[SPHERE_RADIUS]
    if ideal:
        with np.errstate(invalid="ignore"):
            return chord_height(h_c, rays[NADIR_COSINE], distance_m, radius)
    return height_at_distance(
        table, h_c, rays[NADIR_SINE], rays[NADIR_COSINE], distance_m, radius=radius
    )[0]


def target_rays(
    x: Array, y: Array, exposure: Integers, exposures: Exposures, *, camera: Camera, ideal: bool
) -> Array:
    """The matrix of rays (RAY_ROWS, n) of pixels as in `target_heights`, NaN where there is none;
    where ``ideal`` they are the straight chords themselves."""
    if ideal:  # a straight line has no window and no lens, and may lie beside the format
        exposures = replace(
            exposures, refractivity_cabin=exposures.refractivity_outside, principal_change_px=None
        )
        camera = replace(
            camera,
            width_px=camera.width_px + 2 * _MARGIN_PX,
            height_px=camera.height_px + 2 * _MARGIN_PX,
            cx_px=camera.cx_px + _MARGIN_PX,
            cy_px=camera.cy_px + _MARGIN_PX,
        )
        x = x + _MARGIN_PX
        y = y + _MARGIN_PX
    anywhere = np.zeros(x.size)
    observed = observation_columns(x, y, anywhere, anywhere, exposure)
    rays, _, _ = outgoing_rays(observed, camera.constants, exposures.columns)
    return rays


def chord_height(h_c: Array, cos_zeta: Array, distance: Array, radius: Array) -> Array:
    """Height [m] of the end of a straight chord at the nadir angle of cosine ``cos_zeta``.

    Without cancellation: h_g - h_c = D (D - 2 r_c cos zeta) / (r_c + r_g).

    >>> one = np.ones(1)
    >>> chord_height(500.0 * one, one, 200.0 * one, 6.4e6 * one).tolist()
    [300.0]
    """
    r_c = radius + h_c
    fall = distance * (distance - 2.0 * r_c * cos_zeta)
    return np.asarray(h_c + fall / (r_c + np.sqrt(r_c * r_c + fall)))


def _by_repetition(table: PublishedRays, rays: RayColumns) -> tuple[Array, NDArray[np.uint8]]:
    """As `height_at_distance`, starting with the height along the apparent direction."""
    h_c, _, sin_z, cos_z, radius, distance = rays
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(distance) & (distance > 0.0)
        given = np.where(sound, distance, math.nan)
        height = chord_height(h_c, cos_z, given, radius)
        for _ in range(_ROUNDS):
            r_c, status = bend(table, h_c, height, sin_z, cos_z, radius=radius)
            cos_chord = cos_z * np.cos(r_c) + sin_z * np.sin(r_c)
            step = chord_height(h_c, cos_chord, given, radius) - height
            height = height + step
            if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE_M:
                break
    status[(status == OK) & ~(np.abs(step) <= _CLOSE_M)] = MISSES_GROUND
    status[~sound] = BAD_MEASUREMENT
    return np.where(status == OK, height, math.nan), status


# Some hundred bytes are needed for each.
_ROWS_AT_ONCE = 65_536

# One ray in so many goes first, for which tiles are read: the others seldom wait.
_SCOUTS = 64

# From here on down [m] a ray is under all land.
_LOWEST_M = -500.0
_HIGHEST_M = 9_000.0  # and above this over all land

# Rays steeper than this reach the lowest land from any height below 50 km.
_STEEP = 0.17
_FARTHEST_M = 200_000.0

# Knots of R_c / distance along a ray, as shares of the drop or of the distance.
_STEEP_SHARES = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 5) / 4)
_LEVEL_SHARES = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 9) / 8)

# Polynomials from east and north of a station to rows and columns: powers, nodes, and between.
_POWERS = [(d - p, p) for d in range(CHART_DEGREE + 1) for p in range(d + 1)]


def _square_of(side: Array) -> Array:
    """(n * n, 2) the points whose east and north are among n values."""
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


_NODES = _square_of(np.cos(np.pi * (np.arange(6) + 0.5) / 6))
_CHECKS = _square_of(np.linspace(-0.95, 0.95, 5))
_MOST_HALVINGS = 12
_PART_OF_REACH = 0.98  # of a polynomial, that rays are followed for
_LARGEST_ERROR = 0.01
"""Of row and column [cells]; where a polynomial is worse, it is for half the distance."""


class Terrain(Protocol):
    """A terrain of heights above sea level in tiles, whatever they are read from.

    Its ``grid`` says which tiles are in memory; ``lock`` is held while tiles are read and rays go
    over them; ``nodes`` are row and column, in nodes of the grid, of places on WGS 84; ``load``
    reads tiles into memory, as many as fit there, the first ones first.
    """

    @property
    def grid(self) -> TerrainGrid: ...
    @property
    def lock(self) -> AbstractContextManager[object]: ...
    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]: ...
    def load(self, tiles: Integers) -> None: ...


class TerrainHeights(NamedTuple):
    """Where rays land (n,): height above sea level [m], what it changes by with the height of the
    terrain there, slant range [m], and status, ``several_crossings`` where a ray would come out of
    the ground again; but for ``ok`` others have no height.
    """

    h_m: Array
    factor: Array
    distance_m: Array
    status: NDArray[np.uint8]


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
    numbers = np.full((3, n), np.nan)
    status = np.full(n, OK, np.uint8)
    if isinstance(table, PublishedRays):
        table = ray_table(table.profile)
    air = None if ideal else table
    for first in range(0, n, _ROWS_AT_ONCE):
        some = slice(first, min(first + _ROWS_AT_ONCE, n))
        rays = np.empty((CAMERA_HEIGHT + 1, some.stop - first))

        def leave(rows: slice, first: int = first, rays: Array = rays) -> None:
            at = slice(first + rows.start, first + rows.stop)
            rays[:, rows] = target_rays(
                x_px[at], y_px[at], exposure[at], exposures, camera=camera, ideal=ideal
            )

        in_blocks(leave, rays.shape[1])
        is_steep = rays[NADIR_COSINE] > _STEEP
        for steep in (True, False):
            rows = np.flatnonzero((is_steep == steep) & ~np.isnan(rays[NADIR_COSINE]))
            if rows.size:
                way, end, at_end = _ways(
                    rays[:, rows], exposure[first + rows], places, air, terrain, steep=steep
                )
                of_ways = _follow(way, end, at_end, terrain)
                numbers[:, first + rows] = of_ways[:3]
                status[first + rows] = of_ways.status
    return TerrainHeights(numbers[0], numbers[1], numbers[2], status)


def _ways(
    rays: Array,
    exposure: Integers,
    places: tuple[Array, Array],
    air: RayTable | None,
    terrain: Terrain,
    *,
    steep: bool,
) -> tuple[TerrainRays, Array, NDArray[np.uint8]]:
    """Rays over the terrain's grid, their ends [m] and the status of a ray that reaches its end."""
    knot, r_c, at_end = _bent_paths(rays, air, steep=steep)
    sine, cosine, radius, h_c = rays[[NADIR_SINE, NADIR_COSINE, SPHERE_RADIUS, CAMERA_HEIGHT]]
    end = knot[:, -1].copy()
    arc = radius * np.arctan2(end * sine, radius + h_c - end * cosine)
    latitude, longitude = places
    station, chart = np.unique(exposure, return_inverse=True)
    needed = np.zeros(station.size)
    np.fmax.at(needed, chart, 1.01 * arc)
    charts, reach = _charts(latitude[station], longitude[station], needed + 1.0, terrain)
    usable_reach = _PART_OF_REACH * reach[chart]
    short = usable_reach < arc
    end[short] *= usable_reach[short] / arc[short]
    at_end[short] = NO_GROUND
    with np.errstate(invalid="ignore"):
        east, north = rays[DIRECTION : DIRECTION + 2] / np.where(sine > 0, sine, 1)
    r_c /= knot
    way = TerrainRays(
        sin_c=sine,
        cos_c=cosine,
        h_c=h_c,
        r_e=radius,
        east=east,
        north=north,
        knot=knot,
        bend=r_c,
        chart=chart,
        charts=charts,
        reach=reach,
    )
    return way, end, at_end


def _bent_paths(
    rays: Array, air: RayTable | None, *, steep: bool
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Straight distances (n, k) along rays, R_c there, and the status of a ray beyond the last.

    Steep rays as far as the lowest land, others where they leave all land or for 200 km; straight
    without ``air``, NaN where that does not reach as far.
    """
    n = rays.shape[1]
    shares = _STEEP_SHARES if steep else _LEVEL_SHARES
    knot = np.empty((n, shares.size))
    r_c = np.zeros((n, shares.size))
    at_end = np.full(n, OUTSIDE_PROFILE, np.uint8)
    bottom = _LOWEST_M if air is None else max(_LOWEST_M, float(air.edge_m[0]))

    def fill(rows: slice) -> None:
        sine, cosine, radius, h_c = rays[
            [NADIR_SINE, NADIR_COSINE, SPHERE_RADIUS, CAMERA_HEIGHT], rows
        ]
        if steep:
            for k, share in enumerate(shares):
                h_k = h_c - share * (h_c - bottom)
                if air is not None:
                    r_c[rows, k] = bend(air, h_c, h_k, sine, cosine, radius=radius)[0]
                cos_k = cosine * np.cos(r_c[rows, k]) + sine * np.sin(r_c[rows, k])
                knot[rows, k] = straight_reach(h_c, h_k, cos_k, radius=radius, far=False)
            return
        with np.errstate(invalid="ignore"):
            # Beyond the horizon up to where all land is below, unless it meets the lowest before.
            down = straight_reach(h_c, bottom, cosine, radius=radius, far=False)
            up = np.nan_to_num(straight_reach(h_c, _HIGHEST_M, cosine, radius=radius, far=True))
            end = np.fmin(np.where(cosine > 0.0, down, np.nan), up)
            at_end[rows] = np.where(end == up, MISSES_GROUND, OUTSIDE_PROFILE)
            at_end[rows][end > _FARTHEST_M] = NO_GROUND
            end = np.clip(end, 1.0, _FARTHEST_M)
            for k, share in enumerate(shares):
                t = share * end
                knot[rows, k] = t
                if air is not None:
                    h_k = height_at_distance(air, h_c, sine, cosine, t, radius=radius)[0]
                    rise = (h_c - h_k) * (2.0 * radius + h_c + h_k)
                    turned = np.arccos((t * t + rise) / (2.0 * (radius + h_c) * t))
                    r_c[rows, k] = np.arctan2(sine, cosine) - turned

    in_blocks(fill, n)
    return knot, r_c, at_end


def _charts(lat_rad: Array, lon_rad: Array, needed: Array, terrain: Terrain) -> tuple[Array, Array]:
    """Charts (m, 2, 15) of `TerrainRays` about (m,) places, and how far each is good [m].

    Least squares over exact nodes, checked between them; a chart for ``needed`` (m,) that errs by
    more than 0.01 cell is made for half the distance.
    """
    reach = needed.copy()
    charts = np.empty((needed.size, 2, len(_POWERS)))
    solve = np.linalg.pinv(_terms(_NODES))
    left = np.arange(needed.size)
    for _ in range(_MOST_HALVINGS):
        at = np.concatenate([_NODES, _CHECKS]) * reach[left, None, None]
        lat = np.repeat(lat_rad[left], at.shape[1])
        lon = np.repeat(lon_rad[left], at.shape[1])
        east, north = at.reshape(-1, 2).T
        # The ends of arcs in the vertical planes of the places.
        azimuth = np.arctan2(east, north)
        radius = euler_radius(lat, azimuth)
        angle = np.hypot(east, north) / radius
        across = radius * np.sin(angle)
        up = -2.0 * radius * np.sin(0.5 * angle) ** 2
        enu = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), up], axis=-1)
        lat, lon, _ = offset_geodetic(lat, lon, np.zeros(lat.size), enu)
        nodes = np.stack(terrain.nodes(lat, lon), axis=-1).reshape(left.size, -1, 2)
        if terrain.grid.around:
            turns = (nodes[..., 1] - nodes[:, :1, 1]) / terrain.grid.around
            nodes[..., 1] -= terrain.grid.around * np.round(turns)
        charts[left] = np.einsum("tk,mkc->mct", solve, nodes[:, : len(_NODES)])
        there = np.einsum("kt,mct->mkc", _terms(_CHECKS), charts[left])
        error = np.abs(there - nodes[:, len(_NODES) :]).max(axis=(1, 2))
        left = left[~(error < _LARGEST_ERROR)]
        if left.size == 0:
            break
        reach[left] *= 0.5
    reach[left] = 0.0
    charts[left] = np.nan
    return charts, reach


def _terms(at: Array) -> Array:
    """(k, 15) terms of the polynomials at (k, 2) east and north in units of the reach."""
    return np.stack([at[:, 0] ** i * at[:, 1] ** j for i, j in _POWERS], axis=1)


def _follow(
    paths: TerrainRays, end: Array, at_end: NDArray[np.uint8], terrain: Terrain
) -> TerrainHeights:
    """Where rays land, with the tiles read that they come to."""
    from unbend.refraction.kernels.terrain import divide_differences, follow_rays

    n = end.size
    divide_differences(paths.knot, paths.bend)
    usable = np.isfinite(paths.bend).all(axis=1) & np.isfinite(end)
    follows = usable & (paths.reach[paths.chart] > 0.0)
    height, distance, factor = np.full((3, n), np.nan)
    state = TerrainState(
        end=end,
        t=np.zeros(n),
        side=np.zeros(n, np.int8),
        gap=np.zeros(n, bool),
        distance=distance,
        height=height,
        factor=factor,
        wanted=np.full(n, -1),
        result=np.where(follows, np.uint8(WAITS), np.uint8(NO_TERRAIN)),
    )
    followed = np.flatnonzero(follows)
    with terrain.lock:
        for some in (followed[::_SCOUTS], followed):
            while (going := some[state.result[some] == WAITS]).size:

                def follow_block(rows: slice, going: Rows = going) -> None:
                    follow_rays(paths, going[rows], terrain.grid, state)

                in_blocks(follow_block, going.size)
                tiles, count = np.unique(state.wanted[going], return_counts=True)
                tiles = tiles[np.argsort(-count, kind="stable")]
                terrain.load(tiles[tiles >= 0])
    status_of = np.empty(WAITS + 1, np.uint8)
    status_of[LANDED] = OK
    status_of[EMERGES] = SEVERAL_CROSSINGS
    status_of[HIDDEN] = MISSES_GROUND
    status_of[NO_TERRAIN] = NO_GROUND
    passes = state.result == PASSES
    status = np.where(passes, at_end, status_of[state.result]).astype(np.uint8)
    status[~usable] = OUTSIDE_PROFILE
    landed = (status == OK) | (status == SEVERAL_CROSSINGS)
    height[~landed] = np.nan
    distance[~landed] = np.nan
    return TerrainHeights(height, factor, distance, status)
