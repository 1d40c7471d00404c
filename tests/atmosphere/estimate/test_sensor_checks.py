"""Sensors that stand still, sit indoors, or contradict one another, in air known by construction.

The true air is a sounding, or straight lines, integrated in `flights`; what a sensor in a cabin or
a stuck one reads is written here.
"""

from __future__ import annotations

import copy
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.estimate.estimate_checks import (
    PASSED,
    hygrometer_is_outside,
    is_plausible,
)
from unbend.atmosphere.estimate.sensor_checks import maybe_in_a_bay, usable_sensors
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.thermometer_checks import thermometer_is_outside
from unbend.messages import Kind, Ledger

US1976 = standard_atmosphere("us1976")
ARCTIC, DESERT, MONSOON, TRADES, NIGHT = range(5)


@pytest.fixture(scope="module")
def airs(flights):
    return [flights.Truth(balloon) for balloon in flights.extremes()]


def background(truth):
    return climatology(
        latitude_rad=truth.latitude, month=month_of(truth.start_ns), ground_h_m=float(truth.h[0])
    )


def adjust(truth, samples):
    ledger = Ledger()
    found = build_adjusted_profile(
        samples, US1976, truth.latitude, ledger, background=background(truth)
    )
    return found, ledger


def losses(ledger):
    return [entry.code for entry in ledger if entry.kind is Kind.LOSS]


def sigmas(truth, adjusted, climb):
    """By how many of its sigmas R errs."""
    sigma = adjusted.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])
    return abs(truth.error(adjusted.profile, climb)) / sigma


def with_t(samples, value, **change):
    return replace(samples, temperature=replace(samples.temperature, value=value, **change))


def flown(flights, truth, climb, **how):
    return flights.fly(truth, climb, flights.Sensors(noise_k=0.2), np.random.default_rng(1), **how)


def seconds_of(samples):
    return (samples.temperature.time_ns - samples.temperature.time_ns[0]) * 1e-9


# Sensors that stand still


@pytest.mark.parametrize("climb", [400.0, 800.0, 1500.0, 3000.0])
@pytest.mark.parametrize("barometer", [True, False])
def test_a_thermometer_that_stands_still_is_not_used(flights, airs, climb, barometer):
    """PX4 tells 288.15 K where it has no sensor: +25 and +5 % of R over 400 and 1500 m."""
    for truth in (airs[TRADES], airs[NIGHT]):
        samples = flown(flights, truth, climb, descent=True, barometer=barometer)
        constant = with_t(samples, np.full(samples.temperature.value.size, 288.15))
        adjusted, ledger = adjust(truth, constant)
        (entry,) = [e for e in ledger if e.code == "AIR-STUCK"]
        assert (entry.kind, entry.where) == (Kind.LOSS, "thermometer")
        assert "288.15" in entry.what
        assert entry.count == int(samples.temperature.accepted.sum())
        assert adjusted.basis == ("barometer" if barometer else "climatology")
        assert sigmas(truth, adjusted, climb) < 2.0


def test_a_thermometer_that_freezes_leaves_what_it_read_before(flights, airs):
    truth = airs[TRADES]
    samples = flown(flights, truth, 3000.0, descent=True)
    t = samples.temperature
    frozen = seconds_of(samples) > 330.0  # at 1500 m
    stays = with_t(samples, np.where(frozen, t.value[frozen][0], t.value))
    adjusted, ledger = adjust(truth, stays)
    (entry,) = [e for e in ledger if e.code == "AIR-STUCK"]
    assert entry.count == int(frozen.sum())
    assert adjusted.basis == "both"
    assert adjusted.samples.temperature.extent_m == pytest.approx(900.0, abs=10.0)
    assert abs(truth.error(adjusted.profile, 3000.0)) < 0.03
    assert sigmas(truth, adjusted, 3000.0) < 2.0


def test_coarse_steps_and_level_flight_are_no_standstill(flights, airs):
    """A thermometer that tells whole degrees, in air that hardly changes with height."""
    truth = airs[NIGHT]
    samples = flown(flights, truth, 3000.0, descent=True)
    whole = with_t(samples, np.round(samples.temperature.value))
    ledger = Ledger()
    h = samples.temperature.h_m
    isothermal = np.round(275.0 - 1.5e-3 * (h - h.min()))  # 670 m for each degree
    for given in (samples, whole, with_t(samples, isothermal)):
        ledger.take(usable_sensors(replace(given, pressure=None), US1976))
    level = np.full(2000, 1500.0) + np.linspace(0.0, 250.0, 2000)
    stamps = np.arange(2000, dtype=np.int64) * 10**9
    same = SensorSamples(stamps, level, np.full(2000, 280.0), np.zeros(2000, np.uint8), "level")
    kept = ledger.take(usable_sensors(AirSamples(same), US1976))
    assert kept.temperature.accepted.all()
    assert list(ledger) == []


