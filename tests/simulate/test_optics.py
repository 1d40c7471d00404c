"""The curved rays against 40-digit quadrature, published angles, and each other."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from tests.physics.ray_on_sphere import ray_angle_sphere
from unbend.simulate.optics import (
    enu_axes,
    height_and_up,
    shoot,
    to_ecef,
)
from unbend.simulate.true_air import true_air

ARCSEC = math.pi / 648_000.0
RADIUS = 6_371_000.0


def quadrature(refractivity, h_c, h_g, zeta_c, breaks=()):
    """R_c [arcsec] from Gyer Eq. 12 and the triangle of Eq. 10, 40 digits."""
    with mp.workdps(40):
        r_c = mp.mpf(RADIUS) + h_c
        r_g = mp.mpf(RADIUS) + h_g
        zeta = mp.mpf(zeta_c)
        k = (1 + refractivity(mp.mpf(h_c))) * r_c * mp.sin(zeta)

        def integrand(h):
            r = RADIUS + h
            n = 1 + refractivity(h)
            return k / (r * mp.sqrt((n * r) ** 2 - k**2))

        low, high = sorted((h_c, h_g))
        theta = mp.quad(integrand, [low, *sorted(breaks), high])
        chord = mp.atan2(r_g * mp.sin(theta), r_c - r_g * mp.cos(theta))
        return float((zeta - chord) / (mp.pi / 648_000))


def exponential(h):
    return 2.8e-4 * mp.exp(-h / 8000) if isinstance(h, mp.mpf) else 2.8e-4 * math.exp(-h / 8000.0)


def broken(h):
    """Two straight lines with a kink at 1200 m."""
    slope = -2.9e-8 if h < 1200 else -2.1e-8
    return 2.5e-4 + slope * (h - 1200)


def us1976_gyer(h):
    """n of US 1976 up to 20 km and Gyer's Eq. 13, from the papers' constants."""
    big_h = 6_356_766.0 * h / (6_356_766.0 + h)
    gmr = 9.80665 * 28.9644 / 8314.32
    if big_h <= 11_000.0:
        t = 288.15 - 6.5e-3 * big_h
        p = 1013.25 * (t / 288.15) ** (gmr / 6.5e-3)
    else:
        t = 216.65
        at_11 = 1013.25 * (t / 288.15) ** (gmr / 6.5e-3)
        p = at_11 * math.exp(-gmr * (big_h - 11_000.0) / t)
        if big_h > 20_000.0:
            raise ValueError(big_h)
    return 1.0 + 78.831e-6 * p / t


@pytest.mark.parametrize("degrees", [0.0, 45.0, 85.0])
def test_no_gradient_no_refraction(degrees):
    angle = ray_angle_sphere(lambda h: 1.0003, 3000.0, 0.0, math.radians(degrees), RADIUS)
    assert abs(angle) < 1e-25


@pytest.mark.parametrize("h_c", [120.0, 3000.0, 10_000.0])
@pytest.mark.parametrize("degrees", [10.0, 45.0, 75.0, 85.0])
def test_sphere_agrees_with_forty_digits(h_c, degrees):
    zeta = math.radians(degrees)
    angle = ray_angle_sphere(lambda h: 1.0 + exponential(h), h_c, 0.0, zeta, RADIUS) / ARCSEC
    assert angle == pytest.approx(quadrature(exponential, h_c, 0.0, zeta), abs=2e-9)


def test_sphere_with_a_kink():
    zeta = math.radians(60.0)
    angle = ray_angle_sphere(lambda h: 1.0 + broken(h), 3000.0, 0.0, zeta, RADIUS, breaks=(1200.0,))
    expected = quadrature(broken, 3000.0, 0.0, zeta, breaks=(1200.0,))
    assert angle / ARCSEC == pytest.approx(expected, abs=1e-9)


def test_target_above_the_camera():
    zeta = math.radians(95.0)
    angle = ray_angle_sphere(lambda h: 1.0 + exponential(h), 1000.0, 3000.0, zeta, RADIUS)
    expected = quadrature(exponential, 1000.0, 3000.0, zeta)
    assert expected > 30.0
    assert angle / ARCSEC == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("h_c", "degrees", "arcsec"),
    [
        (10_000.0, 75.0, 61.778543),
        (10_000.0, 45.0, 16.378452),
        (3000.0, 45.0, 7.088778),
        (120.0, 45.0, 0.327323),
        (20_000.0, 85.0, 327.014637),
    ],
)
def test_sphere_reproduces_the_reference_angles(h_c, degrees, arcsec):
    kink = 6_356_766.0 * 11_000.0 / (6_356_766.0 - 11_000.0)
    angle = ray_angle_sphere(us1976_gyer, h_c, 0.0, math.radians(degrees), RADIUS, breaks=(kink,))
    assert angle / ARCSEC == pytest.approx(arcsec, abs=1e-6)


def test_a_ray_that_misses_the_ground_is_refused():
    with pytest.raises(ValueError, match="misses height"):
        ray_angle_sphere(lambda h: 1.0 + exponential(h), 3000.0, 0.0, math.radians(89.0), RADIUS)


def test_bowring_agrees_with_the_forward_formula():
    rng = np.random.default_rng(1)
    lat = rng.uniform(-1.55, 1.55, 500)
    lon = rng.uniform(-3.1, 3.1, 500)
    height = rng.uniform(-400.0, 30_000.0, 500)
    found, up = height_and_up(to_ecef(lat, lon, height))
    np.testing.assert_allclose(found, height, rtol=0.0, atol=5e-9)
    np.testing.assert_allclose(np.arcsin(up[:, 2]), lat, rtol=0.0, atol=1e-13)


def test_ecef_agrees_with_proj():
    pyproj = pytest.importorskip("pyproj")
    proj = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    expected = proj.transform(8.5, 47.4, 1234.5)
    found = to_ecef(np.radians(47.4), np.radians(8.5), np.array(1234.5))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8)


@pytest.fixture(scope="module")
def fan():
    """Rays from 3450 m to the ground at 10-70 deg, all around, at 47.4 N."""
    undulation = 47.6
    h_c = 3450.0
    h_g = 450.0
    lat = np.radians(47.4)
    lon = np.radians(8.5)
    zeta, azimuth = (
        a.ravel()
        for a in np.meshgrid(np.radians([10.0, 45.0, 70.0]), np.radians(np.arange(0, 360, 30)))
    )
    camera = to_ecef(lat, lon, np.array(h_c + undulation))
    reach = 3000.0 * np.tan(zeta)
    direction = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1) * reach[:, None]
    ground_lat = lat + direction[:, 1] / 6.36e6
    ground_lon = lon + direction[:, 0] / (6.39e6 * np.cos(lat))
    ground = to_ecef(ground_lat, ground_lon, np.full(len(zeta), h_g + undulation))
    air = true_air(float(lat))
    rays = shoot(air, np.broadcast_to(camera, ground.shape).copy(), ground, undulation)
    return air, rays, enu_axes(lat, lon), (lat, h_c, h_g)


def test_shooting_hits(fan):
    _, rays, _, _ = fan
    assert rays.miss_m.max() < 1e-8


def test_apparent_ray_is_farther_from_the_nadir(fan):
    _, rays, axes, _ = fan
    assert np.all(rays.r_c_rad > 0.0)
    assert np.all((rays.apparent @ axes.T)[:, 2] > (rays.straight @ axes.T)[:, 2])


def test_ellipsoid_agrees_with_the_osculating_sphere(fan):
    air, rays, axes, (lat, h_c, h_g) = fan
    local = rays.apparent @ axes.T
    zeta = np.arctan2(np.hypot(local[:, 0], local[:, 1]), -local[:, 2])
    azimuth = np.arctan2(local[:, 0], local[:, 1])
    e2 = 0.00669437999014
    w = 1.0 - e2 * math.sin(lat) ** 2
    meridian = 6_378_137.0 * (1.0 - e2) / w**1.5
    normal = 6_378_137.0 / w**0.5
    radius = 1.0 / (np.cos(azimuth) ** 2 / meridian + np.sin(azimuth) ** 2 / normal)
    for i in range(len(zeta)):
        sphere = ray_angle_sphere(
            lambda h: float(air.n(np.array(h))), h_c, h_g, zeta[i], radius[i] + 47.6
        )
        assert rays.r_c_rad[i] / ARCSEC == pytest.approx(sphere / ARCSEC, abs=1e-5)


def test_no_gradient_no_bending_in_space():
    class Vacuum:
        def n(self, h_m):
            return np.ones_like(h_m)

        def dn_dh(self, h_m):
            return np.zeros_like(h_m)

    camera = to_ecef(0.5, 0.1, np.array(3000.0))[None]
    ground = to_ecef(0.5004, 0.1004, np.array(0.0))[None]
    assert abs(shoot(Vacuum(), camera, ground, 0.0).r_c_rad[0]) < 1e-15
