"""Counting the messages of an MCAP log, and comparing with what the log says of itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.ingest.mcap.messages import Messages
from pipeline.ledger import Ledger

IDS = 1 << 16  # channel numbers are 16 bits wide


class Counts:
    """Messages by channel, and steps of their sequence numbers.

    ``promised`` by channel and ``promised_total`` are from the log's statistics, None without.
    """

    def __init__(self) -> None:
        self.found = np.zeros(IDS, np.int64)
        self.orphans = 0
        self.promised: dict[int, int] = {}
        self.promised_total: int | None = None
        self._last = np.full(IDS, -1, np.int64)
        self._last_ns = np.zeros(IDS, np.int64)
        self._ones = np.zeros(IDS, np.int64)
        self._gaps = np.zeros(IDS, np.int64)

    def take(self, messages: Messages, names: Mapping[int, str]) -> list[int]:
        """Count some messages; returns the known channels that they are of."""
        tally = np.bincount(messages.channel, minlength=IDS)
        present = np.flatnonzero(tally).tolist()
        known = [number for number in present if number in names]
        unknown = [number for number in present if number not in names]
        self.orphans += messages.short + int(tally[unknown].sum())
        self.found[known] += tally[known]
        if len(messages):
            self._follow(messages)
        return known

    def _follow(self, messages: Messages) -> None:
        order = np.argsort(messages.channel, kind="stable")
        channel = messages.channel[order].astype(np.int64)
        sequence = messages.sequence[order].astype(np.int64)
        log_ns = messages.log_time[order]
        before, before_ns = (np.concatenate([[-1], each[:-1]]) for each in (sequence, log_ns))
        first = np.flatnonzero(np.diff(channel, prepend=-1))
        before[first], before_ns[first] = self._last[channel[first]], self._last_ns[channel[first]]
        step = np.where(before < 0, 0, sequence - before)
        last = np.append(first[1:], channel.shape[0]) - 1
        self._last[channel[last]], self._last_ns[channel[last]] = sequence[last], log_ns[last]
        np.add.at(self._ones, channel[step == 1], 1)
        ahead = step > 1
        np.add.at(self._gaps, channel[ahead], step[ahead] - 1)
        # chunks in another order fill gaps that stood open; a recorder that begins anew does not
        back = (step < 0) & (log_ns < before_ns)
        np.add.at(self._gaps, channel[back], step[back] - 1)

    def by_name(self, names: Mapping[int, str]) -> dict[str, int]:
        """How many messages each topic has; topics without any are left out."""
        result: dict[str, int] = {}
        for number in np.flatnonzero(self.found).tolist():
            result[names[number]] = result.get(names[number], 0) + int(self.found[number])
        return result

    def report(self, names: Mapping[int, str], ledger: Ledger, where: str, *, damaged: bool) -> int:
        """Enter what is missing; returns how many messages that is."""
        if self.orphans:
            ledger.loss(
                "LOG-BAD-BYTES",
                f"{self.orphans} messages belong to no channel",
                where=where,
                count=self.orphans,
            )
        skipped = self._report_sequences(names, ledger)
        if self.promised_total is None:
            if not damaged:
                ledger.note(
                    "LOG-NO-STATISTICS",
                    "the log has no statistics: whether it is whole cannot be checked",
                    where=where,
                )
            return skipped
        total = int(self.found.sum())
        wrong = [
            number
            for number in sorted({*self.promised, *np.flatnonzero(self.found).tolist()})
            if self.promised and self.promised.get(number, 0) != self.found[number]
        ]
        if total != self.promised_total or wrong:
            topics = ", ".join(names.get(number, f"channel {number}") for number in wrong[:8])
            ledger.loss(
                "LOG-INCONSISTENT",
                f"{total} messages were found, the log's statistics say {self.promised_total}"
                + (f"; they differ for {topics}" if topics else ""),
                where=where,
                count=max(abs(self.promised_total - total), 1),
            )
        return max(self.promised_total - total, skipped, 0)

    def _report_sequences(self, names: Mapping[int, str], ledger: Ledger) -> int:
        """Gaps in sequence numbers, of channels whose numbers count their messages at all."""
        skipped = 0
        for number in np.flatnonzero(self._gaps > 0).tolist():
            if 2 * self._ones[number] < self.found[number] or number not in names:
                continue
            count = int(self._gaps[number])
            skipped += count
            ledger.loss(
                "LOG-LINK-LOSS",
                f"{count} messages are missing by their sequence numbers: the recorder did not "
                "get them, or they are damaged",
                where=names[number],
                count=count,
            )
        return skipped
