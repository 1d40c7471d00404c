"""Attitudes as logs write them -> the package's one convention.

The convention: v_ned = R(q) v_body, Hamilton, body forward-right-down, q_w >= 0.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from unbend.units import MOST_FLAGS, Array, whole_numbers

QUATERNION = ("q_w", "q_x", "q_y", "q_z")  # the columns of an attitude
BLOCK = 65_536  # rows converted at once: their quaternions fit the cache

# Bits of GIMBAL_DEVICE_FLAGS: the reference of the yaw of the quaternion.
_YAW_LOCK = 16
_YAW_IN_VEHICLE_FRAME = 32
_YAW_IN_EARTH_FRAME = 64


def unit_quaternions(q: Array) -> Array:
    """Scale (n, 4) quaternions w, x, y, z to length 1, and turn their sign so that w >= 0.

    Rows with a length of 0, infinite or NaN become NaN.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(q, axis=1, keepdims=True)
        usable = (length > 0.0) & np.isfinite(length)
        unit = q / np.where(usable, length, np.nan)
    has_negative_w = unit[:, :1] < 0.0
    return np.where(has_negative_w, -unit, unit)


def replace_in_blocks(
    to_quaternions: Callable[[Array], Array],
    columns: Sequence[Array],
) -> None:
    """Replace the numbers in four (n,) columns by the components of quaternions, in place.

    ``to_quaternions`` is called with (m, 4) numbers, m <= `BLOCK` successive rows of the four
    columns, and returns (m, 4) quaternions.
    """
    count = columns[0].shape[0]
    for begin in range(0, count, BLOCK):
        block = slice(begin, begin + BLOCK)
        numbers = np.stack([column[block] for column in columns], axis=1)
        quaternions = to_quaternions(numbers)
        for column, component in zip(columns, quaternions.T, strict=True):
            column[block] = component


def quaternion_of_euler(
    roll_rad: Array,
    pitch_rad: Array,
    yaw_rad: Array,
) -> Array:
    """(n, 4) quaternions w, x, y, z of (n,) Euler angles [rad] of any range.

    Yaw is applied first, then pitch, then roll (Z-Y-X), as in MAVLink ATTITUDE and in ATT.

    >>> quaternion_of_euler(np.zeros(1), np.zeros(1), np.array([np.pi / 2])).round(4)
    array([[0.7071, 0.    , 0.    , 0.7071]])
    """
    cos_roll = np.cos(roll_rad / 2.0)
    sin_roll = np.sin(roll_rad / 2.0)
    cos_pitch = np.cos(pitch_rad / 2.0)
    sin_pitch = np.sin(pitch_rad / 2.0)
    cos_yaw = np.cos(yaw_rad / 2.0)
    sin_yaw = np.sin(yaw_rad / 2.0)
    components = [
        cos_roll * cos_pitch * cos_yaw + sin_roll * sin_pitch * sin_yaw,
        sin_roll * cos_pitch * cos_yaw - cos_roll * sin_pitch * sin_yaw,
        cos_roll * sin_pitch * cos_yaw + sin_roll * cos_pitch * sin_yaw,
        cos_roll * cos_pitch * sin_yaw - sin_roll * sin_pitch * cos_yaw,
    ]
    return unit_quaternions(np.stack(components, axis=1))


def ned_frd_of_enu_flu(q: Array) -> Array:
    """Convert (n, 4) attitudes w, x, y, z of ROS (REP 103) to the convention of the package.

    ROS rotates from forward-left-up to east-north-up, the package from forward-right-down to
    north-east-down. The quaternion product (0, s, s, 0) q (0, 1, 0, 0), s = 1/sqrt(2), exchanges
    the axes of both frames.

    >>> ned_frd_of_enu_flu(np.array([[1.0, 0.0, 0.0, 0.0]])).round(4)  # x forward, facing east
    array([[0.7071, 0.    , 0.    , 0.7071]])
    """
    w = q[:, 0]
    x = q[:, 1]
    y = q[:, 2]
    z = q[:, 3]
    with np.errstate(over="ignore"):
        components = [
            w + z,
            x + y,
            x - y,
            w - z,
        ]
        product = np.sqrt(0.5) * np.stack(components, axis=1)
        return unit_quaternions(product)


def earth_frame_attitude(columns: Mapping[str, Array]) -> dict[str, Array]:
    """A gimbal's columns, with the quaternion ``q_*`` NaN where the yaw is not from north.

    The ``flags`` of a row state if yaw is measured from north or from the vehicle's nose; where
    neither flag is set, a locked yaw is from north (the text of the message in MAVLink's
    common.xml). The columns ``gimbal_q_*`` stay as sent.
    """
    flags = whole_numbers(columns["flags"], 0, MOST_FLAGS)  # NaN becomes 0: no flag is set
    is_locked = flags & _YAW_LOCK != 0
    in_vehicle_frame = flags & _YAW_IN_VEHICLE_FRAME != 0
    in_earth_frame = flags & _YAW_IN_EARTH_FRAME != 0
    from_north = in_earth_frame | (is_locked & ~in_vehicle_frame)
    result = dict(columns)
    for name in QUATERNION:
        result[name] = np.where(from_north, columns[name], np.nan)
    return result
