"""The messages that logs are known to carry: each is a channel with these values, or a table."""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unbend.ingest import Log, open_log

STAMP_US = 1_700_000_000_000_000
START_NS = STAMP_US * 1000
LAT = math.radians(47.5)
LON = math.radians(-122.25)
PLACE = {"lat_rad": LAT, "lon_rad": LON}
E7 = {"lat": 475_000_000, "lon": -1_222_500_000}
LNG = {"lat": 475_000_000, "lng": -1_222_500_000}
BOOT = {"time_boot_ms": 60_000}
USEC = {"time_usec": 60_000_000}

MOVING = {"v_north_m_s": 1.5, "v_east_m_s": -2.75, "v_down_m_s": 0.5}
RATES = {"rollspeed": 0.5, "pitchspeed": -0.25, "yawspeed": 0.125}
TURNING = {"rate_x_rad_s": 0.5, "rate_y_rad_s": -0.25, "rate_z_rad_s": 0.125}
HEALTH = {
    "innovation_velocity": 0.25,
    "innovation_position": 14.5,
    "innovation_height": 0.5,
    "innovation_compass": 0.75,
}

# MAVLink: fields as sent, and columns in SI. No columns: it plays no part and is a table only.
MAVLINK: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "GPS_RAW_INT": (
        E7
        | USEC
        | {
            "fix_type": 3,
            "alt": 600_250,
            "alt_ellipsoid": 580_500,
            "h_acc": 450,
            "vel_acc": 120,
            "vel": 2_000,
            "cog": 12_000,
            "eph": 121,
            "satellites_visible": 17,
        },
        PLACE
        | {"h_msl_m": 600.25, "h_ellipsoid_m": 580.5, "sigma_h_m": 0.45 / 2**0.5}
        | {
            "sigma_speed_m_s": 0.12,
            "v_north_m_s": -10.0,
            "v_east_m_s": 10.0 * math.sqrt(3.0),
            "hdop": 1.21,
            "satellites": 17.0,
            "fix": 3.0,
        },
    ),
    "GPS2_RAW": (
        E7 | USEC | {"fix_type": 4, "alt": -428_000, "alt_ellipsoid": -400_000, "v_acc": 700},
        PLACE | {"h_msl_m": -428.0, "h_ellipsoid_m": -400.0, "sigma_v_m": 0.7},
    ),
    "GLOBAL_POSITION_INT": (
        E7 | BOOT | {"alt": 600_250, "relative_alt": 30_500, "vx": 150, "vy": -275, "vz": 50},
        PLACE | {"h_msl_m": 600.25, "h_home_m": 30.5} | MOVING,
    ),
    "GLOBAL_POSITION_INT_COV": (
        E7 | USEC | {"alt": 600_250, "relative_alt": 30_500, "vx": 1.5, "vy": -2.75, "vz": 0.5},
        PLACE | {"h_msl_m": 600.25, "h_home_m": 30.5} | MOVING,
    ),
    "LOCAL_POSITION_NED": (
        BOOT | {"x": 10.5, "y": -20.25, "z": -30.5, "vx": 1.5, "vy": -2.75, "vz": 0.5},
        {"north_m": 10.5, "east_m": -20.25, "up_m": 30.5} | MOVING,
    ),
    "EKF_STATUS_REPORT": (
        {
            "velocity_variance": 0.25,
            "pos_horiz_variance": 14.5,
            "pos_vert_variance": 0.5,
            "compass_variance": 0.75,
            "flags": 831 | 1 << 15,
        },
        {
            "innovation_velocity": 0.25,
            "innovation_position": 14.5,
            "innovation_height": 0.5,
            "innovation_compass": 0.75,
            "filter_flags": float(831 | 1 << 15),
        },
    ),
    "ESTIMATOR_STATUS": (
        USEC
        | {
            "vel_ratio": 0.25,
            "pos_horiz_ratio": 14.5,
            "pos_vert_ratio": 0.5,
            "mag_ratio": 0.75,
            "flags": 831 | 1 << 10,
            "pos_horiz_accuracy": 1.5,
        },
        {
            "innovation_velocity": 0.25,
            "innovation_position": 14.5,
            "innovation_height": 0.5,
            "innovation_compass": 0.75,
            "filter_flags": float(831 | 1 << 15),
            "sigma_h_m": 1.5 / 2**0.5,
        },
    ),
    "VIBRATION": (
        USEC
        | {
            "vibration_x": 3.5,
            "vibration_y": 31.25,
            "vibration_z": 2.0,
            "clipping_0": 4,
            "clipping_2": 3,
        },
        {"vibration_m_s2": 31.25, "clipping": 7.0},
    ),
    "AHRS2": (
        LNG | {"yaw": math.pi / 2, "altitude": 600.25},
        PLACE | {"q_w": math.sqrt(0.5), "q_z": math.sqrt(0.5), "h_msl_m": 600.25},
    ),
    "VFR_HUD": ({"airspeed": 41.5, "alt": 600.25}, {"airspeed_m_s": 41.5, "h_msl_m": 600.25}),
    "ALTITUDE": (
        USEC | {"altitude_amsl": 600.0, "altitude_relative": 30.5},
        {"h_msl_m": 600.0, "h_home_m": 30.5},
    ),
    "ATTITUDE": (
        BOOT | {"yaw": math.pi / 2} | RATES,
        {"q_w": math.sqrt(0.5), "q_z": math.sqrt(0.5)} | TURNING,
    ),
    "ATTITUDE_QUATERNION": (
        BOOT | {"q1": 0.5, "q2": 0.5, "q3": -0.5, "q4": 0.5} | RATES,
        {"q_w": 0.5, "q_x": 0.5, "q_y": -0.5, "q_z": 0.5} | TURNING,
    ),
    **{
        name: (
            BOOT | {"press_abs": 700.25, "temperature": 4500, "temperature_press_diff": -1250},
            {"pressure_pa": 70_025.0, "board_temperature_k": 318.15},
        )
        for name in ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")
    },
    "HIGHRES_IMU": (USEC | {"abs_pressure": 700.25}, {"pressure_pa": 70_025.0}),
    "RAW_IMU": (USEC | {"temperature": 4500}, {"board_temperature_k": 318.15}),
    "MCU_STATUS": ({"MCU_temperature": 4500}, {"board_temperature_k": 318.15}),
    "HYGROMETER_SENSOR": (
        {"temperature": -1250, "humidity": 4725},
        {"temperature_k": 260.65, "relative_humidity": 0.4725},
    ),
    "AIRSPEED": (
        {"temperature": -1250, "airspeed": 41.5},
        {"temperature_k": 260.65, "airspeed_m_s": 41.5},
    ),
    "HIGH_LATENCY2": ({"temperature_air": -12}, {"temperature_k": 261.15}),
    "NAMED_VALUE_FLOAT": (BOOT | {"name": b"CabT", "value": 21.5}, {"value": 21.5}),
    "NAMED_VALUE_INT": (BOOT | {"name": b"CabT", "value": 21}, {"value": 21.0}),
    "DEBUG_VECT": (USEC | {"name": b"Cab", "x": 1.5, "z": -2.5}, {"x": 1.5, "z": -2.5}),
    "DEBUG_FLOAT_ARRAY": (
        USEC | {"name": b"Cab", "data": [21.5, 0.0, 3.5] + [0.0] * 55},
        {"value": 21.5, "value_2": 3.5},
    ),
    "TUNNEL": ({}, {}),
    "CAMERA_FEEDBACK": (
        LNG | USEC | {"img_idx": 7, "alt_msl": 600.5, "alt_rel": 30.5, "roll": 90.0},
        PLACE | {"event_index": 7.0, "h_msl_m": 600.5, "h_home_m": 30.5, "roll_rad": math.pi / 2},
    ),
    "CAMERA_TRIGGER": (USEC | {"seq": 7}, {"event_index": 7.0}),
    "CAMERA_IMAGE_CAPTURED": (
        E7 | BOOT | {"alt": 600_500, "relative_alt": 30_500, "image_index": 7, "capture_result": 1},
        PLACE | {"h_msl_m": 600.5, "h_home_m": 30.5, "event_index": 7.0},
    ),
    "CAMERA_STATUS": ({}, {}),
    "MOUNT_STATUS": ({"pointing_a": -9000}, {"gimbal_pitch_rad": -math.pi / 2}),
    "MOUNT_ORIENTATION": (BOOT | {"pitch": -90.0}, {"gimbal_pitch_rad": -math.pi / 2}),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": (BOOT | {"q": [0.5, 0.5, -0.5, 0.5]}, {"gimbal_q_y": -0.5}),
    "SYSTEM_TIME": ({"time_unix_usec": STAMP_US}, {}),
    "TIMESYNC": ({}, {}),
}


