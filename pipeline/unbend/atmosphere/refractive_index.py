"""The refractive index of moist air, and how much water vapour air contains.

All pressures in Pa, temperatures in K, wavelengths in vacuum in m. The vapour pressure ``e`` is
the partial pressure of water; ``e = 0`` is dry air.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.units import HECTOPASCAL, VAPOUR_DEFICIT, ZERO_CELSIUS_K, Array

DEFAULT_WAVELENGTH_M = 0.55e-6
STANDARD_AIR_CO2_PPM = 450.0  # of Ciddor's standard air
DEFAULT_CO2_PPM = STANDARD_AIR_CO2_PPM


def refractivity_gyer(
    temperature_k: ArrayLike, pressure_pa: ArrayLike, vapour_pressure_pa: ArrayLike = 0.0
) -> Array:
    """Refractivity n - 1 at 0.589 um as the papers use it (Gyer 1996, Eq. 13).

    Reproduces Gyer's Table 2 to its last digit. Its vapour term is too small by a tenth; for humid
    air prefer `refractivity_ciddor`.

    >>> float((refractivity_gyer(288.16, 101325.0) * 1e6).round(2))
    277.19
    """
    p_mbar = np.asarray(pressure_pa, dtype=np.float64) / HECTOPASCAL
    e_mbar = np.asarray(vapour_pressure_pa, dtype=np.float64) / HECTOPASCAL
    return np.asarray(
        (78.831e-6 * p_mbar - 11.036e-6 * e_mbar) / np.asarray(temperature_k, np.float64)
    )


def saturation_vapour_pressure(temperature_k: ArrayLike) -> Array:
    """Saturation vapour pressure over water [Pa] (Davis 1992, used by Ciddor 1996, appendix A).

    Valid from 233 K (supercooled water) to 373 K.

    >>> float(saturation_vapour_pressure(293.15).round(2))
    2339.16
    """
    t = np.asarray(temperature_k, dtype=np.float64)
    return np.asarray(
        np.exp(1.2378847e-5 * t * t - 1.9121316e-2 * t + 33.93711047 - 6.3431645e3 / t)
    )


def dew_point(vapour_pressure_pa: ArrayLike) -> Array:
    """Temperature [K] at which air of a vapour pressure [Pa] is saturated, from 180 to 373 K.

    Within 1 mK of the inverse of `saturation_vapour_pressure`.

    >>> dew_point([611.66, 2339.16]).round(2).tolist()
    [273.16, 293.15]
    """
    t = np.arange(180.0, 373.5, 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_e = np.log(vapour_pressure_pa)
        log_saturated = np.log(saturation_vapour_pressure(t))
    return np.asarray(np.interp(log_e, log_saturated, t))


def saturated_lapse(temperature_k: ArrayLike, pressure_pa: ArrayLike) -> Array:
    """Fall of temperature with height [K/m] in rising saturated air, over water (AMS Glossary).

    >>> saturated_lapse([293.15, 253.15], [1e5, 5e4]).round(4).tolist()
    [0.0042, 0.0077]
    """
    t = np.asarray(temperature_k, np.float64)
    p = np.asarray(pressure_pa, np.float64)
    e = saturation_vapour_pressure(t)
    heat = 2.501e6 * 0.622 * e / (p - e) / t  # of condensation [J kg-1 K-1]
    return np.asarray(
        9.80665 * (1.0 + heat / 287.05) / (1005.0 + 0.622 * 2.501e6 * heat / 287.05 / t)
    )


def enhancement_factor(temperature_k: ArrayLike, pressure_pa: ArrayLike) -> Array:
    """Saturation vapour pressure in air over that without air (Ciddor 1996, appendix A).

    >>> float(enhancement_factor(293.15, 101325.0).round(5))
    1.00403
    """
    celsius = np.asarray(temperature_k, dtype=np.float64) - ZERO_CELSIUS_K
    return np.asarray(
        1.00062 + 3.14e-8 * np.asarray(pressure_pa, np.float64) + 5.6e-7 * celsius * celsius
    )


def vapour_pressure(
    relative_humidity: ArrayLike, temperature_k: ArrayLike, pressure_pa: ArrayLike
) -> Array:
    """Vapour pressure e [Pa] of a relative humidity (0 to 1, over water).

    >>> float(vapour_pressure(0.5, 293.15, 101325.0).round(1))
    1174.3
    """
    humidity = np.asarray(relative_humidity, np.float64)
    enhanced = humidity * enhancement_factor(temperature_k, pressure_pa)
    return np.asarray(enhanced * saturation_vapour_pressure(temperature_k))


def virtual_temperature(
    temperature_k: ArrayLike, pressure_pa: ArrayLike, vapour_pressure_pa: ArrayLike
) -> Array:
    """Temperature [K] at which dry air has the density of the moist air.

    >>> float(virtual_temperature(300.0, 1e5, 3000.0).round(2))
    303.44
    """
    t = np.asarray(temperature_k, np.float64)
    p = np.asarray(pressure_pa, np.float64)
    fraction = np.asarray(vapour_pressure_pa, np.float64) / p
    return np.asarray(t / (1.0 - VAPOUR_DEFICIT * fraction))


_GAS_CONSTANT = 8.314510  # R [J mol-1 K-1] (Ciddor 1996)
_M_W = 0.018015  # molar mass of water [kg/mol]


def _compressibility(t: Array, p: Array, x_w: Array) -> Array:
    """Compressibility Z of moist air (Ciddor 1996, Eq. 12; BIPM density equation).

    At ``t`` [K], ``p`` [Pa] and molar fraction ``x_w`` of water vapour.
    """
    c = t - ZERO_CELSIUS_K
    ratio = p / t
    first = 1.58123e-6 - 2.9331e-8 * c + 1.1043e-10 * c * c
    water = 5.707e-6 - 2.051e-8 * c
    water_squared = 1.9898e-4 - 2.376e-6 * c
    return np.asarray(
        1.0
        - ratio * (first + water * x_w + water_squared * x_w * x_w)
        + ratio * ratio * (1.83e-11 - 0.765e-8 * x_w * x_w)
    )


def refractivity_ciddor(
    temperature_k: ArrayLike,
    pressure_pa: ArrayLike,
    vapour_pressure_pa: ArrayLike = 0.0,
    *,
    wavelength_m: float = DEFAULT_WAVELENGTH_M,
    co2_ppm: float = DEFAULT_CO2_PPM,
) -> Array:
    """Phase refractivity n - 1 of moist air (Ciddor 1996, Appl. Opt. 35(9), Eq. 1-5).

    Arguments broadcast. Valid from 233 K to 373 K, 0 to 140 kPa, 0.3 to 1.69 um; beyond, the
    formulas are smooth. Agrees with the published check values to 1e-9 in n.

    >>> float((refractivity_ciddor(293.15, 101325.0, wavelength_m=0.633e-6) * 1e9).round())
    271800.0
    """
    if not 0.23e-6 <= wavelength_m <= 2.0e-6:
        raise messages.wavelength_outside_range(wavelength_m=wavelength_m)
    t = np.asarray(temperature_k, np.float64)
    p = np.asarray(pressure_pa, np.float64)
    with np.errstate(invalid="ignore"):
        x_w = np.where(p > 0.0, np.asarray(vapour_pressure_pa, np.float64) / p, 0.0)

    sigma2 = (1e-6 / wavelength_m) ** 2  # [um-2]
    standard_air = 1e-8 * (5792105.0 / (238.0185 - sigma2) + 167917.0 / (57.362 - sigma2))
    carbonic_air = standard_air * (1.0 + 0.534e-6 * (co2_ppm - STANDARD_AIR_CO2_PPM))
    standard_vapour = 1.022e-8 * (
        295.235 + 2.6422 * sigma2 - 0.032380 * sigma2**2 + 0.004028 * sigma2**3
    )

    m_a = 1e-3 * (28.9635 + 12.011e-6 * (co2_ppm - 400.0))
    z_air = _compressibility(np.asarray(288.15), np.asarray(101325.0), np.asarray(0.0))
    z_vapour = _compressibility(np.asarray(293.15), np.asarray(1333.0), np.asarray(1.0))
    density_air_standard = 101325.0 * m_a / (z_air * _GAS_CONSTANT * 288.15)
    density_vapour_standard = 1333.0 * _M_W / (z_vapour * _GAS_CONSTANT * 293.15)

    z = _compressibility(t, p, x_w)
    density_air = p * m_a * (1.0 - x_w) / (z * _GAS_CONSTANT * t)
    density_vapour = p * _M_W * x_w / (z * _GAS_CONSTANT * t)
    return np.asarray(
        density_air / density_air_standard * carbonic_air
        + density_vapour / density_vapour_standard * standard_vapour
    )


INDEX_OF_ONE_LIGHT = ("gyer",)
"""Formulas for one wavelength, which ignore `IndexModel.wavelength_m`."""

GYER_WAVELENGTH_M = 0.589e-6
"""The wavelength of Gyer's Eq. 13."""


