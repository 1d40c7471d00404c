"""The air along a long flight by a weather model, against air that is integrated at each place."""

from dataclasses import replace

import numpy as np
import pytest

from tests.atmosphere import flights
from tests.atmosphere.adjusting import TRADES, adjust, flown, rms, sigma_of_r
from tests.atmosphere.flights import Truth
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.atmosphere.series.profiles_by_place import add_model_changes
from unbend.atmosphere.soundings.model_field import ModelField

K_PER_KM = 0.05
CLIMB = 3000.0
EARTH_KM = 6371.0
LEVELS = np.append(
    np.arange(20e3, 76e3, 5e3),
    np.arange(77.5e3, 102e3, 2.5e3),
)
BALLOON = flights.extremes()[TRADES]
LATITUDE = BALLOON.latitude


def air_at(east_km, bias_k=0.0):
    """The air of a place: 5 K warmer each 100 km to the east, at the same surface pressure."""
    t = BALLOON.t + K_PER_KM * east_km + bias_k
    return Truth(replace(BALLOON, t=t))


def east_rad(km):
    circle_km = EARTH_KM * np.cos(LATITUDE)
    return np.asarray(km) / circle_km


@pytest.fixture(scope="module")
def field():
    """A model of that air, 1.5 K too warm everywhere, with nodes 25 km apart, at two hours."""
    nodes = np.arange(-125.0, 126.0, 25.0)
    t, q, height = np.empty((3, 2, LEVELS.size, 2, nodes.size))
    for node, km in enumerate(nodes):
        truth = air_at(km, bias_k=1.5)
        h = truth.at_pressure(truth.h, LEVELS[:, None])
        e = np.interp(h, truth.h, truth.e)
        t[..., node] = np.interp(
            h,
            truth.h,
            truth.t,
        )
        q[..., node] = 0.622 * e / (LEVELS[:, None] - 0.378 * e)
        height[..., node] = flights.geopotential(LATITUDE, h)
    t[1] += 2.0  # it warms by 2 K in four hours
    return ModelField(
        "m.nc",
        truth.start_ns + np.array([0, 4 * 3600]) * 10**9,
        LATITUDE + np.array([-0.01, 0.01]),
        east_rad(nodes),
        LEVELS,
        t,
        q,
        height,
    )


@pytest.fixture(scope="module")
def measured():
    """What a flight measured that climbed at kilometre 0."""
    truth = air_at(0.0)
    samples = flown(
        truth,
        CLIMB,
        flights.Sensors(),
        seed=3,
        humidity="profile",
    )
    return adjust(truth, samples)


def with_changes(
    measured,
    field,
    timed,
    km,
    hours=0.0,
):
    """The air at places, by the air that was measured and the changes of the model."""
    count = len(km)
    truth = measured.truth
    return add_model_changes(
        constant_series(timed, count),
        field,
        np.full(count, truth.start_ns + round(hours * 3.6e12)),
        np.full(count, LATITUDE),
        east_rad(km),
        h_c=[truth.ground_m + CLIMB],
        h_g=truth.ground_m,
        measured=True,
    )


def sampled_at(measured, km, time_ns):
    return TimedProfile(
        time_ns,
        measured.profile,
        measured.covariance,
        sampled_at=(LATITUDE, east_rad(km), measured.truth.start_ns),
    )


def at_places(measured, field, km, hours=0.0):
    whole = sampled_at(measured, 0.0, measured.made.time_ns)
    return with_changes(measured, field, whole, km, hours)


def test_at_the_ends_of_200_km_the_error_falls_from_3_percent_below_04(field, measured):
    km = np.linspace(-100.0, 100.0, 81)
    series, (message,) = at_places(measured, field, km)
    assert message.code == "AIR-BY-PLACE"
    assert 60 < len(series.profiles) <= 81
    for end in (0, -1):
        truth = air_at(km[end])
        air = series.timed_profiles[series.profile_number[end]]
        error = abs(truth.error(air.profile, CLIMB))
        assert error < 0.004
        assert error < 2.0 * sigma_of_r(air, truth, CLIMB) < 0.04
        # Pressure at the camera too: what a station's columns show.
        high = 2990
        p = air.profile.pressure(truth.h[high])
        assert p == pytest.approx(truth.p[high], rel=1e-3)


def test_sigma_grows_from_where_the_air_was_measured(measured, field):
    series, _ = at_places(
        measured,
        field,
        [0.0, 50.0, 100.0],
    )
    sigmas = [measured.sigma(CLIMB)]
    for number in series.profile_number:
        air = series.timed_profiles[number]
        sigmas.append(sigma_of_r(air, measured.truth, CLIMB))
    assert np.all(np.diff(sigmas) > 0.0)
    assert sigmas[-1] < 0.02


def test_it_changes_with_time_as_the_model_does(field, measured):
    series, _ = at_places(
        measured,
        field,
        [0.0, 1.0],
        hours=4.0,
    )
    truth = air_at(0.0, bias_k=2.0)
    levels = slice(100, 2901, 147)
    t = series.profiles[0].temperature(truth.h[levels])
    off = t - truth.t[levels]
    assert np.abs(off).max() < 1.7  # an inversion of 6 K is a little rounded
    assert rms(off) < 0.6
    assert abs(off.mean()) < 0.2


def test_a_short_flight_keeps_one_profile(measured, field):
    km = np.linspace(0.0, 20.0, 5)
    series, notes = at_places(measured, field, km, hours=1.5)
    assert not notes
    assert series.profiles == (measured.profile,)


def test_exposures_without_a_place_keep_the_air_of_the_flight(measured, field):
    series, _ = at_places(
        measured,
        field,
        [-50.0, np.nan, 50.0],
    )
    placed, unplaced, _ = series.profile_number
    assert series.profiles[unplaced] is measured.profile
    assert series.profiles[placed] is not measured.profile


def test_between_two_windows_both_places_count(measured, field):
    """0.25 * -40 + 0.75 * 40 = 20 km: nothing changes there."""
    start_ns = measured.truth.start_ns
    west = sampled_at(measured, -40.0, start_ns)
    east = sampled_at(measured, 40.0, start_ns + 1)
    between = TimedProfile(
        start_ns,
        measured.profile,
        neighbours=(west, east, 0.75),
    )
    series, _ = with_changes(measured, field, between, [20.0])
    h = measured.truth.h[100:2901:147]
    t = measured.profile.temperature(h)
    assert series.profiles[0].temperature(h) == pytest.approx(t, abs=0.05)
