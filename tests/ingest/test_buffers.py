"""Memory of rows and columns: the process's own while they are few, of temporary files beyond."""

import errno
import gc
import mmap
import os
import re
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.logs import LOGS
from unbend.ingest import buffers as memory
from unbend.ingest import open_log
from unbend.ingest.buffers import (
    BLOCK,
    REGION,
    SMALL,
    ColumnStore,
    allocate,
    copy_rows,
    release_pages,
)

MIB = 1 << 20
NUMBERS_OF_A_MIB = MIB // 8

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
needs_smaps = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="/proc/self/smaps is Linux's"
)


@pytest.fixture
def arena(monkeypatch):
    """An arena of its own, of which 1 MiB may be private."""
    fresh = memory._Arena()
    monkeypatch.setattr(memory, "_ARENA", fresh)
    monkeypatch.setattr(memory, "PRIVATE", MIB)
    return fresh


@pytest.fixture
def arena_in_files(arena, monkeypatch):
    """An arena of which nothing may be private."""
    monkeypatch.setattr(memory, "PRIVATE", 0)
    return arena


def held(arena):
    """Private bytes and regions, once what is unused has gone."""
    gc.collect()
    return arena.private, len(arena.regions)


def test_what_is_beyond_lies_in_files_and_goes_with_its_arrays(arena):
    private = allocate(NUMBERS_OF_A_MIB, "f8")
    assert held(arena) == (MIB, 0)
    columns = []
    for k in range(3):
        columns.append(allocate(NUMBERS_OF_A_MIB, "i8"))
        columns[k][:] = np.arange(k, k + NUMBERS_OF_A_MIB)
    assert held(arena) == (MIB, 1)
    release_pages()
    for k in range(3):
        assert_array_equal(columns[k], np.arange(k, k + NUMBERS_OF_A_MIB))
    del columns[1:]
    assert held(arena) == (MIB, 1)
    del private, columns
    assert held(arena) == (0, 0)


def test_no_two_arrays_share_a_byte(arena):
    sizes = (MIB, SMALL, SMALL + 1, 3 * SMALL, REGION, SMALL)
    arrays = [allocate(size, "u1") for size in sizes]
    for number, array in enumerate(arrays):
        array[:] = number
    for number, array in enumerate(arrays):
        assert array.min() == array.max() == number
    assert held(arena)[1] == 3


@pytest.mark.parametrize("count", [0, 1, 511])
def test_few_rows_are_left_to_the_heap(arena, count):
    assert allocate(count, [("at", "i8")]).shape == (count,)
    assert arena.private == 0


