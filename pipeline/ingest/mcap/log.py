"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.errors import LogError
from pipeline.flight.channels import Channel
from pipeline.ingest.boot_clock import BootClock, Timeline, UtcReadings, timeline
from pipeline.ingest.channel_builder import channel_of
from pipeline.ingest.log import Contents, Table
from pipeline.ingest.mcap.messages import MAGIC
from pipeline.ingest.mcap.reader import Reader
from pipeline.ingest.mcap.samples import STAMP, Samples, times_of
from pipeline.ingest.mcap.time import clock_of, confirmed
from pipeline.ingest.mcap.topics import Topic, by_clock, names_of
from pipeline.ingest.mcap.values import stacked
from pipeline.ledger import Ledger

PLACE = "\0place"  # of a message in the log, while a table is put together
REASONS = ("LOG-SCHEMA", "LOG-NOT-ROS2", "LOG-NO-PROTOBUF")  # for no table


@dataclass(frozen=True)
class Mcap:
    """The registry's line of this format."""

    name: str = "mcap"
    title: str = "MCAP"
    extensions: tuple[str, ...] = (".mcap",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        reader = Reader(ledger, path.name)
        line = timeline(reader.through(path))
        lost = reader.report()
        samples = [
            each for topic in reader.topics.values() for each in (topic.series or {}).values()
        ]
        _name_apart(samples)
        clock = _clock(line, samples, reader.recorder(), ledger)
        reader.topics.clear()
        reader.topic_of.clear()
        channels, words = _channels(samples, clock, ledger)
        return Contents(
            reader.counts.by_name(reader.names),
            tuple(channels),
            reader.damage.bad_bytes,
            lost,
            clock.line.boots,
            words,
            partial(_table, path, clock),
        )


MCAP = Mcap()


def _clock(
    line: Timeline, samples: list[Samples], recorder: UtcReadings | None, ledger: Ledger
) -> BootClock:
    """The clock since boot, by what receivers and cameras say of UTC."""
    if line.boots > 1:
        line = confirmed(line, (each.stamps(line) for each in samples if each.counted))
    told = [(each.spec.position, each.told()) for each in samples]
    receivers = [one for receiver, one in told if receiver and one is not None]
    cameras = [one for receiver, one in told if not receiver and one is not None]
    return clock_of(line, receivers, cameras, recorder, ledger)


def _name_apart(samples: list[Samples]) -> None:
    """Channels of one topic, which has several schemas, get the schema into their names."""
    taken = Counter(each.name for each in samples)
    for each in samples:
        if taken[each.name] > 1:
            each.name += f" ({each.source.message})"
    names: Counter[str] = Counter()
    for each in samples:  # time since boot and Unix time under one name and schema
        names[each.name] += 1
        if names[each.name] > 1:
            each.name += f" #{names[each.name]}"


def _channels(
    samples: list[Samples], clock: BootClock, ledger: Ledger
) -> tuple[list[Channel], str]:
    channels, without = [], 0
    while samples:  # each is let go when its channel is made
        each = samples.pop(0)
        rows, unstamped = each.rows(clock, ledger)
        without += unstamped
        channel = channel_of(rows, each.spec, ledger)
        if channel is not None:
            channels.append(channel)
    words = "header.stamp of the messages"
    if clock.line.boot.size:
        words = "the vehicle's time since boot, set to UTC by its GNSS messages"
        if not any(clock.utc_known):
            words = "the vehicle's time since boot, set by the recorder's clock"
        if not any(clock.fits):
            words = "the vehicle's time since boot; UTC is unknown"
    if without:
        words += f"; log_time for {without} messages without one"
    return channels, words


def _table(path: Path, clock: BootClock, name: str, instance: str | None) -> Table:
    """The messages of a topic with the recorder's time and their fields as sent."""
    reader = Reader(Ledger(), path.name, only=name)
    deque(reader.through(path), 0)
    tables = []
    for topic in reader.topics.values():
        parts, topic.parts = topic.parts, []
        for part in by_clock(parts):
            places = part.places if part.counted else None
            time_ns, boot, _ = times_of(
                part.stamp_ns, part.log_ns, places, clock, reader.ledger, name
            )
            part.columns.pop(STAMP, None)
            table: Table = {"time_ns": time_ns, "boot": boot, "log_time_ns": part.log_ns}
            table = _of_instance(table | part.columns | {PLACE: part.places}, topic, instance)
            if table and table[PLACE].shape[0]:
                tables.append(table)
    return _whole(tables, reader, name)


def _whole(tables: list[Table], reader: Reader, name: str) -> Table:
    """The tables of the schemas of a topic as one, in the order of the file."""
    if not tables:
        why = [entry.what for entry in reader.ledger if entry.code in REASONS]
        why += [topic.misfit for topic in reader.topics.values() if topic.failed]
        if why:
            raise LogError(
                "LOG-NO-TABLE",
                f"{name} has no rows that can be laid out in columns: {why[0]}",
                where=reader.where,
                remedy="choose another topic of `unbend inspect`",
            )
        return {}
    whole = stacked(tables, [table[PLACE].shape[0] for table in tables])
    places = whole.pop(PLACE)
    if bool(np.all(places[1:] > places[:-1])):
        return whole
    order = np.argsort(places)
    return {key: column[order] for key, column in whole.items()}


def _of_instance(table: Table, topic: Topic, instance: str | None) -> Table:
    if instance is None:
        return table
    mine = dict(names_of(table, topic.spec.id_field)).get(instance)
    return {} if mine is None else {name: column[mine] for name, column in table.items()}
