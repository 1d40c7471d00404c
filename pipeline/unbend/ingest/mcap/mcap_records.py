"""The records of an MCAP file in their order: definitions one by one, messages by the thousand.

Definitions are parsed by the mcap library, whose readers give nothing for a truncated file, inflate
chunks without a limit and lose messages silently. After damage, reading continues at the next place
that is proved: the head of a chunk, or messages of known channels that follow each other.
"""

import struct
import zlib
from collections.abc import Iterator, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, FileView, Runs, gather
from unbend.ingest.mcap import chunks, messages
from unbend.ingest.mcap.damage import Damage
from unbend.messages import Message
from unbend.units import Integers, Rows

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
FOOT = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
CHECKSUM = 4  # [bytes]


class Opcode:
    """The kinds of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    STATISTICS = 0x0B
    DATA_END = 0x0F


LAST = Opcode.DATA_END  # those up to here are defined
PRIVATE = 0x80  # from here on they belong to applications; those between are not given out
PROVING = (Opcode.FOOTER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL)  # beside messages
KEPT = (*IN_CHUNKS, Opcode.MESSAGE)  # of a large chunk

LARGE_MESSAGE = 1 << 16  # [bytes] of what is wanted only images are larger ...
MESSAGE_START = 4096  # [bytes] ... and of those the header is wanted
NEAR = 1 << 16  # [bytes] searched first: damage is seldom large
LINKS = 3  # records in a row that prove a message after damage
SPAN = 4 << 20  # [bytes] of messages decoded together, and of the file walked at once
MAX_DEFINITION = 16 << 20  # [bytes] of a schema, channel or statistics record
LISTED_ENDS = 2  # a million records that end the data must cost no more than two


@dataclass(frozen=True)
class Definition:
    """A schema, channel or statistics record, and where it or its chunk begins."""

    opcode: int
    content: bytes
    at: int


@dataclass(frozen=True)
class Messages:
    """Messages in the order of the file; of a large message only the beginning is there."""

    data: Bytes
    channel: NDArray[np.uint16]
    sequence: NDArray[np.uint32]
    log_time: Integers
    begin: Integers  # place of the encoded message in ``data``
    length: Integers  # of the encoded message
    short: int  # how many records were too short to be messages

    def __len__(self) -> int:
        return int(self.channel.shape[0])


class Record(NamedTuple):
    """A record that is no small message: its place in the file, and the length of its content."""

    opcode: int
    at: int
    length: int

    @property
    def content(self) -> int:
        """Where its content begins."""
        return self.at + RECORD.size


@dataclass
class _Span:
    """Records that begin in a stretch of the file."""

    begin: int
    view: Bytes  # the bytes from ``begin`` on
    starts: list[int]  # places of small messages in the view
    others: list[Record]
    following: int = -1  # where in the file to go on; -1 at the end


_MESSAGE_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_LAST_NS = np.uint64(2**63 - 1)  # log_time is unsigned in the file; times inside are int64


def raw_of(view: Bytes) -> memoryview:
    """The buffer of an array."""
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def candidate_places(view: Bytes, opcodes: tuple[int, ...]) -> Rows:
    """Places with one of these opcodes and a length below 4 GiB."""
    count = view.shape[0] - RECORD.size + 1
    if count <= 0:
        return np.empty(0, np.intp)
    possible = np.isin(view[:count], np.array(opcodes, np.uint8))
    for byte in range(5, RECORD.size):  # the upper half of the length
        possible &= view[byte : byte + count] == 0
    return np.flatnonzero(possible)


def next_message_place(view: Bytes, begin: int, channels: Set[int]) -> int:
    """The first place of a chunk behind ``begin`` from which messages follow; else its end."""
    raw = raw_of(view)
    for near_begin in range(begin + 1, view.shape[0], NEAR):
        near = view[near_begin : near_begin + NEAR + RECORD.size - 1]
        for place in candidate_places(near, (Opcode.MESSAGE,)).tolist():
            if messages_follow(raw, near_begin + place, channels):
                return int(near_begin + place)
    return int(view.shape[0])


def messages_follow(raw: memoryview, place: int, channels: Set[int]) -> bool:
    """Whether messages of known channels follow each other from here on."""
    for _ in range(LINKS):
        if place == len(raw):
            return True
        content = place + RECORD.size
        if content + MESSAGE.size > len(raw):
            return False
        opcode, length = RECORD.unpack_from(raw, place)
        channel = int.from_bytes(raw[content : content + 2], "little")
        if opcode != Opcode.MESSAGE or not MESSAGE.size <= length <= LARGE_MESSAGE:
            return False
        if channel not in channels:
            return False
        place = content + length
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
        self.budget = chunks.InflationBudget(data.size)
        self._waiting: list[tuple[Bytes, Integers]] = []  # views, and where messages begin in them
        self._waiting_bytes = 0
        self._before = -1  # where the last record began: its length may be the damage
        self._data_end = -1  # where the summary begins
        self._disproved = -1  # a record in which others lie
        self._data_ends = 0  # records that end the data
        self._data_end_checked = False

    def __iter__(self) -> Iterator[Definition | Messages]:
        yield from self._summary()
        yield from self._records()

    # The summary.

    def _summary(self) -> Iterator[Definition]:
        """The definitions of the summary at the end of the file, if its checksum holds.

        Where lost bytes have moved the summary, it is searched behind the ends of the data.
        """
        footer = self.data.size - len(MAGIC) - FOOT.size  # where its content begins
        if footer < RECORD.size or self.data[footer + FOOT.size : self.data.size] != MAGIC:
            return
        record = self.data[footer - RECORD.size : footer + FOOT.size]
        if RECORD.unpack_from(record) != (Opcode.FOOTER, FOOT.size):
            return
        start, _, crc = FOOT.unpack_from(record, RECORD.size)
        if not crc or not start:
            return
        covered_end = footer + FOOT.size - CHECKSUM
        if not 0 < start <= footer or self._checksum(start, covered_end) != crc:
            self.damage.add(messages.summary_checksum_fails(where=self.damage.at(footer)))
            start = self._moved_summary(footer, covered_end, crc)
            if start < 0:
                return
        while start + RECORD.size < footer:
            opcode, length = RECORD.unpack(self.data[start : start + RECORD.size])
            begin = start + RECORD.size
            if opcode in IN_CHUNKS and length <= MAX_DEFINITION:
                yield self._definition(opcode, self.data[begin : begin + length], begin)
            start = begin + length

    def _moved_summary(self, footer: int, covered_end: int, crc: int) -> int:
        """Where behind an end of the data a summary begins whose checksum holds, or -1."""
        mark = RECORD.pack(Opcode.DATA_END, CHECKSUM)
        place = -1
        for _ in range(LINKS):
            place = self.data.find(mark, place + 1, footer)
            if place < 0:
                return -1
            start = place + len(mark) + CHECKSUM
            if self._checksum(start, covered_end) == crc:
                return start
        return -1

    def _checksum(self, begin: int, end: int) -> int:
        """The checksum of a stretch of the file."""
        crc = 0
        for place in range(begin, end, SPAN):
            crc = zlib.crc32(self.data[place : min(place + SPAN, end)], crc)
        return crc

    def _definition(self, opcode: int, content: bytes, at: int) -> Definition:
        """A definition; the number of a channel is kept, as it proves messages after damage."""
        if opcode == Opcode.CHANNEL:
            self.channels.add(int.from_bytes(content[:2], "little"))
        return Definition(opcode, content, at)

    # The walk over the file.

    def _records(self) -> Iterator[Definition | Messages]:
        """All records of the file: definitions before the messages of their stretch."""
        place = self._first_record()
        self._before = place - 1
        while place >= 0:
            span = self._walk_span(place)
            for record in span.others:  # before the messages that they define
                if record.opcode in DEFINITIONS:
                    yield from self._read_definition(record)
            if span.starts:
                yield from self._collect(span.view, np.array(span.starts, np.int64))
            for record in span.others:
                if record.opcode not in DEFINITIONS:
                    yield from self._read_other(record)
            place = span.following
        yield from self._flush()

    def _first_record(self) -> int:
        """Where the records begin; a damaged mark may have lost bytes."""
        if self.data[0 : len(MAGIC)] == MAGIC:
            return len(MAGIC)
        first = 0
        for place in range(len(MAGIC) + 1):
            record = self.data[place : place + RECORD.size].ljust(RECORD.size, b"\0")
            opcode, length = RECORD.unpack(record)
            if opcode == Opcode.HEADER and length < NEAR:
                end = place + RECORD.size + length
                following = self.data[end : end + 1]
                if following and 0 < following[0] <= LAST:
                    first = place
        where = self.damage.at(0)
        self.damage.add(messages.file_beginning_damaged(where=where, count=first))
        return first

    def _walk_span(self, begin: int) -> _Span:
        """The records that begin in a stretch of the file, and where to go on."""
        span = _Span(begin, self.data.array(begin, begin + SPAN), [], [])
        raw = raw_of(span.view)
        unpack = RECORD.unpack_from
        place = 0
        while place + RECORD.size <= len(raw):
            opcode, length = unpack(raw, place)
            end = place + RECORD.size + length
            if opcode == Opcode.MESSAGE and length <= LARGE_MESSAGE and end <= len(raw):
                span.starts.append(place)
                self._before = begin + place
            elif self._ends_span(span, Record(opcode, begin + place, length)):
                return span
            place = end
        following = begin + place
        if place > len(raw) or (place and following < self.data.size):
            span.following = following
        else:
            left = self.data.size - following
            self.damage.add(messages.no_footer(where=self.damage.at(following), count=left))
        return span

    def _ends_span(self, span: _Span, record: Record) -> bool:
        """Take a record that is no small message; returns whether the span ends with it."""
        opcode = record.opcode
        end = record.content + record.length
        is_possible = 0 < opcode <= LAST or opcode >= PRIVATE
        if end > self.data.size or not is_possible:
            span.following = self._resume(record.at, opcode, record.length)
            self._drop_disproved(span, record.at)
            return True
        if opcode == Opcode.FOOTER:
            span.following = self._end_at_footer(record.at, record.length)
            return True
        if opcode == Opcode.MESSAGE and record.length <= LARGE_MESSAGE:
            span.following = record.at  # it ends behind the span
            return True
        self._list_record(span, record)
        is_proved = opcode == Opcode.CHUNK and self._proves(record.at)
        self._before = end - 1 if is_proved else record.at
        return False

    def _list_record(self, span: _Span, record: Record) -> None:
        """Add a record to the others of a span, if it is of a kind that is read."""
        opcode = record.opcode
        if opcode == Opcode.DATA_END:
            self._data_end = record.content + record.length
            self._data_ends += 1
            if self._data_ends > LISTED_ENDS:
                return
        is_read = opcode in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
        if is_read or opcode in DEFINITIONS:
            span.others.append(record)

    def _drop_disproved(self, span: _Span, at: int) -> None:
        """Remove the last message of a span, if the records go on at a place inside it."""
        goes_back = 0 <= span.following < at
        if goes_back and span.starts and span.begin + span.starts[-1] == self._disproved:
            span.starts.pop()

    def _end_at_footer(self, at: int, length: int) -> int:
        """Where to go on after a footer: -1, or another record if it is not at the file's end."""
        end = at + RECORD.size + FOOT.size + len(MAGIC)
        if length != FOOT.size or end > self.data.size:
            return self._resume(at, Opcode.FOOTER, length)
        where = self.damage.at(at)
        mark = end - len(MAGIC)
        if end < self.data.size or self.data[mark:end] != MAGIC:
            extra = self.data.size - end
            self.damage.add(messages.file_end_damaged(where=where, count=extra))
        start, _, _ = FOOT.unpack(self.data[at + RECORD.size : mark])
        is_elsewhere = self._data_end < 0 or start not in (0, self._data_end)
        if is_elsewhere and not self.damage.losses:
            self.damage.add(
                messages.summary_elsewhere(where=where, stated=start, found=self._data_end)
            )
        return -1

    # Records other than small messages.

    def _read_definition(self, record: Record) -> Iterator[Definition]:
        """A schema, channel or statistics record."""
        if record.length > MAX_DEFINITION:
            self.damage.add(
                messages.definition_too_large(
                    where=self.damage.at(record.at), count=record.length, opcode=record.opcode
                )
            )
            return
        content = self.data[record.content : record.content + record.length]
        yield self._definition(record.opcode, content, record.content)

    def _read_other(self, record: Record) -> Iterator[Definition | Messages]:
        """A chunk, a large message or an end of the data."""
        if record.opcode == Opcode.CHUNK:
            yield from self._read_chunk(record)
        elif record.opcode == Opcode.MESSAGE:
            head = RECORD.pack(Opcode.MESSAGE, MESSAGE_START)
            start = head + self.data[record.content : record.content + MESSAGE_START]
            yield from self._collect(np.frombuffer(start, np.uint8), np.zeros(1, np.int64))
        else:
            self._check_data_end(record)

    def _check_data_end(self, record: Record) -> None:
        """Check the first end of the data, whose checksum is that of all bytes before."""
        where = self.damage.at(record.at)
        if self._data_end_checked:
            self.damage.add(messages.data_end_twice(where=where))
            return
        self._data_end_checked = True
        end = record.content + min(record.length, CHECKSUM)
        crc = int.from_bytes(self.data[record.content : end], "little")
        if crc and self._checksum(0, record.at) != crc:
            self.damage.add(messages.data_checksum_fails(where=where))

    def _read_chunk(self, record: Record) -> Iterator[Definition | Messages]:
        """The records of a chunk; a chunk that cannot be read is entered as damage."""
        where = self.damage.at(record.at)
        count = record.length
        chunk = chunks.chunk_head(self.data, record.content, record.length)
        if chunk is None:
            self.damage.add(messages.chunk_head_invalid(where=where, count=count))
            return
        if chunk.compression not in chunks.COMPRESSIONS:
            self.damage.add(
                messages.compression_unknown(
                    where=where, count=count, compression=chunk.compression
                )
            )
            return
        too_large = self.budget.too_large(chunk, where=where, count=count)
        if too_large is not None:
            self.damage.add(too_large)
            return
        lost = count if chunk.small else chunk.length
        inflated = chunks.inflate(self.data, chunk, where=where, count=lost)
        if isinstance(inflated, Message):
            self.damage.add(inflated)
        elif chunk.small:
            yield from self._inside(np.frombuffer(inflated, np.uint8), record.at)
        else:
            yield from self._large_chunk(record.at, chunk)

    def _large_chunk(self, at: int, chunk: chunks.Chunk) -> Iterator[Definition | Messages]:
        """The records of a proved chunk, which is inflated again, block by block."""
        kept = bytearray()
        place = 0
        with chunks.chunk_stream(self.data, chunk) as stream:
            while place + RECORD.size <= chunk.size:
                opcode, length = RECORD.unpack(stream.read(RECORD.size))
                if opcode == 0 or length > chunk.size - place - RECORD.size:
                    self.damage.add(
                        messages.chunk_end_not_records(
                            where=self.damage.at(at), count=chunk.size - place, size=chunk.size
                        )
                    )
                    break
                place += RECORD.size + length
                left = length
                if opcode in KEPT:
                    keep = _kept_length(opcode, length)
                    kept += RECORD.pack(opcode, keep) + stream.read(keep)
                    left -= keep
                while left > 0:
                    left -= len(stream.read(min(left, chunks.BLOCK)))
                if len(kept) >= SPAN:
                    yield from self._inside(np.frombuffer(bytes(kept), np.uint8), at)
                    kept.clear()
        yield from self._inside(np.frombuffer(bytes(kept), np.uint8), at)

    def _inside(self, view: Bytes, at: int) -> Iterator[Definition | Messages]:
        """The records of an inflated chunk: messages by the run, between them definitions."""
        raw = raw_of(view)
        size = int(view.shape[0])
        runs = _message_runs(view)
        starts: list[Integers] = []
        place = 0
        while place < size:
            run = runs.starting_at(place)
            if run.stop > run.start:
                starts.append(runs.at[run])
                place = int(runs.end[run.stop - 1])
                continue
            end = _definition_end(raw, place)
            if end < 0:
                place = self._resume_inside(view, place, starts, at)
                continue
            content = raw[place + RECORD.size : end]
            if len(content) <= MAX_DEFINITION:
                yield self._definition(raw[place], bytes(content), at)
            place = end
        if starts:
            yield from self._collect(view, np.concatenate(starts))

    def _resume_inside(self, view: Bytes, place: int, starts: list[Integers], at: int) -> int:
        """Enter damage in a chunk, and return where its messages go on.

        The last of ``starts`` is removed where its length is what is damaged.
        """
        last = place
        if starts and starts[-1].size:
            last = int(starts[-1][-1])
        resumed = next_message_place(view, last, self.channels)
        lost = resumed - place
        if resumed < place:  # the length of the last message is what is damaged
            starts[-1] = starts[-1][:-1]
            lost = resumed - last
        self.damage.add(
            messages.chunk_not_records(
                where=self.damage.at(at), count=lost, size=int(view.shape[0])
            )
        )
        return resumed

    # Messages, decoded together.

    def _collect(self, view: Bytes, starts: Integers) -> Iterator[Messages]:
        """Put messages aside until there are enough to decode them together."""
        self._waiting.append((view, starts))
        self._waiting_bytes += view.shape[0]
        if self._waiting_bytes >= SPAN:
            yield from self._flush()

    def _flush(self) -> Iterator[Messages]:
        """The messages that were put aside."""
        if not self._waiting:
            return
        views = []
        starts = []
        begin = 0
        for view, starts_in_view in self._waiting:
            views.append(view)
            starts.append(starts_in_view + begin)
            begin += view.shape[0]
        data = views[0] if len(views) == 1 else np.concatenate(views)
        self._waiting = []
        self._waiting_bytes = 0
        yield _messages_at(data, np.concatenate(starts))

    # After damage.

    def _resume(self, at: int, opcode: int, length: int) -> int:
        """Enter damage that begins at a record; returns where the records go on, or -1."""
        place = self._next_proved(self._before + 1)
        where = self.damage.at(at)
        if place < 0:
            rest = self.data.size - at
            self.damage.add(
                messages.record_cut_off(where=where, count=rest, length=length, opcode=opcode)
            )
            return -1
        lost = place - at if place > at else place - self._before
        where = self.damage.at(min(at, place))
        self.damage.add(messages.not_a_record(where=where, count=lost))
        self._disproved = self._before
        self._before = place
        return place

    def _next_proved(self, begin: int) -> int:
        """The first place from here on that is proved to be a record, or -1."""
        reach = NEAR
        while begin < self.data.size:
            view = self.data.array(begin, begin + reach)
            for candidate in candidate_places(view, PROVING).tolist():
                if self._proves(begin + candidate):
                    return int(begin + candidate)
            if begin + view.shape[0] >= self.data.size:
                return -1
            begin += view.shape[0] - RECORD.size + 1
            reach = SPAN
        return -1

    def _proves(self, at: int) -> bool:
        """Whether what stands here, and behind it, proves that a record begins here."""
        opcode, length = RECORD.unpack(self.data[at : at + RECORD.size])
        content = at + RECORD.size
        end = content + length
        if end > self.data.size:
            return False
        if opcode == Opcode.FOOTER:
            return bool(length == FOOT.size and end == self.data.size - len(MAGIC))
        if opcode == Opcode.CHUNK:
            chunk = chunks.chunk_head(self.data, content, length)
            return chunk is not None and chunk.plausible
        if opcode == Opcode.DATA_END:
            following = self.data[end : end + 1]
            return length == CHECKSUM and bool(following) and 0 < following[0] <= LAST
        near = self.data.array(at, at + (LINKS + 1) * LARGE_MESSAGE)
        return messages_follow(raw_of(near), 0, self.channels)


