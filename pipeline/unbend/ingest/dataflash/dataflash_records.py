"""Records of an ArduPilot DataFlash log: definitions, places, recovery after damage, tables.

A record is 0xA3 0x95, a type byte and a payload whose length the FMT record of that type gave. It
is confirmed when the next one begins where it ends: there is no checksum. All places where one may
begin are found at once in a block of the file; where each ends on the next, nothing is walked.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import SPAN, FileView, Runs
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash.record_definitions import (
    _FMT_PAYLOAD,
    FMT_LENGTH,
    FMT_TYPE,
    HEADER,
    MAGIC,
    define,
)
from unbend.units import Integers

LINKS = 3  # records in a row that confirm a place to continue after damage


LONGEST = 255  # bytes of a record: its length is one byte


REACH = 1 << 14  # [bytes] first searched after damage: the next record is seldom farther


MOST_DEFINITIONS = 1 << 15  # real logs have 16 to 200; the number of a definition fits two bytes


@dataclass(frozen=True)
class RecordBlock:
    """The records that begin in one block of the file at ``base``: 6 bytes for each.

    ``at`` (n,) their places behind it, rising; ``numbers`` (n,) their definitions.
    """

    base: int
    at: NDArray[np.uint32]
    numbers: NDArray[np.uint16]

    def end(self) -> int:
        """A place behind the last record."""
        return self.base + int(self.at[-1]) + LONGEST if self.at.size else self.base


class _Candidates(Runs):
    """Where a record may begin in one block, and the type bytes there."""

    def __init__(self, places: Integers, types: NDArray[np.uint8], length_of: Integers) -> None:
        super().__init__(places, places + length_of[types])
        self.types = types


class RecordWalker(DamagedBytes):
    """One pass over a file: where the records of some ``names`` (None for all) are, in its order.

    After it ``wanted`` has their blocks, ``definitions`` are all that occurred, ``refused``
    describes FMT records that are not valid.
    """

    def __init__(self, data: FileView, names: Collection[str] | None = None) -> None:
        super().__init__()
        fmt = define(_FMT_PAYLOAD)
        if fmt is None:
            raise LookupError("the definition of FMT is not valid")
        self.data = data
        self.names = names
        self.size = data.size
        self.definitions = [fmt]
        self.number_of = np.zeros(256, np.uint16)
        self.length_of = np.zeros(256, np.int64)
        self.length_of[FMT_TYPE] = FMT_LENGTH
        self.seen: dict[bytes, int] = {}
        self.refused: list[str] = []
        self.wanted: list[RecordBlock] = []
        self._counts = np.zeros(1, np.int64)
        self.runs: list[tuple[Integers, NDArray[np.uint16]]] = []

    def blocks(self) -> Iterator[RecordBlock]:
        """All records block by block, while their bytes are in memory; wanted ones are kept."""
        at = 0
        while at + HEADER <= self.size:
            at = self._walk_block(at)
            yield from self._flush(keep=1)  # damage where the next block begins may include it
        if at < self.size:
            self._resume(at)
        yield from self._flush(keep=0)

    @property
    def counts(self) -> Integers:
        """(n,) how many records there are so far, wanted or not, by definition."""
        missing = len(self.definitions) - self._counts.shape[0]
        return np.append(self._counts, np.zeros(missing, np.int64)) if missing else self._counts

    def message_counts(self) -> dict[str, int]:
        """How many messages of each name there are."""
        counts: Counter[str] = Counter()
        for form, count in zip(self.definitions, self.counts.tolist(), strict=True):
            counts[form.name] += count
        return dict(+counts)

    def _walk_block(self, at: int) -> int:
        """Walk the records that begin in a block; its arrays are freed before the next is read."""
        begin, end = at, min(at + SPAN, self.size - HEADER + 1)
        raw = self.data.array(begin, end + HEADER - 1)
        rows = np.flatnonzero((raw[:-2] == MAGIC[0]) & (raw[1:-1] == MAGIC[1]))
        block = _Candidates(rows + begin, raw[rows + 2], self.length_of)
        while at < end:
            run = block.starting_at(at)
            row, stop = run.start, run.stop
            if stop > row and not block.at[stop - 1] < block.end[stop - 1] <= self.size:
                stop -= 1  # its type is unknown, or the file ends in it
            if stop == row:
                at = self._resume(at)
                continue
            stop = self._keep(block, row, stop)
            at = int(block.end[stop - 1])
            if block.types[stop - 1] == FMT_TYPE:
                block = _Candidates(block.at, block.types, self.length_of)
        return at

    def _keep(self, block: _Candidates, row: int, stop: int) -> int:
        """Keep a run of records; it ends early where an FMT record redefines the following ones."""
        definitions = row + np.flatnonzero(block.types[row:stop] == FMT_TYPE)
        for place in definitions.tolist():
            at = int(block.at[place])
            payload = self.data[at + HEADER : at + FMT_LENGTH]
            number = self.seen.get(payload)
            if number is None:
                definition = define(payload)
                if definition is None or len(self.definitions) == MOST_DEFINITIONS:
                    self.refused.append(f"type {payload[0]} {payload[2:6]!r} at byte {at}")
                    continue
                number = self.seen[payload] = len(self.definitions)
                self.definitions.append(definition)
            form = self.definitions[number]
            if self.number_of[form.type_id] == number:
                continue  # repeated
            self._enter(block, row, place + 1)  # by the definitions before this one
            row = place + 1
            self.number_of[form.type_id], self.length_of[form.type_id] = number, form.length
            if not (block.types[row:stop] == FMT_TYPE).all():  # whose length never changes
                return row
        self._enter(block, row, stop)
        return stop

    def _enter(self, block: _Candidates, row: int, stop: int) -> None:
        if row < stop:
            numbers = self.number_of[block.types[row:stop]]
            self.runs.append((block.at[row:stop], numbers))

    def _flush(self, keep: int) -> Iterator[RecordBlock]:
        """Pack the runs into blocks; the last record may be kept back, as damage may include it."""
        if not self.runs:
            return
        places = np.concatenate([run for run, _ in self.runs])
        numbers = np.concatenate([numbers for _, numbers in self.runs])
        self.runs = [(places[-keep:].copy(), numbers[-keep:].copy())] if keep else []
        places, numbers = places[: places.shape[0] - keep], numbers[: numbers.shape[0] - keep]
        holes = np.flatnonzero(np.diff(places) > SPAN) + 1  # a block is read in one piece
        for at, which in zip(np.split(places, holes), np.split(numbers, holes), strict=True):
            if not at.size:
                continue
            block = RecordBlock(int(at[0]), (at - at[0]).astype(np.uint32), which)
            yield block
            self._counts = self.counts + np.bincount(which, minlength=len(self.definitions))
            if self.names is not None:
                wanted = [form.name in self.names for form in self.definitions]
                rows = np.array(wanted, np.bool_)[which]
                block = RecordBlock(block.base, block.at[rows], which[rows])
            self.wanted.append(block)

    def _resume(self, at: int) -> int:
        """Skip the damage at a byte where no record begins; returns where records continue."""
        begin = at
        before = int(self.runs[-1][0][-1]) if self.runs else -1
        if self.runs and before + self._length(self.data[before + 2 : before + 3]) == at:
            # A record whose type byte was flipped ends in the wrong place. It is damaged when
            # the bytes at its end do not resemble a header, or when records follow from inside it.
            mark = self.data[at : at + 2]
            if mark and mark[:1] != MAGIC[:1] and mark[1:] != MAGIC[1:]:
                begin = before
            inside = self.data.find(MAGIC, before + HEADER, at)
            while inside != -1 and begin == at:
                begin = before if self._chain(inside) else at
                inside = self.data.find(MAGIC, inside + 1, at)
        resumed, place, reach = self.size, begin + 1, REACH
        while resumed == self.size and place < self.size:
            # The search widens: where all records of a type are damaged, it costs what lies between
            # two of them and not a block for each.
            end = min(place + reach, self.size)
            raw = self.data.array(place, end + 1)
            rows = np.flatnonzero((raw[:-1] == MAGIC[0]) & (raw[1:] == MAGIC[1]))
            chains = (row for row in (rows + place).tolist() if self._chain(row))
            resumed = next(chains, self.size)
            place, reach = end, min(2 * reach, SPAN)
        header = self.data[at : at + HEADER]
        cut = len(header) < HEADER or self._length(header[2:]) > self.size - at
        if resumed == self.size and cut and MAGIC.startswith(header[:2]):
            self.cut_bytes = self.size - at  # the file ends in a record that begins here
            return self.size
        if begin < at:  # the record before is part of the damage
            places, numbers = self.runs.pop()
            if places.shape[0] > 1:
                self.runs.append((places[:-1], numbers[:-1]))
        self.drop(begin, resumed)
        return resumed

    def _length(self, type_byte: bytes) -> int:
        return int(self.length_of[type_byte[0]]) if type_byte else 0

    def _chain(self, at: int) -> bool:
        """Whether `LINKS` records follow each other from a byte, or as many as the file has."""
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


def find_records(data: FileView, names: Collection[str] | None = None) -> RecordWalker:
    """Where the records of some types are, or of all, and the damage between them.

    A flipped type byte costs that record; after it reading goes on at three in a row.
    """
    walker = RecordWalker(data, names)
    deque(walker.blocks(), 0)
    return walker
