"""Scanning a telemetry log in stretches: frames checked, wanted payloads kept, the rest counted.

A frame is accepted when its checksum is right. Between accepted frames there are frames that cannot
be checked (an id outside the dialect), frames with a wrong checksum, and bytes of no message. All
frames of a stretch of the file are scanned at once.
"""

from collections import Counter
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest.buffers import Bytes, ColumnStore, FileView
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.message_tables import rows_by_value
from unbend.ingest.tlog.clock_samples import Sampler
from unbend.ingest.tlog.frames import (
    HEAD,
    LONGEST,
    SHORTEST,
    Frames,
    candidates,
    checksums_hold,
    frame_length,
    frames_at,
    joined,
    payloads,
)
from unbend.ingest.tlog.senders import Sender
from unbend.units import Integers

STRETCH = 2 << 20  # [bytes] scanned at once: the tables of its frames fit the cache
STEADY_US = 1_000_000  # stamps that step back by more show that one of them is stray
SILENT_US = 3_000_000  # every component sends a HEARTBEAT each second: three in a row are missing
SEQUENCE = 256  # sequence numbers count modulo this
_MOST_IDS = 1 << 16  # MAVLink 2 has 24 bits, and no dialect more than this


@dataclass(frozen=True)
class Silence:
    """More than `SILENT_US` without a message of a sender, before the byte ``place``.

    ``backward``: how many messages are missing by a step of the sequence that would be one backward
    without the silence (more than half of `SEQUENCE`); 0 for another step.
    """

    source: Sender
    place: int
    seconds: float
    backward: int


@dataclass
class RejectedFrames:
    """Frames of one message id that are not accepted.

    count, size : how many there are, and how many bytes they have together.
    first : the place in the file of the first of them, -1 without any.
    """

    count: int = 0
    first: int = -1
    size: int = 0

    def add(self, place: int, length: int) -> None:
        """Count one more frame, at a place behind those counted before."""
        if not self.count:
            self.first = place
        self.count += 1
        self.size += length


@dataclass
class _SequenceState:
    """The state of a sender's sequence after some of its messages.

    last, heard_us : the sequence number and the stamp [us] of the last message.
    ahead : the highest number so far minus that of the last message; 0 unless the last came late.
    """

    last: int
    heard_us: int
    ahead: int = 0


class _SenderMessages(NamedTuple):
    """Some messages of one sender, (n,) in the order of the file; the columns are of `Frames`."""

    sequence: NDArray[np.uint8]
    host_us: Integers
    place: Integers


def _row_type(layout: np.dtype[Any]) -> np.dtype[Any]:
    """The numpy type of the rows of a message in `Scan.sent`; ``layout``: of its wanted fields."""
    names = layout.names or ()
    packed = np.dtype([(name, layout[name]) for name in names])
    return np.dtype(
        [
            ("place", "i8"),
            ("host_us", "i8"),
            ("source", "u2"),
            ("records", packed),
        ]
    )


