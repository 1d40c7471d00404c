"""Hashes of names, by which all rows of some points are found in tables of any length."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

Hashes = NDArray[np.uint64]


@lru_cache(maxsize=1)
def _compiled() -> Callable[..., Any]:
    """FNV-1a of each of many names, its bits mixed: 10 ns a name. numba is imported here."""
    from pipeline.refraction.kernels.jit import entry

    def fnv_1a(data, begin, found):  # type: ignore[no-untyped-def]
        for row in range(found.size):
            bits = np.uint64(0xCBF29CE484222325)
            for k in range(begin[row], begin[row + 1]):
                bits = (bits ^ np.uint64(data[k])) * np.uint64(0x100000001B3)
            bits = (bits ^ (bits >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
            found[row] = bits ^ (bits >> np.uint64(32))

    return entry(fnv_1a)


def hashes_of(names: pa.StringArray) -> Hashes:
    """(n,) 64 bits of each name, the same for the same name anywhere; null as an empty name."""
    _, offsets, data = names.buffers()
    begin = np.frombuffer(offsets, np.int32, len(names) + 1, 4 * names.offset)
    found = np.empty(len(names), np.uint64)
    _compiled()(np.frombuffer(data or b"\0", np.uint8), begin, found)
    return found


def rows_among(hashes: Hashes, wanted: Hashes) -> NDArray[np.int64]:
    """The rows whose hash is a wanted one; by their last 24 bits first, which leaves few."""
    maybe, mask = np.zeros(1 << 24, np.bool_), np.uint64((1 << 24) - 1)
    maybe[wanted & mask] = True
    rows = np.flatnonzero(maybe[hashes & mask])
    return rows[np.isin(hashes[rows], wanted)]
