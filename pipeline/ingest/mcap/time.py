"""The time of messages in MCAP logs: stamps of any form, and PX4's clock since boot."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import BOOT_STEP_NS
from pipeline.ingest.boot_clock import (
    BootClock,
    Timeline,
    UtcReadings,
    fit_boot_clock,
    microseconds,
)
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND

_LAST_NS = 2**63 - 1
_ISO = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d+))?(Z|[+-]\d\d:\d\d)?")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

# A bare number is Unix time in the unit in which it lies between 1973 and 2286.
_UNITS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))

Columns = Mapping[str, NDArray[Any]]


def stamp_of(value: Any) -> int:
    """Unix time [ns] of a time in JSON or protobuf; 0 when there is none.

    Seconds and nanoseconds, a number of seconds (or ms, us, ns: by its size), or RFC 3339.

    >>> stamp_of("2026-05-01T10:00:00.5Z"), stamp_of(1.5e9), stamp_of({"sec": 1, "nsec": 2})
    (1777629600500000000, 1500000000000000000, 1000000002)
    """
    if isinstance(value, bool) or value is None:
        return 0
    if isinstance(value, str):
        return _rfc3339(value)
    if isinstance(value, int | float):
        return _number(value)
    whole = _first(value, ("sec", "secs", "seconds"))
    part = _first(value, ("nsec", "nsecs", "nanosec", "nanos"))
    return _bounded(int(whole) * NANOSECONDS_PER_SECOND + int(part))


def _first(value: Any, names: tuple[str, ...]) -> Any:
    for name in names:
        found = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
        if found is not None:
            return found
    return 0


def _number(value: float) -> int:
    if not abs(value) < 1e19:  # also not a number
        return 0
    factor = next(factor for least, factor in _UNITS if abs(value) >= least)
    whole = int(value)
    return _bounded(whole * factor + round((value - whole) * factor))


def _rfc3339(text: str) -> int:
    found = _ISO.fullmatch(text.strip())
    if not found:
        return 0
    seconds, fraction, zone = found.groups()
    moment = datetime.fromisoformat(seconds + ("+00:00" if zone in (None, "Z") else zone))
    whole = (moment - _EPOCH) // timedelta(seconds=1)
    return _bounded(whole * NANOSECONDS_PER_SECOND + int((fraction or "0")[:9].ljust(9, "0")))


def _bounded(time_ns: int) -> int:
    return min(max(time_ns, 0), _LAST_NS)


def stamps(columns: Columns, field: str) -> tuple[TimeArray, bool]:
    """The stamps [ns] of decoded messages, and whether they are counted in microseconds.

    Parameters
    ----------
    columns : (n,) the fields as decoded; ``field`` names one of type Time, or microseconds.

    A Time gives 0 where the message has none. Microseconds may be Unix time or count from a boot.
    """
    if f"{field}.sec" in columns:
        part = columns.get(f"{field}.nanosec", columns.get(f"{field}.nsec", np.int64(0)))
        whole = columns[f"{field}.sec"].astype(np.int64)
        time_ns = whole * NANOSECONDS_PER_SECOND + np.asarray(part).astype(np.int64)
        return np.asarray(time_ns, np.int64), False
    if field in columns and columns[field].dtype.kind in "iu":
        return microseconds(columns[field]) * 1000, True
    n = next((column.shape[0] for column in columns.values()), 0)
    return np.zeros(n, np.int64), False


def confirmed(line: Timeline, topics: Iterable[tuple[TimeArray, TimeArray]]) -> Timeline:
    """The boots at which some topic itself steps back, of those that all together show.

    Messages that come late, and chunks that hold one topic each, step back only against others.

    Parameters
    ----------
    topics : places and times since boot [ns] of each.
    """
    starts = np.flatnonzero(np.diff(line.boot) > 0) + 1
    seen = np.zeros(starts.shape, np.bool_)
    for places, boot_ns in topics if starts.size else ():
        row = np.searchsorted(places, line.first[starts])
        inner = (row > 0) & (row < places.shape[0])
        seen[inner] |= boot_ns[row[inner]] < boot_ns[row[inner] - 1] - BOOT_STEP_NS
    marks = np.zeros(line.boot.shape, np.int16)
    marks[starts] = seen
    return replace(line, boot=np.cumsum(marks, dtype=np.int16))


def clock_of(
    line: Timeline,
    receivers: Sequence[UtcReadings],
    cameras: Sequence[UtcReadings],
    recorder: UtcReadings | None,
    ledger: Ledger,
) -> BootClock:
    """UTC of the clock since boot that PX4's messages count.

    Parameters
    ----------
    line : the boots, by the messages of all topics together.
    receivers, cameras : what they say of UTC. A camera's is the autopilot's own clock, which it
        sets by its receiver now and then: it counts where no receiver has a fix.
    recorder : log_time of these messages, for boots that nothing else ties to UTC; None where no
        message counts time since boot.
    """
    if recorder is None:
        return BootClock(line, (None,), (False,))
    known = any(one.sound(line).places.shape[0] for one in receivers)
    clock = fit_boot_clock(line, receivers if known else cameras, ledger, recorder)
    for number, (fit, told) in enumerate(zip(clock.fits, clock.utc_known, strict=True)):
        if told:
            continue
        where = f"boot {number}"
        if fit is not None:
            ledger.fallback(
                "TIME-LOG-TIME",
                "time counts from boot, and no GNSS message with a fix ties that to UTC: the clock "
                "is set by the recorder's time",
                where=where,
                count=fit.rows,
            )
        else:
            ledger.fallback(
                "TIME-NO-UTC",
                "no GNSS message with a fix and no log_time: time counts from boot, as if in 1970; "
                "events in this log can be used, matching by UTC is impossible",
                where=where,
            )
    return clock
