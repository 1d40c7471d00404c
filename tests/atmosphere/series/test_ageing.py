"""What the air changes with age, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

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


def dry_profile(edges_m: np.ndarray, kelvin: np.ndarray) -> Profile:
    gravity = normal_gravity(0.8)
    edge = gravity.geopotential_height(edges_m)
    sources = ("measured",) * (edge.size - 1)
    anchor = (float(edge[0]), 8e4)
    layers = stack_layers(edge, kelvin, np.zeros(edge.size), sources, anchor=anchor)
    return Profile(layers, gravity)


def aged(profile: Profile, edges_m: np.ndarray, hours, metres=0.0) -> ProfileCovariance:
    """What is known of a profile that was known without error, so many hours and metres ago."""
    size = 2 * edges_m.size + 1
    certain = ProfileCovariance(profile, float(profile.layers.edge[0]), np.zeros((size, size)))
    ages = SampleAges(edges_m, np.broadcast_to(hours, edges_m.shape), metres)
    return covariance_with_ageing(certain, ages)


def aged_by(edges_m, hours, metres=0.0) -> ProfileCovariance:
    edges_m = np.asarray(edges_m, float)
    profile = dry_profile(edges_m, np.linspace(290.0, 240.0, edges_m.size))
    return aged(profile, edges_m, hours, metres)


def test_exposures_of_a_quarter_of_an_hour_share_the_age_of_their_air():
    begin_ns = 1_749_718_800 * 10**9
    seconds = np.array([0, 899, 900, 1800])
    profile = dry_profile(np.array([0.0, 1000.0]), np.array([290.0, 284.0]))
    series = constant_series(TimedProfile(None, profile), seconds.size)
    groups = group_exposures(series, begin_ns + seconds * 10**9, None)
    assert groups.group.tolist() == [0, 0, 1, 2]
    since_begin_s = [(middle_ns - begin_ns) / 1e9 for middle_ns in groups.middle_ns]
    assert since_begin_s == [449.5, 900.0, 1800.0]


@pytest.mark.parametrize("ground", [0.0, 2000.0])
def test_the_change_is_that_of_the_height_above_ground(ground):
    """Over Vienna temperatures change in 24 h by 3.1, 3.8 and 4.3 K RMS at 0, 1 and 5 km."""
    edges = ground + np.array([0.0, 1000.0, 5000.0])
    half, day, twice = (
        aged_by(edges, hours).sigma_temperature(edges) for hours in (12.0, 24.0, 48.0)
    )
    np.testing.assert_allclose(day, [3.1, 3.8, 4.3], rtol=0.3)
    assert half[0] > day[0]  # the day's cycle
    assert np.all(twice[1:] > 1.15 * day[1:])


def test_a_distance_ages_too():
    """Stations of North America of one hour, 340 km apart, differ by 2.5 K RMS 3 to 5 km up."""
    edges = np.array([0.0, 1000.0, 4000.0])
    sigma = aged_by(edges, 0.0, np.full(3, 340e3)).sigma_temperature(edges)
    assert sigma[2] == pytest.approx(2.5, rel=0.4)


def thermometer(minutes, h_m) -> AirSamples:
    minutes = np.asarray(minutes)
    time_ns = (minutes * MINUTE_NS).astype(np.int64)
    t = np.full(minutes.size, 280.0)
    return AirSamples(SensorSamples(time_ns, np.asarray(h_m, float), t, name="T"))


def ages_at(samples: AirSamples, minute: float, path=None, low=500.0, high=2400.0) -> SampleAges:
    (ages,) = sample_ages(samples, [round(minute * MINUTE_NS)], low, high, path)
    return ages


def path_north(minutes, metres) -> FlightPath:
    time_ns = (np.asarray(minutes) * MINUTE_NS).astype(np.int64)
    return FlightPath(time_ns, np.asarray(metres) / EARTH_M, np.zeros(time_ns.size))


def test_the_nearest_visit_is_near_in_time_and_place():
    """Climb, a dip 100 km away an hour later, and back: the climb counts, not the latest visit."""
    minutes = np.arange(161.0)
    h = np.interp(minutes, [0, 20, 60, 80, 100], [500.0, 2500.0, 2500.0, 500.0, 2500.0])
    path = path_north(minutes, np.interp(minutes, [20, 60, 100, 160], [0.0, 1e5, 1e5, 0.0]))
    samples = thermometer(minutes, h)
    back = ages_at(samples, 160, path)
    assert np.all(np.asarray(back.metres) < 1.0)
    np.testing.assert_allclose(back.hours, 2.5, atol=0.3)
    np.testing.assert_allclose(ages_at(samples, 160).hours, 1.1, atol=0.4)
    climb_alone = thermometer(minutes[:21], h[:21])
    far = ages_at(climb_alone, 60, path)
    np.testing.assert_allclose(far.metres, math.sqrt(100e3**2 - 18e3**2), rtol=1e-3)


@pytest.mark.parametrize(("km", "is_fresh"), [(15.0, True), (25.0, False)])
def test_what_is_near_in_distance_is_as_fresh_as_half_an_hour(km, is_fresh):
    samples = thermometer(np.arange(21.0), np.linspace(500.0, 2500.0, 21))
    path = path_north([0, 20, 25], [0.0, 0.0, 1e3 * km])
    assert ages_at(samples, 25, path).is_fresh is is_fresh


def test_ages_count_from_the_nearest_visit_and_nothing_for_half_an_hour():
    h = [550.0, 1050.0, 1550.0, 1550.0, 1050.0, 550.0]
    samples = thermometer(HOUR * np.arange(6), h)
    ages = ages_at(samples, 2 * HOUR, high=1600.0)
    np.testing.assert_allclose(ages.h_m, [550.0, 1050.0, 1550.0])
    # sqrt(t^2 - 0.25) of 2, 1 and 0 hours.
    np.testing.assert_allclose(ages.hours, [math.sqrt(3.75), math.sqrt(0.75), 0.0], rtol=1e-9)
    assert not ages.is_fresh
    assert ages_at(samples, 2 * HOUR, low=1500.0, high=1600.0).is_fresh


def test_pressure_changes_where_it_was_sampled_last():
    """5e-4 of ln p an hour there; elsewhere the column between adds to it."""
    edges = [0.0, 1000.0, 5000.0]
    low, _, high = aged_by(edges, [5.0, 4.4, 2.0]).sigma_log_pressure(edges)
    assert high == pytest.approx(2 * 5e-4, rel=1e-6)
    assert low > 2.0 * high
    # 1.5e-8 a metre; the highest of those that are equally old counts as sampled last.
    far = aged_by(edges, 2.0, np.full(3, 1e5)).sigma_log_pressure(edges)
    assert far[2] == pytest.approx(math.hypot(2 * 5e-4, 1.5e-3), rel=1e-6)


def test_a_degree_of_longitude_is_shorter_in_the_north():
    """A hundredth of a radian at 60 N: half of 63.71 km."""
    times = np.array([0, 10], np.int64) * MINUTE_NS
    path = FlightPath(times, np.full(2, math.radians(60.0)), np.array([0.0, 0.01]))
    metres = path.metres_between(times, int(times[0]))
    assert metres == pytest.approx([0.0, 0.005 * EARTH_M], rel=1e-9)


def test_what_is_told_of_old_air_is_its_own_age_and_distance():
    """Half an hour and 18 km count again: 5, 12 and 13, and 3, 4 and 5."""
    fresh = SampleAges(np.array([500.0, 900.0]), np.zeros(2), np.array([0.0, 24e3]))
    old = SampleAges(np.array([500.0, 900.0]), np.array([0.3, 1.2]))
    told = aged_note([fresh, old], count=7)
    assert told.count == 7
    assert told.values == pytest.approx({"hours": 1.3, "km": 30.0, "height_m": 900.0})


def test_below_the_ground_nothing_grows():
    h = np.array([-500.0, 0.0, 5000.0])
    sigma = sigma_of(change_parts(0.8, 0.0, 2.0, 0.0, h), h)
    assert sigma[0] == pytest.approx(sigma[1])


def mean_gradient(profile: Profile, climb_m: float) -> float:
    """R / tan(zeta) in the plane: the mean of N - N_c below a camera (Gyer 1996, Eq. 24)."""
    refractivity = profile.refractivity(np.linspace(0.0, climb_m, 601))
    return float(np.mean(refractivity - refractivity[-1]))


@pytest.mark.parametrize("climb_m", [1000.0, 3000.0, 6000.0])
@pytest.mark.parametrize(
    ("km", "warmer_k", "most_sigmas"),
    [(100.0, 2.0, 1.3), (200.0, 4.0, 1.3), (100.0, 5.0, 2.5), (200.0, 10.0, 2.5)],
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
    sigma = aged(here, edges, 0.0, np.full(edges.size, 1e3 * km)).relative_sigma(climb_m, 0.0)
    of_warmer = mean_gradient(dry_profile(edges, t + warmer_k), climb_m)
    error = abs(of_warmer / mean_gradient(here, climb_m) - 1.0)
    assert error > 0.008
    assert error < most_sigmas * sigma
    assert sigma < 0.12


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
    dry = dry_profile(heights, np.array([290.0, 240.0]))
    moist = replace(dry, layers=replace(dry.layers, vapour=np.array([0.0, 0.05])))
    change = change_of_vapour(moist, SampleAges(heights, np.full(2, hours), np.full(2, metres)))
    expected = 0.1 * share * saturated_pa(290.0 - 273.15) / 8e4
    assert change[0] == pytest.approx(expected, rel=0.01)
