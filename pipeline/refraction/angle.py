"""One refraction angle through a standard atmosphere, in the units people use."""

from __future__ import annotations

from typing import Any

from pipeline.atmosphere import standard_atmosphere
from pipeline.refraction.image import ground_displacement
from pipeline.refraction.ray import refraction_angle
from pipeline.units import ARCSEC, DEGREE, MICRORADIAN


def one_angle(
    atmosphere: str,
    index: str,
    camera_height: float,
    ground_height: float,
    nadir_angle: float,
    radius: float,
    method: str,
) -> dict[str, Any]:
    """What ``unbend angle`` prints.

    Heights [m above sea level], nadir angle [degrees], radius of the earth [m]; the angle comes in
    arcsec, microradians and metres on the ground.

    >>> round(one_angle("us1976", "gyer", 1e4, 0.0, 75.0, 6371e3, "spherical")["r_c_arcsec"], 6)
    61.778543
    """
    air = standard_atmosphere(atmosphere, index=index)
    zeta = nadir_angle * DEGREE
    r_c = refraction_angle(air, camera_height, ground_height, zeta, radius, method)
    return {
        "r_c_arcsec": r_c / ARCSEC,
        "r_c_urad": r_c / MICRORADIAN,
        "r_c_rad": r_c,
        "ground_m": ground_displacement(camera_height, ground_height, zeta, r_c, radius),
        "atmosphere": atmosphere,
        "index": index,
        "method": method,
        "camera_height_m": camera_height,
        "ground_height_m": ground_height,
        "nadir_angle_deg": nadir_angle,
        "radius_m": radius,
    }
