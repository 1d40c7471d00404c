"""Scanning a telemetry log in stretches: frames checked, wanted payloads kept, the rest counted.

A frame is the ground station's big-endian clock in microseconds (8 bytes) and a MAVLink 1 (0xFE) or
MAVLink 2 (0xFD) packet. It is accepted when its checksum holds. Between accepted frames lie those
that cannot be checked (an id outside the dialect), those whose checksum fails, and bytes of no
message. Everything is done for all frames of a stretch of the file at once.
"""

from collections import Counter
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest.buffers import Bytes, ColumnStore, FileView
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.tlog.clock_samples import Key, Sampler
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

STRETCH = 2 << 20  # [bytes] scanned at once: the tables of its frames fit the cache


STEADY_US = 1_000_000


SILENT_US = 3_000_000  # every component sends a HEARTBEAT each second: three in a row are missing


@dataclass(frozen=True)
class Silence:
    """More than `SILENT_US` without a message of a sender, before the byte ``at``.

    ``backward``: messages missing by a step of the sequence otherwise taken as backward, or 0.
    """

    source: Key
    at: int
    seconds: float
    backward: int


@dataclass
class RejectedFrames:
    """Frames of one id that are not accepted: how many, the first of them, their bytes."""

    count: int = 0
    first: int = -1
    size: int = 0


