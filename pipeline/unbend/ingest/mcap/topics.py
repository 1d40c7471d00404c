"""Topics of an MCAP log: their messages decoded into columns, each encoding in its own way."""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Source, TimeArray
from unbend.ingest.field_maps import CAPTURE_UTC_FIELD, UTC_FIELD, MessageMap
from unbend.ingest.limits import SeriesLimit, check_cells
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.cdr import StepBudget, decode, decode_plan
from unbend.ingest.mcap.message_batches import Messages
from unbend.ingest.mcap.ros2_definitions import SchemaError, steps_of
from unbend.ingest.mcap.stamps import LOG_TIME, SEQUENCE, STAMP, own_times, since_boot, stamp_of
from unbend.ingest.mcap.topic_samples import LABELS, PLAIN_JSON, TopicSamples
from unbend.ingest.message_tables import PLACE, column_of, in_order, rows_by_value
from unbend.messages import Message
from unbend.units import Integers, Rows

Columns = dict[str, NDArray[Any]]
MAX_ARRAY = 64  # elements of an array that become columns; of a longer one only the length does
# Messages of JSON and protobuf are parsed one by one, at some 50 MB/s and 10 us for each; chunks of
# them may inflate to more than the file has bytes.
FREE_PARSED = 32 << 20  # [bytes] of any file: 0.6 s
PARSED_RATIO = 40  # ... and as many times its size: 0.8 s a MB
BYTES_OF_PARSE = 500  # that take as long to parse as the rest of a message
MAX_NAMES = 1000  # series that the names in the messages of a topic may make; usual are tens


class Decoded(NamedTuple):
    """Messages of one definition that could be decoded.

    rows : their rows among the messages handed to the decoder.
    columns : their values by path.
    non_numeric : how many wanted values are not numbers, and became NaN.
    unparsed, parse_limit : how many messages are beyond the `ParseBudget`, and its limit [bytes].
    """

    rows: Rows
    columns: Columns
    non_numeric: int = 0
    unparsed: int = 0
    parse_limit: int = 0


Decoder = Callable[[Messages, Rows], Decoded]
"""Decodes those messages of a batch that are in some rows and have one definition."""


class BootStamps(NamedTuple):
    """(n,) places in the log, times since boot and log_time [ns] of messages that have both."""

    places: Integers
    boot_ns: TimeArray
    log_ns: TimeArray


class SeriesKey(NamedTuple):
    """Which samples of a topic go into one series.

    name : a name in its messages; None where these have no names.
    from_integer : whether their times were integers (see `OwnTimes`).
    """

    name: str | None
    from_integer: bool


def _no_blocks() -> dict[bool, list[Columns]]:
    """No columns yet: an empty list for each ``from_integer`` of `OwnTimes`."""
    return {False: [], True: []}


