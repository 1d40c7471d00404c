"""How far the air departs from its climatology, and how it changes: one structure function.

The departure of temperature is a sum of independent parts, normal and about zero. Part k has an
amplitude a_k(z), a correlation r_k in height, a memory tau_k and a reach L_k, so that departures at
two heights, two times and two places have the covariance

    sum of a_k(z) a_k(z') r_k(|z - z'|) exp(-t/tau_k - d/L_k).

The parts: ``waves`` of weather, whose amplitude changes its sign at the tropopause (warm air below
goes with cold air above); ``layers`` of air of other origin; ``climate``, what a place has beside
its climatology for weeks; ``ground``, air in the sun or over a cold field; and the fine structure,
``kinked`` as inversions are and ``smooth``. `benchmarks/fit_air.py` fits them to public ascents.

Heights are reduced: above the ground, and from 3 km on stretched so that the tropopause is 11.5 km
above the ground.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from unbend.atmosphere.climate_tables import season
from unbend.units import DEGREE, Array

NOMINAL_TROPOPAUSE_M = 11_500.0  # reduced height of the tropopause [m]
STRETCHED_ABOVE_M = 3000.0  # below, a reduced height is the height above the ground [m]
LOWEST_TROPOPAUSE_M = 6000.0  # above the ground, over the highest plateaus [m]

CYCLE_LENGTH_M = 5000.0  # correlation in height of the day's cycle, its hour unknown [m]
CYCLE_MEMORY_H = 6.0  # the same in time: a quarter of a day
SPRING = 4.0  # a month between the seasons, where none is known
WARMEST_HOUR = 15.0  # mean local time when the lowest air is warmest [h]

_WEATHER_BY_DEGREES = {
    15.0: 0.6,
    35.0: 1.0,
    50.0: 1.0,
    60.0: 1.4,
}
"""Amplitude of weather at latitudes over that in middle ones. North of 52 degrees 16 ascents depart
by half as much again; 16 over Darwin and the Atlantic are right to 1 sigma with this share."""

_DAY_BY_DEGREES = {
    15.0: 0.0,  # sea and coast, which are all of the tropics that is known here
    30.0: 1.0,
    50.0: 1.0,
    60.0: 0.5,  # snow
    75.0: 0.4,
}
"""Amplitude of the day's cycle at latitudes over that of land between 30 and 50 degrees."""

_MIXED_BY_DEGREES = {
    50.0: 1.0,
    60.0: 0.3,  # snow
}
"""How far a summer's afternoon mixes the lowest air."""

_MIXED_IN_THE_EVENING = 1.5
"""Mixed air stays mixed: after the warmest hour the share of mixing is the cosine of the hour times
this, at most 1, which it is for three hours."""

_INVERSIONS_OF_WINTER = {
    250.0: 1.0,
    750.0: 1.35,
    1500.0: 1.35,
    3000.0: 1.0,
}
"""Amplitude of layers and of the fine structure in mid-winter over that in spring and summer, at
reduced heights [m]: in winter inversions are lifted. In 65 pairs of ascents over Vienna 12 hours
apart, R over 1 km errs by 1.24 sigma without this (4.6 % by more than 3) and by 1.03 with it
(1.5 %); from April to June by 0.8."""

_WINTER_BY_DEGREES = {
    25.0: 0.0,  # no winter
    40.0: 1.0,
    52.0: 1.0,
    60.0: 0.0,  # the weather's amplitude, half as large again, is that of inversions too
}
"""How far the inversions of winter are those of Vienna."""

_TROPOPAUSE_BY_DEGREES = {
    20.0: 16_500.0,
    30.0: 14_500.0,
    40.0: 12_500.0,
    50.0: 11_200.0,
    60.0: 10_000.0,
    75.0: 9_200.0,
}
"""Usual height of the tropopause above sea level [m], the mean of the year."""

_HIGHER_IN_SUMMER_BY_DEGREES = {
    20.0: 0.0,
    30.0: 800.0,
    40.0: 1000.0,
    50.0: 700.0,
    60.0: 600.0,
    75.0: 400.0,
}
"""By how much the tropopause is higher in mid-summer than in the mean [m]."""

_STEP_M = 250.0  # between the heights of a part's amplitudes
_TOP_M = 30_000.0
_NEAR_GROUND_M = (0.0, 15.0, 30.0, 50.0, 80.0, 120.0, 180.0, 300.0)


