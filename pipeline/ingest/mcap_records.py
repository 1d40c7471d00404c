"""Walking the records of an MCAP file, chunk by chunk, as far as it is whole.

The definitions are parsed by the mcap library; the walk is ours, because the library's readers
give nothing for a truncated file and inflate chunks without a bound.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, Any

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

FOOTER, SCHEMA, CHANNEL, MESSAGE_RECORD, CHUNK, STATISTICS = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0B
WANTED = {SCHEMA, CHANNEL, MESSAGE_RECORD, CHUNK, STATISTICS}

CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, letters that follow

# A chunk is inflated block by block, so its size costs time and no memory. Images fill chunks of
# hundreds of MiB and shrink to a half at best; bombs shrink to a 200th (lz4) or a 30,000th (zstd).
FREE_CHUNK = 256 << 20  # [bytes] inflated; taken however far it was compressed
MAX_CHUNK = 2 << 30  # [bytes] inflated
MAX_RATIO = 50  # of a chunk larger than FREE_CHUNK
MAX_WINDOW = 64 << 20  # [bytes] that a decompressor may look back

NO_FOOTER = (
    "without the footer that a closed MCAP has: the recorder died or the copy is incomplete, and "
    "whatever came after is lost"
)

LARGE_MESSAGE = 1 << 16  # [bytes] of what is wanted only images are larger ...
MESSAGE_START = 4096  # [bytes] ... and of those the header is wanted
MAX_DEFINITION = 16 << 20  # [bytes] of a schema, channel or statistics record
BLOCK = 1 << 18


@dataclass
class Damage:
    """What a walk could not read: (code, what, byte offset, bytes)."""

    losses: list[tuple[str, str, int, int]] = field(default_factory=list)

    def add(self, code: str, what: str, at: int, count: int) -> None:
        self.losses.append((code, what, at, count))

    @property
    def bad_bytes(self) -> int:
        return sum(count for _, _, _, count in self.losses)


def records(stream: IO[bytes], size: int, damage: Damage) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of the schemas, channels, messages and statistics of a file.

    Parameters
    ----------
    stream : the file, at its beginning.
    size : its length [bytes].
    damage : filled on the way with what is cut off, corrupt or too large.
    """
    at = len(stream.read(len(MAGIC)))
    opcode = 0
    while opcode != FOOTER:
        header = stream.read(RECORD.size)
        if len(header) < RECORD.size:
            damage.add("LOG-TRUNCATED", f"the file ends {NO_FOOTER}", at, len(header))
            return
        opcode, length = RECORD.unpack(header)
        rest = size - at - RECORD.size
        if opcode == 0 or length > rest:
            what = f"a record of {length} bytes (opcode {opcode}) where {rest} bytes are left"
            damage.add("LOG-TRUNCATED", f"{what}: it ends {NO_FOOTER}", at, size - at)
            return
        if opcode == CHUNK:
            yield from _chunk(stream, at + RECORD.size, length, damage)
        elif opcode in WANTED:
            content = _content(stream, opcode, length, at, damage)
            if content:
                yield opcode, content
        at += RECORD.size + length
        stream.seek(at)


def _content(stream: IO[bytes], opcode: int, length: int, at: int, damage: Damage) -> bytes:
    """The content of a record as far as it is wanted; of a large message the beginning."""
    if opcode == MESSAGE_RECORD:
        return stream.read(length if length <= LARGE_MESSAGE else MESSAGE_START)
    if length > MAX_DEFINITION:
        what = f"a definition of {length} bytes (opcode {opcode}) is skipped"
        damage.add("LOG-TOO-LARGE", what, at, length)
        return b""
    return stream.read(length)


@dataclass(frozen=True)
class _Chunk:
    """The head of a chunk, and where its records lie in the file."""

    size: int
    crc: int
    compression: str
    begin: int
    length: int


def _chunk(stream: IO[bytes], at: int, length: int, damage: Damage) -> Iterator[tuple[int, bytes]]:
    """The records of a chunk, once its size and checksum are proven."""
    chunk = _head(stream, at, length, damage)
    if chunk is None:
        return
    try:
        with _inflated(stream, chunk) as data:
            fault = _fault(chunk, data)
        if fault is not None:
            damage.add(*fault, at, length)
            return
        with _inflated(stream, chunk) as data:
            yield from _records_of_chunk(data, chunk.size, at, damage)
    except _inflating_errors() as error:
        damage.add("LOG-BAD-BYTES", f"a chunk does not inflate ({error})", at, length)


