"""Clocks against calendars, the IERS table and hand-made sequences."""

from datetime import UTC, datetime
from itertools import combinations, pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.flight.clock import (
    clock_fit_note,
    clock_map,
    fit_offset,
    longest_increasing,
    new_readings,
    rows_in_time_order,
    stray_times,
    utc_of_gps,
)
from unbend.messages import Ledger

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


def test_one_flipped_bit_of_a_time_is_stray_and_no_boot() -> None:
    time_ns = np.arange(100, dtype=np.int64) * SECOND // 10
    time_ns[40] += 1 << 45
    stray = stray_times(time_ns)
    np.testing.assert_array_equal(np.flatnonzero(stray), [40])


def test_a_boot_and_a_gap_are_not_stray() -> None:
    time_ns = np.concatenate([np.arange(50), 628 + np.arange(50), np.arange(50)]) * SECOND
    assert not stray_times(time_ns).any()


@pytest.mark.parametrize("rows", [(0,), (40,), (40, 41, 42), (10, 12, 14), (99,)])
def test_stray_stamps_at_any_place(rows: tuple[int, ...]) -> None:
    time_ns = 10**12 + np.arange(100, dtype=np.int64) * SECOND // 10
    for sign in (1, -1) if rows == (40,) else (1,) if rows[0] == 0 else (-1,):
        damaged = time_ns.copy()
        damaged[list(rows)] += sign * 950_400 * SECOND
        np.testing.assert_array_equal(np.flatnonzero(stray_times(damaged)), rows)


def longest(times: tuple[int, ...]) -> int:
    """The length of the longest increasing subsequence, by trying all, longest first."""
    return next(
        k
        for k in range(len(times), -1, -1)
        if any(all(a < b for a, b in pairwise(some)) for some in combinations(times, k))
    )


def test_increasing_keeps_as_many_rows_as_can_be() -> None:
    assert longest_increasing(np.empty(0, np.int64)).shape == (0,)
    for times in product(range(5), repeat=5):
        kept = np.array(times)[longest_increasing(np.array(times, np.int64))]
        assert (np.diff(kept) > 0).all()
        assert kept.shape[0] == longest(times), times


def test_of_equal_stamps_the_first_is_kept() -> None:
    np.testing.assert_array_equal(
        np.flatnonzero(longest_increasing(np.array([1, 2, 2, 3, 3]))), [0, 1, 3]
    )


@pytest.mark.parametrize("row", [0, 5, 500, 999])
@pytest.mark.parametrize("sign", [1, -1])
def test_one_wrong_stamp_costs_one_row(row: int, sign: int) -> None:
    time_ns = np.arange(1000, dtype=np.int64) * SECOND // 10
    time_ns[row] += sign * 11 * 86_400 * SECOND
    rows, stretch = rows_in_time_order(time_ns)
    # a first stamp too low and a last one too high rise as well: nothing tells them from a gap
    rises = (row, sign) in {(0, -1), (999, 1)}
    np.testing.assert_array_equal(np.setdiff1d(np.arange(1000), rows), [] if rises else [row])
    assert not stretch.any()


def test_a_clock_set_back_a_little_costs_what_it_passed_twice() -> None:
    before = np.arange(0, 1000, dtype=np.int64) * SECOND // 10
    after = before[-1] - 10 * SECOND + np.arange(1, 801, dtype=np.int64) * SECOND // 10 + 7
    rows, stretch = rows_in_time_order(np.concatenate([before, after]))
    # 90 to 100 s were read twice: that is settled for the later reading, in all channels alike
    np.testing.assert_array_equal(rows, np.concatenate([np.arange(901), 1000 + np.arange(800)]))
    np.testing.assert_array_equal(stretch, [0] * 901 + [1] * 800)
    # the same where the stamps coincide, and where the later part has fewer rows
    for sparse in (np.arange(800), np.arange(0, 800, 3)):
        rows, stretch = rows_in_time_order(np.concatenate([before, after[sparse] - 7]))
        np.testing.assert_array_equal(rows[stretch == 0], np.arange(900))
        assert np.count_nonzero(stretch == 1) == sparse.shape[0]


def test_a_clock_set_back_by_a_day_costs_nothing() -> None:
    before = 86_400 * SECOND + np.arange(50, dtype=np.int64) * SECOND
    time_ns = np.concatenate([before, np.arange(20, dtype=np.int64) * SECOND])
    rows, stretch = rows_in_time_order(time_ns)
    np.testing.assert_array_equal(rows, np.concatenate([50 + np.arange(20), np.arange(50)]))
    np.testing.assert_array_equal(stretch, [1] * 20 + [0] * 50)


