"""Gyer 1996: the spherical form in steps of a kilometre, the plane form, and that of moist air.

Eq. 24 as printed has three misprints; from Eq. 22 its second term carries (n - n_c)^2 (n + n_c)^2
over n_c^4 cos^2 zeta_c, its third (n - n_c)^3 (n + n_c)^3 over n_c^6 cos^4 zeta_c with the sign of
the first. Eq. 32 is printed with jumbled indices; it means Eq. 31 over all intervals.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.profile import Profile
from unbend.refraction import messages
from unbend.refraction.published import column
from unbend.refraction.published.column import at_45_degrees, downward, finite, times_tangent
from unbend.units import HECTOPASCAL, Array, Rows

STEP_M = 1000.0

# Eq. 33-35 with these thin shells in the two intervals at P_90 give 90 % of Table 6 to the printed
# arcsecond; one shell a metre is 0.5 arcsec low, one a kilometre 18 arcsec.
_SHELLS_PER_INTERVAL = 5000
_SHELL_INTERVALS = 2
_RAYS_AT_ONCE = 64

# By how much of k a ray that grazes the ground may miss it through rounding.
_ROUNDING = 1e-12


# (n - 1) / (p / T) of dry air and the loss by e / T [urad K hPa-1]: Gyer 1996, Eq. 13, and the
# same two numbers for Ciddor 1996 at 0.55 um.
MOIST_COEFFICIENTS = {"gyer": (78.831, 11.036), "ciddor": (79.026, 11.27)}


def _squared(profile: Profile, h: Array, power: int = 1) -> Array:
    """Powers of n^2 - 1."""
    n_less_1 = profile.refractivity(h)
    return np.asarray((n_less_1 * (2.0 + n_less_1)) ** power)


_POWERS = (_squared, partial(_squared, power=2), partial(_squared, power=3))


@at_45_degrees
def plane_first_term(
    profile: Profile, h_c: Array, h_g: Array, *, step: float | None = None
) -> Array:
    """R_c [rad] in flat layers, first term (Gyer 1996, Eq. 24): the plane form of his Table 5.

    Arguments as in `unbend.refraction.published`.
    The integral is exact, or with ``step`` [m] the sum of Eq. 31, which reproduces Table 5 within
    0.31 arcsec. Meant for zeta_c up to 60 degrees and aircraft heights, where it is 0.1 arcsec
    short of the spherical form at 10 km; at 75 degrees it is 0.7, at 85 degrees 25 arcsec short.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("ardc1959", index="gyer")
    >>> float((plane_first_term(air, 10000.0, 0.0, 60 * DEGREE, 6378000.0) / ARCSEC).round(2))
    28.33
    """
    w_c = _squared(profile, h_c)
    if step is None:
        excess = column.mean(profile, _squared, h_g, h_c) - w_c
    else:
        count, width = _intervals(profile, h_c, h_g, step)

        def above_w_c(h: Array, used: Rows) -> Array:
            return _squared(profile, h) - w_c.ravel()[used]

        total = _eq_31(above_w_c, h_g, width, np.zeros(h_g.shape), count)
        excess = np.where(h_c > h_g, total / np.where(h_c > h_g, h_c - h_g, 1.0), 0.0)
    return 0.5 * excess / (1.0 + w_c)


def plane(
    profile: Profile, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike, radius: ArrayLike
) -> Array:
    """R_c [rad] in flat layers with the two further terms (Gyer 1996, Eq. 24, misprints mended).

    Arguments as in `unbend.refraction.published`.
    The further terms are 0.02 arcsec at 60 degrees and 10 km. Beyond that the first term alone errs
    less, by chance: the further ones lower R_c while the curvature of the earth raises it.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("ardc1959", index="gyer")
    >>> float((plane(air, 10000.0, 0.0, 60 * DEGREE, 6378000.0) / ARCSEC).round(2))
    28.31
    """
    h_c, h_g, zeta_c = finite(h_c, h_g, zeta_c)
    w_c = _squared(profile, h_c)
    m_1, m_2, m_3 = (column.mean(profile, power, h_g, h_c) for power in _POWERS)
    n2_c = 1.0 + w_c
    u_1 = (m_1 - w_c) / n2_c
    u_2 = (m_2 - w_c * (2.0 * m_1 - w_c)) / n2_c**2
    u_3 = (m_3 - w_c * (3.0 * m_2 - w_c * (3.0 * m_1 - w_c))) / n2_c**3
    usable = downward(h_c, h_g, zeta_c)
    cos2 = np.cos(np.where(usable, zeta_c, 0.0)) ** 2
    r = 0.5 * u_1 - 0.375 * u_2 / cos2 + 0.3125 * u_3 / cos2**2
    return times_tangent(r, h_c, h_g, zeta_c)


def _wetness(profile: Profile, h: Array) -> Array:
    """e / T [hPa K-1]."""
    return np.asarray(profile.vapour_pressure(h) / HECTOPASCAL / profile.temperature(h))


@at_45_degrees
def plane_moist(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] of moist air by hydrostatics, without an integral over the dry part.

    Arguments as in `unbend.refraction.published`.
    R = k ((p_g - p_c) / (gamma dH) - p_c / Tv_c) + (0.378 k - w) (mean(e/T) - e_c / T_c) with
    gamma = G M0 / R* and dH the geopotential height difference: since dp = -gamma p / Tv dH, the
    mean of p / Tv needs only the pressures at both ends.

    k and w are those of 0.589 um for Gyer's index, else of 0.55 um. In dry air and below 60 degrees
    within 0.3 % of the spherical form up to 12 km, most of it the curvature of the earth.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> float((plane_moist(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(2))
    58.91
    """
    k, w = MOIST_COEFFICIENTS[profile.index.name]
    p_c = profile.pressure(h_c)
    rise = profile.gravity.geopotential_height(h_c) - profile.gravity.geopotential_height(h_g)
    rise = np.where(rise > 0.0, rise, np.nan)
    dry = (profile.pressure(h_g) - p_c) / (profile.constant * rise)
    dry = (dry - p_c / profile.virtual_temperature(h_c)) / HECTOPASCAL
    wet = column.mean(profile, _wetness, h_g, h_c) - _wetness(profile, h_c)
    return np.where(h_c == h_g, 0.0, k * dry + (0.378 * k - w) * wet) * 1e-6


