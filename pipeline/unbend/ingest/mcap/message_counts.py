"""How many messages each channel of an MCAP log has, and how many are missing."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from unbend.ingest.mcap import messages
from unbend.ingest.mcap.message_batches import Messages
from unbend.messages import Ledger
from unbend.units import Integers, Rows

CHANNEL_NUMBERS = 1 << 16  # they are 16 bits wide
LISTED_TOPICS = 8  # of those with other counts than the statistics, in the ledger


class MessageCounts:
    """How many messages each channel has, and how many numbers are missing in its sequence.

    ``stated`` and ``stated_total`` are the counts of the log's own statistics, by channel and in
    all: empty and None without statistics.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(CHANNEL_NUMBERS, np.int64)
        self.orphans = 0  # messages of no channel
        self.stated: dict[int, int] = {}
        self.stated_total: int | None = None
        self._last_number = np.full(CHANNEL_NUMBERS, -1, np.int64)  # -1 before the first message
        self._last_ns = np.zeros(CHANNEL_NUMBERS, np.int64)  # log_time of the last message
        self._single_steps = np.zeros(CHANNEL_NUMBERS, np.int64)
        self._missing_numbers = np.zeros(CHANNEL_NUMBERS, np.int64)

    def take(
        self,
        batch: Messages,
        names: Mapping[int, str],
    ) -> list[int]:
        """Count the messages of a batch; returns the numbers of its channels that are defined.

        ``names``: the topics of the channels defined so far, by number. Messages of other channels,
        and records too short to be messages, are counted as orphans.
        """
        counts = np.bincount(batch.channel, minlength=CHANNEL_NUMBERS)
        defined = []
        self.orphans += batch.too_short
        for number in np.flatnonzero(counts).tolist():
            if number in names:
                defined.append(number)
            else:
                self.orphans += int(counts[number])
        self.counts[defined] += counts[defined]
        if len(batch):
            self._take_sequences(batch)
        return defined

    def _take_sequences(self, batch: Messages) -> None:
        """Count, for each channel, single steps and gaps of the numbers from message to message."""
        order = np.argsort(batch.channel, kind="stable")
        channel = batch.channel[order].astype(np.int64)
        number = batch.sequence[order].astype(np.int64)
        log_ns = batch.log_time[order]
        first_of_channel = np.flatnonzero(np.diff(channel, prepend=-1))
        channels = channel[first_of_channel]
        # the last values of earlier batches are read before those of this one replace them
        number_before = _value_before(number, first_of_channel, self._last_number[channels])
        log_before_ns = _value_before(log_ns, first_of_channel, self._last_ns[channels])
        end_of_channel = np.append(first_of_channel[1:], channel.shape[0])
        last_of_channel = end_of_channel - 1
        self._last_number[channels] = number[last_of_channel]
        self._last_ns[channels] = log_ns[last_of_channel]

        step = number - number_before
        step[number_before < 0] = 0  # of a first message
        is_single = step == 1
        np.add.at(self._single_steps, channel[is_single], 1)
        # Chunks in another order fill gaps that were counted before: in 1 2 5 6 3 4 7 the steps 3,
        # -3 and 3 add 2, -4 and 2 missing numbers. A recorder that counts anew fills no gap.
        fills_gap = (step < 0) & (log_ns < log_before_ns)
        is_gap = (step > 1) | fills_gap
        missing = step[is_gap] - 1
        np.add.at(self._missing_numbers, channel[is_gap], missing)

    def by_name(self, names: Mapping[int, str]) -> dict[str, int]:
        """How many messages each topic has; topics without any are left out.

        ``names``: the topics of the channels, by number. Channels of one topic count together.
        """
        result: Counter[str] = Counter()
        for number in np.flatnonzero(self.counts).tolist():
            topic = names[number]
            result[topic] += int(self.counts[number])
        return result

    def report(
        self,
        names: Mapping[int, str],
        ledger: Ledger,
        where: str,
        *,
        damaged: bool,
    ) -> int:
        """Report missing messages; returns how many are missing.

        Missing are the sequence numbers that are skipped, or, if that is more, the messages that
        the statistics of the log count beyond those read. ``names``: topics by channel number.
        ``damaged``: parts of the log could not be read; missing statistics are then not reported,
        because they may have been among these parts.
        """
        if self.orphans:
            orphans = messages.no_channel_of_messages(file=where, count=self.orphans)
            ledger.add(orphans)
        skipped = self._report_skipped(names, ledger)
        if self.stated_total is None:
            if not damaged:
                ledger.add(messages.no_statistics(file=where))
            return skipped
        read = int(self.counts.sum())
        differing = self._differing_channels()
        if read != self.stated_total or differing:
            listed = differing[:LISTED_TOPICS]
            topics = [names.get(number, f"channel {number}") for number in listed]
            differ = messages.statistics_differ(
                file=where,
                read=read,
                stated=self.stated_total,
                topics=topics,
            )
            ledger.add(differ)
        return max(self.stated_total - read, skipped)

    def _report_skipped(
        self,
        names: Mapping[int, str],
        ledger: Ledger,
    ) -> int:
        """Report the messages that are missing by their sequence numbers; returns how many.

        A channel in which fewer than half of the messages have the number after that of the message
        before is left out: its numbers do not count messages.
        """
        skipped = 0
        for number in np.flatnonzero(self._missing_numbers > 0).tolist():
            is_numbered = 2 * self._single_steps[number] >= self.counts[number]
            if is_numbered and number in names:
                topic = names[number]
                count = int(self._missing_numbers[number])
                skipped += count
                ledger.add(messages.lost_by_recorder(topic=topic, count=count))
        return skipped

    def _differing_channels(self) -> list[int]:
        """The numbers of the channels with another count than the log's statistics state."""
        if not self.stated:
            return []
        with_messages = np.flatnonzero(self.counts).tolist()
        differing = []
        for number in sorted({*self.stated, *with_messages}):
            stated_count = self.stated.get(number, 0)
            if stated_count != self.counts[number]:
                differing.append(number)
        return differing


def _value_before(
    values: Integers,
    first_of_channel: Rows,
    of_last_batches: Integers,
) -> Integers:
    """(n,) the value of the message before each in its channel, for messages sorted by channel.

    ``of_last_batches`` are the values before the first of each channel, from earlier batches.
    """
    before = np.empty_like(values)
    before[1:] = values[:-1]
    before[first_of_channel] = of_last_batches
    return before
