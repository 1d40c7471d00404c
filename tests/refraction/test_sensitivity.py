"""Derivatives of R_c against differences of angles, the package's and those of thirty digits."""

import math

import mpmath as mp
import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.exact_rays import ExactRays
from tests.refraction.images import RADIUS
from tests.refraction.rays import AIR, touching_angle
from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.errors import PhysicsError
from unbend.geodesy import Gravity
from unbend.refraction import ray_weights, refraction_angle, sensitivity
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE
from unbend.units import DEGREE

GRAVITY = Gravity(9.80616, 6_356_360.0)

# Humid air with an inversion, an isothermal layer and a nearly isothermal one.
EDGES = np.array([-300.0, 900.0, 1250.0, 4000.0, 7000.0, 9000.0, 14_000.0])  # [m']
T_M = np.array([291.0, 284.0, 289.5, 270.0, 250.0, 250.0, 250.5])  # [K]
VAPOUR = np.array([0.016, 0.012, 0.004, 0.002, 5e-4, 1e-4, 0.0])  # e/p
ANCHOR_M = 2000.0
ANCHOR_PA = 80_000.0

# Heights of camera and target [m], nadir angle.
TO_INVERSION = (3000.0, 1000.0, 75.0 * DEGREE)
RAYS = {
    "10 km, 60 deg": (10_000.0, 0.0, 60.0 * DEGREE),
    "10 km, 85 deg": (10_000.0, 0.0, 85.0 * DEGREE),
    "10 km, 0.4 deg above the horizon": (10_000.0, 0.0, 86.53 * DEGREE),
    "120 m, 45 deg": (620.0, 500.0, 45.0 * DEGREE),
    "3 m": (503.0, 500.0, 70.0 * DEGREE),
    "nearly nadir": (6000.0, 300.0, 1e-2 * DEGREE),
    "to the inversion": TO_INVERSION,
    "upwards": (1000.0, 3000.0, 95.0 * DEGREE),
    "nearly level upwards": (800.0, 5000.0, 90.2 * DEGREE),
}
EVERY_RAY = pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS)
EVERY_INDEX = pytest.mark.parametrize("index", ["gyer", "ciddor"])


def profile_of(index="gyer", t_m=T_M, vapour=VAPOUR, log_pressure=0.0):
    """The air, with a change of the logarithm of pressure at the anchor."""
    anchor = float(GRAVITY.geopotential_height(ANCHOR_M))
    layers = stack_layers(
        EDGES,
        t_m,
        vapour,
        ("",) * (EDGES.size - 1),
        anchor=(anchor, ANCHOR_PA * math.exp(log_pressure)),
    )
    return Profile(layers, GRAVITY, IndexModel(index))


def derivatives_of(profile, h_c, h_g, zeta):
    """Those of R_c, by the pressure at the anchor too."""
    return sensitivity(
        profile,
        h_c,
        h_g,
        zeta,
        RADIUS,
        anchor_height_m=ANCHOR_M,
    )


def angle_of(profile, h_c, h_g, zeta):
    return refraction_angle(profile, h_c, h_g, zeta, RADIUS)


def difference(function, step):
    """Central difference of fourth order of a function at zero."""
    far = function(2.0 * step) - function(-2.0 * step)
    near = function(step) - function(-step)
    return (8.0 * near - far) / (12.0 * step)


UNIT = np.eye(EDGES.size)
# Steps of differences that leave 1e-9.
BY_AIR = {"d_temperature": 0.03, "d_vapour": 2e-4, "d_log_pressure": 1e-4}
BY_PLACE = {"d_h_c": 0.3, "d_h_g": 0.3, "d_zeta_c": 1e-5}


def changed_air(name, index, change, edge):
    """The air with a change of what a derivative is by."""
    if name == "d_temperature":
        return profile_of(index, t_m=T_M + change * UNIT[edge])
    if name == "d_vapour":
        return profile_of(index, vapour=VAPOUR + change * UNIT[edge])
    return profile_of(index, log_pressure=change)


def assert_derivative(derivative, expected):
    """To 5e-9 of the largest of its kind."""
    largest = np.abs(expected).max()
    assert_near(derivative, expected, 5e-9 * largest)


@EVERY_RAY
@EVERY_INDEX
@pytest.mark.parametrize("name", BY_AIR)
def test_derivatives_by_the_air_against_differences(name, index, ray):
    edges = range(1 if name == "d_log_pressure" else EDGES.size)
    expected = []
    for edge in edges:

        def angle(change, edge=edge):
            return angle_of(changed_air(name, index, change, edge), *ray)

        expected.append(difference(angle, BY_AIR[name]))

    derivatives = derivatives_of(profile_of(index), *ray)

    assert derivatives.valid
    assert_derivative(getattr(derivatives, name), np.squeeze(expected))
    by_pressure = derivatives.d_log_pressure / ANCHOR_PA
    assert_close(derivatives.d_pressure, by_pressure, rtol=1e-14)


