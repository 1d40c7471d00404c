"""Sensors that read whole hectopascals or kelvins: their last digit is part of their noise."""

import numpy as np
import pytest

from tests.atmosphere import flights
from tests.atmosphere.adjusting import (
    ARCTIC,
    DESERT,
    MONSOON,
    NIGHT,
    TRADES,
    adjust,
    drawn_flight,
    extreme,
    with_readings,
)
from unbend.atmosphere.air_samples import SensorSamples
from unbend.atmosphere.estimate.binning import Digits, bin_readings, resolution_of

RISING = np.linspace(100_000.0, 90_000.0, 600)
WHOLE = 100.0 * np.round(RISING / 100.0)
LEVEL = np.zeros(200)
STAIRS = 100.0 * (np.arange(200) // 20)
WAVERING = np.where(np.arange(200) % 50 == 0, 100.0, 0.0)


@pytest.mark.parametrize(
    ("readings", "step"),
    [
        (WHOLE, 100.0),
        (np.round(RISING / 100.0) * 0.01 * 1e4, pytest.approx(100.0)),
        (RISING + np.random.default_rng(1).normal(0.0, 5.0, 600), 0.0),
        (np.full(600, 9e4), 0.0),
    ],
    ids=["whole", "as hectopascals", "fine", "constant"],
)
def test_the_step_of_a_sensor_is_seen_in_its_readings(readings, step):
    sensor = SensorSamples(np.arange(600) * 10**9, np.zeros(600), readings)
    assert resolution_of(sensor) == step


@pytest.mark.parametrize(
    ("binned", "readings", "low", "high"),
    [
        (LEVEL, LEVEL, 28.0, 31.0),
        (LEVEL, STAIRS, 2.8, 5.0),
        (WAVERING, WAVERING, 0.0, 31.0),
    ],
    ids=["level", "stairs", "wavering"],
)
def test_the_last_digit_does_not_average_in_level_flight_but_over_different_readings(
    binned, readings, low, high
):
    """One of 100 / sqrt(12) = 29 in all readings that are the same; 200 of them are no better."""
    bins = bin_readings(
        np.arange(200.0),
        np.full(200, 500.0),
        binned,
        np.ones(200, bool),
        width=1000.0,
        slice_s=1e6,
        floor=1.0,
        digits=Digits(readings, 100.0),
    )
    assert low < bins.sigma[0] < high
    # A step of one digit is no outlier.
    assert not bins.rejected.any()


@pytest.mark.parametrize("climb", [1000.0, 2000.0])
@pytest.mark.parametrize(
    ("place", "thermometer", "most_sigmas"),
    [
        (ARCTIC, True, 3.0),
        (DESERT, False, 3.0),
        (MONSOON, True, 3.0),
        (TRADES, False, 3.5),
        (NIGHT, False, 3.0),
    ],
)
def test_a_barometer_of_whole_hectopascals_is_in_the_sigma(place, thermometer, most_sigmas, climb):
    """Alone and beside a thermometer; one erred by 4.4 sigma with exit 0.

    The trade wind's inversion, 6 K in 250 m, is beyond what any barometer alone resolves: over
    2 km one without digits errs by 2.4 sigma, this one by 3.2; the others stay within 3.
    """
    truth = extreme(place)
    how = {"thermometer": thermometer, "humidity": "none", "rate": 3.0}
    samples = drawn_flight(truth, climb, place, flights.surveyed, **how)
    whole = 100.0 * np.round(samples.pressure.value / 100.0)
    adjusted = adjust(truth, with_readings(samples, whole, "pressure"))
    assert not adjusted.is_told
    assert adjusted.departure(climb) < most_sigmas
