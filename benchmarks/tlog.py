"""Telemetry logs against pymavlink: ratios within one run, on a log grown to 100 MB or more.

    python benchmarks/tlog.py LOG.tlog [MEGABYTES] [PAIRS]

pymavlink reads the first 10 MB of it in each pair, we read the whole: rates are compared.
"""

import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from timing import Rates, seconds

from unbend.ingest import open_log
from unbend.ingest.buffers import open_view
from unbend.ingest.tlog.dialect import crc_extras, dialect, name_of, wanted_layouts
from unbend.ingest.tlog.frames import (
    HEAD,
    STAMP,
    Frames,
    candidates,
    checksums,
    checksums_hold,
    frame_length,
    frames_at,
)
from unbend.ingest.tlog.scan import Scan

NEEDED = tuple(sorted(map(name_of, wanted_layouts())))
LIBRARY_BYTES = 10_000_000
CLOCKS = {"time_boot_ms": 1000, "time_usec": 1, "time_unix_usec": 1}  # [us] a unit


def grow(log: Path, out: Path, size_bytes: int) -> int:
    """Repeat a log until it has so many bytes, as one long flight; the size reached.

    The host's stamps and the vehicle's clocks move on by the length of the log with every copy,
    and checksums are made anew.
    """
    data = log.read_bytes() + bytes(HEAD)
    source = _with_whole_clocks(np.frombuffer(data, np.uint8))
    room = source.shape[0] - HEAD
    frames = _frames(source)
    length_us = int(np.ptp(frames.host_us)) + 100_000
    stamps = _at_any_byte(source, ">u8")
    first = stamps[frames.place]
    size = 0
    with out.open("wb") as stream:
        for copy in range(math.ceil(size_bytes / room)):
            stamps[frames.place] = first + np.uint64(copy * length_us)
            if copy:
                _set_clocks_on(source, frames, length_us)
                _sign(source, frames)
            size += stream.write(source[:room].tobytes())
    return size


def _frames(source: np.ndarray) -> Frames:
    room = source.shape[0] - HEAD
    frames = frames_at(source, candidates(source, room), room)
    return frames.take(checksums_hold(source, frames, crc_extras()))


def _with_whole_clocks(source: np.ndarray) -> np.ndarray:
    """The log with room for later times: MAVLink 2 has trimmed the zeros of small ones."""
    data = source.tobytes()
    out = bytearray()
    done = 0
    for place, size in _trimmed_clocks(_frames(source)):
        at_length = place + STAMP + 1
        length = data[at_length]
        end = place + HEAD + length
        out += data[done:at_length]
        out.append(size)
        out += data[at_length + 1 : end]
        out += bytes(size - length)
        done = end
    out += data[done:]
    whole = np.frombuffer(out, np.uint8)
    places = np.array(_places(bytes(out)))
    _sign(whole, frames_at(whole, places, len(whole) - HEAD))
    return whole


def _trimmed_clocks(frames: Frames) -> list[tuple[int, int]]:
    """Places of frames that have lost zeros and have a clock, and their lengths with the zeros."""
    trimmed = []
    for number in np.unique(frames.message_id).tolist():
        dtype = dialect()[number].dtype
        if not CLOCKS.keys() & set(dtype.names or ()):
            continue
        rows = frames.message_id == number
        rows &= frames.length < dtype.itemsize
        rows &= frames.version == 2
        for place in frames.place[rows].tolist():
            trimmed.append((place, dtype.itemsize))
    return sorted(trimmed)


def _places(data: bytes) -> list[int]:
    """Where the frames of a log without gaps begin."""
    places = []
    place = 0
    while place < len(data) - HEAD:
        length = frame_length(data, place)
        if not length:
            break
        places.append(place)
        place += length
    return places


def _set_clocks_on(source: np.ndarray, frames: Frames, by_us: int):
    for number in np.unique(frames.message_id).tolist():
        fields = dialect()[number].dtype.fields or {}
        for name in CLOCKS.keys() & fields.keys():
            kind, offset = fields[name][:2]
            rows = frames.message_id == number
            rows &= frames.length >= offset + kind.itemsize
            values = _at_any_byte(source, kind)
            places = frames.payload[rows] + offset
            old = values[places]
            range_of_clock = 1 << 8 * kind.itemsize
            units = by_us // CLOCKS[name] % range_of_clock
            moved = old + kind.type(units)
            values[places] = np.where(old > 0, moved, 0)


def _at_any_byte(source: np.ndarray, kind: np.dtype | str) -> np.ndarray:
    """Values of a type of 8 bytes at most, at any byte."""
    count = source.shape[0] - 8
    return np.ndarray(
        (count,),
        kind,
        source,
        strides=(1,),
    )


def _sign(source: np.ndarray, frames: Frames):
    extras = np.zeros(1 << 16, np.uint16)
    for number, extra in crc_extras().items():
        extras[number] = extra
    is_known = np.isin(frames.message_id, list(dialect()))
    for length in np.unique(frames.length).tolist():
        for version, before in ((1, 5), (2, 9)):
            rows = is_known & (frames.length == length)
            rows &= frames.version == version
            if not rows.any():
                continue
            size = before + length
            first = frames.place[rows] + STAMP + 1
            extra = extras[frames.message_id[rows]]
            crc = checksums(source, first, size, extra).computed
            end = first + size
            source[end] = crc & 0xFF
            source[end + 1] = crc >> 8


def library(log: Path, size: int) -> int:
    """pymavlink: `recv_match(type=...)` and `to_dict`; how many bytes it has read."""
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(log), dialect="all")
    while (row := reader.recv_match(type=list(NEEDED))) is not None:
        row.to_dict()
        if reader.f.tell() > size:
            break
    read = reader.f.tell()
    reader.close()
    return int(read)


def ours(log: Path) -> int:
    """The same types as records of numbers, the checksum of every frame tested."""
    with open_view(log) as data:
        return sum(Scan(data, crc_extras(), wanted_layouts()).counts.values())


def main(source: Path, megabytes: int = 110, pairs: int = 7):
    """Print the ratio of the rates and its spread."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "grown.tlog"
        size = grow(source, log, megabytes * 1_000_000)
        print(f"{source.name} grown to {size / 1e6:.0f} MB, {ours(log):,} messages")

        def ours_of_bytes() -> int:
            ours(log)
            return size

        rates = Rates.by_turns(
            lambda: library(log, LIBRARY_BYTES),
            ours_of_bytes,
            pairs,
        )
        library_rate, our_rate = rates.medians(1e6)
        ratio = rates.ratio("pymavlink")
        print(f"{len(NEEDED)} types, CRC on every frame: {ratio}")
        print(f"{library_rate:.1f} and {our_rate:.0f} MB/s")
        print(f"open_log, channels, hash and all: {seconds(lambda: open_log(log)):.2f} s")
        opened = open_log(log)
        print(f"boots {opened.boots}, bad bytes {opened.bad_bytes}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
