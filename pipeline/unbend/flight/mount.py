"""How a camera sits in the aircraft, or on a gimbal whose attitude the mission file names."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight import rotations
from unbend.flight.channels import Channel
from unbend.flight.rotations import CAMERA_AT_REST, down_in_body
from unbend.flight.trajectory import attitude_at
from unbend.messages import Entry, Notes, note, warning
from unbend.units import Array

_Q = ("q_w", "q_x", "q_y", "q_z")
_GIMBALS = ("MNT", "MOUNTSTATUS", "MOUNTORIENTATION", "GIMBALDEVICEATTITUDESTATUS")

# A camera on a gimbal looks along its forward axis; with the mount of an aircraft, in which it
# looks down, it is 90 degrees away from there.
_LARGEST_AXIS_ANGLE_DEG = 45.0

_COUNTERED = -0.5  # slope of angles that counter a motion, half-way to none


@dataclass(frozen=True)
class Mount:
    """How a camera sits in the aircraft; angles [rad], lever arm [m] in the body frame.

    ``sigma_tilt_rad`` about each level axis of the body and ``sigma_yaw_rad`` about its vertical
    one are those of the attitude and the mount together; None for those of the log.
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

        turn = Rotation.from_euler("ZYX", [self.yaw_rad, self.pitch_rad, self.roll_rad])
        return np.asarray(CAMERA_AT_REST @ turn.as_matrix().T)


def payload_attitude(
    gimbal: Channel, aircraft: Channel | None, max_gap_s: float
) -> tuple[Channel, Notes]:
    """A gimbal's channel with the attitude of its payload where its yaw counts from the nose.

    Roll and pitch of gimbals are to the horizon, so only the yaw of the aircraft is added:
    v_ned = Rz(yaw of the aircraft) Rz(yaw) Ry(pitch) Rx(roll) v_payload, then comes the mount
    (boresight) of the camera (common.xml of MAVLink: GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME and
    MOUNT_ORIENTATION). MOUNT_STATUS may hold the angles of servos: where they counter roll and
    pitch of the aircraft (a slope of -1) they are to it, v_ned = R(aircraft) Rz(yaw) Ry(pitch)
    Rx(roll) v_payload. Angles beyond a turn are none: old autopilots send a place there.
    """
    known = np.stack([gimbal.get(name) for name in _Q], 1)
    if f"gimbal_{_Q[0]}" in gimbal.columns:
        to_nose = rotations.matrices_of(np.stack([gimbal[f"gimbal_{name}"] for name in _Q], axis=1))
    elif "gimbal_yaw_rad" in gimbal.columns:
        angles = np.stack([gimbal[f"gimbal_{name}_rad"] for name in ("roll", "pitch", "yaw")], 1)
        angles[(np.abs(angles) > 2.0 * np.pi).any(axis=1)] = np.nan
        to_nose = rotations.ned_from_body(angles)
    else:
        return gimbal, ()
    missing = np.isnan(known).any(axis=1) & np.isfinite(to_nose).all(axis=(1, 2))
    if aircraft is None or not bool(missing.any()):
        return gimbal, ()
    attitude = attitude_at(aircraft, gimbal.time_ns[missing], max_gap_s).quaternion
    turned = rotations.matrices_of(attitude)
    added = f"that of {aircraft.name} is added"
    if is_of_gimbal(gimbal.source.message, "MOUNTSTATUS") and (
        slope_of(roll_and_pitch(to_nose[missing]), roll_and_pitch(turned)) < _COUNTERED
    ):
        added = f"its angles counter the motion of {aircraft.name} and are added to its attitude"
    else:
        level = np.zeros((turned.shape[0], 3))
        level[:, 2] = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
        turned = rotations.ned_from_body(level)
    known[missing] = rotations.quaternions_of(turned @ to_nose[missing])
    where, count, total = gimbal.name, int(missing.sum()), len(gimbal)
    entry = note("GIMBAL-YAW", where=where, count=count, total=total, added=added)
    columns = dict(gimbal.columns) | dict(zip(_Q, known.T, strict=True))
    return replace(gimbal, columns=columns), (entry,)


def with_payload_attitude(
    channels: tuple[Channel, ...], named: Mapping[str, str], max_gap_s: float
) -> tuple[tuple[Channel, ...], Notes]:
    """The channels, that of a gimbal which is named as attitude with its `payload_attitude`.

    ``named`` : role -> channel. The aircraft is the channel named for that, or the best that may
    play the attitude.
    """
    gimbals = [c for c in channels if c.name == named.get("attitude")]
    if not gimbals or not is_of_gimbal(gimbals[0].source.message):
        return channels, ()
    own = named.get("aircraft_attitude")
    able = [c for c in channels if c.name == own or "attitude" in c.roles]
    able = [c for c in able if c.fits_role("attitude")]
    aircraft = min(able, key=lambda c: (c.name != own, c.rank), default=None)
    payload, notes = payload_attitude(gimbals[0], aircraft, max_gap_s)
    return tuple(payload if c is gimbals[0] else c for c in channels), notes


def gimbal_notes(
    messages: Mapping[str, int], roles: Mapping[str, Channel], mounts: Mapping[str, Mount]
) -> Iterator[Entry]:
    """How each camera sits on the gimbal that plays the attitude, or that none is followed.

    ``messages`` : count of every message type or topic of the log. ``mounts`` : by camera.
    """
    attitude = roles.get("attitude")
    if attitude is None or not is_of_gimbal(attitude.source.message):
        listed = [f"{count} {name}" for name, count in messages.items()
                  if count and is_of_gimbal(name)]  # fmt: skip
        if listed:
            yield warning("GIMBAL-IGNORED", listed=", ".join(listed))
        return
    for camera, mount in mounts.items():
        optical_axis = mount.camera_from_body[2]
        cosine = optical_axis @ down_in_body(attitude)
        cosine = cosine[np.isfinite(cosine)]
        if cosine.size == 0:
            continue
        from_forward = float(np.degrees(np.arccos(np.clip(optical_axis[0], -1.0, 1.0))))
        from_nadir = float(np.degrees(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))))
        entry = warning if from_forward > _LARGEST_AXIS_ANGLE_DEG else note
        yield entry("GIMBAL-FRAME", where=f"mount.{camera}", camera=camera, attitude=attitude.name,
                    forward=from_forward, nadir=from_nadir)  # fmt: skip


def roll_and_pitch(ned_from_body: Array) -> Array:
    """(2, n) roll and pitch [rad] of (n, 3, 3) matrices."""
    right, down = ned_from_body[:, 2, 1], ned_from_body[:, 2, 2]
    return np.stack([np.arctan2(right, down), -np.arcsin(ned_from_body[:, 2, 0].clip(-1.0, 1.0))])


def slope_of(angles: Array, motion: Array) -> float:
    """By how much angles follow a motion, (k, n) each: -1 where they counter it; 0 without any.

    >>> slope_of(np.array([[0.1, 0.0, -0.1]]), np.array([[-0.1, 0.0, 0.1]]))
    -1.0
    """
    both = np.isfinite(angles).all(axis=0) & np.isfinite(motion).all(axis=0)
    if not both.any():
        return 0.0
    own, moved = (x[:, both] - np.median(x[:, both], 1, keepdims=True) for x in (angles, motion))
    return round(float(np.sum(own * moved) / max(np.sum(moved**2), 1e-9)), 3)


def is_of_gimbal(message: str, *names: str) -> bool:
    """Whether a message is a gimbal's, or of these names; PX4 writes it as topic and ROS type."""
    return message.rpartition("/")[2].replace("_", "").upper() in (names or _GIMBALS)
