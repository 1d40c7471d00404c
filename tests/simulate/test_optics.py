"""The curved rays against 40-digit quadrature and each other."""

import math

import numpy as np
import pyproj
import pytest
from numpy.testing import assert_allclose

from tests.physics.ray_on_sphere import ray_angle_sphere
from unbend.simulate.optics import enu_axes, height_and_up, shoot, to_ecef
from unbend.simulate.true_air import true_air

ARCSEC = math.pi / 648_000.0
RADIUS = 6_371_000.0


def test_ecef_agrees_with_proj_and_bowring_goes_back():
    rng = np.random.default_rng(1)
    lat = rng.uniform(-1.55, 1.55, 500)
    lon = rng.uniform(-3.1, 3.1, 500)
    height = rng.uniform(-400.0, 30_000.0, 500)
    proj = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    expected = proj.transform(lon, lat, height, radians=True)
    places = to_ecef(lat, lon, height)
    assert_allclose(
        places.T,
        expected,
        rtol=0.0,
        atol=1e-8,
    )
    height_back, up = height_and_up(places)
    assert_allclose(height_back, height, rtol=0.0, atol=5e-9)
    assert_allclose(
        np.arcsin(up[:, 2]),
        lat,
        rtol=0.0,
        atol=1e-13,
    )


UNDULATION = 47.6
H_C = 3450.0
H_G = 450.0
LAT = np.radians(47.4)
LON = np.radians(8.5)
AIR = true_air(float(LAT))


@pytest.fixture(scope="module")
def rays():
    """Rays from 3450 m to the ground at 10-70 deg, all around, at 47.4 N."""
    zeta = np.repeat(
        np.radians([10.0, 45.0, 70.0]),
        12,
    )
    azimuth = np.tile(
        np.radians(np.arange(0, 360, 30)),
        3,
    )
    reach = 3000.0 * np.tan(zeta)
    ground_lat = LAT + np.cos(azimuth) * reach / 6.36e6
    ground_lon = LON + np.sin(azimuth) * reach / (6.39e6 * np.cos(LAT))
    ground = to_ecef(
        ground_lat,
        ground_lon,
        np.full(len(zeta), H_G + UNDULATION),
    )
    camera = to_ecef(LAT, LON, np.array(H_C + UNDULATION))
    return shoot(
        AIR,
        np.tile(camera, (len(zeta), 1)),
        ground,
        UNDULATION,
    )


def test_apparent_ray_is_farther_from_the_nadir(rays):
    up = enu_axes(LAT, LON)[2]
    assert rays.miss_m.max() < 1e-8
    assert np.all(rays.r_c_rad > 0.0)
    assert np.all(rays.apparent @ up > rays.straight @ up)


def test_ellipsoid_agrees_with_the_osculating_sphere(rays):
    east, north, up = (rays.apparent @ enu_axes(LAT, LON).T).T
    zeta = np.arctan2(np.hypot(east, north), -up)
    azimuth = np.arctan2(east, north)
    e2 = 0.00669437999014
    w = 1.0 - e2 * math.sin(LAT) ** 2
    meridian = 6_378_137.0 * (1.0 - e2) / w**1.5
    normal = 6_378_137.0 / w**0.5
    radius = 1.0 / (np.cos(azimuth) ** 2 / meridian + np.sin(azimuth) ** 2 / normal)
    for i in range(len(zeta)):
        sphere_radius = radius[i] + UNDULATION
        sphere = ray_angle_sphere(
            lambda h: float(AIR.n(np.array(h))), H_C, H_G, zeta[i], sphere_radius
        )
        assert rays.r_c_rad[i] / ARCSEC == pytest.approx(sphere / ARCSEC, abs=1e-5)


class Vacuum:
    def n(self, h_m):
        return np.ones_like(h_m)

    def dn_dh(self, h_m):
        return np.zeros_like(h_m)


def test_no_gradient_no_bending_in_space():
    camera = to_ecef(0.5, 0.1, np.array(3000.0))[None]
    ground = to_ecef(0.5004, 0.1004, np.array(0.0))[None]
    assert abs(shoot(Vacuum(), camera, ground, 0.0).r_c_rad[0]) < 1e-15