class Scan(DamagedBytes):
    """The messages of a telemetry log, which is scanned when the object is made, and its damage.

    crc_extra_of_id : the CRC_EXTRA of each id of the dialect.
    wanted : layouts of the payloads to keep, by id.
    exposure_ids : ids of wanted messages with the time of an exposure, not that of sending.

    counts : how many messages of each id there are; those of an id outside the dialect count if
        frames fill all the bytes between accepted ones.
    sent : the rows of the wanted messages by id: ``place`` (byte), ``host_us`` (the ground
        station's clock), ``source`` (the number of the sender) and ``records``.
    unknown, failed : frames of ids outside the dialect, and frames with a wrong checksum, by id.
    lost : how many messages of each sender are missing, by its sequence numbers.
    steady : False if a stamp is more than a second before the stamp of the previous message: one
        of them is stray.
    """

    def __init__(
        self,
        data: FileView,
        crc_extra_of_id: Mapping[int, int],
        wanted: Mapping[int, np.dtype[Any]],
        exposure_ids: Set[int] = frozenset(),
    ) -> None:
        super().__init__()
        self.counts: Counter[int] = Counter()
        self.sent: dict[int, ColumnStore] = {}
        self.clock = Sampler()
        self.unknown: dict[int, RejectedFrames] = {}
        self.failed: dict[int, RejectedFrames] = {}
        self.lost: Counter[Sender] = Counter()
        self.silences: list[Silence] = []
        self.steady = True
        self._data = data
        self._crc_extra_of_id = crc_extra_of_id
        self._wanted = wanted
        self._exposure_ids = exposure_ids
        self._row_types: dict[int, np.dtype[Any]] = {}
        for number, layout in wanted.items():
            self._row_types[number] = _row_type(layout)
        self._end = 0  # the place behind the last accepted frame
        self._host_us = 0  # its stamp; 0 before the first
        self._sequences: dict[int, _SequenceState] = {}
        for begin in range(0, data.size, STRETCH):
            stop = min(begin + STRETCH, data.size)
            self._scan_stretch(begin, stop)
        if self._end < data.size:
            places = self._examine_gap(self._end, data.size)
            if places:
                self._count_lost(self._rejected_at(places, data.size))

    def _scan_stretch(self, begin: int, stop: int) -> None:
        """Scan the frames that begin in the bytes from ``begin`` to ``stop`` of the file.

        Frames that begin inside the last accepted frame are left out.
        """
        window = self._data.array(begin, stop + LONGEST)
        room = window.shape[0]  # no frame ends beyond it, in the padding
        if begin + room == self._data.size:  # a header may extend beyond the end of the file
            window = _padded(window)
        places = candidates(window, stop - begin)
        places_behind = places[places >= self._end - begin]
        frames = frames_at(window, places_behind, room)
        whole_frames = frames.take(checksums_hold(window, frames, self._crc_extra_of_id))
        accepted = _without_nested(whole_frames)
        self._keep(window, accepted, begin)
        if len(accepted):
            self._accept(accepted.moved(begin))

    def _keep(self, window: Bytes, frames: Frames, begin: int) -> None:
        """Keep the wanted messages of a stretch, and sample the clocks of their senders.

        Clocks are sampled from messages with the time since boot at which they were sent.
        ``begin``: where the window begins in the file.
        """
        timed = []
        for number, layout in self._wanted.items():
            chosen = np.flatnonzero(frames.message_id == number)
            if not chosen.shape[0]:
                continue
            of_type = frames.take(chosen)
            names = layout.names or ()
            payload = payloads(window, of_type, layout)
            rows = np.empty(chosen.shape, self._row_types[number])
            rows["place"] = of_type.place + begin
            rows["host_us"] = of_type.host_us
            rows["source"] = of_type.sender
            for name in names:
                rows["records"][name] = payload[name]
            if number not in self.sent:
                self.sent[number] = ColumnStore(rows.dtype)
            self.sent[number].add(rows)
            if number not in self._exposure_ids and "time_boot_ms" in names:
                timed.append(rows)
        self.clock.take(timed)

    def _accept(self, frames: Frames) -> None:
        """Count the accepted frames of a stretch, and examine the bytes before each of them.

        Frames between these that are not accepted count as received for the sequence numbers.
        """
        self._check_stamps(frames)
        rejected = self._rejected_between(frames)
        sent = frames if rejected is None else joined([frames, rejected])
        self._count_lost(sent)
        self._end = int(frames.end[-1])  # only now: the first gap begins at the end before
        usual_ids = frames.message_id[frames.message_id < _MOST_IDS]
        counts = np.bincount(usual_ids)
        for number in np.flatnonzero(counts).tolist():
            self.counts[number] += int(counts[number])

    def _check_stamps(self, frames: Frames) -> None:
        """Set ``steady`` to False if the stamps step back by more than `STEADY_US`."""
        last_us = self._host_us or int(frames.host_us[0])
        step_us = np.diff(frames.host_us, prepend=last_us)
        self.steady &= bool(np.all(step_us >= -STEADY_US))
        self._host_us = int(frames.host_us[-1])

    def _rejected_between(self, frames: Frames) -> Frames | None:
        """Examine the gaps before accepted frames; returns the frames in them, None without any."""
        places: list[int] = []
        previous_end = np.concatenate([[self._end], frames.end[:-1]])
        has_gap_before = previous_end != frames.place
        for row in np.flatnonzero(has_gap_before).tolist():
            begin = int(previous_end[row])
            stop = int(frames.place[row])
            places += self._examine_gap(begin, stop)
        if not places:
            return None
        return self._rejected_at(places, int(frames.place[-1]))

    def _rejected_at(self, places: list[int], stop: int) -> Frames:
        """Read the frames at these places, all before ``stop``, and count them as rejected."""
        begin = places[0]
        window = self._data.array(begin, stop)
        offsets = np.array(places, np.int64) - begin
        frames = frames_at(_padded(window), offsets, window.shape[0])
        frames = frames.moved(begin)
        self._count_rejected(frames)
        return frames

    def _examine_gap(self, begin: int, stop: int) -> list[int]:
        """Count the bytes from ``begin`` to ``stop``, between two accepted frames.

        They may begin with frames that are not accepted, one behind the other. The places of these
        are returned: their content is not used, but they are not lost. What follows is a frame
        that the end of the file cuts off, or bytes of no message.
        """
        if self.is_hopeless(self._data.size):  # bytes between good frames are not searched
            self.drop(begin, stop)
            return []
        places, end = self._frames_in_a_row(begin, stop)
        if end < stop and self._ends_in_frame(end, stop, places):
            self.cut_bytes += stop - end
        elif end < stop:
            if places:
                # The length of the last frame may be damaged: it counts as bytes of no message.
                end = places.pop()
            self.drop_searched(end, stop)
        return places

    def _frames_in_a_row(self, begin: int, stop: int) -> tuple[list[int], int]:
        """The places of the frames that follow each other from ``begin`` on, and the last's end.

        They are recognized by stamps, magic bytes and lengths, without a checksum.
        """
        places: list[int] = []
        place = begin
        view = b""
        view_begin = begin
        while place < stop:
            view_end = view_begin + len(view)
            needs_next_view = place + LONGEST > view_end and view_end < stop
            if needs_next_view:  # True at the first place, where the view is empty
                view_begin = place
                view = self._data[place : min(place + STRETCH, stop)]
            length = frame_length(view, place - view_begin)
            if not length or place + length > stop:
                break
            places.append(place)
            place += length
        return places, place

    def _ends_in_frame(self, begin: int, stop: int, places: list[int]) -> bool:
        """Whether the end of the file cuts off a frame that begins at ``begin``.

        That is so if fewer bytes are left than any frame has, or fewer than the header states.
        ``places``: of the rejected frames before it; False if the last of them is of the dialect,
        because its checksum has failed and its length may be wrong.
        """
        if stop != self._data.size:
            return False
        last_bytes = self._data[begin : begin + LONGEST]  # as far as the file has them
        has_no_room = stop - begin < SHORTEST
        stated_length = frame_length(last_bytes, 0)  # 0 where no frame begins
        if not has_no_room and stated_length <= len(last_bytes):
            return False
        if not places:
            return True
        place = places[-1]
        head = _padded(self._data.array(place, place + HEAD))
        last = frames_at(head, np.zeros(1, np.int64), LONGEST)
        message_id = int(last.message_id[0])
        return message_id not in self._crc_extra_of_id

    def _count_rejected(self, frames: Frames) -> None:
        """Count rejected frames: in ``failed`` those of the dialect, in ``unknown`` all others."""
        message_ids = frames.message_id.tolist()
        places = frames.place.tolist()
        columns = (message_ids, places, frames.total.tolist())
        for number, place, length in zip(*columns, strict=True):
            if number in self._crc_extra_of_id:
                rejected = self.failed.setdefault(number, RejectedFrames())
            else:
                rejected = self.unknown.setdefault(number, RejectedFrames())
                self.counts[number] += 1
            rejected.add(place, length)

    def _count_lost(self, frames: Frames) -> None:
        """Count the sequence numbers of each sender that are missing in the next frames."""
        for number, rows in rows_by_value(frames.sender):
            sent = _SenderMessages(
                sequence=frames.sequence[rows],
                host_us=frames.host_us[rows],
                place=frames.place[rows],
            )
            self._count_lost_of_sender(number, sent)

    def _count_lost_of_sender(self, number: int, sent: _SenderMessages) -> None:
        """Count the numbers that are missing in the next messages of a sender, and its silences.

        ``number``: of the sender (`Sender.number`). The sequence counts modulo 256. A step of more
        than half of that is backward, to a message that later messages have overtaken, and skips
        none. After a gap in the stamps no step is backward.
        """
        sender = Sender.of_number(number)
        state = self._sequences.get(number)
        if state is None:  # nothing is missing before the first message
            first_number = int(sent.sequence[0])
            state = _SequenceState(
                last=(first_number - 1) % SEQUENCE,
                heard_us=int(sent.host_us[0]),
            )
        number_step = np.diff(sent.sequence, prepend=np.uint8(state.last))  # modulo 256
        skipped = number_step - np.uint8(1)  # numbers between two messages, modulo 256
        is_after_gap = np.diff(sent.host_us, prepend=state.heard_us) > SILENT_US
        for row in np.flatnonzero(is_after_gap).tolist():
            self._add_silence(sender, sent, row, int(skipped[row]), state.heard_us)
        step = skipped.view(np.int8).astype(np.int64) + 1  # as int8, more than half is negative
        step[(step < 0) & is_after_gap] = 1  # `Silence.backward` has the numbers that it skips
        # The number of each message, not modulo 256; 0 is that of the last message before these.
        position = np.cumsum(step)
        new_positions = np.unique(position[position > state.ahead])
        lost = 0
        if new_positions.size:
            lost = int(new_positions[-1]) - state.ahead - new_positions.shape[0]
        self.lost[sender] += lost
        highest = max(state.ahead, int(position.max()))
        self._sequences[number] = _SequenceState(
            last=int(sent.sequence[-1]),
            heard_us=int(sent.host_us[-1]),
            ahead=highest - int(position[-1]),
        )

    def _add_silence(
        self,
        sender: Sender,
        sent: _SenderMessages,
        row: int,
        skipped: int,
        heard_us: int,
    ) -> None:
        """Add the silence before the message in a row of ``sent``, if no stray stamp explains it.

        ``skipped``: how many numbers are between that message and the message before, modulo 256.
        ``heard_us``: the stamp [us] of the sender's last message before all of ``sent``.
        """
        silent_us = _silent_us(sent.host_us, row, heard_us)
        if silent_us <= SILENT_US:
            return
        is_backward = skipped >= SEQUENCE // 2
        backward = skipped if is_backward else 0
        silence = Silence(
            source=sender,
            place=int(sent.place[row]),
            seconds=silent_us / 1e6,
            backward=backward,
        )
        self.silences.append(silence)