def mavlink_log(path: Path, name: str, fields: dict[str, Any]) -> Log:
    """Ten seconds of a vehicle, once a second with a message whose other fields are zero."""
    from pymavlink.dialects.v20 import all as library

    kind = getattr(library, f"MAVLink_{name.lower()}_message")
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    blank = {
        field: b"" if form == "char" else [0] * lengths[field] if lengths[field] else 0
        for field, form in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    }
    sender = library.MAVLink(None, 1, 1)
    frames = []
    for k in range(10):
        moved = {
            field: value + k * {"time_boot_ms": 1000, "time_usec": 10**6}.get(field, 0)
            if isinstance(value, int)
            else value
            for field, value in (blank | fields).items()
        }
        attitude = library.MAVLink_attitude_message(60_000 + 1000 * k, 0, 0, 0, 0, 0, 0)
        clock = library.MAVLink_system_time_message(STAMP_US + k * 10**6, 60_000 + 1000 * k)
        others = [clock] if name == "ATTITUDE" else [clock, attitude]
        for message in (*others, kind(**moved)):
            frames.append(struct.pack(">Q", STAMP_US + k * 10**6) + message.pack(sender))
            sender.seq = (sender.seq + 1) % 256
    path.write_bytes(b"".join(frames))
    return open_log(path)


