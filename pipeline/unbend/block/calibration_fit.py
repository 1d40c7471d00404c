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

_STEP, _ROUNDS = 1e-6, 3  # a change is 1e-4: linear to 1e-8, of which the second round leaves none


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
        return np.stack(camera.project(*self.straight.T), axis=1) - self.measured_px


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
    known = {"f", "cx", "cy", "b1", *camera.distortion._fields}
    names = [name for name in names if name in known]

    def moved(values: Array) -> Camera:
        of = dict(zip(names, values.tolist(), strict=True))
        f, b1 = 1.0 + of.pop("f", 0.0), 1.0 + of.pop("b1", 0.0)
        cx, cy = (start + camera.fx_px * of.pop(name, 0.0)
                  for name, start in (("cx", camera.cx_px), ("cy", camera.cy_px)))  # fmt: skip
        lens = {name: getattr(camera.distortion, name) + value for name, value in of.items()}
        return replace(
            camera, fx_px=camera.fx_px * f * b1, fy_px=camera.fy_px * f, cx_px=cx, cy_px=cy,
            distortion=camera.distortion._replace(**lens),
        )  # fmt: skip

    values, weight = np.zeros(len(names)), np.repeat(np.sqrt(rays.weight), 2)
    for _ in range(_ROUNDS):
        now = rays.left_px(moved(values)).ravel()
        slopes = [
            (rays.left_px(moved(values + _STEP * unit)).ravel() - now) / _STEP
            for unit in np.eye(len(names))
        ]
        values = values - _least_squares(np.stack(slopes, axis=1), now, weight)
    return moved(values)


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
        return r**3 * (self.k1 + r**2 * (self.k2 + r**2 * self.k3))


def correction_change(
    camera: Camera, rays: SeenRays, names: Sequence[str] = CORRECTIONS
) -> tuple[CorrectionChange, Array]:
    """The change of a calibration that corrects measured points, and what it leaves (n, 2) [px].

    Linear least squares: what a calibrated camera makes of its measured points, plus the change,
    is 1 + c times the tangents of the straight rays. Holds for whatever the lens itself does.
    """
    u, v, _ = camera.rays(*rays.measured_px.T)
    frame = np.array([camera.fx_px, camera.fy_px])
    x, y = ((rays.measured_px - [camera.cx_px, camera.cy_px]) / frame * [1.0, -1.0]).T
    straight = rays.straight * [1.0, -1.0]
    r2, zero, one = x * x + y * y, np.zeros(x.size), np.ones(x.size)
    terms = {
        "c": (-straight[:, 0], -straight[:, 1]), "x0": (-one, zero), "y0": (zero, -one),
        "k1": (x * r2, y * r2), "k2": (x * r2**2, y * r2**2), "k3": (x * r2**3, y * r2**3),
        "p1": (r2 + 2.0 * x * x, 2.0 * x * y), "p2": (2.0 * x * y, r2 + 2.0 * y * y),
        "b1": (x, zero), "b2": (y, zero),
    }  # fmt: skip
    design = np.stack([np.stack(terms[name], axis=1).ravel() for name in names], axis=1)
    wanted = (straight - np.stack([u, -v], axis=1)).ravel()
    values = _least_squares(design, wanted, np.repeat(np.sqrt(rays.weight), 2))
    left = (design @ values - wanted).reshape(-1, 2) * frame * [1.0, -1.0]
    return CorrectionChange(**dict(zip(names, values.tolist(), strict=True))), left


def _least_squares(design: Array, wanted: Array, weight: Array) -> Array:
    """(k,) unknowns; those that are all but the same for these rows share what they explain."""
    scale = np.linalg.norm(design * weight[:, None], axis=0)
    scaled = design * weight[:, None] / scale
    return np.asarray(np.linalg.lstsq(scaled, wanted * weight, rcond=1e-10)[0] / scale)
