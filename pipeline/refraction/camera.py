"""The camera: pixels to rays and back, pinhole with Brown-Conrady distortion.

Pixels follow COLMAP's rule: the centre of the upper left pixel is (0.5, 0.5). The camera looks
along z, x to the right and y down in the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Interior orientation of a frame camera.

    Parameters
    ----------
    width_px, height_px : format of the image.
    fx_px, fy_px : principal distance in pixels.
    cx_px, cy_px : principal point.
    k1, k2, k3, p1, p2 : Brown-Conrady coefficients in OpenCV's form: with (u, v) ideal and
        r^2 = u^2 + v^2, u_d = u (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 u v + p2 (r^2 + 2 u^2).
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @cached_property
    def largest_radius(self) -> float:
        """Ideal radius (tan of the field angle) up to which the distortion can be inverted."""
        # Where d(r_d)/dr = 0, in 1/r^2: so nothing is divided by a coefficient that may be tiny.
        roots = np.roots([1.0, 3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3])
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots.real)) & (roots.real > 1e-12)]
        return float(1.0 / np.sqrt(real.max())) if real.size else np.inf

    def distort(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Distorted image coordinates of ideal ones, both in units of the principal distance."""
        r2 = u * u + v * v
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        u_d = u * radial + 2.0 * self.p1 * u * v + self.p2 * (r2 + 2.0 * u * u)
        v_d = v * radial + self.p1 * (r2 + 2.0 * v * v) + 2.0 * self.p2 * u * v
        return u_d, v_d

    def _jacobian(self, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        r2 = u * u + v * v
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3))
        uu = radial + u * u * slope + 2.0 * self.p1 * v + 6.0 * self.p2 * u
        uv = u * v * slope + 2.0 * self.p1 * u + 2.0 * self.p2 * v
        vv = radial + v * v * slope + 6.0 * self.p1 * v + 2.0 * self.p2 * u
        return uu, uv, uv, vv

    def rays(self, x_px: Array, y_px: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Ideal image coordinates (u, v) = (tan) of pixels, and whether the camera covers them.

        (n,) pixels. A pixel outside the format, or beyond the radius to which the distortion can
        be inverted, is not covered and returns NaN. Newton's iteration, 1e-14 in u and v.

        >>> camera = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0, k1=-0.1)
        >>> u, v, covered = camera.rays(np.array([500.0, 950.0]), np.array([400.0, 400.0]))
        >>> camera.project(u, v)[0].round(9).tolist(), covered.tolist()
        ([500.0, 950.0], [True, True])
        """
        with np.errstate(invalid="ignore"):
            inside = (
                (x_px >= 0.0) & (x_px <= self.width_px) & (y_px >= 0.0) & (y_px <= self.height_px)
            )
        target_u = np.where(inside, (x_px - self.cx_px) / self.fx_px, np.nan)
        target_v = np.where(inside, (y_px - self.cy_px) / self.fy_px, np.nan)
        u, v = target_u.copy(), target_v.copy()
        step = np.inf
        for _ in range(30):
            u_d, v_d = self.distort(u, v)
            res_u, res_v = target_u - u_d, target_v - v_d
            uu, uv, vu, vv = self._jacobian(u, v)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                determinant = uu * vv - uv * vu
                d_u = (vv * res_u - uv * res_v) / determinant
                d_v = (uu * res_v - vu * res_u) / determinant
            u, v = u + d_u, v + d_v
            step = np.nanmax(np.abs(np.concatenate([d_u, d_v])), initial=0.0)
            if step < 1e-14:
                break
        with np.errstate(invalid="ignore", over="ignore"):
            u_d, v_d = self.distort(u, v)
            solved = np.hypot(u_d - target_u, v_d - target_v) < 1e-12
            covered = inside & solved & (np.hypot(u, v) <= self.largest_radius)
        return np.where(covered, u, np.nan), np.where(covered, v, np.nan), covered

    def project(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixels of ideal image coordinates, both (n,)."""
        u_d, v_d = self.distort(u, v)
        return self.fx_px * u_d + self.cx_px, self.fy_px * v_d + self.cy_px
