"""The records of an MCAP file in their order: definitions one by one, messages by the thousand.

Definitions are parsed by the mcap library, whose readers give nothing for a truncated file, inflate
chunks without a limit and lose messages silently. After damage, reading continues at the next place
that is proved: the head of a chunk, or messages of known channels that follow each other.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Set
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, FileView, Runs, gather
from unbend.ingest.mcap import chunks
from unbend.units import Integers, Rows

MAGIC = b"\x89MCAP0\r\n"


RECORD = struct.Struct("<BQ")


MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


FOOT = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum


class Opcode:
    """The kinds of records."""

    HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
    STATISTICS, DATA_END, LAST = 0x0B, 0x0F, 0x0F
    PRIVATE = 0x80  # from here on they belong to applications; those between are not given out


LARGE_MESSAGE = 1 << 16  # [bytes] of what is wanted only images are larger ...


NEAR = 1 << 16  # [bytes] searched first: damage is seldom large


LINKS = 3  # records in a row that prove a message after damage


NAMED = 8  # losses of one kind that are named one by one


PROVING = (Opcode.FOOTER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)


DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)


NO_FOOTER = (
    "without the footer that a closed MCAP has: the recorder died or the copy is incomplete, and "
    "whatever came after is lost"
)


SPAN = 4 << 20  # [bytes] of messages decoded together, and of the file walked at once


MESSAGE_START = 4096  # [bytes] ... and of those the header is wanted


MAX_DEFINITION = 16 << 20  # [bytes] of a schema, channel or statistics record


@dataclass
class Damage:
    """What could not be read: (code, what, byte offset, bytes); many of a kind as one."""

    losses: list[tuple[str, str, int, int]] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    more: Counter[str] = field(default_factory=Counter)
    bad_bytes: int = 0

    def add(self, code: str, what: str, at: int, count: int) -> None:
        self.bad_bytes += count
        self.seen[code] += 1
        if self.seen[code] <= NAMED:
            self.losses.append((code, what, at, count))
        else:
            self.more[code] += count

    def entries(self) -> Iterator[tuple[str, str, int, int]]:
        """The losses, those beyond the first few of a kind in one line."""
        yield from self.losses
        for code, count in self.more.items():
            last = [at for kind, _, at, _ in self.losses if kind == code][-1]
            yield code, f"{self.seen[code] - NAMED} more places like that", last, count


@dataclass(frozen=True)
class Definition:
    """A schema, channel or statistics record, and where it or its chunk begins."""

    opcode: int
    content: bytes
    at: int


@dataclass(frozen=True)
class Messages:
    """Messages in the order of the file, their bytes, and how many records were too ``short``.

    ``begin`` and ``length`` of the encoded message; of a large one only the beginning is there.
    """

    data: Bytes
    channel: NDArray[np.uint16]
    sequence: NDArray[np.uint32]
    log_time: Integers
    begin: Integers
    length: Integers
    short: int

    def __len__(self) -> int:
        return int(self.channel.shape[0])


_HEADER = np.dtype([
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
    ("log_time", "<u8"), ("publish_time", "<u8"),
])  # fmt: skip


_LAST_NS = np.uint64(2**63 - 1)  # log_time is unsigned in the file; times inside are int64


def raw_of(view: Bytes) -> memoryview:
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def candidate_places(view: Bytes, opcodes: tuple[int, ...]) -> Rows:
    """Places with one of these opcodes and a length below 4 GiB."""
    count = view.shape[0] - RECORD.size + 1
    if count <= 0:
        return np.empty(0, np.intp)
    may = np.isin(view[:count], np.array(opcodes, np.uint8))
    for byte in range(5, RECORD.size):
        may &= view[byte : byte + count] == 0
    return np.flatnonzero(may)


def next_message_place(view: Bytes, begin: int, channels: Set[int]) -> int:
    """The first place of a chunk behind ``begin`` where messages follow, or the chunk's end."""
    raw = raw_of(view)
    for at in range(begin + 1, view.shape[0], NEAR):
        near = view[at : at + NEAR + RECORD.size - 1]
        for place in candidate_places(near, (Opcode.MESSAGE,)).tolist():
            if messages_follow(raw, at + place, channels):
                return int(at + place)
    return int(view.shape[0])


