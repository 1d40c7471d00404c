"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from unbend.errors import LogError
from unbend.flight.clock import BOOT_STEP_NS
from unbend.ingest.boot_clock import BootClock, Timeline, UtcReadings, fit_clock, timeline
from unbend.ingest.channel_builder import channel_of
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.mcap import topics
from unbend.ingest.mcap.mcap_reader import McapReader
from unbend.ingest.mcap.mcap_records import MAGIC
from unbend.ingest.mcap.stamps import LOG_TIME, SEQUENCE, STAMP, times_of
from unbend.ingest.mcap.topic_samples import TopicSamples
from unbend.ingest.message_tables import PLACE, Table, in_order
from unbend.messages import Ledger

REASONS = ("LOG-SCHEMA", "LOG-NOT-ROS2", "LOG-NO-PROTOBUF")  # for no table


def read_log(path: Path, ledger: Ledger) -> Contents:
    """The contents of an MCAP log."""
    reader = McapReader(ledger, path.name)
    line = timeline(reader.through(path))
    lost = reader.report()
    of_topics = (topic.series or {} for topic in reader.topics.values())
    series = [one for of_topic in of_topics for one in of_topic.values()]
    make_names_unique(series)
    clock = boot_clock_of(line, series, reader.recorder(), ledger)
    reader.topics.clear()
    reader.topic_of.clear()
    channels, without = [], 0
    while series:  # each is released when its channel is made
        one = series.pop(0)
        rows, unstamped = one.rows(clock, ledger)
        without += unstamped
        channel = channel_of(rows, one.spec, ledger)
        if channel is not None:
            channels.append(channel)
    time_base = "header.stamp of the messages"
    if clock.line.boot.size:
        time_base = "the vehicle's time since boot, set to UTC by its GNSS messages"
        if not any(clock.utc_known):
            time_base = "the vehicle's time since boot, set by the recorder's clock"
        if not any(clock.fits):
            time_base = "the vehicle's time since boot; UTC is unknown"
    if without:
        time_base += f"; log_time for {without} messages without one"
    counts = reader.counts.by_name(reader.names)
    return Contents(
        counts, tuple(channels), reader.damage.bad_bytes, lost, clock.line.boots, time_base,
        partial(_table, path, clock),
    )  # fmt: skip


MCAP = LogFormat("mcap", "MCAP", (".mcap",), lambda head: head.startswith(MAGIC), read_log)


def make_names_unique(series: list[TopicSamples]) -> None:
    """Channels of one topic that has several schemas get the schema into their names."""
    of_topic = Counter(one.name for one in series)
    for one in series:
        if of_topic[one.name] > 1:
            one.name += f" ({one.source.message})"
    names: Counter[str] = Counter()
    for one in series:  # time since boot and Unix time under one name and schema
        names[one.name] += 1
        if names[one.name] > 1:
            one.name += f" #{names[one.name]}"


def boots_of_topics(line: Timeline, series: Sequence[TopicSamples]) -> Timeline:
    """The boots at which the time of one topic at least steps back: messages may come late."""
    starts = np.flatnonzero(np.diff(line.boot) > 0) + 1
    confirmed = np.zeros(starts.shape, np.bool_)
    for one in series if starts.size else ():
        if one.counted:
            places, boot_ns = one.stamps(line)
            row = np.searchsorted(places, line.first[starts])
            inner = (row > 0) & (row < places.shape[0])
            confirmed[inner] |= boot_ns[row[inner]] < boot_ns[row[inner] - 1] - BOOT_STEP_NS
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
    for one in series:
        readings = one.utc_readings()
        if readings is not None:
            (receivers if one.spec.position else cameras).append(readings)
    utc_of = "GNSS message with a fix and no log_time"
    clock = fit_clock(line, receivers, ledger, recorder, cameras=cameras, utc_of=utc_of)
    for number, (fit, known) in enumerate(zip(clock.fits, clock.utc_known, strict=True)):
        if fit is not None and not known:
            ledger.fallback("TIME-LOG-TIME", where=f"boot {number}", count=fit.rows)
    return clock


def _table(path: Path, clock: BootClock, name: str, instance: str | None) -> Table:
    """The messages of a topic with the recorder's time and their fields as sent.

    A topic of several schemas gives one table, in the order of the file.
    """
    reader = McapReader(Ledger(), path.name, only=name)
    deque(reader.through(path), 0)
    tables = []
    for topic in reader.topics.values():
        for counted in topic.blocks:
            blocks, topic.blocks[counted] = topic.blocks[counted], []
            if not blocks:
                continue
            block = in_order(blocks)
            del block[SEQUENCE]
            log_ns, places = block.pop(LOG_TIME), block[PLACE] if counted else None
            time_ns, boot, _ = times_of(
                block.pop(STAMP), log_ns, places, clock, ledger=reader.ledger, where=name
            )
            table: Table = {"time_ns": time_ns, "boot": boot, "log_time_ns": log_ns}
            table |= block
            if instance is not None:
                rows = dict(topics.rows_by_name(table, topic.spec.id_field)).get(instance, slice(0))
                table = {column: values[rows] for column, values in table.items()}
            if table[PLACE].shape[0]:
                tables.append(table)
    reasons = [entry.what for entry in reader.ledger if entry.code in REASONS]
    reasons += [topic.misfit for topic in reader.topics.values() if topic.failed]
    if not tables and reasons:
        raise LogError.of("LOG-NO-TABLE/table", reader.where, name=name, reasons=reasons[0])
    if not tables:
        return {}
    whole = in_order(tables)
    del whole[PLACE]
    return whole
