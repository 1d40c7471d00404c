"""A file seen through a window that moves along it: bytes anywhere, a few MiB of memory."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError

SPAN = 4 << 20  # bytes read at once; 1 to 16 MiB are equally fast
BEHIND = 4096  # bytes kept before the place asked for: who mends damage looks back

Bytes = NDArray[np.uint8]


class Window:
    """The bytes of a file, read in spans when they are asked for.

    Not a memory map: a file that is cut while it is mapped kills the process, and its pages count
    as the process's memory. A file that grows while it is read is read to where it ended.
    """

    def __init__(self, stream: io.FileIO | io.BytesIO, size: int, name: str = "") -> None:
        self.size = size
        self.name = name
        self._stream = stream
        self._begin = 0
        self._bytes: Bytes = np.empty(0, np.uint8)

    def array(self, begin: int, end: int) -> Bytes:
        """The bytes from ``begin`` to ``end`` or the end of the file; not to be written to."""
        end = min(end, self.size)
        if begin < self._begin or end > self._begin + self._bytes.shape[0]:
            self._load(max(begin - BEHIND, 0), end)
        return self._bytes[begin - self._begin : end - self._begin]

    def __getitem__(self, places: slice) -> bytes:
        """A short stretch as bytes."""
        return self.array(places.start, places.stop).tobytes()

    def find(self, mark: bytes, begin: int, end: int | None = None) -> int:
        """The first place of a mark that lies between two places, or -1."""
        end = self.size if end is None else min(end, self.size)
        while begin + len(mark) <= end:
            stop = min(begin + SPAN, end)
            found = self.array(begin, stop).tobytes().find(mark)
            if found >= 0:
                return begin + found
            begin = stop - len(mark) + 1
        return -1

    def _load(self, begin: int, end: int) -> None:
        length = min(max(end - begin, SPAN + 2 * BEHIND), self.size - begin)
        fetched = np.empty(length, np.uint8)
        self._stream.seek(begin)
        count = 0
        while count < length and (more := self._stream.readinto(fetched[count:].data)):
            count += more
        if count < length:
            raise LogError(
                "LOG-CHANGED",
                f"it had {self.size} bytes and now ends at byte {begin + count}",
                where=self.name,
                remedy="wait until the log is complete, and read it again",
            )
        self._begin, self._bytes = begin, fetched


@contextmanager
def window_on(path: Path) -> Iterator[Window]:
    """A window on a file, as long as the block lasts."""
    with path.open("rb", buffering=0) as stream:
        yield Window(stream, path.stat().st_size, str(path))


def window_of(data: bytes) -> Window:
    """A window on bytes in memory.

    >>> window_of(b"abcabc").find(b"c", 3)
    5
    """
    return Window(io.BytesIO(data), len(data))
