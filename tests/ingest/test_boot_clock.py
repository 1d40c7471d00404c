"""UTC from the time since boot: which boot, which receiver, and what does not fit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from unbend.ingest.boot_clock import BootClock, fit_clock
from unbend.ingest.timelines import timeline
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger

SECOND = 10**9
UTC = 1_700_000_000 * SECOND


class Vehicle:
    """Records every 0.2 s of boots that are (first time since boot, UTC of it, seconds long)."""

    def __init__(self, *boots: tuple[float, float, float]) -> None:
        since = []
        utc = []
        number = []
        for k, (begin, at, length) in enumerate(boots):
            run = np.arange(0.0, length, 0.2)
            since.append(begin + run)
            utc.append(at + run)
            number.append(np.full(run.size, k))
        self.boot_ns = np.round(np.concatenate(since) * SECOND).astype(np.int64)
        self.utc_ns = UTC + np.round(np.concatenate(utc) * SECOND).astype(np.int64)
        self.boot = np.concatenate(number)
        self.places = 10 * np.arange(self.boot_ns.size)

    def told(self, rows: object = slice(None), late_s: float = 0.0, **more: object) -> UtcReadings:
        utc_ns = self.utc_ns[rows] + round(late_s * SECOND)
        good = np.ones(utc_ns.shape, np.bool_)
        return UtcReadings("rows", self.places[rows], self.boot_ns[rows], utc_ns, good, **more)

    def fit(self, *told: UtcReadings, **more: object) -> tuple[BootClock, Ledger]:
        ledger = Ledger()
        line = timeline([(self.places, self.boot_ns)])
        return fit_clock(line, told, ledger, **more), ledger

    def errors_s(self, clock: BootClock) -> np.ndarray:
        return (clock.utc(self.places, self.boot_ns) - self.utc_ns) / SECOND


def codes(ledger: Ledger, kind: str) -> list[str]:
    return [entry.code for entry in ledger if entry.kind == kind]


@pytest.mark.parametrize("first_s", [2.0, 30.0, 300.0])
@pytest.mark.parametrize("later_s", [3.0, 20.0, 500.0])
def test_a_boot_whose_time_is_later(first_s, later_s):
    """The link is down while the vehicle restarts, and comes back when its time is later."""
    vehicle = Vehicle((10.0, 0.0, first_s), (10.0 + first_s + later_s, 3600.0, 600.0))
    clock, ledger = vehicle.fit(vehicle.told())
    np.testing.assert_array_equal(clock.line.boot_of(vehicle.places), vehicle.boot)
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0
    assert codes(ledger, "warning") == ["TIME-REBOOT"]
    assert codes(ledger, "loss") == []


def test_the_boot_begins_at_the_silence_and_not_at_the_first_fix():
    vehicle = Vehicle((10.0, 0.0, 60.0), (90.0, 3600.0, 600.0))
    rows = np.flatnonzero((vehicle.boot == 0) | (vehicle.boot_ns > 200 * SECOND))
    clock, _ = vehicle.fit(vehicle.told(rows))
    np.testing.assert_array_equal(clock.line.boot_of(vehicle.places), vehicle.boot)


def test_a_silence_alone_is_no_boot():
    vehicle = Vehicle((10.0, 0.0, 60.0), (698.0, 688.5, 60.0))  # half a second of drift
    clock, ledger = vehicle.fit(vehicle.told())
    assert clock.line.boots == 1
    assert codes(ledger, "warning") == []


@pytest.mark.parametrize("wrong", [[0], [299], [150], [150, 151, 152, 153], [0, 299, 150]])
def test_a_few_wrong_rows_are_no_boot_even_at_a_silence(wrong):
    vehicle = Vehicle((10.0, 0.0, 30.0), (50.0, 40.0, 30.0))
    told = vehicle.told()
    told.utc_ns[wrong] += 3600 * SECOND
    clock, ledger = vehicle.fit(told)
    assert clock.line.boots == 1
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0
    assert codes(ledger, "loss") == []
    assert "3600000 ms" in next(iter(ledger)).what


def test_a_receiver_that_is_set_late_is_no_boot_but_a_loss():
    """The time since boot runs on: nobody restarted. One row in twenty is not in p5 to p95."""
    vehicle = Vehicle((10.0, 0.0, 600.0))
    told = vehicle.told()
    told.utc_ns[:100] -= 2 * SECOND  # leap seconds that the receiver did not know yet
    clock, ledger = vehicle.fit(told)
    assert clock.line.boots == 1
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0
    assert codes(ledger, "loss") == ["TIME-FIT"]


def test_rows_without_a_fix_do_not_count():
    vehicle = Vehicle((10.0, 0.0, 40.0))
    told = vehicle.told(fix=np.where(np.arange(200) < 120, 2, 3))
    told.utc_ns[:120] -= 3600 * SECOND
    clock, ledger = vehicle.fit(told)
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0
    assert codes(ledger, "loss") == []


def test_the_receiver_with_the_most_rows_decides_and_the_other_is_a_loss():
    vehicle = Vehicle((10.0, 0.0, 40.0))
    clock, ledger = vehicle.fit(vehicle.told([7], late_s=-86_400.0), vehicle.told(slice(2, 190)))
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0
    assert codes(ledger, "loss") == ["TIME-SOURCES"]
    assert "-86400.000 s" in next(e for e in ledger if e.code == "TIME-SOURCES").what


def test_a_second_receiver_serves_where_the_first_has_no_row():
    vehicle = Vehicle((10.0, 0.0, 40.0), (5.0, 3600.0, 40.0))
    clock, _ = vehicle.fit(vehicle.told(slice(0, 190)), vehicle.told(slice(200, 250)))
    assert clock.utc_known == (True, True)
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0


def test_the_recorder_cuts_and_sets_boots_without_utc():
    vehicle = Vehicle((10.0, 0.0, 60.0), (90.0, 3600.0, 600.0))
    jitter = np.random.default_rng(3).integers(0, 300_000_000, vehicle.places.size)
    recorder = vehicle.told()
    recorder.utc_ns[:] += jitter
    clock, _ = vehicle.fit(recorder=recorder)
    np.testing.assert_array_equal(clock.line.boot_of(vehicle.places), vehicle.boot)
    assert clock.utc_known == (False, False)
    assert np.abs(vehicle.errors_s(clock)).max() < 0.3


def test_a_recorder_whose_clock_is_set_does_not_overrule_utc():
    vehicle = Vehicle((10.0, 0.0, 60.0), (90.0, 80.0, 600.0))
    recorder = vehicle.told()
    recorder.utc_ns[vehicle.boot == 1] += 900 * SECOND
    clock, _ = vehicle.fit(vehicle.told(slice(None, None, 5)), recorder=recorder)
    assert clock.line.boots == 1


def test_stray_stamps_are_in_no_fit():
    vehicle = Vehicle((10.0, 0.0, 40.0))
    vehicle.boot_ns[20:24] += 1 << 45
    clock, _ = vehicle.fit(vehicle.told())
    assert not clock.line.good(vehicle.places)[20:24].any()
    assert clock.fits[0] is not None
    assert (clock.fits[0].rows, clock.fits[0].largest_ns) == (196, 0)


def test_repeated_times_of_a_slow_receiver_are_in_no_fit():
    """Each second row is 0.2 s late: the median of all would be 0.1 s off."""
    vehicle = Vehicle((10.0, 0.0, 40.0))
    told = vehicle.told()
    told.utc_ns[1::2] = told.utc_ns[::2]
    clock, _ = vehicle.fit(told)
    assert np.abs(vehicle.errors_s(clock)).max() == 0.0


def test_blocks_of_stamps_are_one_line():
    vehicle = Vehicle((10.0, 0.0, 40.0), (5.0, 100.0, 40.0), (60.0, 200.0, 9.0))
    whole = timeline([(vehicle.places, vehicle.boot_ns)])
    edges = np.array([0, 1, 2, 150, 199, 200, 201, 400, vehicle.places.size])
    parts = [slice(a, b) for a, b in pairwise(edges.tolist())]
    pieces = timeline((vehicle.places[part], vehicle.boot_ns[part]) for part in parts)
    for name, column in vars(whole).items():
        np.testing.assert_array_equal(vars(pieces)[name], column)
    assert whole.boots == 2


def test_small_steps_back_are_no_boot_and_large_ones_are():
    """A logger writes records up to some ms out of order."""
    steady = np.arange(10.0, 15.0, 0.5)
    seconds = np.concatenate([steady, [14.1], steady + 5.0, steady - 7.0])
    line = timeline([(np.arange(31), (seconds * SECOND).astype(np.int64))])
    np.testing.assert_array_equal(line.boot_of(np.arange(31)), [0] * 21 + [1] * 10)
    empty = timeline([])
    assert (empty.boots, empty.boot_of(np.arange(2)).tolist()) == (1, [0, 0])