@dataclass(frozen=True)
class IndexModel:
    """Which formula gives the refractive index, and for which light.

    >>> float((IndexModel("gyer").refractivity(288.16, 101325.0, 0.0) * 1e6).round(2))
    277.19
    """

    name: str = "ciddor"
    wavelength_m: float = DEFAULT_WAVELENGTH_M
    co2_ppm: float = DEFAULT_CO2_PPM

    def __post_init__(self) -> None:
        if self.name not in INDEX_MODELS:
            raise messages.unknown_index(name=self.name, names=", ".join(INDEX_MODELS))

    @property
    def light_m(self) -> float:
        """The wavelength in vacuum [m] for which the formula gives the refractivity."""
        return GYER_WAVELENGTH_M if self.name in INDEX_OF_ONE_LIGHT else self.wavelength_m

    def refractivity(
        self,
        temperature_k: ArrayLike,
        pressure_pa: ArrayLike,
        vapour_pressure_pa: ArrayLike,
    ) -> Array:
        """Refractivity n - 1; arguments in K and Pa broadcast."""
        return INDEX_MODELS[self.name](self, temperature_k, pressure_pa, vapour_pressure_pa)


INDEX_MODELS: dict[str, Callable[[IndexModel, ArrayLike, ArrayLike, ArrayLike], Array]] = {
    "ciddor": lambda model, t, p, e: refractivity_ciddor(
        t, p, e, wavelength_m=model.wavelength_m, co2_ppm=model.co2_ppm
    ),
    "gyer": lambda _, t, p, e: refractivity_gyer(t, p, e),
}
"""Formulas by name, of T [K], p [Pa] and e [Pa]."""
