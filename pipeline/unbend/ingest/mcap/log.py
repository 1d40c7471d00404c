"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

import struct
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from unbend.errors import LogError
from unbend.flight.clock import BOOT_STEP_NS, UNIX_NS_FROM
from unbend.ingest.boot_clock import BootClock, Stamps, Timeline, UtcReadings, fit_clock, timeline
from unbend.ingest.buffers import open_view
from unbend.ingest.channel_builder import channel_of
from unbend.ingest.log import PLACE, Contents, LogFormat, Table, in_order
from unbend.ingest.mcap import samples, topics
from unbend.ingest.mcap.cdr import SchemaError
from unbend.ingest.mcap.records import MAGIC, Damage, Definition, Messages, Opcode, RecordWalk
from unbend.messages import Ledger
from unbend.units import Integers, Rows

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


def make_names_unique(series: list[samples.TopicSamples]) -> None:
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


def boots_of_topics(line: Timeline, series: Sequence[samples.TopicSamples]) -> Timeline:
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
    line: Timeline, series: list[samples.TopicSamples], recorder: UtcReadings | None, ledger: Ledger
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
            del block[samples.SEQUENCE]
            log_ns, places = block.pop(samples.LOG_TIME), block[PLACE] if counted else None
            time_ns, boot, _ = samples.times_of(
                block.pop(samples.STAMP), log_ns, places, clock, ledger=reader.ledger, where=name
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


# What the library's parsers of records raise on damaged lengths and text, beside McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)
# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)

CHANNEL_NUMBERS = 1 << 16  # they are 16 bits wide
RECORDED = 512  # messages of each block (4 MiB) whose log_time is kept beside their time since boot
MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any


class MessageCounts:
    """Messages by channel, steps of their numbers; ``stated`` by the log's own statistics."""

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
        result: Counter[str] = Counter()
        for number in np.flatnonzero(self.counts).tolist():
            result[names[number]] += int(self.counts[number])
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
            apart = ", ".join(names.get(number, f"channel {number}") for number in wrong[:8])
            what = f"{total} messages were read, the log's statistics state {self.stated_total}"
            what += f"; they differ for {apart}" if apart else ""
            count = max(abs(self.stated_total - total), 1)
            ledger.loss("LOG-INCONSISTENT", what, where=where, count=count)
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
        name = samples.known_name(schema.name) if schema is not None else ""
        plain = channel.message_encoding == "json" and name not in samples.SCHEMAS
        if self.only is None and name not in samples.SCHEMAS and not plain:
            return
        if self.only is not None and channel.topic != self.only:
            return
        spec = samples.SCHEMAS.get(name, samples.PLAIN_JSON)
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
