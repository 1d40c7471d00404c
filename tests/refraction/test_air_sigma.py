"""sigma of R from a covariance: the tables against drawn air and against traced rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.refraction import (
    Camera,
    Exposures,
    StationSigmas,
    WindowRays,
    bend,
    correct_observations,
    leading_mode,
    ray_table,
    uncertainty_of,
)
from unbend.refraction.uncertainty.sensitivity import sensitivity
from unbend.refraction.uncertainty.sigmas import OPEN

RADIUS = 6_371_000.0


NARROW = Camera(200, 200, 50_000.0, 50_000.0, 100.0, 100.0)


def tabulated(profile, covariance, h_c, h_g, zeta, ground=(-600.0, 10_000.0)):
    """sigma_R and |dR/dzeta| of rays along the axes of cameras, as corrections have them."""
    n = h_c.size
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    rotation = np.zeros((n, 3, 3))  # x right to the east, y down in the image, looking north
    rotation[:, 0, 0] = 1.0
    rotation[:, 1, 1], rotation[:, 1, 2] = -cosine, -sine
    rotation[:, 2, 1], rotation[:, 2, 2] = sine, -cosine
    outside = profile.refractivity(h_c)
    exposures = Exposures(
        np.ones(n, bool), rotation, np.zeros(n), h_c, outside, outside, radius_m=RADIUS
    )
    axis = np.tile([0.0, 0.0, 1.0], (n, 1))
    stations = StationSigmas(np.full(n, 1e-4), np.full(n, 1e-4), axis, np.zeros(n))
    all_of_them = [(NARROW, np.ones(n, bool))]
    uncertainty = uncertainty_of(
        profile, covariance, exposures, stations, all_of_them, ground_heights_m=ground
    )
    centre = np.full(n, 100.0)
    sigmas = correct_observations(
        centre,
        centre,
        h_g,
        np.arange(n),
        exposures,
        camera=NARROW,
        table=ray_table(profile),
        uncertainty=uncertainty,
    ).sigmas
    slope = sigmas.station_dy_px.astype(float) / NARROW.fy_px / 1e-4
    return sigmas.r_c_rad, slope, uncertainty.tables


def traced(profile, covariance, h_c, h_g, zeta):
    """The same by the gradient of each ray; C is multiplied out, not factored."""
    found = sensitivity(profile, h_c, h_g, zeta, RADIUS, anchor_height_m=covariance.anchor_height_m)
    g = found.gradient
    return np.sqrt(np.einsum("ni,ij,nj->n", g, covariance.matrix, g)), found.d_zeta_c


def rays(rng, n, low, high, largest_deg):
    h_c = rng.uniform(low, high, n)
    return h_c, rng.uniform(0.0, 0.9, n) * low, np.radians(rng.uniform(1.0, largest_deg, n))


@pytest.mark.parametrize(
    ("low", "high", "largest", "allowed"),
    [
        (2600.0, 2750.0, 75.0, 0.01), (2600.0, 2750.0, 85.0, 0.03),
        (1000.0, 2900.0, 80.0, 0.02), (5000.0, 5400.0, 80.0, 0.015),
        (300.0, 420.0, 75.0, 0.03),  # ways from 30 m, less than a layer
    ],
)  # fmt: skip
def test_the_tables_beside_traced_rays(airs, low, high, largest, allowed):
    profile, covariance = airs.air()
    ray = rays(np.random.default_rng(4), 300, low, high, largest)
    sigma, slope, _ = tabulated(profile, covariance, *ray)
    true_sigma, true_slope = traced(profile, covariance, *ray)
    np.testing.assert_allclose(sigma, true_sigma, rtol=allowed)
    # Where R itself is nearly zero in the inversion its slope is too.
    unit = np.median(np.abs(true_slope))
    np.testing.assert_allclose(slope, np.abs(true_slope), rtol=0.01, atol=2e-3 * unit)


def test_one_height_of_camera_and_ground(airs):
    profile, covariance = airs.air()
    ray = np.array([2000.0]), np.array([300.0]), np.array([0.9])
    sigma, slope, air = tabulated(profile, covariance, *ray, (300.0, 300.0))
    true_sigma, true_slope = traced(profile, covariance, *ray)
    np.testing.assert_allclose((sigma[0], slope[0]), (true_sigma[0], true_slope[0]), rtol=3e-3)
    assert air.sigma.size <= 20


def test_sigma_is_the_spread_of_drawn_airs(airs):
    """600 airs drawn from the covariance, each with its own hydrostatics and rays."""
    profile, covariance = airs.air()
    h_c = np.array([2700.0, 2700.0, 2650.0, 2700.0])
    h_g = np.array([200.0, 1500.0, 200.0, 200.0])
    zeta = np.radians([45.0, 60.0, 80.0, 5.0])
    sigma, _, _ = tabulated(profile, covariance, h_c, h_g, zeta)
    rng = np.random.default_rng(11)
    drawn = np.array(
        [
            bend(ray_table(airs.drawn(rng)), h_c, h_g, np.sin(zeta), np.cos(zeta), radius=RADIUS)[0]
            for _ in range(600)
        ]
    )
    # A standard deviation of 600 draws is good to 2.9 %.
    np.testing.assert_allclose(drawn.std(axis=0), sigma, rtol=0.09)

    mode = leading_mode(profile, covariance, open_rays(h_c, zeta), h_g, radius=RADIUS)
    size = np.linalg.svd(drawn - drawn.mean(axis=0), compute_uv=False)
    relative = size[0] / np.sqrt(600.0) / np.linalg.norm(drawn.mean(axis=0))
    np.testing.assert_allclose(mode.sigma, relative, rtol=0.09)
    np.testing.assert_allclose(mode.variance_share, size[0] ** 2 / (size @ size), atol=0.02)


def open_rays(h_c, zeta) -> WindowRays:
    nothing = np.zeros(zeta.size)
    return WindowRays(h_c, zeta, np.full(zeta.size, OPEN), nothing, nothing)


def test_errors_of_one_flight_are_one_scale_factor(airs):
    profile, covariance = airs.air()
    n = 50
    h_c = np.full(n, 2700.0)
    h_g = np.full(n, 200.0)
    zeta = np.radians(np.linspace(5.0, 60.0, n))
    mode = leading_mode(profile, covariance, open_rays(h_c, zeta), h_g)
    assert 0.9999 < mode.variance_share <= 1.0 + 1e-12
    sigma, _ = traced(profile, covariance, h_c[:1], h_g[:1], zeta[:1])
    r = sensitivity(profile, h_c[:1], h_g[:1], zeta[:1]).r_c
    np.testing.assert_allclose(mode.sigma, sigma / r, rtol=2e-3)


def test_the_mode_of_rays_that_disagree(airs):
    """Half a way down, and up at the inversion: eigenvectors of the covariance of R."""
    profile, covariance = airs.air()
    h_c = np.array([2700.0, 2700.0, 2900.0, 1700.0])
    h_g = np.array([200.0, 2500.0, 0.0, 1400.0])
    zeta = np.radians([45.0, 70.0, 20.0, 75.0])
    found = sensitivity(profile, h_c, h_g, zeta, RADIUS, anchor_height_m=covariance.anchor_height_m)
    g = found.gradient
    r = found.r_c
    errors = g @ covariance.matrix @ g.T
    value, vector = np.linalg.eigh(errors)
    mode = leading_mode(profile, covariance, open_rays(h_c, zeta), h_g, radius=RADIUS)
    np.testing.assert_allclose(mode.sigma**2, value[-1] / (r @ r), rtol=1e-5)
    np.testing.assert_allclose(mode.variance_share, value[-1] / value.sum(), rtol=1e-9)
    # C g^T v / sqrt(lambda) is the change of the air, with R growing in it.
    state = covariance.matrix @ g.T @ vector[:, -1] / np.sqrt(value[-1])
    state *= np.sign(vector[:, -1] @ r)
    np.testing.assert_allclose(mode.state, state, atol=1e-6 * np.abs(state).max())
    assert r @ g @ mode.state > 0.0
    assert mode.variance_share < 0.98


def test_no_ray_no_mode(airs):
    profile, covariance = airs.air()
    nothing = np.empty(0)
    assert leading_mode(profile, covariance, open_rays(nothing, nothing), nothing) is None
    upwards = open_rays(np.array([2000.0]), np.array([0.3]))
    assert leading_mode(profile, covariance, upwards, 1e9) is None
    certain = replace(covariance, matrix=0.0 * covariance.matrix)
    assert leading_mode(profile, certain, open_rays(np.full(3, 2e3), np.full(3, 0.5)), 0.0) is None


def test_where_there_is_no_sigma(airs):
    """Nearly level at the ground, and above the camera."""
    profile, covariance = airs.air()
    h_c = np.full(3, 2650.0)
    h_g = np.array([0.0, 2800.0, 100.0])
    zeta = np.radians([88.3, 95.0, 60.0])
    sigma, slope, _ = tabulated(profile, covariance, h_c, h_g, zeta)
    assert np.isnan(sigma).tolist() == np.isnan(slope).tolist() == [True, True, False]


def test_without_a_covariance_only_slopes(airs):
    profile, covariance = airs.air()
    ray = np.array([2650.0]), np.array([100.0]), np.array([0.8])
    sigma, slope, _ = tabulated(profile, None, *ray)
    assert np.isnan(sigma).all()
    np.testing.assert_array_equal(slope, tabulated(profile, covariance, *ray)[1])
