"""Derivatives of R_c against differences of angles, the package's and those of thirty digits."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.errors import PhysicsError
from unbend.geodesy import Gravity
from unbend.refraction import ray_weights, refraction_angle, sensitivity
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE
from unbend.units import DEGREE

RADIUS = 6_371_000.0
GRAVITY = Gravity(9.80616, 6_356_360.0)

# Humid air with an inversion, an isothermal layer and a nearly isothermal one.
EDGES = np.array([-300.0, 900.0, 1250.0, 4000.0, 7000.0, 9000.0, 14_000.0])  # [m']
T_M = np.array([291.0, 284.0, 289.5, 270.0, 250.0, 250.0, 250.5])  # [K]
VAPOUR = np.array([0.016, 0.012, 0.004, 0.002, 5e-4, 1e-4, 0.0])  # e/p
ANCHOR_M = 2000.0
ANCHOR_PA = 80_000.0

RAYS = {
    "10 km, 60 deg": (10_000.0, 0.0, 60.0),
    "10 km, 85 deg": (10_000.0, 0.0, 85.0),
    "10 km, 0.4 deg above the horizon": (10_000.0, 0.0, 86.53),
    "120 m, 45 deg": (620.0, 500.0, 45.0),
    "3 m": (503.0, 500.0, 70.0),
    "nearly nadir": (6000.0, 300.0, 1e-2),
    "to the inversion": (3000.0, 1000.0, 75.0),
    "upwards": (1000.0, 3000.0, 95.0),
    "nearly level upwards": (800.0, 5000.0, 90.2),
}


def profile_of(index: str = "gyer", t_m=T_M, vapour=VAPOUR, log_pressure: float = 0.0) -> Profile:
    """The air, with a change of the logarithm of pressure at the anchor."""
    anchor = float(GRAVITY.geopotential_height(ANCHOR_M))
    layers = stack_layers(
        EDGES,
        np.asarray(t_m),
        np.asarray(vapour),
        ("",) * (EDGES.size - 1),
        anchor=(anchor, ANCHOR_PA * math.exp(log_pressure)),
    )
    return Profile(layers, GRAVITY, IndexModel(index))


def sensitivity_of(ray, index: str = "gyer"):
    h_c, h_g, degrees = ray
    profile = profile_of(index)
    return sensitivity(profile, h_c, h_g, degrees * DEGREE, RADIUS, anchor_height_m=ANCHOR_M)


def difference(function, step: float) -> float:
    """Central difference of fourth order of a function at zero."""
    far = function(2.0 * step) - function(-2.0 * step)
    near = function(step) - function(-step)
    return (8.0 * near - far) / (12.0 * step)


UNIT = np.eye(EDGES.size)
# By the name of a derivative: the air with a change of what it is by, and a step that leaves 1e-9.
BY_AIR = {
    "d_temperature": (lambda index, s, i: profile_of(index, t_m=T_M + s * UNIT[i]), 0.03),
    "d_vapour": (lambda index, s, i: profile_of(index, vapour=VAPOUR + s * UNIT[i]), 2e-4),
    "d_log_pressure": (lambda index, s, _: profile_of(index, log_pressure=s), 1e-4),
}
BY_PLACE = {"d_h_c": (0, 0.3), "d_h_g": (1, 0.3), "d_zeta_c": (2, 1e-5)}


def assert_derivative(derivative, expected) -> None:
    """To 5e-9 of the largest of its kind."""
    largest = np.abs(expected).max()
    assert_near(derivative, expected, atol=5e-9 * largest)


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS.keys())
@pytest.mark.parametrize("index", ["gyer", "ciddor"])
@pytest.mark.parametrize("name", BY_AIR)
def test_derivatives_by_the_air_against_differences(name, index, ray):
    h_c, h_g, degrees = ray
    changed_air, step = BY_AIR[name]
    expected = []
    for i in range(EDGES.size if name != "d_log_pressure" else 1):

        def angle(change, i=i):
            air = changed_air(index, change, i)
            return refraction_angle(air, h_c, h_g, degrees * DEGREE, RADIUS)

        expected.append(difference(angle, step))
    derivatives = sensitivity_of(ray, index)
    assert derivatives.valid
    assert_derivative(getattr(derivatives, name), np.squeeze(expected))
    assert derivatives.d_pressure == pytest.approx(
        derivatives.d_log_pressure / ANCHOR_PA, rel=1e-14
    )


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS.keys())
@pytest.mark.parametrize("name", BY_PLACE)
def test_derivatives_by_the_places_and_the_angle_against_differences(name, ray):
    argument, step = BY_PLACE[name]
    h_c, h_g, degrees = ray

    def angle(change):
        arguments = np.array([h_c, h_g, degrees * DEGREE])
        arguments[argument] += change
        return refraction_angle(profile_of(), *arguments.tolist(), RADIUS)

    assert_derivative(getattr(sensitivity_of(ray), name), difference(angle, step))


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS.keys())
@pytest.mark.parametrize("index", ["gyer", "ciddor"])
def test_the_angle_beside_its_derivatives_is_the_refraction_angle(index, ray):
    h_c, h_g, degrees = ray
    expected = refraction_angle(profile_of(index), h_c, h_g, degrees * DEGREE, RADIUS)
    assert sensitivity_of(ray, index).r_c == pytest.approx(expected, rel=1e-11)


def test_from_virtual_temperature_to_the_thermometer():
    """The two formulas in the docstring of air_jacobian, for edge 1."""
    ray = RAYS["to the inversion"]
    h_c, h_g, degrees = ray
    derivatives = sensitivity_of(ray, "ciddor")
    dry = 1.0 - 0.378 * VAPOUR[1]

    def angle(warmer: float, moister: float) -> float:
        vapour = VAPOUR + moister * UNIT[1]
        t_m = T_M.copy()
        t_m[1] = (T_M[1] * dry + warmer) / (1.0 - 0.378 * vapour[1])
        air = profile_of("ciddor", t_m, vapour)
        return refraction_angle(air, h_c, h_g, degrees * DEGREE, RADIUS)

    by_t = derivatives.d_temperature[1] / dry
    by_x = derivatives.d_vapour[1] + derivatives.d_temperature[1] * 0.378 * T_M[1] / dry
    # Reached: 2e-12.
    assert by_t == pytest.approx(difference(lambda s: angle(s, 0.0), 0.2), rel=1e-9)
    assert by_x == pytest.approx(difference(lambda s: angle(0.0, s), 1e-3), rel=1e-9)


@pytest.mark.parametrize("index", ["gyer", "ciddor"])
def test_the_refractivity_of_layers_against_differences(index):
    h = np.array([-250.0, 905.0, 1100.0, ANCHOR_M, 6500.0, 8000.0, 13_000.0])
    jacobian = air_jacobian(profile_of(index), h, ANCHOR_M)
    by_temperature = jacobian[:, : EDGES.size]
    by_vapour = jacobian[:, EDGES.size + 1 :]
    for name, derivative in (("d_temperature", by_temperature), ("d_vapour", by_vapour)):
        changed_air, step = BY_AIR[name]
        for i in range(EDGES.size):

            def refractivity(change, changed_air=changed_air, i=i):
                return changed_air(index, change, i).refractivity(h)

            largest = np.abs(derivative).max()
            expected = difference(refractivity, 10.0 * step)
            assert_near(derivative[:, i], expected, atol=1e-10 * largest)


@pytest.mark.parametrize(
    ("h_c", "below"),
    [
        (10_000.0, 1e-2),
        (300.0, 1e-5),
    ],
)
def test_near_the_horizon_against_thirty_digits(truth, h_c, below):
    """``below`` degrees under the nadir angle at which the ray would just touch sea level."""
    profile = standard_atmosphere("us1976", index="gyer")
    n_c, n_g = 1.0 + profile.refractivity([h_c, 0.0])
    zeta = math.asin(n_g * RADIUS / (n_c * (RADIUS + h_c))) - below * DEGREE
    derivatives = sensitivity(profile, h_c, 0.0, zeta, RADIUS)
    assert derivatives.valid
    with mp.workdps(30):
        tiny = mp.mpf("1e-12")

        def angle(change, argument=0, pressure_ratio=1):
            ray = [mp.mpf(h_c), mp.mpf(0), mp.mpf(zeta)]
            ray[argument] += change
            return truth(30, pressure_ratio).crossing(*ray, grazing=True).r_c

        def slope(function, step):
            return float((function(step) - function(-step)) / (2 * step))

        by_log_pressure = slope(lambda s: angle(0, pressure_ratio=mp.exp(s)), 10 * tiny)
        by_h_c = slope(lambda s: angle(s, 0), 10**5 * tiny)
        by_h_g = slope(lambda s: angle(s, 1), 10**5 * tiny)
        by_zeta_c = slope(lambda s: angle(s, 2), tiny)
    assert derivatives.d_log_pressure == pytest.approx(by_log_pressure, rel=1e-9)
    assert derivatives.d_h_c == pytest.approx(by_h_c, rel=1e-8)
    assert derivatives.d_h_g == pytest.approx(by_h_g, rel=1e-8)
    assert derivatives.d_zeta_c == pytest.approx(by_zeta_c, rel=1e-10)


@pytest.mark.parametrize(("h_c", "below", "step"), [(10_000.0, 1e-2, 0.03), (300.0, 1e-5, 1e-3)])
def test_near_the_horizon_uniform_warming_is_the_sum_over_the_edges(h_c, below, step):
    profile = profile_of()
    n_c, n_g = 1.0 + profile.refractivity([h_c, 0.0])
    zeta = math.asin(n_g * RADIUS / (n_c * (RADIUS + h_c))) - below * DEGREE
    derivatives = sensitivity(profile, h_c, 0.0, zeta, RADIUS, anchor_height_m=ANCHOR_M)
    assert derivatives.valid

    def angle(warmer):
        return refraction_angle(profile_of(t_m=T_M + warmer), h_c, 0.0, zeta, RADIUS)

    expected = difference(angle, step)
    assert derivatives.d_temperature.sum() == pytest.approx(expected, rel=1e-6)


def test_what_cannot_be_differentiated_says_so():
    profile = profile_of()
    n_c, n_g = 1.0 + profile.refractivity([3000.0, 0.0])
    level = math.asin(n_g * RADIUS / (n_c * (RADIUS + 3000.0)))
    table = [
        # h_c, h_g, zeta_c, status
        (3000.0, 0.0, level - 1e-13, OK),  # level at the ground
        (3000.0, 0.0, level + 0.01, MISSES_GROUND),
        (3000.0, 0.0, 2.0, MISSES_GROUND),
        (3000.0, 4000.0, 89.9 * DEGREE, OK),  # through the lowest point
        (3000.0, 4000.0, 0.5 * math.pi, OK),
        (3000.0, 0.0, math.nan, BAD_MEASUREMENT),
        (20_000.0, 0.0, 0.5, OUTSIDE_PROFILE),
        (3000.0, 1000.0, 0.5, OK),
    ]
    h_c, h_g, zeta, status = np.array(table).T
    derivatives = sensitivity(profile, h_c, h_g, zeta, RADIUS)
    assert derivatives.valid.tolist() == [False] * 7 + [True]
    assert derivatives.status[1:].tolist() == status[1:].tolist()
    for name in (*BY_AIR, *BY_PLACE):
        is_number = np.isfinite(getattr(derivatives, name).reshape(8, -1))
        assert is_number.any(axis=1).tolist() == derivatives.valid.tolist(), name
        assert is_number.all(axis=1).tolist() == derivatives.valid.tolist(), name
    nothing = sensitivity(profile, 3000.0, 0.0, [math.nan, 2.0], RADIUS)
    assert not nothing.valid.any()
    assert np.isnan(nothing.d_temperature).all()


@pytest.mark.parametrize("zeta", [0.6, 1.35])
def test_weights_on_any_change_of_refractivity(zeta):
    """A denser layer of air, added to n; and n scaled as a whole, which bends nothing."""
    profile = standard_atmosphere("us1976", index="gyer")
    weights = ray_weights(profile, 8000.0, 100.0, [[zeta]], RADIUS)
    assert weights.weight.shape == (1, 1, weights.height_m.size)
    weight = weights.weight[0, 0]
    n = profile.refractivity(weights.height_m)
    assert abs(weight @ (1.0 + n)) < 1e-13 * np.abs(weight).max()

    def angle(log_pressure):
        air = profile.at_level(0.0, 101_325.0 * math.exp(log_pressure))
        return refraction_angle(air, 8000.0, 100.0, zeta, RADIUS)

    # Gyer's N is proportional to p: dR/d ln p is the weights on N itself.
    assert weight @ n == pytest.approx(difference(angle, 0.01), rel=1e-8)


@pytest.mark.parametrize(
    ("zeta", "rise"),
    [
        (0.8, -1.0),
        (2.2, 1.0),
    ],
)
def test_a_target_at_the_height_of_the_camera(zeta, rise):
    profile = profile_of()
    h_c = 2000.0
    n_below, n_c, n_above = profile.refractivity([h_c - 1.0, h_c, h_c + 1.0])
    expected = math.tan(zeta) * (n_above - n_below) / 2.0 / (1.0 + n_c) / 2.0
    derivatives = sensitivity(
        profile, h_c, [h_c, h_c + rise * 1e-6, h_c + rise * 1e-2], zeta, RADIUS
    )
    assert derivatives.valid.all()
    # The last is an ordinary ray of 1 cm: reached 5e-7, the curvature of N over it.
    np.testing.assert_allclose(derivatives.d_h_g, expected, rtol=1e-5)
    np.testing.assert_allclose(derivatives.d_h_c, -expected, rtol=1e-5)
    assert derivatives.d_temperature[0].tolist() == [0.0] * EDGES.size


def test_straight_down_only_the_angle_counts():
    derivatives = sensitivity(profile_of(), 5000.0, 100.0, 0.0, RADIUS)
    for name in ("d_h_c", "d_h_g", "d_log_pressure"):
        assert getattr(derivatives, name) == 0.0
    assert not derivatives.d_temperature.any()
    # R_c grows as tan zeta_c.
    by_zeta_c = refraction_angle(profile_of(), 5000.0, 100.0, 1e-6, RADIUS) / 1e-6
    assert derivatives.d_zeta_c == pytest.approx(by_zeta_c, rel=1e-8)


def test_many_rays_are_each_what_they_are_alone():
    """More than one block of rays."""
    profile = profile_of("ciddor")
    zeta = np.linspace(0.2, 1.5, 700)[:, None]
    h_c = np.array([9000.0, 1200.0, 4000.0])
    many = sensitivity(profile, h_c, 0.0, zeta, RADIUS, anchor_height_m=ANCHOR_M)
    assert many.d_temperature.shape == (700, 3, EDGES.size)
    for i in (0, 1, 300, 698, 699):
        few = sensitivity(profile, h_c, 0.0, zeta[i], RADIUS, anchor_height_m=ANCHOR_M)
        np.testing.assert_allclose(many.d_temperature[i], few.d_temperature, rtol=1e-9, atol=1e-20)
        np.testing.assert_allclose(many.d_h_g[i], few.d_h_g, rtol=1e-9)
        for j in range(3):
            alone = sensitivity(profile, h_c[j], 0.0, zeta[i, 0], RADIUS, anchor_height_m=ANCHOR_M)
            for name in ("r_c", "d_h_c", "d_zeta_c", "d_log_pressure"):
                expected = float(getattr(alone, name))
                assert getattr(many, name)[i, j] == pytest.approx(expected, rel=1e-9), name


@pytest.mark.parametrize(
    "shape",
    [
        (0,),
        (1,),
        (3, 0),
        (1, 1),
    ],
    ids=str,
)
def test_no_ray_and_one_ray_have_their_shape(shape):
    """Broadcast views that are contiguous all the same, of which numpy warned."""
    profile = profile_of()
    derivatives = sensitivity(profile, np.full(shape, 3000.0), 0.0, 0.5, RADIUS)
    for name in ("r_c", "status", "valid", "d_h_c"):
        assert getattr(derivatives, name).shape == shape
    assert derivatives.d_temperature.shape == (*shape, EDGES.size)
    alone = sensitivity(profile, 3000.0, 0.0, 0.5, RADIUS)
    assert (derivatives.d_zeta_c == alone.d_zeta_c).all()
    rays = ray_weights(profile, 3000.0, np.zeros(shape), 0.5, RADIUS)
    assert rays.weight.shape == (*shape, rays.height_m.size)


def test_pressure_is_referred_to_a_height_inside_the_profile():
    with refused("PROFILE-RANGE", PhysicsError) as refusal:
        sensitivity(profile_of(), 3000.0, 0.0, 0.5, RADIUS, anchor_height_m=20_000.0)
    assert "20000 m" in refusal.value.what
