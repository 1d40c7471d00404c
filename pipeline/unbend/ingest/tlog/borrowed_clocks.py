"""Senders without a clock of their own: whether that of another component fits."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.clock import UNIX_US_FROM
from unbend.ingest.boot_clock import microseconds
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.tlog.clock_samples import MICROSECOND, READING, Key, Readings, by_source
from unbend.ingest.tlog.sender_clocks import (
    CLOCK_FIELDS,
    EARLIEST_NS,
    LATEST_NS,
    Clocks,
    _fit_sender,
    clock_field,
)
from unbend.messages import Ledger
from unbend.units import Integers

OWN_UTC = "time_utc"


def with_borrowed_clocks(clocks: Clocks, sent: Sequence[ColumnStore], ledger: Ledger) -> Clocks:
    """The clocks, with one for each sender whose times do not fit the clock it would borrow.

    The UTC that images carry is not used where it does not fit the time of their reception.
    """
    late: dict[Key, list[tuple[Readings, int]]] = {}
    for store in sent:
        names = store.dtype["records"].names or ()
        field = clock_field(names)
        for block in store.blocks() if field else ():
            for source, of_source in by_source(block):
                if source in clocks.senders and OWN_UTC not in names:
                    continue
                rows, (unit, turn) = block[of_source], CLOCK_FIELDS[field]
                raw = microseconds(rows["records"][field])
                part = np.empty(rows.shape, READING)
                for name in ("at", "source", "host_us"):
                    part[name] = rows[name]
                part["boot_ns"] = np.where(raw < UNIX_US_FROM, raw * unit, 0)
                part["utc_ns"] = unix_us(rows["records"]) * MICROSECOND
                late.setdefault(source, []).append((part, turn))
    for source, parts in sorted(late.items()):
        clocks = _with_checked_clock(clocks, source, parts, ledger)
    return clocks


def unix_us(records: NDArray[Any]) -> Integers:
    """The UTC that images carry [us]; 0 where they have none."""
    if OWN_UTC not in (records.dtype.names or ()):
        return np.zeros(records.shape, np.int64)
    raw = microseconds(records[OWN_UTC])
    return np.asarray(np.where(raw > UNIX_US_FROM, raw, 0), np.int64)


def _with_checked_clock(
    clocks: Clocks, source: Key, parts: Sequence[tuple[Readings, int]], ledger: Ledger
) -> Clocks:
    """The clocks after the delay of one sender's messages is checked, by their UTC and by boot."""
    where = f"system {source[0]}, component {source[1]}"
    delay, by_utc, clock = [], [], clocks.of(source)
    for part, turn in parts:
        at, host_ns, boot_ns = part["at"], part["host_us"] * MICROSECOND, part["boot_ns"]
        received = clock.utc_of_host(at, host_ns)
        has_utc = part["utc_ns"] > 0
        by_utc.append((received - part["utc_ns"])[has_utc])
        rest = ~has_utc & (boot_ns > 0)
        stamped = clock.utc_of_boot(at[rest], host_ns[rest], boot_ns[rest], turn)
        delay.append(received[rest] - stamped)
    late = np.concatenate(by_utc)
    if late.size and not EARLIEST_NS <= np.median(late) <= LATEST_NS:
        ledger.loss("TIME-OWN-UTC", where=where, count=late.size, late=_seconds(late))
        clocks = replace(clocks, wrong_utc=clocks.wrong_utc | {source})
        for part, _ in parts:
            part["utc_ns"] = 0
        return _with_checked_clock(clocks, source, parts, ledger)
    late = np.concatenate(delay)
    if source in clocks.senders or not late.size:
        return clocks
    count, lender = int(late.size), clocks.lender(source)
    if lender is None:
        ledger.fallback("TIME-HOST-CLOCK", where=where, count=count)
        return clocks
    late_by = _seconds(late)
    if EARLIEST_NS <= np.median(late) <= LATEST_NS:
        ledger.note("TIME-BORROWED", where=where, count=count, lender=lender[1], late=late_by)
        return clocks
    ledger.loss("TIME-BORROWED/not", where=where, count=count, lender=lender[1], late=late_by)
    joined = np.concatenate([part[part["boot_ns"] > 0] for part, _ in parts])
    joined = joined[np.argsort(joined["at"], kind="stable")]
    sender = _fit_sender(joined, clocks.of(source), source, ledger)
    return replace(clocks, senders={**clocks.senders, source: sender})


def _seconds(late: TimeArray) -> str:
    return f"{float(np.median(late)) / 1e9:.1f} s"
