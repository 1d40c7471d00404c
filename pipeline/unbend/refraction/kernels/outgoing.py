"""From pixels to rays outside the window, compiled.

The rays of n observations are the matrix (RAY_ROWS, n) of rows `IDEAL_U` to `CAMERA_HEIGHT`.
Consecutive observations of one exposure, `ExposureRows`, are taken together. What
belongs to the exposure is read once. Each step is a short loop over the rows without a branch,
which touches few columns: the processor does such loops for four rays at a time.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    DIRECTION,
    IDEAL_U,
    IDEAL_V,
    NADIR_COSINE,
    NADIR_SINE,
    RAY_ROWS,
    SPHERE_RADIUS,
    WINDOW_CHANGE,
)
from unbend.refraction.kernels.distortion import distort, slopes
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.kernels.window import fill_window_change
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
)
from unbend.units import Array

FIRST_NEWTON_STEPS = 3  # enough for nearly all pixels, and without a branch
MORE_NEWTON_STEPS = 30  # at most, for pixels that need more
ROUNDING = 4e-15  # residual in distorted image coordinates below which the iteration ends
CONVERGED = 1e-12  # largest residual in distorted image coordinates that counts as a solution

SERIES_LIMIT_RAD = 0.01  # up to which the series of `fill_window_change` for R_cc is good


class ExposureRows(NamedTuple):
    """The observations ``first`` to ``end`` - 1, which belong to one exposure.

    The numbers are unsigned: an index that might be negative, and count from the end of an array,
    keeps the compiler from doing four rows at a time.
    """

    first: np.uint64
    end: np.uint64


class _ExposureOptics(NamedTuple):
    """The window of one exposure, its rotation, and the ellipsoid there."""

    normal: Array  # (3,) unit vector out of the window, in the camera frame
    excess: float  # n_cabin / n_outside - 1
    rotation: Array  # (3, 3) from east-north-up to the camera frame
    curvature: Array  # (2,) of the ellipsoid in the meridian and in the prime vertical [1/m]


class _Scratch(NamedTuple):
    """Work arrays for all observations."""

    direction: Array  # (3, n) unit vectors in the camera frame
    along_normal: Array  # (n,) part of the change at the window along its normal


@within
def exposure_rows_from(first, exposure):  # type: ignore[no-untyped-def]
    """The `ExposureRows` from row ``first`` on; ``exposure`` (n,) is the exposure of each row."""
    end = first + np.uint64(1)
    while end < exposure.size and exposure[end] == exposure[first]:
        end += np.uint64(1)
    return ExposureRows(first, end)


# ---------------------------------------------------------------------- pixels to camera rays


@jit
def _newton_step(u_d, v_d, u, v, parameters):  # type: ignore[no-untyped-def]
    """The next estimate of the ideal image coordinates that the lens distorts to (u_d, v_d).

    From the estimate (u, v) it is (u, v) + J^-1 ((u_d, v_d) - distort(u, v)), J the symmetric
    matrix of derivatives of the distortion.
    """
    u_0, v_0 = distort(u, v, parameters)
    uu, uv, vv = slopes(u, v, parameters)
    inverse = 1.0 / (uu * vv - uv * uv)
    residual_u = u_d - u_0
    residual_v = v_d - v_0
    next_u = u + (vv * residual_u - uv * residual_v) * inverse
    next_v = v + (uu * residual_v - uv * residual_u) * inverse
    return next_u, next_v


@jit
def _residual(u_d, v_d, u, v, parameters):  # type: ignore[no-untyped-def]
    """How far (u, v), distorted, is from (u_d, v_d): the sum of both absolute differences."""
    u_0, v_0 = distort(u, v, parameters)
    return abs(u_0 - u_d) + abs(v_0 - v_d)


@jit
def _ideal_coordinates(u_d, v_d, u, v, parameters):  # type: ignore[no-untyped-def]
    """Ideal image coordinates that the lens distorts to (u_d, v_d), by Newton's iteration.

    The iteration begins with (u, v). Both results are NaN where it does not converge.
    """
    for _ in range(MORE_NEWTON_STEPS):
        if _residual(u_d, v_d, u, v, parameters) < ROUNDING:
            break
        u, v = _newton_step(u_d, v_d, u, v, parameters)
    if _residual(u_d, v_d, u, v, parameters) < CONVERGED:
        return u, v
    return math.nan, math.nan


@jit
def _fill_ideal_coordinates(rows, pixels, camera, change_px, rays):  # type: ignore[no-untyped-def]
    """Fill `IDEAL_U` and `IDEAL_V` of ``rays`` for the observations ``rows``, `ExposureRows`.

    ``pixels`` are x and y (n,) [px]. ``change_px`` [px] is added to the calibrated principal
    distance. The coordinates are NaN where the pixel is outside the format or outside the radius in
    which the distortion can be inverted, where the iteration does not converge, and where the
    principal distance is not positive.
    """
    x, y = pixels
    fx = camera.fx + change_px
    fy = camera.fy + change_px
    cx = camera.cx
    cy = camera.cy
    width = camera.width
    height = camera.height
    parameters = camera.distortion
    u = rays[IDEAL_U]
    v = rays[IDEAL_V]

    # The distorted coordinates, in two rows that are filled with other values afterwards.
    u_d = rays[WINDOW_CHANGE]
    v_d = rays[WINDOW_CHANGE + 1]
    for i in range(rows.first, rows.end):
        u_d[i] = (x[i] - cx) / fx
        v_d[i] = (y[i] - cy) / fy

    # The first of Newton's steps, for all pixels: a fixed number, so that the loop has no branch.
    for i in range(rows.first, rows.end):
        u_i = u_d[i]
        v_i = v_d[i]
        for _ in range(FIRST_NEWTON_STEPS):
            u_i, v_i = _newton_step(u_d[i], v_d[i], u_i, v_i, parameters)
        u[i] = u_i
        v[i] = v_i

    # Further steps until each pixel converges, and NaN for pixels that the camera does not cover.
    has_distance = 0.0 < fx < math.inf and 0.0 < fy < math.inf
    for i in range(rows.first, rows.end):
        u_i = math.nan
        v_i = math.nan
        if has_distance and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            u_i, v_i = _ideal_coordinates(u_d[i], v_d[i], u[i], v[i], parameters)
        if not u_i * u_i + v_i * v_i <= camera.largest_radius * camera.largest_radius:
            u_i = math.nan
            v_i = math.nan
        u[i] = u_i
        v[i] = v_i


@entry
def rays_of_pixels(x, y, camera, rays):  # type: ignore[no-untyped-def]
    """Fill `IDEAL_U` and `IDEAL_V` of ``rays`` for pixels x, y (n,) [px].

    NaN for pixels that the camera does not cover.
    """
    rows = ExposureRows(np.uint64(0), np.uint64(x.size))
    _fill_ideal_coordinates(rows, (x, y), camera, 0.0, rays)


# ---------------------------------------------------------------------- through the window


@jit
def _fill_camera_directions(rows, rays, direction):  # type: ignore[no-untyped-def]
    """Fill ``direction`` (3, n) with (u, v, 1) as a unit vector, in the camera frame."""
    u = rays[IDEAL_U]
    v = rays[IDEAL_V]
    for i in range(rows.first, rows.end):
        direction[2, i] = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0)
    for i in range(rows.first, rows.end):
        direction[0, i] = u[i] * direction[2, i]
        direction[1, i] = v[i] * direction[2, i]


@within
def _fill_rays_outside(rows, rays, scratch, optics, r_cc):  # type: ignore[no-untyped-def]
    """Fill the rays of one exposure outside the window from their ideal image coordinates.

    ``optics`` is the `_ExposureOptics`, ``scratch`` a `_Scratch`, ``rows`` the `ExposureRows`.
    Filled are the rows `WINDOW_CHANGE` to `SPHERE_RADIUS` of ``rays``, and ``r_cc`` [rad], the
    refraction angle at the window. All are NaN where the ideal image coordinates are.
    """
    normal = optics.normal
    excess = optics.excess
    rotation = optics.rotation
    direction = scratch.direction
    along_normal = scratch.along_normal
    _fill_camera_directions(rows, rays, direction)

    # Through the window (Gyer 1996, Eq. 36): change = excess * direction + along_normal * normal.
    if excess == 0.0:
        for i in range(rows.first, rows.end):
            along_normal[i] = 0.0
            r_cc[i] = 0.0
    else:
        fill_window_change(
            rows,
            direction=direction,
            normal=normal,
            excess=excess,
            along_normal=along_normal,
            r_cc=r_cc,
        )
    for k in range(3):
        change = rays[WINDOW_CHANGE + k]
        direction_k = direction[k]
        normal_k = normal[k]
        for i in range(rows.first, rows.end):
            change[i] = excess * direction_k[i] + along_normal[i] * normal_k
    for k in range(3):
        change = rays[WINDOW_CHANGE + k]
        direction_k = direction[k]
        for i in range(rows.first, rows.end):
            direction_k[i] += change[i]

    # From the camera frame to east, north and up: by the transposed rotation.
    d_0 = direction[0]
    d_1 = direction[1]
    d_2 = direction[2]
    for k in range(3):
        t_0 = rotation[0, k]
        t_1 = rotation[1, k]
        t_2 = rotation[2, k]
        apparent = rays[DIRECTION + k]
        for i in range(rows.first, rows.end):
            apparent[i] = t_0 * d_0[i] + t_1 * d_1[i] + t_2 * d_2[i]
    _fill_nadir_angle_and_radius(rows, rays, optics.curvature)


@jit
def _fill_nadir_angle_and_radius(rows, rays, curvature):  # type: ignore[no-untyped-def]
    """Fill `NADIR_SINE`, `NADIR_COSINE` and `SPHERE_RADIUS` from the `DIRECTION` of rays.

    The radius is Euler's in the azimuth A of the ray, 1 / R = cos^2(A) / M + sin^2(A) / N, from
    ``curvature``, 1 / M in the meridian and 1 / N in the prime vertical [1/m]. A ray at the nadir
    has no azimuth and gets the radius M.
    """
    meridian = curvature[0]
    prime_vertical = curvature[1]
    east = rays[DIRECTION]
    north = rays[DIRECTION + 1]
    up = rays[DIRECTION + 2]
    sine = rays[NADIR_SINE]
    cosine = rays[NADIR_COSINE]
    radius = rays[SPHERE_RADIUS]
    for i in range(rows.first, rows.end):
        # Rounding may leave the sine of a level ray 1e-16 above one.
        length = math.sqrt(east[i] * east[i] + north[i] * north[i])
        sine[i] = 1.0 if length > 1.0 else length
        down = -up[i]
        if down > 1.0:
            down = 1.0
        elif down < -1.0:
            down = -1.0
        cosine[i] = down
    for i in range(rows.first, rows.end):
        north2 = north[i] * north[i]
        level2 = east[i] * east[i] + north2
        cos2_azimuth = north2 / level2 if level2 > 0.0 else 1.0
        radius[i] = 1.0 / (prime_vertical + cos2_azimuth * (meridian - prime_vertical))


# ---------------------------------------------------------------------- status


@jit
def _status_of_input(x, y, h_g, has_station):  # type: ignore[no-untyped-def]
    """The status of an observation before its ray is computed: `OK`, or why there is no ray.

    ``has_station`` is False where its exposure has no known station.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        return BAD_MEASUREMENT
    if not has_station:
        return NO_STATION
    if not math.isfinite(h_g):
        return NO_GROUND
    return OK


