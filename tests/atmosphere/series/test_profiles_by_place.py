"""The air along a long flight by a weather model, against air that is integrated at each place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.atmosphere import flights
from tests.atmosphere.adjusting import TRADES, Adjusted, adjust, flown
from tests.atmosphere.flights import Truth
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.atmosphere.series.profiles_by_place import add_model_changes
from unbend.atmosphere.soundings.model_field import ModelField

K_PER_KM = 0.05
CLIMB = 3000.0
EARTH_KM = 6371.0
LEVELS = np.concatenate([np.arange(20e3, 76e3, 5e3), np.arange(77.5e3, 102e3, 2.5e3)])
BALLOON = flights.extremes()[TRADES]
LATITUDE = BALLOON.latitude


def air_at(east_km: float, bias_k=0.0) -> Truth:
    """The air of a place: 5 K warmer each 100 km to the east, at the same surface pressure."""
    return Truth(replace(BALLOON, t=BALLOON.t + K_PER_KM * east_km + bias_k))


def east_rad(km):
    return np.asarray(km) / (EARTH_KM * np.cos(LATITUDE))


@pytest.fixture(scope="module")
def field():
    """A model of that air, 1.5 K too warm everywhere, with nodes 25 km apart, at two hours."""
    nodes = np.arange(-125.0, 126.0, 25.0)
    t, q, height = np.empty((3, 2, LEVELS.size, 2, nodes.size))
    for node, km in enumerate(nodes):
        truth = air_at(km, bias_k=1.5)
        h = np.interp(-np.log(LEVELS), -np.log(truth.p), truth.h)
        e = np.interp(h, truth.h, truth.e)
        t[..., node] = np.interp(h, truth.h, truth.t)[:, None]
        q[..., node] = (0.622 * e / (LEVELS - 0.378 * e))[:, None]
        height[..., node] = flights.geopotential(LATITUDE, h)[:, None]
    t[1] += 2.0  # it warms by 2 K in four hours
    start_ns = air_at(0.0).start_ns
    times = start_ns + np.array([0, 4 * 3600], np.int64) * 10**9
    latitudes = LATITUDE + np.array([-0.01, 0.01])
    return ModelField("m.nc", times, latitudes, east_rad(nodes), LEVELS, t, q, height)


@pytest.fixture(scope="module")
def measured() -> Adjusted:
    """What a flight measured that climbed at kilometre 0."""
    truth = air_at(0.0)
    return adjust(truth, flown(truth, CLIMB, flights.Sensors(), seed=3, humidity="profile"))


def with_changes(measured, field, timed: TimedProfile, km, hours=0.0):
    """The air at places, by the air that was measured and the changes of the model."""
    km = np.asarray(km, float)
    start_ns = measured.truth.start_ns
    ground = measured.truth.ground_m
    return add_model_changes(
        constant_series(timed, km.size),
        field,
        np.full(km.size, start_ns + round(hours * 3.6e12)),
        np.full(km.size, LATITUDE),
        east_rad(km),
        h_c=[ground + CLIMB],
        h_g=ground,
        measured=True,
    )


def sampled_at(measured, km, time_ns: int) -> TimedProfile:
    place = (LATITUDE, float(east_rad(km)), measured.truth.start_ns)
    return TimedProfile(time_ns, measured.profile, measured.covariance, sampled_at=place)


def at_places(measured, field, km, hours=0.0):
    whole = sampled_at(measured, 0.0, measured.made.time_ns)
    return with_changes(measured, field, whole, km, hours)


def test_at_the_ends_of_200_km_the_error_falls_from_3_percent_below_04(field, measured):
    km = np.linspace(-100.0, 100.0, 81)
    series, (told,) = at_places(measured, field, km)
    assert told.code == "AIR-BY-PLACE"
    assert 60 < len(series.profiles) <= 81
    for end in (0, -1):
        truth = air_at(float(km[end]))
        air = series.timed_profiles[series.profile_number[end]]
        after = abs(truth.error(air.profile, CLIMB))
        assert after < 0.004
        sigma = air.covariance.relative_sigma(truth.ground_m + CLIMB, truth.ground_m)
        assert after < 2.0 * sigma < 0.04
        # Pressure at the camera too: what a station's columns show.
        h = truth.ground_m + 2990.0
        assert air.profile.pressure(h) == pytest.approx(np.interp(h, truth.h, truth.p), rel=1e-3)


def test_sigma_grows_from_where_the_air_was_measured(measured, field):
    series, _ = at_places(measured, field, [0.0, 50.0, 100.0])
    ground = measured.truth.ground_m
    sigmas = [measured.sigma(CLIMB)]
    for number in series.profile_number:
        covariance = series.timed_profiles[number].covariance
        sigmas.append(covariance.relative_sigma(ground + CLIMB, ground))
    assert np.all(np.diff(sigmas) > 0.0)
    assert sigmas[-1] < 0.02


def test_it_changes_with_time_as_the_model_does(field, measured):
    series, _ = at_places(measured, field, [0.0, 1.0], hours=4.0)
    truth = air_at(0.0, bias_k=2.0)
    h = np.linspace(100.0, 2900.0, 20) + truth.ground_m
    off = series.profiles[0].temperature(h) - np.interp(h, truth.h, truth.t)
    assert_allclose(off, 0.0, atol=1.7)  # an inversion of 6 K is a little rounded
    assert np.sqrt(np.mean(off**2)) < 0.6
    assert abs(np.mean(off)) < 0.2


def test_a_short_flight_keeps_one_profile(measured, field):
    series, notes = at_places(measured, field, np.linspace(0.0, 20.0, 5), hours=1.5)
    assert not notes
    assert series.profiles == (measured.profile,)


def test_exposures_without_a_place_keep_the_air_of_the_flight(measured, field):
    series, _ = at_places(measured, field, [-50.0, np.nan, 50.0])
    placed, unplaced, _ = (series.profiles[number] for number in series.profile_number)
    assert unplaced is measured.profile
    assert placed is not measured.profile


def test_between_two_windows_both_places_count(measured, field):
    """0.25 * -40 + 0.75 * 40 = 20 km: nothing changes there."""
    start_ns = measured.truth.start_ns
    west = sampled_at(measured, -40.0, start_ns)
    east = sampled_at(measured, 40.0, start_ns + 1)
    between = TimedProfile(start_ns, measured.profile, neighbours=(west, east, 0.75))
    series, _ = with_changes(measured, field, between, [20.0])
    h = np.linspace(100.0, 2900.0, 20) + measured.truth.ground_m
    expected = measured.profile.temperature(h)
    assert_allclose(series.profiles[0].temperature(h), expected, atol=0.05)
