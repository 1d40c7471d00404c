"""MCAP logs of ROS 2 (.mcap): records -> channels in UTC."""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.flight.channels import Channel, Source
from pipeline.flight.clock import UNIX_NS_FROM
from pipeline.ingest.base import Contents
from pipeline.ingest.build import Rows, channel_of
from pipeline.ingest.fields import extract
from pipeline.ingest.mcap_fields import HEADER_ONLY, SCHEMAS, finished, short_name
from pipeline.ingest.mcap_records import (
    CHANNEL,
    MAGIC,
    MESSAGE,
    MESSAGE_RECORD,
    SCHEMA,
    STATISTICS,
    Damage,
    records,
)
from pipeline.ledger import Ledger

_LAST_NS = 2**63 - 1  # log_time is unsigned in the file; times inside are int64

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)

Decoder = Callable[[bytes], tuple[int, str, list[float]]]

# What the generated decoders raise on a message that does not fit its schema.
_DECODE_ERRORS = (
    ValueError,
    KeyError,
    IndexError,
    AttributeError,
    TypeError,
    OverflowError,
    RuntimeError,
    EOFError,
    struct.error,
)


@dataclass(frozen=True)
class Mcap:
    """The registry's line of this format."""

    name: str = "mcap"
    title: str = "MCAP"
    extensions: tuple[str, ...] = (".mcap",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        reader, damage = _Reader(ledger, path.name), Damage()
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return Contents({}, (), path.stat().st_size, 0, 1, "")
            stream.seek(0)
            for opcode, content in records(stream, path.stat().st_size, damage):
                reader.take(opcode, content)
        for code, what, at, count in damage.losses:
            ledger.loss(code, what, where=f"{path.name}, byte {at}", count=count)
        lost = reader.report(damage)
        channels = [topic.channel(ledger) for topic in reader.topics.values()]
        by_log_time = sum(topic.without_stamp for topic in reader.topics.values())
        words = "header.stamp of the messages"
        if by_log_time:
            words += f"; log_time for {by_log_time} messages without one"
        return Contents(
            dict(reader.counts),
            tuple(channel for channel in channels if channel is not None),
            damage.bad_bytes,
            lost,
            1,
            words,
        )


MCAP = Mcap()


@dataclass
class _Topic:
    """A wanted topic: its decoder, and its messages as decoded so far."""

    name: str
    schema: str
    decode: Decoder
    stamps: array[int] = field(default_factory=lambda: array("q"))
    frames: list[str] = field(default_factory=list)
    values: array[float] = field(default_factory=lambda: array("d"))
    without_stamp: int = 0
    failed: int = 0

    def take(self, log_time: int, data: bytes) -> None:
        try:
            stamp, frame, values = self.decode(data)
        except _DECODE_ERRORS:
            self.failed += 1
            return
        if stamp == 0:
            self.without_stamp += 1
        self.stamps.append(stamp or log_time)
        self.values.extend(values)
        if SCHEMAS[self.schema].event:
            self.frames.append(frame)

    def channel(self, ledger: Ledger) -> Channel | None:
        spec = SCHEMAS[self.schema]
        self._report(ledger)
        table = np.array(self.values, np.float64).reshape(len(self.stamps), len(spec.columns))
        fields = {part.fields[0]: table[:, k] for k, part in enumerate(spec.columns)}
        labels = {"frame_id": tuple(self.frames)} if spec.event else {}
        # In the order of the file, never of log_time: a recorder whose clock was set back would
        # shuffle two parts of the flight into each other.
        rows = Rows(
            self.name,
            Source(self.schema),
            np.array(self.stamps, np.int64),
            np.zeros(len(self.stamps), np.int16),
            finished(extract(fields, spec.columns)),
            labels,
        )
        return channel_of(rows, spec, ledger)

    def _report(self, ledger: Ledger) -> None:
        if self.failed:
            ledger.loss(
                "LOG-DECODE",
                f"{self.failed} messages do not fit their schema {self.schema}",
                where=self.name,
                count=self.failed,
            )
        if self.without_stamp:
            ledger.fallback(
                "TIME-LOG-TIME",
                f"{self.without_stamp} messages have no header.stamp: the recorder's time is used",
                where=self.name,
                count=self.without_stamp,
            )
        if any(stamp < UNIX_NS_FROM for stamp in self.stamps):
            ledger.fallback(
                "TIME-NO-UTC",
                "time stamps before 2001 are no UTC (simulated time?): events in this log can be "
                "used, matching by UTC is impossible",
                where=self.name,
            )


class _Reader:
    """Definitions, counts and wanted topics of one file."""

    def __init__(self, ledger: Ledger, where: str) -> None:
        self.ledger = ledger
        self.where = where
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, str] = {}
        self.topic_of: dict[int, _Topic] = {}
        self.topics: dict[tuple[str, str], _Topic] = {}
        self.counts: Counter[str] = Counter()
        self.orphans = 0
        self.promised: int | None = None

    def take(self, opcode: int, content: bytes) -> None:
        if opcode == MESSAGE_RECORD:
            self._message(content)
        elif opcode in (SCHEMA, CHANNEL, STATISTICS):
            self._define(opcode, content)

    def _message(self, content: bytes) -> None:
        if len(content) < MESSAGE.size:
            self.orphans += 1
            return
        number, _, log_time, _ = MESSAGE.unpack_from(content)
        name = self.channels.get(number)
        if name is None:
            self.orphans += 1
            return
        self.counts[name] += 1
        topic = self.topic_of.get(number)
        if topic is not None:
            topic.take(min(log_time, _LAST_NS), content[MESSAGE.size :])

    def _define(self, opcode: int, content: bytes) -> None:
        from mcap import records as library
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError

        kinds = {
            SCHEMA: library.Schema,
            CHANNEL: library.Channel,
            STATISTICS: library.Statistics,
        }
        try:
            record = kinds[opcode].read(ReadDataStream(BytesIO(content)))
        except (McapError, *_PARSE_ERRORS) as error:
            self.ledger.loss(
                "LOG-BAD-BYTES",
                f"a definition (opcode {opcode}) cannot be read: {error}",
                where=self.where,
                count=len(content),
            )
            return
        if opcode == SCHEMA:
            self.schemas.setdefault(record.id, record)
        elif opcode == STATISTICS:
            self.promised = int(record.message_count)
        elif record.id not in self.channels:  # repeated in every chunk and in the summary
            self.channels[record.id] = record.topic
            self._subscribe(record)

    def _subscribe(self, record: Any) -> None:
        schema = self.schemas.get(record.schema_id)
        name = short_name(schema.name) if schema is not None else ""
        if name not in SCHEMAS:
            return
        decode = self._decoder(record, schema, name)
        if decode is not None:
            topic = _Topic(record.topic, name, decode)
            self.topic_of[record.id] = self.topics.setdefault((record.topic, name), topic)

    def _decoder(self, record: Any, schema: Any, name: str) -> Decoder | None:
        from mcap.exceptions import McapError
        from mcap_ros2.decoder import DecoderFactory

        try:
            with redirect_stderr(StringIO()), redirect_stdout(StringIO()):  # its parser prints
                decode = DecoderFactory().decoder_for(record.message_encoding, schema)
        except (McapError, *_schema_errors(), *_DECODE_ERRORS) as error:
            self.ledger.loss(
                "LOG-SCHEMA",
                f"the schema of {name} cannot be parsed ({error}): the topic is not read",
                where=record.topic,
            )
            return None
        if decode is None:
            self.ledger.note(
                "LOG-NOT-ROS2",
                f"{name} is encoded as {record.message_encoding} with a {schema.encoding} schema, "
                "not as ROS 2 CDR: counted, not read",
                where=record.topic,
            )
            return None
        if name in HEADER_ONLY:
            return read_header
        return _values_by(decode, tuple(part.fields[0] for part in SCHEMAS[name].columns))

    def report(self, damage: Damage) -> int:
        """Compare with what the log says it holds; returns how many messages are missing."""
        if self.orphans:
            self.ledger.loss(
                "LOG-BAD-BYTES",
                f"{self.orphans} messages belong to no channel",
                where=self.where,
                count=self.orphans,
            )
        if self.promised is None:
            if not damage.losses:
                self.ledger.note(
                    "LOG-NO-STATISTICS",
                    "the log has no statistics: whether it is whole cannot be checked",
                    where=self.where,
                )
            return 0
        found = sum(self.counts.values())
        if found != self.promised:
            self.ledger.loss(
                "LOG-INCONSISTENT",
                f"{found} messages were found, the log's statistics say {self.promised}",
                where=self.where,
                count=abs(self.promised - found),
            )
        return max(self.promised - found, 0)


