"""Memory that reading a log takes beyond its columns. Each step is a process of its own.

    python benchmarks/log_memory.py grow LOG OUT MEGABYTES
    python benchmarks/log_memory.py measure SAMPLE LOG [tables]
    python benchmarks/log_memory.py watch SAMPLE LOG

The first makes a log of so many megabytes of a shorter one. The second prints, as JSON, how much
more memory than before reading LOG took at most, and the bytes of its columns; a small SAMPLE of
the same format is read before, so that imports do not count. With `tables` all messages of a
DataFlash log are read as tables, else channels. The third prints the largest anonymous memory of
the whole process, imports included, the bytes of the columns and the seconds.
"""

import json
import sys
import threading
import time
from pathlib import Path

import dataflash
import ros2_mcap
import tlog

from unbend.ingest import Log, open_log
from unbend.ingest.dataflash.binary_log import read_tables

_EVERY_S = 0.01

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


def watch(sample: Path, log: Path) -> dict[str, float]:
    """The largest anonymous memory of this process while a log is read, looked at every 10 ms."""
    open_log(sample)
    sizes = [status("RssAnon")]
    over = threading.Event()

    def look():
        while not over.wait(_EVERY_S):
            sizes.append(status("RssAnon"))

    watcher = threading.Thread(target=look)
    watcher.start()
    begin_s = time.perf_counter()
    opened = open_log(log)
    seconds = time.perf_counter() - begin_s
    over.set()
    watcher.join()
    return {"private": max(sizes), "columns": bytes_of_channels(opened), "seconds": seconds}


def main(step: str, first: Path, second: Path, *more: str):
    """One step of the three."""
    if step == "grow":
        grow(first, second, int(more[0]))
    elif step == "watch":
        print(json.dumps(watch(first, second)))
    else:
        print(json.dumps(measure(first, second, *more)))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), *sys.argv[4:])
