"""Samples of the clocks of the senders of a telemetry log, taken while it is scanned."""

from collections.abc import Sequence, Set
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.timelines import microseconds
from unbend.ingest.tlog.senders import systems_of
from unbend.ingest.utc_evidence import FIRST_SET_US
from unbend.units import Mask

MILLISECOND = 1_000_000  # [ns]
MICROSECOND = 1_000  # [ns]

# Density of the samples of a clock: a message without a time is between two of them.
# The link delays it by 55 ms to 2 s (p5 to p95 in real logs), so more samples are no gain.
SAMPLE_MS = 50
DELAY_US = 10_000  # a delay of the link that differs by less is constant
STEADY_MS = 1000  # between samples while the delay is constant

READING = np.dtype(
    [
        ("place", "i8"),  # byte offset of the message
        ("host_us", "i8"),  # the ground station's clock
        ("source", "u2"),  # `Sender.number`
        ("boot_ns", "i8"),  # time since boot
        ("utc_ns", "i8"),  # 0 without UTC
    ]
)
"""A sample of a sender's clock."""

Readings = NDArray[Any]  # (n,) samples of `READING` in the order of the file


class Sampler:
    """Samples of the senders' clocks, taken from messages while a log is scanned.

    Each is sampled every `SAMPLE_MS`, or `STEADY_MS` while its difference from the ground station's
    is constant within `DELAY_US`, and at all messages with UTC.
    """

    def __init__(self) -> None:
        self.rows = ColumnStore(READING)

    def take(self, timed: Sequence[NDArray[Any]]) -> None:
        """Sample the next messages of the file, which have ``time_boot_ms``, type by type."""
        if not timed:
            return
        readings = np.concatenate([_readings_of(part) for part in timed])
        order = np.lexsort((readings["place"], readings["source"]))  # by sender, then by place
        by_sender = readings[order]
        sampled = by_sender[_is_sampled(by_sender)]
        kept = sampled[_is_kept(sampled)]
        in_file_order = np.argsort(kept["place"], kind="stable")
        self.rows.add(kept[in_file_order])

    def readings(self, systems: Set[int]) -> Readings:
        """The samples of the senders of these systems; the sampler is emptied."""
        chosen = ColumnStore(READING)
        sorted_systems = sorted(systems)
        for block in self.rows.drained():
            system = systems_of(block["source"])
            is_chosen = np.isin(system, sorted_systems)
            chosen.add(block[is_chosen])
        return chosen.whole()


def _readings_of(messages: NDArray[Any]) -> Readings:
    """(n,) readings of the senders' clocks from (n,) messages of one type."""
    records = messages["records"]
    rows = np.zeros(messages.shape[0], READING)
    for name in ("place", "host_us", "source"):
        rows[name] = messages[name]
    rows["boot_ns"] = records["time_boot_ms"].astype(np.int64) * MILLISECOND
    if "time_unix_usec" in (records.dtype.names or ()):
        unix_us = microseconds(records["time_unix_usec"])
        rows["utc_ns"] = np.where(unix_us > FIRST_SET_US, unix_us * MICROSECOND, 0)
    return rows


def _is_sampled(rows: Readings) -> Mask:
    """Which readings, sorted by sender, are the first of a sampling interval or have UTC.

    An interval begins where either clock, the sender's or the ground station's, begins one.
    """
    host_ms = rows["host_us"] // 1000
    boot_ms = rows["boot_ns"] // MILLISECOND
    sampled = _changes(rows["source"])
    sampled |= _changes(boot_ms // SAMPLE_MS)
    sampled |= _changes(host_ms // SAMPLE_MS)
    sampled |= rows["utc_ns"] > 0
    return np.asarray(sampled, np.bool_)


def _is_kept(rows: Readings) -> Mask:
    """Which samples, sorted by sender, to keep:

    - The two on both sides of each change of the delay, and of each second.
    - Samples with UTC.
    - Some rows around each jump of a clock, and around the first sample of each sender.
    """
    boot_ms = rows["boot_ns"] // MILLISECOND
    delay_step = (rows["host_us"] - boot_ms * 1000) // DELAY_US
    changed = _changes(delay_step) | _changes(boot_ms // STEADY_MS)
    before_change = np.append(changed[1:], True)
    kept = np.asarray(changed | before_change | (rows["utc_ns"] > 0), np.bool_)
    jumps = _changes(rows["source"])
    jumps[1:] |= np.abs(np.diff(boot_ms)) > STEADY_MS
    for row in np.flatnonzero(jumps).tolist():  # how many rows follow a jump shows a glitch
        first = max(row - STRAY_ROWS - 1, 0)
        last = row + STRAY_ROWS
        kept[first : last + 1] = True
    return kept


def _changes(column: NDArray[Any]) -> Mask:
    """Which rows have another value than the row before; the first row counts as changed."""
    is_new = column[1:] != column[:-1]
    return np.append(True, is_new)
