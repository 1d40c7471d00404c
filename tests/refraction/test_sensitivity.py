"""Derivatives of R_c against differences in 30-digit arithmetic, in air written down again here."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest

from unbend.atmosphere import covariance, hypsometry, standard_atmosphere
from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.errors import PhysicsError
from unbend.geodesy import Gravity
from unbend.refraction import refraction_angle
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE
from unbend.refraction.uncertainty import adjoints
from unbend.refraction.uncertainty import sensitivity as weights
from unbend.refraction.uncertainty.sensitivity import ray_weights, sensitivity
from unbend.units import DEGREE, HYDROSTATIC_CONSTANT

DIGITS = 30
RADIUS = 6_371_000.0
G_PHI = 9.80616
R_PHI = 6_356_360.0

# Humid air with an inversion, an isothermal layer and a nearly isothermal one.
EDGES = [-300.0, 900.0, 1250.0, 4000.0, 7000.0, 9000.0, 14_000.0]  # [m']
T_M = [291.0, 284.0, 289.5, 270.0, 250.0, 250.0, 250.5]  # [K]
VAPOUR = [0.016, 0.012, 0.004, 0.002, 5e-4, 1e-4, 0.0]  # e/p
ANCHOR_M = 2000.0
ANCHOR_PA = 80_000.0

RAYS = {
    "10 km, 60 deg": (10_000.0, 0.0, 60.0),
    "10 km, 85 deg": (10_000.0, 0.0, 85.0),
    "10 km, 0.4 deg above the horizon": (10_000.0, 0.0, 86.53),
    "120 m, 45 deg": (620.0, 500.0, 45.0),
    "3 m": (503.0, 500.0, 70.0),
    "nearly nadir": (6000.0, 300.0, 1e-3),
    "to the inversion": (3000.0, 1000.0, 75.0),
    "upwards": (1000.0, 3000.0, 95.0),
    "nearly level upwards": (800.0, 5000.0, 90.2),
}


def profile_of(index: str = "gyer", t_m=T_M, vapour=VAPOUR) -> Profile:
    gravity = Gravity(G_PHI, R_PHI)
    layers = stack_layers(
        np.array(EDGES),
        np.asarray(t_m),
        np.asarray(vapour),
        ("",) * (len(EDGES) - 1),
        anchor=(float(gravity.geopotential_height(ANCHOR_M)), ANCHOR_PA),
    )
    return Profile(layers, gravity, IndexModel(index))


class Air:
    """The same air in multiple precision: its own hydrostatics and its own index."""

    def __init__(self, index: str) -> None:
        self.index = {"gyer": gyer, "ciddor": ciddor}[index]
        self.t = [mp.mpf(t) for t in T_M]
        self.x = [mp.mpf(x) for x in VAPOUR]
        self.log_p = mp.log(ANCHOR_PA)

    def changed(self, name: str, place: int, by: mp.mpf) -> Air:
        other = object.__new__(Air)
        other.__dict__ = {**self.__dict__, "t": list(self.t), "x": list(self.x)}
        if name == "log_p":
            other.log_p += by
        else:
            getattr(other, name)[place] += by
        return other

    def drop(self, i: int, low: mp.mpf, high: mp.mpf) -> mp.mpf:
        """Integral of dH / T_M between two heights of layer i."""
        slope = (self.t[i + 1] - self.t[i]) / (mp.mpf(EDGES[i + 1]) - EDGES[i])
        t_low, t_high = (self.t[i] + slope * (H - EDGES[i]) for H in (low, high))
        return (high - low) / t_low if slope == 0 else mp.log(t_high / t_low) / slope

    def settled(self) -> Air:
        """With ln p at the edges."""
        anchor = geopotential(mp.mpf(ANCHOR_M))
        a = next(i for i, H in enumerate(EDGES[1:]) if anchor <= H)
        log_p = {a: self.log_p + HYDROSTATIC_CONSTANT * self.drop(a, mp.mpf(EDGES[a]), anchor)}
        for i in range(a, len(EDGES) - 1):
            log_p[i + 1] = log_p[i] - HYDROSTATIC_CONSTANT * self.drop(
                i, mp.mpf(EDGES[i]), mp.mpf(EDGES[i + 1])
            )
        for i in reversed(range(a)):
            log_p[i] = log_p[i + 1] + HYDROSTATIC_CONSTANT * self.drop(
                i, mp.mpf(EDGES[i]), mp.mpf(EDGES[i + 1])
            )
        self.edge_log_p = log_p
        return self

    def refractivity(self, h: mp.mpf) -> mp.mpf:
        H = geopotential(h)
        i = next((i for i, top in enumerate(EDGES[1:]) if top >= H), len(EDGES) - 2)
        share = (H - EDGES[i]) / (mp.mpf(EDGES[i + 1]) - EDGES[i])
        t_m = self.t[i] + (self.t[i + 1] - self.t[i]) * share
        x = self.x[i] + (self.x[i + 1] - self.x[i]) * share
        p = mp.exp(self.edge_log_p[i] - HYDROSTATIC_CONSTANT * self.drop(i, mp.mpf(EDGES[i]), H))
        return self.index(t_m * (1 - mp.mpf("0.378") * x), p, x)


def geopotential(h: mp.mpf) -> mp.mpf:
    return R_PHI * h * G_PHI / ((R_PHI + h) * mp.mpf("9.80665"))


def height(H: float) -> mp.mpf:
    reduced = H * mp.mpf("9.80665") / G_PHI
    return R_PHI * reduced / (R_PHI - reduced)


def gyer(t: mp.mpf, p: mp.mpf, x: mp.mpf) -> mp.mpf:
    """Gyer 1996, Eq. 13."""
    return (mp.mpf("78.831e-8") - mp.mpf("11.036e-8") * x) * p / t


def ciddor(t: mp.mpf, p: mp.mpf, x: mp.mpf) -> mp.mpf:
    """Ciddor 1996 at 0.55 um and 450 ppm (Eq. 1-5, 12); molar masses drop out of the ratios."""

    def compressibility(t: mp.mpf, p: mp.mpf, x: mp.mpf) -> mp.mpf:
        c = t - mp.mpf("273.15")
        a = mp.mpf("1.58123e-6") - mp.mpf("2.9331e-8") * c + mp.mpf("1.1043e-10") * c**2
        b = mp.mpf("5.707e-6") - mp.mpf("2.051e-8") * c
        d = mp.mpf("1.9898e-4") - mp.mpf("2.376e-6") * c
        second = mp.mpf("1.83e-11") - mp.mpf("0.765e-8") * x**2
        return 1 - p / t * (a + b * x + d * x**2) + (p / t) ** 2 * second

    s = 1 / mp.mpf("0.55") ** 2
    n_air = mp.mpf("1e-8") * (5792105 / (mp.mpf("238.0185") - s) + 167917 / (mp.mpf("57.362") - s))
    polynomial = (295.235, 2.6422, -0.032380, 0.004028)
    n_water = mp.mpf("1.022e-8") * mp.fsum(mp.mpf(str(c)) * s**i for i, c in enumerate(polynomial))

    def amount(t: mp.mpf, p: mp.mpf, x: mp.mpf) -> mp.mpf:
        return p / (compressibility(t, p, x) * t)

    air = amount(t, p, x) * (1 - x) / amount(mp.mpf("288.15"), mp.mpf(101325), mp.mpf(0))
    water = amount(t, p, x) * x / amount(mp.mpf("293.15"), mp.mpf(1333), mp.mpf(1))
    return air * n_air + water * n_water


def gauss_legendre(count: int) -> list[tuple[mp.mpf, mp.mpf]]:
    """Nodes and weights to all digits: R_c is a small part of the angle that is integrated."""
    rule = []
    with mp.workdps(DIGITS):
        for x in map(mp.mpf, np.polynomial.legendre.leggauss(count)[0]):
            for _ in range(2):  # from 16 digits to 30 is one step of Newton's
                p = mp.legendre(count, x)
                slope = count * (x * p - mp.legendre(count - 1, x)) / (x * x - 1)
                x -= p / slope
            rule.append((x, 2 / ((1 - x * x) * slope**2)))
    return rule


NODES = gauss_legendre(14)


def angle(air: Air, h_c: mp.mpf, h_g: mp.mpf, zeta: mp.mpf) -> mp.mpf:
    """R_c by Gyer's Eq. 11 and 12, in panels that shrink towards the lower end."""
    air = air.settled()
    low = min(h_c, h_g)
    high = max(h_c, h_g)
    k = (1 + air.refractivity(h_c)) * (RADIUS + h_c) * mp.sin(zeta)
    excess = (1 + air.refractivity(low)) * (RADIUS + low) - k
    cuts = {low, high, *(h for h in map(height, EDGES) if low < h < high)}
    reach = 3 * excess
    while low + reach < high:
        cuts.add(low + reach)
        reach *= 4
    ordered = sorted(cuts)
    theta = mp.mpf(0)
    for a, b in pairwise(ordered):
        for x, w in NODES:
            h = (a + b) / 2 + (b - a) / 2 * x
            r = RADIUS + h
            n = 1 + air.refractivity(h)
            theta += w * (b - a) / 2 * k / (r * mp.sqrt((n * r) ** 2 - k**2))
    r_c = RADIUS + h_c
    r_g = RADIUS + h_g
    return zeta - mp.atan2(r_g * mp.sin(theta), r_c - r_g * mp.cos(theta))


