"""Chunks of an MCAP file: their heads, and inflating them within bounds.

A chunk says how large its records are. It is believed as far as the bounds go, and the inflated
bytes have to agree with it; a bomb therefore costs what its head may claim, not what it holds.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

from pipeline.ingest.buffers import FileView

HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, letters that follow
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


@dataclass(frozen=True)
class Chunk:
    """The head of a chunk, and where its records lie in the file.

    ``size`` of the records when inflated; ``rest`` bytes of the record behind them.
    """

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

    @property
    def too_large(self) -> str:
        """Why the chunk is not inflated, or nothing."""
        if self.size <= MAX_CHUNK and self.size <= max(FREE_CHUNK, MAX_RATIO * self.length):
            return ""
        return (
            f"a chunk of {self.length} bytes would inflate to {self.size}; the limit is "
            f"{MAX_CHUNK}, and {MAX_RATIO} times its own size beyond {FREE_CHUNK}: it is skipped"
        )


class Budget:
    """How much the chunks of a file may inflate to together; it grows with the file's size.

    >>> bool(Budget(0).too_large(Chunk(0, 0, 60 << 20, 0, "zstd", 0, 9, 0)))
    False
    """

    def __init__(self, file_bytes: int) -> None:
        self.limit = FREE_FILE + MAX_RATIO * file_bytes
        self.left = self.limit

    def too_large(self, chunk: Chunk) -> str:
        """Why the chunk is not inflated, or nothing; then its bytes are taken off the budget."""
        if chunk.too_large:
            return chunk.too_large
        cost = chunk.size if chunk.small else 2 * chunk.size
        if cost > self.left:
            return (
                f"a chunk of {chunk.length} bytes would inflate to {chunk.size}, and the chunks "
                f"before it left {self.left} of the {self.limit} bytes that all chunks of a file "
                f"of this size may: it is skipped"
            )
        self.left -= cost
        return ""


def head_of(data: FileView, at: int, length: int) -> Chunk | None:
    """The head of a chunk record whose content is here; None where the lengths contradict."""
    head = data[at : at + min(length, HEAD.size + 16 + 8)]
    if len(head) < HEAD.size + 8:
        return None
    first, last, size, crc, letters = HEAD.unpack_from(head)
    if letters > 16 or len(head) < HEAD.size + letters + 8:
        return None
    before = HEAD.size + letters + 8
    name = head[HEAD.size : HEAD.size + letters].decode("ascii", "backslashreplace")
    packed = int.from_bytes(head[HEAD.size + letters : before], "little")
    if packed > length - before:
        return None
    return Chunk(first, last, size, crc, name, at + before, packed, length - before - packed)


def inflate(data: FileView, chunk: Chunk) -> bytes | Fault:
    """The records of a chunk of at most `WHOLE` bytes, or why they cannot be trusted."""
    packed = data[chunk.begin : chunk.begin + chunk.length]
    try:
        records = _unpacked(packed, chunk.compression, chunk.size + 1)
    except inflating_errors() as error:
        return "LOG-BAD-BYTES", f"a chunk does not inflate ({error})"
    return fault_of(chunk, len(records), zlib.crc32(records) if chunk.crc else 0) or records


def fault_of(chunk: Chunk, size: int, crc: int) -> Fault | None:
    """Why so many inflated bytes with this checksum are not those of the chunk."""
    if size != chunk.size:
        found = f"{size} bytes" if size < chunk.size else "more"
        return "LOG-BAD-BYTES", f"a chunk inflates to {found}, its head says {chunk.size}"
    return ("LOG-CRC", "a chunk fails its checksum") if crc != chunk.crc else None


def _unpacked(packed: bytes, compression: str, limit: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    if compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        with inflater.stream_reader(packed) as stream:
            return bytes(stream.read(limit))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=limit))
    return packed[:limit]


def proven(data: FileView, chunk: Chunk) -> Fault | None:
    """Why the records of a large chunk cannot be trusted; its bytes are inflated and forgotten."""
    size = crc = 0
    try:
        with inflated(data, chunk) as stream:
            while size <= chunk.size and (block := stream.read(BLOCK)):
                size += len(block)
                crc = zlib.crc32(block, crc) if chunk.crc else 0
    except inflating_errors() as error:
        return "LOG-BAD-BYTES", f"a chunk does not inflate ({error})"
    return fault_of(chunk, size, crc)


@contextmanager
def inflated(data: FileView, chunk: Chunk) -> Iterator[IO[bytes]]:
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
