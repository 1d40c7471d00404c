"""Checks if the date of a log is possible, by other sources of the date; how good each clock is.

A receiver that counts weeks modulo 1024 gives a date 19.6 years early; an autopilot without a fix
gives the time at which its clock started. One rule applies to all formats. A date that another
clock of the log confirms is used, moved by rollovers if that makes both agree. An impossible date
that nothing confirms is moved if there is only one way to make it possible, else it is not used.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from unbend.flight.channels import TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK, UNIX_NS_FROM, WEEKS_PER_ROLLOVER
from unbend.flight.survey_dates import DAY_NS, latest_ns
from unbend.units import NANOSECONDS_PER_SECOND, Mask

ROLLOVER_NS = WEEKS_PER_ROLLOVER * SECONDS_PER_WEEK * NANOSECONDS_PER_SECOND

# 2010-01-01: the first flights of the autopilots with logs that are read were in that year.
EARLIEST_NS = 1_262_304_000 * NANOSECONDS_PER_SECOND
# 1981-01-06: a field of UTC that is earlier was never set. A year after the GPS epoch, with which
# receivers begin.
FIRST_SET_US = 347_500_800 * 1_000_000
# Clocks of a log agree on the date within this: a ground station may be set by hand, and a file may
# be named on the day of its download. A rollover is 239 times as long.
SAME_DATE_NS = 30 * DAY_NS
ROLLOVERS = (1, 2, -1)  # missed by a receiver, or (-1) counted too many; the most usual first

# Clocks of four ground stations differed from the GPS time in the same logs by 0.1, 1.3, 2.1 and
# 8.1 s: 4.2 s RMS, rounded up. Recorders on board and autopilots without a fix are set alike.
UNCHECKED_SIGMA_S = 5.0
UNCHECKED_WHY = "set by hand or by a network: such clocks differed from GPS time by 0.1 to 8 s"

_DATE_IN_NAME = re.compile(r"(?<!\d)(20\d\d)[-_.]?(\d\d?)[-_.]?(\d\d?)(?!\d)")


@dataclass(frozen=True)
class Witness:
    """Another source of the date of a log: its ``name`` in words, and its UTC [Unix ns].

    ``is_weak``: it knows the day at best, like the name of a file.
    """

    name: str
    time_ns: int
    is_weak: bool = False


def is_possible(time_ns: int) -> bool:
    """Whether a log can have been written at a time [Unix ns]: since 2010, and not in the future.

    >>> is_possible(1_700_000_000 * 10**9), is_possible(476_000_000 * 10**9)  # 2023, 1985
    (True, False)
    """
    return EARLIEST_NS <= time_ns <= latest_ns()


def missed_rollovers(
    time_ns: int, witnesses: Sequence[Witness], *, of_receiver: bool = True
) -> int | None:
    """How many rollovers of the GPS week a stated time [Unix ns] lacks; None: it is not usable.

    ``witnesses``: other clocks, the strongest first; a witness with an impossible date is ignored.
    ``of_receiver``: False for a clock that no receiver sets. The first rule that applies decides:

    - A witness agrees with the time moved by 0, 1, 2 or -1 rollovers: that number.
    - The stated date is possible: 0.
    - There are witnesses, but none agrees: None.
    - The clock is not ``of_receiver``: None, because it may never have been set.
    - Only one number of rollovers makes the date possible: that number. Else None.

    >>> june_2010 = 1_276_000_000 * 10**9
    >>> missed_rollovers(june_2010, []), missed_rollovers(june_2010 - ROLLOVER_NS, [])
    (0, 1)
    >>> missed_rollovers(june_2010, [Witness("log_time", june_2010 + ROLLOVER_NS // 3)])
    0
    """
    possible_witnesses = [witness for witness in witnesses if is_possible(witness.time_ns)]
    for witness in possible_witnesses:
        for rollovers in (0, *ROLLOVERS):
            moved_ns = time_ns + rollovers * ROLLOVER_NS
            if is_possible(moved_ns) and abs(moved_ns - witness.time_ns) <= SAME_DATE_NS:
                return rollovers
    if is_possible(time_ns):
        return 0
    if possible_witnesses or not of_receiver:
        return None
    return _only_rollovers(time_ns)


def _only_rollovers(time_ns: int) -> int | None:
    """The only number of rollovers (1 or 2) that makes a time possible; None if none or both do."""
    possible = [n for n in ROLLOVERS if n > 0 and is_possible(time_ns + n * ROLLOVER_NS)]
    return possible[0] if len(possible) == 1 else None


def date_in_name(name: str) -> Witness | None:
    """The date in the name of a file, as noon of that day; None without a valid date.

    >>> date_in_name("log_12_2019-3-4-12-30-12.ulg").name
    "the file's name"
    >>> date_in_name("00000042.BIN") is None
    True
    """
    for year, month, day in _DATE_IN_NAME.findall(name):
        try:
            day_in_name = date(int(year), int(month), int(day))
        except ValueError:
            continue
        noon_ns = (day_in_name - date(1970, 1, 1)).days * DAY_NS + DAY_NS // 2
        return Witness("the file's name", noon_ns, is_weak=True)
    return None


def is_utc(time_ns: TimeArray) -> Mask:
    """(n,) True for times [ns] of a log that are UTC; the others count from a boot.

    No log has a UTC before `EARLIEST_NS` (2010), and no time since boot reaches the year 2001.
    """
    return np.asarray(time_ns >= UNIX_NS_FROM, np.bool_)


def is_utc_time(time_ns: int) -> bool:
    """Whether a single time [ns] of a log is UTC, as by `is_utc`."""
    return time_ns >= UNIX_NS_FROM


def date_text(time_ns: int) -> str:
    """The day of a time [Unix ns], UTC.

    >>> date_text(1_482_451_200_000_000_000)
    '2016-12-23'
    """
    return str(np.datetime64(int(time_ns), "ns").astype("datetime64[D]"))


@dataclass(frozen=True)
class ClockAssessment:
    """How good a clock of a log is, and if it is used.

    clock : its name and boot.
    use : "UTC of the log", "compared", "not used" or "counts from boot".
    utc : the day that it states.
    apart_s : its UTC minus the UTC of the log [s].
    sigma_s : of its UTC [s]; None where unknown.
    why : the reason for this sigma.
    """

    clock: str
    use: str
    utc: str | None
    apart_s: float | None
    sigma_s: float | None
    why: str
