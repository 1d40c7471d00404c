"""From pixels to rays outside the window, and from bent rays back to pixels, compiled.

Columns of rays that pass between the two are those of `U` to `H_C` below.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction.camera.brown_conrady import brown_conrady, brown_conrady_slopes
from pipeline.refraction.kernels.jit import entry, jit, within
from pipeline.refraction.status import (
    BAD_MEASUREMENT,
    FAR_BRANCH,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
)

# Ideal image coordinates; change of direction in the window (camera frame); direction outside
# (east, north, up); sine and cosine of the nadir angle, radius of the sphere, height of the camera.
U, V, THROUGH, APPARENT, SIN, COS, RADIUS, H_C = 0, 1, 2, 5, 8, 9, 10, 11
COLUMNS = 12

_distort, _slopes = jit(brown_conrady), jit(brown_conrady_slopes)


@jit
def _newton(u_d, v_d, u, v, k1, k2, k3, p1, p2):  # type: ignore[no-untyped-def]
    """A step of Newton's iteration towards the ideal image coordinates of distorted ones."""
    u_0, v_0 = _distort(u, v, k1, k2, k3, p1, p2)
    uu, uv, vv = _slopes(u, v, k1, k2, k3, p1, p2)
    inverse = 1.0 / (uu * vv - uv * uv)
    res_u, res_v = u_d - u_0, v_d - v_0
    return u + (vv * res_u - uv * res_v) * inverse, v + (uu * res_v - uv * res_u) * inverse


@jit
def _undistort(first, last, u_d, v_d, u, v, k1, k2, k3, p1, p2):  # type: ignore[no-untyped-def]
    """Fill u, v with three steps each: the loop has no branch and runs four points at a time."""
    for i in range(first, last):
        a, b = u_d[i], v_d[i]
        for _ in range(3):
            a, b = _newton(u_d[i], v_d[i], a, b, k1, k2, k3, p1, p2)
        u[i], v[i] = a, b


@jit
def _settle(u_d, v_d, u, v, k1, k2, k3, p1, p2, largest):  # type: ignore[no-untyped-def]
    """u, v after more steps where three were too few; NaN where the iteration does not arrive."""
    for _ in range(30):
        u_0, v_0 = _distort(u, v, k1, k2, k3, p1, p2)
        if abs(u_0 - u_d) + abs(v_0 - v_d) < 4e-15:
            break
        u, v = _newton(u_d, v_d, u, v, k1, k2, k3, p1, p2)
    u_0, v_0 = _distort(u, v, k1, k2, k3, p1, p2)
    arrived = abs(u_0 - u_d) + abs(v_0 - v_d) < 1e-12
    if arrived and u * u + v * v <= largest * largest:
        return u, v
    return math.nan, math.nan


@jit
def _ideal(first, last, x, y, camera, extra, scratch, u, v):  # type: ignore[no-untyped-def]
    """Fill the ideal image coordinates of pixels, NaN where the camera does not cover them.

    ``extra`` is added to the principal distance; ``scratch`` (2, n) is room to work in.
    """
    width, height, fx, fy, cx, cy, k1, k2, k3, p1, p2, largest = camera
    fx, fy = fx + extra, fy + extra
    u_d, v_d = scratch[0], scratch[1]
    for i in range(first, last):
        u_d[i] = (x[i] - cx) / fx
        v_d[i] = (y[i] - cy) / fy
    _undistort(first, last, u_d, v_d, u, v, k1, k2, k3, p1, p2)
    lens = 0.0 < fx < math.inf and 0.0 < fy < math.inf
    for i in range(first, last):
        if lens and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            u[i], v[i] = _settle(u_d[i], v_d[i], u[i], v[i], k1, k2, k3, p1, p2, largest)
        else:
            u[i] = v[i] = math.nan


@entry
def rays_of_pixels(x, y, camera, u, v):  # type: ignore[no-untyped-def]
    """Fill ideal image coordinates of pixels; NaN where the camera does not cover them."""
    _ideal(np.uint64(0), np.uint64(x.size), x, y, camera, 0.0, np.empty((2, x.size)), u, v)


@jit
def _refract(first, last, d, normal, excess, along, r_cc):  # type: ignore[no-untyped-def]
    """Snell's law at a plane window (Gyer 1996, Eq. 36, in vectors), without its differences.

    Directions ``d`` (3, n) change by ``excess`` times themselves and ``along`` times the normal;
    R_cc is good below 0.01. NaN for rays that the window reflects wholly, or that do not lead out
    of it.
    """
    d_0, d_1, d_2, n_0, n_1, n_2 = d[0], d[1], d[2], normal[0], normal[1], normal[2]
    for i in range(first, last):
        cos_in = d_0[i] * n_0 + d_1[i] * n_1 + d_2[i] * n_2
        t_0, t_1, t_2 = d_0[i] - cos_in * n_0, d_1[i] - cos_in * n_1, d_2[i] - cos_in * n_2
        sin2 = t_0 * t_0 + t_1 * t_1 + t_2 * t_2
        cos_out = math.sqrt(1.0 - (1.0 + excess) * (1.0 + excess) * sin2)
        forward = -excess * (2.0 + excess) * sin2 / (cos_out + cos_in)
        length2 = excess * excess * sin2 + forward * forward
        # Twice the arcsine of half the length.
        turned = math.sqrt(length2) * (1.0 + length2 * (1.0 + 0.1125 * length2) / 24.0)
        out = 1.0 if cos_in > 0.0 else math.nan
        along[i] = out * (forward - excess * cos_in)
        r_cc[i] = out * math.copysign(turned, excess)


