"""Decoded rows -> channels: what is dropped, how that is entered, and what is left."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from unbend.flight.channels import Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.field_maps import MessageMap, parse_columns
from unbend.messages import Kind, Ledger

SHOT_COLUMNS = parse_columns(["lat_rad lon_rad = lat lon [deg]", "h_msl_m = alt"], {})
SHOT = MessageMap(tuple(SHOT_COLUMNS), ("events",))
BARO_COLUMNS = parse_columns(["pressure_pa = p [hPa]"], {})
BARO = MessageMap(
    tuple(BARO_COLUMNS),
    ("pressure",),
    rank=10,
    spare_rank=20,
)


def built(spec, time_s, **columns):
    """The channel of the second instance of a message, and what is told of it."""
    time_ns = np.round(np.array(time_s) * 1e9).astype(np.int64)
    arrays = {name: np.array(values, np.float64) for name, values in columns.items()}
    boot = np.zeros(len(time_s), np.int16)
    ledger = Ledger()
    channel = channel_of(
        DecodedRows(
            "X",
            Source("X", "1"),
            time_ns,
            boot,
            arrays,
        ),
        spec,
        ledger,
    )
    assert channel is not None
    return channel, ledger


@pytest.mark.parametrize(
    ("spec", "kind"),
    [(SHOT, Kind.LOSS), (BARO, Kind.NOTE)],
)
def test_a_repeated_exposure_is_a_loss_a_repeated_reading_is_none(spec, kind):
    channel, ledger = built(
        spec,
        [1, 2, 2, 3],
        pressure_pa=[1, 2, 3, 4],
    )
    assert channel["pressure_pa"].tolist() == [1, 2, 4]
    assert [(e.kind, e.code, e.count) for e in ledger] == [(kind, "TIME-REPEAT", 1)]


def test_an_exposure_without_a_place_has_no_height_either():
    """Zeros and the largest integer mean that the place is unknown."""
    largest_rad = np.radians(214.7483647)
    logged = {
        "lat_rad": [0.8, 0.0, 0.8, largest_rad, -np.pi / 2.0],
        "lon_rad": [0.1, 0.0, 0.0, largest_rad, np.pi],
        "h_msl_m": [5.0, 0.0, 6.0, 2_147_483.647, 7.0],
    }
    channel, _ = built(
        SHOT,
        [1, 2, 3, 4, 5],
        **logged,
    )
    for name, values in logged.items():
        expected = np.array(values)
        expected[[1, 3]] = np.nan
        assert_array_equal(channel[name], expected)


def test_exposures_are_numbered_after_repeats_and_before_rows_out_of_order_are_dropped():
    times = [1, 2, 2, 3, 4, 5, 6, 2.5, 7, 8]
    channel, ledger = built(
        SHOT,
        times,
        h_msl_m=list(range(10)),
    )
    assert channel["h_msl_m"].tolist() == [0, 1, 3, 4, 5, 6, 8, 9]
    assert channel["event_index"].tolist() == [0, 1, 2, 3, 4, 5, 7, 8]
    assert {e.code: e.count for e in ledger} == {"TIME-REPEAT": 1, "TIME-BACKWARD": 1}


def test_a_channel_knows_the_units_in_which_it_was_logged():
    channel, _ = built(BARO, [1], pressure_pa=[81_250.0])
    assert channel.logged_units == {"pressure_pa": "hPa"}
    assert channel.rank == 20
    assert channel.roles == ("pressure",)


@given(st.lists(st.integers(0, 60), min_size=1, max_size=60))
def test_times_rise_and_every_row_that_is_missing_is_counted(seconds):
    channel, ledger = built(
        BARO,
        seconds,
        pressure_pa=list(range(len(seconds))),
    )
    assert np.all(np.diff(channel.time_ns) > 0)
    counts = {entry.code: entry.count or 0 for entry in ledger}
    dropped = counts.get("TIME-REPEAT", 0) + counts.get("TIME-BACKWARD", 0)
    assert len(channel) + dropped == len(seconds)
    if "TIME-SET-BACK" not in counts:  # each value keeps the time of its row
        rows = channel["pressure_pa"].astype(int)
        assert_array_equal(
            channel.time_ns // 10**9,
            np.array(seconds)[rows],
        )
