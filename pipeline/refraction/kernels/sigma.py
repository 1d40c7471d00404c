"""Standard deviations of corrections, row by row, compiled."""

import math
from typing import NamedTuple

from pipeline.refraction.kernels.columns import (
    APPARENT,
    AXIS_E,
    AXIS_N,
    BEND,
    CABIN,
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
from pipeline.refraction.status_codes import FAR_BRANCH

_AT_NADIR = 1e-9  # the sine below which R / sin(zeta) is dR/dzeta, and no azimuth is known


class _Ray(NamedTuple):
    """A traced ray: nadir angle, radius and height of the camera [m], fall to the target [m], R."""

    sin_z: float
    cos_z: float
    radius: float
    h_c: float
    drop: float
    r: float


class _Motion(NamedTuple):
    """How the ray of an observation turns: tangent of its nadir angle, dR/dzeta, R/sin(zeta).

    ``out_t``, ``out_q`` towards the nadir and across per unit of dN_c - dN_cc at the window;
    ``d_h_c``, ``d_h_g`` dR/dh_c and dR/dh_g [rad/m]; ``yaw_along``, ``yaw_across`` the yaw axis in
    the ray's vertical plane and across it.
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
    and sigma of y, all zero without a plane window; by the unit of the leading mode's parameter
    R / tan(zeta) and dN_c - dN_cc. ``s`` is the row of the station.
    """
    sigma, angle, factors, behind, lean = air.sigma, air.angle, air.factors, air.behind, air.lean
    nothing = math.nan, math.nan, 0.0, 0.0, 0.0, math.nan, math.nan
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
    mode = _bilinear(air.mode, i, a, j, b)
    x = shared = y = mode_y = 0.0
    if window >= 0:
        x = _bilinear(behind[window, 0], i, a, j, b)
        shared = _bilinear(behind[window, 1], i, a, j, b)
        y = lean[window, i] + a * (lean[window, i + 1] - lean[window, i])
        mode_lean = air.mode_lean[window]
        mode_y = mode_lean[i] + a * (mode_lean[i + 1] - mode_lean[i])
    j, b = _cell(root / air.coarse_step, factors.shape[1])
    k, c = _cell(incidence, factors.shape[2])
    e, share = _cell(s[SPAN] * (factors.shape[0] - 1), factors.shape[0])
    spread_factor = turn_factor = 0.0
    for n in range(8):  # the corners of a cell
        f, g, h = n >> 2, (n >> 1) & 1, n & 1
        weight = (share if f else 1.0 - share) * (b if g else 1.0 - b) * (c if h else 1.0 - c)
        spread_factor += weight * factors[e + f, j + g, k + h, 0]
        turn_factor += weight * factors[e + f, j + g, k + h, 1]
        mode += weight * factors[e + f, j + g, k + h, 2]
    mode, mode_y = mode * drop / air.mode_sigma, mode_y / air.mode_sigma
    return spread * spread_factor * drop, turn * turn_factor * drop, x, shared, y, mode, mode_y


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
def _in_the_image(along, across, motion, air, s):  # type: ignore[no-untyped-def]
    """Sigma of x or y [px] by the air and by the station, and the pixel's motion with h_g [px/m].

    ``along`` and ``across`` are what a turn of the ray along the vertical plane and across it does
    to the pixel [px/rad]; ``air`` is sigma of R_c, sigma of x, its covariance with y over sigma of
    y, and sigma of y.
    """
    sigma_r, sigma_x, shared, sigma_y = air
    # What dN_c - dN_cc does at the window, and how much of it is not the x of a level one.
    window = along * motion.out_t + across * motion.out_q
    by_air = abs(along) * sigma_r
    if s[WINDOW] >= 0.0:
        straight = along * motion.tan_z
        leaning = window - along * (motion.tan_z * (1.0 - motion.d_zeta))
        both = straight * straight * sigma_x * sigma_x
        both += 2.0 * straight * leaning * shared * sigma_y
        both += leaning * leaning * sigma_y * sigma_y
        by_air = 0.0 if both < 0.0 else math.sqrt(both)
    # A tilt turns the nadir: zeta by its part in the ray's plane, the plane by that across it.
    k_e, k_p = -motion.d_zeta * along, motion.swing * across
    turned2 = s[TILT2] * (k_e * k_e + k_p * k_p)
    by_yaw = k_e * motion.yaw_along + k_p * motion.yaw_across
    turned2 += s[YAW2] * (by_yaw * by_yaw)
    lift = (along * motion.d_h_c + window * s[WINDOW_BEND]) * s[SIGMA_H]
    return by_air, math.sqrt(turned2 + lift * lift), along * motion.d_h_g


@jit
def _axes(turn, ray, east, north):  # type: ignore[no-untyped-def]
    """Unit vectors in the camera: towards the nadir, and across the ray's vertical plane."""
    sin_z, cos_z = ray.sin_z, ray.cos_z
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
    return t, q


@entry(rows=0, most=6000)
def propagate(observed, camera_and_rotation, traced, stations_and_air, sigmas):  # type: ignore[no-untyped-def]
    """Fill sigma of R_c [rad], of x and y [px] by air, station and ground, and by the cabin.

    And the derivatives of x and y, with their signs, by the parameter of the leading mode, and by
    the refractivity behind a plane window. ``sigmas`` are the columns of `Sigmas`. NaN where not
    known.
    """
    h_g, sigma_h_g, exposure = observed.h_g, observed.sigma_h_g, observed.exposure
    camera, rotation = camera_and_rotation
    rays, r_c, status = traced
    stations, air = stations_and_air
    sigma_r, air_x, air_y, station_x, station_y, ground_x, ground_y = sigmas[:7]
    r_cc, cabin_x, cabin_y, mode_x, mode_y, ncc_x, ncc_y = sigmas[7:]
    refractivity = air.refractivity
    for i in range(h_g.size):
        sigma_r[i] = math.nan
        air_x[i] = air_y[i] = station_x[i] = station_y[i] = ground_x[i] = ground_y[i] = math.nan
        r_cc[i] = cabin_x[i] = cabin_y[i] = math.nan
        mode_x[i] = mode_y[i] = ncc_x[i] = ncc_y[i] = math.nan
        r = r_c[i]
        if math.isnan(r) or status[i] == FAR_BRANCH:
            continue
        s, turn = stations[exposure[i]], rotation[exposure[i]]
        sin_z, cos_z, h_c = rays[SIN, i], rays[COS, i], rays[H_C, i]
        ray = _Ray(sin_z, cos_z, rays[RADIUS, i], h_c, h_c - h_g[i], r)
        spread, steep, sigma_x, shared, sigma_y, by_mode, lean = _of_the_air(ray, s, air)
        if math.isnan(steep):
            continue
        secant = 1.0 / cos_z
        d_zeta = steep * secant * secant
        sigma_r[i] = spread * sin_z * secant
        j, b = _cell((h_g[i] - air.ground_m) / air.spacing_m, refractivity.size)
        n_g = refractivity[j] + b * (refractivity[j + 1] - refractivity[j])
        d_h_c, d_h_g = _by_heights(ray, d_zeta, n_g, s)

        # At the nadir any azimuth will do.
        east, north, swing = 1.0, 0.0, d_zeta
        if sin_z > _AT_NADIR:
            inverse = 1.0 / sin_z
            east, north = rays[APPARENT, i] * inverse, rays[APPARENT + 1, i] * inverse
            swing = r * inverse
        t, q = _axes(turn, ray, east, north)
        u, v = rays[U, i], rays[V, i]
        point = (u, v, math.sqrt(u * u + v * v + 1.0))
        out_t = out_q = steepness = 0.0
        if s[WINDOW] >= 0.0:
            # How far it turns towards the nadir and across per unit of dN_c - dN_cc.
            n0, n1, n2 = s[NORMAL], s[NORMAL + 1], s[NORMAL + 2]
            out = (n0 * u + n1 * v + n2) / point[2]
            out_t = (n0 * t[0] + n1 * t[1] + n2 * t[2]) / out * (1.0 - d_zeta)
            out_q = (n0 * q[0] + n1 * q[1] + n2 * q[2]) / out
            steepness = math.sqrt(max(0.0, 1.0 - out * out)) / out
        d_image = slopes(u, v, camera.distortion)
        along_x, along_y = _moved(point, t, camera, d_image)
        across_x, across_y = _moved(point, q, camera, d_image)
        motion = _Motion(
            sin_z * secant, d_zeta, swing, out_t, out_q, d_h_c, d_h_g,
            s[AXIS_N] * east - s[AXIS_E] * north, -s[AXIS_N] * north - s[AXIS_E] * east,
        )  # fmt: skip
        air_of_ray = (sigma_r[i], sigma_x, shared, sigma_y)
        air_x[i], station_x[i], by_h_g = _in_the_image(along_x, across_x, motion, air_of_ray, s)
        ground_x[i] = abs(by_h_g) * sigma_h_g[i]
        air_y[i], station_y[i], by_h_g = _in_the_image(along_y, across_y, motion, air_of_ray, s)
        ground_y[i] = abs(by_h_g) * sigma_h_g[i]

        # N in the cabin turns the ray at the window (Gyer 1996, Eq. 36), and its air the lens.
        n_p, n_t, lens_p, lens_t = s[CABIN], s[CABIN + 1], s[CABIN + 2], s[CABIN + 3]
        r_cc[i] = steepness * math.hypot(n_p, n_t)
        by_mode *= sin_z * secant
        turned = along_x * out_t + across_x * out_q
        mode_x[i] = along_x * by_mode + turned * lean
        lever = (observed.x[i] - camera.cx) / camera.fx
        cabin_x[i] = math.hypot(turned * n_p + lever * lens_p, turned * n_t + lever * lens_t)
        if s[WINDOW] >= 0.0:
            ncc_x[i] = -turned
        turned = along_y * out_t + across_y * out_q
        mode_y[i] = along_y * by_mode + turned * lean
        if s[WINDOW] >= 0.0:
            ncc_y[i] = -turned
        lever = (observed.y[i] - camera.cy) / camera.fy
        cabin_y[i] = math.hypot(turned * n_p + lever * lens_p, turned * n_t + lever * lens_t)
