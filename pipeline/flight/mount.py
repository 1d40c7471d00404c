"""How a camera sits in the aircraft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.flight.channels import Array

# A camera at rest in its mount looks down with the top of its image towards the nose: camera x is
# the body's y (right), camera y the body's -x (aft), camera z the body's z (down).
_CAMERA_FROM_REST = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


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
        return np.asarray(_CAMERA_FROM_REST @ turn.as_matrix().T)
