"""Properties of the air that hold for any profile, drawn by hypothesis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from unbend.atmosphere.covariance import ProfileCovariance, plane_rule
from unbend.atmosphere.estimate.binning import bin_readings
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.ageing import SampleAges, covariance_with_ageing
from unbend.atmosphere.series.profile_series import TimedProfile, interpolate_series
from unbend.geodesy import normal_gravity

GAMMA = 9.80665 * 28.9644 / 8314.32  # [K/m']


@st.composite
def profiles(draw, bottom: float = -200.0) -> Profile:
    """Three to six layers, up to 10 km' high, between 200 and 320 K, with up to 3 % of vapour."""
    count = draw(st.integers(3, 6))
    steps = draw(st.lists(st.floats(100.0, 3000.0), min_size=count, max_size=count))
    edge = bottom + np.concatenate([[0.0], np.cumsum(steps)])
    kelvin = st.floats(200.0, 320.0)
    t = np.array(draw(st.lists(kelvin, min_size=count + 1, max_size=count + 1)))
    moist = st.floats(0.0, 0.03)
    vapour = np.array(draw(st.lists(moist, min_size=count + 1, max_size=count + 1)))
    pressure = draw(st.floats(9e4, 1.05e5))
    layers = stack_layers(edge, t, vapour, ("measured",) * count, anchor=(0.0, pressure))
    return Profile(layers, normal_gravity(draw(st.floats(-1.5, 1.5))))


def inside(profile: Profile, share: float) -> float:
    return profile.bottom_m + (0.001 + 0.998 * share) * (profile.top_m - profile.bottom_m)


@given(profiles(), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_pressure_is_the_weight_of_the_air_above(profile, low, high):
    """ln p between two heights is the integral of G M0 / (R* T_M) dH, by quadrature."""
    layers = profile.layers
    H = np.sort(profile.gravity.geopotential_height([inside(profile, low), inside(profile, high)]))
    kinks = [float(e) for e in layers.edge if H[0] < e < H[1]] or None
    weight = quad(
        lambda h: GAMMA / np.interp(h, layers.edge, layers.edge_temperature),
        *H,
        points=kinks,
        epsabs=1e-13,
        limit=200,
    )[0]
    p = profile.pressure(profile.gravity.height(H))
    assert math.log(p[0] / p[1]) == pytest.approx(weight, abs=1e-9)


@given(profiles())
@settings(max_examples=60, deadline=None)
def test_nothing_jumps_where_layers_meet(profile):
    h = profile.break_heights_m[1:-1]
    steepest = {
        "pressure": 0.02,
        "temperature": 1e-3,
        "vapour_pressure": 0.02,
        "refractivity": 1e-9,
    }
    for name, change in steepest.items():
        below, above = (getattr(profile, name)(h + step) for step in (-1e-4, 1e-4))
        assert np.abs(above - below).max() < change, name
    assert np.all(np.diff(profile.pressure(profile.break_heights_m)) < 0.0)


@given(
    st.floats(200.0, 320.0),
    st.floats(2e4, 1.1e5),
    st.floats(0.0, 0.02),
    st.sampled_from(["ciddor", "gyer"]),
)
@settings(max_examples=100, deadline=None)
def test_air_is_denser_cold_under_pressure_and_dry(t, p, vapour, name):
    index = IndexModel(name)
    n = float(index.refractivity(t, p, vapour * p))
    assert 3e-5 < n < 5e-4
    assert float(index.refractivity(t + 1.0, p, vapour * p)) < n
    assert float(index.refractivity(t, 1.01 * p, vapour * 1.01 * p)) > n
    assert float(index.refractivity(t, p, (vapour + 1e-3) * p)) < n
    # Nearly the density: N T / p is constant within 1 % of dry air.
    dry = float(index.refractivity(t, p, 0.0))
    assert dry * t / p == pytest.approx(78.8e-8, rel=0.01)


def covariance_of(profile: Profile, sigmas) -> ProfileCovariance:
    size = 2 * profile.layers.edge.size + 1
    root = np.random.default_rng(round(1e6 * sigmas)).normal(size=(size, size)) * 0.1
    root[:, -profile.layers.edge.size :] *= 1e-3
    return ProfileCovariance(profile, 0.0, root.T @ root)


@given(profiles(), st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 20.0))
@settings(max_examples=40, deadline=None)
def test_a_covariance_is_positive_and_age_never_lowers_it(profile, seed, share, hours):
    fresh = covariance_of(profile, seed)
    h = np.array([profile.bottom_m + 10.0, inside(profile, share)])
    ages = SampleAges(h, np.array([hours, 0.5 * hours]))
    old = covariance_with_ageing(fresh, ages)
    eigenvalues = np.linalg.eigvalsh(old.matrix)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()
    for name in ("sigma_temperature", "sigma_log_pressure", "sigma_refractivity"):
        before = getattr(fresh, name)(h)
        after = getattr(old, name)(h)
        assert np.all(before > 0.0)
        assert np.all(after >= before * (1.0 - 1e-9))


@given(profiles(), st.floats(0.0, 30.0), st.lists(st.integers(-1000, 4600), min_size=1, max_size=9))
@settings(max_examples=30, deadline=None)
def test_a_series_lies_between_its_nodes_and_is_constant_beyond(profile, warmer, seconds):
    layers = profile.layers
    other = stack_layers(
        layers.edge,
        layers.edge_temperature + warmer,
        np.append(layers.vapour, layers.vapour[-1]),
        layers.source,
        anchor=(0.0, 1e5),
    )
    later = Profile(other, profile.gravity)
    nodes = [TimedProfile(0, profile), TimedProfile(3600 * 10**9, later)]
    h_c = 0.9 * profile.top_m
    h, weight = plane_rule(h_c, 0.0, 100)  # drawn air may bend rays upwards, as none does
    assume(all(weight @ node.profile.refractivity(h) > 0.0 for node in nodes))
    times = np.array(seconds, np.int64) * 10**9
    series = interpolate_series(nodes, times, [h_c], 0.0)
    h = np.full(times.size, 0.5 * h_c)
    t_m = np.array([series.profiles[i].virtual_temperature(h[0]) for i in series.profile_number])
    at = [float(node.profile.virtual_temperature(h[0])) for node in nodes]
    assert np.all(t_m >= min(at) - 1e-6)
    assert np.all(t_m <= max(at) + 1e-6)
    order = np.argsort(times, kind="stable")
    assert np.all(np.diff(t_m[order]) >= -1e-6)  # the later, the warmer
    assert np.all(np.abs(t_m[times <= 0] - at[0]) < 1e-9)
    assert np.all(np.abs(t_m[times >= 3600 * 10**9] - at[1]) < 1e-9)


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
    if bins.value.size:
        assert value.min() <= bins.value.min() <= bins.value.max() <= value.max()
        assert np.all(bins.sigma > 0.0)
        assert np.all(bins.sigma >= 0.1 / np.sqrt(bins.count) * (1.0 - 1e-12))
