"""The clocks of a telemetry log: each sender's boots, and its time in UTC.

A sender's messages carry time since its boot; its SYSTEM_TIME ties that to UTC. The stamps of the
log are the ground station's clock: seconds off UTC and unsteady by the radio link, so they serve
only to place messages without a time of their own among those that have one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import (
    LAST_US,
    STRAY_ROWS,
    UNIX_US_FROM,
    along,
    boots_of,
    fit_offset,
    report_fit,
    stray_times,
)
from pipeline.ingest.store import Store
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND

Key = tuple[int, int]

MILLISECOND, MICROSECOND = 1_000_000, 1_000  # [ns]
ROUND_MS = (1 << 32) * MILLISECOND  # 49.7 days: a 32-bit count of milliseconds runs over
ROUND_US = (1 << 32) * MICROSECOND  # 71.6 minutes: one of microseconds
# How far a stamp that ran over may lie from where the sender's clock is: exposures are reported up
# to some seconds late, and a minute is a seventieth of the shorter round.
NEAR_NS = 60 * 1_000_000_000


# How much of a clock is kept: a message without a time of its own is placed between two samples.
# The link shifts it by 55 ms to 2 s (p5 to p95 in real logs), which more samples would not mend.
SAMPLE_MS = 50
DELAY_US = 10_000
STEADY_MS = 1000

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
        self.rows = Store(_READING)

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
        columns = {name: Store(kind) for name, kind in _KINDS.items()}
        for block in self.rows.drained():
            rows = block[np.isin(block["source"] >> 8, sorted(systems))]
            unix_us = np.minimum(rows["unix_us"], LAST_US).astype(np.int64)
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


@dataclass(frozen=True)
class _Sender:
    """One sender's clock.

    ``at``, ``boot_ns`` and ``boot`` (n,), the last from 0: what it showed each second, and at the
    begin of each boot, in the order of the log. By boot: ``offsets``, UTC minus time since boot
    [ns]; ``in_utc``, whether that rests on the sender's own SYSTEM_TIME; ``counts`` of readings;
    ``maps`` from the ground station's clock to UTC.
    """

    at: NDArray[np.int64]
    boot_ns: TimeArray
    boot: NDArray[np.int16]
    offsets: NDArray[np.int64]
    in_utc: NDArray[np.bool_]
    counts: tuple[int, ...]
    maps: tuple[Callable[[TimeArray], TimeArray], ...]

    def before(self, at: NDArray[np.int64]) -> NDArray[np.intp]:
        """The reading that stands before each place of the file, or the first."""
        return np.maximum(np.searchsorted(self.at, at, side="right") - 1, 0)

    def boot_at(self, at: NDArray[np.int64]) -> NDArray[np.int16]:
        return self.boot[self.before(at)]

    def utc_of_host(self, host_ns: TimeArray, boot: NDArray[np.int16]) -> TimeArray:
        result = host_ns.copy()
        for number in np.unique(boot):
            asked = boot == number
            result[asked] = self.maps[int(number)](host_ns[asked])
        return result


@dataclass(frozen=True)
class Clocks:
    """All senders of a log. ``boots`` of the vehicle; ``words`` for the time base."""

    senders: Mapping[Key, _Sender]
    boots: int
    words: str

    def _of(self, source: Key) -> _Sender | None:
        """The sender's own clock, else that of another component of its system."""
        if source in self.senders:
            return self.senders[source]
        same = [key for key in self.senders if key[0] == source[0]]
        return max((self.senders[key] for key in same), key=lambda s: sum(s.counts), default=None)

    def boot(self, source: Key, at: NDArray[np.int64]) -> NDArray[np.int16]:
        """The boot of messages at these places of the file."""
        sender = self._of(source)
        return np.zeros(at.shape, np.int16) if sender is None else sender.boot_at(at)

    def utc_of_host(self, source: Key, at: NDArray[np.int64], host_ns: TimeArray) -> TimeArray:
        """UTC [ns] of messages without a time of their own."""
        sender = self._of(source)
        return host_ns if sender is None else sender.utc_of_host(host_ns, sender.boot_at(at))

    def utc_of_boot(
        self, source: Key, at: NDArray[np.int64], host_ns: TimeArray, boot_ns: TimeArray, turn: int
    ) -> TimeArray:
        """UTC [ns] of times since boot; without a clock of this sender, the log's own stamps.

        ``turn`` is the time [ns] after which a count of 32 bits begins again.
        """
        sender = self._of(source)
        if sender is None:
            return host_ns
        near = sender.before(at)
        since = unrolled(boot_ns, sender.boot_ns[near], turn)
        return np.asarray(since + sender.offsets[sender.boot[near]], np.int64)


def unrolled(stamp_ns: TimeArray, near_ns: TimeArray, turn: int) -> TimeArray:
    """Stamps of a counter that ran over, made whole where they then fit the sender's clock.

    Parameters
    ----------
    stamp_ns : (n,) [ns] as sent.
    near_ns : (n,) [ns] what the sender's clock showed about then, counted without end.
    turn : [ns] after which the counter begins again.

    >>> unrolled(np.array([5 * 10**9]), np.array([ROUND_US + 4 * 10**9]), ROUND_US) - ROUND_US
    array([5000000000])
    """
    behind = near_ns - stamp_ns
    if not behind.shape[0] or int(behind.max()) <= turn // 2:
        return stamp_ns
    turns = np.rint(behind / turn).astype(np.int64)
    whole = stamp_ns + turns * turn
    fits = (turns > 0) & (np.abs(whole - near_ns) < NEAR_NS)
    return np.asarray(np.where(fits, whole, stamp_ns), np.int64)


