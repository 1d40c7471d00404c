"""How many messages each channel of an MCAP log has, and how many are missing."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from unbend.ingest.mcap.mcap_records import Messages
from unbend.messages import Ledger

CHANNEL_NUMBERS = 1 << 16  # they are 16 bits wide


class MessageCounts:
    """Messages by channel, steps of their numbers; ``stated`` by the log's own statistics."""

    def __init__(self) -> None:
        self.counts = np.zeros(CHANNEL_NUMBERS, np.int64)
        self.orphans = 0
        self.stated: dict[int, int] = {}
        self.stated_total: int | None = None
        self._last = np.full(CHANNEL_NUMBERS, -1, np.int64)
        self._last_ns = np.zeros(CHANNEL_NUMBERS, np.int64)
        self._ones = np.zeros(CHANNEL_NUMBERS, np.int64)
        self._gaps = np.zeros(CHANNEL_NUMBERS, np.int64)

    def take(self, messages: Messages, names: Mapping[int, str]) -> list[int]:
        """Count some messages; returns the known channels that they are of."""
        counts = np.bincount(messages.channel, minlength=CHANNEL_NUMBERS)
        present = np.flatnonzero(counts).tolist()
        known = [number for number in present if number in names]
        unknown = [number for number in present if number not in names]
        self.orphans += messages.short + int(counts[unknown].sum())
        self.counts[known] += counts[known]
        if not len(messages):
            return known
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
        return known

    def by_name(self, names: Mapping[int, str]) -> dict[str, int]:
        """How many messages each topic has; topics without any are left out."""
        result: Counter[str] = Counter()
        for number in np.flatnonzero(self.counts).tolist():
            result[names[number]] += int(self.counts[number])
        return result

    def report(self, names: Mapping[int, str], ledger: Ledger, where: str, *, damaged: bool) -> int:
        """Enter what is missing; returns how many messages that is."""
        if self.orphans:
            what = f"{self.orphans} messages belong to no channel"
            ledger.loss("LOG-BAD-BYTES", what, where=where, count=self.orphans)
        skipped = 0
        for number in np.flatnonzero(self._gaps > 0).tolist():
            if 2 * self._ones[number] < self.counts[number] or number not in names:
                continue  # its numbers do not count its messages
            count = int(self._gaps[number])
            skipped += count
            ledger.loss("LOG-LINK-LOSS", where=names[number], count=count)
        if self.stated_total is None:
            if not damaged:
                what = "the log has no statistics: whether it is whole cannot be checked"
                ledger.note("LOG-NO-STATISTICS", what, where=where)
            return skipped
        total = int(self.counts.sum())
        wrong = [
            number
            for number in sorted({*self.stated, *np.flatnonzero(self.counts).tolist()})
            if self.stated and self.stated.get(number, 0) != self.counts[number]
        ]
        if total != self.stated_total or wrong:
            apart = ", ".join(names.get(number, f"channel {number}") for number in wrong[:8])
            what = f"{total} messages were read, the log's statistics state {self.stated_total}"
            what += f"; they differ for {apart}" if apart else ""
            count = max(abs(self.stated_total - total), 1)
            ledger.loss("LOG-INCONSISTENT", what, where=where, count=count)
        return max(self.stated_total - total, skipped, 0)
