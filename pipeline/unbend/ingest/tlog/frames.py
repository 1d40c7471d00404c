"""Frames of a telemetry log: their headers, checksums and payloads, many at once.

A frame is the ground station's big-endian clock in microseconds (8 bytes) and a MAVLink 1 (0xFE) or
MAVLink 2 (0xFD) packet.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, gather
from unbend.ingest.message_tables import rows_by_value
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

_HEAD_V1 = np.dtype(
    [
        ("host_us", ">u8"),
        ("magic", "u1"),
        ("length", "u1"),
        ("sequence", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("message_id", "u1"),
        ("payload", "V4"),  # as far as it lies in the `HEAD` bytes
    ]
)
_HEAD_V2 = np.dtype(
    [
        ("host_us", ">u8"),
        ("magic", "u1"),
        ("length", "u1"),
        ("incompatible", "u1"),
        ("compatible", "u1"),
        ("sequence", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("id_low", "u1"),  # the message id has 24 bits
        ("id_high", "<u2"),
    ]
)


@dataclass(frozen=True)
class Frames:
    """Frames in the order of the file, (n,) each.

    place : the byte at which the stamp, and with it the frame, begins.
    total : how many bytes the frame has, with stamp, checksum and signature.
    host_us : the stamp, which is the ground station's clock [us].
    version : of MAVLink, 1 or 2.
    length : how many bytes of payload are sent.
    sequence : the sender's count of its messages, modulo 256.
    """

    place: Integers
    total: Integers
    host_us: Integers
    version: NDArray[np.uint8]
    length: NDArray[np.uint8]
    sequence: NDArray[np.uint8]
    system: NDArray[np.uint8]
    component: NDArray[np.uint8]
    message_id: NDArray[np.int32]

    def __len__(self) -> int:
        return int(self.place.shape[0])

    @property
    def end(self) -> Integers:
        """The place of the first byte behind each frame."""
        return np.asarray(self.place + self.total, np.int64)

    @property
    def payload(self) -> Integers:
        """The place of the first byte of each payload."""
        before = np.where(self.version == 2, HEAD, STAMP + V1_BEFORE_PAYLOAD)
        return np.asarray(self.place + before, np.int64)

    @property
    def sender(self) -> NDArray[np.uint16]:
        """The number (`Sender.number`) of the sender of each frame."""
        return sender_numbers(self.system, self.component)

    def take(self, rows: Mask | Rows | slice) -> "Frames":
        """The frames in some rows; this object itself if a mask selects all of them."""
        if isinstance(rows, np.ndarray) and rows.dtype == np.bool_:
            has_all = bool(rows.all())
            if has_all:
                return self
        columns = {}
        for name, column in vars(self).items():
            columns[name] = column[rows]
        return Frames(**columns)

    def moved(self, window_begin: int) -> "Frames":
        """The same frames with places in the file instead of places in a window.

        ``window_begin``: where the window begins in the file.
        """
        return replace(self, place=self.place + window_begin)


def joined(parts: list[Frames]) -> Frames:
    """Several tables of frames as one, in the order of the file."""
    columns = {}
    for name in Frames.__dataclass_fields__:
        pieces = [getattr(part, name) for part in parts]
        columns[name] = np.concatenate(pieces)
    whole = Frames(**columns)
    in_file_order = np.argsort(whole.place, kind="stable")
    return whole.take(in_file_order)


def frame_length(data: bytes, begin: int) -> int:
    """The length [bytes] that the header of the frame at a place states; 0 if none begins there.

    ``begin``: the place of its stamp in the data, which may end within the frame.

    >>> frame_length(bytes([0, 5, 0, 0, 0, 0, 0, 0, 0xFE, 4]) + bytes(20), 0)
    20
    """
    if begin + SHORTEST > len(data):
        return 0
    has_stamp = data[begin] == 0 and data[begin + 1] in STAMP_HIGH
    if not has_stamp:
        return 0
    packet = begin + STAMP
    magic = data[packet]
    payload_length = data[packet + 1]
    if magic == V1:
        return STAMP + V1_BEFORE_PAYLOAD + payload_length + CHECKSUM
    if magic != V2:
        return 0
    length = HEAD + payload_length + CHECKSUM
    is_signed = data[packet + 2] & SIGNED
    if is_signed:
        length += SIGNATURE
    return length


def candidates(window: Bytes, stop: int) -> Integers:
    """The places of a window, before ``stop``, where a frame may begin.

    These have a plausible stamp, with a magic byte behind its eight bytes.
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


