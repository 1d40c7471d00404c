"""Attitude conventions against scipy and against attitudes anyone can picture."""

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import NED_FROM_ENU
from unbend.ingest.attitude import (
    earth_frame_attitude,
    ned_frd_of_enu_flu,
    quaternion_of_euler,
    unit_quaternions,
)

FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])


def matrix(q):
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


PICTURED = yaml.safe_load("""
level, facing north: [[0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 0]]
level, facing east: [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 90]]
facing north, nose up 90: [[0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 90, 0]]
facing north, right wing down 90: [[0, 1, 0], [0, 0, 1], [1, 0, 0], [90, 0, 0]]
""")
"""Forward, left and up in east, north and up; roll, pitch and yaw [deg] as pilots know them."""


@pytest.mark.parametrize("name", PICTURED)
def test_pictured_attitudes(name):
    *axes_of_body, euler_deg = PICTURED[name]
    axes = np.array(axes_of_body).T
    ros = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    expected = NED_FROM_ENU @ axes @ FLU_OF_FRD
    assert_allclose(
        matrix(ned_frd_of_enu_flu(ros[None])[0]),
        expected,
        atol=1e-12,
    )
    roll, pitch, yaw = np.radians(euler_deg)[:, None]
    q = quaternion_of_euler(roll, pitch, yaw)
    assert_allclose(
        matrix(q[0]),
        expected,
        atol=1e-12,
    )


def test_random_attitudes_against_matrices():
    random = Rotation.random(
        200,
        rng=np.random.default_rng(7),
    )
    q = ned_frd_of_enu_flu(random.as_quat(scalar_first=True))
    expected = NED_FROM_ENU @ random.as_matrix() @ FLU_OF_FRD
    assert_allclose(matrix(q), expected, atol=1e-12)
    assert (q[:, 0] >= 0.0).all()


def test_euler_against_scipy():
    rng = np.random.default_rng(1)
    roll, pitch, yaw = rng.uniform(
        -np.pi,
        np.pi,
        (3, 100),
    )
    expected = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    assert_allclose(
        matrix(quaternion_of_euler(roll, pitch, yaw)),
        expected,
        atol=1e-12,
    )


def test_a_zero_quaternion_is_unknown():
    q = unit_quaternions(np.array([[0.0, 0.0, 0.0, 0.0], [-2.0, 0.0, 0.0, 0.0]]))
    assert np.isnan(q[0]).all()
    assert q[1].tolist() == [1.0, 0.0, 0.0, 0.0]


YAW_LOCK = 16
IN_VEHICLES_FRAME = 32
IN_EARTHS_FRAME = 64


@pytest.mark.parametrize(
    ("flags", "from_north"),
    [
        (0, False),
        (YAW_LOCK, True),
        (IN_VEHICLES_FRAME, False),
        (IN_EARTHS_FRAME, True),
        (YAW_LOCK | IN_VEHICLES_FRAME, False),
        (YAW_LOCK | IN_EARTHS_FRAME, True),
        (4 | 8, False),
        (4 | 8 | YAW_LOCK, True),
        (np.nan, False),
    ],
)
def test_the_yaw_of_a_gimbal_is_from_north_as_its_flags_say(flags, from_north):
    names = [f"{kind}_{axis}" for kind in ("q", "gimbal_q") for axis in "wxyz"]
    columns = {name: np.array([0.5]) for name in names}
    columns["flags"] = np.array([float(flags)])
    attitude = earth_frame_attitude(columns)
    for axis in "wxyz":
        assert attitude[f"gimbal_q_{axis}"].tolist() == [0.5]
        assert np.isfinite(attitude[f"q_{axis}"]).tolist() == [from_north]
