"""Layout of the records of an MCAP file: their kinds, their heads, and which of them are read.

A record is its opcode (one byte), the length of its content (eight bytes) and its content.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

from unbend.ingest.buffers import Bytes, FileView

MAGIC = b"\x89MCAP0\r\n"  # at both ends of a file
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the content
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
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


LAST_OPCODE = Opcode.DATA_END  # the last opcode that the format defines
FIRST_PRIVATE_OPCODE = (
    0x80  # from here on of applications; those from LAST_OPCODE to here mean nothing
)
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
DEFINITIONS_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL)  # also those that the summary repeats

MAX_DEFINITION = 16 << 20  # [bytes] of a schema, channel or statistics record
LARGE_MESSAGE = 1 << 16  # [bytes] longest that is read whole; of wanted ones only images are larger
MESSAGE_START = 4096  # [bytes] kept of a larger message: of images only the header is wanted
_CHECKED_AT_ONCE = 4 << 20  # [bytes]


class Record(NamedTuple):
    """A record: its kind, where it begins in the file, and the length of its content [bytes]."""

    opcode: int
    begin: int
    length: int

    @property
    def content_begin(self) -> int:
        """The place in the file of the first byte of its content."""
        return self.begin + RECORD_HEAD.size

    @property
    def end(self) -> int:
        """The place in the file behind its last byte."""
        return self.content_begin + self.length


@dataclass(frozen=True)
class Definition:
    """A schema, channel or statistics record.

    ``place`` in the file is where damage of its content is reported: the beginning of its content,
    or of the chunk that it is in.
    """

    opcode: int
    content: bytes
    place: int


def record_at(data: FileView, place: int) -> Record:
    """Read the bytes at a place of the file as the head of a record, without a check.

    Bytes that are missing at the end of the file are read as zeros.
    """
    head = data[place : place + RECORD_HEAD.size].ljust(RECORD_HEAD.size, b"\0")
    opcode, length = RECORD_HEAD.unpack(head)
    return Record(opcode, place, length)


def raw_of(view: Bytes) -> memoryview:
    """The bytes of an array, not copied: single numbers are read faster from a memoryview."""
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def checksum_of(data: FileView, begin: int, end: int) -> int:
    """The CRC-32 of the bytes of the file from ``begin`` to ``end``, read piece by piece."""
    crc = 0
    for place in range(begin, end, _CHECKED_AT_ONCE):
        crc = zlib.crc32(data[place : min(place + _CHECKED_AT_ONCE, end)], crc)
    return crc
