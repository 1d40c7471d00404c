"""Metric frame cameras: a calibration report in millimetres becomes a camera in pixels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import PhysicsError
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.general_frame import GeneralFrame

Array = NDArray[np.float64]

DIRECTIONS = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "down": (0.0, 1.0), "up": (0.0, -1.0)}
"""In the image, x to the right and y down."""

SENSES = {"distortion": 1.0, "correction": -1.0}
"""What the lens does to ideal coordinates, or what is added to measured ones."""

LARGEST_DISAGREEMENT_MM = 0.002
"""Farther than this the coefficients and the table of one report do not mean the same lens."""

LARGEST_OFFSET = 0.25
"""Part of the format by which no principal point of a metric camera is off its centre."""


def metric_camera(
    size_px: tuple[int, int],
    focal_mm: float,
    *,
    pixel_mm: ArrayLike,
    format_mm: ArrayLike,
    origin_px: ArrayLike,
    axes: str,
    ppa_mm: ArrayLike,
    ppbs_mm: ArrayLike,
    coefficients: Mapping[str, float],
    sense: str = "distortion",
    table: tuple[ArrayLike, str] | None = None,
    radius_mm: float = np.inf,
) -> Camera:
    """The camera of a report: projection from the PPA, distortion about the PPBS.

    Pairs are (across, down) or (x, y); ``origin_px`` is where millimetres count from, in COLMAP's
    pixels, ``axes`` the directions of x and y, as ``right up``. ``coefficients`` [powers of mm]:
    dr = r (k0 + k1 r^2 + ... k4 r^8), dx = p1 (r^2 + 2 x^2) + 2 p2 x y, dx = b1 x + b2 y;
    ``table`` (n, 2) radius and dr [mm] with its sense. Calibrated to ``radius_mm`` about the PPBS,
    or the end of the table. Refuses (PhysicsError) pixels that do not fill the format
    (CAMERA-FORMAT), a principal point far from the centre (CAMERA-PRINCIPAL-POINT), a table that
    contradicts the coefficients, or without these a polynomial (CAMERA-REPORT).
    """
    size, pixel, c = np.array(size_px), np.asarray(pixel_mm), focal_mm
    part = size * pixel / format_mm
    if not (part.min() > 0.95 and part.max() < 1.15):
        raise PhysicsError(
            "CAMERA-FORMAT",
            f"{size[0]} x {size[1]} pixels of {pixel[0] * 1e3:g} x {pixel[1] * 1e3:g} um fill "
            f"{part[0]:.3f} of the width and {part[1]:.3f} of the height of the format",
            remedy="check pixel_um, format_mm, and that width and height are not exchanged",
        )
    to_image = np.array([DIRECTIONS[axis] for axis in axes.split()]).T
    point = np.asarray(origin_px) + to_image @ ppa_mm / pixel
    off = np.abs(point / size - 0.5).max()
    if off > LARGEST_OFFSET:
        raise PhysicsError(
            "CAMERA-PRINCIPAL-POINT",
            f"the principal point lies {100.0 * off:.0f} % of the format from its centre",
            remedy="ppa_mm counts from origin along axes, in millimetres; give the pixel of the "
            "corner as origin where it counts from there",
        )
    sign, given = SENSES[sense], coefficients.get
    known = np.array([given(f"k{i}", 0.0) for i in range(5)])
    if table is not None:
        r, dr = np.asarray(table[0], np.float64).T
        # To first order a correction is the distortion with the other sign.
        known = _agreed(known, r, dr * SENSES[table[1]] * sign)
        radius_mm = min(radius_mm, r[-1])
    offset = to_image @ np.subtract(ppa_mm, ppbs_mm) / c
    px, py = to_image @ (given("p1", 0.0), given("p2", 0.0)) * c
    stretch = [[1.0 + given("b1", 0.0), given("b2", 0.0)], [0.0, 1.0]]
    affine = to_image @ (stretch if sign > 0.0 else np.linalg.inv(stretch)) @ to_image.T
    # Slope of a correction in the corners, and so many steps that it is inverted to 1e-17.
    corner = 0.6 * np.hypot(*size * pixel) * np.linspace(0.0, 1.0, 50)[:, None]
    slope = np.abs((known * np.arange(1, 10, 2) * corner ** np.arange(0, 10, 2)).sum(axis=1)).max()
    slope += 6.0 * (abs(given("p1", 0.0)) + abs(given("p2", 0.0))) * corner[-1, 0]
    steps = np.ceil(np.log(1e-17) / np.log(np.clip(slope, 1e-9, 0.27)))
    numbers = (
        *known * c ** np.arange(0, 10, 2), 0.0, 0.0, 0.0, px, py, *offset,
        affine[0, 1] / affine[0, 0], affine[1, 0] / affine[1, 1], sign,
        min(radius_mm / c - np.hypot(*offset), 1e9), steps,
    )  # fmt: skip
    fx, fy, cx, cy = map(float, (*c / pixel * affine.diagonal(), *point))
    return Camera(*size_px, fx, fy, cx, cy, GeneralFrame(*map(float, numbers)))


def _agreed(known: Array, r: Array, wanted: Array) -> Array:
    """(5,) k0 to k4, fitted where all are zero, once they agree with the table."""
    powers, fitted = r[:, None] ** np.arange(1, 10, 2), not known.any()
    if fitted:
        terms, scale = min(5, max(1, np.count_nonzero(r) - 1)), r[-1] ** np.arange(1, 10, 2)
        known[:terms] = np.linalg.lstsq((powers / scale)[:, :terms], wanted, rcond=None)[0]
        known = known / scale
    apart = np.abs(powers @ known - wanted)
    if not apart.max() <= LARGEST_DISAGREEMENT_MM:
        raise PhysicsError(
            "CAMERA-REPORT",
            f"the table and {'a polynomial' if fitted else 'the coefficients'} differ by "
            f"{apart.max() * 1e3:.1f} um at a radius of {r[apart.argmax()]:.1f} mm",
            remedy="check distortion.sense and table.sense (reports of the USGS have coefficients "
            "that correct and a table of the distortion), powers of ten, units, and that both are "
            "for one principal distance",
        )
    return known
