"""Every cell of every message of every DataFlash log here, against pymavlink reading in order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary

from tests.ingest.dataflash.library import library_tables
from tests.logs import REAL, with_suffix
from unbend.ingest.dataflash.binary_log import read_tables
from unbend.ingest.message_tables import PLACE


def different(ours: np.ndarray, theirs: list[Any]) -> int:
    """How many cells of a column are not the same number or the same text."""
    if len(ours) != len(theirs):
        return max(len(ours), len(theirs))
    if ours.dtype.kind == "U":
        return sum(a != b for a, b in zip(ours.tolist(), theirs, strict=True))
    if ours.ndim == 2:  # arrays of numbers, and the bytes of files
        cells = [np.frombuffer(bytes(cell), ours.dtype) for cell in theirs]
        return int(np.count_nonzero(ours != np.array(cells)))
    expected = np.array(theirs, np.float64 if ours.dtype.kind == "f" else ours.dtype)
    values = ours.astype(expected.dtype)
    same = (values == expected) & (np.signbit(values) == np.signbit(expected))
    if ours.dtype.kind == "f":
        same |= np.isnan(values) & np.isnan(expected)
    return int(np.count_nonzero(~same))


@pytest.mark.parametrize("path", with_suffix(".bin"), ids=lambda path: path.name)
def test_every_cell_is_that_of_the_library(path, head, record_property):
    path = head(path, 4_000_000)
    theirs = library_tables(DFReader_binary(str(path)))
    ours = read_tables(path)
    for columns in ours.values():
        del columns[PLACE]
    assert set(ours) == set(theirs)
    cells = 0
    for message, columns in theirs.items():
        assert list(ours[message]) == list(columns), message
        for field, values in columns.items():
            wrong = different(ours[message][field], values)
            assert wrong == 0, f"{message}.{field}: {wrong} of {len(values)} cells differ"
            cells += len(values)
    record_property("cells compared", cells)


def test_logs_are_at_hand():
    assert len(with_suffix(".bin")) >= (9 if REAL.is_dir() else 4)


def test_one_changed_bit_in_a_cell_is_seen():
    values = np.array([1.5, np.nan, -0.0], np.float32)
    assert different(values, [1.5, float("nan"), -0.0]) == 0
    assert different(values, [1.5, float("nan"), 0.0]) == 1
    assert different(values, [np.nextafter(1.5, 2), float("nan"), -0.0]) == 1
    assert different(np.array([7], np.uint64), [8]) == 1
    assert different(np.array(["a"]), ["b"]) == 1
