"""Curved rays from the eikonal equation, and the bending of one ray on a sphere.

d/ds (n dr/ds) = grad n (Born and Wolf, Principles of Optics, 7th ed., 3.2 Eq. 2), with n a
function of the height above the ellipsoid and its gradient along the ellipsoid normal. Positions
are differences from the station, in axes parallel to ECEF: nothing large is subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pipeline.errors import PhysicsError
from pipeline.units import WGS84_A, WGS84_F

Array = NDArray[np.float64]

_E2 = WGS84_F * (2.0 - WGS84_F)
_B = WGS84_A * (1.0 - WGS84_F)
_EP2 = _E2 / (1.0 - _E2)


class Medium(Protocol):
    """Anything with an index and its slope over height above sea level [m]."""

    def n(self, h_m: Array) -> Array: ...

    def dn_dh(self, h_m: Array) -> Array: ...


def to_ecef(lat_rad: Array, lon_rad: Array, h_ellipsoid_m: Array) -> Array:
    """Earth-centred coordinates (..., 3) [m] of WGS84 latitude, longitude [rad], height [m]."""
    normal = WGS84_A / np.sqrt(1.0 - _E2 * np.sin(lat_rad) ** 2)
    across = (normal + h_ellipsoid_m) * np.cos(lat_rad)
    return np.stack(
        [
            across * np.cos(lon_rad),
            across * np.sin(lon_rad),
            (normal * (1.0 - _E2) + h_ellipsoid_m) * np.sin(lat_rad),
        ],
        axis=-1,
    )


def height_and_up(ecef_m: Array) -> tuple[Array, Array]:
    """Ellipsoidal height (...) [m] and unit normal (..., 3) of points (..., 3) [m].

    Bowring (1976) with one repetition: 1e-15 rad in latitude below 30 km, 2e-9 m in height.
    """
    x, y, z = ecef_m[..., 0], ecef_m[..., 1], ecef_m[..., 2]
    p = np.hypot(x, y)
    tan_beta = z * WGS84_A / (p * _B)
    for _ in range(2):
        cos_beta = 1.0 / np.sqrt(1.0 + tan_beta**2)
        sin_beta = tan_beta * cos_beta
        tan_lat = (z + _EP2 * _B * sin_beta**3) / (p - _E2 * WGS84_A * cos_beta**3)
        tan_beta = (1.0 - WGS84_F) * tan_lat
    cos_lat = 1.0 / np.sqrt(1.0 + tan_lat**2)
    sin_lat = tan_lat * cos_lat
    height = p * cos_lat + z * sin_lat - WGS84_A * np.sqrt(1.0 - _E2 * sin_lat**2)
    return height, np.stack([cos_lat * x / p, cos_lat * y / p, sin_lat], axis=-1)


def enu_axes(lat_rad: Array, lon_rad: Array) -> Array:
    """Rows east, north, up (..., 3, 3) of the local frame: v_enu = axes @ v_ecef."""
    slat, clat, slon, clon = np.sin(lat_rad), np.cos(lat_rad), np.sin(lon_rad), np.cos(lon_rad)
    east = np.stack([-slon, clon, np.zeros_like(slon)], axis=-1)
    north = np.stack([-slat * clon, -slat * slon, clat], axis=-1)
    return np.stack([east, north, np.stack([clat * clon, clat * slon, slat], axis=-1)], axis=-2)


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def ray_ends(
    air: Medium, start_m: Array, direction: Array, length_m: Array, undulation_m: float
) -> Array:
    """Where rays end, relative to their start: (n, 3) [m] in ECEF axes.

    start_m (n, 3) ECEF [m], direction (n, 3) unit vectors, length_m (n,) arc length [m]. All rays
    are one system over the scaled arc sigma = s / length; DOP853, rtol 1e-12, about 1e-11 rad.
    """
    count = start_m.shape[0]
    n_start = air.n(height_and_up(start_m)[0] - undulation_m)

    def slope(_: float, state: Array) -> Array:
        offset, ray = state.reshape(2, count, 3)
        height, up = height_and_up(start_m + offset)
        msl = height - undulation_m
        dr = ray * (length_m / air.n(msl))[:, None]
        dv = up * (air.dn_dh(msl) * length_m)[:, None]
        return np.concatenate([dr.ravel(), dv.ravel()])

    first = np.concatenate([np.zeros(3 * count), (direction * n_start[:, None]).ravel()])
    solution = solve_ivp(
        slope,
        (0.0, 1.0),
        first,
        method="DOP853",
        rtol=1e-12,
        atol=np.repeat([1e-9, 1e-15], 3 * count),
        t_eval=[1.0],
    )
    if not solution.success:
        raise PhysicsError("SIM-ODE", f"the rays did not integrate: {solution.message}")
    return np.asarray(solution.y[: 3 * count, -1].reshape(count, 3))


@dataclass(frozen=True, eq=False)
class Rays:
    """Apparent and straight unit directions (n, 3), ECEF axes, and R_c (n,) [rad]."""

    apparent: Array
    straight: Array
    r_c_rad: Array
    miss_m: Array


def shoot(air: Medium, camera_m: Array, ground_m: Array, undulation_m: float) -> Rays:
    """The direction in which each camera sees its ground point, by shooting.

    camera_m, ground_m (n, 3) ECEF [m]. The bending is 1e-5 of the ray, so each repetition of the
    fixed point (aim beside the target by the last miss) gains five digits; it stops below 1e-9 m.
    """
    chord = ground_m - camera_m
    aim = chord.copy()
    miss = np.full(len(chord), np.inf)
    for _ in range(6):
        length = np.linalg.norm(aim, axis=-1)
        error = chord - ray_ends(air, camera_m, unit(aim), length, undulation_m)
        miss = np.linalg.norm(error, axis=-1)
        if float(miss.max(initial=0.0)) < 1e-8:
            break
        aim = aim + error
    apparent, straight = unit(aim), unit(chord)
    cross = np.linalg.norm(np.cross(apparent, straight), axis=-1)
    angle = np.arctan2(cross, np.sum(apparent * straight, axis=-1))
    up = height_and_up(camera_m)[1]
    lifted = np.sum((apparent - straight) * up, axis=-1) >= 0.0
    return Rays(apparent, straight, np.where(lifted, angle, -angle), miss)


def ray_angle_sphere(
    n_of_h: Callable[[float], float],
    h_c: float,
    h_g: float,
    zeta_c: float,
    radius: float,
    breaks: Sequence[float] = (),
) -> float:
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
    r_c, r_g = radius + h_c, radius + h_g
    n_c, sin_c, cos_c = n_of_h(h_c), np.sin(zeta_c), np.cos(zeta_c)
    sign = 1.0 if cos_c >= 0.0 else -1.0

    def straight_cosine(h: float) -> float:
        square = (r_c * cos_c) ** 2 - (h_c - h) * (r_c + radius + h)
        if square <= 0.0:
            raise PhysicsError(
                "SIM-GRAZING", f"the ray at {np.degrees(zeta_c):.4f} deg misses height {h:.1f} m"
            )
        return float(sign * np.sqrt(square) / (radius + h))

    def slope(h: float, _: Array) -> list[float]:
        r, n = radius + h, n_of_h(h)
        sin_s, cos_s = r_c * sin_c / r, straight_cosine(h)
        sin_z = sin_s * n_c / n
        lift = sin_s * (n_c - n) / n  # sin zeta - sin zeta_s
        square = cos_s**2 - lift * (sin_z + sin_s)
        if square <= 0.0:
            raise PhysicsError("SIM-GRAZING", f"the curved ray turns before {h:.1f} m")
        cos_z = sign * float(np.sqrt(square))
        # tan zeta - tan zeta_s = sin(d) / (cos zeta cos zeta_s) with d = zeta - zeta_s, and
        # sin(d) = (sin zeta - sin zeta_s) (1 + cos d) / (cos zeta + cos zeta_s).
        turned = lift * (1.0 + cos_z * cos_s + sin_z * sin_s) / (cos_z + cos_s)
        return [-turned / (cos_z * cos_s) / r]

    q = straight_cosine(h_g) * r_g
    slope(h_g, np.empty(0))  # a ray that never comes down to h_g is refused before any work
    distance = (h_c - h_g) * (r_c + r_g) / (r_c * cos_c + q)
    # 1e-16 rad at the camera: below the rounding of n, where smaller steps only follow noise.
    floor = 1e-16 * abs(distance) / r_g
    low, high = min(h_c, h_g), max(h_c, h_g)
    inner = sorted((b for b in set(breaks) if low < b < high), reverse=bool(h_c > h_g))
    eps = 0.0
    for start, end in pairwise([h_c, *inner, h_g]):
        solution = solve_ivp(
            slope, (start, end), [0.0], method="DOP853", rtol=1e-13, atol=floor, t_eval=[end]
        )
        if not solution.success:
            raise PhysicsError("SIM-ODE", f"the ray did not integrate: {solution.message}")
        eps += float(solution.y[0, -1])
    theta = float(np.arctan2(r_c * sin_c, q)) - zeta_c + 0.5 * eps
    step = 2.0 * r_g * float(np.sin(0.5 * eps))
    return float(
        -np.arctan2(step * np.cos(zeta_c + theta), distance + step * np.sin(zeta_c + theta))
    )
