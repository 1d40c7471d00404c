"""Properties of clocks and quality that hold for whatever a log contains."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.helpers import channel
from unbend.flight.clock import rows_in_time_order
from unbend.flight.evidence.quality import RANGES, mask_impossible_values


@given(st.lists(st.integers(0, 60), max_size=80))
def test_rows_in_time_order_increase_strictly(times):
    time_ns = np.array(times, np.int64)
    rows, stretch = rows_in_time_order(time_ns)
    assert rows.shape == stretch.shape
    assert (np.diff(time_ns[rows]) > 0).all()
    assert bool(times) == bool(rows.size)


@settings(max_examples=60)
@given(arrays(np.float64, 40, elements=st.floats(-1e7, 1e7) | st.just(np.nan)))
def test_masking_touches_no_plausible_value_and_counts_all_others_once(values):
    logged = channel("X", np.arange(40.0), pressure_pa=values, row=np.arange(40.0))
    masked, notes = mask_impossible_values(logged)
    kept = masked["row"].astype(int)
    pressure_pa = masked["pressure_pa"]
    known = np.isfinite(pressure_pa)
    np.testing.assert_array_equal(pressure_pa[known], values[kept][known])
    if any(note.code == "SENSOR-ODD" for note in notes):
        return
    low, high = RANGES["pressure_pa"]
    assert (pressure_pa[known] >= low).all()
    assert (pressure_pa[known] <= high).all()
    lost = np.isfinite(values).sum() - known.sum()
    assert sum(note.count for note in notes if note.kind == "loss") == lost
