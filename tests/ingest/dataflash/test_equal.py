"""Every cell of every message of every DataFlash log here, against pymavlink reading in order."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pymavlink.DFReader import DFReader_binary

from tests.ingest.dataflash.library import library_tables
from tests.logs import REAL, with_suffix
from unbend.ingest.dataflash.binary_log import read_tables
from unbend.ingest.message_tables import PLACE


def assert_same(ours, theirs, name):
    """The cells of a column are the same texts or numbers, of the same sign where they are 0."""
    if ours.dtype.kind == "U":
        assert ours.tolist() == theirs, name
        return
    if ours.ndim == 2:  # arrays of numbers, and the bytes of files
        theirs = [np.frombuffer(bytes(cell), ours.dtype) for cell in theirs]
    expected = np.array(
        theirs,
        np.float64 if ours.dtype.kind == "f" else ours.dtype,
    )
    assert_array_equal(ours, expected, name)
    are_zero = ours == 0
    assert_array_equal(
        np.signbit(ours[are_zero]),
        np.signbit(expected[are_zero]),
        name,
    )


@pytest.mark.parametrize(
    "path",
    with_suffix(".bin"),
    ids=lambda path: path.name,
)
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
            assert_same(ours[message][field], values, f"{message}.{field}")
            cells += len(values)
    record_property("cells compared", cells)


def test_logs_are_at_hand():
    assert len(with_suffix(".bin")) >= (9 if REAL.is_dir() else 4)
