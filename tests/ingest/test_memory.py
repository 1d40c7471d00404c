"""The memory that reading a long log takes beyond its columns, measured in a process of its own."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.logs import LOGS, REPOSITORY

MIB = 1 << 20

_PEAK = """
import json, sys
from pathlib import Path
from unbend.ingest import open_log
from unbend.ingest.dataflash.binary_log import read_tables
def status(key):
    lines = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return int(lines[key].split()[0]) * 1024
open_log(sys.argv[2])  # imports are not the log's memory
before = status("VmRSS")
if sys.argv[3] == "tables":
    tables = read_tables(Path(sys.argv[1]))
    columns = sum(column.nbytes for table in tables.values() for column in table.values())
else:
    log = open_log(sys.argv[1])
    columns = sum(c.time_ns.nbytes + c.boot.nbytes + sum(x.nbytes for x in c.columns.values())
                  for c in log.channels)
print(json.dumps({"more": status("VmHWM") - before, "columns": columns}))
"""


# Benchmarks hold 128 MB on 110 MB of each format. These logs are shorter, to be grown in seconds;
# before blocks were let go one by one it was 111 MiB for the tlog, 65 MiB for the MCAP.
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="only Linux tells the peak")
@pytest.mark.parametrize(
    ("suffix", "benchmark", "megabytes", "read", "spare_mib"),
    [
        (".bin", "dataflash", 170, "tables", 128),
        (".bin", "dataflash", 170, "channels", 96),
        (".tlog", "tlog", 50, "channels", 48),
        (".mcap", "ros2_mcap", 30, "channels", 24),
    ],
)
def test_memory_is_the_columns_and_a_little(
    tmp_path, monkeypatch, suffix, benchmark, megabytes, read, spare_mib
):
    monkeypatch.syspath_prepend(REPOSITORY / "benchmarks")
    module = import_module(benchmark)
    sample = LOGS[f"flight{suffix}"]
    path = tmp_path / f"grown{suffix}"
    module.grow(sample, path, megabytes * 1_000_000)
    words = [str(path), str(sample), read]
    printed = subprocess.check_output([sys.executable, "-c", _PEAK, *words], text=True)
    taken = json.loads(printed)
    assert taken["columns"] > 20 * MIB
    assert taken["more"] < taken["columns"] + spare_mib * MIB
