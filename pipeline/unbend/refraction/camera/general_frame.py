"""The distortion of frame cameras at its most general, for numbers and for columns.

With (s, t) ideal image coordinates from the principal point of best symmetry, in units of the
principal distance, and r^2 = s^2 + t^2, the distortion is

    ds = s (q - 1) + px (r^2 + 2 s^2) + 2 py s t,   dt = t (q - 1) + py (r^2 + 2 t^2) + 2 px s t,
    q = (1 + k0 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) / (1 + q1 r^2 + q2 r^4 + q3 r^6).

``sense`` +1: it is added to ideal coordinates (COLMAP's FULL_OPENCV, Metashape). ``sense`` -1: it
is what corrects measured ones, so that (s + ds, t + dt) of distorted (s, t) are ideal (reports of
the USGS). Affinity comes last: u_d = u + skew_x v, v_d = v + skew_y u.
"""

from typing import Any, NamedTuple

import numpy as np

from unbend.refraction.camera.brown_conrady import first_root

_STEEPEST = 0.3  # slope of a correction that the iteration of `distort` inverts, to 0.3^30 = 2e-16


class GeneralFrame(NamedTuple):
    """Coefficients of the module's equations; lengths are in units of the principal distance."""

    k0: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    q1: float = 0.0
    q2: float = 0.0
    q3: float = 0.0
    px: float = 0.0
    py: float = 0.0
    offset_u: float = 0.0  # principal point less point of best symmetry
    offset_v: float = 0.0
    skew_x: float = 0.0
    skew_y: float = 0.0
    sense: float = 1.0
    limit: float = 1e9  # calibrated radius about the principal point
    steps: float = 30.0  # that invert a correction; each gains a factor of its slope


Parameters = GeneralFrame

MODELS = {
    "FULL_OPENCV": (
        *("fx", "fy", "cx", "cy"),
        *("k1", "k2", "py", "px", "k3", "q1", "q2", "q3"),
    ),
    "GENERAL_FRAME": ("fx", "fy", "cx", "cy", *GeneralFrame._fields),
}
"""Names and parameters of camera models with this distortion, in COLMAP's order.

GENERAL_FRAME, which COLMAP does not have, is the last and has all parameters.
"""


def distort(u: Any, v: Any, parameters: GeneralFrame) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones.

    A correction (``sense`` -1) is inverted by repetition: (x, y) = (s, t) - (ds, dt)(x, y).

    >>> [round(c, 9) for c in distort(0.5, 0.0, GeneralFrame(k1=0.1, q1=0.2))]
    [0.488095238, 0.0]
    >>> x = distort(0.5, 0.0, GeneralFrame(k1=0.1, sense=-1.0))[0]
    >>> round(x + 0.1 * x**3, 12)
    0.5
    """
    p = parameters
    s = u + p.offset_u
    t = v + p.offset_v
    steps = int(p.steps)
    if p.sense > 0.0:
        steps = 1
    x = s
    y = t
    for _ in range(steps):
        r2 = x * x + y * y
        above = p.k0 + r2 * (p.k1 + r2 * (p.k2 + r2 * (p.k3 + r2 * p.k4)))
        below = r2 * (p.q1 + r2 * (p.q2 + r2 * p.q3))
        q_less_1 = (above - below) / (1.0 + below)
        dx = x * q_less_1
        dx += p.px * (r2 + 2.0 * x * x)
        dx += 2.0 * p.py * x * y
        dy = y * q_less_1
        dy += p.py * (r2 + 2.0 * y * y)
        dy += 2.0 * p.px * x * y
        x = s + p.sense * dx
        y = t + p.sense * dy
    u_of_lens = x - p.offset_u
    v_of_lens = y - p.offset_v
    return u_of_lens + p.skew_x * v_of_lens, v_of_lens + p.skew_y * u_of_lens


def slopes(u: Any, v: Any, parameters: GeneralFrame) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`, without the affinity.

    Those of a correction are the inverse of the matrix of its own derivatives, at (x, y).
    """
    p = parameters
    s = u + p.offset_u
    t = v + p.offset_v
    steps = int(p.steps)
    if p.sense > 0.0:
        steps = 0
    x = s
    y = t
    for _ in range(steps):  # a correction has no denominator
        r2 = x * x + y * y
        q_less_1 = p.k0 + r2 * (p.k1 + r2 * (p.k2 + r2 * (p.k3 + r2 * p.k4)))
        dx = x * q_less_1
        dx += p.px * (r2 + 2.0 * x * x)
        dx += 2.0 * p.py * x * y
        dy = y * q_less_1
        dy += p.py * (r2 + 2.0 * y * y)
        dy += 2.0 * p.px * x * y
        x = s - dx
        y = t - dy
    r2 = x * x + y * y
    below = 1.0 + r2 * (p.q1 + r2 * (p.q2 + r2 * p.q3))
    q = (1.0 + p.k0 + r2 * (p.k1 + r2 * (p.k2 + r2 * (p.k3 + r2 * p.k4)))) / below
    above_slope = p.k1 + r2 * (2.0 * p.k2 + r2 * (3.0 * p.k3 + 4.0 * r2 * p.k4))
    below_slope = p.q1 + r2 * (2.0 * p.q2 + 3.0 * r2 * p.q3)
    twice_q_slope = 2.0 * (above_slope - q * below_slope) / below  # 2 dq/d(r^2)
    uu = q + x * x * twice_q_slope
    uu += 6.0 * p.px * x
    uu += 2.0 * p.py * y
    uv = x * y * twice_q_slope
    uv += 2.0 * p.px * y
    uv += 2.0 * p.py * x
    vv = q + y * y * twice_q_slope
    vv += 6.0 * p.py * y
    vv += 2.0 * p.px * x
    if p.sense > 0.0:
        return uu, uv, vv
    inverse = 1.0 / (uu * vv - uv * uv)
    return vv * inverse, -uv * inverse, uu * inverse


def largest_radius(parameters: GeneralFrame) -> float:
    """Ideal radius (tan of the field angle) up to which the distortion can be inverted.

    >>> round(largest_radius(GeneralFrame(q1=1.0)), 9)  # d(r / (1 + r^2))/dr = 0
    1.0
    >>> round(largest_radius(GeneralFrame(k1=-0.1, sense=-1.0)), 9)  # 1 - 0.3 r^2 = 0.7
    0.9
    """
    p = parameters
    square = np.polynomial.Polynomial([0.0, 1.0])
    above = np.polynomial.Polynomial([1.0 + p.k0, p.k1, p.k2, p.k3, p.k4])
    below = np.polynomial.Polynomial([1.0, p.q1, p.q2, p.q3])
    slope_above = above + 2.0 * square * above.deriv()  # d(r above)/dr
    if p.sense < 0.0:
        correction_slope = slope_above - 1.0
        grows_to = first_root(correction_slope - _STEEPEST)
        falls_to = first_root(correction_slope + _STEEPEST)
        r = min(grows_to, falls_to)
        reached = np.inf
        if r < np.inf:
            reached = r * float(above(r * r))
    else:
        # Where d(r above / below)/dr = 0, or where the denominator is.
        turns = slope_above * below - 2.0 * square * above * below.deriv()
        reached = min(first_root(turns), first_root(below))
    return float(min(reached - np.hypot(p.offset_u, p.offset_v), p.limit))