@dataclass(frozen=True, eq=False)
class Part:
    """One independent part of the departure of temperature from the climatology.

    ``sigma_k`` (k,): its amplitude [K] at heights ``h_m`` (k,) above sea level, linear between and
    constant beyond; at heights with amplitudes of opposite signs, departures are opposite.
    ``length_m``: correlation length in height; the correlation is exponential if ``kinked``, else
    Matern 3/2. ``memory_h``, ``reach_m``: time and distance in which the correlation falls to 1/e.
    """

    name: str
    h_m: Array
    sigma_k: Array
    length_m: float
    kinked: bool = False
    memory_h: float = math.inf
    reach_m: float = math.inf

    def correlation_over(self, hours: Array | float, metres: Array | float) -> Array:
        """Correlation of the part with itself after some hours and over some horizontal metres."""
        in_time = np.divide(hours, self.memory_h)
        in_distance = np.divide(metres, self.reach_m)
        return np.asarray(np.exp(-in_time - in_distance))

    def covariance(self, h: Array, other_h: Array, other: "Part | None" = None) -> Array:
        """(n, m) covariance [K2] at heights ``h`` (n,) and ``other_h`` (m,) [m above sea level].

        ``other``: the same part with the amplitudes of another hour of the day, for ``other_h``.
        """
        other = other or self
        here = np.interp(h, self.h_m, self.sigma_k)
        there = np.interp(other_h, other.h_m, other.sigma_k)
        apart = np.abs(h[:, None] - other_h)
        return np.outer(here, there) * correlation(apart, self.length_m, kinked=self.kinked)

    def change(self, hours: Array | float, metres: Array | float = 0.0) -> "Part":
        """The part of the air's change in some hours and over some metres.

        They may be (k,), at the heights of the part. Its amplitude is that of the difference of two
        departures: sigma sqrt(2 (1 - correlation)).
        """
        growth = np.sqrt(2.0 * (1.0 - self.correlation_over(hours, metres)))
        return replace(self, sigma_k=self.sigma_k * growth)


Parts = tuple[Part, ...]


def larger_part(part: Part, other: Part) -> Part:
    """A part with the amplitude of another at the heights where the other's is larger."""
    other_k = np.interp(part.h_m, other.h_m, other.sigma_k)
    is_larger = np.abs(other_k) > np.abs(part.sigma_k)
    return replace(part, sigma_k=np.where(is_larger, other_k, part.sigma_k))


def covariance_of(parts: Parts, h: Array, other_h: Array) -> Array:
    """(n, m) covariance [K2] of the sum of parts at heights (n,), (m,) [m above sea level]."""
    total = np.zeros((h.size, other_h.size))
    for part in parts:
        total += part.covariance(h, other_h)
    return total


def sigma_of(parts: Parts, h: Array) -> Array:
    """One sigma [K] of the sum of parts at heights (n,) [m above sea level]."""
    squares = [np.interp(h, part.h_m, part.sigma_k) ** 2 for part in parts]
    return np.asarray(np.sqrt(np.sum(squares, axis=0)))


def changes(parts: Parts, hours: float, metres: float = 0.0) -> Parts:
    """The parts of the air's change in some hours and over some metres (`Part.change`).

    >>> parts = variation_parts(0.8, 4.0, ground_h_m=0.0)
    >>> sigma_of(changes(parts, 12.0), np.array([1000.0, 5000.0])).round(0).tolist()
    [3.0, 3.0]
    """
    return tuple(part.change(hours, metres) for part in parts)


def correlation(apart_m: Array, length_m: float, *, kinked: bool) -> Array:
    """Correlation over a distance d in height [m].

    exp(-d/length) if ``kinked``, else Matern 3/2: (1 + q) exp(-q), q = sqrt(3) d / length.
    """
    if kinked:
        return np.asarray(np.exp(-apart_m / length_m))
    q = math.sqrt(3.0) * apart_m / length_m
    return np.asarray((1.0 + q) * np.exp(-q))


