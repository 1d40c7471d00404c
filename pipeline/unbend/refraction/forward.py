"""The other direction: from ideal pixels to what a camera in this air measures, for planning."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from unbend.refraction import image
from unbend.refraction.camera.camera import Camera
from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    DIRECTION,
    NADIR_COSINE,
    NADIR_SINE,
    SPHERE_RADIUS,
    TracedColumns,
    observation_columns,
)
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.ray import PublishedRays, bend
from unbend.refraction.ray_table import RayTable
from unbend.refraction.status_codes import (
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_CAMERA,
)
from unbend.refraction.target_heights import height_at_distance, target_rays
from unbend.refraction.uncertainty.sigmas import PARTIALS, Sigmas, Uncertainty
from unbend.refraction.window import refract_at_window
from unbend.units import Array, Integers

# Four rounds do for steep rays, which gain three digits in each.
_ROUNDS = 12
_CLOSE_PX = 1e-11  # a shorter step is the last
_CLOSE_ULP = 2.0  # or one of so many spacings: 1.5e-11 at a hundred thousand pixels
_EDGE_PX = 1e-9  # so far outside the format is rounding
# Through P_90 the refraction angle is good to 1e-7 arcsec, which 20000 px away are 1e-8 px.
_NOISE_PX = 1e-8

# Within 10 degrees of the horizontal: from 30 km the horizon lies 5.6 degrees down.
_NEARLY_LEVEL = 0.17
_USUAL_CURVATURE = 0.065  # half of a level ray's, in units of the earth's
_LIFTS = 10  # rounds of the search for a nearly level ray
_LIFT_MORE = 1.2  # where no ray is found


def apply_refraction(
    x_px: Array,
    y_px: Array,
    h_g: Array,
    exposure: Integers,
    exposures: image.Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
    distance_m: Array | None = None,
    uncertainty: Uncertainty | None = None,
    sigma_h_g: Array | None = None,
) -> image.Corrections:
    """Displace ideal image observations to what a camera in this air measures.

    x_px, y_px : (n,) pixels of the straight chords, with the distortion of the lens.
    distance_m : (n,) slant ranges [m], NaN where unknown, which decide between the two crossings
        of a ray that meets the height of its target twice.
    The rest as for `correct_observations`.

    Returns columns as those of `correct_observations`, with the displaced pixels as
    ``x_corrected_px``, ``y_corrected_px`` and the displacement as ``dx_px``, ``dy_px``. The status
    is ``outside_camera`` where a point is displaced out of the format and ``misses_ground`` where
    no ray shows the target.

    The inverse of `correct_observations` to 1e-9 px, within 0.02 degree of grazing to 1e-8: solved
    by repetition, whatever that does. There two rays may show points of the same straight line;
    without a distance it is the point that the line reaches first.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.refraction import Exposures, ray_table
    >>> one, none = np.ones(1), np.zeros(1)
    >>> down = Exposures(
    ...     one > 0.0, np.diag([1.0, -1.0, -1.0])[None], none, 3000.0 * one, 2e-4 * one, 2e-4 * one)
    >>> camera = Camera(10_000, 10_000, 10_000.0, 10_000.0, 5000.0, 5000.0)
    >>> air, first = ray_table(standard_atmosphere("us1976")), np.zeros(1, np.int64)
    >>> seen = apply_refraction(
    ...     9000.0 * one, 5000.0 * one, none, first, down, camera=camera, table=air)
    >>> seen.x_corrected_px.round(3).tolist()
    [9000.16]
    """
    ideal = np.stack([x_px, y_px], axis=1).astype(np.float64)
    ideal[~np.isfinite(ideal).all(axis=1)] = np.nan
    if distance_m is None:
        distance_m = np.full(x_px.shape, np.nan)
    targets = _Targets(h_g, distance_m, exposure)
    start = _starting_points(ideal, targets, exposures, camera, table)
    columns = _removals_to(ideal, start, targets, exposures, camera=camera, table=table)
    # The removal as a displacement.
    columns["dx_px"] = -columns["dx_px"]
    columns["dy_px"] = -columns["dy_px"]
    displaced_x = ideal[:, 0] + columns["dx_px"]
    displaced_y = ideal[:, 1] + columns["dy_px"]
    columns["x_corrected_px"] = displaced_x
    columns["y_corrected_px"] = displaced_y
    status = columns.pop("status").astype(np.uint8)
    with np.errstate(invalid="ignore"):
        outside = (displaced_x < -_EDGE_PX) | (displaced_x > camera.width_px + _EDGE_PX)
        outside |= (displaced_y < -_EDGE_PX) | (displaced_y > camera.height_px + _EDGE_PX)
    status[outside] = OUTSIDE_CAMERA
    lost = ~np.isin(status, (OK, BEYOND_GRAZING, FAR_BRANCH))
    for column in columns.values():
        column[lost] = np.nan
    displaced = image.Corrections(status=status, **columns)
    if uncertainty is None:
        return displaced
    if sigma_h_g is None:
        sigma_h_g = np.full(x_px.shape, np.nan)
    observations = observation_columns(
        displaced.x_corrected_px, displaced.y_corrected_px, h_g, sigma_h_g, exposure
    )
    sigmas = Sigmas.allocate(x_px.size)
    constants = camera.constants
    exposure_columns = exposures.columns

    def fill_block(rows: slice) -> None:
        observed = observations.part(rows)
        rays = image.outgoing_rays(observed, constants, exposure_columns).rays
        image.fill_sigmas(
            sigmas.rows(rows),
            observed=observed,
            traced=TracedColumns(rays, displaced.r_c_rad[rows], displaced.status[rows]),
            camera=constants,
            exposures=exposure_columns,
            uncertainty=uncertainty,
        )

    in_blocks(fill_block, x_px.size)
    for name in PARTIALS:  # what removes less displaces more
        partial = getattr(sigmas, name)
        np.negative(partial, out=partial)
    return replace(displaced, sigmas=sigmas)


class _Targets(NamedTuple):
    """Heights of targets [m], slant ranges [m], NaN where unknown, and rows of exposures."""

    h_g: Array
    distance: Array
    exposure: Integers


def _starting_points(
    ideal: Array,
    targets: _Targets,
    exposures: image.Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
) -> Array:
    """Pixels (n, 2) from where to search: the ideal ones, or where a ray shows the chord's end.

    For nearly level chords a search from the ideal pixels themselves may end at the other of two
    rays through the same straight line, or begin under the ground. The length of the chord
    separates the two.
    """
    point = ideal.copy()
    rays = target_rays(
        ideal[:, 0], ideal[:, 1], targets.exposure, exposures, camera=camera, ideal=True
    )
    nearly_level = np.abs(rays[NADIR_COSINE]) < _NEARLY_LEVEL
    level = np.flatnonzero(np.isfinite(targets.h_g) & nearly_level)
    if level.size == 0:
        return point
    row = targets.exposure[level]
    apparent = _apparent(rays[:, level], targets.h_g[level], targets.distance[level], table)
    inside = np.einsum("nij,nj->ni", exposures.rotation[row], apparent)
    change_at_window, _ = refract_at_window(
        inside,
        exposures.refractivity_outside[row],
        exposures.refractivity_cabin[row],
        exposures.normals[row],
    )
    inside += change_at_window
    with np.errstate(invalid="ignore", divide="ignore"):
        u_d, v_d = camera.distort(inside[:, 0] / inside[:, 2], inside[:, 1] / inside[:, 2])
    change = exposures.changes_px[row]
    start_x = (camera.fx_px + change) * u_d + camera.cx_px
    start_y = (camera.fy_px + change) * v_d + camera.cy_px
    start = np.stack([start_x, start_y], axis=1)
    usable = np.isfinite(start).all(axis=1) & (inside[:, 2] > 0.0)
    point[level[usable]] = start[usable]
    return point


def _apparent(chords: Array, h_g: Array, distance: Array, table: RayTable | PublishedRays) -> Array:
    """Directions (n, 3), east-north-up, of the rays that show the ends of straight chords.

    The ray is sought that is as far above its chord, at the chord's length, as refraction lifts
    it; NaN where the straight line does not reach the target's height.
    """
    sin_z, cos_z, radius, h_c = chords[[NADIR_SINE, NADIR_COSINE, SPHERE_RADIUS, CAMERA_HEIGHT]]
    near = image.straight_reach(h_c, h_g, cos_z, radius=radius, far=False)
    far = image.straight_reach(h_c, h_g, cos_z, radius=radius, far=True)
    with np.errstate(invalid="ignore"):
        length = np.where(np.abs(far - distance) < np.abs(near - distance), far, near)
    zeta = np.arctan2(sin_z, cos_z)
    lifted = _USUAL_CURVATURE * length * sin_z / (radius + h_c)
    for _ in range(_LIFTS):
        sine = np.sin(zeta + lifted)
        cosine = np.cos(zeta + lifted)
        height, _ = height_at_distance(table, h_c, sine, cosine, length, radius=radius)
        r_c, _ = bend(table, h_c, height, sine, cosine, radius=radius, distance=length)
        lifted = np.where(np.isfinite(r_c), r_c, _LIFT_MORE * lifted)
    east, north = chords[DIRECTION : DIRECTION + 2] * np.sin(zeta + lifted) / sin_z
    return np.stack([east, north, -np.cos(zeta + lifted)], axis=1)


def _removals_to(
    ideal: Array,
    point: Array,
    targets: _Targets,
    exposures: image.Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
) -> dict[str, Any]:
    """Columns of `correct_observations` where it leads to the ideal pixels, found by repetition.

    ``point`` (n, 2) are the pixels to start from; they are changed. The status is ``misses_ground``
    where none is found.
    """
    h_g = targets.h_g
    upper = np.array([camera.width_px, camera.height_px], np.float64)
    close = np.maximum(_CLOSE_PX, _CLOSE_ULP * np.spacing(np.abs(np.nan_to_num(ideal))))
    nearest = np.full(h_g.shape, np.inf)
    columns = {}
    for name in (*image.COLUMNS, "status"):
        columns[name] = np.full(h_g.shape, np.nan)
    rows = np.arange(h_g.size)
    for _ in range(_ROUNDS):
        place = np.clip(point[rows], 0.0, upper)  # there is no shift outside the format
        removed = image.correct_observations(
            place[:, 0],
            place[:, 1],
            h_g[rows],
            targets.exposure[rows],
            exposures,
            camera=camera,
            table=table,
            distance_m=targets.distance[rows],
        )
        shift = np.stack([removed.dx_px, removed.dy_px], axis=1)
        miss = np.abs(place - ideal[rows] + shift).max(axis=1)
        # A point that is near and gets no nearer stays where it was.
        kept = (nearest[rows] > _NOISE_PX) | (miss < nearest[rows])
        for name, column in columns.items():
            column[rows[kept]] = getattr(removed, name)[kept]
        step = np.abs(ideal[rows] - shift - point[rows])
        moving = kept & (step > close[rows]).any(axis=1)
        point[rows] = ideal[rows] - shift
        nearest[rows[kept]] = miss[kept]
        rows = rows[moving]
        if rows.size == 0:
            break
    columns["status"][rows[nearest[rows] > _NOISE_PX]] = MISSES_GROUND
    return columns
