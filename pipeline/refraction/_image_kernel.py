"""From pixels to rays outside the window, and from bent rays back to pixels, compiled.

Columns of rays that pass between the two are those of `U` to `H_C` below.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.refraction._jit import entry, jit
from pipeline.refraction.camera import brown_conrady, brown_conrady_slopes
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
def _undistort(u_d, v_d, u, v, k1, k2, k3, p1, p2):  # type: ignore[no-untyped-def]
    """Fill u, v with three steps each: the loop has no branch and runs four points at a time."""
    for i in range(u_d.size):
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
def _ideal(x, y, camera, extra, scratch, u, v):  # type: ignore[no-untyped-def]
    """Fill the ideal image coordinates of pixels, NaN where the camera does not cover them.

    ``extra`` is added to the principal distance; ``scratch`` (2, n) is room to work in.
    """
    width, height, fx, fy, cx, cy, k1, k2, k3, p1, p2, largest = camera
    fx, fy = fx + extra, fy + extra
    u_d, v_d = scratch[0, : x.size], scratch[1, : x.size]
    for i in range(x.size):
        u_d[i] = (x[i] - cx) / fx
        v_d[i] = (y[i] - cy) / fy
    _undistort(u_d, v_d, u, v, k1, k2, k3, p1, p2)
    lens = 0.0 < fx < math.inf and 0.0 < fy < math.inf
    for i in range(x.size):
        if lens and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            u[i], v[i] = _settle(u_d[i], v_d[i], u[i], v[i], k1, k2, k3, p1, p2, largest)
        else:
            u[i] = v[i] = math.nan


@entry
def rays_of_pixels(x, y, camera, u, v):  # type: ignore[no-untyped-def]
    """Fill ideal image coordinates of pixels; NaN where the camera does not cover them."""
    _ideal(x, y, camera, 0.0, np.empty((2, x.size)), u, v)


@jit
def _refract(u, v, scale, normal, excess, along, r_cc):  # type: ignore[no-untyped-def]
    """Snell's law at a plane window (Gyer 1996, Eq. 36, in vectors), without its differences.

    Directions change by ``excess`` times themselves and ``along`` times the normal; R_cc is good
    below 0.01. NaN for rays that the window reflects wholly, or that do not lead out of it.
    """
    n_0, n_1, n_2 = normal[0], normal[1], normal[2]
    for i in range(u.size):
        d_0, d_1, d_2 = u[i] * scale[i], v[i] * scale[i], scale[i]
        cos_in = d_0 * n_0 + d_1 * n_1 + d_2 * n_2
        t_0, t_1, t_2 = d_0 - cos_in * n_0, d_1 - cos_in * n_1, d_2 - cos_in * n_2
        sin2 = t_0 * t_0 + t_1 * t_1 + t_2 * t_2
        cos_out = math.sqrt(1.0 - (1.0 + excess) * (1.0 + excess) * sin2)
        forward = -excess * (2.0 + excess) * sin2 / (cos_out + cos_in)
        length2 = excess * excess * sin2 + forward * forward
        # Twice the arcsine of half the length.
        turned = math.sqrt(length2) * (1.0 + length2 * (1.0 + 0.1125 * length2) / 24.0)
        leads_out = cos_in > 0.0
        along[i] = forward - excess * cos_in if leads_out else math.nan
        r_cc[i] = math.copysign(turned, excess) if leads_out else math.nan


@jit
def _look_through(rays, some, scale, along, normal, excess, turn):  # type: ignore[no-untyped-def]
    """Fill the change of direction at the window, and the direction outside.

    A loop for each column: with few columns in a loop the compiler takes four rays at a time.
    """
    u, v = rays[U, some], rays[V, some]
    c_0, c_1, c_2 = rays[THROUGH, some], rays[THROUGH + 1, some], rays[THROUGH + 2, some]
    n_0, n_1, n_2 = normal[0], normal[1], normal[2]
    for i in range(u.size):
        c_0[i] = excess * (u[i] * scale[i]) + along[i] * n_0
    for i in range(u.size):
        c_1[i] = excess * (v[i] * scale[i]) + along[i] * n_1
    for i in range(u.size):
        c_2[i] = excess * scale[i] + along[i] * n_2
    for k in range(3):
        t_0, t_1, t_2 = turn[0, k], turn[1, k], turn[2, k]
        apparent = rays[APPARENT + k, some]
        for i in range(u.size):
            across = t_0 * (u[i] * scale[i] + c_0[i]) + t_1 * (v[i] * scale[i] + c_1[i])
            apparent[i] = across + t_2 * (scale[i] + c_2[i])


@jit
def _angles_outside(rays, some, meridian, vertical):  # type: ignore[no-untyped-def]
    """Fill sine and cosine of the nadir angle, and Euler's radius in the azimuth of the ray.

    From 1/radius in the meridian, which also serves at the nadir, and in the prime vertical.
    """
    east, north, up = rays[APPARENT, some], rays[APPARENT + 1, some], rays[APPARENT + 2, some]
    sine, cosine, radius = rays[SIN, some], rays[COS, some], rays[RADIUS, some]
    for i in range(east.size):
        # Rounding may leave the sine of a level ray 1e-16 above one.
        length = math.sqrt(east[i] * east[i] + north[i] * north[i])
        sine[i] = 1.0 if length > 1.0 else length
        cosine[i] = -1.0 if up[i] > 1.0 else (1.0 if up[i] < -1.0 else -up[i])
    for i in range(east.size):
        north2 = north[i] * north[i]
        level2 = east[i] * east[i] + north2
        share = north2 / level2 if level2 > 0.0 else 1.0
        radius[i] = 1.0 / (vertical + share * (meridian - vertical))


@jit
def _see_out(  # type: ignore[no-untyped-def]
    rays, some, scratch, curvature, height, outside, cabin, normal, turn, r_cc
):
    """Fill the rays of one exposure from their ideal image coordinates; NaN stays NaN."""
    u, v = rays[U, some], rays[V, some]
    scale, along = scratch[0, : u.size], scratch[1, : u.size]
    for i in range(u.size):
        scale[i] = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0)
    excess = (cabin - outside) / (1.0 + outside)
    if excess == 0.0:
        along[:] = 0.0
        r_cc[:] = 0.0
    else:
        _refract(u, v, scale, normal, excess, along, r_cc)
    _look_through(rays, some, scale, along, normal, excess, turn)
    _angles_outside(rays, some, curvature[0], curvature[1])
    rays[H_C, some] = height


@jit
def _measured(x, y, h_g, station, status):  # type: ignore[no-untyped-def]
    """The first thing that observations of one exposure lack before any ray, or OK."""
    then = OK if station else NO_STATION
    for i in range(x.size):
        grounded = then if math.isfinite(h_g[i]) or not station else NO_GROUND
        seen = math.isfinite(x[i]) and math.isfinite(y[i])
        status[i] = grounded if seen else BAD_MEASUREMENT


@jit
def _wide_turn(rays, i, r_cc):  # type: ignore[no-untyped-def]
    """R_cc where its series is not good: near total reflection."""
    x, y, z = rays[THROUGH, i], rays[THROUGH + 1, i], rays[THROUGH + 2, i]
    return math.copysign(2.0 * math.asin(0.5 * math.sqrt(x * x + y * y + z * z)), r_cc)


@jit
def _judge(rays, some, outside, r_cc, status):  # type: ignore[no-untyped-def]
    """Give rays that came to nothing their status, and take the numbers out of all without one."""
    u = rays[U, some]
    for i in range(r_cc.size):
        if status[i] == OK:
            if math.isnan(u[i]):
                status[i] = OUTSIDE_CAMERA
            elif math.isnan(outside):
                status[i] = OUTSIDE_PROFILE
            elif math.isnan(r_cc[i]):
                status[i] = OUTSIDE_CAMERA
            elif abs(r_cc[i]) > 0.01:
                r_cc[i] = _wide_turn(rays, some.start + i, r_cc[i])
        if status[i] != OK:
            r_cc[i] = math.nan
            for k in range(COLUMNS):
                rays[k, some.start + i] = math.nan


@jit
def _run_end(exposure, first):  # type: ignore[no-untyped-def]
    """Where the rows of one exposure that follow each other end."""
    last = first + 1
    while last < exposure.size and exposure[last] == exposure[first]:
        last += 1
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
    scratch = np.empty((2, x.size))
    first = 0
    while first < x.size:
        some = slice(first, _run_end(exposure, first))
        e = exposure[first]
        station = 0 <= e < usable.size and usable[e]
        _measured(x[some], y[some], h_g[some], station, status[some])
        if station:
            _ideal(x[some], y[some], camera, change[e], scratch, rays[U, some], rays[V, some])
            _see_out(
                rays, some, scratch, curvature[e], height[e], outside[e], cabin[e], normal[e], rotation[e],
                r_cc[some],
            )  # fmt: skip
        _judge(rays, some, outside[e] if station else math.nan, r_cc[some], status[some])
        first = some.stop


@jit
def _lowered(rays, some, r_c, sideways, down):  # type: ignore[no-untyped-def]
    """Change of unit vectors that turn towards the nadir by R_c, without differences.

    Fills the share of east and north that it is, and the change of up; at the nadir zero.
    """
    up, sine, cosine = rays[APPARENT + 2, some], rays[SIN, some], rays[COS, some]
    # Sines by their series, 1e-17 of themselves below 0.1; larger angles are rare.
    for i in range(r_c.size):
        square = 0.25 * r_c[i] * r_c[i]
        sideways[i] = _sine_share(square)
        down[i] = r_c[i] * _sine_share(4.0 * square)
    for i in range(r_c.size):
        if abs(r_c[i]) > 0.1:
            sideways[i] = 2.0 * math.sin(0.5 * r_c[i]) / r_c[i]
            down[i] = math.sin(r_c[i])
    for i in range(r_c.size):
        half = 0.5 * r_c[i] * sideways[i]
        back = -2.0 * half * half
        inward = down[i] * cosine[i] / sine[i] if sine[i] > 0.0 else 0.0
        sideways[i] = back - inward
        down[i] = up[i] * back - down[i] * sine[i]


@jit
def _sine_share(square):  # type: ignore[no-untyped-def]
    """sin x / x of the square of x below 0.1, to 1e-17."""
    tail = 1.0 - square * (1.0 / 42.0) * (1.0 - square * (1.0 / 72.0))
    return 1.0 - square * (1.0 / 6.0) * (1.0 - square * (1.0 / 20.0) * tail)


@jit
def _seen_straight(rays, some, turn, sideways, down, depth, u, v):  # type: ignore[no-untyped-def]
    """Fill the ideal image coordinates of the straight chords; ``depth`` is room to work in."""
    east, north, u_0, v_0 = (
        rays[APPARENT, some],
        rays[APPARENT + 1, some],
        rays[U, some],
        rays[V, some],
    )
    for k in range(3):
        t_0, t_1, t_2, through = turn[k, 0], turn[k, 1], turn[k, 2], rays[THROUGH + k, some]
        seen = u if k == 0 else (v if k == 1 else depth)
        for i in range(u.size):
            level = (t_0 * east[i] + t_1 * north[i]) * sideways[i]
            seen[i] = through[i] + (level + t_2 * down[i])
    for i in range(u.size):
        ahead = 1.0 / math.sqrt(u_0[i] * u_0[i] + v_0[i] * v_0[i] + 1.0) + depth[i]
        u[i] = u_0[i] + (u[i] - u_0[i] * depth[i]) / ahead
        v[i] = v_0[i] + (v[i] - v_0[i] * depth[i]) / ahead


@jit
def _to_pixels(rays, some, camera, extra, u, v):  # type: ignore[no-untyped-def]
    """Turn ideal image coordinates into pixels from where the rays were measured.

    The principal distance was longer by ``extra`` there.
    """
    _, _, fx, fy, _, _, k1, k2, k3, p1, p2, _ = camera
    u_0, v_0 = rays[U, some], rays[V, some]
    for i in range(u.size):
        was_u, was_v = _distort(u_0[i], v_0[i], k1, k2, k3, p1, p2)
        is_u, is_v = _distort(u[i], v[i], k1, k2, k3, p1, p2)
        u[i] = fx * (is_u - was_u) - extra * was_u
        v[i] = fy * (is_v - was_v) - extra * was_v


@jit
def _reach(cosine, h_c, h_g, radius, status, distance):  # type: ignore[no-untyped-def]
    """Fill the distance along straight lines to where they meet a height; NaN where never.

    Downwards the nearer of two crossings unless the far one is meant, upwards the only one.
    """
    for i in range(cosine.size):
        along = (radius[i] + h_c) * cosine[i]
        drop = (h_c - h_g[i]) * (2.0 * radius[i] + h_c + h_g[i])
        q = math.sqrt(along * along - drop)
        near = h_c > h_g[i] and status[i] != FAR_BRANCH
        length = drop / (along + q) if near else along + q
        length = 0.0 if h_c == h_g[i] else length
        distance[i] = length if length >= 0.0 else math.nan


@jit
def _landing_apart(  # type: ignore[no-untyped-def]
    rays, some, turn, h_c, h_g, sideways, down, status, scratch, apart
):
    """Fill how far apart the measured and the true straight ray reach the target's height."""
    cosine, measured, true = scratch[0, some], scratch[1, some], scratch[2, some]
    c_0, c_1, c_2 = rays[THROUGH, some], rays[THROUGH + 1, some], rays[THROUGH + 2, some]
    up, radius = rays[APPARENT + 2, some], rays[RADIUS, some]
    # Inside the window the direction, in the local frame, is the one outside less the change.
    t_0, t_1, t_2 = turn[0, 2], turn[1, 2], turn[2, 2]
    for i in range(up.size):
        cosine[i] = t_0 * c_0[i] + t_1 * c_1[i] + t_2 * c_2[i] - up[i]
    _reach(cosine, h_c, h_g, radius, status, measured)
    for i in range(up.size):
        apart[i] = cosine[i] * measured[i]
        cosine[i] = -up[i] - down[i]
    _reach(cosine, h_c, h_g, radius, status, true)
    for i in range(up.size):
        apart[i] = (apart[i] - cosine[i] * true[i]) ** 2
    for k in range(2):
        level, t_0, t_1, t_2 = rays[APPARENT + k, some], turn[0, k], turn[1, k], turn[2, k]
        for i in range(up.size):
            cosine[i] = t_0 * c_0[i] + t_1 * c_1[i] + t_2 * c_2[i]
        for i in range(up.size):
            side = (level[i] - cosine[i]) * measured[i] - level[i] * (1.0 + sideways[i]) * true[i]
            apart[i] += side * side
    for i in range(up.size):
        apart[i] = math.sqrt(apart[i])


@entry
def shift_back(  # type: ignore[no-untyped-def]
    h_g, exposure, camera, rotation, change, height, rays, r_c, status, dx, dy, shift_ground
):
    """Fill the shifts in the image and on the ground that refraction angles amount to.

    NaN where the angle is.
    """
    scratch = np.empty((5, h_g.size))
    first = 0
    while first < h_g.size:
        some = slice(first, _run_end(exposure, first))
        e = exposure[first]
        first = some.stop
        if not 0 <= e < height.size:
            dx[some] = dy[some] = shift_ground[some] = math.nan
            continue
        sideways, down = scratch[3, some], scratch[4, some]
        _lowered(rays, some, r_c[some], sideways, down)
        _seen_straight(
            rays, some, rotation[e], sideways, down, scratch[0, some], dx[some], dy[some]
        )
        _to_pixels(rays, some, camera, change[e], dx[some], dy[some])
        _landing_apart(
            rays, some, rotation[e], height[e], h_g[some], sideways, down, status[some], scratch,
            shift_ground[some],
        )  # fmt: skip
