"""The expected air without any measurement, by one of `standard.ATMOSPHERES`, and its spread.

The spread is that of air about the default climatology; for another atmosphere, its difference from
the default is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.atmosphere.air_variation import (
    CYCLE_LENGTH_M,
    CYCLE_MEMORY_H,
    SPRING,
    DailyCycle,
    Part,
    Parts,
    larger_part,
    sigma_of,
    variation_parts,
)
from unbend.atmosphere.climate_tables import SUPPLEMENTS, season
from unbend.atmosphere.layers import STANDARD, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel, saturation_vapour_pressure
from unbend.atmosphere.standard import ATMOSPHERES, AUTO, SeasonAndPlace, known_names
from unbend.units import DEGREE, Array

HUMIDITY_CORRELATION_M = 1000.0

_EXTREME_MONTHS = (1.0, 7.0)
_SPREAD_TOP_M = 30_000.0
_SPREAD_STEP_M = 250.0
_DRY_ABOVE_M = 12_000.0  # above, all humidities weigh less than 1e-4 of n - 1
_DAILY_TO_M = 3000.0  # above the ground, which the day warms [m]
_DAILY_STEP_M = 50.0
_OTHER_TABLE_LENGTH_M = 5000.0  # correlation in height of the difference of two tables [m]


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the air of one day is from a climatology.

    ``parts``: of the departure of temperature, independent of each other. ``relative_humidity``
    (k,): one sigma of relative humidity over water (0 to 1) at increasing heights ``h_m`` (k,)
    above sea level, linear between and constant beyond; it correlates as
    exp(-dh / ``humidity_correlation_m``) over heights dh. ``pressure_ratio``: one sigma of ln p at
    sea level.
    """

    parts: Parts
    h_m: Array
    relative_humidity: Array
    humidity_correlation_m: float
    pressure_ratio: float

    def sigma_temperature(self, h: ArrayLike) -> Array:
        """One sigma of temperature [K] at heights ``h`` [m above sea level]."""
        return sigma_of(self.parts, np.asarray(h, np.float64))

    def sigma_relative_humidity(self, h: ArrayLike) -> Array:
        """One sigma of relative humidity (0 to 1) at heights ``h`` [m above sea level]."""
        return np.interp(np.asarray(h, np.float64), self.h_m, self.relative_humidity)

    def with_difference(self, profile: Profile, expected: Profile) -> Spread:
        """The spread about ``profile``, where this spread is about the ``expected`` profile.

        The difference of the profiles is added, in temperature as one more part.
        """
        inside = (self.h_m <= profile.top_m) & (self.h_m <= expected.top_m)
        h = self.h_m[inside]
        warmer_k = profile.temperature(h) - expected.temperature(h)
        other_table = Part("other table", h, warmer_k, _OTHER_TABLE_LENGTH_M)

        saturated = saturation_vapour_pressure(expected.temperature(h))
        moister_pa = profile.vapour_pressure(h) - expected.vapour_pressure(h)
        moister_rh = np.where(h < _DRY_ABOVE_M, moister_pa / saturated, 0.0)
        log_ratio = float(np.log(profile.pressure(0.0) / expected.pressure(0.0)))
        return Spread(
            parts=(*self.parts, other_table),
            h_m=h,
            relative_humidity=np.hypot(self.relative_humidity[inside], moister_rh),
            humidity_correlation_m=self.humidity_correlation_m,
            pressure_ratio=math.hypot(self.pressure_ratio, log_ratio),
        )


