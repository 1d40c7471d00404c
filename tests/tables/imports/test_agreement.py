"""What is imported against the log: few exposures, long trajectories, logs without positions."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import refused
from tests.tables.checks import refused_with
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.imported_channels import contradictions_of_import
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem
from unbend.messages import Ledger
from unbend.tables.imports.agreement import compare_with_log

ROLES = ("position", "height")
LEVEL = {
    "q_w": 1.0,
    "q_x": 0.0,
    "q_y": 0.0,
    "q_z": 0.0,
}


def gps_of(flight, name, late_s=0.0, north_m=0.0):
    """True positions, stamped late and moved to the north."""
    columns = {
        "lat_rad": np.radians(flight.lat) + north_m / 6.37e6,
        "lon_rad": np.radians(flight.lon),
        "h_ellipsoid_m": flight.height,
    }
    time_ns = flight.utc_ns + round(late_s * 1e9)
    return Channel(name, time_ns, columns, Source("GPS"))


def changed(channel, **columns):
    """The channel with other columns; scalars are those of all rows, None removes a column."""
    changed_columns = dict(channel.columns)
    for name, values in columns.items():
        changed_columns.pop(name, None)
        if values is not None:
            changed_columns[name] = np.broadcast_to(values, len(channel)).copy()
    return replace(channel, columns=changed_columns)


def compared(imported, log, replaces=ROLES):
    """Messages by their codes."""
    ledger = Ledger()
    compare_with_log(imported, log, HeightSystem(47.6), ledger, replaces=replaces)
    return {message.code: message for message in ledger}


def doubts(imported, log, *stretches_of_log):
    return contradictions_of_import(imported, ROLES, log, stretches_of_log)


DAY_NS = 86_400 * 10**9


@pytest.fixture
def log(flight) -> dict[str, Channel]:
    return dict.fromkeys(ROLES, gps_of(flight, "GPS[0]"))


def test_five_exposures_with_the_error_of_an_autopilot_are_no_other_time(exposures, log):
    few = exposures.at_times(np.arange(5) * 3.0 + 280.0)
    off = gps_of(few, "e.MRK", north_m=3.0)

    agrees = compared(off, log)["TRAJECTORY-AGREES"]

    assert agrees.kind == "note"
    assert "3.00 m from GPS[0]" in agrees.what


@pytest.mark.parametrize(
    ("late_s", "shift"),
    [
        (18.0, "18.00 s late"),
        (-18.0, "18.00 s early"),
        (1.0, "1.00 s late"),
        (3600.0, "3600.00 s late"),
    ],
)
def test_a_trajectory_much_longer_than_the_log_is_shifted_all_the_same(
    exposures, log, late_s, shift
):
    long = exposures.at_times(np.arange(-3000.0, 3000.0, 0.5))
    late = gps_of(long, "long.pos", late_s=late_s)
    with refused("TRAJECTORY-TIME", what=shift):
        compared(late, log)


def test_without_positions_nothing_is_checked_and_that_is_told(exposures, log):
    events = gps_of(exposures, "e.MRK")
    assert compared(events, {})["TRAJECTORY-ALONE"].kind == "warning"
    nowhere = changed(events, lat_rad=np.nan)
    assert compared(nowhere, log)["TRAJECTORY-ALONE"].kind == "warning"


def test_a_log_without_heights_at_the_times_of_the_trajectory_is_noted(exposures, log):
    without = changed(log["height"], h_ellipsoid_m=np.nan)
    events = gps_of(exposures, "e.MRK")

    messages = compared(events, log | {"height": without})

    alone = messages["TRAJECTORY-HEIGHT-ALONE"]
    assert alone.kind == "note"
    assert alone.where == "e.MRK"
    assert "TRAJECTORY-HEIGHT-AGREES" not in messages


def test_a_log_without_attitudes_at_the_times_of_the_trajectory_is_noted(exposures, log):
    imported = changed(gps_of(exposures, "t.pos"), **LEVEL)
    later = changed(log["position"], **LEVEL)
    later = replace(later, name="ATT[0]", time_ns=later.time_ns + 10 * DAY_NS)
    with_attitudes = log | {"attitude": later}

    messages = compared(imported, with_attitudes, ("position", "attitude"))

    assert messages["TRAJECTORY-ANGLES-ALONE"].kind == "note"
    assert "TRAJECTORY-ANGLES-AGREE" not in messages


def test_the_height_of_the_other_surface_is_named(exposures, log):
    events = gps_of(exposures, "t.csv")
    above_sea = changed(
        events,
        h_ellipsoid_m=None,
        h_msl_m=exposures.height,
    )
    with refused_with("TRAJECTORY-HEIGHT", "heights above ellipsoid") as refusal:
        compared(above_sea, log)
    assert "+47.6" in refusal.value.what


FIFTH_TENTH = slice(1200, 1500)  # of the 3000 rows of the flight


def moved(channel, *, up_m=0.0, north_m=0.0):
    """The channel with its fifth tenth elsewhere."""
    height = channel["h_ellipsoid_m"].copy()
    height[FIFTH_TENTH] += up_m
    lat_rad = channel["lat_rad"].copy()
    lat_rad[FIFTH_TENTH] += north_m / 6.37e6
    return changed(channel, h_ellipsoid_m=height, lat_rad=lat_rad)


@pytest.mark.parametrize(
    ("quantity", "north_m", "up_m", "code"),
    [
        ("position", 40.0, 0.0, "TRAJECTORY-AGREES"),
        ("height", 0.0, 60.0, "TRAJECTORY-HEIGHT-AGREES"),
    ],
)
def test_a_tenth_of_a_trajectory_that_is_off_is_graded_and_doubtful(
    flight, log, quantity, north_m, up_m, code
):
    true = gps_of(flight, "t.pos")
    wrong = moved(true, north_m=north_m, up_m=up_m)

    messages = compared(wrong, log)
    (stretch,) = doubts(wrong, log)

    assert messages[code].kind == "loss"
    assert stretch.quantity == quantity
    assert stretch.off_m == pytest.approx(north_m + up_m, rel=0.02)
    begin_ns, *_, end_ns = true.time_ns[FIFTH_TENTH]
    assert abs(stretch.begin_ns - begin_ns) < 2e9
    assert abs(stretch.end_ns - end_ns) < 2e9


def test_a_trajectory_that_agrees_is_not_doubtful(flight, log):
    true = gps_of(flight, "t.pos")
    assert compared(true, log)["TRAJECTORY-AGREES"].kind == "note"
    assert doubts(true, log) == ()


def test_a_log_that_is_doubtful_or_a_sigma_that_says_so_casts_no_doubt(flight, log):
    true = gps_of(flight, "t.pos")
    gps = moved(log["position"], north_m=40.0)
    away = dict.fromkeys(ROLES, gps)
    assert doubts(true, away)

    begin_ns, *_, end_ns = true.time_ns.tolist()
    drift = Stretch(begin_ns, end_ns, "position", "it drifts")
    assert doubts(true, away, drift) == ()

    sigma_m = np.full(len(true), 0.02)
    sigma_m[FIFTH_TENTH] = 20.0
    uncertain = changed(moved(true, north_m=40.0), sigma_h_m=sigma_m)
    assert doubts(uncertain, log) == ()


def test_heights_above_another_surface_are_no_doubt(flight, log):
    """In a climb a constant difference is not taken for a lag."""
    height = flight.height + np.linspace(0.0, 900.0, flight.t.size)
    gps = changed(log["height"], h_ellipsoid_m=None, h_msl_m=height - 47.6)
    climbing_log = dict.fromkeys(ROLES, gps)
    climbing = changed(
        gps_of(flight, "t.pos"),
        h_ellipsoid_m=height,
        v_down_m_s=-3.0,
    )
    assert doubts(climbing, climbing_log) == ()
