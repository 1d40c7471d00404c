"""Hashes of names, against FNV-1a in plain Python and its published values."""

import numpy as np
import pyarrow as pa

from unbend.tables.name_hashes import hashes_of, rows_among

# From the reference of Fowler, Noll and Vo: FNV-1a of 64 bits.
OFFSET_BASIS = 0xCBF29CE484222325
PRIME = 0x100000001B3
PUBLISHED = {
    "": OFFSET_BASIS,
    "a": 0xAF63DC4C8601EC8C,
    "foobar": 0x85944171F73967E8,
}


def fnv_1a(name):
    bits = OFFSET_BASIS
    for byte in name.encode():
        bits ^= byte
        bits = bits * PRIME % 2**64
    return bits


def mixed(bits):
    bits ^= bits >> 32
    bits = bits * 0xD6E8FEB86659FD93 % 2**64
    return bits ^ bits >> 32


def test_hashes_are_those_of_plain_python():
    for name, published in PUBLISHED.items():
        assert fnv_1a(name) == published

    names = ["", "a", "foobar", "Straße", "p00000017", None, "p00000018"]
    expected = []
    for name in names:
        bits = fnv_1a(name or "")
        expected.append(mixed(bits))
    array = pa.array(names, pa.string())
    nulls = pa.array([None, None], pa.string())

    assert hashes_of(array).tolist() == expected
    assert hashes_of(array.slice(3, 3)).tolist() == expected[3:6]
    assert hashes_of(nulls).tolist() == [expected[0]] * 2


def test_names_that_count_are_spread_evenly():
    names = [f"p{number:07d}" for number in range(100_000)]

    hashes = hashes_of(pa.array(names))

    assert np.unique(hashes).size == 100_000
    bins = hashes % np.uint64(20)
    counts = np.bincount(bins.astype(int))
    five_sigma = 5 * np.sqrt(5000)  # of Poisson's distribution
    assert np.abs(counts - 5000).max() < five_sigma


def test_rows_among_are_those_of_a_set():
    rng = np.random.default_rng(1)
    hashes = rng.integers(0, 1 << 63, 5000)
    hashes = hashes.astype(np.uint64)
    wanted_rows = [7, 4000, 4001]
    same_last_24_bits = hashes[7] ^ np.uint64(1 << 40)
    hashes[100] = same_last_24_bits

    wanted = np.sort(hashes[wanted_rows])

    assert rows_among(hashes, wanted).tolist() == wanted_rows
