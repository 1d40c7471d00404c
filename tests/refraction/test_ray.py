"""The kernel against 40-digit quadrature, an independent ODE, and itself where two forms meet."""

import math

import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.exact_rays import ExactRays, RaysOfTable
from tests.refraction.images import RADIUS
from tests.refraction.rays import AIR, TABLE, arcsec, integrated_arcsec, touching_angle
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.messages import Ledger
from unbend.refraction import ray_table
from unbend.units import DEGREE


@pytest.fixture(scope="module")
def wiggly():
    """An adjusted profile with an inversion, humidity and a wavy lapse rate."""
    h = np.arange(300.0, 3300.0, 4.0)
    inversion = 6.0 / (1.0 + np.exp(-(h - 1400.0) / 40.0))
    time_ns = np.arange(h.size) * 10**9
    unused = np.zeros(h.size, np.uint8)

    def samples(name, values):
        return SensorSamples(time_ns, h, values, unused, name)

    air = AirSamples(
        samples("T", 289.0 - 6.5e-3 * h + inversion + 0.6 * np.sin(h / 90.0)),
        samples("p", 98_000.0 * np.exp(-(h - 300.0) / 8400.0)),
        samples("rh", 0.5 + 0.3 * np.sin(h / 150.0)),
    )
    standard = standard_atmosphere("us1976")
    latitude = 47.0 * DEGREE
    return build_adjusted_profile(air, standard, latitude, Ledger()).profile


@pytest.mark.parametrize(
    ("h_c", "degrees", "expected"),
    [
        (10_000.0, 75.0, 61.778543),
        (10_000.0, 45.0, 16.378452),
        (3000.0, 45.0, 7.088778),
        (120.0, 45.0, 0.327323),
        (20_000.0, 85.0, 327.014637),
    ],
)
def test_the_reference_angles(h_c, degrees, expected):
    angle = arcsec(AIR, h_c, 0.0, degrees * DEGREE)
    assert_near(angle, expected, 6e-7)  # 5e-7 of rounding


def test_random_rays_against_forty_digits():
    # Reached: 3e-13 arcsec.
    rng = np.random.default_rng(1996)
    exact = ExactRays(40)
    compared = 0
    for _ in range(60):
        h_c = 10.0 ** rng.uniform(1.0, math.log10(30_000.0))
        h_g = rng.uniform(-430.0, h_c)
        zeta = rng.uniform(0.0, 88.0) * DEGREE
        lowest_straight = (RADIUS + h_c) * math.sin(zeta) / (RADIUS + h_g)
        if lowest_straight > 1.0 - 1e-6:
            continue
        compared += 1
        grazing = zeta > 80.0 * DEGREE
        expected = exact.angle(h_c, h_g, zeta, grazing=grazing)
        assert_near(arcsec(AIR, h_c, h_g, zeta), expected, 1e-11)
    assert compared > 50


