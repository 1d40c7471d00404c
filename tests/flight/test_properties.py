"""Properties of clocks and quality that hold for whatever a log contains."""

import numpy as np
from hypothesis import given, settings, strategies
from hypothesis.extra.numpy import arrays

from tests.helpers import channel
from unbend.flight.clock import rows_in_time_order
from unbend.flight.evidence.quality import RANGES, mask_impossible_values

TIMES_NS = strategies.lists(strategies.integers(0, 60), max_size=80)
READINGS_PA = arrays(
    np.float64,
    40,
    elements=strategies.floats(-1e7, 1e7) | strategies.just(np.nan),
)


@given(TIMES_NS)
def test_rows_in_time_order_increase_strictly(times):
    time_ns = np.array(times, np.int64)
    rows, stretch = rows_in_time_order(time_ns)
    assert rows.shape == stretch.shape
    assert (np.diff(time_ns[rows]) > 0).all()
    assert bool(times) == bool(rows.size)


@settings(max_examples=60)
@given(READINGS_PA)
def test_masking_touches_no_plausible_value_and_counts_all_others_once(values):
    row = np.arange(40.0)
    logged = channel(
        "X",
        row,
        pressure_pa=values,
        row=row,
    )

    masked, notes = mask_impossible_values(logged)

    read_pa = values[masked["row"].astype(int)]
    pressure_pa = masked["pressure_pa"]
    is_kept = np.isfinite(pressure_pa)
    kept_pa = pressure_pa[is_kept]
    np.testing.assert_array_equal(kept_pa, read_pa[is_kept])
    if any(note.code == "SENSOR-ODD" for note in notes):
        return
    low, high = RANGES["pressure_pa"]
    assert (kept_pa >= low).all()
    assert (kept_pa <= high).all()
    lost = np.isfinite(values).sum() - kept_pa.size
    assert sum(note.count for note in notes if note.kind == "loss") == lost
