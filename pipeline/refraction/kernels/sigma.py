"""Standard deviations of corrections, row by row, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from pipeline.refraction.kernels.columns import (
    APPARENT,
    AXIS_E,
    AXIS_N,
    BEND,
    COS,
    H_C,
    NODE,
    NORMAL,
    RADIUS,
    SHARE,
    SIGMA_H,
    SIN,
    SPAN,
    TILT2,
    WINDOW,
    WINDOW_BEND,
    YAW2,
    N,
    U,
    V,
)
from pipeline.refraction.kernels.image import slopes
from pipeline.refraction.kernels.jit import entry, jit
from pipeline.refraction.status import FAR_BRANCH

_AT_NADIR = 1e-9  # the sine below which R / sin(zeta) is dR/dzeta, and no azimuth is known


class _Ray(NamedTuple):
    """A traced ray: nadir angle, radius and height of the camera [m], fall to the target [m], R."""

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
def _of_the_air(ray, s, air):  # type: ignore[no-untyped-def]
    """Of a ray [rad], NaN where it is nearly level.

    sigma_R / tan(zeta); dR/dzeta cos^2(zeta); sigma of x, its covariance with y over sigma of y,
    and sigma of y, all zero without a plane window. ``s`` is the row of the station.
    """
    sigma, angle, factors, behind, lean = air.sigma, air.angle, air.factors, air.behind, air.lean
    nothing = math.nan, math.nan, 0.0, 0.0, 0.0
    drop, r_c = ray.drop, ray.radius + ray.h_c
    r_g = ray.radius + ray.h_c - drop
    level2 = (r_c * r_c * ray.cos_z * ray.cos_z - drop * (r_c + r_g)) / (r_g * r_g)
    if not (drop > 0.0 and ray.cos_z > 0.0 and level2 > 0.0):
        return nothing
    root = math.sqrt(drop) - air.way_first
    incidence = (1.0 / math.sqrt(math.sqrt(level2)) - 1.0) / air.incidence_step
    if incidence > factors.shape[2] - 1.0:
        return nothing
    i, a, window = int(s[NODE]), s[SHARE], int(s[WINDOW])
    j, b = _cell(root / air.way_step, sigma.shape[1])
    spread, turn = _bilinear(sigma, i, a, j, b), _bilinear(angle, i, a, j, b)
    x = shared = y = 0.0
    if window >= 0:
        x = _bilinear(behind[window, 0], i, a, j, b)
        shared = _bilinear(behind[window, 1], i, a, j, b)
        y = lean[window, i] + a * (lean[window, i + 1] - lean[window, i])
    j, b = _cell(root / air.coarse_step, factors.shape[1])
    k, c = _cell(incidence, factors.shape[2])
    e, share = _cell(s[SPAN] * (factors.shape[0] - 1), factors.shape[0])
    spread_factor = turn_factor = 0.0
    for n in range(8):  # the corners of a cell
        f, g, h = n >> 2, (n >> 1) & 1, n & 1
        weight = (share if f else 1.0 - share) * (b if g else 1.0 - b) * (c if h else 1.0 - c)
        spread_factor += weight * factors[e + f, j + g, k + h, 0]
        turn_factor += weight * factors[e + f, j + g, k + h, 1]
    return spread * spread_factor * drop, turn * turn_factor * drop, x, shared, y


@jit
def _by_heights(ray, d_zeta, n_g, s):  # type: ignore[no-untyped-def]
    """dR/dh_c and dR/dh_g [rad/m]; formulas of `pipeline.refraction.uncertainty.adjoint`."""
    sin_z, cos_z, radius, h_c, drop, r = ray
    r_c, r_g, n_c = radius + h_c, radius + h_c - drop, s[N]
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
    tan_z, bend = sin_z / cos_z, s[BEND]
    d_h_c = tan_z * (d_zeta * (bend + 1.0 / r_c) - bend) - sin_r / (chord * cos_z)
    return d_h_c, d_h_g


@jit
def _towards(axis, east, north, sin_z, cos_z):  # type: ignore[no-untyped-def]
    """How far a turn towards the nadir moves the ray along an axis of the camera."""
    return -cos_z * (axis[0] * east + axis[1] * north) - sin_z * axis[2]


@jit
def _moved(point, t, camera, d_image):  # type: ignore[no-untyped-def]
    """What a turn of the ray towards the unit vector t does to its pixel [px/rad]."""
    u, v, depth = point
    uu, uv, vv = d_image
    x, y = t[0] - u * t[2], t[1] - v * t[2]
    return camera.fx * depth * (uu * x + uv * y), camera.fy * depth * (uv * x + vv * y)


@jit
def _at_the_window(point, t, q, s):  # type: ignore[no-untyped-def]
    """How far the ray turns towards the nadir and across per unit of dN_c - dN_cc at the window."""
    u, v, depth = point
    n0, n1, n2 = s[NORMAL], s[NORMAL + 1], s[NORMAL + 2]
    out = (n0 * u + n1 * v + n2) / depth
    along = (n0 * t[0] + n1 * t[1] + n2 * t[2]) / out
    return along, (n0 * q[0] + n1 * q[1] + n2 * q[2]) / out


@jit
def _of_both(straight, leaning, x, shared, y):  # type: ignore[no-untyped-def]
    """Sigma of straight x + leaning y, from sigmas of x and y and their covariance over y's."""
    both = straight * straight * x * x + 2.0 * straight * leaning * shared * y
    both += leaning * leaning * y * y
    return 0.0 if both < 0.0 else math.sqrt(both)


