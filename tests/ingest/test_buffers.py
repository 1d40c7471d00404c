"""Memory of rows and columns: the process's own while they are few, of temporary files beyond."""

from __future__ import annotations

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
from pathlib import Path

import numpy as np
import pytest

from unbend.ingest import buffers as memory
from unbend.ingest import open_log
from unbend.ingest.buffers import REGION, SMALL, ColumnStore, allocate, copy_rows, release_pages

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def rooms(monkeypatch):
    """Rooms of their own, of which 1 MiB may be private."""
    fresh = memory._Arena()
    monkeypatch.setattr(memory, "_ARENA", fresh)
    monkeypatch.setattr(memory, "PRIVATE", 1 << 20)
    return fresh


def held(rooms) -> tuple[int, int]:
    """Private bytes and regions, once what is unused has gone."""
    gc.collect()
    return rooms.private, len(rooms.regions)


def test_what_is_beyond_lies_in_files_and_goes_with_its_arrays(rooms):
    own = allocate(1 << 17, "f8")
    assert held(rooms) == (1 << 20, 0)
    several = [allocate(1 << 17, "i8") for _ in range(3)]
    for k, column in enumerate(several):
        column[:] = np.arange(k, k + (1 << 17))
    assert held(rooms) == (1 << 20, 1)
    release_pages()
    for k, column in enumerate(several):
        np.testing.assert_array_equal(column, np.arange(k, k + (1 << 17)))
    del several[1:], column
    assert held(rooms) == (1 << 20, 1)
    del own, several
    assert held(rooms) == (0, 0)


def test_no_two_arrays_share_a_byte(rooms):
    arrays = [
        allocate(size, "u1") for size in (1 << 20, SMALL, SMALL + 1, 3 * SMALL, REGION, SMALL)
    ]
    for number, array in enumerate(arrays):
        array[:] = number
    assert [set(np.unique(array).tolist()) for array in arrays] == [{k} for k in range(6)]
    assert held(rooms)[1] == 3


@pytest.mark.parametrize("count", [0, 1, 511])
def test_few_rows_are_left_to_the_heap(rooms, count):
    assert allocate(count, [("at", "i8")]).shape == (count,)
    assert rooms.private == 0


