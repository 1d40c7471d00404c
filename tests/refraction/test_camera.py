"""The lens: there and back, and where it stops."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_close, assert_near
from unbend.refraction import BrownConrady, Camera
from unbend.simulate.optics import SimulatedCamera

WIDTH = 14_000
HEIGHT = 10_600
SMALL = Camera(
    100,
    80,
    90.0,
    90.0,
    50.0,
    40.0,
)

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


pixels = st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT))


@settings(max_examples=100, deadline=None)
@given(cameras, st.lists(pixels, min_size=1))
def test_there_and_back(camera, pixels):
    x, y = np.array(pixels, dtype=np.float64).T
    u, v, covered = camera.rays(x, y)
    assert_array_equal(np.isnan(u), ~covered)
    again = camera.project(u[covered], v[covered])
    assert_near(again, (x[covered], y[covered]), 1e-9)


def test_a_moderate_lens_covers_its_whole_image():
    """The simulator's projection is written apart from this one, from OpenCV's manual."""
    lens = BrownConrady(
        k1=-0.018,
        k2=0.009,
        k3=-0.002,
        p1=1.5e-4,
        p2=-1e-4,
    )
    camera = Camera(
        WIDTH,
        HEIGHT,
        11_000.0,
        11_000.0,
        7012.4,
        5291.7,
        lens,
    )
    x = np.tile(np.linspace(0, WIDTH, 29), 23)
    y = np.repeat(np.linspace(0, HEIGHT, 23), 29)
    u, v, covered = camera.rays(x, y)
    assert covered.all()
    opencv = (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)
    simulated = SimulatedCamera(
        "x",
        0,
        11_000.0,
        7012.4,
        5291.7,
        opencv,
        0.0,
        (0.0, 0.0, 0.0),
    )
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    again = simulated.project(rays)
    assert_near(again, (x, y), 1e-9)


def with_unit_focal(*coefficients, **named):
    lens = BrownConrady(*coefficients, **named)
    return Camera(10, 10, 1.0, 1.0, 5.0, 5.0, lens)


TURNS_AT_0_8 = Camera(
    4000,
    4000,
    1000.0,
    1000.0,
    1000.0,
    1000.0,
    BrownConrady(k1=-0.5),
)
TURN = np.sqrt(2.0 / 3.0)


def test_beyond_the_calibrated_radius_is_not_covered():
    """r (1 - 0.5 r^2) turns over at r = sqrt(2/3) and reaches 0.544 there.

    It takes values above that again where r is negative, a root that does not count.
    """
    assert_close(TURNS_AT_0_8.largest_radius, TURN, rtol=1e-12)
    x = np.append(1540.0, np.linspace(1545.0, 4000.0, 500))
    u, v, covered = TURNS_AT_0_8.rays(x, np.full(x.shape, 1000.0))
    assert np.flatnonzero(covered).tolist() == [0]
    assert np.isnan([u[1:], v[1:]]).all()


@pytest.mark.parametrize(
    ("k1", "k2", "k3"),
    [
        (0.1, -0.3, 0.0),
        (-0.2, 0.05, -0.02),
        (0.0, 0.0, -0.4),
    ],
)
def test_the_largest_radius_is_where_the_distortion_turns_over(k1, k2, k3):
    """r (1 + k1 r^2 + k2 r^4 + k3 r^6): its derivative is 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6."""
    r2 = with_unit_focal(k1, k2, k3).largest_radius ** 2
    slope = 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2**2 + 7.0 * k3 * r2**3
    assert_near(slope, 0.0, 1e-12)


def test_without_distortion_there_is_no_largest_radius():
    assert with_unit_focal().largest_radius == np.inf


@pytest.mark.parametrize("tiny", [0.0, 5e-324, -1e-310, 1e-200, -1e-20])
def test_coefficients_of_no_size_do_no_harm(tiny):
    nearly_k1_alone = with_unit_focal(k1=-0.5, k2=tiny, k3=tiny)
    assert_close(nearly_k1_alone.largest_radius, TURN, rtol=1e-9)
    nearly_none = with_unit_focal(k1=tiny, k3=tiny)
    assert nearly_none.largest_radius > 1e3


@pytest.mark.parametrize(
    ("beyond", "expected"),
    [
        (0.0, True),
        (0.01, False),
        (np.nan, False),
        (np.inf, False),
    ],
)
def test_the_format_is_covered_to_its_edge(beyond, expected):
    x = np.array([-beyond, 100.0 + beyond, 50.0, 50.0])
    y = np.array([40.0, 40.0, -beyond, 80.0 + beyond])
    _, _, covered = SMALL.rays(x, y)
    assert covered.tolist() == [expected] * 4


def test_no_pixels_no_rays():
    nothing = np.empty(0)
    u, _, covered = TURNS_AT_0_8.rays(nothing, nothing)
    assert u.shape == (0,)
    assert covered.shape == (0,)
