"""Attitudes of gimbals, whose yaw may count from north or from the nose."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.flight.channels import Array
from pipeline.ingest.fields import Column, column

# GIMBAL_DEVICE_FLAGS: in which frame the yaw of the quaternion is
_YAW_LOCK, _YAW_IN_VEHICLE_FRAME, _YAW_IN_EARTH_FRAME = 16, 32, 64


def device_columns(path: str = "q") -> tuple[Column, ...]:
    """The columns of MAVLink's GIMBAL_DEVICE_ATTITUDE_STATUS, where ``q`` is w, x, y, z."""
    return (
        *(column(f"q_{axis}", f"{path}.{k}") for k, axis in enumerate("wxyz")),
        *(column(f"gimbal_q_{axis}", f"{path}.{k}") for k, axis in enumerate("wxyz")),
        column("flags", "flags device_flags"),
    )


def north_only(columns: Mapping[str, Array]) -> dict[str, Array]:
    """`device_columns` with ``q_*`` only where they are an attitude; ``gimbal_q_*`` are as sent.

    The yaw counts from north or from the vehicle's nose, as the flags say; where neither flag is
    set, a locked yaw counts from north (the text of the message in MAVLink's common.xml).
    """
    flags = np.nan_to_num(columns["flags"]).astype(np.int64)
    lock = (flags & _YAW_LOCK != 0) & (flags & _YAW_IN_VEHICLE_FRAME == 0)
    north = (flags & _YAW_IN_EARTH_FRAME != 0) | lock
    attitude = {f"q_{axis}": np.where(north, columns[f"q_{axis}"], np.nan) for axis in "wxyz"}
    return dict(columns) | attitude
