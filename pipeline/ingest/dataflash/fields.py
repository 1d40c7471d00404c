"""Which DataFlash messages are wanted, and which of their fields are which columns.

Fields are named as FMT records name them; names changed over the years, newest first. Values are
already divided as the format letter says (c, C, e: 100; L: 1e7), so Lat is in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.fields import ATTITUDE, GNSS, PRESSURE, MessageMap, column
from pipeline.ingest.log import Table

INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


def instance_of(table: Table) -> NDArray[Any]:
    """The instance of each row, -1 where the message has none.

    Only integers tell instances apart: in PID messages I is a term of the controller.
    """
    for field in INSTANCE_FIELDS:
        if field in table and table[field].dtype.kind in "iu":
            return table[field]
    rows = len(next(iter(table.values()))) if table else 0
    return np.full(rows, -1, np.int8)


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

_SHOT = (
    *_PLACE,
    column("h_msl_m", "Alt"),
    column("h_home_m", "RelAlt"),
    column("h_gnss_m", "GPSAlt"),
    column("event_index", "Img"),
    *_EULER,
)

MESSAGES: Mapping[str, MessageMap] = {
    "POS": MessageMap(
        (*_PLACE, column("h_msl_m", "Alt"), column("h_home_m", "RelHomeAlt RelAlt")),
        ("position",), 10, position=True,
    ),
    "GPS": MessageMap(_GPS, GNSS, 20, position=True, spare_rank=30),
    "GPS2": MessageMap(_GPS, GNSS, 30, position=True),
    "ATT": MessageMap(_EULER, ATTITUDE, 10, attitude=True),
    # A second estimate: its place is 0, 0 until it has one.
    "AHR2": MessageMap(
        (
            *_EULER,
            column("lat_rad", "Lat", "deg", missing=0.0),
            column("lon_rad", "Lng", "deg", missing=0.0),
            column("h_msl_m", "Alt"),
        ),
        ATTITUDE, 40, attitude=True,
    ),
    "XKQ": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True, spare_rank=51),
    "XKQ1": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True),
    "NKQ1": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True),
    "XKF1": MessageMap(_EULER, ATTITUDE, 60, attitude=True, spare_rank=61),
    "NKF1": MessageMap(_EULER, ATTITUDE, 60, attitude=True, spare_rank=61),
    # The gimbal: its roll and pitch are to the horizon, YawE is to north. It is the attitude of a
    # camera, not of the aircraft: it plays a role only when the user names it.
    "MNT": MessageMap(
        (
            column("roll_rad", "Roll", "deg"),
            column("pitch_rad", "Pitch", "deg"),
            column("yaw_rad", "YawE", "deg"),
            column("yaw_in_body_rad", "YawB", "deg"),
        ),
        rank=70, attitude=True,
    ),
    "BARO": MessageMap(_BARO, PRESSURE, 10, spare_rank=20),
    "BAR2": MessageMap(_BARO, PRESSURE, 20),
    "BAR3": MessageMap(_BARO, PRESSURE, 30),
    "ARSP": MessageMap(
        (column("temperature_k", "Temp", "degC"), column("airspeed_m_s", "Airspeed")),
        ("temperature", "airspeed"), 30,
    ),
    "HYGR": MessageMap(
        (
            column("temperature_k", "Temp Temperature", "degC"),
            column("relative_humidity", "Humidity", "%"),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"), 20,
    ),
    # A probe anywhere: motor, battery, cabin, air. It plays only when the user names it.
    "TEMP": MessageMap((column("temperature_k", "Temp", "degC"),)),
    # What a script on the autopilot logs, a cabin sensor for one; it plays only when named.
    "NVF": MessageMap((column("value", "Value"),), id_field="Name"),
    "CAM": MessageMap(_SHOT, ("events",), 10),
    "TRIG": MessageMap(_SHOT, ("events",), 40),
}  # fmt: skip

# Accuracy, and the ellipsoidal height of new logs (INT32_MIN / 100 means unknown), come in a
# message of their own with the time stamp of the GPS row.
ACCURACY_MESSAGE = "GPA"
ACCURACY = (
    column("h_ellipsoid_m", "AEl", floor=-1e5),
    column("sigma_h_m", "HAcc", missing=0.0),
    column("sigma_v_m", "VAcc", missing=0.0),
    # Until 4.6 ArduPilot logged sea level minus ellipsoid, and 0 where it did not know.
    column("undulation_m", "Und", "-m", missing=0.0),
)
