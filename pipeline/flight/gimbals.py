"""Gimbals: whose attitude is the camera's, where the mission file says so."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.flight.mount import Mount
from pipeline.ledger import Entry, Kind, Ledger

_GIMBALS = ("MNT", "MOUNTSTATUS", "MOUNTORIENTATION", "GIMBALDEVICEATTITUDESTATUS")

# A camera on a gimbal looks along its forward axis; with the mount of an aircraft, in which it
# looks down, it is 90 degrees away from there.
_ASTRAY_DEG = 45.0


def report_gimbal_frames(
    messages: Mapping[str, int],
    roles: Mapping[str, Channel],
    mounts: Mapping[str, Mount],
    ledger: Ledger,
) -> None:
    """Say how each camera sits on the gimbal that plays the attitude, or that none is followed.

    Parameters
    ----------
    messages : count of every message type or topic of the log.
    roles : the channel of each role.
    mounts : by camera.
    """
    attitude = roles.get("attitude")
    if attitude is not None and is_of_gimbal(attitude.source.message):
        for camera, mount in mounts.items():
            _tell_frame(attitude, camera, mount, ledger)
        return
    found = [f"{count} {name}" for name, count in messages.items() if count and is_of_gimbal(name)]
    if found:
        ledger.warning(
            "GIMBAL-IGNORED",
            f"the log has {', '.join(found)} of a gimbal: no camera follows it unless its "
            "channel is named as attitude; each is taken as fixed to the aircraft by its mount",
        )


def is_of_gimbal(message: str) -> bool:
    """Whether a message is a gimbal's; PX4 writes the same name as a topic and as a ROS type."""
    return message.rpartition("/")[2].replace("_", "").upper() in _GIMBALS


def _tell_frame(attitude: Channel, camera: str, mount: Mount, ledger: Ledger) -> None:
    """Enter how far a camera looks from the forward axis of its gimbal, and from straight down."""
    axis = mount.camera_from_body[2]
    w, x, y, z = (attitude[f"q_{name}"] for name in "wxyz")
    down = axis @ np.stack(
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1 - 2.0 * (x * x + y * y)]
    )
    down = down[np.isfinite(down)]
    if down.size == 0:
        return
    astray = float(np.degrees(np.arccos(np.clip(axis[0], -1.0, 1.0))))
    nadir = float(np.degrees(np.arccos(np.clip(np.median(down), -1.0, 1.0))))
    ledger.add(
        Entry(
            Kind.WARNING if astray > _ASTRAY_DEG else Kind.NOTE,
            "GIMBAL-FRAME",
            f"{attitude.name} plays the attitude: it is that of a gimbal's payload (forward, "
            f"right, down), along whose forward axis a camera with pitch_deg: 90 looks. By its "
            f"mount {camera} looks {astray:.0f} deg away from that axis, and in the median "
            f"{nadir:.0f} deg from straight down",
            where=f"mount.{camera}",
        )
    )
