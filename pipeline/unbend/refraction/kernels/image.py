"""From pixels to rays outside the window, and from bent rays back to pixels, compiled.

Rays travel as rows `U` to `H_C` of a matrix. Rows of one exposure that follow each other are taken
together, in short passes over all of them: what belongs to the exposure is read once, and a loop
without a branch runs four rays at a time. ``span`` is the pair of first row and end of such a run.
"""

import math

import numpy as np

from unbend.refraction import status_codes as codes
from unbend.refraction.camera import model_of
from unbend.refraction.kernels import columns as of
from unbend.refraction.kernels.jit import OfType, entry, jit, within

distort = OfType(lambda parameters: model_of(parameters).distort)
slopes = OfType(lambda parameters: model_of(parameters).slopes)


@jit
def _newton(u_d, v_d, u, v, parameters):  # type: ignore[no-untyped-def]
    """A step of Newton's iteration towards the ideal image coordinates of distorted ones."""
    u_0, v_0 = distort(u, v, parameters)
    uu, uv, vv = slopes(u, v, parameters)
    inverse = 1.0 / (uu * vv - uv * uv)
    res_u, res_v = u_d - u_0, v_d - v_0
    return u + (vv * res_u - uv * res_v) * inverse, v + (uu * res_v - uv * res_u) * inverse


@jit
def _ideal(span, pixels, camera, change_px, rays):  # type: ignore[no-untyped-def]
    """Fill `U` and `V` of pixels, NaN where the camera does not cover them or nothing converges.

    ``change_px`` is added to the principal distance; the two rows from `THROUGH` are used as room.
    """
    first, last = span
    x, y = pixels
    fx, fy = camera.fx + change_px, camera.fy + change_px
    cx, cy, width, height = camera.cx, camera.cy, camera.width, camera.height
    parameters = camera.distortion
    u, v, u_d, v_d = rays[of.U], rays[of.V], rays[of.THROUGH], rays[of.THROUGH + 1]
    for i in range(first, last):
        u_d[i] = (x[i] - cx) / fx
        v_d[i] = (y[i] - cy) / fy
    for i in range(first, last):  # three steps each, without a branch
        a, b = u_d[i], v_d[i]
        for _ in range(3):
            a, b = _newton(u_d[i], v_d[i], a, b, parameters)
        u[i], v[i] = a, b
    lens = 0.0 < fx < math.inf and 0.0 < fy < math.inf
    for i in range(first, last):
        a, b = u[i], v[i]
        u[i] = v[i] = math.nan
        if lens and 0.0 <= x[i] <= width and 0.0 <= y[i] <= height:
            for _ in range(30):  # more steps where three were too few
                u_0, v_0 = distort(a, b, parameters)
                if abs(u_0 - u_d[i]) + abs(v_0 - v_d[i]) < 4e-15:
                    break
                a, b = _newton(u_d[i], v_d[i], a, b, parameters)
            u_0, v_0 = distort(a, b, parameters)
            close = abs(u_0 - u_d[i]) + abs(v_0 - v_d[i]) < 1e-12
            if close and a * a + b * b <= camera.largest_radius * camera.largest_radius:
                u[i], v[i] = a, b


@entry(rows=0, most=24_000)
def rays_of_pixels(x, y, camera, rays):  # type: ignore[no-untyped-def]
    """Fill the rows `U` and `V` of pixels; NaN where the camera does not cover them."""
    _ideal((np.uint64(0), np.uint64(x.size)), (x, y), camera, 0.0, rays)


@jit
def _snell(cos_in, sin2, excess):  # type: ignore[no-untyped-def]
    """Snell's law at a plane (Gyer 1996, Eq. 36, in vectors), without its differences.

    A direction with the cosine ``cos_in`` to the normal, and the squared sine ``sin2``, changes by
    ``excess`` = n_in / n_out - 1 times its part along the plane, and along the normal by the first
    number that this returns; the second is the squared length of the change.
    """
    cos_out = math.sqrt(1.0 - (1.0 + excess) * (1.0 + excess) * sin2)
    forward = -excess * (2.0 + excess) * sin2 / (cos_out + cos_in)
    return forward, excess * excess * sin2 + forward * forward


