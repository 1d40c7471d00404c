"""Frames of a telemetry log: their headers, checksums and payloads, many at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, gather
from unbend.units import Integers, Mask, Rows

STAMP = 8


V1, V2 = 0xFE, 0xFD


V1_BEFORE_PAYLOAD, V2_BEFORE_PAYLOAD = 6, 10  # from the magic byte on


CHECKSUM = 2


SIGNATURE = 13


HEAD = STAMP + V2_BEFORE_PAYLOAD


SHORTEST = STAMP + V1_BEFORE_PAYLOAD + CHECKSUM


LONGEST = HEAD + 255 + CHECKSUM + SIGNATURE


BLOCK = 8192  # rows of one pass of the checksum: they fit the cache


# First two bytes of a stamp between 2001 (1e15 us, 0x00038D...) and 2103.
STAMP_HIGH = range(0x03, 0x0F)


_HEAD = np.dtype(
    {
        "names": ["host", "magic", "length", "flags", "seq1", "sys1", "comp1", "id1",
                  "seq2", "sys2", "comp2", "low", "high"],
        "formats": [">u8", "u1", "u1", "u1", "u1", "u1", "u1", "u1", "u1", "u1", "u1", "u1", "<u2"],
        "offsets": [0, 8, 9, 10, 10, 11, 12, 13, 12, 13, 14, 15, 16],
        "itemsize": HEAD,
    }
)  # fmt: skip


@dataclass(frozen=True)
class Frames:
    """Frames in the order of the file, ``at`` the byte of the stamp, ``total`` bytes long.

    ``host_us`` is the ground station's clock, ``version`` 1 or 2, ``length`` that of the payload.
    """

    at: Integers
    total: Integers
    host_us: Integers
    version: NDArray[np.uint8]
    length: NDArray[np.uint8]
    sequence: NDArray[np.uint8]
    system: NDArray[np.uint8]
    component: NDArray[np.uint8]
    message_id: NDArray[np.int32]

    def __len__(self) -> int:
        return int(self.at.shape[0])

    @property
    def end(self) -> Integers:
        return np.asarray(self.at + self.total, np.int64)

    @property
    def payload(self) -> Integers:
        """The byte offset of the payload."""
        before = np.where(self.version == 2, HEAD, STAMP + V1_BEFORE_PAYLOAD)
        return np.asarray(self.at + before, np.int64)

    def take(self, rows: Mask | Rows | slice) -> "Frames":
        """The frames of a mask, an index or a slice."""
        if isinstance(rows, np.ndarray) and rows.dtype == np.bool_ and bool(rows.all()):
            return self
        return Frames(**{name: column[rows] for name, column in vars(self).items()})

    def moved(self, by: int) -> "Frames":
        """The same frames counted from another place."""
        return Frames(**(vars(self) | {"at": self.at + by}))


def joined(parts: list[Frames]) -> Frames:
    """Several tables of frames as one, in the order of the file."""
    names = Frames.__dataclass_fields__
    whole = Frames(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in names})
    return whole.take(np.argsort(whole.at, kind="stable"))


def frame_length(data: bytes, at: int) -> int:
    """Bytes of the frame whose stamp begins here; 0 when there is none.

    >>> frame_length(bytes([0, 5, 0, 0, 0, 0, 0, 0, 0xFE, 4]) + bytes(20), 0)
    20
    """
    if at + SHORTEST > len(data) or data[at] != 0 or data[at + 1] not in STAMP_HIGH:
        return 0
    magic = data[at + STAMP]
    if magic == V2:
        signed = SIGNATURE if data[at + STAMP + 2] & 1 else 0
        return HEAD + data[at + STAMP + 1] + CHECKSUM + signed
    if magic == V1:
        return STAMP + V1_BEFORE_PAYLOAD + data[at + STAMP + 1] + CHECKSUM
    return 0


def candidates(window: Bytes, stop: int) -> Integers:
    """Where before ``stop`` a frame may begin: a plausible stamp, eight bytes on a magic byte."""
    count = min(stop, window.shape[0] - STAMP)
    if count <= 0:
        return np.empty(0, np.int64)
    # uint8 wraps: a difference below the length of a range means inside of it
    may = (window[STAMP : STAMP + count] - np.uint8(V2)) <= V1 - V2
    may &= window[:count] == 0
    may &= (window[1 : 1 + count] - np.uint8(STAMP_HIGH.start)) < len(STAMP_HIGH)
    return np.flatnonzero(may).astype(np.int64)


def headers(window: Bytes, places: Integers, room: int) -> Frames:
    """The frames at these places that end in ``room`` bytes; `HEAD` bytes follow the last place."""
    head = gather(window, places, HEAD).view(_HEAD)
    two = head["magic"] == V2
    signed = two & (head["flags"] & 1 == 1)
    total = head["length"].astype(np.int64) + np.where(two, HEAD, STAMP + V1_BEFORE_PAYLOAD)
    total += CHECKSUM + SIGNATURE * signed
    frames = Frames(
        at=places,
        total=total,
        host_us=head["host"].astype(np.int64),
        version=np.where(two, np.uint8(2), np.uint8(1)),
        length=head["length"],
        sequence=np.where(two, head["seq2"], head["seq1"]),
        system=np.where(two, head["sys2"], head["sys1"]),
        component=np.where(two, head["comp2"], head["comp1"]),
        message_id=np.where(two, head["low"] | head["high"].astype(np.int32) << 8, head["id1"]),
    )
    return frames.take(frames.end <= room)


# CRC-16/MCRF4XX (X.25 of the MAVLink library), one entry a byte.
_TABLE = np.arange(256, dtype=np.uint16)


for _ in range(8):
    _TABLE = np.where(_TABLE & 1, (_TABLE >> 1) ^ np.uint16(0x8408), _TABLE >> 1).astype(np.uint16)


def _step(crc: NDArray[np.uint16], byte: NDArray[np.integer[Any]]) -> NDArray[np.uint16]:
    return np.asarray((crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF], np.uint16)


# Two bytes a step: the register is 16 bits wide, so one table of 65,536 entries is the whole step.
_ZERO = np.zeros(1, np.uint16)


_WORDS = _step(_step(np.arange(1 << 16, dtype=np.uint16), _ZERO), _ZERO)


def checksums_hold(window: Bytes, frames: Frames, extras: Mapping[int, int]) -> Mask:
    """Whether the checksum of each of (n,) frames holds; False for ids without a CRC_EXTRA."""
    holds = np.zeros(len(frames), np.bool_)
    if not len(frames):
        return holds
    ids = np.array(sorted(extras), np.int32)
    place = np.minimum(np.searchsorted(ids, frames.message_id), ids.shape[0] - 1)
    known = ids[place] == frames.message_id
    extra = np.array([extras[int(key)] for key in ids], np.uint16)[place]
    group = frames.length.astype(np.uint16) * 2 + (frames.version == 2)
    group[~known] = 0xFFFF
    order = np.argsort(group, kind="stable")
    edges = np.flatnonzero(np.diff(group[order], prepend=0xFFFE)).tolist()
    for begin, end in zip(edges, [*edges[1:], order.shape[0]], strict=True):
        key = int(group[order[begin]])
        if key == 0xFFFF:
            break
        covered = (V2_BEFORE_PAYLOAD if key & 1 else V1_BEFORE_PAYLOAD) - 1 + (key >> 1)
        for block in range(begin, end, BLOCK):
            rows = order[block : min(block + BLOCK, end)]
            first = frames.at[rows] + STAMP + 1  # all but the magic byte
            computed, stored = checksums(window, first, covered, extra[rows])
            holds[rows] = computed == stored
    return holds


def checksums(
    window: Bytes, first: Integers, covered: int, extra: NDArray[np.uint16]
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """The checksums of packets of one length, and those that stand behind them.

    The ``covered`` bytes begin at ``first`` (n,), behind the magic byte; ``extra`` (n,): CRC_EXTRA.
    """
    odd = covered & 1  # then the row begins a byte before, so that words lie on even places
    size = odd + covered + CHECKSUM
    packet = gather(window, first - odd, size)
    words = packet.view("<u2").reshape(-1, size // 2)
    crc = np.full(first.shape, 0xFFFF, np.uint16)
    if odd:
        crc = _step(crc, words[:, 0] >> 8)
    for word in range(odd, size // 2 - 1):
        np.bitwise_xor(crc, words[:, word], out=crc)
        crc = _WORDS.take(crc, mode="clip")  # 16 bits are never out of range: no test needed
    return _step(crc, extra), words[:, -1]


def payloads(window: Bytes, frames: Frames, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Payloads of one message as a structured array; what MAVLink 2 trims is filled with zeros."""
    filled = np.zeros((len(frames), dtype.itemsize), np.uint8)
    begin = frames.payload
    for length in np.flatnonzero(np.bincount(frames.length)).tolist():
        used = min(length, dtype.itemsize)
        if used:
            rows = np.flatnonzero(frames.length == length)
            filled[rows, :used] = gather(window, begin[rows], used).view(np.uint8).reshape(-1, used)
    return filled.view(dtype).reshape(len(frames))
