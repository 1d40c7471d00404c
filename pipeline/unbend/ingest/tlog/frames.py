"""Frames of a telemetry log: their headers, checksums and payloads, many at once.

A frame is the ground station's big-endian clock in microseconds (8 bytes) and a MAVLink 1 (0xFE) or
MAVLink 2 (0xFD) packet.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, gather
from unbend.ingest.tlog.senders import sender_numbers
from unbend.units import Integers, Mask, Rows

STAMP = 8  # [bytes]
V1 = 0xFE  # the magic byte of MAVLink 1
V2 = 0xFD  # that of MAVLink 2
V1_BEFORE_PAYLOAD = 6  # [bytes] from the magic byte on
V2_BEFORE_PAYLOAD = 10
CHECKSUM = 2  # [bytes]
SIGNATURE = 13  # [bytes]
SIGNED = 1  # the flag of MAVLink 2 for a signature
HEAD = STAMP + V2_BEFORE_PAYLOAD
SHORTEST = STAMP + V1_BEFORE_PAYLOAD + CHECKSUM
LONGEST = HEAD + 255 + CHECKSUM + SIGNATURE
BLOCK = 8192  # rows of one pass of the checksum: they fit the cache

# The second byte of a stamp between 2001 (1e15 us, 0x00038D...) and 2103; the first one is 0.
STAMP_HIGH = range(0x03, 0x0F)

# Fields of both versions lie over each other: those with 1 are MAVLink 1's, those with 2, the flags
# and the two parts of the message id (low, high) MAVLink 2's.
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
    """Frames in the order of the file, (n,) each.

    at : the byte at which the stamp, and with it the frame, begins.
    total : how many bytes the frame has, with stamp, checksum and signature.
    host_us : the stamp, which is the ground station's clock [us].
    version : of MAVLink, 1 or 2.
    length : how many bytes of payload are sent.
    sequence : the sender's count of its messages, modulo 256.
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
        """The byte behind each frame."""
        return np.asarray(self.at + self.total, np.int64)

    @property
    def payload(self) -> Integers:
        """The byte offset of the payload."""
        before = np.where(self.version == 2, HEAD, STAMP + V1_BEFORE_PAYLOAD)
        return np.asarray(self.at + before, np.int64)

    @property
    def sender(self) -> NDArray[np.uint16]:
        """The numbers of the senders."""
        return sender_numbers(self.system, self.component)

    def take(self, rows: Mask | Rows | slice) -> "Frames":
        """The frames in some rows; the same object if a mask has all of them."""
        if isinstance(rows, np.ndarray) and rows.dtype == np.bool_ and bool(rows.all()):
            return self
        return Frames(**{name: column[rows] for name, column in vars(self).items()})

    def moved(self, by: int) -> "Frames":
        """The same frames, whose places in a window become places in the file by adding ``by``."""
        return Frames(**(vars(self) | {"at": self.at + by}))


def joined(parts: list[Frames]) -> Frames:
    """Several tables of frames as one, in the order of the file."""
    columns = {}
    for name in Frames.__dataclass_fields__:
        columns[name] = np.concatenate([vars(part)[name] for part in parts])
    whole = Frames(**columns)
    return whole.take(np.argsort(whole.at, kind="stable"))


def frame_length(data: bytes, at: int) -> int:
    """How many bytes the frame has whose stamp begins at a byte, by its header; 0 without a frame.

    The data may end within the frame.

    >>> frame_length(bytes([0, 5, 0, 0, 0, 0, 0, 0, 0xFE, 4]) + bytes(20), 0)
    20
    """
    if at + SHORTEST > len(data) or data[at] != 0 or data[at + 1] not in STAMP_HIGH:
        return 0
    packet = at + STAMP
    magic = data[packet]
    payload_length = data[packet + 1]
    if magic == V2:
        is_signed = data[packet + 2] & SIGNED
        return HEAD + payload_length + CHECKSUM + (SIGNATURE if is_signed else 0)
    if magic == V1:
        return STAMP + V1_BEFORE_PAYLOAD + payload_length + CHECKSUM
    return 0


def candidates(window: Bytes, stop: int) -> Integers:
    """Places before ``stop`` where a frame may begin.

    There is a plausible stamp, and eight bytes on a magic byte.
    """
    count = min(stop, window.shape[0] - STAMP)
    if count <= 0:
        return np.empty(0, np.int64)
    magic = window[STAMP : STAMP + count]
    stamp_high = window[1 : 1 + count]
    # In uint8, values below the begin of a range wrap to large ones: one comparison is enough.
    possible = (magic - np.uint8(V2)) <= V1 - V2
    possible &= window[:count] == 0
    possible &= (stamp_high - np.uint8(STAMP_HIGH.start)) < len(STAMP_HIGH)
    return np.flatnonzero(possible).astype(np.int64)


