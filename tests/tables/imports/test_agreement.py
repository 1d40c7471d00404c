"""What is imported against the log: few exposures, long trajectories, logs without positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import refused
from tests.tables.checks import refused_with
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.imported_channels import contradictions_of_import
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem
from unbend.messages import Ledger, Message
from unbend.tables.imports.agreement import compare_with_log

ROLES = ("position", "height")
LEVEL = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}


def gps_of(flight, name, *, late_s=0.0, north_m=0.0) -> Channel:
    """True positions, stamped late and moved to the north."""
    columns = {
        "lat_rad": np.radians(flight.lat) + north_m / 6.37e6,
        "lon_rad": np.radians(flight.lon),
        "h_ellipsoid_m": flight.height,
    }
    return Channel(name, flight.utc_ns + round(late_s * 1e9), columns, Source("GPS"))


def changed(channel: Channel, **columns) -> Channel:
    """The channel with other columns; scalars hold throughout, None stands for no column."""
    kept = {name: column for name, column in channel.columns.items() if name not in columns}
    for name, values in columns.items():
        if values is not None:
            kept[name] = np.broadcast_to(values, len(channel)).copy()
    return replace(channel, columns=kept)


def compared(imported, own, replaces=ROLES) -> dict[str, Message]:
    """Messages by their codes."""
    ledger = Ledger()
    compare_with_log(imported, own, HeightSystem(47.6), ledger, replaces=replaces)
    return {message.code: message for message in ledger}


@pytest.fixture
def own(flight) -> dict[str, Channel]:
    gps = gps_of(flight, "GPS[0]")
    return {"position": gps, "height": gps}


def test_five_exposures_with_the_error_of_an_autopilot_are_no_other_time(exposures, own):
    few = exposures.at(np.arange(5) * 3.0 + 280.0)
    agrees = compared(gps_of(few, "e.MRK", north_m=3.0), own)["TRAJECTORY-AGREES"]
    assert agrees.kind == "note"
    assert "3.00 m from GPS[0]" in agrees.what


@pytest.mark.parametrize("late_s", [18.0, -18.0, 1.0, 3600.0])
def test_a_trajectory_much_longer_than_the_log_is_shifted_all_the_same(exposures, own, late_s):
    long = exposures.at(np.arange(-3000.0, 3000.0, 0.5))
    with refused("TRAJECTORY-TIME") as refusal:
        compared(gps_of(long, "long.pos", late_s=late_s), own)
    assert f"{abs(late_s):.2f} s {'late' if late_s > 0 else 'early'}" in refusal.value.what


def test_without_positions_nothing_is_checked_and_that_is_told(exposures, own):
    events = gps_of(exposures, "e.MRK")
    assert compared(events, {})["TRAJECTORY-ALONE"].kind == "warning"
    nowhere = changed(events, lat_rad=np.nan)
    assert compared(nowhere, own)["TRAJECTORY-ALONE"].kind == "warning"


def test_a_log_without_heights_at_the_times_of_the_trajectory_is_noted(exposures, own):
    without = own | {"height": changed(own["height"], h_ellipsoid_m=np.nan)}
    messages = compared(gps_of(exposures, "e.MRK"), without)
    assert messages["TRAJECTORY-HEIGHT-ALONE"].kind == "note"
    assert messages["TRAJECTORY-HEIGHT-ALONE"].where == "e.MRK"
    assert "TRAJECTORY-HEIGHT-AGREES" not in messages


def test_a_log_without_attitudes_at_the_times_of_the_trajectory_is_noted(exposures, own):
    imported = changed(gps_of(exposures, "t.pos"), **LEVEL)
    later = changed(own["position"], **LEVEL)
    later = replace(later, name="ATT[0]", time_ns=later.time_ns + 10 * 86_400 * 10**9)
    messages = compared(imported, own | {"attitude": later}, ("position", "attitude"))
    assert messages["TRAJECTORY-ANGLES-ALONE"].kind == "note"
    assert "TRAJECTORY-ANGLES-AGREE" not in messages


def test_the_height_of_the_other_surface_is_named(exposures, own):
    events = gps_of(exposures, "t.csv")
    above_sea = changed(events, h_ellipsoid_m=None, h_msl_m=events["h_ellipsoid_m"])
    with refused_with("TRAJECTORY-HEIGHT", "heights above ellipsoid") as refusal:
        compared(above_sea, own)
    assert "+47.6" in refusal.value.what


def moved(channel: Channel, rows, *, up_m=0.0, north_m=0.0) -> Channel:
    return changed(
        channel,
        h_ellipsoid_m=channel["h_ellipsoid_m"] + np.where(rows, up_m, 0.0),
        lat_rad=channel["lat_rad"] + np.where(rows, north_m / 6.37e6, 0.0),
    )


def fifth_tenth(channel: Channel) -> np.ndarray:
    return np.arange(len(channel)) // (len(channel) // 10) == 4


@pytest.mark.parametrize(
    ("quantity", "north_m", "up_m", "code"),
    [
        ("position", 40.0, 0.0, "TRAJECTORY-AGREES"),
        ("height", 0.0, 60.0, "TRAJECTORY-HEIGHT-AGREES"),
    ],
)
def test_a_tenth_of_a_trajectory_that_is_off_is_graded_and_doubtful(
    flight, own, quantity, north_m, up_m, code
):
    true = gps_of(flight, "t.pos")
    rows = fifth_tenth(true)
    begin_ns, end_ns = true.time_ns[rows][[0, -1]]
    wrong = moved(true, rows, north_m=north_m, up_m=up_m)
    assert compared(wrong, own)[code].kind == "loss"
    (stretch,) = contradictions_of_import(wrong, ROLES, own, ())
    assert stretch.quantity == quantity
    assert stretch.off_m == pytest.approx(north_m + up_m, rel=0.02)
    assert abs(stretch.begin_ns - begin_ns) < 2e9
    assert abs(stretch.end_ns - end_ns) < 2e9


def test_a_trajectory_that_agrees_is_not_doubtful(flight, own):
    true = gps_of(flight, "t.pos")
    assert compared(true, own)["TRAJECTORY-AGREES"].kind == "note"
    assert contradictions_of_import(true, ROLES, own, ()) == ()


def test_a_log_that_is_doubtful_or_a_sigma_that_says_so_casts_no_doubt(flight, own):
    true = gps_of(flight, "t.pos")
    rows = fifth_tenth(true)
    away = {role: moved(channel, rows, north_m=40.0) for role, channel in own.items()}
    assert contradictions_of_import(true, ROLES, away, ())
    whole = Stretch(int(true.time_ns[0]), int(true.time_ns[-1]), "position", "it drifts")
    assert contradictions_of_import(true, ROLES, away, (whole,)) == ()
    wrong = moved(true, rows, north_m=40.0)
    uncertain = changed(wrong, sigma_h_m=np.where(rows, 20.0, 0.02))
    assert contradictions_of_import(uncertain, ROLES, own, ()) == ()


def test_heights_above_another_surface_are_no_doubt(flight, own):
    """In a climb a constant difference is not taken for a lag."""
    true = gps_of(flight, "t.pos")
    height = flight.height + np.linspace(0.0, 900.0, len(true))
    gps = changed(own["height"], h_ellipsoid_m=None, h_msl_m=height - 47.6)
    climbing = changed(true, h_ellipsoid_m=height, v_down_m_s=-3.0)
    of_log = {"position": gps, "height": gps}
    assert contradictions_of_import(climbing, ROLES, of_log, ()) == ()