def _kept_length(opcode: int, length: int) -> int:
    """How many bytes of a record of a large chunk are kept: all, or the beginning."""
    if opcode in IN_CHUNKS:
        return min(length, MAX_DEFINITION)
    return length if length <= LARGE_MESSAGE else MESSAGE_START


def _message_runs(view: Bytes) -> Runs:
    """The places of a chunk with the opcode of a message, and a length that ends inside."""
    size = int(view.shape[0])
    places = np.flatnonzero(view[: max(size - RECORD.size + 1, 0)] == Opcode.MESSAGE)
    lengths = gather(view, places + 1, 8).view("<u8")
    fits = lengths <= (size - RECORD.size - places).astype(np.uint64)
    begins = places[fits].astype(np.int64)
    return Runs(begins, begins + RECORD.size + lengths[fits].astype(np.int64))


def _definition_end(raw: memoryview, place: int) -> int:
    """Where a schema or channel record of a chunk ends that begins here, or -1."""
    if place + RECORD.size > len(raw):
        return -1
    opcode, length = RECORD.unpack_from(raw, place)
    end = place + RECORD.size + length
    if opcode not in IN_CHUNKS or end > len(raw):
        return -1
    return int(end)


def _messages_at(data: Bytes, starts: Integers) -> Messages:
    """The messages whose records begin at these places."""
    size = _MESSAGE_HEADER.itemsize
    inside = starts[starts + size <= data.shape[0]]
    head = gather(data, inside, size).view(_MESSAGE_HEADER)
    is_whole = head["length"].astype(np.int64) >= MESSAGE.size
    head = head[is_whole]
    return Messages(
        data=data,
        channel=head["channel"].copy(),
        sequence=head["sequence"].copy(),
        log_time=np.minimum(head["log_time"], _LAST_NS).astype(np.int64),
        begin=inside[is_whole] + size,
        length=head["length"].astype(np.int64) - MESSAGE.size,
        short=starts.shape[0] - int(np.count_nonzero(is_whole)),
    )
