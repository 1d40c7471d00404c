"""The plane form in moist air, in closed form but for the mean of e/T."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pipeline.atmosphere.profile import Profile
from pipeline.refraction.published.column import Array, finite, mean, times_tangent
from pipeline.units import HECTOPASCAL

# (n - 1) / (p / T) of dry air and the loss by e / T [urad K hPa-1]: Gyer 1996, Eq. 13, and the
# same two numbers for Ciddor 1996 at 0.55 um.
COEFFICIENTS = {"gyer": (78.831, 11.036), "ciddor": (79.026, 11.27)}


def _wetness(profile: Profile, h: Array) -> Array:
    """e / T [hPa K-1]."""
    return np.asarray(profile.vapour_pressure(h) / HECTOPASCAL / profile.temperature(h))


def plane_moist(
    profile: Profile, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike, radius: ArrayLike
) -> Array:
    """R_c [rad] of moist air by hydrostatics, without an integral over the dry part.

    R = k ((p_g - p_c) / (gamma dH) - p_c / Tv_c) + (0.378 k - w) (mean(e/T) - e_c / T_c) with
    gamma = G M0 / R* and dH the geopotential height difference: since dp = -gamma p / Tv dH, the
    mean of p / Tv needs only the pressures at both ends.

    Arguments as in `pipeline.refraction.published`. k and w are those of
    0.589 um for Gyer's index, else of 0.55 um. In dry air and below 60 degrees within 0.3 % of the
    spherical form up to 12 km, most of it the curvature of the earth.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> float((plane_moist(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(2))
    58.91
    """
    h_c, h_g, zeta_c = finite(h_c, h_g, zeta_c)
    k, w = COEFFICIENTS[profile.index.name]
    p_c = profile.pressure(h_c)
    rise = profile.gravity.geopotential_height(h_c) - profile.gravity.geopotential_height(h_g)
    rise = np.where(rise > 0.0, rise, np.nan)
    dry = (profile.pressure(h_g) - p_c) / (profile.constant * rise)
    dry = (dry - p_c / profile.virtual_temperature(h_c)) / HECTOPASCAL
    wet = mean(profile, _wetness, h_g, h_c) - _wetness(profile, h_c)
    column = np.where(h_c == h_g, 0.0, k * dry + (0.378 * k - w) * wet)
    return times_tangent(column * 1e-6, h_c, h_g, zeta_c)
