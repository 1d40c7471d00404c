"""Soundings, weather stations and the climatology as readings, weighted by their age and distance.

After a time t and over a distance d the air's departure from its climatology correlates by
rho = exp(-t/tau - max(d/(tau v), (d/L)^2/2)) with what it was. An old or far reading with an error
of variance s^2 (1/rho^2 - 1), where s is the spread of the climatology, has the weight rho^2.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import messages, sensors
from unbend.atmosphere.estimate.state import TOP_M, Drift
from unbend.atmosphere.refractive_index import enhancement_factor, saturation_vapour_pressure
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Message
from unbend.units import Array, Mask

SPREAD_K, SPREAD_RH = 5.0, 0.3  # of the climatology in the free troposphere

MEMORY_H = 167.0
"""tau: the variance of temperature grows by 0.3 K2 an hour, 0.95 K in three hours, 2.9 K in a day.
Sun et al. 2010 (J. Geophys. Res. 115, D23104) find 0.35 K per 3 h in the free troposphere, linear
up to 6 h: 2.8 K in a day. Two pairs of ascents over Barrow differ by 1.0 to 2.3 K in 12 hours."""

METRES_PER_H, MEMORY_M = 1e5 / 3.0, 1.19e6
"""v: 100 km are as 3 h, 0.95 K (the same paper, which holds for 250 km and from 850 to 200 hPa); L:
from 500 km on, where the climate changes too."""

LOW_PA, ROUGHER = 85_000.0, 2.0
"""In the air below 850 hPa, and across a coast or a ridge, a distance counts so many times."""

FAR_M = 200e3  # a sounding from farther away is reported: its temperatures are 1.4 K less certain

MOST_GROWTH = 9.0
"""A reading whose variance is that many times the climatology's weighs a tenth: after 8 days, or
1800 km. It is left out."""

UNDATED_SOUNDING_H, UNDATED_REPORT_H, UNPLACED_M = 6.0, 3.0, 100e3
"""Assumed where unknown: soundings are released every twelve hours, stations are near."""

FAR_REPORT_H = 3.0  # a surface report from longer before or after is reported

_EARTH_M = 6.371e6
_MOST_EXPONENT = 50.0  # exp of it is finite, and far beyond MOST_GROWTH

LATER_LENGTH_M = 4000.0
"""What age and distance add to the errors of a column (see `variance_growth`) correlates in height
like departures from the climatology."""

DEPARTURE_STEP_M = 500.0

LEVEL_K, LEVEL_RH = 0.4, 0.04  # independent errors of a level of a sounding

WEATHER_LOG_P_PER_H, WEATHER_LOG_P_PER_M = 5e-4, 1.5e-8  # 0.5 hPa an hour; a wind of 12 m/s
STATION_K, STATION_RH, STATION_LOG_P = 1.5, 0.06, 5e-4
"""Two metres above the grass is not yet the free air; a station's pressure is good to 0.5 hPa."""

STATION_K2_PER_H = 2.0
"""Near the ground the day warms the air by some 5 K from dawn to noon, as in `series`."""

THIN_M = 100.0  # levels of a sounding are averaged over this [m']

HUMIDITY_BELOW_M = 12_000.0


@dataclass(frozen=True)
class TimeAndPlace:
    """When [Unix ns] and where [rad] a flight was; None and NaN where unknown."""

    time_ns: int | None = None
    latitude_rad: float = math.nan
    longitude_rad: float = math.nan

    def hours_from(self, time_ns: int | None) -> float:
        """Hours to another time, NaN where either is not known.

        >>> TimeAndPlace(3_600_000_000_000).hours_from(0)
        1.0
        """
        if self.time_ns is None or time_ns is None:
            return math.nan
        return abs(self.time_ns - time_ns) / 3.6e12

    def metres_from(self, latitude_rad: float, longitude_rad: float) -> float:
        """Great-circle distance [m]; NaN where a coordinate of either is not known.

        >>> round(TimeAndPlace(None, 0.0, 0.0).metres_from(0.0, 0.1))
        637100
        """
        north, east = latitude_rad - self.latitude_rad, longitude_rad - self.longitude_rad
        if not math.isfinite(north + east):
            return math.nan
        squeezed = math.cos(latitude_rad) * math.cos(self.latitude_rad)
        half_chord = math.sin(0.5 * north) ** 2 + squeezed * math.sin(0.5 * east) ** 2
        return 2.0 * _EARTH_M * math.asin(math.sqrt(min(half_chord, 1.0)))


def variance_growth(hours: float, metres: float = 0.0) -> float:
    """1/rho^2 - 1: variance of the change of the air, over that of the climatology.

    >>> [round(SPREAD_K * variance_growth(*d) ** 0.5, 2) for d in ((3.0, 0.0), (0.0, 1e5))]
    [0.96, 0.96]
    """
    of_distance = max(2.0 * metres / (METRES_PER_H * MEMORY_H), (metres / MEMORY_M) ** 2)
    exponent = 2.0 * hours / MEMORY_H + of_distance
    return math.expm1(min(exponent, _MOST_EXPONENT))


