"""How a camera sits in the aircraft, or on a gimbal whose attitude the mission file names."""

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

# A camera on a gimbal looks along its forward axis; with the mount of an aircraft, in which it
# looks down, it is 90 degrees away from there.
_LARGEST_AXIS_ANGLE_DEG = 45.0

# Angles that counter a motion have a slope of -1 over it, others of 0: half-way between.
_COUNTERED = -0.5

_LEAST_VARIATION_RAD2 = 1e-9  # of a motion: what is divided by is never 0

_LARGEST_ANGLE_RAD = 2.0 * np.pi  # more is no angle: old autopilots send a position instead


@dataclass(frozen=True)
class Mount:
    """How a camera sits in the aircraft; angles [rad], lever arm [m] in the body frame.

    ``sigma_tilt_rad``, about each level axis of the body, and ``sigma_yaw_rad``, about its vertical
    axis, are those of attitude and mount together. None where the mission file states none.
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
        turn = Rotation.from_euler("ZYX", angles)
        return np.asarray(CAMERA_AT_REST @ turn.as_matrix().T)


def payload_attitude(
    gimbal: Channel, aircraft: Channel | None, max_gap_s: float
) -> tuple[Channel, Notes]:
    """A gimbal's channel with the attitude of its payload, also where its yaw counts from the nose.

    In rows whose yaw counts from the nose the attitude ``q_*`` is unknown so far. It is

    * v_ned = Rz(yaw of the aircraft) Rz(yaw) Ry(pitch) Rx(roll) v_payload, as roll and pitch of
      gimbals count from the horizon (common.xml of MAVLink:
      GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME and MOUNT_ORIENTATION);
    * v_ned = R(aircraft) Rz(yaw) Ry(pitch) Rx(roll) v_payload for angles of servos, which a
      MOUNT_STATUS may hold: all three count from the aircraft.

    The mount (boresight) of the camera on the payload is applied later. The channel stays as it is
    if it has no such rows, or if no channel has the attitude of the aircraft.
    """
    rotations = _rotations_to_nose(gimbal)
    if rotations is None or aircraft is None:
        return gimbal, ()
    quaternion = np.stack([gimbal.get(name) for name in _QUATERNION], axis=1)
    is_unknown = np.isnan(quaternion).any(axis=1)
    is_known_to_nose = np.isfinite(rotations).all(axis=(1, 2))
    only_to_nose = is_unknown & is_known_to_nose
    if not bool(only_to_nose.any()):
        return gimbal, ()
    to_nose = rotations[only_to_nose]
    attitude = attitude_at(aircraft, gimbal.time_ns[only_to_nose], max_gap_s).quaternion
    ned_from_aircraft = matrices_of(attitude)
    if _are_angles_of_servos(gimbal, to_nose, ned_from_aircraft):
        ned_from_base = ned_from_aircraft
        describe = messages.gimbal_counters_motion
    else:
        ned_from_base = _yaw_alone(ned_from_aircraft)
        describe = messages.gimbal_yaw_added
    quaternion[only_to_nose] = quaternions_of(ned_from_base @ to_nose)
    message = describe(
        gimbal=gimbal.name,
        rows=int(np.count_nonzero(only_to_nose)),
        total=len(gimbal),
        aircraft=aircraft.name,
    )
    columns = dict(gimbal.columns)
    columns.update(zip(_QUATERNION, quaternion.T, strict=True))
    return replace(gimbal, columns=columns), (message,)


def _rotations_to_nose(gimbal: Channel) -> Array | None:
    """(n, 3, 3) rotations of a payload whose yaw counts from the nose of the aircraft.

    NaN for numbers that are no angles. None if the channel has neither such a quaternion nor such
    angles.
    """
    if "gimbal_q_w" in gimbal.columns:
        quaternion = np.stack([gimbal[f"gimbal_{name}"] for name in _QUATERNION], axis=1)
        return matrices_of(quaternion)
    if "gimbal_yaw_rad" not in gimbal.columns:
        return None
    columns = ("gimbal_roll_rad", "gimbal_pitch_rad", "gimbal_yaw_rad")
    angles = np.stack([gimbal[name] for name in columns], axis=1)
    impossible = (np.abs(angles) > _LARGEST_ANGLE_RAD).any(axis=1)
    angles[impossible] = np.nan
    return ned_from_body(angles)


def _are_angles_of_servos(gimbal: Channel, to_nose: Array, ned_from_aircraft: Array) -> bool:
    """Whether all angles count from the aircraft, as those of servos do.

    Only a MOUNT_STATUS may hold such angles. Its roll and pitch are such if they counter those of
    the aircraft; roll and pitch from the horizon do not depend on the aircraft.
    """
    if not is_of_gimbal(gimbal.source.message, "MOUNTSTATUS"):
        return False
    angles = roll_and_pitch(to_nose)
    motion = roll_and_pitch(ned_from_aircraft)
    return slope_of(angles, motion) < _COUNTERED


def _yaw_alone(ned_from_aircraft: Array) -> Array:
    """(n, 3, 3) rotations by the yaw of an aircraft alone, with neither roll nor pitch."""
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
    """The channels, in which a gimbal that is named for the attitude has its `payload_attitude`.

    ``named`` : role -> name of the channel. Without a gimbal named for the attitude the channels
    stay as they are.
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
    """The channel with the attitude of the aircraft: that of this name, else of the best rank."""
    candidates: list[Channel] = []
    for channel in channels:
        is_offered = channel.name == name or "attitude" in channel.roles
        if is_offered and channel.fits_role("attitude"):
            candidates.append(channel)
    return min(candidates, key=lambda channel: (channel.name != name, channel.rank), default=None)


