"""Ten times as many image points take at most 100 MB more, whatever the format."""

import os
import subprocess
import sys

import pytest

from tests.logs import REPOSITORY

NAMES = ["colmap-database", "opensfm", "colmap", "bundler", "bingo"]
"""`make faults` tries all, `make test` the first two."""

PROGRAM = "tests.tables.exports.block_memory"


@pytest.mark.skipif(sys.platform != "linux", reason="/proc/self/status")
@pytest.mark.parametrize("name", NAMES if "UNBEND_BLOCKS" in os.environ else NAMES[:2])
def test_memory_grows_little_with_the_image_points(tmp_path, name):
    peaks = []
    for rows in (44_800, 448_000):
        folder = tmp_path / str(rows)
        folder.mkdir()
        words = [sys.executable, "-m", PROGRAM, name, str(rows), folder]
        ended = subprocess.run(words, capture_output=True, text=True, check=True, cwd=REPOSITORY)
        before, peak = map(float, ended.stdout.split())
        assert before < peak
        peaks.append(peak)
    assert peaks[1] - peaks[0] < 100.0, peaks
