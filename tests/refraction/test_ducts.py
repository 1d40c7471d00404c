"""Air in which n r falls with height: rays that bend more than the earth does."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyval

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import RADIUS
from tests.refraction.rays import AIR, arcsec, bent
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.geodesy import lambert_gravity
from unbend.refraction import ray_table
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH
from unbend.units import ARCSEC

LONG = np.longdouble
NODES, WEIGHTS = np.array(leggauss(20), LONG)


def duct(warming):
    """A layer of 30 m over the ground that warms upwards by so many kelvins a metre."""
    edge = np.array([-500.0, 0.0, 30.0, 60.0, 1000.0, 11_000.0, 35_000.0])
    top = 285.0 + 30.0 * warming
    t = np.array([285.0, 285.0, top, top + 1.0, 285.0, 220.0, 220.0])
    layers = stack_layers(
        edge,
        t,
        0.0 * t,
        ("measured",) * 6,
        anchor=(0.0, 101_325.0),
    )
    return Profile(layers, lambert_gravity(0.7), IndexModel("gyer"))


def refractivity(table, piece, h):
    low, high = table.edge_m[piece : piece + 2].astype(LONG)
    coefficients = table.coefficient[piece].astype(LONG)
    return polyval((h - low) / (high - low), coefficients)


def halves(low, high):
    """Heights and weights (20,) of panels graded towards both ends: h = end +- s^2."""
    half = (high - low) / 2
    panels = np.append(LONG(0), np.sqrt(half) * LONG(2) ** -np.arange(38, -1, -1))
    for end, sense in ((low, 1), (high, -1)):
        for s_0, s_1 in pairwise(panels):
            s = s_0 + (s_1 - s_0) * (NODES + 1) / 2
            yield end + sense * s * s, WEIGHTS * s * (s_1 - s_0)


def expected(table, h_c, h_g, zeta):
    """R_c [arcsec] by Gyer's Eq. 12 in 80 bits, graded towards both ends of every piece; NaN where
    the ray turns on its way."""
    first, last = np.searchsorted(table.edge_m, [h_g, h_c], "right") - 1
    h_c = LONG(h_c)
    h_g = LONG(h_g)
    sine = np.sin(LONG(zeta))
    cosine = np.cos(LONG(zeta))
    n_c = refractivity(table, last, h_c)
    n_r = (1 + n_c) * (RADIUS + h_c)
    lift = n_r * cosine**2 / (1 + sine)  # n r (1 - sin(zeta))
    k = n_r - lift
    theta = LONG(0)
    for i in range(first, last + 1):
        low, high = table.edge_m[i : i + 2].astype(LONG)
        for h, weight in halves(max(h_g, low), min(h_c, high)):
            r = RADIUS + h
            excess = r * (refractivity(table, i, h) - n_c) + (1 + n_c) * (h - h_c) + lift
            if not (excess > 0).all():
                return math.nan
            theta += np.sum(weight * k / (r * np.sqrt(excess * (excess + 2 * k))))
    ahead = (h_c - h_g) / (RADIUS + h_g) + 2 * np.sin(theta / 2) ** 2
    across = np.sin(theta)
    r_c_rad = np.arctan2(sine * ahead - cosine * across, cosine * ahead + sine * across)
    return float(r_c_rad / LONG(ARCSEC))


@pytest.mark.parametrize("warming", [0.10, 0.15, 0.5])
def test_rays_in_a_duct(warming):
    profile = duct(warming)
    table = ray_table(profile)
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(40):
        h_c = rng.uniform(5.0, 60.0)
        h_g = rng.uniform(0.0, h_c)
        zeta = math.pi / 2 - 10.0 ** rng.uniform(-6.0, -2.0)
        exact = expected(table, h_c, h_g, zeta)
        if math.isnan(exact):
            continue
        compared += 1
        # Reached: 2e-10 arcsec of up to 850.
        assert_near(
            arcsec(
                profile,
                h_c,
                h_g,
                zeta,
            ),
            exact,
            1e-8,
        )
    assert compared > 8


def test_the_ray_that_was_forty_seconds_off():
    """A reviewer's: level near the upper end of the duct, where the singularity is."""
    ray = (26.398259481305864, 5.365223018200361, 1.5707926881833847)
    profile = duct(0.15)
    exact = expected(ray_table(profile), *ray)
    assert_near(arcsec(profile, *ray), exact, 1e-8)


@pytest.mark.parametrize("below", [1e-7, 1e-5, 1e-3])
def test_grazing_the_top_of_a_duct_from_above(below):
    profile = duct(0.15)
    table = ray_table(profile)
    top = table.edge_m[3]
    n_top, n_c = 1.0 + profile.refractivity([top, 1658.7])
    zeta = math.asin(n_top * (RADIUS + top) / (n_c * (RADIUS + 1658.7))) - below
    ray = (1658.7, 17.9, zeta)
    assert_near(arcsec(profile, *ray), expected(table, *ray), 1e-7)


def test_a_tenth_of_a_microdegree_from_level():
    ray = (9573.849234696296, 9573.951100392289, 1.5707963284804676)
    assert_near(arcsec(AIR, *ray), 1.4722366, 1e-6)  # 40 digits


def test_the_far_crossing_of_the_cameras_own_height():
    table = ray_table(standard_atmosphere("us1976"))
    zeta = math.pi / 2 - 0.02
    nothing, status = bent(
        table,
        3000.0,
        3000.0,
        zeta,
    )
    assert nothing == 0.0
    assert status == BEYOND_GRAZING
    far, status = bent(
        table,
        3000.0,
        3000.0,
        zeta,
        distance=250e3,
    )
    nearly, _ = bent(
        table,
        3000.0,
        3000.0 - 1e-6,
        zeta,
        distance=250e3,
    )
    assert status == FAR_BRANCH
    assert_close(far, float(nearly), rtol=1e-7)
