"""Reading an MCAP log: definitions -> decoders, and messages to the topics that they are of."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import UNIX_NS_FROM
from pipeline.ingest.boot_clock import Stamps, UtcReadings
from pipeline.ingest.buffers import open_view
from pipeline.ingest.fields import MessageMap
from pipeline.ingest.mcap.cdr_schema import SchemaError
from pipeline.ingest.mcap.counts import Counts
from pipeline.ingest.mcap.fields import PLAIN_JSON, SCHEMAS, known_name
from pipeline.ingest.mcap.messages import CHANNEL, MAGIC, SCHEMA, Damage, Definition, Messages
from pipeline.ingest.mcap.records import walk
from pipeline.ingest.mcap.topics import (
    MAX_NAMES,
    CdrDecoder,
    Decoder,
    Topic,
    json_decoder,
    paths_of,
    protobuf_decoder,
)
from pipeline.ledger import Ledger

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)
# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)

RECORDED = 512  # messages of each block (4 MiB) whose log_time is kept beside their time since boot
MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any


class Reader:
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
        self.topic_of: dict[int, tuple[Topic, Decoder]] = {}
        self.decoders: dict[tuple[int, str], Decoder | Exception] = {}
        self.topics: dict[tuple[str, str], Topic] = {}
        self.seen = 0  # messages, of any channel
        self.recorded: list[NDArray[np.int64]] = []

    def through(self, path: Path) -> Iterator[Stamps]:
        """Read the file; yields places and times since boot of the messages that count it."""
        with open_view(path) as data:
            if data[0 : len(MAGIC)] != MAGIC:
                self.damage.add("LOG-BAD-BYTES", "the file begins as no MCAP does", 0, data.size)
                return
            for part in walk(data, self.damage):
                if isinstance(part, Definition):
                    self._define(part)
                elif stamps := self._take(part):
                    places, boot_ns, log_ns = (
                        np.concatenate(each) for each in zip(*stamps, strict=True)
                    )
                    order = np.argsort(places)
                    sample = order[:: -(-order.shape[0] // RECORDED)]
                    self.recorded.append(np.stack([places, boot_ns, log_ns])[:, sample])
                    yield places[order], boot_ns[order]

    def _take(self, messages: Messages) -> list[tuple[TimeArray, TimeArray, TimeArray]]:
        before, self.seen = self.seen, self.seen + len(messages)
        shares: dict[int, list[tuple[Decoder, NDArray[np.intp]]]] = {}
        topics: dict[int, Topic] = {}
        for number in self.counts.take(messages, self.names):
            if number in self.topic_of:
                topic, decoder = self.topic_of[number]
                topics[id(topic)] = topic
                rows = np.flatnonzero(messages.channel == number)
                shares.setdefault(id(topic), []).append((decoder, rows))
        return [
            stamps
            for key, topic in topics.items()
            for stamps in topic.take(messages, shares[key], before)
        ]

    def recorder(self) -> UtcReadings | None:
        """log_time beside time since boot, of some messages of each block; None without any."""
        if not self.recorded:
            return None
        places, boot_ns, log_ns = np.concatenate(self.recorded, axis=1)
        return UtcReadings("log_time", places, boot_ns, log_ns, log_ns > UNIX_NS_FROM)

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
        key = (channel.schema_id, channel.message_encoding)
        decoder = self.decoders.get(key)  # thousands of channels may share a schema
        if decoder is None:
            try:
                decoder = self._decoder(channel, schema, name, spec)
            except _schema_errors() as error:
                decoder = error
            if decoder is not None:
                self.decoders[key] = decoder
        if isinstance(decoder, Exception):
            self.ledger.loss(
                "LOG-SCHEMA",
                f"the schema of {name} cannot be parsed ({decoder}): the topic is not read",
                where=channel.topic,
            )
        elif decoder is not None:
            topic = Topic(channel.topic, name, spec, None if self.only else {})
            topic = self.topics.setdefault((channel.topic, name), topic)
            self.topic_of[channel.id] = (topic, decoder)

    def _decoder(self, channel: Any, schema: Any, name: str, spec: MessageMap) -> Decoder | None:
        encoding, wanted = channel.message_encoding, None if self.only else paths_of(spec)
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
                    topic.misfit,
                    where=topic.name,
                    count=topic.failed,
                )
            if topic.lost_values:
                self.ledger.loss(
                    "LOG-DECODE",
                    f"{topic.lost_values} values are no numbers where numbers are wanted: they are "
                    "missing",
                    where=topic.name,
                    count=topic.lost_values,
                )
            if topic.nameless:
                self.ledger.loss(
                    "LOG-TOO-LARGE",
                    f"{topic.nameless} messages come after {MAX_NAMES} different names: their "
                    "values are not read",
                    where=topic.name,
                    count=topic.nameless,
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