def test_the_files_have_no_names(rooms, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kept = [allocate(1 << 18, "f8") for _ in range(2)]
    assert held(rooms)[1] == 1
    assert not list(tmp_path.iterdir())
    assert kept[0].shape == kept[1].shape


def test_without_space_on_the_disk_memory_is_private(rooms, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    column = allocate(1 << 18, "f8")
    column[:] = 2.0
    assert held(rooms) == (1 << 21, 0)
    assert column.sum() == 2.0 * (1 << 18)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_child_process_writes_elsewhere(monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    mine = allocate(1 << 16, "f8")
    mine[:] = 1.0
    ready, go = os.pipe()
    child = os.fork()
    if not child:
        os.read(ready, 1)
        allocate(1 << 16, "f8")[:] = 7.0
        os._exit(0)
    after = allocate(1 << 16, "f8")
    after[:] = 2.0
    os.write(go, b"!")
    os.waitpid(child, 0)
    os.close(ready)
    os.close(go)
    assert set(mine.tolist()) == {1.0}
    assert set(after.tolist()) == {2.0}


def waited_for(child: int, seconds: float = 10.0) -> int:
    """The exit code of a child process, which is ended where it hangs."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, 9)
    os.waitpid(child, 0)
    raise AssertionError(f"the child process hung for {seconds:g} s")


def as_a_child(what) -> int:
    """The exit code of a child process in which this is run: 0 where it is true."""
    with warnings.catch_warnings():  # of forks beside threads, which is what is tried here
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        code = 2
        try:
            code = 0 if what() else 1
        finally:
            os._exit(code)
    return waited_for(child)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_while_another_thread_holds_the_lock(monkeypatch):
    """The child's copy of the lock belongs to a thread that is not there."""
    monkeypatch.setattr(memory, "PRIVATE", 0)
    locked = threading.Event()
    go = threading.Event()

    def hold() -> None:
        with memory._ARENA.lock:
            locked.set()
            go.wait()

    other = threading.Thread(target=hold)
    other.start()
    locked.wait()
    try:

        def use() -> bool:
            release_pages()
            column = allocate(1 << 16, "f8")
            column[:] = 3.0
            return bool(column.sum() == 3.0 * (1 << 16))

        assert as_a_child(use) == 0
    finally:
        go.set()
        other.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_what_a_child_inherits_is_not_its_own(monkeypatch):
    """It gives back memory that it never took: its count neither begins with it nor ends below."""
    monkeypatch.setattr(memory, "PRIVATE", 1 << 40)
    arrays = [allocate(1 << 16, "f8") for _ in range(3)]
    before = memory._ARENA.private
    assert before >= 3 << 19

    def drop() -> bool:
        counts = [memory._ARENA.private]
        own = allocate(1 << 16, "f8")
        arrays.clear()
        gc.collect()
        counts.append(memory._ARENA.private)
        del own
        gc.collect()
        counts.append(memory._ARENA.private)
        return counts == [0, 1 << 19, 0]

    assert as_a_child(drop) == 0
    assert memory._ARENA.private == before


@pytest.mark.parametrize("dtype", ["u1", "i2", "f8", [("at", "i8"), ("flag", "u1")]])
def test_arrays_in_files_begin_at_multiples_of_64_bytes(rooms, monkeypatch, dtype):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    sizes = (SMALL + 1, SMALL + 7, 2 * SMALL + 63, 5 * SMALL - 1, SMALL + 64, SMALL + 65)
    arrays = [allocate(-(-size // np.dtype(dtype).itemsize), dtype) for size in sizes]
    assert held(rooms) == (0, 1)
    assert [array.ctypes.data % 64 for array in arrays] == [0] * len(sizes)


def resident(array) -> int:
    """Resident bytes of the mapping that holds an array."""
    at = array.ctypes.data
    found = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if borders := re.match(r"([0-9a-f]+)-([0-9a-f]+) ", line):
            low, high = (int(border, 16) for border in borders.groups())
            found = low <= at < high
        elif found and line.startswith("Rss:"):
            return int(line.split()[1]) << 10
    raise AssertionError("no mapping holds the array")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc/self/smaps is Linux's")
def test_what_was_let_go_is_not_resident_and_comes_back(rooms, monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    rows = np.arange(1 << 19)  # 4 MiB
    columns = [copy_rows(rows), copy_rows(rows[::-1])]
    assert held(rooms) == (0, 1)
    assert resident(columns[0]) >= 8 << 20
    release_pages()
    assert resident(columns[0]) == 0
    assert columns[0][1000] == 1000
    assert 0 < resident(columns[0]) < 1 << 20
    np.testing.assert_array_equal(columns[0], rows)
    np.testing.assert_array_equal(columns[1], rows[::-1])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc/self/smaps is Linux's")
def test_a_new_region_lets_go_of_those_before(rooms, monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    monkeypatch.setattr(memory, "REGION", 1 << 20)
    first = allocate(1 << 17, "f8")
    first[:] = 5.0
    assert resident(first) == 1 << 20
    second = allocate(1 << 17, "f8")
    second[:] = 6.0
    assert held(rooms) == (0, 2)
    assert (resident(first), resident(second)) == (0, 1 << 20)
    assert (set(first.tolist()), set(second.tolist())) == ({5.0}, {6.0})


# ---- columns that are moved


@pytest.mark.parametrize("block", [7, 65_536])
@pytest.mark.parametrize("private", [0, 1 << 40])
def test_moved_columns_keep_their_rows(rooms, monkeypatch, block, private):
    monkeypatch.setattr(memory, "_COPIED_ROWS", block)
    monkeypatch.setattr(memory, "PRIVATE", private)
    rng = np.random.default_rng(6)
    rows = rng.integers(0, 3000, 2500)
    for column in (
        rng.normal(size=3000),
        rng.normal(size=(3000, 4)),
        rng.integers(0, 9, (3000, 2, 3), "i2"),
        np.frombuffer(rng.bytes(9000), "S3"),
        rng.normal(size=6000)[::2],
    ):
        for chosen in (None, rows, rows[:1], rows[:0]):
            found = copy_rows(column, chosen)
            expected = column if chosen is None else column[chosen]
            assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
            np.testing.assert_array_equal(found, expected)
            assert not np.shares_memory(found, column)


@pytest.mark.parametrize("wrong", [3000, -3001])
@pytest.mark.parametrize("at", [0, 20, 2499])
def test_a_row_that_is_none_is_refused(rooms, monkeypatch, wrong, at):
    monkeypatch.setattr(memory, "_COPIED_ROWS", 7)
    rows = np.arange(2500)
    rows[at] = wrong
    for column in (np.arange(3000), np.zeros((3000, 4)), np.array([None] * 3000)):
        with pytest.raises(IndexError, match=str(wrong)):
            copy_rows(column, rows)


def test_columns_of_objects_are_moved_as_objects(rooms, monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    things = [2**70 + k if k % 3 else f"text {k}" for k in range(2000)]
    column = np.array(things, object)
    found = copy_rows(column)
    assert found.dtype == object
    assert found.tolist() == things
    assert copy_rows(column, np.array([1999, 0])).tolist() == [things[1999], things[0]]
    assert held(rooms) == (0, 0)
    del column, things
    gc.collect()
    assert found[0] == "text 0"


def test_a_store_in_a_file_gives_back_what_it_took(rooms):
    rows = np.arange(1 << 20)
    store = ColumnStore("i8")
    for part in np.array_split(rows, 7):
        store.add(part)
    assert held(rooms)[1] >= 1
    np.testing.assert_array_equal(store.whole(), rows)


@pytest.mark.parametrize("suffix", [".bin", ".tlog", ".mcap"])
def test_a_log_is_the_same_wherever_its_columns_lie(rooms, monkeypatch, suffix):
    path = ROOT / "sample_logs" / f"flight{suffix}"
    usual = open_log(path)
    monkeypatch.setattr(memory, "PRIVATE", 0)
    monkeypatch.setattr(memory, "REGION", mmap.PAGESIZE)
    monkeypatch.setattr(memory, "SMALL", 1)
    spread = open_log(path)
    assert held(rooms)[1] > 0 or suffix == ".bin"
    assert [c.name for c in spread.channels] == [c.name for c in usual.channels]
    for one, other in zip(spread.channels, usual.channels, strict=True):
        np.testing.assert_array_equal(one.time_ns, other.time_ns)
        np.testing.assert_array_equal(one.boot, other.boot)
        for name, column in other.columns.items():
            np.testing.assert_array_equal(one[name], column)
    assert list(spread.ledger) == list(usual.ledger)