@entry(rows=4, most=3000)
def refract_directions(direction, normal, excess, change, angle):  # type: ignore[no-untyped-def]
    """Fill the change (n, 3) of directions at planes, and the angle it amounts to (n,) [rad]."""
    for i in range(angle.size):
        d, normal_i, tangent = direction[i], normal[i], change[i]
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
def _refract(span, rays, inside, window, along_and_r_cc):  # type: ignore[no-untyped-def]
    """Fill by how much directions ``inside`` (3, n) change along the normal, and R_cc.

    They change besides by ``excess`` times themselves. ``window`` holds the normal and the excess.
    R_cc is good below 0.01. NaN for rays that the window reflects wholly, or that do not lead out.
    """
    first, last = span
    normal, excess = window
    along, r_cc = along_and_r_cc
    d_0, d_1, d_2 = inside[0], inside[1], inside[2]
    n_0, n_1, n_2 = normal[0], normal[1], normal[2]
    for i in range(first, last):
        cos_in = d_0[i] * n_0 + d_1[i] * n_1 + d_2[i] * n_2
        t_0, t_1, t_2 = d_0[i] - cos_in * n_0, d_1[i] - cos_in * n_1, d_2[i] - cos_in * n_2
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
    u, v, d, along = rays[of.U], rays[of.V], scratch[:3], scratch[3]
    for i in range(first, last):
        d[2, i] = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0)
    for i in range(first, last):
        d[0, i] = u[i] * d[2, i]
        d[1, i] = v[i] * d[2, i]
    if excess == 0.0:
        for i in range(first, last):
            along[i] = r_cc[i] = 0.0
    else:
        _refract(span, rays, d, (normal, excess), (along, r_cc))
    for k in range(3):
        change, inside, part = rays[of.THROUGH + k], d[k], normal[k]
        for i in range(first, last):
            change[i] = excess * inside[i] + along[i] * part
    for k in range(3):
        change, inside = rays[of.THROUGH + k], d[k]
        for i in range(first, last):
            inside[i] += change[i]
    d_0, d_1, d_2 = d[0], d[1], d[2]
    for k in range(3):
        t_0, t_1, t_2, apparent = turn[0, k], turn[1, k], turn[2, k], rays[of.APPARENT + k]
        for i in range(first, last):
            apparent[i] = t_0 * d_0[i] + t_1 * d_1[i] + t_2 * d_2[i]
    _angles_outside(span, rays, curvature)


@jit
def _angles_outside(span, rays, curvature):  # type: ignore[no-untyped-def]
    """Fill sine and cosine of the nadir angle, and Euler's radius in the azimuth of the ray.

    From 1/radius in the meridian, which also serves at the nadir, and in the prime vertical.
    """
    first, last = span
    meridian, vertical = curvature[0], curvature[1]
    east, north, up = rays[of.APPARENT], rays[of.APPARENT + 1], rays[of.APPARENT + 2]
    sine, cosine, radius = rays[of.SIN], rays[of.COS], rays[of.RADIUS]
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
    u = rays[of.U]
    for i in range(first, last):
        if status[i] == codes.OK:
            if math.isnan(u[i]):
                status[i] = codes.OUTSIDE_CAMERA
            elif math.isnan(outside):
                status[i] = codes.OUTSIDE_PROFILE
            elif math.isnan(r_cc[i]):
                status[i] = codes.OUTSIDE_CAMERA
            elif abs(r_cc[i]) > 0.01:  # its series is not good near total reflection
                x, y, z = rays[of.THROUGH, i], rays[of.THROUGH + 1, i], rays[of.THROUGH + 2, i]
                turned = 2.0 * math.asin(0.5 * math.sqrt(x * x + y * y + z * z))
                r_cc[i] = math.copysign(turned, r_cc[i])
        if status[i] != codes.OK:
            r_cc[i] = math.nan
            for k in range(of.RAY_ROWS):
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


@entry(rows=0, most=24_000)
def outgoing_rays(observed, camera, exposures, rays, status_and_r_cc):  # type: ignore[no-untyped-def]
    """Fill the matrix of rays, a status where there is no ray to follow, and R_cc."""
    x, y, h_g, _, exposure = observed
    status, r_cc = status_and_r_cc
    scratch = np.empty((4, x.size))
    last = np.uint64(0)
    while last < x.size:
        first, last = last, _end_of_exposure(exposure, last)
        span, e = (first, last), exposure[first]
        station = 0 <= e < exposures.usable.size and exposures.usable[e]
        then = codes.OK if station else codes.NO_STATION
        for i in range(first, last):
            grounded = then if math.isfinite(h_g[i]) or not station else codes.NO_GROUND
            seen = math.isfinite(x[i]) and math.isfinite(y[i])
            status[i] = grounded if seen else codes.BAD_MEASUREMENT
        outside = math.nan
        if station:
            outside, height = exposures.outside[e], exposures.height[e]
            for i in range(first, last):
                rays[of.H_C, i] = height
            _ideal(span, (x, y), camera, exposures.change_px[e], rays)
            excess = (exposures.cabin[e] - outside) / (1.0 + outside)
            exposure_e = (
                exposures.normal[e], excess, exposures.rotation[e], exposures.curvature[e],
            )  # fmt: skip
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


