"""The height at which a ray is a given straight distance away: targets known by slant range."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures, outgoing_rays
from pipeline.refraction.kernels.columns import (
    COS,
    H_C,
    RADIUS,
    SIN,
    ObservationColumns,
    RayColumns,
)
from pipeline.refraction.kernels.ray import ray_heights
from pipeline.refraction.kernels.threads import in_blocks
from pipeline.refraction.ray import DEFAULT_RADIUS_M, PublishedRays, as_columns, bend
from pipeline.refraction.ray_table import RayTable
from pipeline.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK
from pipeline.units import Array, Integers

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

    Parameters
    ----------
    table : the air, from `ray_table` or `rays_by`.
    h_c : height of the camera above sea level [m]; broadcast with the others.
    sin_zeta_c, cos_zeta_c : of the apparent nadir angle at the camera, 0 to 180 degrees.
    distance : length [m] of the straight chord from camera to target, over 0; before or beyond the
        lowest point P_90 of the ray.
    radius : of the sphere [m].

    Returns
    -------
    h_g : height of the target above sea level [m], NaN where ``status`` says there is none.
    status : ``outside_profile`` where the chord ends outside it, ``misses_ground`` where the ray
        passes under all land on its way, ``bad_measurement`` for what is no distance or angle.

    A millionth of a metre against 30-digit arithmetic, through P_90 too: unlike the distance of a
    given height, the height at a given distance is well determined there. For a published method
    the nadir angle of the chord is found by repetition, to the method's own accuracy.
    Source: Gyer 1996, Eq. 12, 15, 16, solved for h_g.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.refraction.ray import ray_table
    >>> air = ray_table(standard_atmosphere("us1976"))
    >>> h_g, status = height_at_distance(air, 3000.0, 0.6, 0.8, 3000.0)
    >>> h_g.round(4).item(), status.item()
    (600.2176, 0)
    """
    shape, (h_c, sin_z, cos_z, distance, radius) = as_columns(
        h_c, sin_zeta_c, cos_zeta_c, distance, radius
    )
    if isinstance(table, PublishedRays):
        rays = RayColumns(h_c, np.empty(h_c.shape), sin_z, cos_z, radius, distance)
        height, status = _by_repetition(table, rays)
        return height.reshape(shape), status.reshape(shape)
    height = np.empty(h_c.shape)
    status = np.empty(h_c.shape, np.uint8)
    rays = RayColumns(h_c, height, sin_z, cos_z, radius, distance)  # h_g is not read

    def heights_of_block(rows: slice) -> None:
        ray_heights(table.pieces, RayColumns(*(a[rows] for a in rays)), height[rows], status[rows])

    in_blocks(heights_of_block, h_c.size)
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

    Parameters
    ----------
    x_px, y_px : (n,) pixels: measured, or those of the straight chord where ``ideal``.
    distance_m : (n,) slant ranges [m], NaN where unknown.
    exposure, exposures, camera, table : as for `correct_observations`.

    Returns the heights above sea level [m], (n,), NaN where the observation lacks something that
    `correct_observations` will name, or its chord ends outside the profile.
    """
    rays = target_rays(x_px, y_px, exposure, exposures, camera=camera, ideal=ideal)
    h_c, radius = rays[H_C], rays[RADIUS]
    if ideal:
        with np.errstate(invalid="ignore"):
            return chord_height(h_c, rays[COS], distance_m, radius)
    return height_at_distance(table, h_c, rays[SIN], rays[COS], distance_m, radius=radius)[0]


def target_rays(
    x_px: Array,
    y_px: Array,
    exposure: Integers,
    exposures: Exposures,
    *,
    camera: Camera,
    ideal: bool,
) -> Array:
    """The matrix of rays (RAY_ROWS, n) of pixels as in `target_heights`; NaN where there is none.

    Where ``ideal`` they are the straight chords themselves.
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
        x_px, y_px = x_px + _MARGIN_PX, y_px + _MARGIN_PX
    anywhere = np.zeros(x_px.size)
    observed = ObservationColumns(x_px, y_px, anywhere, anywhere, exposure)
    rays, _, _ = outgoing_rays(observed, camera.constants, exposures.columns)
    return rays


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
    """As `height_at_distance`, starting with the height along the apparent direction."""
    h_c, _, sin_z, cos_z, radius, distance = rays
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(distance) & (distance > 0.0)
        given = np.where(sound, distance, math.nan)
        height = chord_height(h_c, cos_z, given, radius)
        for _ in range(_ROUNDS):
            r_c, status = bend(table, h_c, height, sin_z, cos_z, radius=radius)
            cos_chord = cos_z * np.cos(r_c) + sin_z * np.sin(r_c)
            step = chord_height(h_c, cos_chord, given, radius) - height
            height = height + step
            if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE_M:
                break
    status[(status == OK) & ~(np.abs(step) <= _CLOSE_M)] = MISSES_GROUND
    status[~sound] = BAD_MEASUREMENT
    return np.where(status == OK, height, math.nan), status
