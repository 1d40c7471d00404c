"""Image observations: from measured pixels to the pixels of the straight chord.

The exact vector form; Gyer's Eq. 40-51 are its scalar twin (with the plus sign in Eq. 50, 51 that
the paper prints as a minus).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geodesy import principal_radii
from pipeline.refraction._threads import in_blocks
from pipeline.refraction.camera import Camera
from pipeline.refraction.ray import PublishedRays, RayTable, bend
from pipeline.refraction.status import OK, STATUS_NAMES
from pipeline.refraction.window import OPTICAL_AXIS

Array = NDArray[np.float64]

# Rows of an image that follow each other on the average, below which it pays to sort them.
_ROWS_OF_AN_IMAGE = 50


@dataclass(frozen=True, eq=False)
class Exposures:
    """What the correction needs to know of each exposure; (s,) arrays.

    ``usable`` is False where an exposure has no position, attitude or cabin air;
    ``rotation`` (s, 3, 3) takes east-north-up to camera; ``refractivity_outside`` and
    ``refractivity_cabin`` are n - 1 on the two sides of the window (equal where nothing bends
    there); ``window_normal`` (s, 3) are unit vectors out of the window in the camera frame, by
    default the optical axis; ``principal_change_px`` is what the air in the lens adds to the
    calibrated principal distance, by default nothing;
    ``radius_m`` replaces the ellipsoid's radius in the ray's azimuth when it is given.
    """

    usable: NDArray[np.bool_]
    rotation: Array
    latitude_rad: Array
    height_m: Array
    refractivity_outside: Array
    refractivity_cabin: Array
    window_normal: Array | None = None
    principal_change_px: Array | None = None
    radius_m: float | None = None


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrected observations; (n,) arrays, NaN where ``status`` says there is no correction.

    ``shift_ground_m`` is the horizontal displacement, at the target's height, of the point where
    the uncorrected straight ray would land.
    """

    dx_px: Array
    dy_px: Array
    x_px: Array
    y_px: Array
    zeta_c_rad: Array
    r_c_rad: Array
    r_cc_rad: Array
    shift_ground_m: Array
    status: NDArray[np.uint8]

    def rows(self, which: NDArray[np.intp]) -> Corrections:
        """Some of the rows."""
        return Corrections(*(getattr(self, field.name)[which] for field in fields(self)))

    def to_pandas(self) -> Any:
        """The corrections as a pandas DataFrame, status in words."""
        import pandas as pd

        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        return pd.DataFrame(columns | {"status": np.array(STATUS_NAMES)[self.status]})


def correct_observations(
    x_px: Array,
    y_px: Array,
    h_g: Array,
    exposure: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
    *,
    distance_m: Array | None = None,
) -> Corrections:
    """Remove compartment and atmospheric refraction from image observations of one camera.

    Parameters
    ----------
    x_px, y_px : (n,) measured, distorted pixels.
    h_g : (n,) heights of the targets above sea level [m].
    exposure : (n,) rows of ``exposures``, -1 where the image has none.
    camera : interior orientation; corrected pixels are distorted again.
    table : the air outside and how rays bend in it, from `rays_by`.
    distance_m : (n,) slant ranges [m], NaN where unknown; see `bend`.

    The change of direction is never a difference of directions; the shift (dx, dy) is good to
    1e-10 px, whatever the size of the pixel coordinates. Rows of one exposure that follow each
    other are fastest.
    """
    order = _by_exposure(exposure)
    if order is not None:
        found = correct_observations(
            x_px[order], y_px[order], h_g[order], exposure[order], exposures, camera, table,
            distance_m=None if distance_m is None else distance_m[order],
        )  # fmt: skip
        return found.rows(np.argsort(order))
    n = x_px.size
    columns = {name: np.empty(n) for name in _COLUMNS}
    status = np.empty(n, np.uint8)
    observed = (x_px, y_px, h_g, exposure, np.full(n, np.nan) if distance_m is None else distance_m)
    constants = _Constants.of(exposures, camera)

    def some(rows: slice) -> None:
        part = {name: values[rows] for name, values in columns.items()}
        _correct_block([a[rows] for a in observed], constants, table, part, status[rows])

    in_blocks(some, n)
    return Corrections(status=status, **columns)


_COLUMNS = tuple(field.name for field in fields(Corrections) if field.name != "status")


