"""Soundings and weather stations as readings, weighted by their age and distance.

How much the air changes in that time and over that distance follows from its structure function
(`atmosphere.air_variation`). A sounding departs from the air of the flight by a profile; the
covariance of this profile with the air and with other soundings is part of the prior
(`state.prior_of`). The sigmas of stations here are those of their surroundings; those of rounding
and sensor are in `surface_report`.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere.air_variation import SPRING, changes, sigma_of, solar_hour, variation_parts
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import messages, sensors
from unbend.atmosphere.estimate.knots import TOP_M
from unbend.atmosphere.estimate.state import Departure, Drift, Separation, exponential
from unbend.atmosphere.refractive_index import enhancement_factor, saturation_vapour_pressure
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Message
from unbend.units import Array, Mask

HUMIDITY_MEMORY_H = 18.0
HUMIDITY_REACH_M = 3e5
"""Time and distance in which the correlation of relative humidity falls to 1/e. Over Vienna it
changes by 0.15, 0.3 and 0.3 in 12 hours at 0.1, 2 and 5 km, in a day by little more."""
MOST_HUMIDITY_GROWTH = 9.0  # largest added variance: then a reading weighs a tenth

ROUGHER = 2.0  # factor of a distance across a coast or a ridge

WARN_SOUNDING_M = 200e3  # a sounding from farther away is reported
WARNED_HEIGHT_M = 3000.0  # height for which the report states what the distance changes

USELESS_AFTER_H = 192.0
USELESS_BEYOND_M = 1.8e6
"""Age and distance from which on a source has no more information than the climatology; less of
both together (`reason_uninformative`)."""

UNDATED_SOUNDING_H = 6.0
UNDATED_REPORT_H = 3.0
UNPLACED_M = 100e3
"""Age and distance where unknown: soundings are released every twelve hours, stations are near."""

WARN_REPORT_H = 3.0  # a surface report from longer before or after is reported
WARN_SOUNDING_H = 6.0  # a sounding farther in time is reported: the boundary layer has changed

_EARTH_M = 6.371e6

DEPARTURE_STEP_M = 500.0
DEPARTURE_NEAR_GROUND_M = (0.0, 50.0, 100.0, 200.0, 350.0, 500.0, 750.0, 1000.0, 1250.0)
"""Knots of a departure: nearer above the lowest level, where the day and inversions change it."""

LEVEL_K = 0.4  # independent errors of a level of a sounding
LEVEL_RH = 0.04

WEATHER_LOG_P_PER_H = 5e-4  # 0.5 hPa an hour
WEATHER_LOG_P_PER_M = 1.5e-8  # a wind of 12 m/s
STATION_K = 1.5
STATION_RH = 0.06
STATION_LOG_P = 5e-4
"""One sigma between 2 m above grass and the free air; a station's pressure is good to 0.5 hPa."""

THIN_M = 100.0  # levels of a sounding are averaged over this [m']

HUMIDITY_BELOW_M = 12_000.0  # humidities of a sounding above are not used [m']


@dataclass(frozen=True)
class TimeAndPlace:
    """When [Unix ns] and where [rad] a flight or a sounding was; None and NaN where unknown.

    ``doubt``: for messages on sources that are far in time, the words that the time may be wrong;
    empty for a time that was logged, or that a source confirms.
    """

    time_ns: int | None = None
    latitude_rad: float = math.nan
    longitude_rad: float = math.nan
    doubt: str = ""

    def hours_from(self, time_ns: int | None) -> float:
        """Hours between this and another time [Unix ns], not negative; NaN where either is unknown.

        >>> TimeAndPlace(3_600_000_000_000).hours_from(0)
        1.0
        """
        if self.time_ns is None or time_ns is None:
            return math.nan
        return abs(self.time_ns - time_ns) / 3.6e12

    def metres_from(self, latitude_rad: float, longitude_rad: float) -> float:
        """Great-circle distance to another place [m]; NaN where any coordinate is unknown.

        >>> round(TimeAndPlace(None, 0.0, 0.0).metres_from(0.0, 0.1))
        637100
        """
        north = latitude_rad - self.latitude_rad
        east = longitude_rad - self.longitude_rad
        if not math.isfinite(north + east):
            return math.nan
        cosines = math.cos(latitude_rad) * math.cos(self.latitude_rad)
        haversine = math.sin(0.5 * north) ** 2 + cosines * math.sin(0.5 * east) ** 2
        return 2.0 * _EARTH_M * math.asin(math.sqrt(min(haversine, 1.0)))


