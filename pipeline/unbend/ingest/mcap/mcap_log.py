"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from unbend.flight.clock import BOOT_STEP_NS
from unbend.ingest.boot_clock import BootClock, Timeline, UtcReadings, fit_clock, timeline
from unbend.ingest.channel_builder import channel_of
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.mcap import messages, topics
from unbend.ingest.mcap.mcap_reader import McapReader
from unbend.ingest.mcap.mcap_records import MAGIC
from unbend.ingest.mcap.stamps import LOG_TIME, SEQUENCE, STAMP, times_of
from unbend.ingest.mcap.topic_samples import TopicSamples
from unbend.ingest.message_tables import PLACE, Table, in_order
from unbend.messages import Ledger


def read_log(path: Path, ledger: Ledger) -> Contents:
    """The contents of an MCAP log."""
    reader = McapReader(ledger, path.name)
    line = timeline(reader.through(path))
    lost = reader.report()
    series: list[TopicSamples] = []
    for topic in reader.topics.values():
        series += (topic.series or {}).values()
    make_names_unique(series)
    clock = boot_clock_of(line, series, reader.recorder(), ledger)
    reader.release_topics()
    channels = []
    unstamped = 0
    while series:  # each is released when its channel is made
        samples = series.pop(0)
        rows, unstamped_rows = samples.rows(clock, ledger)
        unstamped += unstamped_rows
        channel = channel_of(rows, samples.spec, ledger)
        if channel is not None:
            channels.append(channel)
    return Contents(
        messages=reader.counts.by_name(reader.names),
        channels=tuple(channels),
        bad_bytes=reader.damage.bad_bytes,
        lost_messages=lost,
        boots=clock.line.boots,
        time_base=_time_base(clock, unstamped),
        table=partial(_table, path, clock),
    )


def _time_base(clock: BootClock, unstamped: int) -> str:
    """Where the UTC of the messages comes from, some of which have no time of their own."""
    if not clock.line.boot.size:
        time_base = "header.stamp of the messages"
    elif any(clock.utc_known):
        time_base = "the vehicle's time since boot, set to UTC by its GNSS messages"
    elif any(clock.fits):
        time_base = "the vehicle's time since boot, set by the recorder's clock"
    else:
        time_base = "the vehicle's time since boot; UTC is unknown"
    if unstamped:
        time_base += f"; log_time for {unstamped} messages without one"
    return time_base


def is_mcap(head: bytes) -> bool:
    """Whether a file begins as an MCAP does."""
    return head.startswith(MAGIC)


MCAP = LogFormat("mcap", "MCAP", (".mcap",), is_mcap, read_log)


def make_names_unique(series: list[TopicSamples]) -> None:
    """Channels of one topic that has several schemas get the schema into their names."""
    of_topic = Counter(samples.name for samples in series)
    for samples in series:
        if of_topic[samples.name] > 1:
            samples.name += f" ({samples.source.message})"
    names: Counter[str] = Counter()
    for samples in series:  # time since boot and Unix time under one name and schema
        names[samples.name] += 1
        if names[samples.name] > 1:
            samples.name += f" #{names[samples.name]}"


def boots_of_topics(line: Timeline, series: Sequence[TopicSamples]) -> Timeline:
    """The boots at which the time of one topic at least steps back: messages may come late."""
    starts = np.flatnonzero(np.diff(line.boot) > 0) + 1
    confirmed = np.zeros(starts.shape, np.bool_)
    if starts.size:
        for samples in series:
            if not samples.counted:
                continue
            places, boot_ns = samples.stamps(line)
            row = np.searchsorted(places, line.first[starts])
            inner = (row > 0) & (row < places.shape[0])
            step_ns = boot_ns[row[inner]] - boot_ns[row[inner] - 1]
            confirmed[inner] |= step_ns < -BOOT_STEP_NS
    marks = np.zeros(line.boot.shape, np.int16)
    marks[starts] = confirmed
    return replace(line, boot=np.cumsum(marks, dtype=np.int16))


def boot_clock_of(
    line: Timeline, series: list[TopicSamples], recorder: UtcReadings | None, ledger: Ledger
) -> BootClock:
    """UTC of the clock since boot that PX4's messages count.

    ``line``: by the messages of all topics. Receivers of ``series`` give UTC, cameras where none
    has a fix, ``recorder`` (log_time) in boots without; None where no message counts it.
    """
    if line.boots > 1:
        line = boots_of_topics(line, series)
    if recorder is None:
        return BootClock(line, (None,), (False,))
    receivers: list[UtcReadings] = []
    cameras: list[UtcReadings] = []
    for samples in series:
        readings = samples.utc_readings()
        if readings is None:
            continue
        if samples.spec.position:
            receivers.append(readings)
        else:
            cameras.append(readings)
    utc_of = "GNSS message with a fix and no log_time"
    clock = fit_clock(line, receivers, ledger, recorder, cameras=cameras, utc_of=utc_of)
    for number, fit in enumerate(clock.fits):
        if fit is not None and not clock.utc_known[number]:
            ledger.add(messages.set_by_log_time(boot=number, count=fit.rows))
    return clock


def _table(path: Path, clock: BootClock, name: str, instance: str | None) -> Table:
    """The messages of a topic with the recorder's time and their fields as sent.

    A topic of several schemas gives one table, in the order of the file.
    """
    reader = McapReader(Ledger(), path.name, only=name)
    deque(reader.through(path), 0)
    tables = []
    for topic in reader.topics.values():
        for table in _tables_of(topic, clock):
            rows = table
            if instance is not None:
                rows = _rows_of_instance(table, topic.spec.id_field, instance)
            if rows and rows[PLACE].shape[0]:
                tables.append(rows)
    if tables:
        whole = in_order(tables)
        del whole[PLACE]
        return whole
    reasons = [*reader.unread, *(topic.misfit for topic in reader.topics.values() if topic.failed)]
    if reasons:
        raise messages.topic_without_table(file=path.name, name=name, reason=reasons[0].what)
    return {}


def _tables_of(topic: topics.Topic, clock: BootClock) -> Iterator[Table]:
    """The messages of a topic whose times are counted, and the others; they are used up."""
    for counted in (False, True):
        blocks = topic.blocks[counted]
        topic.blocks[counted] = []
        if not blocks:
            continue
        block = in_order(blocks)
        del block[SEQUENCE]
        log_ns = block.pop(LOG_TIME)
        places = block[PLACE] if counted else None
        times = times_of(block.pop(STAMP), log_ns, places, clock, ledger=Ledger(), topic=topic.name)
        table: Table = {"time_ns": times.time_ns, "boot": times.boot, "log_time_ns": log_ns}
        yield table | block


def _rows_of_instance(table: Table, id_field: str, instance: str) -> Table:
    """The rows of one name in the messages, none where no message has it."""
    for name, rows in topics.rows_by_name(table, id_field):
        if name == instance:
            return {field: column[rows] for field, column in table.items()}
    return {}
