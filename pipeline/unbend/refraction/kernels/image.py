"""From pixels to rays outside the window, and from bent rays back to pixels, compiled.

Rays travel as rows `IDEAL_U` to `CAMERA_HEIGHT` of a matrix. Rows of one exposure that follow each
other are taken together, in short passes over all of them: what belongs to the exposure is read
once, and a loop without a branch runs four rays at a time. ``span`` is the pair of first row and
end of such a run.
"""

import math

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
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    FAR_BRANCH,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
)

FIRST_NEWTON_STEPS = 3  # enough for nearly all pixels, and without a branch
MORE_NEWTON_STEPS = 30  # where those were too few
ROUNDING = 4e-15  # of distorted image coordinates: the iteration ends
CONVERGED = 1e-12  # of distorted image coordinates: farther off there is no ray

SERIES_LIMIT_RAD = 0.01  # up to which the series of R_cc is good


@jit
def _newton(u_d, v_d, u, v, parameters):  # type: ignore[no-untyped-def]
    """A step of Newton's iteration towards the ideal image coordinates of distorted ones."""
    u_0, v_0 = distort(u, v, parameters)
    uu, uv, vv = slopes(u, v, parameters)
    inverse = 1.0 / (uu * vv - uv * uv)
    res_u = u_d - u_0
    res_v = v_d - v_0
    next_u = u + (vv * res_u - uv * res_v) * inverse
    next_v = v + (uu * res_v - uv * res_u) * inverse
    return next_u, next_v


@jit
def _ideal(span, pixels, camera, change_px, rays):  # type: ignore[no-untyped-def]
    """Fill `IDEAL_U` and `IDEAL_V` of pixels.

    NaN where the camera does not cover them or nothing converges. ``change_px`` is added to the
    principal distance; the two rows from `WINDOW_CHANGE` are used as room.
    """
    first, last = span
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
    u_d = rays[WINDOW_CHANGE]
    v_d = rays[WINDOW_CHANGE + 1]
    for i in range(first, last):
        u_d[i] = (x[i] - cx) / fx
        v_d[i] = (y[i] - cy) / fy
    for i in range(first, last):
        a = u_d[i]
        b = v_d[i]
        for _ in range(FIRST_NEWTON_STEPS):
            a, b = _newton(u_d[i], v_d[i], a, b, parameters)
        u[i] = a
        v[i] = b
    lens = 0.0 < fx < math.inf and 0.0 < fy < math.inf
    for i in range(first, last):
        a = u[i]
        b = v[i]
        u[i] = math.nan
        v[i] = math.nan
        if lens and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            for _ in range(MORE_NEWTON_STEPS):
                u_0, v_0 = distort(a, b, parameters)
                if abs(u_0 - u_d[i]) + abs(v_0 - v_d[i]) < ROUNDING:
                    break
                a, b = _newton(u_d[i], v_d[i], a, b, parameters)
            u_0, v_0 = distort(a, b, parameters)
            close = abs(u_0 - u_d[i]) + abs(v_0 - v_d[i]) < CONVERGED
            if close and a * a + b * b <= camera.largest_radius * camera.largest_radius:
                u[i] = a
                v[i] = b


@entry
def rays_of_pixels(x, y, camera, rays):  # type: ignore[no-untyped-def]
    """Fill the rows `IDEAL_U` and `IDEAL_V` of pixels; NaN where the camera does not cover them."""
    span = (np.uint64(0), np.uint64(x.size))
    _ideal(span, (x, y), camera, 0.0, rays)


@jit
def _snell(cos_in, sin2, excess):  # type: ignore[no-untyped-def]
    """Snell's law at a plane (Gyer 1996, Eq. 36, in vectors), without its differences.

    A direction with the cosine ``cos_in`` to the normal, and the squared sine ``sin2``, changes by
    ``excess`` = n_in / n_out - 1 times its part along the plane, and along the normal by the first
    number that this returns; the second is the squared length of the change.
    """
    cos_out = math.sqrt(1.0 - (1.0 + excess) * (1.0 + excess) * sin2)
    forward = -excess * (2.0 + excess) * sin2 / (cos_out + cos_in)
    length2 = excess * excess * sin2 + forward * forward
    return forward, length2


