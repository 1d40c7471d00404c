"""Snell's law at the plane of a window (Gyer 1996, Eq. 36), in vectors, compiled.

A ray with the unit vector d meets the plane at the angle of incidence a. The unit normal m of the
plane points to where the ray goes. With excess = n_in / n_out - 1 the unit vector behind
the plane is

    d' = (1 + excess) t + m cos(a'),   t = d - m cos(a),   sin(a') = (1 + excess) sin(a),

so that the direction changes by

    d' - d = excess t + m (cos(a') - cos(a)),
    cos(a') - cos(a) = -excess (2 + excess) sin^2(a) / (cos(a') + cos(a)),

which loses no digits where the excess, some 1e-4, is small. The angle between d and d' is
2 asin(length / 2), with the length of the change.
"""

import math

from unbend.refraction.kernels.jit import entry, jit


@jit
def dot(a, b):  # type: ignore[no-untyped-def]
    """The scalar product of two vectors of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def _change_at_plane(cos_in, sin2_in, excess):  # type: ignore[no-untyped-def]
    """cos(a') - cos(a) at a plane between two media, and the squared length of d' - d.

    a and a' are the angles of the ray to the normal before and behind the plane, d and d' its unit
    vectors there. ``cos_in`` and ``sin2_in`` are cos(a) and sin^2(a), ``excess`` is
    n_in / n_out - 1. Both results are NaN where the plane reflects the ray wholly.
    """
    ratio = 1.0 + excess  # n_in / n_out
    cos_out = math.sqrt(1.0 - ratio * ratio * sin2_in)
    change_of_cosine = -excess * (2.0 + excess) * sin2_in / (cos_out + cos_in)
    # d' - d = excess t + m (cos(a') - cos(a)): t, sin(a) long, is square to the unit normal m.
    length2 = excess * excess * sin2_in + change_of_cosine * change_of_cosine
    return change_of_cosine, length2


@entry
def refract_directions(direction, normal, excess, change, angle):  # type: ignore[no-untyped-def]
    """Fill the change of direction at planes, and the angle between the two directions [rad].

    ``direction`` and ``normal`` (n, 3) are unit vectors, ``excess`` (n,) is n_in / n_out - 1.
    ``change`` (n, 3) and ``angle`` (n,), which has the sign of the excess, are filled; both are NaN
    for a ray that is reflected wholly or does not go to the side the normal points to.
    """
    for i in range(angle.size):
        d = direction[i]
        m = normal[i]
        cos_in = dot(d, m)
        if not cos_in > 0.0:
            cos_in = math.nan
        # t, the direction's part along the plane, is computed in the row of the result.
        t = change[i]
        for k in range(3):
            t[k] = d[k] - cos_in * m[k]
        sin2_in = dot(t, t)
        change_of_cosine, length2 = _change_at_plane(cos_in, sin2_in, excess[i])
        for k in range(3):
            change[i, k] = excess[i] * t[k] + change_of_cosine * m[k]
        half_length = 0.5 * math.sqrt(length2)
        angle[i] = math.copysign(2.0 * math.asin(half_length), excess[i])


@jit
def fill_window_change(rows, direction, normal, excess, along_normal, r_cc):  # type: ignore[no-untyped-def]
    """Fill the change of direction at the window of one exposure, and the angle R_cc [rad].

    ``rows`` are the `ExposureRows`, ``direction`` (3, n) unit vectors of rays inside the window,
    ``normal`` (3,) its unit normal outwards, ``excess`` n_cabin / n_outside - 1. Filled are
    ``along_normal`` (n,), from which the change follows as
    excess * direction + ``along_normal`` * normal, and ``r_cc`` (n,), which has the sign of excess.

    R_cc is 2 asin(length of the change / 2) by its series, good below 0.01. Both are NaN for a ray
    that the window reflects wholly, or that does not lead out.
    """
    d_0 = direction[0]
    d_1 = direction[1]
    d_2 = direction[2]
    m = (normal[0], normal[1], normal[2])
    for i in range(rows.first, rows.end):
        d = (d_0[i], d_1[i], d_2[i])
        cos_in = dot(d, m)
        t_0 = d[0] - cos_in * m[0]
        t_1 = d[1] - cos_in * m[1]
        t_2 = d[2] - cos_in * m[2]
        t = (t_0, t_1, t_2)
        change_of_cosine, length2 = _change_at_plane(cos_in, dot(t, t), excess)
        series = 1.0 + length2 * (1.0 + 0.1125 * length2) / 24.0
        r_cc_size = math.sqrt(length2) * series
        one_if_outward = 1.0 if cos_in > 0.0 else math.nan
        # The change is excess t + change_of_cosine m, and t = d - m cos(a).
        along_normal[i] = one_if_outward * (change_of_cosine - excess * cos_in)
        r_cc[i] = one_if_outward * math.copysign(r_cc_size, excess)
