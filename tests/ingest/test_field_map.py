"""The messages that logs are known to carry: each is a channel with these values, or a table."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from tests.ingest.written_logs import (
    HEADER,
    NS_PER_S,
    DataFlashWriter,
    MavlinkWriter,
    McapWriter,
    RosWriter,
    opened,
    ros_time,
)
from unbend.ingest import Log
from unbend.ingest.field_maps import extract, message_maps

START_NS = 1_700_000_000 * NS_PER_S
START_US = START_NS // 1000
# Decimals are the nearest doubles, as those of an integer divided by 1e7 have to be.
PLACE = {"lat_rad": math.radians(47.3977421), "lon_rad": math.radians(-122.2504519)}
E7 = {"lat": 473_977_421, "lon": -1_222_504_519}
LNG = {"lat": 473_977_421, "lng": -1_222_504_519}

TURN = (0.7, 0.1, -0.5, 0.5)
"""A unit quaternion no two of whose components can be exchanged unnoticed."""

ROLL_DEG = 20.0
PITCH_DEG = -30.0
YAW_DEG = 90.0
ROLL_PITCH_YAW = (ROLL_DEG, PITCH_DEG, YAW_DEG)
ANGLES_DEG = {"roll": ROLL_DEG, "pitch": PITCH_DEG, "yaw": YAW_DEG}
ANGLES = {name: math.radians(angle) for name, angle in ANGLES_DEG.items()}


def quaternion(components: Any, name: str = "q") -> dict[str, float]:
    """Columns of a quaternion, whose real part comes first."""
    return {f"{name}_{axis}": value for axis, value in zip("wxyz", components, strict=True)}


_LIBRARY = Rotation.from_euler("ZYX", (YAW_DEG, PITCH_DEG, ROLL_DEG), degrees=True)
TURNED = quaternion(_LIBRARY.as_quat(scalar_first=True))

MOVING = {"v_north_m_s": 1.5, "v_east_m_s": -2.75, "v_down_m_s": 0.5}
COURSE = {"v_north_m_s": -10.0, "v_east_m_s": 10.0 * math.sqrt(3.0)}  # 20 m/s to 120 degrees
LOCAL = {"north_m": 10.5, "east_m": -20.25, "up_m": 30.5}
RATES = {"rollspeed": 0.5, "pitchspeed": -0.25, "yawspeed": 0.125}
TURNING = {"rate_x_rad_s": 0.5, "rate_y_rad_s": -0.25, "rate_z_rad_s": 0.125}
HEALTH = {
    "innovation_velocity": 0.25,
    "innovation_position": 14.5,
    "innovation_height": 0.5,
    "innovation_compass": 0.75,
}
SHAKEN = {"vibration_m_s2": 31.25, "clipping": 7.0}
BAROMETER = {"pressure_pa": 70_025.0, "board_temperature_k": 318.15}
AIR = {"temperature_k": 260.65, "relative_humidity": 0.4725}
PITOT = {"temperature_k": 260.65, "airspeed_m_s": 41.5}
ABOVE_HOME = {"h_msl_m": 600.25, "h_home_m": 30.5}
TERRAIN = {"h_terrain_m": 570.5, "h_above_terrain_m": 30.25}
TILES = {"tiles_pending": 3.0, "tiles_loaded": 168.0}

_FIX = {"fix_type": 3, "eph": 121, "vel": 2_000, "cog": 12_000, "satellites_visible": 17}
_FIXED = COURSE | {"hdop": 1.21, "satellites": 17.0, "fix": 3.0}
_HEIGHTS = {"alt": 600_250, "alt_ellipsoid": 580_500}
_HEIGHTS_M = {"h_msl_m": 600.25, "h_ellipsoid_m": 580.5}
_MOVED = {"vx": 1.5, "vy": -2.75, "vz": 0.5}
_LOCAL = {"x": 10.5, "y": -20.25, "z": -30.5}
_SCALED = {"press_abs": 700.25, "temperature": 4500, "temperature_press_diff": -1250}

# MAVLink: fields as sent, and columns in SI. No columns: it plays no part and is a table only.
MAVLINK: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "GPS_RAW_INT": (
        E7 | _FIX | _HEIGHTS | {"h_acc": 450, "vel_acc": 120},
        PLACE | _FIXED | _HEIGHTS_M | {"sigma_h_m": 0.45 / math.sqrt(2.0), "sigma_speed_m_s": 0.12},
    ),
    "GPS2_RAW": (
        E7 | {"fix_type": 4, "alt": -428_000, "alt_ellipsoid": -400_000, "v_acc": 700},
        PLACE | {"h_msl_m": -428.0, "h_ellipsoid_m": -400.0, "sigma_v_m": 0.7},
    ),
    "GLOBAL_POSITION_INT": (
        E7 | {"alt": 600_250, "relative_alt": 30_500, "vx": 150, "vy": -275, "vz": 50},
        PLACE | ABOVE_HOME | MOVING,
    ),
    "GLOBAL_POSITION_INT_COV": (
        E7 | {"alt": 600_250, "relative_alt": 30_500} | _MOVED,
        PLACE | ABOVE_HOME | MOVING,
    ),
    "LOCAL_POSITION_NED": (_LOCAL | _MOVED, LOCAL | MOVING),
    "EKF_STATUS_REPORT": (
        {
            "velocity_variance": 0.25,
            "pos_horiz_variance": 14.5,
            "pos_vert_variance": 0.5,
            "compass_variance": 0.75,
            "flags": 831 | 1 << 15,
        },
        HEALTH | {"filter_flags": float(831 | 1 << 15)},
    ),
    "ESTIMATOR_STATUS": (
        {
            "vel_ratio": 0.25,
            "pos_horiz_ratio": 14.5,
            "pos_vert_ratio": 0.5,
            "mag_ratio": 0.75,
            "flags": 831 | 1 << 10,
            "pos_horiz_accuracy": 1.5,
            "pos_vert_accuracy": 2.5,
        },
        HEALTH
        | {
            "filter_flags": float(831 | 1 << 15),
            "sigma_h_m": 1.5 / math.sqrt(2.0),
            "sigma_v_m": 2.5,
        },
    ),
    "VIBRATION": (
        {
            "vibration_x": 3.5,
            "vibration_y": 31.25,
            "vibration_z": 2.0,
            "clipping_0": 4,
            "clipping_2": 3,
        },
        SHAKEN,
    ),
    "AHRS2": (LNG | ANGLES | {"altitude": 600.25}, PLACE | TURNED | {"h_msl_m": 600.25}),
    "VFR_HUD": ({"airspeed": 41.5, "alt": 600.25}, {"airspeed_m_s": 41.5, "h_msl_m": 600.25}),
    "ALTITUDE": ({"altitude_amsl": 600.25, "altitude_relative": 30.5}, ABOVE_HOME),
    "ATTITUDE": (ANGLES | RATES, TURNED | TURNING),
    "ATTITUDE_QUATERNION": (
        {f"q{number}": value for number, value in enumerate(TURN, 1)} | RATES,
        quaternion(TURN) | TURNING,
    ),
    "TERRAIN_REPORT": (
        E7
        | {"terrain_height": 570.5, "current_height": 30.25, "spacing": 100}
        | {"pending": 3, "loaded": 168},
        PLACE | TERRAIN | TILES | {"terrain_spacing_m": 100.0},
    ),
    "EXTENDED_SYS_STATE": ({"landed_state": 2}, {"landed_state": 2.0}),
    "HOME_POSITION": ({"altitude": 570_500}, {"home_h_msl_m": 570.5}),
    "SCALED_PRESSURE": (_SCALED, BAROMETER | {"temperature_k": 260.65}),
    "SCALED_PRESSURE2": (_SCALED, BAROMETER | {"temperature_k": 260.65}),
    "SCALED_PRESSURE3": (_SCALED, BAROMETER | {"temperature_k": 260.65}),
    "HIGHRES_IMU": ({"abs_pressure": 700.25, "temperature": 45.0}, BAROMETER),
    "RAW_IMU": ({"temperature": 4500}, {"board_temperature_k": 318.15}),
    "MCU_STATUS": ({"MCU_temperature": 4500}, {"board_temperature_k": 318.15}),
    "HYGROMETER_SENSOR": ({"temperature": -1250, "humidity": 4725}, AIR),
    "AIRSPEED": ({"temperature": -1250, "airspeed": 41.5}, PITOT),
    "HIGH_LATENCY2": ({"temperature_air": -12}, {"temperature_k": 261.15}),
    "NAMED_VALUE_FLOAT": ({"name": b"CabT", "value": 21.5}, {"value": 21.5}),
    "NAMED_VALUE_INT": ({"name": b"CabT", "value": 21}, {"value": 21.0}),
    "DEBUG_VECT": ({"name": b"Cab", "x": 1.5, "z": -2.5}, {"x": 1.5, "z": -2.5}),
    "DEBUG_FLOAT_ARRAY": (
        {"name": b"Cab", "data": [21.5, 0.0, 3.5] + [0.0] * 55},
        {"value": 21.5, "value_2": 3.5},
    ),
    "TUNNEL": ({}, {}),
    "CAMERA_FEEDBACK": (
        LNG | ANGLES_DEG | {"img_idx": 7, "alt_msl": 600.25, "alt_rel": 30.5},
        PLACE
        | ABOVE_HOME
        | {"event_index": 7.0}
        | {f"{name}_rad": angle for name, angle in ANGLES.items()},
    ),
    "CAMERA_TRIGGER": ({"seq": 7}, {"event_index": 7.0}),
    "CAMERA_IMAGE_CAPTURED": (
        E7
        | {"alt": 600_250, "relative_alt": 30_500, "q": list(TURN)}
        | {"image_index": 7, "capture_result": 1},
        PLACE | ABOVE_HOME | {"event_index": 7.0} | quaternion(TURN, "camera_q"),
    ),
    "CAMERA_STATUS": ({}, {}),
    "MOUNT_STATUS": (
        {"pointing_a": -9000, "pointing_b": 150, "pointing_c": 1000},
        {
            "gimbal_pitch_rad": -math.pi / 2.0,
            "gimbal_roll_rad": math.radians(1.5),
            "gimbal_yaw_rad": math.radians(10.0),
        },
    ),
    "MOUNT_ORIENTATION": (
        ANGLES_DEG | {"yaw": 10.0, "yaw_absolute": YAW_DEG},
        TURNED
        | {
            "gimbal_roll_rad": ANGLES["roll"],
            "gimbal_pitch_rad": ANGLES["pitch"],
            "gimbal_yaw_rad": math.radians(10.0),
        },
    ),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": (
        {"q": list(TURN), "flags": 16},
        quaternion(TURN, "gimbal_q") | quaternion(TURN),
    ),
    "SYSTEM_TIME": ({}, {}),
    "TIMESYNC": ({}, {}),
}


def holds(log: Log, message: str, expected: dict[str, float]) -> None:
    """The channel of a message has these values; without any it is none."""
    channels = [channel for channel in log.channels if channel.source.message == message]
    if not expected:
        assert not channels
    for name, value in expected.items():
        columns = [channel[name] for channel in channels if name in channel.columns]
        assert columns, f"{name} is not in {[sorted(c.columns) for c in channels]}"
        is_angle = name.startswith(("q_", "gimbal_", "camera_q_", "roll_", "pitch_", "yaw_"))
        rel = 1e-6 if is_angle else 4e-15  # angles are sent as float32
        assert columns[0][-1] == pytest.approx(value, rel=rel, abs=1e-7 * is_angle), name


@pytest.mark.parametrize("name", MAVLINK)
def test_mavlink(tmp_path, name):
    fields, expected = MAVLINK[name]
    writer = MavlinkWriter()
    fields_of_kind = getattr(writer.library, f"MAVLink_{name.lower()}_message").fieldnames
    for k in range(10):
        at_us = START_US + k * 10**6
        boot_ms = 60_000 + 1000 * k
        writer.send("system_time", at_us, time_unix_usec=at_us, time_boot_ms=boot_ms)
        if name != "ATTITUDE":
            writer.send("attitude", at_us, time_boot_ms=boot_ms)
        times = {"time_boot_ms": boot_ms, "time_usec": boot_ms * 1000}
        own_times = {field: times[field] for field in times.keys() & set(fields_of_kind)}
        writer.send(name.lower(), at_us, **own_times | fields)
    log = opened(tmp_path / "one.tlog", writer.data)
    holds(log, name, expected)
    table = log.message(name)
    assert table["time_ns"].shape[0] == log.messages[name] >= 10
    for field, value in fields.items():
        if isinstance(value, int | float):
            assert table[field][-1] == pytest.approx(value, rel=1e-6)
    assert not log.ledger.has_losses


_SEEN = PLACE | {"h_msl_m": 600.5, "h_home_m": 30.5}
_SHOT = _SEEN | {"h_gnss_m": 601.0, "roll_rad": ANGLES["roll"], "pitch_rad": ANGLES["pitch"]}
_SHOT_FORMS = {
    "BHIHLLeeeccC I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,R,P,Y":
        (0, 7, 1, 2200, 47.3977421, -122.2504519, 600.5, 30.5, 601.0, *ROLL_PITCH_YAW),
    "IHLLeeeccC GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,Roll,Pitch,Yaw":
        (1, 2200, 47.3977421, -122.2504519, 600.5, 30.5, 601.0, *ROLL_PITCH_YAW),
}  # fmt: skip

# DataFlash: letters and names of the columns behind TimeUS, their values, columns in SI.
DATAFLASH: list[tuple[str, str, tuple[float | bytes, ...], dict[str, float]]] = [
    (
        "GPS2",
        "BIHLLe Status,GMS,GWk,Lat,Lng,Alt",
        (3, 1000, 2200, 47.3977421, -122.2504519, 600.5),
        PLACE | {"h_msl_m": 600.5},
    ),
    (
        "GPS2",
        "BIHBcLLefff Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ",
        (3, 1250, 2200, 9, 1.21, 47.3977421, -122.2504519, 600.5, 20.0, 120.0, -0.5),
        PLACE
        | COURSE
        | {
            "v_down_m_s": -0.5,
            "fix": 3.0,
            "satellites": 9.0,
            "hdop": 1.21,
            "gps_week": 2200.0,
            "gps_week_s": 1.25,
        },
    ),
    ("POS", "LLee Lat,Lng,Alt,RelHomeAlt", (47.3977421, -122.2504519, 600.5, 30.5), _SEEN),
    ("POS", "LLee Lat,Lng,Alt,RelAlt", (47.3977421, -122.2504519, 600.5, 30.5), _SEEN),
    ("ATT", "ccC Roll,Pitch,Yaw", ROLL_PITCH_YAW, TURNED),
    (
        "AHR2",
        "ccCeLL Roll,Pitch,Yaw,Alt,Lat,Lng",
        (*ROLL_PITCH_YAW, 600.25, 47.3977421, -122.2504519),
        PLACE | {"h_msl_m": 600.25} | TURNED,
    ),
    ("XKQ", "Bffff C,Q1,Q2,Q3,Q4", (0, *TURN), quaternion(TURN)),
    ("NKQ1", "ffff Q1,Q2,Q3,Q4", TURN, quaternion(TURN)),
    ("XKF1", "BccC C,Roll,Pitch,Yaw", (0, *ROLL_PITCH_YAW), TURNED),
    (
        "NKF1",
        "ccCffffff Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD",
        (*ROLL_PITCH_YAW, 1.5, -2.75, 0.5, 10.5, -20.25, -30.5),
        TURNED | MOVING | LOCAL,
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
    (
        "ORGN",
        "BLLe Type,Lat,Lng,Alt",
        (0, 47.3977421, -122.2504519, 600.5),
        PLACE | {"h_msl_m": 600.5},
    ),
    (
        "TERR",
        "BLLffHH Status,Lat,Lng,TerrH,CHeight,Pending,Loaded",
        (2, 47.3977421, -122.2504519, 570.5, 30.25, 3, 168),
        PLACE | TERRAIN | TILES | {"terrain_status": 2.0},
    ),
    ("STAT", "B isFlying", (1,), {"flying": 1.0}),
    ("VIBE", "BfffI IMU,VibeX,VibeY,VibeZ,Clip", (0, 3.5, 31.25, 2.0, 7), SHAKEN),
    (
        "VIBE",
        "fffIII VibeX,VibeY,VibeZ,Clip0,Clip1,Clip2",
        (3.5, 31.25, 2.0, 4, 0, 3),
        SHAKEN,
    ),
    ("IMU", "Bffff I,GyrX,GyrY,GyrZ,T", (0, 0.5, -0.25, 0.125, 45.0), TURNING),
    ("BARO", "fc Press,Temp", (70_025.0, 45.0), BAROMETER),
    ("BAR2", "fc Press,Temp", (70_025.0, 45.0), BAROMETER),
    ("BAR3", "fc Press,Temp", (70_025.0, 45.0), BAROMETER),
    ("TEMP", "Bf Instance,Temp", (2, -12.5), {"temperature_k": 260.65}),
    ("ARSP", "fc Airspeed,Temp", (41.5, -12.5), PITOT),
    ("HYGR", "Bff Id,Humidity,Temp", (1, 47.25, -12.5), AIR),
    ("HYGR", "Bff I,Temperature,Humidity", (1, -12.5, 47.25), AIR),
    ("NVF", "Nf Name,Value", (b"CabT", 21.5), {"value": 21.5}),
    *((name, *form, _SHOT) for name in ("CAM", "TRIG") for form in _SHOT_FORMS.items()),
    (
        "MNT",
        "Bffff I,Roll,Pitch,YawB,YawE",
        (0, ROLL_DEG, PITCH_DEG, 10.0, YAW_DEG),
        TURNED | {"yaw_in_body_rad": math.radians(10.0)},
    ),
    ("IMU", "f T", (45.0,), {}),
    ("TSYN", "f RTT", (1.0,), {}),
]


@pytest.mark.parametrize(("name", "form", "values", "expected"), DATAFLASH)
def test_dataflash(tmp_path, name, form, values, expected):
    writer = DataFlashWriter()
    writer.define_receiver()
    letters, fields = form.split()
    writer.define(30, name, "Q" + letters, "TimeUS," + fields)
    for k in range(10):
        time_us = 5_000_000 + 200_000 * k
        writer.fix(time_us, 1000 + 200 * k, week=2200)
        writer.row(name, time_us + 1, *values)
    log = opened(tmp_path / "one.bin", writer.data)
    holds(log, name, expected)
    table = log.message(name)
    for field, value in zip(fields.split(","), values, strict=True):
        expected_cell = value.decode() if isinstance(value, bytes) else pytest.approx(value)
        assert table[field][-1] == expected_cell, field
    assert not log.ledger.has_losses


ORIENTATION = dict(zip("wxyz", TURN, strict=True))
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": ORIENTATION}
# A body forward, left, up in east, north, up: both frames turn, by hand from the matrices.
FROM_ENU = quaternion(np.sqrt(0.5) * np.array([1.2, -0.4, 0.6, 0.2]))
AWAY = {"east_m": 1.0, "north_m": 2.0, "up_m": 3.0} | FROM_ENU
SHOT = {"lat": 47.3977421, "lon": -122.2504519, "alt": 600.5, "seq": 7}
SHOT_PX4 = (
    "uint64 timestamp\nuint64 timestamp_utc\nfloat64 lat\nfloat64 lon\nfloat32 alt\nuint32 seq"
)
_FIXED_PX4 = {"eph": 0.5, "epv": 0.75, "fix_type": 3}
_SIGMAS = {"sigma_h_m": 0.5 / math.sqrt(2.0), "sigma_v_m": 0.75}

ROS: list[tuple[str, str, dict[str, Any], dict[str, float]]] = [
    ("geometry_msgs/PoseStamped", HEADER + "geometry_msgs/Pose pose", {"pose": POSE}, AWAY),
    (
        "nav_msgs/Odometry",
        HEADER + "string child\ngeometry_msgs/PoseWithCovariance pose",
        {"child": "b", "pose": {"pose": POSE}},
        AWAY,
    ),
    (
        "sensor_msgs/Imu",
        HEADER + "geometry_msgs/Quaternion orientation\n"
        "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity",
        {"orientation": ORIENTATION, "angular_velocity": {"x": 0.5, "y": 0.25, "z": -0.125}},
        FROM_ENU | TURNING,
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
        E7 | _FIX | _HEIGHTS | {"h_acc": 450, "v_acc": 700},
        PLACE | _FIXED | _HEIGHTS_M | {"sigma_h_m": 0.45 / math.sqrt(2.0), "sigma_v_m": 0.7},
    ),
    (
        "mavros_msgs/CameraImageCaptured",
        HEADER + "geographic_msgs/GeoPoint geo\nfloat32 relative_alt\n"
        "geometry_msgs/Quaternion orientation\nint32 image_index\nint8 capture_result",
        {
            "geo": {"latitude": 47.3977421, "longitude": -122.2504519, "altitude": 600.5},
            "relative_alt": 30.5,
            "orientation": ORIENTATION,
            "image_index": 7,
            "capture_result": 1,
        },
        PLACE
        | {"h_ellipsoid_m": 600.5, "h_home_m": 30.5, "event_index": 7.0}
        | quaternion(TURN, "camera_q"),
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
        "mavros_msgs/ExtendedState",
        HEADER + "uint8 landed_state",
        {"landed_state": 2},
        {"landed_state": 2.0},
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
        PITOT,
    ),
    (
        "px4_msgs/VehicleAirData",
        "uint64 timestamp\nfloat32 baro_pressure_pa\nfloat32 ambient_temperature",
        {"baro_pressure_pa": 70_025.0, "ambient_temperature": 45.0},
        BAROMETER,
    ),
    (
        "px4_msgs/VehicleAirData",
        "uint64 timestamp\nfloat32 baro_pressure_pa\nfloat32 baro_temp_celcius",
        {"baro_pressure_pa": 70_025.0, "baro_temp_celcius": 45.0},
        BAROMETER,
    ),
    (
        "px4_msgs/SensorHygrometer",
        "uint64 timestamp\nfloat32 temperature\nfloat32 humidity",
        {"temperature": -12.5, "humidity": 47.25},
        AIR,
    ),
    (
        "px4_msgs/CameraCapture",
        SHOT_PX4 + "\nfloat32[4] q\nint8 result",
        SHOT | {"q": list(TURN), "result": 1},
        PLACE | {"event_index": 7.0, "h_msl_m": 600.5} | quaternion(TURN, "camera_q"),
    ),
    (
        "mavros_msgs/GimbalDeviceAttitudeStatus",
        HEADER + "uint16 flags\ngeometry_msgs/Quaternion q",
        {"flags": 0, "q": ORIENTATION},
        quaternion(TURN, "gimbal_q"),
    ),
    (
        "px4_msgs/VehicleGlobalPosition",
        "uint64 timestamp\nfloat64 lat\nfloat64 lon\nfloat32 alt\nfloat32 alt_ellipsoid\n"
        "float32 eph\nfloat32 epv",
        {"lat": 47.3977421, "lon": -122.2504519, "alt": 600.25, "alt_ellipsoid": 580.5}
        | _FIXED_PX4,
        PLACE | _HEIGHTS_M | _SIGMAS,
    ),
    (
        "px4_msgs/SensorGps",
        "uint64 timestamp\nfloat64 latitude_deg\nfloat64 longitude_deg\n"
        "float64 altitude_msl_m\nfloat64 altitude_ellipsoid_m\nfloat32 eph\nfloat32 epv\n"
        "float32 s_variance_m_s\nuint8 fix_type\nfloat32 hdop\n"
        "float32 vel_n_m_s\nfloat32 vel_e_m_s\nfloat32 vel_d_m_s\nuint8 satellites_used",
        _FIXED_PX4
        | {
            "latitude_deg": 47.3977421,
            "longitude_deg": -122.2504519,
            "altitude_msl_m": 600.25,
            "altitude_ellipsoid_m": 580.5,
            "s_variance_m_s": 0.125,
            "hdop": 1.25,
            "vel_n_m_s": 1.5,
            "vel_e_m_s": -2.75,
            "vel_d_m_s": 0.5,
            "satellites_used": 17,
        },
        PLACE
        | MOVING
        | _HEIGHTS_M
        | _SIGMAS
        | {"sigma_speed_m_s": 0.125, "hdop": 1.25, "satellites": 17.0, "fix": 3.0},
    ),
    (
        "px4_msgs/VehicleGpsPosition",
        "uint64 timestamp\nint32 lat\nint32 lon\nint32 alt\nint32 alt_ellipsoid\n"
        "float32 eph\nfloat32 epv\nuint8 fix_type",
        E7 | _HEIGHTS | _FIXED_PX4,
        PLACE | _HEIGHTS_M | _SIGMAS,
    ),
    (
        "px4_msgs/VehicleLocalPosition",
        "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\n"
        "float32 vx\nfloat32 vy\nfloat32 vz\nfloat32 eph\nfloat32 epv\nfloat32 evh",
        _LOCAL | _MOVED | {"eph": 0.5, "epv": 0.75, "evh": 0.25},
        MOVING | LOCAL | _SIGMAS | {"sigma_speed_m_s": 0.25},
    ),
    (
        "px4_msgs/VehicleAttitude",
        "uint64 timestamp\nfloat32[4] q",
        {"q": list(TURN)},
        quaternion(TURN),
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
        "uint16 solution_status_flags\nfloat32 pos_horiz_accuracy\nfloat32 pos_vert_accuracy",
        {
            "vel_test_ratio": 0.25,
            "pos_test_ratio": 14.5,
            "hgt_test_ratio": 0.5,
            "mag_test_ratio": 0.75,
            "solution_status_flags": 0x33F | 1 << 10,
            "pos_horiz_accuracy": 0.5,
            "pos_vert_accuracy": 0.75,
        },
        HEALTH | _SIGMAS | {"filter_flags": float(0x33F | 1 << 15)},
    ),
    (
        "px4_msgs/VehicleImuStatus",
        "uint64 timestamp\nuint32[3] accel_clipping\nfloat32 accel_vibration_metric",
        {"accel_clipping": [4, 0, 3], "accel_vibration_metric": 31.25},
        SHAKEN,
    ),
    (
        "px4_msgs/SensorBaro",
        "uint64 timestamp\nfloat32 pressure\nfloat32 temperature",
        {"pressure": 70_025.0, "temperature": 45.0},
        BAROMETER,
    ),
    ("px4_msgs/CameraTrigger", SHOT_PX4, SHOT, PLACE | {"event_index": 7.0, "h_msl_m": 600.5}),
    (
        "px4_msgs/GimbalDeviceAttitudeStatus",
        "uint64 timestamp\nuint16 device_flags\nfloat32[4] q",
        {"device_flags": 16, "q": list(TURN)},
        quaternion(TURN, "gimbal_q") | quaternion(TURN),
    ),
    (
        "px4_msgs/VehicleLandDetected",
        "uint64 timestamp\nbool landed",
        {"landed": True},
        {"landed": 1.0},
    ),
    (
        "px4_msgs/HomePosition",
        "uint64 timestamp\nfloat32 alt",
        {"alt": 570.5},
        {"home_h_msl_m": 570.5},
    ),
]


@pytest.mark.parametrize(("name", "definition", "fields", "expected"), ROS)
def test_ros_2(tmp_path, name, definition, fields, expected):
    writer = RosWriter()
    writer.define(name, definition)
    for k in range(10):
        time_ns = START_NS + k * NS_PER_S
        stamps = {"frame_stamp": ros_time(time_ns), "timestamp": time_ns // 1000}
        writer.write("/one", name, time_ns, **stamps, **fields)
        writer.write("/air", "sensor_msgs/Temperature", time_ns, temperature=-12.5)
    log = opened(tmp_path / "one.mcap", writer.data)
    holds(log, name, expected)
    assert_array_equal(log.message("/one")["time_ns"], START_NS + np.arange(10) * NS_PER_S)
    assert not log.ledger.has_losses


FOXGLOVE: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "LocationFix": (
        {"latitude": 47.3977421, "longitude": -122.2504519, "altitude": 580.5},
        PLACE | {"h_ellipsoid_m": 580.5},
    ),
    "PoseInFrame": ({"pose": POSE}, AWAY),
    "CompressedImage": ({"data": "eA==", "format": "jpeg"}, {"event_index": 9.0}),
    "RawImage": ({"data": "eA=="}, {"event_index": 9.0}),
    "FrameTransform": ({"translation": POSE["position"], "rotation": ORIENTATION}, AWAY),
}


@pytest.mark.parametrize("name", FOXGLOVE)
def test_foxglove_as_json(tmp_path, name):
    fields, expected = FOXGLOVE[name]
    writer = McapWriter()
    channel = writer.channel("/one", "json", f"foxglove.{name}", "{}")
    for k in range(10):
        time_ns = START_NS + k * NS_PER_S
        stamp = {"sec": time_ns // NS_PER_S, "nsec": 0}
        writer.write(channel, time_ns, {"timestamp": stamp, "frame_id": "a"} | fields)
    log = opened(tmp_path / "one.mcap", writer.data)
    holds(log, f"foxglove.{name}", expected)
    assert len(log.message("/one")["time_ns"]) == 10


@pytest.mark.parametrize(
    ("format_name", "message", "field", "unknown", "column"),
    [
        ("tlog", "GPS_RAW_INT", "alt_ellipsoid", 0, "h_ellipsoid_m"),
        ("tlog", "GPS_RAW_INT", "h_acc", 0, "sigma_h_m"),
        ("tlog", "GPS_RAW_INT", "v_acc", 0, "sigma_v_m"),
        ("tlog", "GPS_RAW_INT", "vel_acc", 0, "sigma_speed_m_s"),
        ("tlog", "GPS_RAW_INT", "satellites_visible", 255, "satellites"),
        ("tlog", "GPS_RAW_INT", "eph", 65535, "hdop"),
        ("tlog", "GPS_RAW_INT", "vel", 65535, "speed_m_s"),
        ("tlog", "GPS_RAW_INT", "cog", 65535, "course_rad"),
        ("tlog", "AHRS2", "lat", 0, "lat_rad"),
        (
            "tlog",
            "SCALED_PRESSURE.temperature_press_diff",
            "temperature_press_diff",
            0,
            "temperature_k",
        ),
        ("tlog", "HIGHRES_IMU", "abs_pressure", 0.0, "pressure_pa"),
        ("tlog", "HYGROMETER_SENSOR", "temperature", 32767, "temperature_k"),
        ("tlog", "HYGROMETER_SENSOR", "humidity", 65535, "relative_humidity"),
        ("tlog", "AIRSPEED", "temperature", 32767, "temperature_k"),
        ("tlog", "RAW_IMU", "temperature", 0, "board_temperature_k"),
        ("tlog", "MOUNT_ORIENTATION", "yaw_absolute", 0.0, "yaw_rad"),
        ("tlog", "ESTIMATOR_STATUS", "pos_horiz_accuracy", 0.0, "sigma_h_m"),
        ("dataflash", "GPS", "HDop", 99.99, "hdop"),
        ("dataflash", "GPS", "GWk", 0, "gps_week"),
        ("dataflash", "AHR2", "Lng", 0.0, "lon_rad"),
        ("px4", "SensorGps", "altitude_ellipsoid_m", 0.0, "h_ellipsoid_m"),
        ("px4", "VehicleGpsPosition", "alt_ellipsoid", 0, "h_ellipsoid_m"),
        ("px4", "VehicleGlobalPosition", "alt_ellipsoid", 0.0, "h_ellipsoid_m"),
        ("px4", "HomePosition", "alt", 0.0, "home_h_msl_m"),
        ("ros", "mavros_msgs/GPSRAW", "alt_ellipsoid", 0, "h_ellipsoid_m"),
        ("ros", "mavros_msgs/ExtendedState", "landed_state", 0, "landed_state"),
    ],
)
def test_a_value_that_means_unknown(format_name, message, field, unknown, column):
    columns = message_maps(format_name)[message].columns
    made = extract({field: np.array([unknown, 1])}, columns)
    assert np.isnan(made[column]).tolist() == [True, False]


@pytest.mark.parametrize(
    ("format_name", "message"),
    [
        ("dataflash", "HYGR"),
        ("dataflash", "TEMP"),
        ("dataflash", "ARSP"),
        ("tlog", "HYGROMETER_SENSOR"),
        ("tlog", "AIRSPEED"),
        ("tlog", "SCALED_PRESSURE"),
        ("ros", "sensor_msgs/Temperature"),
        ("ros", "sensor_msgs/RelativeHumidity"),
        ("ros", "sensor_msgs/FluidPressure"),
    ],
)
def test_the_first_of_several_is_not_preferred(format_name, message):
    """The numbers of instances do not show which sensor is outside."""
    assert message_maps(format_name)[message].spare_rank is None


def test_exposures_are_preferred_to_commands():
    px4 = message_maps("px4")
    assert px4["CameraCapture"].rank < px4["CameraTrigger"].rank
