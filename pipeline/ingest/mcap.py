"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.ingest.base import Contents, Table
from pipeline.ingest.build import channel_of
from pipeline.ingest.cdr_schema import SchemaError
from pipeline.ingest.mcap_counts import Counts
from pipeline.ingest.mcap_fields import (
    PLAIN_JSON,
    SCHEMAS,
    known_name,
)
from pipeline.ingest.mcap_messages import CHANNEL, MAGIC, SCHEMA, Damage, Definition, Messages
from pipeline.ingest.mcap_records import walk
from pipeline.ingest.mcap_samples import STAMP, Samples, own_times, times_of
from pipeline.ingest.mcap_time import BootClock
from pipeline.ingest.mcap_topics import (
    CdrDecoder,
    Decoder,
    Topic,
    json_decoder,
    paths_of,
    protobuf_decoder,
)
from pipeline.ingest.window import window_on
from pipeline.ledger import Ledger

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)
# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)

MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any


@dataclass(frozen=True)
class Mcap:
    """The registry's line of this format."""

    name: str = "mcap"
    title: str = "MCAP"
    extensions: tuple[str, ...] = (".mcap",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        reader = _Reader(ledger, path.name)
        if not reader.through(path):
            return Contents({}, (), path.stat().st_size, 0, 1, "")
        lost = reader.report()
        samples = [topic.samples for topic in reader.topics.values() if topic.samples is not None]
        samples = [each for each in samples if len(each.stamp_ns)]
        readings = [each.clock_readings() for each in samples]
        clock = BootClock([pair for pair in readings if pair is not None], ledger)
        reader.topics.clear()
        reader.topic_of.clear()
        channels, words = _channels(samples, clock, ledger)
        return Contents(
            reader.counts.by_name(reader.names),
            tuple(channels),
            reader.damage.bad_bytes,
            lost,
            clock.boots,
            words,
            partial(_table, path, clock),
        )


MCAP = Mcap()


class _Reader:
    """Definitions, counts and topics of one file. ``only`` reads all fields of one topic."""

    def __init__(self, ledger: Ledger, where: str, only: str | None = None) -> None:
        self.ledger = ledger
        self.where = where
        self.only = only
        self.damage = Damage()
        self.counts = Counts()
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, Any] = {}
        self.names: dict[int, str] = {}
        self.contradictions: set[str] = set()
        self.raw: dict[tuple[int, bytes], bytes] = {}
        self.topic_of: dict[int, Topic] = {}
        self.topics: dict[tuple[str, str], Topic] = {}

    def through(self, path: Path) -> bool:
        """Read the file; False when it does not begin as an MCAP does."""
        with window_on(path) as data:
            if data[0 : len(MAGIC)] != MAGIC:
                return False
            for part in walk(data, self.damage):
                if isinstance(part, Definition):
                    self._define(part)
                else:
                    self._take(part)
        return True

    def _take(self, messages: Messages) -> None:
        present = self.counts.take(messages, self.names)
        for number in present:
            topic = self.topic_of.get(number)
            if topic is not None:
                topic.take(messages, np.flatnonzero(messages.channel == number))

    def _define(self, definition: Definition) -> None:
        from mcap import records as library
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError

        key = (definition.opcode, definition.content[:2])
        if self.raw.setdefault(key, definition.content) is not definition.content and (
            self.raw[key] == definition.content or len(self.contradictions) > MAX_CONTRADICTIONS
        ):
            return  # repeated in every chunk and in the summary
        kinds = {SCHEMA: library.Schema, CHANNEL: library.Channel}
        kind = kinds.get(definition.opcode, library.Statistics)
        try:
            record = kind.read(ReadDataStream(BytesIO(definition.content)))
        except (McapError, *_PARSE_ERRORS) as error:
            what = f"a definition (opcode {definition.opcode}) cannot be read: {error}"
            self.damage.add("LOG-BAD-BYTES", what, definition.at, len(definition.content))
            return
        if kind is library.Statistics:
            self.counts.promised = dict(record.channel_message_counts)
            self.counts.promised_total = int(record.message_count)
            return
        known = self.schemas if kind is library.Schema else self.channels
        if record.id not in known:
            known[record.id] = record
            if kind is library.Channel:
                self.names[record.id] = record.topic
                self._subscribe(record)
        elif known[record.id] != record:
            self.contradictions.add(f"{kind.__name__.lower()} {record.id}")

    def _subscribe(self, channel: Any) -> None:
        schema = self.schemas.get(channel.schema_id)
        name = known_name(schema.name) if schema is not None else ""
        plain = channel.message_encoding == "json" and name not in SCHEMAS
        if self.only is None and name not in SCHEMAS and not plain:
            return
        if self.only is not None and channel.topic != self.only:
            return
        spec = SCHEMAS.get(name, PLAIN_JSON)
        try:
            decoder = self._decoder(channel, schema, None if self.only else paths_of(spec))
        except _schema_errors() as error:
            self.ledger.loss(
                "LOG-SCHEMA",
                f"the schema of {name} cannot be parsed ({error}): the topic is not read",
                where=channel.topic,
            )
            return
        if decoder is not None:
            samples = Samples(channel.topic, name, spec) if self.only is None else None
            topic = Topic(channel.topic, name, spec, decoder, samples)
            self.topic_of[channel.id] = self.topics.setdefault((channel.topic, name), topic)

    def _decoder(self, channel: Any, schema: Any, wanted: frozenset[str] | None) -> Decoder | None:
        encoding = channel.message_encoding
        name = known_name(schema.name) if schema is not None else ""
        spec = SCHEMAS.get(name, PLAIN_JSON)
        if encoding == "json":
            return json_decoder(spec, wanted)
        if schema is None:
            return None
        if encoding == "cdr" and schema.encoding == "ros2msg":
            return CdrDecoder.of(schema.name, schema.data.decode(), wanted)
        if encoding == "protobuf" and schema.encoding == "protobuf":
            try:
                return protobuf_decoder(schema, spec, wanted)
            except ImportError:
                self.ledger.loss(
                    "LOG-NO-PROTOBUF",
                    f"{name} is protobuf, which needs the package mcap-protobuf-support: counted, "
                    "not read",
                    where=channel.topic,
                )
                return None
        self.ledger.note(
            "LOG-NOT-ROS2",
            f"{name} is encoded as {encoding} with a {schema.encoding} schema, not as ROS 2 CDR, "
            "protobuf or JSON: counted, not read",
            where=channel.topic,
        )
        return None

    def report(self) -> int:
        """Enter the damage; returns how many messages are missing."""
        for code, what, at, count in self.damage.all():
            self.ledger.loss(code, what, where=f"{self.where}, byte {at}", count=count)
        if self.contradictions:
            some = ", ".join(sorted(self.contradictions)[:8])
            self.ledger.loss(
                "LOG-INCONSISTENT",
                f"{len(self.contradictions)} definitions come twice and differ ({some}): the first "
                "is used",
                where=self.where,
                count=len(self.contradictions),
            )
        for topic in self.topics.values():
            if topic.failed:
                self.ledger.loss(
                    "LOG-DECODE",
                    f"{topic.failed} messages do not fit their schema {topic.schema}",
                    where=topic.name,
                    count=topic.failed,
                )
        damaged = bool(self.damage.losses)
        return self.counts.report(self.names, self.ledger, self.where, damaged=damaged)


