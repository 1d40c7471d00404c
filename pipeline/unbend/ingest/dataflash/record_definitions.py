"""Definitions of the records of a DataFlash log, read from its FMT records."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

MAGIC = b"\xa3\x95"  # with which each record begins
HEADER = 3  # [bytes] of a record before its fields: the magic and its type
FMT_TYPE = 128  # the type of records that define types
FMT_LENGTH = 89  # [bytes] of such a record
START = MAGIC + bytes([FMT_TYPE])  # with which a log begins
_FMT_PAYLOAD = struct.pack(
    "<BB4s16s64s", FMT_TYPE, FMT_LENGTH, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"
)

FORMAT_LETTERS: Mapping[str, Any] = {
    "a": ("<i2", (32,)), "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
    "q": "<i8", "Q": "<u8", "g": "<f2", "f": "<f4", "d": "<f8", "M": "i1", "n": "S4", "N": "S16",
    "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
}  # fmt: skip
"""Types of fields by the letters of FMT records, as in pymavlink, which takes long to import."""

DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""The divisors of scaled integers, by letter: the logged integer over the divisor is the value."""

_BYTES_OF_FILE = ("u1", (64,))  # the field Z of the message FILE is bytes, not text

# Where the payload of an FMT record has its texts; before them are the type and the length.
NAME_BYTES = slice(2, 6)
_LETTERS_BYTES = slice(6, 22)
_COLUMNS_BYTES = slice(22, 86)


@dataclass(frozen=True)
class RecordDefinition:
    """A type of records as its FMT record defines it.

    length : bytes of a record with its header.
    dtype : a whole record; the header is part of it, but not a field.
    divisors : the divisors of scaled integers, by the name of the field.
    """

    type_id: int
    name: str
    length: int
    dtype: np.dtype[Any]
    divisors: Mapping[str, float]

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the fields."""
        return self.dtype.names or ()

    @property
    def time_field(self) -> str:
        """The field of the time since boot: TimeUS, until 2015 TimeMS; "" without such a field.

        It is used only if it is the first field, with the usual type (uint64 or uint32).
        """
        fields: Mapping[str, Any] = self.dtype.fields or {}
        for name, kind in (("TimeUS", "<u8"), ("TimeMS", "<u4")):
            if name not in fields:
                continue
            kind_of_field, offset = fields[name]
            if offset == HEADER and kind_of_field == np.dtype(kind):
                return name
        return ""


def define(payload: bytes) -> RecordDefinition | None:
    """The definition in the payload of an FMT record (86 bytes); None when it is not valid."""
    type_id = payload[0]
    length = payload[1]
    try:
        name = _text(payload[NAME_BYTES])
        letters = _text(payload[_LETTERS_BYTES])
        columns = _text(payload[_COLUMNS_BYTES])
    except UnicodeDecodeError:
        return None
    fields = columns.split(",") if columns else []
    if not name.isidentifier() or not _are_described(fields, letters):
        return None
    if type_id == FMT_TYPE and length != FMT_LENGTH:
        return None
    layout = _layout(name, letters, fields)
    if layout.itemsize != length:
        return None
    divisors = {}
    for field, letter in zip(fields, letters, strict=True):
        if letter in DIVISORS:
            divisors[field] = DIVISORS[letter]
    return RecordDefinition(type_id, name, length, layout, divisors)


def _are_described(fields: list[str], letters: str) -> bool:
    """Whether all fields have distinct names and one known letter each."""
    if not set(letters) <= set(FORMAT_LETTERS):
        return False
    return len(fields) == len(letters) == len(set(fields)) and "" not in fields


def _layout(name: str, letters: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of the records of a message, with their header."""
    kinds = []
    offsets = []
    end = HEADER
    for letter in letters:
        is_file = letter == "Z" and name == "FILE"
        kind = np.dtype(_BYTES_OF_FILE if is_file else FORMAT_LETTERS[letter])
        kinds.append(kind)
        offsets.append(end)
        end += kind.itemsize
    layout = {"names": fields, "formats": kinds, "offsets": offsets, "itemsize": end}
    return np.dtype(layout)  # type: ignore[call-overload, no-any-return]


def _text(raw: bytes) -> str:
    """ASCII text up to the first NUL."""
    return raw.split(b"\0", 1)[0].decode("ascii")


def definition_of_fmt() -> RecordDefinition:
    """The definition of the records that define all others."""
    definition = define(_FMT_PAYLOAD)
    if definition is None:
        raise LookupError("the definition of FMT is not valid")
    return definition
