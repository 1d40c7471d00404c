"""What the air changes with age, by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.atmosphere.values import saturated_pa
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.air_variation import sigma_of
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.ageing import (
    FlightPath,
    SampleAges,
    aged_note,
    change_of_vapour,
    change_parts,
    covariance_with_ageing,
    sample_ages,
)
from unbend.atmosphere.series.profile_series import (
    TimedProfile,
    constant_series,
    group_exposures,
)
from unbend.geodesy import normal_gravity

MINUTE_NS = 60 * 10**9
HOUR = 60.0  # minutes
EARTH_M = 6.371e6


def dry_profile(edges_m, kelvin):
    gravity = normal_gravity(0.8)
    edge = gravity.geopotential_height(edges_m)
    layers = stack_layers(
        edge,
        np.array(kelvin),
        np.zeros(edge.size),
        ("measured",) * (edge.size - 1),
        anchor=(edge[0], 8e4),
    )
    return Profile(layers, gravity)


def aged(profile, edges_m, hours, metres=0.0):
    """What is known of a profile that was known without error, so many hours and metres ago."""
    size = 2 * edges_m.size + 1
    certain = ProfileCovariance(
        profile,
        profile.layers.edge[0],
        np.zeros((size, size)),
    )
    of_edges = np.zeros(edges_m.size)
    ages = SampleAges(edges_m, of_edges + hours, of_edges + metres)
    return covariance_with_ageing(certain, ages)


def aged_by(edges_m, hours, metres=0.0):
    kelvin = np.linspace(290.0, 240.0, edges_m.size)
    profile = dry_profile(edges_m, kelvin)
    return aged(profile, edges_m, hours, metres)


def test_exposures_of_a_quarter_of_an_hour_share_the_age_of_their_air():
    begin_ns = 1_749_718_800 * 10**9
    seconds = np.array([0, 899, 900, 1800])
    profile = dry_profile([0.0, 1000.0], [290.0, 284.0])
    series = constant_series(TimedProfile(None, profile), seconds.size)

    groups = group_exposures(series, begin_ns + seconds * 10**9, None)

    assert groups.group.tolist() == [0, 0, 1, 2]
    since_begin_s = (np.array(groups.mean_ns) - begin_ns) / 1e9
    assert since_begin_s.tolist() == [449.5, 900.0, 1800.0]


@pytest.mark.parametrize("ground", [0.0, 2000.0])
def test_the_change_is_that_of_the_height_above_ground(ground):
    """Over Vienna temperatures change in 24 h by 3.1, 3.8 and 4.3 K RMS at 0, 1 and 5 km."""
    edges = ground + np.array([0.0, 1000.0, 5000.0])

    def sigma_k(hours):
        return aged_by(edges, hours).sigma_temperature(edges)

    half_a_day = sigma_k(12.0)
    day = sigma_k(24.0)
    two_days = sigma_k(48.0)
    assert_allclose(day, [3.1, 3.8, 4.3], rtol=0.3)
    assert half_a_day[0] > day[0]  # the day's cycle
    assert np.all(two_days[1:] > 1.15 * day[1:])


def test_a_distance_ages_too():
    """Stations of North America of one hour, 340 km apart, differ by 2.5 K RMS 3 to 5 km up."""
    edges = np.array([0.0, 1000.0, 4000.0])
    covariance = aged_by(edges, hours=0.0, metres=340e3)
    *_, sigma = covariance.sigma_temperature(edges)
    assert_allclose(sigma, 2.5, rtol=0.4)


def ns_of(minutes):
    return (np.asarray(minutes) * MINUTE_NS).astype(np.int64)


def thermometer(minutes, h_m):
    t = np.full(minutes.size, 280.0)
    return AirSamples(SensorSamples(ns_of(minutes), h_m, t))


def ages_at(
    samples,
    minute,
    path=None,
    low=500.0,
    high=2400.0,
):
    (ages,) = sample_ages(
        samples,
        [minute * MINUTE_NS],
        low,
        high,
        path,
    )
    return ages


def path_north(minutes, metres):
    north_rad = np.asarray(metres) / EARTH_M
    return FlightPath(ns_of(minutes), north_rad, 0.0 * north_rad)


def test_the_nearest_visit_is_near_in_time_and_place():
    """Climb, a dip 100 km away an hour later, and back: the climb counts, not the latest visit."""
    minutes = np.arange(161.0)
    h = np.interp(
        minutes,
        [0, 20, 60, 80, 100],
        [500, 2500, 2500, 500, 2500],
    )
    metres = np.interp(minutes, [20, 60, 100, 160], [0, 1e5, 1e5, 0])
    path = path_north(minutes, metres)
    samples = thermometer(minutes, h)
    climb_alone = thermometer(minutes[:21], h[:21])

    back = ages_at(samples, 160, path)
    without_place = ages_at(samples, 160)
    far = ages_at(climb_alone, 60, path)

    assert np.all(back.metres < 1.0)
    assert_allclose(back.hours, 2.5, atol=0.3)
    assert_allclose(without_place.hours, 1.1, atol=0.4)
    beyond_18_km = math.sqrt(100e3**2 - 18e3**2)
    assert_allclose(far.metres, beyond_18_km, rtol=1e-3)


@pytest.mark.parametrize(
    ("km", "is_fresh"),
    [
        (15.0, True),
        (25.0, False),
    ],
)
def test_what_is_near_in_distance_is_as_fresh_as_half_an_hour(km, is_fresh):
    minutes = np.arange(21)
    samples = thermometer(minutes, 500.0 + 100.0 * minutes)
    path = path_north([0, 20, 25], [0, 0, 1e3 * km])
    assert ages_at(samples, 25, path).is_fresh is is_fresh


def test_ages_count_from_the_nearest_visit_and_nothing_for_half_an_hour():
    h = np.array([550.0, 1050.0, 1550.0, 1550.0, 1050.0, 550.0])
    samples = thermometer(HOUR * np.arange(6), h)

    ages = ages_at(samples, 2 * HOUR, high=1600.0)
    aloft = ages_at(samples, 2 * HOUR, low=1500.0, high=1600.0)

    assert_allclose(ages.h_m, h[:3])
    # sqrt(t^2 - 0.25) of 2, 1 and 0 hours.
    expected = np.sqrt([3.75, 0.75, 0.0])
    assert_allclose(ages.hours, expected, rtol=1e-9)
    assert not ages.is_fresh
    assert aloft.is_fresh


def test_pressure_changes_where_it_was_sampled_last():
    """5e-4 of ln p an hour there; elsewhere the column between adds to it."""
    edges = np.array([0.0, 1000.0, 5000.0])
    covariance = aged_by(edges, hours=[5.0, 4.4, 2.0])
    low, _, high = covariance.sigma_log_pressure(edges)
    assert_allclose(high, 2 * 5e-4)
    assert low > 2.0 * high
    # 1.5e-8 a metre; the highest of those that are equally old counts as sampled last.
    far = aged_by(edges, hours=2.0, metres=1e5)
    *_, high = far.sigma_log_pressure(edges)
    assert_allclose(high, math.hypot(2 * 5e-4, 1.5e-3))


def test_a_degree_of_longitude_is_shorter_in_the_north():
    """A hundredth of a radian at 60 N: half of 63.71 km."""
    times = ns_of([0, 10])
    sixty_north = np.radians([60.0, 60.0])
    path = FlightPath(times, sixty_north, np.array([0.0, 0.01]))
    metres = path.metres_between(times, times[0])
    assert metres == pytest.approx([0.0, 0.005 * EARTH_M], rel=1e-9)


def test_what_is_told_of_old_air_is_its_own_age_and_distance():
    """Half an hour and 18 km count again: 5, 12 and 13, and 3, 4 and 5."""
    h = np.array([500.0, 900.0])
    fresh = SampleAges(h, np.zeros(2), np.array([0.0, 24e3]))
    old = SampleAges(h, np.array([0.3, 1.2]))
    message = aged_note([fresh, old], count=7)
    assert message.count == 7
    expected = {"hours": 1.3, "km": 30.0, "height_m": 900.0}
    assert message.values == pytest.approx(expected)


def test_below_the_ground_nothing_grows():
    h = np.array([-500.0, 0.0, 5000.0])
    parts = change_parts(0.8, 0.0, 2.0, 0.0, h)
    underground, ground, _ = sigma_of(parts, h)
    assert underground == pytest.approx(ground)


def mean_gradient(profile, climb_m):
    """R / tan(zeta) in the plane: the mean of N - N_c below a camera (Gyer 1996, Eq. 24)."""
    h = np.linspace(0.0, climb_m, 601)
    n = profile.refractivity(h)
    return np.mean(n - n[-1])


@pytest.mark.parametrize("climb_m", [1000.0, 3000.0, 6000.0])
@pytest.mark.parametrize(
    ("km", "warmer_k", "most_sigmas"),
    [
        (100.0, 2.0, 1.3),
        (200.0, 4.0, 1.3),
        (100.0, 5.0, 2.5),
        (200.0, 10.0, 2.5),
    ],
)
def test_air_that_is_warmer_far_from_the_climb_is_within_the_sigma(
    climb_m, km, warmer_k, most_sigmas
):
    """The air was sampled at one place, all of it warms evenly towards the images.

    5 K/100 km are a strong front: 10 K from 200 km away. R errs by 1.2 % for 2 K, by 6 % for 10.
    """
    edges = np.arange(0.0, climb_m + 2001.0, 250.0)
    t = 290.0 - 0.0065 * edges
    here = dry_profile(edges, t)
    there = dry_profile(edges, t + warmer_k)

    covariance = aged(here, edges, hours=0.0, metres=1e3 * km)

    sigma = covariance.relative_sigma(climb_m, 0.0)
    right = mean_gradient(there, climb_m)
    error = abs(right / mean_gradient(here, climb_m) - 1.0)
    assert 0.008 < error < most_sigmas * sigma
    assert sigma < 0.13


@pytest.mark.parametrize(
    ("hours", "metres", "share"),
    [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.5),
        (2.25, 0.0, 0.75),
        (4.0, 0.0, 1.0),
        (9.0, 0.0, 1.0),
        (0.0, 36e3, 0.5),
    ],
)
def test_humidity_changes_by_a_tenth_within_four_hours_and_then_no_more(hours, metres, share):
    """0.1 sqrt(age / 4 h) of e_s/p; 36 km are as an hour."""
    heights = np.array([0.0, 8000.0])
    dry = dry_profile(heights, [290.0, 240.0])
    moist_layers = replace(dry.layers, vapour=np.array([0.0, 0.05]))
    moist = replace(dry, layers=moist_layers)
    ages = SampleAges(heights, np.full(2, hours), np.full(2, metres))

    at_ground, _ = change_of_vapour(moist, ages)

    expected = 0.1 * share * saturated_pa(290.0 - 273.15) / 8e4
    assert_allclose(at_ground, expected, rtol=0.01)