def test_the_files_have_no_names(arena, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    columns = [allocate(2 * NUMBERS_OF_A_MIB, "f8") for _ in range(2)]
    assert held(arena)[1] == 1
    assert not list(tmp_path.iterdir())
    del columns


def test_without_space_on_the_disk_memory_is_private(arena, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    column = allocate(2 * NUMBERS_OF_A_MIB, "f8")
    column[:] = 2.0
    assert held(arena) == (2 * MIB, 0)
    assert column.sum() == 4.0 * NUMBERS_OF_A_MIB


def exit_code(child):
    """Of a child process, which is ended where it hangs for 10 s."""
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, 9)
    os.waitpid(child, 0)
    raise AssertionError("the child process hung")


def fork(is_right: Callable[[], bool]):
    """Starts a child process, which ends with 0 where it finds this to be true."""
    with warnings.catch_warnings():  # of forks beside threads, which is what is tried here
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        code = 2
        try:
            code = 0 if is_right() else 1
        finally:
            os._exit(code)
    return child


@needs_fork
def test_a_child_process_writes_elsewhere(monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    before = allocate(2 * SMALL, "u1")
    before[:] = 1
    ready, go = os.pipe()

    def write():
        os.read(ready, 1)
        allocate(2 * SMALL, "u1")[:] = 7
        return True

    child = fork(write)
    after = allocate(2 * SMALL, "u1")
    after[:] = 2
    os.write(go, b"!")
    assert exit_code(child) == 0
    os.close(ready)
    os.close(go)
    assert set(before.tolist()) == {1}
    assert set(after.tolist()) == {2}


@needs_fork
def test_a_fork_while_another_thread_holds_the_lock(monkeypatch):
    """The child's copy of the lock belongs to a thread that is not there."""
    monkeypatch.setattr(memory, "PRIVATE", 0)
    locked = threading.Event()
    go = threading.Event()

    def hold():
        with memory._ARENA.lock:
            locked.set()
            go.wait()

    def use():
        release_pages()
        column = allocate(2 * SMALL, "u1")
        column[:] = 3
        return set(column.tolist()) == {3}

    other = threading.Thread(target=hold)
    other.start()
    locked.wait()
    try:
        assert exit_code(fork(use)) == 0
    finally:
        go.set()
        other.join()


@needs_fork
def test_what_a_child_inherits_is_not_its_own(monkeypatch):
    """It gives back memory that it never took: its count neither begins with it nor ends below."""
    monkeypatch.setattr(memory, "PRIVATE", 1 << 40)
    inherited = [allocate(MIB, "u1") for _ in range(3)]
    before = memory._ARENA.private
    assert before >= 3 * MIB

    def drop():
        counts = [memory._ARENA.private]
        new = allocate(MIB, "u1")
        inherited.clear()
        gc.collect()
        counts.append(memory._ARENA.private)
        del new
        gc.collect()
        counts.append(memory._ARENA.private)
        return counts == [0, MIB, 0]

    assert exit_code(fork(drop)) == 0
    assert memory._ARENA.private == before


@pytest.mark.parametrize("dtype", ["u1", "i2", "f8", [("at", "i8"), ("flag", "u1")]])
def test_arrays_in_files_begin_at_multiples_of_64_bytes(arena_in_files, dtype):
    sizes = (SMALL + 1, SMALL + 7, 2 * SMALL + 63, 5 * SMALL - 1, SMALL + 64, SMALL + 65)
    arrays = [allocate(size // np.dtype(dtype).itemsize + 1, dtype) for size in sizes]
    assert held(arena_in_files) == (0, 1)
    assert [array.ctypes.data % 64 for array in arrays] == [0] * len(sizes)


def resident(array):
    """Resident bytes of the mapping that holds an array."""
    place = array.ctypes.data
    is_its_mapping = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if borders := re.match(r"([0-9a-f]+)-([0-9a-f]+) ", line):
            is_its_mapping = int(borders[1], 16) <= place < int(borders[2], 16)
        elif is_its_mapping and line.startswith("Rss:"):
            return int(line.split()[1]) << 10
    raise AssertionError("no mapping holds the array")


@needs_smaps
def test_what_was_let_go_is_not_resident_and_comes_back(arena_in_files):
    rows = np.arange(4 * NUMBERS_OF_A_MIB)
    first = copy_rows(rows)
    second = copy_rows(rows[::-1])
    assert held(arena_in_files) == (0, 1)
    assert resident(first) >= 8 * MIB
    release_pages()
    assert resident(first) == 0
    assert first[1000] == 1000
    assert 0 < resident(first) < MIB
    assert_array_equal(first, rows)
    assert_array_equal(second, rows[::-1])


@needs_smaps
def test_a_new_region_lets_go_of_those_before(arena_in_files, monkeypatch):
    monkeypatch.setattr(memory, "REGION", MIB)
    first = allocate(MIB, "u1")
    first[:] = 5
    assert resident(first) == MIB
    second = allocate(MIB, "u1")
    second[:] = 6
    assert held(arena_in_files) == (0, 2)
    assert resident(first) == 0
    assert resident(second) == MIB
    assert first.min() == first.max() == 5
    assert second.min() == second.max() == 6


RANDOM = np.random.default_rng(6)
BLOCK_AND_MORE = 70_000  # rows; 65,536 are copied at once


@pytest.mark.parametrize("private", [0, 1 << 40])
@pytest.mark.parametrize(
    "column",
    [
        RANDOM.normal(size=BLOCK_AND_MORE),
        RANDOM.normal(size=(BLOCK_AND_MORE, 4)),
        RANDOM.integers(0, 9, (BLOCK_AND_MORE, 2, 3), "i2"),
        np.frombuffer(RANDOM.bytes(3 * BLOCK_AND_MORE), "S3"),
        RANDOM.normal(size=2 * BLOCK_AND_MORE)[::2],
    ],
    ids=["numbers", "vectors", "matrices", "bytes", "every second"],
)
def test_moved_columns_keep_their_rows(arena, monkeypatch, column, private):
    monkeypatch.setattr(memory, "PRIVATE", private)
    rows = RANDOM.integers(0, BLOCK_AND_MORE, BLOCK_AND_MORE - 1)
    for chosen in (None, rows, rows[:1], rows[:0]):
        copy = copy_rows(column, chosen)
        expected = column if chosen is None else column[chosen]
        assert copy.dtype == expected.dtype
        assert_array_equal(copy, expected, strict=True)
        assert not np.shares_memory(copy, column)


@pytest.mark.parametrize("wrong", [3000, -3001])
@pytest.mark.parametrize("place", [0, 20, 66_000])
def test_a_row_that_is_none_is_refused(wrong, place):
    rows = np.zeros(BLOCK_AND_MORE, int)
    rows[place] = wrong
    for column in (np.arange(3000), np.zeros((3000, 4)), np.array([None] * 3000)):
        with pytest.raises(IndexError, match=str(wrong)):
            copy_rows(column, rows)


def test_columns_of_objects_are_moved_as_objects(arena_in_files):
    things = [2**70, "text"] * 1000
    column = np.array(things, object)
    copy = copy_rows(column)
    assert copy.dtype == object
    assert copy.tolist() == things
    assert copy_rows(column, np.array([1999, 0])).tolist() == ["text", 2**70]
    assert held(arena_in_files) == (0, 0)


@pytest.mark.parametrize("size", [0, 1, BLOCK // 8, BLOCK // 8 + 1, 3 * BLOCK // 8])
@pytest.mark.parametrize(
    ("way", "is_emptied"), [("whole", True), ("drained", True), ("blocks", False)]
)
def test_what_is_stored_comes_back(arena, size, way, is_emptied):
    rows = np.arange(size)
    store = ColumnStore("i8")
    for part in np.array_split(rows, 7):
        store.add(part)
    assert len(store) == size
    if size > BLOCK // 4:
        assert held(arena)[1] >= 1
    parts = getattr(store, way)()
    if way == "whole":
        parts = [parts]
    assert_array_equal(np.concatenate([rows[:0], *parts]), rows)
    assert len(store) == (0 if is_emptied else size)


@pytest.mark.parametrize("suffix", [".bin", ".tlog", ".mcap"])
def test_a_log_is_the_same_wherever_its_columns_lie(arena_in_files, monkeypatch, suffix):
    path = LOGS[f"flight{suffix}"]
    with monkeypatch.context() as usual_limits:
        usual_limits.setattr(memory, "PRIVATE", 1 << 40)
        usual = open_log(path)
    monkeypatch.setattr(memory, "REGION", mmap.PAGESIZE)
    monkeypatch.setattr(memory, "SMALL", 1)
    spread = open_log(path)
    assert held(arena_in_files)[1] > 0 or suffix == ".bin"
    assert [c.name for c in spread.channels] == [c.name for c in usual.channels]
    for ours, theirs in zip(spread.channels, usual.channels, strict=True):
        assert_array_equal(ours.time_ns, theirs.time_ns)
        assert_array_equal(ours.boot, theirs.boot)
        for name, column in theirs.columns.items():
            assert_array_equal(ours[name], column)
    assert list(spread.ledger) == list(usual.ledger)
