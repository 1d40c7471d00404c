"""Clocks against calendars, the IERS table and hand-made sequences."""

from datetime import UTC, datetime
from itertools import combinations, pairwise, product

import numpy as np
import pytest
from hypothesis import given, strategies

from tests.flight.made_channels import counted, instants
from tests.helpers import NS_PER_S
from unbend.flight.clock import (
    clock_fit_note,
    clock_map,
    fit_offset,
    later_by_rollovers,
    longest_increasing,
    new_readings,
    rows_in_time_order,
    stray_times,
    utc_of_gps,
)

DAY_S = 86_400
TENTH_NS = NS_PER_S // 10
UTC_NS = 1_700_000_000 * NS_PER_S


def unix_ns(text):
    date = datetime.fromisoformat(text).replace(tzinfo=UTC)
    return int(date.timestamp()) * NS_PER_S


def steady_ns(count, interval_ns=NS_PER_S):
    """Times since boot at an interval."""
    return np.arange(count) * interval_ns


# The days on which GPS minus UTC grew by a second (IERS Bulletin C).
LEAP_DAYS = """
1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 1993-07-01
1994-07-01 1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 2015-07-01 2017-01-01
"""


@pytest.mark.parametrize(("leap", "day"), list(enumerate(LEAP_DAYS.split(), start=1)))
def test_a_leap_second_repeats_the_second_before(leap, day):
    midnight_ns = unix_ns(day)
    since_gps_epoch_s = (midnight_ns - unix_ns("1980-01-06")) // NS_PER_S
    week, seconds = divmod(since_gps_epoch_s + leap, 7 * DAY_S)
    around_s = seconds + np.array([-2.0, -1.0, 0.0])
    around_ns = utc_of_gps(np.full(3, week), around_s)
    assert around_ns.tolist() == [midnight_ns - NS_PER_S, midnight_ns, midnight_ns]


def test_gps_milliseconds_are_exact():
    milliseconds = np.array([0, 1, 345_600_123, 604_799_999])
    utc_ns = utc_of_gps(np.full(4, 2300), milliseconds / 1000.0)
    begin_ns = unix_ns("2024-02-04T00:00:00") - 18 * NS_PER_S
    assert (utc_ns - begin_ns).tolist() == (milliseconds * 1_000_000).tolist()


@pytest.mark.parametrize(
    ("week", "rollovers"),
    [
        (1300, 1),
        (2300, 2),
        (1500, -1),
    ],
)
def test_weeks_that_have_rolled_over_take_the_leap_seconds_of_their_date(week, rollovers):
    early_ns = utc_of_gps([week - 1024 * rollovers], [5.5])
    full_ns = later_by_rollovers(early_ns, rollovers, from_gps_week=True)
    assert full_ns == utc_of_gps([week], [5.5])


def test_weeks_that_have_rolled_over_in_utc_are_moved_whole():
    moved_ns = later_by_rollovers(np.array([5]), 1, from_gps_week=False)
    assert moved_ns == 1024 * 7 * DAY_S * NS_PER_S + 5


@pytest.mark.parametrize(
    ("rows", "off_s"),
    [
        ([0], 950_400),
        ([40], 950_400),
        ([40], -950_400),
        ([40, 41, 42], -950_400),
        ([10, 12, 14], -950_400),
        ([99], -950_400),
        ([40], 35_184.372088832),  # one flipped bit: 2 ** 45 ns
        ([40], 1.2),
        ([], 0),
    ],
)
def test_stray_stamps_at_any_place(rows, off_s):
    time_ns = 10**12 + steady_ns(100, TENTH_NS)
    time_ns[rows] += instants(off_s)
    assert np.flatnonzero(stray_times(time_ns)).tolist() == rows


def test_a_boot_and_a_gap_are_not_stray():
    seconds = np.concatenate(
        [
            np.arange(50),
            628 + np.arange(50),
            np.arange(50),
        ]
    )
    assert not stray_times(seconds * NS_PER_S).any()


def longest(times):
    """The length of the longest increasing subsequence, by trying all, longest first."""
    for length in range(len(times), 0, -1):
        for chosen in combinations(times, length):
            if all(first < second for first, second in pairwise(chosen)):
                return length
    return 0


def test_increasing_keeps_as_many_rows_as_can_be():
    assert longest_increasing(np.empty(0, np.int64)).shape == (0,)
    for numbers in product(range(5), repeat=5):
        times = np.array(numbers)
        kept = times[longest_increasing(times)]
        assert (np.diff(kept) > 0).all()
        assert kept.size == longest(numbers)


def test_of_equal_stamps_the_first_is_kept():
    kept = longest_increasing(np.array([1, 2, 2, 3, 3]))
    assert np.flatnonzero(kept).tolist() == [0, 1, 3]


@pytest.mark.parametrize(
    ("row", "off_days", "left_out"),
    [
        (0, 11, [0]),
        (0, -11, []),  # a first stamp too low rises as well: nothing tells it from a gap
        (500, 11, [500]),
        (500, -11, [500]),
        (999, 11, []),
        (999, -11, [999]),
    ],
)
def test_one_wrong_stamp_costs_one_row(row, off_days, left_out):
    time_ns = steady_ns(1000, TENTH_NS)
    time_ns[row] += off_days * DAY_S * NS_PER_S
    rows, stretch = rows_in_time_order(time_ns)
    assert np.setdiff1d(np.arange(1000), rows).tolist() == left_out
    assert not stretch.any()


STEPS = np.arange(800)


