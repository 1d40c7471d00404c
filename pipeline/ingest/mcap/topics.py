"""Topics of an MCAP log: their messages decoded into columns, each encoding in its own way."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Source, TimeArray
from pipeline.ingest.fields import MessageMap
from pipeline.ingest.mcap.cdr import DecodePlan, decode, decode_plan
from pipeline.ingest.mcap.cdr_schema import SchemaError, steps_of
from pipeline.ingest.mcap.fields import LABELS, PLAIN_JSON
from pipeline.ingest.mcap.file_format import Messages
from pipeline.ingest.mcap.samples import STAMP, TopicSamples, own_times, since_boot, stamp_of
from pipeline.ingest.px4_fields import CAPTURE_UTC_FIELD, UTC_FIELD

Columns = dict[str, NDArray[Any]]
MAX_ARRAY = 64  # elements of an array that a table spreads over columns
MAX_NAMES = 1000  # that the messages of a topic may give; a log of values has tens
EXACT = 1 << 53  # every integer up to here is a float64
_WORD = 1 << 64


class Decoder(Protocol):
    """Messages of one definition -> columns."""

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        """The rows that could be decoded, among these, their columns, and values left out."""
        ...


@dataclass
class MessageBlock:
    """Some messages, in the order of the file: columns, own times, log_time [ns], places, numbers.

    ``counted`` says that their own times are counted in microseconds.
    """

    columns: Columns
    stamp_ns: TimeArray
    log_ns: TimeArray
    places: TimeArray
    sequence: NDArray[np.uint32]
    counted: bool

    def take(self, rows: slice | NDArray[Any]) -> MessageBlock:
        columns = {key: column[rows] for key, column in self.columns.items()}
        stamp_ns, log_ns, places = self.stamp_ns[rows], self.log_ns[rows], self.places[rows]
        return MessageBlock(columns, stamp_ns, log_ns, places, self.sequence[rows], self.counted)


@dataclass
class Topic:
    """A topic that is read, of one name of schema, and where its messages go.

    With ``series`` they become channels, one for each name that the messages give (`rows_by_name`),
    without them the ``blocks`` of a table. ``odd`` values are no numbers where one is wanted.
    """

    name: str
    schema: str
    spec: MessageMap
    series: dict[tuple[str | None, bool], TopicSamples] | None
    blocks: list[MessageBlock] = field(default_factory=list)
    failed: int = 0
    nameless: int = 0
    odd: int = 0

    def take(
        self, messages: Messages, shares: Iterable[tuple[Decoder, NDArray[np.intp]]], before: int
    ) -> list[tuple[TimeArray, TimeArray, TimeArray]]:
        """Decode some of these messages, which ``before`` others precede in the log.

        Parameters
        ----------
        shares : rows, and what decodes them: a topic may have several definitions.

        Returns places, times since boot and log_time [ns] of those that count from a boot.
        """
        blocks: list[MessageBlock] = []
        for decoder, rows in shares:
            done, columns, odd = decoder(messages, rows)
            self.failed += rows.shape[0] - len(done)
            self.odd += odd
            if len(done):
                stamp_ns, counted = own_times(columns, self.spec.time_field, len(done))
                rows = rows[done]
                log_ns, sequence = messages.log_time[rows], messages.sequence[rows]
                blocks.append(
                    MessageBlock(columns, stamp_ns, log_ns, rows + before, sequence, counted)
                )
        if self.series is None:
            self.blocks += blocks
            return []
        stamps = []
        for block in by_clock(blocks):
            for name, rows_of_name in rows_by_name(block.columns, self.spec.id_field):
                named = block.take(rows_of_name)
                key = (name, block.counted)
                if key not in self.series and len(self.series) >= MAX_NAMES:
                    self.nameless += int(named.places.shape[0])
                    continue
                if key not in self.series:
                    label = self.name if name is None else f"{self.name}[{name}]"
                    source = Source(self.schema, name)
                    self.series[key] = TopicSamples(label, source, self.spec, block.counted)
                self.series[key].add(
                    named.columns, named.stamp_ns, named.log_ns, named.places, named.sequence
                )
            booted = since_boot(block.stamp_ns)
            if block.counted and bool(booted.any()):
                stamps.append((block.places[booted], block.stamp_ns[booted], block.log_ns[booted]))
        return stamps

    @property
    def misfit(self) -> str:
        if not self.schema:
            return f"{self.failed} messages are no JSON objects that can be read"
        return f"{self.failed} messages do not fit their schema {self.schema}"

    @property
    def lost_values(self) -> int:
        """Values that are no numbers; of a schema of the user's own, only beside numbers."""
        series = (self.series or {}).values()
        wanted = self.spec is not PLAIN_JSON or any(samples.columns for samples in series)
        return self.odd if wanted else 0


