"""Standard deviations of corrections, row by row, compiled."""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import (
    CABIN_SIGMAS,
    CAMERA_HEIGHT,
    DIRECTION,
    HEIGHT_SHARE,
    IDEAL_U,
    IDEAL_V,
    LENS_SIGMAS,
    NADIR_COSINE,
    NADIR_SINE,
    NODE_SHARE,
    RAY_ROWS,
    REFRACTIVITY,
    RELATIVE_GRADIENT,
    SIGMA_HEIGHT,
    SPHERE_RADIUS,
    TABLE_NODE,
    TILT_VARIANCE,
    WINDOW_GRADIENT,
    WINDOW_KIND,
    WINDOW_NORMAL,
    YAW_AXIS_EAST,
    YAW_AXIS_NORTH,
    YAW_EXCESS_VARIANCE,
)
from unbend.refraction.kernels.distortion import slopes
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.status_codes import FAR_BRANCH

_TOGETHER = 256
"""Rows that are worked on together, in a room that stays in a core's first cache."""

_OF_RAYS = (
    IDEAL_U,
    IDEAL_V,
    DIRECTION,
    DIRECTION + 1,
    NADIR_SINE,
    NADIR_COSINE,
    SPHERE_RADIUS,
    CAMERA_HEIGHT,
)
"""Rows of a matrix of rays that are copied to that room."""

# Further rows of it: what observations have,
_X = RAY_ROWS
_Y = _X + 1
_R = _X + 2
_H_G = _X + 3
_SIGMA_H_G = _X + 4
_KEEP = _X + 5  # 1, or NaN where no sigma is known
_DROP = _X + 6  # from the camera to the target [m]
# their places in the tables,
_WAY = _X + 7
_COARSE = _X + 8
_INCIDENCE = _X + 9
_GROUND = _X + 10  # and then N at the target
# what the air does there,
_SPREAD = _X + 11  # sigma of R_c / tan(zeta)
_STEEP = _X + 12  # dR/dzeta cos^2(zeta)
_MODE = _X + 13
_BEHIND = _X + 14
_SHARED = _X + 15
# the slopes of the distortion (3), and the columns of `Sigmas`.
_SLOPES = _X + 16
_OUT = _SLOPES + 3
_SIGMAS = 14
_ROOM = _OUT + _SIGMAS

_AT_NADIR = 1e-9  # the sine below which R / sin(zeta) is dR/dzeta, and no azimuth is known


class _Motion(NamedTuple):
    """How a ray turns, and with what.

    ``tan_z`` tangent of the nadir angle; ``d_zeta`` dR/dzeta; ``swing`` R/sin(zeta); ``out_t`` and
    ``out_q`` how far the ray turns towards the nadir and across per unit of dN_c - dN_cc at the
    window; ``d_h_c`` and ``d_h_g`` dR/dh_c and dR/dh_g [rad/m]; ``yaw_along`` and ``yaw_across``
    the yaw axis in the ray's vertical plane and across it.
    """

    tan_z: float
    d_zeta: float
    swing: float
    out_t: float
    out_q: float
    d_h_c: float
    d_h_g: float
    yaw_along: float
    yaw_across: float


class _AirOfRay(NamedTuple):
    """Sigma of R_c, sigma of x, its covariance with y over sigma of y, and sigma of y."""

    sigma_r: float
    sigma_x: float
    shared: float
    sigma_y: float


class _BentRay(NamedTuple):
    """Sine and cosine of zeta, radius and camera's height [m], fall to the target [m], R."""

    sin_z: float
    cos_z: float
    radius: float
    h_c: float
    drop: float
    r: float


@jit
def _bilinear(table, i, a, j, b):  # type: ignore[no-untyped-def]
    """Bilinear in a table (c, w)."""
    low = table[i, j] + b * (table[i, j + 1] - table[i, j])
    high = table[i + 1, j] + b * (table[i + 1, j + 1] - table[i + 1, j])
    return low + a * (high - low)


@jit
def _cell(position, count):  # type: ignore[no-untyped-def]
    """The node below a position, held within a table, and the share of the way to the next."""
    held = min(max(position, 0.0), count - 1.0)
    node = min(int(held), count - 2)
    return node, held - node


