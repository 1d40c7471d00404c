"""Gyer 1996: the spherical form in steps of a kilometre, the plane form, and that of moist air.

Eq. 24 as printed has three misprints; from Eq. 22 its second term carries (n - n_c)^2 (n + n_c)^2
over n_c^4 cos^2 zeta_c, its third (n - n_c)^3 (n + n_c)^3 over n_c^6 cos^4 zeta_c with the sign of
the first. Eq. 32 is printed with jumbled indices; it means Eq. 31 over all intervals.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

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
_RAYS_AT_ONCE = 64  # in shells: 5 MB an array

_ROUNDING = 1e-12  # share of k by which rounding may make a ray miss the ground that it grazes
_INTERVAL_ROUNDING = 1e-9  # 3000 m with a rounding error are three intervals, not four

# Weights of node j in the integrals over the intervals about it (Eq. 31), by the number of the
# interval less j. Interval j begins at node j. An interval's four nodes are its ends and the next
# node on either side.
_NODE_SHARES = {
    -2: -1.0 / 24.0,
    -1: 13.0 / 24.0,
    0: 13.0 / 24.0,
    1: -1.0 / 24.0,
}


class _MoistCoefficients(NamedTuple):
    """Coefficients of the refractivity of moist air, dry * p / T - loss * e / T, in 1e-6."""

    dry: float  # [K hPa-1]
    loss: float  # [K hPa-1]


MOIST_COEFFICIENTS = {
    "gyer": _MoistCoefficients(dry=78.831, loss=11.036),  # Gyer 1996, Eq. 13
    "ciddor": _MoistCoefficients(dry=79.026, loss=11.27),  # Ciddor 1996 at 0.55 um
}
"""By the name of the formula of the index."""


def _n2_less_1(profile: Profile, h: Array, power: int = 1) -> Array:
    """(n^2 - 1) to the given power, at heights ``h`` [m]."""
    n_less_1 = profile.refractivity(h)
    return np.asarray((n_less_1 * (2.0 + n_less_1)) ** power)


_SECOND_POWER = partial(_n2_less_1, power=2)
_THIRD_POWER = partial(_n2_less_1, power=3)


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
    w_c = _n2_less_1(profile, h_c)
    if step is None:
        excess = column.mean(profile, _n2_less_1, h_g, h_c) - w_c
    else:
        excess = _stepped_mean_excess(profile, h_c, h_g, step)
    return 0.5 * excess / (1.0 + w_c)


def _stepped_mean_excess(profile: Profile, h_c: Array, h_g: Array, step: float) -> Array:
    """Mean of n^2 - 1 between ground and camera less that at the camera, by the sum of Eq. 31.

    ``step`` [m] is the widest interval. Zero where the ground is not below the camera.
    """
    intervals = _intervals(profile, h_c, h_g, step)
    w_c = _n2_less_1(profile, h_c).ravel()

    def above_camera(h: Array, rays: Rows) -> Array:
        return _n2_less_1(profile, h) - w_c[rays]

    from_ground = np.zeros(h_g.shape)
    integral = _eq_31(above_camera, h_g, intervals, from_ground)
    is_thick = h_c > h_g
    thickness = np.where(is_thick, h_c - h_g, 1.0)
    return np.where(is_thick, integral / thickness, 0.0)


def plane(
    profile: Profile, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike, radius: ArrayLike
) -> Array:
    """R_c [rad] in flat layers with the two further terms (Gyer 1996, Eq. 24, misprints corrected).

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
    w_c = _n2_less_1(profile, h_c)
    m_1 = column.mean(profile, _n2_less_1, h_g, h_c)
    m_2 = column.mean(profile, _SECOND_POWER, h_g, h_c)
    m_3 = column.mean(profile, _THIRD_POWER, h_g, h_c)
    n2_c = 1.0 + w_c
    # Means of (n^2 - n_c^2), of its square and of its cube, in units of n_c^2 and its powers.
    u_1 = (m_1 - w_c) / n2_c
    u_2 = (m_2 - w_c * (2.0 * m_1 - w_c)) / n2_c**2
    u_3 = (m_3 - w_c * (3.0 * m_2 - w_c * (3.0 * m_1 - w_c))) / n2_c**3
    is_usable = downward(h_c, h_g, zeta_c)
    cos2 = np.cos(np.where(is_usable, zeta_c, 0.0)) ** 2
    r = 0.5 * u_1 - 0.375 * u_2 / cos2 + 0.3125 * u_3 / cos2**2
    return times_tangent(r, h_c, h_g, zeta_c)


