"""Memory for rows and columns: the process's own while they are few, of temporary files beyond.

The system writes the pages of a file out when it needs memory: so logs of many GB are read on
machines that have less, and what else runs there goes on. Nothing of the files is left behind, even
when the process is killed: they have no names.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

PRIVATE = 256 << 20  # [bytes] of rows and columns in memory of the process's own
REGION = 64 << 20  # [bytes] of a temporary file, at least
SMALL = 4096  # [bytes] that are left to the heap
_ALIGNED = 64  # [bytes]
_BLOCK = 65_536  # rows


class _Rooms:
    """What is held: ``private`` bytes in maps of their own, the others in ``regions`` of files."""

    def __init__(self) -> None:
        self.generation = 0
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what is held; in a child process, which shares the files of its parent."""
        self.lock = threading.RLock()  # the collector may give memory back while it is held
        self.generation += 1
        self.private = 0
        self.regions: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self.last: Callable[[], mmap.mmap | None] = lambda: None  # a region may be gone by now
        self.used = 0  # bytes of the last region

    def take(self, size: int) -> tuple[mmap.mmap, int]:
        """Memory for so many bytes, and where in it they begin."""
        with self.lock:
            if self.private + size > PRIVATE:
                found = self._of_a_file(size)
                if found is not None:
                    return found
            try:
                memory = mmap.mmap(-1, size, access=mmap.ACCESS_COPY)
            except OSError as error:
                raise MemoryError(f"no room for {size} bytes: {error.strerror}") from error
            self.private += size
            weakref.finalize(memory, self._give_back, size, self.generation).atexit = False
            return memory, 0

    def _give_back(self, size: int, generation: int) -> None:
        with self.lock:
            self.private -= size if generation == self.generation else 0

    def _of_a_file(self, size: int) -> tuple[mmap.mmap, int] | None:
        """Room in a temporary file; None where it cannot have any."""
        region = self.last()
        if region is None or self.used + size > len(region):
            self.let_go()
            region = _file(max(size, REGION))
            if region is None:
                return None
            self.regions.add(region)
            self.last, self.used = weakref.ref(region), 0
        begin = self.used
        self.used += -(-size // _ALIGNED) * _ALIGNED
        return region, begin

    def let_go(self) -> None:
        """Let the pages of the files stay there until they are touched."""
        with self.lock:
            for region in self.regions:
                region.madvise(mmap.MADV_DONTNEED)


def _file(size: int) -> mmap.mmap | None:
    """A map of a file that has no name, whose bytes are reserved; None where there is no room."""
    if not hasattr(os, "posix_fallocate") or not hasattr(mmap, "MADV_DONTNEED"):
        return None
    try:
        with tempfile.TemporaryFile() as file:
            os.posix_fallocate(file.fileno(), 0, size)
            return mmap.mmap(file.fileno(), size)
    except OSError:
        return None


_ROOMS = _Rooms()
os.register_at_fork(after_in_child=_ROOMS.begin_anew)


def room(count: int, dtype: DTypeLike) -> NDArray[Any]:
    """(count,) rows with any values in them.

    In memory of the process's own as long as it holds no more than `PRIVATE` so, else in a
    temporary file (of the folder ``TMPDIR``) if there is space for it. Either goes back to the
    system when the last array on it is gone: freed pieces of the heap between others that are still
    in use fit no column of a long log, and a process would keep about as much again as it needs.
    After a fork, parent and child see what the other writes to an array in a file.

    >>> column = room(3, "f8")
    >>> column[:] = 1.5
    >>> column.sum().item()
    4.5
    """
    kind = np.dtype(dtype)
    size = count * kind.itemsize
    if size < SMALL or kind.hasobject:
        return np.empty(count, kind)
    memory, begin = _ROOMS.take(size)
    return np.frombuffer(memory, kind, count, begin)


def moved(column: NDArray[Any], rows: NDArray[np.intp] | None = None) -> NDArray[Any]:
    """A column that is to stay, or some rows of it, in a `room` of its own.

    >>> moved(np.array([5, 6, 7]), np.array([2, 0])).tolist()
    [7, 5]
    """
    kept = room(
        column.shape[0] if rows is None else rows.shape[0], (column.dtype, column.shape[1:])
    )
    for begin in range(0, kept.shape[0], _BLOCK):
        block = slice(begin, begin + _BLOCK)
        kept[block] = column[block] if rows is None else column[rows[block]]
    return kept


def let_go() -> None:
    """Keep no pages of temporary files in memory for now; they come back when they are touched."""
    _ROOMS.let_go()