@jit
def _of_exposure(s, turn, air):  # type: ignore[no-untyped-def]
    """A row of the matrix of stations and a rotation as numbers; sigma of y, the mode's part of y.

    The last two are zero without a plane window.
    """
    station = (
        s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9],
        s[10], s[11], s[12], s[13], s[14], s[15], s[16], s[17], s[18],
    )  # fmt: skip
    first = turn[0]
    second = turn[1]
    third = turn[2]
    rows = (
        (first[0], first[1], first[2]),
        (second[0], second[1], second[2]),
        (third[0], third[1], third[2]),
    )
    i = int(s[TABLE_NODE])
    a = s[NODE_SHARE]
    window = int(s[WINDOW_KIND])
    sigma_y = 0.0
    mode_y = 0.0
    if window >= 0:
        lean = air.lean[window]
        mode = air.mode_lean[window]
        sigma_y = lean[i] + a * (lean[i + 1] - lean[i])
        mode_y = (mode[i] + a * (mode[i + 1] - mode[i])) / air.mode_sigma
    return station, rows, (sigma_y, mode_y)


@jit
def _interpolate(room, count, air, s):  # type: ignore[no-untyped-def]
    """Fill what the air does to rays by their places in the tables; NaN in, NaN out."""
    sigma = air.sigma
    angle = air.angle
    factors = air.factors
    behind = air.behind
    refractivity = air.refractivity
    i = int(s[TABLE_NODE])
    a = s[NODE_SHARE]
    window = int(s[WINDOW_KIND])
    e, share = _cell(s[HEIGHT_SHARE] * (factors.shape[0] - 1), factors.shape[0])
    for r in range(count):
        j, b = _cell(room[_WAY, r], sigma.shape[1])
        drop = room[_DROP, r]
        spread = _bilinear(sigma, i, a, j, b)
        turn = _bilinear(angle, i, a, j, b)
        mode = _bilinear(air.mode, i, a, j, b)
        room[_BEHIND, r] = 0.0
        room[_SHARED, r] = 0.0
        if window >= 0:
            room[_BEHIND, r] = _bilinear(behind[window, 0], i, a, j, b)
            room[_SHARED, r] = _bilinear(behind[window, 1], i, a, j, b)
        j, b = _cell(room[_COARSE, r], factors.shape[1])
        k, c = _cell(room[_INCIDENCE, r], factors.shape[2])
        spread_factor = 0.0
        turn_factor = 0.0
        for corner in range(8):
            f = corner >> 2
            g = (corner >> 1) & 1
            h = corner & 1
            by_height = share if f else 1.0 - share
            by_way = b if g else 1.0 - b
            by_incidence = c if h else 1.0 - c
            weight = by_height * by_way * by_incidence
            spread_factor += weight * factors[e + f, j + g, k + h, 0]
            turn_factor += weight * factors[e + f, j + g, k + h, 1]
            mode += weight * factors[e + f, j + g, k + h, 2]
        room[_SPREAD, r] = spread * spread_factor * drop
        room[_STEEP, r] = turn * turn_factor * drop
        room[_MODE, r] = mode * drop / air.mode_sigma
        j, b = _cell(room[_GROUND, r], refractivity.size)
        room[_GROUND, r] = refractivity[j] + b * (refractivity[j + 1] - refractivity[j])


@jit
def _by_heights(ray, d_zeta, n_g, s):  # type: ignore[no-untyped-def]
    """dR/dh_c and dR/dh_g [rad/m]; formulas of `unbend.refraction.uncertainty.sensitivity`.

    ``ray`` is a `_BentRay`.
    """
    sin_z, cos_z, radius, h_c, drop, r = ray
    r_c = radius + h_c
    r_g = radius + h_c - drop
    n_c = s[REFRACTIVITY]
    sin_r = r * (1.0 - r * r / 6.0)
    cos_t = cos_z * (1.0 - 0.5 * r * r) + sin_z * sin_r
    sin_t = sin_z * (1.0 - 0.5 * r * r) - cos_z * sin_r
    down = math.sqrt(r_c * r_c * cos_t * cos_t - drop * (r_c + r_g))
    chord = drop * (r_c + r_g) / (r_c * cos_t + down)
    turned = r_c * sin_r * (cos_z + 0.5 * r * sin_z)
    sines = (r_c * sin_z * (n_g - n_c) / (1.0 + n_g) - turned) / r_g
    sin_g = r_c * sin_t / r_g - sines
    cos_g = math.sqrt(1.0 - sin_g * sin_g)
    d_h_g = -2.0 * sines / ((down / r_g + cos_g) * chord * cos_g)
    tan_z = sin_z / cos_z
    bend = s[RELATIVE_GRADIENT]
    d_h_c = tan_z * (d_zeta * (bend + 1.0 / r_c) - bend) - sin_r / (chord * cos_z)
    return d_h_c, d_h_g