def _wetness(profile: Profile, h: Array) -> Array:
    """e / T [hPa K-1], vapour pressure over temperature, at heights ``h`` [m]."""
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
    p_g = profile.pressure(h_g)
    p_c = profile.pressure(h_c)
    top = profile.gravity.geopotential_height(h_c)
    bottom = profile.gravity.geopotential_height(h_g)
    rise = np.where(top - bottom > 0.0, top - bottom, np.nan)
    mean_dry = (p_g - p_c) / (profile.constant * rise)
    dry = (mean_dry - p_c / profile.virtual_temperature(h_c)) / HECTOPASCAL
    wet = column.mean(profile, _wetness, h_g, h_c) - _wetness(profile, h_c)
    r = k * dry + (0.378 * k - w) * wet
    return np.where(h_c == h_g, 0.0, r) * 1e-6


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
    ``step`` [m] is the largest width of the equal intervals of Eq. 31 between ground and camera.
    The profile must reach one interval beyond either end. P_90 is the point where a ray is level
    (zeta = 90 degrees). If it is within an interval below the ground, the two lowest intervals are
    not by Eq. 31 but by thin shells (Eq. 33-35), which Gyer has for rays that are level at the
    ground (zeta_g = 90 degrees). NaN for rays that miss the ground.

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
    is_usable = downward(h_c, h_g, zeta_c)
    r_c = np.full(is_usable.shape, np.nan)
    r_c[is_usable] = _eq_11(
        profile,
        h_c[is_usable],
        h_g[is_usable],
        zeta_c[is_usable],
        radius[is_usable],
        step=step,
    )
    is_at_ground = is_usable & (h_c == h_g)  # Eq. 11 is 0/0 there
    return np.where(is_at_ground, 0.0, r_c)


def _eq_11(
    profile: Profile, h_c: Array, h_g: Array, zeta_c: Array, radius: Array, *, step: float
) -> Array:
    """R_c [rad] of Gyer 1996, Eq. 11 as printed; arguments as for `subtended_angle`."""
    theta = subtended_angle(profile, h_c, h_g, zeta_c, radius, step=step)
    r_camera = radius + h_c
    r_ground = radius + h_g
    excess = r_camera / r_ground - np.cos(theta)
    sine = np.sin(theta)
    tangent = np.tan(zeta_c)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.arctan((tangent * excess - sine) / (tangent * sine + excess))


@dataclass(frozen=True, eq=False)
class _Intervals:
    """Equal intervals of height between ground and camera of rays (n,)."""

    count: Array  # 0 where an end is outside the profile
    width_m: Array  # NaN where an end is outside the profile


def _intervals(profile: Profile, h_c: Array, h_g: Array, step: float) -> _Intervals:
    """The equal intervals of Eq. 31, at least one and none wider than ``step`` [m]."""
    if not step > 0.0:
        raise messages.method_step(step=step)
    is_inside = (profile.layer_of(h_c) >= 0) & (profile.layer_of(h_g) >= 0)
    rise = np.where(is_inside, h_c - h_g, np.nan)
    steps = np.ceil(rise / step - _INTERVAL_ROUNDING)
    count = np.maximum(steps, 1.0)
    return _Intervals(count=np.nan_to_num(count), width_m=np.asarray(rise / count))


def _n_r(profile: Profile, h: Array, r: Array) -> Array:
    """n r [m] at heights ``h`` [m], which are ``r`` [m] from the centre of the earth."""
    return (1.0 + profile.refractivity(h)) * r


