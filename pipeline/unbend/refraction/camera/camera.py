"""The camera: pixels to rays and back, a principal distance and the distortion of its lens.

Pixels follow COLMAP's rule: the centre of the upper left pixel is (0.5, 0.5). The camera looks
along z, x to the right and y down in the image.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unbend.refraction.camera import model_of
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.kernels.columns import IDEAL_U, IDEAL_V, RAY_ROWS, CameraConstants
from unbend.units import Array, Mask

NO_DISTORTION = BrownConrady()

LARGEST_CHANGE = 0.01
"""Share of the principal distance that the air never changes: 30 times the 310 ppm of Meier."""


@dataclass(frozen=True)
class Camera:
    """Interior orientation of a frame or fisheye camera.

    ``distortion`` are the parameters of one of `DISTORTION_MODELS`; their type gives the model.
    """

    width_px: int  # format of the image
    height_px: int
    fx_px: float  # principal distance
    fy_px: float
    cx_px: float  # principal point
    cy_px: float
    distortion: Any = NO_DISTORTION

    @property
    def constants(self) -> CameraConstants:
        """The camera as a tuple of floats for compiled functions."""
        parameters = [float(number) for number in self.distortion]
        return CameraConstants(
            width=float(self.width_px),
            height=float(self.height_px),
            fx=float(self.fx_px),
            fy=float(self.fy_px),
            cx=float(self.cx_px),
            cy=float(self.cy_px),
            largest_radius=self.largest_radius,
            distortion=type(self.distortion)(*parameters),
        )

    @cached_property
    def largest_radius(self) -> float:
        """Ideal radius (tan of the field angle) up to which the distortion can be inverted."""
        return float(model_of(type(self.distortion)).largest_radius(self.distortion))

    def distort(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Distorted image coordinates of ideal ones, both in units of the principal distance."""
        u_d, v_d = model_of(type(self.distortion)).distort(u, v, self.distortion)
        return u_d, v_d

    def rays(self, x_px: Array, y_px: Array) -> tuple[Array, Array, Mask]:
        """Ideal image coordinates u, v (n,) of pixels (n,), and a mask (n,) of covered pixels.

        The ray of a pixel is (u, v, 1) in the frame of the camera. A pixel outside the format, or
        beyond the radius to which the distortion can be inverted, is not covered: u and v are NaN.
        By Newton's iteration, to 1e-14 in u and v.

        >>> camera = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0, BrownConrady(k1=-0.1))
        >>> u, v, covered = camera.rays(np.array([500.0, 950.0]), np.array([400.0, 400.0]))
        >>> camera.project(u, v)[0].round(9).tolist(), covered.tolist()
        ([500.0, 950.0], [True, True])
        """
        from unbend.refraction.kernels.outgoing import rays_of_pixels

        x = np.ascontiguousarray(x_px, np.float64)
        y = np.ascontiguousarray(y_px, np.float64)
        rays = np.empty((RAY_ROWS, x.size))
        rays_of_pixels(x, y, self.constants, rays)
        return rays[IDEAL_U], rays[IDEAL_V], np.isfinite(rays[IDEAL_U])

    def project(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixels x, y (n,) of ideal image coordinates u, v (n,); without a check of the format."""
        u_d, v_d = self.distort(u, v)
        return self.fx_px * u_d + self.cx_px, self.fy_px * v_d + self.cy_px


@dataclass(frozen=True)
class LensInAir:
    """A lens with measured derivatives of its principal distance by the air between the elements.

    ``principal_distance_px`` was calibrated at ``reference_pressure_pa`` and
    ``reference_temperature_k``; ``px_per_pa`` and ``px_per_k`` are its derivatives.
    """

    principal_distance_px: float
    reference_pressure_pa: float
    reference_temperature_k: float
    px_per_pa: float
    px_per_k: float


def principal_change(lens: LensInAir, pressure_pa: ArrayLike, temperature_k: ArrayLike) -> Array:
    """Change [px] of a calibrated principal distance by the air in the lens.

    ``pressure_pa``, ``temperature_k`` of the air in the lens broadcast; NaN gives NaN.
    Linear: dc = dc/dp (p - p_ref) + dc/dT (T - T_ref). As good as the derivatives, which have to be
    measured for each type of lens. Meier (Zeiss) found on a 153 mm lens at 6 km -0.020 mm behind a
    pressurised window and -0.036 to -0.047 mm without one: 130 to 310 ppm, which at 45 degrees
    moves a point more than the refraction of the air outside does.

    >>> lens = LensInAir(20000.0, 101325.0, 293.15, px_per_pa=8.4e-5, px_per_k=0.004)
    >>> principal_change(lens, [101325.0, 47181.0], [293.15, 249.19]).round(3).tolist()
    [0.0, -4.724]
    """
    rise_pa = np.asarray(pressure_pa, np.float64) - lens.reference_pressure_pa
    warming_k = np.asarray(temperature_k, np.float64) - lens.reference_temperature_k
    return np.asarray(lens.px_per_pa * rise_pa + lens.px_per_k * warming_k)


def is_impossible_change(lens: LensInAir, change_px: ArrayLike) -> Mask:
    """Whether changes of the principal distance [px] are larger than any air causes.

    The limit is `LARGEST_CHANGE`. NaN is not larger.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(change_px) > LARGEST_CHANGE * lens.principal_distance_px)
