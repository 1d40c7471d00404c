"""Attitudes against numbers that other programs and a published block print."""

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.flight.rotations import (
    NED_FROM_ENU,
    enu_from_grid,
    in_turned_frame,
    matrices_of,
    opk_of_quaternion,
    quaternion_of_opk,
    quaternion_of_rpy,
    quaternions_of,
    rpy_of_quaternion,
)
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef

# Pix4D writes angles into *_calibrated_external_camera_parameters.txt, and for the same image a
# matrix from the world to a camera with x right, y down, z forward into *_calibrated_camera_
# parameters.txt. The image DSC_0157.JPG of a published project.
PIX4D_DEG = (-2.946680, 3.053212, 119.804001)
PIX4D_MATRIX = np.array(
    [
        [-0.49632901575943477734, 0.86794436424468834890, -0.01816834310427051929],
        [0.86649900151927328196, 0.49400145706385401034, -0.07170802455019638366],
        [-0.05326338781351704077, -0.05133362440616233424, -0.99726018196053234366],
    ]
)
# Metashape.Utils.ypr2mat((30, 91, 0)), from a camera with y up and z back to east, north, up
# (agisoft.com/forum, topic 12200).
AGISOFT_MATRIX = np.array(
    [
        [0.8660254037844387, -0.008726203218641737, -0.4999238475781956],
        [-0.49999999999999994, -0.01511422733185856, -0.8658935039207541],
        [0.0, 0.9998476951563913, -0.017452406437283477],
    ]
)
# MathWorks, Aerospace Toolbox, example of angle2quat and of angle2dcm (body from north-east-down).
MATLAB_RPY = [0.0, 0.1, 0.7854]
MATLAB_QUATERNION = [0.9227, -0.0191, 0.0462, 0.3822]
MATLAB_MATRIX = np.array(
    [
        [0.7036, 0.7036, -0.0998],
        [-0.7071, 0.7071, 0.0],
        [0.0706, 0.0706, 0.9950],
    ]
)

# DBAT's published solution of the block over Strasbourg (Boerlin): angles [deg] and projection
# centre [m] of an image; three control points [m] and where they were measured [px].
DBAT_DEG = (0.829772, -0.417236, -89.914549)
DBAT_CENTRE_M = (999660.940086, 112368.368648, 1916.563176)
DBAT_POINTS_M = [
    [999604.580, 112344.443, 139.453],
    [999619.041, 112370.818, 138.970],
    [999170.674, 112692.548, 139.640],
]
DBAT_MEASURED_PX = np.array(
    [
        [5007.6667, 7275.6667],
        [4700.3506, 7105.9468],
        [955.1383, 12311.1660],
    ]
)
DBAT_F_PX = 123.939 / 0.006
DBAT_CENTRE_PX = [26.577 / 0.006, 38.811 / 0.006]

SIN_10 = np.sin(np.radians(10.0))
COS_10 = np.cos(np.radians(10.0))


def matrix_of_opk(angles_deg, order="omega_phi_kappa"):
    """From east, north, up to the camera."""
    quaternion = quaternion_of_opk(np.radians([angles_deg]), order)
    return matrices_of(quaternion)[0]


def matrix_of_rpy(*angles_deg):
    """The same of a camera at rest in an aircraft."""
    quaternion = quaternion_of_rpy(np.radians([angles_deg]))
    return matrices_of(quaternion)[0]


def opk_of_matrix(matrix):
    quaternion = quaternions_of(matrix[None])
    return np.degrees(opk_of_quaternion(quaternion)[0])


def test_opk_is_the_matrix_that_pix4d_prints():
    assert matrix_of_opk(PIX4D_DEG) == pytest.approx(PIX4D_MATRIX, abs=2e-8)
    assert opk_of_matrix(PIX4D_MATRIX) == pytest.approx(PIX4D_DEG, abs=1e-6)


def test_yaw_pitch_roll_is_the_matrix_that_metashape_prints():
    y_up_z_back = np.diag([1.0, -1.0, -1.0])
    enu_from_camera = matrix_of_rpy(0.0, 91.0, 30.0).T @ y_up_z_back
    assert enu_from_camera == pytest.approx(AGISOFT_MATRIX, abs=1e-12)


def test_roll_pitch_yaw_is_the_quaternion_and_the_matrix_that_matlab_prints():
    body = quaternion_of_rpy(np.array([MATLAB_RPY]), np.eye(3))
    body_from_ned = matrices_of(body)[0] @ NED_FROM_ENU
    assert body_from_ned == pytest.approx(MATLAB_MATRIX, abs=5e-5)
    quaternion = quaternions_of(body_from_ned.T[None])[0]
    assert quaternion == pytest.approx(MATLAB_QUATERNION, abs=5e-5)


def test_a_published_block_projects_its_control_points():
    """Within the residuals: a swapped or negated angle moves points by 100 px or more."""
    rays = np.subtract(DBAT_POINTS_M, DBAT_CENTRE_M) @ matrix_of_opk(DBAT_DEG).T
    assert (rays[:, 2] > 1000.0).all()
    projected_px = DBAT_CENTRE_PX + DBAT_F_PX * rays[:, :2] / rays[:, 2:]
    assert projected_px == pytest.approx(DBAT_MEASURED_PX, abs=4.0)


