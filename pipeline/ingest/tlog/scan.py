"""Scanning a telemetry log: every frame checked, the wanted payloads kept, the rest counted.

The file is walked in stretches, so what is kept is all that a large log costs. A frame is believed
when its checksum holds; what lies between believed frames is either frames that cannot be proven
(an id outside the dialect) or are disproved (a checksum that fails), or bytes of no message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.clock import STRAY_ROWS
from pipeline.ingest.buffers import Bytes, ColumnStore, FileView
from pipeline.ingest.tlog.clock_readings import Key, Sampler
from pipeline.ingest.tlog.frames import (
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

STRETCH = 2 << 20  # [bytes] scanned at once: the tables of its frames fit the cache
STEADY_US = 1_000_000
SILENT_US = 3_000_000  # every component sends a HEARTBEAT each second: three in a row are missing


@dataclass(frozen=True)
class Silence:
    """A stretch of more than `SILENT_US` without any message of a sender.

    ``at`` the byte after it, ``seconds`` by the ground station's clock; ``backward`` the messages
    missing by a step of the sequence that is otherwise taken as backward, or 0.
    """

    source: Key
    at: int
    seconds: float
    backward: int


@dataclass
class Suspects:
    """Frames of one id that are not believed: how many, the first of them, their bytes."""

    count: int = 0
    first: int = -1
    size: int = 0


@dataclass
class Scan:
    """What a log holds.

    ``counts`` of messages by id; ``sent`` the wanted ones in the order of the file, with ``at``
    (byte offset), ``host_us`` (the ground station's clock), ``source`` (system times 256 plus
    component) and ``records`` (the payload); ``clock`` what the senders' clocks showed; ``unknown``
    ids that cannot be checked (they are in ``counts``), ``failed`` checksums; ``bad_bytes`` lie
    outside all frames, the first at ``first_bad``; ``cut_bytes`` are a last frame that the end of
    the file cuts off; ``lost`` by the sequence numbers of each (system, component), which count
    modulo 256; ``silences`` of senders; ``steady`` whether no stamp of the ground station lies more
    than a second before the one before: a stray one has one or follows one.
    """

    counts: Counter[int] = field(default_factory=Counter)
    sent: dict[int, ColumnStore] = field(default_factory=dict)
    clock: Sampler = field(default_factory=Sampler)
    unknown: dict[int, Suspects] = field(default_factory=dict)
    failed: dict[int, Suspects] = field(default_factory=dict)
    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0
    lost: Counter[Key] = field(default_factory=Counter)
    silences: list[Silence] = field(default_factory=list)
    steady: bool = True


def scan(
    data: FileView,
    extras: Mapping[int, int],
    wanted: Mapping[int, np.dtype[Any]],
    late: Set[int] = frozenset(),
    stretch: int = STRETCH,
) -> Scan:
    """Find every frame of a telemetry log and keep the payloads of some.

    Parameters
    ----------
    data : the file.
    extras : CRC_EXTRA by message id, from the dialect.
    wanted : the layout of the payloads to keep, by message id.
    late : those of them whose time is not when they were sent, as of exposures.
    stretch : [bytes] scanned at once.

    An id outside the dialect counts as a message where frames stand wall to wall from a frame
    that holds to the next; CRC-16/MCRF4XX as the MAVLink library computes it.
    """
    walk = _Walk(data, extras, wanted, late)
    for begin in range(0, data.size, stretch):
        walk.take(begin, min(begin + stretch, data.size))
    walk.finish()
    return walk.found


class _Walk:
    """The state between two stretches: where the last believed frame ended, and what was found."""

    def __init__(
        self,
        data: FileView,
        extras: Mapping[int, int],
        wanted: Mapping[int, np.dtype[Any]],
        late: Set[int],
    ) -> None:
        self.data = data
        self.extras = extras
        self.wanted = wanted
        self.kept = {number: _row_of(dtype) for number, dtype in wanted.items()}
        self.late = late
        self.end = 0
        self.host_us = 0
        self.found = Scan()
        self.sequences: dict[int, int] = {}
        self.heard_us: dict[int, int] = {}

    def take(self, begin: int, stop: int) -> None:
        """Scan the frames that begin in a stretch."""
        window = self.data.array(begin, stop + LONGEST)
        room = window.shape[0]
        if stop == self.data.size:
            window = _padded(window)
        places = candidates(window, stop - begin)
        frames = headers(window, places[places >= self.end - begin], room)
        frames = frames.take(checksums_hold(window, frames, self.extras))
        frames = _apart(frames)
        self._keep(window, frames, begin)
        frames = frames.moved(begin)
        if len(frames):
            step = np.diff(frames.host_us, prepend=self.host_us or int(frames.host_us[0]))
            self.found.steady &= bool(np.all(step >= -STEADY_US))
            self.host_us = int(frames.host_us[-1])
            between = self._between(frames)
            self._count_lost(joined([frames, *between]) if between else frames)
            self.end = int(frames.end[-1])
        small = frames.message_id[frames.message_id < 1 << 16]
        tally = np.bincount(small)
        for number in np.flatnonzero(tally).tolist():
            self.found.counts[number] += int(tally[number])

    def _keep(self, window: Bytes, frames: Frames, begin: int) -> None:
        timed = []
        for number, dtype in self.wanted.items():
            chosen = np.flatnonzero(frames.message_id == number)
            if chosen.shape[0]:
                mine = frames.take(chosen)
                payload = payloads(window, mine, dtype)
                rows = np.empty(chosen.shape, self.kept[number])
                rows["at"], rows["host_us"] = mine.at + begin, mine.host_us
                rows["source"] = _source_of(mine)
                for name in dtype.names or ():
                    rows["records"][name] = payload[name]
                self.found.sent.setdefault(number, ColumnStore(rows.dtype)).add(rows)
                if number not in self.late and "time_boot_ms" in (dtype.names or ()):
                    timed.append(rows)
        self.found.clock.take(timed)

    def _between(self, frames: Frames) -> list[Frames]:
        """The frames that are not believed, between those that are."""
        begin = np.concatenate([[self.end], frames.end[:-1]])
        gaps = np.flatnonzero(begin != frames.at)
        found = [self._fill(int(begin[k]), int(frames.at[k])) for k in gaps]
        return [part for part in found if len(part)]

    def finish(self) -> None:
        """Scan what follows the last believed frame."""
        if self.end < self.data.size:
            rest = self._fill(self.end, self.data.size)
            if len(rest):
                self._count_lost(rest)

    def _fill(self, begin: int, stop: int) -> Frames:
        """Count what lies between two believed frames; the frames among it."""
        places, at = _chain(self.data, begin, stop)
        cut = 0
        if at < stop:
            disproved = bool(places) and self._number(places[-1]) in self.extras
            if stop == self.data.size and not disproved and _is_cut(self.data, at):
                cut = stop - at
            elif places:
                at = places.pop()  # its length may be what is damaged
        self.found.cut_bytes += cut
        if at + cut < stop:
            self.found.bad_bytes += stop - at
            self.found.first_bad = at if self.found.first_bad < 0 else self.found.first_bad
        window = _padded(self.data.array(begin, at))
        frames = headers(window, np.array(places, np.int64) - begin, at - begin).moved(begin)
        self._suspect(frames)
        return frames

    def _number(self, at: int) -> int:
        head = _padded(self.data.array(at, at + HEAD))
        return int(headers(head, np.zeros(1, np.int64), LONGEST).message_id[0])

    def _suspect(self, frames: Frames) -> None:
        columns = (frames.message_id, frames.at, frames.total)
        for number, at, total in zip(*(column.tolist() for column in columns), strict=True):
            known = number in self.extras
            found = (self.found.failed if known else self.found.unknown).setdefault(
                number, Suspects()
            )
            found.count += 1
            found.size += total
            found.first = at if found.first < 0 else found.first
            self.found.counts[number] += 0 if known else 1

    def _count_lost(self, frames: Frames) -> None:
        """Messages missing by the sequence numbers of each sender.

        A step back or a repeat (a second link, a reordering, a restart) is no loss: of the 256
        possible steps the upper half is taken as backward.
        """
        source = _source_of(frames)
        order = np.argsort(source, kind="stable")
        sequence, host_us = frames.sequence[order], frames.host_us[order]
        begin = np.flatnonzero(np.diff(source[order].astype(np.int32), prepend=-1)).tolist()
        for first, stop in zip(begin, [*begin[1:], order.shape[0]], strict=True):
            key = int(source[order[first]])
            mine = sequence[first:stop]
            before = np.uint8(self.sequences.get(key, (int(mine[0]) - 1) % 256))
            step = np.diff(mine, prepend=before) - np.uint8(1)
            self.sequences[key] = int(mine[-1])
            lost = int(step[step < 128].sum(dtype=np.int64))
            self.found.lost[divmod(key, 256)] += lost
            host = host_us[first:stop]
            steps = np.diff(host, prepend=self.heard_us.get(key, int(host[0])))
            for row in np.flatnonzero(steps > SILENT_US).tolist():
                self._enter_silence(key, host, row, int(frames.at[order[first + row]]), step[row])
            self.heard_us[key] = int(host[-1])

    def _enter_silence(
        self, key: int, host_us: NDArray[np.int64], row: int, at: int, step: np.uint8
    ) -> None:
        """A silence before a row, unless few stamps on one side of it are stray."""
        before = host_us[max(row - STRAY_ROWS - 1, 0) : row].max(initial=self.heard_us.get(key, 0))
        silent_us = int(host_us[row : row + STRAY_ROWS + 1].min()) - int(before)
        if silent_us > SILENT_US:
            backward = int(step) if step >= 128 else 0
            self.found.silences.append(Silence(divmod(key, 256), at, silent_us / 1e6, backward))


def _row_of(layout: np.dtype[Any]) -> np.dtype[Any]:
    """What is kept of a message: the fields of its layout without the gaps between them."""
    packed = np.dtype([(name, layout[name]) for name in layout.names or ()])
    return np.dtype([("at", "i8"), ("host_us", "i8"), ("source", "u2"), ("records", packed)])


def _source_of(frames: Frames) -> NDArray[np.uint16]:
    return np.asarray(frames.system.astype(np.uint16) * 256 + frames.component, np.uint16)


def _apart(frames: Frames) -> Frames:
    """The frames that do not begin inside the one before, as a log inside a payload would."""
    if len(frames) < 2 or bool(np.all(frames.at[1:] >= frames.end[:-1])):
        return frames
    keep, end = [], 0
    for row, (at, stop) in enumerate(zip(frames.at.tolist(), frames.end.tolist(), strict=True)):
        if at >= end:
            keep.append(row)
            end = stop
    return frames.take(np.array(keep, np.intp))


def _padded(window: Bytes) -> Bytes:
    """The bytes with as many zeros behind them as a header may reach too far."""
    return np.concatenate([window, np.zeros(HEAD, np.uint8)])


def _chain(data: FileView, begin: int, stop: int) -> tuple[list[int], int]:
    """Frames that stand wall to wall, and where the first does not follow."""
    places: list[int] = []
    at = first = begin
    view = b""
    while at < stop:
        if at + LONGEST > first + len(view) < stop:
            first, view = at, data[at : min(at + STRETCH, stop)]
        length = frame_length(view, at - first)
        if not length or at + length > stop:
            break
        places.append(at)
        at += length
    return places, at


def _is_cut(data: FileView, at: int) -> bool:
    rest = data[at : at + LONGEST]
    return data.size - at < SHORTEST or frame_length(rest, 0) > len(rest)
