"""How a camera sits in the aircraft, or on a gimbal whose attitude the mission file names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.flight.channels import Array, Channel
from pipeline.flight.rotations import CAMERA_AT_REST
from pipeline.ledger import Entry, Kind, Notes, warning

_GIMBALS = ("MNT", "MOUNTSTATUS", "MOUNTORIENTATION", "GIMBALDEVICEATTITUDESTATUS")

# A camera on a gimbal looks along its forward axis; with the mount of an aircraft, in which it
# looks down, it is 90 degrees away from there.
_LARGEST_AXIS_ANGLE_DEG = 45.0


@dataclass(frozen=True)
class Mount:
    """How a camera sits in the aircraft; angles [rad], lever arm [m] in the body frame."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def camera_from_body(self) -> Array:
        """(3, 3) rotation from the body (forward, right, down) to the camera.

        >>> looks_forward = Mount(pitch_rad=1.5707963267948966)
        >>> round(float((looks_forward.camera_from_body @ [1.0, 0.0, 0.0])[2]), 6)
        1.0
        """
        turn = Rotation.from_euler("ZYX", [self.yaw_rad, self.pitch_rad, self.roll_rad])
        return np.asarray(CAMERA_AT_REST @ turn.as_matrix().T)


def gimbal_notes(
    messages: Mapping[str, int], roles: Mapping[str, Channel], mounts: Mapping[str, Mount]
) -> Notes:
    """How each camera sits on the gimbal that plays the attitude, or that none is followed.

    Parameters
    ----------
    messages : count of every message type or topic of the log.
    roles : the channel of each role.
    mounts : by camera.
    """
    attitude = roles.get("attitude")
    if attitude is None or not is_of_gimbal(attitude.source.message):
        listed = [f"{count} {name}" for name, count in messages.items()
                  if count and is_of_gimbal(name)]  # fmt: skip
        if not listed:
            return ()
        return (
            warning(
                "GIMBAL-IGNORED",
                f"the log has {', '.join(listed)} of a gimbal: no camera follows it unless its "
                "channel is named as attitude; each is taken as fixed to the aircraft by its mount",
            ),
        )
    notes = []
    w, x, y, z = (attitude[f"q_{name}"] for name in "wxyz")
    down_in_body = np.stack(
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1 - 2.0 * (x * x + y * y)]
    )
    for camera, mount in mounts.items():
        optical_axis = mount.camera_from_body[2]
        cosine = optical_axis @ down_in_body
        cosine = cosine[np.isfinite(cosine)]
        if cosine.size == 0:
            continue
        from_forward = float(np.degrees(np.arccos(np.clip(optical_axis[0], -1.0, 1.0))))
        from_nadir = float(np.degrees(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))))
        notes.append(
            Entry(
                Kind.WARNING if from_forward > _LARGEST_AXIS_ANGLE_DEG else Kind.NOTE,
                "GIMBAL-FRAME",
                f"{attitude.name} plays the attitude: it is that of a gimbal's payload (forward, "
                f"right, down), along whose forward axis a camera with pitch_deg: 90 looks. By its "
                f"mount {camera} looks {from_forward:.0f} deg away from that axis, and in the "
                f"median {from_nadir:.0f} deg from straight down",
                where=f"mount.{camera}",
            )
        )
    return tuple(notes)


def is_of_gimbal(message: str) -> bool:
    """Whether a message is a gimbal's; PX4 writes the same name as a topic and as a ROS type."""
    return message.rpartition("/")[2].replace("_", "").upper() in _GIMBALS
