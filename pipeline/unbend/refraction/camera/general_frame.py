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
    """Coefficients; ``offset`` is principal point minus point of symmetry, ``limit`` the calibrated
    radius about the principal point, both in units of the principal distance; ``steps`` of the
    iteration that inverts a correction, each of which gains a factor of its slope."""

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
    offset_u: float = 0.0
    offset_v: float = 0.0
    skew_x: float = 0.0
    skew_y: float = 0.0
    sense: float = 1.0
    limit: float = 1e9
    steps: float = 30.0


Parameters = GeneralFrame


def distort(u: Any, v: Any, parameters: GeneralFrame) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones.

    >>> [round(c, 9) for c in distort(0.5, 0.0, GeneralFrame(k1=0.1, q1=0.2))]
    [0.488095238, 0.0]
    >>> x = distort(0.5, 0.0, GeneralFrame(k1=0.1, sense=-1.0))[0]
    >>> round(x + 0.1 * x**3, 12)
    0.5
    """
    k0, k1, k2, k3, k4, q1, q2, q3, px, py, a, b, skew_x, skew_y, sense, _, steps = parameters
    s, t = u + a, v + b
    x, y = s, t
    for _ in range(1 if sense > 0.0 else int(steps)):
        r2 = x * x + y * y
        above = k0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        below = r2 * (q1 + r2 * (q2 + r2 * q3))
        radial = (above - below) / (1.0 + below)
        dx = x * radial + px * (r2 + 2.0 * x * x) + 2.0 * py * x * y
        dy = y * radial + py * (r2 + 2.0 * y * y) + 2.0 * px * x * y
        x, y = s + sense * dx, t + sense * dy
    return x - a + skew_x * (y - b), y - b + skew_y * (x - a)


def slopes(u: Any, v: Any, parameters: GeneralFrame) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`, but for the affinity."""
    k0, k1, k2, k3, k4, q1, q2, q3, px, py, a, b, _, _, sense, _, steps = parameters
    s, t = u + a, v + b
    x, y = s, t
    for _ in range(0 if sense > 0.0 else int(steps)):
        r2 = x * x + y * y
        radial = k0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        dx = x * radial + px * (r2 + 2.0 * x * x) + 2.0 * py * x * y
        dy = y * radial + py * (r2 + 2.0 * y * y) + 2.0 * px * x * y
        x, y = s - dx, t - dy
    r2 = x * x + y * y
    below = 1.0 + r2 * (q1 + r2 * (q2 + r2 * q3))
    radial = (1.0 + k0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))) / below
    above_slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + 4.0 * r2 * k4))
    slope = 2.0 * (above_slope - radial * (q1 + r2 * (2.0 * q2 + 3.0 * r2 * q3))) / below
    uu = radial + x * x * slope + 6.0 * px * x + 2.0 * py * y
    uv = x * y * slope + 2.0 * px * y + 2.0 * py * x
    vv = radial + y * y * slope + 6.0 * py * y + 2.0 * px * x
    if sense > 0.0:
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
    if p.sense < 0.0:
        by_radius = above + 2.0 * square * above.deriv()
        r = min(first_root(by_radius - 1.0 - side * _STEEPEST) for side in (-1.0, 1.0))
        reached = r * float(above(r * r)) if r < np.inf else np.inf
    else:
        # Where d(r_d)/dr = 0, or where the denominator is.
        turns = (above + 2.0 * square * above.deriv()) * below
        reached = min(map(first_root, (turns - 2.0 * square * above * below.deriv(), below)))
    return float(min(reached - np.hypot(p.offset_u, p.offset_v), p.limit))
