"""Reading an MCAP log: definitions -> decoders, messages -> their topics, counts -> losses."""

import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.flight.clock import UNIX_NS_FROM
from pipeline.ingest.boot_clock import Stamps, UtcReadings
from pipeline.ingest.buffers import open_view
from pipeline.ingest.mcap.cdr import SchemaError
from pipeline.ingest.mcap.fields import PLAIN_JSON, SCHEMAS, known_name
from pipeline.ingest.mcap.file_format import Damage, Definition, Messages, Opcode
from pipeline.ingest.mcap.records import walk
from pipeline.ingest.mcap.topics import (
    MAX_NAMES,
    Decoder,
    Topic,
    cdr_decoder,
    json_decoder,
    paths_of,
    protobuf_decoder,
)
from pipeline.ledger import Ledger
from pipeline.units import Integers, Rows

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)
# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)

CHANNEL_NUMBERS = 1 << 16  # they are 16 bits wide
RECORDED = 512  # messages of each block (4 MiB) whose log_time is kept beside their time since boot
MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any


class MessageCounts:
    """Messages by channel, and steps of their sequence numbers.

    ``stated`` by channel and ``stated_total`` are the log's own statistics, None without.
    """

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
        result: dict[str, int] = {}
        for number in np.flatnonzero(self.counts).tolist():
            result[names[number]] = result.get(names[number], 0) + int(self.counts[number])
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
            topics = ", ".join(names.get(number, f"channel {number}") for number in wrong[:8])
            what = f"{total} messages were read, the log's statistics state {self.stated_total}" + (
                f"; they differ for {topics}" if topics else ""
            )
            ledger.loss(
                "LOG-INCONSISTENT", what, where=where, count=max(abs(self.stated_total - total), 1)
            )
        return max(self.stated_total - total, skipped, 0)


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
        self.topic_of: dict[int, tuple[Topic, Decoder]] = {}
        self.decoders: dict[tuple[int, str], Decoder | Exception] = {}
        self.topics: dict[tuple[str, str], Topic] = {}
        self.seen = 0  # messages, of any channel
        self.recorded: list[Integers] = []

    def through(self, path: Path) -> Iterator[Stamps]:
        """Read the file; yields places and times since boot of the messages that count it."""
        with open_view(path) as data:
            for part in walk(data, self.damage):
                if isinstance(part, Definition):
                    self._define(part)
                    continue
                shares: dict[tuple[str, str], list[tuple[Decoder, Rows]]] = {}
                for number in self.counts.take(part, self.names):
                    if number in self.topic_of:
                        topic, decoder = self.topic_of[number]
                        rows = np.flatnonzero(part.channel == number)
                        shares.setdefault((topic.name, topic.schema), []).append((decoder, rows))
                before, self.seen = self.seen, self.seen + len(part)
                stamps = [
                    stamps_of_part
                    for key, share in shares.items()
                    for stamps_of_part in self.topics[key].take(part, share, before)
                ]
                if stamps:
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
            encoding, wanted = channel.message_encoding, None if self.only else paths_of(spec)
            kind = (encoding, schema.encoding if schema is not None else "")
            try:
                if encoding == "json":
                    decoder = json_decoder(spec, wanted)
                elif kind == ("cdr", "ros2msg"):
                    decoder = cdr_decoder(schema.name, schema.data.decode(), wanted)
                elif kind == ("protobuf", "protobuf"):
                    decoder = protobuf_decoder(schema, spec, wanted)
                elif schema is not None:
                    what = (
                        f"{name} is encoded as {encoding} with a {schema.encoding} schema, not as "
                        "ROS 2 CDR, protobuf or JSON: counted, not read"
                    )
                    self.ledger.note("LOG-NOT-ROS2", what, where=channel.topic)
            except ImportError:
                what = "which needs the package mcap-protobuf-support: counted, not read"
                where = channel.topic
                self.ledger.loss("LOG-NO-PROTOBUF", f"{name} is protobuf, {what}", where=where)
            except _SCHEMA_ERRORS as error:
                decoder = error
            if decoder is not None:
                self.decoders[key] = decoder
        if isinstance(decoder, Exception):
            what = f"the schema of {name} cannot be parsed ({decoder}): the topic is not read"
            self.ledger.loss("LOG-SCHEMA", what, where=channel.topic)
        elif decoder is not None:
            topic = Topic(channel.topic, name, spec, None if self.only else {})
            topic = self.topics.setdefault((channel.topic, name), topic)
            self.topic_of[channel.id] = (topic, decoder)

    def report(self) -> int:
        """Enter the damage; returns how many messages are missing."""
        for code, what, at, count in self.damage.entries():
            self.ledger.loss(code, what, where=f"{self.where}, byte {at}", count=count)
        if self.contradictions:
            examples = ", ".join(sorted(self.contradictions)[:8])
            self.ledger.loss(
                "LOG-INCONSISTENT",
                f"{len(self.contradictions)} definitions come twice and differ ({examples}): the "
                "first is used",
                where=self.where,
                count=len(self.contradictions),
            )
        for topic in self.topics.values():
            if topic.failed:
                self.ledger.loss("LOG-DECODE", topic.misfit, where=topic.name, count=topic.failed)
            if topic.lost_values:
                self.ledger.loss("LOG-DECODE", where=topic.name, count=topic.lost_values)
            if topic.nameless:
                self.ledger.loss(
                    "LOG-TOO-LARGE", where=topic.name, count=topic.nameless, max_names=MAX_NAMES
                )
        damaged = bool(self.damage.losses)
        return self.counts.report(self.names, self.ledger, self.where, damaged=damaged)
