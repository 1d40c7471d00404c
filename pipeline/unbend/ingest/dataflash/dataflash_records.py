"""Records of an ArduPilot DataFlash log: their places, and recovery after damage.

A record is 0xA3 0x95, a type byte and a payload whose length the FMT record of that type gave. It
is confirmed when the next one begins where it ends: there is no checksum. All places where one may
begin are found at once in a block of the file; where each ends on the next, nothing is walked.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import SPAN, Bytes, FileView, Runs
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash.record_definitions import (
    FMT_LENGTH,
    FMT_TYPE,
    HEADER,
    MAGIC,
    NAME_BYTES,
    define,
    definition_of_fmt,
)
from unbend.ingest.limits import MAX_DEFINITIONS_OF_ONE, MAX_REDEFINITIONS
from unbend.ingest.messages import too_many_definitions, too_many_redefinitions
from unbend.units import Integers, Rows

LINKS = 3  # records in a row that confirm a place to continue after damage
LONGEST = 255  # bytes of a record: its length is one byte
REACH = 1 << 14  # [bytes] first searched after damage: the next record is seldom farther
MOST_DEFINITIONS = 1 << 15  # real logs have 16 to 200; the number of a definition fits two bytes
TYPES = 256  # a type is one byte


@dataclass(frozen=True)
class RecordBlock:
    """Records that begin in one block of the file, in 6 bytes each.

    base : the place in the file from which ``at`` counts.
    at : (n,) the places of the records, rising.
    numbers : (n,) the numbers of their definitions.
    """

    base: int
    at: NDArray[np.uint32]
    numbers: NDArray[np.uint16]

    def end(self) -> int:
        """A place that the last record does not reach beyond."""
        if not self.at.size:
            return self.base
        return self.base + int(self.at[-1]) + LONGEST


class _Candidates(Runs):
    """Places in one block where a record may begin, and the type bytes there.

    ``length_of`` are the lengths by type, 0 for one that is not defined: then it ends where it
    begins.
    """

    def __init__(
        self,
        places: Integers,
        types: NDArray[np.uint8],
        length_of: Integers,
    ) -> None:
        super().__init__(places, places + length_of[types])
        self.types = types


def _magic_offsets(raw: Bytes) -> Rows:
    """Where in some bytes the two bytes stand with which records begin."""
    is_magic = (raw[:-1] == MAGIC[0]) & (raw[1:] == MAGIC[1])
    return np.flatnonzero(is_magic)


@dataclass
class _RecordRun:
    """Records that follow each other: their places, and the numbers of their definitions."""

    places: Integers
    numbers: NDArray[np.uint16]


class RecordWalker(DamagedBytes):
    """One pass over a file that finds its records.

    The pass is done when `blocks` is exhausted. Then ``wanted`` has the places of the records with
    some ``names`` (None for all), in blocks in the order of the file; ``definitions`` are all that
    occurred; ``refused`` describes FMT records that are not valid.
    """

    def __init__(self, data: FileView, names: Collection[str] | None = None) -> None:
        super().__init__()
        self.data = data
        self.names = names
        self.size = data.size
        self.definitions = [definition_of_fmt()]
        self.definitions_by_name: Counter[str] = Counter()  # how many each name has
        self.redefinitions = 0  # records behind which a type has another definition
        self.number_of = np.zeros(TYPES, np.uint16)  # of the definition in force, by type
        self.length_of = np.zeros(TYPES, np.int64)
        self.length_of[FMT_TYPE] = FMT_LENGTH
        self.seen: dict[bytes, int] = {}  # numbers of definitions by the payload of their FMT
        self.refused: list[str] = []
        self.kept_blocks: list[RecordBlock] = []
        self.runs: list[_RecordRun] = []  # records that are not yet in a `RecordBlock`
        self._counts = np.zeros(1, np.int64)

    def blocks(self) -> Iterator[RecordBlock]:
        """All records block by block, while their bytes are in memory; wanted ones are kept.

        A block enters ``wanted`` and `counts` only after its reader asks for the next one.
        """
        place = 0
        while place + HEADER <= self.size:
            place = self._walk_block(place)
            yield from self._flush(keep=1)  # damage where the next block begins may include it
        if place < self.size:
            self._resume(place)
        yield from self._flush(keep=0)

    @property
    def counts(self) -> Integers:
        """(n,) how many records of each definition there are so far, wanted or not."""
        missing = len(self.definitions) - self._counts.shape[0]
        return np.append(self._counts, np.zeros(missing, np.int64))

    def message_counts(self) -> dict[str, int]:
        """How many messages of each name there are."""
        counts: Counter[str] = Counter()
        for form, count in zip(self.definitions, self.counts.tolist(), strict=True):
            counts[form.name] += count
        return dict(+counts)

    def _walk_block(self, place: int) -> int:
        """Keep the records that begin in a block of the file; returns where the next block begins.

        The arrays of a block are freed before the next one is read.
        """
        begin = place
        end = min(place + SPAN, self.size - HEADER + 1)
        raw = self.data.array(begin, end + HEADER - 1)
        offsets = _magic_offsets(raw[:-1])  # behind a magic there is the type byte
        types = raw[offsets + len(MAGIC)]
        block = _Candidates(offsets + begin, types, self.length_of)
        while place < end:
            run = self._whole_records(block, place)
            if run.start == run.stop:
                place = self._resume(place)
                if self.is_hopeless(self.size):
                    return self.give_up(place, self.size)
                continue
            stop = self._keep(block, run.start, run.stop)
            place = int(block.end[stop - 1])
            if block.types[stop - 1] == FMT_TYPE:  # the lengths may be others from here on
                block = _Candidates(block.at, block.types, self.length_of)
        return place

    def _whole_records(self, block: _Candidates, place: int) -> slice:
        """The rows of the records that follow each other from a place on; empty without any.

        Without the last one if its type is unknown, or if the file ends in it.
        """
        run = block.starting_at(place)
        if run.start == run.stop:
            return run
        last = run.stop - 1
        type_is_known = block.end[last] > block.at[last]
        is_all_there = block.end[last] <= self.size
        if type_is_known and is_all_there:
            return run
        return slice(run.start, last)

    def _keep(self, block: _Candidates, start: int, stop: int) -> int:
        """Keep the records in rows from ``start`` to ``stop``, and put their definitions in force.

        Returns the row before which it ends: an earlier one than ``stop`` if other records follow
        on an FMT record that defines a type anew, because their lengths may have changed.
        """
        row = start  # the first row that is not entered yet
        is_definition = block.types[start:stop] == FMT_TYPE
        definition_rows = start + np.flatnonzero(is_definition)
        for definition_row in definition_rows.tolist():
            number = self._number_of_definition(int(block.at[definition_row]))
            if number is None:
                continue
            form = self.definitions[number]
            number_in_force = self.number_of[form.type_id]
            if number_in_force == number:
                continue
            self._enter(block, row, definition_row + 1)  # by the definitions in force before it
            row = definition_row + 1
            self.redefinitions += bool(number_in_force)
            if self.redefinitions > MAX_REDEFINITIONS:
                raise too_many_redefinitions(name=form.name, most=MAX_REDEFINITIONS)
            self.number_of[form.type_id] = number
            self.length_of[form.type_id] = form.length
            following_types = block.types[row:stop]
            only_definitions_follow = bool(np.all(following_types == FMT_TYPE))
            if not only_definitions_follow:  # the length of definitions never changes
                return row
        self._enter(block, row, stop)
        return stop

    def _number_of_definition(self, at: int) -> int | None:
        """The number of the definition in the FMT record at a byte; a new one is added.

        None, and the record is among ``refused``, if it is not valid or would be one definition
        too many. Refuses (LogError) a log that defines one name too often.
        """
        payload = self.data[at + HEADER : at + FMT_LENGTH]
        number = self.seen.get(payload)
        if number is not None:
            return number
        definition = define(payload)
        if definition is None or len(self.definitions) == MOST_DEFINITIONS:
            self.refused.append(f"type {payload[0]} {payload[NAME_BYTES]!r} at byte {at}")
            return None
        number = len(self.definitions)
        self.seen[payload] = number
        self.definitions.append(definition)
        self.definitions_by_name[definition.name] += 1
        if self.definitions_by_name[definition.name] > MAX_DEFINITIONS_OF_ONE:
            raise too_many_definitions(name=definition.name, most=MAX_DEFINITIONS_OF_ONE)
        return number

    def _enter(self, block: _Candidates, row: int, stop: int) -> None:
        """Add the records of some rows of a block to the runs, by the definitions in force."""
        if row < stop:
            numbers = self.number_of[block.types[row:stop]]
            self.runs.append(_RecordRun(block.at[row:stop], numbers))

    def _flush(self, keep: int) -> Iterator[RecordBlock]:
        """Pack the records of the runs into blocks, which it yields, counts and adds to ``wanted``.

        The last ``keep`` records (0 or 1) stay a run: damage behind them may include them.
        """
        if not self.runs:
            return
        places = np.concatenate([run.places for run in self.runs])
        numbers = np.concatenate([run.numbers for run in self.runs])
        self.runs = []
        if keep:
            kept_places = places[-keep:].copy()
            kept_numbers = numbers[-keep:].copy()
            self.runs.append(_RecordRun(kept_places, kept_numbers))
            places = places[:-keep]
            numbers = numbers[:-keep]
        # A block is read in one piece: a long stretch of damage divides the records.
        holes = np.flatnonzero(np.diff(places) > SPAN) + 1
        parts = zip(np.split(places, holes), np.split(numbers, holes), strict=True)
        for places_of_part, numbers_of_part in parts:
            if not places_of_part.size:
                continue
            base = int(places_of_part[0])
            block = RecordBlock(
                base=base,
                at=(places_of_part - base).astype(np.uint32),
                numbers=numbers_of_part,
            )
            yield block
            counts = np.bincount(block.numbers, minlength=len(self.definitions))
            self._counts = self.counts + counts
            kept_block = self._wanted_of(block)
            self.kept_blocks.append(kept_block)

    def _wanted_of(self, block: RecordBlock) -> RecordBlock:
        """The records of a block whose names are wanted."""
        if self.names is None:
            return block
        is_wanted = np.array([form.name in self.names for form in self.definitions], np.bool_)
        rows = is_wanted[block.numbers]
        return RecordBlock(
            base=block.base,
            at=block.at[rows],
            numbers=block.numbers[rows],
        )

    def _resume(self, at: int) -> int:
        """Skip the damage at a byte where no record begins; returns where records continue.

        The last record is dropped if the damage is in it. A record that the end of the file cuts
        off is no damage: its bytes are counted as cut.
        """
        begin = at
        includes_last_record = self._record_before_is_damaged(at)
        if includes_last_record:
            begin = int(self.runs[-1].places[-1])
        resumed = self._next_chain(begin + 1)
        if resumed == self.size and self._is_cut_record(at):
            self.cut_bytes = self.size - at
            return self.size
        if includes_last_record:
            self._drop_last_record()
        self.drop_searched(begin, resumed)
        return resumed

    def _record_before_is_damaged(self, at: int) -> bool:
        """Whether the last record ends at this byte, but only because its type byte is damaged.

        A record whose type byte was flipped has the length of another type, and ends in the wrong
        place. Two things show that: both bytes at the end of the record differ from those of a
        header, or a chain of records begins inside the record.
        """
        if not self.runs:
            return False
        before = int(self.runs[-1].places[-1])
        type_byte = self.data[before + 2 : before + HEADER]
        if before + self._length(type_byte) != at:
            return False
        mark = self.data[at : at + len(MAGIC)]
        both_differ = mark[:1] != MAGIC[:1] and mark[1:] != MAGIC[1:]
        if mark and both_differ:
            return True
        inside = self.data.find(MAGIC, before + HEADER, at)
        while inside != -1:
            if self._chain(inside):
                return True
            inside = self.data.find(MAGIC, inside + 1, at)
        return False

    def _next_chain(self, place: int) -> int:
        """The first place from a byte on where a chain of records begins, or the end of the file.

        The bytes searched at once are few at first, and twice as many each time: in a log with many
        damaged records, each search reads little more than what lies before the next good one.
        """
        reach = REACH
        while place < self.size:
            end = min(place + reach, self.size)
            raw = self.data.array(place, end + 1)  # with the second byte of a magic at the end
            candidates = _magic_offsets(raw) + place
            for candidate in candidates.tolist():
                if self._chain(candidate):
                    return int(candidate)
            place = end
            reach = min(2 * reach, SPAN)
        return self.size

    def _is_cut_record(self, at: int) -> bool:
        """Whether the file ends in a record that begins at a byte."""
        header = self.data[at : at + HEADER]
        if not MAGIC.startswith(header[: len(MAGIC)]):
            return False
        if len(header) < HEADER:
            return True
        bytes_left = self.size - at
        return self._length(header[2:]) > bytes_left

    def _drop_last_record(self) -> None:
        """Take back the last record, which is part of the damage."""
        last = self.runs.pop()
        if last.places.shape[0] > 1:
            remaining = _RecordRun(last.places[:-1], last.numbers[:-1])
            self.runs.append(remaining)

    def _length(self, type_byte: bytes) -> int:
        """The length of the records of a type; 0 if it is not defined, or the byte missing."""
        if not type_byte:
            return 0
        return int(self.length_of[type_byte[0]])

    def _chain(self, place: int) -> bool:
        """Whether a chain of `LINKS` records begins at a byte, or a shorter one at the file's end.

        The end of the file may be that of the last record, or cut off the last record: a first one
        within its header only, as its length alone would prove nothing.
        """
        for link in range(LINKS):
            header = self.data[place : place + HEADER]
            if not MAGIC.startswith(header[: len(MAGIC)]):
                return False
            if len(header) < HEADER:
                return True
            length = self._length(header[2:])
            if not length:
                return False
            place += length
            if place >= self.size:
                is_cut_off = place > self.size
                return not is_cut_off or link > 0
        return True


def find_records(data: FileView, names: Collection[str] | None = None) -> RecordWalker:
    """Find the records of some types, or of all, and the damage between them.

    After damage reading goes on where three records follow each other.
    """
    walker = RecordWalker(data, names)
    deque(walker.blocks(), 0)
    return walker
