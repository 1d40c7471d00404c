"""What the simulated cameras see: mount, window, lens, pixels.

Camera axes: x right, y down, z forward. Pixels: the centre of the upper left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A camera at rest in the mount looks down, image top towards the nose (body: forward, right, down).
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class SimulatedCamera:
    """A pinhole with Brown-Conrady distortion (OpenCV's order k1, k2, p1, p2, k3) in a mount.

    The mount rotation Rz(yaw) Ry(pitch) Rx(roll) turns the camera from rest, in body axes;
    the lever arm runs from the GNSS reference point to the camera, body forward, right, down.
    """

    name: str
    instance: int
    focal_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float]
    roll_deg: float
    lever_arm_m: tuple[float, float, float]
    width_px: int = 14_000
    height_px: int = 10_600
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def from_body(self) -> Array:
        """Rotation (3, 3): v_camera = R v_body."""
        mount = body_rotation(*np.radians([self.roll_deg, self.pitch_deg, self.yaw_deg]))
        return np.asarray(CAMERA_FROM_BODY @ mount.T)

    def project(self, rays: Array) -> tuple[Array, Array]:
        """Pixels x, y (n,) of rays (n, 3) in camera axes with z > 0.

        Brown (1971); OpenCV, Camera Calibration and 3D Reconstruction.
        """
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return self.focal_px * xd + self.cx_px, self.focal_px * yd + self.cy_px

    def sees(self, rays: Array, margin_px: float = 80.0) -> NDArray[np.bool_]:
        """Which rays (n, 3) fall on the sensor, a margin inside its edge."""
        # The distortion polynomial folds far rays back onto the sensor: first without the lens.
        reach = 0.6 * np.array([self.width_px, self.height_px]) / self.focal_px
        near = np.all(np.abs(rays[..., :2]) < reach * rays[..., 2:], axis=-1)
        ahead = near & (rays[..., 2] > 0.0)
        safe = np.where(ahead[..., None], rays, [0.0, 0.0, 1.0])
        x, y = self.project(safe)
        inside_x = np.abs(x - 0.5 * self.width_px) < 0.5 * self.width_px - margin_px
        inside_y = np.abs(y - 0.5 * self.height_px) < 0.5 * self.height_px - margin_px
        return np.asarray(ahead & inside_x & inside_y)


def cameras(focal_px: float) -> tuple[SimulatedCamera, SimulatedCamera]:
    """The nadir camera and the one turned 45 deg to the right."""
    nadir = SimulatedCamera(
        "nadir",
        0,
        focal_px,
        7012.4,
        5291.7,
        (-0.018, 0.009, 1.5e-4, -1.0e-4, -0.002),
        0.0,
        (0.35, 0.10, 0.60),
    )
    oblique = SimulatedCamera(
        "oblique",
        1,
        focal_px,
        6989.2,
        5308.1,
        (-0.015, 0.007, -1.2e-4, 0.8e-4, -0.001),
        -45.0,
        (0.20, 0.28, 0.55),
    )
    return nadir, oblique


def body_rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll) (3, 3), angles [rad]: v_ned = R v_body for the aircraft.

    >>> (body_rotation(-np.pi / 4, 0.0, 0.0) @ [0.0, 0.0, 1.0]).round(4).tolist()
    [0.0, 0.7071, 0.7071]
    """
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion(rotation: Array) -> Array:
    """Hamilton quaternion w, x, y, z (4,) of a rotation matrix (3, 3), w >= 0.

    Shepperd (1978): divides by the largest component, so it is exact to rounding for any turn.
    """
    trace = float(np.trace(rotation))
    squares = np.array([trace, *np.diag(rotation)])
    largest = int(np.argmax(squares))
    if largest == 0:
        skew = rotation - rotation.T
        q = np.array([1.0 + trace, skew[2, 1], skew[0, 2], skew[1, 0]])
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.empty(4)
        q[0] = rotation[k, j] - rotation[j, k]
        q[1 + i] = 1.0 + rotation[i, i] - rotation[j, j] - rotation[k, k]
        q[1 + j] = rotation[j, i] + rotation[i, j]
        q[1 + k] = rotation[k, i] + rotation[i, k]
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[0] < 0.0 else q)


def through_window(rays: Array, n_outside: Array, n_cabin: Array) -> tuple[Array, Array]:
    """Inside rays (n, 3) and R_cc (n,) [rad] of outside unit rays (n, 3) in camera axes.

    A plane-parallel window normal to the optical axis: n_cc sin zeta_f = n_a sin zeta_a (Gyer
    1996, Eq. 36, 37), so the component along the window scales by n_a / n_cc. Exact.
    R_cc = zeta_a - zeta_f, positive where the cabin air is the denser.
    """
    ratio = np.asarray(n_outside / n_cabin)
    across = rays[..., :2] * ratio[..., None]
    along = np.sqrt(1.0 - np.sum(across**2, axis=-1))
    inside = np.concatenate([across, along[..., None]], axis=-1)
    sin_a = np.hypot(rays[..., 0], rays[..., 1])
    # sin(zeta_a - zeta_f), without subtracting angles that agree to five digits.
    sin_r = sin_a * (along - ratio * rays[..., 2])
    return inside, np.arcsin(sin_r)
