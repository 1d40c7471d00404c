"""Properties of the air that hold for any profile, drawn by hypothesis."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from scipy.integrate import quad

from tests.atmosphere.values import HYDROSTATIC_K_PER_M
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.binning import bin_readings
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.ageing import SampleAges, covariance_with_ageing
from unbend.geodesy import normal_gravity


@st.composite
def profiles(draw):
    """Three to six layers, up to 10 km' high, between 200 and 320 K, with up to 3 % of vapour."""
    count = draw(st.integers(3, 6))

    def several(low, high, size):
        values = st.lists(
            st.floats(low, high),
            min_size=size,
            max_size=size,
        )
        return np.array(draw(values))

    thickness = several(100.0, 3000.0, count)
    layers = stack_layers(
        edge=np.cumsum([-200.0, *thickness]),
        temperature=several(200.0, 320.0, count + 1),
        vapour=several(0.0, 0.03, count + 1),
        source=("measured",) * count,
        anchor=(0.0, draw(st.floats(9e4, 1.05e5))),
    )
    latitude_rad = draw(st.floats(-1.5, 1.5))
    return Profile(layers, normal_gravity(latitude_rad))


SHARES = st.floats(0.0, 1.0)


def inside(profile, share):
    extent_m = profile.top_m - profile.bottom_m
    return profile.bottom_m + (0.001 + 0.998 * share) * extent_m


@given(profiles(), SHARES, SHARES)
@settings(max_examples=60)
def test_pressure_is_the_weight_of_the_air_above(profile, low, high):
    """ln p between two heights is the integral of G M0 / (R* T_M) dH, by quadrature."""
    layers = profile.layers
    h = [inside(profile, share) for share in sorted([low, high])]
    H = profile.gravity.geopotential_height(h)

    def weight_per_m(H):
        t = np.interp(H, layers.edge, layers.edge_temperature)
        return HYDROSTATIC_K_PER_M / t

    edge = layers.edge
    kinks = edge[(edge > H[0]) & (edge < H[1])]
    weight, _ = quad(
        weight_per_m,
        *H,
        points=kinks if kinks.size else None,
        epsabs=1e-13,
        limit=200,
    )
    below, above = profile.pressure(h)
    assert math.log(below / above) == pytest.approx(weight, abs=1e-9)


STEEPEST = {
    "pressure": 0.02,
    "temperature": 1e-3,
    "vapour_pressure": 0.02,
    "refractivity": 1e-9,
}


@given(profiles())
@settings(max_examples=60)
def test_nothing_jumps_where_layers_meet(profile):
    breaks = profile.break_heights_m
    inner = breaks[1:-1]
    for name, change in STEEPEST.items():
        value = getattr(profile, name)
        jump = value(inner + 1e-4) - value(inner - 1e-4)
        assert np.abs(jump).max() < change, name
    p = profile.pressure(breaks)
    assert np.all(np.diff(p) < 0.0)


def covariance_of(profile, rng):
    edges = profile.layers.edge.size
    size = 2 * edges + 1
    root = rng.normal(0.0, 0.1, (size, size))
    root[:, -edges:] *= 1e-3
    return ProfileCovariance(profile, 0.0, root.T @ root)


RANDOM = st.integers(0, 2**31).map(default_rng)


@given(
    profiles(),
    RANDOM,
    SHARES,
    st.floats(0.0, 20.0),
)
@settings(max_examples=40)
def test_a_covariance_is_positive_and_age_never_lowers_it(profile, rng, share, hours):
    fresh = covariance_of(profile, rng)
    near_bottom = profile.bottom_m + 10.0
    h = np.array([near_bottom, inside(profile, share)])
    ages = SampleAges(h, np.array([hours, 0.5 * hours]))

    old = covariance_with_ageing(fresh, ages)

    eigenvalues = np.linalg.eigvalsh(old.matrix)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()
    for name in ("sigma_temperature", "sigma_log_pressure", "sigma_refractivity"):
        before = getattr(fresh, name)(h)
        after = getattr(old, name)(h)
        assert np.all(before > 0.0)
        assert np.all(after >= before * (1.0 - 1e-9))


@given(
    st.integers(5, 200),
    RANDOM,
    st.floats(10.0, 100.0),
)
@settings(max_examples=40)
def test_bins_keep_every_accepted_reading(count, rng, width):
    """Each is in one bin or an outlier; means stay between the extremes."""
    seconds = np.cumsum(rng.uniform(0.1, 2.0, count))
    height = np.cumsum(rng.normal(3.0, 4.0, count))
    value = rng.normal(size=count)
    accepted = rng.random(count) < 0.8

    bins = bin_readings(
        seconds,
        height,
        value,
        accepted,
        width=width,
        slice_s=30.0,
        floor=0.1,
    )

    assert bins.count.sum() + bins.rejected.sum() == accepted.sum()
    assert not np.any(bins.rejected & ~accepted)
    assert np.all(bins.value >= value.min())
    assert np.all(bins.value <= value.max())
    least_sigma = 0.1 / np.sqrt(bins.count)
    assert np.all(bins.sigma >= least_sigma * (1.0 - 1e-12))