def hours_and_metres(source: Sounding | SurfaceReport, flight: TimeAndPlace) -> tuple[float, float]:
    """Hours and metres between a source and the flight, as assumed where they are not known; twice
    the metres across a coast or a ridge."""
    hours = flight.hours_from(source.time_ns)
    if isinstance(source, Sounding):
        undated_h = UNDATED_SOUNDING_H
        metres = flight.metres_from(source.latitude_rad, source.longitude_rad)
        if not math.isfinite(metres):  # a latitude alone tells how far it is at least
            along_meridian = _EARTH_M * abs(source.latitude_rad - flight.latitude_rad)
            metres = max(UNPLACED_M, float(np.nan_to_num(along_meridian)))
    else:
        undated_h, metres = UNDATED_REPORT_H, source.distance_m
    metres *= ROUGHER if source.across else 1.0
    return hours if math.isfinite(hours) else undated_h, metres


def reason_uninformative(source: Sounding | SurfaceReport, flight: TimeAndPlace) -> str | None:
    """Why a source is too old or too far away to be used, in words; None where it can be.

    >>> reason_uninformative(SurfaceReport(0.0, 1e5, 280.0, 800.0, time_ns=0), TimeAndPlace(10**15))
    'it is 278 hours from the flight: the climatology is as accurate'
    """
    hours, metres = hours_and_metres(source, flight)
    if variance_growth(hours, metres) <= MOST_GROWTH:
        return None
    metres /= ROUGHER if source.across else 1.0
    old, far = f"{hours:.0f} hours", f"{metres / 1e3:.0f} km"
    away = f"{old} and {far}"
    if variance_growth(hours) > MOST_GROWTH:
        away = old
    elif variance_growth(0.0, metres) > MOST_GROWTH:
        away = far
    return f"it is {away} from the flight: the climatology is as accurate"


def distance_notes(
    soundings: Sequence[Sounding], surface: Sequence[SurfaceReport], flight: TimeAndPlace
) -> Iterator[Message]:
    """Sources without time or place, soundings from far away and reports hours away."""
    for sounding in soundings:
        name = sounding.name
        if sounding.time_ns is None:
            yield messages.sounding_undated(where=name, hours=UNDATED_SOUNDING_H)
        metres = flight.metres_from(sounding.latitude_rad, sounding.longitude_rad)
        if not math.isfinite(metres) and math.isfinite(flight.latitude_rad):
            yield messages.sounding_unplaced(where=name, km=UNPLACED_M / 1e3)
        if metres > FAR_M:
            growth = variance_growth(0.0, metres)
            worth = f"temperatures are {SPREAD_K * math.sqrt(growth):.1f} K less certain for that"
            worth = worth if growth <= MOST_GROWTH else "it has no information on its air"
            yield messages.sounding_far_away(where=name, km=metres / 1e3, worth=worth)
    for report in surface:
        hours = flight.hours_from(report.time_ns)
        if report.time_ns is None:
            yield messages.surface_undated(where=report.name, hours=UNDATED_REPORT_H)
        if hours > FAR_REPORT_H and report.is_metar:
            yield messages.metar_far_in_time(where=report.name, hours=hours)
        elif hours > FAR_REPORT_H:
            yield messages.surface_far_in_time(where=report.name, hours=hours)


def sounding_departures(
    soundings: Sequence[Sounding], background: Climatology, flight: TimeAndPlace
) -> tuple[Drift, ...]:
    """How the air of each column departs from that of the flight, over its own heights."""
    gravity = background.profile.gravity
    departures: list[Drift] = []
    for i, sounding in enumerate(soundings):
        inside = _inside(sounding, background)
        if not bool(inside.any()):
            continue
        errors, levels = sounding.errors, gravity.geopotential_height(sounding.h_m)
        height = levels[inside]
        knots = np.arange(height[0], height[-1] + DEPARTURE_STEP_M, DEPARTURE_STEP_M)
        own_k, own_rh = (
            np.interp(knots, levels, np.broadcast_to(sigma, levels.shape))
            for sigma in (errors.temperature_k, errors.relative_humidity)
        )
        hours, metres = hours_and_metres(sounding, flight)
        low = background.profile.pressure(gravity.height(knots)) > LOW_PA
        growth = np.where(
            low, variance_growth(hours, ROUGHER * metres), variance_growth(hours, metres)
        )
        own, later = own_k**2, SPREAD_K**2 * growth
        share = float(np.mean(own) / np.mean(own + later))
        length = share * errors.temperature_length_m + (1.0 - share) * LATER_LENGTH_M
        humid = np.hypot(own_rh, SPREAD_RH * np.sqrt(growth))
        departures += [
            Drift(f"{sensors.SOUNDING_DEPARTURE} {i}", knots, np.sqrt(own + later), length),
            Drift(f"{sensors.SOUNDING_HUMIDITY} {i}", knots, humid, errors.humidity_length_m),
        ]
    return tuple(departures)


