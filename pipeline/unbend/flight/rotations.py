"""Attitudes as angles, quaternions and matrices, and the frames they are measured in.

The attitude of a camera is the quaternion of ``v_camera = R(q) v_frame``: camera x right, y down,
z forward, Hamilton, (n, 4) w, x, y, z with w >= 0. What is unknown (NaN) stays unknown.

Photogrammetry has the camera's y up and z backward, and a matrix M that turns from the camera to
the frame: ``M = Rx(omega) Ry(phi) Rz(kappa)``. Textbooks that turn from the frame to the camera
print its transpose (Wolf and Dewitt 2000, Appendix C): the angles are the same.
"""

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import numpy as np

from unbend.flight.channels import Channel
from unbend.units import DEGREE, Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# From the body (forward, right, down) to a camera that looks down, its top towards the nose.
CAMERA_AT_REST = np.array(
    [
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
    ]
)
# From east, north, up to north, east, down; its own inverse.
NED_FROM_ENU = np.array(
    [
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
    ]
)

_FROM_PHOTOGRAMMETRIC = np.diag([1.0, -1.0, -1.0])

_Axes = Literal["XYZ", "YXZ", "ZYX"]
_ThreeAngles = tuple[Array, Array, Array]

# Axes of the frame and of the camera once turned (intrinsic rotations), as scipy names them.
_ORDERS: dict[str, _Axes] = {
    "omega_phi_kappa": "XYZ",
    "phi_omega_kappa": "YXZ",
}

_FULL_TURN = 2.0 * np.pi
_SMALL_SINE = 1e-9  # of half an angle: below, angle over sine is 2 to the last digit
_GRAD_IN_DEGREES = 0.9


def _grads_for_degrees(a: Array, b: Array, c: Array) -> _ThreeAngles:
    return a * _GRAD_IN_DEGREES, b * _GRAD_IN_DEGREES, c % _FULL_TURN * _GRAD_IN_DEGREES


def _radians_for_degrees(a: Array, b: Array, c: Array) -> _ThreeAngles:
    return a / DEGREE, b / DEGREE, c % _FULL_TURN / DEGREE


def _degrees_for_radians(a: Array, b: Array, c: Array) -> _ThreeAngles:
    return a * DEGREE, b * DEGREE, c * DEGREE


UNIT_MISTAKES: dict[str, Callable[..., _ThreeAngles]] = {
    "read as grads": _grads_for_degrees,
    "read as radians": _radians_for_degrees,
    "read as degrees": _degrees_for_radians,
}
"""What undoes mistakes about the unit of three angles [rad], by the words for the mistake.

The angles are in grads, radians or degrees; they were read as degrees, the last one as radians.
"""

ANGLE_MISTAKES: dict[str, Callable[..., _ThreeAngles]] = {
    "with the other sign of {2}": lambda a, b, c: (a, b, -c),
    "with the other sign of {1}": lambda a, b, c: (a, -b, c),
    "with the other sign of {0}": lambda a, b, c: (-a, b, c),
    "with the other sign of {0} and {1}": lambda a, b, c: (-a, -b, c),
    "with {0} and {1} exchanged": lambda a, b, c: (b, a, c),
    "with {2} counted from east to north": lambda a, b, c: (a, b, np.pi / 2.0 - c),
}
"""What undoes mistakes about three angles [rad], by the words for the mistake.

The first two angles are about level axes, the third is the heading; {0} to {2} are their names.
"""


def _rotation() -> "type[Rotation]":
    """The class of scipy's rotations, imported late: that takes longer than reading a small log."""
    from scipy.spatial.transform import Rotation

    return Rotation


def matrices_of(quaternion: Array) -> Array:
    """(n, 3, 3) rotation matrices of (n, 4) quaternions w, x, y, z.

    >>> matrices_of(np.array([[0.0, 1.0, 0.0, 0.0]]))[0].diagonal().tolist()
    [1.0, -1.0, -1.0]
    """

    def turned(values: Array) -> Array:
        rotations = _rotation().from_quat(values, scalar_first=True)
        return rotations.as_matrix()

    return _where_known(turned, quaternion, (3, 3))


def quaternions_of(matrix: Array) -> Array:
    """(n, 4) quaternions w, x, y, z, w >= 0, of (n, 3, 3) rotation matrices."""

    def turned(values: Array) -> Array:
        rotations = _rotation().from_matrix(values)
        return rotations.as_quat(canonical=True, scalar_first=True)

    return _where_known(turned, matrix, (4,))


