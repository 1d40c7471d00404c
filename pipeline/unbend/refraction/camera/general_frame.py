"""The distortion of frame cameras at its most general, for numbers and for columns.

With (s, t) ideal image coordinates from the principal point of best symmetry, in units of the
principal distance, and r^2 = s^2 + t^2, the distortion is

    ds = s (q - 1) + px (r^2 + 2 s^2) + 2 py s t,   dt = t (q - 1) + py (r^2 + 2 t^2) + 2 px s t,
    q = (1 + k0 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) / (1 + q1 r^2 + q2 r^4 + q3 r^6).

``sense`` +1: (ds, dt) is added to ideal coordinates and gives distorted ones (COLMAP's FULL_OPENCV,
Metashape). ``sense`` -1: (ds, dt) is added to distorted coordinates and gives ideal ones (reports
of the USGS). An affinity of the distorted coordinates comes last: u_d = u + skew_x v,
v_d = v + skew_y u.
"""

from typing import Any, NamedTuple

import numpy as np

from unbend.refraction.camera.brown_conrady import first_root

# Largest slope of a correction that 30 iterations of `distort` invert, to 0.3^30 = 2e-16.
_MAX_CORRECTION_SLOPE = 0.3


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
    offset_u: float = 0.0  # principal point minus point of best symmetry
    offset_v: float = 0.0
    skew_x: float = 0.0
    skew_y: float = 0.0
    sense: float = 1.0  # +1 distortion, -1 correction
    limit: float = 1e9  # calibrated radius about the principal point
    steps: float = 30.0  # iterations that invert a correction; its slope multiplies the error


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
    """Distorted image coordinates of ideal ones, both in units of the principal distance.

    A correction (``sense`` -1) is inverted by iteration: (x, y) = (s, t) - (ds, dt)(x, y).

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
    if p.sense > 0.0:  # a distortion is evaluated once, at (s, t)
        steps = 1
    x = s
    y = t
    for _ in range(steps):
        r2 = x * x + y * y
        numerator_less_1 = p.k0 + r2 * (p.k1 + r2 * (p.k2 + r2 * (p.k3 + r2 * p.k4)))
        denominator_less_1 = r2 * (p.q1 + r2 * (p.q2 + r2 * p.q3))
        q_less_1 = (numerator_less_1 - denominator_less_1) / (1.0 + denominator_less_1)
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

    For a correction they are the inverse of the matrix of its derivatives at the distorted (x, y).
    """
    p = parameters
    s = u + p.offset_u
    t = v + p.offset_v
    steps = int(p.steps)
    if p.sense > 0.0:  # a distortion has its derivatives at (s, t)
        steps = 0
    x = s
    y = t
    for _ in range(steps):  # as in `distort`; a correction has no denominator
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
    denominator = 1.0 + r2 * (p.q1 + r2 * (p.q2 + r2 * p.q3))
    q = (1.0 + p.k0 + r2 * (p.k1 + r2 * (p.k2 + r2 * (p.k3 + r2 * p.k4)))) / denominator
    numerator_slope = p.k1 + r2 * (2.0 * p.k2 + r2 * (3.0 * p.k3 + 4.0 * r2 * p.k4))
    denominator_slope = p.q1 + r2 * (2.0 * p.q2 + 3.0 * r2 * p.q3)
    twice_q_slope = 2.0 * (numerator_slope - q * denominator_slope) / denominator  # 2 dq/d(r^2)
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

    A distortion up to where it turns back, a correction up to where its slope is 0.3; less the
    offset of the point of best symmetry, and at most the calibrated radius ``limit``.

    >>> round(largest_radius(GeneralFrame(q1=1.0)), 9)  # d(r / (1 + r^2))/dr = 0
    1.0
    >>> round(largest_radius(GeneralFrame(k1=-0.1, sense=-1.0)), 9)  # 1 - 0.3 r^2 = 0.7
    0.9
    """
    p = parameters
    # Polynomials in r^2.
    square = np.polynomial.Polynomial([0.0, 1.0])
    numerator = np.polynomial.Polynomial([1.0 + p.k0, p.k1, p.k2, p.k3, p.k4])
    denominator = np.polynomial.Polynomial([1.0, p.q1, p.q2, p.q3])
    slope_of_r_numerator = numerator + 2.0 * square * numerator.deriv()  # d(r numerator)/dr
    if p.sense < 0.0:
        correction_slope = slope_of_r_numerator - 1.0
        rises_to = first_root(correction_slope - _MAX_CORRECTION_SLOPE)
        falls_to = first_root(correction_slope + _MAX_CORRECTION_SLOPE)
        distorted_r = min(rises_to, falls_to)
        ideal_r = np.inf
        if distorted_r < np.inf:
            ideal_r = distorted_r * float(numerator(distorted_r * distorted_r))
    else:
        # Where d(r numerator / denominator)/dr = 0, or where the denominator is.
        turns = slope_of_r_numerator * denominator - 2.0 * square * numerator * denominator.deriv()
        ideal_r = min(first_root(turns), first_root(denominator))
    return float(min(ideal_r - np.hypot(p.offset_u, p.offset_v), p.limit))
