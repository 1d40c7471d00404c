"""The clocks of a telemetry log: each sender's boots, and its time in UTC.

A sender's messages carry time since its boot; its SYSTEM_TIME ties that to UTC. The stamps of the
log are the ground station's clock: seconds off UTC and unsteady by the radio link, so they serve
only to place messages without a time of their own among those that have one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import along, boots_of, fit_offset, report_fit, stray_times
from pipeline.ledger import Ledger

Key = tuple[int, int]

MILLISECOND, MICROSECOND = 1_000_000, 1_000  # [ns]
ROUND_MS = (1 << 32) * MILLISECOND  # 49.7 days: a 32-bit count of milliseconds runs over
ROUND_US = (1 << 32) * MICROSECOND  # 71.6 minutes: one of microseconds
# How far a stamp that ran over may lie from where the sender's clock is: exposures are reported up
# to some seconds late, and a minute is a seventieth of the shorter round.
NEAR_NS = 60 * 1_000_000_000


@dataclass(frozen=True)
class Readings:
    """Messages with a time since boot, (n,) in the order of the file.

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
    """One sender's readings in the order of the log.

    ``boot`` (n,) from 0; ``offsets`` UTC minus time since boot [ns] by boot, ``in_utc`` whether
    that rests on the sender's own SYSTEM_TIME.
    """

    at: NDArray[np.int64]
    host_ns: TimeArray
    boot_ns: TimeArray
    boot: NDArray[np.int16]
    offsets: NDArray[np.int64]
    in_utc: NDArray[np.bool_]

    def before(self, at: NDArray[np.int64]) -> NDArray[np.intp]:
        """The reading that stands before each place of the file, or the first."""
        return np.maximum(np.searchsorted(self.at, at, side="right") - 1, 0)

    def boot_at(self, at: NDArray[np.int64]) -> NDArray[np.int16]:
        return self.boot[self.before(at)]

    def utc_of_host(self, host_ns: TimeArray, boot: NDArray[np.int16]) -> TimeArray:
        result = host_ns.copy()
        for number in np.unique(boot):
            mine = self.boot == number
            asked = boot == number
            to_utc = along(self.host_ns[mine], self.boot_ns[mine] + self.offsets[number])
            result[asked] = to_utc(host_ns[asked])
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
        return max((self.senders[key] for key in same), key=lambda s: len(s.at), default=None)

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
    offsets, in_utc, spreads = [], [], []
    for number in range(int(boot.max()) + 1):
        rows = boot == number
        told = rows & (mine.utc_ns > 0)
        fit = fit_offset(mine.utc_ns[told], boot_ns[told])
        in_utc.append(fit is not None)
        if fit is None:
            stamps = mine.host_ns[rows]
            if leader is not None:
                stamps = leader.utc_of_host(stamps, leader.boot_at(mine.at[rows]))
            fit = fit_offset(stamps, boot_ns[rows])
        offsets.append(0 if fit is None else fit.offset_ns)
        spreads.append(0 if fit is None else fit.spread_ns)
    known = np.array(in_utc, np.bool_)
    sender = _Sender(mine.at, mine.host_ns, boot_ns, boot, np.array(offsets, np.int64), known)
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
        count = int(np.count_nonzero(sender.boot == number))
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