def frames_at(window: Bytes, places: Integers, room: int) -> Frames:
    """Read the frames that begin at (n,) places of a window.

    Frames that end beyond the first ``room`` bytes of the window are left out. The window must have
    `HEAD` bytes from each place on, although a frame may be shorter.
    """
    head = gather(window, places, HEAD)
    v1 = head.view(_HEAD_V1)
    v2 = head.view(_HEAD_V2)
    is_v2 = v2["magic"] == V2
    is_signed = is_v2 & (v2["incompatible"] & SIGNED == 1)
    total = v2["length"].astype(np.int64)
    total += np.where(is_v2, HEAD, STAMP + V1_BEFORE_PAYLOAD)
    total += CHECKSUM + SIGNATURE * is_signed
    id_of_v2 = v2["id_low"] | v2["id_high"].astype(np.int32) << 8
    frames = Frames(
        place=places,
        total=total,
        host_us=v2["host_us"].astype(np.int64),
        version=np.where(is_v2, 2, 1).astype(np.uint8),
        length=v2["length"],
        sequence=np.where(is_v2, v2["sequence"], v1["sequence"]),
        system=np.where(is_v2, v2["system"], v1["system"]),
        component=np.where(is_v2, v2["component"], v1["component"]),
        message_id=np.where(is_v2, id_of_v2, v1["message_id"]),
    )
    return frames.take(frames.end <= room)


# CRC-16/MCRF4XX (X.25 of the MAVLink library): what each value of a byte adds to the checksum.
_POLYNOMIAL = np.uint16(0x8408)
_CRC_OF_BYTE = np.arange(256, dtype=np.uint16)
for _ in range(8):
    _odd = _CRC_OF_BYTE & 1 != 0
    _half = _CRC_OF_BYTE >> 1
    _CRC_OF_BYTE = np.where(_odd, _half ^ _POLYNOMIAL, _half)


def _crc_after_byte(
    crc: NDArray[np.uint16],
    byte: NDArray[np.integer[Any]],
) -> NDArray[np.uint16]:
    """(n,) checksums after one more byte each."""
    table_row = (crc ^ byte) & 0xFF
    return np.asarray((crc >> 8) ^ _CRC_OF_BYTE[table_row], np.uint16)


# Two bytes are one step: the checksum, combined with them by XOR, goes on as if they were zeros. It
# has 16 bits, so that a table of 65,536 entries has all results.
_REGISTERS = np.arange(1 << 16, dtype=np.uint16)
_ZERO = np.zeros(1, np.uint16)
_CRC_AFTER_ZERO_WORD = _crc_after_byte(_crc_after_byte(_REGISTERS, _ZERO), _ZERO)


class _Packets(NamedTuple):
    """Rows of some frames of one version and one length.

    ``covered``: how many bytes of each the checksum covers.
    """

    rows: Rows
    covered: int


def _packets_of_one_length(frames: Frames, has_extra: Mask) -> list[_Packets]:
    """The frames in groups of one version and length, each of at most `BLOCK` rows.

    ``has_extra``: (n,) whether the CRC_EXTRA of a frame's id is known; other frames are left out.
    """
    rows = np.flatnonzero(has_extra)
    group = frames.length[rows].astype(np.uint16) * 2
    group += frames.version[rows] == 2  # the lowest bit is the version
    packets = []
    for _, places_in_rows in rows_by_value(group):
        rows_alike = rows[places_in_rows]
        first_row = rows_alike[0]
        is_v2 = frames.version[first_row] == 2
        before_payload = V2_BEFORE_PAYLOAD if is_v2 else V1_BEFORE_PAYLOAD
        covered = before_payload - 1 + int(frames.length[first_row])  # all but the magic byte
        for begin in range(0, rows_alike.size, BLOCK):
            piece = rows_alike[begin : begin + BLOCK]
            packets.append(_Packets(piece, covered))
    return packets