def variation_parts(
    latitude_rad: float, month: float, ground_h_m: float, hour: float | None = None
) -> Parts:
    """The parts of the air's departure at a latitude, season and hour.

    ``month``: 1.0 is mid-January. ``ground_h_m``: height of the ground [m above sea level].
    ``hour``: mean local time [h]; without it the lowest air is taken as not mixed.
    """
    regular_m = np.arange(-1000.0, _TOP_M - ground_h_m, _STEP_M)
    h_m = ground_h_m + np.union1d(regular_m, _NEAR_GROUND_M)
    reduced_m = reduced_height(h_m, ground_h_m, tropopause_m(latitude_rad, month))
    mixed = mixed_share(latitude_rad, month, hour)
    shares = _shares_of_place(reduced_m, latitude_rad, month)
    parts = []
    for name, table in _tables()["parts"].items():
        stable_k = np.interp(reduced_m, table["height_m"], table["sigma_k"])
        mixed_k = np.interp(reduced_m, table["height_m"], table["mixed_sigma_k"])
        sigma_k = (1.0 - mixed) * stable_k + mixed * mixed_k
        part = Part(
            name=name,
            h_m=h_m,
            sigma_k=sigma_k * shares[name],
            length_m=table["length_m"],
            kinked=table["shape"] == "kinked",
            memory_h=table["memory_h"],
            reach_m=1000.0 * table["reach_km"],
        )
        parts.append(part)
    return tuple(parts)


def _shares_of_place(reduced_m: Array, latitude_rad: float, month: float) -> dict[str, Array]:
    """Factor (n,) of the tabulated amplitude of each part, by its name, at reduced heights [m]."""
    weather = np.full(reduced_m.shape, weather_share(latitude_rad))
    inverted = weather * inversions_of_season(reduced_m, latitude_rad, month)
    # Aloft the tables depart from the tropics as from other latitudes.
    aloft = np.clip((reduced_m - 1000.0) / 3000.0, 0.0, 1.0)
    climate = weather + aloft * (np.maximum(weather, 1.0) - weather)
    return {
        "waves": weather,
        "layers": inverted,
        "climate": climate,
        "ground": weather,
        "kinked": inverted,
        "smooth": inverted,
    }


def reduced_height(h_m: Array, ground_h_m: float, tropopause_h_m: float) -> Array:
    """Height above the ground [m], stretched above 3 km so that the tropopause is at 11.5 km.

    ``h_m``, ``ground_h_m``, ``tropopause_h_m``: heights above sea level.

    >>> reduced_height(np.array([1500.0, 4500.0, 9500.0]), 500.0, 9500.0).tolist()
    [1000.0, 4416.666666666667, 11500.0]
    """
    above_m = np.asarray(h_m - ground_h_m)
    highest_m = max(tropopause_h_m - ground_h_m, LOWEST_TROPOPAUSE_M)
    stretch = (NOMINAL_TROPOPAUSE_M - STRETCHED_ABOVE_M) / (highest_m - STRETCHED_ABOVE_M)
    stretched_m = STRETCHED_ABOVE_M + (above_m - STRETCHED_ABOVE_M) * stretch
    return np.where(above_m < STRETCHED_ABOVE_M, above_m, stretched_m)


def tropopause_m(latitude_rad: float, month: float) -> float:
    """The usual height of the tropopause above sea level [m], to some 500 m.

    >>> round(tropopause_m(0.8, 7.0))
    12566
    """
    mean_m = _at_latitude(_TROPOPAUSE_BY_DEGREES, latitude_rad)
    summer = -season(latitude_rad, month)
    return mean_m + summer * _at_latitude(_HIGHER_IN_SUMMER_BY_DEGREES, latitude_rad)


def weather_share(latitude_rad: float) -> float:
    """Amplitude of the weather at a latitude over that in middle latitudes."""
    return _at_latitude(_WEATHER_BY_DEGREES, latitude_rad)


def share_of_day(latitude_rad: float) -> float:
    """Amplitude of the day's cycle at a latitude over that of land in middle latitudes."""
    return _at_latitude(_DAY_BY_DEGREES, latitude_rad)


def _at_latitude(by_degrees: Mapping[float, float], latitude_rad: float) -> float:
    """The value of a table at a latitude of either hemisphere, linear between its degrees."""
    degrees = abs(latitude_rad) / DEGREE
    return float(np.interp(degrees, list(by_degrees), list(by_degrees.values())))


