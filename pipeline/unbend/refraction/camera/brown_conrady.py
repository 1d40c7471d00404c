"""The distortion of a lens by Brown and Conrady, in OpenCV's form, for numbers and for columns.

With (u, v) ideal image coordinates in units of the principal distance and r^2 = u^2 + v^2,

    u_d = u (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 u v + p2 (r^2 + 2 u^2),
    v_d = v (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 v^2) + 2 p2 u v.
"""

from typing import Any, NamedTuple

import numpy as np


class BrownConrady(NamedTuple):
    """Coefficients as OpenCV defines them."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


Parameters = BrownConrady

MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "BROWN": ("fx", "fy", "cx", "cy", *BrownConrady._fields),
}
"""Names and parameters of camera models with this distortion, in COLMAP's order.

BROWN, which COLMAP does not have, is the last and has all parameters.
"""


def distort(u: Any, v: Any, parameters: BrownConrady) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones, both in units of the principal distance.

    >>> [round(c, 9) for c in distort(0.5, 0.0, BrownConrady(k1=-0.1, p2=0.001))]
    [0.48825, 0.0]
    """
    k1 = parameters.k1
    k2 = parameters.k2
    k3 = parameters.k3
    p1 = parameters.p1
    p2 = parameters.p2
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u_d = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
    v_d = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
    return u_d, v_d


def slopes(u: Any, v: Any, parameters: BrownConrady) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`."""
    k1 = parameters.k1
    k2 = parameters.k2
    k3 = parameters.k3
    p1 = parameters.p1
    p2 = parameters.p2
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    twice_slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))  # 2 d(radial)/d(r^2)
    uu = radial + u * u * twice_slope + 2.0 * p1 * v + 6.0 * p2 * u
    uv = u * v * twice_slope + 2.0 * p1 * u + 2.0 * p2 * v
    vv = radial + v * v * twice_slope + 6.0 * p1 * v + 2.0 * p2 * u
    return uu, uv, vv


def largest_radius(parameters: BrownConrady) -> float:
    """Ideal radius (tan of the field angle) up to which the distortion can be inverted.

    Where the radial distortion turns back; infinite where it never does.

    >>> round(largest_radius(BrownConrady(k1=-1.0 / 3.0)), 9)  # d(r - r^3 / 3)/dr = 0
    1.0
    """
    p = parameters
    slope_of_r_d = [1.0, 3.0 * p.k1, 5.0 * p.k2, 7.0 * p.k3]  # d(r_d)/dr in powers of r^2
    return first_root(slope_of_r_d)


def first_root(coefficients: Any) -> float:
    """The smallest positive r at which a polynomial in r^2 is zero; infinity without any.

    ``coefficients`` are numbers, lowest power first, or a numpy polynomial.

    >>> first_root([1.0, -0.25])
    2.0
    """
    # `np.roots` takes the highest power first. With the lowest first the roots are 1/r^2, and no
    # coefficient is divided by that of the highest power, which may be tiny.
    inverse_squares = np.roots(np.asarray(getattr(coefficients, "coef", coefficients)))
    is_real = np.abs(inverse_squares.imag) < 1e-9 * np.abs(inverse_squares.real)
    is_finite_radius = inverse_squares.real > 1e-12  # r below a million
    positive = inverse_squares.real[is_real & is_finite_radius]
    if positive.size == 0:
        return np.inf
    return float(1.0 / np.sqrt(positive.max()))