@dataclass
class Topic:
    """A topic that is read, with messages of one name of schema, and what was read of it.

    Its messages become channels or a table.

    series : for channels, the samples of each name in the messages (`rows_by_name`); None for a
        table.
    blocks : for a table, its columns batch by batch, by ``from_integer`` of `OwnTimes`.
    failed : how many messages could not be decoded.
    beyond_max_names : how many messages were left out because their names are beyond `MAX_NAMES`.
    non_numeric : how many wanted values are not numbers.
    unparsed, parse_limit : how many messages are beyond the `ParseBudget`, and its limit [bytes].
    limit : how many series all topics may have.
    """

    name: str
    schema: str
    spec: MessageMap
    series: dict[SeriesKey, TopicSamples] | None
    blocks: dict[bool, list[Columns]] = field(default_factory=_no_blocks)
    failed: int = 0
    beyond_max_names: int = 0
    non_numeric: int = 0
    unparsed: int = 0
    parse_limit: int = 0
    limit: SeriesLimit = field(default_factory=SeriesLimit)

    def take(
        self, batch: Messages, shares: Iterable[tuple[Decoder, Rows]], messages_before: int
    ) -> list[BootStamps]:
        """Decode the messages of this topic in a batch, and add them to its series or its blocks.

        ``shares``: decoders, and the rows of the batch for each: a topic may have several
        definitions. ``messages_before``: how many messages precede the batch in the log. Returns
        the stamps that count from a boot; an empty list for a table.
        """
        # The blocks of a table are kept; those of channels become samples of the series below.
        blocks = self.blocks if self.series is None else _no_blocks()
        for decoder, rows in shares:
            decoded = decoder(batch, rows)
            self.failed += rows.shape[0] - len(decoded.rows) - decoded.unparsed
            self.unparsed += decoded.unparsed
            self.parse_limit = max(self.parse_limit, decoded.parse_limit)
            self.non_numeric += decoded.non_numeric
            if not len(decoded.rows):
                continue
            columns = decoded.columns
            decoded_rows = rows[decoded.rows]  # of the batch
            times = own_times(columns, self.spec.time_field, len(decoded.rows))
            columns[STAMP] = times.time_ns
            columns[LOG_TIME] = batch.log_time[decoded_rows]
            columns[PLACE] = decoded_rows + messages_before
            columns[SEQUENCE] = batch.sequence[decoded_rows]
            blocks[times.from_integer].append(columns)
        stamps = []
        if self.series is not None:
            for from_integer, parts in blocks.items():
                if parts:
                    stamps += self._add_samples(
                        in_order(parts), self.series, from_integer=from_integer
                    )
        return stamps

    def _add_samples(
        self, block: Columns, series: dict[SeriesKey, TopicSamples], *, from_integer: bool
    ) -> list[BootStamps]:
        """Add messages to the series of their names; returns the stamps that count from a boot.

        ``block``: the columns of the messages; ``from_integer`` of their times as of `OwnTimes`.
        Messages with names beyond the limits are left out, but their stamps are returned too.
        """
        for name, rows in rows_by_name(block, self.spec.id_field):
            key = SeriesKey(name, from_integer)
            if key not in series:
                count = int(block[PLACE][rows].shape[0])
                if len(series) >= MAX_NAMES:
                    self.beyond_max_names += count
                    continue
                if not self.limit.admits(count):
                    continue
                series[key] = self._new_series(key)
            part = {path: column[rows] for path, column in block.items()}
            series[key].add(part)
        from_boot = since_boot(block[STAMP])
        if not from_integer or not bool(from_boot.any()):
            return []
        return [
            BootStamps(block[PLACE][from_boot], block[STAMP][from_boot], block[LOG_TIME][from_boot])
        ]

    def _new_series(self, key: SeriesKey) -> TopicSamples:
        """An empty series for a name in the messages, which becomes a part of its own name."""
        label = self.name if key.name is None else f"{self.name}[{key.name}]"
        return TopicSamples(
            name=label,
            source=Source(self.schema, key.name),
            spec=self.spec,
            from_integer=key.from_integer,
        )

    def named_series(self) -> list[TopicSamples]:
        """The series of this topic, to be called when all messages are read; none of a table.

        If the messages have a single name, which only repeats the topic, the series drops it.
        """
        if self.series is None:
            return []
        names = {key.name for key in self.series}
        if len(names) == 1 and self.spec.omits_only_id:
            for samples in self.series.values():
                samples.name = self.name
                samples.source = Source(self.schema, None)
        return list(self.series.values())

    @property
    def misfit(self) -> Message:
        """The report of how many messages of this topic could not be decoded."""
        return messages.messages_not_decoded(topic=self.name, schema=self.schema, count=self.failed)

    def losses(self) -> Iterator[Message]:
        """Reports of the messages and values of this topic that are missing."""
        if self.failed:
            yield self.misfit
        if self.non_numeric and self._wants_numbers():
            yield messages.values_not_numbers(topic=self.name, count=self.non_numeric)
        if self.unparsed:
            yield messages.objects_too_large(
                topic=self.name, count=self.unparsed, limit=self.parse_limit
            )
        if self.beyond_max_names:
            yield messages.too_many_names(
                topic=self.name, count=self.beyond_max_names, most=MAX_NAMES
            )

    def _wants_numbers(self) -> bool:
        """Whether a value that is not a number is a loss.

        In a schema of `SCHEMAS` it is. In JSON of another schema it is only if the topic has
        numbers too.
        """
        if self.spec is not PLAIN_JSON:
            return True
        return any(samples.columns.stores for samples in (self.series or {}).values())


def rows_by_name(columns: Columns, field: str) -> Iterable[tuple[str | None, slice | Rows]]:
    """The distinct names in a ``field`` of messages, and the rows of each.

    An empty name is replaced by the ``index`` of the message, if there is such a field. Without a
    field of names, the only name is None, with all rows.
    """
    if not field or field not in columns:
        yield None, slice(None)
        return
    names = columns[field].astype(np.str_).astype(object)
    if columns[field].dtype.kind == "O":  # names that are too long for one column of str
        names = np.array([str(name) for name in columns[field].tolist()], object)
    if "index" in columns:
        is_empty = names == ""
        names[is_empty] = columns["index"].astype(np.str_)[is_empty]
    yield from rows_by_value(names)