@lru_cache
def differences(index: str, h_c: float, h_g: float, degrees: float) -> dict[str, np.ndarray]:
    """R_c and its central differences, with steps that leave 1e-11 of them."""
    with mp.workdps(DIGITS):
        air = Air(index)
        ray = [mp.mpf(h_c), mp.mpf(h_g), mp.mpf(degrees * DEGREE)]

        def by_air(name: str, step: mp.mpf, place: int = 0) -> float:
            one, two = (angle(air.changed(name, place, s), *ray) for s in (step, -step))
            return float((one - two) / (2 * step))

        def by_ray(place: int, step: mp.mpf) -> float:
            moved = [[*ray[:place], ray[place] + s, *ray[place + 1 :]] for s in (step, -step)]
            one, two = (angle(air, *m) for m in moved)
            return float((one - two) / (2 * step))

        edges = range(len(EDGES))
        tiny = mp.mpf("1e-7")
        metre = mp.mpf("1e-5")
        return {
            "r_c": np.array(float(angle(air, *ray))),
            "d_temperature": np.array([by_air("t", mp.mpf("1e-5"), i) for i in edges]),
            "d_vapour": np.array([by_air("x", tiny, i) for i in edges]),
            "d_log_pressure": np.array(by_air("log_p", tiny)),
            "d_h_c": np.array(by_ray(0, metre)),
            "d_h_g": np.array(by_ray(1, metre)),
            "d_zeta_c": np.array(by_ray(2, mp.mpf("1e-9"))),
        }


