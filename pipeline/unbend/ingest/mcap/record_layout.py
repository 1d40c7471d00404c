"""How the records of an MCAP file lie in it: kinds, heads, and which of them are read.

A record is its opcode (one byte), the length of its content (eight bytes) and its content.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

from unbend.ingest.buffers import Bytes, FileView

MAGIC = b"\x89MCAP0\r\n"  # at both ends of a file
RECORD = struct.Struct("<BQ")  # opcode, length of the content
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


LAST = Opcode.DATA_END  # the last opcode that the format defines
PRIVATE = 0x80  # opcodes from here on belong to applications; those between mean nothing
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
DEFINITIONS_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL)  # a chunk and the summary hold no others

MAX_DEFINITION = 16 << 20  # [bytes] of a schema, channel or statistics record
LARGE_MESSAGE = 1 << 16  # [bytes] of the messages that are wanted only images are larger
MESSAGE_START = 4096  # [bytes] kept of a larger message: of images only the header is wanted
_CHECKED_AT_ONCE = 4 << 20  # [bytes]


class Record(NamedTuple):
    """A record: its kind, its place in the file, and the length of its content."""

    opcode: int
    at: int
    length: int

    @property
    def content(self) -> int:
        """Where its content begins."""
        return self.at + RECORD.size

    @property
    def end(self) -> int:
        """Where its content ends."""
        return self.content + self.length


@dataclass(frozen=True)
class Definition:
    """A schema, channel or statistics record.

    ``at`` is the place in the file where damage of its content is reported: the beginning of its
    content, or of the chunk that it is in.
    """

    opcode: int
    content: bytes
    at: int


def record_at(data: FileView, at: int) -> Record:
    """What stands at a place of the file, taken for a record; zeros follow the file's end."""
    head = data[at : at + RECORD.size].ljust(RECORD.size, b"\0")
    opcode, length = RECORD.unpack(head)
    return Record(opcode, at, length)


def raw_of(view: Bytes) -> memoryview:
    """The buffer of an array."""
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def checksum_of(data: FileView, begin: int, end: int) -> int:
    """The checksum of the bytes of the file from ``begin`` to ``end``."""
    crc = 0
    for place in range(begin, end, _CHECKED_AT_ONCE):
        crc = zlib.crc32(data[place : min(place + _CHECKED_AT_ONCE, end)], crc)
    return crc
