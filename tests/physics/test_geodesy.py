"""Radii and local steps against PROJ and against the ellipsoid's own definition."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest

from tests.refraction.comparing import assert_near
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
A = 6_378_137.0
E2 = 6.694379990141e-3
POLAR = A / math.sqrt(1.0 - E2)


@pytest.mark.parametrize("azimuth", [0.0, 17.0, 45.0, 90.0, 123.0, 180.0, 270.0])
@pytest.mark.parametrize("latitude", [-89.0, -35.0, 0.0, 20.0, 47.4, 75.0])
def test_euler_radius_is_the_curvature_of_the_normal_section(latitude, azimuth):
    """The sagitta of a chord under the local horizon, points from PROJ: h = s^2 / 2R."""
    phi = math.radians(latitude)
    lam = math.radians(10.0)
    up = [math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)]
    start = np.array(TO_ECEF.transform(10.0, latitude, 0.0))
    sagittas = []
    for bearing in (azimuth, azimuth + 180.0):  # both ways: odd terms cancel
        lon, lat, _ = GEOD.fwd(10.0, latitude, bearing, 2000.0)
        end = np.array(TO_ECEF.transform(lon, lat, 0.0))
        sagittas.append(np.dot(start - end, up))
    # R (1 - cos(s/R)) with s = 2 km: 0.31 m, known to 1e-9 m.
    radius = 2000.0**2 / (2.0 * np.mean(sagittas))
    assert float(euler_radius(phi, math.radians(azimuth))) == pytest.approx(radius, rel=3e-7)


@pytest.mark.parametrize(
    ("latitude", "azimuth", "radius"),
    [
        (0.0, 0.0, A * (1.0 - E2)),
        (0.0, math.pi / 2.0, A),
        (0.0, math.pi / 4.0, 2.0 * A / (1.0 / (1.0 - E2) + 1.0)),
        (math.pi / 2.0, 0.0, POLAR),
        (math.pi / 2.0, 1.0, POLAR),
        (math.pi / 2.0, 3.0, POLAR),
    ],
)
def test_euler_radius_by_hand(latitude, azimuth, radius):
    assert float(euler_radius(latitude, azimuth)) == pytest.approx(radius, rel=1e-14)


def test_latitudes_and_azimuths_broadcast():
    assert euler_radius(np.zeros((2, 1)), np.zeros(3)).shape == (2, 3)
    meridian, prime_vertical = principal_radii(np.array([0.0, math.pi / 2.0]))
    assert meridian == pytest.approx([A * (1.0 - E2), POLAR], rel=1e-14)
    assert prime_vertical == pytest.approx([A, POLAR], rel=1e-14)


def test_geodetic_of_ecef_against_proj():
    rng = np.random.default_rng(4)
    lon = rng.uniform(-180.0, 180.0, 2000)
    lat = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 2000)))
    h = rng.uniform(-10_000.0, 100_000.0, 2000)
    ecef = map(np.asarray, TO_ECEF.transform(lon, lat, h))
    lat_rad, lon_rad, height = geodetic_of_ecef(*ecef)
    assert_near(lat_rad, np.radians(lat), atol=1e-15)
    assert_near(lon_rad, np.radians(lon), atol=1e-15)
    assert_near(height, h, atol=5e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_geodetic_at_the_poles(sign):
    b = A * (1.0 - 1.0 / 298.257223563)
    lat, lon, h = geodetic_of_ecef(np.zeros(1), np.zeros(1), np.array([sign * (b + 500.0)]))
    assert lat[0] == pytest.approx(sign * math.pi / 2.0, abs=1e-12)
    assert h[0] == pytest.approx(500.0, abs=1e-6)
    assert np.isfinite(lon[0])


STEPS_ENU_M = [
    (0.0, 0.0, 0.0),
    (900.0, 0.0, 0.0),
    (0.0, -700.0, 0.0),
    (0.0, 0.0, 55.0),
    (3.0, 4.0, -2.0),
    (2e5, -1e5, 5e3),
    (-6e5, 8e5, -1e4),
]


@pytest.mark.parametrize("lat", [-89.9999, -45.0, 0.0, 60.0, 89.9999])
@pytest.mark.parametrize("lon", [-179.99999, 0.0, 10.0, 179.99999])
def test_offsets_against_projs_topocentric_frame(lat, lon):
    topocentric = pyproj.Transformer.from_pipeline(
        f"+proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0=1200"
    )
    steps = np.array(STEPS_ENU_M)
    start = np.full((3, len(steps)), [[math.radians(lat)], [math.radians(lon)], [1200.0]])
    lat_rad, lon_rad, h = offset_geodetic(*start, steps)
    assert np.all(np.abs(lon_rad) <= math.pi)
    ecef = TO_ECEF.transform(np.degrees(lon_rad), np.degrees(lat_rad), h)
    back = np.stack(topocentric.transform(*ecef), axis=-1)
    # 5e-9 m of the step, and the rounding of degrees and of PROJ.
    assert_near(back, steps, atol=2e-8)


@pytest.mark.parametrize(
    "gravity",
    [Gravity(9.80665, 6_356_766.0), lambert_gravity(0.8), normal_gravity(-1.2)],
)
def test_geopotential_height_and_back(gravity):
    h = np.linspace(-600.0, 80_000.0, 101)
    back = gravity.height(gravity.geopotential_height(h))
    np.testing.assert_allclose(back, h, rtol=1e-13, atol=1e-9)


def test_a_geopotential_height_of_the_standard():
    # US Standard Atmosphere 1976, Table I: 86 km is 84 852 m'.
    h = Gravity(9.80665, 6_356_766.0).geopotential_height(86_000.0)
    assert float(h) == pytest.approx(84_852.0, abs=0.5)


@pytest.mark.parametrize(
    ("latitude", "gravity"),
    # Moritz 2000, GRS 80: 9.7803267715 at the equator, 9.8321863685 at a pole; WGS 84 differs by
    # 1.4e-7 m/s2. At 45 degrees 9.806199203 (Torge, Geodesy).
    [
        (0.0, 9.7803253359),
        (90.0, 9.8321849378),
        (-90.0, 9.8321849378),
        (45.0, 9.806197769),
    ],
)
def test_normal_gravity_and_its_gradient(latitude, gravity):
    phi = math.radians(latitude)
    model = normal_gravity(phi)
    assert model.g_phi == pytest.approx(gravity, abs=3e-8)
    assert model.latitude_rad == pytest.approx(phi)
    # Free air: 0.3087691 - 0.0004398 sin^2 mGal/m (the same book), g (1 - 2 h / r).
    gradient = (0.3087691 - 0.0004398 * math.sin(phi) ** 2) * 1e-5
    assert 2.0 * model.g_phi / model.r_phi == pytest.approx(gradient, rel=5e-5)


@pytest.mark.parametrize(
    ("latitude", "gravity", "gradient"),
    [
        (0.0, 9.780356, 3.085462e-6 + 2.27e-9 - 2e-12),
        (45.0, 9.780356 * (1.0 + 0.0052885 / 2.0 - 0.0000059), 3.085462e-6 + 2e-12),
        (90.0, 9.832079, 3.085462e-6 - 2.27e-9 - 2e-12),
    ],
)
def test_lamberts_gravity(latitude, gravity, gradient):
    """Gyer 1996, p. 307: 9.780356 (1 + 0.0052885 sin^2 - 0.0000059 sin^2 2 phi).

    The gradient is 3.085462e-6 + 2.27e-9 cos 2 phi - 2e-12 cos 4 phi.
    """
    model = lambert_gravity(math.radians(latitude))
    assert model.g_phi == pytest.approx(gravity, abs=1e-6)
    assert 2.0 * model.g_phi / model.r_phi == pytest.approx(gradient, rel=1e-12)
