"""What the air changes with age, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.air_variation import sigma_of
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.ageing import (
    FlightPath,
    SampleAges,
    change_of_vapour,
    change_parts,
    covariance_with_ageing,
    sample_ages,
)
from unbend.geodesy import normal_gravity

HOUR = 3600 * 10**9


def certain(edges_m: list[float], highest_k: float = 240.0) -> ProfileCovariance:
    """A dry profile from 290 K at the lowest of edges [m], known without error."""
    gravity = normal_gravity(0.8)
    edge = gravity.geopotential_height(edges_m)
    t = np.linspace(290.0, highest_k, edge.size)
    layers = stack_layers(
        edge, t, np.zeros(edge.size), ("measured",) * (edge.size - 1), anchor=(float(edge[0]), 8e4)
    )
    size = 2 * edge.size + 1
    return ProfileCovariance(Profile(layers, gravity), float(edge[0]), np.zeros((size, size)))


@pytest.mark.parametrize("ground", [0.0, 2000.0])
def test_the_change_is_that_of_the_height_above_ground(ground):
    """Over Vienna temperatures change in 24 h by 3.1, 3.8 and 4.3 K RMS at 0, 1 and 5 km."""
    heights = np.array([0.0, 1000.0, 5000.0])
    edges = (ground + heights).tolist()
    day = SampleAges(np.array(edges), np.full(3, 24.0))
    sigma = covariance_with_ageing(certain(edges), day).sigma_temperature(edges)
    np.testing.assert_allclose(sigma, [3.1, 3.8, 4.3], rtol=0.3)
    half = SampleAges(np.array(edges), np.full(3, 12.0))
    by_night = covariance_with_ageing(certain(edges), half).sigma_temperature(edges)
    assert by_night[0] > sigma[0]  # the day's cycle
    twice = SampleAges(day.h_m, 2.0 * day.hours)
    later = covariance_with_ageing(certain(edges), twice).sigma_temperature(edges)
    assert np.all(later[1:] > 1.15 * sigma[1:])


def test_a_distance_ages_too():
    """Stations of North America of one hour, 340 km apart, differ by 2.5 K RMS 3 to 5 km up."""
    edges = [0.0, 1000.0, 4000.0]
    far = SampleAges(np.array(edges), np.zeros(3), np.full(3, 340e3))
    sigma = covariance_with_ageing(certain(edges), far).sigma_temperature(edges)
    assert sigma[2] == pytest.approx(2.5, rel=0.4)
    assert not far.is_fresh


def test_the_nearest_visit_is_near_in_time_and_place():
    """Climb, a dip 100 km away an hour later, and back: the climb counts, not the latest visit."""
    minutes = np.arange(0, 161)
    time_ns = minutes * np.int64(60 * 10**9)
    h = np.interp(minutes, [0, 20, 60, 80, 100], [500.0, 2500.0, 2500.0, 500.0, 2500.0])
    far_north = 100e3 / 6.371e6
    north = np.interp(minutes, [20, 60, 100, 160], [0.0, far_north, far_north, 0.0])
    path = FlightPath(time_ns, north, np.zeros(north.size))
    sensor = SensorSamples(time_ns, h, np.full(h.size, 280.0), np.zeros(h.size, np.uint8), "T")
    samples = AirSamples(temperature=sensor)
    back = [int(time_ns[160])]
    (ages,) = sample_ages(samples, back, 500.0, 2400.0, path)
    assert np.all(np.asarray(ages.metres) < 1.0)
    np.testing.assert_allclose(ages.hours, 2.5, atol=0.3)
    (without,) = sample_ages(samples, back, 500.0, 2400.0)
    np.testing.assert_allclose(without.hours, 1.1, atol=0.4)
    (away,) = sample_ages(samples, [int(time_ns[60])], 500.0, 2400.0, path)
    assert np.all(np.asarray(away.metres) < 1.0)
    climb = SensorSamples(*(v[:21] for v in (time_ns, h, sensor.value, sensor.rejected)), "T")
    (far,) = sample_ages(AirSamples(temperature=climb), [int(time_ns[60])], 500.0, 2400.0, path)
    np.testing.assert_allclose(far.metres, math.sqrt(100e3**2 - 18e3**2), rtol=1e-3)


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
    h = np.array([-500.0, 0.0, 5000.0])
    sigma = sigma_of(change_parts(0.8, 0.0, 2.0, 0.0, h), h)
    assert sigma[0] == pytest.approx(sigma[1])


@pytest.mark.parametrize("climb_m", [1000.0, 3000.0, 6000.0])
@pytest.mark.parametrize("kelvin_per_100_km", [2.0, 5.0])
@pytest.mark.parametrize("km", [100.0, 200.0])
def test_air_that_is_warmer_far_from_the_climb_is_within_the_sigma(climb_m, kelvin_per_100_km, km):
    """The air was sampled at one place, all of it warms evenly towards the images.

    5 K/100 km are a strong front: 10 K from 200 km away. R errs by 1.2 % for 2 K, by 6 % for 10.
    """
    edges = np.arange(0.0, climb_m + 2001.0, 250.0).tolist()
    here = certain(edges, highest_k=290.0 - 0.0065 * edges[-1])
    warmer = replace(here.profile, layers=warmed(here.profile, kelvin_per_100_km * km / 100.0))
    far = SampleAges(np.array(edges), np.zeros(len(edges)), np.full(len(edges), 1e3 * km))
    sigma = covariance_with_ageing(here, far).relative_sigma(climb_m, 0.0)
    error = mean_gradient(warmer, climb_m) / mean_gradient(here.profile, climb_m) - 1.0
    assert abs(error) > 0.008
    assert abs(error) / sigma < 2.5
    if kelvin_per_100_km == 2.0:
        assert abs(error) / sigma < 1.3
    assert sigma < 0.12


def warmed(profile: Profile, kelvin: float):
    """The layers of a dry profile, warmer by so much from the ground to their top."""
    layers = profile.layers
    h = profile.gravity.height(layers.edge)
    t_k, _, vapour = profile.state(h)
    ground = float(layers.edge[0]), float(profile.pressure(h[0]))
    return stack_layers(
        layers.edge, t_k + kelvin, vapour, layers.sources_between(layers.edge), anchor=ground
    )


def mean_gradient(profile: Profile, climb_m: float) -> float:
    """R / tan(zeta) in the plane: the mean of N - N_c below a camera (Gyer 1996, Eq. 24)."""
    refractivity = profile.refractivity(np.linspace(0.0, climb_m, 601))
    return float(np.mean(refractivity - refractivity[-1]))


def test_what_is_near_in_distance_is_as_fresh_as_half_an_hour():
    minute = np.int64(60 * 10**9)
    time_ns = np.arange(21) * minute
    h = np.linspace(500.0, 2500.0, 21)
    sensor = SensorSamples(time_ns, h, np.full(21, 280.0), np.zeros(21, np.uint8), "T")
    for km, is_fresh in ((15.0, True), (25.0, False)):
        north = np.array([0.0, 0.0, km * 1e3 / 6.371e6])
        path = FlightPath(np.array([0, 20, 25]) * minute, north, np.zeros(3))
        samples = AirSamples(temperature=sensor)
        (ages,) = sample_ages(samples, [int(25 * minute)], 500.0, 2400.0, path)
        assert ages.is_fresh is is_fresh


def test_humidity_changes_by_a_tenth_within_four_hours_and_then_no_more():
    """0.1 sqrt(age / 4 h) of e_s/p; 36 km are as an hour. e_s(290 K) is 19.2 hPa (Sonntag 1990)."""
    moist = certain([0.0, 8000.0]).profile
    moist = replace(moist, layers=replace(moist.layers, vapour=np.array([0.0, 0.05])))
    heights = np.array([0.0, 8000.0])
    share_of_age = {0.0: 0.0, 1.0: 0.5, 2.25: 0.75, 4.0: 1.0, 9.0: 1.0}
    for hours, share in share_of_age.items():
        change = change_of_vapour(moist, SampleAges(heights, np.full(2, hours)))
        assert change[0] == pytest.approx(0.1 * share * 1920.0 / 8e4, rel=0.01)
    far = change_of_vapour(moist, SampleAges(heights, np.zeros(2), np.full(2, 36e3)))
    assert far[0] == pytest.approx(0.05 * 1920.0 / 8e4, rel=0.01)