def by_clock(blocks: Iterable[MessageBlock]) -> Iterable[MessageBlock]:
    """Blocks as one, those whose times are counted in microseconds apart; they are used up."""
    every = list(blocks)
    for counted in (False, True):
        of_clock = [block for block in every if block.counted == counted]
        if len(of_clock) < 2:
            yield from of_clock
            continue
        sizes = [len(block.places) for block in of_clock]
        whole = MessageBlock(
            stack_tables([block.columns for block in of_clock], sizes),
            np.concatenate([block.stamp_ns for block in of_clock]),
            np.concatenate([block.log_ns for block in of_clock]),
            np.concatenate([block.places for block in of_clock]),
            np.concatenate([block.sequence for block in of_clock]),
            counted,
        )
        in_order = bool(np.all(whole.places[1:] > whole.places[:-1]))
        yield whole if in_order else whole.take(np.argsort(whole.places))


def rows_by_name(
    columns: Columns, field: str
) -> Iterable[tuple[str | None, slice | NDArray[np.bool_]]]:
    """The names in messages, and the rows of each; None where the messages have no names.

    ``index`` is the name of those whose name is empty.
    """
    if not field or field not in columns:
        yield None, slice(None)
        return
    names = columns[field].astype(np.str_)
    if "index" in columns:
        names = np.where(names == "", columns["index"].astype(np.str_), names)
    for name in np.unique(names).tolist():
        yield str(name), names == name


def paths_of(spec: MessageMap) -> frozenset[str]:
    """The fields that a channel is made of, its time and texts included."""
    fields = {name for column in spec.columns for name in column.fields}
    at = spec.time_field
    fields |= {at, f"{at}.sec", f"{at}.nanosec", f"{at}.nsec", UTC_FIELD, CAPTURE_UTC_FIELD}
    if spec.id_field:
        fields |= {spec.id_field, "index"}
    if spec.event:
        fields |= {path for paths in LABELS.values() for path in paths.split()}
    return frozenset(fields)


@dataclass(frozen=True)
class CdrDecoder:
    """ROS 2 messages by their layout."""

    plan: DecodePlan

    @classmethod
    def of(cls, schema: str, text: str, wanted: frozenset[str] | None) -> CdrDecoder:
        """By the definition in the log; raises SchemaError."""
        return cls(decode_plan(steps_of(schema, text), wanted))

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        begin, length = messages.begin[rows], messages.length[rows]
        return (*decode(messages.data, begin, length, self.plan), 0)


@dataclass(frozen=True)
class ObjectDecoder:
    """Messages that a library decodes one by one, such as protobuf and JSON.

    ``wanted`` fields become columns, those of ``spec`` of numbers; None takes all there are.
    """

    parse: Callable[[bytes], Any]
    errors: tuple[type[Exception], ...]
    spec: MessageMap
    wanted: frozenset[str] | None

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        raw = memoryview(messages.data)  # type: ignore[arg-type]
        done: list[int] = []
        decoded: list[dict[str, Any]] = []
        for row, (begin, length) in enumerate(
            zip(messages.begin[rows].tolist(), messages.length[rows].tolist(), strict=True)
        ):
            try:
                message = self.parse(bytes(raw[begin : begin + length]))
                values = dict(flat(message, "", self.wanted))
                stamp = message
                for part in self.spec.time_field.split("."):
                    getter = stamp.get if isinstance(stamp, dict) else partial(getattr, stamp)
                    stamp = getter(part, None)
                values[STAMP] = stamp_of(stamp)
            except self.errors:
                continue
            done.append(row)
            decoded.append(values)
        if self.wanted is None:
            return done, columns_of(decoded), 0
        numbers = {name for column in self.spec.columns for name in column.fields}
        odd = 0
        for values in decoded:
            for name in numbers & values.keys():
                value = number(values[name])
                odd += value is None
                values[name] = np.nan if value is None else value
        return done, columns_of(decoded), odd


def columns_of(decoded: list[dict[str, Any]]) -> Columns:
    """Messages as dictionaries -> columns, where missing as `column_of` says."""
    names = dict.fromkeys(name for values in decoded for name in values)
    result = {name: column_of([values.get(name) for values in decoded]) for name in names}
    if STAMP in result:
        result[STAMP] = result[STAMP].astype(np.int64)
    return result


def flat(value: Any, path: str, wanted: frozenset[str] | None) -> Iterable[tuple[str, Any]]:
    """The numbers and texts of an object by their paths; of long arrays and bytes the length.

    Of what is wanted also values that are neither, but not what is empty.
    """
    if wanted is not None and path in wanted and value is not None:
        yield path, value
    if isinstance(value, bool | int | float | str):
        if wanted is None:
            yield path, value
        return
    if wanted is None and _long(value):
        yield f"{path}[]", len(value)
        return
    members: Iterable[tuple[str, Any]] = ()
    if isinstance(value, dict):
        members = ((str(name), member) for name, member in value.items())
    elif hasattr(value, "DESCRIPTOR"):
        members = ((part.name, getattr(value, part.name)) for part in value.DESCRIPTOR.fields)
    elif value is not None and hasattr(value, "__len__") and not _long(value):
        members = ((str(k), member) for k, member in enumerate(value))
    for name, member in members:
        inner = f"{path}.{name}" if path else name
        if wanted is None or any(each == inner or each.startswith(f"{inner}.") for each in wanted):
            yield from flat(member, inner, wanted)


