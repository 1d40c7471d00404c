"""Which messages of PX4 are wanted, and which of their fields are which columns.

PX4 logs the same messages to its own files (.ulg) and, over ROS 2, to MCAP. Fields are paths into
the message; a number is an index into an array. ``timestamp`` counts microseconds since boot.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.ingest.attitude import gimbal_columns
from pipeline.ingest.channel_builder import DecodedRows
from pipeline.ingest.fields import (
    ATTITUDE,
    GNSS,
    HUMIDITY,
    INNOVATIONS,
    PRESSURE,
    TEMPERATURE,
    MessageMap,
    column,
    columns,
)
from pipeline.ledger import Ledger
from pipeline.units import Array

UTC_FIELD = "time_utc_usec"
"""Unix time [us] in the messages of receivers, beside their time since boot."""

CAPTURE_UTC_FIELD = "timestamp_utc"
"""Unix time [us] of an exposure by the autopilot's own clock, which it sets now and then."""

_FAILED = 0.0  # of ``result``: 1 is success, -1 a camera that does not answer (CameraCapture.msg)


CAMERA_QUATERNION = "camera_q_w camera_q_x camera_q_y camera_q_z"

# SensorGps has had its degrees as 1e-7 integers and its heights as mm before PX4 1.14.
_RECEIVER = MessageMap(
    (
        column("lat_rad", "latitude_deg", "deg"),
        column("lat_rad", "lat", "degE7"),
        column("lon_rad", "longitude_deg", "deg"),
        column("lon_rad", "lon", "degE7"),
        column("h_msl_m", "altitude_msl_m"),
        column("h_msl_m", "alt", "mm"),
        column("h_ellipsoid_m", "altitude_ellipsoid_m", missing=0.0),
        column("h_ellipsoid_m", "alt_ellipsoid", "mm", missing=0.0),
        column("sigma_h_m", "eph", "m plane"),
        column("sigma_v_m", "epv"),
        column("fix", "fix_type"),
        column("sigma_speed_m_s", "s_variance_m_s"),
        column("satellites", "satellites_used"),
        column("hdop", "hdop"),
        *columns("v_north_m_s v_east_m_s v_down_m_s", "vel_n_m_s vel_e_m_s vel_d_m_s"),
    ),
    GNSS, 20, position=True,
)  # fmt: skip
_SHOT = MessageMap(
    (
        *columns("lat_rad lon_rad", "lat lon", "deg"),
        column("h_msl_m", "alt"),
        *columns("event_index result", "seq result"),
        *columns(CAMERA_QUATERNION, "q.0 q.1 q.2 q.3"),
    ),
    ("events",), 10,
)  # fmt: skip

MESSAGES: Mapping[str, MessageMap] = {
    "SensorGps": _RECEIVER,
    "VehicleGpsPosition": replace(_RECEIVER, rank=21),
    "VehicleGlobalPosition": MessageMap(
        (
            *columns("lat_rad lon_rad", "lat lon", "deg"),
            column("h_msl_m", "alt"),
            column("h_ellipsoid_m", "alt_ellipsoid", missing=0.0),
            column("sigma_h_m", "eph", "m plane"),
            column("sigma_v_m", "epv"),
            *columns("v_north_m_s v_east_m_s v_down_m_s", "vel_n vel_e vel_d"),
        ),
        ("position",), 10, position=True,
    ),
    "VehicleLocalPosition": MessageMap(
        (
            *columns("north_m east_m", "x y"),
            column("up_m", "z", "-"),
            *columns("v_north_m_s v_east_m_s v_down_m_s", "vx vy vz"),
            column("sigma_h_m", "eph", "m plane"),
            column("sigma_v_m", "epv"),
            column("sigma_speed_m_s", "evh"),
        )
    ),
    "VehicleAttitude": MessageMap(
        (
            *columns("q_w q_x q_y q_z", "q.0 q.1 q.2 q.3"),
            # until PX4 1.10
            *columns("rate_x_rad_s rate_y_rad_s rate_z_rad_s", "rollspeed pitchspeed yawspeed"),
        ),
        ATTITUDE, 10, attitude=True,
    ),
    "VehicleAngularVelocity": MessageMap(
        columns("rate_x_rad_s rate_y_rad_s rate_z_rad_s", "xyz.0 xyz.1 xyz.2")
    ),
    "EstimatorStatus": MessageMap(
        (
            *columns(INNOVATIONS, "vel_test_ratio pos_test_ratio hgt_test_ratio mag_test_ratio"),
            column("filter_flags", "solution_status_flags", "ESTIMATOR_STATUS_FLAGS"),
            column("sigma_h_m", "pos_horiz_accuracy", "m plane"),
            column("sigma_v_m", "pos_vert_accuracy"),
        )
    ),
    "VehicleImuStatus": MessageMap(
        (
            column("vibration_m_s2", "accel_vibration_metric"),
            *(column(f"clipping_{k}", f"accel_clipping.{k}") for k in range(3)),
        )
    ),
    "VehicleAirData": MessageMap(
        (
            column("pressure_pa", "baro_pressure_pa"),
            column("board_temperature_k", "baro_temp_celcius ambient_temperature", "degC"),
        ),
        PRESSURE, 10,
    ),
    "SensorBaro": MessageMap(
        (column("pressure_pa", "pressure"), column("board_temperature_k", "temperature", "degC")),
        PRESSURE, 20,
    ),
    "Airspeed": MessageMap(
        (
            column("temperature_k", "air_temperature_celsius", "degC"),
            # the indicated one, as ArduPilot and MAVLink log it: the atmosphere applies the density
            column("airspeed_m_s", "indicated_airspeed_m_s"),
        ),
        ("temperature", "airspeed"), 30,
    ),
    "SensorHygrometer": MessageMap(
        (
            column("temperature_k", "temperature", "degC"),
            column("relative_humidity", "humidity", "%"),
        ),
        (*TEMPERATURE, *HUMIDITY), 20,
    ),
    "CameraCapture": _SHOT,
    "CameraTrigger": replace(_SHOT, rank=30),
    "GimbalDeviceAttitudeStatus": MessageMap(gimbal_columns(), attitude=True),
}  # fmt: skip
"""By the name of the message in px4_msgs."""


def topic_of(message: str) -> str:
    """The topic under which PX4 logs a message.

    >>> topic_of("VehicleGpsPosition")
    'vehicle_gps_position'
    """
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", message).lower()


TOPICS: Mapping[str, MessageMap] = {topic_of(name): spec for name, spec in MESSAGES.items()}


def captured_rows(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows of a camera without those that report that it took no image.

    An index that is 0 in all of several rows is dropped: mavros never fills it in.
    """
    columns: dict[str, Array] = dict(rows.columns)
    failed = columns.pop("result", np.ones(len(rows))) == _FAILED
    index = columns.get("event_index", np.empty(0))
    if index.shape[0] > 1 and not index.any():
        del columns["event_index"]
        what = f"all {len(rows)} rows have the index 0: they are numbered from 0 in order"
        ledger.note("EVENT-NO-INDEX", what, where=rows.name, count=len(rows))
    rows = replace(rows, columns=columns)
    if not failed.any():
        return rows
    what = f"{int(failed.sum())} of {len(rows)} rows report that the camera took no image"
    ledger.warning("EVENT-FAILED", what, where=rows.name, count=int(failed.sum()))
    return rows.take(~failed)
