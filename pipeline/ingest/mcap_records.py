"""Walking the records of an MCAP file, chunk by chunk, as far as it is whole.

The records themselves are parsed by the mcap library; the walk is ours, because the library's
readers give nothing for a truncated file and inflate chunks without a bound.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, Any

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

FOOTER, SCHEMA, CHANNEL, MESSAGE_RECORD, CHUNK, STATISTICS = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0B
WANTED = {SCHEMA, CHANNEL, MESSAGE_RECORD, CHUNK, STATISTICS}

MAX_CHUNK = 64 << 20  # [bytes] inflated; writers default to 1 to 4 MiB
MAX_RECORD = 256 << 20  # [bytes] a single message larger than this is skipped

# What the library's parsers of records raise on damaged lengths and text, beside McapError.
PARSE_ERRORS = (struct.error, ValueError, OverflowError)


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
            damage.add("LOG-TRUNCATED", "the file ends without a footer", at, len(header))
            return
        opcode, length = RECORD.unpack(header)
        rest = size - at - RECORD.size
        if opcode == 0 or length > rest:
            what = f"a record of {length} bytes (opcode {opcode}) where {rest} bytes are left"
            damage.add("LOG-TRUNCATED", f"{what}: the rest cannot be read", at, size - at)
            return
        if opcode not in WANTED:
            stream.seek(length, 1)
        elif length > MAX_RECORD:
            damage.add("LOG-TOO-LARGE", f"a record of {length} bytes is skipped", at, length)
            stream.seek(length, 1)
        elif opcode == CHUNK:
            yield from _chunk(stream.read(length), at, damage)
        else:
            yield opcode, stream.read(length)
        at += RECORD.size + length


def _chunk(content: bytes, at: int, damage: Damage) -> Iterator[tuple[int, bytes]]:
    data = _inflated(content, at, damage)
    place = 0
    while place < len(data):
        rest = len(data) - place - RECORD.size
        opcode, length = RECORD.unpack_from(data, place) if rest >= 0 else (0, 0)
        if opcode == 0 or length > rest:
            left = len(data) - place
            what = f"the last {left} of {len(data)} bytes of a chunk make no sense"
            damage.add("LOG-BAD-BYTES", what, at, left)
            return
        place += RECORD.size
        yield opcode, data[place : place + length]
        place += length


def _inflated(content: bytes, at: int, damage: Damage) -> bytes:
    """The records of a chunk; empty, with an entry in the damage, when they cannot be trusted."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.records import Chunk

    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    except (McapError, *PARSE_ERRORS) as error:
        damage.add("LOG-BAD-BYTES", f"a chunk has no valid head ({error})", at, len(content))
        return b""
    if chunk.uncompressed_size > MAX_CHUNK:
        what = f"a chunk of {chunk.uncompressed_size} bytes exceeds the limit of {MAX_CHUNK}"
        damage.add("LOG-TOO-LARGE", what, at, len(content))
        return b""
    data = _decompressed(chunk, at, damage)
    if data is None:
        return b""
    if len(data) != chunk.uncompressed_size:
        what = f"a chunk inflates to {len(data)} bytes, its head says {chunk.uncompressed_size}"
        damage.add("LOG-BAD-BYTES", what, at, len(content))
        return b""
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        damage.add("LOG-CRC", "a chunk fails its checksum", at, len(content))
        return b""
    return data


def _decompressed(chunk: Any, at: int, damage: Damage) -> bytes | None:
    """The data of a chunk, never more than one byte beyond the size that its head promises."""
    import lz4.frame  # type: ignore[import-untyped]  # it ships neither stubs nor a marker
    import zstandard

    limit = int(chunk.uncompressed_size) + 1
    try:
        if chunk.compression == "":
            return bytes(chunk.data)
        if chunk.compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                return bytes(reader.read(limit))
        if chunk.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, limit))
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        damage.add("LOG-BAD-BYTES", f"a chunk does not inflate ({error})", at, len(chunk.data))
        return None
    what = f"a chunk is compressed with {chunk.compression!r}, which is not known"
    damage.add("LOG-BAD-BYTES", what, at, len(chunk.data))
    return None
