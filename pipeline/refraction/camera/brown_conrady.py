"""The distortion of a lens: Brown-Conrady in OpenCV's form, for numbers and for columns.

With (u, v) ideal image coordinates in units of the principal distance and r^2 = u^2 + v^2,

    u_d = u (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 u v + p2 (r^2 + 2 u^2),
    v_d = v (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 v^2) + 2 p2 u v.
"""

from __future__ import annotations

from typing import Any


def brown_conrady(
    u: Any, v: Any, k1: float, k2: float, k3: float, p1: float, p2: float
) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones.

    >>> [round(c, 9) for c in brown_conrady(0.5, 0.0, -0.1, 0.0, 0.0, 0.0, 0.001)]
    [0.48825, 0.0]
    """
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u_d = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
    v_d = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
    return u_d, v_d


def brown_conrady_slopes(
    u: Any, v: Any, k1: float, k2: float, k3: float, p1: float, p2: float
) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `brown_conrady`."""
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    uu = radial + u * u * slope + 2.0 * p1 * v + 6.0 * p2 * u
    uv = u * v * slope + 2.0 * p1 * u + 2.0 * p2 * v
    vv = radial + v * v * slope + 6.0 * p1 * v + 2.0 * p2 * u
    return uu, uv, vv
