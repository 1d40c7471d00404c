"""A sensor whose values never change in a flight that moved is a finding, and no sound one is."""

from __future__ import annotations

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.constant_sensors import FEWEST_SAMPLES, constant_sensors
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.roles import assign_roles
from unbend.ingest import open_log
from unbend.ingest.attitude import quaternion_of_euler

ROWS = 400


def channel(name: str, message: str = "", **columns: np.ndarray) -> Channel:
    time_ns = 1_700_000_000_000_000_000 + np.arange(ROWS) * 100_000_000
    return Channel(
        name=name,
        time_ns=time_ns,
        columns=columns,
        source=Source(message or name),
        boot=np.zeros(ROWS, np.int16),
    )


def flight(climb_m: float = 1000.0, way_m: float = 3000.0) -> dict[str, Channel]:
    """A flight that climbs on a straight line, all of whose sensors change."""
    draw = np.random.default_rng(7)
    share = np.linspace(0.0, 1.0, ROWS)
    height_m = 100.0 + climb_m * share + draw.normal(0.0, 0.01, ROWS)
    place = {
        "lat_rad": 0.8 + way_m / 6.37e6 * share + draw.normal(0.0, 1e-9, ROWS),
        "lon_rad": 0.2 + draw.normal(0.0, 1e-9, ROWS),
        "h_msl_m": height_m,
    }
    angles = [draw.normal(mean, 0.01, ROWS) for mean in (0.0, 0.05, 1.0)]
    quaternion = quaternion_of_euler(*angles)
    return {
        "position": channel("GPS", **place),
        "height": channel("GPS", **place),
        "attitude": channel(
            "ATT", **dict(zip(("q_w", "q_x", "q_y", "q_z"), quaternion.T, strict=True))
        ),
        "pressure": channel("BARO", pressure_pa=1e5 - 12.0 * height_m),
        "temperature": channel("HYGR", temperature_k=288.0 - 0.0065 * height_m),
    }


def with_angles(roll: float | None, pitch: float | None, yaw: float | None) -> Channel:
    """An attitude, some of whose angles are constant."""
    draw = np.random.default_rng(8)
    angles = [
        draw.normal(0.1, 0.01, ROWS) if angle is None else np.full(ROWS, angle)
        for angle in (roll, pitch, yaw)
    ]
    quaternion = quaternion_of_euler(*angles)
    return channel("ATT", **dict(zip(("q_w", "q_x", "q_y", "q_z"), quaternion.T, strict=True)))


def findings(roles: dict[str, Channel]) -> list[tuple[str, str]]:
    notes = constant_sensors(roles)
    assert {note.code for note in notes} <= {"SENSOR-CONSTANT"}
    return [(note.kind, f"{note.where}: {note.what}") for note in notes]


def test_a_sound_flight_has_none() -> None:
    assert findings(flight()) == []
    assert findings({}) == []


@pytest.mark.parametrize(
    ("angles", "said"),
    [
        ((0.0, None, None), "roll = 0.00°"),
        ((None, 0.2, None), "pitch = 11.46°"),
        ((None, None, -3.1), "yaw = -177.62°"),
        ((0.0, 0.0, 0.0), "roll = 0.00°, pitch = 0.00°, yaw = 0.00°"),
    ],
)
def test_an_angle_that_never_changes(angles: tuple[float, ...], said: str) -> None:
    roles = flight() | {"attitude": with_angles(*angles)}
    [(kind, what)] = findings(roles)
    assert kind == "finding"
    assert f"the attitude have {said}, although the flight spans" in what


@pytest.mark.parametrize(
    ("role", "column", "value"),
    [
        ("pressure", "pressure_pa", 9e4),
        ("temperature", "temperature_k", 273.15),
        ("position", "lat_rad", 0.8),
        ("position", "lon_rad", 0.2),
        ("height", "h_msl_m", 120.0),
    ],
)
def test_a_column_that_never_changes(role: str, column: str, value: float) -> None:
    roles = flight()
    stuck = dict(roles[role].columns) | {column: np.full(ROWS, value)}
    roles[role] = channel(roles[role].name, **stuck)
    said = [what for _, what in findings(roles)]
    assert len(said) == 1
    assert said[0].startswith(f"{roles[role].name}: all 400 samples of the {role} have")


def test_a_position_that_never_changes_while_the_pressure_does() -> None:
    roles = flight(way_m=0.0)
    still = dict(roles["position"].columns) | {
        "lat_rad": np.full(ROWS, 0.8),
        "lon_rad": np.full(ROWS, 0.2),
    }
    roles["position"] = channel("GPS", **still)
    assert len(findings(roles)) == 2


def test_what_may_rightly_be_constant() -> None:
    """A gimbal holds an angle, a parked aircraft is still, and a few samples may be equal."""
    roles = flight() | {"attitude": with_angles(0.0, 0.0, None)}
    gimbal = channel("MOUNT", "MOUNT_ORIENTATION", **roles["attitude"].columns)
    assert findings(roles | {"attitude": gimbal}) == []
    parked = flight(climb_m=0.0, way_m=0.0)
    still = channel("BARO", pressure_pa=np.full(ROWS, 9e4))
    assert findings(parked | {"pressure": still, "attitude": with_angles(0.0, 0.0, 0.0)}) == []
    values = np.full(ROWS, np.nan)
    values[: FEWEST_SAMPLES - 1] = 9e4
    assert findings(flight() | {"pressure": channel("BARO", pressure_pa=values)}) == []


SOUND = ("flight.bin", "flight.tlog", "flight.mcap", "pymavlink_swift_flight.tlog")


@pytest.mark.parametrize("name", at_hand(*SOUND))
def test_no_real_flight_has_one(name: str) -> None:
    roles, _ = assign_roles(open_log(LOGS[name]).channels, {}, needs_cabin=False)
    plausible = {role: plausible_samples(part, role)[0] for role, part in roles.items()}
    assert constant_sensors(plausible) == ()
