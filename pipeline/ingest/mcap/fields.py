"""Which messages of MCAP logs are wanted, and which of their fields are which columns.

Fields are paths into the message; a number is an index into an array. The time of a message is
where ``time_field`` says: a Time, or microseconds (PX4) since boot or of Unix time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.flight.channels import Array
from pipeline.ingest import px4_fields
from pipeline.ingest.attitude import earth_frame_attitude, ned_frd_of_enu_flu, replace_in_blocks
from pipeline.ingest.boot_clock import LOWEST_FIX
from pipeline.ingest.fields import (
    ATTITUDE,
    GNSS,
    HUMIDITY,
    MAVLINK_FIX,
    PRESSURE,
    TEMPERATURE,
    FieldColumn,
    MessageMap,
    column,
)
from pipeline.ingest.mcap.cdr_schema import short
from pipeline.ingest.px4_fields import TIMESTAMP, camera_quaternion

HEADER = "header.stamp"


def _orientation(path: str) -> tuple[FieldColumn, ...]:
    return tuple(column(f"ros_{axis}", f"{path}.{axis}") for axis in "wxyz")


def _local(path: str) -> tuple[FieldColumn, ...]:
    # REP 103: x east, y north, z up of a local frame
    axes = zip(("east_m", "north_m", "up_m"), "xyz", strict=True)
    return tuple(column(name, f"{path}.{axis}") for name, axis in axes)


_PLACE_DEG = (column("lat_rad", "latitude", "deg"), column("lon_rad", "longitude", "deg"))
_COVARIANCE = (
    column("covariance_type", "position_covariance_type"),
    *(column(f"variance_{k}", f"position_covariance.{4 * k}") for k in range(3)),
)
_EVENTS = ("events",)

_FIX = MessageMap(
    (*_PLACE_DEG, column("h_ellipsoid_m", "altitude"), column("status", "status.status"),
     *_COVARIANCE),
    GNSS, 20, time_field=HEADER, position=True,
)  # fmt: skip
_POSE = MessageMap(
    (*_local("pose.position"), *_orientation("pose.orientation")),
    ATTITUDE, 40, time_field=HEADER, attitude=True,
)  # fmt: skip
_IMAGE = MessageMap((), _EVENTS, 20, time_field=HEADER)

_ROS = {
    "sensor_msgs/NavSatFix": _FIX,
    "sensor_msgs/Imu": MessageMap(
        (
            *_orientation("orientation"),
            column("covariance_0", "orientation_covariance.0"),
            column("rate_x_rad_s", "angular_velocity.x"),  # of a body forward, left, up
            column("rate_y_rad_s", "angular_velocity.y", "-"),
            column("rate_z_rad_s", "angular_velocity.z", "-"),
        ),
        ATTITUDE, 20, time_field=HEADER, attitude=True,
    ),
    "nav_msgs/Odometry": MessageMap(
        (*_local("pose.pose.position"), *_orientation("pose.pose.orientation")),
        ATTITUDE, 30, time_field=HEADER, attitude=True,
    ),
    "geometry_msgs/PoseStamped": _POSE,
    "sensor_msgs/FluidPressure": MessageMap(
        (column("pressure_pa", "fluid_pressure"),), PRESSURE, 10, time_field=HEADER
    ),
    "sensor_msgs/Temperature": MessageMap(
        (column("temperature_k", "temperature", "degC"),), TEMPERATURE, 20, time_field=HEADER
    ),
    "sensor_msgs/RelativeHumidity": MessageMap(
        (column("relative_humidity", "relative_humidity"),), HUMIDITY, 20, time_field=HEADER
    ),
    "sensor_msgs/Image": _IMAGE,
    "sensor_msgs/CompressedImage": _IMAGE,
}  # fmt: skip

_CAPTURED = MessageMap(
    (
        column("lat_rad", "geo.latitude", "deg"),
        column("lon_rad", "geo.longitude", "deg"),
        # GeoPoint is above the ellipsoid: the plugin adds the undulation to MAVLink's altitude
        column("h_ellipsoid_m", "geo.altitude"),
        column("h_home_m", "relative_alt"),
        column("event_index", "image_index"),
        *camera_quaternion("orientation", "wxyz"),
    ),
    _EVENTS, 15, time_field=HEADER,
)  # fmt: skip

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field

_MAVROS = {
    "mavros_msgs/GPSRAW": MessageMap(MAVLINK_FIX, GNSS, 25, time_field=HEADER, position=True),
    "mavros_msgs/CameraImageCaptured": _CAPTURED,
    "mavros_msgs/CamIMUStamp": MessageMap(
        (column("event_index", "frame_seq_id"),), _EVENTS, 25, time_field="frame_stamp"
    ),
    "mavros_msgs/DebugValue": MessageMap(
        (column("value", "value_float"), column("integer", "value_int"), column("kind", "type")),
        id_field="name", time_field=HEADER,
    ),
    "mavros_msgs/GimbalDeviceAttitudeStatus": MessageMap(
        tuple(column(f"gimbal_q_{axis}", f"q.{axis}") for axis in "wxyz"), time_field=HEADER
    ),
}  # fmt: skip

_PX4 = {f"px4_msgs/{name}": spec for name, spec in px4_fields.MESSAGES.items()}

_FOXGLOVE_IMAGE = replace(_IMAGE, time_field=TIMESTAMP)
_FOXGLOVE = {
    "foxglove.LocationFix": replace(_FIX, time_field=TIMESTAMP),
    "foxglove.PoseInFrame": replace(_POSE, time_field=TIMESTAMP),
    "foxglove.CompressedImage": _FOXGLOVE_IMAGE,
    "foxglove.RawImage": _FOXGLOVE_IMAGE,
    "foxglove.FrameTransform": MessageMap(  # a gimbal or a mount: no role unless it is named
        (*_local("translation"), *_orientation("rotation")), time_field=TIMESTAMP, attitude=True
    ),
}

SCHEMAS: Mapping[str, MessageMap] = _ROS | _MAVROS | _PX4 | _FOXGLOVE

PLAIN_JSON = MessageMap((column("value", "value"),), time_field=TIMESTAMP)
"""JSON of a schema of the user's own: a time and a value, of a role only when it is named."""

