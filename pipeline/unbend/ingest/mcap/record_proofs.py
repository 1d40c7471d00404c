"""What proves, after damage, that a record begins at a place of an MCAP file or of a chunk.

Any byte may look like an opcode. Proved are a footer at the end of the file, the head of a chunk
with sizes that fit each other, the end of the data with a record behind it, and messages of known
channels that follow each other.
"""

from collections.abc import Set

import numpy as np

from unbend.ingest.buffers import Bytes, FileView
from unbend.ingest.mcap import chunks
from unbend.ingest.mcap.record_layout import (
    CHECKSUM,
    FOOTER,
    LARGE_MESSAGE,
    LAST_OPCODE,
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Opcode,
    raw_of,
    record_at,
)
from unbend.units import Rows

PROVABLE = (Opcode.FOOTER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
MESSAGES_IN_A_ROW = 3  # that prove each other
NEAR = 1 << 16  # [bytes] searched first: damage is seldom large
FAR = 4 << 20  # [bytes] searched at once afterwards


def next_proved_record(data: FileView, begin: int, channels: Set[int]) -> int | None:
    """The first place of the file from ``begin`` on at which a record is proved to begin.

    ``channels``: the numbers of the channels defined so far. None if no such place follows.
    """
    reach = NEAR
    while begin < data.size:
        view = data.array(begin, begin + reach)
        for place_in_view in candidate_places(view, PROVABLE).tolist():
            place = int(begin + place_in_view)
            if is_proved(data, place, channels):
                return place
        if begin + view.shape[0] >= data.size:
            return None
        begin += view.shape[0] - RECORD_HEAD.size + 1  # the last places lacked bytes of their heads
        reach = FAR
    return None


def is_proved(data: FileView, place: int, channels: Set[int]) -> bool:
    """Whether the bytes of the file from a place on prove that a record begins there.

    Only the kinds of `PROVABLE` can be proved, each in its own way. ``channels``: the numbers of
    the channels defined so far.
    """
    record = record_at(data, place)
    if record.end > data.size:
        return False
    if record.opcode == Opcode.FOOTER:
        return record.length == FOOTER.size and record.end == data.size - len(MAGIC)
    if record.opcode == Opcode.CHUNK:
        chunk = chunks.chunk_head(data, record.content_begin, record.length)
        return chunk is not None and chunk.plausible
    if record.opcode == Opcode.DATA_END:
        following = data[record.end : record.end + 1]
        return record.length == CHECKSUM and bool(following) and 0 < following[0] <= LAST_OPCODE
    # Anything else is taken for a message: other kinds are refused by their opcode.
    near = data.array(place, place + (MESSAGES_IN_A_ROW + 1) * LARGE_MESSAGE)
    return messages_follow(raw_of(near), 0, channels)


def next_message_in_chunk(view: Bytes, begin: int, channels: Set[int]) -> int:
    """The first place behind ``begin`` from which `messages_follow` in an inflated chunk.

    ``channels``: the numbers of the channels defined so far. The chunk's length if there is no such
    place.
    """
    raw = raw_of(view)
    for near_begin in range(begin + 1, view.shape[0], NEAR):
        near = view[near_begin : near_begin + NEAR + RECORD_HEAD.size - 1]
        for place_in_near in candidate_places(near, (Opcode.MESSAGE,)).tolist():
            place = int(near_begin + place_in_near)
            if messages_follow(raw, place, channels):
                return place
    return int(view.shape[0])


def candidate_places(view: Bytes, opcodes: tuple[int, ...]) -> Rows:
    """The places of ``view`` with one of these opcodes, followed by a length below 4 GiB."""
    count = view.shape[0] - RECORD_HEAD.size + 1
    if count <= 0:
        return np.empty(0, np.intp)
    possible = np.isin(view[:count], np.array(opcodes, np.uint8))
    upper_half = RECORD_HEAD.size - 4  # of the eight bytes of the length, at the end of the head
    for byte in range(upper_half, RECORD_HEAD.size):
        possible &= view[byte : byte + count] == 0
    return np.flatnonzero(possible)


def messages_follow(raw: memoryview, place: int, channels: Set[int]) -> bool:
    """Whether `MESSAGES_IN_A_ROW` messages of known channels follow each other from a place on.

    Fewer are enough if the last one ends where ``raw`` ends.
    """
    for _ in range(MESSAGES_IN_A_ROW):
        if place == len(raw):
            return True
        content = place + RECORD_HEAD.size
        if content + MESSAGE_HEAD.size > len(raw):
            return False
        opcode, length = RECORD_HEAD.unpack_from(raw, place)
        if opcode != Opcode.MESSAGE:
            return False
        if not MESSAGE_HEAD.size <= length <= LARGE_MESSAGE:
            return False
        channel_number = raw[content : content + 2]
        if int.from_bytes(channel_number, "little") not in channels:
            return False
        place = content + length
    return place <= len(raw)  # the last message is whole