@jit
def _turns(axis, east, north, sin_z, cos_z):  # type: ignore[no-untyped-def]
    """Parts along an axis of the camera of unit vectors towards the nadir, and across the ray's
    vertical plane."""
    towards = -cos_z * (axis[0] * east + axis[1] * north) - sin_z * axis[2]
    across = axis[1] * east - axis[0] * north
    return towards, across


@jit
def _moved(point, t, camera, d_image):  # type: ignore[no-untyped-def]
    """What a turn of the ray towards the unit vector t does to its pixel [px/rad]."""
    u, v, depth = point
    uu, uv, vv = d_image
    x = t[0] - u * t[2]
    y = t[1] - v * t[2]
    moved_x = camera.fx * depth * (uu * x + uv * y)
    moved_y = camera.fy * depth * (uv * x + vv * y)
    return moved_x, moved_y


@jit
def _in_the_image(along, across, motion, air, s):  # type: ignore[no-untyped-def]
    """Sigma of x or y [px] by the air and by the station, and the pixel's motion with h_g [px/m].

    ``along`` and ``across`` are what a turn of the ray along the vertical plane and across it does
    to the pixel [px/rad]; ``air`` is an `_AirOfRay`, ``motion`` a `_Motion`.
    """
    # What dN_c - dN_cc does at the window, and how much of it is not the x of a level one.
    window = along * motion.out_t + across * motion.out_q
    by_air = abs(along) * air.sigma_r
    if s[WINDOW_KIND] >= 0.0:
        straight = along * motion.tan_z
        leaning = window - along * (motion.tan_z * (1.0 - motion.d_zeta))
        both = straight * straight * air.sigma_x * air.sigma_x
        both += 2.0 * straight * leaning * air.shared * air.sigma_y
        both += leaning * leaning * air.sigma_y * air.sigma_y
        by_air = 0.0 if both < 0.0 else math.sqrt(both)
    # A tilt turns the nadir: zeta by its part in the ray's plane, the plane by that across it.
    k_e = -motion.d_zeta * along
    k_p = motion.swing * across
    turned2 = s[TILT_VARIANCE] * (k_e * k_e + k_p * k_p)
    by_yaw = k_e * motion.yaw_along + k_p * motion.yaw_across
    turned2 += s[YAW_EXCESS_VARIANCE] * (by_yaw * by_yaw)
    lift = (along * motion.d_h_c + window * s[WINDOW_GRADIENT]) * s[SIGMA_HEIGHT]
    by_station = math.sqrt(turned2 + lift * lift)
    return by_air, by_station, along * motion.d_h_g


@within
def _places(room, count, air):  # type: ignore[no-untyped-def]
    """Fill where rays are in the tables; rays that are nearly level, or not kept, become NaN."""
    way_first = air.way_first
    way_step = air.way_step
    coarse_step = air.coarse_step
    incidence_step = air.incidence_step
    most = air.factors.shape[2] - 1.0
    ground_m = air.ground_m
    spacing_m = air.spacing_m
    for i in range(count):
        h_c = room[CAMERA_HEIGHT, i]
        cos_z = room[NADIR_COSINE, i]
        r_c = room[SPHERE_RADIUS, i] + room[CAMERA_HEIGHT, i]
        drop = h_c - room[_H_G, i]
        r_g = room[SPHERE_RADIUS, i] + h_c - drop
        level2 = (r_c * r_c * cos_z * cos_z - drop * (r_c + r_g)) / (r_g * r_g)
        root = math.sqrt(drop) - way_first
        incidence = (1.0 / math.sqrt(math.sqrt(level2)) - 1.0) / incidence_step
        served = (room[_KEEP, i] == 1.0) & (drop > 0.0) & (cos_z > 0.0) & (level2 > 0.0)
        served &= incidence <= most
        room[_DROP, i] = drop
        room[_KEEP, i] = 1.0 if served else math.nan
        room[_WAY, i] = root / way_step if served else 0.0
        room[_COARSE, i] = root / coarse_step if served else 0.0
        room[_INCIDENCE, i] = incidence if served else 0.0
        room[_GROUND, i] = (room[_H_G, i] - ground_m) / spacing_m if served else 0.0


