"""The inverse of the correction, for planning: from ideal pixels to those a camera measures."""

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
    CameraConstants,
    ExposureColumns,
    ObservationColumns,
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

_MAX_ITERATIONS = 12  # steep rays, which gain three digits in each, need four
# The iteration ends with a step that is shorter than both: this many pixels, or this many spacings
# of floating-point numbers, which are 1.5e-11 px at a hundred thousand pixels.
_LAST_STEP_PX = 1e-11
_LAST_STEP_SPACINGS = 2.0
_EDGE_PX = 1e-9  # points outside the format by less are inside: rounding
# Through P_90 the refraction angle is good to 1e-7 arcsec: 1e-8 px at 20000 px of principal
# distance.
_NOISE_PX = 1e-8

# Cosine of the nadir angle 10 degrees below the horizontal. The horizon of 30 km is 5.6 degrees
# down.
_NEARLY_LEVEL_COSINE = 0.17
_USUAL_LIFT = 0.065  # R_c of a nearly level ray over the angle of its way at the earth's centre
_LIFT_ITERATIONS = 10
_LIFT_MORE = 1.2  # factor of a lift with which no ray reaches the end of the chord


def apply_refraction(  # noqa: PLR0913
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

    x_px, y_px : (n,) ideal pixels: those of the straight chords, with the distortion of the lens.
    distance_m : (n,) slant ranges [m], NaN where unknown, which decide between the two crossings
        of a ray that meets the height of its target twice.
    Other arguments are those of `correct_observations`.

    Returns columns as `correct_observations` does, with the displaced pixels as
    ``x_corrected_px``, ``y_corrected_px`` and the displacement as ``dx_px``, ``dy_px``. The status
    is ``outside_camera`` where a point is displaced out of the format and ``misses_ground`` where
    no ray shows the target.

    `correct_observations` is inverted by iteration: to 1e-9 px, within 0.02 degree of grazing to
    1e-8 px. So near to grazing two rays may show points of the same straight line; without a
    distance the point that the line reaches first is taken.

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
    columns = _inverted_corrections(ideal, start, targets, exposures, camera=camera, table=table)
    # The correction leads from the displaced to the ideal pixel, the displacement back.
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
    has_no_result = ~np.isin(status, (OK, BEYOND_GRAZING, FAR_BRANCH))
    for column in columns.values():
        column[has_no_result] = np.nan
    displaced = image.Corrections(status=status, **columns)
    if uncertainty is None:
        return displaced
    if sigma_h_g is None:
        sigma_h_g = np.full(x_px.shape, np.nan)
    observations = observation_columns(
        displaced.x_corrected_px, displaced.y_corrected_px, h_g, sigma_h_g, exposure
    )
    sigmas = _sigmas_of_displacements(
        displaced, observations, exposures.columns, camera.constants, uncertainty
    )
    return replace(displaced, sigmas=sigmas)


def _sigmas_of_displacements(
    displaced: image.Corrections,
    observations: ObservationColumns,
    exposures: ExposureColumns,
    camera: CameraConstants,
    uncertainty: Uncertainty,
) -> Sigmas:
    """Standard deviations of displacements; ``observations`` are the displaced points."""
    count = observations.x.size
    sigmas = Sigmas.allocate(count)

    def fill_block(rows: slice) -> None:
        observed = observations.part(rows)
        rays = image.outgoing_rays(observed, camera, exposures).rays
        image.fill_sigmas(
            sigmas.rows(rows),
            observed=observed,
            traced=TracedColumns(rays, displaced.r_c_rad[rows], displaced.status[rows]),
            camera=camera,
            exposures=exposures,
            uncertainty=uncertainty,
        )

    in_blocks(fill_block, count)
    # Derivatives of the displacement are those of the correction with the other sign.
    for name in PARTIALS:
        partial = getattr(sigmas, name)
        np.negative(partial, out=partial)
    return sigmas


class _Targets(NamedTuple):
    """Targets of n observations."""

    h_g: Array  # height above sea level [m]
    distance: Array  # slant range [m], NaN where unknown
    exposure: Integers  # row of the exposures


def _starting_points(
    ideal: Array,
    targets: _Targets,
    exposures: image.Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
) -> Array:
    """Pixels (n, 2) at which the iteration of `_inverted_corrections` begins.

    They are the ``ideal`` pixels (n, 2), but for nearly level chords the pixels of rays that show
    the end of the chord. There an iteration from the ideal pixels may begin under the ground, or
    end at the other of two rays that show points of the same straight line; the length of the chord
    separates the two.
    """
    point = ideal.copy()
    rays = target_rays(
        ideal[:, 0], ideal[:, 1], targets.exposure, exposures, camera=camera, ideal=True
    )
    nearly_level = np.abs(rays[NADIR_COSINE]) < _NEARLY_LEVEL_COSINE
    level = np.flatnonzero(np.isfinite(targets.h_g) & nearly_level)  # rows of the observations
    if level.size == 0:
        return point
    row = targets.exposure[level]
    apparent = _apparent_directions(
        rays[:, level], targets.h_g[level], targets.distance[level], table
    )
    # Back through the window and the lens to the pixel.
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


def _apparent_directions(
    chords: Array, h_g: Array, distance: Array, table: RayTable | PublishedRays
) -> Array:
    """Unit vectors (n, 3), east-north-up, of the rays that show the ends of straight chords.

    ``chords`` (RAY_ROWS, n) are straight lines to the heights ``h_g`` [m]; of two crossings of the
    height the one nearer to ``distance`` [m] is the end. The apparent ray is R_c above the chord.
    R_c depends on the apparent ray, so both are iterated. NaN where the line does not reach h_g.
    """
    sin_z, cos_z, radius, h_c = chords[[NADIR_SINE, NADIR_COSINE, SPHERE_RADIUS, CAMERA_HEIGHT]]
    near = image.straight_reach(h_c, h_g, cos_z, radius=radius, far=False)
    far = image.straight_reach(h_c, h_g, cos_z, radius=radius, far=True)
    with np.errstate(invalid="ignore"):
        length = np.where(np.abs(far - distance) < np.abs(near - distance), far, near)
    zeta = np.arctan2(sin_z, cos_z)
    lift = _USUAL_LIFT * length * sin_z / (radius + h_c)  # of the ray above its chord [rad]
    for _ in range(_LIFT_ITERATIONS):
        sine = np.sin(zeta + lift)
        cosine = np.cos(zeta + lift)
        height, _ = height_at_distance(table, h_c, sine, cosine, length, radius=radius)
        r_c, _ = bend(table, h_c, height, sine, cosine, radius=radius, distance=length)
        lift = np.where(np.isfinite(r_c), r_c, _LIFT_MORE * lift)
    east, north = chords[DIRECTION : DIRECTION + 2] * np.sin(zeta + lift) / sin_z
    return np.stack([east, north, -np.cos(zeta + lift)], axis=1)


def _inverted_corrections(
    ideal: Array,
    point: Array,
    targets: _Targets,
    exposures: image.Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
) -> dict[str, Any]:
    """Columns of `correct_observations` for the pixels that it corrects to the ``ideal`` ones.

    The pixel is iterated as ideal - (dx, dy) from ``point`` (n, 2), which is changed. The status is
    ``misses_ground`` where the iteration does not come to the ideal pixel.
    """
    h_g = targets.h_g
    format_px = np.array([camera.width_px, camera.height_px], np.float64)
    spacing = np.spacing(np.abs(np.nan_to_num(ideal)))
    last_step = np.maximum(_LAST_STEP_PX, _LAST_STEP_SPACINGS * spacing)
    least_miss = np.full(h_g.shape, np.inf)  # of all iterations so far [px]
    columns = {}
    for name in (*image.COLUMNS, "status"):
        columns[name] = np.full(h_g.shape, np.nan)
    rows = np.arange(h_g.size)  # that are still iterated
    for _ in range(_MAX_ITERATIONS):
        place = np.clip(point[rows], 0.0, format_px)  # no pixel outside the format has a shift
        corrected = image.correct_observations(
            place[:, 0],
            place[:, 1],
            h_g[rows],
            targets.exposure[rows],
            exposures,
            camera=camera,
            table=table,
            distance_m=targets.distance[rows],
        )
        shift = np.stack([corrected.dx_px, corrected.dy_px], axis=1)
        miss = np.abs(place - ideal[rows] + shift).max(axis=1)
        # A row whose miss is noise and does not decrease keeps its last result.
        is_better = (least_miss[rows] > _NOISE_PX) | (miss < least_miss[rows])
        for name, column in columns.items():
            column[rows[is_better]] = getattr(corrected, name)[is_better]
        step = np.abs(ideal[rows] - shift - point[rows])
        moves = is_better & (step > last_step[rows]).any(axis=1)
        point[rows] = ideal[rows] - shift
        least_miss[rows[is_better]] = miss[is_better]
        rows = rows[moves]
        if rows.size == 0:
            break
    columns["status"][rows[least_miss[rows] > _NOISE_PX]] = MISSES_GROUND
    return columns
