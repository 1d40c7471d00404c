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
    top = 285.0 + 30.0 * warming
    table = [
        (-500.0, 285.0),
        (0.0, 285.0),
        (30.0, top),
        (60.0, top + 1.0),
        (1000.0, 285.0),
        (11_000.0, 220.0),
        (35_000.0, 220.0),
    ]
    edge, t = np.array(table).T
    layers = stack_layers(
        edge,
        t,
        0.0 * t,
        ("measured",) * 6,
        anchor=(0.0, 101_325.0),
    )
    index = IndexModel("gyer")
    return Profile(layers, lambert_gravity(0.7), index)


def refractivity(table, piece, h):
    low, high = table.edge_m[piece : piece + 2].astype(LONG)
    coefficients = table.coefficient[piece].astype(LONG)
    u = (h - low) / (high - low)
    return polyval(u, coefficients)


def halves(low, high):
    """Heights and weights (20,) of panels graded towards both ends: h = end +- s^2."""
    end = np.sqrt((high - low) / 2)
    shares = LONG(2) ** -np.arange(38, -1, -1)
    panels = np.append(LONG(0), end * shares)
    for end, sense in ((low, 1), (high, -1)):
        for s_0, s_1 in pairwise(panels):
            width = s_1 - s_0
            s = s_0 + width * (NODES + 1) / 2
            yield end + sense * s * s, WEIGHTS * s * width


def expected(table, h_c, h_g, zeta):
    """R_c [arcsec] by Gyer's Eq. 12 in 80 bits, graded towards both ends of every piece; NaN where
    the ray turns on its way."""
    first, last = np.searchsorted(table.edge_m, [h_g, h_c], "right") - 1
    h_c = LONG(h_c)
    h_g = LONG(h_g)
    zeta = LONG(zeta)
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    n_c = refractivity(table, last, h_c)
    n_r = (1 + n_c) * (RADIUS + h_c)
    lift = n_r * cosine**2 / (1 + sine)  # n r (1 - sin(zeta))
    k = n_r - lift
    theta = LONG(0)
    for i in range(first, last + 1):
        low, high = table.edge_m[i : i + 2].astype(LONG)
        for h, weight in halves(max(h_g, low), min(h_c, high)):
            r = RADIUS + h
            denser = refractivity(table, i, h) - n_c
            excess = r * denser + (1 + n_c) * (h - h_c) + lift
            if not (excess > 0).all():
                return math.nan
            root = np.sqrt(excess * (excess + 2 * k))
            theta += np.sum(weight * k / (r * root))
    fall = (h_c - h_g) / (RADIUS + h_g)
    ahead = fall + 2 * np.sin(theta / 2) ** 2
    across = np.sin(theta)
    y = sine * ahead - cosine * across
    x = cosine * ahead + sine * across
    r_c_rad = np.arctan2(y, x)
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
        ray = (h_c, h_g, zeta)
        exact = expected(table, *ray)
        if math.isnan(exact):
            continue
        compared += 1
        # Reached: 2e-10 arcsec of up to 850.
        assert_near(arcsec(profile, *ray), exact, 1e-8)
    assert compared > 8


def test_the_ray_that_was_forty_seconds_off():
    """A reviewer's: level near the upper end of the duct, where the singularity is."""
    h_c = 26.398259481305864
    h_g = 5.365223018200361
    zeta = 1.5707926881833847
    ray = (h_c, h_g, zeta)
    profile = duct(0.15)
    exact = expected(ray_table(profile), *ray)
    assert_near(arcsec(profile, *ray), exact, 1e-8)


@pytest.mark.parametrize("below", [1e-7, 1e-5, 1e-3])
def test_grazing_the_top_of_a_duct_from_above(below):
    profile = duct(0.15)
    table = ray_table(profile)
    top = table.edge_m[3]
    h_c = 1658.7
    n_top, n_c = 1.0 + profile.refractivity([top, h_c])
    grazing = math.asin(n_top * (RADIUS + top) / (n_c * (RADIUS + h_c)))
    ray = (h_c, 17.9, grazing - below)
    exact = expected(table, *ray)
    assert_near(arcsec(profile, *ray), exact, 1e-7)


def test_a_tenth_of_a_microdegree_from_level():
    h_c = 9573.849234696296
    h_g = 9573.951100392289
    zeta = 1.5707963284804676
    angle = arcsec(AIR, h_c, h_g, zeta)
    assert_near(angle, 1.4722366, 1e-6)  # 40 digits


def test_the_far_crossing_of_the_cameras_own_height():
    table = ray_table(standard_atmosphere("us1976"))
    zeta = math.pi / 2 - 0.02
    ray = (table, 3000.0, 3000.0, zeta)
    nothing, status = bent(*ray)
    assert nothing == 0.0
    assert status == BEYOND_GRAZING
    far, status = bent(*ray, distance=250e3)
    assert status == FAR_BRANCH
    h_g = 3000.0 - 1e-6
    nearly, _ = bent(table, 3000.0, h_g, zeta, distance=250e3)
    assert_close(far, nearly, rtol=1e-7)
