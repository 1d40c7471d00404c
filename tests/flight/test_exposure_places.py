"""The log's own place, height and attitude of each exposure, beside the flight made by hand."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import EARTH_M, instants, with_columns, without_columns
from tests.helpers import channel
from unbend.flight.evidence.exposure_places import ExposureEvidence, exposure_findings
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.evidence.stretches import Stretch

SPEED_M_S = 40.0
LATITUDE = 0.8
FLOWN_S = np.arange(0.0, 120.0, 0.1)
SHOT_S = np.arange(10.0, 110.0, 5.0)


def columns_at(seconds, north_m=0.0, **changed):
    """Level flight to the east at 40 m/s, 450 m above the sea at the take-off, 1,450 m now."""
    return {
        "lat_rad": LATITUDE + north_m / EARTH_M,
        "lon_rad": 0.1 + SPEED_M_S * seconds / EARTH_M / np.cos(LATITUDE),
        "h_msl_m": 1450.0,
        "h_home_m": 1000.0,
        "q_w": 1.0,
        "q_x": 0.0,
        "q_y": 0.0,
        "q_z": 0.0,
        **changed,
    }


FLOWN = columns_at(FLOWN_S)
POS = channel("POS", FLOWN_S, "position", **FLOWN)
GPS = channel(
    "GPS",
    FLOWN_S,
    "height",
    "position",
    **FLOWN,
    sigma_h_m=0.5,
    sigma_v_m=0.8,
)
ATT = channel("ATT", FLOWN_S, "attitude", **FLOWN)
ROLES = {"position": POS, "height": GPS, "attitude": ATT}
BY_GPS = {"position": GPS, "height": GPS, "attitude": ATT}


def shots(logged, kind="CAM", seconds=SHOT_S):
    return channel(f"{kind}[0]", seconds, "events", event_index=seconds, **logged)


def findings(events, roles=ROLES, delay_s=0.0, **changes):
    evidence = ExposureEvidence(
        channel=events,
        time_ns=events.time_ns + instants(delay_s),
        roles=roles,
        log_roles=roles,
        accuracy=LogAccuracy(GPS),
        suspect=(),
        lever_arm_m=0.0,
        max_gap_s=2.0,
    )
    contradictions = list(exposure_findings(replace(evidence, **changes)))
    for finding in contradictions:
        assert (finding.kind, finding.code) == ("finding", "EVENTS-ELSEWHERE")
    return contradictions


UNKNOWN = dict.fromkeys(("lat_rad", "lon_rad", "q_w", "q_x", "q_y", "q_z"), np.nan)


@pytest.mark.parametrize(
    ("logged", "delay_s"),
    [
        (columns_at(SHOT_S), 0.0),
        (columns_at(SHOT_S - 0.16), 0.0),
        (columns_at(SHOT_S - 0.4), 0.0),
        (columns_at(SHOT_S), 0.9),
        (columns_at(SHOT_S - 0.9), -0.9),
        (columns_at(SHOT_S, **UNKNOWN, h_msl_m=0.0, h_home_m=0.0), 0.0),
        (columns_at(SHOT_S, h_msl_m=1000.0), 0.0),
        (columns_at(SHOT_S, north_m=5.0), 0.0),
    ],
    ids=[
        "of the exposure",
        "of the trigger",
        "of the last fix",
        "of the trigger, before a delay that the mission file states",
        "of the shutter, logged late",
        "zeros are unknown",
        "above the take-off under the name of above the sea",
        "5 m beside",
    ],
)
def test_sound_logs_have_no_finding(logged, delay_s):
    assert findings(shots(logged), delay_s=delay_s) == []


CLIMB_M = np.minimum(FLOWN_S / 10.0, 1.0) * 1000.0  # of a log that begins at the take-off


@pytest.mark.parametrize(
    ("flown_m", "logged"),
    [
        # the receiver was at the take-off when the log began
        (450.0 + CLIMB_M, {"h_msl_m": 1000.0}),
        # it was not, but the log has the same height under both names
        (np.full(FLOWN_S.shape, 1450.0), {"h_msl_m": 1000.0, "h_home_m": 1000.0}),
    ],
)
def test_heights_above_a_take_off_that_the_receiver_does_not_know(flown_m, logged):
    gps = with_columns(without_columns(GPS, "h_home_m"), h_msl_m=flown_m)
    roles = {"position": gps, "height": gps}
    columns = columns_at(SHOT_S)
    place = {
        "lat_rad": columns["lat_rad"],
        "lon_rad": columns["lon_rad"],
    }
    assert findings(shots(place | logged), roles) == []
    assert findings(shots(place | {"h_msl_m": 2000.0, "h_home_m": 1200.0}), roles) != []


@pytest.mark.parametrize("north_m", [30.0, 500.0, -500.0])
def test_events_of_another_vehicle_are_a_finding(north_m):
    (finding,) = findings(shots(columns_at(SHOT_S, north_m)))
    assert finding.count == SHOT_S.size
    assert finding.values["off_m"] == pytest.approx(abs(north_m), abs=0.5)
    assert "another vehicle" in finding.what


@pytest.mark.parametrize("shift_s", [2.0, -2.0, 18.0])
def test_a_clock_that_is_off_is_a_finding_which_says_by_how_much(shift_s):
    seconds = SHOT_S[SHOT_S + shift_s < 119.0]
    (finding,) = findings(shots(columns_at(seconds + shift_s), seconds=seconds))
    direction = "later" if shift_s > 0 else "earlier"
    shift = re.search(rf"its places ([\d.]+) s {direction}", finding.what)
    assert float(shift[1]) == pytest.approx(abs(shift_s), rel=0.01)


@pytest.mark.parametrize(("speed_m_s", "is_named"), [(3.0, True), (1.0, False)])
def test_the_shift_is_that_of_places_in_motion(speed_m_s, is_named):
    flown = columns_at(FLOWN_S * speed_m_s / SPEED_M_S)
    position = with_columns(GPS, lon_rad=flown["lon_rad"])
    seconds = SHOT_S[SHOT_S < 80.0]
    logged = columns_at((seconds + 25.0) * speed_m_s / SPEED_M_S)
    (finding,) = findings(shots(logged, seconds=seconds), {"position": position})
    assert ("s later" in finding.what) == is_named


def test_one_exposure_elsewhere_is_enough():
    logged = shots(columns_at(SHOT_S))
    elsewhere = logged["lat_rad"] + 100.0 / EARTH_M * (SHOT_S == 25.0)
    (finding,) = findings(with_columns(logged, lat_rad=elsewhere))
    assert finding.count == 1


POOR = with_columns(GPS, sigma_h_m=np.full(FLOWN_S.shape, 10.0))


@pytest.mark.parametrize(
    ("north_m", "changes"),
    [
        (30.0, {"accuracy": LogAccuracy(POOR)}),
        (30.0, {"lever_arm_m": 30.0}),
        (500.0, {"suspect": (Stretch(*instants(0, 200), "position", "the receiver steps"),)}),
    ],
    ids=["sigmas", "the lever arm", "suspect stretches do not count"],
)
def test_places_that_may_be_so_far_apart(north_m, changes):
    events = shots(columns_at(SHOT_S, north_m))
    assert findings(events, **changes) == []
    assert findings(events) != []


@pytest.mark.parametrize(
    ("logged", "says"),
    [
        ({"h_msl_m": 1600.0}, "h_msl_m"),
        ({"h_gnss_m": 1600.0}, "GPS"),
    ],
)
def test_heights_of_another_flight_are_a_finding(logged, says):
    (finding,) = findings(shots(columns_at(SHOT_S, **logged)))
    assert says in finding.what


def test_a_filter_with_a_barometer_may_be_apart_from_a_receiver():
    assert findings(shots(columns_at(SHOT_S, h_msl_m=1520.0)), BY_GPS) == []


@pytest.mark.parametrize(
    ("kind", "is_of_aircraft"),
    [
        ("CAM", True),
        ("camera_capture", True),
        ("px4_msgs/CameraCapture", True),
        ("CAMERA_FEEDBACK", False),
    ],
)
def test_attitudes_of_the_aircraft_are_compared_and_those_of_cameras_are_not(kind, is_of_aircraft):
    half_rad = np.radians(20.0) / 2.0
    tilted = columns_at(
        SHOT_S,
        q_w=np.cos(half_rad),
        q_x=np.sin(half_rad),
    )
    off_deg = [finding.values["off_deg"] for finding in findings(shots(tilted, kind))]
    assert off_deg == [pytest.approx(20.0, abs=0.1)] * is_of_aircraft
