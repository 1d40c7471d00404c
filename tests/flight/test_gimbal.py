"""Cameras on gimbals: where they look, and what is said of it. Expected directions by hand."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount, gimbal_notes, payload_attitude
from unbend.flight.roles import assign_roles
from unbend.flight.station_builder import build_stations
from unbend.flight.stations import Stations
from unbend.ingest import open_log
from unbend.messages import Ledger

SECOND = 1_000_000_000
START_US = 1_700_000_000_000_000
BOOT_US = 60_000_000
# the gimbal points forward and down
PITCH = math.radians(-45.0)
YAW = math.radians(4.0)
# Yaw about down, then pitch about right, by half angles: w, x, y, z as MAVLink has them.
Q = (
    math.cos(PITCH / 2) * math.cos(YAW / 2),
    -math.sin(PITCH / 2) * math.sin(YAW / 2),
    math.sin(PITCH / 2) * math.cos(YAW / 2),
    math.cos(PITCH / 2) * math.sin(YAW / 2),
)
YAW_IN_EARTH_FRAME = 64
MNT = "<QB9f"
AHEAD = Mount(pitch_rad=math.pi / 2)
FORWARD_DOWN = np.array(  # east, north, up
    [math.sin(YAW) * math.sqrt(0.5), math.cos(YAW) * math.sqrt(0.5), -math.sqrt(0.5)]
)
BACK_DOWN = FORWARD_DOWN * [-1.0, -1.0, 1.0]


def dataflash(path: Path) -> str:
    def define(kind: int, name: str, letters: str, columns: str, layout: str) -> bytes:
        size = 3 + struct.calcsize(layout)
        words = (name.encode(), letters.encode(), columns.encode())
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, *words)

    gps = "<QBBIHBhiii"
    data = define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "<BB4s16s64s")
    data += define(20, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt", gps)
    columns = "TimeUS,I,DRoll,Roll,DPitch,Pitch,DYawB,YawB,DYawE,YawE,Dist"
    data += define(60, "MNT", "QBfffffffff", columns, MNT)
    for k in range(20):
        at = BOOT_US + 200_000 * k
        fix = (at, 0, 3, 1000 + 200 * k, 2200, 12, 80, 470_000_000, 80_000_000, 60_000)
        data += b"\xa3\x95\x14" + struct.pack(gps, *fix)
        data += b"\xa3\x95\x3c" + struct.pack(MNT, at, 0, 0, 0, 0, -45, 0, 4, 0, 4, 0)
    path.write_bytes(data)
    return "MNT[0]"


def tlog(path: Path, name: str) -> str:
    from pymavlink.dialects.v20 import all as dialect

    sender = dialect.MAVLink(None, 1, 1)
    data = b""
    for k in range(20):
        ms = 60_000 + 200 * k
        utc_us = START_US + 200_000 * k
        gimbal = {
            "MOUNT_ORIENTATION": dialect.MAVLink_mount_orientation_message(
                ms, roll=0.0, pitch=-45.0, yaw=-80.0, yaw_absolute=4.0
            ),
            "GIMBAL_DEVICE_ATTITUDE_STATUS": dialect.MAVLink_gimbal_device_attitude_status_message(
                0, 0, ms, YAW_IN_EARTH_FRAME, Q, 0.0, 0.0, 0.0, 0
            ),
        }[name]
        for message in (dialect.MAVLink_system_time_message(utc_us, ms), gimbal):
            data += struct.pack(">Q", utc_us) + message.pack(sender)
    path.write_bytes(data)
    return "GIMBAL_DEVICE_ATTITUDE_STATUS[0]" if "DEVICE" in name else name


def mcap(path: Path, package: str) -> str:
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    schema = writer.register_msgdef(
        f"{package}/msg/GimbalDeviceAttitudeStatus",
        "uint64 timestamp\nuint16 device_flags\nfloat32[4] q",
    )
    for k in range(20):
        at_us = START_US + 200_000 * k
        message = {"timestamp": at_us, "device_flags": YAW_IN_EARTH_FRAME, "q": list(Q)}
        writer.write_message("/gimbal", schema, message, at_us * 1000)
    writer.finish()
    path.write_bytes(file.getvalue())
    return "/gimbal"


LOGS: dict[str, tuple[str, Callable[[Path], str]]] = {
    "MNT": ("log.bin", dataflash),
    "MOUNT_ORIENTATION": ("log.tlog", lambda path: tlog(path, "MOUNT_ORIENTATION")),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": (
        "log.tlog",
        lambda path: tlog(path, "GIMBAL_DEVICE_ATTITUDE_STATUS"),
    ),
    "px4_msgs": ("log.mcap", lambda path: mcap(path, "px4_msgs")),
}


def named(*channels: Channel, gimbal: str, mounts: dict[str, Mount]):
    """The roles where a channel is named as attitude, and what is said of gimbals."""
    ledger = Ledger()
    roles = assign_roles(channels, {"attitude": gimbal}, needs_cabin=False)[0]
    ledger.extend(gimbal_notes({"MNT": 20, "ATT": 20}, roles, mounts))
    return roles, ledger


def station_of(roles: dict[str, Channel], mount: Mount) -> Stations:
    time_ns = roles["attitude"].time_ns
    events = Events("cam", np.array(["a"], object), time_ns[5:6] + SECOND // 20)
    return build_stations(events, roles, mount, HeightSystem(), 1.0)


def camera_axes(attitude: Channel, mount: Mount) -> np.ndarray:
    """Optical axis and top of the image of a camera, as rows of east, north, up."""
    place = {"lat_rad": 0.82, "lon_rad": 0.14, "h_msl_m": 1000.0}
    columns = {name: np.full(len(attitude), value) for name, value in place.items()}
    position = Channel("POS", attitude.time_ns, columns, Source("POS"))
    station = station_of({"position": position, "height": position, "attitude": attitude}, mount)
    assert station.ok.all()
    assert np.isnan(station.aircraft_quaternion).all(), "a gimbal's is not the aircraft's"
    enu_from_camera = Rotation.from_quat(station.quaternion[0][[1, 2, 3, 0]]).inv()
    return enu_from_camera.apply([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@pytest.mark.parametrize("message", LOGS)
def test_a_camera_of_every_gimbal_looks_forward_and_down(message: str, tmp_path: Path) -> None:
    """With the mount of an aircraft, which is 90 degrees away, it looks back and down."""
    file, write = LOGS[message]
    name = write(tmp_path / file)
    log = open_log(tmp_path / file)
    mounts = {"right": AHEAD, "wrong": Mount()}
    roles, ledger = named(*log.channels, gimbal=name, mounts=mounts)
    axis, top = camera_axes(roles["attitude"], AHEAD)
    assert axis == pytest.approx(FORWARD_DOWN, abs=1e-6)
    assert top == pytest.approx(FORWARD_DOWN * [1.0, 1.0, -1.0], abs=1e-6)  # forward and up
    axis, top = camera_axes(roles["attitude"], Mount())
    assert axis == pytest.approx(BACK_DOWN, abs=1e-6)
    assert top == pytest.approx(FORWARD_DOWN, abs=1e-6)
    told = [(e.kind, e.code, e.where) for e in ledger]
    assert told == [
        ("note", "GIMBAL-FRAME", "mount.right"),
        ("warning", "GIMBAL-FRAME", "mount.wrong"),
    ]


def of_angles(name: str, roll_deg: float, pitch_deg: float, yaw_deg: float) -> Channel:
    """An aircraft's attitude: yaw, then pitch, then roll, by products of half-angle quaternions."""
    w, x, y, z = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_quat()[
        [3, 0, 1, 2]
    ]
    columns = {"q_w": w, "q_x": x, "q_y": y, "q_z": z}
    return Channel(
        name,
        np.arange(5) * SECOND,
        {k: np.full(5, v) for k, v in columns.items()},
        Source(name),
        roles=("attitude",),
    )


