"""Hashes of names, against FNV-1a in plain Python and its published values."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from unbend.tables.name_hashes import hashes_of, rows_among

# From the reference of Fowler, Noll and Vo: FNV-1a of 64 bits.
PUBLISHED = {"": 0xCBF29CE484222325, "a": 0xAF63DC4C8601EC8C, "foobar": 0x85944171F73967E8}


def fnv_1a(name: str) -> int:
    bits = 0xCBF29CE484222325
    for byte in name.encode():
        bits = (bits ^ byte) * 0x100000001B3 % (1 << 64)
    return bits


def mixed(bits: int) -> int:
    bits = (bits ^ bits >> 32) * 0xD6E8FEB86659FD93 % (1 << 64)
    return bits ^ bits >> 32


def test_hashes_are_those_of_plain_python():
    assert {name: fnv_1a(name) for name in PUBLISHED} == PUBLISHED
    names = ["", "a", "foobar", "Straße", "p00000017", None, "p00000018"]
    expected = [mixed(fnv_1a(name or "")) for name in names]
    assert hashes_of(pa.array(names, pa.string())).tolist() == expected
    assert hashes_of(pa.array(names, pa.string()).slice(3, 3)).tolist() == expected[3:6]
    assert hashes_of(pa.array([None, None], pa.string())).tolist() == expected[:1] * 2


def test_names_that_count_are_spread_evenly():
    hashes = hashes_of(pa.array([f"p{k:07d}" for k in range(100_000)]))
    assert np.unique(hashes).size == 100_000
    counts = np.bincount((hashes % np.uint64(20)).astype(int))
    assert np.abs(counts - 5000).max() < 5 * np.sqrt(5000)  # five sigma of Poisson's


def test_rows_among_are_those_of_a_set():
    rng = np.random.default_rng(1)
    hashes = rng.integers(0, 1 << 63, 5000).astype(np.uint64)
    hashes[100] = hashes[7] ^ np.uint64(1 << 40)  # the same last 24 bits
    wanted = hashes[[7, 4000, 4001]]
    of_set = set(wanted.tolist())
    expected = [k for k, value in enumerate(hashes.tolist()) if value in of_set]
    assert rows_among(hashes, np.sort(wanted)).tolist() == expected == [7, 4000, 4001]
