"""Air in which n r falls with height: rays that bend more than the earth does."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.standard import standard_atmosphere
from unbend.geodesy import lambert_gravity
from unbend.refraction import bend, ray_table, refraction_angle
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, OK
from unbend.units import ARCSEC

RADIUS = 6_371_000.0
LONG = np.longdouble


def duct(warming):
    """A layer of 30 m over the ground that warms upwards by so many kelvins a metre."""
    edge = np.array([-500.0, 0.0, 30.0, 60.0, 1000.0, 11_000.0, 35_000.0])
    top = 285.0 + 30.0 * warming
    t = np.array([285.0, 285.0, top, top + 1.0, 285.0, 220.0, 220.0])
    layers = stack_layers(edge, t, 0.0 * t, ("measured",) * 6, anchor=(0.0, 101_325.0))
    return Profile(layers, lambert_gravity(0.7), IndexModel("gyer"))


def expected(table, h_c, h_g, zeta):
    """R_c [arcsec] by Gyer's Eq. 12 in 80 bits, graded towards both ends of every piece; NaN where
    the ray turns on its way."""
    nodes, weights = (a.astype(LONG) for a in np.polynomial.legendre.leggauss(20))
    edge = table.edge_m.astype(LONG)
    radius = LONG(RADIUS)
    h_c = LONG(h_c)
    h_g = LONG(h_g)
    zeta = LONG(zeta)

    def value(i, h):
        u = (h - edge[i]) / (edge[i + 1] - edge[i])
        return sum(LONG(c) * u**j for j, c in enumerate(table.coefficient[i]))

    first, last = (int(np.searchsorted(table.edge_m, float(h), "right")) - 1 for h in (h_g, h_c))
    n_c = value(last, h_c)
    lift = np.cos(zeta) ** 2 / (1 + np.sin(zeta))  # 1 - sin(zeta)
    lift = lift * (1 + n_c) * (radius + h_c)
    k = (1 + n_c) * (radius + h_c) - lift
    theta = LONG(0)
    for i in range(first, last + 1):
        low = max(h_g, edge[i])
        high = min(h_c, edge[i + 1])
        half = (high - low) / 2
        panels = np.concatenate([[LONG(0)], np.sqrt(half) * LONG(2) ** -np.arange(38, -1, -1)])
        for base, sense in ((low, 1), (high, -1)):
            for s_0, s_1 in pairwise(panels):
                s = s_0 + (s_1 - s_0) * (nodes + 1) / 2
                h = base + sense * s * s
                excess = (radius + h) * (value(i, h) - n_c) + (1 + n_c) * (h - h_c) + lift
                if not (excess > 0).all():
                    return math.nan
                slope = 2 * s * k / ((radius + h) * np.sqrt(excess * (excess + 2 * k)))
                theta += np.sum(weights * slope) * (s_1 - s_0) / 2
    ahead = (h_c - h_g) / (radius + h_g) + 2 * np.sin(theta / 2) ** 2
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    across = np.sin(theta)
    return float(
        np.arctan2(sine * ahead - cosine * across, cosine * ahead + sine * across) / LONG(ARCSEC)
    )


@pytest.mark.parametrize("warming", [0.10, 0.15, 0.5])
def test_rays_in_a_duct(warming):
    table = ray_table(duct(warming))
    rng = np.random.default_rng(4)
    seen = 0
    for _ in range(40):
        h_c = rng.uniform(5.0, 60.0)
        h_g = rng.uniform(0.0, h_c)
        zeta = math.pi / 2 - 10.0 ** rng.uniform(-6.0, -2.0)
        angle, status = bend(table, h_c, h_g, math.sin(zeta), math.cos(zeta), radius=RADIUS)
        wanted = expected(table, h_c, h_g, zeta)
        if not math.isnan(wanted):
            seen += 1
            assert status in (OK, BEYOND_GRAZING)
            # Reached: 2e-10 arcsec of up to 850.
            assert angle / ARCSEC == pytest.approx(wanted, abs=1e-8), (h_c, h_g, zeta)
    assert seen > 8


def test_the_ray_that_was_forty_seconds_off():
    """A reviewer's: level near the upper end of the duct, where the singularity is."""
    h_c = 26.398259481305864
    h_g = 5.365223018200361
    zeta = 1.5707926881833847
    found = refraction_angle(duct(0.15), h_c, h_g, zeta, RADIUS) / ARCSEC
    assert found == pytest.approx(expected(ray_table(duct(0.15)), h_c, h_g, zeta), abs=1e-8)


def test_grazing_the_top_of_a_duct_from_above():
    table = ray_table(duct(0.15))
    top = float(table.edge_m[3])
    n = [1.0 + float(duct(0.15).refractivity(h)) for h in (top, 1658.7)]
    level = math.asin(n[0] * (RADIUS + top) / (n[1] * (RADIUS + 1658.7)))
    for below in (1e-7, 1e-5, 1e-3):
        zeta = level - below
        angle, _ = bend(table, 1658.7, 17.9, math.sin(zeta), math.cos(zeta), radius=RADIUS)
        assert angle / ARCSEC == pytest.approx(expected(table, 1658.7, 17.9, zeta), abs=1e-7)


def test_a_tenth_of_a_microdegree_from_level():
    air = standard_atmosphere("us1976", index="gyer")
    found = refraction_angle(air, 9573.849234696296, 9573.951100392289, 1.5707963284804676)
    assert found / ARCSEC == pytest.approx(1.4722366, abs=1e-6)  # 40 digits: 1.4722366


def test_the_far_crossing_of_the_cameras_own_height():
    table = ray_table(standard_atmosphere("us1976"))
    zeta = math.pi / 2 - 0.02
    given = (math.sin(zeta), math.cos(zeta))
    nothing, at_camera = bend(table, 3000.0, 3000.0, *given, radius=RADIUS)
    assert nothing == 0.0
    assert at_camera == BEYOND_GRAZING
    far, status = bend(table, 3000.0, 3000.0, *given, radius=RADIUS, distance=250e3)
    nearly, _ = bend(table, 3000.0, 3000.0 - 1e-6, *given, radius=RADIUS, distance=250e3)
    assert status == FAR_BRANCH
    assert far == pytest.approx(float(nearly), rel=1e-7)