def paths_of(spec: MessageMap) -> frozenset[str]:
    """The paths of the fields that are read for a channel: values, time, UTC, names and texts."""
    time = spec.time_field
    paths = {time, f"{time}.sec", f"{time}.nanosec", f"{time}.nsec"}
    paths |= {UTC_FIELD, CAPTURE_UTC_FIELD, *spec.fields}
    if spec.id_field:
        paths |= {spec.id_field, "index"}
    if spec.event:
        for alternatives in LABELS.values():
            paths |= set(alternatives)
    return frozenset(paths)


def cdr_decoder(
    schema: str, text: str, wanted: frozenset[str] | None, budget: StepBudget | None = None
) -> Decoder:
    """The decoder of ROS 2 messages of the name ``schema``; ``text``: their definition in the log.

    ``wanted``: paths of the fields that become columns, None for all. Raises SchemaError.
    """
    plan = decode_plan(steps_of(schema, text), wanted)

    def decoder(batch: Messages, rows: Rows) -> Decoded:
        decoded = decode(batch.data, batch.begin[rows], batch.length[rows], plan, budget)
        return Decoded(decoded.rows, decoded.columns)

    return decoder


@dataclass
class ParseBudget:
    """How many bytes of messages may be parsed one by one, of all topics of a log."""

    limit: int = FREE_PARSED
    bytes_left: int = FREE_PARSED

    @classmethod
    def of_file(cls, size: int) -> "ParseBudget":
        """The budget of a file of ``size`` bytes: more for a larger one."""
        limit = FREE_PARSED + PARSED_RATIO * size
        return cls(limit, limit)

    def spend(self, length: int) -> bool:
        """Take a message of ``length`` bytes from the budget; False if too few are left."""
        cost = length + BYTES_OF_PARSE
        if cost > self.bytes_left:
            return False
        self.bytes_left -= cost
        return True


@dataclass(frozen=True)
class ObjectDecoder:
    """A decoder of messages that a library parses one by one.

    parse : turns the bytes of a message into an object.
    errors : what ``parse`` and the reading of members raise on a message that does not fit; such a
        message is left out.
    wanted : paths of the fields that become columns; None for all.
    """

    parse: Callable[[bytes], Any]
    errors: tuple[type[Exception], ...]
    spec: MessageMap
    wanted: frozenset[str] | None
    budget: ParseBudget = field(default_factory=ParseBudget)

    def __call__(self, batch: Messages, rows: Rows) -> Decoded:
        """Decode the messages in some rows of a batch."""
        raw = memoryview(batch.data)  # type: ignore[arg-type]
        begins = batch.begin[rows].tolist()
        lengths = batch.length[rows].tolist()
        parsed_rows = []
        parsed_values = []
        unparsed = 0
        for row, (begin, length) in enumerate(zip(begins, lengths, strict=True)):
            if not self.budget.spend(length):
                unparsed += 1
                continue
            with suppress(*self.errors):
                values_of_message = self._values_of(bytes(raw[begin : begin + length]))
                parsed_values.append(values_of_message)
                parsed_rows.append(row)
        non_numeric = 0
        if self.wanted is not None:
            for values in parsed_values:
                non_numeric += _make_numbers(values, self.spec.fields)
        names = dict.fromkeys(name for values in parsed_values for name in values)
        check_cells(len(names), len(parsed_values), sum(map(len, parsed_values)))
        # None where a message lacks the field: `column_of` fills it in.
        columns = {}
        for name in names:
            columns[name] = column_of([values.get(name) for values in parsed_values])
        if STAMP in columns:
            columns[STAMP] = columns[STAMP].astype(np.int64)
        return Decoded(
            rows=np.array(parsed_rows, np.intp),
            columns=columns,
            non_numeric=non_numeric,
            unparsed=unparsed,
            parse_limit=self.budget.limit,
        )

    def _values_of(self, raw: bytes) -> dict[str, Any]:
        """The values of one message by path, and its own time as `STAMP`; 0 without a time."""
        message = self.parse(raw)
        values = dict(flat_values(message, "", self.wanted))
        member = message  # from here down to the time
        for name in self.spec.time_field.split("."):
            member = member.get(name) if isinstance(member, dict) else getattr(member, name, None)
        values[STAMP] = stamp_of(member)
        return values