@within
def _spread(room, count, camera, exposure):  # type: ignore[no-untyped-def]
    """Fill the columns of `Sigmas`; ``exposure`` as `_of_exposure` returns it.

    A loop without a branch, over rows of one small array, runs four rays at a time.
    """
    fx = camera.fx
    fy = camera.fy
    cx = camera.cx
    cy = camera.cy
    s, turn, (sigma_y, mode_y) = exposure
    window = s[WINDOW_KIND] >= 0.0
    no_window = 1.0 if window else math.nan
    n0 = s[WINDOW_NORMAL]
    n1 = s[WINDOW_NORMAL + 1]
    n2 = s[WINDOW_NORMAL + 2]
    axis_e = s[YAW_AXIS_EAST]
    axis_n = s[YAW_AXIS_NORTH]
    # By pressure and temperature in the cabin.
    n_p = s[CABIN_SIGMAS]
    n_t = s[CABIN_SIGMAS + 1]
    lens_p = s[LENS_SIGMAS]
    lens_t = s[LENS_SIGMAS + 1]
    cabin = math.sqrt(n_p * n_p + n_t * n_t)
    for i in range(count):
        sin_z = room[NADIR_SINE, i]
        cos_z = room[NADIR_COSINE, i]
        r = room[_R, i]
        ray = _BentRay(
            sin_z, cos_z, room[SPHERE_RADIUS, i], room[CAMERA_HEIGHT, i], room[_DROP, i], r
        )
        secant = 1.0 / cos_z
        steep = room[_STEEP, i]
        keep = math.nan if math.isnan(steep) else room[_KEEP, i]
        d_zeta = steep * secant * secant
        sigma_r = room[_SPREAD, i] * sin_z * secant
        d_h_c, d_h_g = _by_heights(ray, d_zeta, room[_GROUND, i], s)

        # At the nadir any azimuth will do.
        inverse = 1.0 / sin_z
        leans = sin_z > _AT_NADIR
        east = room[DIRECTION, i] * inverse if leans else 1.0
        north = room[DIRECTION + 1, i] * inverse if leans else 0.0
        swing = r * inverse if leans else d_zeta
        t_0, q_0 = _turns(turn[0], east, north, sin_z, cos_z)
        t_1, q_1 = _turns(turn[1], east, north, sin_z, cos_z)
        t_2, q_2 = _turns(turn[2], east, north, sin_z, cos_z)
        towards = (t_0, t_1, t_2)
        across = (q_0, q_1, q_2)
        u = room[IDEAL_U, i]
        v = room[IDEAL_V, i]
        point = (u, v, math.sqrt(u * u + v * v + 1.0))

        # How far it turns towards the nadir and across per unit of dN_c - dN_cc.
        out = (n0 * u + n1 * v + n2) / point[2]
        out_t = (n0 * t_0 + n1 * t_1 + n2 * t_2) / out * (1.0 - d_zeta) if window else 0.0
        out_q = (n0 * q_0 + n1 * q_1 + n2 * q_2) / out if window else 0.0
        steepness = math.sqrt(max(0.0, 1.0 - out * out)) / out if window else 0.0
        d_image = (room[_SLOPES, i], room[_SLOPES + 1, i], room[_SLOPES + 2, i])
        along_x, along_y = _moved(point, towards, camera, d_image)
        across_x, across_y = _moved(point, across, camera, d_image)
        yaw_along = axis_n * east - axis_e * north
        yaw_across = -axis_n * north - axis_e * east
        motion = _Motion(
            sin_z * secant, d_zeta, swing, out_t, out_q, d_h_c, d_h_g, yaw_along, yaw_across
        )
        air_of_ray = _AirOfRay(sigma_r, room[_BEHIND, i], room[_SHARED, i], sigma_y)
        air_x, station_x, ground_x = _in_the_image(along_x, across_x, motion, air_of_ray, s)
        air_y, station_y, ground_y = _in_the_image(along_y, across_y, motion, air_of_ray, s)

        # N in the cabin turns the ray at the window (Gyer 1996, Eq. 36), and its air the lens.
        by_mode = room[_MODE, i] * (sin_z * secant)
        turned_x = along_x * out_t + across_x * out_q
        turned_y = along_y * out_t + across_y * out_q
        x_lever = (room[_X, i] - cx) / fx
        y_lever = (room[_Y, i] - cy) / fy
        x_p = turned_x * n_p + x_lever * lens_p
        x_t = turned_x * n_t + x_lever * lens_t
        y_p = turned_y * n_p + y_lever * lens_p
        y_t = turned_y * n_t + y_lever * lens_t
        room[_OUT, i] = sigma_r * keep
        room[_OUT + 1, i] = air_x * keep
        room[_OUT + 2, i] = air_y * keep
        room[_OUT + 3, i] = station_x * keep
        room[_OUT + 4, i] = station_y * keep
        room[_OUT + 5, i] = abs(ground_x) * room[_SIGMA_H_G, i] * keep
        room[_OUT + 6, i] = abs(ground_y) * room[_SIGMA_H_G, i] * keep
        room[_OUT + 7, i] = steepness * cabin * keep
        room[_OUT + 8, i] = math.sqrt(x_p * x_p + x_t * x_t) * keep
        room[_OUT + 9, i] = math.sqrt(y_p * y_p + y_t * y_t) * keep
        room[_OUT + 10, i] = (along_x * by_mode + turned_x * mode_y) * keep
        room[_OUT + 11, i] = (along_y * by_mode + turned_y * mode_y) * keep
        room[_OUT + 12, i] = -turned_x * no_window * keep
        room[_OUT + 13, i] = -turned_y * no_window * keep


