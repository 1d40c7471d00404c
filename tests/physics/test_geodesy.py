"""Radii and local steps against PROJ and against the ellipsoid's own definition."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest

from pipeline.geodesy import Gravity, euler_radius, geodetic_of_ecef, offset_geodetic

GEOD = pyproj.Geod(ellps="WGS84")
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)


@pytest.mark.parametrize("azimuth", [0.0, 17.0, 45.0, 90.0, 123.0, 180.0, 270.0])
@pytest.mark.parametrize("latitude", [-89.0, -35.0, 0.0, 20.0, 47.4, 75.0])
def test_euler_radius_is_the_curvature_of_the_normal_section(latitude, azimuth):
    """The sagitta of a chord under the local horizon, points from PROJ: h = s^2 / 2R."""
    radius = float(euler_radius(math.radians(latitude), math.radians(azimuth)))
    sag = []
    for bearing in (azimuth, azimuth + 180.0):  # both ways: odd terms cancel
        lon, lat, _ = GEOD.fwd(10.0, latitude, bearing, 2000.0)
        there = np.array(TO_ECEF.transform(lon, lat, 0.0))
        here = np.array(TO_ECEF.transform(10.0, latitude, 0.0))
        phi, lam = math.radians(latitude), math.radians(10.0)
        up = [math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)]
        sag.append(-np.dot(there - here, up))
    # R (1 - cos(s/R)) with s = 2 km: 0.31 m, known to 1e-9 m.
    assert 2000.0**2 / (2.0 * np.mean(sag)) == pytest.approx(radius, rel=3e-7)


def test_euler_radius_at_its_extremes():
    a, e2 = 6_378_137.0, 6.694379990141e-3
    assert float(euler_radius(0.0, 0.0)) == pytest.approx(a * (1.0 - e2), rel=1e-14)
    assert float(euler_radius(0.0, math.pi / 2.0)) == pytest.approx(a, rel=1e-14)
    polar = a / math.sqrt(1.0 - e2)
    for azimuth in (0.0, 1.0, 3.0):
        assert float(euler_radius(math.pi / 2.0, azimuth)) == pytest.approx(polar, rel=1e-14)
    assert euler_radius(np.zeros((2, 1)), np.zeros(3)).shape == (2, 3)


def test_geodetic_of_ecef_against_proj():
    rng = np.random.default_rng(4)
    lon = rng.uniform(-180.0, 180.0, 2000)
    lat = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 2000)))
    h = rng.uniform(-10_000.0, 100_000.0, 2000)
    found = geodetic_of_ecef(*map(np.asarray, TO_ECEF.transform(lon, lat, h)))
    np.testing.assert_allclose(found[0], np.radians(lat), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found[1], np.radians(lon), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found[2], h, rtol=0.0, atol=1e-6)


def test_geodetic_at_the_poles():
    b = 6_378_137.0 * (1.0 - 1.0 / 298.257223563)
    for sign in (1.0, -1.0):
        lat, lon, h = geodetic_of_ecef(np.zeros(1), np.zeros(1), np.array([sign * (b + 500.0)]))
        assert lat[0] == pytest.approx(sign * math.pi / 2.0, abs=1e-12)
        assert h[0] == pytest.approx(500.0, abs=1e-6)
        assert np.isfinite(lon[0])


@pytest.mark.parametrize("lat", [-89.9999, -45.0, 0.0, 60.0, 89.9999])
@pytest.mark.parametrize("lon", [-179.99999, 0.0, 10.0, 179.99999])
def test_offsets_against_projs_topocentric_frame(lat, lon):
    topocentric = pyproj.Transformer.from_pipeline(
        f"+proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0=1200"
    )
    steps = np.array(
        [[0.0, 0.0, 0.0], [900.0, 0.0, 0.0], [0.0, -700.0, 0.0], [0.0, 0.0, 55.0], [3.0, 4.0, -2.0]]
    )
    n = len(steps)
    found = offset_geodetic(
        np.full(n, math.radians(lat)), np.full(n, math.radians(lon)), np.full(n, 1200.0), steps
    )
    assert np.all(np.abs(found[1]) <= math.pi)
    ecef = TO_ECEF.transform(np.degrees(found[1]), np.degrees(found[0]), found[2])
    back = np.stack(topocentric.transform(*ecef), axis=-1)
    # The docstring promises 1 mm.
    np.testing.assert_allclose(back, steps, rtol=0.0, atol=1e-7)


def test_geopotential_height_and_back():
    gravity = Gravity(9.80665, 6_356_766.0)
    h = np.linspace(-500.0, 80_000.0, 101)
    np.testing.assert_allclose(
        gravity.height(gravity.geopotential_height(h)), h, rtol=1e-13, atol=1e-9
    )
    # US Standard Atmosphere 1976, Table I: 86 km is 84 852 m'.
    assert float(gravity.geopotential_height(86_000.0)) == pytest.approx(84_852.0, abs=0.5)
