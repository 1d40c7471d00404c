"""Properties of the air that hold for any profile, drawn by hypothesis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from tests.atmosphere.values import HYDROSTATIC_K_PER_M
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.binning import bin_readings
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.ageing import SampleAges, covariance_with_ageing
from unbend.geodesy import normal_gravity


@st.composite
def profiles(draw) -> Profile:
    """Three to six layers, up to 10 km' high, between 200 and 320 K, with up to 3 % of vapour."""
    count = draw(st.integers(3, 6))

    def several(low: float, high: float, size: int) -> np.ndarray:
        return np.array(draw(st.lists(st.floats(low, high), min_size=size, max_size=size)))

    edge = -200.0 + np.concatenate([[0.0], np.cumsum(several(100.0, 3000.0, count))])
    virtual = several(200.0, 320.0, count + 1)
    vapour = several(0.0, 0.03, count + 1)
    anchor = (0.0, draw(st.floats(9e4, 1.05e5)))
    layers = stack_layers(edge, virtual, vapour, ("measured",) * count, anchor=anchor)
    return Profile(layers, normal_gravity(draw(st.floats(-1.5, 1.5))))


SHARES = st.floats(0.0, 1.0)


def inside(profile: Profile, share: float) -> float:
    return profile.bottom_m + (0.001 + 0.998 * share) * (profile.top_m - profile.bottom_m)


@given(profiles(), SHARES, SHARES)
@settings(max_examples=60, deadline=None)
def test_pressure_is_the_weight_of_the_air_above(profile, low, high):
    """ln p between two heights is the integral of G M0 / (R* T_M) dH, by quadrature."""
    layers = profile.layers
    H = np.sort(profile.gravity.geopotential_height([inside(profile, low), inside(profile, high)]))
    kinks = [float(edge) for edge in layers.edge if H[0] < edge < H[1]]
    weight, _ = quad(
        lambda h: HYDROSTATIC_K_PER_M / np.interp(h, layers.edge, layers.edge_temperature),
        *H,
        points=kinks or None,
        epsabs=1e-13,
        limit=200,
    )
    p = profile.pressure(profile.gravity.height(H))
    assert math.log(p[0] / p[1]) == pytest.approx(weight, abs=1e-9)


STEEPEST = {
    "pressure": 0.02,
    "temperature": 1e-3,
    "vapour_pressure": 0.02,
    "refractivity": 1e-9,
}


@given(profiles())
@settings(max_examples=60, deadline=None)
def test_nothing_jumps_where_layers_meet(profile):
    h = profile.break_heights_m[1:-1]
    for name, change in STEEPEST.items():
        value = getattr(profile, name)
        assert np.abs(value(h + 1e-4) - value(h - 1e-4)).max() < change, name
    assert np.all(np.diff(profile.pressure(profile.break_heights_m)) < 0.0)


def covariance_of(profile: Profile, seed: int) -> ProfileCovariance:
    edges = profile.layers.edge.size
    size = 2 * edges + 1
    root = 0.1 * np.random.default_rng(seed).normal(size=(size, size))
    root[:, -edges:] *= 1e-3
    return ProfileCovariance(profile, 0.0, root.T @ root)


@given(profiles(), st.integers(0, 2**31), SHARES, st.floats(0.0, 20.0))
@settings(max_examples=40, deadline=None)
def test_a_covariance_is_positive_and_age_never_lowers_it(profile, seed, share, hours):
    fresh = covariance_of(profile, seed)
    h = np.array([profile.bottom_m + 10.0, inside(profile, share)])
    old = covariance_with_ageing(fresh, SampleAges(h, np.array([hours, 0.5 * hours])))
    eigenvalues = np.linalg.eigvalsh(old.matrix)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()
    for name in ("sigma_temperature", "sigma_log_pressure", "sigma_refractivity"):
        before = getattr(fresh, name)(h)
        assert np.all(before > 0.0)
        assert np.all(getattr(old, name)(h) >= before * (1.0 - 1e-9))


@given(st.integers(5, 200), st.integers(0, 2**31), st.floats(10.0, 100.0))
@settings(max_examples=40, deadline=None)
def test_bins_keep_every_accepted_reading(count, seed, width):
    """Each is in one bin or an outlier; means stay between the extremes."""
    rng = np.random.default_rng(seed)
    seconds = np.cumsum(rng.uniform(0.1, 2.0, count))
    height = np.cumsum(rng.normal(3.0, 4.0, count))
    value = rng.normal(size=count)
    accepted = rng.random(count) < 0.8
    bins = bin_readings(seconds, height, value, accepted, width=width, slice_s=30.0, floor=0.1)
    assert bins.count.sum() + bins.rejected.sum() == accepted.sum()
    assert not np.any(bins.rejected & ~accepted)
    assert np.all((bins.value >= value.min()) & (bins.value <= value.max()))
    assert np.all(bins.sigma >= 0.1 / np.sqrt(bins.count) * (1.0 - 1e-12))