@entry(rows=2, most=3000)
def straight_reach(rays, far, distance):  # type: ignore[no-untyped-def]
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
    fx, fy, parameters = camera.fx, camera.fy, camera.distortion
    u, v, lower, seen = rays[of.U], rays[of.V], scratch[2:5], scratch[5:8]
    l_0, l_1, l_2 = lower[0], lower[1], lower[2]
    for k in range(3):
        t_0, t_1, t_2 = turn[k, 0], turn[k, 1], turn[k, 2]
        through, moved = rays[of.THROUGH + k], seen[k]
        for i in range(first, last):
            moved[i] = through[i] + (t_0 * l_0[i] + t_1 * l_1[i] + t_2 * l_2[i])
    s_0, s_1, s_2 = seen[0], seen[1], seen[2]
    for i in range(first, last):
        depth = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i] + 1.0) + s_2[i]
        u_0, v_0 = distort(u[i], v[i], parameters)
        u_1 = u[i] + (s_0[i] - u[i] * s_2[i]) / depth
        u_1, v_1 = distort(u_1, v[i] + (s_1[i] - v[i] * s_2[i]) / depth, parameters)
        dx[i] = fx * (u_1 - u_0) - change_px * u_0
        dy[i] = fy * (v_1 - v_0) - change_px * v_0


@within
def _shift_on_ground(span, rays, scratch, landing, shift_ground):  # type: ignore[no-untyped-def]
    """Fill how far apart straight rays land, that inside the window and the true one.

    ``landing`` holds the rotation of the exposure, and ground height and status of the rows.
    """
    first, last = span
    turn, h_g, status = landing
    lower, seen, radius, h_c = scratch[2:5], scratch[5:8], rays[of.RADIUS], rays[of.H_C]
    through_0, through_1, through_2 = rays[of.THROUGH], rays[of.THROUGH + 1], rays[of.THROUGH + 2]
    for k in range(3):  # the direction inside the window, east-north-up
        t_0, t_1, t_2 = turn[0, k], turn[1, k], turn[2, k]
        apparent, inside = rays[of.APPARENT + k], seen[k]
        for i in range(first, last):
            inside[i] = apparent[i] - (t_0 * through_0[i] + t_1 * through_1[i] + t_2 * through_2[i])
    east, north, up = rays[of.APPARENT], rays[of.APPARENT + 1], rays[of.APPARENT + 2]
    for i in range(first, last):
        far = status[i] == codes.FAR_BRANCH
        raw = _reach(-seen[2, i], h_c[i], h_g[i], radius[i], far)
        true = _reach(-up[i] - lower[2, i], h_c[i], h_g[i], radius[i], far)
        x = seen[0, i] * raw - (east[i] + lower[0, i]) * true
        y = seen[1, i] * raw - (north[i] + lower[1, i]) * true
        z = seen[2, i] * raw - (up[i] + lower[2, i]) * true
        shift_ground[i] = math.sqrt(x * x + y * y + z * z)


@entry(rows=0, most=24_000)
def shift_back(observed, camera, exposures, traced, shifts):  # type: ignore[no-untyped-def]
    """Fill the shifts in the image and on the ground that refraction angles amount to.

    Rows of ``scratch``: sines of half the angle and of the angle, change of the direction outside
    (3), and room for three more.
    """
    exposure, h_g, status = observed.exposure, observed.h_g, traced.status
    rays, r_c, (dx, dy, ground) = traced.rays, traced.r_c, shifts
    scratch = np.empty((8, r_c.size))
    half, sin_r, lower = scratch[0], scratch[1], scratch[2:5]
    for i in range(r_c.size):
        half[i], sin_r[i] = math.sin(0.5 * r_c[i]), math.sin(r_c[i])
    for i in range(r_c.size):
        # The direction turns towards the nadir; zero for a ray at the nadir.
        sin_z, cos_z = rays[of.SIN, i], rays[of.COS, i]
        back = -2.0 * (half[i] * half[i])
        inward = sin_r[i] * cos_z / sin_z if sin_z > 0.0 else 0.0
        lower[0, i] = rays[of.APPARENT, i] * (back - inward)
        lower[1, i] = rays[of.APPARENT + 1, i] * (back - inward)
        lower[2, i] = rays[of.APPARENT + 2, i] * back - sin_r[i] * sin_z
    last = np.uint64(0)
    while last < r_c.size:
        first, last = last, _end_of_exposure(exposure, last)
        span, e = (first, last), exposure[first]
        if 0 <= e < exposures.usable.size:
            turn, change_px = exposures.rotation[e], exposures.change_px[e]
            _shift_in_image(span, rays, scratch, (camera, turn, change_px), (dx, dy))
            _shift_on_ground(span, rays, scratch, (turn, h_g, status), ground)
    for i in range(r_c.size):
        if math.isnan(r_c[i]):
            dx[i] = dy[i] = ground[i] = math.nan