@within
def _set_status_of_rays(rows, rays, refractivity_outside, r_cc, status):  # type: ignore[no-untyped-def]
    """Set the status of observations without a ray, and their ``rays`` and ``r_cc`` to NaN.

    ``refractivity_outside`` is NaN where the camera is outside the profile. An R_cc that is too
    large for its series, near total reflection, is replaced by 2 asin(length of the change at the
    window / 2).
    """
    u = rays[IDEAL_U]
    for i in range(rows.first, rows.end):
        if status[i] == OK:
            if math.isnan(u[i]):
                status[i] = OUTSIDE_CAMERA
            elif math.isnan(refractivity_outside):
                status[i] = OUTSIDE_PROFILE
            elif math.isnan(r_cc[i]):  # the window reflects the ray
                status[i] = OUTSIDE_CAMERA
            elif abs(r_cc[i]) > SERIES_LIMIT_RAD:
                x = rays[WINDOW_CHANGE, i]
                y = rays[WINDOW_CHANGE + 1, i]
                z = rays[WINDOW_CHANGE + 2, i]
                length = math.sqrt(x * x + y * y + z * z)
                r_cc[i] = math.copysign(2.0 * math.asin(0.5 * length), r_cc[i])
        if status[i] != OK:
            r_cc[i] = math.nan
            for k in range(RAY_ROWS):
                rays[k, i] = math.nan


