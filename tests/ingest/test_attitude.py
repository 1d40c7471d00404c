"""Attitude conventions against scipy and against attitudes anyone can picture."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.ingest.attitude import (
    earth_frame_attitude,
    ned_frd_of_enu_flu,
    quaternion_of_euler,
    unit_quaternions,
)

ENU_OF_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])


def matrix(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q[..., [1, 2, 3, 0]]).as_matrix()


def ros_of_axes(forward: list[float], left: list[float], up: list[float]) -> np.ndarray:
    """The ROS quaternion of a body whose axes point so in east-north-up."""
    x, y, z, w = Rotation.from_matrix(np.array([forward, left, up]).T).as_quat()
    return np.array([[w, x, y, z]])


@pytest.mark.parametrize(
    ("name", "forward", "left", "up", "euler_deg"),
    [
        ("level, facing north", [0, 1, 0], [-1, 0, 0], [0, 0, 1], (0, 0, 0)),
        ("level, facing east", [1, 0, 0], [0, 1, 0], [0, 0, 1], (0, 0, 90)),
        ("facing north, nose up 90", [0, 0, 1], [-1, 0, 0], [0, -1, 0], (0, 90, 0)),
        ("facing north, right wing down 90", [0, 1, 0], [0, 0, 1], [1, 0, 0], (90, 0, 0)),
        ("level, facing south", [0, -1, 0], [1, 0, 0], [0, 0, 1], (0, 0, 180)),
    ],
)
def test_pictured_attitudes(name, forward, left, up, euler_deg):
    q = ned_frd_of_enu_flu(ros_of_axes(forward, left, up))
    # the body's axes, turned into north-east-down, are the pictured ones
    forward_ned, right_ned, down_ned = matrix(q[0]).T
    np.testing.assert_allclose(ENU_OF_NED @ forward_ned, forward, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(ENU_OF_NED @ right_ned, [-x for x in left], atol=1e-12)
    np.testing.assert_allclose(ENU_OF_NED @ down_ned, [-x for x in up], atol=1e-12)
    angles = [np.array([np.radians(angle)]) for angle in euler_deg]
    np.testing.assert_allclose(matrix(quaternion_of_euler(*angles)[0]), matrix(q[0]), atol=1e-12)


def test_random_attitudes_against_matrices():
    random = Rotation.random(200, rng=np.random.default_rng(7))
    ros = random.as_quat()[:, [3, 0, 1, 2]]
    q = ned_frd_of_enu_flu(ros)
    expected = ENU_OF_NED.T @ random.as_matrix() @ FLU_OF_FRD
    np.testing.assert_allclose(matrix(q), expected, atol=1e-12)
    assert (q[:, 0] >= 0.0).all()


def test_euler_against_scipy():
    rng = np.random.default_rng(1)
    roll, pitch, yaw = rng.uniform(-np.pi, np.pi, (3, 100))
    expected = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    q = quaternion_of_euler(roll, pitch, yaw)
    np.testing.assert_allclose(matrix(q), expected, atol=1e-12)


def test_a_zero_quaternion_is_unknown():
    q = unit_quaternions(np.array([[0.0, 0.0, 0.0, 0.0], [-2.0, 0.0, 0.0, 0.0]]))
    assert np.isnan(q[0]).all()
    np.testing.assert_array_equal(q[1], [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("flags", "from_north"),
    [  # GIMBAL_DEVICE_FLAGS: 16 yaw lock, 32 yaw in the vehicle's frame, 64 in the earth's
        (0, False),
        (16, True),
        (32, False),
        (64, True),
        (16 | 32, False),
        (16 | 64, True),
        (4 | 8, False),
        (4 | 8 | 16, True),
        (np.nan, False),
    ],
)
def test_the_yaw_of_a_gimbal_is_from_north_as_its_flags_say(flags, from_north):
    q = {f"{kind}_{axis}": np.array([0.5]) for kind in ("q", "gimbal_q") for axis in "wxyz"}
    columns = earth_frame_attitude(q | {"flags": np.array([flags], np.float64)})
    for axis in "wxyz":
        assert columns[f"gimbal_q_{axis}"].tolist() == [0.5]
        np.testing.assert_array_equal(columns[f"q_{axis}"], [0.5 if from_north else np.nan])
