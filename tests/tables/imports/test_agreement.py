"""What is imported against the log: few exposures, long trajectories, logs without positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import MissionError
from pipeline.flight.channels import Channel, Source
from pipeline.flight.heights import HeightSystem
from pipeline.ledger import Ledger
from pipeline.tables.imports.agreement import compare_with_log

ROLES = ("position", "height")


def channel(flight, name, *, late_s=0.0, north_m=0.0):
    """A channel of true positions, stamped late and moved to the north."""
    columns = {
        "lat_rad": np.radians(flight.lat) + north_m / 6.37e6,
        "lon_rad": np.radians(flight.lon),
        "h_ellipsoid_m": flight.height,
    }
    return Channel(name, flight.utc_ns + round(late_s * 1e9), columns, Source("GPS"))


def compared(imported, own):
    ledger = Ledger()
    heights = HeightSystem(47.6)
    compare_with_log(imported, own, heights, ledger, replaces=ROLES)
    return {entry.code: entry for entry in ledger}


@pytest.fixture
def own(flight):
    gps = channel(flight, "GPS[0]")
    return {"position": gps, "height": gps}


def test_five_exposures_with_the_error_of_an_autopilot_are_no_other_time(exposures, own):
    few = channel(replace(exposures, t=np.arange(5) * 3.0 + 280.0), "e.MRK", north_m=3.0)
    told = compared(few, own)
    assert told["TRAJECTORY-AGREES"].kind == "note"
    assert "3.00 m from GPS[0]" in told["TRAJECTORY-AGREES"].what


@pytest.mark.parametrize("late_s", [18.0, -18.0, 1.0, 3600.0])
def test_a_trajectory_much_longer_than_the_log_is_shifted_all_the_same(exposures, own, late_s):
    long = replace(exposures, t=np.arange(-3000.0, 3000.0, 0.5))
    with pytest.raises(MissionError) as caught:
        compared(channel(long, "long.pos", late_s=late_s), own)
    assert caught.value.code == "TRAJECTORY-TIME"
    assert f"{abs(late_s):.2f} s {'late' if late_s > 0 else 'early'}" in caught.value.what


def test_without_positions_nothing_is_checked_and_that_is_told(exposures, own):
    assert compared(channel(exposures, "e.MRK"), {})["TRAJECTORY-ALONE"].kind == "warning"
    lost = channel(exposures, "e.MRK")
    nowhere = replace(lost, columns=lost.columns | {"lat_rad": np.full(len(lost), np.nan)})
    assert compared(nowhere, own)["TRAJECTORY-ALONE"].kind == "warning"


def test_the_height_of_the_other_surface_is_named(exposures, own):
    sea = channel(exposures, "t.csv")
    wrong = {n: v for n, v in sea.columns.items() if n != "h_ellipsoid_m"}
    wrong["h_msl_m"] = sea["h_ellipsoid_m"]
    with pytest.raises(MissionError, match="heights above ellipsoid") as caught:
        compared(replace(sea, columns=wrong), own)
    assert caught.value.code == "TRAJECTORY-HEIGHT"
    assert "+47.6" in caught.value.what
