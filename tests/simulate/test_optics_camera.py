"""Mount, window and lens of the simulated cameras."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.simulate.optics import body_rotation, cameras, quaternion, through_window


def test_mounts_point_where_they_say():
    nadir, oblique = cameras(20_000.0)
    # Rows of the rotation are the camera's axes in body axes: forward, right, down.
    np.testing.assert_allclose(nadir.from_body(), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(oblique.from_body()[2], [0.0, half, half], atol=1e-15)
    np.testing.assert_allclose(oblique.from_body()[1], [-1.0, 0.0, 0.0], atol=1e-15)


def test_body_rotation_is_yaw_pitch_roll():
    expected = Rotation.from_euler("ZYX", [2.1, -0.3, 0.7]).as_matrix()
    np.testing.assert_allclose(body_rotation(0.7, -0.3, 2.1), expected, atol=1e-15)


def test_quaternion_agrees_with_scipy():
    for rotation in Rotation.random(200, rng=np.random.default_rng(3)):
        w, x, y, z = quaternion(rotation.as_matrix())
        assert w >= 0.0
        back = Rotation.from_quat([x, y, z, w])
        assert (back * rotation.inv()).magnitude() < 1e-14


def test_window_obeys_snell_and_denser_cabin_air_pulls_inward():
    slope = np.radians([1e-3, 5.0, 19.0])
    rays = np.stack([np.sin(slope), np.zeros(3), np.cos(slope)], axis=-1)
    n_outside = np.full(3, 1.00019)
    n_cabin = np.full(3, 1.00023)
    inside, r_cc = through_window(rays, n_outside, n_cabin)
    zeta_f = np.arctan2(inside[:, 0], inside[:, 2])
    np.testing.assert_allclose(n_cabin * np.sin(zeta_f), n_outside * np.sin(slope), rtol=1e-14)
    np.testing.assert_allclose(r_cc, slope - zeta_f, rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(r_cc, np.tan(zeta_f) * 4e-5 / 1.00019, rtol=1e-4)  # Gyer Eq. 38
    camera = cameras(20_000.0)[0]
    moved = camera.project(inside)[0] - camera.project(rays)[0]
    assert np.all(moved < 0.0)


def test_same_air_on_both_sides_changes_nothing():
    ray = np.array([[0.2, -0.1, np.sqrt(0.95)]])
    inside, r_cc = through_window(ray, np.array([1.0002]), np.array([1.0002]))
    np.testing.assert_allclose(inside, ray, atol=1e-16)
    assert abs(r_cc[0]) < 1e-16


def test_lens_by_hand():
    camera = cameras(20_000.0)[0]
    x, y = camera.project(np.array([[0.1, -0.2, 1.0]]))
    k1, k2, p1, p2, k3 = camera.distortion
    radial = 1.0 + k1 * 0.05 + k2 * 0.05**2 + k3 * 0.05**3
    expected_x = 0.1 * radial + 2 * p1 * 0.1 * -0.2 + p2 * (0.05 + 2 * 0.01)
    expected_y = -0.2 * radial + p1 * (0.05 + 2 * 0.04) + 2 * p2 * 0.1 * -0.2
    assert x[0] == pytest.approx(20_000.0 * expected_x + camera.cx_px, abs=1e-9)
    assert y[0] == pytest.approx(20_000.0 * expected_y + camera.cy_px, abs=1e-9)


def test_far_rays_are_not_folded_back_by_the_lens():
    rays = np.array([[3.0, 0.1, 1.0], [0.0, 0.0, -1.0], [0.1, 0.1, 1.0]])
    assert cameras(20_000.0)[0].sees(rays).tolist() == [False, False, True]
