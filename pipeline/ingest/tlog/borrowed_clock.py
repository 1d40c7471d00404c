"""Senders without a clock of their own: cameras and gimbals, which only answer and report.

Their times since boot may be those of the autopilot's clock, to which MAVLink cameras are set, or
of their own; a camera may carry UTC besides. When its messages were received tells which it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import UNIX_US_FROM
from pipeline.ingest.boot_clock import microseconds
from pipeline.ingest.buffers import ColumnStore
from pipeline.ingest.tlog.clock import CLOCK_FIELDS, EARLIEST_NS, LATEST_NS, Clocks, clock_field
from pipeline.ingest.tlog.clock_readings import MICROSECOND, Key, Readings, by_source
from pipeline.ledger import Ledger

OWN_UTC = "time_utc"


def borrowed(clocks: Clocks, sent: Sequence[ColumnStore], ledger: Ledger) -> Clocks:
    """The clocks, with one for each sender whose times do not fit the clock that it would borrow.

    Parameters
    ----------
    sent : the messages of each type that become channels.

    Also doubts the UTC that images carry, where it does not fit when they were received.
    """
    late: dict[Key, list[tuple[Readings, int]]] = {}
    for store in sent:
        names = store.dtype["records"].names or ()
        field = clock_field(names)
        for block in store.blocks() if field else ():
            for source, mine in by_source(block):
                if source not in clocks.senders or OWN_UTC in names:
                    part = _readings(block[mine], field), CLOCK_FIELDS[field][1]
                    late.setdefault(source, []).append(part)
    for source, parts in sorted(late.items()):
        clocks = _judged(clocks, source, parts, ledger)
    return clocks


def _readings(rows: NDArray[Any], field: str) -> Readings:
    raw = microseconds(rows["records"][field])
    boot_ns = np.where(raw < UNIX_US_FROM, raw * CLOCK_FIELDS[field][0], 0)
    utc_us = unix_us(rows["records"])
    return Readings(
        rows["at"], rows["source"], rows["host_us"] * MICROSECOND, boot_ns, utc_us * MICROSECOND
    )


def unix_us(records: NDArray[Any]) -> NDArray[np.int64]:
    """The UTC that images carry [us]; 0 where they have none."""
    if OWN_UTC not in (records.dtype.names or ()):
        return np.zeros(records.shape, np.int64)
    raw = microseconds(records[OWN_UTC])
    return np.asarray(np.where(raw > UNIX_US_FROM, raw, 0), np.int64)


def _judged(
    clocks: Clocks, source: Key, parts: Sequence[tuple[Readings, int]], ledger: Ledger
) -> Clocks:
    """The clocks, when it is known what the times of one sender mean."""
    where = f"system {source[0]}, component {source[1]}"
    delay, by_utc = [], []
    for mine, turn in parts:
        received = clocks.utc_of_host(source, mine.at, mine.host_ns)
        told = mine.utc_ns > 0
        by_utc.append((received - mine.utc_ns)[told])
        rest = mine.take(~told & (mine.boot_ns > 0))
        stamped = clocks.utc_of_boot(source, rest.at, rest.host_ns, rest.boot_ns, turn)
        delay.append(received[~told & (mine.boot_ns > 0)] - stamped)
    late = np.concatenate(by_utc)
    if late.size and not EARLIEST_NS <= np.median(late) <= LATEST_NS:
        ledger.loss(
            "TIME-OWN-UTC",
            f"the UTC of {late.size} images is {_seconds(late)} before they were received: that "
            "camera's clock is wrong, its time since boot is used",
            where=where,
            count=int(late.size),
        )
        clocks = replace(clocks, doubted=clocks.doubted | {source})
        parts = [(replace(mine, utc_ns=np.zeros_like(mine.utc_ns)), turn) for mine, turn in parts]
        return _judged(clocks, source, parts, ledger)
    late = np.concatenate(delay)
    if source in clocks.senders or not late.size:
        return clocks
    return _with_lender(clocks, source, [mine for mine, _ in parts], late, where, ledger)


def _with_lender(
    clocks: Clocks, source: Key, parts: Sequence[Readings], late: TimeArray, where: str,
    ledger: Ledger,
) -> Clocks:  # fmt: skip
    lender = clocks.lender(source)
    if lender is None:
        ledger.fallback(
            "TIME-HOST-CLOCK",
            f"no clock of this system is known: {late.size} messages have the time at which they "
            "were received, by a ground station's clock that may be seconds off UTC",
            where=where,
            count=int(late.size),
        )
        return clocks
    if EARLIEST_NS <= np.median(late) <= LATEST_NS:
        ledger.note(
            "TIME-BORROWED",
            f"it has no clock of its own: the times of {late.size} messages are taken as those of "
            f"component {lender[1]}, which fits as they were received {_seconds(late)} later",
            where=where,
            count=int(late.size),
        )
        return clocks
    ledger.loss(
        "TIME-BORROWED",
        f"the times since boot of {late.size} messages are not those of component {lender[1]}, by "
        f"which they would be {_seconds(late)} old when they were received: their clock is set by "
        "that, and exposures may be late by the delay of the link",
        where=where,
        count=int(late.size),
    )
    columns: Mapping[str, list[NDArray[Any]]] = {
        name: [vars(mine)[name] for mine in parts] for name in vars(parts[0])
    }
    joined = Readings(**{name: np.concatenate(several) for name, several in columns.items()})
    joined = joined.take(joined.boot_ns > 0)
    return clocks.with_own(source, joined.take(np.argsort(joined.at, kind="stable")), ledger)


def _seconds(late: TimeArray) -> str:
    return f"{float(np.median(late)) / 1e9:.1f} s"