def _silent_us(host_us: Integers, row: int, heard_us: int) -> int:
    """How long a sender was silent before the message in a row [us].

    From the latest of a few stamps before that message to the earliest of a few stamps from the
    message on, because single stamps may be stray. ``host_us``: (n,) stamps [us]. ``heard_us``: the
    stamp before all of these.
    """
    first = max(row - STRAY_ROWS - 1, 0)
    before_us = host_us[first:row].max(initial=heard_us)
    after_us = host_us[row : row + STRAY_ROWS + 1].min()
    return int(after_us) - int(before_us)


def _without_nested(frames: Frames) -> Frames:
    """The frames without those that begin inside another frame, with a log as payload."""
    ends = frames.end
    are_apart = bool(np.all(frames.place[1:] >= ends[:-1]))
    if are_apart:
        return frames
    rows = []
    end_before = 0
    begin_and_end = zip(frames.place.tolist(), ends.tolist(), strict=True)
    for row, (begin, end) in enumerate(begin_and_end):
        if begin >= end_before:
            rows.append(row)
            end_before = end
    return frames.take(np.array(rows, np.intp))


def _padded(window: Bytes) -> Bytes:
    """The bytes, followed by `HEAD` zeros: a header may extend beyond the end."""
    zeros = np.zeros(HEAD, np.uint8)
    return np.concatenate([window, zeros])
