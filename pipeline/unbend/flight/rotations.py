"""Attitudes as angles, quaternions and matrices, and the frames they are measured in.

The attitude of a camera is the quaternion of ``v_camera = R(q) v_frame``: camera x right, y down,
z forward, Hamilton, (n, 4) w, x, y, z with w >= 0. Rows with a NaN give rows of NaN.

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

# The axes of three rotations in turn, each about an axis that the rotations before it have turned
# (intrinsic rotations); scipy writes these in capitals.
_AXES_OF_ORDERS: dict[str, _Axes] = {
    "omega_phi_kappa": "XYZ",
    "phi_omega_kappa": "YXZ",
}

_FULL_TURN_RAD = 2.0 * np.pi
_SMALL_SINE = 1e-9  # of half an angle: below, angle over sine is 2 to the last digit
_DEGREES_PER_GRAD = 0.9


def _grads_read_as_degrees(a: Array, b: Array, c: Array) -> _ThreeAngles:
    """The true angles [rad], if numbers in grads were converted as if they were degrees."""
    heading = c % _FULL_TURN_RAD
    return a * _DEGREES_PER_GRAD, b * _DEGREES_PER_GRAD, heading * _DEGREES_PER_GRAD


def _radians_read_as_degrees(a: Array, b: Array, c: Array) -> _ThreeAngles:
    """The true angles [rad], if numbers in radians were converted as if they were degrees."""
    heading = c % _FULL_TURN_RAD
    return a / DEGREE, b / DEGREE, heading / DEGREE


def _degrees_read_as_radians(a: Array, b: Array, c: Array) -> _ThreeAngles:
    """The true angles [rad], if numbers in degrees were taken for radians."""
    return a * DEGREE, b * DEGREE, c * DEGREE


UNIT_MISTAKES: dict[str, Callable[..., _ThreeAngles]] = {
    "read as grads": _grads_read_as_degrees,
    "read as radians": _radians_read_as_degrees,
    "read as degrees": _degrees_read_as_radians,
}
"""Functions that correct a wrong unit of three angles [rad], the last of which is the heading.

The key names the unit that the numbers have in truth, and in which they should be read.
"""

ANGLE_MISTAKES: dict[str, Callable[..., _ThreeAngles]] = {
    "with the other sign of {2}": lambda a, b, c: (a, b, -c),
    "with the other sign of {1}": lambda a, b, c: (a, -b, c),
    "with the other sign of {0}": lambda a, b, c: (-a, b, c),
    "with the other sign of {0} and {1}": lambda a, b, c: (-a, -b, c),
    "with {0} and {1} exchanged": lambda a, b, c: (b, a, c),
    "with {2} counted from east to north": lambda a, b, c: (a, b, np.pi / 2.0 - c),
}
"""Functions that correct a wrong convention of three angles [rad], by the words for the correction.

The first two angles are about level axes, the third is the heading; {0} to {2} are their names.
"""


def _scipy_rotation() -> "type[Rotation]":
    """scipy's class of rotations, imported late: that takes longer than reading a small log."""
    from scipy.spatial.transform import Rotation

    return Rotation


def matrices_of(quaternion: Array) -> Array:
    """(n, 3, 3) rotation matrices of (n, 4) quaternions w, x, y, z.

    >>> matrices_of(np.array([[0.0, 1.0, 0.0, 0.0]]))[0].diagonal().tolist()
    [1.0, -1.0, -1.0]
    """

    def matrices(known: Array) -> Array:
        rotations = _scipy_rotation().from_quat(known, scalar_first=True)
        return rotations.as_matrix()

    return _for_known_rows(matrices, quaternion, (3, 3))


def quaternions_of(matrix: Array) -> Array:
    """(n, 4) quaternions w, x, y, z, w >= 0, of (n, 3, 3) rotation matrices."""

    def quaternions(known: Array) -> Array:
        rotations = _scipy_rotation().from_matrix(known)
        return rotations.as_quat(canonical=True, scalar_first=True)

    return _for_known_rows(quaternions, matrix, (4,))