def headers(window: Bytes, places: Integers, room: int) -> Frames:
    """The frames at these places of a window that end within its first ``room`` bytes.

    The window must have `HEAD` bytes from the last place on, though its frame may be shorter.
    """
    head = gather(window, places, HEAD).view(_HEAD)
    is_v2 = head["magic"] == V2
    is_signed = is_v2 & (head["flags"] & SIGNED == 1)
    total = head["length"].astype(np.int64)
    total += np.where(is_v2, HEAD, STAMP + V1_BEFORE_PAYLOAD)
    total += CHECKSUM + SIGNATURE * is_signed
    id_of_v2 = head["low"] | head["high"].astype(np.int32) << 8
    frames = Frames(
        at=places,
        total=total,
        host_us=head["host"].astype(np.int64),
        version=np.where(is_v2, np.uint8(2), np.uint8(1)),
        length=head["length"],
        sequence=np.where(is_v2, head["seq2"], head["seq1"]),
        system=np.where(is_v2, head["sys2"], head["sys1"]),
        component=np.where(is_v2, head["comp2"], head["comp1"]),
        message_id=np.where(is_v2, id_of_v2, head["id1"]),
    )
    return frames.take(frames.end <= room)


# CRC-16/MCRF4XX (X.25 of the MAVLink library): what each byte adds to the checksum.
_POLYNOMIAL = np.uint16(0x8408)
_TABLE = np.arange(256, dtype=np.uint16)
for _ in range(8):
    _odd = _TABLE & 1 != 0
    _TABLE = np.where(_odd, (_TABLE >> 1) ^ _POLYNOMIAL, _TABLE >> 1).astype(np.uint16)


def _step(crc: NDArray[np.uint16], byte: NDArray[np.integer[Any]]) -> NDArray[np.uint16]:
    """The checksums after one more byte each."""
    return np.asarray((crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF], np.uint16)


# What two bytes add at a step: the register has 16 bits, so that 65,536 entries are all there are.
_ZERO = np.zeros(1, np.uint16)
_WORDS = _step(_step(np.arange(1 << 16, dtype=np.uint16), _ZERO), _ZERO)


class _Packets(NamedTuple):
    """Rows of some frames of one version and one length, and the bytes their checksum covers."""

    rows: Rows
    covered: int


def _packets_of_one_length(frames: Frames, known: Mask) -> list[_Packets]:
    """The known frames by version and length, in pieces of at most `BLOCK` rows."""
    group = frames.length.astype(np.uint16) * 2 + (frames.version == 2)  # lowest bit: MAVLink 2
    rows = np.flatnonzero(known)
    rows = rows[np.argsort(group[rows], kind="stable")]
    starts = np.flatnonzero(np.diff(group[rows].astype(np.int32), prepend=-1)).tolist()
    packets = []
    for begin, end in pairwise([*starts, rows.shape[0]]):
        key = int(group[rows[begin]])
        before_payload = V2_BEFORE_PAYLOAD if key & 1 else V1_BEFORE_PAYLOAD
        covered = before_payload - 1 + (key >> 1)  # all but the magic byte
        for first in range(begin, end, BLOCK):
            packets.append(_Packets(rows[first : min(first + BLOCK, end)], covered))
    return packets


def checksums_hold(window: Bytes, frames: Frames, extras: Mapping[int, int]) -> Mask:
    """Whether the checksum of each of (n,) frames holds; False for ids without a CRC_EXTRA."""
    holds = np.zeros(len(frames), np.bool_)
    if not len(frames):
        return holds
    ids = np.array(sorted(extras), np.int32)
    extra_of_id = np.array([extras[number] for number in ids.tolist()], np.uint16)
    place = np.minimum(np.searchsorted(ids, frames.message_id), ids.shape[0] - 1)
    known = ids[place] == frames.message_id
    extra = extra_of_id[place]
    for rows, covered in _packets_of_one_length(frames, known):
        first = frames.at[rows] + STAMP + 1
        computed, stored = checksums(window, first, covered, extra[rows])
        holds[rows] = computed == stored
    return holds


def checksums(
    window: Bytes, first: Integers, covered: int, extra: NDArray[np.uint16]
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """The (n,) computed checksums of packets of one length, and the stored ones behind them.

    The ``covered`` bytes begin at ``first`` (n,), behind the magic byte; ``extra`` (n,): CRC_EXTRA.
    """
    odd = covered & 1  # an odd packet is read from a byte before, so that it consists of words
    size = odd + covered + CHECKSUM
    packet = gather(window, first - odd, size)
    words = packet.view("<u2").reshape(-1, size // 2)
    crc = np.full(first.shape, 0xFFFF, np.uint16)
    if odd:
        crc = _step(crc, words[:, 0] >> 8)  # without the byte before
    for word in range(odd, size // 2 - 1):
        np.bitwise_xor(crc, words[:, word], out=crc)
        crc = _WORDS.take(crc, mode="clip")  # 16 bits are never out of range: no test needed
    return _step(crc, extra), words[:, -1]


def payloads(window: Bytes, frames: Frames, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Payloads of frames of one message as a structured array.

    What MAVLink 2 does not send, zeros at the end, is filled in.
    """
    filled = np.zeros((len(frames), dtype.itemsize), np.uint8)
    begin = frames.payload
    for length in np.flatnonzero(np.bincount(frames.length)).tolist():
        used = min(length, dtype.itemsize)
        if used:
            rows = np.flatnonzero(frames.length == length)
            sent = gather(window, begin[rows], used).view(np.uint8)
            filled[rows, :used] = sent.reshape(-1, used)
    return filled.view(dtype).reshape(len(frames))
