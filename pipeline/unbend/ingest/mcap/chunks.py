"""Chunks of an MCAP file, inflated as far as the limits allow.

A chunk is inflated no further than its head states, and the head may state no more than the limits
allow. So a bomb costs what the limits allow, and not what it would inflate to.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any, NamedTuple

from unbend.ingest.buffers import FileView
from unbend.ingest.mcap import messages
from unbend.messages import Message

CHUNK_HEAD = struct.Struct("<QQQII")  # the fields of `_HeadFields`
PACKED_SIZE = 8  # [bytes] of the number behind the name of the compression
LONGEST_NAME = 16  # letters of the name of a compression
COMPRESSIONS = ("", "lz4", "zstd")

# Up to WHOLE bytes a chunk is inflated at once; recorders write 1 to 4 MiB. Beyond, it is inflated
# block by block and twice, so its size costs time and no memory. Images fill chunks of hundreds of
# MiB and shrink to a half at best; bombs shrink to a 250th (lz4) or a 30,000th (zstd).
WHOLE = 16 << 20  # [bytes] inflated
FREE_CHUNK = 64 << 20  # [bytes] inflated; taken however far it was compressed
MAX_CHUNK = 2 << 30  # [bytes] inflated
MAX_RATIO = 200  # of a chunk larger than FREE_CHUNK, and of a file whose chunks exceed FREE_FILE
FREE_FILE = 256 << 20  # [bytes] inflated, all chunks of a file: 0.1 to 0.3 s
MAX_WINDOW = 64 << 20  # [bytes] that a decompressor may look back
BLOCK = 1 << 18  # [bytes] of a large chunk at once


class _HeadFields(NamedTuple):
    """The numbers at the beginning of a chunk; the name of the compression follows."""

    first_time: int
    last_time: int
    size: int
    crc: int
    letters_of_name: int


@dataclass(frozen=True)
class Chunk:
    """The head of a chunk, and where its packed records lie in the file.

    first_time, last_time : of its messages, as the head states them.
    size, crc : bytes and checksum of its records when inflated; 0 for no checksum.
    begin, length : place in the file and bytes of the packed records.
    rest : bytes of the chunk behind the packed records; 0 in an undamaged chunk.
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
        if self.compression not in COMPRESSIONS or self.rest != 0:
            return False
        if self.first_time > self.last_time:
            return False
        if self.compression == "":
            return self.size == self.length
        return self.size <= MAX_CHUNK

    @property
    def small(self) -> bool:
        """Whether it may be inflated at once: neither its records nor their packed bytes are large.

        At the worst packing adds some bytes to each block.
        """
        longest_packed = self.size + self.size // 64 + 4096
        return self.size <= WHOLE and self.length <= longest_packed


class InflationBudget:
    """How many bytes the chunks of a file may inflate to together: more for a larger file.

    >>> chunk = Chunk(0, 0, 60 << 20, 0, "zstd", 0, 9, 0)
    >>> InflationBudget(0).spend(chunk, where="a.mcap, byte 0", count=9) is None
    True
    """

    def __init__(self, file_bytes: int) -> None:
        self.limit = FREE_FILE + MAX_RATIO * file_bytes
        self.left = self.limit

    def spend(self, chunk: Chunk, *, where: str, count: int) -> Message | None:
        """Take what inflating a chunk costs from the budget, if the chunk may be inflated.

        Returns None then; otherwise the reason why it may not, and nothing is taken. ``where`` and
        ``count`` are its place, and its bytes in the file, for the message.
        """
        if chunk.size > min(MAX_CHUNK, max(FREE_CHUNK, MAX_RATIO * chunk.length)):
            return messages.chunk_too_large(
                where=where,
                count=count,
                packed=chunk.length,
                size=chunk.size,
                largest=MAX_CHUNK,
                ratio=MAX_RATIO,
                free=FREE_CHUNK,
            )
        cost = chunk.size if chunk.small else 2 * chunk.size  # a large one is inflated twice
        if cost > self.left:
            return messages.chunks_too_large(
                where=where,
                count=count,
                packed=chunk.length,
                size=chunk.size,
                left=self.left,
                limit=self.limit,
            )
        self.left -= cost
        return None


def chunk_head(data: FileView, at: int, length: int) -> Chunk | None:
    """The head of a chunk record whose content begins at ``at`` and has ``length`` bytes.

    None where the lengths in the head do not fit into the record.
    """
    head = data[at : at + min(length, CHUNK_HEAD.size + LONGEST_NAME + PACKED_SIZE)]
    if len(head) < CHUNK_HEAD.size + PACKED_SIZE:
        return None
    fields = _HeadFields(*CHUNK_HEAD.unpack_from(head))
    name_end = CHUNK_HEAD.size + fields.letters_of_name
    head_end = name_end + PACKED_SIZE
    if fields.letters_of_name > LONGEST_NAME or len(head) < head_end:
        return None
    packed = int.from_bytes(head[name_end:head_end], "little")
    if packed > length - head_end:
        return None
    return Chunk(
        first_time=fields.first_time,
        last_time=fields.last_time,
        size=fields.size,
        crc=fields.crc,
        compression=head[CHUNK_HEAD.size : name_end].decode("ascii", "backslashreplace"),
        begin=at + head_end,
        length=packed,
        rest=length - head_end - packed,
    )


def inflate(data: FileView, chunk: Chunk, *, where: str, count: int) -> bytes | Message:
    """Inflate a chunk and check it; returns its records, or why they cannot be used.

    Of a large chunk nothing is returned but b"": it is checked here, and inflated again block by
    block. ``where`` and ``count`` are its place, and its bytes in the file, for the message.
    """
    import zstandard

    blocks: list[bytes] = []
    size = 0
    crc = 0
    step = chunk.size + 1 if chunk.small else BLOCK  # a byte more shows that a chunk is too long
    try:
        with chunk_stream(data, chunk) as stream:
            while size <= chunk.size and (block := stream.read(step)):
                size += len(block)
                if chunk.crc:  # else the recorder made no checksum, and ``crc`` stays 0 too
                    crc = zlib.crc32(block, crc)
                if chunk.small:
                    blocks.append(block)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:  # of damaged bytes
        return messages.chunk_not_inflated(where=where, count=count, reason=str(error))
    if size != chunk.size:
        return messages.chunk_of_another_size(
            where=where, count=count, size=size, stated=chunk.size
        )
    if crc != chunk.crc:
        return messages.chunk_checksum_fails(where=where, count=count)
    return b"".join(blocks)


@contextmanager
def chunk_stream(data: FileView, chunk: Chunk) -> Iterator[IO[bytes]]:
    """The records of a chunk as a stream; those of a large chunk are inflated as they are read."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    packed: Any = io.BufferedReader(_Packed(data, chunk), BLOCK)
    if chunk.small:
        packed = io.BytesIO(data[chunk.begin : chunk.begin + chunk.length])
    if chunk.compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        stream = inflater.stream_reader(packed)
        yield stream if chunk.small else io.BufferedReader(stream, BLOCK)
    elif chunk.compression == "lz4" and chunk.small:
        # Bytes behind the frame are not read.
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