@jit
def _look_through(first, last, rays, d, along, normal, excess, turn):  # type: ignore[no-untyped-def]
    """Fill the change of direction at the window, and the direction outside.

    A loop for each column: with few columns in a loop the compiler takes four rays at a time.
    """
    for k in range(3):
        change, inside, part = rays[THROUGH + k], d[k], normal[k]
        for i in range(first, last):
            change[i] = excess * inside[i] + along[i] * part
    for k in range(3):
        change, inside = rays[THROUGH + k], d[k]
        for i in range(first, last):
            inside[i] += change[i]
    d_0, d_1, d_2 = d[0], d[1], d[2]
    for k in range(3):
        t_0, t_1, t_2, apparent = turn[0, k], turn[1, k], turn[2, k], rays[APPARENT + k]
        for i in range(first, last):
            apparent[i] = t_0 * d_0[i] + t_1 * d_1[i] + t_2 * d_2[i]


@jit
def _angles_outside(first, last, rays, meridian, vertical):  # type: ignore[no-untyped-def]
    """Fill sine and cosine of the nadir angle, and Euler's radius in the azimuth of the ray.

    From 1/radius in the meridian, which also serves at the nadir, and in the prime vertical.
    """
    east, north, up = rays[APPARENT], rays[APPARENT + 1], rays[APPARENT + 2]
    sine, cosine, radius = rays[SIN], rays[COS], rays[RADIUS]
    for i in range(first, last):
        # Rounding may leave the sine of a level ray 1e-16 above one.
        length = math.sqrt(east[i] * east[i] + north[i] * north[i])
        sine[i] = 1.0 if length > 1.0 else length
        cosine[i] = -1.0 if up[i] > 1.0 else (1.0 if up[i] < -1.0 else -up[i])
    for i in range(first, last):
        north2 = north[i] * north[i]
        level2 = east[i] * east[i] + north2
        share = north2 / level2 if level2 > 0.0 else 1.0
        radius[i] = 1.0 / (vertical + share * (meridian - vertical))


@within
def _see_out(  # type: ignore[no-untyped-def]
    first, last, rays, scratch, curvature, height, outside, cabin, normal, turn, r_cc
):
    """Fill the rays of one exposure from their ideal image coordinates; NaN stays NaN."""
    u, v, d, along = rays[U], rays[V], scratch[:3], scratch[3]
    for i in range(first, last):
        d[2, i] = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0)
        rays[H_C, i] = height
    for i in range(first, last):
        d[0, i] = u[i] * d[2, i]
        d[1, i] = v[i] * d[2, i]
    excess = (cabin - outside) / (1.0 + outside)
    if excess == 0.0:
        for i in range(first, last):
            along[i] = r_cc[i] = 0.0
    else:
        _refract(first, last, d, normal, excess, along, r_cc)
    _look_through(first, last, rays, d, along, normal, excess, turn)
    _angles_outside(first, last, rays, curvature[0], curvature[1])


@jit
def _measured(first, last, x, y, h_g, station, status):  # type: ignore[no-untyped-def]
    """The first thing that observations of one exposure lack before any ray, or OK."""
    then = OK if station else NO_STATION
    for i in range(first, last):
        grounded = then if math.isfinite(h_g[i]) or not station else NO_GROUND
        seen = math.isfinite(x[i]) and math.isfinite(y[i])
        status[i] = grounded if seen else BAD_MEASUREMENT


@jit
def _wide_turn(rays, i, r_cc):  # type: ignore[no-untyped-def]
    """R_cc where its series is not good: near total reflection."""
    x, y, z = rays[THROUGH, i], rays[THROUGH + 1, i], rays[THROUGH + 2, i]
    return math.copysign(2.0 * math.asin(0.5 * math.sqrt(x * x + y * y + z * z)), r_cc)


@within
def _judge(first, last, rays, outside, r_cc, status):  # type: ignore[no-untyped-def]
    """Give rays that came to nothing their status, and take the numbers out of all without one."""
    u = rays[U]
    for i in range(first, last):
        if status[i] == OK:
            if math.isnan(u[i]):
                status[i] = OUTSIDE_CAMERA
            elif math.isnan(outside):
                status[i] = OUTSIDE_PROFILE
            elif math.isnan(r_cc[i]):
                status[i] = OUTSIDE_CAMERA
            elif abs(r_cc[i]) > 0.01:
                r_cc[i] = _wide_turn(rays, i, r_cc[i])
        if status[i] != OK:
            r_cc[i] = math.nan
            for k in range(COLUMNS):
                rays[k, i] = math.nan