def worst(index: str, h_c: float, h_g: float, degrees: float) -> dict[str, float]:
    """Largest error of each derivative, in parts of the largest of its kind."""
    expected = differences(index, h_c, h_g, degrees)
    found = sensitivity(
        profile_of(index), h_c, h_g, degrees * DEGREE, RADIUS, anchor_height_m=ANCHOR_M
    )
    assert found.valid
    assert found.d_pressure == pytest.approx(found.d_log_pressure / ANCHOR_PA, rel=1e-14)
    return {
        name: float(np.abs(getattr(found, name) - value).max() / np.abs(value).max())
        for name, value in expected.items()
    }


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS.keys())
def test_derivatives_against_differences_of_thirty_digits(ray):
    # Reached: 3e-10 upwards through the inversion, 4e-11 elsewhere; in dR/dzeta of the ray of 3 m,
    # which is 2e-7, 2e-9.
    errors = worst("gyer", *ray)
    assert max(errors.values()) < 5e-9, errors


def test_derivatives_through_humid_air_with_the_index_of_ciddor():
    # Reached: 9e-12.
    errors = worst("ciddor", *RAYS["to the inversion"])
    assert max(errors.values()) < 1e-10, errors


def turned(function, which=slice(None)):
    """A function that returns the opposite of some of its results."""

    def wrong(*arguments):
        result = function(*arguments)
        if isinstance(result, tuple):
            flips = [-1.0 if i in range(len(result))[which] else 1.0 for i in range(len(result))]
            return tuple(f * r for f, r in zip(flips, result, strict=True))
        return -result

    return wrong