LABELS: Mapping[str, str] = {"file_url": "file_url", "frame_id": "header.frame_id frame_id"}
"""Texts that belong to each event, and where they may be."""


def known_name(schema: str) -> str:
    """The name of a message in `SCHEMAS`, whatever the encoding writes between its parts.

    >>> known_name("sensor_msgs/msg/NavSatFix"), known_name("foxglove_msgs/msg/RawImage")
    ('sensor_msgs/NavSatFix', 'foxglove.RawImage')
    """
    return short(schema).replace("foxglove_msgs/", "foxglove.")


def finished(schema: str, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns as decoded -> columns in use: one attitude convention, sigmas, a fix as in MAVLink.

    Parameters
    ----------
    columns : (n,) arrays by name. An Imu whose first covariance is -1 has no orientation
        (sensor_msgs/Imu); a NavSatFix whose covariance type is 0 does not know its accuracy.
    """
    result = dict(columns)
    if schema.endswith("/GimbalDeviceAttitudeStatus") and "flags" in result:
        result = earth_frame_attitude(result)
    if schema.endswith("/DebugValue"):
        kind, whole = result.pop("kind", None), result.pop("integer", None)
        if kind is not None and whole is not None:
            result["value"] = np.where(kind == _NAMED_VALUE_INT, whole, result["value"])
    if "ros_w" in result:
        q = [result.pop(f"ros_{axis}") for axis in "wxyz"]
        replace_in_blocks(ned_frd_of_enu_flu, q)
        if "covariance_0" in result:
            unknown = result.pop("covariance_0") == -1.0
            for part in q:
                part[unknown] = np.nan
        result |= {f"q_{axis}": part for axis, part in zip("wxyz", q, strict=True)}
    if "status" in result:
        result["fix"] = np.where(result.pop("status") >= 0.0, float(LOWEST_FIX), 0.0)
    if "covariance_type" in result:
        known = result.pop("covariance_type") > 0.0
        variances = [result.pop(f"variance_{k}", np.full(known.shape, np.nan)) for k in range(3)]
        east, north, up = (np.where(known, np.maximum(part, 0.0), np.nan) for part in variances)
        result |= {"sigma_h_m": np.sqrt(east / 2.0 + north / 2.0), "sigma_v_m": np.sqrt(up)}
    return result