@entry
def refract_directions(direction, normal, excess, change, angle):  # type: ignore[no-untyped-def]
    """Fill the change (n, 3) of directions at planes, and the angle it amounts to (n,) [rad]."""
    for i in range(angle.size):
        d = direction[i]
        normal_i = normal[i]
        tangent = change[i]
        cos_in = d[0] * normal_i[0] + d[1] * normal_i[1] + d[2] * normal_i[2]
        if not cos_in > 0.0:
            cos_in = math.nan
        for k in range(3):
            tangent[k] = d[k] - cos_in * normal_i[k]
        sin2 = tangent[0] * tangent[0] + tangent[1] * tangent[1] + tangent[2] * tangent[2]
        forward, length2 = _snell(cos_in, sin2, excess[i])
        for k in range(3):
            tangent[k] = excess[i] * tangent[k] + forward * normal_i[k]
        angle[i] = math.copysign(2.0 * math.asin(0.5 * math.sqrt(length2)), excess[i])


@jit
def _refract(span, inside, window, along_and_r_cc):  # type: ignore[no-untyped-def]
    """Fill by how much directions ``inside`` (3, n) change along the normal, and R_cc.

    They change besides by ``excess`` times themselves. ``window`` holds the normal and the excess.
    R_cc is good below 0.01. NaN for rays that the window reflects wholly, or that do not lead out.
    """
    first, last = span
    normal, excess = window
    along, r_cc = along_and_r_cc
    d_0 = inside[0]
    d_1 = inside[1]
    d_2 = inside[2]
    n_0 = normal[0]
    n_1 = normal[1]
    n_2 = normal[2]
    for i in range(first, last):
        cos_in = d_0[i] * n_0 + d_1[i] * n_1 + d_2[i] * n_2
        t_0 = d_0[i] - cos_in * n_0
        t_1 = d_1[i] - cos_in * n_1
        t_2 = d_2[i] - cos_in * n_2
        forward, length2 = _snell(cos_in, t_0 * t_0 + t_1 * t_1 + t_2 * t_2, excess)
        # Twice the arcsine of half the length.
        turned = math.sqrt(length2) * (1.0 + length2 * (1.0 + 0.1125 * length2) / 24.0)
        out = 1.0 if cos_in > 0.0 else math.nan
        along[i] = out * (forward - excess * cos_in)
        r_cc[i] = out * math.copysign(turned, excess)


@within
def _leave_camera(span, rays, scratch, exposure, r_cc):  # type: ignore[no-untyped-def]
    """Fill the rays of one exposure from their ideal image coordinates; NaN stays NaN.

    ``exposure`` holds normal of the window, excess n_cc/n - 1, rotation and curvature;
    ``scratch`` (4, n) is room to work in. A loop for each column: few columns in a loop are fast.
    """
    first, last = span
    normal, excess, turn, curvature = exposure
    u = rays[IDEAL_U]
    v = rays[IDEAL_V]
    d = scratch[:3]
    along = scratch[3]
    for i in range(first, last):
        d[2, i] = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0)
    for i in range(first, last):
        d[0, i] = u[i] * d[2, i]
        d[1, i] = v[i] * d[2, i]
    if excess == 0.0:
        for i in range(first, last):
            along[i] = 0.0
            r_cc[i] = 0.0
    else:
        _refract(span, d, (normal, excess), (along, r_cc))
    for k in range(3):
        change = rays[WINDOW_CHANGE + k]
        inside = d[k]
        part = normal[k]
        for i in range(first, last):
            change[i] = excess * inside[i] + along[i] * part
    for k in range(3):
        change = rays[WINDOW_CHANGE + k]
        inside = d[k]
        for i in range(first, last):
            inside[i] += change[i]
    d_0 = d[0]
    d_1 = d[1]
    d_2 = d[2]
    for k in range(3):
        t_0 = turn[0, k]
        t_1 = turn[1, k]
        t_2 = turn[2, k]
        apparent = rays[DIRECTION + k]
        for i in range(first, last):
            apparent[i] = t_0 * d_0[i] + t_1 * d_1[i] + t_2 * d_2[i]
    _angles_outside(span, rays, curvature)


@jit
def _angles_outside(span, rays, curvature):  # type: ignore[no-untyped-def]
    """Fill sine and cosine of the nadir angle, and Euler's radius in the azimuth of the ray.

    From 1/radius in the meridian, which also serves at the nadir, and in the prime vertical.
    """
    first, last = span
    meridian = curvature[0]
    vertical = curvature[1]
    east = rays[DIRECTION]
    north = rays[DIRECTION + 1]
    up = rays[DIRECTION + 2]
    sine = rays[NADIR_SINE]
    cosine = rays[NADIR_COSINE]
    radius = rays[SPHERE_RADIUS]
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
def _flag_without_ray(span, rays, outside, r_cc, status):  # type: ignore[no-untyped-def]
    """Give observations without a ray their status, and take the numbers out of all of those."""
    first, last = span
    u = rays[IDEAL_U]
    for i in range(first, last):
        if status[i] == OK:
            if math.isnan(u[i]):
                status[i] = OUTSIDE_CAMERA
            elif math.isnan(outside):
                status[i] = OUTSIDE_PROFILE
            elif math.isnan(r_cc[i]):
                status[i] = OUTSIDE_CAMERA
            elif abs(r_cc[i]) > SERIES_LIMIT_RAD:  # near total reflection
                x = rays[WINDOW_CHANGE, i]
                y = rays[WINDOW_CHANGE + 1, i]
                z = rays[WINDOW_CHANGE + 2, i]
                turned = 2.0 * math.asin(0.5 * math.sqrt(x * x + y * y + z * z))
                r_cc[i] = math.copysign(turned, r_cc[i])
        if status[i] != OK:
            r_cc[i] = math.nan
            for k in range(RAY_ROWS):
                rays[k, i] = math.nan