def _inside(sounding: Sounding, background: Climatology) -> Mask:
    """Levels where the background has air: a climatology ends at 30 km, a balloon at 35."""
    profile = background.profile
    top = min(TOP_M, profile.top_m - THIN_M)
    return np.asarray((sounding.h_m > profile.bottom_m + THIN_M) & (sounding.h_m < top))


def sounding_readings(
    sounding: Sounding, number: int, background: Climatology, flight: TimeAndPlace
) -> list[sensors.Readings]:
    """Temperatures and humidities of a balloon, and its pressure at the lowest level; ``number`` is
    its place among the soundings, which names its departure."""
    height = background.profile.gravity.geopotential_height(sounding.h_m)
    inside = _inside(sounding, background)
    if not bool(inside.any()):
        return []
    e, t, p = sounding.vapour_pressure_pa, sounding.temperature_k, sounding.pressure_pa
    rh, name = _relative_humidity(e, t, p), sounding.name
    h, mean_t = _thinned(height[inside], t[inside])
    departure, sigma = f"{sensors.SOUNDING_DEPARTURE} {number}", np.full(h.size, LEVEL_K)
    readings: list[sensors.Readings] = [sensors.Temperatures(name, h, mean_t, sigma, departure)]
    moist = inside & np.isfinite(rh) & (height < HUMIDITY_BELOW_M)
    if bool(moist.any()):
        h, u = _thinned(height[moist], rh[moist])
        departure = f"{sensors.SOUNDING_HUMIDITY} {number}"
        readings.append(sensors.Humidities(name, h, u, np.full(h.size, LEVEL_RH), drift=departure))
    lowest = np.flatnonzero(inside)[:1]
    hours, metres = hours_and_metres(sounding, flight)
    weather = np.hypot(WEATHER_LOG_P_PER_H * hours, WEATHER_LOG_P_PER_M * metres)
    sigma = np.array([float(np.hypot(sounding.errors.log_pressure, weather))])
    readings.append(sensors.Pressures(name, height[lowest], np.log(p[lowest]), sigma))
    return readings


def surface_readings(
    report: SurfaceReport, background: Climatology, flight: TimeAndPlace
) -> list[sensors.Readings]:
    """Temperature, pressure and humidity of a station, less certain by its age and distance."""
    height = background.profile.gravity.geopotential_height(np.array([report.h_m]))
    hours, metres = hours_and_metres(report, flight)
    if float(background.profile.pressure(report.h_m)) > LOW_PA:
        metres *= ROUGHER
    name, pressure = report.name, report.pressure_pa
    readings: list[sensors.Readings] = []
    if np.isfinite(t := report.temperature_k):
        of_air = STATION_K**2 + report.sigma_temperature_k**2 + STATION_K2_PER_H * hours
        of_air += SPREAD_K**2 * variance_growth(0.0, metres)
        sigma = np.array([np.sqrt(of_air)])
        readings.append(sensors.Temperatures(name, height, np.array([t]), sigma))
    if np.isfinite(pressure):
        instrument = np.hypot(STATION_LOG_P, report.sigma_pressure_pa / pressure)
        weather = np.hypot(WEATHER_LOG_P_PER_H * hours, WEATHER_LOG_P_PER_M * report.distance_m)
        sigma = np.array([np.hypot(instrument, weather)])
        readings.append(sensors.Pressures(name, height, np.log([pressure]), sigma))
    else:
        pressure = float(background.profile.pressure(report.h_m))
    rh = _relative_humidity(report.vapour_pressure_pa, t, pressure)
    if bool(np.isfinite(rh)):
        growth = variance_growth(hours, metres)
        sigma = np.array([np.hypot(STATION_RH, SPREAD_RH * np.sqrt(growth))])
        readings.append(sensors.Humidities(name, height, np.atleast_1d(rh), sigma))
    return readings


def _relative_humidity(e: Array | float, t: Array | float, p: Array | float) -> Array:
    """Over water, between 0 and 1."""
    return np.clip(e / (enhancement_factor(t, p) * saturation_vapour_pressure(t)), 0.0, 1.0)


def _thinned(height: Array, value: Array) -> tuple[Array, Array]:
    """Means of levels in bins of 100 m'."""
    _, number = np.unique(np.floor(height / THIN_M), return_inverse=True)
    count = np.bincount(number)
    return np.bincount(number, height) / count, np.bincount(number, value) / count