def _make_numbers(values: dict[str, Any], fields: set[str]) -> int:
    """Replace the values of some fields by numbers, in place.

    Returns how many values are not numbers; these become NaN.
    """
    non_numeric = 0
    for name in fields & values.keys():
        value = as_number(values[name])
        if value is None:
            non_numeric += 1
            value = np.nan
        values[name] = value
    return non_numeric


def flat_values(value: Any, path: str, wanted: frozenset[str] | None) -> Iterable[tuple[str, Any]]:
    """The paths and values of the members of an object, and of their members.

    ``path``: that of ``value``, "" for a whole message. With ``wanted`` paths the result is the
    wanted values, whatever they are. With None it is all numbers and texts, and the lengths of long
    arrays, as ``path[]``.
    """
    if wanted is not None and path in wanted and value is not None:
        yield path, value  # a member of it may be wanted too
    if isinstance(value, bool | int | float | str):
        if wanted is None:
            yield path, value
        return
    if wanted is None and _is_long(value):
        yield f"{path}[]", len(value)
        return
    for name, member in _members(value):
        inner = f"{path}.{name}" if path else name
        if wanted is None or _leads_to_wanted(inner, wanted):
            yield from flat_values(member, inner, wanted)


def _leads_to_wanted(path: str, wanted: frozenset[str]) -> bool:
    """Whether a path is wanted, or is that of an object with wanted members."""
    return path in _with_prefixes(wanted)


@lru_cache(maxsize=64)
def _with_prefixes(wanted: frozenset[str]) -> frozenset[str]:
    """Wanted paths, and those of all objects around them.

    >>> sorted(_with_prefixes(frozenset({"header.stamp.sec"})))
    ['header', 'header.stamp', 'header.stamp.sec']
    """
    paths = set()
    for path in wanted:
        parts = path.split(".")
        paths |= {".".join(parts[:end]) for end in range(1, len(parts) + 1)}
    return frozenset(paths)


def _members(value: Any) -> Iterator[tuple[str, Any]]:
    """The members of a JSON object, of a protobuf message or of a short array, by name or index.

    A number and bytes have none. Texts are not handed over here: `flat_values` keeps them whole.
    """
    if isinstance(value, dict):
        for name, member in value.items():
            yield str(name), member
    elif hasattr(value, "DESCRIPTOR"):
        for part in value.DESCRIPTOR.fields:
            yield part.name, getattr(value, part.name)
    elif hasattr(value, "__len__") and not _is_long(value):
        for index, member in enumerate(value):
            yield str(index), member


def _is_long(value: Any) -> bool:
    """Whether a value is bytes, or an array of more than `MAX_ARRAY` elements."""
    if isinstance(value, dict) or not hasattr(value, "__len__"):
        return False
    return isinstance(value, bytes) or len(value) > MAX_ARRAY


def json_decoder(spec: MessageMap, wanted: frozenset[str] | None, budget: ParseBudget) -> Decoder:
    """The decoder of JSON objects; a message that is other JSON is left out.

    ``wanted``: paths of the fields that become columns, None for all. ``budget``: of the log.
    """
    errors = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
    return ObjectDecoder(_json_object, errors, spec, wanted, budget)


def _json_object(data: bytes) -> dict[str, Any]:
    """A JSON object; TypeError for anything else."""
    value = json.loads(data)
    if not isinstance(value, dict):
        raise TypeError("not an object")
    return value


def protobuf_decoder(
    schema: Any,
    spec: MessageMap,
    wanted: frozenset[str] | None,
    budget: ParseBudget,
) -> Decoder:
    """The decoder of protobuf messages, by mcap-protobuf-support.

    ``schema``: the record of the mcap library. ``wanted``: paths of the fields that become columns,
    None for all. ``budget``: of the log. Raises ImportError without that library, SchemaError for a
    damaged schema, and TypeError for a schema in another encoding.
    """
    from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    from mcap.exceptions import McapError
    from mcap_protobuf.decoder import DecoderFactory

    try:
        parse = DecoderFactory().decoder_for("protobuf", schema)
    except (DecodeError, McapError) as error:
        raise SchemaError(str(error)) from error
    if parse is None:
        raise TypeError(f"a {schema.encoding} schema")
    errors = (DecodeError, ValueError, TypeError, OverflowError, RuntimeError)
    return ObjectDecoder(parse, errors, spec, wanted, budget)


def as_number(value: Any) -> float | None:
    """The number that a value is, or that a text states (64 bits of protobuf in JSON); else None.

    >>> as_number("21.5"), as_number("n/a"), as_number(10**400)
    (21.5, None, None)
    """
    if not isinstance(value, bool | int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None
