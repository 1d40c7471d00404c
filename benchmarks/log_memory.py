"""Memory that reading a log takes beyond its columns. Each step is a process of its own.

    python benchmarks/log_memory.py grow LOG OUT MEGABYTES
    python benchmarks/log_memory.py measure SAMPLE LOG [tables]

The first makes a log of so many megabytes of a shorter one. The second prints, as JSON, how much
more memory than before reading LOG took at most, and the bytes of its columns; a small SAMPLE of
the same format is read before, so that imports do not count. With `tables` all messages of a
DataFlash log are read as tables, else channels.
"""

import json
import sys
from pathlib import Path

import dataflash
import ros2_mcap
import tlog

from unbend.ingest import Log, open_log
from unbend.ingest.dataflash.binary_log import read_tables

GROWERS = {".bin": dataflash, ".tlog": tlog, ".mcap": ros2_mcap}


def grow(log: Path, out: Path, megabytes: int):
    """Repeat a log until it is so long."""
    GROWERS[out.suffix].grow(log, out, megabytes * 1_000_000)


def status(key: str) -> int:
    """What Linux says of the memory of this process [bytes]."""
    for line in Path("/proc/self/status").read_text("utf-8").splitlines():
        name, _, value = line.partition(":")
        if name == key:
            return int(value.split()[0]) * 1024
    raise KeyError(key)


def bytes_of_channels(log: Log) -> int:
    """The bytes of all columns of a log, times and boots included."""
    size = 0
    for channel in log.channels:
        size += channel.time_ns.nbytes + channel.boot.nbytes
        size += sum(column.nbytes for column in channel.columns.values())
    return size


def measure(
    sample: Path,
    log: Path,
    read: str = "channels",
) -> dict[str, int]:
    """How much more memory reading a log took, and the bytes of its columns."""
    open_log(sample)
    before = status("VmRSS")
    if read == "tables":
        tables = read_tables(log)
        columns = 0
        for table in tables.values():
            columns += sum(column.nbytes for column in table.values())
    else:
        opened = open_log(log)
        columns = bytes_of_channels(opened)
    more = status("VmHWM") - before
    return {"more": more, "columns": columns}


def main(step: str, first: Path, second: Path, *more: str):
    """One step of the two."""
    if step == "grow":
        grow(first, second, int(more[0]))
    else:
        print(json.dumps(measure(first, second, *more)))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), *sys.argv[4:])
