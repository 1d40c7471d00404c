"""What lies in an MCAP file: records, messages and chunks, and what proves that they do.

A chunk is inflated as far as the limits allow, and has to agree with its head: a decompression bomb
costs what its head may state, not what it holds.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Set
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import Bytes, FileView, gather
from pipeline.units import Integers, Rows

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
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, letters that follow
COMPRESSIONS = ("", "lz4", "zstd")

# Up to WHOLE bytes a chunk is inflated at once; recorders write 1 to 4 MiB. Beyond, it is inflated
# block by block and twice, so its size costs time and no memory. Images fill chunks of hundreds of
# MiB and shrink to a half at best; bombs shrink to a 250th (lz4) or a 30,000th (zstd).
WHOLE = 16 << 20
FREE_CHUNK = 64 << 20  # [bytes] inflated; taken however far it was compressed
MAX_CHUNK = 2 << 30  # [bytes] inflated
MAX_RATIO = 200  # of a chunk larger than FREE_CHUNK, and of a file whose chunks exceed FREE_FILE
FREE_FILE = 256 << 20  # [bytes] inflated, all chunks of a file: 0.1 to 0.3 s
MAX_WINDOW = 64 << 20  # [bytes] that a decompressor may look back
BLOCK = 1 << 18

Fault = tuple[str, str]  # code and words


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


_HEADER = np.dtype(
    {
        "names": ["length", "channel", "sequence", "log_time"],
        "formats": ["<u8", "<u2", "<u4", "<u8"],
        "offsets": [1, 9, 11, 15],
        "itemsize": RECORD.size + MESSAGE.size,
    }
)
_LAST_NS = np.uint64(2**63 - 1)  # log_time is unsigned in the file; times inside are int64


def messages_at(data: Bytes, starts: Integers) -> Messages:
    """The messages whose records begin at these places."""
    size = _HEADER.itemsize
    inside = starts[starts + size <= data.shape[0]]
    head = gather(data, inside, size).view(_HEADER)
    good = head["length"].astype(np.int64) >= MESSAGE.size
    head, begin = head[good], inside[good] + size
    channel, sequence = head["channel"].copy(), head["sequence"].copy()
    log_time = np.minimum(head["log_time"], _LAST_NS).astype(np.int64)
    length, short = head["length"].astype(np.int64) - MESSAGE.size, starts.shape[0] - head.shape[0]
    return Messages(data, channel, sequence, log_time, begin, length, int(short))


def raw_of(view: Bytes) -> memoryview:
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def record_at(raw: bytes | memoryview, at: int) -> tuple[int, int]:
    """Opcode and length of the record that begins here."""
    opcode, length = RECORD.unpack_from(raw, at)
    return int(opcode), int(length)


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
        opcode, length = record_at(raw, place)
        channel = int.from_bytes(raw[place + 9 : place + 11], "little")
        if opcode != Opcode.MESSAGE or not MESSAGE.size <= length <= LARGE_MESSAGE:
            return False
        if channel not in channels:
            return False
        place += RECORD.size + length
    return place <= len(raw)


@dataclass(frozen=True)
class MessageRuns:
    """Places where messages may begin and end; ``breaks`` are those that no next one follows."""

    at: Integers
    end: Integers
    breaks: Rows

    @classmethod
    def of(cls, view: Bytes) -> MessageRuns:
        """The places with the opcode of a message and a length that ends inside ``view``."""
        count = view.shape[0] - RECORD.size + 1
        if count <= 0:
            none = np.empty(0, np.int64)
            return cls(none, none, np.empty(0, np.intp))
        at = np.flatnonzero(view[:count] == Opcode.MESSAGE).astype(np.int64)
        length = gather(view, at + 1, 8).view("<u8")
        inside = length <= (view.shape[0] - RECORD.size - at).astype(np.uint64)
        at = at[inside]
        end = at + RECORD.size + length[inside].astype(np.int64)
        follows = np.append(at[1:], -1) == end
        return cls(at, end, np.flatnonzero(~follows))

    def starting_at(self, place: int) -> slice:
        """The candidates that follow each other from a place on; empty when none begins there."""
        first = int(np.searchsorted(self.at, place))
        if first == self.at.shape[0] or self.at[first] != place:
            return slice(first, first)
        return slice(first, int(self.breaks[np.searchsorted(self.breaks, first)]) + 1)


@dataclass(frozen=True)
class Chunk:
    """The head of a chunk, its records' ``size`` when inflated and where they lie in the file."""

    first_time: int
    last_time: int
    size: int
    crc: int
    compression: str
    begin: int
    length: int
    rest: int

    @property
    def plausible(self) -> bool:
        """Whether the head alone proves that a chunk begins here: its sizes fit each other."""
        known = self.compression in COMPRESSIONS and self.rest == 0
        fits = self.size == self.length if self.compression == "" else self.size <= MAX_CHUNK
        return known and fits and self.first_time <= self.last_time

    @property
    def small(self) -> bool:
        """Whether it may be inflated at once; packing adds some bytes a block at the worst."""
        return self.size <= WHOLE and self.length <= self.size + self.size // 64 + 4096


