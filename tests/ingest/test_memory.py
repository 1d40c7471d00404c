"""The memory that reading a long log takes beyond its columns, measured in a process of its own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.logs import LOGS, REPOSITORY

MIB = 1 << 20
MEASURE = REPOSITORY / "benchmarks" / "log_memory.py"


def measured(*words):
    """What a step of the measurement prints, which is a process of its own."""
    command = [sys.executable, str(MEASURE), *map(str, words)]
    return subprocess.check_output(command, text=True)


# Benchmarks hold 128 MB on 110 MB of each format. These logs are shorter, to be grown in seconds;
# before blocks were let go one by one it was 111 MiB for the tlog, 65 MiB for the MCAP.
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="only Linux tells the peak")
@pytest.mark.parametrize(
    ("suffix", "megabytes", "read", "spare_mib"),
    [
        (".bin", 170, "tables", 128),
        (".bin", 170, "channels", 96),
        (".tlog", 50, "channels", 48),
        (".mcap", 30, "channels", 24),
    ],
)
def test_memory_is_the_columns_and_a_little(tmp_path, suffix, megabytes, read, spare_mib):
    sample = LOGS[f"flight{suffix}"]
    path = tmp_path / f"grown{suffix}"
    measured("grow", sample, path, megabytes)
    taken = json.loads(measured("measure", sample, path, read))
    assert taken["columns"] > 20 * MIB
    assert taken["more"] < taken["columns"] + spare_mib * MIB
