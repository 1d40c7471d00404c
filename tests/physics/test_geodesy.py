"""Radii and local steps against PROJ and against the ellipsoid's own definition."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from unbend.geodesy import (
    Gravity,
    euler_radius,
    geodetic_of_ecef,
    lambert_gravity,
    normal_gravity,
    offset_geodetic,
    principal_radii,
)

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
        phi = math.radians(latitude)
        lam = math.radians(10.0)
        up = [math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)]
        sag.append(-np.dot(there - here, up))
    # R (1 - cos(s/R)) with s = 2 km: 0.31 m, known to 1e-9 m.
    assert 2000.0**2 / (2.0 * np.mean(sag)) == pytest.approx(radius, rel=3e-7)


def test_euler_radius_at_its_extremes():
    a = 6_378_137.0
    e2 = 6.694379990141e-3
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
    np.testing.assert_allclose(found[0], np.radians(lat), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found[1], np.radians(lon), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found[2], h, rtol=0.0, atol=5e-9)


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
        [
            [0.0, 0.0, 0.0],
            [900.0, 0.0, 0.0],
            [0.0, -700.0, 0.0],
            [0.0, 0.0, 55.0],
            [3.0, 4.0, -2.0],
            [2e5, -1e5, 5e3],
            [-6e5, 8e5, -1e4],
        ]
    )
    n = len(steps)
    found = offset_geodetic(
        np.full(n, math.radians(lat)), np.full(n, math.radians(lon)), np.full(n, 1200.0), steps
    )
    assert np.all(np.abs(found[1]) <= math.pi)
    ecef = TO_ECEF.transform(np.degrees(found[1]), np.degrees(found[0]), found[2])
    back = np.stack(topocentric.transform(*ecef), axis=-1)
    # 5e-9 m of the step, and the rounding of degrees and of PROJ.
    np.testing.assert_allclose(back, steps, rtol=0.0, atol=2e-8)


def test_geopotential_height_and_back():
    gravity = Gravity(9.80665, 6_356_766.0)
    h = np.linspace(-500.0, 80_000.0, 101)
    np.testing.assert_allclose(
        gravity.height(gravity.geopotential_height(h)), h, rtol=1e-13, atol=1e-9
    )
    # US Standard Atmosphere 1976, Table I: 86 km is 84 852 m'.
    assert float(gravity.geopotential_height(86_000.0)) == pytest.approx(84_852.0, abs=0.5)


@pytest.mark.parametrize(
    ("latitude", "gravity"),
    # Moritz 2000, GRS 80: 9.7803267715 at the equator, 9.8321863685 at a pole; WGS 84 differs by
    # 1.4e-7 m/s2. At 45 degrees 9.806199203 (Torge, Geodesy).
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.806197769)],
)
def test_normal_gravity_and_its_gradient(latitude, gravity):
    found = normal_gravity(math.radians(latitude))
    assert found.g_phi == pytest.approx(gravity, abs=3e-8)
    assert found.latitude_rad == pytest.approx(math.radians(latitude))
    # Free air: 0.3087691 - 0.0004398 sin^2 mGal/m (the same book), g (1 - 2 h / r).
    gradient = (0.3087691 - 0.0004398 * math.sin(math.radians(latitude)) ** 2) * 1e-5
    assert 2.0 * found.g_phi / found.r_phi == pytest.approx(gradient, rel=5e-5)


@pytest.mark.parametrize(("latitude", "gravity"), [(0.0, 9.780356), (90.0, 9.832079)])
def test_lamberts_gravity(latitude, gravity):
    """Gyer 1996, p. 307: 9.780356 (1 + 0.0052885 sin^2 - 0.0000059 sin^2 2 phi)."""
    found = lambert_gravity(math.radians(latitude))
    assert found.g_phi == pytest.approx(gravity, abs=1e-6)
    # 3.085462e-6 + 2.27e-9 cos 2 phi - 2e-12 cos 4 phi
    gradient = 3.085462e-6 + 2.27e-9 * (1.0 if latitude == 0.0 else -1.0) - 2e-12
    assert 2.0 * found.g_phi / found.r_phi == pytest.approx(gradient, rel=1e-12)


LATITUDES = st.floats(-1.57, 1.57)
LONGITUDES = st.floats(-math.pi, math.pi)


@given(LATITUDES, st.floats(0.0, 2.0 * math.pi))
def test_eulers_radius_lies_between_the_principal_ones_and_repeats(latitude, azimuth):
    meridian, prime_vertical = map(float, principal_radii(latitude))
    radius = float(euler_radius(latitude, azimuth))
    assert meridian * (1 - 1e-15) <= radius <= prime_vertical * (1 + 1e-15)
    for same in (azimuth + math.pi, -azimuth):
        assert float(euler_radius(latitude, same)) == pytest.approx(radius, rel=1e-14)
    # Curvatures in directions at right angles have the same sum (Euler).
    other = float(euler_radius(latitude, azimuth + math.pi / 2.0))
    assert 1.0 / radius + 1.0 / other == pytest.approx(1.0 / meridian + 1.0 / prime_vertical)


@given(LATITUDES, LONGITUDES, st.floats(-500.0, 10_000.0), st.floats(-900.0, 900.0))
def test_a_step_up_changes_the_height_alone(latitude, longitude, height, up):
    one = (np.array([latitude]), np.array([longitude]), np.array([height]))
    lat, lon, h = offset_geodetic(*one, np.array([[0.0, 0.0, up]]))
    assert lat[0] == pytest.approx(latitude, abs=1e-13)
    assert (lon[0] - longitude + math.pi) % (2.0 * math.pi) - math.pi == pytest.approx(0, abs=1e-12)
    assert h[0] == pytest.approx(height + up, abs=1e-8)


@given(LATITUDES, LONGITUDES, st.floats(-500.0, 10_000.0), st.floats(10.0, 900.0))
def test_a_step_to_the_east_or_north_goes_there(latitude, longitude, height, step):
    """By the radii: d phi = n / (M + h), d lambda = e / ((N + h) cos phi), to first order."""
    assume(abs(latitude) < 1.4)
    one = (np.array([latitude]), np.array([longitude]), np.array([height]))
    meridian, prime_vertical = map(float, principal_radii(latitude))
    lat, _, _ = offset_geodetic(*one, np.array([[0.0, step, 0.0]]))
    assert lat[0] - latitude == pytest.approx(step / (meridian + height), rel=1e-3)
    _, lon, _ = offset_geodetic(*one, np.array([[step, 0.0, 0.0]]))
    turned = (lon[0] - longitude + math.pi) % (2.0 * math.pi) - math.pi
    east = step / ((prime_vertical + height) * math.cos(latitude))
    assert turned == pytest.approx(east, rel=1e-3)


@given(LATITUDES, st.floats(-600.0, 80_000.0))
def test_heights_and_geopotential_heights_go_there_and_back(latitude, height):
    for gravity in (lambert_gravity(latitude), normal_gravity(latitude)):
        back = float(gravity.height(gravity.geopotential_height(height)))
        assert back == pytest.approx(height, rel=1e-12, abs=1e-9)
