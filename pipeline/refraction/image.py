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
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.kernels.threads import in_blocks
from pipeline.refraction.ray import PublishedRays, RayTable, bend
from pipeline.refraction.status import OK, STATUS_NAMES
from pipeline.refraction.uncertainty.sigmas import Sigmas, Solved, Uncertainty
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

    @property
    def normals(self) -> Array:
        """(s, 3) normals of the windows."""
        if self.window_normal is None:
            return np.tile(OPTICAL_AXIS, (self.usable.size, 1))
        return self.window_normal

    @property
    def changes_px(self) -> Array:
        """(s,) what is added to the principal distance."""
        if self.principal_change_px is None:
            return np.zeros(self.usable.size)
        return self.principal_change_px


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrected observations, with ``sigmas`` where they were asked for.

    Arrays (n,), NaN where ``status`` says there is no correction.

    ``shift_ground_m`` is the horizontal displacement, at the target's height, of the point where
    the uncorrected straight ray would land. It is also NaN where that ray passes over the horizon
    and only the bent one lands: the last 0.2 degree of nadir angle from 10 km above sea level.
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
    sigmas: Sigmas | None = None

    def rows(self, which: NDArray[np.intp]) -> Corrections:
        """Some of the rows."""
        columns: dict[str, Any] = {name: getattr(self, name)[which] for name in COLUMNS}
        sigmas = None if self.sigmas is None else self.sigmas.rows(which)
        return Corrections(**columns, status=self.status[which], sigmas=sigmas)

    def to_pandas(self) -> Any:
        """The corrections as a pandas DataFrame, status in words."""
        import pandas as pd

        columns = {name: getattr(self, name) for name in COLUMNS}
        if self.sigmas is not None:
            columns |= {f"sigma_{name}": v for name, v in self.sigmas.columns().items()}
        return pd.DataFrame(columns | {"status": np.array(STATUS_NAMES)[self.status]})


COLUMNS = tuple(f.name for f in fields(Corrections) if f.name not in ("status", "sigmas"))
"""The columns of numbers of `Corrections`, in its order."""


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
    uncertainty: Uncertainty | None = None,
    sigma_h_g: Array | None = None,
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
    uncertainty : asks for ``sigmas``, from `uncertainty_of`; sigma_h_g (n,) that of ``h_g`` [m].

    The change of direction is never a difference of directions; the shift (dx, dy) is good to
    1e-10 px, whatever the size of the pixel coordinates. Rows of one exposure that follow each
    other are fastest.
    """
    order = _by_exposure(exposure)
    if order is not None:
        found = correct_observations(
            x_px[order], y_px[order], h_g[order], exposure[order], exposures, camera, table,
            distance_m=None if distance_m is None else distance_m[order],
            uncertainty=uncertainty,
            sigma_h_g=None if sigma_h_g is None else sigma_h_g[order],
        )  # fmt: skip
        return found.rows(np.argsort(order))
    n = x_px.size
    # In one piece: the system hands large ones out in large pages, which take less time.
    columns = dict(zip(COLUMNS, np.empty((len(COLUMNS), n)), strict=True))
    status = np.empty(n, np.uint8)
    sigmas = None if uncertainty is None else Sigmas.room(n)
    unknown = np.broadcast_to(np.nan, n)
    observed = (x_px, y_px, h_g, exposure, unknown if distance_m is None else distance_m)
    sigma_h_g = unknown if sigma_h_g is None else sigma_h_g
    k = Constants.of(exposures, camera)

    def some(rows: slice) -> None:
        part = {name: values[rows] for name, values in columns.items()}
        rays = _correct_block([a[rows] for a in observed], k, table, part, status[rows])
        if sigmas is not None and uncertainty is not None:
            solved = Solved(
                h_g[rows], sigma_h_g[rows], exposure[rows], k.camera, k.rotation, rays,
                part["r_c_rad"], status[rows],
            )  # fmt: skip
            sigmas.fill(rows, uncertainty, solved)

    in_blocks(some, n)
    return Corrections(status=status, sigmas=sigmas, **columns)


def sigmas_at(
    found: Corrections,
    h_g: Array,
    exposure: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    uncertainty: Uncertainty,
    sigma_h_g: Array | None = None,
) -> Sigmas:
    """Standard deviations of displacements, at the pixels ``x_px``, ``y_px`` that they lead to.

    ``found`` (n,) from `apply_refraction`; the rest as for `correct_observations`.
    """
    n = found.x_px.size
    sigmas, k = Sigmas.room(n), Constants.of(exposures, camera)
    sigma_h_g = np.full(n, np.nan) if sigma_h_g is None else sigma_h_g

    def some(rows: slice) -> None:
        observed = (found.x_px[rows], found.y_px[rows], h_g[rows], exposure[rows])
        rays, _, _ = look_out(observed, k)
        solved = Solved(
            h_g[rows], sigma_h_g[rows], exposure[rows], k.camera, k.rotation, rays,
            found.r_c_rad[rows], found.status[rows],
        )  # fmt: skip
        sigmas.fill(rows, uncertainty, solved)

    in_blocks(some, n)
    return sigmas


@dataclass(frozen=True, eq=False)
class Constants:
    """Exposures and camera in the form the kernels take."""

    camera: tuple[float, ...]
    usable: NDArray[np.bool_]
    rotation: Array
    curvature: Array
    air: tuple[Array, ...]
    change: Array

    @classmethod
    def of(cls, exposures: Exposures, camera: Camera) -> Constants:
        if exposures.radius_m is None:
            radii = principal_radii(exposures.latitude_rad)
            curvature = 1.0 / np.stack(radii, axis=1)
        else:
            curvature = np.full((exposures.usable.size, 2), 1.0 / exposures.radius_m)
        air = (
            exposures.height_m,
            exposures.refractivity_outside,
            exposures.refractivity_cabin,
            exposures.normals,
        )
        return cls(
            camera.numbers,
            exposures.usable,
            exposures.rotation,
            curvature,
            air,
            exposures.changes_px,
        )


def _correct_block(
    observed: list[Any],
    constants: Constants,
    table: RayTable | PublishedRays,
    columns: dict[str, Array],
    status: NDArray[np.uint8],
) -> Array:
    """Pixels to rays, rays through the air, and back; fills ``columns`` and ``status``.

    Gives the columns of the rays.
    """
    # The compiled functions are imported with the first ray, not with the package.
    from pipeline.refraction.kernels import image as kernel

    x, y, h_g, exposure, distance = observed
    k = constants
    rays, columns["r_cc_rad"][:], status[:] = look_out((x, y, h_g, exposure), k)
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
    return rays


def look_out(
    observed: tuple[Array, Array, Array, NDArray[np.int64]], k: Constants
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Columns of the rays of pixels, R_cc and status."""
    from pipeline.refraction.kernels import image as kernel

    n = observed[0].size
    rays, r_cc, status = np.empty((kernel.COLUMNS, n)), np.empty(n), np.empty(n, np.uint8)
    kernel.look_out(
        *observed, k.camera, k.usable, k.rotation, k.curvature, *k.air, k.change, rays, r_cc, status
    )
    return rays, r_cc, status


