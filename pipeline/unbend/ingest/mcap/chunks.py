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

# Up to MAX_AT_ONCE bytes a chunk is inflated at once; recorders write 1 to 4 MiB. Beyond, it is
# inflated block by block and twice, so its size costs time and no memory. Images fill chunks of
# hundreds of MiB and shrink to a half at best; bombs shrink to a 250th (lz4), a 30,000th (zstd).
MAX_AT_ONCE = 16 << 20  # [bytes] inflated
FREE_CHUNK = 64 << 20  # [bytes] inflated; taken however far it was compressed
MAX_CHUNK = 2 << 30  # [bytes] inflated
MAX_RATIO = 200  # of a chunk larger than FREE_CHUNK, and of a file whose chunks exceed FREE_FILE
FREE_FILE = 256 << 20  # [bytes] inflated, all chunks of a file: 0.1 to 0.3 s
FREE_MESSAGES = 500_000  # in the chunks of any file: 0.5 s, and 60 MB of columns
BYTES_OF_MESSAGE = 8  # of the file, compressed: a time and a value alone that vary need more
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
    """The head of a chunk, and where its packed records are in the file.

    first_time, last_time : log_time [ns] of its messages, as the head states them.
    size, crc : bytes and CRC-32 of its records when inflated; a CRC of 0 means no checksum.
    compression : its name, "" for records that are not packed.
    begin, length : place in the file and bytes of the packed records.
    trailing_bytes : bytes of the chunk behind the packed records; 0 in an undamaged chunk.
    """

    first_time: int
    last_time: int
    size: int
    crc: int
    compression: str
    begin: int
    length: int
    trailing_bytes: int

    @property
    def plausible(self) -> bool:
        """Whether the head alone proves that a chunk begins here: its sizes fit each other."""
        if self.compression not in COMPRESSIONS or self.trailing_bytes != 0:
            return False
        if self.first_time > self.last_time:
            return False
        if self.compression == "":
            return self.size == self.length
        return self.size <= MAX_CHUNK

    @property
    def small(self) -> bool:
        """Whether it may be inflated at once: neither its records nor their packed bytes are large.

        Packing makes records that cannot be compressed longer by some bytes a block.
        """
        longest_packed = self.size + self.size // 64 + 4096
        return self.size <= MAX_AT_ONCE and self.length <= longest_packed


class InflationBudget:
    """How many bytes and messages the chunks of a file may inflate to: more for a larger file.

    ``max_bytes`` and ``max_messages`` of all chunks; ``bytes_left`` and ``messages_left`` of them.

    >>> chunk = Chunk(0, 0, 60 << 20, 0, "zstd", 0, 9, 0)
    >>> InflationBudget(0).spend(chunk, where="a.mcap, byte 0", count=9) is None
    True
    """

    def __init__(self, file_bytes: int) -> None:
        self.max_bytes = FREE_FILE + MAX_RATIO * file_bytes
        self.bytes_left = self.max_bytes
        self.max_messages = FREE_MESSAGES + file_bytes // BYTES_OF_MESSAGE
        self.messages_left = self.max_messages

    def spend(self, chunk: Chunk, *, where: str, count: int) -> Message | None:
        """Take the cost of inflating a chunk from the budget; None if that is possible.

        If the chunk is too large, nothing is taken, and the message about that is returned.
        ``where`` and ``count``: the chunk's place, and its bytes in the file, for the message.
        """
        largest = min(MAX_CHUNK, max(FREE_CHUNK, MAX_RATIO * chunk.length))
        if chunk.size > largest:
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
        if cost > self.bytes_left:
            return messages.chunks_too_large(
                where=where,
                count=count,
                packed=chunk.length,
                size=chunk.size,
                left=self.bytes_left,
                limit=self.max_bytes,
            )
        self.bytes_left -= cost
        return None

    def spend_messages(self, rows: int, *, where: str, count: int) -> Message | None:
        """Take the messages of a chunk, ``rows``, from the budget; None if that is possible.

        If they are too many, nothing is taken, and the message about that is returned. ``where``
        and ``count``: the chunk's place, and the bytes of its messages, for the message.
        """
        if rows > self.messages_left:
            return messages.too_many_messages(
                where=where,
                count=count,
                rows=rows,
                left=self.messages_left,
                limit=self.max_messages,
            )
        self.messages_left -= rows
        return None


def chunk_head(data: FileView, begin: int, length: int) -> Chunk | None:
    """Read the head of a chunk from the content of its record: ``length`` bytes from ``begin`` on.

    None where the lengths in the head do not fit into the record.
    """
    head = data[begin : begin + min(length, CHUNK_HEAD.size + LONGEST_NAME + PACKED_SIZE)]
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
        begin=begin + head_end,
        length=packed,
        trailing_bytes=length - head_end - packed,
    )


def inflate(data: FileView, chunk: Chunk, *, where: str, count: int) -> bytes | Message:
    """Inflate a chunk and check it; returns its records, or a message why they cannot be used.

    A large chunk is only checked, and b"" is returned: `chunk_stream` inflates it again, block by
    block. ``where`` and ``count``: its place, and its bytes in the file, for the message.
    """
    import zstandard

    blocks: list[bytes] = []
    size = 0
    crc = 0
    read_size = chunk.size + 1 if chunk.small else BLOCK  # + 1 shows that a chunk is too long
    try:
        with chunk_stream(data, chunk) as stream:
            while size <= chunk.size and (block := stream.read(read_size)):
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
    """The inflated records of a chunk as a stream; a large chunk is inflated as it is read."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    packed: Any
    if chunk.small:
        packed = io.BytesIO(data[chunk.begin : chunk.begin + chunk.length])
    else:
        packed = io.BufferedReader(_Packed(data, chunk), BLOCK)
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
    """The packed bytes of a chunk as a file, for the libraries that inflate them."""

    def __init__(self, data: FileView, chunk: Chunk) -> None:
        super().__init__()
        self.data = data
        self.place = chunk.begin
        self.end = chunk.begin + chunk.length

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        block = self.data[self.place : min(self.place + len(buffer), self.end)]
        buffer[: len(block)] = block
        self.place += len(block)
        return len(block)
