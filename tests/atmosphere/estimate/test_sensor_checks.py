"""Sensors that stand still, sit indoors, or contradict one another, in air known by construction.

The true air is made of straight lines, integrated in `flights`; what a sensor in a cabin or a stuck
one reads is written here.
"""

import copy
import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.random import default_rng

from tests.atmosphere import adjusting, flights
from tests.atmosphere.adjusting import (
    NIGHT,
    QUIET,
    TRADES,
    US1976,
    adjust,
    codes,
    drawn_flight,
    expected_air,
    extreme,
    seconds_of,
    warmer,
    with_readings,
)
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.estimate_checks import (
    PASSED,
    hygrometer_is_outside,
    is_plausible,
)
from unbend.atmosphere.estimate.sensor_checks import maybe_in_a_bay, usable_sensors
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.thermometer_checks import thermometer_is_outside
from unbend.messages import Kind

IN_THE_AIR = SensorSettings()
ON_A_BOARD = SensorSettings(board_temperature=True)


flown = partial(adjusting.flown, sensors=QUIET)


def noise(samples, sigma):
    return default_rng(2).normal(
        0.0,
        sigma,
        samples.pressure.value.size,
    )


def reading_always(samples, value, sensor):
    count = getattr(samples, sensor).value.size
    return with_readings(samples, np.full(count, value), sensor)


def number_in(text, pattern):
    return float(re.search(pattern, text)[1])


# Sensors that stand still


@pytest.mark.parametrize("place", [TRADES, NIGHT])
@pytest.mark.parametrize("climb", [400.0, 3000.0])
@pytest.mark.parametrize(
    ("barometer", "basis"),
    [
        (True, "barometer"),
        (False, "climatology"),
    ],
)
def test_a_thermometer_that_stands_still_is_not_used(place, climb, barometer, basis):
    """PX4 tells 288.15 K where it has no sensor: +25 and +5 % of R over 400 and 1500 m."""
    truth = extreme(place)
    samples = flown(truth, climb, descent=True, barometer=barometer)
    stuck_samples = reading_always(samples, 288.15, "temperature")

    adjusted = adjust(truth, stuck_samples)

    stuck = adjusted.entry("AIR-STUCK", Kind.LOSS)
    assert stuck.where == "thermometer"
    assert "288.15" in stuck.what
    assert stuck.count == samples.temperature.accepted.sum()
    assert adjusted.basis == basis
    assert adjusted.departure(climb) < 2.0


def test_a_thermometer_that_freezes_leaves_what_it_read_before(trades):
    samples = flown(trades, 3000.0, descent=True)
    t = samples.temperature.value.copy()
    frozen = seconds_of(samples) > 330.0  # at 1500 m
    t[frozen] = t[frozen][0]
    adjusted = adjust(trades, with_readings(samples, t))
    assert adjusted.entry("AIR-STUCK").count == frozen.sum()
    assert adjusted.basis == "both"
    assert adjusted.made.samples.temperature.extent_m == pytest.approx(900.0, abs=10.0)
    assert abs(adjusted.error(3000.0)) < 0.03
    assert adjusted.departure(3000.0) < 2.0


def test_coarse_steps_and_level_flight_are_no_standstill(night):
    """A thermometer that tells whole degrees, in air that hardly changes with height."""
    samples = replace(flown(night, 3000.0, descent=True), pressure=None)
    t = samples.temperature
    isothermal = 275.0 - 1.5e-3 * (t.h_m - t.h_m.min())  # 670 m for each degree
    level = SensorSamples(
        np.arange(2000) * 10**9,
        np.linspace(1500.0, 1750.0, 2000),
        np.full(2000, 280.0),
    )
    for moving in (
        samples,
        with_readings(samples, np.round(t.value)),
        with_readings(samples, np.round(isothermal)),
        AirSamples(level),
    ):
        usable, notes = usable_sensors(moving, US1976)
        assert usable.temperature.accepted.sum() == moving.temperature.accepted.sum()
        assert not notes


@pytest.mark.parametrize(
    ("value", "losses"),
    [
        (1.0, []),
        (0.0, []),
        (0.43, ["AIR-STUCK"]),
    ],
)
def test_humidity_may_stay_at_its_ends_but_not_between(monsoon, value, losses):
    samples = flown(monsoon, 2000.0, humidity="profile", descent=True)
    usable, notes = usable_sensors(reading_always(samples, value, "humidity"), US1976)
    assert (usable.humidity is None) == bool(losses)
    assert codes(notes, Kind.LOSS) == losses


@pytest.mark.parametrize("climb", [400.0, 1500.0])
@pytest.mark.parametrize("noise_pa", [0.0, 3.0])
def test_the_pressure_of_a_sealed_hull(trades, climb, noise_pa):
    samples = flown(trades, climb, descent=True)
    sealed = trades.p0 + noise(samples, noise_pa)
    adjusted = adjust(trades, with_readings(samples, sealed, "pressure"))
    assert adjusted.losses == ["AIR-NOT-OUTSIDE"]
    assert adjusted.basis == "thermometer"
    assert adjusted.departure(climb) < 2.0


