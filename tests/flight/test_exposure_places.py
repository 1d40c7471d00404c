"""The log's own place, height and attitude of each exposure, beside the flight made by hand."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.exposure_places import ExposureEvidence, exposure_findings
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.evidence.stretches import Stretch
from unbend.messages import Message

SECOND = 1_000_000_000
EARTH_M = 6_371_000.0
SPEED_M_S = 40.0
LATITUDE = 0.8
FLOWN_S = np.arange(0.0, 120.0, 0.1)
SHOT_S = np.arange(10.0, 110.0, 5.0)


def columns_at(seconds: np.ndarray, north_m: float = 0.0) -> dict[str, np.ndarray]:
    """Level flight to the east at 40 m/s, 450 m above the sea at the take-off, 1,450 m now."""
    east_m = SPEED_M_S * seconds
    return {
        "lat_rad": np.full(seconds.shape, LATITUDE + north_m / EARTH_M),
        "lon_rad": 0.1 + east_m / EARTH_M / np.cos(LATITUDE),
        "h_msl_m": np.full(seconds.shape, 1450.0),
        "h_home_m": np.full(seconds.shape, 1000.0),
        "q_w": np.full(seconds.shape, 1.0),
        "q_x": np.zeros(seconds.shape),
        "q_y": np.zeros(seconds.shape),
        "q_z": np.zeros(seconds.shape),
    }


def channel(name: str, seconds: np.ndarray, *roles: str, **columns: np.ndarray) -> Channel:
    time_ns = np.round(seconds * SECOND).astype(np.int64)
    message = name.partition("[")[0]
    return Channel(name, time_ns, columns, Source(message), roles=roles)


POS = channel("POS", FLOWN_S, "position", **columns_at(FLOWN_S))
GPS = channel(
    "GPS[0]",
    FLOWN_S,
    "height",
    "position",
    **columns_at(FLOWN_S) | {"sigma_h_m": np.full(FLOWN_S.shape, 0.5)},
    sigma_v_m=np.full(FLOWN_S.shape, 0.8),
)
ATT = channel("ATT", FLOWN_S, "attitude", **columns_at(FLOWN_S))
ROLES = {"position": POS, "height": GPS, "attitude": ATT}


def shots(logged: dict[str, np.ndarray], kind: str = "CAM") -> Channel:
    return channel(f"{kind}[0]", SHOT_S, "events", event_index=SHOT_S, **logged)


def findings(events: Channel, delay_s: float = 0.0, **changes: object) -> list[Message]:
    evidence = ExposureEvidence(
        channel=events,
        time_ns=events.time_ns + round(delay_s * SECOND),
        roles=ROLES,
        own=ROLES,
        accuracy=LogAccuracy(GPS),
        suspect=(),
        lever_arm_m=0.0,
        max_gap_s=2.0,
    )
    found = list(exposure_findings(replace(evidence, **changes)))
    assert all((entry.code, entry.kind) == ("EVENTS-ELSEWHERE", "finding") for entry in found)
    return found


def nowhere(seconds: np.ndarray) -> dict[str, np.ndarray]:
    unknown = dict.fromkeys(("lat_rad", "lon_rad", "q_w", "q_x", "q_y", "q_z"), np.nan)
    return (
        columns_at(seconds)
        | {name: np.full(seconds.shape, value) for name, value in unknown.items()}
        | {"h_msl_m": np.zeros(seconds.shape), "h_home_m": np.zeros(seconds.shape)}
    )


@pytest.mark.parametrize(
    ("logged", "delay_s"),
    [
        (columns_at(SHOT_S), 0.0),
        # the place of the trigger, and that of the last fix
        (columns_at(SHOT_S - 0.16), 0.0),
        (columns_at(SHOT_S - 0.4), 0.0),
        # a delay that the mission file states: the place is that of the trigger
        (columns_at(SHOT_S), 0.9),
        # the shutter was logged late, and the place is that of the shutter
        (columns_at(SHOT_S - 0.9), -0.9),
        # zeros are unknown
        (nowhere(SHOT_S), 0.0),
        # a height above the take-off under the name of one above the sea
        (columns_at(SHOT_S) | {"h_msl_m": np.full(SHOT_S.shape, 1000.0)}, 0.0),
        (columns_at(SHOT_S, north_m=5.0), 0.0),
    ],
)
def test_sound_logs_have_no_finding(logged: dict[str, np.ndarray], delay_s: float) -> None:
    assert findings(shots(logged), delay_s) == []


CLIMB_M = np.minimum(FLOWN_S / 10.0, 1.0) * 1000.0  # of a log that begins at the take-off
AT_1000_M = np.full(SHOT_S.shape, 1000.0)


@pytest.mark.parametrize(
    ("flown_m", "logged"),
    [
        # the receiver was at the take-off when the log began
        (450.0 + CLIMB_M, {"h_msl_m": AT_1000_M}),
        # it was not, but the log has the same height under both names
        (np.full(FLOWN_S.shape, 1450.0), {"h_msl_m": AT_1000_M, "h_home_m": AT_1000_M}),
    ],
)
def test_heights_above_a_take_off_that_the_receiver_does_not_know(flown_m, logged) -> None:
    columns = {name: values for name, values in GPS.columns.items() if name != "h_home_m"}
    gps = replace(GPS, columns=columns | {"h_msl_m": flown_m})
    roles = {"position": gps, "height": gps}
    place = {name: columns_at(SHOT_S)[name] for name in ("lat_rad", "lon_rad")}
    assert findings(shots(place | logged), roles=roles, own=roles) == []
    off = {"h_msl_m": AT_1000_M + 1000.0, "h_home_m": AT_1000_M + 200.0}
    assert findings(shots(place | off), roles=roles, own=roles) != []


@pytest.mark.parametrize("north_m", [30.0, 500.0, -500.0])
def test_events_of_another_vehicle_are_a_finding(north_m: float) -> None:
    (entry,) = findings(shots(columns_at(SHOT_S, north_m)))
    assert entry.count == SHOT_S.size
    assert entry.values["off_m"] == pytest.approx(abs(north_m), abs=0.5)
    assert "another vehicle" in entry.what


@pytest.mark.parametrize("shift_s", [2.0, -2.0, 18.0])
def test_a_clock_that_is_off_is_a_finding_which_says_by_how_much(shift_s: float) -> None:
    seconds = SHOT_S[SHOT_S + shift_s < 119.0]
    events = channel(
        "CAM[0]", seconds, "events", event_index=seconds, **columns_at(seconds + shift_s)
    )
    (entry,) = findings(events)
    said = re.search(r"its places ([\d.]+) s (later|earlier)", entry.what)
    assert said is not None
    assert float(said[1]) == pytest.approx(abs(shift_s), rel=0.01)
    assert said[2] == ("later" if shift_s > 0 else "earlier")


def test_one_exposure_elsewhere_is_enough() -> None:
    logged = columns_at(SHOT_S)
    logged["lat_rad"] = logged["lat_rad"].copy()
    logged["lat_rad"][3] += 100.0 / EARTH_M
    (entry,) = findings(shots(logged))
    assert entry.count == 1


def test_the_limit_follows_from_the_sigmas_and_the_lever_arm() -> None:
    events = shots(columns_at(SHOT_S, north_m=30.0))
    poor = replace(GPS, columns=dict(GPS.columns) | {"sigma_h_m": np.full(FLOWN_S.shape, 10.0)})
    assert findings(events, accuracy=LogAccuracy(poor)) == []
    assert findings(events, lever_arm_m=30.0) == []
    assert findings(events) != []


def test_exposures_in_suspect_stretches_do_not_count() -> None:
    suspect = Stretch(0, 200 * SECOND, "position", "the receiver steps")
    assert findings(shots(columns_at(SHOT_S, north_m=500.0)), suspect=(suspect,)) == []


def test_heights_of_another_flight_are_a_finding() -> None:
    other = columns_at(SHOT_S) | {"h_msl_m": np.full(SHOT_S.shape, 1600.0)}
    (entry,) = findings(shots(other))
    assert "h_msl_m" in entry.what
    by_receiver = columns_at(SHOT_S) | {"h_gnss_m": np.full(SHOT_S.shape, 1600.0)}
    (entry,) = findings(shots(by_receiver))
    assert "GPS[0]" in entry.what


def test_a_filter_with_a_barometer_may_be_apart_from_a_receiver() -> None:
    roles = {"position": GPS, "height": GPS, "attitude": ATT}
    other = columns_at(SHOT_S) | {"h_msl_m": np.full(SHOT_S.shape, 1520.0)}
    assert findings(shots(other), own=roles, roles=roles) == []


def test_attitudes_of_the_aircraft_are_compared_and_those_of_cameras_are_not() -> None:
    half_rad = np.radians(20.0) / 2.0
    tilted = columns_at(SHOT_S) | {
        "q_w": np.full(SHOT_S.shape, np.cos(half_rad)),
        "q_x": np.full(SHOT_S.shape, np.sin(half_rad)),
    }
    for kind in ("CAM", "camera_capture", "px4_msgs/CameraCapture"):
        (entry,) = findings(shots(tilted, kind))
        assert entry.values["off_deg"] == pytest.approx(20.0, abs=0.1)
    assert findings(shots(tilted, "CAMERA_FEEDBACK")) == []
