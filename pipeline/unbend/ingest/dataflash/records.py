"""Records of an ArduPilot DataFlash log: definitions, places, recovery after damage, tables.

A record is 0xA3 0x95, a type byte and a payload whose length the FMT record of that type gave. It
is confirmed when the next one begins where it ends: there is no checksum. All places where one may
begin are found at once in a block of the file; where each ends on the next, nothing is walked.
"""

import struct
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import SPAN, FileView, Runs, allocate, gather
from unbend.ingest.log import PLACE, DamagedBytes, Table, in_order
from unbend.messages import Ledger
from unbend.units import Integers, Mask

MAGIC = b"\xa3\x95"
HEADER = 3
FMT_TYPE = 128
FMT_LENGTH = 89
START = MAGIC + bytes([FMT_TYPE])
_FMT_FIELDS = (FMT_TYPE, FMT_LENGTH, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
_FMT_PAYLOAD = struct.pack("<BB4s16s64s", *_FMT_FIELDS)
LINKS = 3  # records in a row that confirm a place to continue after damage
LONGEST = 255  # bytes of a record: its length is one byte
REACH = 1 << 14  # [bytes] first searched after damage: the next record is seldom farther
MOST_DEFINITIONS = 1 << 15  # real logs have 16 to 200; the number of a definition fits two bytes


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


def read_records(found: RecordWalker, wanted: Mask) -> Iterator[tuple[int, NDArray[Any], Integers]]:
    """The records of wanted definitions, a block of the file at a time.

    Yields the number of a definition, its records as a structured array, and their places.
    """
    for block in found.wanted:
        rows = np.flatnonzero(wanted[block.numbers])
        if rows.size == 0:
            continue
        numbers = block.numbers[rows]
        order = rows[np.argsort(numbers, kind="stable")]
        counts = np.bincount(numbers, minlength=wanted.shape[0])
        raw = found.data.array(block.base, block.end())
        begin = 0
        for number in np.flatnonzero(counts).tolist():
            at = block.at[order[begin : begin + counts[number]]]
            begin += int(counts[number])
            form = found.definitions[number]
            # Every place of the block seen as a record: the wanted ones are then one copy each.
            rows_of_type = gather(raw, at, form.length).view(form.dtype)
            yield number, rows_of_type, at.astype(np.int64) + block.base


INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


def decode(found: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Table]:
    """The columns of some message types, in one pass over the file, with `PLACE`.

    ``wanted``: by type, which fields. Numbers keep their type; scaled ones (c, C, e, E, L) are
    float64, divided as pymavlink does; characters are text. Types of one name are one table: what a
    row lacks is NaN or empty, a field that was text and number is of objects (`without_objects`).
    """
    tables: dict[int, Table] = {}
    for number, count in enumerate(found.counts.tolist()):
        form = found.definitions[number]
        if form.name in wanted and count:
            table = tables[number] = {PLACE: allocate(count, np.int64)}
            for name in filter(wanted[form.name], form.fields):
                kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
                table[name] = allocate(count, (kind.base, kind.shape))
    filled = dict.fromkeys(tables, 0)
    mask = np.array([number in tables for number in range(len(found.definitions))], np.bool_)
    for number, rows, places in read_records(found, mask):
        part = slice(filled[number], filled[number] + places.shape[0])
        filled[number] = part.stop
        for name, column in tables[number].items():
            divisor = found.definitions[number].divisors.get(name)
            if divisor is None:
                column[part] = places if name == PLACE else rows[name]
            else:
                np.divide(rows[name], divisor, out=column[part])
    by_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        columns = tables.pop(number).items()
        table = {name: texts(part) if part.dtype.kind == "S" else part for name, part in columns}
        by_name.setdefault(found.definitions[number].name, []).append(table)
    return {name: merge_tables(several) for name, several in by_name.items()}


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL: UTF-8, else Latin-1, as pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    different, places = np.unique(raw, return_inverse=True)
    words = []
    for value in different.tolist():
        try:
            word = value.decode("utf-8")
        except UnicodeDecodeError:
            word = value.decode("latin-1")
        words.append(word.split("\0", 1)[0])
    return np.array(words, np.str_)[places] if words else np.empty(0, "U1")


def merge_tables(several: list[Table]) -> Table:
    """Tables of one message whose definition changed, as one; missing instances are -1."""
    if len(several) == 1:
        return several[0]
    for name in INSTANCE_FIELDS:
        present = [table[name] for table in several if name in table]
        if present and all(column.dtype.kind in "iu" for column in present):
            for table in several:
                table.setdefault(name, np.full(table[PLACE].size, -1))
    return in_order(several)


def without_objects(table: Table, name: str, ledger: Ledger) -> Table:
    """A table without objects: the last value of a column decides between text and numbers."""
    columns = dict(table)
    for label, column in table.items():
        if column.dtype.kind != "O":
            continue
        known = [value for value in column.tolist() if value is not None]
        kind = str if isinstance(known[-1], str) else (int, float)
        lost = sum(not isinstance(value, kind) for value in known)
        missing, dtype = ("", np.str_) if kind is str else (np.nan, np.float64)
        values = [value if isinstance(value, kind) else missing for value in column.tolist()]
        columns[label] = np.array(values, dtype)
        if lost:
            ledger.loss("LOG-REDEFINED", where=name, count=lost, total=len(known), field=label)
    return columns
