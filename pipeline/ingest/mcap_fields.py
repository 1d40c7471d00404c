"""Which ROS 2 messages are wanted, and which of their fields are which columns.

Fields are paths into the decoded message; a number is an index into an array.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.flight.channels import Array
from pipeline.ingest.build import LOWEST_FIX
from pipeline.ingest.fields import Column, MessageMap, column
from pipeline.ingest.frames import ned_frd_of_enu_flu

HEADER_ONLY = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")


def _orientation(path: str) -> tuple[Column, ...]:
    return tuple(column(f"ros_{axis}", f"{path}.{axis}") for axis in "wxyz")


def _local(path: str) -> tuple[Column, ...]:
    # REP 103: x east, y north, z up of a local frame
    axes = zip(("east_m", "north_m", "up_m"), "xyz", strict=True)
    return tuple(column(name, f"{path}.{axis}") for name, axis in axes)


_IMAGE = MessageMap((), ("events",), 20)

SCHEMAS: Mapping[str, MessageMap] = {
    "sensor_msgs/NavSatFix": MessageMap(
        (
            column("lat_rad", "latitude", "deg"),
            column("lon_rad", "longitude", "deg"),
            column("h_ellipsoid_m", "altitude"),
            column("status", "status.status"),
            column("covariance_type", "position_covariance_type"),
            *(column(f"variance_{k}", f"position_covariance.{4 * k}") for k in range(3)),
        ),
        ("height", "position"),
        20,
        position=True,
    ),
    "sensor_msgs/Imu": MessageMap(
        (*_orientation("orientation"), column("covariance_0", "orientation_covariance.0")),
        ("attitude",),
        20,
        attitude=True,
    ),
    "nav_msgs/Odometry": MessageMap(
        (*_local("pose.pose.position"), *_orientation("pose.pose.orientation")),
        ("attitude",),
        30,
        attitude=True,
    ),
    "geometry_msgs/PoseStamped": MessageMap(
        (*_local("pose.position"), *_orientation("pose.orientation")),
        ("attitude",),
        40,
        attitude=True,
    ),
    "sensor_msgs/FluidPressure": MessageMap(
        (column("pressure_pa", "fluid_pressure"),), ("pressure", "cabin_pressure"), 10
    ),
    "sensor_msgs/Temperature": MessageMap(
        (column("temperature_k", "temperature", "degC"),),
        ("temperature", "cabin_temperature"),
        20,
    ),
    "sensor_msgs/RelativeHumidity": MessageMap(
        (column("relative_humidity", "relative_humidity"),), ("humidity", "cabin_humidity"), 20
    ),
    "sensor_msgs/Image": _IMAGE,
    "sensor_msgs/CompressedImage": _IMAGE,
}


def short_name(schema: str) -> str:
    """The name of a message without the ``msg`` that ROS 2 puts into it.

    >>> short_name("sensor_msgs/msg/NavSatFix")
    'sensor_msgs/NavSatFix'
    """
    return schema.replace("/msg/", "/")


def finished(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns as decoded -> columns in use: one attitude convention, sigmas, a fix as in MAVLink.

    Parameters
    ----------
    columns : (n,) arrays by name. An Imu whose first covariance is -1 has no orientation
        (sensor_msgs/Imu); a NavSatFix whose covariance type is 0 does not know its accuracy.
    """
    result = dict(columns)
    if "ros_w" in result:
        ros = np.stack([result.pop(f"ros_{axis}") for axis in "wxyz"], axis=1)
        none = result.pop("covariance_0", np.zeros(ros.shape[0])) == -1.0
        q = np.where(none[:, None], np.nan, ned_frd_of_enu_flu(ros))
        result |= {f"q_{axis}": q[:, k] for k, axis in enumerate("wxyz")}
    if "status" in result:
        result["fix"] = np.where(result.pop("status") >= 0.0, float(LOWEST_FIX), 0.0)
    if "covariance_type" in result:
        known = result.pop("covariance_type") > 0.0
        east, north, up = (
            np.where(known, np.maximum(result.pop(f"variance_{k}"), 0.0), np.nan) for k in range(3)
        )
        # one horizontal axis, as HAcc of a receiver
        result |= {"sigma_h_m": np.sqrt(east / 2.0 + north / 2.0), "sigma_v_m": np.sqrt(up)}
    return result
