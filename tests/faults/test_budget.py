"""Time and memory of reading grow with the bytes of a log, whatever it holds.

Work is counted, not timed: calls of functions, each with the rows of the arrays that it had in its
hands. So a busy machine changes nothing, and a pass over all rows for each of many things shows.
"""

import gc
import sys
import tracemalloc

import numpy as np
import pytest

from tests.faults.hostile import GROWING
from tests.faults.mutate import limited, work_unit_s
from tests.helpers import codes_of_losses
from unbend.errors import LogError
from unbend.ingest import open_log
from unbend.ingest.limits import check_boots, check_senders

MOST_GROWTH = 2.3  # of time and memory, where the structure doubles
ROWS_OF_CALL = 200  # that numpy works off in the time of a call of Python
# Below, fixed costs hide the growth: work in calls, memory in bytes.
LEAST_WORK = 3_000
LEAST_MEMORY = 1 << 20
FIXED_MEMORY = 200 << 20
MEMORY_OF_INPUT = 20  # times its bytes
# CPU of what was found, in work units (0.03 to 0.1 s): before it was minutes.
FIXED_UNITS = 60.0
UNITS_OF_MB = 30.0


class Work:
    """Counts calls of functions, and the rows of the arrays of each when it returns."""

    def __init__(self):
        self.calls = 0.0

    def __call__(self, frame, event, _):
        if event == "return":
            rows = 0
            # numpy's own functions may search in an array without a pass over it
            is_own = frame.f_globals.get("__name__", "").startswith("unbend")
            for value in frame.f_locals.values() if is_own else ():
                # the bytes of a file, and the items that overlap in them, are only looked at
                if isinstance(value, np.ndarray) and value.dtype.kind != "V" and value.itemsize > 1:
                    rows += value.size
            self.calls += 1.0 + rows / ROWS_OF_CALL
        elif event == "c_call":
            self.calls += 0.2

    def of_reading(self, path):
        """The work of reading a log, refused or not."""
        sys.setprofile(self)
        try:
            read(path)
        finally:
            sys.setprofile(None)
        return self.calls


def read(path):
    """Read a log; its losses by code, or the code of its refusal."""
    try:
        log = open_log(path, needs_channels=False)
    except LogError as error:
        return error.code if error.where else "without a place"
    return " ".join(sorted(set(codes_of_losses(log.ledger))))


def memory_of_reading(path):
    """The most memory [bytes] that reading a log takes."""
    gc.collect()
    tracemalloc.start()
    try:
        read(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def written(folder, hostile, n):
    path = folder / f"hostile{hostile.suffix}"
    path.write_bytes(hostile.build(n))
    return path


@pytest.mark.parametrize("name", GROWING)
def test_twice_the_structure_is_at_most_twice_the_work(tmp_path, name):
    hostile = GROWING[name]
    work = []
    memory = []
    read(written(tmp_path, hostile, 5))  # imports and caches are not the log's work
    for times in (1, 2):
        path = written(tmp_path, hostile, times * hostile.small)
        work.append(Work().of_reading(path))
        memory.append(memory_of_reading(path))
    assert work[1] <= max(MOST_GROWTH * work[0], LEAST_WORK)
    assert memory[1] <= max(MOST_GROWTH * memory[0], LEAST_MEMORY)


@pytest.mark.parametrize("name", GROWING)
def test_what_took_minutes_is_within_the_budget(tmp_path, name):
    """At the size at which it was found: CPU time is limited by what the machine does in it."""
    hostile = GROWING[name]
    path = written(tmp_path, hostile, hostile.n)
    size = path.stat().st_size
    units = FIXED_UNITS + UNITS_OF_MB * size / 1e6
    with limited(units * work_unit_s()):
        losses = read(path)
    assert hostile.said in losses
    assert memory_of_reading(path) < FIXED_MEMORY + MEMORY_OF_INPUT * size


def test_large_logs_may_have_more_boots_and_senders(tmp_path):
    """A season that was joined, and a swarm, are right inputs: the limits grow with the records."""
    check_boots(1200, records=1_200_000)
    check_senders(1020, readings=255_000)
    with pytest.raises(LogError, match="at most 1090 power-ups"):
        check_boots(6000, records=90_000)
    with pytest.raises(LogError, match="at most 32000 power-ups"):
        check_boots(40_000, records=10**9)
    with pytest.raises(LogError, match="at most 500"):
        check_senders(501, readings=99)
