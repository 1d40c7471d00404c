"""Scanning a telemetry log in stretches: frames checked, wanted payloads kept, the rest counted.

A frame is accepted when its checksum holds. Between accepted frames lie those that cannot be
checked (an id outside the dialect), those whose checksum fails, and bytes of no message. Everything
is done for all frames of a stretch of the file at once.
"""

from collections import Counter
from collections.abc import Mapping, Set
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest.buffers import Bytes, ColumnStore, FileView
from unbend.ingest.damaged_bytes import DamagedBytes
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
STEADY_US = 1_000_000  # a step back of more shows a stray stamp
SILENT_US = 3_000_000  # every component sends a HEARTBEAT each second: three in a row are missing
SEQUENCE = 256  # numbers, then they begin again
_MOST_IDS = 1 << 16  # MAVLink 2 has 24 bits, and no dialect more than this


@dataclass(frozen=True)
class Silence:
    """More than `SILENT_US` without a message of a sender, before the byte ``at``.

    ``backward``: messages missing by a step of the sequence otherwise taken as backward, or 0.
    """

    source: Sender
    at: int
    seconds: float
    backward: int


@dataclass
class RejectedFrames:
    """Frames of one id that are not accepted: how many, the first of them, their bytes."""

    count: int = 0
    first: int = -1
    size: int = 0

    def add(self, place: int, length: int) -> None:
        """Count one more, which comes behind those before."""
        if not self.count:
            self.first = place
        self.count += 1
        self.size += length


@dataclass
class _SequenceState:
    """Where the sequence of a sender stands: its last number and when it was heard [us].

    ``ahead``: how far the highest number so far is ahead of the last: messages may come late.
    """

    last: int
    heard_us: int
    ahead: int = 0


def _row_type(layout: np.dtype[Any]) -> np.dtype[Any]:
    """Rows of a message: the byte and the clock of the ground station, the sender, the fields."""
    packed = np.dtype([(name, layout[name]) for name in layout.names or ()])
    return np.dtype([("at", "i8"), ("host_us", "i8"), ("source", "u2"), ("records", packed)])