@EVERY_RAY
@pytest.mark.parametrize("name", BY_PLACE)
def test_derivatives_by_the_places_and_the_angle_against_differences(name, ray):
    changed = [*BY_PLACE].index(name)

    def angle(change):
        arguments = list(ray)
        arguments[changed] += change
        return angle_of(profile_of(), *arguments)

    derivatives = derivatives_of(profile_of(), *ray)
    expected = difference(angle, BY_PLACE[name])
    assert_derivative(getattr(derivatives, name), expected)


@EVERY_RAY
@EVERY_INDEX
def test_the_angle_beside_its_derivatives_is_the_refraction_angle(index, ray):
    air = profile_of(index)
    derivatives = derivatives_of(air, *ray)
    assert_close(derivatives.r_c, angle_of(air, *ray), rtol=1e-11)


def test_from_virtual_temperature_to_the_thermometer():
    """The two formulas in the docstring of air_jacobian, for edge 1."""
    derivatives = derivatives_of(profile_of("ciddor"), *TO_INVERSION)
    dry = 1.0 - 0.378 * VAPOUR[1]

    def warmer(kelvin, moister=0.0):
        vapour = VAPOUR + moister * UNIT[1]
        t_m = T_M.copy()
        t_m[1] = (T_M[1] * dry + kelvin) / (1.0 - 0.378 * vapour[1])
        return angle_of(profile_of("ciddor", t_m, vapour), *TO_INVERSION)

    def moister(vapour):
        return warmer(0.0, vapour)

    by_t = derivatives.d_temperature[1] / dry
    by_x = derivatives.d_vapour[1] + derivatives.d_temperature[1] * 0.378 * T_M[1] / dry
    # Reached: 2e-12.
    assert_close(by_t, difference(warmer, 0.2), rtol=1e-9)
    assert_close(by_x, difference(moister, 1e-3), rtol=1e-9)


@EVERY_INDEX
def test_the_refractivity_of_layers_against_differences(index):
    h = np.array([-250.0, 905.0, 1100.0, ANCHOR_M, 6500.0, 8000.0, 13_000.0])
    jacobian = air_jacobian(profile_of(index), h, ANCHOR_M)
    derivatives = {
        "d_temperature": jacobian[:, : EDGES.size],
        "d_vapour": jacobian[:, EDGES.size + 1 :],
    }
    for name, derivative in derivatives.items():
        largest = np.abs(derivative).max()
        for edge in range(EDGES.size):

            def refractivity(change, name=name, edge=edge):
                return changed_air(name, index, change, edge).refractivity(h)

            expected = difference(refractivity, 10.0 * BY_AIR[name])
            assert_near(derivative[:, edge], expected, 1e-10 * largest)


@pytest.mark.parametrize(
    ("h_c", "below"),
    [
        (10_000.0, 1e-2),
        (300.0, 1e-5),
    ],
)
def test_near_the_horizon_against_thirty_digits(h_c, below):
    """``below`` degrees under the nadir angle at which the ray would just touch sea level."""
    zeta = touching_angle(AIR, h_c) - below * DEGREE
    derivatives = sensitivity(AIR, h_c, 0.0, zeta, RADIUS)
    assert derivatives.valid
    with mp.workdps(30):
        ray = {"h_c": mp.mpf(h_c), "h_g": mp.mpf(0), "zeta_c": mp.mpf(zeta)}

        def angle(name, change):
            if name == "log_pressure":
                denser = ExactRays(30, mp.exp(change))
                return denser.crossing(**ray, grazing=True).r_c
            changed = ray | {name: ray[name] + change}
            return ExactRays(30).crossing(**changed, grazing=True).r_c

        def slope(name, step):
            step = mp.mpf(step)
            return float((angle(name, step) - angle(name, -step)) / (2 * step))

        by_log_pressure = slope("log_pressure", "1e-11")
        by_h_c = slope("h_c", "1e-7")
        by_h_g = slope("h_g", "1e-7")
        by_zeta_c = slope("zeta_c", "1e-12")
    assert_close(derivatives.d_log_pressure, by_log_pressure, rtol=1e-9)
    assert_close(derivatives.d_h_c, by_h_c, rtol=1e-8)
    assert_close(derivatives.d_h_g, by_h_g, rtol=1e-8)
    assert_close(derivatives.d_zeta_c, by_zeta_c, rtol=1e-10)


@pytest.mark.parametrize(
    ("h_c", "below", "step"),
    [
        (10_000.0, 1e-2, 0.03),
        (300.0, 1e-5, 1e-3),
    ],
)
def test_near_the_horizon_uniform_warming_is_the_sum_over_the_edges(h_c, below, step):
    profile = profile_of()
    zeta = touching_angle(profile, h_c) - below * DEGREE
    derivatives = derivatives_of(profile, h_c, 0.0, zeta)
    assert derivatives.valid

    def angle(warmer):
        return angle_of(profile_of(t_m=T_M + warmer), h_c, 0.0, zeta)

    expected = difference(angle, step)
    assert_close(derivatives.d_temperature.sum(), expected, rtol=1e-6)