def hours_and_metres(source: Sounding | SurfaceReport, flight: TimeAndPlace) -> tuple[float, float]:
    """Hours and metres between a source and the flight, assumed ones where they are not known.

    The metres are doubled across a coast or a ridge.
    """
    if isinstance(source, Sounding):
        undated_h = UNDATED_SOUNDING_H
        metres = _metres_to_sounding(source, flight)
    else:
        undated_h = UNDATED_REPORT_H
        metres = source.distance_m
    metres *= ROUGHER if source.across else 1.0
    hours = flight.hours_from(source.time_ns)
    if not math.isfinite(hours):
        hours = undated_h
    return hours, metres


def _metres_to_sounding(sounding: Sounding, flight: TimeAndPlace) -> float:
    """Distance of a sounding [m]; where unknown 100 km, or more if the latitudes differ by more."""
    metres = flight.metres_from(sounding.latitude_rad, sounding.longitude_rad)
    if math.isfinite(metres):
        return metres
    along_meridian = _EARTH_M * abs(sounding.latitude_rad - flight.latitude_rad)
    return max(UNPLACED_M, float(np.nan_to_num(along_meridian)))


def reason_uninformative(source: Sounding | SurfaceReport, flight: TimeAndPlace) -> str | None:
    """Why a source is too old or too far away to be used, in words; None if it can be used.

    >>> reason_uninformative(SurfaceReport(0.0, 1e5, 280.0, 800.0, time_ns=0), TimeAndPlace(10**15))
    'it is 278 hours from the flight: the climatology is as accurate'
    """
    hours, metres = hours_and_metres(source, flight)
    lost_by_age = hours / USELESS_AFTER_H  # shares of the information, 1 if it has none
    lost_by_distance = (metres / USELESS_BEYOND_M) ** 2
    if lost_by_age + lost_by_distance <= 1.0:
        return None
    metres /= ROUGHER if source.across else 1.0
    away = f"{hours:.0f} hours and {metres / 1e3:.0f} km"
    if lost_by_age > 1.0:
        away = f"{hours:.0f} hours"
    elif lost_by_distance > 1.0:
        away = f"{metres / 1e3:.0f} km"
    return messages.too_far_from_flight(away=away)


def pressure_sources(
    sources: Iterable[Sounding | SurfaceReport], flight: TimeAndPlace
) -> list[str]:
    """The names of the sources that have a pressure, with their distances where these are known.

    >>> report = SurfaceReport(432.0, 97_000.0, 290.0, 1200.0, origin="METAR LSZH", distance_m=9e3)
    >>> pressure_sources([report], TimeAndPlace())
    ['surface report METAR LSZH (9 km from the flight)']
    """
    described = []
    for source in sources:
        if isinstance(source, Sounding):
            metres = flight.metres_from(source.latitude_rad, source.longitude_rad)
        elif math.isfinite(source.pressure_pa):
            metres = source.distance_m
        else:
            continue
        name = source.name
        if math.isfinite(metres):
            name = f"{name} ({metres / 1e3:.0f} km from the flight)"
        described.append(name)
    return described


def distance_notes(
    soundings: Sequence[Sounding], surface: Sequence[SurfaceReport], flight: TimeAndPlace
) -> Iterator[Message]:
    """Messages on sources without time or place, from far away or hours away.

    None on the hours of a source that is not used (`reason_uninformative`): it has its own message.
    """
    for sounding in soundings:
        yield from _notes_of_sounding(sounding, flight)
    for report in surface:
        yield from _notes_of_report(report, flight)


def _notes_of_sounding(sounding: Sounding, flight: TimeAndPlace) -> Iterator[Message]:
    """Messages that a sounding has no time or place, or is from far away or from another time."""
    name = sounding.name
    if sounding.time_ns is None:
        yield messages.sounding_undated(where=name, hours=UNDATED_SOUNDING_H)
    hours = flight.hours_from(sounding.time_ns)
    if hours > WARN_SOUNDING_H and reason_uninformative(sounding, flight) is None:
        yield messages.sounding_far_in_time(where=name, hours=hours, doubt=flight.doubt)
    metres = flight.metres_from(sounding.latitude_rad, sounding.longitude_rad)
    if not math.isfinite(metres) and math.isfinite(flight.latitude_rad):
        yield messages.sounding_unplaced(where=name, km=UNPLACED_M / 1e3)
    if metres > WARN_SOUNDING_M:
        consequence = "it has no information on its air"
        if metres <= USELESS_BEYOND_M:
            parts = variation_parts(flight.latitude_rad, SPRING, ground_h_m=0.0)
            change = changes(parts, 0.0, metres)
            kelvin = sigma_of(change, np.array([WARNED_HEIGHT_M]))[0]
            consequence = f"temperatures are {kelvin:.1f} K less certain because of this"
        yield messages.sounding_far_away(where=name, km=metres / 1e3, consequence=consequence)


