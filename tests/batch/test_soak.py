"""Many missions one after the other in one process: nothing stays open or is left, nothing grows.

10 missions in `make test`; UNBEND_SOAK states another number (RELIABILITY.md, F22).
"""

import os
import tempfile
from pathlib import Path

import pytest

MISSIONS = int(os.environ.get("UNBEND_SOAK", "10"))
WARM_UP = 5  # missions after which imports, kernels and caches are there
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
GROWTH_OF_ALLOCATOR = 30e6  # bytes that malloc may keep, whatever the number of missions
GROWTH_OF_MISSION = 5e3  # bytes: in an hour of a mission a second less than 20 MB

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="/proc is not there"),
    pytest.mark.usefixtures("plain_report"),
]


def open_files():
    """Files, pipes and sockets that this process has open."""
    return len(os.listdir("/proc/self/fd"))


def resident_bytes():
    """Resident memory of this process [bytes]."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * PAGE_BYTES


def temporary_files():
    """Names in the folder for temporary files."""
    return set(os.listdir(tempfile.gettempdir()))


def test_many_missions_leave_nothing_behind(mission, tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    for _ in range(WARM_UP):
        assert mission.run("--force").code == 0
    files_before = open_files()
    bytes_before = resident_bytes()
    for _ in range(MISSIONS):
        assert mission.run("--force").code == 0
    growth = resident_bytes() - bytes_before
    assert open_files() == files_before
    assert temporary_files() == set()
    assert growth < GROWTH_OF_ALLOCATOR + MISSIONS * GROWTH_OF_MISSION
