"""Walking the records of an ArduPilot DataFlash log, and round the damage in it.

A record is 0xA3 0x95, a type byte and a payload whose length the FMT record of that type gave.
There is no checksum: what proves a record is that the next one begins where it ends. All places
where a record may begin are found at once in a block of the file; where each ends on the next,
nothing has to be walked.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import SPAN, FileView, gather
from pipeline.ingest.dataflash.formats import (
    FMT_LENGTH,
    FMT_TYPE,
    HEADER,
    Definition,
    builtin,
    define,
)

MAGIC = b"\xa3\x95"
FMT_START = MAGIC + bytes([FMT_TYPE])
LINKS = 3  # records in a row that prove a place to go on after damage
LONGEST = 255  # bytes of a record: its length is one byte
REACH = 1 << 14  # [bytes] first searched after damage: the next record is seldom farther
MOST_DEFINITIONS = 1 << 15  # real logs have 16 to 200; the number of one fits two bytes


@dataclass(frozen=True)
class Part:
    """The records that begin in one block of the file: 6 bytes for each.

    ``base`` is the block's place, ``at`` (n,) the records' places behind it, rising; ``numbers``
    (n,) their definitions.
    """

    base: int
    at: NDArray[np.uint32]
    numbers: NDArray[np.uint16]

    def end(self) -> int:
        """A place behind the last record."""
        return self.base + int(self.at[-1]) + LONGEST if self.at.size else self.base

    def only(self, wanted: NDArray[np.bool_]) -> Part:
        """The records of some definitions; ``wanted`` says for each whether it is."""
        rows = wanted[self.numbers]
        return Part(self.base, self.at[rows], self.numbers[rows])


@dataclass(frozen=True)
class Walk:
    """Where the records are, in the order of the file.

    ``parts`` have the wanted records, ``counts`` (n,) are of all, by definition. ``bad_bytes`` lie
    outside all records, the first at ``first_bad``; ``cut_bytes`` are a last record that the end of
    the file cuts off; ``refused`` FMT records that make no sense.
    """

    definitions: tuple[Definition, ...]
    parts: tuple[Part, ...]
    counts: NDArray[np.int64]
    bad_bytes: int
    first_bad: int
    cut_bytes: int
    refused: tuple[str, ...]

    @property
    def offsets(self) -> NDArray[np.int64]:
        """The place of every record, (n,): 8 bytes each."""
        places = [part.at.astype(np.int64) + part.base for part in self.parts]
        return np.concatenate(places) if places else np.empty(0, np.int64)

    @property
    def numbers(self) -> NDArray[np.uint16]:
        """The definition of every record, (n,)."""
        numbers = [part.numbers for part in self.parts]
        return np.concatenate(numbers) if numbers else np.empty(0, np.uint16)


@dataclass
class _Block:
    """Where a record may begin in one block: places, type bytes and the lengths of these types.

    ``breaks`` are the rows whose record does not end at the place of the next row.
    """

    places: NDArray[np.int64]
    types: NDArray[np.uint8]
    lengths: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    breaks: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))

    def link(self, length_of: NDArray[np.int64]) -> None:
        """Set the lengths, and find out what ends where; again when a length has changed."""
        self.lengths = length_of[self.types]
        links = self.places[:-1] + self.lengths[:-1] == self.places[1:]
        self.breaks = np.append(np.flatnonzero(~links), self.places.shape[0] - 1)


class Walker:
    """One walk: which type has which length now, and what was found.

    Parameters
    ----------
    data : the file.
    names : the message types whose records are wanted; all where it is None.
    """

    def __init__(self, data: FileView, names: Collection[str] | None = None) -> None:
        self.data = data
        self.names = names
        self.size = data.size
        self.definitions = [builtin()]
        self.number_of = np.zeros(256, np.uint16)
        self.length_of = np.zeros(256, np.int64)
        self.length_of[FMT_TYPE] = FMT_LENGTH
        self.seen: dict[bytes, int] = {}
        self.refused: list[str] = []
        self.wanted: list[Part] = []
        self.total = np.zeros(1, np.int64)
        self.runs: list[tuple[NDArray[np.int64], NDArray[np.uint16]]] = []
        self.bad_bytes, self.first_bad, self.cut_bytes = 0, -1, 0

    def parts(self) -> Iterator[Part]:
        """All records, a part at a time, while its bytes are at hand; the wanted ones are kept."""
        at = 0
        while at + HEADER <= self.size:
            at = self._walk_block(at)
            yield from self._flush(keep=1)  # damage where a block begins may cost the one before
        if at < self.size:
            self._resume(at)
        yield from self._flush(keep=0)

    def found(self) -> Walk:
        """What was found, when all parts have been seen."""
        return Walk(
            tuple(self.definitions), tuple(self.wanted), self._totals(), self.bad_bytes,
            self.first_bad, self.cut_bytes, tuple(self.refused),
        )  # fmt: skip

    def _totals(self) -> NDArray[np.int64]:
        missing = len(self.definitions) - self.total.shape[0]
        return np.append(self.total, np.zeros(missing, np.int64)) if missing else self.total

    def _enter_part(self, part: Part) -> None:
        self.total = self._totals() + np.bincount(part.numbers, minlength=len(self.definitions))
        if self.names is not None:
            names = self.names
            part = part.only(np.array([form.name in names for form in self.definitions], np.bool_))
        self.wanted.append(part)

    def _walk_block(self, at: int) -> int:
        """Past the records that begin in the block at a place: where the next one should be."""
        block, end = self._block(at)
        while at < end:
            row = int(np.searchsorted(block.places, at))
            if row == block.places.shape[0] or block.places[row] != at:
                at = self._resume(at)
                continue
            stop = int(block.breaks[np.searchsorted(block.breaks, row)]) + 1
            if not 0 < block.lengths[stop - 1] <= self.size - block.places[stop - 1]:
                stop -= 1  # of unknown type, or past the end of the file
            if stop == row:
                at = self._resume(at)
                continue
            stop = self._keep(block, row, stop)
            at = int(block.places[stop - 1] + block.lengths[stop - 1])
            if block.types[stop - 1] == FMT_TYPE:
                block.link(self.length_of)
        return at

    def _block(self, begin: int) -> tuple[_Block, int]:
        end = min(begin + SPAN, self.size - HEADER + 1)
        raw = self.data.array(begin, end + HEADER - 1)
        rows = np.flatnonzero((raw[:-2] == MAGIC[0]) & (raw[1:-1] == MAGIC[1]))
        block = _Block(rows + begin, raw[rows + 2])
        block.link(self.length_of)
        return block, end

    def _keep(self, block: _Block, row: int, stop: int) -> int:
        """Enter a run of records; it ends early where an FMT record changes what follows."""
        definitions = row + np.flatnonzero(block.types[row:stop] == FMT_TYPE)
        for place in definitions.tolist():
            number = self._read_definition(int(block.places[place]))
            if number is None:
                continue
            self._enter(block, row, place + 1)  # as they were defined until now
            row = place + 1
            self.number_of[self.definitions[number].type_id] = number
            self.length_of[self.definitions[number].type_id] = self.definitions[number].length
            if not (block.types[row:stop] == FMT_TYPE).all():  # whose length never changes
                return row
        self._enter(block, row, stop)
        return stop

    def _enter(self, block: _Block, row: int, stop: int) -> None:
        if row < stop:
            numbers = self.number_of[block.types[row:stop]]
            self.runs.append((block.places[row:stop], numbers))

    def _read_definition(self, at: int) -> int | None:
        """The number of what an FMT record defines, or None when it says nothing new."""
        payload = self.data[at + HEADER : at + FMT_LENGTH]
        number = self.seen.get(payload)
        if number is None:
            definition = define(payload)
            if definition is None or len(self.definitions) == MOST_DEFINITIONS:
                self.refused.append(f"type {payload[0]} {payload[2:6]!r} at byte {at}")
                return None
            number = self.seen[payload] = len(self.definitions)
            self.definitions.append(definition)
        known = self.number_of[self.definitions[number].type_id] == number
        return None if known else number

    def _flush(self, keep: int) -> Iterator[Part]:
        """Pack the runs into a part; the last record may stay, to be taken back."""
        if not self.runs:
            return
        places = np.concatenate([run for run, _ in self.runs])
        numbers = np.concatenate([numbers for _, numbers in self.runs])
        self.runs = [(places[-keep:].copy(), numbers[-keep:].copy())] if keep else []
        places, numbers = places[: places.shape[0] - keep], numbers[: numbers.shape[0] - keep]
        holes = np.flatnonzero(np.diff(places) > SPAN) + 1  # a part is read in one piece
        for some, which in zip(np.split(places, holes), np.split(numbers, holes), strict=True):
            if some.size:
                base = int(some[0])
                part = Part(base, (some - base).astype(np.uint32), which)
                yield part
                self._enter_part(part)

    def _resume(self, at: int) -> int:
        """Past the damage at a byte where no record begins: where to go on."""
        begin = self._suspect(at)
        found = self._next(begin + 1)
        if found == self.size and self._is_cut(at):
            self.cut_bytes = self.size - at
            return self.size
        if begin < at:  # the record before is part of the damage
            places, numbers = self.runs.pop()
            if places.shape[0] > 1:
                self.runs.append((places[:-1], numbers[:-1]))
        self.bad_bytes += found - begin
        self.first_bad = begin if self.first_bad < 0 else self.first_bad
        return found

    def _suspect(self, at: int) -> int:
        """Where the damage found at a byte begins: there, or at the record before.

        A record whose type byte was flipped ends in the wrong place. It is given up when records
        follow from inside it, or when nothing at its end looks like a header.
        """
        if not self.runs:
            return at
        before = int(self.runs[-1][0][-1])
        if before + self._length(self.data[before + 2 : before + 3]) != at:
            return at  # damage ended right there, and begins again
        inside = self.data.find(MAGIC, before + HEADER, at)
        while inside != -1:
            if self._chain(inside):
                return before
            inside = self.data.find(MAGIC, inside + 1, at)
        header = self.data[at : at + 2]
        return at if not header or header[:1] == MAGIC[:1] or header[1:] == MAGIC[1:] else before

    def _next(self, at: int) -> int:
        """The next byte from which a chain of records runs, or the end of the file.

        The search widens as it goes: where all records of a type are damaged, it costs what lies
        between two of them and not a block for each.
        """
        begin, reach = at, REACH
        while begin < self.size:
            end = min(begin + reach, self.size)
            raw = self.data.array(begin, end + 1)
            rows = np.flatnonzero((raw[:-1] == MAGIC[0]) & (raw[1:] == MAGIC[1]))
            for place in (rows + begin).tolist():
                if self._chain(place):
                    return int(place)
            begin, reach = end, min(2 * reach, SPAN)
        return self.size

    def _length(self, type_byte: bytes) -> int:
        return int(self.length_of[type_byte[0]]) if type_byte else 0

    def _chain(self, at: int) -> bool:
        for link in range(LINKS):
            header = self.data[at : at + HEADER]
            if not MAGIC.startswith(header[:2]):
                return False
            if len(header) < HEADER:
                return True
            length = self._length(header[2:])
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
        return len(header) < HEADER or self._length(header[2:]) > self.size - at


def walk(data: FileView, names: Collection[str] | None = None) -> Walk:
    """Find every whole record of a DataFlash log.

    Parameters
    ----------
    data : the file.
    names : the message types whose places are wanted; all where it is None.

    Returns where the records are and what lies between them. A flipped type byte costs that one
    record; after any damage the walk goes on where a chain of three records begins.
    """
    walker = Walker(data, names)
    for _ in walker.parts():
        pass
    return walker.found()


def records(
    data: FileView, walk: Walk, wanted: NDArray[np.bool_]
) -> Iterator[tuple[int, NDArray[Any], NDArray[np.int64]]]:
    """The records of some definitions, a block of the file at a time.

    Parameters
    ----------
    wanted : for each definition, whether it is.

    Yields the number of a definition, its records in a block as a structured array, and their
    places in the file; those of one definition come in the order of the file.
    """
    for part in walk.parts:
        rows = np.flatnonzero(wanted[part.numbers])
        if rows.size == 0:
            continue
        numbers = part.numbers[rows]
        order = rows[np.argsort(numbers, kind="stable")]
        counts = np.bincount(numbers, minlength=wanted.shape[0])
        raw = data.array(part.base, part.end())
        begin = 0
        for number in np.flatnonzero(counts).tolist():
            at = part.at[order[begin : begin + counts[number]]]
            begin += int(counts[number])
            form = walk.definitions[number]
            # Every place of the block seen as a record: the wanted ones are then one copy each.
            rows = gather(raw, at, form.length).view(form.dtype)
            yield number, rows, at.astype(np.int64) + part.base
