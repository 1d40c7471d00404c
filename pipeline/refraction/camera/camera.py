"""The camera: pixels to rays and back, pinhole with Brown-Conrady distortion.

Pixels follow COLMAP's rule: the centre of the upper left pixel is (0.5, 0.5). The camera looks
along z, x to the right and y down in the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline.refraction.camera.brown_conrady import brown_conrady

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

    @property
    def numbers(self) -> tuple[float, ...]:
        """Format, principal distance and point, coefficients, largest radius, for the kernels."""
        return (
            float(self.width_px), float(self.height_px), float(self.fx_px), float(self.fy_px),
            float(self.cx_px), float(self.cy_px), *self.coefficients, self.largest_radius,
        )  # fmt: skip

    @property
    def coefficients(self) -> tuple[float, ...]:
        """k1, k2, k3, p1, p2."""
        return tuple(float(c) for c in (self.k1, self.k2, self.k3, self.p1, self.p2))

    @cached_property
    def largest_radius(self) -> float:
        """Ideal radius (tan of the field angle) up to which the distortion can be inverted."""
        # Where d(r_d)/dr = 0, in 1/r^2: so nothing is divided by a coefficient that may be tiny.
        roots = np.roots([1.0, 3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3])
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots.real)) & (roots.real > 1e-12)]
        return float(1.0 / np.sqrt(real.max())) if real.size else np.inf

    def distort(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Distorted image coordinates of ideal ones, both in units of the principal distance."""
        return brown_conrady(u, v, *self.coefficients)

    def rays(self, x_px: Array, y_px: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Ideal image coordinates (u, v) = (tan) of pixels, and whether the camera covers them.

        (n,) pixels. A pixel outside the format, or beyond the radius to which the distortion can
        be inverted, is not covered and returns NaN. Newton's iteration, 1e-14 in u and v.

        >>> camera = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0, k1=-0.1)
        >>> u, v, covered = camera.rays(np.array([500.0, 950.0]), np.array([400.0, 400.0]))
        >>> camera.project(u, v)[0].round(9).tolist(), covered.tolist()
        ([500.0, 950.0], [True, True])
        """
        # The compiled functions are imported with the first ray, not with the package.
        from pipeline.refraction.kernels.image import rays_of_pixels

        u, v = np.empty(x_px.shape), np.empty(x_px.shape)
        rays_of_pixels(x_px, y_px, self.numbers, u, v)
        return u, v, np.isfinite(u)

    def project(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixels of ideal image coordinates, both (n,)."""
        u_d, v_d = self.distort(u, v)
        return self.fx_px * u_d + self.cx_px, self.fy_px * v_d + self.cy_px
