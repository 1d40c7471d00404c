"""Rays: the kernel beside `scipy.integrate.quad`, one ray at a time.

quad integrates the same formulas written out in plain floats for one layer of dry air, which is 40
times as fast as over the functions of arrays of this package.
"""

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import quad
from survey import air

from unbend.refraction import bend, ray_table

RAYS = 2_000_000
CAMERAS = 400
BY_QUAD = 3_000
RADIUS = 6_371_000.0
H_C = 6000.0
SAME = 1e-6 * 4.85e-6  # a millionth of an arcsecond [rad]

# US 1976 at the ground, and below 11 km
P_0 = 101_325.0
T_0 = 288.15
LAPSE = 0.0065
EXPONENT = 9.80665 * 28.9644 / 8314.32 / LAPSE
EARTH = 6_356_766.0


def refractivity_ciddor() -> Callable[[float], float]:
    """n - 1 of dry US 1976 air in the troposphere, in plain floats: Ciddor 1996 at 0.55 um."""
    s2 = (1.0 / 0.55) ** 2
    n_axs = (5_792_105.0 / (238.0185 - s2) + 167_917.0 / (57.362 - s2)) * 1e-8

    def compressibility(p: float, t: float) -> float:
        c = t - 273.15
        first = 1.58123e-6 - 2.9331e-8 * c + 1.1043e-10 * c * c
        second = 1.83e-11 * (p / t) ** 2
        return 1.0 - p / t * first + second

    factor = n_axs * compressibility(P_0, T_0) / (P_0 / T_0)

    def refractivity(h: float) -> float:
        t = T_0 - LAPSE * (EARTH * h / (EARTH + h))
        p = P_0 * (t / T_0) ** EXPONENT
        return factor * (p / t) / compressibility(p, t)

    return refractivity


def angle_by_quad(
    refractivity: Callable[[float], float],
    h_g: float,
    zeta: float,
) -> float:
    """R_c by the same difference form, with scipy's adaptive quadrature to 1e-9 arcsec."""
    n_c = refractivity(H_C)
    r_c = RADIUS + H_C
    r_g = RADIUS + h_g
    index2 = (1.0 + n_c) ** 2
    s = r_c * math.sin(zeta)
    b_c = r_c * math.cos(zeta)
    b2_c = b_c**2

    def integrand(h: float) -> float:
        n = refractivity(h)
        r = RADIUS + h
        m = (n - n_c) * (2.0 + n + n_c)
        fall = (H_C - h) * (r_c + r)
        straight2 = index2 * (b2_c - fall)
        a = math.sqrt(straight2 + m * r * r)
        b = math.sqrt(straight2)
        return m * r / (a * b * (a + b))

    integral, _ = quad(
        integrand,
        h_g,
        H_C,
        epsabs=0.0,
        epsrel=1e-11,
    )
    half = 0.5 * (1.0 + n_c) * s * integral
    fall = (H_C - h_g) * (r_c + r_g)
    q = math.sqrt(b2_c - fall)
    turned = math.atan2(s, q) - half
    chord = fall / (b_c + q)
    across = 2.0 * r_g * math.sin(half)
    return math.atan2(
        across * math.cos(turned),
        chord - across * math.sin(turned),
    )


def test_kernel_beside_quad_over_plain_floats(ratios):
    refractivity = refractivity_ciddor()
    rng = np.random.default_rng(1)
    table = ray_table(air())
    h_g = rng.uniform(0.0, 2000.0, RAYS)
    zeta = rng.uniform(0.0, math.radians(65.0), RAYS)
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    h_c = np.repeat(H_C + 0.01 * np.arange(CAMERAS), RAYS // CAMERAS)
    few = slice(0, BY_QUAD)
    rays = list(zip(h_g[few].tolist(), zeta[few].tolist(), strict=True))

    def by_kernel():
        bend(table, h_c, h_g, sine, cosine, radius=RADIUS)

    def by_quad() -> list[float]:
        return [angle_by_quad(refractivity, *ray) for ray in rays]

    bent, _ = bend(
        table,
        H_C,
        h_g[few],
        sine[few],
        cosine[few],
        radius=RADIUS,
    )
    assert np.abs(bent - by_quad()).max() < SAME, "the two are not the same ray"

    ratio = ratios.of_times(by_kernel, by_quad, counts=(RAYS, BY_QUAD))
    ratios.check("rays, times as fast as scipy's quad over plain floats", ratio, at_least=200.0)
