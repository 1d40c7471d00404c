"""Image observations: from measured pixels to the pixels of the straight chord.

The exact vector form; Gyer's Eq. 40-51 are its scalar twin (with the plus sign in Eq. 50, 51 that
the paper prints as a minus).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.geodesy import principal_radii
from unbend.refraction.camera.camera import Camera
from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    NADIR_COSINE,
    NADIR_SINE,
    RAY_ROWS,
    SPHERE_RADIUS,
    CameraConstants,
    ExposureColumns,
    ObservationColumns,
    OutgoingRays,
    RayColumns,
    Shifts,
    TracedColumns,
    observation_columns,
)
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.ray import PublishedRays, as_columns, bend
from unbend.refraction.ray_table import RayTable
from unbend.refraction.status_codes import OK, STATUS_NAMES
from unbend.refraction.uncertainty.sigmas import Sigmas, Uncertainty
from unbend.refraction.window import OPTICAL_AXIS
from unbend.units import Array, Integers, Mask, Rows

# Rows of an image that follow each other on the average, below which it pays to sort them.
_ROWS_OF_AN_IMAGE = 50


@dataclass(frozen=True, eq=False)
class Exposures:
    """What the correction needs to know of each exposure; (s,) arrays.

    ``usable`` is False where an exposure has no position, attitude or cabin air; ``rotation``
    (s, 3, 3) takes east-north-up to camera; ``refractivity_outside``, ``refractivity_cabin`` are
    n - 1 on the two sides of the window (equal where nothing bends there); ``window_normal`` (s, 3)
    unit vectors out of it in the camera frame, by default the optical axis;
    ``principal_change_px`` what the air in the lens adds to the calibrated principal distance, by
    default nothing; ``radius_m`` replaces the ellipsoid's radius in the ray's azimuth.
    """

    usable: Mask
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

    @property
    def columns(self) -> ExposureColumns:
        """The exposures for compiled functions."""
        if self.radius_m is None:
            curvature = 1.0 / np.stack(principal_radii(self.latitude_rad), axis=1)
        else:
            curvature = np.full((self.usable.size, 2), 1.0 / self.radius_m)
        return ExposureColumns(
            usable=self.usable,
            rotation=self.rotation,
            curvature=curvature,
            height=self.height_m,
            outside=self.refractivity_outside,
            cabin=self.refractivity_cabin,
            normal=self.normals,
            change_px=self.changes_px,
        )


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrected observations, with ``sigmas`` where they were asked for.

    Arrays (n,), NaN where ``status`` says there is no correction. The corrected pixels are the
    measured ones and ``dx_px``, ``dy_px``; of `apply_refraction` they are the displaced ones.

    ``shift_ground_m`` is the horizontal displacement, at the target's height, of the point where
    the uncorrected straight ray would land. The stated calibration gives that ray to the measured
    pixel: the metres are those of the shift in the image, by air, window and lens together. It is
    also NaN where that ray passes over the horizon and only the bent one lands: the last 0.2 degree
    of nadir angle from 10 km above sea level.
    """

    dx_px: Array
    dy_px: Array
    x_corrected_px: Array
    y_corrected_px: Array
    zeta_c_rad: Array
    r_c_rad: Array
    r_cc_rad: Array
    shift_ground_m: Array
    status: NDArray[np.uint8]
    sigmas: Sigmas | None = None

    def rows(self, which: Rows | slice) -> Corrections:
        """Some of the rows; those of a slice can be filled."""
        columns: dict[str, Any] = {}
        for name in COLUMNS:
            columns[name] = getattr(self, name)[which]
        sigmas = None if self.sigmas is None else self.sigmas.rows(which)
        return Corrections(**columns, status=self.status[which], sigmas=sigmas)

    def to_pandas(self) -> Any:
        """The corrections as a pandas DataFrame, status in words."""
        import pandas as pd

        columns = {name: getattr(self, name) for name in COLUMNS}
        if self.sigmas is not None:
            columns |= self.sigmas.named()
        return pd.DataFrame(columns | {"status": np.array(STATUS_NAMES)[self.status]})


COLUMNS = tuple(f.name for f in fields(Corrections) if f.name not in ("status", "sigmas"))
"""The columns of numbers of `Corrections`, in its order."""


