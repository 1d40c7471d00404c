"""Which messages of MCAP logs are wanted, and which of their fields are which columns.

Fields are paths into the message; a number is an index into an array. The time of a message is
where ``time_field`` says: a Time, or microseconds (PX4) since boot or of Unix time.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
    columns,
    members,
)
from pipeline.ingest.mcap.cdr_schema import short
from pipeline.ingest.px4_fields import CAMERA_QUATERNION
from pipeline.units import Array


def _pose(place: str, turn: str) -> tuple[FieldColumn, ...]:
    """Columns of a place (REP 103: x east, y north, z up of a local frame) and an orientation."""
    local = columns("east_m north_m up_m", members(place, "xyz"))
    return (*local, *columns("ros_w ros_x ros_y ros_z", members(turn, "wxyz")))


_EVENTS = ("events",)

_FIX = MessageMap(
    (
        *columns("lat_rad lon_rad", "latitude longitude", "deg"),
        *columns("h_ellipsoid_m status", "altitude status.status"),
        column("covariance_type", "position_covariance_type"),
        *columns("variance_0 variance_1 variance_2", members("position_covariance", "048")),
    ),
    GNSS, 20, position=True,
)  # fmt: skip
_POSE = MessageMap(_pose("pose.position", "pose.orientation"), ATTITUDE, 40, attitude=True)
_IMAGE = MessageMap((), _EVENTS, 20)

_ROS = {
    "sensor_msgs/NavSatFix": _FIX,
    "sensor_msgs/Imu": MessageMap(
        (
            *columns("ros_w ros_x ros_y ros_z", members("orientation", "wxyz")),
            column("covariance_0", "orientation_covariance.0"),
            column("rate_x_rad_s", "angular_velocity.x"),  # of a body forward, left, up
            *columns("rate_y_rad_s rate_z_rad_s", members("angular_velocity", "yz"), "-"),
        ),
        ATTITUDE, 20, attitude=True,
    ),
    "nav_msgs/Odometry": MessageMap(
        _pose("pose.pose.position", "pose.pose.orientation"), ATTITUDE, 30, attitude=True
    ),
    "geometry_msgs/PoseStamped": _POSE,
    "sensor_msgs/FluidPressure": MessageMap(
        (column("pressure_pa", "fluid_pressure"),), PRESSURE, 10
    ),
    "sensor_msgs/Temperature": MessageMap(
        (column("temperature_k", "temperature", "degC"),), TEMPERATURE, 20
    ),
    "sensor_msgs/RelativeHumidity": MessageMap(
        (column("relative_humidity", "relative_humidity"),), HUMIDITY, 20
    ),
    "sensor_msgs/Image": _IMAGE,
    "sensor_msgs/CompressedImage": _IMAGE,
}  # fmt: skip

_CAPTURED = MessageMap(
    (
        *columns("lat_rad lon_rad", "geo.latitude geo.longitude", "deg"),
        # GeoPoint is above the ellipsoid: the plugin adds the undulation to MAVLink's altitude
        column("h_ellipsoid_m", "geo.altitude"),
        *columns("h_home_m event_index", "relative_alt image_index"),
        *columns(CAMERA_QUATERNION, members("orientation", "wxyz")),
    ),
    _EVENTS, 15,
)  # fmt: skip

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field

_MAVROS = {
    "mavros_msgs/GPSRAW": MessageMap(MAVLINK_FIX, GNSS, 25, position=True),
    "mavros_msgs/CameraImageCaptured": _CAPTURED,
    "mavros_msgs/CamIMUStamp": MessageMap(
        (column("event_index", "frame_seq_id"),), _EVENTS, 25
    ),
    "mavros_msgs/DebugValue": MessageMap(
        columns("value integer kind", "value_float value_int type"), id_field="name"
    ),
    "mavros_msgs/GimbalDeviceAttitudeStatus": MessageMap(
        columns("gimbal_q_w gimbal_q_x gimbal_q_y gimbal_q_z", members("q", "wxyz"))
    ),
}  # fmt: skip

_PX4 = {f"px4_msgs/{name}": spec for name, spec in px4_fields.MESSAGES.items()}

_FOXGLOVE = {
    "foxglove.LocationFix": _FIX,
    "foxglove.PoseInFrame": _POSE,
    "foxglove.CompressedImage": _IMAGE,
    "foxglove.RawImage": _IMAGE,
    # a gimbal or a mount: no role unless it is named
    "foxglove.FrameTransform": MessageMap(_pose("translation", "rotation"), attitude=True),
}

_STAMPS = {"mavros_msgs/CamIMUStamp": "frame_stamp"}
_WITH_HEADER = {
    name: replace(spec, time_field=_STAMPS.get(name, "header.stamp"))
    for name, spec in (_ROS | _MAVROS).items()
}
SCHEMAS: Mapping[str, MessageMap] = _WITH_HEADER | _PX4 | _FOXGLOVE

PLAIN_JSON = MessageMap((column("value", "value"),))
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
