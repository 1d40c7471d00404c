"""How many messages each channel of an MCAP log has, and how many are missing."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from unbend.ingest.mcap import messages
from unbend.ingest.mcap.mcap_records import Messages
from unbend.messages import Ledger

CHANNEL_NUMBERS = 1 << 16  # they are 16 bits wide
LISTED_TOPICS = 8  # whose counts differ from the statistics, in the ledger


class MessageCounts:
    """Messages by channel, steps of their numbers; ``stated`` by the log's own statistics."""

    def __init__(self) -> None:
        self.counts = np.zeros(CHANNEL_NUMBERS, np.int64)
        self.orphans = 0  # messages of no channel
        self.stated: dict[int, int] = {}
        self.stated_total: int | None = None
        self._last = np.full(CHANNEL_NUMBERS, -1, np.int64)  # number
        self._last_ns = np.zeros(CHANNEL_NUMBERS, np.int64)  # log_time
        self._single_steps = np.zeros(CHANNEL_NUMBERS, np.int64)
        self._missing = np.zeros(CHANNEL_NUMBERS, np.int64)  # numbers

    def take(self, batch: Messages, names: Mapping[int, str]) -> list[int]:
        """Count some messages; returns the known channels that they are of."""
        counts = np.bincount(batch.channel, minlength=CHANNEL_NUMBERS)
        known = []
        self.orphans += batch.short
        for number in np.flatnonzero(counts).tolist():
            if number in names:
                known.append(number)
            else:
                self.orphans += int(counts[number])
        self.counts[known] += counts[known]
        if len(batch):
            self._take_sequences(batch)
        return known

    def _take_sequences(self, batch: Messages) -> None:
        """Count the steps of the numbers of each channel."""
        order = np.argsort(batch.channel, kind="stable")
        channel = batch.channel[order].astype(np.int64)
        sequence = batch.sequence[order].astype(np.int64)
        log_ns = batch.log_time[order]
        before = np.concatenate([[-1], sequence[:-1]])
        before_ns = np.concatenate([[-1], log_ns[:-1]])
        first = np.flatnonzero(np.diff(channel, prepend=-1))  # of each channel
        before[first] = self._last[channel[first]]
        before_ns[first] = self._last_ns[channel[first]]
        last = np.append(first[1:], channel.shape[0]) - 1
        self._last[channel[last]] = sequence[last]
        self._last_ns[channel[last]] = log_ns[last]
        step = np.where(before < 0, 0, sequence - before)
        np.add.at(self._single_steps, channel[step == 1], 1)
        ahead = step > 1
        # chunks in another order fill gaps that stood open; a recorder that begins anew does not
        back = (step < 0) & (log_ns < before_ns)
        moved = ahead | back
        np.add.at(self._missing, channel[moved], step[moved] - 1)

    def by_name(self, names: Mapping[int, str]) -> dict[str, int]:
        """How many messages each topic has; topics without any are left out."""
        result: Counter[str] = Counter()
        for number in np.flatnonzero(self.counts).tolist():
            result[names[number]] += int(self.counts[number])
        return result

    def report(self, names: Mapping[int, str], ledger: Ledger, where: str, *, damaged: bool) -> int:
        """Enter what is missing; returns how many messages that is."""
        if self.orphans:
            ledger.add(messages.no_channel_of_messages(file=where, count=self.orphans))
        skipped = self._report_skipped(names, ledger)
        if self.stated_total is None:
            if not damaged:
                ledger.add(messages.no_statistics(file=where))
            return skipped
        read = int(self.counts.sum())
        differ = self._differing_channels()
        if read != self.stated_total or differ:
            topics = [names.get(number, f"channel {number}") for number in differ[:LISTED_TOPICS]]
            ledger.add(
                messages.statistics_differ(
                    file=where, read=read, stated=self.stated_total, topics=topics
                )
            )
        return max(self.stated_total - read, skipped, 0)

    def _report_skipped(self, names: Mapping[int, str], ledger: Ledger) -> int:
        """Enter the messages that are missing by their numbers; returns how many."""
        skipped = 0
        for number in np.flatnonzero(self._missing > 0).tolist():
            counts_its_messages = 2 * self._single_steps[number] >= self.counts[number]
            if counts_its_messages and number in names:
                count = int(self._missing[number])
                skipped += count
                ledger.add(messages.lost_by_recorder(topic=names[number], count=count))
        return skipped

    def _differing_channels(self) -> list[int]:
        """The channels that have another count than the log's statistics state."""
        if not self.stated:
            return []
        present = np.flatnonzero(self.counts).tolist()
        differ = []
        for number in sorted({*self.stated, *present}):
            if self.stated.get(number, 0) != self.counts[number]:
                differ.append(number)
        return differ
