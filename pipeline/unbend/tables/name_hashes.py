"""Names as numbers of 64 bits, the same everywhere: a table of names may be larger than memory."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from unbend.units import Integers

Hashes = NDArray[np.uint64]

_FNV_BASIS = np.uint64(0xCBF29CE484222325)  # of FNV-1a with 64 bits
_FNV_PRIME = np.uint64(0x100000001B3)
_MIXING_FACTOR = np.uint64(0xD6E8FEB86659FD93)  # FNV-1a hardly changes the highest bits
_LAST_BITS = 1 << 20  # of hashes: as many booleans fit into a cache


def hashes_of(names: pa.StringArray) -> Hashes:
    """(n,) 64 bits of each name, the same for the same name anywhere; null as an empty name.

    FNV-1a, letter by letter over all names (100 ns a name), and its bits mixed.
    """
    _, offsets, data = names.buffers()
    first_offset = 4 * names.offset
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
    """The upper half of the bits mixed into the lower."""
    upper = bits >> np.uint64(32)
    return np.asarray(bits ^ upper)


def rows_among(hashes: Hashes, wanted: Hashes) -> Integers:
    """The rows whose hash is a wanted one; by their last 20 bits first, which leaves few."""
    last_bits = np.uint64(_LAST_BITS - 1)
    is_maybe_wanted = np.zeros(_LAST_BITS, np.bool_)
    is_maybe_wanted[wanted & last_bits] = True
    rows = np.flatnonzero(is_maybe_wanted[hashes & last_bits])
    return rows[np.isin(hashes[rows], wanted)]