def _long(value: Any) -> bool:
    """Whether this is bytes or a long array."""
    if isinstance(value, dict) or not hasattr(value, "__len__"):
        return False
    return isinstance(value, bytes) or len(value) > MAX_ARRAY


def json_object(data: bytes) -> dict[str, Any]:
    """A JSON object; any other text raises TypeError."""
    value = json.loads(data)
    if not isinstance(value, dict):
        raise TypeError("not an object")
    return value


def json_decoder(spec: MessageMap, wanted: frozenset[str] | None) -> ObjectDecoder:
    """JSON objects; whatever else the text is does not fit."""
    errors = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
    return ObjectDecoder(json_object, errors, spec, wanted)


def protobuf_decoder(schema: Any, spec: MessageMap, wanted: frozenset[str] | None) -> ObjectDecoder:
    """Protobuf by mcap-protobuf-support; raises ImportError without it, SchemaError on damage."""
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
    return ObjectDecoder(parse, errors, spec, wanted)


def number(value: Any) -> float | None:
    """A number, or the text of one (as protobuf writes 64 bits into JSON); else None.

    >>> number("21.5"), number("n/a"), number(10**400)
    (21.5, None, None)
    """
    try:
        return float(value) if isinstance(value, bool | int | float | str) else None
    except (ValueError, OverflowError):
        return None


def is_exact_float(value: Any) -> bool:
    """Whether a value is no integer that a float64 would alter."""
    if not isinstance(value, int) or abs(value) <= EXACT:
        return True
    return abs(value) < _WORD and int(float(value)) == value


def column_of(values: list[Any]) -> NDArray[Any]:
    """Values of any kind as one column; None is a message that has none.

    Parameters
    ----------
    values : of one field, a message each.

    Returns bool, int64, uint64 or float64 where that alters no number (NaN where one is missing),
    str where all are texts ("" where one is missing), else the values as objects.

    >>> column_of([2**60 + 1, -5]).tolist(), column_of([1, None]), column_of([1, "n/a"])
    ([1152921504606846977, -5], array([ 1., nan]), array([1, 'n/a'], dtype=object))
    """
    kinds = {type(value) for value in values}
    whole, there = type(None) not in kinds, kinds - {type(None)}
    if there == {str}:
        return np.array(["" if value is None else value for value in values], np.str_)
    if there == {bool} and whole:
        return np.array(values, np.bool_)
    if there and there <= {bool, int} and whole:
        low, high = min(values), max(values)
        if low >= -_WORD // 2 and high < _WORD // 2:
            return np.array(values, np.int64)
        if low >= 0 and high < _WORD:
            return np.array(values, np.uint64)
    if there <= {bool, int, float} and all(is_exact_float(value) for value in values):
        return np.array([np.nan if value is None else value for value in values], np.float64)
    result = np.empty(len(values), object)
    for k, value in enumerate(values):  # at once, lists of one length would be an array
        result[k] = value
    return result


def stack_tables(
    tables: Sequence[dict[str, NDArray[Any]]], counts: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """Tables of so many rows end to end, each column as `join_pieces`; they are used up."""
    if len(tables) == 1:
        return tables[0]
    names = dict.fromkeys(name for table in tables for name in table)
    pairs = list(zip(tables, counts, strict=True))
    return {name: join_pieces([table.pop(name, count) for table, count in pairs]) for name in names}


def join_pieces(pieces: Sequence[NDArray[Any] | int]) -> NDArray[Any]:
    """Pieces of a column end to end; an integer stands for so many messages without it.

    >>> join_pieces([np.array([1.5]), 1]), join_pieces([np.array(["a"]), np.array([7])])
    (array([1.5, nan]), array(['a', 7], dtype=object))
    """
    arrays = [piece for piece in pieces if isinstance(piece, np.ndarray)]
    kinds = {(a.dtype if a.dtype.kind != "U" else np.dtype(np.str_), a.shape[1:]) for a in arrays}
    dtype, shape = next(iter(kinds), (np.dtype(np.float64), ()))
    if len(kinds) <= 1 and (len(arrays) == len(pieces) or dtype.kind in "fU"):
        missing = "" if dtype.kind == "U" else np.nan
        return np.concatenate(
            [np.full((p, *shape), missing, dtype) if isinstance(p, int) else p for p in pieces]
        )
    values: list[Any] = []
    for piece in pieces:
        values += [None] * piece if isinstance(piece, int) else piece.tolist()
    return column_of(values)