def messages_follow(raw: memoryview, place: int, channels: Set[int]) -> bool:
    """Whether messages of known channels follow each other from here on."""
    for _ in range(LINKS):
        if place == len(raw):
            return True
        if place + RECORD.size + MESSAGE.size > len(raw):
            return False
        opcode, length = RECORD.unpack_from(raw, place)
        channel = int.from_bytes(raw[place + 9 : place + 11], "little")
        if opcode != Opcode.MESSAGE or not MESSAGE.size <= length <= LARGE_MESSAGE:
            return False
        if channel not in channels:
            return False
        place += RECORD.size + length
    return place <= len(raw)


class RecordWalk:
    """The definitions and messages of a file; ``damage`` is filled on the way.

    A summary that its checksum proves comes first: its definitions serve where those among the
    messages are damaged. A definition may come several times.
    """

    def __init__(self, data: FileView, damage: Damage) -> None:
        self.data = data
        self.damage = damage
        self.channels: set[int] = set()
        self.waiting: list[tuple[Bytes, Integers]] = []
        self.weight = 0
        self.before = -1  # where the last record began: its length may be the damage
        self.data_end = -1  # where the summary begins
        self.disproved = -1  # a record in which others lie
        self.budget = chunks.InflationBudget(data.size)
        self.ends, self.ended = 0, False  # records that end the data; whether one was checked

    def __iter__(self) -> Iterator[Definition | Messages]:
        yield from self.summary()
        yield from self.records()

    def summary(self) -> Iterator[Definition]:
        """Definitions of the summary, if its checksum holds; if moved, it follows the data end."""
        at = self.data.size - len(MAGIC) - FOOT.size
        if at < RECORD.size or self.data[at + FOOT.size : self.data.size] != MAGIC:
            return
        foot = self.data[at - RECORD.size : at + FOOT.size]
        start, _, crc = FOOT.unpack_from(foot, RECORD.size)
        if RECORD.unpack_from(foot) != (Opcode.FOOTER, FOOT.size) or not crc or not start:
            return
        end = at + FOOT.size - 4
        if not 0 < start <= at or self._checksum(start, end) != crc:
            what = "the summary is not where the footer says, or fails its checksum"
            self.damage.add("LOG-CRC", what, at, 0)
            mark, start = RECORD.pack(Opcode.DATA_END, 4), -1
            for _ in range(LINKS):
                start = self.data.find(mark, start + 1, at)
                if start < 0 or self._checksum(start + len(mark) + 4, end) == crc:
                    break
            else:
                return
            if start < 0:
                return
            start += len(mark) + 4
        while start + RECORD.size < at:
            opcode, length = RECORD.unpack(self.data[start : start + RECORD.size])
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and length <= MAX_DEFINITION:
                begin = start + RECORD.size
                yield self._definition(opcode, self.data[begin : begin + length], begin)
            start += RECORD.size + length

    def _checksum(self, begin: int, end: int) -> int:
        crc = 0
        for at in range(begin, end, SPAN):
            crc = zlib.crc32(self.data[at : min(at + SPAN, end)], crc)
        return crc

    def _definition(self, opcode: int, content: bytes, at: int) -> Definition:
        if opcode == Opcode.CHANNEL:
            self.channels.add(int.from_bytes(content[:2], "little"))
        return Definition(opcode, content, at)

    def records(self) -> Iterator[Definition | Messages]:
        """The records from behind the mark, or from the header record on, to the footer."""
        at = len(MAGIC) if self.data[0 : len(MAGIC)] == MAGIC else 0
        if not at:
            for place in range(len(MAGIC) + 1):
                header = self.data[place : place + RECORD.size].ljust(RECORD.size, b"\0")
                opcode, length = RECORD.unpack(header)
                end = place + RECORD.size + length
                behind = (self.data[end : end + 1] if length < NEAR else b"") or b"\0"
                at = place if opcode == Opcode.HEADER and 0 < behind[0] <= Opcode.LAST else at
            what = "the file begins as no MCAP does: its first bytes are damaged or lost"
            self.damage.add("LOG-BAD-BYTES", what, 0, at)
        self.before = at - 1
        while at >= 0:
            starts: list[int] = []
            view = self.data.array(at, at + SPAN)
            others: list[tuple[int, int, int]] = []
            end = self._span(at, view, starts, others)
            for opcode, place, length in others:  # before the messages that they define
                if opcode in DEFINITIONS:
                    yield from self._other(opcode, place, length)
            if starts:
                yield from self._collect(view, np.array(starts, np.int64))
            for opcode, place, length in others:
                if opcode not in DEFINITIONS:
                    yield from self._other(opcode, place, length)
            at = end
        yield from self._flush()

    def _span(
        self, begin: int, view: Bytes, starts: list[int], others: list[tuple[int, int, int]]
    ) -> int:
        """Records that begin in a stretch of the file; where to go on, or -1 at the end."""
        raw, place, size = raw_of(view), 0, self.data.size - begin
        unpack = RECORD.unpack_from
        opcode: int
        length: int
        while True:
            at = begin + place
            if place + RECORD.size > len(raw):
                if place and at < self.data.size:
                    return at
                self.damage.add("LOG-TRUNCATED", f"the file ends {NO_FOOTER}", at, size - place)
                return -1
            opcode, length = unpack(raw, place)
            end = place + RECORD.size + length
            if end > size or not (0 < opcode <= Opcode.LAST or opcode >= Opcode.PRIVATE):
                next_place = self._resume(at, opcode, length)
                if 0 <= next_place < at and starts and begin + starts[-1] == self.disproved:
                    starts.pop()
                return next_place
            if opcode == Opcode.FOOTER:
                return self._foot(at, length)
            if opcode == Opcode.MESSAGE:
                if length > LARGE_MESSAGE:
                    others.append((opcode, at, length))
                elif end <= len(raw):
                    starts.append(place)
                else:
                    return at
            elif opcode == Opcode.DATA_END:
                self.ends += 1
                if self.ends <= 2:  # a million of them must cost no more than two
                    others.append((opcode, at, length))
            elif opcode in DEFINITIONS or opcode == Opcode.CHUNK:
                others.append((opcode, at, length))
            sure = opcode == Opcode.CHUNK and self._proves(at)
            self.before = begin + end - 1 if sure else at
            self.data_end = begin + end if opcode == Opcode.DATA_END else self.data_end
            place = end
            if place > len(raw):
                return begin + place

    def _foot(self, at: int, length: int) -> int:
        """The end of the walk, if a footer is where a footer must be."""
        end = at + RECORD.size + FOOT.size + len(MAGIC)
        if length != FOOT.size or end > self.data.size:
            return self._resume(at, Opcode.FOOTER, length)
        if end < self.data.size or self.data[end - len(MAGIC) : end] != MAGIC:
            what = f"{self.data.size - end} bytes follow the end of the log, or its mark is damaged"
            self.damage.add("LOG-BAD-BYTES", what, at, self.data.size - end)
        start = int(FOOT.unpack(self.data[at + RECORD.size : end - len(MAGIC)])[0])
        if not self.damage.losses and (self.data_end < 0 or start not in (0, self.data_end)):
            what = f"the footer says that the summary begins at byte {start}, the data end at "
            what += f"{self.data_end}: a part of the file is missing"
            self.damage.add("LOG-INCONSISTENT", what, at, 0)
        return -1

    def _other(self, opcode: int, at: int, length: int) -> Iterator[Definition | Messages]:
        content = at + RECORD.size
        if opcode == Opcode.CHUNK:
            chunk = chunks.chunk_head(self.data, content, length)
            if chunk is None or chunk.compression not in chunks.COMPRESSIONS:
                what = "a chunk has no valid head"
                if chunk is not None:
                    what = f"a chunk is compressed with {chunk.compression!r}, which is not known"
                self.damage.add("LOG-BAD-BYTES", what, at, length)
            elif too_large := self.budget.too_large(chunk):
                self.damage.add("LOG-TOO-LARGE", too_large, at, length)
            elif not isinstance(records := chunks.inflate(self.data, chunk), bytes):
                self.damage.add(*records, at, length if chunk.small else chunk.length)
            elif chunk.small:
                yield from self._inside(np.frombuffer(records, np.uint8), at)
            else:
                yield from self._large_chunk(at, chunk)
        elif opcode == Opcode.MESSAGE:
            head = RECORD.pack(Opcode.MESSAGE, MESSAGE_START)
            start = head + self.data[content : content + MESSAGE_START]
            yield from self._collect(np.frombuffer(start, np.uint8), np.zeros(1, np.int64))
        elif opcode == Opcode.DATA_END and self.ended:
            what = "the data end a second time: their checksum here is not checked"
            self.damage.add("LOG-INCONSISTENT", what, at, 0)
        elif opcode == Opcode.DATA_END:  # the checksum is that of all bytes before
            self.ended = True
            crc = int.from_bytes(self.data[content : content + min(length, 4)], "little")
            if crc and self._checksum(0, at) != crc:
                self.damage.add("LOG-CRC", "the data section fails its checksum", at, 0)
        elif length > MAX_DEFINITION:
            what = f"a definition of {length} bytes (opcode {opcode}) is skipped"
            self.damage.add("LOG-TOO-LARGE", what, at, length)
        else:
            yield self._definition(opcode, self.data[content : content + length], content)

    def _large_chunk(self, at: int, chunk: chunks.Chunk) -> Iterator[Definition | Messages]:
        """The records of a proved chunk, which is inflated again, block by block."""
        with chunks.chunk_stream(self.data, chunk) as stream:
            place, kept = 0, bytearray()
            while place + RECORD.size <= chunk.size:
                header = stream.read(RECORD.size)
                opcode, length = RECORD.unpack(header)
                left = chunk.size - place - RECORD.size
                if opcode == 0 or length > left:
                    what = f"the last {chunk.size - place} of {chunk.size} bytes of a chunk are"
                    self.damage.add("LOG-BAD-BYTES", f"{what} no record", at, chunk.size - place)
                    break
                place += RECORD.size + length
                keep = length if length <= LARGE_MESSAGE else MESSAGE_START
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    keep = min(length, MAX_DEFINITION)
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    kept += RECORD.pack(opcode, keep) + stream.read(keep)
                    length -= keep
                while length > 0:
                    length -= len(stream.read(min(length, chunks.BLOCK)))
                if len(kept) >= SPAN:
                    yield from self._inside(np.frombuffer(bytes(kept), np.uint8), at)
                    kept.clear()
            yield from self._inside(np.frombuffer(bytes(kept), np.uint8), at)

    def _inside(self, view: Bytes, at: int) -> Iterator[Definition | Messages]:
        """The records of an inflated chunk: messages by the run, between them definitions."""
        raw, place, size = raw_of(view), 0, int(view.shape[0])
        # what has the opcode of a message, and a length that ends inside
        may = np.flatnonzero(view[: max(size - RECORD.size + 1, 0)] == Opcode.MESSAGE)
        length_of = gather(view, may + 1, 8).view("<u8")
        fits = length_of <= (size - RECORD.size - may).astype(np.uint64)
        may = may[fits].astype(np.int64)
        runs = Runs(may, may + RECORD.size + length_of[fits].astype(np.int64))
        starts = [np.empty(0, np.int64)]
        while place < size:
            run = runs.starting_at(place)
            if run.stop > run.start:
                starts.append(runs.at[run])
                place = int(runs.end[run.stop - 1])
                continue
            whole = place + RECORD.size <= size
            opcode, length = RECORD.unpack_from(raw, place) if whole else (0, 0)
            end = place + RECORD.size + length
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or end > size:
                last = int(starts[-1][-1]) if starts[-1].size else place
                next_place = next_message_place(view, last, self.channels)
                lost = next_place - place
                if next_place < place:  # the length of the last message is what is damaged
                    starts[-1] = starts[-1][:-1]
                    lost = next_place - last
                what = f"{lost} of {size} bytes of a chunk are no record"
                self.damage.add("LOG-BAD-BYTES", what, at, lost)
                place = next_place
                continue
            if length <= MAX_DEFINITION:
                yield self._definition(opcode, bytes(raw[place + RECORD.size : end]), at)
            place = end
        if len(starts) > 1:
            yield from self._collect(view, np.concatenate(starts))

    def _collect(self, view: Bytes, starts: Integers) -> Iterator[Messages]:
        """Put messages aside until there are enough to decode them together."""
        self.waiting.append((view, starts))
        self.weight += view.shape[0]
        if self.weight >= SPAN:
            yield from self._flush()

    def _flush(self) -> Iterator[Messages]:
        if self.waiting:
            views = [view for view, _ in self.waiting]
            begin = np.cumsum([0] + [view.shape[0] for view in views[:-1]]).tolist()
            starts = [s + b for (_, s), b in zip(self.waiting, begin, strict=True)]
            data = views[0] if len(views) == 1 else np.concatenate(views)
            self.waiting, self.weight = [], 0
            every, size = np.concatenate(starts), _HEADER.itemsize
            inside = every[every + size <= data.shape[0]]
            head = gather(data, inside, size).view(_HEADER)
            good = head["length"].astype(np.int64) >= MESSAGE.size
            head, short = head[good], every.shape[0] - int(np.count_nonzero(good))
            log_time = np.minimum(head["log_time"], _LAST_NS).astype(np.int64)
            length = head["length"].astype(np.int64) - MESSAGE.size
            numbers = head["channel"].copy(), head["sequence"].copy()
            yield Messages(data, *numbers, log_time, inside[good] + size, length, short)

    def _resume(self, at: int, opcode: int, length: int) -> int:
        """Where the records go on after damage, or -1 where they do not."""
        place, begin, reach = -1, self.before + 1, NEAR
        while place < 0 and begin < self.data.size:
            view = self.data.array(begin, begin + reach)
            candidates = candidate_places(view, PROVING).tolist()
            place = next((begin + k for k in candidates if self._proves(begin + k)), -1)
            if begin + view.shape[0] >= self.data.size:
                break
            begin, reach = begin + view.shape[0] - RECORD.size + 1, SPAN
        if place < 0:
            rest = self.data.size - at
            what = f"a record of {length} bytes (opcode {opcode}) where {rest} bytes are left"
            self.damage.add("LOG-TRUNCATED", f"{what}: it ends {NO_FOOTER}", at, rest)
            return -1
        lost = place - at if place > at else place - self.before
        self.disproved = self.before
        what = f"{lost} bytes are no record, or part of one whose length is damaged"
        self.damage.add("LOG-BAD-BYTES", what, min(at, place), lost)
        self.before = place
        return place

    def _proves(self, at: int) -> bool:
        opcode, length = RECORD.unpack(self.data[at : at + RECORD.size])
        end = at + RECORD.size + length
        if end > self.data.size:
            return False
        if opcode == Opcode.FOOTER:
            return bool(length == FOOT.size and end == self.data.size - len(MAGIC))
        if opcode == Opcode.CHUNK:
            chunk = chunks.chunk_head(self.data, at + RECORD.size, length)
            return chunk is not None and chunk.plausible
        if opcode == Opcode.DATA_END:
            follows = self.data[end : end + 1]
            return length == 4 and bool(follows) and 0 < follows[0] <= Opcode.LAST
        near = self.data.array(at, at + (LINKS + 1) * LARGE_MESSAGE)
        return messages_follow(raw_of(near), 0, self.channels)