@given(st.lists(st.integers(0, 60), max_size=80))
def test_untangled_always_rises(times: list[int]) -> None:
    time_ns = np.array(times, np.int64)
    rows, stretch = rows_in_time_order(time_ns)
    assert rows.shape == stretch.shape
    assert (np.diff(time_ns[rows]) > 0).all()
    assert (rows.shape[0] > 0) == bool(times)


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
        new_readings(np.array([5, 5, 7, 7, 9])), [True, False, True, False, True]
    )


def test_along_follows_a_drifting_clock_and_does_not_extrapolate_the_drift() -> None:
    host = np.array([0, 10, 20], np.int64) * SECOND + 1_600_000_000 * SECOND
    vehicle = np.array([0, 11, 20], np.int64) * SECOND + 1_700_000_000 * SECOND
    asked = np.array([-5, 5, 15, 30], np.int64) * SECOND + 1_600_000_000 * SECOND
    expected = np.array([-5.0, 5.5, 15.5, 30.0]) * SECOND + 1_700_000_000 * SECOND
    np.testing.assert_array_equal(clock_map(host, vehicle)(asked), expected.astype(np.int64))


@pytest.mark.parametrize(
    ("late_ms", "rows", "kind", "count"),
    [
        (39, slice(0, 400), "note", 400),
        (5003, slice(0, 150), "loss", 150),
        (999, slice(390, 400), "loss", 10),  # a leap second late in a flight: not in p5 to p95
        (999, slice(200, 204), "note", 400),  # a glitch
        (999, slice(200, 249), "note", 49),  # 9.6 s, and then as before
        (999, slice(200, 251), "loss", 51),  # 10 s
        (201, slice(395, 400), "loss", 5),  # it may have lasted beyond the log
        (201, slice(200, 205), "note", 400),
        (1200, slice(0, 2), "note", 2),  # written late, as the logger began
        (604_800_001, slice(0, 3), "note", 3),  # the week number came late
        (86_400_000, slice(399, 400), "note", 1),
    ],
)
def test_a_stepping_clock_is_a_loss_counted_and_placed(late_ms, rows, kind, count):
    ledger = Ledger()
    boot_ns = 50 * SECOND + np.arange(400) * SECOND // 5
    utc_ns = boot_ns + 1_700_000_000 * SECOND
    utc_ns[rows] += late_ms * 1_000_000
    ledger.add(clock_fit_note("400 GPS rows", fit_offset(utc_ns, boot_ns), "boot 0"))
    (entry,) = ledger
    assert (entry.code, entry.kind, entry.count) == ("TIME-FIT", kind, count)
    if kind == "loss":
        assert entry.where == f"boot 0, first {50 + rows.start / 5:.3f} s after boot"


@pytest.mark.parametrize("late_s", [0.9, 1.5, 5.0])
def test_a_single_stamp_that_is_off_is_no_step(late_s: float) -> None:
    """p5 and p95 of 400 rows do not see it, and the median does not follow it."""
    boot_ns = np.arange(400) * SECOND
    utc_ns = boot_ns + 1_700_000_000 * SECOND
    utc_ns[200] += round(late_s * SECOND)
    fit = fit_offset(utc_ns, boot_ns)
    assert (fit.spread_ns, fit.largest_ns, fit.far) == (0, round(late_s * SECOND), 1)
    entry = clock_fit_note("400 GPS rows", fit, "boot 0")
    assert (entry.kind, entry.count) == ("note", 400 if late_s < 1.0 else 1)
    assert "stepped" not in entry.what
    assert f"the farthest is {late_s * 1000:.0f} ms off" in entry.what


def test_stamps_that_scatter_are_no_step_and_say_how_good_utc_is() -> None:
    """Uniform within 0.18 s to both sides: none is more than 0.2 s off, p5 to p95 are 0.32 s."""
    boot_ns = np.arange(400) * SECOND
    jitter_ns = np.random.default_rng(5).integers(-180_000_000, 180_000_000, 400)
    fit = fit_offset(boot_ns + 1_700_000_000 * SECOND + jitter_ns, boot_ns)
    entry = clock_fit_note("400 GPS rows", fit, "boot 0")
    assert (entry.kind, entry.count, fit.far) == ("warning", 400, 0)
    assert "stepped" not in entry.what
    assert fit.sigma_ns == pytest.approx(1.4826 * 0.09 * SECOND, rel=0.1)  # the median of |jitter|
