"""sigma of R from a covariance: the tables against drawn air and against traced rays."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_close
from tests.refraction.images import (
    NARROW,
    RADIUS,
    corrected,
    exposure,
    looking,
    station_sigmas,
    together,
    uncertainties,
)
from tests.refraction.uncertain_air import AIR, COVARIANCE, TABLE
from unbend.refraction import WindowRays, leading_mode, sensitivity
from unbend.refraction.uncertainty.sigmas import OPEN

CAMERA = replace(NARROW, fx_px=50_000.0, fy_px=50_000.0)
TILT = 1e-4


def tabulated(covariance, h_c, h_g, zeta, ground=(-600.0, 10_000.0)):
    """sigma_R and |dR/dzeta| of rays along the axes of cameras, as corrections have them."""
    single = []
    for height, tilt_deg in zip(h_c, np.degrees(zeta), strict=True):
        single.append(exposure(AIR, looking(tilt_deg), h_c=height))
    exposures = together(*single)
    made = uncertainties(
        AIR,
        covariance,
        exposures,
        CAMERA,
        station_sigmas(h_c.size, tilt=TILT, yaw=TILT),
        ground_heights_m=ground,
    )
    sigmas = corrected(
        CAMERA.cx_px,
        CAMERA.cy_px,
        exposures,
        TABLE,
        camera=CAMERA,
        h_g=h_g,
        row=np.arange(h_c.size),
        uncertainty=made,
    ).sigmas
    slope = sigmas.station_dy_px / CAMERA.fy_px / TILT
    return sigmas.r_c_rad, slope, made.tables


def traced(h_c, h_g, zeta):
    """R, its derivatives by the air and by the angle."""
    anchor_m = COVARIANCE.anchor_height_m
    derivatives = sensitivity(
        AIR,
        h_c,
        h_g,
        zeta,
        RADIUS,
        anchor_height_m=anchor_m,
    )
    return derivatives.r_c, derivatives.gradient, derivatives.d_zeta_c


def traced_sigma(gradient):
    """C is multiplied out, not factored."""
    variance = np.einsum("ni,ij,nj->n", gradient, COVARIANCE.matrix, gradient)
    return np.sqrt(variance)


@pytest.mark.parametrize(
    ("low", "high", "largest_deg", "allowed"),
    [
        (2600.0, 2750.0, 75.0, 0.01),
        (2600.0, 2750.0, 85.0, 0.03),
        (1000.0, 2900.0, 80.0, 0.02),
        (5000.0, 5400.0, 80.0, 0.015),
        (300.0, 420.0, 75.0, 0.03),  # ways from 30 m, less than a layer
    ],
)
def test_the_tables_beside_traced_rays(low, high, largest_deg, allowed):
    rng = np.random.default_rng(4)
    h_c = rng.uniform(low, high, 300)
    h_g = rng.uniform(0.0, 0.9, 300) * low
    zeta = np.radians(rng.uniform(1.0, largest_deg, 300))
    sigma, slope, _ = tabulated(COVARIANCE, h_c, h_g, zeta)
    _, gradient, true_slope = traced(h_c, h_g, zeta)
    assert_close(sigma, traced_sigma(gradient), rtol=allowed)
    # Where R itself is nearly zero in the inversion its slope is too.
    size = np.abs(true_slope)
    usual = np.median(size)
    assert_close(slope, size, rtol=0.01, atol=2e-3 * usual)


def test_one_height_of_camera_and_ground():
    ray = np.array([[2000.0], [300.0], [0.9]])
    sigma, slope, tables = tabulated(COVARIANCE, *ray, (300.0, 300.0))
    _, gradient, true_slope = traced(*ray)
    assert_close(sigma, traced_sigma(gradient), rtol=3e-3)
    assert_close(slope, true_slope, rtol=3e-3)
    assert tables.sigma.size <= 20


def mode_of(h_c, zeta, h_g, covariance=COVARIANCE, **options):
    """The leading mode of rays through no window."""
    no_turn = np.zeros(zeta.size)
    kind = np.full(zeta.size, OPEN)
    rays = WindowRays(h_c, zeta, kind, no_turn, no_turn)
    return leading_mode(AIR, covariance, rays, h_g, **options)


def test_errors_of_one_flight_are_one_scale_factor():
    h_c = np.full(50, 2700.0)
    zeta = np.radians(np.linspace(5.0, 60.0, 50))
    mode = mode_of(h_c, zeta, 200.0)
    assert 0.9999 < mode.variance_share <= 1.0 + 1e-12
    r_c, gradient, _ = traced(h_c[:1], 200.0, zeta[:1])
    relative = traced_sigma(gradient) / r_c
    assert_close(mode.sigma, relative, rtol=2e-3)


def test_the_mode_of_rays_that_disagree():
    """Half a way down, and up at the inversion: eigenvectors of the covariance of R."""
    h_c = np.array([2700.0, 2700.0, 2900.0, 1700.0])
    h_g = np.array([200.0, 2500.0, 0.0, 1400.0])
    zeta = np.radians([45.0, 70.0, 20.0, 75.0])
    r_c, gradient, _ = traced(h_c, h_g, zeta)
    values, vectors = np.linalg.eigh(gradient @ COVARIANCE.matrix @ gradient.T)
    value = values[-1]
    vector = vectors[:, -1]

    mode = mode_of(h_c, zeta, h_g, radius=RADIUS)

    assert_close(mode.sigma**2, value / (r_c @ r_c), rtol=1e-5)
    assert_close(mode.variance_share, value / values.sum(), rtol=1e-9)
    # C g^T v / sqrt(lambda) is the change of the air, with R growing in it.
    state = COVARIANCE.matrix @ gradient.T @ vector / np.sqrt(value)
    state *= np.sign(vector @ r_c)
    largest = np.abs(state).max()
    assert_close(mode.state, state, rtol=1e-7, atol=1e-6 * largest)
    assert r_c @ gradient @ mode.state > 0.0
    assert mode.variance_share < 0.98


H_C = np.array([2000.0])
ZETA = np.array([0.3])
NOTHING = np.empty(0)
CERTAIN = replace(COVARIANCE, matrix=0.0 * COVARIANCE.matrix)


@pytest.mark.parametrize(
    ("covariance", "h_c", "zeta", "h_g"),
    [
        (COVARIANCE, NOTHING, NOTHING, NOTHING),
        (COVARIANCE, H_C, ZETA, 1e9),
        (CERTAIN, H_C, ZETA, 0.0),
    ],
    ids=["no ray", "no angle", "nothing is uncertain"],
)
def test_no_ray_no_mode(covariance, h_c, zeta, h_g):
    assert mode_of(h_c, zeta, h_g, covariance) is None


def test_where_there_is_no_sigma():
    """Nearly level at the ground, and above the camera."""
    h_g = np.array([0.0, 2800.0, 100.0])
    zeta = np.radians([88.3, 95.0, 60.0])
    h_c = np.full(3, 2650.0)
    sigma, slope, _ = tabulated(
        COVARIANCE,
        h_c,
        h_g,
        zeta,
    )
    assert np.isnan(sigma).tolist() == [True, True, False]
    assert np.isnan(slope).tolist() == [True, True, False]


def test_without_a_covariance_only_slopes():
    ray = np.array([[2650.0], [100.0], [0.8]])
    sigma, slope, _ = tabulated(None, *ray)
    _, slope_with_covariance, _ = tabulated(COVARIANCE, *ray)
    assert np.isnan(sigma).all()
    assert_array_equal(slope, slope_with_covariance)
