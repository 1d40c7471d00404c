"""Whole image points, pixel to corrected pixel, beside plain numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from survey import CAMERA, air, exposures, points

from unbend.geodesy import euler_radius
from unbend.refraction import correct_observations, ray_table

# A million a call: columns of 32 MB and more are fetched from the system anew each time, and that
# would be timed. A run corrects 250,000 at a time.
POINTS = 1_000_000
IMAGES = 400
BY_NUMPY = 400_000
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def undistort(x: Any, y: Any) -> tuple[Any, Any]:
    """Ideal image coordinates by fixed point."""
    u_d = (x - CAMERA.cx_px) / CAMERA.fx_px
    v_d = (y - CAMERA.cy_px) / CAMERA.fy_px
    u = u_d
    v = v_d
    k1, k2, k3, _, _ = CAMERA.distortion
    for _ in range(8):
        r2 = u * u + v * v
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = u_d / radial
        v = v_d / radial
    return u, v


def angles(n_of: Any, h_c: Any, h_g: Any, sine: Any, cosine: Any, radius: Any) -> Any:
    """R_c by Gauss-Legendre over the one layer between camera and ground."""
    n_c = n_of(h_c)
    r_c = radius + h_c
    r_g = radius + h_g
    index2 = (1.0 + n_c) ** 2
    b2_c = (r_c * cosine) ** 2
    integral = np.zeros_like(h_g)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        h = h_g + (h_c - h_g) * (0.5 + 0.5 * node)
        n = n_of(h)
        r = radius + h
        m = (n - n_c) * (2.0 + n + n_c)
        straight2 = index2 * (b2_c - (h_c - h) * (r_c + r))
        a = np.sqrt(straight2 + m * r * r)
        b = np.sqrt(straight2)
        integral += 0.5 * weight * (h_c - h_g) * m * r / (a * b * (a + b))
    half = 0.5 * (1.0 + n_c) * r_c * sine * integral
    q = np.sqrt(b2_c - (h_c - h_g) * (r_c + r_g))
    z = np.arctan2(r_c * sine, q)
    chord = (h_c - h_g) * (r_c + r_g) / (r_c * cosine + q)
    across = 2.0 * r_g * np.sin(half)
    return np.arctan2(across * np.cos(z - half), chord - across * np.sin(z - half))


def correct_by_numpy(n_of: Any, x: Any, y: Any, h_g: Any, e: Any, ex: Any) -> tuple[Any, Any]:
    """The same steps, column by column, in blocks that fit the cache."""
    u, v = undistort(x, y)
    d = np.stack([u, v, np.ones_like(u)]) / np.sqrt(u * u + v * v + 1.0)
    k1, k2, k3, _, _ = CAMERA.distortion
    excess = ((ex.refractivity_cabin - ex.refractivity_outside) / (1 + ex.refractivity_outside))[e]
    outside = d * (1.0 + excess)
    outside[2] = np.sqrt(1.0 - outside[0] ** 2 - outside[1] ** 2)
    turn = ex.rotation[e]
    local = np.einsum("nji,jn->in", turn, outside)
    sine = np.hypot(local[0], local[1])
    cosine = -local[2]
    radius = euler_radius(ex.latitude_rad[e], np.arctan2(local[0], local[1]))
    r_c = angles(n_of, ex.height_m[e], h_g, sine, cosine, radius)
    lower = -2.0 * np.sin(0.5 * r_c) ** 2 * local
    lower[:2] -= np.sin(r_c) * cosine / sine * local[:2]
    lower[2] -= np.sin(r_c) * sine
    seen = outside + np.einsum("nij,jn->in", turn, lower)
    u = seen[0] / seen[2]
    v = seen[1] / seen[2]
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return CAMERA.fx_px * u * radial + CAMERA.cx_px, CAMERA.fy_px * v * radial + CAMERA.cy_px


def replace_in_blocks(n_of: Any, x: Any, y: Any, h_g: Any, e: Any, ex: Any) -> tuple[Any, Any]:
    """Blocks of 10,000 points."""
    parts = [slice(i, i + 10_000) for i in range(0, x.size, 10_000)]
    found = [correct_by_numpy(n_of, x[p], y[p], h_g[p], e[p], ex) for p in parts]
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def test_image_points_beside_numpy(ratios):
    profile = air()
    ex = exposures(IMAGES)
    table = ray_table(profile)
    x, y, h_g = points(POINTS)
    e = np.repeat(np.arange(IMAGES), POINTS // IMAGES)
    few = slice(0, BY_NUMPY)
    # What a hand would write: n - 1 as a polynomial in height, fitted to 1e-12.
    grid = np.linspace(0.0, 6100.0, 400)
    fitted = np.polynomial.Polynomial.fit(grid, profile.refractivity(grid), 9)

    ours = correct_observations(x[few], y[few], h_g[few], e[few], ex, camera=CAMERA, table=table)
    theirs = replace_in_blocks(fitted, x[few], y[few], h_g[few], e[few], ex)
    assert np.abs(ours.x_corrected_px - theirs[0]).max() < 1e-6
    assert np.abs(ours.y_corrected_px - theirs[1]).max() < 1e-6

    ratio = ratios.of_times(
        lambda: correct_observations(x, y, h_g, e, ex, camera=CAMERA, table=table),
        lambda: replace_in_blocks(fitted, x[few], y[few], h_g[few], e[few], ex),
        counts=(POINTS, BY_NUMPY),
    )
    ratios.check("image points, times as fast as numpy", ratio, at_least=1.8)
