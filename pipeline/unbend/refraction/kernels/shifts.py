"""From refraction angles back to pixels: the shifts in the image and on the ground, compiled.

The straight ray to the target is the apparent one, turned towards the nadir by R_c: with the nadir
angle z, east e, north n and up u of the apparent unit vector,

    e' - e = e (-2 sin^2(R_c / 2) - sin(R_c) cos(z) / sin(z)),   n' - n likewise,
    u' - u = -2 u sin^2(R_c / 2) - sin(R_c) sin(z),

the vector form of Gyer 1996, Eq. 40-51, without a difference of directions.

In these functions r_c and r_g are distances from the earth's centre, and R_c is ``angle``.
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
    SPHERE_RADIUS,
    WINDOW_CHANGE,
    CameraConstants,
)
from unbend.refraction.kernels.distortion import distort, slopes
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.kernels.outgoing import exposure_rows_from
from unbend.refraction.status_codes import FAR_BRANCH
from unbend.units import Array


class _Scratch(NamedTuple):
    """Work arrays for all observations."""

    sin_half_r: Array  # (n,) sin(R_c / 2)
    sin_r: Array  # (n,) sin(R_c)
    to_nadir: Array  # (3, n) straight less apparent unit vector outside: e' - e, n' - n, u' - u
    vector: Array  # (3, n) any vector of each ray; each function that uses it fills it first


class _ExposedCamera(NamedTuple):
    """The camera of one exposure and its pose."""

    camera: CameraConstants
    rotation: Array  # (3, 3) from east-north-up to the camera frame
    change_px: float  # what the air in the lens adds to the principal distance [px]


@jit
def _straight_distance(cos_z, h_c, h_g, radius, is_far):  # type: ignore[no-untyped-def]
    """Distance D [m] along a straight line from height h_c to height h_g; NaN without a crossing.

    ``cos_z`` is the cosine of its nadir angle z at h_c. With r = radius + h the law of cosines
    gives D^2 - 2 D r_c cos(z) + r_c^2 - r_g^2 = 0. Downwards D is the smaller root, or with
    ``is_far`` the larger; upwards only the larger is positive.
    """
    if h_c == h_g and not is_far:
        return 0.0
    along = (radius + h_c) * cos_z
    square_difference = (h_c - h_g) * (2.0 * radius + h_c + h_g)  # r_c^2 - r_g^2
    root = math.sqrt(along * along - square_difference)
    is_near = h_c > h_g and not is_far
    distance = square_difference / (along + root) if is_near else along + root
    return distance if distance >= 0.0 else math.nan


@entry
def fill_straight_reach(rays, is_far, distance):  # type: ignore[no-untyped-def]
    """Fill ``distance`` (n,) [m] along straight lines from cameras to their targets' heights.

    ``rays`` are `RayColumns`, of them sin_c is not read. Downwards it is the nearer of two
    crossings, or the farther where ``is_far`` (n,); NaN without a crossing.
    """
    for i in range(distance.size):
        distance[i] = _straight_distance(
            rays.cos_c[i], rays.h_c[i], rays.h_g[i], rays.r_e[i], is_far[i]
        )


@within
def _fill_turn_to_nadir(rays, angle, scratch):  # type: ignore[no-untyped-def]
    """Fill ``scratch.to_nadir`` (3, n), unit vectors of straight less apparent rays outside.

    ``angle`` (n,) is R_c [rad]; the equations are those of the module. Also filled are ``sin_r``
    and ``sin_half_r``.
    """
    sin_half_r = scratch.sin_half_r
    sin_r = scratch.sin_r
    to_nadir = scratch.to_nadir
    for i in range(angle.size):
        sin_half_r[i] = math.sin(0.5 * angle[i])
        sin_r[i] = math.sin(angle[i])
    for i in range(angle.size):
        sin_z = rays[NADIR_SINE, i]
        cos_z = rays[NADIR_COSINE, i]
        second_order = -2.0 * (sin_half_r[i] * sin_half_r[i])
        # A ray at the nadir has R_c = 0: the term is zero, and 0 / 0 is avoided.
        first_order = sin_r[i] * cos_z / sin_z if sin_z > 0.0 else 0.0
        to_nadir[0, i] = rays[DIRECTION, i] * (second_order - first_order)
        to_nadir[1, i] = rays[DIRECTION + 1, i] * (second_order - first_order)
        to_nadir[2, i] = rays[DIRECTION + 2, i] * second_order - sin_r[i] * sin_z


@within
def _fill_image_shift(rows, rays, scratch, exposed, shifts):  # type: ignore[no-untyped-def]
    """Fill ``dx`` and ``dy`` [px], corrected less measured pixel, for the rows of one exposure.

    ``exposed`` is its `_ExposedCamera`, ``shifts`` are the `Shifts`. The measured x - cx is
    (fx + ``change_px``) u_d, with u_d the distorted u of the ray inside the camera. The corrected
    x - cx is fx u_d, with u_d that of the straight ray. The straight ray is the unit vector of
    (u, v, 1), changed by the window and by the turn to the nadir. Likewise y.
    """
    camera = exposed.camera
    rotation = exposed.rotation
    change_px = exposed.change_px
    dx = shifts.dx
    dy = shifts.dy
    fx = camera.fx
    fy = camera.fy
    parameters = camera.distortion
    u = rays[IDEAL_U]
    v = rays[IDEAL_V]
    east = scratch.to_nadir[0]
    north = scratch.to_nadir[1]
    up = scratch.to_nadir[2]
    # The change of the unit vector by the window and by the turn to the nadir, in the camera frame.
    change = scratch.vector
    for k in range(3):
        t_0 = rotation[k, 0]
        t_1 = rotation[k, 1]
        t_2 = rotation[k, 2]
        at_window = rays[WINDOW_CHANGE + k]
        change_k = change[k]
        for i in range(rows.first, rows.end):
            change_k[i] = at_window[i] + (t_0 * east[i] + t_1 * north[i] + t_2 * up[i])
    change_x = change[0]
    change_y = change[1]
    change_z = change[2]
    for i in range(rows.first, rows.end):
        # u of the straight ray, its x / z, is (u z + change_x) / (z + change_z), with z of the unit
        # vector inside; here without a difference of near numbers.
        straight_z = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0) + change_z[i]
        u_straight = u[i] + (change_x[i] - u[i] * change_z[i]) / straight_z
        v_straight = v[i] + (change_y[i] - v[i] * change_z[i]) / straight_z
        u_measured, v_measured = distort(u[i], v[i], parameters)
        u_corrected, v_corrected = distort(u_straight, v_straight, parameters)
        dx[i] = fx * (u_corrected - u_measured) - change_px * u_measured
        dy[i] = fy * (v_corrected - v_measured) - change_px * v_measured


@jit
def _error_without_lens_change(u, v, camera, change_px):  # type: ignore[no-untyped-def]
    """How far ideal coordinates are wrong if the pixel is read without the change of the lens.

    The ray (u, v) is imaged with the principal distances fx + ``change_px`` and fy + ``change_px``.
    The stated calibration, with fx and fy, gives its pixel the ideal coordinates u + du, v + dv.
    Returns du and dv to first order; the second order is 1e-4 of that.
    """
    u_distorted, v_distorted = distort(u, v, camera.distortion)
    du_distorted = change_px / camera.fx * u_distorted
    dv_distorted = change_px / camera.fy * v_distorted
    uu, uv, vv = slopes(u, v, camera.distortion)
    determinant = uu * vv - uv * uv
    du = (vv * du_distorted - uv * dv_distorted) / determinant
    dv = (uu * dv_distorted - uv * du_distorted) / determinant
    return du, dv


@within
def _add_change_of_lens(rows, rays, exposed, inside):  # type: ignore[no-untyped-def]
    """Change rays inside the window to those that the stated calibration gives their pixels.

    ``inside`` (3, n) are their unit vectors in east, north and up, ``rows`` those of the exposure
    ``exposed``. The stated calibration omits the change of the principal distance.
    """
    rotation = exposed.rotation
    for i in range(rows.first, rows.end):
        u = rays[IDEAL_U, i]
        v = rays[IDEAL_V, i]
        du, dv = _error_without_lens_change(u, v, exposed.camera, exposed.change_px)
        z = 1.0 / math.sqrt(u * u + v * v + 1.0)
        stated_z = 1.0 / math.sqrt((u + du) * (u + du) + (v + dv) * (v + dv) + 1.0)
        change_x = (u + du) * stated_z - u * z
        change_y = (v + dv) * stated_z - v * z
        change_z = stated_z - z
        # From the camera frame to east, north and up: by the transposed rotation.
        for k in range(3):
            along_x = rotation[0, k] * change_x
            along_y = rotation[1, k] * change_y
            along_z = rotation[2, k] * change_z
            inside[k, i] += along_x + along_y + along_z


@within
def _fill_ground_shift(rows, traced, h_g, scratch, exposed, shift):  # type: ignore[no-untyped-def]
    """Fill ``shift`` [m], how far apart the raw and the true ray meet the target's height ``h_g``.

    Both are straight. The raw ray has the direction that the stated calibration gives the measured
    pixel, the true ray is that to the target. Filled are the ``rows`` of one exposure, ``exposed``.
    """
    rotation = exposed.rotation
    rays = traced.rays
    status = traced.status
    to_nadir = scratch.to_nadir
    inside = scratch.vector
    radius = rays[SPHERE_RADIUS]
    h_c = rays[CAMERA_HEIGHT]
    at_window_0 = rays[WINDOW_CHANGE]
    at_window_1 = rays[WINDOW_CHANGE + 1]
    at_window_2 = rays[WINDOW_CHANGE + 2]
    # The direction inside the window in east, north and up: outside less the change at the window.
    for k in range(3):
        t_0 = rotation[0, k]
        t_1 = rotation[1, k]
        t_2 = rotation[2, k]
        apparent = rays[DIRECTION + k]
        inside_k = inside[k]
        for i in range(rows.first, rows.end):
            change = t_0 * at_window_0[i] + t_1 * at_window_1[i] + t_2 * at_window_2[i]
            inside_k[i] = apparent[i] - change
    if exposed.change_px != 0.0:
        _add_change_of_lens(rows, rays, exposed, inside)
    east = rays[DIRECTION]
    north = rays[DIRECTION + 1]
    up = rays[DIRECTION + 2]
    for i in range(rows.first, rows.end):
        is_far = status[i] == FAR_BRANCH
        cos_raw = -inside[2, i]  # of the nadir angle
        cos_true = -up[i] - to_nadir[2, i]
        raw_m = _straight_distance(cos_raw, h_c[i], h_g[i], radius[i], is_far)
        true_m = _straight_distance(cos_true, h_c[i], h_g[i], radius[i], is_far)
        # The point of the raw ray less that of the true ray.
        to_east = inside[0, i] * raw_m - (east[i] + to_nadir[0, i]) * true_m
        to_north = inside[1, i] * raw_m - (north[i] + to_nadir[1, i]) * true_m
        upwards = inside[2, i] * raw_m - (up[i] + to_nadir[2, i]) * true_m
        shift[i] = math.sqrt(to_east * to_east + to_north * to_north + upwards * upwards)


@entry
def fill_shifts(observed, camera, exposures, traced, shifts):  # type: ignore[no-untyped-def]
    """Fill ``shifts``, the `Shifts` in the image and on the ground by the refraction of rays.

    ``observed`` are `ObservationColumns`, ``camera`` `CameraConstants`, ``exposures``
    `ExposureColumns` and ``traced`` `TracedColumns`. Shifts are NaN where there is no refraction
    angle, as in a row with an exposure that is not among ``exposures``.
    """
    exposure = observed.exposure
    exposure_count = exposures.usable.size
    angle = traced.angle
    work = np.empty((8, angle.size))
    scratch = _Scratch(sin_half_r=work[0], sin_r=work[1], to_nadir=work[2:5], vector=work[5:8])
    _fill_turn_to_nadir(traced.rays, angle, scratch)
    first = np.uint64(0)  # unsigned as in `ExposureRows`
    while first < angle.size:
        rows = exposure_rows_from(first, exposure)
        e = exposure[first]
        if 0 <= e < exposure_count:
            rotation = exposures.rotation[e]
            exposed = _ExposedCamera(camera, rotation, exposures.change_px[e])
            _fill_image_shift(rows, traced.rays, scratch, exposed, shifts)
            _fill_ground_shift(
                rows,
                traced,
                h_g=observed.h_g,
                scratch=scratch,
                exposed=exposed,
                shift=shifts.ground,
            )
        first = rows.end
    for i in range(angle.size):
        if math.isnan(angle[i]):
            shifts.dx[i] = math.nan
            shifts.dy[i] = math.nan
            shifts.ground[i] = math.nan
