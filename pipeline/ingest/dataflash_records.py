"""Walking the records of an ArduPilot DataFlash log, and round the damage in it.

A record is 0xA3 0x95, a type byte and a payload whose length the FMT record of that type gave.
There is no checksum: what proves a record is that the next one begins where it ends.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\xa3\x95"
HEADER = 3
FMT_TYPE = 128
FMT_LENGTH = 89
FMT_START = MAGIC + bytes([FMT_TYPE])
BLOCK = 65_536  # rows gathered at once: an index takes eight times the bytes that it fetches
LINKS = 3  # records in a row that prove a place to go on after damage


@dataclass(frozen=True)
class Definition:
    """What an FMT record said: the name of a type, and where its fields are.

    ``divisors`` by field name, 1 where the field is not scaled.
    """

    type_id: int
    name: str
    length: int
    dtype: np.dtype[Any]
    divisors: Mapping[str, float]


@dataclass(frozen=True)
class Walk:
    """Where the records are: offsets (n,) and definition numbers (n,), in the order of the file.

    ``bad_bytes`` lie outside all records, the first at ``first_bad``; ``cut_bytes`` are a last
    record that the end of the file cuts off; ``refused`` FMT records that make no sense.
    """

    definitions: tuple[Definition, ...]
    offsets: NDArray[np.int64]
    numbers: NDArray[np.int32]
    bad_bytes: int
    first_bad: int
    cut_bytes: int
    refused: tuple[str, ...]


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
    kinds = [_numpy_kind(FORMAT_TO_STRUCT[code][0]) for code in codes]
    sizes = [kind.itemsize for kind in kinds]
    distinct = len(set(fields)) == len(fields) == len(kinds)
    if not distinct or HEADER + sum(sizes) != length:
        return None
    offsets = [HEADER + sum(sizes[:k]) for k in range(len(sizes))]
    dtype = np.dtype(
        {"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": length}
    )
    # 1/0.01 and 1/1e-7 are exactly 100 and 1e7, and division is what the library does.
    divisors = {
        field: 1.0 / scale if scale else 1.0
        for field, scale in zip(fields, form.msg_mults, strict=True)
    }
    return Definition(type_id, name, length, dtype, divisors)


def _numpy_kind(letters: str) -> np.dtype[Any]:
    """The numpy type of one field of a struct format: ``64s`` -> S64, ``h`` -> <i2."""
    return np.dtype(f"S{letters[:-1]}" if letters.endswith("s") else f"<{letters}")


class _Walker:
    """The state of one walk: which type has which length now, and what was found."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.size = len(data)
        self.definitions: list[Definition] = []
        self.number_of = [-1] * 256
        self.length_of = [0] * 256
        self.length_of[FMT_TYPE] = FMT_LENGTH
        self.seen: dict[bytes, int] = {}
        self.refused: list[str] = []
        self.offsets = array("q")
        self.numbers = array("i")
        self.bad: list[tuple[int, int]] = []
        self.cut_bytes = 0

    def walk(self) -> None:
        data, end = self.data, self.size - HEADER
        length_of, number_of = self.length_of, self.number_of
        keep_offset, keep_number = self.offsets.append, self.numbers.append
        at = 0
        while at <= end:
            length = length_of[data[at + 2]]
            if data[at] != 0xA3 or data[at + 1] != 0x95 or not length or at + length > self.size:
                at = self._resume(at)
                continue
            kind = data[at + 2]
            if kind == FMT_TYPE:
                self._learn(at)
            keep_offset(at)
            keep_number(number_of[kind])
            at += length
        if at < self.size:
            self._resume(at)

    def _learn(self, at: int) -> None:
        payload = self.data[at + HEADER : at + FMT_LENGTH]
        if payload not in self.seen:
            definition = define(payload)
            if definition is None:
                self.refused.append(f"type {payload[0]} {payload[2:6]!r} at byte {at}")
                return
            self.seen[payload] = len(self.definitions)
            self.definitions.append(definition)
        number = self.seen[payload]
        definition = self.definitions[number]
        self.number_of[definition.type_id] = number
        self.length_of[definition.type_id] = definition.length

    def _resume(self, at: int) -> int:
        """Past the damage at a byte where no record begins: where to go on."""
        begin = self._suspect(at)
        found = self._next(begin + 1)
        if found == self.size and self._is_cut(at):
            self.cut_bytes = self.size - at
            return self.size
        if begin < at:  # the record before is part of the damage
            self.offsets.pop()
            self.numbers.pop()
        self.bad.append((begin, found - begin))
        return found

    def _suspect(self, at: int) -> int:
        """Where the damage found at a byte begins: there, or at the record before.

        A record whose type byte was flipped ends in the wrong place. It is given up when records
        follow from inside it, or when nothing at its end looks like a header.
        """
        if not self.offsets:
            return at
        before = self.offsets[-1]
        if before + self.length_of[self.data[before + 2]] != at:
            return at  # damage ended right there, and begins again
        inside = self.data.find(MAGIC, before + HEADER, at)
        while inside != -1:
            if self._chain(inside):
                return before
            inside = self.data.find(MAGIC, inside + 1, at)
        header = self.data[at : at + 2]
        return at if not header or header[:1] == MAGIC[:1] or header[1:] == MAGIC[1:] else before

    def _next(self, at: int) -> int:
        """The next byte from which a chain of records runs, or the end of the file."""
        at = self.data.find(MAGIC, at)
        while at != -1:
            if self._chain(at):
                return at
            at = self.data.find(MAGIC, at + 1)
        return self.size

    def _chain(self, at: int) -> bool:
        for link in range(LINKS):
            header = self.data[at : at + HEADER]
            if not MAGIC.startswith(header[:2]):
                return False
            if len(header) < HEADER:
                return True
            length = self.length_of[header[2]]
            if not length:
                return False
            at += length
            if at >= self.size:
                return at == self.size or link > 0  # the last record may be cut
        return True

    def _is_cut(self, at: int) -> bool:
        """Whether the file ends inside a record that begins here."""
        header = self.data[at : at + HEADER]
        if not MAGIC.startswith(header[:2]):
            return False
        return len(header) < HEADER or self.length_of[header[2]] > self.size - at