@pytest.mark.parametrize("below", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize("h_c", [50.0, 1000.0, 10_000.0, 25_000.0])
def test_near_grazing_against_forty_digits(h_c, below):
    """``below`` degrees under the nadir angle at which the ray would just touch sea level."""
    zeta = touching_angle(AIR, h_c) - below * DEGREE
    angle = arcsec(AIR, h_c, 0.0, zeta)
    expected = ExactRays(30).angle(
        h_c,
        0.0,
        zeta,
        grazing=True,
    )
    # Reached: 3e-11 arcsec.
    assert_near(angle, expected, 1e-9)


@pytest.mark.parametrize("h_c", [0.0, 5000.0])
@pytest.mark.parametrize("rise", [30.0, 12_000.0])
@pytest.mark.parametrize("degrees", [90.0, 90.01, 91.0, 95.0, 120.0, 170.0])
def test_targets_above_against_thirty_digits(h_c, rise, degrees):
    zeta = degrees * DEGREE
    ray = (h_c, h_c + rise, zeta)
    angle = arcsec(AIR, *ray)
    if degrees == 90.0:  # 90 deg in double precision is 6e-17 rad short of it
        expected = ExactRays(50).through_lowest_point(*ray)
    else:
        expected = ExactRays(30).angle(*ray, grazing=degrees < 92.0)
    # Reached: 7e-10 arcsec, level; 1e-11 from 91 deg.
    assert_near(angle, expected, 1e-9)


@pytest.mark.parametrize("h_c", [1000.0, 20_000.0])
@pytest.mark.parametrize("rise", [1.0, 5000.0])
@pytest.mark.parametrize("degrees", [89.999, 89.99, 89.985, 89.6, 89.0])
def test_targets_above_through_the_lowest_point(h_c, rise, degrees):
    ray = (h_c, h_c + rise, degrees * DEGREE)
    angle = arcsec(AIR, *ray)
    expected = ExactRays(30).through_lowest_point(*ray)
    # Reached: 8e-10 arcsec, and 1e-8 where the lowest point is 1 mm down: its height keeps
    # 4e-12 m. Thirty digits are good to 3e-11.
    within = 1e-9 if degrees < 89.995 else 5e-8
    assert_near(angle, expected, within)


@pytest.mark.parametrize(
    ("h_c", "h_g", "degrees"),
    [
        (3200.0, 300.0, 20.0),
        (3200.0, 300.0, 84.0),
        (1425.0, 310.0, 75.0),
        (8000.0, 0.0, 80.0),
        (500.0, 2500.0, 100.0),
    ],
)
def test_a_wiggly_profile_against_an_independent_ode(wiggly, h_c, h_g, degrees):
    ray = (wiggly, h_c, h_g, degrees * DEGREE)
    # Reached: 3e-10 arcsec.
    assert_near(arcsec(*ray), integrated_arcsec(*ray), 1e-9)


def test_the_table_reproduces_the_profile(wiggly):
    h = np.linspace(-400.0, 30_000.0, 5003)
    for profile in (AIR, wiggly):
        table = ray_table(profile)
        edge = table.edge_m
        piece = np.searchsorted(edge, h, "right") - 1
        piece = np.clip(piece, 0, edge.size - 2)
        u = (h - edge[piece]) / np.diff(edge)[piece]
        coefficients = table.coefficient[piece].T
        value = polyval(u, coefficients, tensor=False)
        # Where layers meet, the two may differ by a step of the table's own making.
        assert_close(value, profile.refractivity(h), rtol=2e-12)


@pytest.mark.parametrize("part", [0.3, 0.4, 0.499, 0.501, 0.6])
@pytest.mark.parametrize(
    ("h_c", "h_g"),
    [
        (3000.0, 2880.0),
        (950.0, 500.0),
        (500.0, 950.0),
    ],
)
def test_about_the_guard_over_one_piece_of_the_table(h_c, h_g, part):
    """q^2 at the lower end is ``part`` of that at the upper: few nodes for a steep integrand."""
    piece_of_camera, piece_of_target = np.searchsorted(TABLE.edge_m, [h_c, h_g])
    assert piece_of_camera == piece_of_target
    rise = abs(h_c - h_g)
    q2 = rise * (2.0 * RADIUS + h_c + h_g) / (1.0 - part)  # at the upper end
    if h_g > h_c:
        q2 *= part  # at the camera
    sine = math.sqrt(1.0 - q2 / (RADIUS + h_c) ** 2)
    zeta = math.asin(sine)
    if h_g > h_c:
        zeta = math.pi - zeta
    angle = arcsec(AIR, h_c, h_g, zeta)
    expected = ExactRays(30).angle(
        h_c,
        h_g,
        zeta,
        grazing=True,
    )
    # Reached: 4e-10 arcsec beside the guard, 0.5; a guard of 0.3 would leave 5e-7.
    assert_near(angle, expected, 1e-9)


@pytest.mark.parametrize(
    ("h_c", "below"),
    [
        (3000.0, 1e-2),
        (3000.0, 1e-4),
        (900.0, 1e-3),
    ],
)
def test_near_grazing_through_many_kinks(wiggly, h_c, below):
    """Against 25-digit quadrature of the kernel's own polynomials (Eq. 12)."""
    table = ray_table(wiggly)
    exact = RaysOfTable(25, table)
    first, last = np.searchsorted(table.edge_m, [312.0, h_c])
    h_g = table.edge_m[first]
    h_c = table.edge_m[last]  # the camera is on a boundary; the kernel reads the piece above it
    n_r_target = exact.n_r(mp.mpf(h_g))
    n_r_camera = exact.n_r(mp.mpf(h_c))
    zeta = math.asin(n_r_target / n_r_camera) - below * DEGREE
    expected = exact.angle(h_c, h_g, zeta, grazing=True)
    angle = arcsec(wiggly, h_c, h_g, zeta)
    # Reached: 1e-12 arcsec.
    assert_near(angle, expected, 1e-9)
