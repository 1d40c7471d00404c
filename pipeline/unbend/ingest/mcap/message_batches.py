"""Messages of an MCAP file, gathered until there are enough of them to decode them together."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, gather
from unbend.ingest.mcap.record_layout import MESSAGE_HEAD
from unbend.units import Integers

BATCH_BYTES = 4 << 20  # of messages decoded together

_MESSAGE_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_LAST_NS = np.uint64(2**63 - 1)  # log_time is unsigned in the file; times inside are int64


class MessageRecords(NamedTuple):
    """Bytes of some records, and the (n,) places in ``data`` where those of messages begin."""

    data: Bytes
    starts: Integers


@dataclass(frozen=True)
class Messages:
    """(n,) messages in the order of the file; of a large message only the beginning is there."""

    data: Bytes
    channel: NDArray[np.uint16]  # number of the channel
    sequence: NDArray[np.uint32]  # count by the recorder, 0 if it does not count
    log_time: Integers  # when the recorder received the message [Unix ns]
    begin: Integers  # place of the encoded message in ``data``
    length: Integers  # of the encoded message [bytes]
    too_short: int  # how many records were too short to be messages

    def __len__(self) -> int:
        return int(self.channel.shape[0])


class MessageBatch:
    """Records of messages that wait for others, to be decoded together with them."""

    def __init__(self) -> None:
        self._waiting: list[MessageRecords] = []
        self._waiting_bytes = 0

    def add(self, records: MessageRecords) -> Iterator[Messages]:
        """Let records wait; when `BATCH_BYTES` wait, yield all of them as one batch."""
        self._waiting.append(records)
        self._waiting_bytes += records.data.shape[0]
        if self._waiting_bytes >= BATCH_BYTES:
            yield from self.flush()

    def flush(self) -> Iterator[Messages]:
        """Yield all messages that wait, as one batch; afterwards none waits."""
        if not self._waiting:
            return
        views = []
        starts = []
        begin = 0
        for records in self._waiting:
            views.append(records.data)
            starts.append(records.starts + begin)
            begin += records.data.shape[0]
        data = views[0] if len(views) == 1 else np.concatenate(views)
        self._waiting = []
        self._waiting_bytes = 0
        yield _messages_at(data, np.concatenate(starts))


def _messages_at(data: Bytes, starts: Integers) -> Messages:
    """The messages of the records that begin at these places of ``data``.

    Records too short to be a message are only counted.
    """
    size = _MESSAGE_HEADER.itemsize
    with_head = starts[starts + size <= data.shape[0]]
    heads = gather(data, with_head, size).view(_MESSAGE_HEADER)
    is_whole = heads["length"].astype(np.int64) >= MESSAGE_HEAD.size
    head = heads[is_whole]
    return Messages(
        data=data,
        channel=head["channel"].copy(),
        sequence=head["sequence"].copy(),
        log_time=np.minimum(head["log_time"], _LAST_NS).astype(np.int64),
        begin=with_head[is_whole] + size,
        length=head["length"].astype(np.int64) - MESSAGE_HEAD.size,
        too_short=starts.shape[0] - int(np.count_nonzero(is_whole)),
    )