def clocks_of(readings: Readings | None, ledger: Ledger) -> Clocks:
    """Fit the clocks of all senders; how well, and what they fall back on, is in the ledger."""
    if readings is None:
        ledger.fallback(
            "TIME-HOST-CLOCK",
            "no message carries the vehicle's time: the ground station's clock is used, "
            "which may be seconds off UTC",
        )
        return Clocks({}, 1, "ground station clock")
    unique, counts = np.unique(readings.source, return_counts=True)
    busiest = [divmod(key, 256) for key in unique[np.argsort(-counts, kind="stable")].tolist()]
    vehicle = busiest[0]
    senders: dict[Key, _Sender] = {}
    for source in busiest:
        mine = readings.take(readings.source == source[0] * 256 + source[1])
        leader = senders.get(vehicle) if vehicle[0] == source[0] else None
        sender, spread_ns = _fit(mine, leader, source, ledger)
        senders[source] = sender
        _report(source, sender, spread_ns, ledger)
    boots = senders[vehicle].offsets.shape[0]
    return Clocks(senders, boots, _words(senders[vehicle]))


def _fit(
    mine: Readings, leader: _Sender | None, source: Key, ledger: Ledger
) -> tuple[_Sender, list[int]]:
    """A sender's clock, and by boot how far the rows scatter about it (p95 - p5) [ns]."""
    mine = mine.take(~stray_times(mine.boot_ns))  # a glitch of the clock is no boot
    boot_ns = _counted_on(mine, source, ledger)
    boot = boots_of(boot_ns)
    offsets, in_utc, spreads, maps = [], [], [], []
    counts = np.bincount(boot).tolist()
    for number, count in enumerate(counts):
        rows = slice(sum(counts[:number]), sum(counts[:number]) + count)
        told = mine.utc_ns[rows] > 0
        fit = fit_offset(mine.utc_ns[rows][told], boot_ns[rows][told])
        in_utc.append(fit is not None)
        if fit is None:
            stamps = mine.host_ns[rows]
            if leader is not None:
                stamps = leader.utc_of_host(stamps, leader.boot_at(mine.at[rows]))
            fit = fit_offset(stamps, boot_ns[rows])
        offsets.append(0 if fit is None else fit.offset_ns)
        spreads.append(0 if fit is None else fit.spread_ns)
        maps.append(along(mine.host_ns[rows], boot_ns[rows] + offsets[-1]))
    mark = np.ones(boot.shape, np.bool_)
    mark[1:] = (np.diff(boot_ns // NANOSECONDS_PER_SECOND) != 0) | (np.diff(boot) != 0)
    sender = _Sender(
        mine.at[mark], boot_ns[mark], boot[mark], np.array(offsets, np.int64),
        np.array(in_utc, np.bool_), tuple(counts), tuple(maps),
    )  # fmt: skip
    return sender, spreads


def _counted_on(mine: Readings, source: Key, ledger: Ledger) -> TimeArray:
    """Times since boot that go on where a 32-bit count of milliseconds ran over."""
    if mine.at.shape[0] < 2:
        return mine.boot_ns
    step = np.diff(mine.boot_ns)
    # A new boot starts near zero too, but not just when the host's clock says that the count was
    # full. A message that was overtaken shows the time before the turn: a step back by a turn.
    turn = np.rint(-step / ROUND_MS).astype(np.int64)
    turn[np.abs(step + turn * ROUND_MS - np.diff(mine.host_ns)) > NEAR_NS] = 0
    if not turn.any():
        return mine.boot_ns
    turns = np.concatenate([[0], np.cumsum(turn)])
    ledger.note(
        "TIME-WRAP",
        f"the 32-bit count of milliseconds since boot ran over after 49.7 days, "
        f"{int(turns.max())} times: it is counted on",
        where=f"system {source[0]}, component {source[1]}",
        count=int(turns.max()),
    )
    return np.asarray(mine.boot_ns + turns * ROUND_MS, np.int64)


def _report(source: Key, sender: _Sender, spread_ns: Sequence[int], ledger: Ledger) -> None:
    for number, known in enumerate(sender.in_utc.tolist()):
        count = sender.counts[number]
        where = f"system {source[0]}, component {source[1]}, boot {number}"
        scatter = f"they agree within {spread_ns[number] / 1e6:.0f} ms (p5 to p95)"
        if known:
            report_fit(ledger, "SYSTEM_TIME messages", spread_ns[number], where, count)
        else:
            ledger.fallback(
                "TIME-HOST-CLOCK",
                f"no SYSTEM_TIME with UTC: the clock is set by the stamps of {count} messages, "
                f"which are the ground station's and may be seconds off UTC; {scatter}",
                where=where,
                count=count,
            )


def _words(sender: _Sender) -> str:
    boots = int(sender.offsets.shape[0])
    known = int(np.count_nonzero(sender.in_utc))
    if known == boots:
        return "vehicle clock, set to UTC by the median of SYSTEM_TIME"
    if known == 0:
        return "vehicle clock, set by the ground station's clock"
    return f"vehicle clock, set to UTC by SYSTEM_TIME in {known} of {boots} boots"