def _schema_errors() -> tuple[type[Exception], ...]:
    """What a damaged definition raises in our parser and in the libraries'."""
    from mcap.exceptions import McapError

    try:
        from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    except ImportError:
        return (McapError, *_SCHEMA_ERRORS)
    return (McapError, DecodeError, *_SCHEMA_ERRORS)


def _channels(
    samples: list[Samples], clock: BootClock, ledger: Ledger
) -> tuple[list[Channel], str]:
    channels, without = [], 0
    from_boot = any(each.since_boot for each in samples)
    while samples:  # each is let go when its channel is made
        each = samples.pop(0)
        rows, unstamped = each.rows(clock, ledger)
        without += unstamped
        channel = channel_of(rows, each.spec, ledger)
        if channel is not None:
            channels.append(channel)
    words = "header.stamp of the messages"
    if from_boot:
        words = "the vehicle's time since boot, set to UTC by its GNSS messages"
        if not clock.fits:
            words = "the vehicle's time since boot, set by the recorder's clock"
    if without:
        words += f"; log_time for {without} messages without one"
    return channels, words


def _table(path: Path, fitted: BootClock, name: str, instance: str | None) -> Table:
    """All messages of a topic with the recorder's time and their fields as sent."""
    reader = _Reader(Ledger(), path.name, only=name)
    if instance is not None or not reader.through(path):
        return {}
    clock = BootClock((), reader.ledger)
    clock.fits = fitted.fits
    for topic in reader.topics.values():
        columns, log_ns = topic.whole()
        if not log_ns.shape[0]:
            continue
        stamp_ns, since_boot = own_times(columns, topic.spec.time_field, log_ns.shape[0])
        time_ns, boot, _ = times_of(
            stamp_ns, log_ns, clock, reader.ledger, name, since_boot=since_boot
        )
        columns.pop(STAMP, None)
        table: Table = {"time_ns": time_ns, "boot": boot, "log_time_ns": log_ns}
        return table | columns
    return {}
