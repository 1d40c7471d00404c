"""Which DataFlash messages are wanted, and which of their fields are which columns.

Fields are named as FMT records name them; names changed over the years, newest first. Values are
already divided as the format letter says (c, C, e: 100; L: 1e7), so Lat is in degrees.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.fields import (
    ATTITUDE,
    GNSS,
    INNOVATIONS,
    PRESSURE,
    MessageMap,
    column,
    columns,
)
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


_PLACE = columns("lat_rad lon_rad", "Lat Lng", "deg")
_EULER = (
    column("roll_rad", "R Roll", "deg"),
    column("pitch_rad", "P Pitch", "deg"),
    column("yaw_rad", "Y Yaw", "deg"),
)
_QUATERNION = columns("q_w q_x q_y q_z", "Q1 Q2 Q3 Q4")
_EPOCH = (column("gps_week", "GWk GPSWeek", missing=0.0), column("gps_week_s", "GMS GPSTime", "ms"))
_GPS = (
    *_PLACE,
    column("h_msl_m", "Alt"),
    column("fix", "Status"),
    column("speed_m_s", "Spd"),
    column("course_rad", "GCrs", "deg"),
    column("v_down_m_s", "VZ"),
    column("satellites", "NSats"),
    column("hdop", "HDop", missing=99.99),
    *_EPOCH,
)

# Of a filter: attitude, velocity, and the place from the origin (ORGN[0]).
_FILTER = (
    *_EULER,
    *columns("v_north_m_s v_east_m_s v_down_m_s north_m east_m", "VN VE VD PN PE"),
    column("up_m", "PD", "-"),
)
_HEALTH = MessageMap(
    (
        *columns(INNOVATIONS, "SV SP SH SM"),
        column("filter_flags", "SS", "nav_filter_status"),
        *columns("filter_timeouts filter_faults", "TS FS"),
    )
)

# Temp of a barometer is its board: 20-51 C were seen in the air, never the outside temperature.
_BARO = (column("pressure_pa", "Press"), column("board_temperature_k", "Temp", "degC"))

_SHOT = (
    *_PLACE,
    *columns("h_msl_m h_home_m h_gnss_m event_index", "Alt RelAlt GPSAlt Img"),
    *_EULER,
    *_EPOCH,
    column("sigma_time_s", "sigma_time_s"),  # made of what old logs have
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
            *columns("lat_rad lon_rad", "Lat Lng", "deg", missing=0.0),
            column("h_msl_m", "Alt"),
        ),
        ATTITUDE, 40, attitude=True,
    ),
    "XKQ": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True, spare_rank=51),
    "XKQ1": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True),
    "NKQ1": MessageMap(_QUATERNION, ATTITUDE, 50, attitude=True),
    "XKF1": MessageMap(_FILTER, ATTITUDE, 60, attitude=True, spare_rank=61),
    "NKF1": MessageMap(_FILTER, ATTITUDE, 60, attitude=True, spare_rank=61),
    "EKF1": MessageMap(_FILTER, ATTITUDE, 60, attitude=True),
    # Type 0 is the origin of the filter's local places, 1 is home.
    "ORGN": MessageMap((*_PLACE, column("h_msl_m", "Alt")), id_field="Type"),
    # What the autopilot's own terrain grid has below it: no role, a check of ground heights.
    "TERR": MessageMap(
        (
            *_PLACE,
            *columns("h_terrain_m h_above_terrain_m terrain_status", "TerrH CHeight Status"),
            *columns("tiles_pending tiles_loaded", "Pending Loaded"),
        )
    ),
    "XKF4": _HEALTH,
    "NKF4": _HEALTH,
    "EKF4": _HEALTH,
    "VIBE": MessageMap(
        (
            *(column(f"vibration_m_s2_{axis}", f"Vibe{axis}") for axis in "XYZ"),
            column("clipping_0", "Clip Clip0"),
            *columns("clipping_1 clipping_2", "Clip1 Clip2"),
        ),
        id_field="IMU",
    ),
    "IMU": MessageMap(columns("rate_x_rad_s rate_y_rad_s rate_z_rad_s", "GyrX GyrY GyrZ")),
    # The gimbal: its roll and pitch are to the horizon, YawE is to north. It is the attitude of a
    # camera, not of the aircraft: it plays a role only when the user names it.
    "MNT": MessageMap(
        (
            *columns("roll_rad pitch_rad yaw_rad", "Roll Pitch YawE", "deg"),
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
    "MSG": MessageMap((), text_field="Message"),
    "EV": MessageMap((), text_field="Id"),
    "ERR": MessageMap((), text_field="Subsys"),
    "CAM": MessageMap(_SHOT, ("events",), 10),
    "TRIG": MessageMap(_SHOT, ("events",), 40),
}  # fmt: skip

# What EV and ERR mean, as far as they concern the filter and the receivers (AP_Logger.h); in ERR
# the second number is 0 where the trouble is over.
EVENTS = {60: "EKF_ALT_RESET", 62: "EKF_YAW_RESET", 67: "GPS_PRIMARY_CHANGED"}
ERRORS = {
    3: "COMPASS", 7: "FAILSAFE_GPS", 11: "GPS", 12: "CRASH_CHECK", 16: "EKFCHECK",
    17: "FAILSAFE_EKFINAV", 18: "BARO", 24: "EKF_PRIMARY", 29: "FAILSAFE_VIBE",
    31: "FAILSAFE_DEADRECKON",
}  # fmt: skip


def texts_of(message: str, field: str, table: Table) -> tuple[str, ...] | None:
    """What the autopilot says in each row of MSG, EV or ERR; None where no text is defined.

    >>> texts_of("ERR", "Subsys", {"Subsys": np.array([16], "u1"), "ECode": np.array([2], "u1")})
    ('ERR EKFCHECK 2',)
    """
    words = table.get(field)
    if words is None or words.dtype.kind != ("U" if message == "MSG" else "u"):
        return None
    if message == "MSG":
        return tuple(words.tolist())
    names = EVENTS if message == "EV" else ERRORS
    codes = table["ECode"].tolist() if "ECode" in table else [""] * words.shape[0]
    pairs = zip(words.tolist(), codes, strict=True)
    return tuple(f"{message} {names.get(number, number)} {code}".strip() for number, code in pairs)


# Accuracy, and the ellipsoidal height of new logs (INT32_MIN / 100 means unknown), come in a
# message of their own with the time stamp of the GPS row.
ACCURACY_MESSAGES = {"GPS": "GPA", "GPS2": "GPA2"}
ACCURACY = (
    column("h_ellipsoid_m", "AEl", floor=-1e5),
    column("sigma_h_m", "HAcc", "m plane", missing=0.0),
    *columns("sigma_v_m sigma_speed_m_s", "VAcc SAcc", missing=0.0),
    column("has_vertical_speed", "VV"),
    # Until 4.6 ArduPilot logged sea level minus ellipsoid, and 0 where it did not know.
    column("undulation_m", "Und", "-", missing=0.0),
)
