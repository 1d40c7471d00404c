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

# Mean number of successive rows of one exposure below which sorting them first is faster.
_MIN_MEAN_RUN = 50


@dataclass(frozen=True, eq=False)
class Exposures:
    """What the correction needs to know of each of s exposures; (s,) arrays.

    ``usable`` is False where an exposure has no position, attitude or cabin air; ``rotation``
    (s, 3, 3) takes east-north-up to the camera frame; ``height_m`` is above sea level.
    ``refractivity_outside``, ``refractivity_cabin`` are n - 1 on the two sides of the window (equal
    where nothing bends there); ``window_normal`` (s, 3) unit vectors out of it in the camera frame,
    by default the optical axis; ``principal_change_px`` the change of the calibrated principal
    distance by the air in the lens, by default 0; ``radius_m`` the radius of a sphere that replaces
    the ellipsoid.
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
        """(s, 3) unit vectors out of the windows, in the camera frame."""
        if self.window_normal is None:
            return np.tile(OPTICAL_AXIS, (self.usable.size, 1))
        return self.window_normal

    @property
    def changes_px(self) -> Array:
        """(s,) changes of the principal distance by the air in the lens [px]."""
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
    """Corrections of n observations; ``sigmas`` is None where they were not requested.

    Arrays (n,), NaN where there is no correction; ``status`` gives the reason as a code of
    `status_codes`. The corrected pixels are the sum of the measured ones and ``dx_px``, ``dy_px``;
    in a result of `apply_refraction` they are the sum of the ideal ones and ``dx_px``, ``dy_px``.

    ``shift_ground_m`` is the horizontal distance, at the target's height, between the points where
    the uncorrected and the corrected straight ray land. The uncorrected ray is that of the measured
    pixel by the stated calibration, so that the distance includes air, window and lens. It is also
    NaN where that ray passes over the horizon and only the bent one lands: the last 0.2 degree of
    nadir angle from 10 km above sea level.
    """

    dx_px: Array
    dy_px: Array
    x_corrected_px: Array
    y_corrected_px: Array
    zeta_c_rad: Array  # apparent nadir angle outside the window
    r_c_rad: Array  # refraction angle of the atmosphere
    r_cc_rad: Array  # refraction angle at the window
    shift_ground_m: Array
    status: NDArray[np.uint8]
    sigmas: Sigmas | None = None

    def rows(self, selection: Rows | slice) -> Corrections:
        """The selected rows. Those of a slice are views: filling them fills these corrections."""
        columns: dict[str, Any] = {}
        for name in COLUMNS:
            columns[name] = getattr(self, name)[selection]
        sigmas = None if self.sigmas is None else self.sigmas.rows(selection)
        return Corrections(**columns, status=self.status[selection], sigmas=sigmas)

    def to_pandas(self) -> Any:
        """The corrections as a pandas DataFrame, with names of statuses instead of codes."""
        import pandas as pd

        columns = {name: getattr(self, name) for name in COLUMNS}
        if self.sigmas is not None:
            columns |= self.sigmas.named()
        return pd.DataFrame(columns | {"status": np.array(STATUS_NAMES)[self.status]})


COLUMNS = tuple(f.name for f in fields(Corrections) if f.name not in ("status", "sigmas"))
"""The columns of numbers of `Corrections`, in its order."""


def correct_observations(  # noqa: PLR0913
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
    uncertainty : from `uncertainty_of`; with it the result has ``sigmas``.
    sigma_h_g : (n,) standard deviations of ``h_g`` [m], for ``sigmas``; NaN where unknown.

    The shift (dx, dy) is computed directly, not as a difference of two directions: good to
    1e-10 px, whatever the size of the coordinates. Fastest where the rows of each exposure follow
    each other.
    """
    n = x_px.size
    distance = _values_or_nan(distance_m, n)
    sigma_h_g = _values_or_nan(sigma_h_g, n)
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
    # One allocation for all columns: the system gives it large pages, which take less time.
    columns = dict(zip(COLUMNS, np.empty((len(COLUMNS), n)), strict=True))
    corrections = Corrections(
        status=np.empty(n, np.uint8),
        sigmas=None if uncertainty is None else Sigmas.allocate(n),
        **columns,
    )
    observations = observation_columns(x_px, y_px, h_g, sigma_h_g, exposure)
    corrector = _BlockCorrector(camera.constants, exposures.columns, table, uncertainty)

    def correct_block(rows: slice) -> None:
        corrector.fill(corrections.rows(rows), observations.part(rows), distance[rows])

    in_blocks(correct_block, n)
    return corrections


