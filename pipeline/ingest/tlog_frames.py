"""Walking the frames of a MAVLink telemetry log, and round the damage in it.

A frame is the ground station's big-endian clock in microseconds (8 bytes) and a MAVLink 1 (0xFE)
or MAVLink 2 (0xFD) packet with a checksum. Lengths come from the headers, checksums are computed
for all frames of equal length at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

STAMP = 8
V1, V2 = 0xFE, 0xFD
V1_BEFORE_PAYLOAD, V2_BEFORE_PAYLOAD = 6, 10  # from the magic byte on
CHECKSUM = 2
SIGNATURE = 13
SHORTEST = STAMP + V1_BEFORE_PAYLOAD + CHECKSUM
BLOCK = 8192  # rows of one pass of the checksum: they fit the cache

# First two bytes of a stamp between 2001 (1e15 us, 0x00038D...) and 2103.
STAMP_HIGH = range(0x03, 0x0F)


@dataclass(frozen=True)
class Frames:
    """The frames in the order of the file, one row each.

    ``at`` byte offset of the stamp; ``host_us`` the ground station's clock; ``length`` of the
    payload; ``start`` byte offset of the payload.
    """

    at: NDArray[np.int64]
    host_us: NDArray[np.int64]
    version: NDArray[np.uint8]
    length: NDArray[np.int64]
    start: NDArray[np.int64]
    sequence: NDArray[np.int64]
    system: NDArray[np.int64]
    component: NDArray[np.int64]
    message_id: NDArray[np.int64]

    def __len__(self) -> int:
        return int(self.at.shape[0])

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Frames:
        """The frames of a mask or an index."""
        return Frames(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True)
class FrameWalk:
    """All frames with whole headers, and the bytes between them."""

    frames: Frames
    valid: NDArray[np.bool_]
    bad_bytes: int
    first_bad: int
    cut_bytes: int


def frame_length(data: bytes, at: int) -> int:
    """Bytes of the frame whose stamp begins here; 0 when there is none."""
    if at + SHORTEST > len(data) or data[at] != 0 or data[at + 1] not in STAMP_HIGH:
        return 0
    magic = data[at + STAMP]
    if magic == V2:
        signed = SIGNATURE if data[at + STAMP + 2] & 1 else 0
        return STAMP + V2_BEFORE_PAYLOAD + data[at + STAMP + 1] + CHECKSUM + signed
    if magic == V1:
        return STAMP + V1_BEFORE_PAYLOAD + data[at + STAMP + 1] + CHECKSUM
    return 0


class _Walker:
    def __init__(self, data: bytes, extras: Mapping[int, int]) -> None:
        self.data = data
        self.size = len(data)
        self.extras = extras
        self.starts: list[int] = []
        self.bad: list[tuple[int, int]] = []
        self.cut_bytes = 0

    def walk(self) -> None:
        at = 0
        while at < self.size:
            length = frame_length(self.data, at)
            if length and at + length <= self.size:
                self.starts.append(at)
                at += length
            else:
                at = self._resume(at)

    def _resume(self, at: int) -> int:
        begin = at
        if self.starts and self._disproved(self.starts[-1], at):
            begin = self.starts.pop()  # its length may be what is damaged
        found = self._next(begin + 1)
        if found == self.size and begin == at and self._is_cut(at):
            self.cut_bytes = self.size - at
        else:
            self.bad.append((begin, found - begin))
        return found

    def _disproved(self, at: int, end: int) -> bool:
        """Whether a frame ends here and fails its checksum; that of an unknown id cannot."""
        frames = _columns(self.data, np.array([at], np.int64))
        ends = at + frame_length(self.data, at) == end
        return ends and int(frames.message_id[0]) in self.extras and not self._proven(at)

    def _next(self, at: int) -> int:
        """The next byte with a frame whose checksum holds, or the end of the file."""
        at += STAMP
        while True:
            ends = [self.data.find(bytes([magic]), at) for magic in (V1, V2)]
            places = [place for place in ends if place != -1]
            if not places:
                return self.size
            at = min(places)
            if self._proven(at - STAMP):
                return at - STAMP
            at += 1

    def _proven(self, at: int) -> bool:
        length = frame_length(self.data, at)
        if not length or at + length > self.size:
            return False
        frames = _columns(self.data, np.array([at], np.int64))
        return bool(checksums_hold(self.data, frames, self.extras)[0])

    def _is_cut(self, at: int) -> bool:
        rest = self.size - at
        return rest < SHORTEST or frame_length(self.data, at) > rest


def walk(data: bytes, extras: Mapping[int, int]) -> FrameWalk:
    """Find every frame of a telemetry log.

    Parameters
    ----------
    data : the file.
    extras : CRC_EXTRA by message id, from the dialect.

    Returns the frames, with ``valid`` where the checksum holds (ids outside the dialect cannot be
    checked and count as valid: they only stand where the frames before them end). After damage
    the walk goes on with the next frame whose checksum holds.
    """
    walker = _Walker(data, extras)
    walker.walk()
    frames = _columns(data, np.array(walker.starts, np.int64))
    known = np.isin(frames.message_id, list(extras))
    valid = ~known
    valid[known] = checksums_hold(data, frames.take(known), extras)
    bad_bytes = sum(count for _, count in walker.bad)
    first = min((start for start, _ in walker.bad), default=-1)
    return FrameWalk(frames, valid, bad_bytes, first, walker.cut_bytes)


def _columns(data: bytes, at: NDArray[np.int64]) -> Frames:
    source = np.frombuffer(data, np.uint8)
    stamps = source[at[:, None] + np.arange(STAMP)].reshape(-1, STAMP)
    magic = at + STAMP
    version = source[magic]
    two = version == V2
    ids = [source[magic + np.where(two, k, 5 if k == 7 else 0)].astype(np.int64) for k in (7, 8, 9)]
    message_id = np.where(two, ids[0] | ids[1] << 8 | ids[2] << 16, ids[0])
    header = np.where(two, V2_BEFORE_PAYLOAD, V1_BEFORE_PAYLOAD)
    return Frames(
        at=at,
        host_us=stamps.view(">u8")[:, 0].astype(np.int64) if at.shape[0] else at,
        version=version,
        length=source[magic + 1].astype(np.int64),
        start=magic + header,
        sequence=source[magic + np.where(two, 4, 2)].astype(np.int64),
        system=source[magic + np.where(two, 5, 3)].astype(np.int64),
        component=source[magic + np.where(two, 6, 4)].astype(np.int64),
        message_id=message_id,
    )


def _crc_table() -> NDArray[np.uint16]:
    """CRC-16/MCRF4XX (X.25 of the MAVLink library), one entry a byte."""
    table = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint16(0x8408), table >> 1).astype(np.uint16)
    return table


_TABLE = _crc_table()


def checksums_hold(data: bytes, frames: Frames, extras: Mapping[int, int]) -> NDArray[np.bool_]:
    """Whether the checksum of each frame holds; False for ids without a CRC_EXTRA.

    Parameters
    ----------
    frames : (n,) frames that lie wholly inside ``data``.
    extras : CRC_EXTRA by message id.
    """
    source = np.frombuffer(data, np.uint8)
    holds = np.zeros(len(frames), np.bool_)
    known = np.isin(frames.message_id, list(extras))
    ids, inverse = np.unique(frames.message_id, return_inverse=True)
    extra = np.array([extras.get(int(key), 0) for key in ids], np.uint16)[inverse]
    group = frames.length * 2 + (frames.version == V2)
    for key in np.unique(group[known]):
        rows_of_key = np.flatnonzero(known & (group == key))
        before = V2_BEFORE_PAYLOAD if key & 1 else V1_BEFORE_PAYLOAD
        covered = before - 1 + (int(key) >> 1)  # all but the magic byte
        for block in range(0, rows_of_key.shape[0], BLOCK):
            rows = rows_of_key[block : block + BLOCK]
            places = frames.at[rows] + STAMP + 1
            packet = source[places + np.arange(covered + CHECKSUM)[:, None]]
            crc = np.full(rows.shape[0], 0xFFFF, np.uint16)
            for byte in packet[:covered]:
                crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
            crc = (crc >> 8) ^ _TABLE[(crc ^ extra[rows]) & 0xFF]
            stored = packet[covered].astype(np.uint16) | packet[covered + 1].astype(np.uint16) << 8
            holds[rows] = crc == stored
    return holds


def payloads(data: bytes, frames: Frames, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The payloads of frames of one message as a structured array.

    MAVLink 2 trims zeros at the end and newer dialects append fields: short payloads are filled
    with zeros, long ones cut to the size of ``dtype``.
    """
    source = np.frombuffer(data, np.uint8)
    filled = np.zeros((len(frames), dtype.itemsize), np.uint8)
    for length in np.unique(frames.length):
        rows = np.flatnonzero(frames.length == length)
        used = min(int(length), dtype.itemsize)
        index = frames.start[rows, None] + np.arange(used)
        filled[rows, :used] = source[index]
    return filled.view(dtype).reshape(len(frames))


def lost_by_source(frames: Frames) -> dict[tuple[int, int], int]:
    """Messages missing by the sequence numbers of each (system, component).

    A step back or a repeat (a second link, a reordering, a restart) is no loss: of the 256
    possible steps the upper half is taken as backward.
    """
    lost: dict[tuple[int, int], int] = {}
    keys = frames.system * 256 + frames.component
    for key in np.unique(keys):
        step = (np.diff(frames.sequence[keys == key]) - 1) % 256
        lost[(int(key) // 256, int(key) % 256)] = int(step[step < 128].sum())
    return lost
