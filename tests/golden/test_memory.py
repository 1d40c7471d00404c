"""Memory does not depend on the number of observations."""

import json
import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq

from tests.logs import REPOSITORY

from .conftest import sample_sections, write_mission

ROWS = 10_000_000
# A million rows end before all parts are at work that are at once: 650 to 730 MB. From here on the
# peak is 740 to 840 MB, on an idle machine and on a busy one.
FEW_ROWS = 2_000_000

_RUN = """
import json, sys
from pathlib import Path
from unbend.batch.runs import run_mission
outcome = run_mission(Path(sys.argv[1]))
# Not ru_maxrss: that starts at what the parent had when it made this process.
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
peak = int(status["VmHWM"].split()[0]) * 1024
print(json.dumps([outcome.manifest.values["observations"]["rows"], peak]))
"""


def peak_of(folder, rows):
    """Rows corrected, and the largest resident memory [bytes] of a process that did it."""
    small = pq.read_table(REPOSITORY / "sample_logs" / "observations.parquet")
    block = pa.concat_tables([small] * 200).combine_chunks()
    folder.mkdir()
    with pq.ParquetWriter(folder / "observations.parquet", small.schema) as writer:
        for first in range(0, rows, len(block)):
            writer.write_table(block.slice(0, min(len(block), rows - first)))
    sections = sample_sections("bin", folder / "results")
    sections["observations"]["path"] = str(folder / "observations.parquet")
    mission = write_mission(folder / "mission.yaml", **sections)
    output = subprocess.check_output([sys.executable, "-c", _RUN, mission], text=True)
    return json.loads(output)


def test_ten_million_observations_in_a_gigabyte(tmp_path):
    few_rows, few_peak = peak_of(tmp_path / "few", FEW_ROWS)
    rows, peak = peak_of(tmp_path / "many", ROWS)
    assert few_rows == FEW_ROWS
    assert rows == ROWS
    assert peak < 1e9
    assert peak < few_peak + 100e6
