"""A sensor whose values never change in a flight that moved is a finding, and no sound one is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import (
    located,
    plausible_roles,
    quaternion_columns,
    with_columns,
)
from tests.helpers import channel
from tests.logs import LOGS, at_hand
from unbend.flight.evidence.constant_sensors import FEWEST_SAMPLES, constant_sensors
from unbend.ingest import open_log

ROW = np.arange(400)
SECONDS = ROW / 10.0
NOISE = np.random.default_rng(7).normal(0.0, 0.01, (6, 400))
ROLL = NOISE[0]
PITCH = 0.05 + NOISE[1]
YAW = 1.0 + NOISE[2]


def attitude(roll=ROLL, pitch=PITCH, yaw=YAW, message="ATT"):
    """An attitude, whose angles may be constant [rad]."""
    angles = np.stack(np.broadcast_arrays(yaw, pitch, roll, ROLL)[:3], axis=1)
    turns = Rotation.from_euler("ZYX", angles)
    return channel(message, SECONDS, **quaternion_columns(turns))


def flight(climb_m=1000.0, way_m=3000.0):
    """A flight that climbs on a straight line, all of whose sensors change."""
    share = np.linspace(0.0, 1.0, 400)
    height_m = 100.0 + climb_m * share + NOISE[3]
    gps = channel(
        "GPS",
        SECONDS,
        lat_rad=0.8 + way_m / 6.37e6 * share + NOISE[4] * 1e-7,
        lon_rad=0.2 + NOISE[5] * 1e-7,
        h_msl_m=height_m,
    )
    return {
        "position": gps,
        "height": gps,
        "attitude": attitude(),
        "pressure": channel("BARO", SECONDS, pressure_pa=1e5 - 12.0 * height_m),
        "temperature": channel("HYGR", SECONDS, temperature_k=288.0 - 0.0065 * height_m),
    }


def stuck(roles, role, **values):
    """The roles, of which columns of one never change."""
    columns = {name: np.full(400, value) for name, value in values.items()}
    return roles | {role: with_columns(roles[role], **columns)}


@pytest.mark.parametrize(
    ("constant", "says"),
    [
        (attitude(roll=0.0), "roll = 0.00°"),
        (attitude(pitch=0.2), "pitch = 11.46°"),
        (attitude(yaw=-3.1), "yaw = -177.62°"),
        (attitude(0.0, 0.0, 0.0), "roll = 0.00°, pitch = 0.00°, yaw = 0.00°"),
    ],
)
def test_an_angle_that_never_changes(constant, says):
    (finding,) = constant_sensors(flight() | {"attitude": constant})
    assert located([finding]) == [("finding", "SENSOR-CONSTANT", "ATT")]
    assert f"the attitude have {says}, although the flight spans" in finding.what


@pytest.mark.parametrize(
    ("climb_m", "role", "column", "value", "is_found"),
    [
        (1000.0, "pressure", "pressure_pa", 9e4, True),
        (1000.0, "temperature", "temperature_k", 273.15, True),
        (1000.0, "position", "lat_rad", 0.8, True),
        (1000.0, "position", "lon_rad", 0.2, True),
        (1000.0, "height", "h_msl_m", 120.0, True),
        # of the climb 98 % count
        (55.0, "pressure", "pressure_pa", 9e4, True),
        (45.0, "pressure", "pressure_pa", 9e4, False),
        (310.0, "temperature", "temperature_k", 273.15, True),
        (290.0, "temperature", "temperature_k", 273.15, False),
        (55.0, "height", "h_msl_m", 120.0, True),
        (45.0, "height", "h_msl_m", 120.0, False),
    ],
)
def test_a_column_that_never_changes(climb_m, role, column, value, is_found):
    roles = stuck(flight(climb_m), role, **{column: value})
    findings = constant_sensors(roles)
    assert [finding.where for finding in findings] == [roles[role].name] * is_found
    for finding in findings:
        assert finding.what.startswith(f"all 400 samples of the {role} have")


@pytest.mark.parametrize(
    ("climb_m", "way_m", "is_found"),
    [
        (45.0, 320.0, True),
        (45.0, 290.0, False),
        (55.0, 0.0, True),
    ],
)
def test_whether_a_flight_moved(climb_m, way_m, is_found):
    """By its way, of which 98 % count, or by its climb; its pressure shows nothing."""
    roles = stuck(flight(climb_m, way_m), "pressure", pressure_pa=np.nan)
    roles["attitude"] = attitude(roll=0.0)
    assert len(constant_sensors(roles)) == is_found


def test_a_position_that_never_changes_while_the_pressure_does():
    roles = stuck(
        flight(way_m=0.0),
        "position",
        lat_rad=0.8,
        lon_rad=0.2,
    )
    assert [finding.where for finding in constant_sensors(roles)] == ["GPS", "GPS"]


GIMBAL = attitude(roll=0.0, pitch=0.0, message="MOUNT_ORIENTATION")
PARKED = stuck(flight(0.0, 0.0), "pressure", pressure_pa=9e4)
FEW_PA = np.where(ROW < FEWEST_SAMPLES - 1, 9e4, np.nan)


@pytest.mark.parametrize(
    "roles",
    [
        flight(),
        {},
        flight() | {"attitude": GIMBAL},
        PARKED | {"attitude": attitude(0.0, 0.0, 0.0)},
        flight() | {"pressure": channel("BARO", SECONDS, pressure_pa=FEW_PA)},
    ],
    ids=[
        "a sound flight",
        "an empty log",
        "a gimbal holds an angle",
        "a parked aircraft is still",
        "few samples may be equal",
    ],
)
def test_what_may_rightly_be_constant(roles):
    assert constant_sensors(roles) == ()


SOUND = ("flight.bin", "flight.tlog", "flight.mcap", "pymavlink_swift_flight.tlog")


@pytest.mark.parametrize("name", at_hand(*SOUND))
def test_no_real_flight_has_one(name):
    log = open_log(LOGS[name])
    assert constant_sensors(plausible_roles(log.channels)) == ()
