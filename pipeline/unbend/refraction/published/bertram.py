"""Bertram 1966: a trapezoid sum over tabulated densities; and the Manual's fit to his table.

Two things in the paper are wrong, with any number of digits. Eq. 9 is not the refraction of a
raised ground point, because every height is counted from sea level, the lever arms too
(`bertram1966` follows the paper, `bertram1966_from_ground` starts at the point). The curved-earth
term has the wrong sign and is a small part of what the curvature does (`bertram1966_curved`).
"2.340 / Z" above 80.5 km is 2,340 / Z urad with Z in km.
"""

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.profile import Profile
from unbend.refraction.published.column import at_45_degrees, density, finite, times_tangent
from unbend.units import Array

INDEX_PER_DENSITY = 0.000226
"""(n - 1) / rho [m3 kg-1] (Eq. 7)."""

LOWEST_M = -1000.0
"""Lowest ground of `bertram1966` and `manual`, above sea level."""

# Bertram's entries: every 1000 m from 500 m (Table 1), every 3000 m from 20,500 m (Table 2).
NODES_M = np.r_[0.0, 500.0:20_501.0:1000.0, 23_500.0:80_501.0:3000.0]
INTERVAL_M = np.concatenate([np.full(21, 1000.0), np.full(20, 3000.0)])
"""Height between the two densities that give the gradient, for each step between nodes [m]."""


@at_45_degrees
def bertram1966(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] by the trapezoid on tabulated densities (Bertram 1966, Eq. 6, 8 and 9).

    Arguments as in `unbend.refraction.published`. The sum starts at sea level, in steps of 1000 m
    to 20.5 km, of 3000 m to 80.5 km, and nothing is added above. A raised ground is treated by
    Eq. 9, as printed. The profile must reach half an interval beyond either end (82 km at most);
    NaN for a camera at or below sea level and a ground below -1 km.

    With h_g = 0 within 1.4 % of the spherical form at 45 degrees up to 20 km, 2.4 % up to 80 km.
    **With h_g > 0 it reads high**: by 12 % for camera and ground at 10 and 1 km, 25 % at 10 and
    2 km, 34 % at 3 and 1 km; for work take `bertram1966_from_ground`.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("ardc1959")
    >>> r = bertram1966(air, [10500.0, 10500.0], [0.0, 1500.0], 0.7853981633974483, 0.0)
    >>> (r * 1e6).round(1).tolist()
    [80.8, 78.1]
    """
    sea = np.zeros(h_c.shape)
    is_usable = (h_c > 0.0) & (h_g >= LOWEST_M)
    camera = _moment(profile, sea, np.where(is_usable, h_c, np.nan))
    ground = _moment(profile, sea, np.where(is_usable, h_g, np.nan))
    return INDEX_PER_DENSITY * (camera - ground) / np.where(is_usable, h_c, 1.0)


@at_45_degrees
def bertram1966_from_ground(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] by Eq. 6 of Bertram 1966, corrected: the sum starts at the ground.

    Arguments as in `unbend.refraction.published`. Within 1.4 % of the spherical form at 45 degrees
    and up to 20 km, whatever the height of the ground.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("ardc1959")
    >>> r = bertram1966_from_ground(air, 10500.0, 1500.0, 0.7853981633974483, 0.0)
    >>> float((r * 1e6).round(1))
    66.0
    """
    rise = np.where(h_c >= h_g, h_c - h_g, np.nan)
    moment = _moment(profile, h_g, rise)
    return INDEX_PER_DENSITY * moment / np.where(rise > 0.0, rise, 1.0)


