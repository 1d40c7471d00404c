"""Radii and local steps against PROJ and against the ellipsoid's own definition."""

import math
from math import pi

import numpy as np
import pyproj
import pytest

from tests.refraction.comparing import assert_close, assert_near
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
AT_EQUATOR = A * (1.0 - E2)  # in the meridian


@pytest.mark.parametrize("azimuth", [0.0, 17.0, 45.0, 90.0, 123.0, 180.0, 270.0])
@pytest.mark.parametrize("latitude", [-89.0, -35.0, 0.0, 20.0, 47.4, 75.0])
def test_euler_radius_is_the_curvature_of_the_normal_section(latitude, azimuth):
    """The sagitta of a chord under the local horizon, points from PROJ: h = s^2 / 2R."""
    phi = math.radians(latitude)
    up = [math.cos(phi), 0.0, math.sin(phi)]  # at longitude 0
    start = np.array(TO_ECEF.transform(0.0, latitude, 0.0))
    sagittas = []
    for bearing in (azimuth, azimuth + 180.0):  # both ways: odd terms cancel
        lon, lat, _ = GEOD.fwd(0.0, latitude, bearing, 2000.0)
        end = np.array(TO_ECEF.transform(lon, lat, 0.0))
        sagittas.append(np.dot(start - end, up))
    # R (1 - cos(s/R)) with s = 2 km: 0.31 m, known to 1e-9 m.
    radius = 2000.0**2 / (2.0 * np.mean(sagittas))
    by_euler = euler_radius(phi, math.radians(azimuth))
    assert_close(by_euler, radius, rtol=3e-7)


def test_latitudes_and_azimuths_broadcast():
    radii = euler_radius(np.zeros((2, 1)), np.zeros(3))
    assert radii.shape == (2, 3)
    meridian, prime_vertical = principal_radii(np.array([0.0, pi / 2.0]))
    assert_close(meridian, [AT_EQUATOR, POLAR], rtol=1e-14)
    assert_close(prime_vertical, [A, POLAR], rtol=1e-14)


def test_geodetic_of_ecef_against_proj():
    rng = np.random.default_rng(4)
    lon = rng.uniform(-180.0, 180.0, 2000)
    lat = np.degrees(
        np.arcsin(
            rng.uniform(
                -1.0,
                1.0,
                2000,
            )
        )
    )
    h = rng.uniform(-10_000.0, 100_000.0, 2000)
    ecef = map(np.asarray, TO_ECEF.transform(lon, lat, h))
    lat_rad, lon_rad, height = geodetic_of_ecef(*ecef)
    assert_near(lat_rad, np.radians(lat), 1e-15)
    assert_near(lon_rad, np.radians(lon), 1e-15)
    assert_near(height, h, 5e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_geodetic_at_the_poles(sign):
    b = A * (1.0 - 1.0 / 298.257223563)
    on_axis = np.zeros(1)
    z = np.array([sign * (b + 500.0)])
    lat, lon, h = geodetic_of_ecef(on_axis, on_axis, z)
    assert_near(lat, [sign * pi / 2.0], 1e-12)
    assert_near(h, [500.0], 1e-6)
    assert np.isfinite(lon).all()


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
    start = [math.radians(lat), math.radians(lon), 1200.0]
    starts = np.tile(start, (len(steps), 1)).T.copy()

    lat_rad, lon_rad, h = offset_geodetic(*starts, steps)

    assert np.all(np.abs(lon_rad) <= pi)
    ecef = TO_ECEF.transform(np.degrees(lon_rad), np.degrees(lat_rad), h)
    back = np.stack(topocentric.transform(*ecef), axis=-1)
    # 5e-9 m of the step, and the rounding of degrees and of PROJ.
    assert_near(back, steps, 2e-8)


US1976_GRAVITY = Gravity(9.80665, 6_356_766.0)


@pytest.mark.parametrize(
    "gravity",
    [
        US1976_GRAVITY,
        lambert_gravity(0.8),
        normal_gravity(-1.2),
    ],
)
def test_geopotential_height_and_back(gravity):
    h = np.linspace(-600.0, 80_000.0, 101)
    back = gravity.height(gravity.geopotential_height(h))
    assert_close(back, h, rtol=1e-13, atol=1e-9)


def test_a_geopotential_height_of_the_standard():
    # US Standard Atmosphere 1976, Table I: 86 km is 84 852 m'.
    h = US1976_GRAVITY.geopotential_height(86_000.0)
    assert_near(h, 84_852.0, 0.5)


def gradient_of(model):
    """Of gravity [1/s2], at sea level."""
    return 2.0 * model.g_phi / model.r_phi


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
    assert_near(model.g_phi, gravity, 3e-8)
    assert model.latitude_rad == pytest.approx(phi)
    # Free air: 0.3087691 - 0.0004398 sin^2 mGal/m (the same book), g (1 - 2 h / r).
    gradient = (0.3087691 - 0.0004398 * math.sin(phi) ** 2) * 1e-5
    assert_close(gradient_of(model), gradient, rtol=5e-5)


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
    assert_near(model.g_phi, gravity, 1e-6)
    assert_close(gradient_of(model), gradient, rtol=1e-12)