def _notes_of_report(report: SurfaceReport, flight: TimeAndPlace) -> Iterator[Message]:
    """Messages that a surface report has no time, or is hours away from the flight."""
    if report.time_ns is None:
        yield messages.surface_undated(where=report.name, hours=UNDATED_REPORT_H)
    hours = flight.hours_from(report.time_ns)
    is_far = hours > WARN_REPORT_H and reason_uninformative(report, flight) is None
    if is_far and report.is_metar:
        yield messages.metar_far_in_time(where=report.name, hours=hours, doubt=flight.doubt)
    elif is_far:
        yield messages.surface_far_in_time(where=report.name, hours=hours, doubt=flight.doubt)


def sounding_departures(
    soundings: Sequence[Sounding], background: Climatology, flight: TimeAndPlace
) -> tuple[Departure, ...]:
    """The departures of each sounding's temperatures from those of the flight, in their order.

    None for a sounding without a level inside the background.
    """
    used = {}
    for number, sounding in enumerate(soundings):
        if bool(_inside(sounding, background).any()):
            used[departure_name(number)] = sounding
    departures = []
    for name, sounding in used.items():
        from_others = {}
        for other_name, other in used.items():
            if other_name != name:
                from_others[other_name] = separation(sounding, other, flight)
        departure = departure_of(
            sounding, name, background, flight, from_other_soundings=from_others
        )
        departures.append(departure)
    return tuple(departures)


def departure_of(
    sounding: Sounding,
    name: str,
    background: Climatology,
    flight: TimeAndPlace,
    *,
    from_other_soundings: Mapping[str, Separation],
) -> Departure:
    """Prior of how temperatures of a sounding or model column depart from those of the flight.

    ``name``: of the departure. ``from_other_soundings``: separations of this column from the
    others, by the names of their departures.
    """
    gravity = background.profile.gravity
    levels = gravity.geopotential_height(sounding.h_m)
    knots = _departure_knots(levels[_inside(sounding, background)])
    h = gravity.height(knots)
    hour = solar_hour(sounding.time_ns, _longitude(sounding, flight))
    sigma_at_levels_k = np.broadcast_to(sounding.errors.temperature_k, levels.shape)
    sigma_k = np.interp(knots, levels, sigma_at_levels_k)
    correlation = exponential(knots, sounding.errors.temperature_length_m)
    hour_k = unknown_hour_k(background, hour, h)
    errors = np.outer(sigma_k, sigma_k) * correlation + np.outer(hour_k, hour_k)
    return Departure(
        name=name,
        knot=knots,
        expected_k=-background.warming_since(hour, h),
        parts=background.parts_at(hour),
        errors=errors,
        from_flight=Separation(*hours_and_metres(sounding, flight)),
        from_other_soundings=from_other_soundings,
    )


def unknown_hour_k(background: Climatology, hour: float | None, h: Array) -> Array:
    """One sigma [K] at heights (n,) [m] by the unknown hour of the day of a source.

    0 where the mean local time ``hour`` [h] of the source is known. 0 too where that of the flight
    is unknown, because then the day's cycle is part of the spread of the background.
    """
    if hour is not None or background.daily is None or background.hour is None:
        return np.zeros(h.shape)
    return background.daily.by_hour_k(h)


def departure_name(number: int) -> str:
    """The name of the temperature departure of sounding number ``number`` in the mission."""
    return f"{sensors.SOUNDING_DEPARTURE} {number}"


