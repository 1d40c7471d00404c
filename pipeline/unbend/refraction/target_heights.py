"""Heights of targets whose slant range is known, along curved rays."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures, outgoing_rays
from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    NADIR_COSINE,
    NADIR_SINE,
    SPHERE_RADIUS,
    RayColumns,
    observation_columns,
)
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.ray import DEFAULT_RADIUS_M, PublishedRays, as_columns, bend
from unbend.refraction.ray_table import RayTable
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK
from unbend.units import Array, Integers

# Each iteration with a published method gains three digits: these methods end before grazing,
# where more would be needed.
_MAX_ITERATIONS = 12
_LAST_STEP_M = 1e-7  # a smaller change of the height ends the iteration

# Ideal pixels may be this far outside the format: refraction displaces them by less.
_MARGIN_PX = 500


def height_at_distance(
    table: RayTable | PublishedRays,
    h_c: ArrayLike,
    sin_zeta_c: ArrayLike,
    cos_zeta_c: ArrayLike,
    distance: ArrayLike,
    *,
    radius: ArrayLike = DEFAULT_RADIUS_M,
) -> tuple[Array, NDArray[np.uint8]]:
    """Heights of targets whose slant range is known, along the bent rays that show them.

    distance : length [m] of the straight chord from camera to target, above 0. The target may be
        before or beyond the lowest point P_90 of the ray.
    table, h_c, sin_zeta_c, cos_zeta_c, radius : as for `bend`; all broadcast.

    Returns the heights h_g of the targets above sea level [m], NaN where the status is not ``ok``,
    and the status: ``outside_profile`` where the chord ends outside the profile, ``misses_ground``
    where the ray passes under all land on its way, ``bad_measurement`` where a distance or an angle
    is not valid.

    A millionth of a metre against 30-digit arithmetic, through P_90 too: unlike the distance of a
    given height, the height at a given distance is well determined there. For a published method
    the nadir angle of the chord is found by iteration, to the method's accuracy.
    Source: Gyer 1996, Eq. 12, 15, 16, solved for h_g.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.refraction.ray import ray_table
    >>> air = ray_table(standard_atmosphere("us1976"))
    >>> h_g, status = height_at_distance(air, 3000.0, 0.6, 0.8, 3000.0)
    >>> h_g.round(4).item(), status.item()
    (600.2176, 0)
    """
    shape, columns = as_columns(h_c, sin_zeta_c, cos_zeta_c, distance, radius)
    count = columns[0].size
    height = np.empty(count)
    status = np.empty(count, np.uint8)
    rays = RayColumns(
        h_c=columns[0],
        h_g=height,  # is not read
        sin_c=columns[1],
        cos_c=columns[2],
        r_e=columns[4],
        distance=columns[3],
    )
    if isinstance(table, PublishedRays):
        height, status = _heights_by_iteration(table, rays)
    else:
        from unbend.refraction.kernels.ray import ray_heights

        pieces = table.pieces

        def heights_of_block(rows: slice) -> None:
            part = RayColumns(*(column[rows] for column in rays))
            ray_heights(pieces, part, height[rows], status[rows])

        in_blocks(heights_of_block, count)
    return height.reshape(shape), status.reshape(shape)


def target_heights(
    x_px: Array,
    y_px: Array,
    distance_m: Array,
    exposure: Integers,
    exposures: Exposures,
    *,
    camera: Camera,
    table: RayTable | PublishedRays,
    ideal: bool = False,
) -> Array:
    """Heights of the targets of image observations whose slant range is known.

    x_px, y_px : (n,) pixels: measured, or those of the straight chord where ``ideal``.
    distance_m : (n,) slant ranges [m].
    exposure, exposures, camera, table : as for `correct_observations`.

    Returns the heights above sea level [m], (n,), NaN where the pixel has no ray, the distance is
    not valid or the chord ends outside the profile.
    """
    rays = target_rays(x_px, y_px, exposure, exposures, camera=camera, ideal=ideal)
    h_c = rays[CAMERA_HEIGHT]
    radius = rays[SPHERE_RADIUS]
    if ideal:
        with np.errstate(invalid="ignore"):
            return chord_height(h_c, rays[NADIR_COSINE], distance_m, radius)
    height, _ = height_at_distance(
        table, h_c, rays[NADIR_SINE], rays[NADIR_COSINE], distance_m, radius=radius
    )
    return height


def target_rays(
    x: Array, y: Array, exposure: Integers, exposures: Exposures, *, camera: Camera, ideal: bool
) -> Array:
    """The rays of pixels as a matrix (RAY_ROWS, n), NaN where a pixel has no ray.

    `kernels.columns` lists the rows of the matrix. ``ideal``: the pixels are those of straight
    chords, which are returned; they do not bend at the window and may be outside the format.
    """
    if ideal:
        exposures = replace(
            exposures, refractivity_cabin=exposures.refractivity_outside, principal_change_px=None
        )
        camera = replace(
            camera,
            width_px=camera.width_px + 2 * _MARGIN_PX,
            height_px=camera.height_px + 2 * _MARGIN_PX,
            cx_px=camera.cx_px + _MARGIN_PX,
            cy_px=camera.cy_px + _MARGIN_PX,
        )
        x = x + _MARGIN_PX
        y = y + _MARGIN_PX
    unused_height = np.zeros(x.size)
    observed = observation_columns(x, y, unused_height, unused_height, exposure)
    return outgoing_rays(observed, camera.constants, exposures.columns).rays


def chord_height(h_c: Array, cos_zeta: Array, distance: Array, radius: Array) -> Array:
    """Height [m] of the end of a straight chord at the nadir angle of cosine ``cos_zeta``.

    ``distance`` D is the length of the chord [m], ``h_c`` the height of its begin. Without
    cancellation, with r = radius + h: h_g - h_c = D (D - 2 r_c cos zeta) / (r_c + r_g).

    >>> one = np.ones(1)
    >>> chord_height(500.0 * one, one, 200.0 * one, 6.4e6 * one).tolist()
    [300.0]
    """
    r_c = radius + h_c
    fall = distance * (distance - 2.0 * r_c * cos_zeta)
    return np.asarray(h_c + fall / (r_c + np.sqrt(r_c * r_c + fall)))


def _heights_by_iteration(
    table: PublishedRays, rays: RayColumns
) -> tuple[Array, NDArray[np.uint8]]:
    """Heights and statuses of `height_at_distance` with a published method.

    The iteration begins with the height at the end of the straight line in the apparent direction.
    That height gives R_c, R_c gives the nadir angle of the chord, and the chord a better height.
    """
    h_c = rays.h_c
    sin_z = rays.sin_c
    cos_z = rays.cos_c
    radius = rays.r_e
    distance = rays.distance
    is_distance = np.isfinite(distance) & (distance > 0.0)
    is_iterating = is_distance
    status = np.where(is_distance, MISSES_GROUND, BAD_MEASUREMENT)
    with np.errstate(invalid="ignore"):
        height = chord_height(h_c, cos_z, np.where(is_distance, distance, math.nan), radius)
        for _ in range(_MAX_ITERATIONS):
            r_c, status_of_ray = bend(table, h_c, height, sin_z, cos_z, radius=radius)
            cos_chord = cos_z * np.cos(r_c) + sin_z * np.sin(r_c)
            step = chord_height(h_c, cos_chord, distance, radius) - height
            # Each row ends on its own: its result does not depend on the other rows.
            height = np.where(is_iterating, height + step, height)
            ends_now = is_iterating & ~(np.abs(step) > _LAST_STEP_M)  # a NaN ends too
            status = np.where(ends_now, status_of_ray, status)
            status[ends_now & np.isnan(step) & (status_of_ray == OK)] = MISSES_GROUND
            is_iterating = is_iterating & ~ends_now
            if not is_iterating.any():
                break
    return np.where(status == OK, height, math.nan), status.astype(np.uint8)
