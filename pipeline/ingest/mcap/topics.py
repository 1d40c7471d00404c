"""Topics of an MCAP log: their messages decoded into columns, each encoding in its own way."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Source, TimeArray
from pipeline.ingest.fields import MessageMap
from pipeline.ingest.mcap.cdr import Program, decode, program
from pipeline.ingest.mcap.cdr_schema import steps_of
from pipeline.ingest.mcap.fields import LABELS, PLAIN_JSON
from pipeline.ingest.mcap.messages import Messages
from pipeline.ingest.mcap.samples import STAMP, Samples, own_times, since_boot
from pipeline.ingest.mcap.time import stamp_of
from pipeline.ingest.mcap.values import column_of, number, stacked
from pipeline.ingest.px4_fields import CAPTURE_UTC_FIELD, UTC_FIELD

Columns = dict[str, NDArray[Any]]
MAX_ARRAY = 64  # elements of an array that a table spreads over columns
MAX_NAMES = 1000  # that the messages of a topic may give; a log of values has tens


class Decoder(Protocol):
    """Messages of one definition -> columns."""

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        """The rows that could be decoded, among these, their columns, and values left out."""
        ...


@dataclass
class Part:
    """Some messages, in the order of the file: columns, own times, log_time [ns], places, numbers.

    ``counted`` says that their own times are counted in microseconds.
    """

    columns: Columns
    stamp_ns: TimeArray
    log_ns: TimeArray
    places: TimeArray
    sequence: NDArray[np.uint32]
    counted: bool

    def take(self, mine: slice | NDArray[Any]) -> Part:
        columns = {key: column[mine] for key, column in self.columns.items()}
        stamp_ns, log_ns, places = self.stamp_ns[mine], self.log_ns[mine], self.places[mine]
        return Part(columns, stamp_ns, log_ns, places, self.sequence[mine], self.counted)

    @classmethod
    def of(cls, parts: Sequence[Part]) -> Part:
        """Parts of one clock put together; they are handed over."""
        if len(parts) == 1:
            return parts[0]
        columns = stacked([part.columns for part in parts], [len(part.places) for part in parts])
        stamp_ns = np.concatenate([part.stamp_ns for part in parts])
        log_ns = np.concatenate([part.log_ns for part in parts])
        places = np.concatenate([part.places for part in parts])
        sequence = np.concatenate([part.sequence for part in parts])
        whole = cls(columns, stamp_ns, log_ns, places, sequence, parts[0].counted)
        if bool(np.all(whole.places[1:] > whole.places[:-1])):
            return whole
        return whole.take(np.argsort(whole.places))


@dataclass
class Topic:
    """A topic that is read, of one name of schema, and where its messages go.

    With ``series`` they become channels, one for each name that the messages give (`names_of`),
    without them the ``parts`` of a table. ``odd`` values are no numbers where one is wanted.
    """

    name: str
    schema: str
    spec: MessageMap
    series: dict[tuple[str | None, bool], Samples] | None
    parts: list[Part] = field(default_factory=list)
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
        parts: list[Part] = []
        for decoder, rows in shares:
            done, columns, odd = decoder(messages, rows)
            self.failed += rows.shape[0] - len(done)
            self.odd += odd
            if len(done):
                stamp_ns, counted = own_times(columns, self.spec.time_field, len(done))
                rows = rows[done]
                log_ns, sequence = messages.log_time[rows], messages.sequence[rows]
                parts.append(Part(columns, stamp_ns, log_ns, rows + before, sequence, counted))
        if self.series is None:
            self.parts += parts
            return []
        found = []
        for part in by_clock(parts):
            self._sort(part)
            if part.counted:
                mine = since_boot(part.stamp_ns)
                if bool(mine.any()):
                    found.append((part.places[mine], part.stamp_ns[mine], part.log_ns[mine]))
        return found

    def _sort(self, part: Part) -> None:
        """Put messages where those of their name are."""
        for name, mine in names_of(part.columns, self.spec.id_field):
            few = part.take(mine)
            series = self._series(name, part.counted)
            if series is not None:
                series.add(few.columns, few.stamp_ns, few.log_ns, few.places, few.sequence)
            else:
                self.nameless += int(few.places.shape[0])

    def _series(self, name: str | None, counted: bool) -> Samples | None:
        key = (name, counted)
        if self.series is None or (key not in self.series and len(self.series) >= MAX_NAMES):
            return None
        if key not in self.series:
            label = self.name if name is None else f"{self.name}[{name}]"
            source = Source(self.schema, name)
            self.series[key] = Samples(label, source, self.spec, counted)
        return self.series[key]

    @property
    def misfit(self) -> str:
        if not self.schema:
            return f"{self.failed} messages are no JSON objects that can be read"
        return f"{self.failed} messages do not fit their schema {self.schema}"

    @property
    def lost_values(self) -> int:
        """Values that are no numbers; of a schema of the user's own, only beside numbers."""
        series = (self.series or {}).values()
        mine = self.spec is not PLAIN_JSON or any(each.columns for each in series)
        return self.odd if mine else 0


