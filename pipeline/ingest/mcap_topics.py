"""Topics of an MCAP log: their messages decoded into columns, each encoding in its own way."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.cdr import Program, decode, program
from pipeline.ingest.cdr_schema import steps_of
from pipeline.ingest.fields import MessageMap
from pipeline.ingest.mcap_fields import CAPTURE_UTC_FIELD, LABELS, UTC_FIELD
from pipeline.ingest.mcap_messages import Messages
from pipeline.ingest.mcap_samples import STAMP, Samples
from pipeline.ingest.mcap_time import stamp_of

Columns = dict[str, NDArray[Any]]
MAX_ARRAY = 64  # elements of an array that a table spreads over columns


class Decoder(Protocol):
    """Messages of one definition -> columns."""

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns]:
        """The rows that could be decoded, among these, and their columns."""
        ...


@dataclass
class Topic:
    """A topic that is read: its decoder, and where the messages go.

    With ``samples`` they become a channel, without the ``parts`` of a table.
    """

    name: str
    schema: str
    spec: MessageMap
    decoder: Decoder
    samples: Samples | None
    parts: list[tuple[Columns, NDArray[np.int64]]] = field(default_factory=list)
    failed: int = 0

    def take(self, messages: Messages, rows: NDArray[np.intp]) -> None:
        """Decode some of these messages."""
        done, columns = self.decoder(messages, rows)
        self.failed += rows.shape[0] - len(done)
        if not len(done):
            return
        log_ns = messages.log_time[rows[done]]
        if self.samples is not None:
            self.samples.add(columns, log_ns)
        else:
            self.parts.append((columns, log_ns))

    def whole(self) -> tuple[Columns, NDArray[np.int64]]:
        """The table as columns, and the recorder's time [ns]; they are handed over."""
        parts, self.parts = self.parts, []
        if not parts:
            return {}, np.empty(0, np.int64)
        names = list(dict.fromkeys(name for columns, _ in parts for name in columns))
        whole = {}
        for name in names:
            pieces = [
                columns.pop(name) if name in columns else _absent(name, parts, time.shape[0])
                for columns, time in parts
            ]
            whole[name] = np.concatenate(pieces)
        return whole, np.concatenate([time for _, time in parts])


def _absent(name: str, parts: list[tuple[Columns, NDArray[np.int64]]], count: int) -> NDArray[Any]:
    """What stands for a field that JSON left out of some messages."""
    texts = any(columns[name].dtype.kind == "U" for columns, _ in parts if name in columns)
    return np.full(count, "" if texts else np.nan)


def paths_of(spec: MessageMap) -> frozenset[str]:
    """The fields that a channel is made of, its time and texts included."""
    fields = {name for column in spec.columns for name in column.fields}
    at = spec.time_field
    fields |= {at, f"{at}.sec", f"{at}.nanosec", f"{at}.nsec", UTC_FIELD, CAPTURE_UTC_FIELD}
    if spec.event:
        fields |= {path for paths in LABELS.values() for path in paths.split()}
    return frozenset(fields)


@dataclass(frozen=True)
class CdrDecoder:
    """ROS 2 messages by their layout."""

    todo: Program

    @classmethod
    def of(cls, schema: str, text: str, wanted: frozenset[str] | None) -> CdrDecoder:
        """By the definition in the log; raises SchemaError."""
        return cls(program(steps_of(schema, text), wanted))

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns]:
        begin, length = messages.begin[rows], messages.length[rows]
        return decode(messages.data, begin, length, self.todo)


@dataclass(frozen=True)
class ObjectDecoder:
    """Messages that a library decodes one by one, such as protobuf and JSON.

    ``wanted`` fields become columns of numbers or texts; None takes all there are.
    """

    one: Callable[[bytes], Any]
    errors: tuple[type[Exception], ...]
    time_field: str
    wanted: frozenset[str] | None

    def __call__(self, messages: Messages, rows: NDArray[np.intp]) -> tuple[Any, Columns]:
        raw = memoryview(messages.data)  # type: ignore[arg-type]
        done: list[int] = []
        found: list[dict[str, Any]] = []
        for row, (begin, length) in enumerate(
            zip(messages.begin[rows].tolist(), messages.length[rows].tolist(), strict=True)
        ):
            try:
                message = self.one(bytes(raw[begin : begin + length]))
                values = dict(flat(message, "", self.wanted))
                values[STAMP] = stamp_of(_member(message, self.time_field))
            except self.errors:
                continue
            done.append(row)
            found.append(values)
        return done, columns_of(found)


def columns_of(found: list[dict[str, Any]]) -> Columns:
    """Messages as dictionaries -> columns; NaN or an empty text where one has no such field."""
    result: Columns = {}
    for name in dict.fromkeys(name for values in found for name in values):
        values = [message.get(name) for message in found]
        if name == STAMP:
            result[name] = np.array(values, np.int64)
        elif any(isinstance(value, str) for value in values):
            result[name] = np.array(["" if v is None else str(v) for v in values], np.str_)
        else:
            result[name] = np.array([np.nan if v is None else float(v) for v in values])
    return result


def flat(value: Any, path: str, wanted: frozenset[str] | None) -> Iterable[tuple[str, Any]]:
    """The numbers and texts of an object by their paths; long arrays are left out."""
    if isinstance(value, bool | int | float | str):
        if wanted is None or path in wanted:
            yield path, value
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
    if value is None or isinstance(value, bytes) or not hasattr(value, "__len__"):
        return ()
    return ((str(k), member) for k, member in enumerate(value)) if len(value) <= MAX_ARRAY else ()


def _member(value: Any, path: str) -> Any:
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
    return value


def json_decoder(spec: MessageMap, wanted: frozenset[str] | None) -> ObjectDecoder:
    """JSON objects; whatever else the text is does not fit."""
    errors = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
    return ObjectDecoder(_json_object, errors, spec.time_field, wanted)


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
    return ObjectDecoder(one, errors, spec.time_field, wanted)
