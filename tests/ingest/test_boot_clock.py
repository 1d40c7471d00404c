"""UTC from the time since boot: which boot, which receiver, and what does not fit."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import with_code
from unbend.ingest.boot_clock import BootClock, fit_clock
from unbend.ingest.timelines import timeline
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger

SECOND = 10**9
UTC = 1_700_000_000 * SECOND
ALL = slice(None)


class Vehicle:
    """Records every 0.2 s of boots that are (first time since boot, UTC of it, seconds long)."""

    def __init__(self, *boots: tuple[float, float, float]):
        since_boot = []
        utc = []
        numbers = []
        for number, (first_s, utc_s, length_s) in enumerate(boots):
            run = np.arange(0.0, length_s, 0.2)
            since_boot.append(first_s + run)
            utc.append(utc_s + run)
            numbers.append(np.full(run.size, number))
        self.boot_ns = np.round(np.concatenate(since_boot) * SECOND).astype(np.int64)
        self.utc_ns = UTC + np.round(np.concatenate(utc) * SECOND).astype(np.int64)
        self.boot = np.concatenate(numbers)
        self.places = 10 * np.arange(self.boot_ns.size)

    def readings(self, rows=ALL, late_s=0.0, **more):
        """What a receiver with these rows says."""
        utc_ns = self.utc_ns[rows] + round(late_s * SECOND)
        good = np.ones(utc_ns.shape, np.bool_)
        return UtcReadings(
            "rows",
            self.places[rows],
            self.boot_ns[rows],
            utc_ns,
            good,
            **more,
        )

    def fit(self, *readings, **more) -> tuple[BootClock, Ledger]:
        ledger = Ledger()
        line = timeline([(self.places, self.boot_ns)])
        return fit_clock(line, readings, ledger, **more), ledger

    def largest_error_s(self, clock):
        errors_ns = clock.utc(self.places, self.boot_ns) - self.utc_ns
        return np.abs(errors_ns).max() / SECOND

    def is_split_right(self, clock):
        return np.array_equal(
            clock.line.boot_of(self.places),
            self.boot,
        )


def codes(ledger, kind):
    return [entry.code for entry in ledger if entry.kind == kind]


@pytest.mark.parametrize(
    "first_s",
    [2.0, 30.0, 300.0],
)
@pytest.mark.parametrize(
    "later_s",
    [3.0, 20.0, 500.0],
)
def test_a_boot_whose_time_is_later(first_s, later_s):
    """The link is down while the vehicle restarts, and comes back when its time is later."""
    vehicle = Vehicle(
        (10.0, 0.0, first_s),
        (10.0 + first_s + later_s, 3600.0, 600.0),
    )
    clock, ledger = vehicle.fit(vehicle.readings())
    assert vehicle.is_split_right(clock)
    assert vehicle.largest_error_s(clock) == 0.0
    assert codes(ledger, "warning") == ["TIME-REBOOT"]
    assert codes(ledger, "loss") == []


def test_the_boot_begins_at_the_silence_and_not_at_the_first_fix():
    vehicle = Vehicle(
        (10.0, 0.0, 60.0),
        (90.0, 3600.0, 600.0),
    )
    rows = np.flatnonzero((vehicle.boot == 0) | (vehicle.boot_ns > 200 * SECOND))
    clock, _ = vehicle.fit(vehicle.readings(rows))
    assert vehicle.is_split_right(clock)


def test_a_silence_alone_is_no_boot():
    vehicle = Vehicle(
        (10.0, 0.0, 60.0),
        (698.0, 688.5, 60.0),
    )  # half a second of drift
    clock, ledger = vehicle.fit(vehicle.readings())
    assert clock.line.boots == 1
    assert codes(ledger, "warning") == []


@pytest.mark.parametrize(
    "wrong",
    [[0], [299], [150], [150, 151, 152, 153], [0, 299, 150]],
)
def test_a_few_wrong_rows_are_no_boot_even_at_a_silence(wrong):
    vehicle = Vehicle(
        (10.0, 0.0, 30.0),
        (50.0, 40.0, 30.0),
    )
    readings = vehicle.readings()
    readings.utc_ns[wrong] += 3600 * SECOND
    clock, ledger = vehicle.fit(readings)
    assert clock.line.boots == 1
    assert vehicle.largest_error_s(clock) == 0.0
    assert codes(ledger, "loss") == []
    assert "3600000 ms" in next(iter(ledger)).what


def test_a_receiver_that_is_set_late_is_no_boot_but_a_loss():
    """The time since boot runs on: nobody restarted. One row in twenty is not in p5 to p95."""
    vehicle = Vehicle((10.0, 0.0, 600.0))
    readings = vehicle.readings()
    readings.utc_ns[:100] -= 2 * SECOND  # leap seconds that the receiver did not know yet
    clock, ledger = vehicle.fit(readings)
    assert clock.line.boots == 1
    assert vehicle.largest_error_s(clock) == 0.0
    assert codes(ledger, "loss") == ["TIME-FIT"]


@pytest.mark.parametrize(("stepped_s", "sigma_s"), [(0.0, 5.0), (2.0, 5.0), (30.0, 30.0)])
def test_a_clock_without_a_receiver_that_was_set_is_as_good_as_its_step(stepped_s, sigma_s):
    """A recorder's, or that of an autopilot without a fix."""
    vehicle = Vehicle((10.0, 0.0, 600.0))
    readings = vehicle.readings(sigma_s=5.0)
    readings.utc_ns[2000:] += round(stepped_s * SECOND)
    by_recorder, _ = vehicle.fit(recorder=readings)
    by_autopilot, _ = vehicle.fit(readings)
    assert by_recorder.sigma_s == by_autopilot.sigma_s == sigma_s