def _values_or_nan(values: Array | None, count: int) -> Array:
    """The values, or ``count`` times NaN where ``values`` is None."""
    return np.full(count, np.nan) if values is None else values


def _pays_to_sort(exposure: Integers) -> bool:
    """Whether the exposure changes so often from row to row that sorting the rows is faster."""
    steps = np.diff(exposure)
    changes = int(np.count_nonzero(steps))
    is_sorted = bool(np.all(steps >= 0))
    return changes * _MIN_MEAN_RUN > exposure.size and not is_sorted


@dataclass(frozen=True, eq=False)
class _BlockCorrector:
    """Corrects one block of observations after the other; all share these inputs."""

    camera: CameraConstants
    exposures: ExposureColumns
    table: RayTable | PublishedRays
    uncertainty: Uncertainty | None

    def fill(self, part: Corrections, observed: ObservationColumns, distance: Array) -> None:
        """Fill ``part``, the rows of the corrections that belong to the ``observed`` points.

        ``distance``: slant ranges (n,) [m], NaN where unknown.
        """
        from unbend.refraction.kernels.shifts import fill_shifts

        outgoing = outgoing_rays(observed, self.camera, self.exposures)
        rays = outgoing.rays
        r_c, status_of_bend = bend(
            self.table,
            rays[CAMERA_HEIGHT],
            observed.h_g,
            rays[NADIR_SINE],
            rays[NADIR_COSINE],
            radius=rays[SPHERE_RADIUS],
            distance=distance,
        )
        status = np.where(outgoing.status == OK, status_of_bend, outgoing.status)
        traced = TracedColumns(rays, r_c, status)
        part.r_cc_rad[:] = outgoing.r_cc
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
    """Fill the standard deviations ``sigmas`` of the corrections of observed points."""
    from unbend.refraction.kernels.sigma import fill_sigma_columns

    pose = (camera, exposures.rotation)
    air = (uncertainty.stations, uncertainty.tables)
    fill_sigma_columns(observed, pose, traced, air, tuple(sigmas))


def outgoing_rays(
    observed: ObservationColumns, camera: CameraConstants, exposures: ExposureColumns
) -> OutgoingRays:
    """The rays of observed points outside the window, with R_cc and a status."""
    from unbend.refraction.kernels.outgoing import fill_outgoing_rays

    n = observed.x.size
    outgoing = OutgoingRays(np.empty((RAY_ROWS, n)), np.empty(n), np.empty(n, np.uint8))
    fill_outgoing_rays(observed, camera, exposures, outgoing)
    return outgoing


def straight_reach(
    h_c: ArrayLike, h_g: ArrayLike, cos_zeta: ArrayLike, *, radius: ArrayLike, far: ArrayLike
) -> Array:
    """Distance [m] along straight lines from the height h_c to the height h_g; NaN if not reached.

    h_c, h_g : heights above sea level [m]; broadcast with the others.
    cos_zeta : cosine of the nadir angle of the line at h_c.
    radius : of the sphere [m].
    far : a line that looks down reaches h_g twice: True takes the second crossing. A line upwards
        reaches it once, whatever ``far`` is.

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
    """Distance [m] between the points where apparent and true straight ray reach the height h_g.

    The apparent ray leaves the camera at the nadir angle ``zeta_c``, the true one at
    ``zeta_c - r_c`` [rad]; both broadcast. NaN where the apparent one passes over the horizon,
    though the bent ray may land. ``far`` takes the second crossing of the height, for rays of the
    status ``far_branch``.

    >>> ground_displacement(10000.0, 0.0, 0.7853981633974483, 7.94e-5, 6371000.0).round(3).item()
    1.592
    """
    # The first axis has two rows: the apparent ray, the true ray.
    angles = np.stack(np.broadcast_arrays(zeta_c, np.subtract(zeta_c, r_c)))
    reach = straight_reach(h_c, h_g, np.cos(angles), radius=radius, far=far)
    across = np.sin(angles) * reach
    up = -np.cos(angles) * reach
    across_apart = across[0] - across[1]
    up_apart = up[0] - up[1]
    return np.asarray(np.sqrt(across_apart**2 + up_apart**2))


def lattice_nodes(camera: Camera, columns: int, rows: int) -> tuple[Array, Array]:
    """Pixels x, y (rows * columns,) of a grid over a camera's format, its corners included.

    ``columns``, ``rows``: numbers of nodes across and down, 2 or more. The nodes are evenly spaced
    and listed row by row, in COLMAP's pixels.

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