@jit
def _by_station(moved, d_zeta, swing, axis, s):  # type: ignore[no-untyped-def]
    """Sigma [px] by tilt, yaw and height: ``moved`` are the pixel's motions with a turn along and
    across the vertical plane and with the height, ``axis`` the yaw axis along and across it."""
    along, across, by_height = moved
    k_e, k_p = -d_zeta * along, swing * across
    turned2 = s[TILT2] * (k_e * k_e + k_p * k_p)
    turned2 += s[YAW2] * (k_e * axis[0] + k_p * axis[1]) ** 2
    return math.sqrt(turned2 + by_height * by_height)


@entry
def propagate(observed, camera_and_rotation, traced, stations_and_air, sigmas):  # type: ignore[no-untyped-def]
    """Fill sigma of R_c [rad] and those of x and y [px] by the air, the station, the ground.

    ``sigmas`` are the columns of `Sigmas`. NaN where not known.
    """
    h_g, sigma_h_g, exposure = observed.h_g, observed.sigma_h_g, observed.exposure
    camera, rotation = camera_and_rotation
    rays, r_c, status = traced
    stations, air = stations_and_air
    sigma_r, air_x, air_y, station_x, station_y, ground_x, ground_y = sigmas
    refractivity = air.refractivity
    for i in range(h_g.size):
        sigma_r[i] = math.nan
        air_x[i] = air_y[i] = station_x[i] = station_y[i] = ground_x[i] = ground_y[i] = math.nan
        r = r_c[i]
        if math.isnan(r) or status[i] == FAR_BRANCH:
            continue
        s, turn = stations[exposure[i]], rotation[exposure[i]]
        sin_z, cos_z, h_c = rays[SIN, i], rays[COS, i], rays[H_C, i]
        ray = _Ray(sin_z, cos_z, rays[RADIUS, i], h_c, h_c - h_g[i], r)
        spread, steep, sigma_x, shared, sigma_y = _of_the_air(ray, s, air)
        if math.isnan(steep):
            continue
        secant = 1.0 / cos_z
        d_zeta = steep * secant * secant
        sigma_r[i] = spread * sin_z * secant
        j, b = _cell((h_g[i] - air.ground_m) / air.spacing_m, refractivity.size)
        n_g = refractivity[j] + b * (refractivity[j + 1] - refractivity[j])
        d_h_c, d_h_g = _by_heights(ray, d_zeta, n_g, s)

        # Unit vectors in the camera: t towards the nadir, q across; at the nadir any will do.
        east, north, swing = 1.0, 0.0, d_zeta
        if sin_z > _AT_NADIR:
            inverse = 1.0 / sin_z
            east, north = rays[APPARENT, i] * inverse, rays[APPARENT + 1, i] * inverse
            swing = r * inverse
        t = (
            _towards(turn[0], east, north, sin_z, cos_z),
            _towards(turn[1], east, north, sin_z, cos_z),
            _towards(turn[2], east, north, sin_z, cos_z),
        )
        q = (
            turn[0, 1] * east - turn[0, 0] * north,
            turn[1, 1] * east - turn[1, 0] * north,
            turn[2, 1] * east - turn[2, 0] * north,
        )
        u, v = rays[U, i], rays[V, i]
        point = (u, v, math.sqrt(u * u + v * v + 1.0))
        out_t = out_q = 0.0
        if s[WINDOW] >= 0.0:
            out_t, out_q = _at_the_window(point, t, q, s)
            out_t *= 1.0 - d_zeta
        d_image = slopes(u, v, camera.distortion)
        along_x, along_y = _moved(point, t, camera, d_image)
        across_x, across_y = _moved(point, q, camera, d_image)

        # What dN_c - dN_cc does at the window, and how much of it is not the x of a level one.
        window_x, window_y = along_x * out_t + across_x * out_q, along_y * out_t + across_y * out_q
        tan_z = sin_z * secant
        if s[WINDOW] >= 0.0:
            level = tan_z * (1.0 - d_zeta)
            lean_x, lean_y = window_x - along_x * level, window_y - along_y * level
            air_x[i] = _of_both(along_x * tan_z, lean_x, sigma_x, shared, sigma_y)
            air_y[i] = _of_both(along_y * tan_z, lean_y, sigma_x, shared, sigma_y)
        else:
            air_x[i] = abs(along_x) * sigma_r[i]
            air_y[i] = abs(along_y) * sigma_r[i]
        # A tilt turns the nadir: zeta by its part in the ray's plane, the plane by that across it.
        axis = (
            s[AXIS_N] * east - s[AXIS_E] * north,
            -s[AXIS_N] * north - s[AXIS_E] * east,
        )
        lift_x = (along_x * d_h_c + window_x * s[WINDOW_BEND]) * s[SIGMA_H]
        lift_y = (along_y * d_h_c + window_y * s[WINDOW_BEND]) * s[SIGMA_H]
        station_x[i] = _by_station((along_x, across_x, lift_x), d_zeta, swing, axis, s)
        station_y[i] = _by_station((along_y, across_y, lift_y), d_zeta, swing, axis, s)
        ground_x[i] = abs(along_x * d_h_g) * sigma_h_g[i]
        ground_y[i] = abs(along_y * d_h_g) * sigma_h_g[i]