@pytest.mark.parametrize(
    ("module", "name", "which"),
    [
        (hypsometry, "_layer", slice(1, 3)),
        (hypsometry, "_layer", slice(2, 3)),
        (covariance, "_index_partials", slice(0, 1)),
        (covariance, "_index_partials", slice(2, 3)),
        (adjoints, "_by_target_height", slice(None)),
    ],
)
def test_a_sign_turned_over_is_seen(monkeypatch, module, name, which):
    ray = RAYS["120 m, 45 deg"]
    assert max(worst("gyer", *ray).values()) < 5e-9
    monkeypatch.setattr(module, name, turned(getattr(module, name), which))
    assert max(worst("gyer", *ray).values()) > 1e-3


@pytest.mark.parametrize("index", ["gyer", "ciddor"])
def test_refractivity_of_the_layers_against_differences_of_thirty_digits(index):
    h = np.array([-250.0, 905.0, 1100.0, ANCHOR_M, 6500.0, 8000.0, 13_000.0])
    found = air_jacobian(profile_of(index), h, ANCHOR_M)
    edges = len(EDGES)
    with mp.workdps(DIGITS):
        for name, values in (("t", found[:, :edges]), ("x", found[:, edges + 1 :])):
            step = mp.mpf("1e-6")
            for i in range(len(EDGES)):
                one, two = (Air(index).changed(name, i, s).settled() for s in (step, -step))
                expected = [
                    float((one.refractivity(z) - two.refractivity(z)) / (2 * step))
                    for z in map(mp.mpf, h)
                ]
                # Reached: 3e-13 of the largest.
                scale = np.abs(values).max()
                np.testing.assert_allclose(values[:, i], expected, rtol=0.0, atol=2e-12 * scale)


def horizon(profile: Profile, h_c: float) -> float:
    """Nadir angle [rad] at which a ray just touches sea level."""
    n_c, n_g = (1.0 + float(profile.refractivity(h)) for h in (h_c, 0.0))
    return math.asin(n_g * RADIUS / (n_c * (RADIUS + h_c)))


@pytest.mark.parametrize(("h_c", "below"), [(10_000.0, 1e-2), (300.0, 1e-5)])
def test_near_the_horizon(h_c, below):
    profile = profile_of()
    zeta = horizon(profile, h_c) - below * DEGREE
    found = sensitivity(profile, h_c, 0.0, zeta, RADIUS, anchor_height_m=ANCHOR_M)
    assert found.valid
    with mp.workdps(DIGITS):
        ray = [mp.mpf(h_c), mp.mpf(0), mp.mpf(zeta)]
        step = mp.mpf("1e-10")
        one, two = (angle(Air("gyer").changed("t", 1, s), *ray) for s in (step, -step))
        by_t = float((one - two) / (2 * step))
        one, two = (angle(Air("gyer"), *ray[:2], ray[2] + s * 1e-6) for s in (step, -step))
        by_zeta = float((one - two) / (2e-6 * step))
    # Reached: 2e-12.
    assert found.d_temperature[1] == pytest.approx(by_t, rel=1e-10)
    assert found.d_zeta_c == pytest.approx(by_zeta, rel=1e-10)


