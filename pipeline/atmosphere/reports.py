"""What soundings, weather stations and the climatology say, as readings for the estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air import enhancement_factor, saturation_vapour_pressure
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.measurements import (
    SOUNDING_DEPARTURE,
    SOUNDING_HUMIDITY,
    Humidities,
    Pressures,
    Source,
    Temperatures,
)
from pipeline.atmosphere.metar import SurfaceReport
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.state import TOP_M, Drift

Array = NDArray[np.float64]

UNKNOWN_AGE_H = 6.0
"""Soundings are released every twelve hours [h]."""

AT_ONCE_K, GROWTH_K2_PER_H, DEPARTURE_LENGTH_M = 1.2, 0.3, 1500.0
"""How far the air of a sounding is from the flight's: 1.2 K at once (instrument, place), 2.9 K
after a day, near the spread of a climatology after three; judgement, not measured here."""

DEPARTURE_RH, DEPARTURE_RH_LENGTH_M = 0.15, 1000.0

LEVEL_K, LEVEL_RH, LEVEL_LOG_P, WEATHER_LOG_P_PER_H = 0.4, 0.04, 1e-3, 5e-4
"""Independent errors of a level of a sounding; its pressure ages by 0.5 hPa an hour."""

STATION_K, STATION_RH, STATION_LOG_P = 1.5, 0.06, 5e-4
"""Two metres above the grass is not yet the free air; a station's pressure is good to 0.5 hPa."""

THIN_M = 100.0
"""Levels of a sounding are averaged over this [m']."""

HUMIDITY_BELOW_M = 12_000.0


def of_the_sea(background: Climatology) -> list[Source]:
    """The climatology's pressure at sea level."""
    value = np.log(background.profile.pressure(np.zeros(1)))
    sigma = np.array([background.spread.pressure_ratio])
    return [Pressures("climatology", np.zeros(1), value, sigma)]


def departures_of(
    soundings: Sequence[Sounding], start_ns: int | None, low: float, high: float
) -> tuple[Drift, ...]:
    """How the air of soundings departs from that of the flight, between two heights [m']."""
    if not soundings:
        return ()
    age = max(_age_h(sounding, start_ns) for sounding in soundings)
    sigma = float(np.sqrt(AT_ONCE_K**2 + GROWTH_K2_PER_H * age))
    course = np.arange(low, high + 500.0, 500.0)
    return (
        Drift(SOUNDING_DEPARTURE, course, sigma, DEPARTURE_LENGTH_M),
        Drift(SOUNDING_HUMIDITY, course, DEPARTURE_RH, DEPARTURE_RH_LENGTH_M),
    )


def _age_h(sounding: Sounding, start_ns: int | None) -> float:
    """Hours between a sounding and the flight."""
    if start_ns is None or sounding.time_ns is None:
        return UNKNOWN_AGE_H
    return abs(start_ns - sounding.time_ns) / 3.6e12


def of_sounding(sounding: Sounding, background: Climatology, start_ns: int | None) -> list[Source]:
    """Temperatures and humidities of a balloon, and its pressure at the lowest level."""
    gravity = background.profile.gravity
    height = gravity.geopotential_height(sounding.h_m)
    inside = (sounding.h_m > background.profile.bottom_m) & (sounding.h_m < TOP_M)
    rh = _relative_humidity(
        sounding.vapour_pressure_pa, sounding.temperature_k, sounding.pressure_pa
    )
    name = f"sounding {sounding.station}".strip()
    found: list[Source] = []
    h, t = _thinned(height[inside], sounding.temperature_k[inside])
    found.append(Temperatures(name, h, t, np.full(h.size, LEVEL_K), SOUNDING_DEPARTURE))
    moist = inside & np.isfinite(rh) & (height < HUMIDITY_BELOW_M)
    if bool(moist.any()):
        h, u = _thinned(height[moist], rh[moist])
        found.append(Humidities(name, h, u, np.full(h.size, LEVEL_RH), drift=SOUNDING_HUMIDITY))
    lowest = int(np.flatnonzero(inside)[0])
    level = np.log(sounding.pressure_pa[lowest : lowest + 1])
    age = _age_h(sounding, start_ns)
    sigma = np.array([float(np.hypot(LEVEL_LOG_P, WEATHER_LOG_P_PER_H * age))])
    found.append(Pressures(name, height[lowest : lowest + 1], level, sigma))
    return found


def of_report(report: SurfaceReport, background: Climatology) -> list[Source]:
    """What a station on the ground says of the air above it."""
    height = background.profile.gravity.geopotential_height(np.array([report.h_m]))
    name = f"surface report {report.origin}".strip()
    found: list[Source] = []
    if np.isfinite(report.temperature_k):
        found.append(
            Temperatures(name, height, np.array([report.temperature_k]), np.array([STATION_K]))
        )
    if np.isfinite(report.pressure_pa):
        found.append(
            Pressures(name, height, np.log([report.pressure_pa]), np.array([STATION_LOG_P]))
        )
    pressure = report.pressure_pa
    if not np.isfinite(pressure):
        pressure = float(background.profile.pressure(report.h_m))
    rh = _relative_humidity(report.vapour_pressure_pa, report.temperature_k, pressure)
    if bool(np.isfinite(rh)):
        found.append(Humidities(name, height, np.atleast_1d(rh), np.array([STATION_RH])))
    return found


def _relative_humidity(e: Array | float, t: Array | float, p: Array | float) -> Array:
    """Over water, between 0 and 1."""
    return np.clip(e / (enhancement_factor(t, p) * saturation_vapour_pressure(t)), 0.0, 1.0)


def _thinned(height: Array, value: Array) -> tuple[Array, Array]:
    """Means of levels in bins of 100 m'."""
    _, number = np.unique(np.floor(height / THIN_M), return_inverse=True)
    count = np.bincount(number)
    return np.bincount(number, height) / count, np.bincount(number, value) / count