def _head(stream: IO[bytes], at: int, length: int, damage: Damage) -> _Chunk | None:
    """The head of a chunk; None, with an entry in the damage, when it cannot be trusted."""
    head = stream.read(min(length, CHUNK_HEAD.size))
    if len(head) == CHUNK_HEAD.size:
        _, _, size, crc, letters = CHUNK_HEAD.unpack(head)
        rest = length - CHUNK_HEAD.size - letters - 8
        if rest >= 0 and letters <= 16:
            name = stream.read(letters).decode("ascii", "backslashreplace")
            packed = int.from_bytes(stream.read(8), "little")
            if packed <= rest:
                chunk = _Chunk(size, crc, name, at + length - rest, packed)
                return _bounded(chunk, at, length, damage)
    damage.add("LOG-BAD-BYTES", "a chunk has no valid head", at, length)
    return None


def _bounded(chunk: _Chunk, at: int, length: int, damage: Damage) -> _Chunk | None:
    size = chunk.size
    if chunk.compression not in ("", "lz4", "zstd"):
        what = f"a chunk is compressed with {chunk.compression!r}, which is not known"
        damage.add("LOG-BAD-BYTES", what, at, length)
    elif size > MAX_CHUNK or size > max(FREE_CHUNK, MAX_RATIO * chunk.length):
        what = (
            f"a chunk of {chunk.length} bytes would inflate to {size}; the limit is {MAX_CHUNK}, "
            f"and {MAX_RATIO} times its own size beyond {FREE_CHUNK}: it is skipped"
        )
        damage.add("LOG-TOO-LARGE", what, at, length)
    else:
        return chunk
    return None


def _fault(chunk: _Chunk, data: IO[bytes]) -> tuple[str, str] | None:
    """Why the records of a chunk cannot be trusted, as code and words."""
    size = crc = 0
    while size <= chunk.size and (block := data.read(BLOCK)):
        size += len(block)
        crc = zlib.crc32(block, crc) if chunk.crc else 0
    if size != chunk.size:
        found = f"{size} bytes" if size < chunk.size else "more"
        return "LOG-BAD-BYTES", f"a chunk inflates to {found}, its head says {chunk.size}"
    return ("LOG-CRC", "a chunk fails its checksum") if crc != chunk.crc else None


def _records_of_chunk(
    data: IO[bytes], size: int, at: int, damage: Damage
) -> Iterator[tuple[int, bytes]]:
    place = 0
    while place < size:
        header = data.read(RECORD.size)
        rest = size - place - RECORD.size
        opcode, length = RECORD.unpack(header) if rest >= 0 else (0, 0)
        if opcode == 0 or length > rest:
            what = f"the last {size - place} of {size} bytes of a chunk make no sense"
            damage.add("LOG-BAD-BYTES", what, at, size - place)
            return
        place += RECORD.size + length
        content = b""
        if opcode in WANTED and opcode != CHUNK:  # a chunk in a chunk is against the format
            content = _content(data, opcode, length, at, damage)
            if content:
                yield opcode, content
        left = length - len(content)
        while left > 0:
            left -= len(data.read(min(left, BLOCK)))


class _Window(io.RawIOBase):
    """A stretch of a file as a file of its own."""

    def __init__(self, stream: IO[bytes], begin: int, length: int) -> None:
        super().__init__()
        self.stream = stream
        self.at = begin
        self.end = begin + length

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        self.stream.seek(self.at)
        block = self.stream.read(min(len(buffer), self.end - self.at))
        buffer[: len(block)] = block
        self.at += len(block)
        return len(block)


def _inflated(stream: IO[bytes], chunk: _Chunk) -> IO[bytes]:
    """The records of a chunk as a stream."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    window: Any = io.BufferedReader(_Window(stream, chunk.begin, chunk.length), BLOCK)
    if chunk.compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        return io.BufferedReader(inflater.stream_reader(window), BLOCK)
    if chunk.compression == "lz4":
        return io.BufferedReader(lz4.frame.LZ4FrameFile(window), BLOCK)
    return io.BufferedReader(window, BLOCK)


def _inflating_errors() -> tuple[type[Exception], ...]:
    import zstandard

    return (zstandard.ZstdError, RuntimeError, EOFError)
