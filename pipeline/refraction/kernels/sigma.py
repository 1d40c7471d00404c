"""Standard deviations of corrections, row by row, compiled.

Columns of stations that pass in are those of `N` to `SIGMA_H` below.
"""

from __future__ import annotations

import math

from pipeline.refraction.camera.brown_conrady import brown_conrady_slopes
from pipeline.refraction.kernels.image import APPARENT, COS, H_C, RADIUS, SIN, U, V
from pipeline.refraction.kernels.jit import entry, jit
from pipeline.refraction.status import FAR_BRANCH

# Of a station: refractivity N outside and N'/n [1/m] there; node below it among the cameras of the
# table, share of the way to the next, share of the way from the lowest to the highest camera;
# variance of tilt, what that of yaw exceeds it by [rad2], east and north of the yaw axis; sigma of
# height [m]; number of the view in the tables, -1 without a plane window; N'/n less what the
# cabin's follows of it [1/m]; the normal of the window in the camera frame.
N, BEND, NODE, SHARE, SPAN, TILT2, YAW2, AXIS_E, AXIS_N, SIGMA_H = range(10)
VIEW, WINDOW_BEND, NORMAL = 10, 11, 12
STATION_COLUMNS = NORMAL + 3

_AT_NADIR = 1e-9  # the sine below which R / sin(zeta) is dR/dzeta, and no azimuth is known

_slopes = jit(brown_conrady_slopes)


@jit
def _plane(table, i, a, j, b):  # type: ignore[no-untyped-def]
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
def _of_the_air(drop, cos_z, radius, h_c, s, air):  # type: ignore[no-untyped-def]
    """Of a ray [rad], NaN where it is nearly level.

    sigma_R / tan(zeta); dR/dzeta cos^2(zeta); sigma of x, its covariance with y over sigma of y,
    and sigma of y, all zero without a plane window.
    """
    first, way_step, coarse_step, incidence_step, sigma, angle, factors, behind, lean = air
    nothing = math.nan, math.nan, 0.0, 0.0, 0.0
    r_c, r_g = radius + h_c, radius + h_c - drop
    level2 = (r_c * r_c * cos_z * cos_z - drop * (r_c + r_g)) / (r_g * r_g)
    if not (drop > 0.0 and cos_z > 0.0 and level2 > 0.0):
        return nothing
    root = math.sqrt(drop) - first
    incidence = (1.0 / math.sqrt(math.sqrt(level2)) - 1.0) / incidence_step
    if incidence > factors.shape[2] - 1.0:
        return nothing
    i, a, view = int(s[NODE]), s[SHARE], int(s[VIEW])
    j, b = _cell(root / way_step, sigma.shape[1])
    spread, turn = _plane(sigma, i, a, j, b), _plane(angle, i, a, j, b)
    x = shared = y = 0.0
    if view >= 0:
        x, shared = _plane(behind[view, 0], i, a, j, b), _plane(behind[view, 1], i, a, j, b)
        y = lean[view, i] + a * (lean[view, i + 1] - lean[view, i])
    j, b = _cell(root / coarse_step, factors.shape[1])
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
def _by_heights(sin_z, cos_z, radius, h_c, drop, r, d_zeta, n_g, s):  # type: ignore[no-untyped-def]
    """dR/dh_c and dR/dh_g [rad/m]; formulas of `pipeline.refraction.uncertainty.adjoint`."""
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
def _moved(u, v, depth, t, fx, fy, slopes):  # type: ignore[no-untyped-def]
    """What a turn of the ray towards the unit vector t does to its pixel [px/rad]."""
    uu, uv, vv = slopes
    x, y = t[0] - u * t[2], t[1] - v * t[2]
    return fx * depth * (uu * x + uv * y), fy * depth * (uv * x + vv * y)


@jit
def _at_the_window(u, v, depth, t, q, s):  # type: ignore[no-untyped-def]
    """How far the ray turns towards the nadir and across per unit of dN_c - dN_cc at the window."""
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
def _tilted(along, across, d_zeta, swing, axis_e, axis_p, by_height, s):  # type: ignore[no-untyped-def]
    """Sigma [px] by tilt, yaw and height, from what turns along and across the plane do."""
    k_e, k_p = -d_zeta * along, swing * across
    turned2 = s[TILT2] * (k_e * k_e + k_p * k_p)
    turned2 += s[YAW2] * (k_e * axis_e + k_p * axis_p) ** 2
    return math.sqrt(turned2 + by_height * by_height)