def holds(log: Log, message: str, expected: dict[str, float]) -> None:
    """The channel of a message has these values; without any it is none."""
    found = [channel for channel in log.channels if channel.source.message == message]
    if not expected:
        assert not found
        return
    for name, value in expected.items():
        columns = [channel[name] for channel in found if name in channel.columns]
        assert columns, f"{name} is not in {[sorted(c.columns) for c in found]}"
        assert columns[0][-1] == pytest.approx(value, rel=1e-6, abs=1e-7), name


@pytest.mark.parametrize("name", MAVLINK)
def test_mavlink(tmp_path: Path, name: str) -> None:
    fields, expected = MAVLINK[name]
    log = mavlink_log(tmp_path / "one.tlog", name, fields)
    holds(log, name, expected)
    table = log.message(name)
    assert table["time_ns"].shape[0] == log.messages[name] >= 10
    for field, value in fields.items():
        if isinstance(value, int | float) and not field.startswith("time"):
            assert table[field][-1] == pytest.approx(value, rel=1e-6)
    assert not log.ledger.has_losses


# DataFlash: letters and names of the columns behind TimeUS, their values, columns in SI.
_SHOT = {
    "BHIHLLeeeccC I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,R,P,Y":
        (0, 7, 1, 2200, 47.5, -122.25, 600.5, 30.5, 601.0, 90.0, 0.0, 0.0),
    "IHLLeeeccC GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,Roll,Pitch,Yaw":
        (1, 2200, 47.5, -122.25, 600.5, 30.5, 601.0, 90.0, 0.0, 0.0),
}  # fmt: skip
_SHOWN = PLACE | {
    "h_msl_m": 600.5,
    "h_home_m": 30.5,
    "h_gnss_m": 601.0,
    "roll_rad": math.pi / 2,
}
_QUARTER = {"q_w": math.sqrt(0.5), "q_z": math.sqrt(0.5)}
_Q = {"q_w": 0.5, "q_x": 0.5, "q_y": -0.5, "q_z": 0.5}
_AIR = {"temperature_k": 260.65, "relative_humidity": 0.4725}
DATAFLASH: list[tuple[str, str, tuple[float | bytes, ...], dict[str, float]]] = [
    (
        "GPS2",
        "BIHLLe Status,GMS,GWk,Lat,Lng,Alt",
        (3, 1000, 2200, 47.5, -122.25, 600.5),
        PLACE | {"h_msl_m": 600.5},
    ),
    (
        "GPS2",
        "BIHBcLLefff Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ",
        (3, 1250, 2200, 9, 1.21, 47.5, -122.25, 600.5, 20.0, 120.0, -0.5),
        PLACE
        | {
            "v_north_m_s": -10.0,
            "v_east_m_s": 10.0 * math.sqrt(3.0),
            "v_down_m_s": -0.5,
            "fix": 3.0,
            "satellites": 9.0,
            "hdop": 1.21,
            "gps_week": 2200.0,
            "gps_week_s": 1.25,
        },
    ),
    (
        "POS",
        "LLee Lat,Lng,Alt,RelHomeAlt",
        (47.5, -122.25, 600.5, 30.5),
        PLACE | {"h_msl_m": 600.5, "h_home_m": 30.5},
    ),
    ("POS", "LLee Lat,Lng,Alt,RelAlt", (47.5, -122.25, 600.5, 30.5), {"h_home_m": 30.5}),
    ("ATT", "ccC Roll,Pitch,Yaw", (0.0, 0.0, 90.0), _QUARTER),
    (
        "AHR2",
        "ccCeLL Roll,Pitch,Yaw,Alt,Lat,Lng",
        (0.0, 0.0, 90.0, 600.25, 47.5, -122.25),
        PLACE | {"h_msl_m": 600.25} | _QUARTER,
    ),
    ("XKQ", "Bffff C,Q1,Q2,Q3,Q4", (0, 0.5, 0.5, -0.5, 0.5), _Q),
    ("NKQ1", "ffff Q1,Q2,Q3,Q4", (0.5, 0.5, -0.5, 0.5), _Q),
    ("XKF1", "BccC C,Roll,Pitch,Yaw", (0, 0.0, 0.0, 90.0), _QUARTER),
    ("NKF1", "ccC Roll,Pitch,Yaw", (0.0, 0.0, 90.0), _QUARTER),
    (
        "NKF1",
        "ccCffffff Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD",
        (0.0, 0.0, 90.0, 1.5, -2.75, 0.5, 10.5, -20.25, -30.5),
        _QUARTER | MOVING | {"north_m": 10.5, "east_m": -20.25, "up_m": 30.5},
    ),
    # solution status: attitude to predicted place, a glitch of the receiver, dead reckoning
    (
        "XKF4",
        "BccccHBI C,SV,SP,SH,SM,FS,TS,SS",
        (0, 0.25, 14.5, 0.5, 0.75, 2, 3, 0x33F | 1 << 13 | 1 << 14 | 1 << 16 | 1 << 18),
        HEALTH
        | {
            "filter_flags": float(0x33F | 1 << 15 | 1 << 18),
            "filter_faults": 2.0,
            "filter_timeouts": 3.0,
        },
    ),
    (
        "NKF4",
        "ccccHBH SV,SP,SH,SM,FS,TS,SS",
        (0.25, 14.5, 0.5, 0.75, 2, 3, 0x33F),
        HEALTH | {"filter_flags": float(0x33F)},
    ),
    ("ORGN", "BLLe Type,Lat,Lng,Alt", (0, 47.5, -122.25, 600.5), PLACE | {"h_msl_m": 600.5}),
    (
        "VIBE",
        "BfffI IMU,VibeX,VibeY,VibeZ,Clip",
        (0, 3.5, 31.25, 2.0, 7),
        {"vibration_m_s2": 31.25, "clipping": 7.0},
    ),
    (
        "VIBE",
        "fffIII VibeX,VibeY,VibeZ,Clip0,Clip1,Clip2",
        (3.5, 31.25, 2.0, 4, 0, 3),
        {"vibration_m_s2": 31.25, "clipping": 7.0},
    ),
    ("IMU", "Bffff I,GyrX,GyrY,GyrZ,T", (0, 0.5, -0.25, 0.125, 45.0), TURNING),
    *(
        (
            name,
            "fc Press,Temp",
            (70_025.0, 45.0),
            {"pressure_pa": 70_025.0, "board_temperature_k": 318.15},
        )
        for name in ("BARO", "BAR2", "BAR3")
    ),
    ("TEMP", "Bf Instance,Temp", (2, -12.5), {"temperature_k": 260.65}),
    ("ARSP", "fc Airspeed,Temp", (41.5, -12.5), {"temperature_k": 260.65, "airspeed_m_s": 41.5}),
    ("HYGR", "Bff Id,Humidity,Temp", (1, 47.25, -12.5), _AIR),
    ("HYGR", "Bff I,Temperature,Humidity", (1, -12.5, 47.25), _AIR),
    ("NVF", "Nf Name,Value", (b"CabT", 21.5), {"value": 21.5}),
    *((name, form, values, _SHOWN) for name in ("CAM", "TRIG") for form, values in _SHOT.items()),
    ("MNT", "Bffff I,Roll,Pitch,YawB,YawE", (0, 0.0, 0.0, 10.0, 90.0), _QUARTER),
    ("IMU", "f T", (45.0,), {}),
    ("TSYN", "f RTT", (1.0,), {}),
]