def separation(sounding: Sounding, other: Sounding, flight: TimeAndPlace) -> Separation:
    """Hours and metres between two soundings; where unknown, the sum of both from the flight."""
    hours, metres = hours_and_metres(sounding, flight)
    other_hours, other_metres = hours_and_metres(other, flight)
    released = TimeAndPlace(sounding.time_ns, sounding.latitude_rad, sounding.longitude_rad)
    between_h = released.hours_from(other.time_ns)
    between_m = released.metres_from(other.latitude_rad, other.longitude_rad)
    if sounding.across or other.across:
        between_m *= ROUGHER
    return Separation(
        hours=between_h if math.isfinite(between_h) else hours + other_hours,
        metres=between_m if math.isfinite(between_m) else metres + other_metres,
    )


def humidity_drifts(
    soundings: Sequence[Sounding], background: Climatology, flight: TimeAndPlace
) -> tuple[Drift, ...]:
    """The departures of each sounding's relative humidities from those of the flight.

    None for a sounding without a level inside the background.
    """
    gravity = background.profile.gravity
    drifts = []
    for i, sounding in enumerate(soundings):
        inside = _inside(sounding, background)
        if not bool(inside.any()):
            continue
        levels = gravity.geopotential_height(sounding.h_m)
        height = levels[inside]
        knots = np.arange(height[0], height[-1] + DEPARTURE_STEP_M, DEPARTURE_STEP_M)
        sigma_at_levels = np.broadcast_to(sounding.errors.relative_humidity, levels.shape)
        sigma_of_errors = np.interp(knots, levels, sigma_at_levels)
        sigma_of_climate = background.spread.sigma_relative_humidity(gravity.height(knots))
        growth = humidity_growth(*hours_and_metres(sounding, flight))
        sigma_of_change = sigma_of_climate * math.sqrt(growth)
        drift = Drift(
            name=f"{sensors.SOUNDING_HUMIDITY} {i}",
            knot=knots,
            sigma=np.hypot(sigma_of_errors, sigma_of_change),
            length=sounding.errors.humidity_length_m,
        )
        drifts.append(drift)
    return tuple(drifts)


def humidity_growth(hours: float, metres: float) -> float:
    """Variance that a reading of humidity gains by age and distance, over that of the climatology.

    It is 1/rho^2 - 1 for the correlation rho over the time and distance: with this error variance
    (in units of the climatology's) a reading gets the weight rho^2.

    >>> [round(humidity_growth(hours, 0.0), 2) for hours in (0.0, 3.0, 24.0)]
    [0.0, 0.4, 9.0]
    """
    exponent = 2.0 * (hours / HUMIDITY_MEMORY_H + metres / HUMIDITY_REACH_M)
    growth = math.expm1(min(exponent, MOST_HUMIDITY_GROWTH))
    return min(growth, MOST_HUMIDITY_GROWTH)


def _departure_knots(height: Array) -> Array:
    """Knots of a departure [m'], from the lowest to the highest of increasing heights [m']."""
    near = height[0] + np.array(DEPARTURE_NEAR_GROUND_M)
    first = near[-1] + DEPARTURE_STEP_M
    stop = height[-1] + DEPARTURE_STEP_M
    above = np.arange(first, stop, DEPARTURE_STEP_M)
    return np.concatenate([near, above])


def _longitude(source: Sounding, flight: TimeAndPlace) -> float:
    """Longitude of a sounding [rad]; that of the flight where it is unknown."""
    if math.isfinite(source.longitude_rad):
        return source.longitude_rad
    return flight.longitude_rad


def _inside(sounding: Sounding, background: Climatology) -> Mask:
    """Which levels of a sounding are inside the background, which may end below the balloon."""
    profile = background.profile
    top = min(TOP_M, profile.top_m - THIN_M)
    is_above_bottom = sounding.h_m > profile.bottom_m + THIN_M
    return np.asarray(is_above_bottom & (sounding.h_m < top))


