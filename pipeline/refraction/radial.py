"""Refraction as a function of the nadir angle alone: one table a flying height."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.profile import Profile
from pipeline.errors import PhysicsError
from pipeline.refraction.image import ground_displacement
from pipeline.refraction.published import manual
from pipeline.refraction.ray import DEFAULT_RADIUS_M, bend, rays_by, refraction_angle
from pipeline.units import DEGREE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RadialTable:
    """The refraction of one camera height over one ground; (n,) arrays over the nadir angle.

    ``r_c_rad`` is NaN where ``status`` (codes of `pipeline.refraction.status`) says why;
    ``shift_ground_m`` is the horizontal displacement on the ground, also NaN where the straight
    apparent ray passes over the horizon and only the bent one lands. For an image taken vertically
    ``radius_px`` is the distance from the principal point and ``dr_px`` what to add to it; both
    are NaN without a principal distance. ``k_rad`` is R at 45 degrees, the K of the Manual of
    Photogrammetry, and ``k_manual_rad`` the value of its formula (NaN where it has none).
    """

    h_c_m: float
    h_g_m: float
    nadir_angle_rad: Array
    r_c_rad: Array
    shift_ground_m: Array
    radius_px: Array
    dr_px: Array
    status: NDArray[np.uint8]
    k_rad: float
    k_manual_rad: float


def radial_table(
    profile: Profile,
    h_c: float,
    h_g: float,
    nadir_angle: Array,
    *,
    focal_px: float | None = None,
    radius: float = DEFAULT_RADIUS_M,
    method: str = "spherical",
) -> RadialTable:
    """Refraction over the nadir angle, for one flying height.

    Parameters
    ----------
    profile : the air.
    h_c, h_g : heights of camera and ground above sea level [m], the camera's the greater.
    nadir_angle : (n,) apparent nadir angles [rad], 0 to below 90 degrees.
    focal_px : principal distance [px], for the shift in a vertical image.
    radius : of the sphere [m].
    method : one of `pipeline.refraction.METHODS`.

    Without a window and without distortion. Accuracy is that of the method; the shift is
    f (tan(zeta - R) - tan zeta), without cancellation.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> found = radial_table(air, 6000.0, 0.0, np.array([0.5]), focal_px=20000.0)
    >>> found.dr_px.round(3).tolist(), round(found.k_rad * 1e6, 2)
    ([-0.836], 58.92)
    """
    zeta = np.asarray(nadir_angle, dtype=np.float64)
    if not bool(np.all((zeta >= 0.0) & (zeta < 90.0 * DEGREE))):
        raise PhysicsError(
            "RADIAL-ANGLE",
            "a radial table goes from the nadir to below the horizon, not from "
            f"{zeta.min() / DEGREE:g} to {zeta.max() / DEGREE:g} degrees",
            remedy="choose a largest nadir angle of more than 0 and less than 90 degrees",
        )
    if not h_c > h_g:
        raise PhysicsError(
            "RADIAL-HEIGHTS",
            f"a camera at {h_c:g} m is not above a ground at {h_g:g} m",
            remedy="give both in metres above sea level, the camera's the greater",
        )
    if focal_px is not None and not 0.0 < focal_px < math.inf:
        raise PhysicsError(
            "RADIAL-FOCAL",
            f"a principal distance of {focal_px:g} px is none",
            remedy="give it in pixels",
        )
    k = refraction_angle(profile, h_c, h_g, 45.0 * DEGREE, radius, method)
    r_c, status = bend(rays_by(profile, method), h_c, h_g, np.sin(zeta), np.cos(zeta), radius)
    pairs = zip(zeta.tolist(), r_c.tolist(), strict=True)
    ground = [ground_displacement(h_c, h_g, z, r, radius) for z, r in pairs]
    f = math.nan if focal_px is None else focal_px
    return RadialTable(
        h_c, h_g, zeta, r_c, np.array(ground), f * np.tan(zeta),
        f * np.sin(-r_c) / (np.cos(zeta) * np.cos(zeta - r_c)) + 0.0, status,
        k, float(manual(profile, h_c, h_g, 45.0 * DEGREE, radius)),
    )  # fmt: skip


def angles_to(largest_deg: float, step_deg: float = 5.0) -> Array:
    """Nadir angles [rad] in whole steps from 0 up to, and with, the largest.

    >>> (angles_to(12.0, 5.0) / DEGREE).round(9).tolist()
    [0.0, 5.0, 10.0, 12.0]
    """
    if not (0.0 < largest_deg < 90.0 and step_deg > 0.0):
        raise PhysicsError(
            "RADIAL-ANGLE",
            f"nadir angles to {largest_deg:g} degrees in steps of {step_deg:g} make no table",
            remedy="choose a largest nadir angle of more than 0 and less than 90 degrees",
        )
    steps = np.arange(0.0, largest_deg - 1e-9 * step_deg, step_deg)
    return np.append(steps, largest_deg) * DEGREE