@pytest.mark.parametrize(("name", "form", "values", "expected"), DATAFLASH)
def test_dataflash(
    tmp_path: Path,
    dataflash_writer: Callable,
    name: str,
    form: str,
    values: tuple[float | bytes, ...],
    expected: dict[str, float],
) -> None:
    writer = dataflash_writer()
    writer.define(20, "GPS", "QBIHLLe", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt")
    letters, fields = form.split()
    writer.define(30, name, "Q" + letters, "TimeUS," + fields)
    for k in range(10):
        time_us = 5_000_000 + 200_000 * k
        writer.row("GPS", time_us, 3, 1000 + 200 * k, 2200, 47.5, -122.25, 600.5)
        writer.row(name, time_us + 1, *values)
    path = tmp_path / "one.bin"
    path.write_bytes(writer.data)
    log = open_log(path)
    holds(log, name, expected)
    table = log.message(name)
    for field, value in zip(fields.split(","), values, strict=True):
        expected_cell = value.decode() if isinstance(value, bytes) else pytest.approx(value)
        assert table[field][-1] == expected_cell, field
    assert not log.ledger.has_losses


XYZW = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"
XYZ = "float64 x\nfloat64 y\nfloat64 z"
PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Point": XYZ,
    "geometry_msgs/Quaternion": XYZW,
    "geometry_msgs/Vector3": XYZ,
    "geographic_msgs/GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude",
}
HEADER = "std_msgs/Header header\n"
TURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}  # x forward to the east: yaw 90 degrees
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": TURNED}
AWAY = {"east_m": 1.0, "north_m": 2.0, "up_m": 3.0} | _QUARTER
RAW_GPS = {"lat": 475_000_000, "lon": -1_222_500_000, "alt": 600_250, "alt_ellipsoid": 580_500}
RAW_PLACE = PLACE | {"h_msl_m": 600.25, "h_ellipsoid_m": 580.5}
QUARTER = {"w": 0.5, "x": 0.5, "y": -0.5, "z": 0.5}
SHOT = {"lat": 47.5, "lon": -122.25, "alt": 600.5, "seq": 7}
SHOT_PX4 = (
    "uint64 timestamp\nuint64 timestamp_utc\nfloat64 lat\nfloat64 lon\nfloat32 alt\nuint32 seq"
)

