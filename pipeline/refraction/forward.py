"""The other direction: from ideal pixels to what a camera in this air measures, for planning."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geodesy import euler_radius
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.chord import height_at_distance
from pipeline.refraction.image import (
    COLUMNS,
    Corrections,
    Exposures,
    correct_observations,
    sigmas_at,
)
from pipeline.refraction.ray import PublishedRays, RayTable, bend
from pipeline.refraction.status import (
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_CAMERA,
)
from pipeline.refraction.uncertainty.sigmas import Uncertainty
from pipeline.refraction.window import leave_compartment

Array = NDArray[np.float64]

# Four rounds do for steep rays, which gain three digits in each.
_ROUNDS = 12
_CLOSE_PX = 1e-11
# Coordinates of a hundred thousand pixels are rounded to 1.5e-11.
_CLOSE_ULP = 2.0
_EDGE_PX = 1e-9
# Through P_90 the refraction angle is good to 1e-7 arcsec, which 20000 px away are 1e-8 px.
_NOISE_PX = 1e-8

# Within 10 degrees of the horizontal: from 30 km the horizon lies 5.6 degrees down.
_NEARLY_LEVEL = 0.17
_USUAL_CURVATURE = 0.065  # half of a level ray's, in units of the earth's
_LIFTS = 10


def apply_refraction(
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
    """Displace ideal image observations to what a camera in this air measures.

    Parameters
    ----------
    x_px, y_px : (n,) pixels of the straight chords, with the distortion of the lens.
    h_g : (n,) heights of the targets above sea level [m].
    exposure : (n,) rows of ``exposures``, -1 where the image has none.
    camera, table : as for `correct_observations`.
    distance_m : (n,) slant ranges [m], NaN where unknown, which decide between the two crossings
        of a ray that meets the height of its target twice.
    uncertainty, sigma_h_g : ask for ``sigmas``, as for `correct_observations`.

    Returns
    -------
    Columns as those of `correct_observations` at the displaced pixels, which are ``x_px``,
    ``y_px``; ``dx_px``, ``dy_px`` are the displacement. The status is ``outside_camera`` where a
    point is displaced out of the format and ``misses_ground`` where no ray shows the target.

    The inverse of `correct_observations` to 1e-9 px, within 0.02 degree of grazing to 1e-8: solved
    for by repetition, whatever that does. There two rays may show points of the same straight line;
    without a distance it is the point that the line reaches first.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.refraction import ray_table
    >>> one, none = np.ones(1), np.zeros(1)
    >>> down = Exposures(
    ...     one > 0.0, np.diag([1.0, -1.0, -1.0])[None], none, 3000.0 * one, 2e-4 * one, 2e-4 * one)
    >>> camera = Camera(10_000, 10_000, 10_000.0, 10_000.0, 5000.0, 5000.0)
    >>> air, first = ray_table(standard_atmosphere("us1976")), np.zeros(1, np.int64)
    >>> seen = apply_refraction(9000.0 * one, 5000.0 * one, none, first, down, camera, air)
    >>> seen.x_px.round(3).tolist()
    [9000.16]
    """
    ideal = np.stack([x_px, y_px], axis=1).astype(np.float64)
    ideal[~np.isfinite(ideal).all(axis=1)] = np.nan
    upper = np.array([camera.width_px, camera.height_px], np.float64)
    close = np.maximum(_CLOSE_PX, _CLOSE_ULP * np.spacing(np.abs(np.nan_to_num(ideal))))
    point = ideal.copy()
    _start_near_level(point, h_g, exposure, exposures, camera, table, distance_m)
    nearest = np.full(x_px.shape, np.inf)
    columns = {name: np.full(x_px.shape, np.nan) for name in (*COLUMNS, "status")}
    rows = np.arange(x_px.size)
    for _ in range(_ROUNDS):
        at = np.clip(point[rows], 0.0, upper)  # there is no shift outside the format
        removed = correct_observations(
            at[:, 0], at[:, 1], h_g[rows], exposure[rows], exposures, camera, table,
            distance_m=None if distance_m is None else distance_m[rows],
        )  # fmt: skip
        shift = np.stack([removed.dx_px, removed.dy_px], axis=1)
        miss = np.abs(at - ideal[rows] + shift).max(axis=1)
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
    found = _displaced(columns, ideal, upper)
    if uncertainty is None:
        return found
    sigmas = sigmas_at(found, h_g, exposure, exposures, camera, uncertainty, sigma_h_g)
    return replace(found, sigmas=sigmas)


def _start_near_level(
    point: Array,
    h_g: Array,
    exposure: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
    distance_m: Array | None,
) -> None:
    """Put the points of nearly level chords where a ray shows the chord's end.

    From the ideal pixels themselves a search may end at the other of two rays through the same
    straight line, or begin under the ground. The length of the chord tells them apart.
    """
    x, y = np.clip(point, 0.0, [camera.width_px, camera.height_px]).T
    u, v, covered = camera.rays(x, y)
    row = np.maximum(exposure, 0)
    known = covered & (exposure >= 0) & np.isfinite(h_g)
    if not bool(known.any()):
        return
    ideal = np.stack([u, v, np.ones(u.shape)], axis=1)
    ideal /= np.sqrt(u * u + v * v + 1.0)[:, None]
    down = -np.einsum("ni,ni->n", exposures.rotation[row, :, 2], ideal)
    level = np.flatnonzero(known & exposures.usable[row] & (np.abs(down) < _NEARLY_LEVEL))
    if level.size == 0:
        return
    row = row[level]
    chord = np.einsum("nji,nj->ni", exposures.rotation[row], ideal[level])
    given = np.full(level.size, np.nan) if distance_m is None else distance_m[level]
    apparent = _apparent(chord, h_g[level], given, row, exposures, table)
    inside = np.einsum("nij,nj->ni", exposures.rotation[row], apparent)
    outside, cabin = exposures.refractivity_outside[row], exposures.refractivity_cabin[row]
    # In through the window by the law by which it leaves.
    inside += leave_compartment(inside, outside, cabin, exposures.normals[row])[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        u_d, v_d = camera.distort(inside[:, 0] / inside[:, 2], inside[:, 1] / inside[:, 2])
    change = exposures.changes_px[row]
    f_x, f_y = camera.fx_px + change, camera.fy_px + change
    start = np.stack([f_x * u_d + camera.cx_px, f_y * v_d + camera.cy_px], axis=1)
    found = np.isfinite(start).all(axis=1) & (inside[:, 2] > 0.0)
    point[level[found]] = start[found]


def _apparent(
    chord: Array,
    h_g: Array,
    distance: Array,
    row: NDArray[np.int64],
    exposures: Exposures,
    table: RayTable | PublishedRays,
) -> Array:
    """Directions (n, 3), east-north-up, of the rays that show the ends of straight chords.

    The ray is sought that is as far above its chord, at the chord's length, as refraction lifts
    it; NaN where the straight line does not reach ``h_g``.
    """
    sin_z, cos_z = np.hypot(chord[:, 0], chord[:, 1]), -chord[:, 2]
    h_c, radius = exposures.height_m[row], _radius(exposures, row, chord)
    r_c, r_g = radius + h_c, radius + h_g
    drop = (h_c - h_g) * (r_c + r_g)
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.sqrt((r_c * cos_z) ** 2 - drop)
        near, far = drop / (r_c * cos_z + reach), r_c * cos_z + reach
        beyond = (h_g > h_c) | (np.abs(far - distance) < np.abs(near - distance))
        length = np.where(beyond, far, near)
    zeta = np.arctan2(sin_z, cos_z)
    lifted = _USUAL_CURVATURE * length * sin_z / r_c
    for _ in range(_LIFTS):
        sine, cosine = np.sin(zeta + lifted), np.cos(zeta + lifted)
        height, _ = height_at_distance(table, h_c, sine, cosine, length, radius)
        found, _ = bend(table, h_c, height, sine, cosine, radius, length)
        lifted = np.where(np.isfinite(found), found, 1.2 * lifted)
    stretch = (np.sin(zeta + lifted) / sin_z)[:, None]
    return np.concatenate([chord[:, :2] * stretch, -np.cos(zeta + lifted)[:, None]], axis=1)


def _radius(exposures: Exposures, row: NDArray[np.int64], direction: Array) -> Array:
    """Of the sphere (n,) [m], in the azimuths of directions (n, 3), east-north-up."""
    if exposures.radius_m is not None:
        return np.full(row.shape, exposures.radius_m)
    azimuth = np.arctan2(direction[:, 0], direction[:, 1])
    return np.asarray(euler_radius(exposures.latitude_rad[row], azimuth))


def _displaced(columns: dict[str, Any], ideal: Array, upper: Array) -> Corrections:
    """What a removal that ends in the ideal pixels says, as a displacement."""
    columns["dx_px"], columns["dy_px"] = -columns["dx_px"], -columns["dy_px"]
    columns["x_px"] = ideal[:, 0] + columns["dx_px"]
    columns["y_px"] = ideal[:, 1] + columns["dy_px"]
    status = columns.pop("status").astype(np.uint8)
    with np.errstate(invalid="ignore"):
        displaced = np.stack([columns["x_px"], columns["y_px"]], axis=1)
        outside = ((displaced < -_EDGE_PX) | (displaced > upper + _EDGE_PX)).any(axis=1)
    status[outside] = OUTSIDE_CAMERA
    lost = ~np.isin(status, (OK, BEYOND_GRAZING, FAR_BRANCH))
    for column in columns.values():
        column[lost] = np.nan
    return Corrections(status=status, **columns)
