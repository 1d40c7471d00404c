"""Bytes of a file, and memory for the rows and columns that are made of them.

Columns are in the process's own memory while they are few; further ones are in temporary files.
The system writes the pages of a file out when it needs memory, so that logs of many GB are read on
machines that have less, and other programs go on. The files disappear with the process.
"""

import io
import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from unbend.ingest import messages
from unbend.units import Integers, Rows

SPAN = 4 << 20  # [bytes] read at once; 1 to 16 MiB are equally fast
BEHIND = 4096  # [bytes] kept before the place asked for: recovery after damage steps back
PRIVATE = 256 << 20  # [bytes] of rows and columns in memory of the process's own
REGION = 64 << 20  # [bytes] of a temporary file, at least
SMALL = 4096  # [bytes]: smaller arrays are left to the heap
BLOCK = 1 << 20  # [bytes] of the largest block of a `ColumnStore`
_SMALLEST_BLOCK = 4096  # [bytes]
_ALIGNED = 64  # [bytes]
_COPIED_ROWS = 65_536  # at once

Bytes = NDArray[np.uint8]


class FileView:
    """The bytes of a file, up to the ``size`` that it had when it was opened, read when asked for.

    A span of some MB is kept. A memory map is not used, because a file that is cut while it is
    mapped ends the process.
    """

    def __init__(
        self,
        stream: io.FileIO | io.BytesIO,
        size: int,
        name: str = "",
    ) -> None:
        self.size = size
        self.name = name
        self._stream = stream
        self._begin = 0
        self._bytes: Bytes = np.empty(0, np.uint8)

    def array(self, begin: int, end: int) -> Bytes:
        """The bytes from ``begin`` to ``end``, or to the end of the file; for reading only."""
        end = min(end, self.size)
        kept_end = self._begin + self._bytes.shape[0]
        if begin < self._begin or end > kept_end:
            span_begin = max(begin - BEHIND, 0)
            self._bytes = self._read(span_begin, end)
            self._begin = span_begin
        return self._bytes[begin - self._begin : end - self._begin]

    def _read(self, begin: int, end: int) -> Bytes:
        """A span of the file from ``begin`` on, at least to ``end``.

        Raises LogError if the file has become shorter.
        """
        usual_length = SPAN + 2 * BEHIND  # with `BEHIND` bytes on both sides of the bytes asked for
        wanted_length = max(end - begin, usual_length)
        length = min(wanted_length, self.size - begin)
        span = np.empty(length, np.uint8)
        self._stream.seek(begin)
        count = 0
        while count < length:
            more = self._stream.readinto(span[count:].data)
            if not more:
                raise messages.log_changed(path=self.name, size=self.size, end=begin + count)
            count += more
        return span

    def __getitem__(self, places: slice) -> bytes:
        """A short stretch of the file as bytes, copied; ``places`` must have a start and a stop."""
        return self.array(places.start, places.stop).tobytes()

    def find(self, mark: bytes, begin: int, end: int | None = None) -> int:
        """The first place from which a mark is in the file, completely between two places; else -1.

        ``end`` None means the end of the file.
        """
        end = self.size if end is None else min(end, self.size)
        while begin + len(mark) <= end:
            stop = min(begin + SPAN, end)
            place = self.array(begin, stop).tobytes().find(mark)
            if place >= 0:
                return begin + place
            begin = stop - len(mark) + 1  # a mark may cross the border of two spans
        return -1


@contextmanager
def open_view(path: Path) -> Iterator[FileView]:
    """A view of a file, open until the end of the with statement."""
    with path.open("rb", buffering=0) as stream:
        yield FileView(stream, path.stat().st_size, str(path))


def view_of_bytes(data: bytes) -> FileView:
    """A view of bytes in memory.

    >>> view_of_bytes(b"abcabc").find(b"c", 3)
    5
    """
    return FileView(io.BytesIO(data), len(data))