def quaternion_of_opk(angles: Array, order: str = "omega_phi_kappa") -> Array:
    """(n, 4) attitudes of cameras from the angles of photogrammetry.

    ``angles``: (n, 3) in the order of their names [rad], any range: omega about x, phi about y,
    kappa about z, counter-clockwise seen from the axis' tip. ``order``: ``omega_phi_kappa``, or
    ``phi_omega_kappa`` where phi is the primary rotation (BLUH).

    With all angles zero the camera looks along -z of the frame, the image's x along x. Reproduces
    the rotation matrices that Pix4D prints beside its angles to the angles' rounding.

    >>> quaternion_of_opk(np.zeros((1, 3))).tolist()
    [[0.0, 1.0, 0.0, 0.0]]
    """
    frame_from_photogrammetric = _euler_matrices(_ORDERS[order], angles)
    photogrammetric_from_frame = _transposed(frame_from_photogrammetric)
    return quaternions_of(_FROM_PHOTOGRAMMETRIC @ photogrammetric_from_frame)


def opk_of_quaternion(quaternion: Array, order: str = "omega_phi_kappa") -> Array:
    """(n, 3) angles [rad] in the order of their names; inverse of `quaternion_of_opk`.

    The first and the last lie in [-pi, pi], the second in [-pi/2, pi/2]. At its ends, where the
    camera looks along the axis of the first, the last is zero and the first holds both.
    """
    frame_from_camera = _transposed(matrices_of(quaternion))
    frame_from_photogrammetric = frame_from_camera @ _FROM_PHOTOGRAMMETRIC
    return _euler_angles(_ORDERS[order], frame_from_photogrammetric)


def quaternion_of_rpy(angles: Array, camera_from_body: Array = CAMERA_AT_REST) -> Array:
    """(n, 4) attitudes of cameras against east, north, up from those of the body.

    ``angles``: (n, 3) roll, pitch, yaw [rad] of the body (forward, right, down) against north,
    east, down: right wing down, nose up, clockwise from north; yaw is applied first, roll last.
    ``camera_from_body``: (3, 3), by default of a camera that looks down, its top towards the nose.

    >>> quaternion_of_rpy(np.zeros((1, 3))).round(6).tolist()
    [[0.0, 1.0, 0.0, 0.0]]
    """
    body_from_ned = _transposed(ned_from_body(angles))
    camera_from_enu = camera_from_body @ body_from_ned @ NED_FROM_ENU
    return quaternions_of(camera_from_enu)


def ned_from_body(angles: Array) -> Array:
    """(n, 3, 3) rotations Rz(yaw) Ry(pitch) Rx(roll) of (n, 3) roll, pitch, yaw [rad]."""
    yaw_pitch_roll = angles[:, ::-1]
    return _euler_matrices("ZYX", yaw_pitch_roll)


def rpy_of_quaternion(quaternion: Array, camera_from_body: Array = CAMERA_AT_REST) -> Array:
    """(n, 3) roll, pitch, yaw [rad]; inverse of `quaternion_of_rpy`, the pitch in [-pi/2, pi/2]."""
    enu_from_camera = _transposed(matrices_of(quaternion))
    ned_from_body_axes = NED_FROM_ENU @ enu_from_camera @ camera_from_body
    yaw_pitch_roll = _euler_angles("ZYX", ned_from_body_axes)
    return np.asarray(yaw_pitch_roll[:, ::-1])


def in_turned_frame(quaternion: Array, frame_from_other: Array) -> Array:
    """Attitudes of v_camera = R(q) v_frame as those of v_camera = R(q) v_other.

    ``frame_from_other`` is (3, 3) or (n, 3, 3); `geodesy.enu_from_ecef` and `enu_from_grid` give
    its transpose.
    """
    camera_from_frame = matrices_of(quaternion)
    return quaternions_of(camera_from_frame @ frame_from_other)


