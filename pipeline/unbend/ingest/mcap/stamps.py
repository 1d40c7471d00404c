"""Times of the messages of MCAP logs, in any form."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.clock import BOOT_STEP_NS, UNIX_NS_FROM
from unbend.ingest.boot_clock import (
    BootClock,
    nanoseconds,
)
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Mask, Rows

Columns = Mapping[str, NDArray[Any]]


STAMP, LOG_TIME, SEQUENCE = "\0stamp_ns", "\0log_ns", "\0sequence"
"""Columns beside the fields: a message's own time and log_time [ns], and its number."""


_LAST_NS = 2**63 - 1


_ISO = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d+))?(Z|[+-]\d\d:\d\d)?")


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


# A bare number is Unix time in the unit in which it lies between 1973 and 2286.
_UNITS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))


def stamp_of(value: Any) -> int:
    """Unix time [ns] of a time in JSON or protobuf; 0 when there is none.

    Seconds and nanoseconds, a number of seconds (or ms, us, ns: by its size), or RFC 3339.

    >>> stamp_of("2026-05-01T10:00:00.5Z"), stamp_of(1.5e9), stamp_of({"sec": 1, "nsec": 2})
    (1777629600500000000, 1500000000000000000, 1000000002)
    """
    if isinstance(value, bool) or value is None:
        return 0
    if isinstance(value, str):
        match = _ISO.fullmatch(value.strip())
        if not match:
            return 0
        seconds, fraction, zone = match.groups()
        moment = datetime.fromisoformat(seconds + ("+00:00" if zone in (None, "Z") else zone))
        time_ns = (moment - _EPOCH) // timedelta(seconds=1) * NANOSECONDS_PER_SECOND
        time_ns += int((fraction or "0")[:9].ljust(9, "0"))
    elif isinstance(value, int | float):
        if not abs(value) < 1e19:  # also not a number
            return 0
        factor = next(factor for least, factor in _UNITS if abs(value) >= least)
        time_ns = int(value) * factor + round((value - int(value)) * factor)
    else:
        whole = _first(value, ("sec", "secs", "seconds"))
        part = _first(value, ("nsec", "nsecs", "nanosec", "nanos"))
        time_ns = int(whole) * NANOSECONDS_PER_SECOND + int(part)
    return min(max(time_ns, 0), _LAST_NS)


def _first(value: Any, names: tuple[str, ...]) -> Any:
    for name in names:
        member = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
        if member is not None:
            return member
    return 0


def in_sequence(sequence: NDArray[np.uint32], time_ns: TimeArray) -> Rows | None:
    """The order by (n,) numbers, where that puts times right that step back, else None.

    Numbers that repeat or contradict the times are of a recorder that counts anew, or a set clock.

    >>> in_sequence(np.array([0, 1, 4, 2], np.uint32), np.array([10, 11, 14, 12]))
    array([0, 1, 3, 2])
    """
    if bool(np.all(time_ns[1:] >= time_ns[:-1])):
        return None
    order = np.argsort(sequence, kind="stable")
    numbers, times = sequence[order], time_ns[order]
    rise = np.all(numbers[1:] > numbers[:-1]) and np.all(times[1:] >= times[:-1])
    return order if bool(rise) else None


def own_times(columns: Columns, time_field: str, count: int) -> tuple[TimeArray, bool]:
    """The messages' own times [ns], 0 without, and whether they are counted in microseconds.

    ``time_field`` names a Time of the (count,) columns, or microseconds from a boot or 1970.
    """
    if STAMP in columns:
        return columns[STAMP], False
    if f"{time_field}.sec" in columns:
        seconds = columns[f"{time_field}.sec"].astype(np.int64)
        names = [f"{time_field}.{name}" for name in ("nanosec", "nsec")]
        part = next((columns[name] for name in names if name in columns), np.int64(0))
        time_ns = seconds * NANOSECONDS_PER_SECOND + np.asarray(part).astype(np.int64)
        return np.asarray(time_ns, np.int64), False
    if time_field in columns and columns[time_field].dtype.kind in "iu":
        return nanoseconds(columns[time_field]), True
    return np.zeros(count, np.int64), False


def since_boot(stamp_ns: TimeArray) -> Mask:
    """Which counted stamps count from a boot; 0 is none, and large ones are Unix time."""
    return np.asarray((stamp_ns > 0) & (stamp_ns < UNIX_NS_FROM), np.bool_)


def good_rows(places: TimeArray, stamp_ns: TimeArray, clock: BootClock) -> Mask:
    """Which messages of a topic, at (n,) places and stamps [ns], have a time that fits the log.

    One that fits none of its neighbours there may have come late: it is used where it lies between
    its neighbours of the same topic, and within the times of the log.
    """
    line, counted = clock.line, since_boot(stamp_ns)
    good = np.asarray(line.good(places) | ~counted, np.bool_)
    misfits = np.flatnonzero(~good)
    if not misfits.size:
        return good
    boots, first, last = line.boot_of(places), line.begin[~line.stray], line.end[~line.stray]
    for number in np.unique(boots[misfits]).tolist():
        of_boot = line.boot[~line.stray] == number
        known = np.flatnonzero(good & counted & (boots == number))
        low, high = first[of_boot].min() - BOOT_STEP_NS, last[of_boot].max() + BOOT_STEP_NS
        bounds = np.concatenate([[low], stamp_ns[known], [high]])
        rows = misfits[boots[misfits] == number]
        after = np.searchsorted(known, rows)
        good[rows] = (bounds[after] < stamp_ns[rows]) & (stamp_ns[rows] < bounds[after + 1])
    return good


def times_of(
    stamp_ns: TimeArray, log_ns: TimeArray, places: TimeArray | None, clock: BootClock,
    *, ledger: Ledger, where: str,
) -> tuple[TimeArray, NDArray[np.int16], int]:  # fmt: skip
    """UTC [ns], boot, and how many messages have no time of their own: it is the recorder's.

    ``places`` of messages whose stamps are counted in microseconds, None of others.
    """
    none = stamp_ns == 0
    boot = np.zeros(stamp_ns.shape, np.int16)
    early = stamp_ns < UNIX_NS_FROM
    if places is not None:
        counted = since_boot(stamp_ns)
        boot = clock.line.boot_of(places)
        stamp_ns = np.where(counted, clock.utc(places, stamp_ns), stamp_ns)
        early &= ~counted
    count = int(np.count_nonzero(none))
    if count:
        what = f"{count} messages have no header.stamp: the recorder's time is used"
        ledger.fallback("TIME-LOG-TIME", what, where=where, count=count)
        stamp_ns[none] = log_ns[none]
        early[none] = log_ns[none] < UNIX_NS_FROM
    if bool(early.any()):
        ledger.fallback("TIME-NO-UTC/times-of", where=where)
    return stamp_ns, boot, count
