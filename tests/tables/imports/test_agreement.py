"""What is imported against the log: few exposures, long trajectories, logs without positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.imported_channels import contradictions_of_import
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem
from unbend.messages import Ledger
from unbend.tables.imports.agreement import compare_with_log

ROLES = ("position", "height")


def channel(flight, name, *, late_s=0.0, north_m=0.0):
    """A channel of true positions, stamped late and moved to the north."""
    columns = {
        "lat_rad": np.radians(flight.lat) + north_m / 6.37e6,
        "lon_rad": np.radians(flight.lon),
        "h_ellipsoid_m": flight.height,
    }
    return Channel(name, flight.utc_ns + round(late_s * 1e9), columns, Source("GPS"))


def compared(imported, own, replaces=ROLES):
    ledger = Ledger()
    heights = HeightSystem(47.6)
    compare_with_log(imported, own, heights, ledger, replaces=replaces)
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


def test_a_log_without_heights_at_the_times_of_the_trajectory_is_noted(exposures, own):
    unknown = np.full(len(own["height"]), np.nan)
    columns = own["height"].columns | {"h_ellipsoid_m": unknown}
    without = own | {"height": replace(own["height"], columns=columns)}
    noted = compared(channel(exposures, "e.MRK"), without)
    assert noted["TRAJECTORY-HEIGHT-ALONE"].kind == "note"
    assert noted["TRAJECTORY-HEIGHT-ALONE"].where == "e.MRK"
    assert "TRAJECTORY-HEIGHT-AGREES" not in noted


def test_a_log_without_attitudes_at_the_times_of_the_trajectory_is_noted(exposures, own):
    level = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    imported = channel(exposures, "t.pos")
    turned = {name: np.full(len(imported), value) for name, value in level.items()}
    gps = own["position"]
    later_ns = gps.time_ns + 10 * 86_400 * 10**9
    attitude = {name: np.full(len(gps), value) for name, value in level.items()}
    noted = compared(
        replace(imported, columns=imported.columns | turned),
        own | {"attitude": Channel("ATT[0]", later_ns, attitude, Source("ATT"))},
        replaces=("position", "attitude"),
    )
    assert noted["TRAJECTORY-ANGLES-ALONE"].kind == "note"
    assert "TRAJECTORY-ANGLES-AGREE" not in noted


def test_the_height_of_the_other_surface_is_named(exposures, own):
    sea = channel(exposures, "t.csv")
    wrong = {n: v for n, v in sea.columns.items() if n != "h_ellipsoid_m"}
    wrong["h_msl_m"] = sea["h_ellipsoid_m"]
    with pytest.raises(MissionError, match="heights above ellipsoid") as caught:
        compared(replace(sea, columns=wrong), own)
    assert caught.value.code == "TRAJECTORY-HEIGHT"
    assert "+47.6" in caught.value.what


def shifted(imported, rows, *, up_m=0.0, north_m=0.0):
    columns = dict(imported.columns)
    columns["h_ellipsoid_m"] = columns["h_ellipsoid_m"] + np.where(rows, up_m, 0.0)
    columns["lat_rad"] = columns["lat_rad"] + np.where(rows, north_m / 6.37e6, 0.0)
    return replace(imported, columns=columns)


def test_a_tenth_of_a_trajectory_that_is_off_is_graded_and_doubtful(flight, own):
    true = channel(flight, "t.pos")
    rows = np.arange(len(true)) // (len(true) // 10) == 4
    begin, end = true.time_ns[rows][[0, -1]]
    for off, code, quantity in (
        ({"north_m": 40.0}, "TRAJECTORY-AGREES", "position"),
        ({"up_m": 60.0}, "TRAJECTORY-HEIGHT-AGREES", "height"),
    ):
        wrong = shifted(true, rows, **off)
        assert compared(wrong, own)[code].kind == "loss"
        (stretch,) = contradictions_of_import(wrong, ROLES, own, ())
        assert stretch.quantity == quantity
        assert stretch.off_m == pytest.approx(next(iter(off.values())), rel=0.02)
        assert abs(stretch.begin_ns - begin) < 2e9
        assert abs(stretch.end_ns - end) < 2e9
    assert compared(true, own)["TRAJECTORY-AGREES"].kind == "note"
    assert contradictions_of_import(true, ROLES, own, ()) == ()


def test_a_log_that_is_doubtful_or_a_sigma_that_says_so_casts_no_doubt(flight, own):
    true = channel(flight, "t.pos")
    rows = np.arange(len(true)) // (len(true) // 10) == 4
    away = {n: shifted(c, rows, north_m=40.0) for n, c in own.items()}
    assert contradictions_of_import(true, ROLES, away, ())
    whole = Stretch(int(true.time_ns[0]), int(true.time_ns[-1]), "position", "it drifts")
    assert contradictions_of_import(true, ROLES, away, (whole,)) == ()
    sigma = {"sigma_h_m": np.where(rows, 20.0, 0.02)}
    told = shifted(replace(true, columns=dict(true.columns) | sigma), rows, north_m=40.0)
    assert contradictions_of_import(told, ROLES, own, ()) == ()


def test_heights_above_another_surface_are_no_doubt(flight, own):
    """In a climb a constant difference is not taken for a lag."""
    true = channel(flight, "t.pos")
    climb = np.linspace(0.0, 900.0, len(true))
    sea = {n: v for n, v in true.columns.items() if n != "h_ellipsoid_m"}
    gps = replace(true, name="GPS[0]", columns=sea | {"h_msl_m": flight.height - 47.6 + climb})
    up = replace(
        true,
        columns=dict(true.columns)
        | {"h_ellipsoid_m": flight.height + climb, "v_down_m_s": np.full(len(true), -3.0)},
    )
    assert contradictions_of_import(up, ROLES, {"position": gps, "height": gps}, ()) == ()
