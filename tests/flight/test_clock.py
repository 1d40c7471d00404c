"""Clocks against calendars, the IERS table and hand-made sequences."""

from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.flight.clock import (
    along,
    boots_of,
    fit_offset,
    fresh,
    increasing,
    stray_times,
    utc_of_gps,
)

SECOND = 10**9


def unix_ns(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * SECOND


def gps_week_seconds(utc: str, leap: int) -> tuple[int, int]:
    elapsed = datetime.fromisoformat(utc) - datetime(1980, 1, 6)
    return divmod(elapsed.days * 86400 + elapsed.seconds + leap, 604_800)


@pytest.mark.parametrize(
    ("utc", "leap"),
    [
        ("1980-01-06T00:00:00", 0),
        ("1999-08-22T12:00:00", 13),  # the first rollover of the 10-bit week
        ("2015-06-30T23:59:59", 16),
        ("2015-07-01T00:00:00", 17),
        ("2016-12-23T10:00:00", 17),  # pymavlink's constant 18 is wrong here by 1 s
        ("2016-12-31T23:59:59", 17),
        ("2017-01-01T00:00:00", 18),
        ("2025-11-13T17:26:09", 18),
    ],
)
def test_leap_seconds_by_date(utc: str, leap: int) -> None:
    week, seconds = gps_week_seconds(utc, leap)
    assert int(utc_of_gps(week, float(seconds))) == unix_ns(utc)


def test_gps_milliseconds_are_exact() -> None:
    milliseconds = np.array([0, 1, 345_600_123, 604_799_999])
    utc = utc_of_gps(np.full(4, 2300), milliseconds / 1000.0)
    start = unix_ns("2024-02-04T00:00:00") - 18 * SECOND
    np.testing.assert_array_equal(utc - start, milliseconds * 1_000_000)


def test_the_second_before_a_leap_second_is_repeated() -> None:
    week, seconds = gps_week_seconds("2017-01-01T00:00:00", 18)
    around = utc_of_gps(np.full(3, week), np.array([seconds - 2.0, seconds - 1.0, seconds]))
    midnight = unix_ns("2017-01-01T00:00:00")
    np.testing.assert_array_equal(around, [midnight - SECOND, midnight, midnight])


def test_small_steps_back_are_no_boot_and_large_ones_are() -> None:
    seconds = np.array([10.0, 11.0, 10.4, 12.0, 3.0, 4.0, 2.5, 9.0])
    boots = boots_of((seconds * SECOND).astype(np.int64))
    np.testing.assert_array_equal(boots, [0, 0, 0, 0, 1, 1, 2, 2])
    assert boots_of(np.empty(0, np.int64)).shape == (0,)


def test_one_flipped_bit_of_a_time_is_stray_and_no_boot() -> None:
    time_ns = np.arange(100, dtype=np.int64) * SECOND // 10
    time_ns[40] += 1 << 45
    stray = stray_times(time_ns)
    np.testing.assert_array_equal(np.flatnonzero(stray), [40])
    assert boots_of(time_ns[~stray]).max() == 0


def test_a_boot_and_a_gap_are_not_stray() -> None:
    time_ns = np.concatenate([np.arange(50), 628 + np.arange(50), np.arange(50)]) * SECOND
    assert not stray_times(time_ns).any()


def test_increasing_keeps_a_strictly_rising_subsequence() -> None:
    time_ns = np.array([3, 3, 5, 4, 6, 1, 7], np.int64)
    np.testing.assert_array_equal(time_ns[increasing(time_ns)], [3, 5, 6, 7])


def test_offset_is_robust_and_keeps_nanoseconds() -> None:
    boot_ns = np.arange(0, 200 * SECOND, SECOND, dtype=np.int64)
    utc_ns = boot_ns + 1_700_000_000_123_456_789
    utc_ns[:40] += 7 * SECOND  # a receiver that set its clock late
    fit = fit_offset(utc_ns, boot_ns)
    assert fit is not None
    assert fit.offset_ns == 1_700_000_000_123_456_789
    assert (fit.rows, fit.spread_ns) == (200, 7 * SECOND)
    assert fit_offset(np.empty(0, np.int64), np.empty(0, np.int64)) is None


def test_fresh_drops_repeats_of_a_slow_receiver() -> None:
    np.testing.assert_array_equal(
        fresh(np.array([5, 5, 7, 7, 9])), [True, False, True, False, True]
    )


def test_along_follows_a_drifting_clock_and_does_not_extrapolate_the_drift() -> None:
    host = np.array([0, 10, 20], np.int64) * SECOND + 1_600_000_000 * SECOND
    vehicle = np.array([0, 11, 20], np.int64) * SECOND + 1_700_000_000 * SECOND
    asked = np.array([-5, 5, 15, 30], np.int64) * SECOND + 1_600_000_000 * SECOND
    expected = np.array([-5.0, 5.5, 15.5, 30.0]) * SECOND + 1_700_000_000 * SECOND
    np.testing.assert_array_equal(along(host, vehicle)(asked), expected.astype(np.int64))