def correct_observations(
    x_px: Array,
    y_px: Array,
    h_g: Array,
    exposure: Integers,
    exposures: Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
    distance_m: Array | None = None,
    uncertainty: Uncertainty | None = None,
    sigma_h_g: Array | None = None,
) -> Corrections:
    """Remove compartment and atmospheric refraction from image observations of one camera.

    x_px, y_px : (n,) measured, distorted pixels.
    h_g : (n,) heights of the targets above sea level [m].
    exposure : (n,) rows of ``exposures``, -1 where the image has none.
    camera : interior orientation; corrected pixels are distorted again.
    table : the air outside and how rays bend in it, from `rays_by`.
    distance_m : (n,) slant ranges [m], NaN where unknown; see `bend`.
    uncertainty : asks for ``sigmas``, from `uncertainty_of`; sigma_h_g (n,) that of ``h_g`` [m].

    The shift (dx, dy) is no difference of directions: good to 1e-10 px, whatever the size of the
    coordinates. Rows of one exposure that follow each other are fastest.
    """
    n = x_px.size
    distance = _or_unknown(distance_m, n)
    sigma_h_g = _or_unknown(sigma_h_g, n)
    if _pays_to_sort(exposure):
        order = np.argsort(exposure, kind="stable")
        sorted_corrections = correct_observations(
            x_px[order],
            y_px[order],
            h_g[order],
            exposure[order],
            exposures,
            camera=camera,
            table=table,
            distance_m=distance[order],
            uncertainty=uncertainty,
            sigma_h_g=sigma_h_g[order],
        )
        return sorted_corrections.rows(np.argsort(order))
    # In one piece: the system hands large ones out in large pages, which take less time.
    columns = dict(zip(COLUMNS, np.empty((len(COLUMNS), n)), strict=True))
    room = Corrections(
        status=np.empty(n, np.uint8),
        sigmas=None if uncertainty is None else Sigmas.allocate(n),
        **columns,
    )
    observations = observation_columns(x_px, y_px, h_g, sigma_h_g, exposure)
    task = _Correction(camera.constants, exposures.columns, table, uncertainty)

    def correct_block(rows: slice) -> None:
        task.fill(room.rows(rows), observations.part(rows), distance[rows])

    in_blocks(correct_block, n)
    return room


def _or_unknown(values: Array | None, count: int) -> Array:
    """Values, or NaN for each row where none are given."""
    return np.full(count, np.nan) if values is None else values


def _pays_to_sort(exposure: Integers) -> bool:
    """Whether rows of an exposure follow each other so seldom that sorting them is faster."""
    steps = np.diff(exposure)
    changes = int(np.count_nonzero(steps))
    is_sorted = bool(np.all(steps >= 0))
    return changes * _ROWS_OF_AN_IMAGE > exposure.size and not is_sorted


@dataclass(frozen=True, eq=False)
class _Correction:
    """What all blocks of a correction share."""

    camera: CameraConstants
    exposures: ExposureColumns
    table: RayTable | PublishedRays
    uncertainty: Uncertainty | None

    def fill(self, part: Corrections, observed: ObservationColumns, distance: Array) -> None:
        """Fill the corrections of some observations.

        ``distance``: slant ranges (n,) [m], NaN where unknown.
        """
        from unbend.refraction.kernels.shifts import fill_shifts

        rays, part.r_cc_rad[:], status_of_ray = outgoing_rays(observed, self.camera, self.exposures)
        r_c, status_of_bend = bend(
            self.table,
            rays[CAMERA_HEIGHT],
            observed.h_g,
            rays[NADIR_SINE],
            rays[NADIR_COSINE],
            radius=rays[SPHERE_RADIUS],
            distance=distance,
        )
        status = np.where(status_of_ray == OK, status_of_bend, status_of_ray)
        traced = TracedColumns(rays, r_c, status)
        part.r_c_rad[:] = r_c
        part.status[:] = status
        part.zeta_c_rad[:] = np.arctan2(rays[NADIR_SINE], rays[NADIR_COSINE])
        shifts = Shifts(part.dx_px, part.dy_px, part.shift_ground_m)
        fill_shifts(observed, self.camera, self.exposures, traced, shifts)
        part.x_corrected_px[:] = observed.x + part.dx_px
        part.y_corrected_px[:] = observed.y + part.dy_px
        if self.uncertainty is not None and part.sigmas is not None:
            fill_sigmas(
                part.sigmas,
                observed=observed,
                traced=traced,
                camera=self.camera,
                exposures=self.exposures,
                uncertainty=self.uncertainty,
            )


