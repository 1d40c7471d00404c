"""How a camera sits in the aircraft, or on a gimbal that the mission file names as attitude."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import Channel, plain_name
from unbend.flight.rotations import (
    CAMERA_AT_REST,
    down_in_body,
    matrices_of,
    ned_from_body,
    quaternions_of,
)
from unbend.flight.trajectory import attitude_at
from unbend.messages import Message, Notes
from unbend.units import Array

_QUATERNION = ("q_w", "q_x", "q_y", "q_z")
_GIMBAL_MESSAGES = ("MNT", "MOUNTSTATUS", "MOUNTORIENTATION", "GIMBALDEVICEATTITUDESTATUS")

# Between the optical axis and the forward axis of a gimbal: 0 as a rule, and 90 degrees with the
# default mount of an aircraft, in which a camera looks down. Half-way between.
_LARGEST_AXIS_ANGLE_DEG = 45.0

# Angles that counter a motion have a slope of -1 over it, others of 0: half-way between.
_COUNTERED = -0.5

_LEAST_VARIATION_RAD2 = 1e-9  # of a motion, so that nothing is divided by 0

_LARGEST_ANGLE_RAD = 2.0 * np.pi  # old autopilots send a position instead, which is larger


@dataclass(frozen=True)
class Mount:
    """How a camera sits in the aircraft; angles [rad], lever arm [m] in the body frame.

    ``sigma_tilt_rad`` (about each level axis of the body) and ``sigma_yaw_rad`` (about its vertical
    axis) are the sigmas of attitude and mount together; None if the mission file states none.
    """

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_tilt_rad: float | None = None
    sigma_yaw_rad: float | None = None

    @property
    def camera_from_body(self) -> Array:
        """(3, 3) rotation from the body (forward, right, down) to the camera.

        >>> looks_forward = Mount(pitch_rad=1.5707963267948966)
        >>> round(float((looks_forward.camera_from_body @ [1.0, 0.0, 0.0])[2]), 6)
        1.0
        """
        from scipy.spatial.transform import Rotation

        angles = [self.yaw_rad, self.pitch_rad, self.roll_rad]
        body_from_mount = Rotation.from_euler("ZYX", angles)
        return np.asarray(CAMERA_AT_REST @ body_from_mount.as_matrix().T)


def payload_attitude(
    gimbal: Channel, aircraft: Channel | None, max_gap_s: float
) -> tuple[Channel, Notes]:
    """Fill in the attitude of a gimbal's payload in rows with a yaw relative to the nose.

    In these rows the attitude ``q_*`` is still unknown (NaN). It becomes

    * v_ned = Rz(yaw of the aircraft) Rz(yaw) Ry(pitch) Rx(roll) v_payload, as roll and pitch of
      gimbals are relative to the horizon (common.xml of MAVLink:
      GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME and MOUNT_ORIENTATION);
    * v_ned = R(aircraft) Rz(yaw) Ry(pitch) Rx(roll) v_payload for angles of servos, which a
      MOUNT_STATUS may contain: all three are relative to the aircraft.

    The mount (boresight) of the camera on the payload is applied later. The channel is returned
    unchanged if it has no such rows, or if ``aircraft``, the aircraft's attitude, is None.
    """
    all_relative = _rotations_relative_to_nose(gimbal)
    if all_relative is None or aircraft is None:
        return gimbal, ()
    quaternion = np.stack([gimbal.get(name) for name in _QUATERNION], axis=1)
    is_attitude_unknown = np.isnan(quaternion).any(axis=1)
    is_relative_known = np.isfinite(all_relative).all(axis=(1, 2))
    filled_rows = is_attitude_unknown & is_relative_known
    if not bool(filled_rows.any()):
        return gimbal, ()
    base_from_payload = all_relative[filled_rows]
    attitude = attitude_at(aircraft, gimbal.time_ns[filled_rows], max_gap_s).quaternion
    ned_from_aircraft = matrices_of(attitude)
    if _are_angles_of_servos(gimbal, base_from_payload, ned_from_aircraft):
        ned_from_base = ned_from_aircraft
        report = messages.gimbal_counters_motion
    else:
        ned_from_base = _yaw_alone(ned_from_aircraft)
        report = messages.gimbal_yaw_added
    quaternion[filled_rows] = quaternions_of(ned_from_base @ base_from_payload)
    message = report(
        gimbal=gimbal.name,
        rows=int(np.count_nonzero(filled_rows)),
        total=len(gimbal),
        aircraft=aircraft.name,
    )
    columns = dict(gimbal.columns)
    columns.update(zip(_QUATERNION, quaternion.T, strict=True))
    return replace(gimbal, columns=columns), (message,)


def _rotations_relative_to_nose(gimbal: Channel) -> Array | None:
    """(n, 3, 3) rotations Rz(yaw) Ry(pitch) Rx(roll) of a payload, yaw relative to the nose.

    They come from the columns ``gimbal_q_*``, else ``gimbal_*_rad``; NaN for angles of more than a
    turn. None if the channel has neither.
    """
    if "gimbal_q_w" in gimbal.columns:
        quaternion = np.stack([gimbal[f"gimbal_{name}"] for name in _QUATERNION], axis=1)
        return matrices_of(quaternion)
    if "gimbal_yaw_rad" not in gimbal.columns:
        return None
    columns = ("gimbal_roll_rad", "gimbal_pitch_rad", "gimbal_yaw_rad")
    angles = np.stack([gimbal[name] for name in columns], axis=1)
    is_impossible = (np.abs(angles) > _LARGEST_ANGLE_RAD).any(axis=1)
    angles[is_impossible] = np.nan
    return ned_from_body(angles)


def _are_angles_of_servos(
    gimbal: Channel, base_from_payload: Array, ned_from_aircraft: Array
) -> bool:
    """Whether all angles of a gimbal are relative to the aircraft, as those of its servos are.

    That is possible in a MOUNT_STATUS only: its roll and pitch then counter those of the aircraft.
    Roll and pitch relative to the horizon do not depend on the aircraft. Both arrays are (n, 3, 3).
    """
    if not is_of_gimbal(gimbal.source.message, "MOUNTSTATUS"):
        return False
    angles = roll_and_pitch(base_from_payload)
    motion = roll_and_pitch(ned_from_aircraft)
    return slope_of(angles, motion) < _COUNTERED


def _yaw_alone(ned_from_aircraft: Array) -> Array:
    """(n, 3, 3) rotations by only the yaw of an aircraft, without its roll and pitch."""
    north = ned_from_aircraft[:, 0, 0]  # of the forward axis
    east = ned_from_aircraft[:, 1, 0]
    angles = np.zeros((north.size, 3))
    angles[:, 2] = np.arctan2(east, north)
    return ned_from_body(angles)


def with_payload_attitude(
    channels: tuple[Channel, ...],
    named: Mapping[str, str],
    max_gap_s: float,
) -> tuple[tuple[Channel, ...], Notes]:
    """Fill in the `payload_attitude` of the gimbal that the mission file names for the attitude.

    ``named`` : role -> name of the channel. Returns all channels with that gimbal's replaced;
    unchanged if no gimbal is named for the attitude.
    """
    attitude_name = named.get("attitude")
    gimbal = next((channel for channel in channels if channel.name == attitude_name), None)
    if gimbal is None or not is_of_gimbal(gimbal.source.message):
        return channels, ()
    aircraft = _aircraft_of_gimbal(channels, named.get("aircraft_attitude"))
    payload, notes = payload_attitude(gimbal, aircraft, max_gap_s)
    replaced = tuple(payload if channel is gimbal else channel for channel in channels)
    return replaced, notes


def _aircraft_of_gimbal(channels: tuple[Channel, ...], name: str | None) -> Channel | None:
    """The channel with the attitude of the aircraft: the one named, else that of the best rank.

    ``name`` : from the mission file, if it names one. None if no channel has an attitude.
    """
    candidates: list[Channel] = []
    for channel in channels:
        is_candidate = channel.name == name or "attitude" in channel.roles
        if is_candidate and channel.fits_role("attitude"):
            candidates.append(channel)
    return min(candidates, key=lambda channel: (channel.name != name, channel.rank), default=None)


def gimbal_notes(
    logged: Mapping[str, int],
    roles: Mapping[str, Channel],
    mounts: Mapping[str, Mount],
) -> Iterator[Message]:
    """Report how each camera sits on the gimbal that has the role of the attitude.

    If no gimbal has it, report the gimbals of the log, which are not used. ``logged`` : number of
    messages by message type or topic. ``mounts`` : by camera.
    """
    attitude = roles.get("attitude")
    if attitude is None or not is_of_gimbal(attitude.source.message):
        listed: list[str] = []
        for name, count in logged.items():
            if count and is_of_gimbal(name):
                listed.append(f"{count} {name}")
        if listed:
            yield messages.gimbal_ignored(listed=", ".join(listed))
        return
    down = down_in_body(attitude)
    for camera, mount in mounts.items():
        optical_axis = mount.camera_from_body[2]  # in the body: forward, right, down
        cosines = optical_axis @ down  # of the angles from nadir
        cosines = cosines[np.isfinite(cosines)]
        if cosines.size == 0:
            continue
        from_forward_deg = _angle_deg(optical_axis[0])
        yield messages.gimbal_frame(
            camera=camera,
            attitude=attitude.name,
            from_forward_deg=from_forward_deg,
            from_nadir_deg=_angle_deg(np.median(cosines)),
            is_far=from_forward_deg > _LARGEST_AXIS_ANGLE_DEG,
        )


def _angle_deg(cosine: float) -> float:
    """The angle [deg] of a cosine; a cosine that rounding has carried beyond 1 counts as 1."""
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def roll_and_pitch(ned_from_body: Array) -> Array:
    """(2, n) roll and pitch [rad] of (n, 3, 3) rotations from body to north, east, down."""
    # The down components of the body's axes.
    down_of_forward = ned_from_body[:, 2, 0]
    down_of_right = ned_from_body[:, 2, 1]
    down_of_down = ned_from_body[:, 2, 2]
    roll = np.arctan2(down_of_right, down_of_down)
    pitch = -np.arcsin(down_of_forward.clip(-1.0, 1.0))
    return np.stack([roll, pitch])


def slope_of(angles: Array, motion: Array) -> float:
    """The least-squares slope of (k, n) angles over a (k, n) motion, each less its row's median.

    It is -1 if the angles counter the motion, and 0 without motion; rounded to three digits.
    Columns with a NaN do not count.

    >>> slope_of(np.array([[0.1, 0.0, -0.1]]), np.array([[-0.1, 0.0, 0.1]]))
    -1.0
    """
    has_angles = np.isfinite(angles).all(axis=0)
    has_motion = np.isfinite(motion).all(axis=0)
    is_known = has_angles & has_motion
    if not is_known.any():
        return 0.0
    y = _about_median(angles[:, is_known])
    x = _about_median(motion[:, is_known])
    variation = max(np.sum(x**2), _LEAST_VARIATION_RAD2)
    return round(float(np.sum(y * x) / variation), 3)


def _about_median(angles: Array) -> Array:
    """(k, n) angles less the median of each row."""
    median = np.median(angles, axis=1, keepdims=True)
    return np.asarray(angles - median)


def is_of_gimbal(message: str, *names: str) -> bool:
    """Whether a message type is that of a gimbal or, if ``names`` are given, one of ``names``.

    The message may be written as a topic (gimbal_v1) or a ROS type (px4_msgs/GimbalV1); ``names``
    are as `plain_name` gives them.
    """
    return plain_name(message) in (names or _GIMBAL_MESSAGES)