@within
def _copy_to_room(room, span, observed, camera, traced):  # type: ignore[no-untyped-def]
    """Fill the first rows of the room: rays, observations and slopes of the distortion."""
    first, count = span
    x, y, h_g, sigma_h_g, _ = observed
    rays, r_c, status = traced
    for k in _OF_RAYS:
        for i in range(count):
            room[k, i] = rays[k, first + i]
    for i in range(count):
        j = first + i
        room[_X, i] = x[j]
        room[_Y, i] = y[j]
        room[_R, i] = r_c[j]
        room[_H_G, i] = h_g[j]
        room[_SIGMA_H_G, i] = sigma_h_g[j]
        far = status[j] == FAR_BRANCH
        room[_KEEP, i] = math.nan if math.isnan(r_c[j]) or far else 1.0
        uu, uv, vv = slopes(rays[IDEAL_U, j], rays[IDEAL_V, j], camera.distortion)
        room[_SLOPES, i] = uu
        room[_SLOPES + 1, i] = uv
        room[_SLOPES + 2, i] = vv


@entry
def propagate(observed, camera_and_rotation, traced, stations_and_air, sigmas):  # type: ignore[no-untyped-def]
    """Fill sigma of R_c [rad], of x and y [px] by air, station and ground, and by the cabin.

    And the derivatives of x and y, with their signs, by the parameter of the leading mode, and by
    the refractivity behind a plane window. ``sigmas`` are the columns of `Sigmas`. NaN where not
    known. Rows of one exposure that follow each other are taken together.
    """
    exposure = observed.exposure
    camera, rotation = camera_and_rotation
    stations, air = stations_and_air
    sigma_r = sigmas[0]
    others = sigmas[1:]
    room = np.empty((_ROOM, _TOGETHER))
    last = 0
    while last < exposure.size:
        first = last
        e = exposure[last]
        while last < exposure.size and last - first < _TOGETHER and exposure[last] == e:
            last += 1
        count = last - first
        if not 0 <= e < stations.shape[0]:
            for k in range(_SIGMAS):
                for i in range(count):
                    room[_OUT + k, i] = math.nan
        else:
            _copy_to_room(room, (first, count), observed, camera, traced)
            of_exposure = _of_exposure(stations[e], rotation[e], air)
            _places(room, count, air)
            _interpolate(room, count, air, of_exposure[0])
            _spread(room, count, camera, of_exposure)
        for i in range(count):
            sigma_r[first + i] = room[_OUT, i]
        for k in range(_SIGMAS - 1):
            out = others[k]
            for i in range(count):
                out[first + i] = room[_OUT + 1 + k, i]
