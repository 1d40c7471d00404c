"""The same inputs give the same bytes, whatever the machine, its settings and the day.

Each case is a run in a process of its own. `make test` has two; UNBEND_MACHINES=all runs each
(RELIABILITY.md, F15).
"""

import os
import subprocess
import sys

import pytest

from tests.conftest import MissionFolder

from .conftest import hashes_in

MACHINES = {
    "hash seed 1, New York": {"PYTHONHASHSEED": "1", "TZ": "America/New_York"},
    "hash seed 2, Kathmandu": {"PYTHONHASHSEED": "2", "TZ": "Asia/Kathmandu"},
    "hash seed 3, Turkish": {
        "PYTHONHASHSEED": "3",
        "LC_ALL": "tr_TR.UTF-8",
        "LANG": "tr_TR.UTF-8",
    },
    "one thread": {
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    },
    "numpy without AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V3"},
    "kernels without AVX2": {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""},
}
"""Environments that a result must not show, each with what is set in it."""

MACHINES_OF_EACH_TEST_RUN = ("hash seed 1, New York", "numpy without AVX2")
ALL = os.environ.get("UNBEND_MACHINES") == "all"
TRIED = list(MACHINES) if ALL else list(MACHINES_OF_EACH_TEST_RUN)


def run_in_process(mission: MissionFolder, *options, **environment):
    """Run a mission in a process of its own, with variables of its environment."""
    done = subprocess.run(
        [sys.executable, "-m", "unbend", "run", mission.save(), *options],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def assert_same_tables(mission, other):
    assert hashes_in(mission.output, "*.parquet") == hashes_in(other.output, "*.parquet")


@pytest.mark.parametrize("machine", TRIED)
def test_another_machine_gives_the_same_bytes(machine, mission, baseline):
    run_in_process(mission, **MACHINES[machine])
    assert_same_tables(mission, baseline)


@pytest.mark.parametrize("processes", [2, 8] if ALL else [2])
def test_processes_side_by_side_give_the_same_bytes(mission_factory, baseline, tmp_path, processes):
    missions = [mission_factory(tmp_path / str(number)) for number in range(processes)]
    files = [str(mission.save()) for mission in missions]
    first = missions[0]
    run_in_process(first, *files[1:], "--jobs", str(processes))
    for mission in missions:
        assert_same_tables(mission, baseline)