def _schema_errors() -> tuple[type[Exception], ...]:
    """What the parser of schemas raises; it is no public part of mcap-ros2-support."""
    try:
        from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
    except ImportError:  # another version keeps its parser elsewhere
        return (AssertionError, NameError)
    return (AssertionError, NameError, InvalidSpecification, InvalidValue)


def _values_by(decode: Callable[[bytes], Any], paths: tuple[str, ...]) -> Decoder:
    parts = [path.split(".") for path in paths]

    def values(data: bytes) -> tuple[int, str, list[float]]:
        message = decode(data)
        stamp = message.header.stamp
        time_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        return time_ns, message.header.frame_id, [_follow(message, path) for path in parts]

    return values


def _follow(message: Any, path: list[str]) -> float:
    for part in path:
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    return float(message)


def read_header(data: bytes) -> tuple[int, str, list[float]]:
    """Time and frame of a message that begins with a std_msgs/Header, without the rest of it.

    CDR: 4 bytes of encapsulation (the second even: big-endian), then sec, nanosec, length, text.
    """
    order = "<" if data[1] & 1 else ">"
    sec, nanosec, length = struct.unpack_from(f"{order}iII", data, 4)
    frame = data[16 : 16 + length].split(b"\0", 1)[0].decode("utf-8", "backslashreplace")
    return sec * 1_000_000_000 + nanosec, frame, []