class Scan(DamagedBytes):
    """The messages of a telemetry log, and what is damaged or missing.

    ``wanted``: layouts of payloads to keep, by id; ``late`` ones have not the time of sending. An
    id outside the dialect counts where frames fill all between accepted ones.

    ``sent``: the wanted ones, with ``at`` (byte), ``host_us`` (the ground station's clock),
    ``source`` (system times 256 plus component) and ``records``; ``unknown`` ids (in ``counts``)
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
        self.lost: Counter[Key] = Counter()
        self.silences: list[Silence] = []
        self.steady = True
        self._data = data
        self._extras = extras
        self._wanted = wanted
        self._row_types: dict[int, np.dtype[Any]] = {}
        for number, layout in wanted.items():
            packed = np.dtype([(name, layout[name]) for name in layout.names or ()])
            columns = [("at", "i8"), ("host_us", "i8"), ("source", "u2"), ("records", packed)]
            self._row_types[number] = np.dtype(columns)
        self._late = late
        self._end = 0
        self._host_us = 0
        self._sequences: dict[int, int] = {}
        self._highest: dict[int, int] = {}  # how far the highest number is ahead of the last
        self._heard_us: dict[int, int] = {}
        for begin in range(0, data.size, STRETCH):
            self.scan_stretch(begin, min(begin + STRETCH, data.size))
        if self._end < data.size:
            rest = self._fill(self._end, data.size)
            if len(rest):
                self._count_lost(rest)

    def scan_stretch(self, begin: int, stop: int) -> None:
        """Scan the frames that begin in a stretch."""
        window = self._data.array(begin, stop + LONGEST)
        room = window.shape[0]
        if stop == self._data.size:
            window = _padded(window)
        places = candidates(window, stop - begin)
        frames = headers(window, places[places >= self._end - begin], room)
        frames = frames.take(checksums_hold(window, frames, self._extras))
        if not bool(np.all(frames.at[1:] >= frames.end[:-1])):
            # some begin inside the one before, as where a payload holds a log
            apart, end = [], 0
            for row, pair in enumerate(zip(frames.at.tolist(), frames.end.tolist(), strict=True)):
                if pair[0] >= end:
                    apart.append(row)
                    end = pair[1]
            frames = frames.take(np.array(apart, np.intp))
        timed = []
        for number, dtype in self._wanted.items():
            chosen = np.flatnonzero(frames.message_id == number)
            if chosen.shape[0]:
                of_type = frames.take(chosen)
                payload = payloads(window, of_type, dtype)
                rows = np.empty(chosen.shape, self._row_types[number])
                rows["at"], rows["host_us"] = of_type.at + begin, of_type.host_us
                rows["source"] = _source_of(of_type)
                for name in dtype.names or ():
                    rows["records"][name] = payload[name]
                self.sent.setdefault(number, ColumnStore(rows.dtype)).add(rows)
                if number not in self._late and "time_boot_ms" in (dtype.names or ()):
                    timed.append(rows)
        self.clock.take(timed)
        frames = frames.moved(begin)
        if len(frames):
            step = np.diff(frames.host_us, prepend=self._host_us or int(frames.host_us[0]))
            self.steady &= bool(np.all(step >= -STEADY_US))
            self._host_us = int(frames.host_us[-1])
            ends = np.concatenate([[self._end], frames.end[:-1]])
            gaps = np.flatnonzero(ends != frames.at)
            filled = [self._fill(int(ends[k]), int(frames.at[k])) for k in gaps]
            between = [part for part in filled if len(part)]
            self._count_lost(joined([frames, *between]) if between else frames)
            self._end = int(frames.end[-1])
        small = frames.message_id[frames.message_id < 1 << 16]
        for number, count in enumerate(np.bincount(small).tolist()):
            if count:
                self.counts[number] += count

    def _fill(self, begin: int, stop: int) -> Frames:
        """Count the bytes between two accepted frames; returns the frames among them."""
        places: list[int] = []  # of frames that follow each other without a gap
        at = first = begin
        view = b""
        while at < stop:
            if at + LONGEST > first + len(view) < stop:
                first, view = at, self._data[at : min(at + STRETCH, stop)]
            length = frame_length(view, at - first)
            if not length or at + length > stop:
                break
            places.append(at)
            at += length
        cut = 0
        if at < stop:
            rest = self._data[at : at + LONGEST]
            is_cut = stop == self._data.size and (
                stop - at < SHORTEST or frame_length(rest, 0) > len(rest)
            )
            if is_cut and places:  # not behind a frame whose checksum fails
                head = _padded(self._data.array(places[-1], places[-1] + HEAD))
                last = headers(head, np.zeros(1, np.int64), LONGEST)
                is_cut = int(last.message_id[0]) not in self._extras
            if is_cut:
                cut = stop - at
            elif places:
                at = places.pop()  # its length may be damaged
        self.cut_bytes += cut
        if at + cut < stop:
            self.drop(at, stop)
        window = _padded(self._data.array(begin, at))
        frames = headers(window, np.array(places, np.int64) - begin, at - begin).moved(begin)
        columns = (frames.message_id, frames.at, frames.total)
        for number, place, total in zip(*(column.tolist() for column in columns), strict=True):
            known = number in self._extras
            by_id = self.failed if known else self.unknown
            rejected = by_id.setdefault(number, RejectedFrames())
            rejected.count += 1
            rejected.size += total
            rejected.first = place if rejected.first < 0 else rejected.first
            self.counts[number] += 0 if known else 1
        return frames

    def _count_lost(self, frames: Frames) -> None:
        """Messages missing by the numbers of each sender; the upper half of steps is backward.

        What comes late fills its gap. A silence counts unless few stamps beside it are stray.
        """
        source = _source_of(frames)
        order = np.argsort(source, kind="stable")
        sequence, host_us = frames.sequence[order], frames.host_us[order]
        begin = np.flatnonzero(np.diff(source[order].astype(np.int32), prepend=-1)).tolist()
        for first, stop in zip(begin, [*begin[1:], order.shape[0]], strict=True):
            key = int(source[order[first]])
            numbers = sequence[first:stop]
            before = np.uint8(self._sequences.get(key, (int(numbers[0]) - 1) % 256))
            step = np.diff(numbers, prepend=before) - np.uint8(1)
            self._sequences[key] = int(numbers[-1])
            host = host_us[first:stop]
            heard_us = self._heard_us.get(key, int(host[0]))
            forward = step.view(np.int8).astype(np.int64) + 1
            forward[(forward < 0) & (np.diff(host, prepend=heard_us) > SILENT_US)] = 1
            place, highest = np.cumsum(forward), self._highest.get(key, 0)
            new = np.unique(place[place > highest])
            lost = int(new[-1]) - highest - new.shape[0] if new.size else 0
            self._highest[key] = max(highest, int(place.max())) - int(place[-1])
            self.lost[divmod(key, 256)] += lost
            for row in np.flatnonzero(np.diff(host, prepend=heard_us) > SILENT_US).tolist():
                last = int(host[max(row - STRAY_ROWS - 1, 0) : row].max(initial=heard_us))
                silent_us = int(host[row : row + STRAY_ROWS + 1].min()) - last
                if silent_us > SILENT_US:
                    at = int(frames.at[order[first + row]])
                    backward = int(step[row]) if step[row] >= 128 else 0
                    silence = Silence(divmod(key, 256), at, silent_us / 1e6, backward)
                    self.silences.append(silence)
            self._heard_us[key] = int(host[-1])


def _source_of(frames: Frames) -> NDArray[np.uint16]:
    return np.asarray(frames.system.astype(np.uint16) * 256 + frames.component, np.uint16)


def _padded(window: Bytes) -> Bytes:
    """The bytes and behind them zeros, as many as a header may extend beyond the end."""
    return np.concatenate([window, np.zeros(HEAD, np.uint8)])
