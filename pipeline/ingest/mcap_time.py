"""The time of messages in MCAP logs: stamps of any form, and PX4's clock since boot."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import (
    LAST_US,
    UNIX_US_FROM,
    Offset,
    boots_of,
    fit_offset,
    fresh,
    report_fit,
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
    """The stamps [ns] of decoded messages, and whether they count from a boot.

    Parameters
    ----------
    columns : (n,) the fields as decoded; ``field`` names one of type Time, or microseconds.

    A Time gives 0 where the message has none. Microseconds below 1e15 count from the boot.
    """
    if f"{field}.sec" in columns:
        part = columns.get(f"{field}.nanosec", columns.get(f"{field}.nsec", np.int64(0)))
        whole = columns[f"{field}.sec"].astype(np.int64)
        time_ns = whole * NANOSECONDS_PER_SECOND + np.asarray(part).astype(np.int64)
        return np.asarray(time_ns, np.int64), False
    if field in columns and columns[field].dtype.kind in "iu":
        raw = np.minimum(columns[field].astype(np.uint64), np.uint64(LAST_US)).astype(np.int64)
        return raw * 1000, bool(np.any((raw > 0) & (raw < UNIX_US_FROM)))
    n = next((column.shape[0] for column in columns.values()), 0)
    return np.zeros(n, np.int64), False


class BootClock:
    """PX4's clock since boot -> UTC, by its GNSS messages, or by when they were recorded."""

    def __init__(self, readings: Iterable[tuple[TimeArray, TimeArray]], ledger: Ledger) -> None:
        """``readings`` are UTC and time since boot [ns] of the messages that have both."""
        self.ledger = ledger
        self.boots = 1
        self.fits: dict[int, Offset] = {}
        for utc_ns, boot_ns in readings:
            boot = boots_of(boot_ns)
            told = utc_ns > UNIX_US_FROM * 1000
            for number in np.unique(boot[told]).tolist():
                mine = told & (boot == number)
                mine[mine] = fresh(utc_ns[mine])
                fit = fit_offset(utc_ns[mine], boot_ns[mine])
                if fit is not None and number not in self.fits:
                    self.fits[number] = fit
                    report_fit(ledger, "GNSS messages", fit.spread_ns, f"boot {number}", fit.rows)

    def utc(
        self, boot_ns: TimeArray, log_ns: TimeArray, where: str
    ) -> tuple[TimeArray, NDArray[np.int16]]:
        """UTC [ns] and boot of a topic's messages, in the order of the file."""
        boot = boots_of(boot_ns)
        time_ns = boot_ns.copy()
        for number in np.unique(boot).tolist():
            mine = boot == number
            fit = self.fits.get(number)
            if fit is None:
                fit = fit_offset(log_ns[mine], boot_ns[mine])
                self.ledger.fallback(
                    "TIME-LOG-TIME",
                    f"time counts from boot {number}, and no GNSS message ties that to UTC: the "
                    "clock is set by the recorder's time",
                    where=where,
                    count=int(np.count_nonzero(mine)),
                )
            time_ns[mine] += fit.offset_ns if fit is not None else 0
        self.boots = max(self.boots, int(boot.max()) + 1 if boot.shape[0] else 1)
        return time_ns, boot
