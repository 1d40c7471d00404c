"""Records of an ArduPilot DataFlash log: their places, and recovery after damage.

A record is 0xA3 0x95, a type byte and a payload; the FMT record of the type gives its length. There
is no checksum: a record is confirmed if the next one begins where it ends. All places in a block of
the file where a record may begin are found at once; a run of records that follow each other is
accepted as a whole.
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
    """Places in one block of the file where a record may begin, and the type bytes there.

    ``length_of`` (256,): the length of a record by type, 0 for a type that is not defined. The
    ``end`` of a candidate of such a type equals its place.
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
    """The offsets in ``raw`` of the two magic bytes with which records begin."""
    is_magic = (raw[:-1] == MAGIC[0]) & (raw[1:] == MAGIC[1])
    return np.flatnonzero(is_magic)


@dataclass
class _RecordRun:
    """Records that follow each other: their places, and the numbers of their definitions."""

    places: Integers
    numbers: NDArray[np.uint16]


class RecordWalker(DamagedBytes):
    """One pass over a file that finds its records.

    The pass is done when `blocks` is exhausted. Then ``kept_blocks`` has the records with the
    wanted ``names`` (None for all), in blocks in the order of the file; ``definitions`` has all
    definitions, and a definition is referred to by its number, the index there; ``refused``
    describes FMT records that are not valid.
    """

    def __init__(self, data: FileView, names: Collection[str] | None = None) -> None:
        super().__init__()
        self.data = data
        self.names = names
        self.size = data.size
        self.definitions = [definition_of_fmt()]
        self.definitions_by_name: Counter[str] = Counter()  # how many definitions each name has
        self.redefinitions = 0  # how often a type got another definition
        self.number_of = np.zeros(TYPES, np.uint16)  # by type: of the definition in force
        self.length_of = np.zeros(TYPES, np.int64)  # by type: of a record, 0 if not defined
        self.length_of[FMT_TYPE] = FMT_LENGTH
        self.seen: dict[bytes, int] = {}  # number of a definition by the payload of its FMT
        self.refused: list[str] = []
        self.kept_blocks: list[RecordBlock] = []
        self.runs: list[_RecordRun] = []  # records that are not yet in a `RecordBlock`
        self._counts = np.zeros(1, np.int64)  # records by definition, as many as known then

    def blocks(self) -> Iterator[RecordBlock]:
        """Yield all records, block by block, while their bytes are in memory.

        A block enters ``kept_blocks`` and `counts` only when the next block is requested.
        """
        place = 0
        while place + HEADER <= self.size:
            place = self._walk_block(place)
            yield from self._flush(held_back=1)  # damage in the next block may include it
        if place < self.size:  # fewer bytes than a header: of a cut record, or damage
            self._resume(place)
        yield from self._flush(held_back=0)

    @property
    def counts(self) -> Integers:
        """(n,) how many records of each definition have been yielded, wanted or not."""
        missing = len(self.definitions) - self._counts.shape[0]
        return np.append(self._counts, np.zeros(missing, np.int64))

    def message_counts(self) -> dict[str, int]:
        """How many messages of each name there are."""
        counts: Counter[str] = Counter()
        for form, count in zip(self.definitions, self.counts.tolist(), strict=True):
            counts[form.name] += count
        return dict(+counts)

    def _walk_block(self, place: int) -> int:
        """Enter the records of the block that begins at ``place``; returns where the next begins.

        The arrays of a block are freed before the next one is read.
        """
        begin = place
        end = min(place + SPAN, self.size - HEADER + 1)
        raw = self.data.array(begin, end + HEADER - 1)
        offsets = _magic_offsets(raw[:-1])  # without the last byte: a type byte must follow
        types = raw[offsets + len(MAGIC)]
        candidates = _Candidates(offsets + begin, types, self.length_of)
        while place < end:
            run = self._whole_records(candidates, place)
            if run.start == run.stop:
                place = self._resume(place)
                if self.is_hopeless(self.size):
                    return self.give_up(place, self.size)
                continue
            stop = self._enter_and_define(candidates, run.start, run.stop)
            place = int(candidates.end[stop - 1])
            if candidates.types[stop - 1] == FMT_TYPE:  # it may have changed the lengths
                candidates = _Candidates(candidates.at, candidates.types, self.length_of)
        return place

    def _whole_records(self, candidates: _Candidates, place: int) -> slice:
        """The rows of the candidates that follow each other from ``place`` on; may be empty.

        The last one is left out if its type is unknown, or if the file ends in it.
        """
        run = candidates.starting_at(place)
        if run.start == run.stop:
            return run
        last = run.stop - 1
        type_is_known = candidates.end[last] > candidates.at[last]
        is_complete = candidates.end[last] <= self.size
        if type_is_known and is_complete:
            return run
        return slice(run.start, last)

    def _enter_and_define(self, candidates: _Candidates, start: int, stop: int) -> int:
        """Enter the records in rows from ``start`` to ``stop``, and put their definitions in force.

        Returns the row behind the last record entered. That is less than ``stop`` if an FMT record
        gives a type another definition and records that are not FMT follow: their lengths may have
        changed.
        """
        row = start  # the first row that is not entered yet
        is_definition = candidates.types[start:stop] == FMT_TYPE
        definition_rows = start + np.flatnonzero(is_definition)
        for definition_row in definition_rows.tolist():
            number = self._number_of_definition(int(candidates.at[definition_row]))
            if number is None:
                continue
            form = self.definitions[number]
            number_in_force = self.number_of[form.type_id]
            if number_in_force == number:
                continue
            self._enter(candidates, row, definition_row + 1)  # by the definitions before it
            row = definition_row + 1
            self.redefinitions += bool(number_in_force)
            if self.redefinitions > MAX_REDEFINITIONS:
                raise too_many_redefinitions(name=form.name, most=MAX_REDEFINITIONS)
            self.number_of[form.type_id] = number
            self.length_of[form.type_id] = form.length
            following_types = candidates.types[row:stop]
            only_definitions_follow = bool(np.all(following_types == FMT_TYPE))
            if not only_definitions_follow:  # FMT records always have the same length
                return row
        self._enter(candidates, row, stop)
        return stop

    def _number_of_definition(self, place: int) -> int | None:
        """The number of the definition in the FMT record at ``place``; a new one is added.

        None if the definition is not valid, or if there are `MOST_DEFINITIONS` already; then it is
        added to ``refused``. Raises LogError for a log that defines one name too often.
        """
        payload = self.data[place + HEADER : place + FMT_LENGTH]
        number = self.seen.get(payload)
        if number is not None:
            return number
        definition = define(payload)
        if definition is None or len(self.definitions) == MOST_DEFINITIONS:
            self.refused.append(f"type {payload[0]} {payload[NAME_BYTES]!r} at byte {place}")
            return None
        number = len(self.definitions)
        self.seen[payload] = number
        self.definitions.append(definition)
        self.definitions_by_name[definition.name] += 1
        if self.definitions_by_name[definition.name] > MAX_DEFINITIONS_OF_ONE:
            raise too_many_definitions(name=definition.name, most=MAX_DEFINITIONS_OF_ONE)
        return number

    def _enter(self, candidates: _Candidates, start: int, stop: int) -> None:
        """Add the candidates in rows from ``start`` to ``stop`` to the runs, as records.

        They get the numbers of the definitions that are in force now.
        """
        if start < stop:
            numbers = self.number_of[candidates.types[start:stop]]
            self.runs.append(_RecordRun(candidates.at[start:stop], numbers))

    def _flush(self, held_back: int) -> Iterator[RecordBlock]:
        """Pack the records of the runs into blocks; yield each, then count and keep its records.

        The last ``held_back`` records (0 or 1) stay in a run: damage behind them may include them.
        """
        if not self.runs:
            return
        places = np.concatenate([run.places for run in self.runs])
        numbers = np.concatenate([run.numbers for run in self.runs])
        self.runs = []
        if held_back:
            last_places = places[-held_back:].copy()
            last_numbers = numbers[-held_back:].copy()
            self.runs.append(_RecordRun(last_places, last_numbers))
            places = places[:-held_back]
            numbers = numbers[:-held_back]
        # The bytes of a block are read in one piece: long damage begins a new block.
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
        """The records of a block with wanted names."""
        if self.names is None:
            return block
        is_wanted = np.array([form.name in self.names for form in self.definitions], np.bool_)
        rows = is_wanted[block.numbers]
        return RecordBlock(
            base=block.base,
            at=block.at[rows],
            numbers=block.numbers[rows],
        )

    def _resume(self, place: int) -> int:
        """Skip the damage at ``place``, where no record begins; returns where records continue.

        The last record is dropped if the damage is in it. A record that the end of the file cuts
        off is not damage: its bytes are counted as cut.
        """
        begin = place
        includes_last_record = self._record_before_is_damaged(place)
        if includes_last_record:
            begin = int(self.runs[-1].places[-1])
        resumed = self._next_chain(begin + 1)
        if resumed == self.size and self._is_cut_record(place):
            self.cut_bytes = self.size - place
            return self.size
        if includes_last_record:
            self._drop_last_record()
        self.drop_searched(begin, resumed)
        return resumed

    def _record_before_is_damaged(self, place: int) -> bool:
        """Whether the last record ends at ``place`` only because its type byte is damaged.

        A record with a flipped type byte has the length of another type, and ends in the wrong
        place. This is assumed in two cases: both bytes at ``place`` differ from those of a header,
        or a chain of records begins inside the record.
        """
        if not self.runs:
            return False
        before = int(self.runs[-1].places[-1])
        type_byte = self.data[before + 2 : before + HEADER]
        if before + self._length_of_type(type_byte) != place:
            return False
        mark = self.data[place : place + len(MAGIC)]
        both_differ = mark[:1] != MAGIC[:1] and mark[1:] != MAGIC[1:]
        if mark and both_differ:
            return True
        inside = self.data.find(MAGIC, before + HEADER, place)
        while inside != -1:
            if self._begins_chain(inside):
                return True
            inside = self.data.find(MAGIC, inside + 1, place)
        return False

    def _next_chain(self, place: int) -> int:
        """The first place from a byte on where a chain of records begins, or the end of the file.

        The bytes searched at once are few at first, and twice as many each time: in a log with many
        damaged records, each search reads little more than the bytes up to the next good one.
        """
        reach = REACH
        while place < self.size:
            end = min(place + reach, self.size)
            raw = self.data.array(place, end + 1)  # with the second byte of a magic at the end
            candidates = _magic_offsets(raw) + place
            for candidate in candidates.tolist():
                if self._begins_chain(candidate):
                    return int(candidate)
            place = end
            reach = min(2 * reach, SPAN)
        return self.size

    def _is_cut_record(self, place: int) -> bool:
        """Whether a record begins at ``place`` that the end of the file cuts off."""
        header = self.data[place : place + HEADER]
        if not MAGIC.startswith(header[: len(MAGIC)]):
            return False
        if len(header) < HEADER:
            return True
        bytes_left = self.size - place
        return self._length_of_type(header[2:]) > bytes_left

    def _drop_last_record(self) -> None:
        """Remove the last record from the runs, because it is part of the damage."""
        last = self.runs.pop()
        if last.places.shape[0] > 1:
            remaining = _RecordRun(last.places[:-1], last.numbers[:-1])
            self.runs.append(remaining)

    def _length_of_type(self, type_byte: bytes) -> int:
        """The length of records of a type; 0 if it is not defined, or if ``type_byte`` is empty."""
        if not type_byte:
            return 0
        return int(self.length_of[type_byte[0]])

    def _begins_chain(self, place: int) -> bool:
        """Whether `LINKS` successive records begin at ``place``; fewer if the file ends there.

        The last record may end with the file or be cut off by its end. If that is already the first
        record, it counts only if it is cut off within its header: a length alone proves nothing.
        """
        for link in range(LINKS):
            header = self.data[place : place + HEADER]
            if not MAGIC.startswith(header[: len(MAGIC)]):
                return False
            if len(header) < HEADER:
                return True
            length = self._length_of_type(header[2:])
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
    deque(walker.blocks(), 0)  # runs through all blocks without keeping them
    return walker