ROS: list[tuple[str, str, dict[str, Any], dict[str, float]]] = [
    ("geometry_msgs/PoseStamped", HEADER + "geometry_msgs/Pose pose", {"pose": POSE}, AWAY),
    (
        "nav_msgs/Odometry",
        HEADER + "string child\ngeometry_msgs/PoseWithCovariance pose",
        {"child": "b", "pose": {"pose": POSE, "covariance": [0.0] * 36}},
        AWAY,
    ),
    (
        "sensor_msgs/Imu",
        HEADER + "geometry_msgs/Quaternion orientation\n"
        "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity",
        {
            "orientation": TURNED,
            "orientation_covariance": [0.0] * 9,
            "angular_velocity": {"x": 0.5, "y": 0.25, "z": -0.125},
        },
        _QUARTER | TURNING,
    ),
    (
        "sensor_msgs/Image",
        HEADER + "uint32 height\nuint8[] data",
        {"height": 1, "data": b"x"},
        {"event_index": 9.0},
    ),
    (
        "sensor_msgs/TimeReference",
        HEADER + "builtin_interfaces/Time time_ref",
        {"time_ref": {"sec": 1, "nanosec": 2}},
        {},
    ),
    (
        "mavros_msgs/GPSRAW",
        HEADER + "uint8 fix_type\nint32 lat\nint32 lon\nint32 alt\n"
        "uint16 eph\nuint16 vel\nuint16 cog\nuint8 satellites_visible\nint32 alt_ellipsoid\n"
        "uint32 h_acc\nuint32 v_acc",
        RAW_GPS
        | {
            "fix_type": 3,
            "h_acc": 450,
            "eph": 121,
            "vel": 2_000,
            "cog": 12_000,
            "satellites_visible": 17,
        },
        RAW_PLACE
        | {
            "sigma_h_m": 0.45 / 2**0.5,
            "hdop": 1.21,
            "satellites": 17.0,
            "v_north_m_s": -10.0,
            "v_east_m_s": 10.0 * math.sqrt(3.0),
        },
    ),
    (
        "mavros_msgs/CameraImageCaptured",
        HEADER + "geographic_msgs/GeoPoint geo\n"
        "float32 relative_alt\nint32 image_index\nint8 capture_result\nstring file_url",
        {
            "geo": {"latitude": 47.5, "longitude": -122.25, "altitude": 600.5},
            "relative_alt": 30.5,
            "image_index": 7,
            "capture_result": 1,
            "file_url": "a.jpg",
        },
        PLACE | {"h_ellipsoid_m": 600.5, "h_home_m": 30.5, "event_index": 7.0},
    ),
    (
        "mavros_msgs/CamIMUStamp",
        "builtin_interfaces/Time frame_stamp\nint32 frame_seq_id",
        {"frame_seq_id": 7},
        {"event_index": 7.0},
    ),
    (
        "mavros_msgs/DebugValue",
        HEADER + "int32 index\nstring name\nfloat32 value_float",
        {"index": -1, "name": "CabT", "value_float": 21.5},
        {"value": 21.5},
    ),
    (
        "px4_msgs/Airspeed",
        "uint64 timestamp\nfloat32 indicated_airspeed_m_s\n"
        "float32 true_airspeed_m_s\nfloat32 air_temperature_celsius",
        {
            "indicated_airspeed_m_s": 41.5,
            "true_airspeed_m_s": 48.5,
            "air_temperature_celsius": -12.5,
        },
        {"airspeed_m_s": 41.5, "temperature_k": 260.65},
    ),
    (
        "px4_msgs/VehicleAirData",
        "uint64 timestamp\nfloat32 baro_pressure_pa\nfloat32 ambient_temperature",
        {"baro_pressure_pa": 70_025.0, "ambient_temperature": 45.0},
        {"pressure_pa": 70_025.0, "board_temperature_k": 318.15},
    ),
    (
        "px4_msgs/CameraCapture",
        SHOT_PX4 + "\nfloat32[4] q\nint8 result",
        SHOT | {"q": [0.5, 0.5, -0.5, 0.5], "result": 1},
        PLACE | {"event_index": 7.0, "h_msl_m": 600.5, "camera_q_y": -0.5},
    ),
    (
        "mavros_msgs/GimbalDeviceAttitudeStatus",
        HEADER + "uint16 flags\ngeometry_msgs/Quaternion q",
        {"flags": 0, "q": QUARTER},
        {"gimbal_q_w": 0.5, "gimbal_q_y": -0.5},
    ),
    (
        "px4_msgs/VehicleGlobalPosition",
        "uint64 timestamp\nfloat64 lat\nfloat64 lon\nfloat32 alt",
        {"lat": 47.5, "lon": -122.25, "alt": 600.25},
        PLACE | {"h_msl_m": 600.25},
    ),
    (
        "px4_msgs/SensorGps",
        "uint64 timestamp\nfloat64 latitude_deg\nfloat64 longitude_deg\n"
        "float64 altitude_msl_m\nfloat32 s_variance_m_s\nuint8 fix_type\nfloat32 hdop\n"
        "float32 vel_n_m_s\nfloat32 vel_e_m_s\nfloat32 vel_d_m_s\nuint8 satellites_used",
        {
            "latitude_deg": 47.5,
            "longitude_deg": -122.25,
            "altitude_msl_m": 600.25,
            "s_variance_m_s": 0.125,
            "fix_type": 3,
            "hdop": 1.25,
            "vel_n_m_s": 1.5,
            "vel_e_m_s": -2.75,
            "vel_d_m_s": 0.5,
            "satellites_used": 17,
        },
        PLACE | MOVING | {"sigma_speed_m_s": 0.125, "hdop": 1.25, "satellites": 17.0, "fix": 3.0},
    ),
    (
        "px4_msgs/VehicleLocalPosition",
        "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\n"
        "float32 vx\nfloat32 vy\nfloat32 vz\nfloat32 eph\nfloat32 epv\nfloat32 evh",
        {
            "x": 10.5,
            "y": -20.25,
            "z": -30.5,
            "vx": 1.5,
            "vy": -2.75,
            "vz": 0.5,
            "eph": 0.5,
            "epv": 0.75,
            "evh": 0.25,
        },
        MOVING
        | {
            "north_m": 10.5,
            "east_m": -20.25,
            "up_m": 30.5,
            "sigma_h_m": 0.5 / 2**0.5,
            "sigma_v_m": 0.75,
            "sigma_speed_m_s": 0.25,
        },
    ),
    (
        "px4_msgs/VehicleAngularVelocity",
        "uint64 timestamp\nfloat32[3] xyz",
        {"xyz": [0.5, -0.25, 0.125]},
        TURNING,
    ),
    (
        "px4_msgs/EstimatorStatus",
        "uint64 timestamp\nfloat32 vel_test_ratio\n"
        "float32 pos_test_ratio\nfloat32 hgt_test_ratio\nfloat32 mag_test_ratio\n"
        "uint16 solution_status_flags",
        {
            "vel_test_ratio": 0.25,
            "pos_test_ratio": 14.5,
            "hgt_test_ratio": 0.5,
            "mag_test_ratio": 0.75,
            "solution_status_flags": 0x33F | 1 << 10,
        },
        HEALTH | {"filter_flags": float(0x33F | 1 << 15)},
    ),
    (
        "px4_msgs/VehicleImuStatus",
        "uint64 timestamp\nuint32[3] accel_clipping\nfloat32 accel_vibration_metric",
        {"accel_clipping": [4, 0, 3], "accel_vibration_metric": 31.25},
        {"vibration_m_s2": 31.25, "clipping": 7.0},
    ),
    (
        "px4_msgs/SensorBaro",
        "uint64 timestamp\nfloat32 pressure\nfloat32 temperature",
        {"pressure": 70_025.0, "temperature": 45.0},
        {"pressure_pa": 70_025.0, "board_temperature_k": 318.15},
    ),
    ("px4_msgs/CameraTrigger", SHOT_PX4, SHOT, PLACE | {"event_index": 7.0, "h_msl_m": 600.5}),
    (
        "px4_msgs/GimbalDeviceAttitudeStatus",
        "uint64 timestamp\nuint16 device_flags\nfloat32[4] q",
        {"device_flags": 0, "q": [0.5, 0.5, -0.5, 0.5]},
        {"gimbal_q_y": -0.5},
    ),
]


