"""Memory of rows and columns: the process's own while they are few, of temporary files beyond."""

from __future__ import annotations

import errno
import gc
import mmap
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from pipeline.ingest import memory, open_log
from pipeline.ingest.memory import REGION, SMALL, let_go, room
from pipeline.ingest.store import Store

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def rooms(monkeypatch):
    """Rooms of their own, of which 1 MiB may be private."""
    fresh = memory._Rooms()
    monkeypatch.setattr(memory, "_ROOMS", fresh)
    monkeypatch.setattr(memory, "PRIVATE", 1 << 20)
    return fresh


def held(rooms) -> tuple[int, int]:
    """Private bytes and regions, once what is unused has gone."""
    gc.collect()
    return rooms.private, len(rooms.regions)


def test_what_is_beyond_lies_in_files_and_goes_with_its_arrays(rooms):
    own = room(1 << 17, "f8")
    assert held(rooms) == (1 << 20, 0)
    several = [room(1 << 17, "i8") for _ in range(3)]
    for k, column in enumerate(several):
        column[:] = np.arange(k, k + (1 << 17))
    assert held(rooms) == (1 << 20, 1)
    let_go()
    for k, column in enumerate(several):
        np.testing.assert_array_equal(column, np.arange(k, k + (1 << 17)))
    del several[1:], column
    assert held(rooms) == (1 << 20, 1)
    del own, several
    assert held(rooms) == (0, 0)


def test_no_two_arrays_share_a_byte(rooms):
    arrays = [room(size, "u1") for size in (1 << 20, SMALL, SMALL + 1, 3 * SMALL, REGION, SMALL)]
    for number, array in enumerate(arrays):
        array[:] = number
    assert [set(np.unique(array).tolist()) for array in arrays] == [{k} for k in range(6)]
    assert held(rooms)[1] == 3


@pytest.mark.parametrize("count", [0, 1, 511])
def test_few_rows_are_left_to_the_heap(rooms, count):
    assert room(count, [("at", "i8")]).shape == (count,)
    assert rooms.private == 0


def test_the_files_have_no_names(rooms, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kept = [room(1 << 18, "f8") for _ in range(2)]
    assert held(rooms)[1] == 1
    assert not list(tmp_path.iterdir())
    assert kept[0].shape == kept[1].shape


def test_without_space_on_the_disk_memory_is_private(rooms, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    column = room(1 << 18, "f8")
    column[:] = 2.0
    assert held(rooms) == (1 << 21, 0)
    assert column.sum() == 2.0 * (1 << 18)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_child_process_writes_elsewhere(monkeypatch):
    monkeypatch.setattr(memory, "PRIVATE", 0)
    mine = room(1 << 16, "f8")
    mine[:] = 1.0
    ready, go = os.pipe()
    child = os.fork()
    if not child:
        os.read(ready, 1)
        room(1 << 16, "f8")[:] = 7.0
        os._exit(0)
    after = room(1 << 16, "f8")
    after[:] = 2.0
    os.write(go, b"!")
    os.waitpid(child, 0)
    os.close(ready)
    os.close(go)
    assert set(mine.tolist()) == {1.0}
    assert set(after.tolist()) == {2.0}


def test_a_store_in_a_file_gives_back_what_it_took(rooms):
    rows = np.arange(1 << 20)
    store = Store("i8")
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