def gather(data: NDArray[np.uint8], places: NDArray[Any], size: int) -> NDArray[Any]:
    """(n,) void items: ``size`` bytes of the data from each of (n,) places on.

    All of these bytes must be in the data.

    >>> gather(np.frombuffer(b"abcdef", np.uint8), np.array([3, 0]), 2).view("S2")
    array([b'de', b'ab'], dtype='|S2')
    """
    count = max(data.shape[0] - size + 1, 0)
    # an item at every byte, overlapping, without a copy; then one copy of those at the places
    all_items: NDArray[Any] = np.ndarray(
        shape=(count,),
        dtype=f"V{size}",
        buffer=data,
        strides=(1,),
    )
    items: NDArray[Any] = all_items[places]
    return items


class Runs:
    """Candidates for messages, and the runs of candidates that follow each other without a gap.

    at : (n,) places where messages may begin, rising.
    end : (n,) the place behind the last byte of each.

    >>> Runs(np.array([0, 4, 9]), np.array([4, 8, 12])).starting_at(0)
    slice(0, 2, None)
    """

    def __init__(self, at: Integers, end: Integers) -> None:
        self.at = at
        self.end = end
        next_at = np.append(at[1:], -1)  # -1 equals no end: the last message of all ends a run
        self._breaks = np.flatnonzero(next_at != end)  # (k,) row of the last message of each run

    def starting_at(self, place: int) -> slice:
        """The rows of the run of messages from ``place`` on; empty if no message begins there."""
        first = int(np.searchsorted(self.at, place))
        if first == self.at.shape[0] or self.at[first] != place:
            return slice(first, first)
        break_behind = np.searchsorted(self._breaks, first)
        last = int(self._breaks[break_behind])
        return slice(first, last + 1)


class _Arena:
    """Memory of columns: ``private`` bytes of the process; ``regions``, maps of temporary files.

    Each piece of private memory is a map of its own, and returns to the system when it is freed.
    """

    def __init__(self) -> None:
        self.generation = 0
        self.reset()

    def reset(self) -> None:
        """Forget all memory: a child process must not take more from the files of its parent."""
        self.lock = threading.RLock()  # the collector may free memory while it is held
        self.generation += 1
        self.private = 0
        self.regions: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self.last: Callable[[], mmap.mmap | None] = lambda: None  # a region may be freed by now
        self.used = 0  # bytes of the last region

    def take(self, size: int) -> tuple[mmap.mmap, int]:
        """Memory with ``size`` free bytes, and the place in it where these begin.

        Private memory up to `PRIVATE` bytes, and beyond if the disk has no space for a file.
        """
        with self.lock:
            if self.private + size > PRIVATE:
                region = self._region_with(size)
                if region is not None:
                    begin = self.used
                    self.used += -(-size // _ALIGNED) * _ALIGNED  # rounded up
                    return region, begin
            return self._take_private(size), 0

    def _region_with(self, size: int) -> mmap.mmap | None:
        """The last region if it has room, else a new one; None without space on the disk.

        Before a new one is made, the pages of all others may be written out.
        """
        region = self.last()
        if region is not None and self.used + size <= len(region):
            return region
        self.release_pages()
        region = _mapped_file(max(size, REGION))
        if region is not None:
            self.regions.add(region)
            self.last = weakref.ref(region)
            self.used = 0
        return region

    def _take_private(self, size: int) -> mmap.mmap:
        """Memory of the process's own."""
        # A child process shares the pages until either writes to them.
        access = mmap.ACCESS_COPY if hasattr(os, "fork") else mmap.ACCESS_WRITE
        try:
            memory = mmap.mmap(-1, size, access=access)
        except OSError as error:
            raise MemoryError(f"no memory for {size} bytes: {error.strerror}") from error
        self.private += size
        finalizer = weakref.finalize(memory, self._free, size, self.generation)
        finalizer.atexit = False  # at exit the system frees the memory
        return memory

    def _free(self, size: int, generation: int) -> None:
        """Subtract private memory that was freed, unless a fork has begun a new generation."""
        with self.lock:
            if generation == self.generation:
                self.private -= size

    def release_pages(self) -> None:
        """Let the system write the pages of the files out; they are read again on use."""
        if hasattr(mmap, "MADV_DONTNEED"):  # Windows trims them when it needs memory
            with self.lock:
                for region in self.regions:
                    region.madvise(mmap.MADV_DONTNEED)


def _mapped_file(size: int) -> mmap.mmap | None:
    """A map of a temporary file with its bytes reserved on the disk; None without space."""
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:  # macOS, Windows: a page without space on the disk would end the process
                for begin in range(0, size, SPAN):
                    file.write(bytes(min(SPAN, size - begin)))
                file.flush()
            return mmap.mmap(file.fileno(), size)
    except OSError:
        return None


_ARENA = _Arena()
if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_ARENA.reset)


