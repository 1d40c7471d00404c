"""Rays over a terrain, against steps of an integrated ray on the ellipsoid."""

import numpy as np
import pyproj
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.refraction.array_terrain import ArrayTerrain
from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import DOWN, looking
from unbend.atmosphere import standard_atmosphere
from unbend.geodesy import enu_from_ecef
from unbend.refraction import Camera, Exposures, correct_observations, ray_table
from unbend.refraction.status_codes import MISSES_GROUND, NO_GROUND, OK, SEVERAL_CROSSINGS
from unbend.refraction.terrain_heights import terrain_heights

AIR = standard_atmosphere("us1976")
TABLE = ray_table(AIR)
CAMERA = Camera(  # to 76 deg off the axis
    20_000,
    20_000,
    2_500.0,
    2_500.0,
    10_000.0,
    10_000.0,
)
TO_THE_EAST = looking(90.0, azimuth_deg=90.0)
EAST = 0.5 * np.pi  # azimuth [rad]
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
TO_GEODETIC = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
STEP = 1.0 / 1200.0  # 3 arcsec


def relief(rows, columns, *, cliffs=True):
    """Hills of 600 m and ripples of 20 m, cut by cliffs of 250 m from one node to the next."""
    i, j = np.mgrid[0:rows, 0:columns].astype(float)
    z = 500.0 + 300.0 * np.sin(i / 37.0) * np.cos(j / 29.0) + 20.0 * np.sin(i / 3.1 + j / 2.3)
    if cliffs:
        z += 250.0 * ((i // 40 + j // 55) % 2)
    return z.astype(np.float32)


def surface_of(terrain, lon, lat):
    """Bilinear height of the terrain at places [deg]; NaN beside it."""
    row, column = terrain.nodes(np.radians(lat), np.radians(lon))
    i = np.floor(row).astype(int)
    j = np.floor(column).astype(int)
    south = row - i
    east = column - j

    def between_columns(i):
        west_node = terrain.stored(i, j)
        east_node = terrain.stored(i, j + 1)
        return (1 - east) * west_node + east * east_node

    return (1 - south) * between_columns(i) + south * between_columns(i + 1)


def ecef_of(lon_deg, lat_deg, height_m):
    xyz = TO_ECEF.transform(lon_deg, lat_deg, height_m)
    return np.stack(xyz, axis=-1)


def geodetic_of(ecef):
    """Longitude, latitude [deg] and height [m] (..., 3) of places."""
    lon_lat_h = TO_GEODETIC.transform(*np.moveaxis(ecef, -1, 0))
    return np.stack(lon_lat_h, axis=-1)


def in_ecef(lat_deg, lon_deg, enu):
    """Vectors east, north, up (n, 3) of places in earth-centred axes."""
    axes = enu_from_ecef(np.radians(lat_deg), np.radians(lon_deg))
    return np.einsum("nk,nkc->nc", enu, axes)


def slopes(_, state):
    """Derivatives of places and of n times directions along rays: grad n over the ellipsoid."""
    place, momentum = state.reshape(2, -1, 3)
    lon, lat, h = geodetic_of(place).T
    h = np.clip(h, -900.0, 40_000.0)
    n = 1.0 + AIR.refractivity(h)
    per_m = AIR.refractivity(h + 0.5) - AIR.refractivity(h - 0.5)
    up = enu_from_ecef(np.radians(lat), np.radians(lon))[:, 2]
    velocity = momentum / n[:, None]
    gradient = per_m[:, None] * up
    return np.stack([velocity, gradient]).ravel()


class IntegratedRays:
    """Rays through the air, by d(n t)/ds = grad n, to where all have left the land."""

    def __init__(self, terrain, lat, lon, height, direction):
        place = ecef_of(lon, lat, height)
        n_c = 1.0 + AIR.refractivity(height)
        momentum = n_c[:, None] * in_ecef(lat, lon, direction)
        to_lowest_land = (height + 600.0) / -direction[:, 2]
        self.terrain = terrain
        self.count = len(place)
        self.length_m = to_lowest_land.max()
        self.solution = solve_ivp(
            slopes,
            (0.0, self.length_m),
            np.stack([place, momentum]).ravel(),
            method="DOP853",
            rtol=1e-12,
            atol=1e-6,
            dense_output=True,
        )

    def points(self, length_m, rows):
        """Lon, lat [deg] and height [m] (n, k, 3) of some rays at lengths (k,)."""
        state = self.solution.sol(length_m)
        places = state.reshape(2, -1, 3, length_m.size)[0, rows]
        return geodetic_of(np.moveaxis(places, 1, -1))

    def over_terrain(self, length_m, rows):
        """Heights (n, k) over the terrain; NaN beside it."""
        lon, lat, h = np.moveaxis(self.points(length_m, rows), -1, 0)
        return h - surface_of(self.terrain, lon, lat)

    def crossing(self, row, low, high):
        """Where a ray goes under the terrain, between two lengths."""

        def over(length_m):
            return self.over_terrain(np.array([length_m]), [row])[0, 0]

        length_m = np.array([brentq(over, low, high)])
        return self.points(length_m, [row])[0, 0]

    def landed(self, look_m):
        """First points (n, 3) under the terrain, which is looked for every so many metres."""
        landed = np.full((self.count, 3), np.nan)
        for start in np.arange(0.0, self.length_m, 100.0 * look_m):
            looks = start + look_m * np.arange(101)
            on_their_way = np.flatnonzero(np.isnan(landed[:, 0]))
            if not on_their_way.size:
                break
            under = self.over_terrain(looks, on_their_way) < 0.0
            for row, is_under in zip(on_their_way, under, strict=True):
                if is_under.any():
                    high = looks[np.argmax(is_under)]
                    landed[row] = self.crossing(row, high - look_m, high)
        return landed


def direction_of(zeta, azimuth):
    """Unit vectors (n, 3) east, north, up at a nadir angle and an azimuth [rad]."""
    east = np.sin(zeta) * np.sin(azimuth)
    north = np.sin(zeta) * np.cos(azimuth)
    return np.stack([east, north, -np.cos(zeta)], axis=1)


def rays_from(count, lat, lon, span, heights, seed):
    """Cameras about a place, and a ray each, to 75 degrees off the nadir."""
    rng = np.random.default_rng(seed)
    lat = lat + rng.uniform(-span, span, count)
    lon = lon + rng.uniform(-span, span, count)
    lon = (lon + 180.0) % 360.0 - 180.0
    height = rng.uniform(*heights, count)
    zeta = np.radians(rng.uniform(0.0, 74.5, count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    return lat, lon, height, direction_of(zeta, azimuth)


def exposures_at(lat_deg, height_m, rotation=DOWN):
    outside = AIR.refractivity(height_m)
    count = len(height_m)
    return Exposures(
        usable=np.ones(count, bool),
        rotation=np.tile(rotation, (count, 1, 1)),
        latitude_rad=np.radians(lat_deg),
        height_m=height_m,
        refractivity_outside=outside,
        refractivity_cabin=outside,
    )


def heights_at(terrain, x, y, exposures, lat_deg, lon_deg, **options):
    """Heights of `terrain_heights` for one pixel of each exposure."""
    return terrain_heights(
        x,
        y,
        np.arange(len(x)),
        exposures,
        (np.radians(lat_deg), np.radians(lon_deg)),
        camera=CAMERA,
        table=TABLE,
        terrain=terrain,
        **options,
    )


def landing(terrain, lat, lon, height, direction, **options):
    """Where one ray from each camera lands, and its pixel, row and exposure."""
    u, v, w = DOWN @ direction.T
    x = CAMERA.cx_px + CAMERA.fx_px * u / w
    y = CAMERA.cy_px + CAMERA.fy_px * v / w
    exposures = exposures_at(lat, height)
    heights = heights_at(
        terrain,
        x,
        y,
        exposures,
        lat,
        lon,
        **options,
    )
    return heights, (x, y, np.arange(len(x)), exposures)


def ends_of(lat, lon, height, direction, distance_m, r_c_rad):
    """Ends of the straight chords to where rays land: lon, lat [deg], height [m]."""
    east, north, up = direction.T
    zeta = np.arccos(-up) - r_c_rad
    azimuth = np.arctan2(east, north)
    chord = distance_m[:, None] * direction_of(zeta, azimuth)
    camera = ecef_of(lon, lat, height)
    return geodetic_of(camera + in_ecef(lat, lon, chord))


@pytest.mark.parametrize(
    ("lat", "lon", "grid"),
    [
        (46.5, 8.0, {"west": 8.0 - 750 * STEP}),
        # The date line is in the middle, and the grid goes round the earth.
        (-17.0, 180.0, {"west": -180.0, "around": 432_000, "first": -750}),
    ],
)
def test_rays_land_where_an_integrated_ray_does(lat, lon, grid):
    heights = relief(1500, 1500)
    north = lat + 750 * STEP
    terrain = ArrayTerrain(
        heights,
        north,
        step_lat=STEP,
        step_lon=STEP,
        **grid,
    )
    rays = rays_from(
        500,
        lat,
        lon,
        0.1,
        (3_000.0, 10_000.0),
        seed=1,
    )
    landed = IntegratedRays(terrain, *rays).landed(look_m=2.0)

    landings, (x, y, rows, exposures) = landing(terrain, *rays)

    assert set(landings.status.tolist()) == {OK, SEVERAL_CROSSINGS}
    assert (landings.status == SEVERAL_CROSSINGS).sum() >= 5

    def r_c_to(h_m):
        corrections = correct_observations(
            x,
            y,
            h_m,
            rows,
            exposures,
            camera=CAMERA,
            table=TABLE,
        )
        return corrections.r_c_rad

    r_c = r_c_to(landings.h_m)
    lon_end, lat_end, _ = ends_of(*rays, landings.distance_m, r_c).T
    lon_landed, lat_landed, h_landed = landed.T.copy()
    geod = pyproj.Geod(ellps="WGS84")
    _, _, apart_m = geod.inv(lon_end, lat_end, lon_landed, lat_landed)
    assert np.max(apart_m) < 0.1
    assert_close(r_c, r_c_to(h_landed), rtol=1e-4)

    # Straight rays would land elsewhere.
    straight, _ = landing(terrain, *rays, ideal=True)
    assert np.nanmax(np.abs(straight.h_m - h_landed)) > 0.5


def test_the_error_of_a_landing_is_what_raising_the_terrain_does():
    rays = rays_from(
        300,
        46.5,
        8.0,
        0.1,
        (3_000.0, 10_000.0),
        seed=2,
    )
    heights = relief(1500, 1500, cliffs=False)
    north = 46.5 + 750 * STEP
    west = 8.0 - 750 * STEP

    def raised_by(metres):
        raised = heights + np.float32(metres)
        terrain = ArrayTerrain(raised, north, west, STEP, STEP)
        landings, _ = landing(terrain, *rays)
        return landings

    low = raised_by(-0.25)
    high = raised_by(0.25)
    # Not those that land elsewhere when it is raised, or on the next cell's slope.
    near = np.abs(high.distance_m - low.distance_m) < 4.0
    assert near.sum() > 200
    change = (high.h_m - low.h_m)[near] / 0.5
    ratio = change / raised_by(0.0).factor[near]
    assert np.quantile(np.abs(ratio - 1.0), 0.9) < 0.05
    assert change.max() > 1.2


class CountedTerrain(ArrayTerrain):
    """A terrain that fails where rays ask for tiles again and again."""

    rounds = 0

    def load(self, tiles):
        self.rounds += 1
        assert self.rounds < 100, "rays are followed for ever"
        super().load(tiles)


def test_a_ray_that_rises_comes_to_an_end():
    """Cameras beside the terrain, above and below it, all looking 5 degrees above the horizon.

    All but the last two leave it before they are higher than any land may be; the last is so from
    the beginning.
    """
    terrain = CountedTerrain(
        relief(600, 600, cliffs=False),
        46.5,
        8.0,
        STEP,
        STEP,
    )
    lat = np.full(5, 46.3)
    lon = np.array([7.9, 8.6, 8.2, 8.2, 8.2])
    height = np.array([2500.0, 2500.0, 2500.0, 50.0, 9500.0])
    exposures = exposures_at(lat, height, TO_THE_EAST)
    x = np.full(5, CAMERA.cx_px)
    above_axis_px = CAMERA.fy_px * np.tan(np.radians(5.0))
    y = np.full(5, CAMERA.cy_px - above_axis_px)

    landings = heights_at(
        terrain,
        x,
        y,
        exposures,
        lat,
        lon,
    )

    assert landings.status.tolist() == [NO_GROUND] * 3 + [MISSES_GROUND] * 2
    assert np.isnan(landings.h_m).all()


def test_nearly_level_rays_reach_high_ground_where_an_integrated_ray_does():
    """From 6500 m onto a plateau at 4000 m, 81 to 87 degrees off the nadir: 16 to 51 km away."""
    down = np.radians([9.0, 6.0, 3.0])
    plateau = np.full((60, 900), 4_000.0, np.float32)
    terrain = ArrayTerrain(
        plateau,
        46.5 + 30 * STEP,
        8.0 - 30 * STEP,
        STEP,
        STEP,
    )
    lat = np.full(3, 46.5)
    lon = np.full(3, 8.0)
    height = np.full(3, 6_500.0)
    direction = direction_of(0.5 * np.pi - down, np.full(3, EAST))
    rays = IntegratedRays(terrain, lat, lon, height, direction)
    landed = rays.landed(look_m=100.0)
    way = ecef_of(*landed.T) - ecef_of(lon, lat, height)
    exposures = exposures_at(lat, height, TO_THE_EAST)
    x = np.full(3, CAMERA.cx_px)
    y = CAMERA.cy_px + CAMERA.fy_px * np.tan(down)

    landings = heights_at(
        terrain,
        x,
        y,
        exposures,
        lat,
        lon,
    )

    assert (landings.status == OK).all()
    distance_m = np.linalg.norm(way, axis=1)
    assert_near(landings.distance_m, distance_m, 0.01)
