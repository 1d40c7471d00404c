"""Which MAVLink messages are wanted, and which of their fields are which columns.

A key with a dot is a second channel out of the same message.
"""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.ingest.fields import MessageMap, column

INT16_MAX, UINT16_MAX = 32767.0, 65535.0

_PLACE = (column("lat_rad", "lat", "degE7"), column("lon_rad", "lon lng", "degE7"))
_EULER = tuple(column(f"{angle}_rad", angle) for angle in ("roll", "pitch", "yaw"))
_EULER_DEG = tuple(column(f"{angle}_rad", angle, "deg") for angle in ("roll", "pitch", "yaw"))

# Trimmed zeros of MAVLink 2 and the short MAVLink 1 message look like 0: 0 is missing.
_GPS = (
    *_PLACE,
    column("h_msl_m", "alt", "mm"),
    column("h_ellipsoid_m", "alt_ellipsoid", "mm", missing=0.0),
    column("sigma_h_m", "h_acc", "mm", missing=0.0),
    column("sigma_v_m", "v_acc", "mm", missing=0.0),
    column("fix", "fix_type"),
)
_BARO = (
    column("pressure_pa", "press_abs", "hPa"),
    column("board_temperature_k", "temperature", "cdegC"),
)
_DIFFERENTIAL = (column("temperature_k", "temperature_press_diff", "cdegC", missing=0.0),)

_GNSS = ("height", "position")
_PRESSURE = ("pressure", "cabin_pressure")
_ATTITUDE = ("attitude",)
_BOOT_MS, _USEC = "time_boot_ms", "time_usec"

_PITOT = MessageMap(_DIFFERENTIAL, ("temperature",), 40, time_field=_BOOT_MS)


def _baro(rank: int) -> MessageMap:
    return MessageMap(_BARO, _PRESSURE, rank, time_field=_BOOT_MS)


MESSAGES: Mapping[str, MessageMap] = {
    "GLOBAL_POSITION_INT": MessageMap(
        (*_PLACE, column("h_msl_m", "alt", "mm"), column("h_home_m", "relative_alt", "mm")),
        ("position",),
        10,
        time_field=_BOOT_MS,
        position=True,
    ),
    "GPS_RAW_INT": MessageMap(_GPS, _GNSS, 20, time_field=_USEC, position=True),
    "GPS2_RAW": MessageMap(_GPS, _GNSS, 30, time_field=_USEC, position=True),
    "ATTITUDE": MessageMap(_EULER, _ATTITUDE, 10, time_field=_BOOT_MS, attitude=True),
    "ATTITUDE_QUATERNION": MessageMap(
        tuple(column(f"q_{axis}", f"q{k}") for k, axis in enumerate("wxyz", 1)),
        _ATTITUDE,
        20,
        time_field=_BOOT_MS,
        attitude=True,
    ),
    "AHRS2": MessageMap(_EULER, _ATTITUDE, 40, attitude=True),
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
        _PRESSURE,
        15,
        id_field="id",
        time_field=_USEC,
        spare_rank=16,
    ),
    "HYGROMETER_SENSOR": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("relative_humidity", "humidity", "c%", missing=UINT16_MAX),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"),
        20,
        id_field="id",
    ),
    "AIRSPEED": MessageMap(
        (
            column("temperature_k", "temperature", "cdegC", missing=INT16_MAX),
            column("airspeed_m_s", "airspeed"),
        ),
        ("temperature", "airspeed"),
        30,
        id_field="id",
    ),
    "VFR_HUD": MessageMap((column("airspeed_m_s", "airspeed"),), ("airspeed",), 60),
    "NAMED_VALUE_FLOAT": MessageMap(
        (column("value", "value"),), id_field="name", time_field=_BOOT_MS
    ),
    "CAMERA_FEEDBACK": MessageMap(
        (
            *_PLACE,
            column("h_msl_m", "alt_msl"),
            column("event_index", "img_idx"),
            *_EULER_DEG,
        ),
        ("events",),
        10,
        id_field="cam_idx",
        time_field=_USEC,
    ),
    "CAMERA_TRIGGER": MessageMap(
        (column("event_index", "seq"),), ("events",), 30, time_field=_USEC
    ),
}