@within
def _end_of_exposure(exposure, first):  # type: ignore[no-untyped-def]
    """The row after the last that follows ``first`` and is of the same exposure.

    Rows are unsigned: an index that might count from the end would keep the compiler from vectors.
    """
    last = first + np.uint64(1)
    while last < exposure.size and exposure[last] == exposure[first]:
        last += np.uint64(1)
    return last


@jit
def _status_of_input(x, y, h_g, has_station):  # type: ignore[no-untyped-def]
    """The status of an observation before its ray is sought."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return BAD_MEASUREMENT
    if not has_station:
        return NO_STATION
    if not math.isfinite(h_g):
        return NO_GROUND
    return OK


@entry
def fill_outgoing_rays(observed, camera, exposures, rays, status_and_r_cc):  # type: ignore[no-untyped-def]
    """Fill the matrix of rays, a status where there is no ray to follow, and R_cc."""
    x, y, h_g, _, exposure = observed
    status, r_cc = status_and_r_cc
    scratch = np.empty((4, x.size))
    last = np.uint64(0)
    while last < x.size:
        first = last
        last = _end_of_exposure(exposure, first)
        span = (first, last)
        e = exposure[first]
        has_station = 0 <= e < exposures.usable.size and exposures.usable[e]
        for i in range(first, last):
            status[i] = _status_of_input(x[i], y[i], h_g[i], has_station)
        outside = math.nan
        if has_station:
            outside = exposures.outside[e]
            height = exposures.height[e]
            for i in range(first, last):
                rays[CAMERA_HEIGHT, i] = height
            _ideal(span, (x, y), camera, exposures.change_px[e], rays)
            excess = (exposures.cabin[e] - outside) / (1.0 + outside)
            exposure_e = (
                exposures.normal[e],
                excess,
                exposures.rotation[e],
                exposures.curvature[e],
            )
            _leave_camera(span, rays, scratch, exposure_e, r_cc)
        _flag_without_ray(span, rays, outside, r_cc, status)


@jit
def _reach(cos_z, h_c, h_g, radius, far):  # type: ignore[no-untyped-def]
    """Distance along a straight line to where it meets a height; NaN where it never does."""
    if h_c == h_g and not far:
        return 0.0
    along = (radius + h_c) * cos_z
    drop = (h_c - h_g) * (2.0 * radius + h_c + h_g)
    q = math.sqrt(along * along - drop)
    # Downwards the nearer of two crossings unless the far one is meant, upwards the only one.
    distance = drop / (along + q) if h_c > h_g and not far else along + q
    return distance if distance >= 0.0 else math.nan


@entry
def fill_straight_reach(rays, far, distance):  # type: ignore[no-untyped-def]
    """Fill the distances at which the straight lines of `RayColumns` meet their target heights.

    Downwards the nearer of two crossings, or the other where ``far`` (n,); sin_c is not read.
    """
    for i in range(distance.size):
        distance[i] = _reach(rays.cos_c[i], rays.h_c[i], rays.h_g[i], rays.r_e[i], far[i])


@within
def _shift_in_image(span, rays, scratch, exposure, shifts):  # type: ignore[no-untyped-def]
    """Fill dx and dy of one exposure; ``scratch`` as `shift_back` has it.

    ``exposure`` holds its camera, its rotation, and what is added to the principal distance.
    """
    first, last = span
    camera, turn, change_px = exposure
    dx, dy = shifts
    fx = camera.fx
    fy = camera.fy
    parameters = camera.distortion
    u = rays[IDEAL_U]
    v = rays[IDEAL_V]
    lower_0 = scratch[2]
    lower_1 = scratch[3]
    lower_2 = scratch[4]
    seen = scratch[5:8]
    for k in range(3):
        t_0 = turn[k, 0]
        t_1 = turn[k, 1]
        t_2 = turn[k, 2]
        through = rays[WINDOW_CHANGE + k]
        moved = seen[k]
        for i in range(first, last):
            moved[i] = through[i] + (t_0 * lower_0[i] + t_1 * lower_1[i] + t_2 * lower_2[i])
    s_0 = seen[0]
    s_1 = seen[1]
    s_2 = seen[2]
    for i in range(first, last):
        depth = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0) + s_2[i]
        u_0, v_0 = distort(u[i], v[i], parameters)
        u_straight = u[i] + (s_0[i] - u[i] * s_2[i]) / depth
        v_straight = v[i] + (s_1[i] - v[i] * s_2[i]) / depth
        u_1, v_1 = distort(u_straight, v_straight, parameters)
        dx[i] = fx * (u_1 - u_0) - change_px * u_0
        dy[i] = fy * (v_1 - v_0) - change_px * v_0


@within
def _shift_on_ground(span, rays, scratch, landing, shift_ground):  # type: ignore[no-untyped-def]
    """Fill how far apart straight rays land, that inside the window and the true one.

    ``landing`` holds the rotation of the exposure, and ground height and status of the rows.
    """
    first, last = span
    turn, h_g, status = landing
    lower = scratch[2:5]
    seen = scratch[5:8]
    radius = rays[SPHERE_RADIUS]
    h_c = rays[CAMERA_HEIGHT]
    through_0 = rays[WINDOW_CHANGE]
    through_1 = rays[WINDOW_CHANGE + 1]
    through_2 = rays[WINDOW_CHANGE + 2]
    for k in range(3):  # the direction inside the window, east-north-up
        t_0 = turn[0, k]
        t_1 = turn[1, k]
        t_2 = turn[2, k]
        apparent = rays[DIRECTION + k]
        inside = seen[k]
        for i in range(first, last):
            turned = t_0 * through_0[i] + t_1 * through_1[i] + t_2 * through_2[i]
            inside[i] = apparent[i] - turned
    east = rays[DIRECTION]
    north = rays[DIRECTION + 1]
    up = rays[DIRECTION + 2]
    for i in range(first, last):
        far = status[i] == FAR_BRANCH
        raw = _reach(-seen[2, i], h_c[i], h_g[i], radius[i], far)
        true = _reach(-up[i] - lower[2, i], h_c[i], h_g[i], radius[i], far)
        x = seen[0, i] * raw - (east[i] + lower[0, i]) * true
        y = seen[1, i] * raw - (north[i] + lower[1, i]) * true
        z = seen[2, i] * raw - (up[i] + lower[2, i]) * true
        shift_ground[i] = math.sqrt(x * x + y * y + z * z)


@entry
def shift_back(observed, camera, exposures, traced, shifts):  # type: ignore[no-untyped-def]
    """Fill the shifts in the image and on the ground that refraction angles amount to.

    Rows of ``scratch``: sines of half the angle and of the angle, change of the direction outside
    (3), and room for three more.
    """
    exposure = observed.exposure
    h_g = observed.h_g
    status = traced.status
    rays = traced.rays
    r_c = traced.r_c
    dx, dy, ground = shifts
    scratch = np.empty((8, r_c.size))
    half = scratch[0]
    sin_r = scratch[1]
    lower = scratch[2:5]
    for i in range(r_c.size):
        half[i] = math.sin(0.5 * r_c[i])
        sin_r[i] = math.sin(r_c[i])
    for i in range(r_c.size):
        # The direction turns towards the nadir; zero for a ray at the nadir.
        sin_z = rays[NADIR_SINE, i]
        cos_z = rays[NADIR_COSINE, i]
        back = -2.0 * (half[i] * half[i])
        inward = sin_r[i] * cos_z / sin_z if sin_z > 0.0 else 0.0
        lower[0, i] = rays[DIRECTION, i] * (back - inward)
        lower[1, i] = rays[DIRECTION + 1, i] * (back - inward)
        lower[2, i] = rays[DIRECTION + 2, i] * back - sin_r[i] * sin_z
    last = np.uint64(0)
    while last < r_c.size:
        first = last
        last = _end_of_exposure(exposure, first)
        span = (first, last)
        e = exposure[first]
        if 0 <= e < exposures.usable.size:
            turn = exposures.rotation[e]
            of_exposure = (camera, turn, exposures.change_px[e])
            _shift_in_image(span, rays, scratch, of_exposure, (dx, dy))
            _shift_on_ground(span, rays, scratch, (turn, h_g, status), ground)
    for i in range(r_c.size):
        if math.isnan(r_c[i]):
            dx[i] = math.nan
            dy[i] = math.nan
            ground[i] = math.nan
