"""Rows that come in piece by piece and leave as one column, never both at once in memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.ingest.memory import room

SMALLEST, BLOCK = 4096, 1 << 20  # [bytes] of the first block, and of the largest


class Store:
    """Rows of one type in blocks that go back to the system when they are let go."""

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
                size = min(max(self._length * self.dtype.itemsize, SMALLEST), BLOCK)
                self._room = max(size // self.dtype.itemsize, 1)
                self._blocks.append(room(self._room, self.dtype))
            count = min(self._room, rows.shape[0] - done)
            first = self._blocks[-1].shape[0] - self._room
            self._blocks[-1][first : first + count] = rows[done : done + count]
            self._room -= count
            done += count
            self._length += count

    def blocks(self) -> Iterator[NDArray[Any]]:
        """The rows, some at a time; they may be written to."""
        for k, block in enumerate(self._blocks):
            yield block if k + 1 < len(self._blocks) else block[: block.shape[0] - self._room]

    def drained(self) -> Iterator[NDArray[Any]]:
        """The rows, some at a time; each block is let go when the next is asked for."""
        last, room = len(self._blocks) - 1, self._room
        blocks, self._blocks, self._room, self._length = self._blocks[::-1], [], 0, 0
        for k in range(last + 1):
            block = blocks.pop()
            yield block if k < last else block[: block.shape[0] - room]

    def whole(self) -> NDArray[Any]:
        """All rows as one array; the store is empty then.

        >>> store = Store(np.int64)
        >>> store.add(np.arange(3))
        >>> store.whole(), len(store)
        (array([0, 1, 2]), 0)
        """
        result, done = room(self._length, self.dtype), 0
        for block in self.drained():
            result[done : done + block.shape[0]] = block
            done += block.shape[0]
        return result
