"""The formula of the Manual of Photogrammetry, as many programs carry it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pipeline.atmosphere.profile import Profile
from pipeline.refraction.published.column import Array, finite, times_tangent

TOP_M = 80_500.0


def manual(
    profile: Profile, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike, radius: ArrayLike
) -> Array:
    """R_c [rad] by 2410 H / (H^2 - 6 H + 250) - (h / H) 2410 h / (h^2 - 6 h + 250) urad.

    Arguments as in `pipeline.refraction.published`; ``profile`` is not looked at, H and h are km
    above sea level. NaN for a camera at or below sea level or above 80.5 km.

    A fit to Bertram's table, good above 6 km: against the spherical form at 45 degrees in ARDC 1959
    it reads 25, 22, 13 and 2 % low at 0.5, 1, 3 and 6 km, 5 % high at 10 km, 0 % at 20 km. A
    raised ground is scaled as in Bertram's Eq. 9, and with the same fault: camera and ground at 10
    and 2 km read 33 % high, at 3 and 1 km 20 %. Source: Manual of Photogrammetry (4th edition).

    >>> float((manual(None, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(2))
    57.84
    """
    h_c, h_g, zeta_c = finite(h_c, h_g, zeta_c)
    usable = (h_c > 0.0) & (h_c <= TOP_M)
    H, h = np.where(usable, h_c, np.nan) / 1e3, h_g / 1e3
    r = 2410.0 * H / (H * H - 6.0 * H + 250.0)
    r = (r - 2410.0 * h / (h * h - 6.0 * h + 250.0) * (h / H)) * 1e-6
    return times_tangent(r, h_c, h_g, zeta_c)
