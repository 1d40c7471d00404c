"""Definitions of the records of a DataFlash log: what its FMT records say of each type."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

MAGIC = b"\xa3\x95"


HEADER = 3


FMT_TYPE = 128


FMT_LENGTH = 89


START = MAGIC + bytes([FMT_TYPE])


_FMT_FIELDS = (FMT_TYPE, FMT_LENGTH, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")


_FMT_PAYLOAD = struct.pack("<BB4s16s64s", *_FMT_FIELDS)


FORMAT_LETTERS: Mapping[str, Any] = {
    "a": ("<i2", (32,)), "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
    "q": "<i8", "Q": "<u8", "g": "<f2", "f": "<f4", "d": "<f8", "M": "i1", "n": "S4", "N": "S16",
    "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
}  # fmt: skip
"""Types of fields by the letters of FMT records, as in pymavlink, which takes long to import."""


DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""What integers of some letters are divided by."""


@dataclass(frozen=True)
class RecordDefinition:
    """A record type by its FMT record; ``divisors`` of the scaled fields by name."""

    type_id: int
    name: str
    length: int
    dtype: np.dtype[Any]
    divisors: Mapping[str, float]

    @property
    def fields(self) -> tuple[str, ...]:
        return self.dtype.names or ()

    @property
    def time_field(self) -> str:
        """The time since boot with which the records begin: TimeUS, until 2015 TimeMS; or ""."""
        fields: Mapping[str, Any] = self.dtype.fields or {}
        for name, kind in (("TimeUS", "<u8"), ("TimeMS", "<u4")):
            if name in fields and fields[name][:2] == (np.dtype(kind), HEADER):
                return name
        return ""


def define(payload: bytes) -> RecordDefinition | None:
    """The definition in the payload of an FMT record (86 bytes); None when it is not valid."""
    type_id, length = payload[0], payload[1]
    try:
        parts = payload[2:6], payload[6:22], payload[22:86]
        name, codes, columns = (part.split(b"\0", 1)[0].decode("ascii") for part in parts)
    except UnicodeDecodeError:
        return None
    if not name.isidentifier() or not set(codes) <= set(FORMAT_LETTERS):
        return None
    fields = tuple(columns.split(",")) if columns else ()
    kinds = [  # bytes of files stay bytes
        np.dtype(("u1", (64,)) if code == "Z" and name == "FILE" else FORMAT_LETTERS[code])
        for code in codes
    ]
    sizes = [kind.itemsize for kind in kinds]
    distinct = len(set(fields)) == len(fields) == len(kinds) and all(fields)
    if not distinct or HEADER + sum(sizes) != length:
        return None
    if type_id == FMT_TYPE and length != FMT_LENGTH:
        return None
    offsets = [HEADER + sum(sizes[:k]) for k in range(len(sizes))]
    dtype = np.dtype(
        {"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": length}
    )
    divisors = {n: DIVISORS[c] for n, c in zip(fields, codes, strict=True) if c in DIVISORS}
    return RecordDefinition(type_id, name, length, dtype, divisors)