def quaternion_of_opk(angles: Array, order: str = "omega_phi_kappa") -> Array:
    """(n, 4) attitudes of cameras from the angles of photogrammetry.

    ``angles``: (n, 3) in the order that ``order`` names [rad], any range: omega about x, phi about
    y, kappa about z, counter-clockwise seen from the axis' tip. ``order``: ``omega_phi_kappa``, or
    ``phi_omega_kappa`` where phi is the primary rotation (BLUH).

    With all angles zero the camera looks along -z of the frame, the image's x along x. Reproduces
    the rotation matrices that Pix4D prints next to its angles to the angles' rounding.

    >>> quaternion_of_opk(np.zeros((1, 3))).tolist()
    [[0.0, 1.0, 0.0, 0.0]]
    """
    frame_from_photogrammetric = _euler_matrices(_AXES_OF_ORDERS[order], angles)
    photogrammetric_from_frame = _transposed(frame_from_photogrammetric)
    return quaternions_of(_FROM_PHOTOGRAMMETRIC @ photogrammetric_from_frame)


def opk_of_quaternion(quaternion: Array, order: str = "omega_phi_kappa") -> Array:
    """(n, 3) angles [rad] in the order that ``order`` names; inverse of `quaternion_of_opk`.

    The first and the last angle are in [-pi, pi], the second in [-pi/2, pi/2]. Where the second is
    -pi/2 or pi/2 only the sum or difference of the other two is determined: the last is set to 0.
    """
    frame_from_camera = _transposed(matrices_of(quaternion))
    frame_from_photogrammetric = frame_from_camera @ _FROM_PHOTOGRAMMETRIC
    return _euler_angles(_AXES_OF_ORDERS[order], frame_from_photogrammetric)


def quaternion_of_rpy(angles: Array, camera_from_body: Array = CAMERA_AT_REST) -> Array:
    """(n, 4) attitudes of cameras relative to east, north, up, from roll, pitch, yaw of the body.

    ``angles``: (n, 3) roll, pitch, yaw [rad] of the body (forward, right, down) relative to north,
    east, down. Positive are right wing down, nose up, clockwise from north; yaw is applied first,
    roll last. ``camera_from_body``: (3, 3) rotation, by default that of a camera that looks down
    with its top towards the nose.

    >>> quaternion_of_rpy(np.zeros((1, 3))).round(6).tolist()
    [[0.0, 1.0, 0.0, 0.0]]
    """
    body_from_ned = _transposed(ned_from_body(angles))
    camera_from_enu = camera_from_body @ body_from_ned @ NED_FROM_ENU
    return quaternions_of(camera_from_enu)


def ned_from_body(angles: Array) -> Array:
    """(n, 3, 3) rotations from body to north, east, down, of (n, 3) roll, pitch, yaw [rad].

    That is Rz(yaw) Ry(pitch) Rx(roll).
    """
    yaw_pitch_roll = angles[:, ::-1]
    return _euler_matrices("ZYX", yaw_pitch_roll)


def rpy_of_quaternion(quaternion: Array, camera_from_body: Array = CAMERA_AT_REST) -> Array:
    """(n, 3) roll, pitch, yaw [rad] of the body; inverse of `quaternion_of_rpy`.

    The pitch is in [-pi/2, pi/2].
    """
    enu_from_camera = _transposed(matrices_of(quaternion))
    ned_from_body_axes = NED_FROM_ENU @ enu_from_camera @ camera_from_body
    yaw_pitch_roll = _euler_angles("ZYX", ned_from_body_axes)
    return np.asarray(yaw_pitch_roll[:, ::-1])


def in_turned_frame(quaternion: Array, frame_from_other: Array) -> Array:
    """(n, 4) attitudes of cameras relative to another frame.

    ``quaternion``: (n, 4) with v_camera = R(q) v_frame; the result has v_camera = R(q) v_other.
    ``frame_from_other``: the rotation v_frame = R v_other, (3, 3) or (n, 3, 3). For example
    `enu_from_grid` leads from attitudes relative to east, north, up to those relative to the grid,
    and its transpose back.
    """
    camera_from_frame = matrices_of(quaternion)
    return quaternions_of(camera_from_frame @ frame_from_other)