def test_what_cannot_be_differentiated_says_so():
    profile = profile_of()
    level = horizon(profile, 3000.0)
    h_c = [3000.0, 3000.0, 3000.0, 3000.0, 3000.0, 3000.0, 20_000.0, 3000.0]
    h_g = [0.0, 0.0, 0.0, 4000.0, 4000.0, 0.0, 0.0, 1000.0]
    zeta = [level - 1e-13, level + 0.01, 2.0, 89.9 * DEGREE, 0.5 * math.pi, math.nan, 0.5, 0.5]
    found = sensitivity(profile, h_c, h_g, zeta, RADIUS)
    # Level at the ground; below the horizon; upwards to the ground; through the lowest point.
    assert found.valid.tolist() == [False] * 7 + [True]
    assert found.status.tolist()[1:] == [
        MISSES_GROUND,
        MISSES_GROUND,
        OK,
        OK,
        BAD_MEASUREMENT,
        OUTSIDE_PROFILE,
        OK,
    ]
    for name in ("d_temperature", "d_vapour", "d_log_pressure", "d_h_c", "d_h_g", "d_zeta_c"):
        row = np.isfinite(getattr(found, name).reshape(8, -1))
        assert row.any(axis=1).tolist() == row.all(axis=1).tolist() == found.valid.tolist(), name
    nothing = sensitivity(profile, 3000.0, 0.0, [math.nan, 2.0], RADIUS)
    assert not nothing.valid.any()
    assert np.isnan(nothing.d_temperature).all()


def bend_difference(change, step: float, *ray: float) -> float:
    """Fourth-order difference of the package's own angle; ``change`` makes a profile."""
    at = [refraction_angle(change(s * step), *ray, RADIUS) for s in (-2.0, -1.0, 1.0, 2.0)]
    return (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * step)


@pytest.mark.parametrize("ray", [(10_000.0, 0.0, 1.3), (2500.0, 800.0, 0.7), (900.0, 6000.0, 1.9)])
def test_uniform_warming_is_the_sum_over_the_edges(ray):
    found = sensitivity(
        profile_of("ciddor"), *ray, RADIUS, anchor_height_m=ANCHOR_M
    ).d_temperature.sum()
    expected = bend_difference(lambda s: profile_of("ciddor", np.add(T_M, s)), 0.2, *ray)
    # Reached: 1e-12.
    assert found == pytest.approx(expected, rel=1e-9)


def test_from_virtual_temperature_to_the_thermometer():
    """The two formulas in the docstring of air_jacobian, for edge 1."""
    ray = (3000.0, 200.0, 1.1)
    found = sensitivity(profile_of("ciddor"), *ray, RADIUS, anchor_height_m=ANCHOR_M)
    wet = 0.378 * VAPOUR[1]
    kelvin = T_M[1] * (1.0 - wet)

    def air(warmer: float, moister: float) -> Profile:
        t_m = np.array(T_M)
        x = np.array(VAPOUR)
        x[1] += moister
        t_m[1] = (kelvin + warmer) / (1.0 - 0.378 * x[1])
        return profile_of("ciddor", t_m, x)

    by_t = found.d_temperature[1] / (1.0 - wet)
    by_x = found.d_vapour[1] + found.d_temperature[1] * 0.378 * T_M[1] / (1.0 - wet)
    # Reached: 2e-12.
    assert by_t == pytest.approx(bend_difference(lambda s: air(s, 0.0), 0.2, *ray), rel=1e-9)
    assert by_x == pytest.approx(bend_difference(lambda s: air(0.0, s), 1e-3, *ray), rel=1e-9)


def test_weights_on_any_change_of_refractivity():
    """A denser layer of air, added to n; and n scaled as a whole, which bends nothing."""
    profile = standard_atmosphere("us1976", index="gyer")
    found = ray_weights(profile, 8000.0, 100.0, [[0.6], [1.35]], RADIUS)
    assert found.weight.shape == (2, 1, found.height_m.size)
    n = profile.refractivity(found.height_m)
    scale = np.abs(found.weight).max()
    assert np.abs(found.weight @ (1.0 + n)).max() < 1e-13 * scale
    # Gyer's N is proportional to p: dR/d ln p is the weights on N itself.
    for row, zeta in zip(found.weight[:, 0], (0.6, 1.35), strict=True):
        expected = bend_difference(
            lambda s: profile.at_level(0.0, 101_325.0 * math.exp(s)), 0.01, 8000.0, 100.0, zeta
        )
        assert row @ n == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("zeta", [0.8, 2.2])
