"""What the air changes with age, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.profile_series import (
    SampleAges,
    change_sigma,
    covariance_with_ageing,
    sample_ages,
)
from unbend.geodesy import normal_gravity

HOUR = 3600 * 10**9


def certain(edges_m: list[float]) -> ProfileCovariance:
    """A dry profile that is known without error, with edges at heights [m]."""
    gravity = normal_gravity(0.8)
    edge = gravity.geopotential_height(edges_m)
    t = np.linspace(290.0, 240.0, edge.size)
    layers = stack_layers(edge, t, np.zeros(edge.size), ("measured",) * (edge.size - 1),
                          anchor=(float(edge[0]), 8e4))  # fmt: skip
    size = 2 * edge.size + 1
    return ProfileCovariance(Profile(layers, gravity), float(edge[0]), np.zeros((size, size)))


@pytest.mark.parametrize("ground", [0.0, 2000.0])
def test_the_change_is_that_of_the_height_above_ground(ground):
    """2 K2 an hour at the ground, sqrt(8) K in four; aloft 0.3 of it, by exp(-h/1500 m) between."""
    edges = [ground, ground + 1500.0, ground + 6000.0]
    ages = SampleAges(np.array([ground, ground + 6000.0]), np.array([4.0, 4.0]))
    sigma = covariance_with_ageing(certain(edges), ages).sigma_temperature(edges)
    by_hand = [math.sqrt(8.0) * (0.3 + 0.7 * math.exp(-h / 1500.0)) for h in (0.0, 1500.0, 6000.0)]
    np.testing.assert_allclose(sigma, by_hand, rtol=1e-6)


def test_pressure_changes_where_it_was_sampled_last():
    """5e-4 of ln p an hour there; elsewhere the column between adds to it."""
    edges = [0.0, 1000.0, 5000.0]
    ages = SampleAges(np.array([0.0, 5000.0]), np.array([5.0, 2.0]))
    sigma = covariance_with_ageing(certain(edges), ages).sigma_log_pressure(edges)
    assert sigma[2] == pytest.approx(2 * 5e-4, rel=1e-6)
    assert sigma[0] > 2.0 * sigma[2]


def test_ages_count_from_the_nearest_visit_and_nothing_for_half_an_hour():
    time_ns = np.array([0, 1, 2, 3, 4, 5], np.int64) * HOUR
    h = np.array([550.0, 1050.0, 1550.0, 1550.0, 1050.0, 550.0])
    sensor = SensorSamples(time_ns, h, np.full(6, 280.0), np.zeros(6, np.uint8), "T")
    (ages,) = sample_ages(AirSamples(temperature=sensor), [2 * HOUR], 500.0, 1600.0)
    np.testing.assert_allclose(ages.h_m, [550.0, 1050.0, 1550.0])
    # sqrt(t^2 - 0.25) of 2, 1 and 0 hours.
    np.testing.assert_allclose(ages.hours, [math.sqrt(3.75), math.sqrt(0.75), 0.0], rtol=1e-9)
    (fresh,) = sample_ages(AirSamples(temperature=sensor), [2 * HOUR], 1500.0, 1600.0)
    assert fresh.is_fresh
    assert not ages.is_fresh


def test_below_the_ground_nothing_grows():
    assert change_sigma(np.array([-500.0]), 1.0)[0] == pytest.approx(math.sqrt(2.0))