def gyer1996(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike,
    *,
    step: float = STEP_M,
) -> Array:
    """R_c [rad] through spherical layers as Gyer computed it (1996, Eq. 1, 11, 12, 31, 33-35).

    Arguments as in `unbend.refraction.published`.
    ``step`` [m] is the widest interval of Eq. 31, whose equal intervals fill the height difference.
    The profile must reach one interval beyond either end. Where the interval below the ground holds
    P_90, thin shells (Eq. 33-35) take the place of Eq. 31 in the two lowest intervals, as for
    zeta_g = 90 degrees; NaN for rays that miss the ground.

    Reproduces his Tables 3 and 4 within 0.015 arcsec. Against the converged integral the step
    costs 0.035 arcsec up to 80 degrees and up to 7.8 arcsec at 85 degrees and 25 km; Eq. 11
    cancels to 1e-6 of R_c at 120 m above ground, to 1 % at 1 m.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("ardc1959", index="gyer")
    >>> float((gyer1996(air, 10000.0, 0.0, 75 * DEGREE, 6378000.0) / ARCSEC).round(2))
    61.78
    """
    h_c, h_g, zeta_c, radius = finite(h_c, h_g, zeta_c, radius)
    usable = downward(h_c, h_g, zeta_c)
    r_c = np.full(usable.shape, np.nan)
    rays = h_c[usable], h_g[usable], zeta_c[usable], radius[usable]
    theta = subtended_angle(profile, *rays, step=step)
    # Eq. 11 as printed.
    r_camera, r_ground = radius[usable] + h_c[usable], radius[usable] + h_g[usable]
    excess, tangent = r_camera / r_ground - np.cos(theta), np.tan(zeta_c[usable])
    sine = np.sin(theta)
    with np.errstate(invalid="ignore", divide="ignore"):
        r_c[usable] = np.arctan((tangent * excess - sine) / (tangent * sine + excess))
    return np.where(usable & (h_c == h_g), 0.0, r_c)


