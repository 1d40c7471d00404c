"""The memory that reading a long log takes beyond its columns, measured in a process of its own."""

import json
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from unbend.ingest.buffers import BLOCK, ColumnStore

ROOT = Path(__file__).resolve().parents[2]
MIB = 1 << 20

# Benchmarks hold 128 MB on 110 MB of each format. These logs are shorter, to be grown in seconds;
# before blocks were let go one by one it was 111 MiB for the tlog, 65 MiB for the MCAP.
CASES = {
    "bin all": (".bin", "dataflash", 170, 128),
    "bin": (".bin", "dataflash", 170, 96),
    "tlog": (".tlog", "tlog", 50, 48),
    "mcap": (".mcap", "ros2_mcap", 30, 24),
}

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
if sys.argv[3] == "all":
    tables = read_tables(Path(sys.argv[1]))
    columns = sum(column.nbytes for table in tables.values() for column in table.values())
else:
    log = open_log(sys.argv[1])
    columns = sum(c.time_ns.nbytes + c.boot.nbytes + sum(x.nbytes for x in c.columns.values())
                  for c in log.channels)
print(json.dumps({"more": status("VmHWM") - before, "columns": columns}))
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="only Linux tells the peak")
@pytest.mark.parametrize("case", CASES)
def test_memory_is_the_columns_and_a_little(tmp_path, case):
    suffix, grower, megabytes, spare = CASES[case]
    spec = spec_from_file_location(f"unbend_{grower}", ROOT / "benchmarks" / f"{grower}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    sample = ROOT / "sample_logs" / f"flight{suffix}"
    path = tmp_path / f"grown{suffix}"
    module.grow(sample, path, megabytes * 1_000_000)
    done = subprocess.run(
        [sys.executable, "-c", _PEAK, str(path), str(sample), case.partition(" ")[2]],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    print(f"{case}: {found['more'] / MIB:.0f} MiB for {found['columns'] / MIB:.0f} MiB of columns")
    assert found["columns"] > 20 * MIB
    assert found["more"] < found["columns"] + spare * MIB


@pytest.mark.parametrize("size", [0, 1, BLOCK // 8, BLOCK // 8 + 1, 3 * BLOCK // 8])
def test_what_is_stored_comes_back(size):
    rows = np.arange(size)
    for way in ("whole", "drained", "blocks"):
        store = ColumnStore("i8")
        for part in np.array_split(rows, 7):
            store.add(part)
        assert len(store) == size
        found = getattr(store, way)()
        if way != "whole":
            found = np.concatenate([np.empty(0, np.int64), *found])
        assert_array_equal(found, rows)
        assert len(store) == (size if way == "blocks" else 0)