NOSE_ANGLES = {"gimbal_roll_rad": 0.0, "gimbal_pitch_rad": PITCH, "gimbal_yaw_rad": YAW}
NOSE_QUATERNION = dict(
    zip(("gimbal_q_w", "gimbal_q_x", "gimbal_q_y", "gimbal_q_z"), Q, strict=True)
)


@pytest.mark.parametrize("columns", [NOSE_ANGLES, NOSE_QUATERNION], ids=["angles", "quaternion"])
def test_yaw_from_the_nose_is_turned_by_the_aircraft_s(columns: dict[str, float]) -> None:
    """The aircraft flies east, banks 20 deg and climbs: the payload looks to 94 deg and 45 down."""
    unknown = {f"q_{axis}": np.nan for axis in "wxyz"} if columns is NOSE_QUATERNION else {}
    gimbal = Channel(
        "MOUNT_STATUS",
        np.arange(1, 11) * SECOND // 3,
        {name: np.full(10, value) for name, value in (columns | unknown).items()},
        Source("MOUNT_STATUS"),
    )
    aircraft = of_angles("ATTITUDE", 20.0, 8.0, 90.0)
    payload, (told,) = payload_attitude(gimbal, aircraft, 2.0)
    axis, top = camera_axes(payload, AHEAD)
    to_the_east = FORWARD_DOWN[[1, 0, 2]] * [1.0, -1.0, 1.0]
    assert axis == pytest.approx(to_the_east, abs=1e-9)
    assert top == pytest.approx(to_the_east * [1.0, 1.0, -1.0], abs=1e-9)
    assert (told.code, told.kind, told.count) == ("GIMBAL-YAW", "note", 10)
    assert "ATTITUDE is added" in told.what


