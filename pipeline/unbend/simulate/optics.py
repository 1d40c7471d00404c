"""The optics of the simulated cameras: curved rays, window, lens, pixels.

Rays follow the eikonal equation d/ds (n dr/ds) = grad n (Born and Wolf, Principles of Optics, 7th
ed., 3.2 Eq. 2), with n a function of the height above the ellipsoid and its gradient along the
ellipsoid normal. Positions are differences from the station, in axes parallel to ECEF, so that no
large numbers are subtracted.

Camera axes: x right, y down, z forward. Pixels: the centre of the upper left pixel is (0.5, 0.5).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.integrate import solve_ivp

from unbend.simulate import messages
from unbend.units import WGS84_A, WGS84_F, Array, Mask

_E2 = WGS84_F * (2.0 - WGS84_F)  # first eccentricity, squared
_B = WGS84_A * (1.0 - WGS84_F)  # semi-minor axis [m]
_EP2 = _E2 / (1.0 - _E2)  # second eccentricity, squared

RAY_TOLERANCE = 1e-12  # relative, of the integration
OFFSET_TOLERANCE_M = 1e-9
DIRECTION_TOLERANCE = 1e-15
AIM_TOLERANCE_M = 1e-8  # the aim is repeated until all rays miss by less
MAX_AIMS = 6  # each repetition gains five digits

# A camera at rest in the mount looks down, image top towards the nose (body: forward, right, down).
CAMERA_FROM_BODY = np.array(
    [
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
    ]
)
NED_FROM_ENU = np.array(
    [
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
    ]
)


class Medium(Protocol):
    """A medium with a refractive index that is a function of the height above sea level [m]."""

    def n(self, h_m: Array) -> Array:
        """The refractive index at heights [m]."""
        ...

    def dn_dh(self, h_m: Array) -> Array:
        """The slope of the index over height [1/m], at heights [m]."""
        ...


def to_ecef(lat_rad: Array, lon_rad: Array, h_ellipsoid_m: Array) -> Array:
    """Earth-centred coordinates (..., 3) [m] of WGS84 latitude, longitude [rad], height [m]."""
    sin_lat = np.sin(lat_rad)
    normal = WGS84_A / np.sqrt(1.0 - _E2 * sin_lat**2)
    across = (normal + h_ellipsoid_m) * np.cos(lat_rad)
    x = across * np.cos(lon_rad)
    y = across * np.sin(lon_rad)
    z = (normal * (1.0 - _E2) + h_ellipsoid_m) * sin_lat
    return np.stack([x, y, z], axis=-1)


def height_and_up(ecef_m: Array) -> tuple[Array, Array]:
    """Ellipsoidal height (...) [m] and unit normal (..., 3) of points (..., 3) [m].

    Bowring (1976) with one repetition: 1e-15 rad in latitude below 30 km, 2e-9 m in height.
    """
    x = ecef_m[..., 0]
    y = ecef_m[..., 1]
    z = ecef_m[..., 2]
    p = np.hypot(x, y)
    tan_beta = z * WGS84_A / (p * _B)
    for _ in range(2):
        cos_beta = 1.0 / np.sqrt(1.0 + tan_beta**2)
        sin_beta = tan_beta * cos_beta
        rise = z + _EP2 * _B * sin_beta**3
        run = p - _E2 * WGS84_A * cos_beta**3
        tan_lat = rise / run
        tan_beta = (1.0 - WGS84_F) * tan_lat
    cos_lat = 1.0 / np.sqrt(1.0 + tan_lat**2)
    sin_lat = tan_lat * cos_lat
    tangent_plane = WGS84_A * np.sqrt(1.0 - _E2 * sin_lat**2)  # from the centre of the earth
    height = p * cos_lat + z * sin_lat - tangent_plane
    return height, np.stack([cos_lat * x / p, cos_lat * y / p, sin_lat], axis=-1)


def enu_axes(lat_rad: Array, lon_rad: Array) -> Array:
    """Rows east, north, up (..., 3, 3) of the local frame: v_enu = axes @ v_ecef."""
    sin_lat = np.sin(lat_rad)
    cos_lat = np.cos(lat_rad)
    sin_lon = np.sin(lon_rad)
    cos_lon = np.cos(lon_rad)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(sin_lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-2)


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length one."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / length)


def ray_ends(
    air: Medium, start_m: Array, direction: Array, length_m: Array, undulation_m: float
) -> Array:
    """Where rays end, relative to their start: (n, 3) [m] in ECEF axes.

    start_m (n, 3) ECEF [m], direction (n, 3) unit vectors, length_m (n,) arc length [m]. With the
    scaled arc sigma = s / length and the ray vector p = n dr/ds: dr/dsigma = length p / n and
    dp/dsigma = length dn/dh up. All rays are integrated as one system; DOP853, rtol 1e-12, about
    1e-11 rad. Raises PhysicsError if the integration fails.
    """
    count = start_m.shape[0]
    start_height, _ = height_and_up(start_m)
    n_start = air.n(start_height - undulation_m)

    def slope(_: float, state: Array) -> Array:
        """The derivative over sigma of all offsets r, then of all ray vectors p, as one array."""
        offset, ray = state.reshape(2, count, 3)
        height, up = height_and_up(start_m + offset)
        h_msl = height - undulation_m
        by_ray = length_m / air.n(h_msl)
        by_up = air.dn_dh(h_msl) * length_m
        offset_slope = ray * by_ray[:, None]
        ray_slope = up * by_up[:, None]
        return np.concatenate([offset_slope.ravel(), ray_slope.ravel()])

    ray = direction * n_start[:, None]
    no_offset = np.zeros(3 * count)
    solution = solve_ivp(
        slope,
        (0.0, 1.0),
        np.concatenate([no_offset, ray.ravel()]),
        method="DOP853",
        t_eval=[1.0],
        rtol=RAY_TOLERANCE,
        atol=np.repeat([OFFSET_TOLERANCE_M, DIRECTION_TOLERANCE], 3 * count),
    )
    if not solution.success:
        raise messages.not_integrated(what="rays", answer=solution.message)
    offset = solution.y[: 3 * count, -1]
    return np.asarray(offset.reshape(count, 3))


@dataclass(frozen=True, eq=False)
class TracedRays:
    """Unit directions (n, 3) in ECEF axes from the camera: of the apparent ray and of the chord.

    ``r_c_rad``: (n,) the angle between both, positive where the apparent ray is farther from the
    nadir. ``miss_m``: (n,) distance between the end of the ray and the ground point [m].
    """

    apparent: Array
    straight: Array
    r_c_rad: Array
    miss_m: Array


def shoot(air: Medium, camera_m: Array, ground_m: Array, undulation_m: float) -> TracedRays:
    """The direction in which each camera sees its ground point, by shooting.

    camera_m, ground_m (n, 3) ECEF [m]. Each ray is aimed off its ground point by the sum of its
    misses so far. The bending is 1e-5 of the ray, so each repetition gains five digits; they end
    when all rays miss by less than `AIM_TOLERANCE_M`.
    """
    chord = ground_m - camera_m
    aim = chord.copy()
    miss = np.full(len(chord), np.inf)
    for _ in range(MAX_AIMS):
        length = np.linalg.norm(aim, axis=-1)
        reached = ray_ends(air, camera_m, unit(aim), length, undulation_m)
        error = chord - reached
        miss = np.linalg.norm(error, axis=-1)
        if float(miss.max(initial=0.0)) < AIM_TOLERANCE_M:
            break
        aim = aim + error
    apparent = unit(aim)
    straight = unit(chord)
    normal = np.cross(apparent, straight)
    sine = np.linalg.norm(normal, axis=-1)
    cosine = np.sum(apparent * straight, axis=-1)
    angle = np.arctan2(sine, cosine)
    _, up = height_and_up(camera_m)
    lift = np.sum((apparent - straight) * up, axis=-1)
    return TracedRays(
        apparent=apparent,
        straight=straight,
        r_c_rad=np.where(lift >= 0.0, angle, -angle),
        miss_m=miss,
    )


@dataclass(frozen=True)
class SimulatedCamera:
    """A pinhole with Brown-Conrady distortion (OpenCV's order k1, k2, p1, p2, k3) in a mount.

    The mount rotation Rz(yaw) Ry(pitch) Rx(roll), in body axes, rotates the camera from its
    position at rest (`CAMERA_FROM_BODY`). The lever arm is the vector from the GNSS reference point
    to the camera, in body axes forward, right, down.
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
        angles_rad = np.radians([self.roll_deg, self.pitch_deg, self.yaw_deg])
        mount = body_rotation(*angles_rad)
        return np.asarray(CAMERA_FROM_BODY @ mount.T)

    def project(self, rays: Array) -> tuple[Array, Array]:
        """Pixels x, y (n,) of rays (n, 3) in camera axes with z > 0.

        Brown (1971); OpenCV, Camera Calibration and 3D Reconstruction.
        """
        k1, k2, p1, p2, k3 = self.distortion
        x = rays[..., 0] / rays[..., 2]
        y = rays[..., 1] / rays[..., 2]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x_distorted = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        y_distorted = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        x_px = self.focal_px * x_distorted + self.cx_px
        y_px = self.focal_px * y_distorted + self.cy_px
        return x_px, y_px

    def sees(self, rays: Array, margin_px: float = 80.0) -> Mask:
        """Which rays (n, 3) in camera axes fall on the sensor, a margin inside its edge."""
        # The distortion polynomial folds far rays back onto the sensor: rays beyond 0.6 of its size
        # without distortion are excluded first.
        reach = 0.6 * np.array([self.width_px, self.height_px]) / self.focal_px
        forward = rays[..., 2:]
        aside = np.abs(rays[..., :2])
        near = np.all(aside < reach * forward, axis=-1)
        ahead = near & (rays[..., 2] > 0.0)
        straight_ahead = np.array([0.0, 0.0, 1.0])
        rays_ahead = np.where(ahead[..., None], rays, straight_ahead)
        x_px, y_px = self.project(rays_ahead)
        half_width = 0.5 * self.width_px
        half_height = 0.5 * self.height_px
        inside_x = np.abs(x_px - half_width) < half_width - margin_px
        inside_y = np.abs(y_px - half_height) < half_height - margin_px
        return np.asarray(ahead & inside_x & inside_y)


def cameras(focal_px: float) -> tuple[SimulatedCamera, SimulatedCamera]:
    """The nadir camera, and the oblique camera that looks 45 deg to the right."""
    nadir = SimulatedCamera(
        name="nadir",
        instance=0,
        focal_px=focal_px,
        cx_px=7012.4,
        cy_px=5291.7,
        distortion=(-0.018, 0.009, 1.5e-4, -1.0e-4, -0.002),
        roll_deg=0.0,
        lever_arm_m=(0.35, 0.10, 0.60),
    )
    oblique = SimulatedCamera(
        name="oblique",
        instance=1,
        focal_px=focal_px,
        cx_px=6989.2,
        cy_px=5308.1,
        distortion=(-0.015, 0.007, -1.2e-4, 0.8e-4, -0.001),
        roll_deg=-45.0,
        lever_arm_m=(0.20, 0.28, 0.55),
    )
    return nadir, oblique


def body_rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll) (3, 3), angles [rad]: v_ned = R v_body for the aircraft.

    >>> (body_rotation(-np.pi / 4, 0.0, 0.0) @ [0.0, 0.0, 1.0]).round(4).tolist()
    [0.0, 0.7071, 0.7071]
    """
    cr = np.cos(roll)
    sr = np.sin(roll)
    cp = np.cos(pitch)
    sp = np.sin(pitch)
    cy = np.cos(yaw)
    sy = np.sin(yaw)
    north = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]
    east = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]
    down = [-sp, cp * sr, cp * cr]
    return np.array([north, east, down])


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
        j = (i + 1) % 3
        k = (i + 2) % 3
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
    R_cc = zeta_a - zeta_f, positive where the cabin air is denser than the air outside.
    """
    ratio = np.asarray(n_outside / n_cabin)
    across = rays[..., :2] * ratio[..., None]
    sine_squared = np.sum(across**2, axis=-1)
    along = np.sqrt(1.0 - sine_squared)
    inside = np.concatenate([across, along[..., None]], axis=-1)
    sin_a = np.hypot(rays[..., 0], rays[..., 1])
    # sin(zeta_a - zeta_f), without subtracting angles that agree to five digits.
    sin_r = sin_a * (along - ratio * rays[..., 2])
    return inside, np.arcsin(sin_r)