def by_clock(parts: Iterable[Part]) -> Iterable[Part]:
    """Parts put together, those whose times are counted in microseconds apart."""
    every = list(parts)
    for counted in (False, True):
        if some := [part for part in every if part.counted == counted]:
            yield Part.of(some)


def names_of(
    columns: Columns, field: str
) -> Iterable[tuple[str | None, slice | NDArray[np.bool_]]]:
    """The names that messages give themselves, and which are theirs; None where they have none.

    ``index`` names those whose name is empty.
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

    plan: Program

    @classmethod
    def of(cls, schema: str, text: str, wanted: frozenset[str] | None) -> CdrDecoder:
        """By the definition in the log; raises SchemaError."""
        return cls(program(steps_of(schema, text), wanted))

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        begin, length = messages.begin[rows], messages.length[rows]
        return (*decode(messages.data, begin, length, self.plan), 0)


@dataclass(frozen=True)
class ObjectDecoder:
    """Messages that a library decodes one by one, such as protobuf and JSON.

    ``wanted`` fields become columns, those of ``spec`` of numbers; None takes all there are.
    """

    one: Callable[[bytes], Any]
    errors: tuple[type[Exception], ...]
    spec: MessageMap
    wanted: frozenset[str] | None

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns, int]:
        raw = memoryview(messages.data)  # type: ignore[arg-type]
        done: list[int] = []
        found: list[dict[str, Any]] = []
        for row, (begin, length) in enumerate(
            zip(messages.begin[rows].tolist(), messages.length[rows].tolist(), strict=True)
        ):
            try:
                message = self.one(bytes(raw[begin : begin + length]))
                values = dict(flat(message, "", self.wanted))
                values[STAMP] = stamp_of(_member(message, self.spec.time_field))
            except self.errors:
                continue
            done.append(row)
            found.append(values)
        if self.wanted is None:
            return done, columns_of(found), 0
        numbers = {name for column in self.spec.columns for name in column.fields}
        odd = 0
        for values in found:
            for name in numbers & values.keys():
                value = number(values[name])
                odd += value is None
                values[name] = np.nan if value is None else value
        return done, columns_of(found), odd


def columns_of(found: list[dict[str, Any]]) -> Columns:
    """Messages as dictionaries -> columns, where missing as `column_of` says."""
    names = dict.fromkeys(name for values in found for name in values)
    result = {name: column_of([values.get(name) for values in found]) for name in names}
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
    for name, member in _members(value):
        inner = f"{path}.{name}" if path else name
        if wanted is None or any(each == inner or each.startswith(f"{inner}.") for each in wanted):
            yield from flat(member, inner, wanted)


def _members(value: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(value, dict):
        return ((str(name), member) for name, member in value.items())
    if hasattr(value, "DESCRIPTOR"):
        return ((part.name, getattr(value, part.name)) for part in value.DESCRIPTOR.fields)
    if value is None or not hasattr(value, "__len__") or _long(value):
        return ()
    return ((str(k), member) for k, member in enumerate(value))


def _long(value: Any) -> bool:
    """Whether this is bytes or a long array."""
    if isinstance(value, dict) or not hasattr(value, "__len__"):
        return False
    return isinstance(value, bytes) or len(value) > MAX_ARRAY


def _member(value: Any, path: str) -> Any:
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
    return value


def json_decoder(spec: MessageMap, wanted: frozenset[str] | None) -> ObjectDecoder:
    """JSON objects; whatever else the text is does not fit."""
    errors = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
    return ObjectDecoder(_json_object, errors, spec, wanted)


def _json_object(data: bytes) -> dict[str, Any]:
    value = json.loads(data)
    if not isinstance(value, dict):
        raise TypeError("not an object")
    return value


def protobuf_decoder(schema: Any, spec: MessageMap, wanted: frozenset[str] | None) -> ObjectDecoder:
    """Protobuf by mcap-protobuf-support; raises ImportError without it, or as it refuses."""
    from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    from mcap_protobuf.decoder import DecoderFactory

    one = DecoderFactory().decoder_for("protobuf", schema)
    if one is None:
        raise TypeError(f"a {schema.encoding} schema")
    errors = (DecodeError, ValueError, TypeError, OverflowError, RuntimeError)
    return ObjectDecoder(one, errors, spec, wanted)
