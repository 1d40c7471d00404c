"""What the air is like without any measurement, one of `standard.ATMOSPHERES`, and how far from
that it may be: one model for all, and how far each departs from the US Supplements 1966."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.atmosphere.climate_tables import SUPPLEMENTS, season
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel, saturation_vapour_pressure
from unbend.atmosphere.standard import ATMOSPHERES, AUTO, SeasonAndPlace, known_names
from unbend.units import DEGREE, Array

HUMIDITY_CORRELATION_M = 1000.0
"""With it, the sigmas below and a measured surface pressure, sigma of R is 19 / 9 / 5 / 3 % over
1 / 3 / 6 / 10 km; eight real ascents departed by 11 / 8 / 2 / 4 % RMS."""

_NO_SEASON = 4.0  # halfway between the seasons, which follow a cosine
_EXTREME_MONTHS = (1.0, 7.0)
_SPREAD_TOP_M, _SPREAD_STEP_M = 30_000.0, 250.0
_BOUNDARY_LAYER_M = 1500.0
_DRY_ABOVE_M = 12_000.0  # above, all humidities weigh less than 1e-4 of n - 1


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the air of one day is from a climatology.

    One sigma (k,) of temperature [K] and of relative humidity over water [1] at increasing heights
    ``h_m`` (k,) above sea level, linear between and constant beyond; ``pressure_ratio`` that of
    ln p at sea level. Humidity correlates as exp(-dh / ``humidity_correlation_m``) over heights dh.
    """

    h_m: Array
    temperature_k: Array
    relative_humidity: Array
    humidity_correlation_m: float
    pressure_ratio: float

    def sigma_temperature(self, h: ArrayLike) -> Array:
        """One sigma of temperature [K] at heights ``h`` [m above sea level]."""
        return np.interp(np.asarray(h, np.float64), self.h_m, self.temperature_k)

    def sigma_relative_humidity(self, h: ArrayLike) -> Array:
        """One sigma of relative humidity (0 to 1) at heights ``h`` [m above sea level]."""
        return np.interp(np.asarray(h, np.float64), self.h_m, self.relative_humidity)

    def about(self, profile: Profile, expected: Profile) -> Spread:
        """The spread about another profile than the expected: their difference is part of it."""
        inside = (self.h_m <= profile.top_m) & (self.h_m <= expected.top_m)
        h = self.h_m[inside]
        saturated = saturation_vapour_pressure(expected.temperature(h))
        off = profile.temperature(h) - expected.temperature(h)
        wet = (profile.vapour_pressure(h) - expected.vapour_pressure(h)) / saturated
        wet = np.where(h < _DRY_ABOVE_M, wet, 0.0)
        level = float(np.log(profile.pressure(0.0) / expected.pressure(0.0)))
        return Spread(
            h, temperature_k=np.hypot(self.temperature_k[inside], off),
            relative_humidity=np.hypot(self.relative_humidity[inside], wet),
            humidity_correlation_m=self.humidity_correlation_m,
            pressure_ratio=math.hypot(self.pressure_ratio, level),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Climatology:
    """The expected profile, its spread, and in words which tables it comes from; where it has no
    humidity the profile is dry because the model says nothing of water."""

    profile: Profile
    spread: Spread
    origin: str
    has_humidity: bool

    def relative_humidity(self, h: ArrayLike) -> Array:
        """Expected relative humidity over water (0 to 1) at heights ``h`` [m above sea level]."""
        saturated = saturation_vapour_pressure(self.profile.temperature(h))
        return self.profile.vapour_pressure(h) / saturated

    def sigma_log_pressure(self, h_m: float) -> float:
        """One sigma of ln p at a height [m above sea level]: at sea level, and 2 % of the fall."""
        fall = math.log(float(self.profile.pressure(0.0)) / float(self.profile.pressure(h_m)))
        return math.hypot(self.spread.pressure_ratio, 0.02 * fall)


def climatology(
    name: str = AUTO,
    *,
    latitude_rad: float,
    month: float | None,
    index: IndexModel | None = None,
    ground_h_m: float = 0.0,
    longitude_rad: float = 0.0,
) -> Climatology:
    """The air to expect at a place and season, with its spread.

    ``name``: one of `known_names`; ``auto`` is the Supplements 1966 by latitude and season.
    ``latitude_rad``: north positive; gives gravity too. ``month``: 1.0 is mid-January, 7.0
    mid-July, None where the date is not known; see `month_of`. ``ground_h_m``: of the ground
    [m above sea level], on which the boundary layer stands. ``longitude_rad``: used by NRLMSIS
    only.

    Raises ``PhysicsError`` where the name is unknown, the latitude is beyond the pole, or the
    package behind NRLMSIS is not installed.

    >>> air = climatology(latitude_rad=0.8, month=7.0)
    >>> [round(float(t), 1) for t in (air.profile.temperature(0), air.spread.sigma_temperature(0))]
    [293.8, 7.3]
    """
    model = ATMOSPHERES.get(name)
    if model is None:
        raise messages.unknown_climatology(name=name, names=", ".join(known_names()))
    index = index or IndexModel()
    place = SeasonAndPlace(latitude_rad, _NO_SEASON if month is None else month, longitude_rad)
    profile = model.profile(place, index)
    if month is None:
        spread = _spread_over_the_year(place, ground_h_m, index)
    else:
        spread = expected_spread(latitude_rad, month, ground_h_m)
    if model is not ATMOSPHERES[SUPPLEMENTS]:
        spread = spread.about(profile, ATMOSPHERES[SUPPLEMENTS].profile(place, index))
    return Climatology(profile, spread, model.origin, model.has_humidity)


def _spread_over_the_year(place: SeasonAndPlace, ground_h_m: float, index: IndexModel) -> Spread:
    """The spread about the middle of the year, at a place where the day is not known.

    Mid-winter and mid-summer are half of their difference away. That counts as one sigma, beside
    the weather of the season in which it is larger: most flights are of one season, and have to be
    covered there.
    """
    supplements = ATMOSPHERES[SUPPLEMENTS]
    middle = supplements.profile(place, index)
    spreads = []
    for month in _EXTREME_MONTHS:
        extreme = supplements.profile(replace(place, month=month), index)
        of_season = expected_spread(place.latitude_rad or 0.0, month, ground_h_m)
        spreads.append(of_season.about(extreme, middle))
    winter, summer = spreads
    return replace(
        winter,
        temperature_k=np.maximum(winter.temperature_k, summer.temperature_k),
        relative_humidity=np.maximum(winter.relative_humidity, summer.relative_humidity),
        pressure_ratio=max(winter.pressure_ratio, summer.pressure_ratio),
    )


def month_of(time_ns: int | None) -> float | None:
    """The month that `climatology` takes, of a time [Unix ns]; 1.0 is 15 January.

    None without a time: no season may be assumed.

    >>> round(month_of(1_310_688_000 * 10**9), 2), month_of(None)  # 15 July 2011
    (6.95, None)
    """
    if time_ns is None:
        return None
    day = np.datetime64(int(time_ns), "ns").astype("datetime64[D]")
    into = float((day - day.astype("datetime64[Y]")).astype(np.float64))
    return (into - 14.0) / 365.25 * 12.0 + 1.0


def expected_spread(latitude_rad: float, month: float, ground_h_m: float = 0.0) -> Spread:
    """One sigma of a day's air about the Supplements at the same latitude and season.

    Temperature: in the free troposphere 4 K in the tropics, 5 K in middle and high latitudes and
    up to 6 K at the tropopause; near the ground 2 K more in the tropics, 3 K in middle and high
    latitudes in summer and 6 K in winter, falling by 1/e in 1.5 km. Relative humidity: 0.30,
    0.15 in the lowest kilometre and above 12 km. Pressure at sea level: 0.6 % in the tropics,
    1.0 % in middle latitudes, 1.3 % in their winter.

    These contain the day's weather, the hour, and the place along the parallel. They are judgement,
    set on eight real ascents of five sites, whose departures they overstate by a third (RMS 0.74 of
    sigma), because five sites are few.
    """
    degrees = abs(latitude_rad) / DEGREE
    winter = 0.5 + 0.5 * season(latitude_rad, month)
    away = float(np.interp(degrees, [15.0, 50.0], [0.0, 1.0]))  # from the tropics
    h = np.arange(0.0, _SPREAD_TOP_M + 1.0, _SPREAD_STEP_M)
    tropics = np.interp(h, [0.0, 8000.0, 16_000.0, 19_000.0, 30_000.0], [4.0, 4.5, 5.0, 5.0, 4.0])
    middle = np.interp(h, [0.0, 6000.0, 10_000.0, 13_000.0, 30_000.0], [4.5, 5.0, 6.0, 5.5, 5.0])
    free = (1.0 - away) * tropics + away * middle
    near = 2.0 + away * (1.0 + 3.0 * winter)
    above_ground = np.maximum(h - ground_h_m, 0.0)
    temperature = free + near * np.exp(-above_ground / _BOUNDARY_LAYER_M)
    humidity = np.interp(above_ground, [0.0, 1000.0, 10_000.0, 13_000.0], [0.15, 0.3, 0.3, 0.15])
    level = 0.006 + away * (0.004 + 0.003 * winter)
    return Spread(h, temperature, humidity, HUMIDITY_CORRELATION_M, level)
