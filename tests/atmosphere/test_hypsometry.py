"""Columns of air and their derivatives against 40 digits, at and beyond the edges of layers."""

from __future__ import annotations

from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import (
    ProfileCovariance,
    air_jacobian,
    log_pressure_jacobian,
    plane_rule,
)
from unbend.atmosphere.hypsometry import _layer, column, hats
from unbend.units import HYDROSTATIC_CONSTANT

CHANGES = [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.0107, 0.013, 0.03, 0.0499, 0.0501, 0.1, 0.3, 0.6]
SIGNED = sorted({sign * x for x in CHANGES for sign in (-1.0, 1.0)})
# Relative; reached: 6e-16 where the derivatives are a series, 2e-15 where they are closed, which
# may lose 9e-15 where it begins. The series without its last term errs by 9e-15 at 0.0499.
SERIES = 4e-15
CLOSED = 2e-14
AIR = standard_atmosphere("us1976")


def layer_of(thickness, lower, upper):
    """Integral of dH/T by quadrature, and its derivatives by the temperatures at both edges."""
    d = mp.mpf(thickness)
    t_0 = mp.mpf(lower)
    t_1 = mp.mpf(upper)

    def t(u):
        return t_0 + u * (t_1 - t_0)

    return (
        d * mp.quad(lambda u: 1 / t(u), [0, 1]),
        -d * mp.quad(lambda u: (1 - u) / t(u) ** 2, [0, 1]),
        -d * mp.quad(lambda u: u / t(u) ** 2, [0, 1]),
    )


@pytest.mark.parametrize("change", SIGNED)
@pytest.mark.parametrize("lower", [180.0, 216.65, 300.0])
def test_a_layer_against_forty_digits(change, lower):
    thickness = 1234.5
    upper = lower * (1.0 + change)
    found = _layer(*(np.array([v]) for v in (thickness, lower, upper)))
    with mp.workdps(40):
        expected = layer_of(thickness, lower, upper)
        off = [
            float(abs(mp.mpf(float(f[0])) / e - 1)) for f, e in zip(found, expected, strict=True)
        ]
    assert max(off) < (SERIES if abs(change) < 0.05 else CLOSED)


EDGE = np.array([-300.0, 0.0, 850.0, 851.0, 4000.0, 11_000.0, 20_000.0])
VIRTUAL = np.array([290.0, 290.0, 290.0 * (1.0 + 1e-6), 300.0, 294.0, 185.0, 296.0])


def column_to(height):
    """The integral of dH/T_M from the lowest edge, and its derivatives by T_M at the edges."""
    total = mp.mpf(0)
    slopes = [mp.mpf(0)] * EDGE.size
    for k in range(EDGE.size - 1):
        low = mp.mpf(EDGE[k])
        high = mp.mpf(EDGE[k + 1])
        top = min(mp.mpf(height), high)
        if top <= low:
            break
        t_0 = mp.mpf(VIRTUAL[k])
        t_1 = mp.mpf(VIRTUAL[k + 1])

        def share(h, low=low, high=high):
            return (h - low) / (high - low)

        def t(h, t_0=t_0, t_1=t_1, share=share):
            return t_0 + (t_1 - t_0) * share(h)

        total += mp.quad(lambda h, t=t: 1 / t(h), [low, top])
        slopes[k] -= mp.quad(lambda h, t=t, share=share: (1 - share(h)) / t(h) ** 2, [low, top])
        slopes[k + 1] -= mp.quad(lambda h, t=t, share=share: share(h) / t(h) ** 2, [low, top])
    return float(total), [float(v) for v in slopes]


def test_a_column_against_forty_digits():
    height = np.concatenate([[9000.0, 3.0], EDGE, EDGE[1:] - 0.25, EDGE[:-1] + 0.25, [15_000.0]])
    integral, gradient = column(EDGE, VIRTUAL, height)
    with mp.workdps(40):
        expected = [column_to(float(h)) for h in height]
    total = np.array([one for one, _ in expected])
    slopes = np.array([row for _, row in expected])
    # Reached: 2e-16 of the integral, 7e-16 of each derivative.
    np.testing.assert_allclose(integral, total, rtol=2e-15, atol=0.0)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-14, atol=0.0)
    assert not gradient[2].any()  # nothing lies below the lowest edge
    above = np.repeat(height[:, None], EDGE.size, axis=1) < EDGE
    beyond = np.cumsum(above, axis=1) > 1  # the first edge above still bounds the layer
    assert not gradient[beyond].any()