# A hygrometer that reads what no air holds


@pytest.mark.parametrize(
    ("thermometer", "basis"),
    [
        (True, "both"),
        (False, "barometer"),
    ],
)
def test_a_hygrometer_stuck_at_saturation_through_a_desert(desert, thermometer, basis):
    """A cloud 2.4 km deep whose temperature falls by 9.75 K/km."""
    samples = flown(desert, 3000.0, humidity="profile", thermometer=thermometer)
    adjusted = adjust(desert, reading_always(samples, 1.0, "humidity"))
    refused = adjusted.entry("AIR-HYGROMETER", Kind.LOSS)
    assert refused.where == "hygrometer"
    assert "97 % and more" in refused.what
    # Of saturated air at 309 K and 940 hPa 3.1, at 286 K and 700 hPa 4.3 K/km, worked by hand.
    limit = number_in(refused.what, r"saturated air is unstable from ([\d.]+) K/km")
    assert limit == pytest.approx(3.7, abs=0.3)
    assert "K/km" in adjusted.why_not("hygrometer hygrometer")
    assert adjusted.basis == basis
    assert adjusted.made.samples.humidity is None
    assert adjusted.departure(3000.0) < 2.5
    good = adjust(desert, samples)
    assert good.losses == []
    assert good.made.samples.humidity is not None


@pytest.mark.parametrize("value", [-0.01, 0.0, 0.008])
def test_a_hygrometer_that_is_dead_or_in_fractions(desert, value):
    samples = flown(desert, 800.0, gate_s=0.0)
    adjusted = adjust(desert, reading_always(samples, value, "humidity"))
    text = adjusted.entry("AIR-HYGROMETER").what
    assert f"its highest reading is {100 * value:.1f} % relative humidity" in text


def test_a_dew_point_above_that_of_any_air(arctic, desert):
    """Saturated at 315 K, on the ground of a desert; and 4 sigma too wet for an arctic winter."""
    samples = flown(desert, 800.0, gate_s=0.0)  # humidity of the lowest 200 m
    saturated = reading_always(samples, 1.0, "humidity")
    text = adjust(desert, saturated).entry("AIR-HYGROMETER").what
    assert number_in(text, r"dew point of ([\d.]+) C") > 35.0
    assert "do not exceed 35.0 C" in text

    air = expected_air(desert)
    made = estimate(reading_always(samples, 0.4, "humidity"), air)
    assert hygrometer_is_outside(made, air) == PASSED
    check = hygrometer_is_outside(made, expected_air(arctic))
    assert not check
    limit = number_in(check.reason, r"do not exceed ([\d.-]+) C")
    # Expected -33 C, sigma of T 10.5 K and of RH 0.15 in 0.8: 10.8 K.
    assert limit == pytest.approx(-33.0 + 4.0 * 10.8, abs=6.0)


@pytest.mark.parametrize("value", [1.0, 1.03])
def test_real_clouds_keep_their_hygrometer(monsoon, value):
    """Monsoon air of 5.5 K/km, saturated over 2 km and 3 % more."""
    samples = flown(monsoon, 2000.0, humidity="profile", descent=True)
    cloud = reading_always(samples, value, "humidity")
    assert adjust(monsoon, cloud).losses == []


# A thermometer against a barometer


def check_refused(truth, samples, climb, most_sigmas=2.0):
    """The barometer is used without the thermometer; the text of its refusal."""
    adjusted = adjust(truth, samples)
    assert adjusted.losses == ["AIR-THERMOMETER"]
    assert adjusted.basis == "barometer"
    assert adjusted.departure(climb) < most_sigmas
    return adjusted.entry("AIR-THERMOMETER").what


def test_noise_about_a_room_temperature_over_three_kilometres(night):
    """Right in the mean: only its change with height gives it away."""
    samples = flown(night, 3000.0, descent=True)
    room = night.t[300:3000].mean() + noise(samples, 0.3)
    text = check_refused(night, with_readings(samples, room), 3000.0)
    assert "only partly in the air outside" in text


@pytest.mark.parametrize("place", [TRADES, NIGHT])
@pytest.mark.parametrize("climb", [600.0, 900.0])
def test_a_cabin_that_cools_during_a_short_climb(place, climb):
    """As a heated cabin does, 8 K above the ground: 24 and 14 % of R before, at 5 sigma."""
    truth = extreme(place)
    samples = flown(truth, climb, descent=True)
    cooled = 6.0 * (1.0 - np.exp(-seconds_of(samples) / 400.0))
    cabin = truth.t[0] + 12.0 - cooled + noise(samples, 0.2)
    check_refused(truth, with_readings(samples, cabin), climb)


