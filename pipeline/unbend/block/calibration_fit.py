"""The change of an interior orientation that does to image points what a correction does.

A program that takes image points as measured, refraction in, finds the straight rays all the same
where its camera is not the calibrated one, but one that sees the straight ray to a point where the
air makes the calibrated one see it. Over one flying height that is nearly a frame camera: with
R = K tan(zeta), straight down, f (1 + K) and k1 + K.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.refraction.camera.camera import Camera
from unbend.units import Array

FEW = ("f", "k1")
"""What refraction changes in a camera that looks straight down."""

FULL = ("f", "cx", "cy", "b1", "skew_x", "k1", "k2", "k3", "p1", "p2", "px", "py")
"""What it may change in any camera; a camera model has some of them. b1 is fx over fy less one."""

CORRECTIONS = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
"""The unknowns of `correction_change`; ``c`` and k1 are `FEW` of them."""

STEP = 1e-6  # for derivatives of pixels by parameters
ROUNDS = 3  # a change is 1e-4: linear to 1e-8, of which the second round leaves none
SMALLEST_SINGULAR = 1e-10  # of the largest: unknowns that are all but the same share what they do
Y_UP = np.array([1.0, -1.0])  # from y down to y up, and back


@dataclass(frozen=True, eq=False)
class SeenRays:
    """Straight rays (n, 2), their tangents right and down, and the pixels (n, 2) they are seen at.

    ``measured_px`` have refraction in and are COLMAP's; ``weight`` (n,) is 1 or what a row is
    worth against others.
    """

    straight: Array
    measured_px: Array
    weight: Array

    def left_px(self, camera: Camera) -> Array:
        """(n, 2) pixels in which a camera would see the straight rays, less those measured."""
        seen_px = np.stack(camera.project(*self.straight.T), axis=1)
        return seen_px - self.measured_px


def changed_camera(camera: Camera, rays: SeenRays, names: Sequence[str] = FULL) -> Camera:
    """The camera whose named parameters make it see straight rays where they were measured.

    Weighted least squares in the image; ``names`` are those of `FULL`, of which the camera's model
    may lack some. The change of f is that of fx and fy alike. Of exact rays of such a camera the
    result is that camera, to 1e-9 px.

    >>> tangents = np.stack(np.meshgrid([-0.3, -0.1, 0.2], [-0.2, 0.1, 0.25]), -1).reshape(-1, 2)
    >>> pixels = 1000.0 * (1.0 + 5e-5) * tangents + [500.0, 400.0]
    >>> seen = SeenRays(tangents, pixels, np.ones(9))
    >>> round(changed_camera(Camera(1000, 800, 1e3, 1e3, 500.0, 400.0), seen, FEW).fx_px, 9)
    1000.05
    """
    possible = {"f", "cx", "cy", "b1", *camera.distortion._fields}
    free = [name for name in names if name in possible]
    values = np.zeros(len(free))
    weight = np.repeat(np.sqrt(rays.weight), 2)
    for _ in range(ROUNDS):
        moved = moved_camera(camera, free, values)
        left = rays.left_px(moved).ravel()
        slopes = []
        for unit in np.eye(len(free)):
            nearby = moved_camera(camera, free, values + STEP * unit)
            change = rays.left_px(nearby).ravel() - left
            slopes.append(change / STEP)
        design = np.stack(slopes, axis=1)
        values = values - least_squares(design, left, weight)
    return moved_camera(camera, free, values)


def moved_camera(camera: Camera, names: Sequence[str], values: Array) -> Camera:
    """A camera whose named parameters are changed by values: f by a share, cx and cy by f."""
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
    """What is added to a calibration by which measured image coordinates are corrected.

    With x, y measured less the principal point in units of the principal distance c, x to the
    right, y up and r^2 = x^2 + y^2, added to them are, beside what the calibration adds,

        dx = -x0 + x (k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 x^2) + 2 p2 x y + b1 x + b2 y,
        dy = -y0 + y (k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 y^2),

    and the ray is that to the principal distance c (1 + ``c``). In units of length L of the image
    k1 is k1 / c^2, p1 is p1 / c.
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
        """(n,) what is added to radii (n,), in their unit, the principal distance."""
        r2 = r**2
        by_r3 = self.k1 + r2 * (self.k2 + r2 * self.k3)
        return r**3 * by_r3


def correction_change(
    camera: Camera, rays: SeenRays, names: Sequence[str] = CORRECTIONS
) -> tuple[CorrectionChange, Array]:
    """The change of a calibration that corrects measured points, and what it leaves (n, 2) [px].

    Linear least squares: what a calibrated camera makes of its measured points, plus the change,
    is 1 + c times the tangents of the straight rays. Holds for whatever the lens itself does.
    """
    u, v, _ = camera.rays(*rays.measured_px.T)
    focal_px = np.array([camera.fx_px, camera.fy_px])
    centre_px = np.array([camera.cx_px, camera.cy_px])
    measured = (rays.measured_px - centre_px) / focal_px * Y_UP
    straight = rays.straight * Y_UP
    terms = terms_of_correction(measured, straight)
    design = np.stack([terms[name].ravel() for name in names], axis=1)
    wanted = (straight - columns(u, -v)).ravel()
    weight = np.repeat(np.sqrt(rays.weight), 2)
    values = least_squares(design, wanted, weight)
    left = (design @ values - wanted).reshape(-1, 2)
    change = dict(zip(names, values.tolist(), strict=True))
    return CorrectionChange(**change), left * focal_px * Y_UP


def terms_of_correction(measured: Array, straight: Array) -> dict[str, Array]:
    """(n, 2) what a unit of each unknown of `CORRECTIONS` adds to x and y, y up."""
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
    """(n, 2) of both."""
    return np.stack([x, y], axis=1)


def least_squares(design: Array, wanted: Array, weight: Array) -> Array:
    """(k,) unknowns; those that are all but the same for these rows share what they explain."""
    weighted = design * weight[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    solution = np.linalg.lstsq(weighted / scale, wanted * weight, rcond=SMALLEST_SINGULAR)
    scaled_values = solution[0]
    return np.asarray(scaled_values / scale)