def walk(data: bytes) -> Walk:
    """Find every whole record of a DataFlash log.

    Parameters
    ----------
    data : the file.

    Returns where the records are and what lies between them. A flipped type byte costs that one
    record; after any damage the walk goes on where a chain of three records begins.
    """
    walker = _Walker(data)
    walker.walk()
    numbers = np.frombuffer(walker.numbers, np.int32)
    offsets = np.frombuffer(walker.offsets, np.int64)
    return Walk(
        tuple(walker.definitions),
        offsets,
        numbers,
        sum(count for _, count in walker.bad),
        min((first for first, _ in walker.bad), default=-1),
        walker.cut_bytes,
        tuple(walker.refused),
    )


def gather(data: bytes, walk: Walk, number: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """The records of one definition as a structured array, and their places in the walk."""
    definition = walk.definitions[number]
    rows = np.flatnonzero(walk.numbers == number)
    records = byte_rows(data, walk.offsets[rows], definition.length)
    return records.view(definition.dtype).reshape(rows.shape[0]), rows


def byte_rows(data: bytes, at: NDArray[np.int64], length: int) -> NDArray[np.uint8]:
    """The ``length`` bytes from each place on, (n, length)."""
    source = np.frombuffer(data, np.uint8)
    rows = np.empty((at.shape[0], length), np.uint8)
    for begin in range(0, at.shape[0], BLOCK):
        block = at[begin : begin + BLOCK]
        rows[begin : begin + BLOCK] = source[block[:, None] + np.arange(length)]
    return rows