@dataclass(frozen=True, eq=False)
class Climatology:
    """The expected profile, its spread, and its ``origin``, in words.

    ``has_humidity``: False if the profile is dry because its model has no water. ``daily``: the
    cycle of the day at its place and season. ``hour``: mean local time of the profile [h], None if
    unknown.
    """

    profile: Profile
    spread: Spread
    origin: str
    has_humidity: bool
    daily: DailyCycle | None = None
    hour: float | None = None

    def warming_since(self, hour: float | None, h: Array) -> Array:
        """Warming by the day's cycle [K] from mean local time ``hour`` [h] to that of the profile.

        At heights ``h`` (n,) [m above sea level]; 0 where either time is unknown.
        """
        if self.daily is None or self.hour is None or hour is None:
            return np.zeros(h.shape)
        return self.daily.of_hour_k(h, self.hour) - self.daily.of_hour_k(h, hour)

    def parts_at(self, hour: float | None) -> Parts:
        """The parts of the spread with the amplitudes of another mean local time [h].

        The parts of the profile's own time where either time is unknown.
        """
        if self.daily is None or self.hour is None or hour is None:
            return self.spread.parts
        daily = self.daily
        of_hour = variation_parts(daily.latitude_rad, daily.month, daily.ground_h_m, hour)
        return (*of_hour, *self.spread.parts[len(of_hour) :])

    def relative_humidity(self, h: ArrayLike) -> Array:
        """Expected relative humidity over water (0 to 1) at heights ``h`` [m above sea level]."""
        saturated = saturation_vapour_pressure(self.profile.temperature(h))
        return self.profile.vapour_pressure(h) / saturated

    def sigma_log_pressure(self, h_m: float) -> float:
        """One sigma of ln p at a height [m above sea level].

        That at sea level, and 2 % of the fall of ln p from there.
        """
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
    hour: float | None = None,
) -> Climatology:
    """The air to expect at a place, season and hour of the day, with its spread.

    ``name``: one of `known_names`; ``auto`` is the Supplements 1966 by latitude and season, with
    the lowest 3 km corrected by public ascents and the hour of the day. ``latitude_rad``: north
    positive; gives gravity too. ``month``: 1.0 is mid-January, 7.0 mid-July, None where the date is
    unknown; see `month_of`. ``ground_h_m``: of the ground [m above sea level], where the boundary
    layer begins. ``longitude_rad``: used by NRLMSIS only. ``hour``: mean local time [h], see
    `air_variation.solar_hour`; without it, or without a month, the mean of day and night is
    expected, and the day's cycle is part of the spread.

    Raises ``PhysicsError`` where the name is unknown, the latitude is beyond the pole, or the
    package behind NRLMSIS is not installed.

    >>> air = climatology(latitude_rad=0.8, month=7.0)
    >>> [round(float(t), 1) for t in (air.profile.temperature(0), air.spread.sigma_temperature(0))]
    [297.8, 6.7]
    """
    model = ATMOSPHERES.get(name)
    if model is None:
        raise messages.unknown_climatology(name=name, names=", ".join(known_names()))
    index = index or IndexModel()
    if month is None:
        hour = None
    month_or_spring = SPRING if month is None else month
    place = SeasonAndPlace(latitude_rad, month_or_spring, longitude_rad)
    daily = DailyCycle(latitude_rad, place.month, ground_h_m)
    expected = _expected_profile(place, daily, hour, index)
    if month is None:
        spread = _spread_over_the_year(place, ground_h_m, index)
    else:
        spread = expected_spread(latitude_rad, month, ground_h_m, hour)
    if model is ATMOSPHERES[SUPPLEMENTS]:
        profile = expected
        origin = f"{model.origin}; the lowest 3 km by the hour of the day, from public ascents"
    else:
        profile = model.profile(place, index)
        spread = spread.with_difference(profile, expected)
        origin = model.origin
    return Climatology(
        profile=profile,
        spread=spread,
        origin=origin,
        has_humidity=model.has_humidity,
        daily=daily,
        hour=hour,
    )


def _expected_profile(
    place: SeasonAndPlace, daily: DailyCycle, hour: float | None, index: IndexModel
) -> Profile:
    """The Supplements 1966, with temperatures of the lowest 3 km corrected by ``daily``.

    Vapour, and pressure at the ground, are those of the tables. ``hour``: mean local time [h], None
    for the mean of day and night.
    """
    profile = ATMOSPHERES[SUPPLEMENTS].profile(place, index)
    gravity = profile.gravity
    above_ground = np.arange(0.0, _DAILY_TO_M + 1.0, _DAILY_STEP_M)
    added = gravity.geopotential_height(daily.ground_h_m + above_ground)
    inner = profile.layers.edge[1:-1]
    is_apart = np.min(np.abs(inner[:, None] - added), axis=1) > 1.0
    edge = np.unique(np.concatenate([profile.layers.edge[[0, -1]], inner[is_apart], added]))
    h = gravity.height(edge)
    t_m, _, vapour = profile.state(h)
    warmer = daily.mean_k(h) + daily.of_hour_k(h, hour)
    layers = stack_layers(
        edge,
        t_m + warmer,
        vapour,
        (STANDARD,) * (edge.size - 1),
        anchor=(float(added[0]), float(profile.pressure(daily.ground_h_m))),
        constant=profile.constant,
    )
    return replace(profile, layers=layers)


