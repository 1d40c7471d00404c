"""Which messages of PX4 are wanted, and which of their fields are which columns.

PX4 logs the same messages to its own files (.ulg) and, over ROS 2, to MCAP. Fields are paths into
the message; a number is an index into an array. ``timestamp`` counts microseconds since boot.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from pipeline.flight.channels import Array
from pipeline.ingest.attitude import gimbal_columns
from pipeline.ingest.channel_builder import DecodedRows
from pipeline.ingest.fields import (
    ATTITUDE,
    GNSS,
    HUMIDITY,
    PRESSURE,
    TEMPERATURE,
    FieldColumn,
    MessageMap,
    column,
)
from pipeline.ledger import Ledger

TIMESTAMP = "timestamp"
UTC_FIELD = "time_utc_usec"
"""Unix time [us] in the messages of receivers, beside their time since boot."""

CAPTURE_UTC_FIELD = "timestamp_utc"
"""Unix time [us] of an exposure by the autopilot's own clock, which it sets now and then."""

_FAILED = 0.0  # of ``result``: 1 is success, -1 a camera that does not answer (CameraCapture.msg)


def camera_quaternion(path: str, axes: str = "0123") -> tuple[FieldColumn, ...]:
    """The attitude of a camera, w, x, y, z in this order under a path."""
    pairs = zip("wxyz", axes, strict=True)
    return tuple(column(f"camera_q_{axis}", f"{path}.{name}") for axis, name in pairs)


def _axes(names: Iterable[str], fields: Iterable[str]) -> tuple[FieldColumn, ...]:
    return tuple(map(column, names, fields))


_VELOCITY = ("v_north_m_s", "v_east_m_s", "v_down_m_s")
_RATES = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")

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
        *_axes(_VELOCITY, ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")),
    ),
    GNSS, 20, time_field=TIMESTAMP, position=True,
)  # fmt: skip
_SHOT = MessageMap(
    (
        column("lat_rad", "lat", "deg"),
        column("lon_rad", "lon", "deg"),
        column("h_msl_m", "alt"),
        column("event_index", "seq"),
        column("result", "result"),
        *camera_quaternion("q"),
    ),
    ("events",), 10, time_field=TIMESTAMP,
)  # fmt: skip

MESSAGES: Mapping[str, MessageMap] = {
    "SensorGps": _RECEIVER,
    "VehicleGpsPosition": replace(_RECEIVER, rank=21),
    "VehicleGlobalPosition": MessageMap(
        (
            column("lat_rad", "lat", "deg"),
            column("lon_rad", "lon", "deg"),
            column("h_msl_m", "alt"),
            column("h_ellipsoid_m", "alt_ellipsoid", missing=0.0),
            column("sigma_h_m", "eph", "m plane"),
            column("sigma_v_m", "epv"),
            *_axes(_VELOCITY, ("vel_n", "vel_e", "vel_d")),
        ),
        ("position",), 10, time_field=TIMESTAMP, position=True,
    ),
    "VehicleLocalPosition": MessageMap(
        (
            *_axes(("north_m", "east_m"), "xy"),
            column("up_m", "z", "-"),
            *_axes(_VELOCITY, ("vx", "vy", "vz")),
            column("sigma_h_m", "eph", "m plane"),
            column("sigma_v_m", "epv"),
            column("sigma_speed_m_s", "evh"),
        ),
        time_field=TIMESTAMP,
    ),
    "VehicleAttitude": MessageMap(
        (
            *(column(f"q_{axis}", f"q.{k}") for k, axis in enumerate("wxyz")),
            *_axes(_RATES, ("rollspeed", "pitchspeed", "yawspeed")),  # until PX4 1.10
        ),
        ATTITUDE, 10, time_field=TIMESTAMP, attitude=True,
    ),
    "VehicleAngularVelocity": MessageMap(
        _axes(_RATES, ("xyz.0", "xyz.1", "xyz.2")), time_field=TIMESTAMP
    ),
    "EstimatorStatus": MessageMap(
        (
            column("innovation_velocity", "vel_test_ratio"),
            column("innovation_position", "pos_test_ratio"),
            column("innovation_height", "hgt_test_ratio"),
            column("innovation_compass", "mag_test_ratio"),
            column("filter_flags", "solution_status_flags", "ESTIMATOR_STATUS_FLAGS"),
            column("sigma_h_m", "pos_horiz_accuracy", "m plane"),
            column("sigma_v_m", "pos_vert_accuracy"),
        ),
        time_field=TIMESTAMP,
    ),
    "VehicleImuStatus": MessageMap(
        (
            column("vibration_m_s2", "accel_vibration_metric"),
            *(column(f"clipping_{k}", f"accel_clipping.{k}") for k in range(3)),
        ),
        time_field=TIMESTAMP,
    ),
    "VehicleAirData": MessageMap(
        (
            column("pressure_pa", "baro_pressure_pa"),
            column("board_temperature_k", "baro_temp_celcius ambient_temperature", "degC"),
        ),
        PRESSURE, 10, time_field=TIMESTAMP,
    ),
    "SensorBaro": MessageMap(
        (column("pressure_pa", "pressure"), column("board_temperature_k", "temperature", "degC")),
        PRESSURE, 20, time_field=TIMESTAMP,
    ),
    "Airspeed": MessageMap(
        (
            column("temperature_k", "air_temperature_celsius", "degC"),
            # the indicated one, as ArduPilot and MAVLink log it: the atmosphere applies the density
            column("airspeed_m_s", "indicated_airspeed_m_s"),
        ),
        ("temperature", "airspeed"), 30, time_field=TIMESTAMP,
    ),
    "SensorHygrometer": MessageMap(
        (
            column("temperature_k", "temperature", "degC"),
            column("relative_humidity", "humidity", "%"),
        ),
        (*TEMPERATURE, *HUMIDITY), 20, time_field=TIMESTAMP,
    ),
    "CameraCapture": _SHOT,
    "CameraTrigger": replace(_SHOT, rank=30),
    "GimbalDeviceAttitudeStatus": MessageMap(
        gimbal_columns(), time_field=TIMESTAMP, attitude=True
    ),
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