def subtended_angle(
    profile: Profile, h_c: Array, h_g: Array, zeta_c: Array, radius: Array, *, step: float
) -> Array:
    """Angle [rad] that rays subtend at the centre of the earth, as Gyer computed it (Eq. 12).

    Arguments as for `gyer1996`, all but ``step`` of the shape (n,). NaN for rays that miss the
    ground. The lowest intervals of rays that are level within an interval below the ground are
    integrated in thin shells, the others by Eq. 31.
    """
    k = _n_r(profile, h_c, radius + h_c) * np.sin(zeta_c)
    intervals = _intervals(profile, h_c, h_g, step)
    h_below = h_g - intervals.width_m  # an interval below the ground
    misses = _n_r(profile, h_g, radius + h_g) < k * (1.0 - _ROUNDING)
    is_grazing = _n_r(profile, h_below, radius + h_below) <= k
    shell_intervals = np.minimum(intervals.count, _SHELL_INTERVALS)
    shell_intervals = np.where(is_grazing, shell_intervals, 0.0)

    def eq_12(h: Array, rays: Rows) -> Array:
        r = radius[rays] + h
        n_r = _n_r(profile, h, r)
        k_ray = k[rays]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(k_ray / (r * np.sqrt((n_r - k_ray) * (n_r + k_ray))))

    theta = _eq_31(eq_12, h_g, intervals, shell_intervals)
    shells_m = intervals.width_m * shell_intervals
    rays_in_shells = np.flatnonzero(is_grazing & ~misses)
    blocks = max(1, math.ceil(rays_in_shells.size / _RAYS_AT_ONCE))
    for rays in np.array_split(rays_in_shells, blocks):
        theta[rays] += _angle_in_shells(profile, k[rays], h_g[rays], shells_m[rays], radius[rays])
    return np.where(misses, np.nan, theta)


def _angle_in_shells(
    profile: Profile, k: Array, h_g: Array, shells_m: Array, radius: Array
) -> Array:
    """Angle [rad] that rays subtend in thin shells on the ground (Eq. 33-35).

    Arguments are (n,) in m: ``shells_m`` is the thickness of all shells of a ray together, ``k`` is
    n r sin(zeta), ``radius`` that of the sphere. In shell i the index is n_i, of its lower end.
    """
    count = _SHELLS_PER_INTERVAL * _SHELL_INTERVALS
    share = np.arange(count + 1) / count
    h = h_g[:, None] + shells_m[:, None] * share
    r = radius[:, None] + h
    k_over_n = k[:, None] / (1.0 + profile.refractivity(h[:, :-1]))
    at_top = np.arccos(np.minimum(k_over_n / r[:, 1:], 1.0))
    at_bottom = np.arccos(np.minimum(k_over_n / r[:, :-1], 1.0))
    return np.asarray(np.sum(at_top - at_bottom, axis=1))


def _eq_31(
    integrand: Callable[[Array, Rows], Array],
    h_g: Array,
    intervals: _Intervals,
    first: Array,
) -> Array:
    """Integral by Eq. 31 over the intervals of each ray from number ``first``, from the ground up.

    ``integrand`` is a function of heights [m] and of the numbers of the rays at these heights.
    ``h_g`` are the heights of the ground [m]. NaN where a ray has no intervals.
    """
    ground = h_g.ravel()
    width = intervals.width_m.ravel()
    begin = first.ravel()
    end = intervals.count.ravel()
    total = 0.0 * width  # NaN where there are no intervals
    last_node = int(end.max(initial=0.0)) + 1
    for node in range(-1, last_node + 1):
        weight = np.zeros(total.shape)
        for offset, share in _NODE_SHARES.items():
            interval = node + offset
            is_summed = (interval >= begin) & (interval < end)
            weight += np.where(is_summed, share, 0.0)
        rays = np.flatnonzero(weight)
        value = integrand(ground[rays] + node * width[rays], rays)
        total[rays] += weight[rays] * width[rays] * value
    return total.reshape(h_g.shape)
