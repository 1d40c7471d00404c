"""The rational distortion of OpenCV, COLMAP's FULL_OPENCV, for numbers and for columns.

With (u, v) ideal image coordinates in units of the principal distance and r^2 = u^2 + v^2,

    q = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),
    u_d = u q + 2 p1 u v + p2 (r^2 + 2 u^2),   v_d = v q + p1 (r^2 + 2 v^2) + 2 p2 u v.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class FullOpenCV(NamedTuple):
    """Coefficients in COLMAP's order."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


Parameters = FullOpenCV


def distort(u: Any, v: Any, parameters: FullOpenCV) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones.

    >>> [round(c, 9) for c in distort(0.5, 0.0, FullOpenCV(k1=0.1, k4=0.2))]
    [0.488095238, 0.0]
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = parameters
    r2 = u * u + v * v
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u_d = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
    v_d = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
    return u_d, v_d


def slopes(u: Any, v: Any, parameters: FullOpenCV) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`."""
    k1, k2, p1, p2, k3, k4, k5, k6 = parameters
    r2 = u * u + v * v
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    upper_slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    lower_slope = k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6)
    slope = 2.0 * (upper_slope - radial * lower_slope) / below
    uu = radial + u * u * slope + 2.0 * p1 * v + 6.0 * p2 * u
    uv = u * v * slope + 2.0 * p1 * u + 2.0 * p2 * v
    vv = radial + v * v * slope + 6.0 * p1 * v + 2.0 * p2 * u
    return uu, uv, vv


def largest_radius(parameters: FullOpenCV) -> float:
    """Ideal radius (tan of the field angle) up to which the distortion can be inverted.

    >>> round(largest_radius(FullOpenCV(k4=1.0)), 9)  # d(r / (1 + r^2))/dr = 0
    1.0
    """
    p = parameters
    s = np.polynomial.Polynomial([0.0, 1.0])
    upper = np.polynomial.Polynomial([1.0, p.k1, p.k2, p.k3])
    lower = np.polynomial.Polynomial([1.0, p.k4, p.k5, p.k6])
    # With s = r^2: where d(r_d)/dr = 0, or where the denominator is.
    turns = (upper + 2.0 * s * upper.deriv()) * lower - 2.0 * s * upper * lower.deriv()
    smallest = np.inf
    for polynomial in (turns, lower):
        # In 1/s, so that nothing is divided by a coefficient that may be tiny.
        roots = np.roots(polynomial.coef)
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots.real)) & (roots.real > 1e-12)]
        if real.size:
            smallest = min(smallest, 1.0 / float(np.sqrt(real.max())))
    return smallest
