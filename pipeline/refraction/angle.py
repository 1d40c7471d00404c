"""One refraction angle through a standard atmosphere, in the units people use."""

from __future__ import annotations

import math
from typing import Any

from pipeline.atmosphere import standard_atmosphere
from pipeline.errors import PhysicsError
from pipeline.refraction.image import ground_displacement
from pipeline.refraction.ray import angle_and_status
from pipeline.refraction.status import FAR_BRANCH, STATUS_NAMES
from pipeline.units import ARCSEC, DEGREE, MICRORADIAN


def one_angle(
    atmosphere: str,
    index: str,
    camera_height: float,
    ground_height: float,
    nadir_angle: float,
    radius: float,
    method: str,
    distance: float | None = None,
) -> dict[str, Any]:
    """What ``unbend angle`` prints.

    Heights [m above sea level], nadir angle [degrees], radius of the earth [m]; the angle comes in
    arcsec, microradians and metres on the ground. ``distance`` [m] is the slant range, which
    decides where the ray meets the ground's height twice; published methods know the near crossing
    only. ``status`` is ``ok``, ``beyond_grazing`` (twice, and the near crossing taken for want of a
    distance) or ``far_branch``. ``ground_m`` is None where the straight apparent ray passes over
    the horizon and only the bent one lands.

    >>> round(one_angle("us1976", "gyer", 1e4, 0.0, 75.0, 6371e3, "spherical")["r_c_arcsec"], 6)
    61.778543
    """
    if distance is not None and not 0.0 < distance < math.inf:
        raise PhysicsError(
            "ANGLE-DISTANCE",
            f"a slant range of {distance:g} m is none",
            remedy="give the straight distance from camera to target in metres, or leave it out",
        )
    air = standard_atmosphere(atmosphere, index=index)
    zeta = nadir_angle * DEGREE
    angle, code = angle_and_status(
        air, camera_height, ground_height, zeta, radius, method,
        math.nan if distance is None else distance,
    )  # fmt: skip
    ground = ground_displacement(
        camera_height, ground_height, zeta, angle, radius, far=code == FAR_BRANCH
    )
    return {
        "r_c_arcsec": angle / ARCSEC,
        "r_c_urad": angle / MICRORADIAN,
        "r_c_rad": angle,
        "ground_m": None if math.isnan(ground) else ground,
        "status": STATUS_NAMES[code],
        "atmosphere": atmosphere,
        "index": index,
        "method": method,
        "camera_height_m": camera_height,
        "ground_height_m": ground_height,
        "nadir_angle_deg": nadir_angle,
        "distance_m": distance,
        "radius_m": radius,
    }
