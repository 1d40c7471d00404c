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
def _ideal(x, y, camera, extra, u, v):  # type: ignore[no-untyped-def]
    """Fill the ideal image coordinates of pixels, NaN where the camera does not cover them.

    ``extra`` (n,) is added to the principal distance; NaN where nothing positive and finite is
    left of it.
    """
    width, height, fx, fy, cx, cy, k1, k2, k3, p1, p2, largest = camera
    u_d, v_d = np.empty(x.size), np.empty(x.size)
    for i in range(x.size):
        u_d[i] = (x[i] - cx) / (fx + extra[i])
        v_d[i] = (y[i] - cy) / (fy + extra[i])
    _undistort(u_d, v_d, u, v, k1, k2, k3, p1, p2)
    for i in range(x.size):
        lens = 0.0 < fx + extra[i] < math.inf and 0.0 < fy + extra[i] < math.inf
        if lens and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            u[i], v[i] = _settle(u_d[i], v_d[i], u[i], v[i], k1, k2, k3, p1, p2, largest)
        else:
            u[i] = v[i] = math.nan


@entry
def rays_of_pixels(x, y, camera, u, v):  # type: ignore[no-untyped-def]
    """Fill ideal image coordinates of pixels; NaN where the camera does not cover them."""
    extra = np.empty(x.size)
    for i in range(x.size):
        extra[i] = 0.0
    _ideal(x, y, camera, extra, u, v)


@jit
def _through_window(d, normal, cabin, outside, change):  # type: ignore[no-untyped-def]
    """Change of direction at a plane window (Gyer 1996, Eq. 36, in vectors), and R_cc.

    NaN for a ray that the window reflects wholly, or that does not lead out of it.
    """
    excess = (cabin - outside) / (1.0 + outside)
    if excess == 0.0:
        change[:] = 0.0
        return 0.0
    cos_in = d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]
    sin2, ratio = 0.0, 1.0 + excess
    for k in range(3):
        change[k] = d[k] - cos_in * normal[k]
        sin2 += change[k] * change[k]
    left = 1.0 - ratio * ratio * sin2
    if not (cos_in > 0.0 and left >= 0.0):
        return math.nan
    along = -excess * (2.0 + excess) * sin2 / (math.sqrt(left) + cos_in)
    length2 = 0.0
    for k in range(3):
        change[k] = excess * change[k] + along * normal[k]
        length2 += change[k] * change[k]
    # Twice the arcsine of half the length, which is below 1e-3 but near total reflection.
    length = math.sqrt(length2)
    if length > 0.01:
        return math.copysign(2.0 * math.asin(0.5 * length), excess)
    return math.copysign(length * (1.0 + length2 * (1.0 + 0.1125 * length2) / 24.0), excess)


@jit
def _missing(x, y, h_g, exposure, usable):  # type: ignore[no-untyped-def]
    """The first thing that an observation lacks before any ray, or OK."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return BAD_MEASUREMENT
    if exposure < 0 or exposure >= usable.size or not usable[exposure]:
        return NO_STATION
    if not math.isfinite(h_g):
        return NO_GROUND
    return OK


@jit
def _blank(rays, i):  # type: ignore[no-untyped-def]
    """Take the numbers out of a ray's columns."""
    for k in range(COLUMNS):
        rays[k, i] = math.nan


@entry
def look_out(  # type: ignore[no-untyped-def]
    x, y, h_g, exposure, camera, usable, rotation, curvature, height, outside, cabin, normal,
    change, rays, r_cc, status,
):  # fmt: skip
    """Fill the columns of ``rays``, R_cc, and a status where there is no ray to follow.

    ``curvature`` (s, 2) is 1/radius in the meridian and in the prime vertical.
    """
    # Passes over all points: short loops keep the processor busy.
    extra = np.empty(x.size)
    for i in range(x.size):
        status[i] = _missing(x[i], y[i], h_g[i], exposure[i], usable)
        extra[i] = change[exposure[i]] if status[i] == OK else 0.0
    _ideal(x, y, camera, extra, rays[U], rays[V])
    for i in range(x.size):
        if status[i] == OK and math.isnan(rays[U, i]):
            status[i] = OUTSIDE_CAMERA
        elif status[i] == OK and math.isnan(outside[exposure[i]]):
            status[i] = OUTSIDE_PROFILE
    d, bent = np.empty(3), np.empty(3)
    for i in range(x.size):
        e, u, v = exposure[i], rays[U, i], rays[V, i]
        r_cc[i] = math.nan
        if status[i] == OK:
            scale = 1.0 / math.sqrt(u * u + v * v + 1.0)
            d[0], d[1], d[2] = u * scale, v * scale, scale
            r_cc[i] = _through_window(d, normal[e], cabin[e], outside[e], bent)
            if math.isnan(r_cc[i]):
                status[i] = OUTSIDE_CAMERA
        if status[i] != OK:
            _blank(rays, i)
            continue
        for k in range(3):
            rays[THROUGH + k, i] = bent[k]
            d[k] += bent[k]
        turn = rotation[e]
        for k in range(3):
            rays[APPARENT + k, i] = turn[0, k] * d[0] + turn[1, k] * d[1] + turn[2, k] * d[2]
        rays[H_C, i] = height[e]
    for i in range(x.size):
        east2, north2 = rays[APPARENT, i] ** 2, rays[APPARENT + 1, i] ** 2
        level2 = east2 + north2
        # Rounding may leave the sine of a level ray 1e-16 above one.
        rays[SIN, i] = min(math.sqrt(level2), 1.0)
        rays[COS, i] = min(max(-rays[APPARENT + 2, i], -1.0), 1.0)
        # Euler's radius in the azimuth of the ray; at the nadir that of the meridian.
        if status[i] == OK:
            share = north2 / level2 if level2 > 0.0 else 1.0
            across, along = curvature[exposure[i], 1], curvature[exposure[i], 0]
            rays[RADIUS, i] = 1.0 / (across + share * (along - across))


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
