"""The bending of a single ray in layers of a sphere: slow, and independent of the package."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class RayOnSphere:
    """A ray from a camera at radius ``r_c`` in layers of a sphere; ``sign`` -1 where it rises."""

    n_of_h: Callable[[float], float]
    radius: float
    h_c: float
    zeta_c: float
    n_c: float
    sign: float

    def straight_cosine(self, h):
        """Cosine of the nadir angle at a height, of the straight line."""
        r_c = self.radius + self.h_c
        cos_c = np.cos(self.zeta_c)
        square = (r_c * cos_c) ** 2 - (self.h_c - h) * (r_c + self.radius + h)
        if square <= 0.0:
            degrees = np.degrees(self.zeta_c)
            raise ValueError(f"the ray at {degrees:.4f} deg misses height {h:.1f} m")
        return float(self.sign * np.sqrt(square) / (self.radius + h))

    def slope(self, h, _):
        """d(eps)/dh of eps = theta_ray - theta_straight."""
        r = self.radius + h
        n = self.n_of_h(h)
        sin_s = (self.radius + self.h_c) * np.sin(self.zeta_c) / r
        cos_s = self.straight_cosine(h)
        sin_z = sin_s * self.n_c / n
        lift = sin_s * (self.n_c - n) / n  # sin zeta - sin zeta_s
        square = cos_s**2 - lift * (sin_z + sin_s)
        if square <= 0.0:
            raise ValueError(f"the curved ray turns before {h:.1f} m")
        cos_z = self.sign * np.sqrt(square)
        # tan zeta - tan zeta_s = sin(d) / (cos zeta cos zeta_s) with d = zeta - zeta_s, and
        # sin(d) = (sin zeta - sin zeta_s) (1 + cos d) / (cos zeta + cos zeta_s).
        turned = lift * (1.0 + cos_z * cos_s + sin_z * sin_s) / (cos_z + cos_s)
        return [-turned / (cos_z * cos_s) / r]


def ray_angle_sphere(n_of_h, h_c, h_g, zeta_c, radius, *, breaks=()):
    """Refraction angle R_c [rad] of one ray in a spherically stratified atmosphere.

    n_of_h: refractive index at a height [m]; h_c, h_g: heights of camera and ground [m]; zeta_c:
    apparent nadir angle [rad], over 90 deg for a target above; radius of the sphere [m]; breaks:
    heights of kinks of n [m]. The state is theta_ray - theta_straight, so nothing cancels:
    d(eps)/dh = -(tan zeta - tan zeta_s) / r (Gyer 1996, Eq. 2) with zeta from Snell's law (Eq. 1);
    the angle at the camera from the triangle camera - straight end - ray end. DOP853 at rtol
    1e-13; about 1e-9 arcsec, limited by the rounding of n (2e-16). Not through a grazing point.

    >>> ray_angle_sphere(lambda h: 1.0003, 3000.0, 0.0, 0.8, 6371000.0)
    -0.0
    """
    r_c = radius + h_c
    r_g = radius + h_g
    sin_c = np.sin(zeta_c)
    cos_c = np.cos(zeta_c)
    ray = RayOnSphere(
        n_of_h,
        radius,
        h_c,
        zeta_c,
        n_c=n_of_h(h_c),
        sign=np.copysign(1.0, cos_c),
    )
    q = ray.straight_cosine(h_g) * r_g
    ray.slope(h_g, np.empty(0))  # a ray that never comes down to h_g is refused before any work
    distance = (h_c - h_g) * (r_c + r_g) / (r_c * cos_c + q)
    # 1e-16 rad at the camera: below the rounding of n, where smaller steps only follow noise.
    floor = 1e-16 * abs(distance) / r_g
    low = min(h_c, h_g)
    high = max(h_c, h_g)
    inner = sorted(b for b in set(breaks) if low < b < high)
    if h_c > h_g:
        inner.reverse()
    eps = 0.0
    for start, end in pairwise([h_c, *inner, h_g]):
        solution = solve_ivp(
            ray.slope,
            (start, end),
            [0.0],
            method="DOP853",
            rtol=1e-13,
            atol=floor,
            t_eval=[end],
        )
        if not solution.success:
            raise ValueError(f"the ray did not integrate: {solution.message}")
        eps += solution.y[0, -1]
    direction = np.arctan2(r_c * sin_c, q) + 0.5 * eps
    step = 2.0 * r_g * np.sin(0.5 * eps)
    across = step * np.cos(direction)
    along = distance + step * np.sin(direction)
    return float(-np.arctan2(across, along))
