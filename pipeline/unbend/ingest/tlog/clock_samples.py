"""Samples of the clocks of the senders of a telemetry log, taken while it is scanned."""

from collections.abc import Iterator, Sequence, Set
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import STRAY_ROWS, UNIX_US_FROM
from unbend.ingest.boot_clock import microseconds
from unbend.ingest.buffers import ColumnStore
from unbend.units import Mask

MILLISECOND, MICROSECOND = 1_000_000, 1_000  # [ns]


# Density of the samples of a clock: a message without a time of its own lies between two of them.
# The link delays it by 55 ms to 2 s (p5 to p95 in real logs), so more samples are no gain.
SAMPLE_MS = 50


DELAY_US = 10_000


STEADY_MS = 1000


Key = tuple[int, int]  # a sender: system and component


READING = np.dtype(
    [("at", "i8"), ("host_us", "i8"), ("source", "u2"), ("boot_ns", "i8"), ("utc_ns", "i8")]
)
"""A sample of a sender's clock: ``at`` byte offset; ``host_us`` the ground station's clock;
``source`` system times 256 plus component; ``boot_ns`` since boot; ``utc_ns`` or 0."""


Readings = NDArray[Any]  # (n,) samples of `READING` in the order of the file


class Sampler:
    """Samples of the senders' clocks, taken from messages while a log is scanned.

    Each is sampled every `SAMPLE_MS`, or `STEADY_MS` while its difference from the ground station's
    is constant within `DELAY_US`, and at all messages with UTC.
    """

    def __init__(self) -> None:
        self.rows = ColumnStore(READING)

    def take(self, timed: Sequence[NDArray[Any]]) -> None:
        """Sample the next messages of the file, which have ``time_boot_ms``."""
        if not timed:
            return
        rows = np.zeros(sum(part.shape[0] for part in timed), READING)
        done = 0
        for part in timed:
            piece = rows[done : done + part.shape[0]]
            for name in ("at", "host_us", "source"):
                piece[name] = part[name]
            piece["boot_ns"] = part["records"]["time_boot_ms"].astype(np.int64) * MILLISECOND
            if "time_unix_usec" in (part["records"].dtype.names or ()):
                piece["utc_ns"] = microseconds(part["records"]["time_unix_usec"])  # for now
            done += part.shape[0]
        rows = rows[np.lexsort((rows["at"], rows["source"]))]
        host_ms, boot_ms = rows["host_us"] // 1000, rows["boot_ns"] // MILLISECOND
        first = _changes(rows["source"]) | _changes(boot_ms // SAMPLE_MS)
        sampled = first | _changes(host_ms // SAMPLE_MS) | (rows["utc_ns"] > 0)
        rows, boot_ms = rows[sampled], boot_ms[sampled]
        delay = (rows["host_us"] - boot_ms * 1000) // DELAY_US
        jumps = _changes(rows["source"])
        jumps[1:] |= np.abs(np.diff(boot_ms)) > STEADY_MS
        changed = _changes(delay) | _changes(boot_ms // STEADY_MS)
        keep = changed | np.append(changed[1:], True) | (rows["utc_ns"] > 0)
        for row in np.flatnonzero(jumps).tolist():  # the number of rows after it shows a glitch
            keep[max(row - STRAY_ROWS - 1, 0) : row + STRAY_ROWS + 1] = True
        kept = rows[keep]
        unix_us = kept["utc_ns"]
        kept["utc_ns"] = np.where(unix_us > UNIX_US_FROM, unix_us * MICROSECOND, 0)
        self.rows.add(kept[np.argsort(kept["at"], kind="stable")])

    def readings(self, systems: Set[int]) -> Readings:
        """The samples of the senders of these systems; all are used up."""
        chosen = ColumnStore(READING)
        for block in self.rows.drained():
            chosen.add(block[np.isin(block["source"] >> 8, sorted(systems))])
        return chosen.whole()


def _changes(column: NDArray[Any]) -> Mask:
    """Where a value is not that of the row before."""
    return np.append(True, column[1:] != column[:-1])


def by_source(rows: NDArray[Any]) -> Iterator[tuple[Key, Mask | slice]]:
    """The senders of messages, and the rows of each."""
    sources = np.unique(rows["source"])
    for number in sources.tolist():
        of_source = slice(None) if sources.shape[0] == 1 else rows["source"] == number
        yield divmod(number, 256), of_source