def test_the_receiver_with_the_most_rows_decides_and_the_other_is_a_loss():
    vehicle = Vehicle((10.0, 0.0, 40.0))
    a_day_early = vehicle.readings([7], late_s=-86_400.0)
    clock, ledger = vehicle.fit(
        a_day_early,
        vehicle.readings(slice(2, 190)),
    )
    assert vehicle.largest_error_s(clock) == 0.0
    assert codes(ledger, "loss") == ["TIME-SOURCES"]
    assert "-86400.000 s" in with_code(ledger, "TIME-SOURCES")[0].what


def test_a_second_receiver_serves_where_the_first_has_no_row():
    vehicle = Vehicle(
        (10.0, 0.0, 40.0),
        (5.0, 3600.0, 40.0),
    )
    clock, _ = vehicle.fit(
        vehicle.readings(slice(0, 190)),
        vehicle.readings(slice(200, 250)),
    )
    assert clock.utc_known == (True, True)
    assert vehicle.largest_error_s(clock) == 0.0


def test_the_recorder_cuts_and_sets_boots_without_utc():
    vehicle = Vehicle(
        (10.0, 0.0, 60.0),
        (90.0, 3600.0, 600.0),
    )
    recorder = vehicle.readings()
    recorder.utc_ns[:] += np.random.default_rng(3).integers(0, 300_000_000, vehicle.places.size)
    clock, _ = vehicle.fit(recorder=recorder)
    assert vehicle.is_split_right(clock)
    assert clock.utc_known == (False, False)
    assert vehicle.largest_error_s(clock) < 0.3


def test_a_recorder_whose_clock_is_set_does_not_overrule_utc():
    vehicle = Vehicle(
        (10.0, 0.0, 60.0),
        (90.0, 80.0, 600.0),
    )
    recorder = vehicle.readings()
    recorder.utc_ns[vehicle.boot == 1] += 900 * SECOND
    clock, _ = vehicle.fit(
        vehicle.readings(slice(None, None, 5)),
        recorder=recorder,
    )
    assert clock.line.boots == 1


def test_stray_stamps_are_in_no_fit():
    vehicle = Vehicle((10.0, 0.0, 40.0))
    vehicle.boot_ns[20:24] += 1 << 45
    clock, _ = vehicle.fit(vehicle.readings())
    assert not clock.line.good(vehicle.places)[20:24].any()
    (fit,) = clock.fits
    assert fit is not None
    assert fit.rows == 196
    assert fit.largest_ns == 0


def test_repeated_times_of_a_slow_receiver_are_in_no_fit():
    """Each second row is 0.2 s late: the median of all would be 0.1 s off."""
    vehicle = Vehicle((10.0, 0.0, 40.0))
    readings = vehicle.readings()
    readings.utc_ns[1::2] = readings.utc_ns[::2]
    clock, _ = vehicle.fit(readings)
    assert vehicle.largest_error_s(clock) == 0.0


def test_blocks_of_stamps_are_one_line():
    vehicle = Vehicle(
        (10.0, 0.0, 40.0),
        (5.0, 100.0, 40.0),
        (60.0, 200.0, 9.0),
    )
    whole = timeline([(vehicle.places, vehicle.boot_ns)])
    edges = [0, 1, 2, 150, 199, 200, 201, 400, vehicle.places.size]
    blocks = []
    for begin, end in pairwise(edges):
        blocks.append((vehicle.places[begin:end], vehicle.boot_ns[begin:end]))
    pieces = timeline(blocks)
    for name, column in vars(whole).items():
        assert_array_equal(vars(pieces)[name], column)
    assert whole.boots == 2


def test_small_steps_back_are_no_boot_and_large_ones_are():
    """A logger writes records up to some ms out of order."""
    steady = np.arange(10.0, 15.0, 0.5)
    seconds = np.concatenate([steady, [14.1], steady + 5.0, steady - 7.0])
    line = timeline([(np.arange(31), (seconds * SECOND).astype(np.int64))])
    assert_array_equal(
        line.boot_of(np.arange(31)),
        [0] * 21 + [1] * 10,
    )


def test_a_line_without_stamps_is_one_boot():
    empty = timeline([])
    assert empty.boots == 1
    assert empty.boot_of(np.arange(2)).tolist() == [0, 0]
