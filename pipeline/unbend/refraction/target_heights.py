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

# Rounds for a published method: each gains three digits, and they go no nearer to grazing.
_ROUNDS = 12
_CLOSE_M = 1e-7

# More than refraction moves a point into the format.
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

    distance : length [m] of the straight chord from camera to target, over 0; before or beyond the
        lowest point P_90 of the ray. The rest as for `bend`; all broadcast.

    Returns the height h_g of the target above sea level [m], NaN where there is none, and the
    status: ``outside_profile`` where the chord ends outside it, ``misses_ground`` where the ray
    passes under all land on its way, ``bad_measurement`` for what is no distance or angle.

    A millionth of a metre against 30-digit arithmetic, through P_90 too: unlike the distance of a
    given height, the height at a given distance is well determined there. For a published method
    the nadir angle of the chord is found by repetition, to the method's own accuracy.
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
        height, status = _by_repetition(table, rays)
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
    The rest as for `correct_observations`.

    Returns the heights above sea level [m], (n,), NaN where the observation lacks something that
    `correct_observations` will name, or its chord ends outside the profile.
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
    """The matrix of rays (RAY_ROWS, n) of pixels, NaN where a pixel has no ray.

    Arguments as for `target_heights`: where ``ideal`` the rays are the straight chords themselves.
    """
    if ideal:  # a straight line has no window and no lens, and may lie beside the format
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
    anywhere = np.zeros(x.size)
    observed = observation_columns(x, y, anywhere, anywhere, exposure)
    return outgoing_rays(observed, camera.constants, exposures.columns).rays


def chord_height(h_c: Array, cos_zeta: Array, distance: Array, radius: Array) -> Array:
    """Height [m] of the end of a straight chord at the nadir angle of cosine ``cos_zeta``.

    Without cancellation: h_g - h_c = D (D - 2 r_c cos zeta) / (r_c + r_g).

    >>> one = np.ones(1)
    >>> chord_height(500.0 * one, one, 200.0 * one, 6.4e6 * one).tolist()
    [300.0]
    """
    r_c = radius + h_c
    fall = distance * (distance - 2.0 * r_c * cos_zeta)
    return np.asarray(h_c + fall / (r_c + np.sqrt(r_c * r_c + fall)))


def _by_repetition(table: PublishedRays, rays: RayColumns) -> tuple[Array, NDArray[np.uint8]]:
    """Heights and status as `height_at_distance` has them, by a published method.

    The height at the end of the straight line in the apparent direction gives R_c, R_c the nadir
    angle of the chord, and that a better height.
    """
    h_c = rays.h_c
    sin_z = rays.sin_c
    cos_z = rays.cos_c
    radius = rays.r_e
    distance = rays.distance
    is_distance = np.isfinite(distance) & (distance > 0.0)
    is_open = is_distance
    status = np.where(is_distance, MISSES_GROUND, BAD_MEASUREMENT)
    with np.errstate(invalid="ignore"):
        height = chord_height(h_c, cos_z, np.where(is_distance, distance, math.nan), radius)
        for _ in range(_ROUNDS):
            r_c, status_of_ray = bend(table, h_c, height, sin_z, cos_z, radius=radius)
            cos_chord = cos_z * np.cos(r_c) + sin_z * np.sin(r_c)
            step = chord_height(h_c, cos_chord, distance, radius) - height
            # A row ends by itself: its height and status do not depend on the rows beside it.
            height = np.where(is_open, height + step, height)
            ends = is_open & ~(np.abs(step) > _CLOSE_M)  # settled, or NaN
            status = np.where(ends, status_of_ray, status)
            status[ends & np.isnan(step) & (status_of_ray == OK)] = MISSES_GROUND
            is_open = is_open & ~ends
            if not is_open.any():
                break
    return np.where(status == OK, height, math.nan), status.astype(np.uint8)
