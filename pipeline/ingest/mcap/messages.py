"""Messages and definitions of an MCAP file as they lie in it, and what proves that they do."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Set
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import Bytes, gather

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
FOOT = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum

FOOTER, SCHEMA, CHANNEL, MESSAGE_RECORD, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
STATISTICS, DATA_END = 0x0B, 0x0F
LAST_OPCODE = 0x0F
PRIVATE = 0x80  # opcodes from here on belong to applications; those between are not given out

LARGE_MESSAGE = 1 << 16  # [bytes] of what is wanted only images are larger ...
NEAR = 1 << 16  # [bytes] searched first: damage is seldom large
LINKS = 3  # records in a row that prove a message after damage
NAMED = 8  # losses of one kind that are named one by one


@dataclass
class Damage:
    """What a walk could not read: (code, what, byte offset, bytes); many of a kind as one."""

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

    def all(self) -> Iterator[tuple[str, str, int, int]]:
        """The losses, those beyond the first few of a kind in one line."""
        yield from self.losses
        for code, count in self.more.items():
            last = [at for found, _, at, _ in self.losses if found == code][-1]
            yield code, f"{self.seen[code] - NAMED} more places like that", last, count


@dataclass(frozen=True)
class Definition:
    """A schema, channel or statistics record, and where it or its chunk begins."""

    opcode: int
    content: bytes
    at: int


@dataclass(frozen=True)
class Messages:
    """Messages in the order of the file, one row each, and the bytes that they lie in.

    ``begin`` and ``length`` of the encoded message; of a large one only the beginning is there.
    ``short`` is the number of records too short for a message.
    """

    data: Bytes
    channel: NDArray[np.uint16]
    sequence: NDArray[np.uint32]
    log_time: NDArray[np.int64]
    begin: NDArray[np.int64]
    length: NDArray[np.int64]
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


def messages_at(data: Bytes, starts: NDArray[np.int64]) -> Messages:
    """The messages whose records begin at these places."""
    size = _HEADER.itemsize
    inside = starts[starts + size <= data.shape[0]]
    head = gather(data, inside, size).view(_HEADER)
    good = head["length"].astype(np.int64) >= MESSAGE.size
    head, begin = head[good], inside[good] + size
    return Messages(
        data,
        head["channel"].copy(),
        head["sequence"].copy(),
        np.minimum(head["log_time"], _LAST_NS).astype(np.int64),
        begin,
        head["length"].astype(np.int64) - MESSAGE.size,
        int(starts.shape[0] - head.shape[0]),
    )


def raw_of(view: Bytes) -> memoryview:
    return memoryview(view)  # type: ignore[arg-type]  # an array is a buffer


def record_at(raw: bytes | memoryview, at: int) -> tuple[int, int]:
    """Opcode and length of the record that begins here."""
    opcode, length = RECORD.unpack_from(raw, at)
    return int(opcode), int(length)


def may_begin(view: Bytes, opcodes: tuple[int, ...]) -> NDArray[np.intp]:
    """Places with one of these opcodes and a length below 4 GiB."""
    count = view.shape[0] - RECORD.size + 1
    if count <= 0:
        return np.empty(0, np.intp)
    may = np.isin(view[:count], np.array(opcodes, np.uint8))
    for byte in range(5, RECORD.size):
        may &= view[byte : byte + count] == 0
    return np.flatnonzero(may)


def next_message(view: Bytes, begin: int, channels: Set[int]) -> int:
    """The next place in a chunk behind ``begin`` that proves to be a message, or its end."""
    raw = raw_of(view)
    for at in range(begin + 1, view.shape[0], NEAR):
        near = view[at : at + NEAR + RECORD.size - 1]
        for place in may_begin(near, (MESSAGE_RECORD,)).tolist():
            if linked(raw, at + place, channels):
                return int(at + place)
    return int(view.shape[0])


def linked(raw: memoryview, place: int, channels: Set[int]) -> bool:
    """Whether messages of known channels stand wall to wall from here on."""
    for _ in range(LINKS):
        if place == len(raw):
            return True
        if place + RECORD.size + MESSAGE.size > len(raw):
            return False
        opcode, length = record_at(raw, place)
        channel = int.from_bytes(raw[place + 9 : place + 11], "little")
        if opcode != MESSAGE_RECORD or not MESSAGE.size <= length <= LARGE_MESSAGE:
            return False
        if channel not in channels:
            return False
        place += RECORD.size + length
    return place <= len(raw)


@dataclass(frozen=True)
class Runs:
    """Places where a message record may begin, and how far they stand wall to wall.

    ``at`` and ``end`` (n,) of each candidate; ``breaks`` those that the next does not follow.
    """

    at: NDArray[np.int64]
    end: NDArray[np.int64]
    breaks: NDArray[np.intp]

    @classmethod
    def of(cls, view: Bytes) -> Runs:
        """By the opcode and a length that stays inside."""
        count = view.shape[0] - RECORD.size + 1
        if count <= 0:
            none = np.empty(0, np.int64)
            return cls(none, none, np.empty(0, np.intp))
        at = np.flatnonzero(view[:count] == MESSAGE_RECORD).astype(np.int64)
        length = gather(view, at + 1, 8).view("<u8")
        inside = length <= (view.shape[0] - RECORD.size - at).astype(np.uint64)
        at = at[inside]
        end = at + RECORD.size + length[inside].astype(np.int64)
        follows = np.append(at[1:], -1) == end
        return cls(at, end, np.flatnonzero(~follows))

    def from_place(self, place: int) -> slice:
        """The candidates wall to wall from a place on; an empty slice when none begins there."""
        first = int(np.searchsorted(self.at, place))
        if first == self.at.shape[0] or self.at[first] != place:
            return slice(first, first)
        return slice(first, int(self.breaks[np.searchsorted(self.breaks, first)]) + 1)
