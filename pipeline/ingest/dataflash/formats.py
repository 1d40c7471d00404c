"""What an FMT record of an ArduPilot log defines: a type, its length and its fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER = 3
FMT_TYPE = 128
FMT_LENGTH = 89
_FMT_PAYLOAD = (
    bytes([FMT_TYPE, FMT_LENGTH])
    + b"FMT".ljust(4, b"\0")
    + b"BBnNZ".ljust(16, b"\0")
    + b"Type,Length,Name,Format,Columns".ljust(64, b"\0")
)


@dataclass(frozen=True)
class Definition:
    """What an FMT record said: the name of a type, and where its fields are.

    ``divisors`` of the scaled fields by field name: values are integers that are to be divided.
    ``letters`` by field name: the format letters of ArduPilot's LogStructure.h.
    """

    type_id: int
    name: str
    length: int
    dtype: np.dtype[Any]
    divisors: Mapping[str, float]
    letters: Mapping[str, str]

    @property
    def fields(self) -> tuple[str, ...]:
        return self.dtype.names or ()

    @property
    def timed(self) -> bool:
        """Whether the records begin with their time, as all do since 2014."""
        fields = self.dtype.fields
        return (
            fields is not None
            and "TimeUS" in fields
            and fields["TimeUS"][:2] == (np.dtype("<u8"), HEADER)
        )


def define(payload: bytes) -> Definition | None:
    """The definition in the payload of an FMT record (86 bytes); None when it cannot be right."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT, DFFormat

    type_id, length = payload[0], payload[1]
    try:
        name, codes, columns = (
            part.split(b"\0", 1)[0].decode("ascii")
            for part in (payload[2:6], payload[6:22], payload[22:86])
        )
    except UnicodeDecodeError:
        return None
    if not name.isidentifier() or not set(codes) <= set(FORMAT_TO_STRUCT):
        return None
    form = DFFormat(type_id, name, length, codes, columns)
    fields = tuple(form.columns)
    kinds = [_numpy_kind(code, FORMAT_TO_STRUCT[code][0], name) for code in codes]
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
    # 1/0.01 and 1/1e-7 are exactly 100 and 1e7, and division is what the library does.
    divisors = {
        field: 1.0 / scale for field, scale in zip(fields, form.msg_mults, strict=True) if scale
    }
    return Definition(type_id, name, length, dtype, divisors, dict(zip(fields, codes, strict=True)))


def _numpy_kind(code: str, letters: str, name: str) -> np.dtype[Any]:
    """The numpy type of one field: ``64s`` -> S64, ``h`` -> <i2; bytes of files stay bytes."""
    if code == "a":
        return np.dtype(("<i2", (32,)))
    if code == "Z" and name == "FILE":
        return np.dtype(("u1", (64,)))
    return np.dtype(f"S{letters[:-1]}" if letters.endswith("s") else f"<{letters}")


def builtin() -> Definition:
    """The definition of FMT records, which a reader has to know before it reads any."""
    definition = define(_FMT_PAYLOAD)
    if definition is None:
        raise LookupError("pymavlink does not know the format letters of FMT")
    return definition


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL.

    UTF-8, or Latin-1 where a field is not valid UTF-8, which is what pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    different, places = np.unique(raw, return_inverse=True)
    known = [_text(value) for value in different.tolist()]
    return np.array(known, np.str_)[places] if known else np.empty(0, "U1")


def _text(value: bytes) -> str:
    try:
        return value.decode("utf-8").split("\0", 1)[0]
    except UnicodeDecodeError:
        return value.decode("latin-1").split("\0", 1)[0]