def fill_sigmas(
    sigmas: Sigmas,
    *,
    observed: ObservationColumns,
    traced: TracedColumns,
    camera: CameraConstants,
    exposures: ExposureColumns,
    uncertainty: Uncertainty,
) -> None:
    """Fill the standard deviations of some observations."""
    from unbend.refraction.kernels.sigma import fill_sigma_columns

    pose = (camera, exposures.rotation)
    air = (uncertainty.stations, uncertainty.tables)
    fill_sigma_columns(observed, pose, traced, air, tuple(sigmas))


def outgoing_rays(
    observed: ObservationColumns, camera: CameraConstants, exposures: ExposureColumns
) -> OutgoingRays:
    """The rays that pixels see outside the window."""
    from unbend.refraction.kernels.outgoing import fill_outgoing_rays

    n = observed.x.size
    outgoing = OutgoingRays(np.empty((RAY_ROWS, n)), np.empty(n), np.empty(n, np.uint8))
    fill_outgoing_rays(observed, camera, exposures, outgoing)
    return outgoing


def straight_reach(
    h_c: ArrayLike, h_g: ArrayLike, cos_zeta: ArrayLike, *, radius: ArrayLike, far: ArrayLike
) -> Array:
    """How far away [m] straight lines reach a height; NaN where they never get there.

    Heights above sea level [m], cosine of the nadir angle, radius of the sphere [m], and whether
    the second of two crossings is meant (downwards; upwards there is one). Arguments broadcast.

    >>> straight_reach(3000.0, 1000.0, 0.8, radius=6371e3, far=[False, True]).round(3).tolist()
    [2500.221, 10195899.779]
    """
    from unbend.refraction.kernels.shifts import fill_straight_reach

    shape, columns = as_columns(h_c, h_g, cos_zeta, radius, far)
    distance = np.empty(columns[0].shape)
    rays = RayColumns(
        h_c=columns[0],
        h_g=columns[1],
        sin_c=columns[2],  # is not read
        cos_c=columns[2],
        r_e=columns[3],
        distance=distance,
    )
    is_far = columns[4] != 0.0
    fill_straight_reach(rays, is_far, distance)
    return distance.reshape(shape)


def ground_displacement(
    h_c: float, h_g: float, zeta_c: ArrayLike, r_c: ArrayLike, radius: float, *, far: bool = False
) -> Array:
    """How far [m] refraction angles move the points where straight rays reach a height.

    ``zeta_c``, ``r_c`` [rad] broadcast. NaN where the apparent line passes over the horizon, though
    the bent ray may land. ``far`` takes the second crossing of the height, for rays of the status
    ``far_branch``.

    >>> ground_displacement(10000.0, 0.0, 0.7853981633974483, 7.94e-5, 6371000.0).round(3).item()
    1.592
    """
    angles = np.stack(np.broadcast_arrays(zeta_c, np.subtract(zeta_c, r_c)))
    reach = straight_reach(h_c, h_g, np.cos(angles), radius=radius, far=far)
    apparent, true = np.stack([np.sin(angles), -np.cos(angles)], axis=1) * reach[:, None]
    along = apparent[0] - true[0]
    down = apparent[1] - true[1]
    return np.asarray(np.sqrt(along**2 + down**2))


def lattice_nodes(camera: Camera, columns: int, rows: int) -> tuple[Array, Array]:
    """Pixels of a grid from corner to corner of a camera's format.

    Nodes across and down, 2 or more; x, y (rows * columns,) in COLMAP's pixels, row by row.

    >>> x, y = lattice_nodes(Camera(400, 300, 500.0, 500.0, 200.0, 150.0), 3, 2)
    >>> x.tolist(), y.tolist()
    ([0.0, 200.0, 400.0, 0.0, 200.0, 400.0], [0.0, 0.0, 0.0, 300.0, 300.0, 300.0])
    """
    if columns < 2 or rows < 2:
        raise ValueError("a lattice has at least two columns and two rows")
    across = np.linspace(0.0, camera.width_px, columns)
    down = np.linspace(0.0, camera.height_px, rows)
    x, y = np.meshgrid(across, down)
    return x.ravel(), y.ravel()
