"""Which MAVLink messages are wanted, which fields are which columns, and pymavlink's dialect.

A key with a dot is a second channel out of the same message.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from pipeline.ingest.attitude import gimbal_columns
from pipeline.ingest.fields import ATTITUDE, GNSS, MAVLINK_FIX, PRESSURE, MessageMap, column

INT16_MAX, UINT16_MAX = 32767.0, 65535.0

_PLACE = MAVLINK_FIX[:2]
_ABOVE_HOME = (*_PLACE, column("h_msl_m", "alt", "mm"), column("h_home_m", "relative_alt", "mm"))
_AXES = (("v_north_m_s", "vx"), ("v_east_m_s", "vy"), ("v_down_m_s", "vz"))
_RATES = (
    column("rate_x_rad_s", "rollspeed"),
    column("rate_y_rad_s", "pitchspeed"),
    column("rate_z_rad_s", "yawspeed"),
)
_EULER = tuple(column(f"{angle}_rad", angle) for angle in ("roll", "pitch", "yaw"))
_EULER_DEG = tuple(column(f"{angle}_rad", angle, "deg") for angle in ("roll", "pitch", "yaw"))

_GPS = (*MAVLINK_FIX, column("sigma_speed_m_s", "vel_acc", "mm", missing=0.0))
_BARO = (
    column("pressure_pa", "press_abs", "hPa"),
    column("board_temperature_k", "temperature", "cdegC"),
)
_DIFFERENTIAL = (column("temperature_k", "temperature_press_diff", "cdegC", missing=0.0),)

_BOOT_MS, _USEC = "time_boot_ms", "time_usec"

_NAMED = MessageMap((column("value", "value"),), id_field="name", time_field=_BOOT_MS)
_PITOT = MessageMap(_DIFFERENTIAL, ("temperature",), 40, time_field=_BOOT_MS)


def _baro(rank: int) -> MessageMap:
    return MessageMap(_BARO, PRESSURE, rank, time_field=_BOOT_MS)


MESSAGES: Mapping[str, MessageMap] = {
    "GLOBAL_POSITION_INT": MessageMap(
        (*_ABOVE_HOME, *(column(name, axis, "cm") for name, axis in _AXES)),
        ("position",), 10, time_field=_BOOT_MS, position=True,
    ),
    "GPS_RAW_INT": MessageMap(_GPS, GNSS, 20, time_field=_USEC, position=True),
    "GPS2_RAW": MessageMap(_GPS, GNSS, 30, time_field=_USEC, position=True),
    "GLOBAL_POSITION_INT_COV": MessageMap(
        (*_ABOVE_HOME, *(column(name, axis) for name, axis in _AXES)),
        ("position",), 15, time_field=_USEC, position=True,
    ),
    "LOCAL_POSITION_NED": MessageMap(
        (
            column("north_m", "x"),
            column("east_m", "y"),
            column("up_m", "z", "-"),
            *(column(name, axis) for name, axis in _AXES),
        ),
        time_field=_BOOT_MS,
    ),
    # Heights without a place: no role asks for them, a user may.
    "ALTITUDE": MessageMap(
        (column("h_msl_m", "altitude_amsl"), column("h_home_m", "altitude_relative")),
        time_field=_USEC,
    ),
    "ATTITUDE": MessageMap((*_EULER, *_RATES), ATTITUDE, 10, time_field=_BOOT_MS, attitude=True),
    "ATTITUDE_QUATERNION": MessageMap(
        (*(column(f"q_{axis}", f"q{k}") for k, axis in enumerate("wxyz", 1)), *_RATES),
        ATTITUDE, 20, time_field=_BOOT_MS, attitude=True,
    ),
    # A second estimate: its place is 0, 0 until it has one.
    "AHRS2": MessageMap(
        (
            *_EULER,
            column("lat_rad", "lat", "degE7", missing=0.0),
            column("lon_rad", "lng", "degE7", missing=0.0),
            column("h_msl_m", "altitude"),
        ),
        ATTITUDE, 40, attitude=True,
    ),
    # As TERR of DataFlash: no role. A spacing of 0 means that it had no terrain.
    "TERRAIN_REPORT": MessageMap(
        (
            *_PLACE,
            column("h_terrain_m", "terrain_height"),
            column("h_above_terrain_m", "current_height"),
            column("terrain_spacing_m", "spacing"),
            column("tiles_pending", "pending"),
            column("tiles_loaded", "loaded"),
        )
    ),
    "SCALED_PRESSURE": _baro(10),
    "SCALED_PRESSURE2": _baro(20),
    "SCALED_PRESSURE3": _baro(30),
    "SCALED_PRESSURE.temperature_press_diff": _PITOT,
    "SCALED_PRESSURE2.temperature_press_diff": _PITOT,
    "SCALED_PRESSURE3.temperature_press_diff": _PITOT,
    "HIGHRES_IMU": MessageMap(
        (
            column("pressure_pa", "abs_pressure", "hPa", missing=0.0),
            column("board_temperature_k", "temperature", "degC"),
        ),
        PRESSURE, 15, id_field="id", time_field=_USEC, spare_rank=16,
    ),
    "HYGROMETER_SENSOR": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("relative_humidity", "humidity", "c%", missing=UINT16_MAX),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"), 20, id_field="id",
    ),
    "AIRSPEED": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("airspeed_m_s", "airspeed"),
        ),
        ("temperature", "airspeed"), 30, id_field="id",
    ),
    "VFR_HUD": MessageMap(
        (column("airspeed_m_s", "airspeed"), column("h_msl_m", "alt")), ("airspeed",), 60
    ),
    # The sensor's own temperature, an extension of MAVLink 2: trimmed or absent it looks like 0.
    "RAW_IMU": MessageMap(
        (column("board_temperature_k", "temperature", "cdegC", missing=0.0),), id_field="id",
        time_field=_USEC,
    ),
    "MCU_STATUS": MessageMap(
        (column("board_temperature_k", "MCU_temperature", "cdegC"),), id_field="id"
    ),
    "HIGH_LATENCY2": MessageMap((column("temperature_k", "temperature_air", "degC"),), rank=60),
    "NAMED_VALUE_FLOAT": _NAMED,
    "NAMED_VALUE_INT": _NAMED,
    "DEBUG_VECT": MessageMap(
        tuple(column(axis, axis) for axis in "xyz"), id_field="name", time_field=_USEC
    ),
    # Elements that are never set are 0 and no column; the first is what a role can take.
    "DEBUG_FLOAT_ARRAY": MessageMap(
        (
            column("value", "data.0"),
            *(column(f"value_{k}", f"data.{k}", missing=0.0) for k in range(1, 58)),
        ),
        id_field="name", time_field=_USEC,
    ),
    "CAMERA_FEEDBACK": MessageMap(
        (
            *_PLACE,
            column("h_msl_m", "alt_msl"),
            column("h_home_m", "alt_rel"),
            column("event_index", "img_idx"),
            *_EULER_DEG,
        ),
        ("events",), 10, id_field="cam_idx", time_field=_USEC,
    ),
    "CAMERA_IMAGE_CAPTURED": MessageMap(
        (
            *_ABOVE_HOME,
            column("event_index", "image_index"),
            *(column(f"camera_q_{axis}", f"q.{k}") for k, axis in enumerate("wxyz")),
        ),
        ("events",), 20, id_field="camera_id", time_field=_BOOT_MS,
    ),
    "CAMERA_TRIGGER": MessageMap(
        (column("event_index", "seq"),), ("events",), 30, time_field=_USEC
    ),
    "EKF_STATUS_REPORT": MessageMap(
        (
            column("innovation_velocity", "velocity_variance"),
            column("innovation_position", "pos_horiz_variance"),
            column("innovation_height", "pos_vert_variance"),
            column("innovation_compass", "compass_variance"),
            column("filter_flags", "flags", "EKF_STATUS_FLAGS"),
        )
    ),
    "ESTIMATOR_STATUS": MessageMap(
        (
            column("innovation_velocity", "vel_ratio"),
            column("innovation_position", "pos_horiz_ratio"),
            column("innovation_height", "pos_vert_ratio"),
            column("innovation_compass", "mag_ratio"),
            column("filter_flags", "flags", "ESTIMATOR_STATUS_FLAGS"),
            column("sigma_h_m", "pos_horiz_accuracy", "m plane", missing=0.0),
            column("sigma_v_m", "pos_vert_accuracy", missing=0.0),
        ),
        time_field=_USEC,
    ),
    "VIBRATION": MessageMap(
        (
            *(column(f"vibration_m_s2_{axis}", f"vibration_{axis}") for axis in "xyz"),
            *(column(f"clipping_{k}", f"clipping_{k}") for k in range(3)),
        ),
        time_field=_USEC,
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
            *(column(f"gimbal_{angle}_rad", angle, "deg") for angle in ("roll", "pitch", "yaw")),
            *_EULER_DEG[:2],
            # an extension of MAVLink 2: trimmed or absent it looks like 0
            column("yaw_rad", "yaw_absolute", "deg", missing=0.0),
        ),
        time_field=_BOOT_MS, attitude=True,
    ),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": MessageMap(
        gimbal_columns(), id_field="gimbal_device_id", time_field=_BOOT_MS, attitude=True
    ),
}  # fmt: skip

LABELS: Mapping[str, str] = {"CAMERA_IMAGE_CAPTURED": "file_url", "STATUSTEXT": "text"}
"""Messages with a text that belongs to each row."""

SYSTEM_TIME, PARAM_VALUE = "SYSTEM_TIME", "PARAM_VALUE"


def wanted_fields() -> dict[str, set[str]]:
    """The fields that the channels and their clocks are made of, by message."""
    wanted = {
        SYSTEM_TIME: {"time_boot_ms", "time_unix_usec"},
        PARAM_VALUE: {"param_id", "param_value"},
        "CAMERA_IMAGE_CAPTURED": {"capture_result", "time_utc"},
        "STATUSTEXT": {"id", "chunk_seq"},
    }
    for key, spec in MESSAGES.items():
        fields = {name.partition(".")[0] for column in spec.columns for name in column.fields}
        fields |= {spec.id_field, spec.time_field, LABELS.get(key, "")}
        wanted.setdefault(key.partition(".")[0], set()).update(fields)
    return wanted


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


@dataclass(frozen=True)
class Dialect:
    """Messages by number, and numbers by name."""

    messages: Mapping[int, Message]
    numbers: Mapping[str, int]

    @property
    def extras(self) -> dict[int, int]:
        return {number: message.crc_extra for number, message in self.messages.items()}

    def name(self, number: int) -> str:
        """The name of a message, made up where the dialect does not know it."""
        known = self.messages.get(number)
        return f"UNKNOWN_{number}" if known is None else known.name

    def layouts(self, wanted: Mapping[str, Iterable[str]]) -> dict[int, np.dtype[Any]]:
        """The layouts of messages with only the wanted fields at their places, by number."""
        result = {}
        for name, fields in wanted.items():
            number = self.numbers.get(name)
            if number is not None:
                dtype, kept = self.messages[number].dtype, set(fields)
                result[number] = dtype[[name for name in dtype.names or () if name in kept]]
        return result


@cache
def dialect() -> Dialect:
    """The library's union of all dialects."""
    from pymavlink.dialects.v20 import all as library

    messages = {}
    for number, definition in library.mavlink_map.items():
        kinds = zip(definition.fieldnames, definition.fieldtypes, strict=True)
        messages[int(number)] = Message(
            int(number),
            str(definition.msgname),
            int(definition.crc_extra),
            layout_of(definition.unpacker.format, definition.ordered_fieldnames),
            tuple(definition.fieldnames),
            frozenset(field for field, kind in kinds if kind == "char"),
            definition.instance_field or "",
        )
    return Dialect(messages, {message.name: number for number, message in messages.items()})


def layout_of(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> layout_of("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    items = re.findall(r"(\d*)([a-zA-Z])", layout)
    kinds = [f"S{count or 1}" if kind == "s" else f"{count}<{kind}" for count, kind in items]
    return np.dtype(list(zip(fields, kinds, strict=True)))