def test_what_cannot_be_differentiated_says_so():
    profile = profile_of()
    touching = touching_angle(profile, 3000.0)
    table = [
        # h_c, h_g, zeta_c, status
        (3000.0, 0.0, touching - 1e-13, OK),  # level at the ground
        (3000.0, 0.0, touching + 0.01, MISSES_GROUND),
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
        values = getattr(derivatives, name)
        assert np.isnan(values[:7]).all(), name
        assert np.isfinite(values[7]).all(), name


def test_where_no_ray_can_be_differentiated():
    nothing = sensitivity(
        profile_of(),
        3000.0,
        0.0,
        [math.nan, 2.0],
        RADIUS,
    )
    assert not nothing.valid.any()
    assert np.isnan(nothing.d_temperature).all()


@pytest.mark.parametrize("zeta", [0.6, 1.35])
def test_weights_on_any_change_of_refractivity(zeta):
    """A denser layer of air, added to n; and n scaled as a whole, which bends nothing."""
    weights = ray_weights(
        AIR,
        8000.0,
        100.0,
        [[zeta]],
        RADIUS,
    )
    assert weights.weight.shape == (1, 1, weights.height_m.size)
    weight = weights.weight[0, 0]
    n = AIR.refractivity(weights.height_m)
    assert abs(weight @ (1.0 + n)) < 1e-13 * np.abs(weight).max()

    def angle(log_pressure):
        pressure_pa = 101_325.0 * math.exp(log_pressure)
        air = AIR.at_level(0.0, pressure_pa)
        return angle_of(air, 8000.0, 100.0, zeta)

    # Gyer's N is proportional to p: dR/d ln p is the weights on N itself.
    assert_close(weight @ n, difference(angle, 0.01), rtol=1e-8)


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
    h_g = h_c + rise * np.array([0.0, 1e-6, 1e-2])
    derivatives = sensitivity(profile, h_c, h_g, zeta, RADIUS)
    assert derivatives.valid.all()
    # The last is an ordinary ray of 1 cm: reached 5e-7, the curvature of N over it.
    assert_close(derivatives.d_h_g, expected, rtol=1e-5)
    assert_close(derivatives.d_h_c, -expected, rtol=1e-5)
    assert not derivatives.d_temperature[0].any()


def test_straight_down_only_the_angle_counts():
    derivatives = sensitivity(
        profile_of(),
        5000.0,
        100.0,
        0.0,
        RADIUS,
    )
    for name in ("d_h_c", "d_h_g", "d_log_pressure"):
        assert getattr(derivatives, name) == 0.0
    assert not derivatives.d_temperature.any()
    # R_c grows as tan zeta_c.
    by_zeta_c = angle_of(profile_of(), 5000.0, 100.0, 1e-6) / 1e-6
    assert_close(derivatives.d_zeta_c, by_zeta_c, rtol=1e-8)


def test_many_rays_are_each_what_they_are_alone():
    """More than one block of rays."""
    profile = profile_of("ciddor")
    zeta = np.linspace(0.2, 1.5, 700)[:, None]
    h_c = np.array([9000.0, 1200.0, 4000.0])
    many = derivatives_of(profile, h_c, 0.0, zeta)
    assert many.d_temperature.shape == (700, 3, EDGES.size)
    for i in (0, 1, 300, 698, 699):
        few = derivatives_of(profile, h_c, 0.0, zeta[i])
        assert_close(many.d_temperature[i], few.d_temperature, rtol=1e-9, atol=1e-20)
        assert_close(many.d_h_g[i], few.d_h_g, rtol=1e-9)
        for j in range(3):
            alone = derivatives_of(profile, h_c[j], 0.0, zeta[i, 0])
            for name in ("r_c", "d_h_c", "d_zeta_c", "d_log_pressure"):
                values = getattr(many, name)
                assert_close(values[i, j], getattr(alone, name), rtol=1e-9)


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
    derivatives = sensitivity(
        profile,
        np.full(shape, 3000.0),
        0.0,
        0.5,
        RADIUS,
    )
    for name in ("r_c", "status", "valid", "d_h_c"):
        assert getattr(derivatives, name).shape == shape
    assert derivatives.d_temperature.shape == (*shape, EDGES.size)
    alone = sensitivity(profile, 3000.0, 0.0, 0.5, RADIUS)
    assert (derivatives.d_zeta_c == alone.d_zeta_c).all()
    rays = ray_weights(
        profile,
        3000.0,
        np.zeros(shape),
        0.5,
        RADIUS,
    )
    assert rays.weight.shape == (*shape, rays.height_m.size)


def test_pressure_is_referred_to_a_height_inside_the_profile():
    with refused("PROFILE-RANGE", PhysicsError, what="20000 m"):
        sensitivity(
            profile_of(),
            3000.0,
            0.0,
            0.5,
            RADIUS,
            anchor_height_m=20_000.0,
        )
