"""Clocks: GPS time, the vehicle's time since boot, and UTC.

Every device in a log has a clock of its own. What leaves this module is int64 Unix nanoseconds.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.messages import clock_scatters, clock_stepped, time_fit, time_fit_but_for
from unbend.messages import Message
from unbend.units import NANOSECONDS_PER_SECOND, UNIX_NS_OF_GPS_EPOCH, Array, Integers, Mask, Rows

SECONDS_PER_WEEK = 604_800
WEEKS_PER_ROLLOVER = 1024  # the week has 10 bits in the signal

# The UTC dates from which GPS minus UTC is 0, 1, 2 ... s, from IERS Bulletin C (numbers 1-70) and
# the USNO table tai-utc.dat less 19 s. None has been announced after 2017-01-01.
_LEAP_DATES = (
    "1980-01-06 1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 "
    "1992-07-01 1993-07-01 1994-07-01 1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 "
    "2012-07-01 2015-07-01 2017-01-01"
)
_LEAP_UTC_NS = np.array(_LEAP_DATES.split(), "datetime64[ns]").astype(np.int64)
_LEAP_SECONDS = np.arange(_LEAP_UTC_NS.size)
_LEAP_GPS_NS = _LEAP_UTC_NS + _LEAP_SECONDS * NANOSECONDS_PER_SECOND - UNIX_NS_OF_GPS_EPOCH

# A field of MAVLink called time_usec is either time since boot or Unix time; 1e15 us since boot
# would be 31 years, 1e15 us of Unix time is the year 2001.
UNIX_US_FROM = 10**15
UNIX_NS_FROM = UNIX_US_FROM * 1000
LAST_US = 1 << 52  # 142 years: a stamp beyond is damage, and below, nanoseconds fit into 64 bits

BOOT_STEP_NS = NANOSECONDS_PER_SECOND  # loggers write records up to some ms out of order
STRAY_ROWS = 4  # up to so many successive rows can be one glitch; a power-up writes more
LARGEST_SPREAD_NS = 200_000_000  # real logs: 1 to 40 ms; a receiver's time step is a second or more
LARGEST_SIGMA_NS = 60_000_000  # of one row, by the median: 200 ms from p5 to p95
SIGMA_OF_MAD = 1.4826  # of a normal distribution, over its median absolute deviation
# A clock stepped if the offset differs for as long as this, or for this share of a log of less than
# 40 s.
LASTING_NS = 10 * NANOSECONDS_PER_SECOND
LASTING_SHARE = 0.25
SET_BACKS = 16  # times that step back more often than this are noise, not settings of a clock


def utc_of_gps(week: ArrayLike, seconds: ArrayLike) -> TimeArray:
    """UTC of a GPS week and the seconds of that week.

    ``week``: (...) weeks since 1980-01-06, full (not modulo 1024). ``seconds``: (...) [s], may
    exceed a week. Returns (...) Unix time [ns], int64, exact to 1 ns for milliseconds of the week;
    a leap second repeats the second before. Leap seconds by date: IERS Bulletin C.

    >>> utc_of_gps(1928, 432017.0)  # 2016-12-23 00:00:00 UTC: 17 leap seconds, not 18
    array(1482451200000000000)
    """
    weeks_ns = np.asarray(week, np.int64) * (SECONDS_PER_WEEK * NANOSECONDS_PER_SECOND)
    seconds_of_week = np.asarray(seconds, np.float64)
    # Whole seconds and fractions are separate: float64 has not every nanosecond of many weeks.
    whole_seconds = np.floor(seconds_of_week)
    fraction_ns = np.rint((seconds_of_week - whole_seconds) * 1e9).astype(np.int64)
    gps_ns = weeks_ns + whole_seconds.astype(np.int64) * NANOSECONDS_PER_SECOND + fraction_ns
    # The last leap second that has come; before 1980 the first entry, which is 0 s.
    last_before = np.searchsorted(_LEAP_GPS_NS, gps_ns, side="right") - 1
    row = np.maximum(last_before, 0)
    utc: TimeArray = gps_ns + UNIX_NS_OF_GPS_EPOCH - _LEAP_SECONDS[row] * NANOSECONDS_PER_SECOND
    return np.asarray(utc, np.int64)


def later_by_rollovers(utc_ns: TimeArray, rollovers: int, *, from_gps_week: bool) -> TimeArray:
    """Correct the (n,) UTC [Unix ns] of a receiver that lacks rollovers of its week counter.

    ``rollovers``: how many times 1024 weeks are added. ``from_gps_week``: True if the UTC was
    computed from the GPS week, and so with the leap seconds of the date that is too early; False if
    the receiver itself subtracted the present leap seconds.

    >>> early = utc_of_gps([276], [0.0])
    >>> full = later_by_rollovers(early, 1, from_gps_week=True)
    >>> bool(full == utc_of_gps([1300], [0.0]))
    True
    """
    weeks_ns = rollovers * WEEKS_PER_ROLLOVER * SECONDS_PER_WEEK * NANOSECONDS_PER_SECOND
    moved_ns = utc_ns + weeks_ns
    if not from_gps_week:
        return moved_ns
    more_leap_seconds = _leap_seconds_at(moved_ns) - _leap_seconds_at(utc_ns)
    return np.asarray(moved_ns - more_leap_seconds * NANOSECONDS_PER_SECOND, np.int64)


def _leap_seconds_at(utc_ns: TimeArray) -> Integers:
    """(n,) GPS time minus UTC [s] at times [Unix ns]; 0 before 1980."""
    last_before = np.searchsorted(_LEAP_UTC_NS, utc_ns, side="right") - 1
    row = np.maximum(last_before, 0)
    return np.asarray(_LEAP_SECONDS[row], np.int64)


def stray_times(time_ns: TimeArray) -> Mask:
    """Mark short runs of time stamps that are far from the stamps before and after them.

    ``time_ns``: (n,) [ns] in the order of the file. Returns (n,) True where a stamp is stray:

    * Within the file, up to `STRAY_ROWS` successive stamps more than a second from the stamp before
      them, if the stamp after them is within a second of that one. After a gap or a new boot the
      stamps do not return like this.
    * At the begin or the end of the file, up to `STRAY_ROWS` stamps, if time steps back between
      them and the longer stretch next to them.

    >>> stray_times(np.array([0.0, 0.1, 70.0, 0.3, 0.4]) * 1e9)
    array([False, False,  True, False, False])
    """
    n = time_ns.shape[0]
    steps = np.diff(time_ns)
    np.abs(steps, out=steps)
    far_from_previous = np.flatnonzero(steps > BOOT_STEP_NS) + 1
    if n == 0 or far_from_previous.size == 0:
        return np.zeros(n, np.bool_)
    first_row = np.append(0, far_from_previous)
    length = np.diff(np.append(first_row, n))
    begin_ns = time_ns[first_row]
    end_ns = time_ns[first_row + length - 1]
    is_stray = stray_stretches(begin_ns, end_ns, length)
    return np.repeat(is_stray, length)


def stray_stretches(begin_ns: TimeArray, end_ns: TimeArray, length: Integers) -> Mask:
    """Mark stray stretches of time stamps by the rules of `stray_times`.

    A stretch ends where the next stamp is more than a second away. ``begin_ns``, ``end_ns``: (n,)
    the first and the last stamp of each stretch, in the order of the file; ``length``: (n,) its
    number of stamps. Returns (n,) True where a stretch is stray.

    >>> begin = np.array([0, 70, 2]) * 10**9
    >>> end = np.array([1, 70, 9]) * 10**9
    >>> stray_stretches(begin, end, np.array([9, 1, 9]))
    array([False,  True, False])
    """
    is_short = length <= STRAY_ROWS
    is_stray = np.zeros(begin_ns.shape, np.bool_)
    if begin_ns.shape[0] < 2:
        return is_stray
    # The first and the last stretch have one neighbour only: they are stray if time steps back.
    is_stray[0] = is_short[0] and not is_short[1] and begin_ns[1] < end_ns[0]
    is_stray[-1] = is_short[-1] and not is_short[-2] and begin_ns[-1] < end_ns[-2]
    # The others are compared with the last stamp before them that is not stray. Behind a stray
    # first stretch, the second is good.
    last_good_ns = begin_ns[1] if is_stray[0] else end_ns[0]
    for k in range(1, begin_ns.shape[0] - 1):
        leaves = abs(begin_ns[k] - last_good_ns) > BOOT_STEP_NS
        next_returns = abs(begin_ns[k + 1] - last_good_ns) <= BOOT_STEP_NS
        is_stray[k] = is_short[k] and leaves and next_returns
        if not is_stray[k]:
            last_good_ns = end_ns[k]
    return is_stray


def longest_increasing(time_ns: TimeArray) -> Mask:
    """Mark a longest subsequence of rows in which the times increase strictly.

    ``time_ns``: (n,) in the order of the file. A wrong stamp costs one row, whatever its value. Of
    equal stamps the first is marked.

    >>> longest_increasing(np.array([1, 3, 900, 4, 5, 5]))
    array([ True,  True, False,  True,  True, False])
    """
    if bool(np.all(np.diff(time_ns) > 0)):
        return np.ones(time_ns.shape, np.bool_)
    no_row = -1
    # Entry k is of the increasing subsequences of k + 1 rows: the smallest time that ends one.
    end_times: list[int] = []
    end_rows: list[int] = []
    row_before = [no_row] * time_ns.shape[0]  # in the longest subsequence that ends with each row
    for row, time in enumerate(time_ns.tolist()):
        length = len(end_times)  # of the longest subsequence that the row can continue
        if end_times and time <= end_times[-1]:
            length = bisect_left(end_times, time)
            if end_times[length] == time:
                continue
        if length:
            row_before[row] = end_rows[length - 1]
        # Replaces entry ``length`` by this earlier time, or appends it.
        end_times[length : length + 1] = [time]
        end_rows[length : length + 1] = [row]
    # Back from the end of the longest subsequence.
    is_marked = np.zeros(time_ns.shape, np.bool_)
    marked_row = end_rows[-1]
    while marked_row != no_row:
        is_marked[marked_row] = True
        marked_row = row_before[marked_row]
    return is_marked


def rows_in_time_order(time_ns: TimeArray) -> tuple[Rows, NDArray[np.int16]]:
    """Choose rows with strictly increasing times, also if the clock was set back.

    ``time_ns``: (n,) [ns] in the order of the file. Returns (m,) row numbers in the order of time,
    and for each row how often the clock had been set back before it. Single rows out of order are
    left out (`longest_increasing`). More than `STRAY_ROWS` successive ones show that the clock was
    set back; of times that it passed twice, the rows before the setting are left out.

    >>> rows_in_time_order(np.array([0, 1, 90, 91, 92, 93, 94, 40, 41, 42, 43, 44, 45, 46]))[0]
    array([ 0,  1,  7,  8,  9, 10, 11, 12, 13,  2,  3,  4,  5,  6])
    """
    is_increasing = longest_increasing(time_ns)
    rows = np.flatnonzero(is_increasing | _in_long_runs(~is_increasing))
    is_set_back = np.diff(time_ns[rows]) <= 0
    settings = int(np.count_nonzero(is_set_back))
    if settings == 0 or settings > SET_BACKS:
        rows = np.flatnonzero(is_increasing)
        return rows, np.zeros(rows.shape, np.int16)
    settings_before = np.append(0, np.cumsum(is_set_back)).astype(np.int16)
    time = time_ns[rows]
    is_kept = np.ones(rows.shape, np.bool_)
    for number in range(1, settings + 1):
        after_setting = time[settings_before == number]
        passed_again = (time >= after_setting[0]) & (time <= after_setting[-1])
        is_earlier = settings_before < number
        is_kept &= ~(is_earlier & passed_again)
    order = np.argsort(time[is_kept], kind="stable")
    return rows[is_kept][order], settings_before[is_kept][order]


def _in_long_runs(mask: Mask) -> Mask:
    """(n,) where a mask is True in a run of more than `STRAY_ROWS` rows."""
    begin = np.flatnonzero(np.diff(mask, prepend=~mask[:1]))  # of each run of equal values
    length = np.diff(np.append(begin, mask.shape[0]))
    return mask & np.repeat(length > STRAY_ROWS, length)


@dataclass(frozen=True)
class ClockOffset:
    """UTC minus the time since boot, in one power-up, and how its rows scatter about the median."""

    offset_ns: int  # UTC minus time since boot, median of the rows
    spread_ns: int  # from the 5th to the 95th percentile
    rows: int
    largest_ns: int = 0  # distance of the farthest row from the median
    far: int = 0  # number of rows farther from the median than `LARGEST_SPREAD_NS`
    first_far_ns: int = 0  # time since boot of the first far row
    stepped: bool = False  # the far rows last, as after a step of one of the clocks
    sigma_ns: int = 0  # of the scatter of most rows; 0 up to `LARGEST_SIGMA_NS`


def fit_offset(utc_ns: TimeArray, boot_ns: TimeArray) -> ClockOffset | None:
    """The offset of a boot clock from UTC, robust against late and wrong rows; None without rows.

    ``utc_ns``: (n,) [ns] as a receiver or the vehicle reports it, ``boot_ns``: (n,) [ns] time since
    boot in the same rows. The offset is the median: in real logs rows scatter by 20-39 ms (p5-p95),
    the first one errs by up to 17 ms, and slopes over less than ten minutes are noise. Rows farther
    than `LARGEST_SPREAD_NS` from the median are counted; a clock stepped if they last (`_lasts`).

    >>> fit_offset(np.array([1_000, 2_000, 99_000]), np.array([0, 1_000, 2_000])).offset_ns
    1000
    """
    if utc_ns.shape[0] == 0:
        return None
    difference = utc_ns - boot_ns
    base = int(difference[0])  # float64 has all ns of small differences, but not of Unix time
    apart = (difference - base).astype(np.float64)
    low, middle, high = np.percentile(apart, (5.0, 50.0, 95.0))
    largest = max(float(apart.max() - middle), float(middle - apart.min()))
    sigma = SIGMA_OF_MAD * float(np.median(np.abs(apart - middle)))
    offset = ClockOffset(
        offset_ns=base + round(middle),
        spread_ns=round(high - low),
        rows=utc_ns.size,
        largest_ns=round(largest),
        sigma_ns=round(sigma) if sigma > LARGEST_SIGMA_NS else 0,
    )
    if largest <= LARGEST_SPREAD_NS:
        return offset
    is_far = np.abs(apart - middle) > LARGEST_SPREAD_NS
    return replace(
        offset,
        far=int(np.count_nonzero(is_far)),
        first_far_ns=int(boot_ns[np.argmax(is_far)]),
        stepped=_lasts(is_far, boot_ns),
    )


def _lasts(is_far: Mask, boot_ns: TimeArray) -> bool:
    """Whether the offset of two clocks differs for so long that one of them must have stepped.

    ``is_far``: (n,) True for rows far from the median offset; ``boot_ns``: (n,) their time since
    boot. True if more than `STRAY_ROWS` successive far rows last for 10 s (for a quarter of a log
    of less than 40 s), or are the last rows of the log, so that their duration is unknown.
    """
    span_ns = float(boot_ns.max() - boot_ns.min())
    lasting_ns = min(LASTING_NS, LASTING_SHARE * span_ns)
    in_runs = _in_long_runs(is_far)
    begins = np.flatnonzero(in_runs & ~np.append(False, in_runs[:-1]))
    ends = np.flatnonzero(in_runs & ~np.append(in_runs[1:], False))
    is_long = boot_ns[ends] - boot_ns[begins] >= lasting_ns
    is_last = ends == is_far.shape[0] - 1
    return bool((is_long | is_last).any())


def new_readings(time_ns: TimeArray) -> Mask:
    """(n,) True for the first row, and where the time differs from that of the row before.

    A receiver that is logged faster than it reports repeats its time; the repetitions are late.
    """
    return np.append(np.ones(min(1, time_ns.size), np.bool_), np.diff(time_ns) != 0)


def clock_map(from_ns: TimeArray, to_ns: TimeArray) -> Callable[[TimeArray], TimeArray]:
    """A function that converts (m,) times [ns] of one clock to times of another.

    ``from_ns``, ``to_ns``: (n,) [ns] simultaneous readings of the two, n >= 1, in any order.
    Between readings the function is linear; outside it keeps the difference of the nearest reading.
    A reading of the second clock that is below an earlier one, as with senders that overtake each
    other, is raised to that one.

    >>> clock_map(np.array([0, 10]), np.array([100, 120]))(np.array([-1, 5, 12]))
    array([ 99, 110, 122])
    """
    order = np.argsort(from_ns, kind="stable")
    first_clock = from_ns[order]
    second_clock = to_ns[order]
    del order  # in long logs these arrays are the peak of memory
    np.maximum.accumulate(second_clock, out=second_clock)
    # Relative to the first reading, so that float64 has all nanoseconds.
    base_from = int(first_clock[0])
    base_to = int(second_clock[0])
    first_clock -= base_from
    second_clock -= base_to
    elapsed: Array = first_clock.astype(np.float64)
    ahead: Array = second_clock.astype(np.float64)
    ahead -= elapsed  # how much more has elapsed on the second clock
    del first_clock, second_clock

    def mapped(time_ns: TimeArray) -> TimeArray:
        since = time_ns - base_from
        shift: Array = np.interp(since.astype(np.float64), elapsed, ahead)
        return np.asarray(since + base_to + np.rint(shift).astype(np.int64), np.int64)

    return mapped


def clock_fit_note(source: str, fit: ClockOffset, where: str) -> Message:
    """Report how well the rows of a source agree on UTC; the first case that applies counts.

    * One of the clocks stepped, as the offset differs for a while: a loss.
    * Most rows scatter, so that UTC is less certain: a warning.
    * Single rows came late, or with a wrong week, which does not affect the median: a note that
      counts them.
    * All rows agree: a note.

    ``source`` : the rows that give UTC, in words. ``where`` : the boot, in words.
    """
    spread_ms = fit.spread_ns / 1e6
    largest_ms = fit.largest_ns / 1e6
    limit_ms = LARGEST_SPREAD_NS / 1e6
    if fit.stepped:
        return clock_stepped(
            where=f"{where}, first {fit.first_far_ns / 1e9:.3f} s after boot",
            far=fit.far,
            source=source,
            spread_ms=spread_ms,
            largest_ms=largest_ms,
            limit_ms=limit_ms,
        )
    if fit.sigma_ns:
        return clock_scatters(
            where=where,
            rows=fit.rows,
            source=source,
            spread_ms=spread_ms,
            largest_ms=largest_ms,
            sigma_ms=fit.sigma_ns / 1e6,
        )
    if fit.spread_ns > LARGEST_SPREAD_NS or fit.largest_ns > BOOT_STEP_NS:
        return time_fit_but_for(
            where=f"{where}, first {fit.first_far_ns / 1e9:.3f} s after boot",
            far=fit.far,
            source=source,
            spread_ms=spread_ms,
            largest_ms=largest_ms,
            limit_ms=limit_ms,
        )
    return time_fit(
        where=where,
        rows=fit.rows,
        source=source,
        spread_ms=spread_ms,
        largest_ms=largest_ms,
    )