def checksums_hold(
    window: Bytes,
    frames: Frames,
    crc_extra_of_id: Mapping[int, int],
) -> Mask:
    """(n,) whether the checksum of each frame is right; False for ids without a CRC_EXTRA."""
    is_right = np.zeros(len(frames), np.bool_)
    if not len(frames):
        return is_right
    sorted_ids = sorted(crc_extra_of_id)
    ids = np.array(sorted_ids, np.int32)
    extra_of_id = np.array([crc_extra_of_id[number] for number in sorted_ids], np.uint16)
    id_row = np.searchsorted(ids, frames.message_id)
    id_row = np.minimum(id_row, ids.shape[0] - 1)  # beyond the last id: any row, it is not equal
    has_extra = ids[id_row] == frames.message_id
    extra = extra_of_id[id_row]
    for rows, bytes_covered in _packets_of_one_length(frames, has_extra):
        behind_magic = frames.place[rows] + STAMP + 1
        sums = checksums(window, behind_magic, bytes_covered, extra[rows])
        is_right[rows] = sums.computed == sums.stored
    return is_right


class Checksums(NamedTuple):
    """The checksums of (n,) packets: computed from their bytes, and stored behind them."""

    computed: NDArray[np.uint16]
    stored: NDArray[np.uint16]


def checksums(
    window: Bytes,
    behind_magic: Integers,
    covered: int,
    extra: NDArray[np.uint16],
) -> Checksums:
    """The checksums of (n,) packets of one length.

    They cover ``covered`` bytes from ``behind_magic`` (n,) on, the places behind the magic bytes,
    and ``extra`` (n,), the CRC_EXTRA of each packet.
    """
    # Packets with an odd number of bytes are read from the byte before: then they are whole words.
    bytes_before = covered % 2
    size = bytes_before + covered + CHECKSUM
    packets = gather(window, behind_magic - bytes_before, size)
    words = packets.view("<u2").reshape(-1, size // 2)
    stored_word = size // 2 - 1
    crc = np.full(behind_magic.shape, 0xFFFF, np.uint16)
    first_whole_word = 0
    if bytes_before:
        high_byte = words[:, 0] >> 8  # the low one is the byte before the packet
        crc = _crc_after_byte(crc, high_byte)
        first_whole_word = 1
    for number in range(first_whole_word, stored_word):
        np.bitwise_xor(crc, words[:, number], out=crc)
        # 16 bits are never out of range, so "clip" only spares the test.
        crc = _CRC_AFTER_ZERO_WORD.take(crc, mode="clip")
    return Checksums(
        computed=_crc_after_byte(crc, extra),
        stored=words[:, stored_word],
    )


def payloads(
    window: Bytes,
    frames: Frames,
    dtype: np.dtype[Any],
) -> NDArray[Any]:
    """(n,) payloads of frames of one message as a structured array of ``dtype``.

    Zeros at the end, which MAVLink 2 does not send, are filled in. Bytes beyond ``dtype``, of
    fields that the dialect does not have, are cut off.
    """
    filled = np.zeros((len(frames), dtype.itemsize), np.uint8)
    payload_begins = frames.payload
    frames_of_length = np.bincount(frames.length)
    for length in np.flatnonzero(frames_of_length).tolist():
        used_bytes = min(length, dtype.itemsize)
        if used_bytes:
            rows = np.flatnonzero(frames.length == length)
            sent = gather(window, payload_begins[rows], used_bytes)
            sent_bytes = sent.view(np.uint8).reshape(-1, used_bytes)
            filled[rows, :used_bytes] = sent_bytes
    return filled.view(dtype).reshape(len(frames))