def test_right_wing_down_looks_to_the_left():
    """On a flight to the north."""
    optical_axis = matrix_of_rpy(10.0, 0.0, 0.0)[2]
    assert optical_axis == pytest.approx([-SIN_10, 0.0, -COS_10])


@pytest.mark.parametrize("order", ["omega_phi_kappa", "phi_omega_kappa"])
def test_angles_come_back(order):
    limit = [3.1, 1.5, 3.1]
    angles = np.random.default_rng(5).uniform(np.negative(limit), limit, (200, 3))
    angles[7] = np.nan
    quaternion = quaternion_of_opk(angles, order)
    assert np.flatnonzero(~(quaternion[:, 0] >= 0.0)).tolist() == [7]
    opk = opk_of_quaternion(quaternion, order)
    assert opk == pytest.approx(angles, abs=1e-9, nan_ok=True)
    rpy = rpy_of_quaternion(quaternion_of_rpy(angles[:, ::-1]))
    assert rpy == pytest.approx(
        angles[:, ::-1],
        abs=1e-9,
        nan_ok=True,
    )


@pytest.mark.parametrize(
    ("order", "angles_deg", "axis"),
    [
        (
            "phi_omega_kappa",
            [10.0, 0.0, 0.0],
            [-SIN_10, 0.0, -COS_10],
        ),
        (
            "phi_omega_kappa",
            [10.0, 10.0, 0.0],
            [-SIN_10 * COS_10, SIN_10, -(COS_10**2)],
        ),
        (
            "omega_phi_kappa",
            [10.0, 10.0, 0.0],
            [-SIN_10, SIN_10 * COS_10, -(COS_10**2)],
        ),
    ],
)
def test_the_primary_angle_is_about_the_axis_of_the_frame(order, angles_deg, axis):
    assert matrix_of_opk(angles_deg, order)[2] == pytest.approx(axis)


def test_looking_along_the_axis_of_the_first_angle_both_are_one():
    straight_ahead = quaternion_of_opk(np.radians([[20.0, 90.0, 15.0]]))
    angles = opk_of_quaternion(straight_ahead)
    assert np.isfinite(angles).all()
    assert quaternion_of_opk(angles) == pytest.approx(straight_ahead, abs=1e-9)


def test_convergence_is_the_map_projection_s_own():
    """2.5 degrees east of the central meridian grid north is 1.86 deg east of the meridian."""
    utm = pyproj.Proj("EPSG:32632")
    convergence_deg = utm.get_factors(11.5, 48.0).meridian_convergence
    assert convergence_deg == pytest.approx(1.8584, abs=1e-4)
    turn = enu_from_grid(np.radians(convergence_deg))

    eastings, northings = utm([11.5, 11.5], [48.0, 48.0 + 1e-5])
    step = np.array(
        [
            *np.diff(eastings),
            *np.diff(northings),
            0.0,
        ]
    )
    north = step / np.linalg.norm(step)
    assert turn @ north == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)

    on_grid = quaternion_of_rpy(np.zeros((1, 3)))
    on_earth = rpy_of_quaternion(in_turned_frame(on_grid, turn.T))[0]
    assert np.degrees(on_earth) == pytest.approx([0, 0, 1.8584], abs=1e-4)


def test_the_vertical_turns_0_9_degrees_in_100_km():
    """Plumb lines meet at the earth's centre.

    Along the first vertical, a camera at a place in the north looks beyond the point below it, away
    from the first.
    """
    latitude = np.radians([47.0])
    longitude = np.radians([8.0])
    axes = enu_from_ecef(latitude, longitude)[0]
    origin_m = ecef_of_geodetic(latitude, longitude, np.zeros(1))[0]
    north_m = origin_m + axes.T @ [0.0, 100e3, 0.0]
    far_latitude, far_longitude, _ = geodetic_of_ecef(*north_m[:, None])

    turn = enu_from_ecef(far_latitude, far_longitude)[0] @ axes.T
    straight_down = quaternion_of_opk(np.zeros((1, 3)))
    far_camera = matrices_of(in_turned_frame(straight_down, turn.T))[0]

    angle_rad = Rotation.from_matrix(turn).magnitude()
    assert np.degrees(angle_rad) == pytest.approx(0.8991, abs=2e-3)
    to_the_north_rad = np.arcsin(far_camera[2, 1])
    assert np.degrees(to_the_north_rad) == pytest.approx(0.8991, abs=2e-3)


def test_earth_centred_coordinates_against_pyproj():
    latitude = np.array([-33.5, 0.0, 89.9])
    longitude = np.array([151.0, -180.0, 12.0])
    height_m = np.array([100.0, -50.0, 9000.0])
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected_m = np.transpose(to_ecef.transform(longitude, latitude, height_m))
    ecef_m = ecef_of_geodetic(np.radians(latitude), np.radians(longitude), height_m)
    assert ecef_m == pytest.approx(expected_m, abs=1e-6)