def stamp(k: int) -> dict[str, int]:
    return {"sec": START_NS // 10**9 + k, "nanosec": 0}


def parts_of(definition: str) -> str:
    """A definition with the definitions that it needs behind it."""
    names = [definition]
    text = definition
    for name, part in PARTS.items():
        if any(name in each for each in names):
            names.append(part)
    known = [name for name in PARTS if any(f"{name} " in each for each in names)]
    return "\n===\n".join([text, *(f"MSG: {name}\n{PARTS[name]}" for name in known)])


@pytest.mark.parametrize(("name", "definition", "fields", "expected"), ROS)
def test_ros_2(
    tmp_path: Path, name: str, definition: str, fields: dict[str, Any], expected: dict[str, float]
) -> None:
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    package, short = name.split("/")
    schema = writer.register_msgdef(f"{package}/msg/{short}", parts_of(definition))
    air = writer.register_msgdef(
        "sensor_msgs/msg/Temperature", parts_of(HEADER + "float64 temperature")
    )
    for k in range(10):
        at = START_NS + k * 10**9
        header = {"header": {"stamp": stamp(k), "frame_id": ""}}
        times = header | {"frame_stamp": stamp(k), "timestamp": at // 1000}
        own = {key: value for key, value in times.items() if key in definition}
        writer.write_message("/one", schema, own | fields, at)
        writer.write_message("/air", air, header | {"temperature": -12.5}, at)
    writer.finish()
    path = tmp_path / "one.mcap"
    path.write_bytes(file.getvalue())
    log = open_log(path)
    holds(log, name, expected)
    np.testing.assert_array_equal(log.message("/one")["time_ns"], START_NS + np.arange(10) * 10**9)
    assert not log.ledger.has_losses


FOXGLOVE: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "LocationFix": (
        {"latitude": 47.5, "longitude": -122.25, "altitude": 580.5},
        PLACE | {"h_ellipsoid_m": 580.5},
    ),
    "PoseInFrame": ({"pose": POSE}, AWAY),
    "CompressedImage": ({"data": "eA==", "format": "jpeg"}, {"event_index": 9.0}),
    "RawImage": ({"data": "eA=="}, {"event_index": 9.0}),
    "FrameTransform": ({"translation": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": TURNED}, AWAY),
}


@pytest.mark.parametrize("name", FOXGLOVE)
def test_foxglove_as_json(tmp_path: Path, name: str) -> None:
    from mcap.writer import Writer

    fields, expected = FOXGLOVE[name]
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="test")
    schema = writer.register_schema(f"foxglove.{name}", "jsonschema", b"{}")
    channel = writer.register_channel("/one", "json", schema)
    for k in range(10):
        row = {"timestamp": {"sec": stamp(k)["sec"], "nsec": 0}, "frame_id": "a"} | fields
        at = START_NS + k * 10**9
        writer.add_message(channel, at, json.dumps(row).encode(), at)
    writer.finish()
    path = tmp_path / "one.mcap"
    path.write_bytes(file.getvalue())
    log = open_log(path)
    holds(log, f"foxglove.{name}", expected)
    assert len(log.message("/one")["time_ns"]) == 10
