"""Fit a camera that has refraction in its interior orientation.

The fitted camera sees the straight ray to a point at the pixel where the calibrated camera measured
the point through the air. A program that uses it with uncorrected image points gets straight rays.
For one flying height it is nearly a frame camera: with refraction R = K tan(zeta), looking straight
down, it has f (1 + K) and k1 + K.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.refraction.camera.camera import Camera
from unbend.units import Array

NADIR_PARAMETERS = ("f", "k1")
"""Parameters that refraction changes in a camera that looks straight down."""

ALL_PARAMETERS = ("f", "cx", "cy", "b1", "skew_x", "k1", "k2", "k3", "p1", "p2", "px", "py")
"""Parameters that it may change in any camera; a model has some of them. b1 is fx / fy - 1."""

CORRECTION_TERMS = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
"""The unknowns of `correction_change`; c and k1 correspond to `NADIR_PARAMETERS`."""

STEP = 1e-6  # of a parameter, for derivatives of pixels
ROUNDS = 3  # changes are about 1e-4: one round is linear to 1e-8, two are exact to rounding
SMALLEST_SINGULAR = 1e-10  # of the largest singular value: unknowns with equal effects share it
Y_UP = np.array([1.0, -1.0])  # factor of (x, y) from y down to y up, and back


@dataclass(frozen=True, eq=False)
class SeenRays:
    """Straight rays, and the pixels where a camera measured their points through the air."""

    straight: Array  # (n, 2) tangents to the right and down
    measured_px: Array  # (n, 2) in COLMAP's pixels
    weight: Array  # (n,) weights of the rows in the fit

    def residual_px(self, camera: Camera) -> Array:
        """(n, 2) pixels at which a camera would see the straight rays, minus the measured ones."""
        seen_px = np.stack(camera.project(*self.straight.T), axis=1)
        return seen_px - self.measured_px


def fitted_camera(camera: Camera, rays: SeenRays, names: Sequence[str] = ALL_PARAMETERS) -> Camera:
    """A camera with parameters fitted so that it sees straight rays where they were measured.

    Weighted least squares in the image. ``names`` are the fitted ones of `ALL_PARAMETERS`; those
    that the camera's model lacks are left out. fx and fy change by one factor, f. Exact rays of
    such a camera give it back to 1e-9 px.

    >>> tangents = np.stack(np.meshgrid([-0.3, -0.1, 0.2], [-0.2, 0.1, 0.25]), -1).reshape(-1, 2)
    >>> pixels = 1000.0 * (1.0 + 5e-5) * tangents + [500.0, 400.0]
    >>> seen = SeenRays(tangents, pixels, np.ones(9))
    >>> calibrated = Camera(1000, 800, 1e3, 1e3, 500.0, 400.0)
    >>> round(fitted_camera(calibrated, seen, NADIR_PARAMETERS).fx_px, 9)
    1000.05
    """
    possible = {"f", "cx", "cy", "b1", *camera.distortion._fields}
    free = [name for name in names if name in possible]
    values = np.zeros(len(free))
    weight = np.repeat(np.sqrt(rays.weight), 2)
    for _ in range(ROUNDS):
        current = with_changes(camera, free, values)
        residual = rays.residual_px(current).ravel()
        slopes = []
        for unit in np.eye(len(free)):
            nearby = with_changes(camera, free, values + STEP * unit)
            change = rays.residual_px(nearby).ravel() - residual
            slopes.append(change / STEP)
        design = np.stack(slopes, axis=1)
        values = values - least_squares(design, residual, weight)
    return with_changes(camera, free, values)


def with_changes(camera: Camera, names: Sequence[str], values: Array) -> Camera:
    """The camera with the named parameters changed by ``values``.

    f and b1 are relative changes (b1 of fx alone), cx and cy count in units of fx, and coefficients
    of distortion are added.
    """
    changes = dict(zip(names, values.tolist(), strict=True))
    scale = 1.0 + changes.pop("f", 0.0)
    aspect = 1.0 + changes.pop("b1", 0.0)
    cx_px = camera.cx_px + camera.fx_px * changes.pop("cx", 0.0)
    cy_px = camera.cy_px + camera.fx_px * changes.pop("cy", 0.0)
    coefficients = {}
    for name, change in changes.items():
        coefficients[name] = getattr(camera.distortion, name) + change
    return replace(
        camera,
        fx_px=camera.fx_px * scale * aspect,
        fy_px=camera.fy_px * scale,
        cx_px=cx_px,
        cy_px=cy_px,
        distortion=camera.distortion._replace(**coefficients),
    )


@dataclass(frozen=True)
class CorrectionChange:
    """Change of a calibration that is a correction of measured image coordinates.

    x, y are measured coordinates minus the principal point in units of the principal distance c, x
    to the right, y up, and r^2 = x^2 + y^2. In addition to the correction of the calibration, the
    change adds to them

        dx = -x0 + x (k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 x^2) + 2 p2 x y + b1 x + b2 y,
        dy = -y0 + y (k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 y^2),

    and the principal distance of the ray is c (1 + ``c``). For coordinates in millimetres divide k1
    by c^2, k2 by c^4, k3 by c^6, and p1 and p2 by c.
    """

    c: float = 0.0
    x0: float = 0.0
    y0: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    b1: float = 0.0
    b2: float = 0.0

    def radial(self, r: Array) -> Array:
        """(n,) radial part of the correction at radii (n,), both in units of c."""
        r2 = r**2
        by_r3 = self.k1 + r2 * (self.k2 + r2 * self.k3)
        return r**3 * by_r3


def correction_change(
    camera: Camera, rays: SeenRays, names: Sequence[str] = CORRECTION_TERMS
) -> tuple[CorrectionChange, Array]:
    """Fit the change of a calibration that removes refraction from measured points.

    Linear least squares: the rays of the calibrated camera through its measured points, plus the
    change, are 1 + c times the tangents of the straight rays. True for any model of the lens.
    Returns the change and the residuals (n, 2) [px].
    """
    u, v, _ = camera.rays(*rays.measured_px.T)
    focal_px = np.array([camera.fx_px, camera.fy_px])
    centre_px = np.array([camera.cx_px, camera.cy_px])
    measured = (rays.measured_px - centre_px) / focal_px * Y_UP
    straight = rays.straight * Y_UP
    terms = terms_of_correction(measured, straight)
    design = np.stack([terms[name].ravel() for name in names], axis=1)
    target = (straight - columns(u, -v)).ravel()
    weight = np.repeat(np.sqrt(rays.weight), 2)
    values = least_squares(design, target, weight)
    residual = (design @ values - target).reshape(-1, 2)
    change = dict(zip(names, values.tolist(), strict=True))
    return CorrectionChange(**change), residual * focal_px * Y_UP


def terms_of_correction(measured: Array, straight: Array) -> dict[str, Array]:
    """(n, 2) change of x and y by a unit of each of `CORRECTION_TERMS`, by the term.

    ``measured`` and ``straight`` are (n, 2) in units of the principal distance, y up.
    """
    x, y = measured.T
    zero = np.zeros(x.size)
    unit = np.ones(x.size)
    r2 = x * x + y * y
    xy = 2.0 * x * y
    return {
        "c": -straight,
        "x0": columns(-unit, zero),
        "y0": columns(zero, -unit),
        "k1": columns(x * r2, y * r2),
        "k2": columns(x * r2**2, y * r2**2),
        "k3": columns(x * r2**3, y * r2**3),
        "p1": columns(r2 + 2.0 * x * x, xy),
        "p2": columns(xy, r2 + 2.0 * y * y),
        "b1": columns(x, zero),
        "b2": columns(y, zero),
    }


def columns(x: Array, y: Array) -> Array:
    """(n, 2) array with the columns x and y."""
    return np.stack([x, y], axis=1)


def least_squares(design: Array, target: Array, weight: Array) -> Array:
    """(k,) solution of weighted least squares, ``design`` (n, k) times it near ``target`` (n,).

    ``weight`` (n,) multiplies the rows. Unknowns with nearly equal columns share their effect.
    """
    weighted = design * weight[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    solution = np.linalg.lstsq(weighted / scale, target * weight, rcond=SMALLEST_SINGULAR)
    scaled_values = solution[0]
    return np.asarray(scaled_values / scale)