def test_readings_of_no_place_are_refused_beside_a_barometer(trades):
    """Jumps of 3 K every minute: right in the mean and in both halves."""
    samples = flown(trades, 900.0, descent=True)
    jumps = np.where(
        seconds_of(samples) // 40.0 % 2.0 < 1.0,
        3.0,
        -3.0,
    )
    wild = warmer(samples, jumps)
    usable, _ = usable_sensors(wild, US1976)
    assert usable.temperature is not None
    assert "within 30 minutes" in check_refused(trades, wild, 900.0)


def with_a_wave(truth, samples):
    """6 K, a kilometre long: each half agrees, and no two readings contradict."""
    above = samples.temperature.h_m - truth.ground_m
    return warmer(samples, 6.0 * np.sin(2.0 * np.pi * above / 1000.0))


def test_a_barometer_that_fits_air_of_its_own_outvotes_a_thermometer(trades):
    text = check_refused(
        trades,
        with_a_wave(trades, flown(trades, 3000.0)),
        3000.0,
    )
    assert "fits plausible air" in text or "fit physical air only" in text


def test_only_a_barometer_can_refuse_a_thermometer(trades):
    air = expected_air(trades)
    samples = flown(trades, 3000.0)
    wrong = with_a_wave(trades, samples)
    made = estimate(wrong, air)

    def is_outside(readings, made=made, settings=IN_THE_AIR):
        return thermometer_is_outside(readings, made, air, None, settings)

    assert not is_outside(wrong)
    assert is_outside(replace(wrong, pressure=None))
    assert is_outside(wrong, settings=ON_A_BOARD) == PASSED
    # A bent barometer fits no air of its own either: it is not believed against a thermometer.
    p = samples.pressure
    bent_pa = p.value * (1.0 + 0.004 * np.sin(p.h_m / 60.0))
    bent = with_readings(samples, bent_pa, "pressure")
    assert is_outside(bent, estimate(bent, air))


def test_a_thermometer_that_reads_the_same_over_little_height_is_told_of(night):
    """In a bay whose air is for a third from outside."""
    samples = drawn_flight(night, 600.0, 2, humidity="none", rate=2.5)
    t = 294.0 - 0.3 * (294.0 - samples.temperature.value)
    inside = with_readings(samples, t)
    adjusted = adjust(night, inside)
    message = adjusted.entry("AIR-ISOTHERMAL", Kind.WARNING)
    assert 50.0 < message.values["percent"] < 99.0
    assert adjusted.departure(600.0) < 3.0
    assert "AIR-ISOTHERMAL" not in adjust(night, samples).codes()
    # One that is stated to sit on a board needs no warning.
    made = estimate(inside, expected_air(night), settings=ON_A_BOARD)
    assert maybe_in_a_bay(made, inside) == ()


@pytest.mark.parametrize("tau_s", [300.0, 3000.0])
@pytest.mark.parametrize("warmer_k", [0.0, 6.0])
def test_a_cabin_that_follows_the_ground_of_a_clear_night(night, tau_s, warmer_k):
    """It changes with time, not with height: 4 to 6 sigma before, without a word."""
    samples = drawn_flight(
        night,
        600.0,
        7,
        humidity="none",
        descent=True,
        gate_s=60.0,
    )
    outside = night.at_height(night.t, samples.temperature.h_m - night.ground_m)
    cabin = flights.lagging(outside, keep=math.exp(-1.0 / tau_s))
    cabin += warmer_k + noise(samples, 0.2)
    check_refused(night, with_readings(samples, cabin), 600.0, most_sigmas=1.5)


@pytest.mark.parametrize("climb", [1000.0, 400.0])
def test_a_refusal_states_what_is_seen_and_the_limit(trades, climb):
    """A probe 20 K too warm: beside the 8 K stands what barometer and GNSS leave open."""
    samples = flown(trades, climb, descent=True)
    adjusted = adjust(trades, warmer(samples, 20.0))
    refused = adjusted.entry("AIR-THERMOMETER")
    assert refused.where == "thermometer"
    difference_k = number_in(refused.what, r"reads \+([\d.]+) K")
    assert difference_k == pytest.approx(20.0, abs=5.0)
    limit = number_in(refused.what, r"limit ([\d.]+) K")
    assert 8.0 < limit < 12.0
    assert f"limit {limit:.1f} K" in adjusted.why_not("thermometer thermometer")


# Whether an estimate looks like air


@pytest.mark.parametrize(
    ("lowest", "overturns"),
    [
        (0.0, False),
        (300.0, True),
    ],
)
def test_ground_in_the_sun_is_air(desert, lowest, overturns):
    """Superadiabatic in its lowest 100 m; the same lapse farther up overturns."""
    air = expected_air(desert)
    hot = copy.copy(desert)
    above = np.maximum(desert.h - desert.ground_m - lowest, 0.0)
    hot.t = desert.t + 6.0 * np.exp(-above / 60.0)
    samples = flown(hot, 2000.0, descent=True, gate_s=0.0)
    check = is_plausible(estimate(samples, air), air)
    assert bool(check) is not overturns
    assert ("air is unstable from 9.8 K/km" in check.reason) is overturns
