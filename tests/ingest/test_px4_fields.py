"""PX4's cameras: which rows are exposures, and what their index is."""

import numpy as np

from unbend.flight.channels import Source
from unbend.ingest.channel_builder import DecodedRows, captured_rows
from unbend.messages import Ledger


def shots(result, index):
    columns = {
        "result": np.array(result),
        "event_index": np.array(index),
    }
    times_ns = np.arange(len(result))
    return DecodedRows(
        "C",
        Source("C"),
        times_ns,
        np.zeros(len(result), np.int16),
        columns,
    )


def test_only_images_that_failed_are_dropped():
    """CameraCapture.msg: 1 success, 0 failure, -1 a camera that does not answer."""
    ledger = Ledger()
    rows = captured_rows(
        shots(
            [1, 0, -1, 1, np.nan],
            [5, 6, 7, 8, 9],
        ),
        ledger,
    )
    assert rows.columns["event_index"].tolist() == [5, 7, 8, 9]
    assert "result" not in rows.columns
    assert [(e.kind, e.code, e.count) for e in ledger] == [("warning", "EVENT-FAILED", 1)]


def test_the_index_of_the_first_image_is_0():
    ledger = Ledger()
    assert captured_rows(shots([1], [0]), ledger).columns["event_index"].tolist() == [0]
    assert not list(ledger)
