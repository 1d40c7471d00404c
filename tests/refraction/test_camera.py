"""The lens: there and back, and where it stops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend.refraction import BrownConrady, Camera
from unbend.refraction.camera.brown_conrady import distort, slopes
from unbend.simulate.optics import SimulatedCamera

WIDTH = 14_000
HEIGHT = 10_600
FOCAL = 11_000.0

cameras = st.builds(
    Camera,
    st.just(WIDTH),
    st.just(HEIGHT),
    st.floats(8_000.0, 30_000.0),
    st.floats(8_000.0, 30_000.0),
    st.floats(6_800.0, 7_200.0),
    st.floats(5_100.0, 5_500.0),
    st.builds(
        BrownConrady,
        k1=st.floats(-0.15, 0.15),
        k2=st.floats(-0.03, 0.03),
        k3=st.floats(-0.01, 0.01),
        p1=st.floats(-2e-3, 2e-3),
        p2=st.floats(-2e-3, 2e-3),
    ),
)


@settings(max_examples=100, deadline=None)
@given(cameras, st.lists(st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT)), min_size=1))
def test_there_and_back(camera, pixels):
    x, y = np.array(pixels, dtype=np.float64).T
    u, v, covered = camera.rays(x, y)
    np.testing.assert_array_equal(np.isnan(u), ~covered)
    x_again, y_again = camera.project(u[covered], v[covered])
    np.testing.assert_allclose(x_again, x[covered], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(y_again, y[covered], rtol=0.0, atol=1e-9)


def test_a_moderate_lens_covers_its_whole_image():
    camera = Camera(
        WIDTH,
        HEIGHT,
        FOCAL,
        FOCAL,
        7012.4,
        5291.7,
        distortion=BrownConrady(k1=-0.018, k2=0.009, k3=-0.002, p1=1.5e-4, p2=-1e-4),
    )
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, WIDTH, 29), np.linspace(0, HEIGHT, 23)))
    u, v, covered = camera.rays(x, y)
    assert covered.all()
    # The simulator's projection is written apart from this one, from OpenCV's manual.
    other = SimulatedCamera(
        "x", 0, FOCAL, 7012.4, 5291.7, (-0.018, 0.009, 1.5e-4, -1e-4, -0.002), 0.0, (0.0, 0.0, 0.0)
    )
    x_other, y_other = other.project(np.stack([u, v, np.ones_like(u)], axis=-1))
    np.testing.assert_allclose(x_other, x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(y_other, y, rtol=0.0, atol=1e-9)


def test_the_distortion_is_opencvs():
    # Worked by hand: u = 0.5, v = -0.25, r^2 = 0.3125.
    camera = Camera(
        10, 10, 1.0, 1.0, 0.0, 0.0, BrownConrady(k1=0.1, k2=0.2, k3=0.3, p1=0.01, p2=0.02)
    )
    radial = 1.0 + 0.1 * 0.3125 + 0.2 * 0.3125**2 + 0.3 * 0.3125**3
    u, v = camera.distort(np.array([0.5]), np.array([-0.25]))
    assert u[0] == pytest.approx(0.5 * radial + 2 * 0.01 * -0.125 + 0.02 * (0.3125 + 0.5), 1e-14)
    assert v[0] == pytest.approx(
        -0.25 * radial + 0.01 * (0.3125 + 0.125) + 2 * 0.02 * -0.125, 1e-14
    )


def test_beyond_the_calibrated_radius_is_not_covered():
    # r (1 - 0.5 r^2) turns over at r = sqrt(2/3) and reaches 0.544 there.
    camera = Camera(2000, 2000, 1000.0, 1000.0, 1000.0, 1000.0, BrownConrady(k1=-0.5))
    assert camera.largest_radius == pytest.approx(np.sqrt(2.0 / 3.0), rel=1e-12)
    u, v, covered = camera.rays(np.array([1540.0, 1550.0, 2000.0]), np.full(3, 1000.0))
    assert covered.tolist() == [True, False, False]
    assert np.isnan(u[1:]).all()
    assert np.isnan(v[1:]).all()
    assert Camera(10, 10, 1.0, 1.0, 5.0, 5.0).largest_radius == np.inf


@pytest.mark.parametrize("tiny", [0.0, 5e-324, -1e-310, 1e-200, -1e-20])
def test_coefficients_of_no_size_do_no_harm(tiny):
    camera = Camera(
        2000, 2000, 1000.0, 1000.0, 1000.0, 1000.0, BrownConrady(k1=-0.5, k2=tiny, k3=tiny)
    )
    assert camera.largest_radius == pytest.approx(np.sqrt(2.0 / 3.0), rel=1e-9)
    assert Camera(10, 10, 1.0, 1.0, 5.0, 5.0, BrownConrady(k1=tiny, k3=tiny)).largest_radius > 1e3


def test_outside_the_format_is_not_covered():
    camera = Camera(100, 80, 90.0, 90.0, 50.0, 40.0)
    x = np.array([-0.01, 0.0, 100.0, 100.01, 50.0, 50.0, np.nan, np.inf])
    y = np.array([40.0, 40.0, 40.0, 40.0, -0.01, 80.0, 40.0, 40.0])
    covered = camera.rays(x, y)[2]
    assert covered.tolist() == [False, True, True, False, False, True, False, False]


def test_no_pixels_no_rays():
    u, _, covered = Camera(100, 80, 90.0, 90.0, 50.0, 40.0).rays(np.empty(0), np.empty(0))
    assert u.shape == covered.shape == (0,)


def test_the_largest_radius_is_where_the_distortion_turns_over():
    """r (1 + k1 r^2 + k2 r^4 + k3 r^6): its derivative is 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6."""
    for k1, k2, k3 in ((0.1, -0.3, 0.0), (-0.2, 0.05, -0.02), (0.0, 0.0, -0.4)):
        lens = BrownConrady(k1, k2, k3)
        r2 = Camera(10, 10, 1.0, 1.0, 5.0, 5.0, lens).largest_radius ** 2
        assert 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2**2 + 7.0 * k3 * r2**3 == pytest.approx(
            0.0, abs=1e-12
        )


def test_the_slopes_are_the_derivatives_of_the_distortion():
    """Central differences, for each coefficient by itself."""
    step = 1e-6
    for parameters in np.eye(5) * 0.1:
        lens = BrownConrady(*parameters)
        (right, left), (down, up) = (
            (distort(0.3 + s * step, -0.2, lens) for s in (1, -1)),
            (distort(0.3, -0.2 + s * step, lens) for s in (1, -1)),
        )
        uu, vu = ((a - b) / (2.0 * step) for a, b in zip(right, left, strict=True))
        uv, vv = ((a - b) / (2.0 * step) for a, b in zip(down, up, strict=True))
        assert slopes(0.3, -0.2, lens) == pytest.approx((uu, uv, vv), abs=1e-9)
        assert uv == pytest.approx(vu, abs=1e-9)


def test_no_pixel_beyond_the_largest_radius_is_covered_by_another_root():
    """r (1 - 0.5 r^2) takes values above 0.544 again where r is negative."""
    camera = Camera(4000, 4000, 1000.0, 1000.0, 1000.0, 1000.0, BrownConrady(k1=-0.5))
    x = np.linspace(1545.0, 4000.0, 500)
    u, _, covered = camera.rays(x, np.full(x.shape, 1000.0))
    assert not covered.any()
    assert np.isnan(u).all()
