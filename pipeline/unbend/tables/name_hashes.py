"""Hashes of names in 64 bits, the same on every machine: all names may not fit into memory."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from unbend.units import Integers

Hashes = NDArray[np.uint64]

_FNV_BASIS = np.uint64(0xCBF29CE484222325)  # of FNV-1a with 64 bits
_FNV_PRIME = np.uint64(0x100000001B3)
_MIXING_FACTOR = np.uint64(0xD6E8FEB86659FD93)  # FNV-1a hardly changes the highest bits
_FILTER_SIZE = 1 << 20  # booleans, one for each value of a hash's last 20 bits: fit into a cache


def hashes_of(names: pa.StringArray) -> Hashes:
    """(n,) the 64-bit hash of each name, equal for equal names; null counts as an empty name.

    FNV-1a over the bytes of UTF-8, with the bits mixed at the end; 100 ns a name.
    """
    # Name k are the bytes from begin[k] to begin[k + 1] of Arrow's buffers.
    _, offsets, data = names.buffers()
    first_offset = 4 * names.offset  # bytes of int32 before a slice
    begin = np.frombuffer(
        offsets,
        np.int32,
        len(names) + 1,
        first_offset,
    )
    text = np.frombuffer(data or b"\0", np.uint8)
    length = np.diff(begin)
    bits = np.full(len(names), _FNV_BASIS, np.uint64)
    for place in range(length.max(initial=0)):
        rows = np.flatnonzero(length > place)
        letter = text[begin[rows] + place]
        bits[rows] = (bits[rows] ^ letter) * _FNV_PRIME
    bits = _folded(bits) * _MIXING_FACTOR
    return _folded(bits)


def _folded(bits: Hashes) -> Hashes:
    """(n,) bits with the upper 32 of each combined into the lower 32 by exclusive or."""
    upper = bits >> np.uint64(32)
    return np.asarray(bits ^ upper)


def rows_among(hashes: Hashes, wanted: Hashes) -> Integers:
    """Indices of the ``hashes`` (n,) that are among the ``wanted``.

    A filter by the last 20 bits leaves few for the exact comparison.
    """
    last_bits = np.uint64(_FILTER_SIZE - 1)  # a mask of 20 bits
    is_maybe_wanted = np.zeros(_FILTER_SIZE, np.bool_)
    is_maybe_wanted[wanted & last_bits] = True
    rows = np.flatnonzero(is_maybe_wanted[hashes & last_bits])
    return rows[np.isin(hashes[rows], wanted)]
