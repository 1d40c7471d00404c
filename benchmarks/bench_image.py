"""Whole image points, pixel to corrected pixel, beside plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from survey import CAMERA, air, exposures, points

from unbend.geodesy import euler_radius
from unbend.refraction import Exposures, correct_observations, ray_table

# A million a call: columns of 32 MB and more are fetched from the system anew each time, and that
# would be timed. A run corrects 250,000 at a time.
POINTS = 1_000_000
IMAGES = 400
BY_NUMPY = 400_000
BLOCK = 10_000  # points: their columns fit the cache
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
K1, K2, K3 = CAMERA.distortion[:3]

Refractivity = Callable[[np.ndarray], np.ndarray]
Pair = tuple[np.ndarray, np.ndarray]


@dataclass
class Observations:
    """Pixels, heights of the ground [m] and numbers of exposures of points (n,)."""

    x: np.ndarray
    y: np.ndarray
    h_g: np.ndarray
    exposure: np.ndarray

    def part(self, rows: slice) -> Observations:
        return Observations(
            self.x[rows],
            self.y[rows],
            self.h_g[rows],
            self.exposure[rows],
        )


def radial(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The factor by which the lens moves a point from the axis."""
    r2 = u * u + v * v
    return 1.0 + r2 * (K1 + r2 * (K2 + r2 * K3))


def undistort(x: np.ndarray, y: np.ndarray) -> Pair:
    """Ideal image coordinates by fixed point."""
    u_d = (x - CAMERA.cx_px) / CAMERA.fx_px
    v_d = (y - CAMERA.cy_px) / CAMERA.fy_px
    u = u_d
    v = v_d
    for _ in range(8):
        factor = radial(u, v)
        u = u_d / factor
        v = v_d / factor
    return u, v


def angles(
    refractivity: Refractivity,
    h_c: np.ndarray,
    h_g: np.ndarray,
    sine: np.ndarray,
    cosine: np.ndarray,
    radius: np.ndarray,
) -> np.ndarray:
    """R_c by Gauss-Legendre over the one layer between camera and ground."""
    n_c = refractivity(h_c)
    r_c = radius + h_c
    r_g = radius + h_g
    index2 = (1.0 + n_c) ** 2
    s = r_c * sine
    b_c = r_c * cosine
    b2_c = b_c**2
    integral = np.zeros_like(h_g)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        h = h_g + (h_c - h_g) * (0.5 + 0.5 * node)
        n = refractivity(h)
        r = radius + h
        m = (n - n_c) * (2.0 + n + n_c)
        fall = (h_c - h) * (r_c + r)
        straight2 = index2 * (b2_c - fall)
        a = np.sqrt(straight2 + m * r * r)
        b = np.sqrt(straight2)
        step = 0.5 * weight * (h_c - h_g)
        integral += step * m * r / (a * b * (a + b))
    half = 0.5 * (1.0 + n_c) * s * integral
    fall = (h_c - h_g) * (r_c + r_g)
    q = np.sqrt(b2_c - fall)
    turned = np.arctan2(s, q) - half
    chord = fall / (b_c + q)
    across = 2.0 * r_g * np.sin(half)
    return np.arctan2(
        across * np.cos(turned),
        chord - across * np.sin(turned),
    )


def correct_by_numpy(
    refractivity: Refractivity,
    points: Observations,
    exposures: Exposures,
) -> Pair:
    """The same steps, column by column."""
    u, v = undistort(points.x, points.y)
    length = np.sqrt(u * u + v * v + 1.0)
    ray = np.stack([u, v, np.ones_like(u)]) / length
    difference = exposures.refractivity_cabin - exposures.refractivity_outside
    excess = difference / (1 + exposures.refractivity_outside)
    outside = ray * (1.0 + excess[points.exposure])
    outside[2] = np.sqrt(1.0 - outside[0] ** 2 - outside[1] ** 2)
    rotation = exposures.rotation[points.exposure]
    local = np.einsum("nji,jn->in", rotation, outside)
    sine = np.hypot(local[0], local[1])
    cosine = -local[2]
    azimuth = np.arctan2(local[0], local[1])
    r_c = angles(
        refractivity,
        h_c=exposures.height_m[points.exposure],
        h_g=points.h_g,
        sine=sine,
        cosine=cosine,
        radius=euler_radius(exposures.latitude_rad[points.exposure], azimuth),
    )
    sine_r = np.sin(r_c)
    lower = -2.0 * np.sin(0.5 * r_c) ** 2 * local
    lower[:2] -= sine_r * cosine / sine * local[:2]
    lower[2] -= sine_r * sine
    seen = outside + np.einsum("nij,jn->in", rotation, lower)
    u = seen[0] / seen[2]
    v = seen[1] / seen[2]
    factor = radial(u, v)
    x = CAMERA.fx_px * u * factor + CAMERA.cx_px
    y = CAMERA.fy_px * v * factor + CAMERA.cy_px
    return x, y


def correct_in_blocks(
    refractivity: Refractivity,
    points: Observations,
    exposures: Exposures,
) -> Pair:
    """All points, in blocks that fit the cache."""
    x = []
    y = []
    for start in range(0, points.x.size, BLOCK):
        block = points.part(slice(start, start + BLOCK))
        x_of_block, y_of_block = correct_by_numpy(refractivity, block, exposures)
        x.append(x_of_block)
        y.append(y_of_block)
    return np.concatenate(x), np.concatenate(y)


def test_image_points_beside_numpy(ratios):
    profile = air()
    flown = exposures(IMAGES)
    table = ray_table(profile)
    exposure = np.repeat(np.arange(IMAGES), POINTS // IMAGES)
    every = Observations(*points(POINTS), exposure)
    few = every.part(slice(0, BY_NUMPY))
    # What a hand would write: n - 1 as a polynomial in height, fitted to 1e-12.
    grid = np.linspace(0.0, 6100.0, 400)
    fitted = np.polynomial.Polynomial.fit(grid, profile.refractivity(grid), 9)

    def by_kernel(points: Observations):
        return correct_observations(
            points.x,
            points.y,
            points.h_g,
            points.exposure,
            flown,
            camera=CAMERA,
            table=table,
        )

    def by_numpy():
        return correct_in_blocks(fitted, few, flown)

    corrected = by_kernel(few)
    x, y = by_numpy()
    assert np.abs(corrected.x_corrected_px - x).max() < 1e-6
    assert np.abs(corrected.y_corrected_px - y).max() < 1e-6

    counts = (POINTS, BY_NUMPY)
    ratio = ratios.of_times(lambda: by_kernel(every), by_numpy, counts=counts)
    ratios.check("image points, times as fast as numpy", ratio, at_least=1.8)
