"""Columns of air and their derivatives against 40 digits, at and beyond the edges of layers."""

from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

from tests.atmosphere.values import HYDROSTATIC_K_PER_M
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import (
    ProfileCovariance,
    air_jacobian,
    log_pressure_jacobian,
    plane_rule,
)
from unbend.atmosphere.hypsometry import interpolation_weights, inverse_temperature_integral

RISES = "1e-12 1e-9 1e-6 1e-3 0.0107 0.013 0.03 0.0499 0.0501 0.1 0.3 0.6"
CHANGES = np.array(RISES.split(), float)
# Relative; reached: 6e-16 where the derivatives are a series, 2e-15 where they are closed, which
# may lose 9e-15 where it begins. The series without its last term errs by 9e-15 at 0.0499.
SERIES = 4e-15
CLOSED = 2e-14
AIR = standard_atmosphere("us1976")


def part_of_layer(thickness, virtual, share=1):
    """The integral of dH/T_M over the lower share of a layer, by quadrature with 40 digits, and
    its derivatives by T_M at both edges."""
    lower, upper = map(mp.mpf, virtual)

    def t(u):
        return lower + u * (upper - lower)

    integrands = (
        lambda u: 1 / t(u),
        lambda u: (u - 1) / t(u) ** 2,
        lambda u: -u / t(u) ** 2,
    )
    means = [mp.quad(integrand, [0, share]) for integrand in integrands]
    return np.array([mean * thickness for mean in means], float)


@pytest.mark.parametrize("change", [0.0, *CHANGES, *-CHANGES])
@pytest.mark.parametrize("lower", [180.0, 300.0])
def test_a_layer_against_forty_digits(change, lower):
    edge = np.array([0.0, 1234.5])
    virtual = np.array([lower, lower * (1.0 + change)])

    integral, gradient = inverse_temperature_integral(edge, virtual, edge[1:])

    with mp.workdps(40):
        expected = part_of_layer(edge[1], virtual)
    limit = SERIES if abs(change) < 0.05 else CLOSED
    assert_allclose(integral, expected[:1], rtol=limit)
    assert_allclose(gradient[0], expected[1:], rtol=limit)


LEVELS = """
-300 290
0 290
850 290.00029
851 300
4000 294
11000 185
20000 296
"""
EDGE, VIRTUAL = np.array(LEVELS.split(), float).reshape(-1, 2).T
"""Geopotential heights [m'] and virtual temperatures [K] of edges."""


def column_to(height):
    """The integral of dH/T_M from the lowest edge, and its derivatives by T_M at the edges."""
    total = np.zeros(1 + EDGE.size)
    for layer, (low, high) in enumerate(pairwise(EDGE)):
        if height <= low:
            break
        thickness = high - low
        share = (mp.mpf(min(height, high)) - low) / thickness
        virtual = VIRTUAL[layer : layer + 2]
        part = part_of_layer(thickness, virtual, share)
        total[[0, layer + 1, layer + 2]] += part
    return total


def test_a_column_against_forty_digits():
    below_edges = EDGE[1:] - 0.25
    above_edges = EDGE[:-1] + 0.25
    inside = [3.0, 9000.0, 15_000.0]
    height = np.concatenate(
        [
            inside,
            EDGE,
            below_edges,
            above_edges,
        ]
    )

    integral, gradient = inverse_temperature_integral(EDGE, VIRTUAL, height)

    with mp.workdps(40):
        expected = np.array([column_to(h) for h in height])
    # Reached: 2e-16 of the integral, 7e-16 of each derivative.
    assert_allclose(integral, expected[:, 0], rtol=2e-15)
    assert_allclose(gradient, expected[:, 1:], rtol=1e-14)


def test_hats_are_linear_between_knots_and_constant_beyond():
    knot = np.array([-100.0, 0.0, 250.0, 1e4])
    x = [-1e6, -100.1, -100.0, -25.0, 0.0, 125.0, 9999.0, 1e4, 10_000.1, 1e9]
    values = interpolation_weights(knot, np.array(x)).T
    expected = [np.interp(x, knot, hat) for hat in np.eye(4)]
    assert_allclose(values, expected, rtol=1e-14, atol=1e-15)
    assert_array_equal(interpolation_weights(knot, knot), np.eye(4))


# ---- heights outside the profile


def test_rows_outside_the_profile_are_nothing_at_all():
    inside = [AIR.bottom_m, 0.0, 8000.0, AIR.top_m]
    below = [AIR.bottom_m - 1.0, np.nan]
    above = [AIR.top_m + 1.0, 1e9]
    h = np.array([*below, *inside, *above])
    outside = [0, 1, 6, 7]
    edges = AIR.layers.edge.size
    covariance = ProfileCovariance(AIR, 0.0, np.eye(2 * edges + 1))

    alone = log_pressure_jacobian(AIR, inside, 0.0)
    among = log_pressure_jacobian(AIR, h, 0.0)
    of_covariance = covariance.log_pressure_by_virtual(h)
    air = air_jacobian(AIR, h, 0.0)

    assert np.isfinite(alone).all()
    for jacobian in (among, of_covariance):
        assert jacobian.shape == (8, edges)
        assert np.isnan(jacobian[outside]).all()
        assert_array_equal(jacobian[2:6], alone)
    assert np.isnan(air[outside]).all()
    assert np.isfinite(air[2:6]).all()


def test_the_derivative_of_the_pressure_is_that_of_its_column():
    """ln p falls by G M0/R* times the integral of dH/T_M from the anchor."""
    heights = [0.0, 9000.0, 25_000.0]
    ends = AIR.gravity.geopotential_height([3000.0, *heights])
    layers = AIR.layers
    _, gradient = inverse_temperature_integral(layers.edge, layers.edge_temperature, ends)
    expected = -HYDROSTATIC_K_PER_M * (gradient[1:] - gradient[0])
    rows = log_pressure_jacobian(AIR, heights, 3000.0)
    assert_allclose(rows, expected, rtol=1e-12, atol=1e-18)


# ---- the plane


@pytest.mark.parametrize(
    ("h_c", "h_g"),
    [
        (10_000.0, 0.0),
        (3450.0, 450.0),
        (500.0, 2500.0),
    ],
)
def test_the_plane_rule_is_the_mean_over_the_way_less_the_camera(h_c, h_g):
    total, _ = quad(
        AIR.refractivity,
        h_g,
        h_c,
        epsabs=0.0,
        epsrel=1e-13,
    )
    expected = total / (h_c - h_g) - AIR.refractivity(h_c)
    errors = []
    for steps in (200, 400):
        h, weight = plane_rule(h_c, h_g, steps)
        assert h.shape == weight.shape == (steps + 1,)
        assert h[0] == h_g
        assert h[-1] == h_c
        assert abs(weight.sum()) < 1e-14  # a constant N bends nothing
        by_rule = weight @ AIR.refractivity(h)
        errors.append(by_rule / expected - 1.0)
    # Reached: 4e-6 over 10 km, and a quarter of it with half the step.
    assert abs(errors[0]) < 5e-6
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=1e-5)
