"""Cameras on gimbals: where they look, and what is said of it. Expected directions by hand."""

import math
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import (
    counted,
    image_names,
    instants,
    located,
    quaternion_columns,
    rotation_of,
    turned_channel,
    with_columns,
)
from tests.helpers import channel
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount, gimbal_notes, payload_attitude
from unbend.flight.station_builder import build_stations
from unbend.ingest import open_log

SECONDS = np.arange(5.0)
AHEAD = Mount(pitch_rad=math.pi / 2)
AS_IN_AN_AIRCRAFT = Mount()


def attitude(message, *yaw_pitch_roll_deg):
    return turned_channel(message, SECONDS, "ZYX", yaw_pitch_roll_deg, "attitude")


def camera_axes(gimbal, mount):
    """Optical axis and top of the image of a camera, as rows of east, north, up."""
    position = channel(
        "POS",
        [0, 9],
        lat_rad=0.82,
        lon_rad=0.14,
        h_msl_m=1000.0,
    )
    roles = {
        "position": position,
        "height": position,
        "attitude": gimbal,
    }
    exposure = Events("cam", image_names("a"), instants(1.8))
    station = build_stations(exposure, roles, mount, HeightSystem(), 10.0)
    assert station.ok.all()
    assert np.isnan(station.aircraft_quaternion).all(), "a gimbal's is not the aircraft's"
    enu_from_camera = rotation_of(station.quaternion[0]).inv()
    return enu_from_camera.apply([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


HALF = math.sqrt(0.5)
# The gimbal points 45 deg down and 4 deg to the right of north.
PITCH = math.radians(-45.0)
YAW = math.radians(4.0)
FORWARD_DOWN = np.array(
    [
        math.sin(YAW) * HALF,
        math.cos(YAW) * HALF,
        -HALF,
    ]
)
FORWARD_UP = FORWARD_DOWN * [1.0, 1.0, -1.0]
GIMBAL = quaternion_columns(Rotation.from_euler("ZYX", [YAW, PITCH, 0.0]))


@pytest.mark.parametrize(
    ("mount", "axis", "top"),
    [
        (AHEAD, FORWARD_DOWN, FORWARD_UP),
        (AS_IN_AN_AIRCRAFT, -FORWARD_UP, FORWARD_DOWN),
    ],
    ids=["forward and down", "with the mount of an aircraft back and down"],
)
def test_a_camera_on_a_gimbal_looks_where_that_points(mount, axis, top):
    gimbal = channel("MNT[0]", SECONDS, **GIMBAL)
    assert camera_axes(gimbal, mount) == pytest.approx(np.array([axis, top]), abs=1e-9)


NAN = float("nan")
UNKNOWN = dict.fromkeys(GIMBAL, NAN)
TO_NOSE = {f"gimbal_{name}": value for name, value in GIMBAL.items()}
NOSE_ANGLES = {
    "gimbal_roll_rad": 0.0,
    "gimbal_pitch_rad": PITCH,
    "gimbal_yaw_rad": YAW,
}


@pytest.mark.parametrize(
    "columns",
    [NOSE_ANGLES, TO_NOSE | UNKNOWN],
    ids=["angles", "quaternion"],
)
def test_yaw_from_the_nose_is_turned_by_the_aircraft_s(columns):
    """The aircraft flies east, banks 20 deg and climbs: the payload looks to 94 deg and 45 down."""
    gimbal = channel("MOUNT_STATUS", SECONDS[1:] - 0.3, **columns)
    aircraft = attitude("ATTITUDE", 90.0, 8.0, 20.0)

    payload, notes = payload_attitude(gimbal, aircraft, 2.0)

    to_the_east = FORWARD_DOWN[[1, 0, 2]] * [1.0, -1.0, 1.0]
    axes = np.array([to_the_east, to_the_east * [1.0, 1.0, -1.0]])
    assert camera_axes(payload, AHEAD) == pytest.approx(axes, abs=1e-9)
    assert counted(notes) == [("note", "GIMBAL-YAW", 4)]
    assert "ATTITUDE is added" in notes[0].what


@pytest.mark.parametrize("counters", [True, False])
@pytest.mark.parametrize("message", ["MOUNT_STATUS", "MOUNT_ORIENTATION"])
def test_angles_of_servos_are_to_the_aircraft(message, counters):
    """They counter its roll and pitch; MOUNT_ORIENTATION is to the horizon by its definition."""
    row = np.arange(200)
    roll = 0.3 * np.sin(row / 7.0)
    pitch = 0.2 * np.cos(row / 11.0)
    yaw = row / 40.0
    still = np.zeros(200)
    turns = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
    aircraft = channel("ATTITUDE", row / 10.0, **quaternion_columns(turns))
    angles = np.stack([still + 0.5, 0.1 - counters * pitch, -counters * roll], axis=1)
    gimbal = channel(
        message,
        row / 10.0,
        gimbal_yaw_rad=np.where(row == 3, 4.7e6, 0.5),  # a place, as autopilots of 2012 send it
        gimbal_pitch_rad=angles[:, 1],
        gimbal_roll_rad=angles[:, 2],
    )

    payload, notes = payload_attitude(gimbal, aircraft, 2.0)

    quaternion = np.stack([payload[name] for name in GIMBAL], axis=1)
    is_known = np.isfinite(quaternion).all(axis=1)
    assert np.flatnonzero(~is_known).tolist() == [3]
    is_to_aircraft = counters and message == "MOUNT_STATUS"
    assert any("compensate the motion" in note.what for note in notes) == is_to_aircraft
    if is_to_aircraft:
        expected = turns * Rotation.from_euler("ZYX", angles)
    else:
        headings = np.stack([yaw, still, still], axis=1)
        expected = Rotation.from_euler("ZYX", angles + headings)
    apart = rotation_of(quaternion[is_known]) * expected[is_known].inv()
    assert apart.magnitude().max() < 1e-7


@pytest.mark.parametrize(
    ("gimbal", "aircraft"),
    [
        (attitude("MNT[0]", 0.0, -30.0, 0.0), attitude("ATT", 90.0, 0.0, 0.0)),
        (channel("MOUNT_STATUS", SECONDS, **NOSE_ANGLES), None),
    ],
    ids=["one that knows north", "no aircraft"],
)
def test_a_gimbal_that_stays_as_it_is(gimbal, aircraft):
    assert payload_attitude(gimbal, aircraft, 2.0) == (gimbal, ())


def pitched(degrees):
    return Mount(pitch_rad=math.radians(degrees))


@pytest.mark.parametrize(
    ("pitch_deg", "mount", "kind", "away", "nadir"),
    [
        (-90.0, AHEAD, "note", 0, 0),
        (-90.0, AS_IN_AN_AIRCRAFT, "warning", 90, 90),
        (-30.0, AHEAD, "note", 0, 60),
        (-30.0, pitched(60.0), "note", 30, 30),
        (-30.0, pitched(120.0), "note", 30, 90),
        (-30.0, pitched(44.0), "warning", 46, 14),
        (-80.0, Mount(roll_rad=-math.pi / 2), "warning", 90, 90),  # to the right
    ],
)
def test_where_each_camera_looks_is_told(pitch_deg, mount, kind, away, nadir):
    roles = {"attitude": attitude("MNT[0]", 0.0, pitch_deg, 0.0)}
    (note,) = gimbal_notes({"MNT": 20, "ATT": 20}, roles, {"oblique": mount})
    assert located([note]) == [(kind, "GIMBAL-FRAME", "mount.oblique")]
    assert f"oblique looks {away} deg away" in note.what
    assert f"{nadir} deg from straight down" in note.what
    assert "pitch_deg: 90" in note.what


def test_rows_without_an_attitude_do_not_count():
    """The last two rows point straight down; without any known row there is nothing to say."""
    gimbal = attitude("MNT[0]", 0.0, -90.0, 0.0)

    def notes_from(first_s):
        """With a gimbal that is known from a second on."""
        q_y = np.where(first_s > SECONDS, NAN, gimbal["q_y"])
        roles = {"attitude": with_columns(gimbal, q_y=q_y)}
        return list(gimbal_notes({"MNT": 5}, roles, {"nadir": AHEAD}))

    (note,) = notes_from(3.0)
    assert "0 deg from straight down" in note.what
    assert notes_from(9.0) == []


@pytest.mark.parametrize(
    ("messages", "ignored"),
    [
        ({"ATT": 10}, None),
        ({"ATT": 10, "MNT": 0}, None),
        ({"ATT": 10, "MNT": 7}, "7 MNT"),
        ({"MOUNT_ORIENTATION": 7, "MOUNT_STATUS": 3}, "7 MOUNT_ORIENTATION, 3 MOUNT_STATUS"),
        ({"GIMBAL_DEVICE_ATTITUDE_STATUS": 7}, "7 GIMBAL_DEVICE_ATTITUDE_STATUS"),
        ({"gimbal_device_attitude_status": 7}, "7 gimbal_device_attitude_status"),
        ({"/fmu/out/gimbal_device_attitude_status": 7}, "7 /fmu/out/gimbal_device"),
    ],
)
@pytest.mark.parametrize("roles", [{"attitude": attitude("ATT", 0.0, 0.0, 0.0)}, {}])
def test_a_gimbal_that_nobody_follows_is_told(messages, ignored, roles):
    notes = list(gimbal_notes(messages, roles, {"nadir": AS_IN_AN_AIRCRAFT}))
    is_told = ignored is not None
    assert located(notes) == [("warning", "GIMBAL-IGNORED", "")] * is_told
    for note in notes:
        assert ignored in note.what
        assert "fixed to the aircraft" in note.what


MNT = "<QB9f"
MNT_COLUMNS = b"TimeUS,I,DRoll,Roll,DPitch,Pitch,DYawB,YawB,DYawE,YawE,Dist"


def test_a_mission_is_told_of_its_gimbal(mission, unbend):
    definition = (99, 3 + struct.calcsize(MNT), b"MNT", b"QBfffffffff", MNT_COLUMNS)
    data = mission.log.read_bytes() + b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *definition)
    for time_us in open_log(mission.log).message("ATT")["TimeUS"].tolist():
        data += b"\xa3\x95\x63" + struct.pack(
            MNT,
            time_us,
            0,
            0,
            0,
            0,
            -45,
            0,
            4,
            0,
            4,
            0,
        )
    mission.log.write_bytes(data)

    of_aircraft = unbend("check", mission.save()).text
    mission.config["log"]["channels"]["attitude"] = "MNT[0]"
    mission.config["mount"]["nadir"] = {"pitch_deg": 90.0}
    of_gimbal = unbend("check", "-v", mission.save()).text

    assert "GIMBAL-IGNORED" in of_aircraft
    assert "GIMBAL-FRAME" not in of_aircraft
    assert "GIMBAL-IGNORED" not in of_gimbal
    assert of_gimbal.count("note GIMBAL-FRAME") == 1  # nadir
    assert of_gimbal.count("warning GIMBAL-FRAME") == 1  # oblique has the mount of an aircraft
