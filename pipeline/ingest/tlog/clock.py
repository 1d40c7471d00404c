"""The clocks of a telemetry log: each sender's boots, and its time in UTC.

A sender's messages carry time since its boot; its SYSTEM_TIME ties that to UTC. The stamps of the
log are the ground station's clock: seconds off UTC and unsteady by the radio link, so they serve
only to place messages without a time of their own among those that have one.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import clock_map, stray_times
from pipeline.ingest.boot_clock import BootClock, UtcReadings, fit_boot_clock, timeline
from pipeline.ingest.tlog.clock_readings import MICROSECOND, MILLISECOND, Key, Readings
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND

ROUND_MS = (1 << 32) * MILLISECOND  # 49.7 days: a 32-bit count of milliseconds runs over
ROUND_US = (1 << 32) * MICROSECOND  # 71.6 minutes: one of microseconds

CLOCK_FIELDS: Mapping[str, tuple[int, int]] = {
    "time_boot_ms": (MILLISECOND, ROUND_MS),
    "time_usec": (MICROSECOND, ROUND_US),
}
"""Fields with a time since boot: their unit [ns], and after what time [ns] they begin again."""

# How far a stamp that ran over may lie from where the sender's clock is: exposures are reported up
# to some seconds late, and a minute is a seventieth of the shorter round.
NEAR_NS = 60 * NANOSECONDS_PER_SECOND
# A message that is stamped on arrival comes after what it tells of, and not much: links and
# cameras delay by up to some seconds, the link's jitter is 2 s at most in real logs.
EARLIEST_NS, LATEST_NS = -2 * NANOSECONDS_PER_SECOND, 10 * NANOSECONDS_PER_SECOND


@dataclass(frozen=True)
class _Sender:
    """One sender's clock.

    ``at`` and ``boot_ns`` (n,): what it showed each second, and at the begin of each boot, in the
    order of the log; ``clock`` its boots and their UTC. By boot: ``counts`` of readings, ``maps``
    from the ground station's clock to UTC.
    """

    at: NDArray[np.int64]
    boot_ns: TimeArray
    clock: BootClock
    counts: tuple[int, ...]
    maps: tuple[Callable[[TimeArray], TimeArray], ...]

    def near(self, at: NDArray[np.int64]) -> TimeArray:
        """The reading that stands before each place of the file, or the first."""
        row = np.maximum(np.searchsorted(self.at, at, side="right") - 1, 0)
        return np.asarray(self.boot_ns[row], np.int64)

    def utc_of_host(self, at: NDArray[np.int64], host_ns: TimeArray) -> TimeArray:
        boot, result = self.clock.line.boot_of(at), host_ns.copy()
        for number in np.unique(boot):
            asked = boot == number
            result[asked] = self.maps[int(number)](host_ns[asked])
        return result


@dataclass(frozen=True)
class Clocks:
    """All senders of a log. ``boots`` of the vehicle; ``words`` for the time base.

    ``doubted`` are senders whose own UTC, which images carry, is not to be believed.
    """

    senders: Mapping[Key, _Sender]
    boots: int
    words: str
    doubted: frozenset[Key] = frozenset()

    def lender(self, source: Key) -> Key | None:
        """Whose clock serves a sender: its own, else that of another component of its system."""
        if source in self.senders:
            return source
        same = [key for key in self.senders if key[0] == source[0]]
        return max(same, key=lambda key: sum(self.senders[key].counts), default=None)

    def _of(self, source: Key) -> _Sender | None:
        lender = self.lender(source)
        return None if lender is None else self.senders[lender]

    def boot(self, source: Key, at: NDArray[np.int64]) -> NDArray[np.int16]:
        """The boot of messages at these places of the file."""
        sender = self._of(source)
        return np.zeros(at.shape, np.int16) if sender is None else sender.clock.line.boot_of(at)

    def ran_on(self, source: Key, at: int, least_ns: int) -> bool:
        """Whether a sender's clock goes on by so much at a place of the file, within a boot.

        It does not at a restart, nor where only the ground station's clock was set. True where the
        sender shows no clock.
        """
        sender = self.senders.get(source)
        if sender is None:
            return True
        row = int(np.searchsorted(sender.at, at))
        if not 0 < row < sender.at.shape[0]:
            return True
        boots = sender.clock.line.boot_of(sender.at[row - 1 : row + 1])
        step = int(sender.boot_ns[row] - sender.boot_ns[row - 1])
        return bool(boots[0] == boots[1]) and step >= least_ns

    def placed(self, source: Key, at: NDArray[np.int64], boot_ns: TimeArray) -> NDArray[np.int64]:
        """Places whose boot is that of times since boot: the first messages of a boot may come
        before the first that shows its clock, to which they are moved.
        """
        sender = self._of(source)
        if sender is None or sender.clock.line.boots == 1:
            return at
        row = np.maximum(np.searchsorted(sender.at, at, side="right") - 1, 0)
        after = np.minimum(row + 1, sender.at.shape[0] - 1)
        line = sender.clock.line
        closer = np.abs(boot_ns - sender.boot_ns[after]) < np.abs(boot_ns - sender.boot_ns[row])
        closer &= line.boot_of(sender.at[after]) != line.boot_of(at)
        return np.asarray(np.where(closer, sender.at[after], at), np.int64)

    def utc_of_host(self, source: Key, at: NDArray[np.int64], host_ns: TimeArray) -> TimeArray:
        """UTC [ns] of messages without a time of their own."""
        sender = self._of(source)
        return host_ns if sender is None else sender.utc_of_host(at, host_ns)

    def utc_of_boot(
        self, source: Key, at: NDArray[np.int64], host_ns: TimeArray, boot_ns: TimeArray, turn: int
    ) -> TimeArray:
        """UTC [ns] of times since boot; without a clock of this sender, the log's own stamps.

        ``turn`` is the time [ns] after which a count of 32 bits begins again.
        """
        sender = self._of(source)
        if sender is None:
            return host_ns
        return sender.clock.utc(at, unrolled(boot_ns, sender.near(at), turn))

    def with_own(self, source: Key, mine: Readings, ledger: Ledger) -> Clocks:
        """These clocks and one more, set by the ground station's stamps through its lender's."""
        lender = self._of(source)
        sender = _fit(mine, lender, source, ledger)
        return replace(self, senders={**self.senders, source: sender})


def clock_field(names: Container[str]) -> str:
    """The field of a message that has its time, or ""."""
    return next((name for name in CLOCK_FIELDS if name in names), "")


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
        senders[source] = _fit(mine, leader, source, ledger)
    return Clocks(senders, senders[vehicle].clock.line.boots, _words(senders[vehicle].clock))


def _fit(mine: Readings, leader: _Sender | None, source: Key, ledger: Ledger) -> _Sender:
    """A sender's clock; without UTC of its own it is set by when its messages were received."""
    where = f"system {source[0]}, component {source[1]}"
    mine = mine.take(~stray_times(mine.boot_ns))  # a glitch of the clock is no boot
    at, boot_ns = mine.at, _counted_on(mine, where, ledger)
    host_ns = mine.host_ns if leader is None else leader.utc_of_host(at, mine.host_ns)
    told = UtcReadings("SYSTEM_TIME messages", at, boot_ns, mine.utc_ns, mine.utc_ns > 0)
    received = UtcReadings("stamps", at, boot_ns, host_ns, np.ones(at.shape, np.bool_))
    clock = fit_boot_clock(timeline([(at, boot_ns)]), [told], ledger, received, where)
    boot = clock.line.boot_of(at)
    counts = np.bincount(boot, minlength=clock.line.boots).tolist()
    maps = []
    for number, count in enumerate(counts):
        rows = slice(sum(counts[:number]), sum(counts[:number]) + count)
        maps.append(clock_map(mine.host_ns[rows], clock.utc(at[rows], boot_ns[rows])))
        _report_fallback(clock, number, count, where, ledger)
    mark = np.ones(boot.shape, np.bool_)
    mark[1:] = (np.diff(boot_ns // NANOSECONDS_PER_SECOND) != 0) | (np.diff(boot) != 0)
    return _Sender(at[mark], boot_ns[mark], clock, tuple(counts), tuple(maps))


def _counted_on(mine: Readings, where: str, ledger: Ledger) -> TimeArray:
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
        where=where,
        count=int(turns.max()),
    )
    return np.asarray(mine.boot_ns + turns * ROUND_MS, np.int64)


def _report_fallback(clock: BootClock, number: int, count: int, where: str, ledger: Ledger) -> None:
    fit = clock.fits[number]
    if clock.utc_known[number] or fit is None:
        return
    ledger.fallback(
        "TIME-HOST-CLOCK",
        f"no SYSTEM_TIME with UTC: the clock is set by the stamps of {count} messages, which are "
        "the ground station's and may be seconds off UTC; they agree within "
        f"{fit.spread_ns / 1e6:.0f} ms (p5 to p95)",
        where=f"{where}, boot {number}",
        count=count,
    )


def _words(clock: BootClock) -> str:
    known, boots = clock.utc_known.count(True), len(clock.utc_known)
    if known == boots:
        return "vehicle clock, set to UTC by the median of SYSTEM_TIME"
    if known == 0:
        return "vehicle clock, set by the ground station's clock"
    return f"vehicle clock, set to UTC by SYSTEM_TIME in {known} of {boots} boots"