def enu_from_grid(convergence_rad: float | Array) -> Array:
    """Rotation from a map's grid (x, y, up) to east, north, up: (3, 3); of (n,) angles (n, 3, 3).

    ``convergence_rad`` is positive where grid north is east of true north, as on the northern
    hemisphere east of a projection's central meridian: true azimuth = grid azimuth + convergence.

    >>> (enu_from_grid(np.radians(2.0)) @ [0.0, 1.0, 0.0]).round(4).tolist()
    [0.0349, 0.9994, 0.0]
    """
    up = np.array([0.0, 0.0, 1.0])
    rotation_vector = np.multiply.outer(-convergence_rad, up)
    rotations = _scipy_rotation().from_rotvec(rotation_vector)
    return np.asarray(rotations.as_matrix())


def quaternion_products(first: Array, second: Array) -> Array:
    """(m, 4) Hamilton products first * second of quaternions x, y, z, w.

    It takes a tenth of the time of scipy's product.
    """
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
    """(3, n) unit vectors to the nadir in body axes, by a channel's attitudes ``q_*``."""
    components = [
        channel["q_w"],
        channel["q_x"],
        channel["q_y"],
        channel["q_z"],
    ]
    return down_of(np.stack(components, axis=1))


def down_of(quaternion: Array) -> Array:
    """(3, n) unit vectors to the nadir in body axes (forward, right, down).

    ``quaternion``: (n, 4) w, x, y, z with v_ned = R(q) v_body.
    """
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
    sign_of_shorter_turn = np.where(scalar < 0.0, -1.0, 1.0)  # q and -q are one attitude
    vector = sign_of_shorter_turn * quaternion[:, :3]
    sine = lengths(vector)[:, None]
    half_angle = np.arctan2(sine, np.abs(scalar))
    divisor = np.maximum(sine, _SMALL_SINE)
    angle_over_sine = 2.0 * half_angle / divisor
    is_large = sine > _SMALL_SINE
    return vector * np.where(is_large, angle_over_sine, 2.0)


def _transposed(matrices: Array) -> Array:
    """(n, 3, 3) transposes of matrices: the inverses of rotations."""
    return matrices.transpose(0, 2, 1)


def _euler_matrices(axes: _Axes, angles: Array) -> Array:
    """(n, 3, 3) matrices of (n, 3) angles [rad], in the order of ``axes`` (intrinsic rotations)."""

    def matrices(known: Array) -> Array:
        rotations = _scipy_rotation().from_euler(axes, known)
        return rotations.as_matrix()

    return _for_known_rows(matrices, angles, (3, 3))


def _euler_angles(axes: _Axes, matrix: Array) -> Array:
    """(n, 3) angles [rad] about ``axes`` of (n, 3, 3) matrices; inverse of `_euler_matrices`."""

    def angles(known: Array) -> Array:
        with warnings.catch_warnings():
            # Where the first and third axis coincide, one of their angles is taken as zero.
            warnings.simplefilter("ignore", UserWarning)
            rotations = _scipy_rotation().from_matrix(known)
            return rotations.as_euler(axes)

    return _for_known_rows(angles, matrix, (3,))


def _for_known_rows(
    function: Callable[[Array], Array],
    values: Array,
    shape: tuple[int, ...],
) -> Array:
    """(n, *shape) results of a function, called with the finite rows only; NaN for other rows.

    ``values``: (n, ...); ``shape``: that of the function's result for one row.
    """
    rows = values.shape[0]
    result = np.full((rows, *shape), np.nan)
    axes_of_a_row = tuple(range(1, values.ndim))
    is_known = np.isfinite(values).all(axis=axes_of_a_row)
    if bool(is_known.any()):
        result[is_known] = function(values[is_known])
    return result