def enu_from_grid(convergence_rad: float | Array) -> Array:
    """(3, 3), of (n,) angles (n, 3, 3), rotation from a map's grid (x, y, up) to east, north, up.

    ``convergence_rad`` is positive where grid north lies east of true north, as on the northern
    hemisphere east of a projection's central meridian: true azimuth = grid azimuth + convergence.

    >>> (enu_from_grid(np.radians(2.0)) @ [0.0, 1.0, 0.0]).round(4).tolist()
    [0.0349, 0.9994, 0.0]
    """
    up = np.array([0.0, 0.0, 1.0])
    rotation_vector = np.multiply.outer(-convergence_rad, up)
    rotations = _rotation().from_rotvec(rotation_vector)
    return np.asarray(rotations.as_matrix())


def quaternion_products(first: Array, second: Array) -> Array:
    """(m, 4) products of unit quaternions x, y, z, w, in a tenth of the time of scipy's."""
    x1, y1, z1, w1 = first.T
    x2, y2, z2, w2 = second.T
    products = [
        w1 * x2 + w2 * x1 + y1 * z2 - z1 * y2,
        w1 * y2 + w2 * y1 + z1 * x2 - x1 * z2,
        w1 * z2 + w2 * z1 + x1 * y2 - y1 * x2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    ]
    return np.stack(products, axis=1)


def down_in_body(channel: Channel) -> Array:
    """(3, n) direction of down about the body's axes, of the attitudes of a channel."""
    components = [
        channel["q_w"],
        channel["q_x"],
        channel["q_y"],
        channel["q_z"],
    ]
    return down_of(np.stack(components, axis=1))


def down_of(quaternion: Array) -> Array:
    """(3, n) direction of down about the body's axes, of (n, 4) quaternions w, x, y, z."""
    w = quaternion[:, 0]
    x = quaternion[:, 1]
    y = quaternion[:, 2]
    z = quaternion[:, 3]
    forward = 2.0 * (x * z - w * y)
    right = 2.0 * (y * z + w * x)
    down = 1.0 - 2.0 * (x * x + y * y)
    return np.stack([forward, right, down])


def lengths(vectors: Array) -> Array:
    """(m,) Euclidean lengths of (m, k) vectors, in a third of the time of numpy's norm."""
    square = np.einsum("ij,ij->i", vectors, vectors)
    return np.asarray(np.sqrt(square))


def rotation_vectors(quaternion: Array) -> Array:
    """(m, 3) rotation vectors [rad], at most half a turn, of unit quaternions x, y, z, w."""
    scalar = quaternion[:, 3:]
    shorter_way = np.where(scalar < 0.0, -1.0, 1.0)
    vector = shorter_way * quaternion[:, :3]
    sine = lengths(vector)[:, None]
    half_angle = np.arctan2(sine, np.abs(scalar))
    divisor = np.maximum(sine, _SMALL_SINE)
    angle_over_sine = 2.0 * half_angle / divisor
    is_large = sine > _SMALL_SINE
    return vector * np.where(is_large, angle_over_sine, 2.0)


def _transposed(matrices: Array) -> Array:
    """(n, 3, 3) inverses of rotation matrices."""
    return matrices.transpose(0, 2, 1)


def _euler_matrices(axes: _Axes, angles: Array) -> Array:
    """(n, 3, 3) matrices of (n, 3) angles [rad] about these axes, each as turned so far."""

    def turned(values: Array) -> Array:
        rotations = _rotation().from_euler(axes, values)
        return rotations.as_matrix()

    return _where_known(turned, angles, (3, 3))


def _euler_angles(axes: _Axes, matrix: Array) -> Array:
    """(n, 3) angles [rad] about these axes of (n, 3, 3) matrices; inverse of `_euler_matrices`."""

    def angles_of(values: Array) -> Array:
        with warnings.catch_warnings():
            # Where the first and third axis coincide, one of their angles is taken as zero.
            warnings.simplefilter("ignore", UserWarning)
            rotations = _rotation().from_matrix(values)
            return rotations.as_euler(axes)

    return _where_known(angles_of, matrix, (3,))


def _where_known(
    function: Callable[[Array], Array],
    values: Array,
    shape: tuple[int, ...],
) -> Array:
    """(n, *shape) results of a function for the rows without NaN; NaN for the other rows."""
    rows = values.shape[0]
    result = np.full((rows, *shape), np.nan)
    columns = tuple(range(1, values.ndim))
    is_known = np.isfinite(values).all(axis=columns)
    if bool(is_known.any()):
        result[is_known] = function(values[is_known])
    return result