def test_a_target_at_the_height_of_the_camera(zeta):
    profile = profile_of()
    h_c = 2000.0
    rise = 1.0 if zeta > 1.6 else -1.0
    n = profile.refractivity([h_c - 1.0, h_c, h_c + 1.0])
    expected = math.tan(zeta) * (n[2] - n[0]) / 2.0 / (1.0 + n[1]) / 2.0
    found = sensitivity(profile, h_c, [h_c, h_c + rise * 1e-6, h_c + rise * 1e-2], zeta, RADIUS)
    assert found.valid.all()
    # The last is an ordinary ray of 1 cm: reached 5e-7, the curvature of N over it.
    np.testing.assert_allclose(found.d_h_g, expected, rtol=1e-5)
    np.testing.assert_allclose(found.d_h_c, -expected, rtol=1e-5)
    assert found.d_temperature[0].tolist() == [0.0] * len(EDGES)


def test_straight_down_only_the_angle_counts():
    found = sensitivity(profile_of(), 5000.0, 100.0, 0.0, RADIUS)
    for name in ("d_h_c", "d_h_g", "d_log_pressure"):
        assert getattr(found, name) == 0.0
    assert not found.d_temperature.any()
    # R_c grows as tan zeta_c.
    assert found.d_zeta_c == pytest.approx(
        refraction_angle(profile_of(), 5000.0, 100.0, 1e-6, RADIUS) / 1e-6, rel=1e-8
    )


def test_many_rays_are_each_what_they_are_alone(monkeypatch):
    monkeypatch.setattr(weights, "_BLOCK", 3000)
    profile = profile_of("ciddor")
    h_c = np.array([9000.0, 1200.0, 4000.0])
    zeta = np.array([[0.2], [1.5], [0.9], [1.2]])
    together = sensitivity(profile, h_c, 0.0, zeta, RADIUS, anchor_height_m=ANCHOR_M)
    assert together.d_temperature.shape == (4, 3, len(EDGES))
    for i in range(4):
        for j in range(3):
            alone = sensitivity(profile, h_c[j], 0.0, zeta[i, 0], RADIUS, anchor_height_m=ANCHOR_M)
            np.testing.assert_allclose(
                together.d_temperature[i, j], alone.d_temperature, rtol=1e-9, atol=1e-20
            )
            assert together.d_h_g[i, j] == pytest.approx(float(alone.d_h_g), rel=1e-9)


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 0), (1, 1)], ids=str)
def test_no_ray_and_one_ray_have_their_shape(shape):
    """Broadcast views that are contiguous all the same, of which numpy warned."""
    profile = profile_of()
    found = sensitivity(profile, np.full(shape, 3000.0), 0.0, 0.5, RADIUS)
    assert found.r_c.shape == found.status.shape == found.valid.shape == shape
    assert found.d_temperature.shape == (*shape, len(EDGES))
    alone = sensitivity(profile, 3000.0, 0.0, 0.5, RADIUS)
    assert (found.d_zeta_c == alone.d_zeta_c).all()
    rays = ray_weights(profile, 3000.0, np.zeros(shape), 0.5, RADIUS)
    assert rays.weight.shape == (*shape, rays.height_m.size)


def test_pressure_is_referred_to_a_height_inside_the_profile():
    with pytest.raises(PhysicsError) as refusal:
        sensitivity(profile_of(), 3000.0, 0.0, 0.5, RADIUS, anchor_height_m=20_000.0)
    assert refusal.value.code == "PROFILE-RANGE"
    assert "20000 m" in refusal.value.what
    outside = air_jacobian(profile_of(), [-1000.0, 100.0, 20_000.0], 0.0)
    assert np.isfinite(outside[:, : len(EDGES)]).all(axis=1).tolist() == [False, True, False]