@pytest.mark.parametrize(
    ("later", "kept_before"),
    [
        (STEPS / 10.0 + 90.0 + 7e-9, 901),
        (STEPS / 10.0 + 90.0, 900),
        (STEPS[::3] / 10.0 + 90.0, 900),
    ],
    ids=["stamps apart", "stamps coincide", "fewer rows"],
)
def test_a_clock_set_back_a_little_costs_what_it_passed_twice(later, kept_before):
    """90 to 100 s were read twice: the later reading counts."""
    first = np.arange(1000) / 10.0
    rows, stretch = rows_in_time_order(instants(*first, *later))
    assert rows[stretch == 0].tolist() == list(range(kept_before))
    assert rows[stretch == 1].tolist() == list(range(1000, 1000 + later.size))


def test_a_clock_set_back_by_a_day_costs_nothing():
    seconds = np.concatenate([DAY_S + np.arange(50), np.arange(20)])
    rows, stretch = rows_in_time_order(seconds * NS_PER_S)
    assert rows.tolist() == [*range(50, 70), *range(50)]
    assert stretch.tolist() == [1] * 20 + [0] * 50


@given(strategies.lists(strategies.integers(0, 60), max_size=80))
def test_rows_in_time_order_increase_strictly(times):
    """For whatever a log contains."""
    time_ns = np.array(times, np.int64)
    rows, stretch = rows_in_time_order(time_ns)
    assert rows.shape == stretch.shape
    assert (np.diff(time_ns[rows]) > 0).all()
    assert bool(times) == bool(rows.size)


def test_new_readings_are_no_repeats_of_a_slow_receiver():
    assert new_readings(np.array([5, 5, 7, 7, 9])).tolist() == [True, False, True, False, True]


@pytest.mark.parametrize(
    ("readings_s", "asked_s", "mapped_s"),
    [
        # a drifting clock is followed, and its drift is not extrapolated
        (
            [0, 11, 20],
            [-5, 0, 5, 10, 15, 20, 30],
            [-5, 0, 5.5, 11, 15.5, 20, 30],
        ),
        # a reading that falls back is raised to the one before
        (
            [0, 11, 9],
            [5, 15, 20, 30],
            [5.5, 11, 11, 21],
        ),
    ],
)
def test_a_clock_map_goes_through_its_readings_and_never_back(readings_s, asked_s, mapped_s):
    host_ns = 1_600_000_000 * NS_PER_S
    read_ns = host_ns + instants(0, 10, 20)
    vehicle_of_host = clock_map(read_ns, UTC_NS + instants(*readings_s))
    mapped_ns = vehicle_of_host(host_ns + instants(*asked_s))
    assert mapped_ns.tolist() == (UTC_NS + instants(*mapped_s)).tolist()


def test_offset_is_robust_and_keeps_nanoseconds():
    boot_ns = steady_ns(200)
    utc_ns = boot_ns + UTC_NS + 123_456_789
    utc_ns[:40] += 7 * NS_PER_S  # a receiver that set its clock late
    fit = fit_offset(utc_ns, boot_ns)
    assert fit.offset_ns == UTC_NS + 123_456_789
    assert fit.rows == 200
    assert fit.spread_ns == 7 * NS_PER_S


def test_no_readings_have_no_offset():
    assert fit_offset(np.empty(0, np.int64), np.empty(0, np.int64)) is None


def test_the_spread_is_from_the_5th_to_the_95th_percentile():
    """101 rows are late by 0 to 100 ms."""
    boot_ns = steady_ns(101)
    late_ns = steady_ns(101, 1_000_000)
    fit = fit_offset(boot_ns + late_ns, boot_ns)
    assert fit.offset_ns == 50_000_000
    assert fit.spread_ns == 90_000_000
    assert fit.largest_ns == 50_000_000


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
    boot_ns = 50 * NS_PER_S + steady_ns(400, NS_PER_S // 5)
    utc_ns = boot_ns + UTC_NS
    utc_ns[rows] += late_ms * 1_000_000
    note = clock_fit_note("400 GPS rows", fit_offset(utc_ns, boot_ns), "boot 0")
    assert counted([note]) == [(kind, "TIME-FIT", count)]
    if kind == "loss":
        assert note.where == f"boot 0, first {50 + rows.start / 5:.3f} s after boot"


@pytest.mark.parametrize(
    ("late_ms", "count"),
    [
        (900, 400),
        (1500, 1),
        (5000, 1),
    ],
)
def test_a_single_stamp_that_is_off_is_no_step(late_ms, count):
    """p5 and p95 of 400 rows do not see it, and the median does not follow it."""
    boot_ns = steady_ns(400)
    utc_ns = boot_ns + UTC_NS
    utc_ns[200] += late_ms * 1_000_000
    fit = fit_offset(utc_ns, boot_ns)
    assert fit.spread_ns == 0
    assert fit.largest_ns == late_ms * 1_000_000
    assert fit.far == 1

    note = clock_fit_note("400 GPS rows", fit, "boot 0")
    assert counted([note]) == [("note", "TIME-FIT", count)]
    assert "stepped" not in note.what
    assert f"the farthest is {late_ms} ms off" in note.what


def test_stamps_that_scatter_are_no_step_and_say_how_good_utc_is():
    """Uniform within 0.18 s: none is more than 0.2 s off, p5 to p95 are 0.32 s, |x| is 0.09 s."""
    boot_ns = steady_ns(400)
    jitter_ns = np.random.default_rng(5).integers(-180_000_000, 180_000_000, 400)
    fit = fit_offset(boot_ns + UTC_NS + jitter_ns, boot_ns)
    note = clock_fit_note("400 GPS rows", fit, "boot 0")
    assert counted([note]) == [("warning", "TIME-FIT", 400)]
    assert fit.far == 0
    assert "stepped" not in note.what
    median_ns = 0.09 * NS_PER_S  # of the jitter without its sign
    assert fit.sigma_ns == pytest.approx(1.4826 * median_ns, rel=0.1)
