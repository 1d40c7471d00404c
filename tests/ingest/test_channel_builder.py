"""Decoded rows -> channels: what is dropped, how that is entered, and what is left."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.flight.channels import Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.field_maps import MessageMap, parse_columns
from unbend.messages import Kind, Ledger

SHOT = MessageMap(
    tuple(parse_columns(["lat_rad lon_rad = lat lon [deg]", "h_msl_m = alt"], {})),
    ("events",),
)
BARO = MessageMap(
    tuple(parse_columns(["pressure_pa = p [hPa]"], {})), ("pressure",), 10, spare_rank=20
)


def rows(time_s: list[float], **columns: list[float]) -> DecodedRows:
    time_ns = np.array([round(t * 1e9) for t in time_s], np.int64)
    arrays = {name: np.array(values, np.float64) for name, values in columns.items()}
    return DecodedRows("X", Source("X", "1"), time_ns, np.zeros(len(time_s), np.int16), arrays)


@pytest.mark.parametrize(("spec", "kind"), [(SHOT, Kind.LOSS), (BARO, Kind.NOTE)])
def test_a_repeated_exposure_is_a_loss_a_repeated_reading_is_none(spec, kind):
    ledger = Ledger()
    channel = channel_of(rows([1, 2, 2, 3], pressure_pa=[1, 2, 3, 4]), spec, ledger)
    assert channel is not None
    assert channel["pressure_pa"].tolist() == [1, 2, 4]
    assert [(e.kind, e.code, e.count) for e in ledger] == [(kind, "TIME-REPEAT", 1)]


def test_an_exposure_without_a_place_has_no_height_either():
    place = {"lat_rad": [0.8, 0.0, 0.8], "lon_rad": [0.1, 0.0, 0.0], "h_msl_m": [5.0, 0.0, 6.0]}
    channel = channel_of(rows([1, 2, 3], **place), SHOT, Ledger())
    assert channel is not None
    np.testing.assert_array_equal(channel["lat_rad"], [0.8, np.nan, 0.8])
    np.testing.assert_array_equal(channel["lon_rad"], [0.1, np.nan, 0.0])
    np.testing.assert_array_equal(channel["h_msl_m"], [5.0, np.nan, 6.0])


def test_the_largest_integer_is_no_place_of_an_exposure():
    largest_rad = np.radians(214.7483647)
    pole_rad = np.radians(90.0)
    place = {
        "lat_rad": [0.8, largest_rad, -pole_rad],
        "lon_rad": [0.1, largest_rad, np.pi],
        "h_msl_m": [5.0, 2_147_483.647, 6.0],
    }
    channel = channel_of(rows([1, 2, 3], **place), SHOT, Ledger())
    assert channel is not None
    for name in place:
        assert np.isnan(channel[name]).tolist() == [False, True, False]


def test_exposures_are_numbered_after_repeats_and_before_rows_out_of_order_are_dropped():
    ledger = Ledger()
    times = [1, 2, 2, 3, 4, 5, 6, 2.5, 7, 8]
    channel = channel_of(rows(times, h_msl_m=list(range(10))), SHOT, ledger)
    assert channel is not None
    assert channel["h_msl_m"].tolist() == [0, 1, 3, 4, 5, 6, 8, 9]
    assert channel["event_index"].tolist() == [0, 1, 2, 3, 4, 5, 7, 8]
    assert {e.code: e.count for e in ledger} == {"TIME-REPEAT": 1, "TIME-BACKWARD": 1}


def test_a_channel_knows_the_units_in_which_it_was_logged():
    channel = channel_of(rows([1], pressure_pa=[81_250.0]), BARO, Ledger())
    assert channel is not None
    assert channel.logged_units == {"pressure_pa": "hPa"}
    assert (channel.rank, channel.roles) == (20, ("pressure",))


@given(st.lists(st.integers(0, 60), min_size=1, max_size=60))
def test_times_rise_and_every_row_that_is_missing_is_counted(seconds):
    ledger = Ledger()
    values = list(range(len(seconds)))
    channel = channel_of(rows([float(s) for s in seconds], pressure_pa=values), BARO, ledger)
    assert channel is not None
    assert np.all(np.diff(channel.time_ns) > 0)
    dropped = sum(e.count or 0 for e in ledger if e.code in ("TIME-REPEAT", "TIME-BACKWARD"))
    assert len(channel) + dropped == len(seconds)
    kept = channel["pressure_pa"].astype(int)
    back = {e.code for e in ledger} & {"TIME-SET-BACK"}
    if not back:  # each value keeps the time of its row
        assert [seconds[k] for k in kept] == (channel.time_ns // 10**9).tolist()
