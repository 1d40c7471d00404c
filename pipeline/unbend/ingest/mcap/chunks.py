"""Chunks of an MCAP file, inflated as far as the limits allow.

A chunk has to agree with its head: a bomb costs what that may state, not what it holds.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

from unbend.ingest.buffers import FileView

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
    """The records of a chunk, or why they cannot be used; of a large one nothing is kept."""
    import zstandard

    blocks, size, crc = list[bytes](), 0, 0
    step = chunk.size + 1 if chunk.small else BLOCK
    try:
        with chunk_stream(data, chunk) as stream:
            while size <= chunk.size and (block := stream.read(step)):
                size += len(block)
                crc = zlib.crc32(block, crc) if chunk.crc else 0
                blocks += [block] if chunk.small else []
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:  # of damaged bytes
        return "LOG-BAD-BYTES", f"a chunk does not inflate ({error})"
    if size != chunk.size:
        inflated = f"{size} bytes" if size < chunk.size else "more"
        return "LOG-BAD-BYTES", f"a chunk inflates to {inflated}, its head states {chunk.size}"
    return ("LOG-CRC", "a chunk fails its checksum") if crc != chunk.crc else b"".join(blocks)


@contextmanager
def chunk_stream(data: FileView, chunk: Chunk) -> Iterator[IO[bytes]]:
    """The records of a chunk as a stream."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    packed: Any = io.BufferedReader(_Packed(data, chunk), BLOCK)
    if chunk.small:
        packed = io.BytesIO(data[chunk.begin : chunk.begin + chunk.length])
    if chunk.compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        stream = inflater.stream_reader(packed)
        yield stream if chunk.small else io.BufferedReader(stream, BLOCK)
    elif chunk.compression == "lz4" and chunk.small:  # bytes behind the frame are left
        frame = lz4.frame.LZ4FrameDecompressor()
        yield io.BytesIO(frame.decompress(packed.read(), max_length=chunk.size + 1))
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