@pytest.mark.parametrize("message", ["MOUNT_STATUS", "MOUNT_ORIENTATION"])
@pytest.mark.parametrize("servos", [True, False])
def test_angles_of_servos_are_to_the_aircraft(message: str, servos: bool) -> None:
    """They counter its roll and pitch; MOUNT_ORIENTATION is to the horizon by its definition."""
    k = np.arange(200)
    roll = 0.3 * np.sin(k / 7.0)
    pitch = 0.2 * np.cos(k / 11.0)
    yaw = k / 40.0
    turns = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
    columns = dict(zip(("q_x", "q_y", "q_z", "q_w"), turns.as_quat().T, strict=True))
    aircraft = Channel("ATTITUDE", k * SECOND // 10, columns, Source("ATTITUDE"))
    own = np.stack([0.5 + 0.0 * k, 0.1 - servos * pitch, -servos * roll], axis=1)
    angles = dict(
        zip(("gimbal_yaw_rad", "gimbal_pitch_rad", "gimbal_roll_rad"), own.T, strict=True)
    )
    angles["gimbal_yaw_rad"] = np.where(
        k == 3, 4.7e6, 0.5
    )  # a place, as autopilots of 2012 send it
    payload, _ = payload_attitude(
        Channel(message, aircraft.time_ns, angles, Source(message)), aircraft, 2.0
    )
    ours = np.stack([payload[f"q_{axis}"] for axis in "xyzw"], axis=1)
    assert np.flatnonzero(np.isnan(ours).any(axis=1)).tolist() == [3]
    if servos and message == "MOUNT_STATUS":
        expected = turns * Rotation.from_euler("ZYX", own)
    else:
        expected = Rotation.from_euler("ZYX", own + np.stack([yaw, 0.0 * k, 0.0 * k], axis=1))
    apart = (Rotation.from_quat(ours[k != 3]) * expected[k != 3].inv()).magnitude()
    assert apart.max() < 1e-7


def test_a_gimbal_that_knows_north_and_one_without_an_aircraft_stay_as_they_are() -> None:
    mnt = attitude("MNT[0]", "MNT", -30.0)
    assert payload_attitude(mnt, of_angles("ATT", 0.0, 0.0, 90.0), 2.0) == (mnt, ())
    status = Channel(
        "S",
        np.arange(3) * SECOND,
        {k: np.full(3, v) for k, v in NOSE_ANGLES.items()},
        Source("MOUNT_STATUS"),
    )
    assert payload_attitude(status, None, 2.0) == (status, ())


def attitude(name: str, message: str, pitch_deg: float) -> Channel:
    half = math.radians(pitch_deg) / 2.0
    columns = {"q_w": math.cos(half), "q_x": 0.0, "q_y": math.sin(half), "q_z": 0.0}
    time_ns = np.arange(5) * SECOND
    return Channel(
        name,
        time_ns,
        {k: np.full(5, v) for k, v in columns.items()},
        Source(message),
        roles=() if message != "ATT" else ("attitude",),
    )


@pytest.mark.parametrize(
    ("pitch_deg", "mount", "kind", "away", "nadir"),
    [
        (-90.0, AHEAD, "note", 0, 0),
        (-90.0, Mount(), "warning", 90, 90),
        (-30.0, AHEAD, "note", 0, 60),
        (-30.0, Mount(pitch_rad=math.radians(60.0)), "note", 30, 30),
        (-30.0, Mount(pitch_rad=math.radians(120.0)), "note", 30, 90),
        (-80.0, Mount(roll_rad=math.radians(-90.0)), "warning", 90, 90),  # to the right
    ],
)
def test_where_each_camera_looks_is_told(
    pitch_deg: float, mount: Mount, kind: str, away: int, nadir: int
) -> None:
    gimbal = attitude("MNT[0]", "MNT", pitch_deg)
    _, ledger = named(gimbal, gimbal="MNT[0]", mounts={"oblique": mount})
    (entry,) = ledger
    assert (entry.kind, entry.code, entry.where) == (kind, "GIMBAL-FRAME", "mount.oblique")
    assert f"oblique looks {away} deg away" in entry.what
    assert f"{nadir} deg from straight down" in entry.what
    assert "pitch_deg: 90" in entry.what


def test_rows_without_an_attitude_do_not_count() -> None:
    gimbal = attitude("MNT[0]", "MNT", -90.0)
    for known, told in ((slice(0, 3), 1), (slice(0, 5), 0)):
        gimbal["q_y"][known] = np.nan
        _, ledger = named(gimbal, gimbal="MNT[0]", mounts={"nadir": AHEAD})
        assert ["0 deg from straight down" in entry.what for entry in ledger] == [True] * told


@pytest.mark.parametrize(
    ("messages", "ignored"),
    [
        ({"ATT": 10}, ""),
        ({"ATT": 10, "MNT": 0}, ""),
        ({"ATT": 10, "MNT": 7}, "7 MNT"),
        ({"MOUNT_ORIENTATION": 7, "MOUNT_STATUS": 3}, "7 MOUNT_ORIENTATION, 3 MOUNT_STATUS"),
        ({"GIMBAL_DEVICE_ATTITUDE_STATUS": 7}, "7 GIMBAL_DEVICE_ATTITUDE_STATUS"),
        ({"gimbal_device_attitude_status": 7}, "7 gimbal_device_attitude_status"),
        ({"/fmu/out/gimbal_device_attitude_status": 7}, "7 /fmu/out/gimbal_device"),
    ],
)
def test_a_gimbal_that_nobody_follows_is_told(messages: dict[str, int], ignored: str) -> None:
    aircraft = attitude("ATT", "ATT", 0.0)
    for roles in ({"attitude": aircraft}, {}):
        ledger = Ledger()
        ledger.extend(gimbal_notes(messages, roles, {"nadir": Mount()}))
        assert [(e.kind, e.code) for e in ledger] == [("warning", "GIMBAL-IGNORED")] * bool(ignored)
        assert all(
            ignored in entry.what and "fixed to the aircraft" in entry.what for entry in ledger
        )


def test_a_gimbal_that_is_followed_is_not_said_to_be_ignored() -> None:
    both = (attitude("ATT", "ATT", 0.0), attitude("MNT[0]", "MNT", -90.0))
    _, ledger = named(*both, gimbal="MNT[0]", mounts={"nadir": AHEAD, "oblique": AHEAD})
    assert {entry.code for entry in ledger} == {"GIMBAL-FRAME"}
    assert [entry.where for entry in ledger] == ["mount.nadir", "mount.oblique"]
    _, ledger = named(*both, gimbal="ATT", mounts={"nadir": Mount()})
    assert [entry.code for entry in ledger] == ["GIMBAL-IGNORED"]


def test_a_mission_is_told_of_its_gimbal(mission, unbend) -> None:
    columns = b"TimeUS,I,DRoll,Roll,DPitch,Pitch,DYawB,YawB,DYawE,YawE,Dist"
    rows = struct.pack("<BB4s16s64s", 99, 3 + struct.calcsize(MNT), b"MNT", b"QBfffffffff", columns)
    data = mission.log.read_bytes() + b"\xa3\x95\x80" + rows
    for us in open_log(mission.log).message("ATT")["TimeUS"].tolist():
        data += b"\xa3\x95\x63" + struct.pack(MNT, us, 0, 0, 0, 0, -45, 0, 4, 0, 4, 0)
    mission.log.write_bytes(data)
    said = unbend("check", mission.save()).text
    assert "GIMBAL-IGNORED" in said
    assert "GIMBAL-FRAME" not in said
    mission.config["log"]["channels"]["attitude"] = "MNT[0]"
    mission.config["mount"]["nadir"] = {"pitch_deg": 90.0}
    said = unbend("check", "-v", mission.save()).text
    assert "GIMBAL-IGNORED" not in said
    assert said.count("note GIMBAL-FRAME") == 1  # nadir
    assert said.count("warning GIMBAL-FRAME") == 1  # oblique has the mount of an aircraft


@pytest.mark.parametrize(
    ("ids", "names"),
    [([1, 1], ["/gimbal"]), ([1, 2], ["/gimbal[1]", "/gimbal[2]"])],
    ids=["one gimbal", "two gimbals"],
)
def test_the_number_of_a_gimbal_names_a_channel_only_where_there_are_several(
    tmp_path: Path, ids: list[int], names: list[str]
) -> None:
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    definition = "uint64 timestamp\nuint16 device_flags\nfloat32[4] q\nuint8 gimbal_device_id"
    schema = writer.register_msgdef("px4_msgs/msg/GimbalDeviceAttitudeStatus", definition)
    for k in range(20):
        at_us = START_US + 200_000 * k
        message = {
            "timestamp": at_us,
            "device_flags": YAW_IN_EARTH_FRAME,
            "q": list(Q),
            "gimbal_device_id": ids[k % 2],
        }
        writer.write_message("/gimbal", schema, message, at_us * 1000)
    writer.finish()
    path = tmp_path / "log.mcap"
    path.write_bytes(file.getvalue())
    assert [channel.name for channel in open_log(path).channels] == names