def _intervals(profile: Profile, h_c: Array, h_g: Array, step: float) -> tuple[Array, Array]:
    """Number and width [m] of the equal intervals, none wider than ``step``.

    Zero and NaN where an end lies outside the profile.
    """
    if not step > 0.0:
        raise messages.method_step(step=step)
    # 3000 m reached with a rounding error are three intervals of 1000 m.
    rise = np.where((profile.layer_of(h_c) >= 0) & (profile.layer_of(h_g) >= 0), h_c - h_g, np.nan)
    count = np.maximum(np.ceil(rise / step - 1e-9), 1.0)
    return np.nan_to_num(count), np.asarray(rise / count)


def subtended_angle(
    profile: Profile, h_c: Array, h_g: Array, zeta_c: Array, radius: Array, *, step: float
) -> Array:
    """Angle [rad] that rays subtend at the centre of the earth, as Gyer computed it (Eq. 12).

    All arguments but ``step`` are (n,); elsewhere as for `gyer1996`. NaN for rays that miss the
    ground.
    """

    def n_r(h: Array, r: Array) -> Array:
        return (1.0 + profile.refractivity(h)) * r

    k = n_r(h_c, radius + h_c) * np.sin(zeta_c)
    count, width = _intervals(profile, h_c, h_g, step)
    below = h_g - width
    misses = n_r(h_g, radius + h_g) < k * (1.0 - _ROUNDING)
    grazing = n_r(below, radius + below) <= k
    first = np.where(grazing, np.minimum(count, _SHELL_INTERVALS), 0.0)

    def eq_12(h: Array, used: Rows) -> Array:
        r, k_used = radius[used] + h, k[used]
        product = n_r(h, r)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(k_used / (r * np.sqrt((product - k_used) * (product + k_used))))

    theta = _eq_31(eq_12, h_g, width, first, count)
    count_of_shells = _SHELLS_PER_INTERVAL * _SHELL_INTERVALS
    shells = np.arange(count_of_shells + 1) / count_of_shells
    at = np.flatnonzero(grazing & ~misses)
    for block in np.array_split(at, max(1, math.ceil(at.size / _RAYS_AT_ONCE))):
        # Thin shells in the lowest intervals, Eq. 33-35; in shell i the index is that of its lower
        # end, n_i.
        h = h_g[block, None] + (width[block] * first[block])[:, None] * shells
        r = radius[block, None] + h
        k_n = k[block, None] / (1.0 + profile.refractivity(h[:, :-1]))
        top = np.arccos(np.minimum(k_n / r[:, 1:], 1.0))
        bottom = np.arccos(np.minimum(k_n / r[:, :-1], 1.0))
        theta[block] += np.sum(top - bottom, axis=1)
    return np.where(misses, np.nan, theta)


def _eq_31(
    integrand: Callable[[Array, Rows], Array], h_g: Array, width: Array, first: Array, count: Array
) -> Array:
    """Sum of Eq. 31 over the intervals ``first`` to ``count``, counted from the ground.

    ``integrand`` is given heights and the numbers of the rays they belong to.
    """
    flat = [a.ravel() for a in (h_g, width, first, count)]
    total = 0.0 * flat[1]  # NaN where there are no intervals
    for node in range(-1, int(count.max(initial=0.0)) + 2):
        # A node is left end, right end or outside point of up to four intervals.
        weight = np.zeros(total.shape)
        for interval, share in ((node - 2, -1.0), (node - 1, 13.0), (node, 13.0), (node + 1, -1.0)):
            weight += np.where((interval >= flat[2]) & (interval < flat[3]), share / 24.0, 0.0)
        used = np.flatnonzero(weight)
        value = integrand(flat[0][used] + node * flat[1][used], used)
        total[used] += weight[used] * flat[1][used] * value
    return total.reshape(h_g.shape)
