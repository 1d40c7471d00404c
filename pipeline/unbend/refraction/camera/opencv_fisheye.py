"""The equidistant fisheye lens with OpenCV's four coefficients, for numbers and for columns.

With (u, v) ideal image coordinates, r = sqrt(u^2 + v^2) = tan theta (Kannala and Brandt 2006),

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),
    u_d = u theta_d / r,   v_d = v theta_d / r.

COLMAP's OPENCV_FISHEYE; RADIAL_FISHEYE has k1 and k2, SIMPLE_RADIAL_FISHEYE k1. Rays at 90 degrees
from the optical axis and beyond have no ideal image coordinates.
"""

from typing import Any, NamedTuple

import numpy as np

from unbend.refraction.camera.brown_conrady import first_root

# Added to r^2, so that theta_d / r is 1 on the axis and not 0 / 0.
_TINY = 1e-300

LARGEST_ANGLE_RAD = np.radians(89.5)
"""Rays farther from the optical axis than this are not covered: their tangent is not precise."""


class OpenCVFisheye(NamedTuple):
    """Coefficients in OpenCV's and COLMAP's order."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0


Parameters = OpenCVFisheye

MODELS = {
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", *OpenCVFisheye._fields),
}
"""Names and parameters of camera models with this distortion, in COLMAP's order; the last has all.
"""


def distort(u: Any, v: Any, parameters: OpenCVFisheye) -> tuple[Any, Any]:
    """Distorted image coordinates of ideal ones, both in units of the principal distance.

    >>> [round(float(c), 9) for c in distort(1.0, 0.0, OpenCVFisheye())]  # 45 degrees
    [0.785398163, 0.0]
    """
    p = parameters
    r = np.sqrt(u * u + v * v + _TINY)
    theta = np.arctan(r)
    t2 = theta * theta
    theta_d = theta * (1.0 + t2 * (p.k1 + t2 * (p.k2 + t2 * (p.k3 + t2 * p.k4))))
    quotient = theta_d / r
    return u * quotient, v * quotient


def slopes(u: Any, v: Any, parameters: OpenCVFisheye) -> tuple[Any, Any, Any]:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`."""
    p = parameters
    r2 = u * u + v * v + _TINY
    r = np.sqrt(r2)
    theta = np.arctan(r)
    t2 = theta * theta
    theta_d = theta * (1.0 + t2 * (p.k1 + t2 * (p.k2 + t2 * (p.k3 + t2 * p.k4))))
    quotient = theta_d / r
    inner = t2 * (5.0 * p.k2 + t2 * (7.0 * p.k3 + t2 * 9.0 * p.k4))
    theta_d_slope = 1.0 + t2 * (3.0 * p.k1 + inner)  # d(theta_d)/d(theta)
    twice_slope = (theta_d_slope / (1.0 + r2) - quotient) / r2  # 2 d(quotient)/d(r^2)
    uu = quotient + u * u * twice_slope
    uv = u * v * twice_slope
    vv = quotient + v * v * twice_slope
    return uu, uv, vv


def largest_radius(parameters: OpenCVFisheye) -> float:
    """Ideal radius (tan of the field angle) up to which the distortion can be inverted.

    Up to where theta_d turns back, at most to 89.5 degrees.

    >>> round(float(np.degrees(np.arctan(largest_radius(OpenCVFisheye())))), 6)
    89.5
    """
    p = parameters
    # Where d(theta_d)/d(theta) = 0.
    turn = first_root([1.0, 3.0 * p.k1, 5.0 * p.k2, 7.0 * p.k3, 9.0 * p.k4])
    return float(np.tan(min(turn, LARGEST_ANGLE_RAD)))
