"""OpenSfM's projections as its documentation has them."""

from __future__ import annotations

import numpy as np

COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2", "c_x", "c_y")


def opensfm_projection(camera, u, v) -> np.ndarray:
    """(n, 2) image points of (u, v, 1), in units of the longer side, from the image's centre."""
    k1, k2, k3, k4, p1, p2, c_x, c_y = (camera.get(name, 0.0) for name in COEFFICIENTS)
    r2 = u * u + v * v
    if "fisheye" in camera["projection_type"]:
        theta = np.arctan(np.sqrt(r2))
        series = 1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8
        bent = theta * series / np.sqrt(r2 + 1e-300)
        x = u * bent
        y = v * bent
    else:
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
        y = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    focal_x = camera.get("focal", camera.get("focal_x"))
    focal_y = camera.get("focal", camera.get("focal_y"))
    return np.stack([focal_x * x + c_x, focal_y * y + c_y], axis=1)