def mixed_share(latitude_rad: float, month: float, hour: float | None) -> float:
    """How far the sun mixes the lowest air: 0 is not at all, 1 is fully mixed.

    1 on a mid-summer's afternoon up to 50 degrees of latitude, less towards 60 (snow). It follows
    the height of the sun, and decreases later after the warmest hour. 0 at night, in mid-winter,
    and where the mean local time ``hour`` [h] is None.

    >>> [round(mixed_share(0.8, 7.0, hour), 2) for hour in (3.0, 10.0, 15.0, 18.0)]
    [0.0, 0.26, 1.0, 1.0]
    """
    if hour is None:
        return 0.0
    summer = 0.5 - 0.5 * season(latitude_rad, month)
    sunny = max(0.0, math.cos(2.0 * math.pi * (hour - WARMEST_HOUR) / 24.0))
    mixed = sunny
    if hour > WARMEST_HOUR:
        mixed = min(1.0, _MIXED_IN_THE_EVENING * sunny)
    return summer * mixed * _at_latitude(_MIXED_BY_DEGREES, latitude_rad)


def inversions_of_season(reduced_m: Array, latitude_rad: float, month: float) -> Array:
    """(n,) amplitude of inversions over that in spring and summer, at reduced heights (n,) [m].

    >>> inversions_of_season(np.array([1000.0, 3000.0]), 0.8, 1.0).round(2).tolist()
    [1.35, 1.0]
    """
    cold = max(0.0, season(latitude_rad, month))
    cold *= _at_latitude(_WINTER_BY_DEGREES, latitude_rad)
    heights_m = list(_INVERSIONS_OF_WINTER)
    in_winter = np.interp(reduced_m, heights_m, list(_INVERSIONS_OF_WINTER.values()))
    return np.asarray(1.0 + cold * (in_winter - 1.0))


@dataclass(frozen=True)
class DailyCycle:
    """How the lowest 3 km differ from the Supplements 1966, by place, season and hour of the day.

    ``ground_h_m``: height of the ground [m above sea level].
    """

    latitude_rad: float
    month: float
    ground_h_m: float = 0.0

    def mean_k(self, h_m: Array) -> Array:
        """Mean of day and night minus the Supplements [K], at heights (n,) [m above sea level]."""
        return self._between("winter_k", "summer_k", h_m)

    def by_hour_k(self, h_m: Array) -> Array:
        """Amplitude of the day's cycle [K] at heights (n,) [m above sea level]."""
        return self._between("by_hour_winter_k", "by_hour_summer_k", h_m)

    def of_hour_k(self, h_m: Array, solar_hour: float | None) -> Array:
        """Temperature at a mean local time [h] minus the mean of day and night [K]; 0 for None.

        >>> cycle = DailyCycle(0.8, 7.0)
        >>> bool(cycle.of_hour_k(np.zeros(1), 14.0)[0] > 4.0)
        True
        """
        if solar_hour is None:
            return np.zeros(np.shape(h_m))
        phase = 2.0 * math.pi * (solar_hour - WARMEST_HOUR) / 24.0
        return self.by_hour_k(h_m) * math.cos(phase)

    def _between(self, winter: str, summer: str, h_m: Array) -> Array:
        """Values [K] between two tables, of mid-winter and mid-summer, at heights (n,) [m].

        ``winter``, ``summer``: names of the tables. Times the share of the latitude.
        """
        table = _tables()["daily"]
        winter_k = np.array(table[winter])
        summer_k = np.array(table[summer])
        winter_share = 0.5 + 0.5 * season(self.latitude_rad, self.month)
        values_k = winter_share * winter_k + (1.0 - winter_share) * summer_k
        above_ground_m = h_m - self.ground_h_m
        share = share_of_day(self.latitude_rad)
        return np.asarray(share * np.interp(above_ground_m, table["height_m"], values_k))


def solar_hour(time_ns: int | None, longitude_rad: float) -> float | None:
    """Mean local time [h] of a time [Unix ns] at a longitude; None where either is not known.

    >>> solar_hour(0, math.pi)
    12.0
    """
    if time_ns is None or not math.isfinite(longitude_rad):
        return None
    return (time_ns / 3.6e12 + longitude_rad / DEGREE / 15.0) % 24.0


@lru_cache(maxsize=1)
def _tables() -> Mapping[str, Any]:
    """The fitted numbers of ``data/air_variation.toml``."""
    text = resources.files("unbend.atmosphere").joinpath("data/air_variation.toml")
    return tomllib.loads(text.read_text(encoding="ascii"))