@entry
def fill_outgoing_rays(observed, camera, exposures, outgoing):  # type: ignore[no-untyped-def]
    """Fill ``outgoing``, the `OutgoingRays` of ``observed``: rays outside the window, R_cc, status.

    ``observed`` are `ObservationColumns`, ``camera`` the `CameraConstants`, ``exposures`` the
    `ExposureColumns`. Where the status is not `OK` there is no ray, and all numbers are NaN.
    """
    x = observed.x
    y = observed.y
    h_g = observed.h_g
    exposure = observed.exposure
    rays = outgoing.rays
    r_cc = outgoing.r_cc
    status = outgoing.status
    work = np.empty((4, x.size))
    scratch = _Scratch(direction=work[:3], along_normal=work[3])
    first = np.uint64(0)  # unsigned as in `ExposureRows`
    while first < x.size:
        rows = exposure_rows_from(first, exposure)
        e = exposure[first]
        has_station = 0 <= e < exposures.usable.size and exposures.usable[e]
        for i in range(rows.first, rows.end):
            status[i] = _status_of_input(x[i], y[i], h_g[i], has_station)
        refractivity_outside = math.nan
        if has_station:
            refractivity_outside = exposures.outside[e]
            difference = exposures.cabin[e] - refractivity_outside
            height = exposures.height[e]
            for i in range(rows.first, rows.end):
                rays[CAMERA_HEIGHT, i] = height
            _fill_ideal_coordinates(rows, (x, y), camera, exposures.change_px[e], rays)
            optics = _ExposureOptics(
                normal=exposures.normal[e],
                excess=difference / (1.0 + refractivity_outside),
                rotation=exposures.rotation[e],
                curvature=exposures.curvature[e],
            )
            _fill_rays_outside(rows, rays, scratch, optics, r_cc)
        # Rays without a station were not filled: their status makes them NaN.
        _set_status_of_rays(rows, rays, refractivity_outside, r_cc, status)
        first = rows.end