def test_humidity_may_stay_at_its_ends_but_not_between(flights, airs):
    truth = airs[MONSOON]
    samples = flown(flights, truth, 2000.0, humidity="profile", descent=True)
    for value, stuck in ((1.0, False), (0.0, False), (0.43, True)):
        same = replace(samples.humidity, value=np.full(samples.humidity.value.size, value))
        ledger = Ledger()
        kept = ledger.take(usable_sensors(replace(samples, humidity=same), US1976))
        assert (kept.humidity is None) is stuck
        assert losses(ledger) == (["AIR-STUCK"] if stuck else [])


@pytest.mark.parametrize("climb", [400.0, 1500.0])
def test_the_pressure_of_a_sealed_hull(flights, airs, climb):
    truth = airs[TRADES]
    samples = flown(flights, truth, climb, descent=True)
    p = samples.pressure
    noise = np.random.default_rng(3).normal(0.0, 3.0, p.value.size)
    for value in (np.full(p.value.size, truth.p[0]), truth.p[0] + noise):
        sealed = replace(samples, pressure=replace(p, value=value))
        adjusted, ledger = adjust(truth, sealed)
        assert losses(ledger) == ["AIR-NOT-OUTSIDE"]
        assert adjusted.basis == "thermometer"
        assert sigmas(truth, adjusted, climb) < 2.0


# A hygrometer that reads what no air holds


def stuck_wet(samples, value=1.0):
    humidity = samples.humidity
    return replace(samples, humidity=replace(humidity, value=np.full(humidity.value.size, value)))


@pytest.mark.parametrize("thermometer", [True, False])
def test_a_hygrometer_stuck_at_saturation_through_a_desert(flights, airs, thermometer):
    """A cloud 2.4 km deep whose temperature falls by 9.75 K/km."""
    truth = airs[DESERT]
    samples = flown(flights, truth, 3000.0, humidity="profile", thermometer=thermometer)
    adjusted, ledger = adjust(truth, stuck_wet(samples))
    (entry,) = [e for e in ledger if e.code == "AIR-HYGROMETER"]
    assert (entry.kind, entry.where) == (Kind.LOSS, "hygrometer")
    assert "97 % and more" in entry.what
    # Of saturated air at 309 K and 940 hPa 3.1, at 286 K and 700 hPa 4.3 K/km, worked by hand.
    limit = float(re.search(r"saturated air is unstable from ([\d.]+) K/km", entry.what)[1])
    assert limit == pytest.approx(3.7, abs=0.3)
    (use,) = [use for use in adjusted.sources if use.source == "hygrometer hygrometer"]
    assert "K/km" in use.why_not
    assert adjusted.basis == ("both" if thermometer else "barometer")
    assert adjusted.samples.humidity is None
    assert sigmas(truth, adjusted, 3000.0) < 2.5
    good, ledger = adjust(truth, samples)
    assert losses(ledger) == []
    assert good.samples.humidity is not None


@pytest.mark.parametrize("value", [-0.01, 0.0, 0.008])
def test_a_hygrometer_that_is_dead_or_in_fractions(flights, airs, value):
    samples = flown(flights, airs[DESERT], 800.0, gate_s=0.0)
    _, ledger = adjust(airs[DESERT], stuck_wet(samples, value))
    (entry,) = [e for e in ledger if e.code == "AIR-HYGROMETER"]
    assert f"its highest reading is {100 * value:.1f} % relative humidity" in entry.what


def test_a_dew_point_above_that_of_any_air(flights, airs):
    """Saturated at 315 K, on the ground of a desert; and 4 sigma too wet for an arctic winter."""
    samples = flown(flights, airs[DESERT], 800.0, gate_s=0.0)  # humidity of the lowest 200 m
    _, ledger = adjust(airs[DESERT], stuck_wet(samples))
    (entry,) = [e for e in ledger if e.code == "AIR-HYGROMETER"]
    assert float(re.search(r"dew point of ([\d.]+) C", entry.what)[1]) > 35.0
    assert "do not exceed 35.0 C" in entry.what
    made = estimate(stuck_wet(samples, 0.4), background(airs[DESERT]))
    assert hygrometer_is_outside(made, background(airs[DESERT])) == PASSED
    check = hygrometer_is_outside(made, background(airs[ARCTIC]))
    assert not check
    limit = float(re.search(r"do not exceed ([\d.-]+) C", check.reason)[1])
    # Expected -33 C, sigma of T 10.5 K and of RH 0.15 in 0.8: 10.8 K.
    assert limit == pytest.approx(-33.0 + 4.0 * 10.8, abs=6.0)


