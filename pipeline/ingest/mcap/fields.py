"""Which messages of MCAP logs are wanted, and what becomes of their columns.

The time of a message is where ``time_field`` says: a Time, or microseconds (PX4) since boot or of
Unix time.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.ingest import px4_fields
from pipeline.ingest.attitude import earth_frame_attitude, ned_frd_of_enu_flu, replace_in_blocks
from pipeline.ingest.boot_clock import LOWEST_FIX
from pipeline.ingest.fields import FieldColumn, MessageMap, message_maps
from pipeline.ingest.mcap.cdr import short
from pipeline.units import Array

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field

_PX4 = {f"px4_msgs/{name}": spec for name, spec in px4_fields.MESSAGES.items()}
_STAMPS = {"mavros_msgs/CamIMUStamp": "frame_stamp"}
_WITH_HEADER = {
    name: replace(spec, time_field=_STAMPS.get(name, "header.stamp"))
    for name, spec in message_maps("ros").items()
}
SCHEMAS: Mapping[str, MessageMap] = _WITH_HEADER | _PX4 | message_maps("foxglove")

PLAIN_JSON = MessageMap((FieldColumn("value", ("value",)),))
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