def _spread_over_the_year(place: SeasonAndPlace, ground_h_m: float, index: IndexModel) -> Spread:
    """The spread about the middle of the year, for a flight of unknown date.

    ``place.month`` is that of spring, the middle. To the spread of mid-winter, and of mid-summer,
    the difference of that season's profile from the middle one is added as one sigma. The larger of
    both is taken, part by part and height by height, so that flights of either season are covered.
    """
    latitude_rad = place.latitude_rad or 0.0
    middle_day = DailyCycle(latitude_rad, place.month, ground_h_m)
    middle = _expected_profile(place, middle_day, None, index)
    spreads = []
    for month in _EXTREME_MONTHS:
        daily = DailyCycle(latitude_rad, month, ground_h_m)
        extreme = _expected_profile(replace(place, month=month), daily, None, index)
        of_season = expected_spread(latitude_rad, month, ground_h_m)
        spreads.append(of_season.with_difference(extreme, middle))
    winter, summer = spreads
    return replace(
        winter,
        parts=tuple(map(larger_part, winter.parts, summer.parts)),
        relative_humidity=np.maximum(winter.relative_humidity, summer.relative_humidity),
        pressure_ratio=max(winter.pressure_ratio, summer.pressure_ratio),
    )


def month_of(time_ns: int | None) -> float | None:
    """The month of a time [Unix ns] as a number for `climatology`; 1.0 is 15 January.

    None without a time, because no season may be assumed.

    >>> round(month_of(1_310_688_000 * 10**9), 2), month_of(None)  # 15 July 2011
    (6.95, None)
    """
    if time_ns is None:
        return None
    day = np.datetime64(int(time_ns), "ns").astype("datetime64[D]")
    into = float((day - day.astype("datetime64[Y]")).astype(np.float64))
    return (into - 14.0) / 365.25 * 12.0 + 1.0


def expected_spread(
    latitude_rad: float, month: float, ground_h_m: float = 0.0, hour: float | None = None
) -> Spread:
    """One sigma of a day's air about the climatology at the same latitude and season.

    Temperature: the parts of `air_variation`, fitted to public ascents; without an ``hour`` (mean
    local time [h]) the day's cycle too. Relative humidity: 0.30 from 1 to 10 km above the ground,
    0.15 at the ground and above 13 km. Pressure at sea level: 0.6 % in the tropics, 1.0 % in middle
    latitudes, 1.3 % in their winter.
    """
    degrees = abs(latitude_rad) / DEGREE
    winter = 0.5 + 0.5 * season(latitude_rad, month)
    from_tropics = float(np.interp(degrees, [15.0, 50.0], [0.0, 1.0]))
    h = np.arange(0.0, _SPREAD_TOP_M + 1.0, _SPREAD_STEP_M)
    parts = variation_parts(latitude_rad, month, ground_h_m, hour)
    if hour is None:
        cycle = DailyCycle(latitude_rad, month, ground_h_m).by_hour_k(parts[0].h_m)
        hour_k = cycle / math.sqrt(2.0)  # RMS of a cosine
        parts = (
            *parts,
            Part("hour", parts[0].h_m, hour_k, CYCLE_LENGTH_M, memory_h=CYCLE_MEMORY_H),
        )
    above_ground = np.maximum(h - ground_h_m, 0.0)
    humidity = np.interp(above_ground, [0.0, 1000.0, 10_000.0, 13_000.0], [0.15, 0.3, 0.3, 0.15])
    sigma_log_p = 0.006 + from_tropics * (0.004 + 0.003 * winter)
    return Spread(parts, h, humidity, HUMIDITY_CORRELATION_M, sigma_log_p)