@jit
def _run_end(exposure, first):  # type: ignore[no-untyped-def]
    """Where rows of one exposure that follow each other end.

    Rows are unsigned: an index that might count from the end would keep the compiler from vectors.
    """
    last = first + np.uint64(1)
    while last < exposure.size and exposure[last] == exposure[first]:
        last += np.uint64(1)
    return last


@entry
def look_out(  # type: ignore[no-untyped-def]
    x, y, h_g, exposure, camera, usable, rotation, curvature, height, outside, cabin, normal,
    change, rays, r_cc, status,
):  # fmt: skip
    """Fill the columns of ``rays``, R_cc, and a status where there is no ray to follow.

    ``curvature`` (s, 2) is 1/radius in the meridian and in the prime vertical. Rows of one exposure
    that follow each other are taken together, in passes over all of them: short loops keep the
    processor busy, and what belongs to the exposure is read once.
    """
    scratch = np.empty((4, x.size))
    last = np.uint64(0)
    while last < x.size:
        first, last = last, _run_end(exposure, last)
        e = exposure[first]
        station = 0 <= e < usable.size and usable[e]
        _measured(first, last, x, y, h_g, station, status)
        if station:
            _ideal(first, last, x, y, camera, change[e], scratch, rays[U], rays[V])
            _see_out(
                first, last, rays, scratch, curvature[e], height[e], outside[e], cabin[e],
                normal[e], rotation[e], r_cc,
            )  # fmt: skip
        _judge(first, last, rays, outside[e] if station else math.nan, r_cc, status)


@jit
def _lowered(a, sin_z, cos_z, angle, out):  # type: ignore[no-untyped-def]
    """Change of a unit vector that turns towards the nadir; zero for a ray at the nadir."""
    back = -2.0 * math.sin(0.5 * angle) ** 2
    sin_a = math.sin(angle)
    inward = sin_a * cos_z / sin_z if sin_z > 0.0 else 0.0
    out[0] = a[0] * (back - inward)
    out[1] = a[1] * (back - inward)
    out[2] = a[2] * back - sin_a * sin_z


@jit
def _reach(cos_z, h_c, h_g, radius, far):  # type: ignore[no-untyped-def]
    """Distance along a straight line to where it meets a height; NaN where it never does."""
    if h_c == h_g:
        return 0.0
    along = (radius + h_c) * cos_z
    drop = (h_c - h_g) * (2.0 * radius + h_c + h_g)
    q = math.sqrt(along * along - drop)
    # Downwards the nearer of two crossings unless the far one is meant, upwards the only one.
    distance = drop / (along + q) if h_c > h_g and not far else along + q
    return distance if distance >= 0.0 else math.nan


@entry
def shift_back(  # type: ignore[no-untyped-def]
    x, y, h_g, exposure, camera, rotation, change, rays, r_c, status, dx, dy, shift_ground
):
    """Fill the shifts in the image and on the ground that refraction angles amount to."""
    fx, fy = camera[2], camera[3]
    k1, k2, k3, p1, p2 = camera[6:11]
    apparent, lower, seen = np.empty(3), np.empty(3), np.empty(3)
    for i in range(x.size):
        if math.isnan(r_c[i]):
            dx[i] = dy[i] = shift_ground[i] = math.nan
            continue
        turn = rotation[exposure[i]]
        for k in range(3):
            apparent[k] = rays[APPARENT + k, i]
        _lowered(apparent, rays[SIN, i], rays[COS, i], r_c[i], lower)
        u, v, extra = rays[U, i], rays[V, i], change[exposure[i]]
        for k in range(3):
            seen[k] = rays[THROUGH + k, i] + (
                turn[k, 0] * lower[0] + turn[k, 1] * lower[1] + turn[k, 2] * lower[2]
            )
        depth = 1.0 / math.sqrt(u * u + v * v + 1.0) + seen[2]
        u_0, v_0 = _distort(u, v, k1, k2, k3, p1, p2)
        u_1, v_1 = _distort(
            u + (seen[0] - u * seen[2]) / depth, v + (seen[1] - v * seen[2]) / depth,
            k1, k2, k3, p1, p2,
        )  # fmt: skip
        dx[i] = fx * (u_1 - u_0) - extra * u_0
        dy[i] = fy * (v_1 - v_0) - extra * v_0
        far, radius, h_c = status[i] == FAR_BRANCH, rays[RADIUS, i], rays[H_C, i]
        for k in range(3):  # the direction inside the window, east-north-up
            seen[k] = apparent[k] - (
                turn[0, k] * rays[THROUGH, i]
                + turn[1, k] * rays[THROUGH + 1, i]
                + turn[2, k] * rays[THROUGH + 2, i]
            )
        raw = _reach(-seen[2], h_c, h_g[i], radius, far)
        true = _reach(-apparent[2] - lower[2], h_c, h_g[i], radius, far)
        apart2 = 0.0
        for k in range(3):
            apart2 += (seen[k] * raw - (apparent[k] + lower[k]) * true) ** 2
        shift_ground[i] = math.sqrt(apart2)
