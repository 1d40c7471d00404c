"""One pass over an MCAP log: definitions, counts, and the topics that are read."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from unbend.flight.clock import UNIX_NS_FROM
from unbend.ingest.buffers import open_view
from unbend.ingest.field_maps import MessageMap
from unbend.ingest.limits import MAX_SERIES, SeriesLimit
from unbend.ingest.mcap import messages, topics
from unbend.ingest.mcap.cdr import StepBudget
from unbend.ingest.mcap.damage import Damage
from unbend.ingest.mcap.mcap_records import RecordWalk
from unbend.ingest.mcap.message_batches import Messages
from unbend.ingest.mcap.message_counts import MessageCounts
from unbend.ingest.mcap.record_layout import Definition, Opcode
from unbend.ingest.mcap.ros2_definitions import SchemaError
from unbend.ingest.mcap.topic_samples import PLAIN_JSON, SCHEMAS, TopicSamples, message_name
from unbend.ingest.message_tables import rows_by_value
from unbend.ingest.timelines import Stamps
from unbend.ingest.utc_evidence import UNCHECKED_SIGMA_S, UNCHECKED_WHY
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger, Message
from unbend.units import Integers, Rows

# What the library's parsers of records raise on damaged lengths and text, apart from McapError.
_PARSE_ERRORS = (struct.error, ValueError, OverflowError)
# What a definition that is damaged makes the libraries raise.
_SCHEMA_ERRORS = (SchemaError, UnicodeDecodeError, TypeError, ValueError, KeyError, RuntimeError)

# Of messages and of their definitions; JSON needs none.
READ_ENCODINGS = {("cdr", "ros2msg"), ("protobuf", "protobuf")}
RECORDER_SAMPLES = 512  # messages of each batch (4 MiB): log_time and time since boot are kept
MAX_CONTRADICTIONS = 1000  # definitions that differ from an earlier one; no log has any
LISTED_CONTRADICTIONS = 8  # in the ledger


class TopicKey(NamedTuple):
    """A topic, and the name of its messages; some topics have several."""

    topic: str
    schema: str


class _Subscription(NamedTuple):
    """The topic to which the messages of a channel belong, and what decodes them."""

    topic: topics.Topic
    decoder: topics.Decoder


class McapReader:
    """Reads one file: its definitions, counts and topics.

    ``only``: the name of the one topic to read, with all fields; None for all topics that channels
    are made of, with the fields for these. ``unread``: why topics that are wanted are not read; it
    is in the ledger too. ``unread_encodings``: those of any messages that are not read, each with
    its first topic.
    """

    def __init__(self, ledger: Ledger, file: str, only: str | None = None) -> None:
        self.ledger = ledger
        self.file = file
        self.only = only
        self.damage = Damage(file)
        self.counts = MessageCounts()
        self.names: dict[int, str] = {}  # topics, by the number of their channel
        self.topics: dict[TopicKey, topics.Topic] = {}
        self.unread: list[Message] = []
        self.unread_encodings: dict[str, str] = {}
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self._contents: dict[tuple[int, bytes], bytes] = {}  # of definitions: opcode and number
        self._contradictions: set[str] = set()
        self._decoders: dict[tuple[int, str], topics.Decoder | Exception] = {}
        self._subscriptions: dict[int, _Subscription] = {}
        self.recorded_ns: int | None = None  # log_time of the first message that has UTC
        self._parse_budget = topics.ParseBudget()
        self._step_budget = StepBudget()
        self.series_limit = SeriesLimit()  # of all topics together
        self._crowded_out: set[int] = set()  # channels of topics beyond `MAX_SERIES`
        self._messages_seen = 0  # messages, of any channel
        self._recorded: list[Integers] = []  # (3, n): places, times since boot [ns], log_time [ns]

    def read_file(self, path: Path) -> Iterator[Stamps]:
        """Read the file; yields the places and times since boot of its messages that have one.

        The file is read as far as the result is iterated: all of it when that is exhausted.
        """
        with open_view(path) as data:
            self._parse_budget = topics.ParseBudget.of_file(data.size)
            self._step_budget = StepBudget.of_file(data.size)
            for part in RecordWalk(data, self.damage):
                if isinstance(part, Definition):
                    self._define(part)
                    continue
                stamps = self._take_batch(part)
                if stamps:
                    yield self._merged_stamps(stamps)

    def _take_batch(self, batch: Messages) -> list[topics.BootStamps]:
        """Count messages and hand them to their topics; returns the stamps since boot of these."""
        shares: dict[TopicKey, list[tuple[topics.Decoder, Rows]]] = {}
        rows_of = dict(rows_by_value(batch.channel))
        for number in self.counts.take(batch, self.names):
            if number in self._subscriptions:
                topic, decoder = self._subscriptions[number]
                rows = rows_of[number]
                shares.setdefault(TopicKey(topic.name, topic.schema), []).append((decoder, rows))
        if self.recorded_ns is None:
            with_utc = batch.log_time[batch.log_time > UNIX_NS_FROM]
            self.recorded_ns = int(with_utc[0]) if with_utc.size else None
        messages_before = self._messages_seen
        self._messages_seen += len(batch)
        stamps: list[topics.BootStamps] = []
        for key, shares_of_topic in shares.items():
            stamps += self.topics[key].take(batch, shares_of_topic, messages_before)
        return stamps

    def _merged_stamps(self, stamps: list[topics.BootStamps]) -> Stamps:
        """Stamps of several topics in the order of the log.

        At most `RECORDER_SAMPLES` of them are kept with log_time, for `recorder_readings`.
        """
        places = np.concatenate([part.places for part in stamps])
        boot_ns = np.concatenate([part.boot_ns for part in stamps])
        log_ns = np.concatenate([part.log_ns for part in stamps])
        order = np.argsort(places)
        step = -(-order.shape[0] // RECORDER_SAMPLES)  # rounded up
        sample = order[::step]
        self._recorded.append(np.stack([places[sample], boot_ns[sample], log_ns[sample]]))
        return places[order], boot_ns[order]

    def recorder_readings(self) -> UtcReadings | None:
        """The recorder's log_time as UTC of times since boot, of some messages of each batch.

        None if no message has a time since boot.
        """
        if not self._recorded:
            return None
        places, boot_ns, log_ns = np.concatenate(self._recorded, axis=1)
        return UtcReadings(
            source="log_time",
            places=places,
            boot_ns=boot_ns,
            utc_ns=log_ns,
            usable=log_ns > UNIX_NS_FROM,
            sigma_s=UNCHECKED_SIGMA_S,
            why=UNCHECKED_WHY,
        )

    def release_topics(self) -> None:
        """Forget the topics, so that the memory of their samples is freed with their last user."""
        self.topics.clear()
        self._subscriptions.clear()

    def _define(self, definition: Definition) -> None:
        """Parse a definition and keep it, a channel with its topic if that is wanted.

        Of several schemas or channels with one number the first is used: copies, as in every chunk,
        are passed over, and a later one that differs is a contradiction. Of several statistics the
        last are used. A definition that cannot be parsed is damage.
        """
        from mcap import records as library
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError

        if self._is_skipped(definition):
            return
        kinds = {Opcode.SCHEMA: library.Schema, Opcode.CHANNEL: library.Channel}
        kind = kinds.get(definition.opcode, library.Statistics)
        try:
            record = kind.read(ReadDataStream(BytesIO(definition.content)))
        except (McapError, *_PARSE_ERRORS) as error:
            self.damage.add(
                messages.definition_unreadable(
                    where=self.damage.place_in_words(definition.place),
                    count=len(definition.content),
                    opcode=definition.opcode,
                    reason=str(error),
                )
            )
            return
        if kind is library.Statistics:
            self.counts.stated = dict(record.channel_message_counts)
            self.counts.stated_total = int(record.message_count)
            return
        definitions = self._schemas if kind is library.Schema else self._channels
        if record.id in definitions:
            if definitions[record.id] != record:
                self._contradictions.add(f"{kind.__name__.lower()} {record.id}")
            return
        definitions[record.id] = record
        if kind is library.Channel:
            self.names[record.id] = record.topic
            self._subscribe(record)

    def _is_skipped(self, definition: Definition) -> bool:
        """Whether a definition is not parsed: it is a copy, or too many contradict earlier ones.

        The content of the first definition of each kind and number is kept for that.
        """
        number = definition.content[:2]  # of a schema or a channel; of statistics just two bytes
        first = self._contents.setdefault((definition.opcode, number), definition.content)
        is_new = first is definition.content  # not only equal: it was entered in the line before
        if is_new:
            return False
        is_copy = first == definition.content
        return is_copy or len(self._contradictions) > MAX_CONTRADICTIONS

    def _subscribe(self, channel: Any) -> None:
        """Begin to read the topic of a channel, if it is wanted and can be decoded."""
        schema = self._schemas.get(channel.schema_id)
        name = ""
        encoding_of_schema = ""
        if schema is not None:
            name = message_name(schema.name)
            encoding_of_schema = schema.encoding
        self._note_unread_encoding(channel.topic, channel.message_encoding, encoding_of_schema)
        if self.only is None:
            is_wanted = name in SCHEMAS or channel.message_encoding == "json"
        else:
            is_wanted = channel.topic == self.only
        if not is_wanted:
            return
        spec = SCHEMAS.get(name, PLAIN_JSON)
        decoder = self._decoder(channel, schema, name, spec)
        if isinstance(decoder, Exception):
            self._leave_unread(
                messages.schema_not_parsed(topic=channel.topic, schema=name, reason=str(decoder))
            )
        elif decoder is not None:
            key = TopicKey(channel.topic, name)
            if key not in self.topics and len(self.topics) >= MAX_SERIES:
                self._crowded_out.add(channel.id)
                return
            if key not in self.topics:
                series: dict[topics.SeriesKey, TopicSamples] | None = None if self.only else {}
                self.topics[key] = topics.Topic(
                    channel.topic, name, spec, series, limit=self.series_limit
                )
            self._subscriptions[channel.id] = _Subscription(self.topics[key], decoder)

    def _note_unread_encoding(
        self, topic: str, message_encoding: str, schema_encoding: str
    ) -> None:
        """Keep the encodings of a topic in ``unread_encodings`` if its messages cannot be read."""
        if message_encoding == "json" or (message_encoding, schema_encoding) in READ_ENCODINGS:
            return
        described = (
            f"{message_encoding or 'no encoding'} with {schema_encoding or 'no'} definitions"
        )
        self.unread_encodings.setdefault(described, topic)

    def _decoder(
        self,
        channel: Any,
        schema: Any,
        name: str,
        spec: MessageMap,
    ) -> topics.Decoder | Exception | None:
        """The decoder of the messages of a channel, or the error of a schema that cannot be parsed.

        ``name`` and ``spec``: the key and the map of the messages in `SCHEMAS`. None where the
        encoding is not read, or the library for it is missing. Thousands of channels may share a
        schema: it is parsed once.
        """
        key = (channel.schema_id, channel.message_encoding)
        decoder = self._decoders.get(key)
        if decoder is None:
            try:
                decoder = self._new_decoder(channel, schema, name, spec)
            except ImportError:
                self._leave_unread(
                    messages.protobuf_not_installed(topic=channel.topic, schema=name)
                )
            except _SCHEMA_ERRORS as error:
                decoder = error
            if decoder is not None:
                self._decoders[key] = decoder
        return decoder

    def _new_decoder(
        self,
        channel: Any,
        schema: Any,
        name: str,
        spec: MessageMap,
    ) -> topics.Decoder | None:
        """A new decoder of the messages of a channel; None where their encoding is not read.

        JSON needs no schema; messages of any other encoding cannot be read without a schema.
        """
        wanted = None if self.only else topics.paths_of(spec)
        encoding = channel.message_encoding
        if encoding == "json":
            return topics.json_decoder(spec, wanted, self._parse_budget)
        if schema is None:
            return None
        if encoding == "cdr" and schema.encoding == "ros2msg":
            return topics.cdr_decoder(schema.name, schema.data.decode(), wanted, self._step_budget)
        if encoding == "protobuf" and schema.encoding == "protobuf":
            return topics.protobuf_decoder(schema, spec, wanted, self._parse_budget)
        self._leave_unread(
            messages.encoding_not_read(
                topic=channel.topic,
                schema=name,
                encoding=encoding,
                schema_encoding=schema.encoding,
            )
        )
        return None

    def _leave_unread(self, reason: Message) -> None:
        """Enter why a topic is not read, in the ledger and in ``unread``."""
        self.unread.append(reason)
        self.ledger.add(reason)

    def report(self) -> int:
        """Enter damage and losses in the ledger; returns how many messages are missing."""
        self.ledger.extend(self.damage.messages())
        if self._contradictions:
            self.ledger.add(
                messages.definitions_differ(
                    file=self.file,
                    count=len(self._contradictions),
                    examples=sorted(self._contradictions)[:LISTED_CONTRADICTIONS],
                )
            )
        for topic in self.topics.values():
            self.ledger.extend(topic.losses())
        self.series_limit.dropped += int(self.counts.counts[list(self._crowded_out)].sum())
        if self._step_budget.dropped:
            self.ledger.add(
                messages.too_many_elements(file=self.file, count=self._step_budget.dropped)
            )
        self.series_limit.report(self.ledger, self.file)
        damaged = bool(self.damage.losses)
        return self.counts.report(self.names, self.ledger, self.file, damaged=damaged)
