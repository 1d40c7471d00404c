"""Topics of an MCAP log: their messages decoded into columns, each encoding in its own way."""

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Source, TimeArray
from unbend.ingest.field_maps import CAPTURE_UTC_FIELD, UTC_FIELD, MessageMap
from unbend.ingest.mcap.cdr import decode, decode_plan
from unbend.ingest.mcap.mcap_records import Messages
from unbend.ingest.mcap.ros2_definitions import SchemaError, steps_of
from unbend.ingest.mcap.stamps import LOG_TIME, SEQUENCE, STAMP, own_times, since_boot, stamp_of
from unbend.ingest.mcap.topic_samples import LABELS, PLAIN_JSON, TopicSamples
from unbend.ingest.message_tables import PLACE, column_of, in_order
from unbend.units import Mask, Rows

Columns = dict[str, NDArray[Any]]
MAX_ARRAY = 64  # elements of an array that a table spreads over columns
MAX_NAMES = 1000  # that the messages of a topic may give; a log of values has tens


Decoder = Callable[[Messages, Rows], tuple[Any, Columns, int]]
"""Rows of messages of one definition -> those that could be decoded, counted among these, their
columns, and how many values were left out."""


@dataclass
class Topic:
    """A topic that is read, of one name of schema, and where its messages go.

    To ``series`` of channels, one for each name in them (`rows_by_name`), or, where that is None,
    to the ``blocks`` of a table, counted times apart. ``odd`` values are wanted and no numbers.
    """

    name: str
    schema: str
    spec: MessageMap
    series: dict[tuple[str | None, bool], TopicSamples] | None
    blocks: dict[bool, list[Columns]] = field(default_factory=lambda: {False: [], True: []})
    failed: int = 0
    nameless: int = 0
    odd: int = 0

    def take(
        self, messages: Messages, shares: Iterable[tuple[Decoder, Rows]], before: int
    ) -> list[tuple[TimeArray, TimeArray, TimeArray]]:
        """Decode some of these messages, which ``before`` others precede in the log.

        ``shares``: rows, and what decodes them: a topic may have several definitions. Returns
        places, times since boot and log_time [ns] of those that count from a boot.
        """
        blocks: dict[bool, list[Columns]] = {False: [], True: []}
        for decoder, rows in shares:
            done, columns, odd = decoder(messages, rows)
            self.failed += rows.shape[0] - len(done)
            self.odd += odd
            if len(done):
                stamp, counted = own_times(columns, self.spec.time_field, len(done))
                rows = rows[done]
                columns |= {STAMP: stamp, LOG_TIME: messages.log_time[rows]}
                columns |= {PLACE: rows + before, SEQUENCE: messages.sequence[rows]}
                (blocks if self.series is not None else self.blocks)[counted].append(columns)
        stamps: list[tuple[TimeArray, TimeArray, TimeArray]] = []
        if self.series is None:
            return stamps
        for counted, parts in blocks.items():
            if not parts:
                continue
            block = in_order(parts)
            for name, rows_of_name in rows_by_name(block, self.spec.id_field):
                named = {path: column[rows_of_name] for path, column in block.items()}
                key = (name, counted)
                if key not in self.series and len(self.series) >= MAX_NAMES:
                    self.nameless += int(named[PLACE].shape[0])
                    continue
                if key not in self.series:
                    label = self.name if name is None else f"{self.name}[{name}]"
                    source = Source(self.schema, name)
                    self.series[key] = TopicSamples(label, source, self.spec, counted)
                self.series[key].add(named)
            booted = since_boot(block[STAMP])
            if counted and bool(booted.any()):
                names = (PLACE, STAMP, LOG_TIME)
                places, boot_ns, log_ns = (block[name][booted] for name in names)
                stamps.append((places, boot_ns, log_ns))
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
        wanted = self.spec is not PLAIN_JSON or any(one.columns.stores for one in series)
        return self.odd if wanted else 0


def rows_by_name(columns: Columns, field: str) -> Iterable[tuple[str | None, slice | Mask]]:
    """The names in messages (of empty ones the ``index``) or None, and the rows of each."""
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


def cdr_decoder(schema: str, text: str, wanted: frozenset[str] | None) -> Decoder:
    """ROS 2 messages, by their definition in the log; raises SchemaError."""
    plan = decode_plan(steps_of(schema, text), wanted)

    def decoder(messages: Messages, rows: Rows) -> tuple[Any, Columns, int]:
        begin, length = messages.begin[rows], messages.length[rows]
        return (*decode(messages.data, begin, length, plan), 0)

    return decoder


def object_decoder(
    parse: Callable[[bytes], Any],
    errors: tuple[type[Exception], ...],
    spec: MessageMap,
    wanted: frozenset[str] | None,
) -> Decoder:
    """Messages that a library decodes one by one; ``wanted`` fields become columns, None: all."""

    def values_of(raw: bytes) -> dict[str, Any]:
        message = parse(raw)
        values = dict(flat(message, "", wanted))
        stamp = message
        for part in spec.time_field.split("."):
            getter = stamp.get if isinstance(stamp, dict) else partial(getattr, stamp)
            stamp = getter(part, None)
        return values | {STAMP: stamp_of(stamp)}

    def decoder(messages: Messages, rows: Rows) -> tuple[Any, Columns, int]:
        raw = memoryview(messages.data)  # type: ignore[arg-type]
        places = zip(messages.begin[rows].tolist(), messages.length[rows].tolist(), strict=True)
        decoded: dict[int, dict[str, Any]] = {}
        for row, (begin, length) in enumerate(places):
            with suppress(*errors):
                decoded[row] = values_of(bytes(raw[begin : begin + length]))
        odd = 0
        numbers = {name for column in spec.columns for name in column.fields}
        for values in decoded.values() if wanted is not None else ():
            for name in numbers & values.keys():
                value = number(values[name])
                odd += value is None
                values[name] = np.nan if value is None else value
        found = [*decoded.values()]
        names = dict.fromkeys(name for values in found for name in values)
        columns = {name: column_of([values.get(name) for values in found]) for name in names}
        if STAMP in columns:
            columns[STAMP] = columns[STAMP].astype(np.int64)
        return list(decoded), columns, odd

    return decoder


def flat(value: Any, path: str, wanted: frozenset[str] | None) -> Iterable[tuple[str, Any]]:
    """Numbers and texts of an object by path; of long arrays the length, of what is wanted all."""
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


def json_decoder(spec: MessageMap, wanted: frozenset[str] | None) -> Decoder:
    """JSON objects; whatever else the text is does not fit."""

    def parse(data: bytes) -> dict[str, Any]:
        value = json.loads(data)
        if not isinstance(value, dict):
            raise TypeError("not an object")
        return value

    errors = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
    return object_decoder(parse, errors, spec, wanted)


def protobuf_decoder(schema: Any, spec: MessageMap, wanted: frozenset[str] | None) -> Decoder:
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
    return object_decoder(parse, errors, spec, wanted)


def number(value: Any) -> float | None:
    """A number, or the text of one (as protobuf writes 64 bits into JSON); else None.

    >>> number("21.5"), number("n/a"), number(10**400)
    (21.5, None, None)
    """
    try:
        return float(value) if isinstance(value, bool | int | float | str) else None
    except (ValueError, OverflowError):
        return None
