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
DEEPEST = 8  # formats inside each other
LONGEST_DATA = 0xFFFF  # [bytes]: the size of a message has two bytes
_FIELD = re.compile(r"(?P<kind>\w+)(?:\[(?P<count>\d{1,5})\])? (?P<name>\w+)")
_PADDING = "_padding"


class Field(NamedTuple):
    """A field of a format: its type, number of elements (0 for no array) and name."""

    kind: str
    elements: int
    name: str


class FlatField(NamedTuple):
    """One number of a message: its path, and its numpy type."""

    path: str
    dtype: str


_TIMESTAMP = Field("uint64_t", 0, "timestamp")


def _size(fields: list[FlatField]) -> int:
    """The bytes of fields."""
    return sum(np.dtype(field.dtype).itemsize for field in fields)


@dataclass
class FlatFormats:
    """Formats that `flat_fields` has taken apart, by name, and how many fields they have."""

    fields: dict[str, list[FlatField] | None] = field(default_factory=dict)
    count: int = 0


def flat_fields(
    name: str,
    formats: dict[str, list[Field]],
    depth: int = 0,
    flat: FlatFormats | None = None,
) -> list[FlatField] | None:
    """Names and types of all numbers of a format, also of formats nested in it, and of padding.

    None if a part of the format is not defined, or if it is longer than a message can be. ``flat``
    gets the formats that are taken apart on the way. LogError if all of these have more fields than
    any log (LOG-TOO-LARGE).

    >>> flat_fields("a", {"a": [Field("b", 2, "x")], "b": [Field("float", 0, "y")]})
    [FlatField(path='x[0].y', dtype='<f4'), FlatField(path='x[1].y', dtype='<f4')]
    """
    flat = FlatFormats() if flat is None else flat
    if name in flat.fields:
        return flat.fields[name]
    if name not in formats or depth > DEEPEST:
        return None
    flat.fields[name] = None  # also of a format that lies within itself
    result: list[FlatField] = []
    size = 0
    for part in formats[name]:
        inner: list[FlatField] | None
        if part.kind in TYPES:
            inner = [FlatField("", TYPES[part.kind])]
        else:
            inner = flat_fields(part.kind, formats, depth + 1, flat)
        if not inner:
            return None
        size += max(part.elements, 1) * _size(inner)
        if size > LONGEST_DATA:  # before its elements are made, which may be many
            return None
        result += _elements(part, inner)
    flat.fields[name] = result
    flat.count += len(result)
    check_fields(flat.count)
    return result


def _elements(field: Field, inner: list[FlatField]) -> Iterator[FlatField]:
    """The numbers of all elements of a field; ``inner`` are those of one element."""
    names = [field.name]
    if field.elements:
        names = [f"{field.name}[{k}]" for k in range(field.elements)]
    for name in names:
        for path, dtype in inner:
            yield FlatField(f"{name}.{path}" if path else name, dtype)


class Definitions:
    """The formats of a file, and the ``layouts`` of the topics with a timestamp.

    `sizes_of` adds the layout of a topic.
    """

    def __init__(self) -> None:
        self.formats: dict[str, list[Field]] = {}
        self.layouts: dict[str, np.dtype[Any]] = {}
        self._flattened = FlatFormats()
        self._sizes: dict[str, tuple[int, int] | None] = {}

    def add_format(self, content: bytes) -> bool:
        """Add the format that a definition message holds; False if that is damaged."""
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

    def sizes_of(self, name: str) -> tuple[int, int] | None:
        """The bytes of a topic's data without and with the padding at its end, not always logged.

        None if the topic is not defined, or two of its fields have the same path. If the topic has
        a timestamp, its layout without that padding is added to ``layouts``.
        """
        if name not in self._sizes:
            self._sizes[name] = self._new_sizes(name)
        return self._sizes[name]

    def _new_sizes(self, name: str) -> tuple[int, int] | None:
        """The sizes of a topic that is taken apart for the first time."""
        fields = list(flat_fields(name, self.formats, flat=self._flattened) or [])
        with_padding = _size(fields)
        while fields and fields[-1].path.startswith(_PADDING):
            fields.pop()
        has_repeated_paths = len({field.path for field in fields}) < len(fields)
        if not fields or has_repeated_paths:
            return None
        layout = np.dtype([(field.path, field.dtype) for field in fields])
        if _TIMESTAMP in self.formats[name]:
            self.layouts[name] = layout
        return layout.itemsize, with_padding


def dtype_of_value(key: re.Match[bytes] | None) -> np.dtype[Any] | None:
    """The numpy type of a keyed value; None where that is a text, an array or not known."""
    if key is None:
        return None
    kind = TYPES.get(key["type"].decode())
    return None if kind is None else np.dtype(kind)
