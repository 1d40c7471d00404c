"""Which MAVLink messages are wanted, which fields are which columns, and pymavlink's dialect.

A key with a dot is a second channel out of the same message.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from pipeline.ingest.attitude import gimbal_columns
from pipeline.ingest.fields import (
    ATTITUDE,
    GNSS,
    INNOVATIONS,
    MAVLINK_FIX,
    PRESSURE,
    MessageMap,
    column,
    columns,
)
from pipeline.ingest.tlog.clock import CLOCK_FIELDS

INT16_MAX, UINT16_MAX = 32767.0, 65535.0

_PLACE = MAVLINK_FIX[:2]
_ABOVE_HOME = (*_PLACE, column("h_msl_m", "alt", "mm"), column("h_home_m", "relative_alt", "mm"))
_VELOCITY = columns("v_north_m_s v_east_m_s v_down_m_s", "vx vy vz")
_RATES = columns("rate_x_rad_s rate_y_rad_s rate_z_rad_s", "rollspeed pitchspeed yawspeed")
_EULER = columns("roll_rad pitch_rad yaw_rad", "roll pitch yaw")
_EULER_DEG = columns("roll_rad pitch_rad yaw_rad", "roll pitch yaw", "deg")

_GPS = (*MAVLINK_FIX, column("sigma_speed_m_s", "vel_acc", "mm", missing=0.0))
_BARO = (
    column("pressure_pa", "press_abs", "hPa"),
    column("board_temperature_k", "temperature", "cdegC"),
)
_NAMED = MessageMap((column("value", "value"),))
_PITOT = MessageMap(
    (column("temperature_k", "temperature_press_diff", "cdegC", missing=0.0),), ("temperature",), 40
)

MESSAGES: Mapping[str, MessageMap] = {
    "GLOBAL_POSITION_INT": MessageMap(
        (*_ABOVE_HOME, *columns("v_north_m_s v_east_m_s v_down_m_s", "vx vy vz", "cm")),
        ("position",), 10, position=True,
    ),
    "GPS_RAW_INT": MessageMap(_GPS, GNSS, 20, position=True),
    "GPS2_RAW": MessageMap(_GPS, GNSS, 30, position=True),
    "GLOBAL_POSITION_INT_COV": MessageMap(
        (*_ABOVE_HOME, *_VELOCITY), ("position",), 15, position=True
    ),
    "LOCAL_POSITION_NED": MessageMap(
        (*columns("north_m east_m", "x y"), column("up_m", "z", "-"), *_VELOCITY)
    ),
    # Heights without a place: no role asks for them, a user may.
    "ALTITUDE": MessageMap(
        columns("h_msl_m h_home_m", "altitude_amsl altitude_relative")
    ),
    "ATTITUDE": MessageMap((*_EULER, *_RATES), ATTITUDE, 10, attitude=True),
    "ATTITUDE_QUATERNION": MessageMap(
        (*columns("q_w q_x q_y q_z", "q1 q2 q3 q4"), *_RATES), ATTITUDE, 20, attitude=True
    ),
    # A second estimate: its place is 0, 0 until it has one.
    "AHRS2": MessageMap(
        (
            *_EULER,
            *columns("lat_rad lon_rad", "lat lng", "degE7", missing=0.0),
            column("h_msl_m", "altitude"),
        ),
        ATTITUDE, 40, attitude=True,
    ),
    # As TERR of DataFlash: no role. A spacing of 0 means that it had no terrain.
    "TERRAIN_REPORT": MessageMap(
        (
            *_PLACE,
            *columns("h_terrain_m h_above_terrain_m", "terrain_height current_height"),
            *columns("terrain_spacing_m tiles_pending tiles_loaded", "spacing pending loaded"),
        )
    ),
    "SCALED_PRESSURE": MessageMap(_BARO, PRESSURE, 10),
    "SCALED_PRESSURE2": MessageMap(_BARO, PRESSURE, 20),
    "SCALED_PRESSURE3": MessageMap(_BARO, PRESSURE, 30),
    "SCALED_PRESSURE.temperature_press_diff": _PITOT,
    "SCALED_PRESSURE2.temperature_press_diff": _PITOT,
    "SCALED_PRESSURE3.temperature_press_diff": _PITOT,
    "HIGHRES_IMU": MessageMap(
        (
            column("pressure_pa", "abs_pressure", "hPa", missing=0.0),
            column("board_temperature_k", "temperature", "degC"),
        ),
        PRESSURE, 15, spare_rank=16,
    ),
    "HYGROMETER_SENSOR": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("relative_humidity", "humidity", "c%", missing=UINT16_MAX),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"), 20,
    ),
    "AIRSPEED": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("airspeed_m_s", "airspeed"),
        ),
        ("temperature", "airspeed"), 30,
    ),
    "VFR_HUD": MessageMap(columns("airspeed_m_s h_msl_m", "airspeed alt"), ("airspeed",), 60),
    # The sensor's own temperature, an extension of MAVLink 2: trimmed or absent it looks like 0.
    "RAW_IMU": MessageMap(
        (column("board_temperature_k", "temperature", "cdegC", missing=0.0),)
    ),
    "MCU_STATUS": MessageMap((column("board_temperature_k", "MCU_temperature", "cdegC"),)),
    "HIGH_LATENCY2": MessageMap((column("temperature_k", "temperature_air", "degC"),), rank=60),
    "NAMED_VALUE_FLOAT": _NAMED,
    "NAMED_VALUE_INT": _NAMED,
    "DEBUG_VECT": MessageMap(columns("x y z", "x y z")),
    # Elements that are never set are 0 and no column; the first is what a role can take.
    "DEBUG_FLOAT_ARRAY": MessageMap(
        (
            column("value", "data.0"),
            *(column(f"value_{k}", f"data.{k}", missing=0.0) for k in range(1, 58)),
        )
    ),
    "CAMERA_FEEDBACK": MessageMap(
        (
            *_PLACE,
            *columns("h_msl_m h_home_m event_index", "alt_msl alt_rel img_idx"),
            *_EULER_DEG,
        ),
        ("events",), 10,
    ),
    "CAMERA_IMAGE_CAPTURED": MessageMap(
        (
            *_ABOVE_HOME,
            column("event_index", "image_index"),
            *columns("camera_q_w camera_q_x camera_q_y camera_q_z", "q.0 q.1 q.2 q.3"),
        ),
        ("events",), 20,
    ),
    "CAMERA_TRIGGER": MessageMap((column("event_index", "seq"),), ("events",), 30),
    "EKF_STATUS_REPORT": MessageMap(
        (
            *columns(INNOVATIONS, "velocity_variance pos_horiz_variance pos_vert_variance "
                     "compass_variance"),
            column("filter_flags", "flags", "EKF_STATUS_FLAGS"),
        )
    ),
    "ESTIMATOR_STATUS": MessageMap(
        (
            *columns(INNOVATIONS, "vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio"),
            column("filter_flags", "flags", "ESTIMATOR_STATUS_FLAGS"),
            column("sigma_h_m", "pos_horiz_accuracy", "m plane", missing=0.0),
            column("sigma_v_m", "pos_vert_accuracy", missing=0.0),
        )
    ),
    "VIBRATION": MessageMap(
        (
            *(column(f"vibration_m_s2_{axis}", f"vibration_{axis}") for axis in "xyz"),
            *(column(f"clipping_{k}", f"clipping_{k}") for k in range(3)),
        )
    ),
    "STATUSTEXT": MessageMap((), text_field="text"),
    # A gimbal plays no role unless it is named: whether a camera hangs on it, no log says.
    "MOUNT_STATUS": MessageMap(
        (
            column("gimbal_pitch_rad", "pointing_a", "cdeg"),
            column("gimbal_roll_rad", "pointing_b", "cdeg"),
            column("gimbal_yaw_rad", "pointing_c", "cdeg"),
        )
    ),
    "MOUNT_ORIENTATION": MessageMap(
        (
            *columns("gimbal_roll_rad gimbal_pitch_rad gimbal_yaw_rad", "roll pitch yaw", "deg"),
            *_EULER_DEG[:2],
            # an extension of MAVLink 2: trimmed or absent it looks like 0
            column("yaw_rad", "yaw_absolute", "deg", missing=0.0),
        ),
        attitude=True,
    ),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": MessageMap(gimbal_columns(), attitude=True),
}  # fmt: skip

LABELS: Mapping[str, str] = {"CAMERA_IMAGE_CAPTURED": "file_url", "STATUSTEXT": "text"}
"""Messages with a text that belongs to each row."""

# Fields that tell instances apart, where the dialect names none, or a number beside the name.
_INSTANCES = {
    "DEBUG_FLOAT_ARRAY": "name", "CAMERA_FEEDBACK": "cam_idx", "CAMERA_IMAGE_CAPTURED": "camera_id",
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "gimbal_device_id",
}  # fmt: skip

SYSTEM_TIME, PARAM_VALUE = "SYSTEM_TIME", "PARAM_VALUE"


@dataclass(frozen=True)
class Message:
    """One message of the dialect.

    ``dtype`` of the payload in the order of the wire; ``fields`` in the order of the definition;
    ``texts`` those of them that are char arrays; ``instance_field`` or "".
    """

    number: int
    name: str
    crc_extra: int
    dtype: np.dtype[Any]
    fields: tuple[str, ...]
    texts: frozenset[str]
    instance_field: str


@cache
def dialect() -> Mapping[int, Message]:
    """The library's union of all dialects, by number."""
    from pymavlink.dialects.v20 import all as library

    messages = {}
    for number, definition in library.mavlink_map.items():
        kinds = zip(definition.fieldnames, definition.fieldtypes, strict=True)
        name, names = str(definition.msgname), tuple(definition.fieldnames)
        layout = layout_of(definition.unpacker.format, definition.ordered_fieldnames)
        texts = frozenset(field for field, kind in kinds if kind == "char")
        instance = _INSTANCES.get(name, definition.instance_field or "")
        messages[int(number)] = Message(
            int(number), name, int(definition.crc_extra), layout, names, texts, instance
        )
    return messages


