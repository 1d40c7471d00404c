"""Which DataFlash messages are wanted, and which of their fields are which columns.

Fields are named as FMT records name them; names changed over the years, newest first. Values are
already divided as the format letter says (c, C, e: 100; L: 1e7), so Lat is in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.ingest.fields import MessageMap, column

INSTANCE_FIELDS = ("I", "Instance", "Id", "C")

_PLACE = (column("lat_rad", "Lat", "deg"), column("lon_rad", "Lng", "deg"))
_EULER = (
    column("roll_rad", "R Roll", "deg"),
    column("pitch_rad", "P Pitch", "deg"),
    column("yaw_rad", "Y Yaw", "deg"),
)
_QUATERNION = (column("q_w", "Q1"), column("q_x", "Q2"), column("q_y", "Q3"), column("q_z", "Q4"))

_GPS = (*_PLACE, column("h_msl_m", "Alt"), column("fix", "Status"))

# Temp of a barometer is its board: 20-51 C were seen in the air, never the outside temperature.
_BARO = (column("pressure_pa", "Press"), column("board_temperature_k", "Temp", "degC"))

_SHOT = (*_PLACE, column("h_msl_m", "Alt"), column("event_index", "Img"), *_EULER)

_GNSS = ("height", "position")
_PRESSURE = ("pressure", "cabin_pressure")
_ATTITUDE = ("attitude",)

MESSAGES: Mapping[str, MessageMap] = {
    "POS": MessageMap(
        (*_PLACE, column("h_msl_m", "Alt"), column("h_home_m", "RelHomeAlt RelAlt")),
        ("position",),
        10,
        10,
        position=True,
    ),
    "GPS": MessageMap(_GPS, _GNSS, 20, 30, position=True),
    "GPS2": MessageMap(_GPS, _GNSS, 30, 30, position=True),
    "ATT": MessageMap(_EULER, _ATTITUDE, 10, 10, attitude=True),
    "AHR2": MessageMap(_EULER, _ATTITUDE, 40, 40, attitude=True),
    "XKQ": MessageMap(_QUATERNION, _ATTITUDE, 50, 51, attitude=True),
    "XKQ1": MessageMap(_QUATERNION, _ATTITUDE, 50, 50, attitude=True),
    "NKQ1": MessageMap(_QUATERNION, _ATTITUDE, 50, 50, attitude=True),
    "BARO": MessageMap(_BARO, _PRESSURE, 10, 20),
    "BAR2": MessageMap(_BARO, _PRESSURE, 20, 20),
    "BAR3": MessageMap(_BARO, _PRESSURE, 30, 30),
    "ARSP": MessageMap(
        (column("temperature_k", "Temp", "degC"), column("airspeed_m_s", "Airspeed")),
        ("temperature", "airspeed"),
        30,
        31,
    ),
    "HYGR": MessageMap(
        (
            column("temperature_k", "Temp Temperature", "degC"),
            column("relative_humidity", "Humidity", "%"),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"),
        20,
        21,
    ),
    "TEMP": MessageMap(
        (column("temperature_k", "Temp", "degC"),), ("cabin_temperature", "temperature"), 40, 41
    ),
    "CAM": MessageMap(_SHOT, ("events",), 10, 10),
    "TRIG": MessageMap(_SHOT, ("events",), 40, 40),
}

# Accuracy, and the ellipsoidal height of new logs (INT32_MIN / 100 means unknown), come in a
# message of their own with the time stamp of the GPS row.
ACCURACY_MESSAGE = "GPA"
ACCURACY = (
    column("h_ellipsoid_m", "AEl", floor=-1e5),
    column("sigma_h_m", "HAcc", missing=0.0),
    column("sigma_v_m", "VAcc", missing=0.0),
)
