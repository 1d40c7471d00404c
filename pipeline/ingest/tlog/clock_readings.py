"""What the clocks of senders in a telemetry log show, sampled while it is scanned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import STRAY_ROWS, UNIX_US_FROM
from pipeline.ingest.boot_clock import microseconds
from pipeline.ingest.buffers import ColumnStore

MILLISECOND, MICROSECOND = 1_000_000, 1_000  # [ns]

# How much of a clock is kept: a message without a time of its own is placed between two samples.
# The link shifts it by 55 ms to 2 s (p5 to p95 in real logs), which more samples would not mend.
SAMPLE_MS = 50
DELAY_US = 10_000
STEADY_MS = 1000

Key = tuple[int, int]
"""A sender: system and component."""

_READING = np.dtype(
    [("at", "i8"), ("host_us", "i8"), ("source", "u2"), ("boot_ms", "u4"), ("unix_us", "u8")]
)
_KINDS = {"at": "i8", "source": "u2", "host_ns": "i8", "boot_ns": "i8", "utc_ns": "i8"}


class Sampler:
    """What the clocks of the senders show, taken from messages while a log is scanned.

    Each sender's clock is looked at every `SAMPLE_MS`; every `STEADY_MS` while the ground station's
    clock stays as far behind it within `DELAY_US`; and at all messages with UTC.
    """

    def __init__(self) -> None:
        self.rows = ColumnStore(_READING)

    def take(self, timed: Sequence[NDArray[Any]]) -> None:
        """Look at messages with ``time_boot_ms``, the next ones of the file."""
        if not timed:
            return
        rows = np.zeros(sum(part.shape[0] for part in timed), _READING)
        done = 0
        for part in timed:
            piece = rows[done : done + part.shape[0]]
            for name in ("at", "host_us", "source"):
                piece[name] = part[name]
            piece["boot_ms"] = part["records"]["time_boot_ms"]
            if "time_unix_usec" in (part["records"].dtype.names or ()):
                piece["unix_us"] = part["records"]["time_unix_usec"]
            done += part.shape[0]
        kept = _telling(rows[np.lexsort((rows["at"], rows["source"]))])
        self.rows.add(kept[np.argsort(kept["at"], kind="stable")])

    def readings(self, systems: Set[int]) -> Readings | None:
        """What was taken from senders of these systems."""
        columns = {name: ColumnStore(kind) for name, kind in _KINDS.items()}
        for block in self.rows.drained():
            rows = block[np.isin(block["source"] >> 8, sorted(systems))]
            unix_us = microseconds(rows["unix_us"])
            columns["at"].add(rows["at"])
            columns["source"].add(rows["source"])
            columns["host_ns"].add(rows["host_us"] * MICROSECOND)
            columns["boot_ns"].add(rows["boot_ms"].astype(np.int64) * MILLISECOND)
            columns["utc_ns"].add(np.where(unix_us > UNIX_US_FROM, unix_us * MICROSECOND, 0))
        if not len(columns["at"]):
            return None
        return Readings(**{name: store.whole() for name, store in columns.items()})


def _telling(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The samples to keep, of rows sorted by sender."""
    host_ms = rows["host_us"] // 1000
    first = _changes(rows["source"]) | _changes(rows["boot_ms"] // SAMPLE_MS)
    rows = rows[first | _changes(host_ms // SAMPLE_MS) | (rows["unix_us"] > 0)]
    boot_ms = rows["boot_ms"].astype(np.int64)
    delay = (rows["host_us"] - boot_ms * 1000) // DELAY_US
    jumps = _changes(rows["source"])
    jumps[1:] |= np.abs(np.diff(boot_ms)) > STEADY_MS
    changed = _changes(delay) | _changes(boot_ms // STEADY_MS)
    keep = changed | np.append(changed[1:], True) | (rows["unix_us"] > 0)
    for row in np.flatnonzero(jumps).tolist():  # whether it is a glitch, their number tells
        keep[max(row - STRAY_ROWS - 1, 0) : row + STRAY_ROWS + 1] = True
    return np.asarray(rows[keep])


def _changes(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Where a value is not that of the row before."""
    return np.append(True, column[1:] != column[:-1])


def by_source(rows: NDArray[Any]) -> Iterator[tuple[Key, NDArray[np.bool_] | slice]]:
    """The senders of messages, and which are theirs."""
    sources = np.unique(rows["source"])
    for number in sources.tolist():
        mine = slice(None) if sources.shape[0] == 1 else rows["source"] == number
        yield divmod(number, 256), mine


@dataclass(frozen=True)
class Readings:
    """What clocks of senders showed, (n,) in the order of the file.

    ``at`` byte offset; ``source`` system times 256 plus component; ``host_ns`` the ground
    station's clock; ``boot_ns`` since boot; ``utc_ns`` or 0.
    """

    at: NDArray[np.int64]
    source: NDArray[np.uint16]
    host_ns: TimeArray
    boot_ns: TimeArray
    utc_ns: TimeArray

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Readings:
        """The readings of a mask or an index."""
        if rows.dtype == np.bool_ and bool(rows.all()):
            return self
        return Readings(**{name: column[rows] for name, column in vars(self).items()})
