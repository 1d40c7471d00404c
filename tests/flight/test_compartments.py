"""A barometer in a closed compartment is told from one that fails, and from one outside."""

import numpy as np
import pytest

from tests.helpers import channel
from unbend.flight.compartments import (
    closed_compartments,
    longest_repetition,
)

SECONDS = np.arange(1200.0)
CLIMB = np.interp(
    SECONDS,
    [0.0, 400.0, 800.0, 1200.0],
    [0.0, 1.0, 1.0, 0.0],
)
RANDOM = np.random.default_rng(5)
NOISE_PA = RANDOM.normal(size=SECONDS.size)


def air_pa(height_m):
    return 101_325.0 * np.exp(-height_m / 8000.0)


def flight(top_m=3000.0):
    """The heights of a flight from 200 m, and its barometer outside."""
    height_m = 200.0 + (top_m - 200.0) * CLIMB
    height = channel(
        "GPS[0]",
        SECONDS,
        "height",
        h_msl_m=height_m,
    )
    outside = channel(
        "BARO[0]",
        SECONDS,
        "pressure",
        pressure_pa=air_pa(height_m) + 5.0 * NOISE_PA,
    )
    return height, outside


def cabin_pa(top_m=3000.0):
    """A cabin that climbs to 1200 m."""
    height_m = 200.0 + 1000.0 * CLIMB * (top_m - 200.0) / 2800.0
    return air_pa(height_m) + 5.0 * NOISE_PA[::-1]


def names_of(pressure_pa, top_m=3000.0, *, has_outside=True):
    height, outside = flight(top_m)
    second = channel(
        "BARO[1]",
        SECONDS,
        "pressure",
        pressure_pa=pressure_pa,
    )
    channels = [second]
    if has_outside:
        channels.insert(0, outside)
    compartments = closed_compartments(channels, height)
    return [compartment.barometer for compartment in compartments]


def test_a_cabin():
    assert names_of(cabin_pa()) == ["BARO[1]"]


def test_a_flight_below_the_height_of_cabins():
    assert names_of(cabin_pa(1900.0), 1900.0) == []


def test_without_a_barometer_that_follows_the_height_the_height_may_be_wrong():
    assert names_of(cabin_pa(), has_outside=False) == []


GROUND_PA = air_pa(200.0)
OUTSIDE_PA = flight()[1]["pressure_pa"]
STUCK_PA = np.where(
    SECONDS < 200.0,
    OUTSIDE_PA,
    OUTSIDE_PA[200],
)
HALF_CONSTANT_PA = np.where(
    SECONDS < 700.0,
    cabin_pa()[350],
    cabin_pa(),
)
FAILURES = {
    "constant": np.full(SECONDS.size, GROUND_PA),
    "noise": cabin_pa() + 2000.0 * NOISE_PA,
    "stuck on the way up": STUCK_PA,
    "stuck for most of the flight": HALF_CONSTANT_PA,
    "in another unit": cabin_pa() / 100.0,
    "too low": OUTSIDE_PA - 10_000.0 * CLIMB,
    "higher than the ground": cabin_pa() + 10_000.0,
    "outside, with 19 hPa of dynamic pressure": OUTSIDE_PA + 1900.0 * np.sin(SECONDS / 30.0),
    "missing": np.full(SECONDS.size, np.nan),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_barometer_that_fails_is_in_no_compartment(name):
    assert names_of(FAILURES[name]) == []


def test_a_few_damaged_samples_hide_no_cabin():
    damaged_pa = cabin_pa()
    damaged_pa[[100, 600]] = 3e5
    assert names_of(damaged_pa) == ["BARO[1]"]


def test_the_barometer_outside_is_in_no_compartment():
    assert names_of(OUTSIDE_PA + 300.0) == []


def test_heights_without_a_column_say_nothing():
    _, outside = flight()
    height = channel("GPS[0]", SECONDS, "height")
    assert list(closed_compartments([outside], height)) == []


@pytest.mark.parametrize(
    ("values", "longest"),
    [
        ([1.0], 1),
        ([1.0, 1.0], 2),
        ([1.0, 2.0, 2.0, 3.0, 3.0, 3.0], 3),
    ],
)
def test_longest_repetition(values, longest):
    assert longest_repetition(np.array(values)) == longest