def crc_extras() -> dict[int, int]:
    """CRC_EXTRA by message id."""
    return {number: message.crc_extra for number, message in dialect().items()}


@cache
def message_of_name() -> Mapping[str, Message]:
    """The same by name."""
    return {message.name: message for message in dialect().values()}


def name_of(number: int) -> str:
    """The name of a message, made up where the dialect does not know it."""
    known = dialect().get(number)
    return f"UNKNOWN_{number}" if known is None else known.name


def wanted_layouts() -> dict[int, np.dtype[Any]]:
    """The layouts of the messages that channels and clocks are made of, by number.

    Only the fields that are needed for it, each at its place.
    """
    wanted = {
        SYSTEM_TIME: {"time_unix_usec"},
        PARAM_VALUE: {"param_id", "param_value"},
        "CAMERA_IMAGE_CAPTURED": {"capture_result", "time_utc"},
        "STATUSTEXT": {"id", "chunk_seq"},
    }
    for key, spec in MESSAGES.items():
        fields = {name.partition(".")[0] for column in spec.columns for name in column.fields}
        wanted.setdefault(key.partition(".")[0], set()).update(fields, {LABELS.get(key, "")})
    result = {}
    for message in (m for m in dialect().values() if m.name in wanted):
        kept = wanted[message.name] | {message.instance_field, *CLOCK_FIELDS}
        names = message.dtype.names or ()
        result[message.number] = message.dtype[[name for name in names if name in kept]]
    return result


def layout_of(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> layout_of("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    items = re.findall(r"(\d*)([a-zA-Z])", layout)
    kinds = [f"S{count or 1}" if kind == "s" else f"{count}<{kind}" for count, kind in items]
    return np.dtype(list(zip(fields, kinds, strict=True)))