def test_hats_are_linear_between_knots_and_constant_beyond():
    knot = np.array([-100.0, 0.0, 250.0, 1e4])
    x = np.array([-1e6, -100.1, -100.0, -25.0, 0.0, 125.0, 9999.0, 1e4, 10_000.1, 1e9])
    weights = hats(knot, x)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=0.0, atol=1e-15)
    assert np.all((weights >= 0.0) & (weights <= 1.0))
    for value in (knot, knot**2, np.array([3.0, -1.0, 4.0, 1.0])):
        np.testing.assert_allclose(weights @ value, np.interp(x, knot, value), rtol=1e-14)
    assert weights[[0, 1, 2]].tolist() == [[1.0, 0.0, 0.0, 0.0]] * 3
    assert weights[[-3, -2, -1]].tolist() == [[0.0, 0.0, 0.0, 1.0]] * 3
    np.testing.assert_array_equal(hats(knot, knot), np.eye(4))


# ---- heights outside the profile


def test_rows_outside_the_profile_are_nothing_at_all():
    inside = np.array([AIR.bottom_m, 0.0, 8000.0, AIR.top_m])
    h = np.array([AIR.bottom_m - 1.0, *inside[:2], np.nan, *inside[2:], AIR.top_m + 1.0, 1e9])
    out = np.array([True, False, False, True, False, False, True, True])
    k = AIR.layers.edge.size
    covariance = ProfileCovariance(AIR, 0.0, np.eye(2 * k + 1))
    alone = log_pressure_jacobian(AIR, inside, 0.0)
    air = air_jacobian(AIR, h, 0.0)
    assert np.isfinite(alone).all()
    for found in (log_pressure_jacobian(AIR, h, 0.0), covariance.log_pressure_by_virtual(h)):
        assert found.shape == (h.size, k)
        assert np.isnan(found[out]).all()
        np.testing.assert_array_equal(found[~out], alone)
    assert np.isnan(air[out]).all()
    assert np.isfinite(air[~out]).all()


def test_the_derivative_of_the_pressure_is_that_of_its_column():
    """d ln p / d T_k = G M0/R* (integral of phi_k / T_M^2 from the anchor), by quadrature."""
    edge = AIR.layers.edge
    virtual = AIR.layers.edge_temperature
    anchor = 3000.0
    heights = [0.0, 9000.0, 25_000.0]
    base, *ends = AIR.gravity.geopotential_height([anchor, *heights]).tolist()
    rows = log_pressure_jacobian(AIR, heights, anchor)
    for row, end in zip(rows, ends, strict=True):
        inner = sorted((e for e in edge if min(base, end) < e < max(base, end)), reverse=end < base)
        for k, hat in enumerate(np.eye(edge.size)):
            expected = 0.0
            for low, high in pairwise([base, *inner, end]):
                expected += quad(
                    lambda x, hat=hat: np.interp(x, edge, hat) / np.interp(x, edge, virtual) ** 2,
                    low,
                    high,
                )[0]
            # Reached: 2e-15.
            assert row[k] == pytest.approx(HYDROSTATIC_CONSTANT * expected, rel=1e-12, abs=1e-20)


# ---- the plane


@pytest.mark.parametrize(("h_c", "h_g"), [(10_000.0, 0.0), (3450.0, 450.0), (500.0, 2500.0)])
def test_the_plane_rule_is_the_mean_over_the_way_less_the_camera(h_c, h_g):
    mean, _ = quad(AIR.refractivity, h_g, h_c, epsabs=0.0, epsrel=1e-13)
    expected = mean / (h_c - h_g) - float(AIR.refractivity(h_c))
    off = []
    for steps in (200, 400):
        h, weight = plane_rule(h_c, h_g, steps)
        assert h.shape == weight.shape == (steps + 1,)
        assert (h[0], h[-1]) == (h_g, h_c)
        assert abs(weight.sum()) < 1e-14  # a constant N bends nothing
        off.append(weight @ AIR.refractivity(h) / expected - 1.0)
    # Reached: 4e-6 over 10 km, and a quarter of it with half the step.
    assert abs(off[0]) < 5e-6
    assert off[1] == pytest.approx(0.25 * off[0], rel=1e-5)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_the_plane_rule_is_exact_where_n_falls_evenly(steps):
    h, weight = plane_rule(2000.0, 300.0, steps)
    assert weight @ (3e-4 - 2.5e-8 * h) == pytest.approx(0.5 * 2.5e-8 * 1700.0, rel=1e-11)