def sounding_readings(
    sounding: Sounding, number: int, background: Climatology, flight: TimeAndPlace
) -> list[sensors.Readings]:
    """Temperatures and humidities of a balloon, and its pressure at the lowest level.

    ``number``: of the sounding in the mission, for the name of its departure. Empty where no level
    is inside the background.
    """
    height = background.profile.gravity.geopotential_height(sounding.h_m)
    inside = _inside(sounding, background)
    if not bool(inside.any()):
        return []
    temperature_height, mean_k = _thinned(height[inside], sounding.temperature_k[inside])
    temperatures = sensors.Temperatures(
        sounding.name,
        temperature_height,
        mean_k,
        np.full(mean_k.size, LEVEL_K),
        departure_name(number),
    )
    readings: list[sensors.Readings] = [temperatures]
    rh = _relative_humidity(
        sounding.vapour_pressure_pa, sounding.temperature_k, sounding.pressure_pa
    )
    is_moist = inside & np.isfinite(rh) & (height < HUMIDITY_BELOW_M)
    if bool(is_moist.any()):
        humidity_height, mean_rh = _thinned(height[is_moist], rh[is_moist])
        humidities = sensors.Humidities(
            sounding.name,
            humidity_height,
            mean_rh,
            np.full(mean_rh.size, LEVEL_RH),
            drift=f"{sensors.SOUNDING_HUMIDITY} {number}",
        )
        readings.append(humidities)
    lowest = np.flatnonzero(inside)[:1]  # an array of one row
    weather = _weather_log_p(*hours_and_metres(sounding, flight))
    sigma = float(np.hypot(sounding.errors.log_pressure, weather))
    pressure = sensors.Pressures(
        sounding.name,
        height[lowest],
        np.log(sounding.pressure_pa[lowest]),
        np.array([sigma]),
    )
    readings.append(pressure)
    return readings


def _weather_log_p(hours: float, metres: float) -> float:
    """One sigma of the change of ln p at a height in some hours and over some metres."""
    return float(np.hypot(WEATHER_LOG_P_PER_H * hours, WEATHER_LOG_P_PER_M * metres))


def surface_readings(
    report: SurfaceReport, background: Climatology, flight: TimeAndPlace
) -> list[sensors.Readings]:
    """Temperature, pressure and humidity of a station, as far as it has them.

    Their sigmas grow with age and distance.
    """
    height = background.profile.gravity.geopotential_height(np.array([report.h_m]))
    hours, metres = hours_and_metres(report, flight)
    name = report.name
    readings: list[sensors.Readings] = []
    if np.isfinite(report.temperature_k):
        readings.append(surface_temperature(report, background, flight))
    pressure_pa = report.pressure_pa  # the background's where the report has none
    if np.isfinite(pressure_pa):
        instrument = np.hypot(STATION_LOG_P, report.sigma_pressure_pa / pressure_pa)
        weather = _weather_log_p(hours, report.distance_m)
        sigma = np.array([np.hypot(instrument, weather)])
        log_pressure = np.log([pressure_pa])
        readings.append(sensors.Pressures(name, height, log_pressure, sigma))
    else:
        pressure_pa = float(background.profile.pressure(report.h_m))
    rh = _relative_humidity(report.vapour_pressure_pa, report.temperature_k, pressure_pa)
    if bool(np.isfinite(rh)):
        sigma_of_climate = background.spread.sigma_relative_humidity(report.h_m)
        sigma_of_change = sigma_of_climate * math.sqrt(humidity_growth(hours, metres))
        sigma = np.atleast_1d(np.hypot(STATION_RH, sigma_of_change))
        readings.append(sensors.Humidities(name, height, np.atleast_1d(rh), sigma))
    return readings


def surface_temperature(
    report: SurfaceReport, background: Climatology, flight: TimeAndPlace
) -> sensors.Temperatures:
    """The temperature of a station, corrected to the hour of the flight by the day's cycle."""
    h = np.array([report.h_m])
    hour = solar_hour(report.time_ns, flight.longitude_rad)
    corrected_k = report.temperature_k + background.warming_since(hour, h)
    change = changes(background.spread.parts, *hours_and_metres(report, flight))
    instrument_k = np.hypot(STATION_K, report.sigma_temperature_k)
    change_k = np.hypot(sigma_of(change, h), unknown_hour_k(background, hour, h))
    return sensors.Temperatures(
        report.name,
        background.profile.gravity.geopotential_height(h),
        corrected_k,
        np.hypot(instrument_k, change_k),
    )


def _relative_humidity(e: Array | float, t: Array | float, p: Array | float) -> Array:
    """Relative humidity over water, 0 to 1, from vapour pressure [Pa], T [K] and pressure [Pa]."""
    saturated = enhancement_factor(t, p) * saturation_vapour_pressure(t)
    return np.clip(e / saturated, 0.0, 1.0)


def _thinned(height: Array, value: Array) -> tuple[Array, Array]:
    """Means of heights and values in bins of 100 m', from the ground up."""
    _, bin_of = np.unique(np.floor(height / THIN_M), return_inverse=True)
    count = np.bincount(bin_of)
    mean_height = np.bincount(bin_of, height) / count
    mean_value = np.bincount(bin_of, value) / count
    return mean_height, mean_value
