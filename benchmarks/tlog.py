"""Telemetry logs against pymavlink: ratios within one run, on a log grown to 100 MB or more.

    python benchmarks/tlog.py LOG.tlog [MEGABYTES] [PAIRS]

pymavlink reads the first 10 MB of it in each pair, we read the whole: rates are compared.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

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
    headers,
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
    source = _with_whole_clocks(np.frombuffer(log.read_bytes() + bytes(HEAD), np.uint8))
    room = source.shape[0] - HEAD
    frames = _frames(source)
    length_us = int(np.ptp(frames.host_us)) + 100_000
    stamps = np.ndarray((room - 7,), ">u8", source, strides=(1,))
    first = stamps[frames.place]
    size = 0
    with out.open("wb") as stream:
        for copy in range(-(-size_bytes // room)):
            stamps[frames.place] = first + np.uint64(copy * length_us)
            if copy:
                _set_clocks_on(source, frames, length_us)
                _sign(source, frames)
            size += stream.write(source[:room].tobytes())
    return size


def _frames(source: np.ndarray) -> Frames:
    room = source.shape[0] - HEAD
    frames = headers(source, candidates(source, room), room)
    return frames.take(checksums_hold(source, frames, crc_extras()))


def _with_whole_clocks(source: np.ndarray) -> np.ndarray:
    """The log with room for later times: MAVLink 2 has trimmed the zeros of small ones."""
    frames = _frames(source)
    parts = []
    for number in np.unique(frames.message_id).tolist():
        dtype = dialect()[number].dtype
        if set(dtype.names or ()) & set(CLOCKS):
            rows = (frames.message_id == number) & (frames.length < dtype.itemsize)
            rows &= frames.version == 2
            parts += [(at, dtype.itemsize) for at in frames.place[rows].tolist()]
    data = source.tobytes()
    done = 0
    out = []
    for at, size in sorted(parts):
        length = data[at + STAMP + 1]
        end = at + HEAD + length
        out += [data[done : at + STAMP + 1], bytes([size]), data[at + STAMP + 2 : end]]
        out += [bytes(size - length)]
        done = end
    whole = np.frombuffer(b"".join([*out, data[done:]]), np.uint8).copy()
    places = []
    at = 0
    raw = whole.tobytes()
    while at < len(raw) - HEAD and (length := frame_length(raw, at)):
        places.append(at)
        at += length
    _sign(whole, headers(whole, np.array(places), len(whole) - HEAD))
    return whole


def _set_clocks_on(source: np.ndarray, frames: Frames, by_us: int) -> None:
    for number in np.unique(frames.message_id).tolist():
        dtype = dialect()[number].dtype
        for name, unit in CLOCKS.items():
            if name not in (dtype.names or ()):
                continue
            kind, offset = dtype.fields[name][:2]
            rows = (frames.message_id == number) & (frames.length >= offset + kind.itemsize)
            values = np.ndarray((source.shape[0] - 8,), kind, source, strides=(1,))
            places = frames.payload[rows] + offset
            old = values[places]
            values[places] = np.where(
                old > 0, old + kind.type(by_us // unit % (1 << 8 * kind.itemsize)), 0
            )


def _sign(source: np.ndarray, frames: Frames) -> None:
    extras = np.zeros(1 << 16, np.uint16)
    for number, extra in crc_extras().items():
        extras[number] = extra
    for length in np.unique(frames.length).tolist():
        for version, before in ((1, 5), (2, 9)):
            rows = (frames.length == length) & (frames.version == version)
            rows &= np.isin(frames.message_id, list(dialect()))
            first = frames.place[rows] + STAMP + 1
            if first.shape[0]:
                extra = extras[frames.message_id[rows]]
                crc = checksums(source, first, before + length, extra).computed
                for byte in (0, 1):
                    source[first + before + length + byte] = crc >> 8 * byte & 0xFF


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


def main(source: Path, megabytes: int = 110, pairs: int = 7) -> None:
    """Print the ratio of the rates and its spread."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "grown.tlog"
        size = grow(source, log, megabytes * 1_000_000)
        print(f"{source.name} grown to {size / 1e6:.0f} MB, {ours(log):,} messages")
        rates = []
        for _ in range(pairs):
            begin = time.perf_counter()
            read = library(log, LIBRARY_BYTES)
            middle = time.perf_counter()
            ours(log)
            rates.append((read / (middle - begin), size / (time.perf_counter() - middle)))
        ratios = [b / a for a, b in rates]
        theirs, mine = (statistics.median(column) / 1e6 for column in zip(*rates, strict=True))
        print(
            f"{len(NEEDED)} types, CRC on every frame: {statistics.median(ratios):.1f}x pymavlink "
            f"(median of {pairs} pairs, {min(ratios):.1f} to {max(ratios):.1f}); {theirs:.1f} and "
            f"{mine:.0f} MB/s"
        )
        begin = time.perf_counter()
        log_read = open_log(log)
        print(f"open_log, channels, hash and all: {time.perf_counter() - begin:.2f} s")
        print(f"boots {log_read.boots}, bad bytes {log_read.bad_bytes}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(word) for word in sys.argv[2:]))
