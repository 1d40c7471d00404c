"""DataFlash against pymavlink: ratios within one run, on a log grown to 100 MB or more.

python benchmarks/dataflash.py LOG.bin [MEGABYTES] [PAIRS]
"""

from __future__ import annotations

import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from unbend.ingest import open_log
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.dataflash.binary_log import read_tables
from unbend.ingest.dataflash.dataflash_records import find_records
from unbend.ingest.dataflash.record_definitions import HEADER
from unbend.ingest.message_tables import PLACE

NEEDED = ("GPS", "GPA", "ATT", "BARO", "POS", "CAM", "TRIG", "ARSP", "HYGR")
WEEK_MS = 604_800_000


def grow(log: Path, out: Path, size_bytes: int) -> int:
    """Repeat a DataFlash log until it has so many bytes, as one long flight; the size reached.

    TimeUS and the GPS time move on by the length of the log with every copy.
    """
    data = log.read_bytes()
    found = find_records(view_of_bytes(data))
    places = np.concatenate([block.base + block.at.astype(np.int64) for block in found.wanted])
    numbers = np.concatenate([block.numbers for block in found.wanted])
    timed = np.array([form.time_field == "TimeUS" for form in found.definitions], np.bool_)
    stamps = places[timed[numbers]] + HEADER
    source = np.frombuffer(data, np.uint8).copy()
    anywhere = np.ndarray((source.shape[0] - 7,), "<u8", source, strides=(1,))
    first = anywhere[stamps]
    length_us = int(first.max() - first.min()) + 100_000
    receivers = [
        (places[numbers == k], form)
        for k, form in enumerate(found.definitions)
        if form.name in ("GPS", "GPS2") and {"GMS", "GWk"} <= set(form.fields)
    ]
    size = 0
    with out.open("wb") as stream:
        for copy in range(-(-size_bytes // len(data))):
            anywhere[stamps] = first + np.uint64(copy * length_us)
            for rows, form in receivers:
                records = np.ndarray(
                    (source.shape[0] - form.length + 1,), form.dtype, source, strides=(1,)
                )
                for row in rows.tolist():
                    ms = int(records[row]["GMS"]) + (length_us // 1000 if copy else 0)
                    records[row]["GWk"] += ms // WEEK_MS
                    records[row]["GMS"] = ms % WEEK_MS
            size += stream.write(source.tobytes())
    return size


def library_needed(log: Path) -> int:
    """pymavlink, the wanted types through its index: `recv_match(type=...)` and `to_dict`."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(log))
    rows = 0
    with contextlib.closing(reader):
        while (row := reader.recv_match(type=list(NEEDED))) is not None:
            row.to_dict()
            rows += 1
    return rows


def library_all(log: Path) -> int:
    """pymavlink, every message: `recv_msg` and `to_dict`."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(log))
    rows = 0
    with contextlib.closing(reader):
        while (row := reader.recv_msg()) is not None:
            row.to_dict()
            rows += 1
    return rows


def ours_needed(log: Path) -> int:
    """The same types as columns."""
    return sum(table[PLACE].size for table in read_tables(log, NEEDED).values())


def ours_all(log: Path) -> int:
    """Every type as columns."""
    return sum(table[PLACE].size for table in read_tables(log).values())


def seconds(action: Callable[[Path], object], log: Path) -> float:
    begin = time.perf_counter()
    action(log)
    return time.perf_counter() - begin


def ratios(
    library: Callable[[Path], int], ours: Callable[[Path], int], log: Path, pairs: int
) -> tuple[float, float, list[float]]:
    """Median seconds of both, and the ratio of each pair."""
    found = [(seconds(library, log), seconds(ours, log)) for _ in range(pairs)]
    return (
        statistics.median(a for a, _ in found),
        statistics.median(b for _, b in found),
        [a / b for a, b in found],
    )


def main(source: Path, megabytes: int = 110, pairs: int = 7) -> None:
    """Print the ratios and their medians."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "grown.bin"
        size = grow(source, log, megabytes * 1_000_000) / 1e6
        ours_needed(log)
        with log.open("rb") as stream:
            messages = sum(find_records(view_of_bytes(stream.read())).message_counts().values())
        print(f"{source.name} grown to {size:.0f} MB, {messages:,} messages")
        for name, library, ours in (
            ("needed types", library_needed, ours_needed),
            ("all types", library_all, ours_all),
        ):
            theirs_s, ours_s, found = ratios(library, ours, log, pairs)
            print(
                f"{name}: {statistics.median(found):.1f}x pymavlink (median of {pairs} pairs, "
                f"{min(found):.1f} to {max(found):.1f}); {size / theirs_s:.1f} and "
                f"{size / ours_s:.0f} MB/s"
            )
        print(f"open_log, channels, hash and all: {seconds(open_log, log):.2f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(word) for word in sys.argv[2:]))
