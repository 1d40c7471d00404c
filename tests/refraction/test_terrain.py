"""Rays over a terrain, against steps of an integrated ray on the ellipsoid."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import Camera, Exposures, correct_observations
from unbend.refraction.ray import rays_by
from unbend.refraction.status_codes import (
    NO_GROUND,
    OK,
    SEVERAL_CROSSINGS,
)
from unbend.refraction.terrain_heights import terrain_heights

from .array_terrain import ArrayTerrain

AIR = standard_atmosphere("us1976")
TABLE = rays_by(AIR, "spherical")
CAMERA = Camera(20_000, 20_000, 2_500.0, 2_500.0, 10_000.0, 10_000.0)  # to 76 deg off the axis
DOWN = np.diag([1.0, -1.0, -1.0])
TO_THE_EAST = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
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


def exposures_at(lat_deg, height_m, rotation=None):
    n = len(height_m)
    outside = AIR.refractivity(np.asarray(height_m, float))
    turned = np.tile(DOWN, (n, 1, 1)) if rotation is None else rotation
    return Exposures(
        np.ones(n, bool), turned, np.radians(lat_deg), np.asarray(height_m, float), outside, outside
    )


def surface_of(terrain, lon, lat):
    """Bilinear height of the terrain at places [deg]; NaN beside it."""
    row, column = terrain.nodes(np.radians(lat), np.radians(lon))
    i = np.floor(row).astype(int)
    j = np.floor(column).astype(int)
    u = row - i
    v = column - j
    north = (1 - v) * terrain.stored(i, j) + v * terrain.stored(i, j + 1)
    return (1 - u) * north + u * (
        (1 - v) * terrain.stored(i + 1, j) + v * terrain.stored(i + 1, j + 1)
    )


def marched(terrain, lat_deg, lon_deg, height_m, direction, *, step=40.0, bent=True, fine=20):
    """First points (n, 3) of rays under the terrain: lon, lat [deg], height [m].

    Runge and Kutta's steps of d(n t)/ds = grad n over the ellipsoid; between them cubic pieces,
    looked at every ``step / fine`` m and then halved.
    """
    at = np.stack(TO_ECEF.transform(lon_deg, lat_deg, height_m), axis=1)
    east, north, up = axes(lat_deg, lon_deg)
    e, n_, u = direction.T
    tangent = e[:, None] * east + n_[:, None] * north + u[:, None] * up

    def slope(p, q):
        lon, lat, h = TO_GEODETIC.transform(*p.T)
        h = np.clip(h, -900.0, 40_000.0)
        n = 1.0 + AIR.refractivity(h)
        gradient = (AIR.refractivity(h + 0.5) - AIR.refractivity(h - 0.5))[:, None]
        return q / n[:, None], gradient * axes(lat, lon)[2] * bent

    q = tangent * (1.0 + AIR.refractivity(np.asarray(height_m)))[:, None]
    found = np.full((len(at), 3), np.nan)
    left = np.ones(len(at), bool)
    share = np.linspace(0.0, 1.0, fine + 1)[None, :, None]
    for _ in range(20_000):
        p_0 = at[left]
        q_0 = q[left]
        k1 = slope(p_0, q_0)
        k2 = slope(p_0 + 0.5 * step * k1[0], q_0 + 0.5 * step * k1[1])
        k3 = slope(p_0 + 0.5 * step * k2[0], q_0 + 0.5 * step * k2[1])
        k4 = slope(p_0 + step * k3[0], q_0 + step * k3[1])
        p_1 = p_0 + step / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0])
        q_1 = q_0 + step / 6.0 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1])
        out = slope(p_1, q_1)[0]

        def piece(s, p_0=p_0, p_1=p_1, d_0=k1[0], d_1=out):
            return (
                (1 + 2 * s) * (1 - s) ** 2 * p_0[:, None]
                + s * (1 - s) ** 2 * step * d_0[:, None]
                + s * s * (3 - 2 * s) * p_1[:, None]
                + s * s * (s - 1) * step * d_1[:, None]
            )

        def above(points):
            lon, lat, h = TO_GEODETIC.transform(*points.reshape(-1, 3).T)
            return (h - surface_of(terrain, lon, lat)).reshape(points.shape[:2])

        height = above(piece(share))
        under = height < 0.0
        hit = under.any(axis=1)
        if hit.any():
            first = np.argmax(under[hit], axis=1)
            low = (first - 1) / fine
            high = first / fine
            ends = [a[hit] for a in (p_0, p_1, k1[0], out)]
            for _ in range(40):
                middle = 0.5 * (low + high)
                inside = above(piece(middle[:, None, None], *ends))[:, 0] < 0.0
                high = np.where(inside, middle, high)
                low = np.where(inside, low, middle)
            points = piece(high[:, None, None], *ends)[:, 0]
            rows = np.flatnonzero(left)[hit]
            found[rows] = np.stack(TO_GEODETIC.transform(*points.T), axis=1)
        at[left], q[left] = p_1, q_1
        low_or_lost = TO_GEODETIC.transform(*p_1.T)[2] < -600.0
        left[np.flatnonzero(left)[hit | low_or_lost]] = False
        if not left.any():
            break
    return found


def axes(lat_deg, lon_deg):
    """East, north and up (n, 3) at places."""
    phi = np.radians(lat_deg)
    lam = np.radians(lon_deg)
    east = np.stack([-np.sin(lam), np.cos(lam), np.zeros_like(lam)], axis=1)
    north = np.stack([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)], axis=1)
    return east, north, np.cross(east, north)


def pixels_of(direction):
    """Pixels of `CAMERA` looking down that see directions east, north, up."""
    x, y, z = DOWN @ direction.T
    return CAMERA.fx_px * x / z + CAMERA.cx_px, CAMERA.fy_px * y / z + CAMERA.cy_px


def rays_from(count, lat, lon, span, heights, seed):
    """Cameras about a place, and a ray each, to 75 degrees off the nadir."""
    rng = np.random.default_rng(seed)
    lat = lat + rng.uniform(-span, span, count)
    lon = lon + rng.uniform(-span, span, count)
    height = rng.uniform(*heights, count)
    zeta = np.radians(rng.uniform(0.0, 74.5, count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    direction = np.stack(
        [np.sin(zeta) * np.sin(azimuth), np.sin(zeta) * np.cos(azimuth), -np.cos(zeta)], axis=1
    )
    return lat, (lon + 180.0) % 360.0 - 180.0, height, direction


def landing(terrain, lat, lon, height, direction, **options):
    """Heights of `terrain_heights` for one ray from each camera."""
    x, y = pixels_of(direction)
    where = np.radians(lat), np.radians(lon)
    rows = np.arange(len(lat))
    exposures = exposures_at(lat, height)
    found = terrain_heights(
        x, y, rows, exposures, where, camera=CAMERA, table=TABLE, terrain=terrain, **options
    )
    return found, (x, y, rows, exposures)


def horizontal(a, b):
    """Metres between places, lon and lat [deg]."""
    return pyproj.Geod(ellps="WGS84").inv(a[:, 0], a[:, 1], b[:, 0], b[:, 1])[2]


def ends_of(lat, lon, height, direction, found, corrected):
    """Ends of the straight chords to where rays land: lon, lat [deg]."""
    zeta = np.arccos(-direction[:, 2]) - corrected.r_c_rad
    azimuth = np.arctan2(direction[:, 0], direction[:, 1])
    chord = found.distance_m[:, None] * np.stack(
        [np.sin(zeta) * np.sin(azimuth), np.sin(zeta) * np.cos(azimuth), -np.cos(zeta)], axis=1
    )
    start = np.stack(TO_ECEF.transform(lon, lat, height), axis=1)
    end = start + sum(chord[:, k, None] * axis for k, axis in enumerate(axes(lat, lon)))
    return np.stack(TO_GEODETIC.transform(*end.T), axis=1)


@pytest.mark.parametrize(("lat", "lon", "around"), [(46.5, 8.0, 0), (-17.0, 180.0, 432_000)])
def test_rays_land_where_an_integrated_ray_does(lat, lon, around):
    west = lon - 750 * STEP
    first = 0
    if around:  # the date line lies in the middle, and the grid goes round the earth
        west = -180.0
        first = -750
    north = lat + 750 * STEP
    terrain = ArrayTerrain(relief(1500, 1500), north, west, STEP, STEP, around=around, first=first)
    rays = rays_from(500, lat, lon, 0.1, (3_000.0, 10_000.0), 1)
    truth = marched(terrain, *rays)
    found, (x, y, rows, exposures) = landing(terrain, *rays)
    assert np.isin(found.status, (OK, SEVERAL_CROSSINGS)).all()
    assert (found.status == SEVERAL_CROSSINGS).sum() >= 5
    corrected = correct_observations(x, y, found.h_m, rows, exposures, camera=CAMERA, table=TABLE)
    at_truth = correct_observations(x, y, truth[:, 2], rows, exposures, camera=CAMERA, table=TABLE)
    ends = ends_of(*rays, found, corrected)
    apart = horizontal(ends, truth)
    print(np.sort(apart)[-5:], np.abs(found.h_m - truth[:, 2]).max())
    assert apart.max() < 0.1
    assert np.abs(corrected.r_c_rad / at_truth.r_c_rad - 1.0).max() < 1e-4
    # Straight rays would land elsewhere.
    straight = landing(terrain, *rays, ideal=True)[0]
    assert np.nanmax(np.abs(straight.h_m - truth[:, 2])) > 0.5


def test_the_error_of_a_landing_is_that_of_the_terrain_by_its_slope():
    """On a plane that falls to the east 1 / (1 + tan slope tan zeta); on relief by raising it."""
    fall = 0.15
    metres = np.radians(STEP) * 6_378_137.0 * np.cos(np.radians(1e-3))  # of a cell at the equator
    j = np.mgrid[0:400, 0:400][1]
    heights = (2_000.0 - fall * metres * (j - 192)).astype(np.float32)
    plane = ArrayTerrain(heights, 0.16, -0.16, STEP, STEP)
    n = 60
    zeta = np.radians(np.linspace(1.0, 70.0, n))
    for sign in (1.0, -1.0):  # away from the camera, and towards it
        direction = np.stack([sign * np.sin(zeta), np.zeros(n), -np.cos(zeta)], axis=1)
        found, _ = landing(plane, np.zeros(n), np.zeros(n), np.full(n, 3_500.0), direction)
        assert (found.status == OK).all()
        wanted = 1.0 / (1.0 - sign * fall * np.tan(zeta))
        np.testing.assert_allclose(found.factor, wanted, rtol=0.01)
    rays = rays_from(300, 46.5, 8.0, 0.1, (3_000.0, 10_000.0), 2)
    corner = (46.5 + 750 * STEP, 8.0 - 750 * STEP)
    heights = relief(1500, 1500, cliffs=False)
    low, high = (
        landing(ArrayTerrain(heights + np.float32(add), *corner, STEP, STEP), *rays)[0]
        for add in (-0.25, 0.25)
    )
    at = landing(ArrayTerrain(heights, *corner, STEP, STEP), *rays)[0].factor
    # Not those that land elsewhere when it is raised, or on the next cell's slope.
    near = np.abs(high.distance_m - low.distance_m) < 4.0
    assert near.sum() > 200
    change = (high.h_m - low.h_m)[near] / 0.5
    assert np.quantile(np.abs(change / at[near] - 1.0), 0.9) < 0.05
    assert change.max() > 1.2


class CountedTerrain(ArrayTerrain):
    """A terrain that fails where rays ask for tiles again and again."""

    def load(self, tiles):
        self.rounds = getattr(self, "rounds", 0) + 1
        assert self.rounds < 100, "rays are followed for ever"
        super().load(tiles)


def test_a_ray_that_rises_beside_the_terrain_comes_to_an_end():
    """Two cameras beside the terrain and one above it, all looking 5 degrees above the horizon.

    All leave it before they are higher than any land may be.
    """
    terrain = CountedTerrain(relief(600, 600, cliffs=False), 46.5, 8.0, STEP, STEP)
    lat = np.full(3, 46.3)
    lon = np.array([7.9, 8.6, 8.2])
    height = np.full(3, 2500.0)
    exposures = exposures_at(lat, height, np.tile(TO_THE_EAST, (3, 1, 1)))
    x = np.full(3, CAMERA.cx_px)
    y = np.full(3, CAMERA.cy_px - CAMERA.fy_px * np.tan(np.radians(5.0)))
    found = terrain_heights(
        x,
        y,
        np.arange(3),
        exposures,
        (np.radians(lat), np.radians(lon)),
        camera=CAMERA,
        table=TABLE,
        terrain=terrain,
    )
    assert found.status.tolist() == [NO_GROUND] * 3
    assert np.isnan(found.h_m).all()


def test_nearly_level_rays_reach_high_ground_where_an_integrated_ray_does():
    """From 6500 m onto a plateau at 4000 m, 81 to 87 degrees off the nadir: 16 to 51 km away."""
    down = np.radians([9.0, 6.0, 3.0])
    corner = (46.5 + 30 * STEP, 8.0 - 30 * STEP)
    plateau = ArrayTerrain(np.full((60, 900), 4_000.0, np.float32), *corner, STEP, STEP)
    lat = np.full(3, 46.5)
    lon = np.full(3, 8.0)
    height = np.full(3, 6_500.0)
    direction = np.stack([np.cos(down), np.zeros(3), -np.sin(down)], axis=1)
    truth = marched(plateau, lat, lon, height, direction, step=500.0, fine=5)
    start = np.stack(TO_ECEF.transform(lon, lat, height), axis=1)
    end = np.stack(TO_ECEF.transform(*truth.T), axis=1)
    found = terrain_heights(
        np.full(3, CAMERA.cx_px),
        CAMERA.cy_px + CAMERA.fy_px * np.tan(down),
        np.arange(3),
        exposures_at(lat, height, np.tile(TO_THE_EAST, (3, 1, 1))),
        (np.radians(lat), np.radians(lon)),
        camera=CAMERA,
        table=TABLE,
        terrain=plateau,
    )
    assert (found.status == OK).all()
    distance_m = np.linalg.norm(end - start, axis=1)
    np.testing.assert_allclose(found.distance_m, distance_m, rtol=0.0, atol=0.01)