class Scan(DamagedBytes):
    """The messages of a telemetry log, and what is damaged or missing.

    ``wanted``: layouts of payloads to keep, by id; ``late`` ones have not the time of sending. An
    id outside the dialect counts where frames fill all between accepted ones.

    ``sent``: the wanted ones, with ``at`` (byte), ``host_us`` (the ground station's clock),
    ``source`` (the number of the sender) and ``records``; ``unknown`` ids (in ``counts``)
    and ``failed`` checksums; ``lost`` by sequence numbers modulo 256; ``steady``: no stamp lies
    more than a second before the one before, as a stray one or the next would.
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
        self._row_types = {number: _row_type(layout) for number, layout in wanted.items()}
        self._late = late
        self._end = 0  # of the last accepted frame
        self._host_us = 0  # its stamp
        self._sequences: dict[int, _SequenceState] = {}
        for begin in range(0, data.size, STRETCH):
            self._scan_stretch(begin, min(begin + STRETCH, data.size))
        if self._end < data.size:
            rest = self._between(self._end, data.size)
            if len(rest):
                self._count_lost(rest)

    def _scan_stretch(self, begin: int, stop: int) -> None:
        """Scan the frames that begin in a stretch."""
        window = self._data.array(begin, stop + LONGEST)
        room = window.shape[0]
        if stop == self._data.size:
            window = _padded(window)
        places = candidates(window, stop - begin)
        places = places[places >= self._end - begin]
        frames = headers(window, places, room)
        frames = frames.take(checksums_hold(window, frames, self._extras))
        frames = _apart(frames)
        self._keep(window, frames, begin)
        if len(frames):
            self._accept(frames.moved(begin))

    def _keep(self, window: Bytes, frames: Frames, begin: int) -> None:
        """Keep the wanted messages of a stretch, and sample the clocks of their senders."""
        timed = []
        for number, layout in self._wanted.items():
            chosen = np.flatnonzero(frames.message_id == number)
            if not chosen.shape[0]:
                continue
            of_type = frames.take(chosen)
            names = layout.names or ()
            payload = payloads(window, of_type, layout)
            rows = np.empty(chosen.shape, self._row_types[number])
            rows["at"] = of_type.at + begin
            rows["host_us"] = of_type.host_us
            rows["source"] = of_type.sender
            for name in names:
                rows["records"][name] = payload[name]
            self.sent.setdefault(number, ColumnStore(rows.dtype)).add(rows)
            if number not in self._late and "time_boot_ms" in names:
                timed.append(rows)
        self.clock.take(timed)

    def _accept(self, frames: Frames) -> None:
        """Count the accepted frames of a stretch, and what lies between them."""
        last_us = self._host_us or int(frames.host_us[0])
        step_us = np.diff(frames.host_us, prepend=last_us)
        self.steady &= bool(np.all(step_us >= -STEADY_US))
        self._host_us = int(frames.host_us[-1])
        end_before = np.concatenate([[self._end], frames.end[:-1]])
        between = []
        for row in np.flatnonzero(end_before != frames.at).tolist():
            frames_between = self._between(int(end_before[row]), int(frames.at[row]))
            if len(frames_between):
                between.append(frames_between)
        self._count_lost(joined([frames, *between]) if between else frames)
        self._end = int(frames.end[-1])
        counts = np.bincount(frames.message_id[frames.message_id < _MOST_IDS])
        for number in np.flatnonzero(counts).tolist():
            self.counts[number] += int(counts[number])

    def _between(self, begin: int, stop: int) -> Frames:
        """Count the bytes between two accepted frames; returns the frames among them."""
        places, end = self._frames_in_a_row(begin, stop)
        cut = 0
        if end < stop:
            if self._ends_in_frame(end, stop, places):
                cut = stop - end
            elif places:
                end = places.pop()  # its length may be damaged
        self.cut_bytes += cut
        if end + cut < stop:
            self.drop(end, stop)
        window = _padded(self._data.array(begin, end))
        frames = headers(window, np.array(places, np.int64) - begin, end - begin).moved(begin)
        self._count_rejected(frames)
        return frames

    def _frames_in_a_row(self, begin: int, stop: int) -> tuple[list[int], int]:
        """The places of frames that follow each other from a byte, and where the last ends."""
        places: list[int] = []
        place = begin
        view = b""
        view_begin = begin
        while place < stop:
            view_end = view_begin + len(view)
            if place + LONGEST > view_end and view_end < stop:
                view_begin = place
                view = self._data[place : min(place + STRETCH, stop)]
            length = frame_length(view, place - view_begin)
            if not length or place + length > stop:
                break
            places.append(place)
            place += length
        return places, place

    def _ends_in_frame(self, at: int, stop: int, places: list[int]) -> bool:
        """Whether the file ends in a frame that begins here, behind frames at ``places``."""
        if stop != self._data.size:
            return False
        rest = self._data[at : at + LONGEST]
        if stop - at >= SHORTEST and frame_length(rest, 0) <= len(rest):
            return False
        if not places:
            return True
        # not behind a frame whose checksum fails
        head = _padded(self._data.array(places[-1], places[-1] + HEAD))
        last = headers(head, np.zeros(1, np.int64), LONGEST)
        return int(last.message_id[0]) not in self._extras

    def _count_rejected(self, frames: Frames) -> None:
        """Count frames of unknown ids, and those whose checksum fails."""
        columns = (frames.message_id.tolist(), frames.at.tolist(), frames.total.tolist())
        for number, place, length in zip(*columns, strict=True):
            if number in self._extras:
                rejected = self.failed.setdefault(number, RejectedFrames())
            else:
                rejected = self.unknown.setdefault(number, RejectedFrames())
                self.counts[number] += 1
            rejected.add(place, length)

    def _count_lost(self, frames: Frames) -> None:
        """Messages missing by the numbers of each sender; the upper half of steps is backward."""
        numbers = frames.sender
        order = np.argsort(numbers, kind="stable")
        starts = np.flatnonzero(np.diff(numbers[order].astype(np.int32), prepend=-1)).tolist()
        for begin, end in pairwise([*starts, order.shape[0]]):
            rows = order[begin:end]
            self._count_lost_of_sender(
                int(numbers[rows[0]]), frames.sequence[rows], frames.host_us[rows], frames.at[rows]
            )

    def _count_lost_of_sender(
        self, number: int, sequence: NDArray[np.uint8], host_us: Integers, at: Integers
    ) -> None:
        """Count what is missing between the next messages of a sender; what is late fills its gap.

        A silence counts unless few stamps beside it are stray.
        """
        sender = Sender.of_number(number)
        state = self._sequences.get(number)
        if state is None:
            state = _SequenceState(last=(int(sequence[0]) - 1) % SEQUENCE, heard_us=int(host_us[0]))
        skipped = np.diff(sequence, prepend=np.uint8(state.last)) - np.uint8(1)  # modulo 256
        silent = np.diff(host_us, prepend=state.heard_us) > SILENT_US
        for row in np.flatnonzero(silent).tolist():
            silent_us = _silent_us(host_us, row, state.heard_us)
            if silent_us > SILENT_US:
                is_backward = skipped[row] >= SEQUENCE // 2
                backward = int(skipped[row]) if is_backward else 0
                self.silences.append(Silence(sender, int(at[row]), silent_us / 1e6, backward))
        # how far each message is from the last of those before
        step = skipped.view(np.int8).astype(np.int64) + 1
        step[(step < 0) & silent] = 1  # after seconds of silence no message overtakes another
        place = np.cumsum(step)
        new = np.unique(place[place > state.ahead])
        lost = 0
        if new.size:
            lost = int(new[-1]) - state.ahead - new.shape[0]
        self.lost[sender] += lost
        self._sequences[number] = _SequenceState(
            last=int(sequence[-1]),
            heard_us=int(host_us[-1]),
            ahead=max(state.ahead, int(place.max())) - int(place[-1]),
        )


def _silent_us(host_us: Integers, row: int, heard_us: int) -> int:
    """The time before a message without another of its sender, by the stamps on both sides.

    Of those the nearest count, as single ones may be stray; ``heard_us``: the last one before all.
    """
    before_us = host_us[max(row - STRAY_ROWS - 1, 0) : row].max(initial=heard_us)
    after_us = host_us[row : row + STRAY_ROWS + 1].min()
    return int(after_us) - int(before_us)


def _apart(frames: Frames) -> Frames:
    """The frames without those that begin inside the one before, as where a payload holds a log."""
    if bool(np.all(frames.at[1:] >= frames.end[:-1])):
        return frames
    rows = []
    end_before = 0
    for row, (begin, end) in enumerate(zip(frames.at.tolist(), frames.end.tolist(), strict=True)):
        if begin >= end_before:
            rows.append(row)
            end_before = end
    return frames.take(np.array(rows, np.intp))


def _padded(window: Bytes) -> Bytes:
    """The bytes and behind them zeros, as many as a header may extend beyond the end."""
    return np.concatenate([window, np.zeros(HEAD, np.uint8)])
