"""Formats of a ULog file: which fields the messages of a topic have, nested ones flattened."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from unbend.ingest.limits import check_fields

TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "bool": "i1", "char": "i1", "int16_t": "<i2",
    "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4", "float": "<f4", "int64_t": "<i8",
    "uint64_t": "<u8", "double": "<f8",
}  # fmt: skip
MAX_DEPTH = 8  # of formats inside each other
MAX_DATA_SIZE = 0xFFFF  # [bytes]: the size of a message has two bytes
_FIELD = re.compile(r"(?P<kind>\w+)(?:\[(?P<count>\d{1,5})\])? (?P<name>\w+)")
_PADDING = "_padding"  # names of fields without content begin so


class Field(NamedTuple):
    """A field of a format: its type, number of elements (0 if it is not an array) and name."""

    kind: str
    elements: int
    name: str


class FlatField(NamedTuple):
    """One number of a message: its path, and its numpy type."""

    path: str
    dtype: str


_TIMESTAMP = Field("uint64_t", 0, "timestamp")


def _size(fields: list[FlatField]) -> int:
    """How many bytes the values of these fields have together."""
    return sum(np.dtype(field.dtype).itemsize for field in fields)


@dataclass
class FlatFormats:
    """The formats that `flat_fields` has flattened.

    fields : the fields of each by the format's name, None of a format that cannot be used.
    count : of the fields of all formats.
    """

    fields: dict[str, list[FlatField] | None] = field(default_factory=dict)
    count: int = 0


def flat_fields(
    name: str,
    formats: dict[str, list[Field]],
    depth: int = 0,
    flattened: FlatFormats | None = None,
) -> list[FlatField] | None:
    """Names and types of all numbers of a format, also of formats nested in it, and of padding.

    ``depth``: how many formats are around this one. ``flattened`` gets the formats that are
    flattened on the way. None if a part of the format is not defined or contains the format itself,
    or if it is longer than a message can be. LogError if all flattened formats have more fields
    than any log (LOG-TOO-LARGE).

    >>> flat_fields("a", {"a": [Field("b", 2, "x")], "b": [Field("float", 0, "y")]})
    [FlatField(path='x[0].y', dtype='<f4'), FlatField(path='x[1].y', dtype='<f4')]
    """
    flattened = FlatFormats() if flattened is None else flattened
    if name in flattened.fields:
        return flattened.fields[name]
    if name not in formats or depth > MAX_DEPTH:
        return None
    flattened.fields[name] = None  # stays None of a format that contains itself
    result: list[FlatField] = []
    size = 0
    for part in formats[name]:
        inner: list[FlatField] | None
        if part.kind in TYPES:
            inner = [FlatField("", TYPES[part.kind])]
        else:
            inner = flat_fields(part.kind, formats, depth + 1, flattened)
        if not inner:
            return None
        size += max(part.elements, 1) * _size(inner)
        if size > MAX_DATA_SIZE:  # before its elements are made, which may be many
            return None
        result += _elements(part, inner)
    flattened.fields[name] = result
    flattened.count += len(result)
    check_fields(flattened.count)
    return result


def _elements(field: Field, inner: list[FlatField]) -> Iterator[FlatField]:
    """The numbers of all elements of a field; ``inner``: the numbers of one element."""
    names = [field.name]
    if field.elements:
        names = [f"{field.name}[{index}]" for index in range(field.elements)]
    for name in names:
        for path, dtype in inner:
            yield FlatField(f"{name}.{path}" if path else name, dtype)


class DataSizes(NamedTuple):
    """The bytes of a topic's data without and with the padding at its end, not always logged."""

    without_padding: int
    with_padding: int


class Definitions:
    """The formats of a file by name, and the numpy types of the data of topics, ``layouts``.

    `sizes_of` adds the layout of a topic, if the topic has a timestamp.
    """

    def __init__(self) -> None:
        self.formats: dict[str, list[Field]] = {}
        self.layouts: dict[str, np.dtype[Any]] = {}
        self._flattened = FlatFormats()
        self._sizes: dict[str, DataSizes | None] = {}

    def add_format(self, content: bytes) -> bool:
        """Add the format in the content of a definition message; False if that is damaged."""
        name, colon, text = content.decode("ascii", "replace").partition(":")
        fields = []
        for part in text.split(";"):
            if not part:
                continue
            match = _FIELD.fullmatch(part)
            if match is None:
                return False
            elements = int(match["count"] or 0)
            is_empty_array = match["count"] is not None and elements == 0
            if is_empty_array:
                return False
            fields.append(Field(match["kind"], elements, match["name"]))
        if not colon or not fields:
            return False
        self.formats[name] = fields
        self._flattened = FlatFormats()
        self._sizes.clear()
        return True

    def sizes_of(self, name: str) -> DataSizes | None:
        """The sizes of a topic's data.

        None if the topic is not defined, or two of its fields have the same path. If the topic has
        a timestamp, its layout without the padding at the end is added to ``layouts``.
        """
        if name not in self._sizes:
            self._sizes[name] = self._new_sizes(name)
        return self._sizes[name]

    def _new_sizes(self, name: str) -> DataSizes | None:
        """The sizes of a topic that is asked for the first time; its layout is added."""
        fields = list(flat_fields(name, self.formats, flattened=self._flattened) or [])
        size_with_padding = _size(fields)
        while fields and fields[-1].path.startswith(_PADDING):
            fields.pop()
        has_repeated_paths = len({field.path for field in fields}) < len(fields)
        if not fields or has_repeated_paths:
            return None
        layout = np.dtype([(field.path, field.dtype) for field in fields])
        if _TIMESTAMP in self.formats[name]:
            self.layouts[name] = layout
        return DataSizes(layout.itemsize, size_with_padding)


def dtype_of_value(key: re.Match[bytes] | None) -> np.dtype[Any] | None:
    """The numpy type of a keyed value; None if that is an array (also a text) or not known.

    ``key``: the match of a key as in ``int32_t NAME``, None without one.
    """
    if key is None:
        return None
    kind = TYPES.get(key["type"].decode())
    return None if kind is None else np.dtype(kind)