def gimbal_notes(
    logged: Mapping[str, int],
    roles: Mapping[str, Channel],
    mounts: Mapping[str, Mount],
) -> Iterator[Message]:
    """Report how each camera sits on the gimbal that plays the attitude.

    If no gimbal does, report that the log has gimbals which are not used. ``logged`` : count of
    every message type or topic of the log. ``mounts`` : by camera.
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
        cosine = optical_axis @ down
        cosine = cosine[np.isfinite(cosine)]
        if cosine.size == 0:
            continue
        from_forward_deg = _angle_deg(optical_axis[0])
        yield messages.gimbal_frame(
            camera=camera,
            attitude=attitude.name,
            from_forward_deg=from_forward_deg,
            from_nadir_deg=_angle_deg(np.median(cosine)),
            far=from_forward_deg > _LARGEST_AXIS_ANGLE_DEG,
        )


def _angle_deg(cosine: float) -> float:
    """The angle [deg] of a cosine, which rounding may have carried beyond 1."""
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def roll_and_pitch(ned_from_body: Array) -> Array:
    """(2, n) roll and pitch [rad] of (n, 3, 3) matrices."""
    # How much each axis of the body points down.
    forward_axis = ned_from_body[:, 2, 0]
    right_axis = ned_from_body[:, 2, 1]
    down_axis = ned_from_body[:, 2, 2]
    roll = np.arctan2(right_axis, down_axis)
    pitch = -np.arcsin(forward_axis.clip(-1.0, 1.0))
    return np.stack([roll, pitch])


def slope_of(angles: Array, motion: Array) -> float:
    """The slope of (k, n) angles over a (k, n) motion, about the medians of both.

    It is -1 where the angles counter the motion, and 0 without motion; to three digits.

    >>> slope_of(np.array([[0.1, 0.0, -0.1]]), np.array([[-0.1, 0.0, 0.1]]))
    -1.0
    """
    has_angles = np.isfinite(angles).all(axis=0)
    has_motion = np.isfinite(motion).all(axis=0)
    is_known = has_angles & has_motion
    if not is_known.any():
        return 0.0
    turned = _about_median(angles[:, is_known])
    moved = _about_median(motion[:, is_known])
    variation = max(np.sum(moved**2), _LEAST_VARIATION_RAD2)
    return round(float(np.sum(turned * moved) / variation), 3)


def _about_median(angles: Array) -> Array:
    """(k, n) angles less the median of each row."""
    median = np.median(angles, axis=1, keepdims=True)
    return np.asarray(angles - median)


def is_of_gimbal(message: str, *names: str) -> bool:
    """Whether a message is one of a gimbal's or, if ``names`` are given, one of these.

    Cases, underscores and paths do not count, because PX4 writes the names as topics (gimbal_v1)
    and as ROS types (px4_msgs/GimbalV1).
    """
    return plain_name(message) in (names or _GIMBAL_MESSAGES)
