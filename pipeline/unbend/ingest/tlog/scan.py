"""Scanning a telemetry log in stretches: frames checked, wanted payloads kept, the rest counted.

A frame is accepted when its checksum holds. Between accepted frames lie those that cannot be
checked (an id outside the dialect), those whose checksum fails, and bytes of no message. Everything
is done for all frames of a stretch of the file at once.
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
    headers,
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
    """Frames of one id that are not accepted.

    count, size : how many there are, and their bytes together.
    first : the place of the first of them, -1 without any.
    """

    count: int = 0
    first: int = -1
    size: int = 0

    def add(self, place: int, length: int) -> None:
        """Count one more frame, which lies behind those counted before."""
        if not self.count:
            self.first = place
        self.count += 1
        self.size += length


@dataclass
class _SequenceState:
    """Where the sequence of a sender stands after some messages.

    last, heard_us : the number and the stamp [us] of the last message.
    ahead : by how much the highest number so far is ahead of the last one, which may come late.
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
    """Rows of a message: the byte and the clock of the ground station, the sender, the fields."""
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

    extras : the CRC_EXTRA of each id of the dialect.
    wanted : layouts of the payloads to keep, by id.
    late : ids of wanted messages whose time since boot is not that of sending.

    counts : how many messages of each id there are; those of an id outside the dialect count if
        frames fill all the bytes between accepted ones.
    sent : the rows of the wanted messages by id: ``place`` (byte), ``host_us`` (the ground
        station's clock), ``source`` (the number of the sender) and ``records``.
    unknown, failed : frames outside the dialect, and those whose checksum fails, by id.
    lost : missing messages of each sender, by its sequence numbers.
    steady : whether no stamp lies more than a second before the stamp before it, as a stray stamp
        would, or the one that follows a stray stamp.
    """

    def __init__(
        self,
        data: FileView,
        extras: Mapping[int, int],
        wanted: Mapping[int, np.dtype[Any]],
        late: Set[int] = frozenset(),
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
        self._extras = extras
        self._wanted = wanted
        self._late = late
        self._row_types: dict[int, np.dtype[Any]] = {}
        for number, layout in wanted.items():
            self._row_types[number] = _row_type(layout)
        self._end = 0  # of the last accepted frame
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
        """Scan the frames that begin in a stretch, behind the last accepted frame."""
        window = self._data.array(begin, stop + LONGEST)
        room = window.shape[0]  # the padding is no room for frames
        if begin + room == self._data.size:  # a header may extend beyond the end of the file
            window = _padded(window)
        places = candidates(window, stop - begin)
        places_behind = places[places >= self._end - begin]
        frames = headers(window, places_behind, room)
        whole_frames = frames.take(checksums_hold(window, frames, self._extras))
        accepted = _apart(whole_frames)
        self._keep(window, accepted, begin)
        if len(accepted):
            self._accept(accepted.moved(begin))

    def _keep(self, window: Bytes, frames: Frames, begin: int) -> None:
        """Keep the wanted messages of a stretch, and sample the clocks of their senders.

        Clocks are sampled from messages with the time since boot at which they were sent.
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
            if number not in self._late and "time_boot_ms" in names:
                timed.append(rows)
        self.clock.take(timed)

    def _accept(self, frames: Frames) -> None:
        """Count the accepted frames of a stretch, and examine the bytes before each of them.

        The messages of other frames between these are not lost, though they are not accepted.
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
        """Examine the gaps before accepted frames; returns the frames in them, if there are any."""
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
        """The frames at these places, which end before ``stop``; they are counted as rejected."""
        begin = places[0]
        window = self._data.array(begin, stop)
        offsets = np.array(places, np.int64) - begin
        frames = headers(_padded(window), offsets, window.shape[0])
        frames = frames.moved(begin)
        self._count_rejected(frames)
        return frames

    def _examine_gap(self, begin: int, stop: int) -> list[int]:
        """Count the bytes from ``begin`` to ``stop``, which lie between two accepted frames.

        From the begin on they may be frames that are not accepted, one behind the other; the places
        of these are returned, because their messages are not lost, though their content is not
        used. What follows is a frame that the end of the file cuts off, or bytes of no message.
        """
        if self.is_hopeless(self._data.size):  # what lies between good frames is not searched
            self.drop(begin, stop)
            return []
        places, end = self._frames_in_a_row(begin, stop)
        if end < stop and self._ends_in_frame(end, stop, places):
            self.cut_bytes += stop - end
        elif end < stop:
            if places:
                # The length of the last frame may be damaged: it counts to the bytes of no message.
                end = places.pop()
            self.drop_searched(end, stop)
        return places

    def _frames_in_a_row(self, begin: int, stop: int) -> tuple[list[int], int]:
        """The places of frames that follow each other from a byte, and where the last ends.

        Their checksums do not count here: only stamps, magic bytes and lengths.
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
        """Whether the file ends within a frame that begins at a byte, behind frames at ``places``.

        The file does if fewer bytes are left than any frame has, or fewer than the header says.
        False behind a frame of the dialect, whose checksum has failed.
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
        # The frame before is not accepted. If it is of the dialect, its checksum has failed, and
        # its length may be wrong.
        place = places[-1]
        head = _padded(self._data.array(place, place + HEAD))
        last = headers(head, np.zeros(1, np.int64), LONGEST)
        message_id = int(last.message_id[0])
        return message_id not in self._extras

    def _count_rejected(self, frames: Frames) -> None:
        """Count frames that are not accepted: of an unknown id, or else with a failed checksum."""
        message_ids = frames.message_id.tolist()
        places = frames.place.tolist()
        columns = (message_ids, places, frames.total.tolist())
        for number, place, length in zip(*columns, strict=True):
            if number in self._extras:
                rejected = self.failed.setdefault(number, RejectedFrames())
            else:
                rejected = self.unknown.setdefault(number, RejectedFrames())
                self.counts[number] += 1
            rejected.add(place, length)

    def _count_lost(self, frames: Frames) -> None:
        """Count the messages that each sender numbered, but that are not among these frames."""
        for number, rows in rows_by_value(frames.sender):
            sent = _SenderMessages(
                sequence=frames.sequence[rows],
                host_us=frames.host_us[rows],
                place=frames.place[rows],
            )
            self._count_lost_of_sender(number, sent)

    def _count_lost_of_sender(self, number: int, sent: _SenderMessages) -> None:
        """Count the numbers that are missing in the next messages of a sender, and its silences.

        The sequence counts modulo 256. A step of more than half of that is one backward, to a
        message that later ones have overtaken and that therefore is not missing. After a gap in the
        stamps no step is backward.
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
        skipped = number_step - np.uint8(1)
        is_after_gap = np.diff(sent.host_us, prepend=state.heard_us) > SILENT_US
        for row in np.flatnonzero(is_after_gap).tolist():
            self._add_silence(sender, sent, row, int(skipped[row]), state.heard_us)
        step = skipped.view(np.int8).astype(np.int64) + 1  # as int8, more than half is negative
        step[(step < 0) & is_after_gap] = 1  # what it skips is in ``backward`` of the silence
        # The number of each message, counted on beyond 256 from 0 at the last message before these.
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
        """Add the silence before the message in a row, if it is one: a stray stamp is none.

        ``skipped``: the numbers between that message and the one before. ``heard_us``: the stamp of
        the sender before all these messages.
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
    message on, because single stamps may be stray. ``heard_us``: the stamp before all rows.
    """
    first = max(row - STRAY_ROWS - 1, 0)
    before_us = host_us[first:row].max(initial=heard_us)
    after_us = host_us[row : row + STRAY_ROWS + 1].min()
    return int(after_us) - int(before_us)


def _apart(frames: Frames) -> Frames:
    """The frames without those that begin inside another frame: its payload may hold a log."""
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
