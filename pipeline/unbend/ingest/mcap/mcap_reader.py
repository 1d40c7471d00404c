"""One pass over an MCAP log: definitions, counts, and the topics that are read."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from unbend.flight.clock import UNIX_NS_FROM
from unbend.ingest.boot_clock import Stamps, UtcReadings
from unbend.ingest.buffers import open_view
from unbend.ingest.mcap import topics
from unbend.ingest.mcap.mcap_records import Damage, Definition, Opcode, RecordWalk
from unbend.ingest.mcap.message_counts import MessageCounts
from unbend.ingest.mcap.ros2_definitions import SchemaError
from unbend.ingest.mcap.topic_samples import PLAIN_JSON, SCHEMAS, known_name
from unbend.messages import Ledger
from unbend.units import Integers, Rows

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)


# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)


RECORDED = 512  # messages of each block (4 MiB) whose log_time is kept beside their time since boot


MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any


class McapReader:
    """Definitions, counts and topics of one file; with ``only`` all fields of that topic."""

    def __init__(self, ledger: Ledger, where: str, only: str | None = None) -> None:
        self.ledger = ledger
        self.where = where
        self.only = only
        self.damage = Damage()
        self.counts = MessageCounts()
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, Any] = {}
        self.names: dict[int, str] = {}
        self.contradictions: set[str] = set()
        self.raw: dict[tuple[int, bytes], bytes] = {}
        self.topic_of: dict[int, tuple[topics.Topic, topics.Decoder]] = {}
        self.decoders: dict[tuple[int, str], topics.Decoder | Exception] = {}
        self.topics: dict[tuple[str, str], topics.Topic] = {}
        self.seen = 0  # messages, of any channel
        self.recorded: list[Integers] = []

    def through(self, path: Path) -> Iterator[Stamps]:
        """Read the file; yields places and times since boot of the messages that count it."""
        with open_view(path) as data:
            for part in RecordWalk(data, self.damage):
                if isinstance(part, Definition):
                    self._define(part)
                    continue
                shares: dict[tuple[str, str], list[tuple[topics.Decoder, Rows]]] = {}
                for number in self.counts.take(part, self.names):
                    if number in self.topic_of:
                        topic, decoder = self.topic_of[number]
                        rows = np.flatnonzero(part.channel == number)
                        shares.setdefault((topic.name, topic.schema), []).append((decoder, rows))
                before, self.seen = self.seen, self.seen + len(part)
                taken = (self.topics[key].take(part, of, before) for key, of in shares.items())
                if stamps := [stamp for stamps_of_topic in taken for stamp in stamps_of_topic]:
                    places, boot_ns, log_ns = map(np.concatenate, zip(*stamps, strict=True))
                    order = np.argsort(places)
                    sample = order[:: -(-order.shape[0] // RECORDED)]
                    self.recorded.append(np.stack([places, boot_ns, log_ns])[:, sample])
                    yield places[order], boot_ns[order]

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
        kinds = {Opcode.SCHEMA: library.Schema, Opcode.CHANNEL: library.Channel}
        kind = kinds.get(definition.opcode, library.Statistics)
        try:
            record = kind.read(ReadDataStream(BytesIO(definition.content)))
        except (McapError, *_PARSE_ERRORS) as error:
            what = f"a definition (opcode {definition.opcode}) cannot be read: {error}"
            self.damage.add("LOG-BAD-BYTES", what, definition.at, len(definition.content))
            return
        if kind is library.Statistics:
            self.counts.stated = dict(record.channel_message_counts)
            self.counts.stated_total = int(record.message_count)
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
        schema: Any = self.schemas.get(channel.schema_id)
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
            encoding = channel.message_encoding
            wanted = None if self.only else topics.paths_of(spec)
            kind = (encoding, schema.encoding if schema is not None else "")
            try:
                if encoding == "json":
                    decoder = topics.json_decoder(spec, wanted)
                elif kind == ("cdr", "ros2msg"):
                    decoder = topics.cdr_decoder(schema.name, schema.data.decode(), wanted)
                elif kind == ("protobuf", "protobuf"):
                    decoder = topics.protobuf_decoder(schema, spec, wanted)
                elif schema is not None:
                    where, of = channel.topic, schema.encoding
                    self.ledger.note(
                        "LOG-NOT-ROS2", where=where, name=name, encoding=encoding, schema=of
                    )
            except ImportError:
                self.ledger.loss("LOG-NO-PROTOBUF", where=channel.topic, name=name)
            except _SCHEMA_ERRORS as error:
                decoder = error
            if decoder is not None:
                self.decoders[key] = decoder
        if isinstance(decoder, Exception):
            what = f"the schema of {name} cannot be parsed ({decoder}): the topic is not read"
            self.ledger.loss("LOG-SCHEMA", what, where=channel.topic)
        elif decoder is not None:
            topic = topics.Topic(channel.topic, name, spec, None if self.only else {})
            topic = self.topics.setdefault((channel.topic, name), topic)
            self.topic_of[channel.id] = (topic, decoder)

    def report(self) -> int:
        """Enter the damage; returns how many messages are missing."""
        for code, what, at, count in self.damage.entries():
            self.ledger.loss(code, what, where=f"{self.where}, byte {at}", count=count)
        if self.contradictions:
            count, examples = len(self.contradictions), ", ".join(sorted(self.contradictions)[:8])
            self.ledger.loss("LOG-INCONSISTENT", where=self.where, count=count, examples=examples)
        for topic in self.topics.values():
            if topic.failed:
                self.ledger.loss("LOG-DECODE", topic.misfit, where=topic.name, count=topic.failed)
            if topic.lost_values:
                self.ledger.loss("LOG-DECODE", where=topic.name, count=topic.lost_values)
            if topic.nameless:
                most, count = topics.MAX_NAMES, topic.nameless
                self.ledger.loss("LOG-TOO-LARGE", where=topic.name, count=count, max_names=most)
        damaged = bool(self.damage.losses)
        return self.counts.report(self.names, self.ledger, self.where, damaged=damaged)