def bertram1966_curved(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike,
    *,
    as_printed: bool = False,
) -> Array:
    """R_c [rad] with the term for the curvature of the earth (Bertram 1966, p. 81).

    Arguments as in `unbend.refraction.published`. The sum starts at the ground. The term is
    tan(zeta_c) / (v Z_0 R) times the sum of (Z_0 - Z) Z dv/dZ; ``as_printed`` takes it with the
    sign of the paper, which lowers R_c where the curvature raises it. It keeps the first power of
    X_0 - X and no more: 0.04 arcsec of the 0.7 that the curvature adds at 10 km and 75 degrees. It
    serves comparison only.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("ardc1959")
    >>> r = bertram1966_curved(air, 64500.0, 0.0, 0.7853981633974483, 6378000.0)
    >>> flat = bertram1966_from_ground(air, 64500.0, 0.0, 0.7853981633974483, 6378000.0)
    >>> float((r / flat - 1.0).round(4))
    0.0078
    """
    h_c, h_g, zeta_c, radius = finite(h_c, h_g, zeta_c, radius)
    rise = np.where(h_c >= h_g, h_c - h_g, np.nan)
    second = _moment(profile, h_g, rise, curvature=True) / radius
    term = INDEX_PER_DENSITY * second / np.where(rise > 0.0, rise, 1.0)
    if as_printed:
        term = -term
    flat = bertram1966_from_ground(profile, h_c, h_g, zeta_c, radius)
    return flat + times_tangent(term, h_c, h_g, zeta_c)


def _moment(profile: Profile, origin: Array, rise: Array, *, curvature: bool = False) -> Array:
    """Sum of -x drho/dz dz over heights x above ``origin`` [m] from 0 to ``rise`` [m], in kg m-2.

    A trapezoid between the entries of `NODES_M`. The last, partial step ends at ``rise``, so that
    the sum is continuous in ``rise`` and is Bertram's at his entries. With ``curvature`` each term
    has the further factor (rise - x) [m].
    """
    total = np.zeros(origin.shape)
    has_heights = np.isfinite(origin) & np.isfinite(rise)
    steps = zip(NODES_M[:-1], NODES_M[1:], INTERVAL_M.tolist(), strict=True)
    for low, high, interval in steps:
        is_reached = rise > low
        if low == 0.0:
            is_reached |= rise < 0.0  # below the origin, one step of the same rule
        in_step = has_heights & is_reached
        if not in_step.any():
            break
        end = np.minimum(rise[in_step], high)
        ends_of_step = [end]
        if low > 0.0:  # else x = 0 there, and the term is zero
            ends_of_step.insert(0, np.full(end.shape, low))
        for x in ends_of_step:
            gradient = _density_gradient(profile, origin[in_step] + x, interval)
            product = x * gradient
            part = 0.5 * (end - low) * product
            if curvature:
                part = part * (rise[in_step] - x)
            total[in_step] += part
    return np.where(has_heights, total, np.nan)


def _density_gradient(profile: Profile, z: Array, interval: float) -> Array:
    """-drho/dz [kg m-4] from the densities half an interval [m] below and above heights ``z``."""
    half = 0.5 * interval
    return (density(profile, z - half) - density(profile, z + half)) / interval


MANUAL_TOP_M = 80_500.0
"""Highest camera of Bertram's table, to which the Manual's formula is fitted."""


@at_45_degrees
def manual(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] by the formula of the Manual of Photogrammetry, of camera H and ground h [km].

    R = 2410 H / (H^2 - 6 H + 250) - (h / H) 2410 h / (h^2 - 6 h + 250) urad at 45 degrees, with
    heights above sea level; at other nadir angles times the tangent. Arguments as in
    `unbend.refraction.published`; ``profile`` is not used. NaN for a camera at or below sea level
    or above 80.5 km, and for a ground below -1 km.

    A fit to Bertram's table, good above 6 km: against the spherical form at 45 degrees in ARDC 1959
    it reads 25, 22, 13 and 2 % low at 0.5, 1, 3 and 6 km, 5 % high at 10 km, 0 % at 20 km. A
    raised ground is scaled as in Bertram's Eq. 9, and with the same fault: camera and ground at 10
    and 2 km read 33 % high, at 3 and 1 km 20 %. Source: Manual of Photogrammetry (4th edition).

    >>> float((manual(None, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(2))
    57.84
    """
    is_usable = (h_c > 0.0) & (h_c <= MANUAL_TOP_M) & (h_g >= LOWEST_M)
    H = np.where(is_usable, h_c, np.nan) / 1e3
    h = h_g / 1e3
    camera = 2410.0 * H / (H * H - 6.0 * H + 250.0)
    ground = 2410.0 * h / (h * h - 6.0 * h + 250.0)
    return np.asarray((camera - ground * (h / H)) * 1e-6)