class InflationBudget:
    """How much the chunks of a file may inflate to together; it grows with the file's size.

    >>> bool(InflationBudget(0).too_large(Chunk(0, 0, 60 << 20, 0, "zstd", 0, 9, 0)))
    False
    """

    def __init__(self, file_bytes: int) -> None:
        self.limit = FREE_FILE + MAX_RATIO * file_bytes
        self.left = self.limit

    def too_large(self, chunk: Chunk) -> str:
        """Why the chunk is not inflated; empty where it is, and its bytes are subtracted."""
        what = f"a chunk of {chunk.length} bytes would inflate to {chunk.size}"
        if chunk.size > min(MAX_CHUNK, max(FREE_CHUNK, MAX_RATIO * chunk.length)):
            limits = f"the limit is {MAX_CHUNK}, and {MAX_RATIO} times its own size"
            return f"{what}; {limits} beyond {FREE_CHUNK}: it is skipped"
        cost = chunk.size if chunk.small else 2 * chunk.size
        if cost > self.left:
            left = f"the chunks before it left {self.left} of the {self.limit} bytes"
            return f"{what}, and {left} that all chunks of a file of this size may: it is skipped"
        self.left -= cost
        return ""


def chunk_head(data: FileView, at: int, length: int) -> Chunk | None:
    """The head of a chunk record whose content is here; None where the lengths contradict."""
    head = data[at : at + min(length, CHUNK_HEAD.size + 16 + 8)]
    if len(head) < CHUNK_HEAD.size + 8:
        return None
    first, last, size, crc, letters = CHUNK_HEAD.unpack_from(head)
    if letters > 16 or len(head) < CHUNK_HEAD.size + letters + 8:
        return None
    before = CHUNK_HEAD.size + letters + 8
    name = head[CHUNK_HEAD.size : CHUNK_HEAD.size + letters].decode("ascii", "backslashreplace")
    packed = int.from_bytes(head[CHUNK_HEAD.size + letters : before], "little")
    if packed > length - before:
        return None
    return Chunk(first, last, size, crc, name, at + before, packed, length - before - packed)


def inflate(data: FileView, chunk: Chunk) -> bytes | Fault:
    """The records of a chunk of at most `WHOLE` bytes, or why they cannot be used."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    records, limit = data[chunk.begin : chunk.begin + chunk.length], chunk.size + 1
    try:
        if chunk.compression == "zstd":
            inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
            with inflater.stream_reader(records) as stream:
                records = bytes(stream.read(limit))
        elif chunk.compression == "lz4":
            lz4_inflater = lz4.frame.LZ4FrameDecompressor()
            records = bytes(lz4_inflater.decompress(records, max_length=limit))
    except inflating_errors() as error:
        return "LOG-BAD-BYTES", f"a chunk does not inflate ({error})"
    records = records[:limit]
    return chunk_fault(chunk, len(records), zlib.crc32(records) if chunk.crc else 0) or records


def chunk_fault(chunk: Chunk, size: int, crc: int) -> Fault | None:
    """Why so many inflated bytes with this checksum are not those of the chunk."""
    if size != chunk.size:
        inflated = f"{size} bytes" if size < chunk.size else "more"
        return "LOG-BAD-BYTES", f"a chunk inflates to {inflated}, its head states {chunk.size}"
    return ("LOG-CRC", "a chunk fails its checksum") if crc != chunk.crc else None


def large_chunk_fault(data: FileView, chunk: Chunk) -> Fault | None:
    """Why the records of a large chunk cannot be used; its bytes are inflated and not kept."""
    size = crc = 0
    try:
        with chunk_stream(data, chunk) as stream:
            while size <= chunk.size and (block := stream.read(BLOCK)):
                size += len(block)
                crc = zlib.crc32(block, crc) if chunk.crc else 0
    except inflating_errors() as error:
        return "LOG-BAD-BYTES", f"a chunk does not inflate ({error})"
    return chunk_fault(chunk, size, crc)


@contextmanager
def chunk_stream(data: FileView, chunk: Chunk) -> Iterator[IO[bytes]]:
    """The records of a chunk as a stream."""
    import lz4.frame
    import zstandard

    packed: Any = io.BufferedReader(_Packed(data, chunk), BLOCK)
    if chunk.compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        yield io.BufferedReader(inflater.stream_reader(packed), BLOCK)
    elif chunk.compression == "lz4":
        yield io.BufferedReader(lz4.frame.LZ4FrameFile(packed), BLOCK)
    else:
        yield packed


class _Packed(io.RawIOBase):
    """The packed bytes of a chunk as a file of their own."""

    def __init__(self, data: FileView, chunk: Chunk) -> None:
        super().__init__()
        self.data = data
        self.at = chunk.begin
        self.end = chunk.begin + chunk.length

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        block = self.data[self.at : min(self.at + len(buffer), self.end)]
        buffer[: len(block)] = block
        self.at += len(block)
        return len(block)


def inflating_errors() -> tuple[type[Exception], ...]:
    """What the inflaters raise on damaged bytes."""
    import zstandard

    return (zstandard.ZstdError, RuntimeError, EOFError)
