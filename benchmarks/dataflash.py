"""DataFlash against pymavlink: ratios within one run, on a log grown to 100 MB or more.

python benchmarks/dataflash.py LOG.bin [MEGABYTES] [PAIRS]
"""

import contextlib
import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from timing import Rates, seconds

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
    scan = find_records(view_of_bytes(data))
    source = np.frombuffer(data, np.uint8).copy()
    place_parts = []
    number_parts = []
    for block in scan.kept_blocks:
        place_parts.append(block.base + block.at.astype(np.int64))
        number_parts.append(block.numbers)
    places = np.concatenate(place_parts)
    numbers = np.concatenate(number_parts)
    is_timed = np.array([form.time_field == "TimeUS" for form in scan.definitions])
    stamps = places[is_timed[numbers]] + HEADER
    times_us = overlapping(source, np.dtype("<u8"))
    first = times_us[stamps]
    length_us = int(np.ptp(first)) + 100_000
    receivers = []
    for number, form in enumerate(scan.definitions):
        has_gps_time = {"GMS", "GWk"} <= set(form.fields)
        if has_gps_time and form.name in ("GPS", "GPS2"):
            rows = places[numbers == number]
            receivers.append((form, rows))
    size = 0
    copies = math.ceil(size_bytes / len(data))
    with out.open("wb") as stream:
        for copy in range(copies):
            times_us[stamps] = first + np.uint64(copy * length_us)
            if copy:
                for form, rows in receivers:
                    records = overlapping(source, form.dtype)
                    move_gps_time(records, rows, length_us // 1000)
            size += stream.write(source.tobytes())
    return size


def overlapping(source: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Values of a type at any byte of a log."""
    count = source.size - dtype.itemsize + 1
    return np.ndarray(
        (count,),
        dtype,
        source,
        strides=(1,),
    )


def move_gps_time(records: np.ndarray, rows: np.ndarray, by_ms: int):
    """Week and millisecond of the week of some records."""
    for row in rows.tolist():
        record = records[row]
        later_ms = int(record["GMS"]) + by_ms
        record["GWk"] += later_ms // WEEK_MS
        record["GMS"] = later_ms % WEEK_MS


def library_needed(log: Path) -> int:
    """pymavlink, the wanted types through its index: `recv_match(type=...)` and `to_dict`."""
    from pymavlink.DFReader import DFReader_binary

    rows = 0
    with contextlib.closing(DFReader_binary(str(log))) as reader:
        while (row := reader.recv_match(type=list(NEEDED))) is not None:
            row.to_dict()
            rows += 1
    return rows


def library_all(log: Path) -> int:
    """pymavlink, every message: `recv_msg` and `to_dict`."""
    from pymavlink.DFReader import DFReader_binary

    rows = 0
    with contextlib.closing(DFReader_binary(str(log))) as reader:
        while (row := reader.recv_msg()) is not None:
            row.to_dict()
            rows += 1
    return rows


def ours_needed(log: Path) -> int:
    """The same types as columns."""
    return count_rows(read_tables(log, NEEDED))


def ours_all(log: Path) -> int:
    """Every type as columns."""
    return count_rows(read_tables(log))


def count_rows(tables: dict[str, dict[str, np.ndarray]]) -> int:
    return sum(table[PLACE].size for table in tables.values())


def main(source: Path, megabytes: int = 110, pairs: int = 7):
    """Print the ratios and their medians."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "grown.bin"
        size = grow(source, log, megabytes * 1_000_000)
        ours_needed(log)
        counts = find_records(view_of_bytes(log.read_bytes())).message_counts()
        messages = sum(counts.values())
        print(f"{source.name} grown to {size / 1e6:.0f} MB, {messages:,} messages")
        compare("needed types", log, pairs, library_needed, ours_needed)
        compare("all types", log, pairs, library_all, ours_all)
        print(f"open_log, channels, hash and all: {seconds(lambda: open_log(log)):.2f} s")


def compare(
    name: str,
    log: Path,
    pairs: int,
    library: Callable[[Path], int],
    ours: Callable[[Path], int],
):
    """Print how many times as fast we are, and both rates."""

    def bytes_by(action: Callable[[Path], int]) -> int:
        action(log)
        return log.stat().st_size

    rates = Rates.by_turns(
        lambda: bytes_by(library),
        lambda: bytes_by(ours),
        pairs,
    )
    library_rate, our_rate = rates.medians(1e6)
    print(f"{name}: {rates.ratio('pymavlink')}")
    print(f"{library_rate:.1f} and {our_rate:.0f} MB/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