def _by_exposure(exposure: NDArray[np.int64]) -> NDArray[np.intp] | None:
    """The order that brings rows of one exposure together; None where they are."""
    changes = int(np.count_nonzero(np.diff(exposure)))
    if changes * _ROWS_OF_AN_IMAGE <= exposure.size or bool(np.all(np.diff(exposure) >= 0)):
        return None
    return np.argsort(exposure, kind="stable")


def landing_point(
    direction: Array, h_c: Array, h_g: Array, radius: Array, *, far: bool = False
) -> Array:
    """Where straight rays first reach a height, from the camera: (n, 3) east, north, up [m].

    ``direction`` (n, 3) unit vectors; NaN where the line never gets there. ``far`` asks for where
    it leaves that height again.
    """
    r_c, r_g = radius + h_c, radius + h_g
    cos_z = -direction[:, 2]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        q = np.sqrt((r_c * cos_z) ** 2 - (h_c - h_g) * (r_c + r_g))
        # Downwards the nearer of two crossings, upwards the only one.
        distance = np.where(
            (h_c >= h_g) & ~np.bool_(far),
            (h_c - h_g) * (r_c + r_g) / (r_c * cos_z + q),
            r_c * cos_z + q,
        )
        distance = np.where(h_c == h_g, 0.0, distance)
        distance = np.where(distance >= 0.0, distance, np.nan)
    return np.asarray(direction * distance[:, None])


def ground_displacement(
    h_c: float, h_g: float, zeta_c: float, r_c: float, radius: float, *, far: bool = False
) -> float:
    """How far [m] a refraction angle moves the point where a straight ray reaches a height.

    NaN where the apparent line passes over the horizon, though the bent ray may land. ``far`` takes
    the second crossing of the height, for rays of the status ``far_branch``.

    >>> round(ground_displacement(10000.0, 0.0, 0.7853981633974483, 7.94e-5, 6371000.0), 3)
    1.592
    """
    angle = np.array([zeta_c, zeta_c - r_c])
    rays = np.stack([np.sin(angle), np.zeros(2), -np.cos(angle)], axis=1)
    ones = np.ones(2)
    apparent, true = landing_point(rays, h_c * ones, h_g * ones, radius * ones, far=far)
    return float(np.linalg.norm(apparent - true))