def allocate(count: int, dtype: DTypeLike) -> NDArray[Any]:
    """An array of (count,) rows that are not initialized.

    Up to `PRIVATE` bytes are the process's own, further ones in a temporary file (of ``TMPDIR``) if
    there is space; both return to the system with the last array on them. After a fork, parent and
    child see what the other writes to an array in a file.

    >>> column = allocate(3, "f8")
    >>> column[:] = 1.5
    >>> column.sum().item()
    4.5
    """
    kind = np.dtype(dtype)
    size = count * kind.itemsize
    if size < SMALL or kind.hasobject:
        return np.empty(count, kind)
    memory, begin = _ARENA.take(size)
    return np.frombuffer(memory, kind, count, offset=begin)


def copy_rows(column: NDArray[Any], rows: Rows | None = None) -> NDArray[Any]:
    """A copy of a column, or of some rows of it, in memory of `allocate`.

    >>> copy_rows(np.array([5, 6, 7]), np.array([2, 0])).tolist()
    [7, 5]
    """
    count = column.shape[0] if rows is None else rows.shape[0]
    type_of_row = (column.dtype, column.shape[1:])  # a row may be an array itself
    copy = allocate(count, type_of_row)
    for begin in range(0, count, _COPIED_ROWS):
        block = slice(begin, begin + _COPIED_ROWS)
        copy[block] = column[block] if rows is None else column[rows[block]]
    return copy


def release_pages() -> None:
    """Keep no pages of temporary files in memory; they are read again when they are used."""
    _ARENA.release_pages()


class ColumnStore:
    """Rows of one type, added piece by piece, in blocks that are freed one by one."""

    def __init__(self, dtype: DTypeLike) -> None:
        self.dtype = np.dtype(dtype)
        self._blocks: list[NDArray[Any]] = []
        self._room = 0  # free rows of the last block
        self._length = 0

    def __len__(self) -> int:
        return self._length

    def add(self, rows: NDArray[Any]) -> None:
        """Append rows, converted to the type of this store."""
        done = 0
        while done < rows.shape[0]:
            if not self._room:
                self._add_block()
            count = min(self._room, rows.shape[0] - done)
            block = self._blocks[-1]
            first_free = block.shape[0] - self._room
            block[first_free : first_free + count] = rows[done : done + count]
            self._room -= count
            done += count
            self._length += count

    def _add_block(self) -> None:
        """Append a block as large as all rows so far, between `_SMALLEST_BLOCK` and `BLOCK`."""
        size_so_far = self._length * self.dtype.itemsize
        size = min(max(size_so_far, _SMALLEST_BLOCK), BLOCK)
        self._room = max(size // self.dtype.itemsize, 1)
        self._blocks.append(allocate(self._room, self.dtype))

    def blocks(self) -> Iterator[NDArray[Any]]:
        """The rows that were added, block by block; they may be changed in place."""
        yield from self._blocks[:-1]
        if self._blocks:
            last = self._blocks[-1]
            yield last[: last.shape[0] - self._room]

    def drained(self) -> Iterator[NDArray[Any]]:
        """The rows, block by block; empties the store, so that each block is freed after use."""
        blocks = self._blocks[::-1]  # reversed: pop() takes them from the end
        free_rows = self._room
        self._blocks = []
        self._room = 0
        self._length = 0
        while blocks:
            block = blocks.pop()
            is_last = not blocks
            if is_last:
                block = block[: block.shape[0] - free_rows]
            yield block

    def whole(self) -> NDArray[Any]:
        """All rows as one array; empties the store.

        >>> store = ColumnStore(np.int64)
        >>> store.add(np.arange(3))
        >>> store.whole(), len(store)
        (array([0, 1, 2]), 0)
        """
        result = allocate(self._length, self.dtype)
        done = 0
        for block in self.drained():
            result[done : done + block.shape[0]] = block
            done += block.shape[0]
        return result