@dataclass(frozen=True, eq=False)
class _Constants:
    """Exposures and camera in the form the kernels take."""

    camera: tuple[float, ...]
    usable: NDArray[np.bool_]
    rotation: Array
    curvature: Array
    air: tuple[Array, ...]
    change: Array

    @classmethod
    def of(cls, exposures: Exposures, camera: Camera) -> _Constants:
        if exposures.radius_m is None:
            radii = principal_radii(exposures.latitude_rad)
            curvature = 1.0 / np.stack(radii, axis=1)
        else:
            curvature = np.full((exposures.usable.size, 2), 1.0 / exposures.radius_m)
        count = exposures.usable.size
        normal, change = exposures.window_normal, exposures.principal_change_px
        air = (
            exposures.height_m,
            exposures.refractivity_outside,
            exposures.refractivity_cabin,
            np.tile(OPTICAL_AXIS, (count, 1)) if normal is None else normal,
        )
        return cls(
            camera.numbers,
            exposures.usable,
            exposures.rotation,
            curvature,
            air,
            np.zeros(count) if change is None else change,
        )


def _correct_block(
    observed: list[Any],
    constants: _Constants,
    table: RayTable | PublishedRays,
    columns: dict[str, Array],
    status: NDArray[np.uint8],
) -> None:
    """Pixels to rays, rays through the air, and back; fills ``columns`` and ``status``."""
    # The compiled functions are imported with the first ray, not with the package.
    from pipeline.refraction import _image_kernel as kernel

    x, y, h_g, exposure, distance = observed
    rays = np.empty((kernel.COLUMNS, x.size))
    k = constants
    kernel.look_out(
        x, y, h_g, exposure, k.camera, k.usable, k.rotation, k.curvature, *k.air, k.change, rays,
        columns["r_cc_rad"], status,
    )  # fmt: skip
    sine, cosine = rays[kernel.SIN], rays[kernel.COS]
    r_c, ray_status = bend(
        table, rays[kernel.H_C], h_g, sine, cosine, rays[kernel.RADIUS], distance
    )
    traced = status == OK
    status[traced] = ray_status[traced]
    columns["r_c_rad"][:] = r_c
    columns["zeta_c_rad"][:] = np.arctan2(sine, cosine)
    kernel.shift_back(
        x, y, h_g, exposure, k.camera, k.rotation, k.change, rays, r_c, status,
        columns["dx_px"], columns["dy_px"], columns["shift_ground_m"],
    )  # fmt: skip
    columns["x_px"][:] = x + columns["dx_px"]
    columns["y_px"][:] = y + columns["dy_px"]


def _by_exposure(exposure: NDArray[np.int64]) -> NDArray[np.intp] | None:
    """The order that brings rows of one exposure together; None where they are."""
    changes = int(np.count_nonzero(np.diff(exposure)))
    if changes * _ROWS_OF_AN_IMAGE <= exposure.size or bool(np.all(np.diff(exposure) >= 0)):
        return None
    return np.argsort(exposure, kind="stable")


def landing_point(direction: Array, h_c: Array, h_g: Array, radius: Array) -> Array:
    """Where straight rays first reach a height, from the camera: (n, 3) east, north, up [m].

    ``direction`` (n, 3) unit vectors; NaN where the line never gets there.
    """
    r_c, r_g = radius + h_c, radius + h_g
    cos_z = -direction[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.sqrt((r_c * cos_z) ** 2 - (h_c - h_g) * (r_c + r_g))
        # Downwards the nearer of two crossings, upwards the only one.
        distance = np.where(
            h_c >= h_g,
            (h_c - h_g) * (r_c + r_g) / (r_c * cos_z + q),
            r_c * cos_z + q,
        )
        distance = np.where(h_c == h_g, 0.0, distance)
        distance = np.where(distance >= 0.0, distance, np.nan)
    return np.asarray(direction * distance[:, None])


def ground_displacement(h_c: float, h_g: float, zeta_c: float, r_c: float, radius: float) -> float:
    """How far [m] a refraction angle moves the point where a straight ray reaches a height.

    >>> round(ground_displacement(10000.0, 0.0, 0.7853981633974483, 7.94e-5, 6371000.0), 3)
    1.592
    """
    angle = np.array([zeta_c, zeta_c - r_c])
    rays = np.stack([np.sin(angle), np.zeros(2), -np.cos(angle)], axis=1)
    ones = np.ones(2)
    apparent, true = landing_point(rays, h_c * ones, h_g * ones, radius * ones)
    return float(np.linalg.norm(apparent - true))
