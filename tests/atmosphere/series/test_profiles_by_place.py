"""The air along a long flight by a weather model, against air that is integrated at each place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.atmosphere.series.profiles_by_place import add_model_changes
from unbend.atmosphere.soundings.model_field import ModelField
from unbend.messages import Ledger

K_PER_KM = 0.05
TOP_M = 3000.0
EARTH_KM = 6371.0
LEVELS = 100.0 * np.array(
    [
        200.0,
        250,
        300,
        350,
        400,
        450,
        500,
        550,
        600,
        650,
        700,
        750,
        775,
        800,
        825,
        850,
        875,
        900,
        925,
        950,
        975,
        1000,
    ]
)


@pytest.fixture(scope="module")
def balloon(flights):
    (found,) = [b for b in flights.extremes() if b.name.startswith("trade")]
    return found


def air_at(flights, balloon, east_km: float, bias_k: float = 0.0):
    """The air of a place: 5 K warmer each 100 km to the east, at the same surface pressure."""
    return flights.Truth(replace(balloon, t=balloon.t + K_PER_KM * east_km + bias_k))


def east_rad(balloon, km):
    return np.asarray(km) / (EARTH_KM * np.cos(balloon.latitude))


@pytest.fixture(scope="module")
def field(flights, balloon):
    """A model of that air, 1.5 K too warm everywhere, with nodes 25 km apart, at two hours."""
    nodes = np.arange(-125.0, 126.0, 25.0)
    shape = (2, LEVELS.size, 2, nodes.size)
    t = np.empty(shape)
    q = np.empty(shape)
    height = np.empty(shape)
    for k, km in enumerate(nodes):
        truth = air_at(flights, balloon, km, bias_k=1.5)
        h = np.interp(-np.log(LEVELS), -np.log(truth.p), truth.h)
        e = np.interp(h, truth.h, truth.e)
        t[..., k] = np.interp(h, truth.h, truth.t)[:, None]
        q[..., k] = (0.622 * e / (LEVELS - 0.378 * e))[:, None]
        height[..., k] = flights.geopotential(balloon.latitude, h)[:, None]
    t[1] += 2.0  # it warms by 2 K in four hours
    hours = np.array([0, 4 * 3600], np.int64) * 10**9
    truth = air_at(flights, balloon, 0.0)
    return ModelField(
        "m.nc",
        truth.start_ns + hours,
        balloon.latitude + np.array([-0.01, 0.01]),
        east_rad(balloon, nodes),
        LEVELS,
        t,
        q,
        height,
    )


@pytest.fixture(scope="module")
def measured(flights, balloon):
    """What a flight measured that climbed at kilometre 0, with its profile."""
    truth = air_at(flights, balloon, 0.0)
    rng = np.random.default_rng(3)
    samples = flights.fly(truth, TOP_M, flights.Sensors(), rng, humidity="profile")
    background = climatology(latitude_rad=balloon.latitude, month=3)
    return build_adjusted_profile(
        samples, standard_atmosphere("us1976"), balloon.latitude, Ledger(), background=background
    ), truth


def at_places(measured, field, balloon, km, hours=0.0):
    made, truth = measured
    whole = TimedProfile(
        made.time_ns,
        made.profile,
        made.covariance,
        sampled_at=(balloon.latitude, 0.0, truth.start_ns),
    )
    km = np.atleast_1d(np.asarray(km, float))
    times = np.full(km.size, truth.start_ns) + np.int64(hours * 3.6e12)
    ground = float(truth.h[0])
    return add_model_changes(
        constant_series(whole, km.size),
        field,
        times,
        np.full(km.size, balloon.latitude),
        east_rad(balloon, km),
        h_c=[ground + TOP_M],
        h_g=ground,
        measured=True,
    )


def test_at_the_ends_of_200_km_the_error_falls_from_3_percent_below_04(
    flights, balloon, field, measured
):
    km = np.linspace(-100.0, 100.0, 81)
    series, (told,) = at_places(measured, field, balloon, km)
    assert told.code == "AIR-BY-PLACE"
    assert 60 < len(series.profiles) <= 81
    for end in (0, -1):
        truth = air_at(flights, balloon, float(km[end]))
        before = truth.error(measured[0].profile, TOP_M)
        air = series.timed_profiles[series.profile_number[end]]
        after = truth.error(air.profile, TOP_M)
        assert 0.022 < abs(before) < 0.04
        assert abs(after) < 0.004
        sigma = air.covariance.relative_sigma(truth.h[0] + TOP_M, truth.h[0])
        assert abs(after) < 2.0 * sigma < 0.04
        # Pressure and temperature at the camera too: what a station's columns show.
        h = truth.h[0] + 2990.0
        assert air.profile.pressure(h) == pytest.approx(np.interp(h, truth.h, truth.p), rel=1e-3)


def test_sigma_grows_from_where_the_air_was_measured(measured, field, balloon):
    series, _ = at_places(measured, field, balloon, [0.0, 50.0, 100.0])
    ground = float(measured[1].h[0])
    sigmas = [
        air.covariance.relative_sigma(ground + TOP_M, ground)
        for air in (series.timed_profiles[i] for i in series.profile_number)
    ]
    own = measured[0].covariance.relative_sigma(ground + TOP_M, ground)
    assert own < sigmas[0] < sigmas[1] < sigmas[2] < 0.02


def test_it_changes_with_time_as_the_model_does(flights, balloon, field, measured):
    series, _ = at_places(measured, field, balloon, [0.0, 1.0], hours=4.0)
    truth = flights.Truth(replace(balloon, t=balloon.t + 2.0))
    h = np.linspace(100.0, 2900.0, 20) + truth.h[0]
    off = series.profiles[0].temperature(h) - np.interp(h, truth.h, truth.t)
    np.testing.assert_allclose(off, 0.0, atol=1.7)  # an inversion of 6 K is a little rounded
    assert np.sqrt(np.mean(off**2)) < 0.6
    assert abs(np.mean(series.profiles[0].temperature(h) - np.interp(h, truth.h, truth.t))) < 0.2


def test_a_short_flight_keeps_one_profile(measured, field, balloon):
    series, notes = at_places(measured, field, balloon, np.linspace(0.0, 20.0, 5), hours=1.5)
    assert not notes
    assert series.profiles == (measured[0].profile,)


def test_exposures_without_a_place_keep_the_air_of_the_flight(measured, field, balloon):
    series, _ = at_places(measured, field, balloon, [-50.0, np.nan, 50.0])
    assert series.profiles[series.profile_number[1]] is measured[0].profile
    assert series.timed_profiles[series.profile_number[0]].profile is not measured[0].profile


def test_between_two_windows_both_places_count(measured, field, balloon):
    made, truth = measured
    nodes = [
        TimedProfile(
            truth.start_ns + k,
            made.profile,
            made.covariance,
            sampled_at=(balloon.latitude, float(east_rad(balloon, km)), truth.start_ns),
        )
        for k, km in ((0, -40.0), (1, 40.0))
    ]
    between = TimedProfile(truth.start_ns, made.profile, neighbours=(*nodes, 0.75))
    ground = float(truth.h[0])
    series, _ = add_model_changes(
        constant_series(between, 1),
        field,
        np.array([truth.start_ns]),
        np.array([balloon.latitude]),
        east_rad(balloon, [20.0]),
        h_c=[ground + TOP_M],
        h_g=ground,
        measured=True,
    )
    # 0.25 * -40 + 0.75 * 40 = 20 km: nothing changes there.
    h = np.linspace(100.0, 2900.0, 20) + ground
    np.testing.assert_allclose(
        series.profiles[0].temperature(h), made.profile.temperature(h), atol=0.05
    )