def test_real_clouds_keep_their_hygrometer(flights, airs):
    """Monsoon air of 5.5 K/km, saturated over 2 km and 3 % more."""
    truth = airs[MONSOON]
    samples = flown(flights, truth, 2000.0, humidity="profile", descent=True)
    for value in (1.0, 1.03):
        _, ledger = adjust(truth, stuck_wet(samples, value))
        assert losses(ledger) == []


# A thermometer against a barometer


def test_noise_about_a_room_temperature_over_three_kilometres(flights, airs):
    """Right in the mean: only its change with height gives it away."""
    truth = airs[NIGHT]
    samples = flown(flights, truth, 3000.0, descent=True)
    noise = np.random.default_rng(2).normal(0.0, 0.3, samples.temperature.value.size)
    mean = float(truth.t[300:3000].mean())
    adjusted, ledger = adjust(truth, with_t(samples, mean + noise))
    assert losses(ledger) == ["AIR-THERMOMETER"]
    assert "only partly in the air outside" in next(e.what for e in ledger)
    assert adjusted.basis == "barometer"
    assert sigmas(truth, adjusted, 3000.0) < 2.0


@pytest.mark.parametrize("air", [TRADES, NIGHT])
@pytest.mark.parametrize("climb", [600.0, 900.0])
def test_a_cabin_that_cools_during_a_short_climb(flights, airs, air, climb):
    """As a heated cabin does, 8 K above the ground: 24 and 14 % of R before, at 5 sigma."""
    truth = airs[air]
    samples = flown(flights, truth, climb, descent=True)
    since = seconds_of(samples)
    noise = np.random.default_rng(2).normal(0.0, 0.2, since.size)
    cabin = truth.t[0] + 12.0 - 6.0 * (1.0 - np.exp(-since / 400.0)) + noise
    adjusted, ledger = adjust(truth, with_t(samples, cabin))
    assert losses(ledger) == ["AIR-THERMOMETER"]
    assert adjusted.basis == "barometer"
    assert sigmas(truth, adjusted, climb) < 2.0


