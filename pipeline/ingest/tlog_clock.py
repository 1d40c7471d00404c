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
from pipeline.ingest.tlog_frames import Frames
from pipeline.ledger import Ledger

Key = tuple[int, int]
Timed = tuple[NDArray[np.intp], TimeArray, TimeArray]


@dataclass(frozen=True)
class _Sender:
    """One sender's timed messages in the order of the log: rows (n,), host and boot time [ns].

    ``boot`` (n,) from 0; ``offsets`` UTC minus time since boot [ns] by boot, ``in_utc`` whether
    that rests on the sender's own SYSTEM_TIME.
    """

    rows: NDArray[np.intp]
    host_ns: TimeArray
    boot_ns: TimeArray
    boot: NDArray[np.int16]
    offsets: NDArray[np.int64]
    in_utc: NDArray[np.bool_]

    def boot_at(self, rows: NDArray[np.intp]) -> NDArray[np.int16]:
        before = np.searchsorted(self.rows, rows, side="right") - 1
        return self.boot[np.maximum(before, 0)]

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
    host_ns: TimeArray
    boots: int
    words: str

    def _of(self, source: Key) -> _Sender | None:
        """The sender's own clock, else that of another component of its system."""
        if source in self.senders:
            return self.senders[source]
        same = [key for key in self.senders if key[0] == source[0]]
        return max((self.senders[key] for key in same), key=lambda s: len(s.rows), default=None)

    def boot(self, source: Key, rows: NDArray[np.intp]) -> NDArray[np.int16]:
        sender = self._of(source)
        return np.zeros(rows.shape, np.int16) if sender is None else sender.boot_at(rows)

    def utc_of_host(self, source: Key, rows: NDArray[np.intp]) -> TimeArray:
        """UTC [ns] of messages without a time of their own."""
        sender = self._of(source)
        host_ns = self.host_ns[rows]
        return host_ns if sender is None else sender.utc_of_host(host_ns, sender.boot_at(rows))

    def utc_of_boot(self, source: Key, boot_ns: TimeArray, rows: NDArray[np.intp]) -> TimeArray:
        """UTC [ns] of times since boot; without a clock of this sender, the log's own stamps."""
        sender = self._of(source)
        if sender is None:
            return self.host_ns[rows]
        return np.asarray(boot_ns + sender.offsets[sender.boot_at(rows)], np.int64)


def clocks_of(timed: Sequence[Timed], frames: Frames, ledger: Ledger) -> Clocks:
    """Fit the clocks of all senders; how well, and what they fall back on, is in the ledger.

    Parameters
    ----------
    timed : (rows, time since boot [ns], UTC [ns] or 0) of each message with a time since boot.
    frames : all valid frames of the log.
    """
    host_ns = frames.host_us * 1000
    if not timed:
        ledger.fallback(
            "TIME-HOST-CLOCK",
            "no message carries the vehicle's time: the ground station's clock is used, "
            "which may be seconds off UTC",
        )
        return Clocks({}, host_ns, 1, "ground station clock")
    rows, boot_ns, utc_ns = (np.concatenate(parts) for parts in zip(*timed, strict=True))
    order = np.argsort(rows, kind="stable")
    rows, boot_ns, utc_ns = rows[order], boot_ns[order], utc_ns[order]
    keys = frames.system[rows] * 256 + frames.component[rows]
    unique, counts = np.unique(keys, return_counts=True)
    busiest = unique[np.argsort(-counts, kind="stable")].tolist()
    vehicle = _key(busiest[0])
    senders: dict[Key, _Sender] = {}
    for key in busiest:
        mine, source = keys == key, _key(key)
        leader = senders.get(vehicle) if vehicle[0] == source[0] else None
        sender, spread_ns = _fit(rows[mine], host_ns, boot_ns[mine], utc_ns[mine], leader)
        senders[source] = sender
        _report(source, sender, spread_ns, ledger)
    boots = senders[vehicle].offsets.shape[0]
    return Clocks(senders, host_ns, boots, _words(senders[vehicle]))


def _key(number: int) -> Key:
    return number // 256, number % 256


def _fit(
    rows: NDArray[np.intp],
    host_ns: TimeArray,
    boot_ns: TimeArray,
    utc_ns: TimeArray,
    leader: _Sender | None,
) -> tuple[_Sender, list[int]]:
    """A sender's clock, and by boot how far the rows scatter about it (p95 - p5) [ns]."""
    steady = ~stray_times(boot_ns)  # a glitch of the sender's clock is no boot
    rows, boot_ns, utc_ns = rows[steady], boot_ns[steady], utc_ns[steady]
    host_ns = host_ns[rows]
    boot = boots_of(boot_ns)
    offsets, in_utc, spreads = [], [], []
    for number in range(int(boot.max()) + 1):
        mine = boot == number
        told = mine & (utc_ns > 0)
        fit = fit_offset(utc_ns[told], boot_ns[told])
        in_utc.append(fit is not None)
        if fit is None:
            stamps = host_ns[mine]
            if leader is not None:
                stamps = leader.utc_of_host(stamps, leader.boot_at(rows[mine]))
            fit = fit_offset(stamps, boot_ns[mine])
        offsets.append(0 if fit is None else fit.offset_ns)
        spreads.append(0 if fit is None else fit.spread_ns)
    sender = _Sender(
        rows, host_ns, boot_ns, boot, np.array(offsets, np.int64), np.array(in_utc, np.bool_)
    )
    return sender, spreads


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
