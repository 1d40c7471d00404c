"""The formulas of Saastamoinen 1974: R = mean n - n at the camera, and what follows from it.

All are plane: alpha = R tan(zeta_c) (Eq. 1). He takes the refractive index in proportion to the
density, in moist air too, where that overstates the effect of humidity about twice. His Eq. 7, 8
and 10 have g M / R* = 34.11 (it is 34.163 K per geopotential km) and so read 27 % high at 120 m
above ground and 1 % at 3 km; the coefficient 39.6 of Eq. 8 is 39.5 when derived from Eq. 7.
"""

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.profile import Profile
from unbend.refraction import messages
from unbend.refraction.published.column import at_45_degrees, density, mean
from unbend.units import HECTOPASCAL, Array

INDEX_PER_DENSITY = 0.000226
"""(n - 1) / rho [m3 kg-1]."""

ICAN_TROPOPAUSE_M = 11_000.0
ICAN_TOP_M = 30_000.0
QUADRATIC_TOP_M = 9_000.0
_SERIES_TOP_KM = 30.0  # above ground
_SERIES_TERMS = 30  # enough up to `_SERIES_TOP_KM`


@at_45_degrees
def saastamoinen1974(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] by the mean density of the column (Saastamoinen 1974, Eq. 2).

    Arguments as in `unbend.refraction.published`. The mean is exact. Below 60 degrees and 10 km
    within 0.4 % of the spherical form with the index of 0.589 um, in dry air.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1962")
    >>> float((saastamoinen1974(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(1))
    58.8
    """
    return INDEX_PER_DENSITY * (mean(profile, density, h_g, h_c) - density(profile, h_c))


@at_45_degrees
def saastamoinen1974_ican(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] in the I.C.A.N. atmosphere (Saastamoinen 1974, Eq. 3a, 3b): heights only.

    Arguments as in `unbend.refraction.published`; ``profile`` is not used. Ground up to 11 km,
    camera up to 30 km, NaN beyond. Eq. 3b has a plus before 521 / (H - h). Within 0.2 urad of Eq. 2
    in that atmosphere up to 20 km, within 0.25 in US 1962 (worst at 12 km).

    >>> float((saastamoinen1974_ican(None, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(1))
    58.9
    """
    is_covered = (h_c <= ICAN_TOP_M) & (h_g <= ICAN_TROPOPAUSE_M)
    is_usable = is_covered & (h_c > h_g)
    H = np.where(is_usable, h_c, 1000.0) / 1e3
    h = np.where(is_usable, h_g, 0.0) / 1e3
    low = np.minimum(H, ICAN_TROPOPAUSE_M / 1e3)
    ground = (1.0 - 0.02257 * h) ** 5.256
    eq_3a = (
        2335.0 / (H - h) * (ground - (1.0 - 0.02257 * low) ** 5.256)
        - 277.0 * (1.0 - 0.02257 * low) ** 4.256
    )
    eq_3b = 2335.0 / (H - h) * ground - 0.8540 ** (H - 11.0) * (82.2 + 521.0 / (H - h))
    r = np.where(h_c <= ICAN_TROPOPAUSE_M, eq_3a, eq_3b) * 1e-6
    not_usable = np.where(h_c == h_g, 0.0, np.nan)
    return np.where(is_usable, r, not_usable)


def _eq_5(c_1: float, c_2: float, h_c: Array, h_g: Array) -> Array:
    """R [rad at 45 degrees] where n = n_0 + c_1 z + c_2 z^2, z the height (Saastamoinen, Eq. 5).

    ``c_1`` [m-1], ``c_2`` [m-2], heights of camera and ground [m].
    """
    ratio = 2.0 * c_2 / (3.0 * c_1)
    return np.asarray(-0.5 * c_1 * (h_c - h_g) * (1.0 + ratio * (2.0 * h_c + h_g)))


@at_45_degrees
def saastamoinen1974_quadratic(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] by 13 (H - h) (1 - 0.02 (2H + h)) (Saastamoinen 1974, Eq. 6): heights only.

    Arguments as in `unbend.refraction.published`; ``profile`` is not used. Camera up to 9 km, NaN
    beyond. Within 0.5 urad of Eq. 2 in US 1962, as he states.

    >>> r = saastamoinen1974_quadratic(None, 6000.0, 0.0, 0.7853981633974483, 0.0)
    >>> float((r * 1e6).round(2))
    59.28
    """
    c_1 = -26e-9  # [m-1]
    c_2 = -0.03e-3 * c_1  # [m-2]
    covered_h_c = np.where(h_c <= QUADRATIC_TOP_M, h_c, np.nan)
    return _eq_5(c_1, c_2, covered_h_c, h_g)


def quadratic_coefficients(
    profile: Profile, lowest: float = 0.0, highest: float = QUADRATIC_TOP_M
) -> tuple[float, float]:
    """c_1 [m-1] and c_2 [m-2] of the parabola through a profile's index (Saastamoinen, Eq. 4).

    Least squares at 200 heights from ``lowest`` to ``highest`` [m above sea level].

    >>> from unbend.atmosphere import standard_atmosphere
    >>> c_1, c_2 = quadratic_coefficients(standard_atmosphere("us1962", index="gyer"))
    >>> round(-0.5e9 * c_1, 2), round(1e3 * 2 * c_2 / (3 * c_1), 4)
    (12.94, -0.0199)
    """
    if not profile.bottom_m <= lowest < highest <= profile.top_m:
        raise messages.method_span(where=profile.extent, lowest=lowest, highest=highest)
    middle = 0.5 * (highest + lowest)
    half = 0.5 * (highest - lowest)
    x = np.linspace(-1.0, 1.0, 200)
    refractivity = profile.refractivity(middle + half * x)
    a_2, a_1, _ = np.polyfit(x, refractivity, 2)
    c_2 = a_2 / half**2
    c_1 = a_1 / half - 2.0 * c_2 * middle
    return float(c_1), float(c_2)


@at_45_degrees
def saastamoinen1974_fitted(
    profile: Profile, h_c: Array, h_g: Array, *, highest: float = QUADRATIC_TOP_M
) -> Array:
    """R_c [rad] by Eq. 5 of Saastamoinen 1974 with coefficients fitted to the profile.

    Arguments as in `unbend.refraction.published`. Fitted from sea level to ``highest`` [m], NaN for
    cameras above it. For US 1962 within 0.5 urad of Eq. 2.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1962", index="gyer")
    >>> float((saastamoinen1974_fitted(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(1))
    59.1
    """
    c_1, c_2 = quadratic_coefficients(profile, highest=highest)
    r = _eq_5(c_1, c_2, h_c, h_g)
    is_covered = (h_c <= highest) & (h_g >= profile.bottom_m)
    return np.where(is_covered, r, np.nan)


def weather_refraction(
    pressure_ground: ArrayLike,
    pressure_camera: ArrayLike,
    rise: ArrayLike,
    pressure_lens: ArrayLike,
    temperature_lens: ArrayLike,
) -> Array:
    """R [rad at 45 degrees] from weather at both ends (Saastamoinen 1974, Eq. 7 and 10).

    pressure_ground, pressure_camera : of the air outside [Pa].
    rise : H - h, height of the camera above the ground [m], positive.
    pressure_lens, temperature_lens : of the air at the lens [Pa], [K]: outside for Eq. 7, of the
        compartment for Eq. 10, which then gives R + Delta R.

    Arguments broadcast. His 34.11 makes R 27 % high at 120 m, 3 % at 1 km, 1 % at 3 km, 0.2 % at
    10 km.

    >>> float((weather_refraction(101325.0, 47200.0, 6000.0, 74700.0, 278.0) * 1e6).round(1))
    -3.4
    """
    p_g = np.asarray(pressure_ground, np.float64)
    p_c = np.asarray(pressure_camera, np.float64)
    rise_km = np.asarray(rise, np.float64) / 1e3
    per_km = (p_g - p_c) / HECTOPASCAL / rise_km
    lens_hpa = np.asarray(pressure_lens, np.float64) / HECTOPASCAL
    lens = lens_hpa / np.asarray(temperature_lens)
    return np.asarray(2.316e-6 * (per_km - 34.11 * lens))


@at_45_degrees
def saastamoinen1974_weather(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] from pressure and temperature at both ends (Saastamoinen 1974, Eq. 7).

    Arguments as in `unbend.refraction.published`. The ground need not be at sea level (as in his
    Eq. 10). The temperature is the virtual one, which gives the density. NaN where h_c = h_g:
    the formula has no limit there. For its accuracy see `weather_refraction`.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1962")
    >>> float((saastamoinen1974_weather(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(1))
    59.2
    """
    p_c = profile.pressure(h_c)
    return weather_refraction(
        pressure_ground=profile.pressure(h_g),
        pressure_camera=p_c,
        rise=np.where(h_c > h_g, h_c - h_g, np.nan),
        pressure_lens=p_c,
        temperature_lens=profile.virtual_temperature(h_c),
    )


@at_45_degrees
def saastamoinen1974_series(profile: Profile, h_c: Array, h_g: Array) -> Array:
    """R_c [rad] from ground weather and lapse rate (Saastamoinen 1974, Eq. 8).

    Arguments as in `unbend.refraction.published`. Pressure and virtual temperature are those of the
    ground, the lapse rate is the mean one up to the camera. The series is summed to 30 terms, which
    suffices up to 30 km above ground; NaN beyond. In air linear in temperature it is within 0.5 %
    of Eq. 2 (39.6 for 39.5 is 0.25 % of it), free of the cancellation of Eq. 7. One lapse rate
    across the tropopause costs 2 % at 12 km, 6 % at 20 km.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1962")
    >>> float((saastamoinen1974_series(air, 6000.0, 0.0, 0.7853981633974483, 0.0) * 1e6).round(1))
    59.1
    """
    rise = (h_c - h_g) / 1e3
    rise = np.where((rise >= 0.0) & (rise <= _SERIES_TOP_KM), rise, np.nan)
    t_g = profile.virtual_temperature(h_g)
    t_c = profile.virtual_temperature(h_c)
    p_g = profile.pressure(h_g) / HECTOPASCAL
    beta = (t_c - t_g) / np.where(rise > 0.0, rise, 1.0)
    y = rise / t_g
    total = np.ones(y.shape)
    product = np.ones(y.shape)
    for n in range(1, _SERIES_TERMS + 1):
        # (-1)^n / n! (34.1 + 2 beta) ... (34.1 + (n + 1) beta) y^n
        product = product * -(34.1 + (n + 1.0) * beta) * y / n
        total += 2.0 / (n + 2.0) * product
    return np.asarray(39.6e-6 * (34.1 + beta) * (p_g / t_g**2) * rise * total)


def compartment(refractivity_outside: ArrayLike, refractivity_cabin: ArrayLike) -> Array:
    """Delta R = n_H - n_A [rad at 45 degrees], to be added to R (Saastamoinen 1974, Eq. 9).

    From the refractivities N outside, n_H, and in the cabin, n_A, for a horizontal window; the
    exact form is `unbend.refraction.window.refract_at_window`. His Delta R is Gyer's -R_cc.

    >>> round(float(compartment(149.75e-6, 212.28e-6)) * 1e6, 1)
    -62.5
    """
    n_h = np.asarray(refractivity_outside, np.float64)
    n_a = np.asarray(refractivity_cabin, np.float64)
    return np.asarray(n_h - n_a)