def test_readings_of_no_place_are_refused_beside_a_barometer(flights, airs):
    """Jumps of 3 K every minute: right in the mean and in both halves."""
    truth = airs[TRADES]
    samples = flown(flights, truth, 900.0, descent=True)
    t = samples.temperature
    jumps = np.where(seconds_of(samples) // 40.0 % 2.0 < 1.0, 3.0, -3.0)
    ledger = Ledger()
    wild = with_t(samples, t.value + jumps)
    assert ledger.take(usable_sensors(wild, US1976)).temperature is not None
    adjusted, ledger = adjust(truth, wild)
    assert losses(ledger) == ["AIR-THERMOMETER"]
    assert "within 30 minutes" in next(e.what for e in ledger)
    assert adjusted.basis == "barometer"
    assert sigmas(truth, adjusted, 900.0) < 2.0


def test_a_barometer_that_fits_air_of_its_own_outvotes_a_thermometer(flights, airs):
    """A wave of 6 K a kilometre long: each half agrees, and no two readings contradict."""
    truth = airs[TRADES]
    samples = flown(flights, truth, 3000.0)
    t = samples.temperature
    wave = 6.0 * np.sin(2.0 * np.pi * (t.h_m - truth.h[0]) / 1000.0)
    adjusted, ledger = adjust(truth, with_t(samples, t.value + wave))
    assert losses(ledger) == ["AIR-THERMOMETER"]
    (what,) = [e.what for e in ledger if e.code == "AIR-THERMOMETER"]
    assert "fits plausible air" in what or "fit physical air only" in what
    assert adjusted.basis == "barometer"
    assert sigmas(truth, adjusted, 3000.0) < 2.0


def test_only_a_barometer_can_refuse_a_thermometer(flights, airs):
    truth = airs[TRADES]
    samples = flown(flights, truth, 3000.0)
    t = samples.temperature
    wave = 6.0 * np.sin(2.0 * np.pi * (t.h_m - truth.h[0]) / 1000.0)
    wrong = with_t(samples, t.value + wave)
    air = background(truth)
    made = estimate(wrong, air)
    assert not thermometer_is_outside(wrong, made, air, None, SensorSettings())
    alone = replace(wrong, pressure=None)
    assert thermometer_is_outside(alone, made, air, None, SensorSettings())
    board = SensorSettings(board_temperature=True)
    assert thermometer_is_outside(wrong, made, air, None, board) == PASSED
    # A bent barometer fits no air of its own either: it is not believed against a thermometer.
    p = samples.pressure
    bent = replace(p, value=p.value * (1.0 + 0.004 * np.sin(p.h_m / 60.0)))
    spoilt = replace(samples, pressure=bent)
    assert thermometer_is_outside(spoilt, estimate(spoilt, air), air, None, SensorSettings())


def test_a_thermometer_that_reads_the_same_over_little_height_is_told_of(flights, airs):
    """In a bay whose air is for a third from outside."""
    truth = airs[NIGHT]
    rng = np.random.default_rng(2)
    samples = flights.fly(truth, 600.0, flights.drawn(rng), rng, humidity="none", rate=2.5)
    t = samples.temperature
    inside = with_t(samples, 294.0 - 0.3 * (294.0 - t.value))
    found, ledger = adjust(truth, inside)
    (entry,) = [e for e in ledger if e.code == "AIR-ISOTHERMAL"]
    assert entry.kind is Kind.WARNING
    assert 50.0 < entry.values["percent"] < 99.0
    assert sigmas(truth, found, 600.0) < 3.0
    _, ledger = adjust(truth, samples)
    assert "AIR-ISOTHERMAL" not in [e.code for e in ledger]
    # One that is stated to sit on a board needs no warning.
    made = estimate(inside, background(truth), settings=SensorSettings(board_temperature=True))
    assert maybe_in_a_bay(made, inside) == ()


@pytest.mark.parametrize("tau_s", [300.0, 900.0, 3000.0])
@pytest.mark.parametrize("warmer_k", [0.0, 6.0])
def test_a_cabin_that_follows_the_ground_of_a_clear_night(flights, airs, tau_s, warmer_k):
    """It changes with time, not with height: 4 to 6 sigma before, without a word."""
    truth = airs[NIGHT]
    rng = np.random.default_rng(7)
    samples = flights.fly(
        truth, 600.0, flights.drawn(rng), rng, humidity="none", descent=True, gate_s=60.0
    )
    t = samples.temperature
    outside = truth.at(truth.t, t.h_m - truth.h[0])
    keep = math.exp(-1.0 / tau_s)
    cabin = lfilter([1.0 - keep], [1.0, -keep], outside, zi=[keep * outside[0]])[0] + warmer_k
    found, ledger = adjust(truth, with_t(samples, cabin + rng.normal(0.0, 0.2, cabin.size)))
    assert losses(ledger) == ["AIR-THERMOMETER"]
    assert sigmas(truth, found, 600.0) < 1.5


def test_honest_thermometers_are_believed(flights, airs):
    """Drawn biases, transients, lags and drifts, in five extreme airs: none of 40 is refused."""
    rng = np.random.default_rng(12)
    for truth in airs:
        for climb in (700.0, 1500.0):
            for descent in (True, False):
                for _ in range(2):
                    sensors = flights.drawn(rng)
                    samples = flights.fly(truth, climb, sensors, rng, descent=descent)
                    _, ledger = adjust(truth, samples)
                    assert losses(ledger) == []


def test_a_refusal_states_what_is_seen_and_the_limit(flights, airs):
    """A probe 20 K too warm: beside the 8 K stands what barometer and GNSS leave open."""
    for climb in (1000.0, 400.0):
        samples = flown(flights, airs[TRADES], climb, descent=True)
        adjusted, ledger = adjust(airs[TRADES], with_t(samples, samples.temperature.value + 20.0))
        (entry,) = [e for e in ledger if e.code == "AIR-THERMOMETER"]
        assert entry.where == "thermometer"
        seen, limit = re.search(r"reads \+([\d.]+) K .* limit ([\d.]+) K", entry.what).groups()
        assert float(seen) == pytest.approx(20.0, abs=5.0)
        assert 8.0 < float(limit) < 12.0
        (use,) = [use for use in adjusted.sources if use.source == "thermometer thermometer"]
        assert f"limit {limit} K" in use.why_not


def test_ground_in_the_sun_is_air(flights, airs):
    """Superadiabatic in its lowest 100 m; the same lapse farther up overturns."""
    truth = airs[DESERT]
    for lowest, overturns in ((0.0, False), (300.0, True)):
        hot = copy.copy(truth)
        hot.t = truth.t + 6.0 * np.exp(-np.maximum(truth.h - truth.h[0] - lowest, 0.0) / 60.0)
        samples = flown(flights, hot, 2000.0, descent=True, gate_s=0.0)
        check = is_plausible(estimate(samples, background(truth)), background(truth))
        assert bool(check) is not overturns, check.reason
        assert not overturns or "air is unstable from 9.8 K/km" in check.reason


# Whether an estimate looks like air


def test_a_balloon_may_rise_above_the_climatology(flights, airs):
    truth = airs[NIGHT]
    air = background(truth)
    made = estimate(flown(flights, truth, 3000.0), air)
    higher = replace(made, readings=replace(made.readings, high=40_000.0, low=-9000.0))
    assert air.profile.top_m < 31_000.0
    with np.errstate(all="raise"):
        assert is_plausible(higher, air)