@entry
def spread_out(  # type: ignore[no-untyped-def]
    h_g, sigma_h_g, exposure, camera, rotation, rays, r_c, status, stations, air, ground, sigma_r,
    air_x, air_y, station_x, station_y, ground_x, ground_y,
):  # fmt: skip
    """Fill sigma of R_c [rad] and those of x and y [px] by the air, the station, the ground.

    ``ground`` : lowest height, spacing [m] and refractivity above. NaN where not known.
    """
    fx, fy = camera[2], camera[3]
    k1, k2, k3, p1, p2 = camera[6:11]
    lowest, spacing, refractivity = ground
    for i in range(h_g.size):
        sigma_r[i] = math.nan
        air_x[i] = air_y[i] = station_x[i] = station_y[i] = ground_x[i] = ground_y[i] = math.nan
        r = r_c[i]
        if math.isnan(r) or status[i] == FAR_BRANCH:
            continue
        s, turn = stations[exposure[i]], rotation[exposure[i]]
        sin_z, cos_z, radius, h_c = rays[SIN, i], rays[COS, i], rays[RADIUS, i], rays[H_C, i]
        drop = h_c - h_g[i]
        spread, steep, sigma_x, shared, sigma_y = _of_the_air(drop, cos_z, radius, h_c, s, air)
        if math.isnan(steep):
            continue
        secant = 1.0 / cos_z
        d_zeta = steep * secant * secant
        sigma_r[i] = spread * sin_z * secant
        j, b = _cell((h_g[i] - lowest) / spacing, refractivity.size)
        n_g = refractivity[j] + b * (refractivity[j + 1] - refractivity[j])
        d_h_c, d_h_g = _by_heights(sin_z, cos_z, radius, h_c, drop, r, d_zeta, n_g, s)

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
        depth = math.sqrt(u * u + v * v + 1.0)
        out_t = out_q = 0.0
        if s[VIEW] >= 0.0:
            out_t, out_q = _at_the_window(u, v, depth, t, q, s)
            out_t *= 1.0 - d_zeta
        slopes = _slopes(u, v, k1, k2, k3, p1, p2)
        along_x, along_y = _moved(u, v, depth, t, fx, fy, slopes)
        across_x, across_y = _moved(u, v, depth, q, fx, fy, slopes)

        # What dN_c - dN_cc does at the window, and how much of it is not the x of a level one.
        window_x, window_y = along_x * out_t + across_x * out_q, along_y * out_t + across_y * out_q
        tan_z = sin_z * secant
        if s[VIEW] >= 0.0:
            level = tan_z * (1.0 - d_zeta)
            lean_x, lean_y = window_x - along_x * level, window_y - along_y * level
            air_x[i] = _of_both(along_x * tan_z, lean_x, sigma_x, shared, sigma_y)
            air_y[i] = _of_both(along_y * tan_z, lean_y, sigma_x, shared, sigma_y)
        else:
            air_x[i] = abs(along_x) * sigma_r[i]
            air_y[i] = abs(along_y) * sigma_r[i]
        # A tilt turns the nadir: zeta by its part in the ray's plane, the plane by that across it.
        axis_e = s[AXIS_N] * east - s[AXIS_E] * north
        axis_p = -s[AXIS_N] * north - s[AXIS_E] * east
        lift_x = (along_x * d_h_c + window_x * s[WINDOW_BEND]) * s[SIGMA_H]
        lift_y = (along_y * d_h_c + window_y * s[WINDOW_BEND]) * s[SIGMA_H]
        station_x[i] = _tilted(along_x, across_x, d_zeta, swing, axis_e, axis_p, lift_x, s)
        station_y[i] = _tilted(along_y, across_y, d_zeta, swing, axis_e, axis_p, lift_y, s)
        ground_x[i] = abs(along_x * d_h_g) * sigma_h_g[i]
        ground_y[i] = abs(along_y * d_h_g) * sigma_h_g[i]
