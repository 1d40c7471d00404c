"""What soundings, weather stations and the climatology say, as readings for the estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.representativeness import (
    SPREAD_K,
    SPREAD_RH,
    TimeAndPlace,
    apart,
    unlikeness,
)
from pipeline.atmosphere.estimate.sensors import (
    SOUNDING_DEPARTURE,
    SOUNDING_HUMIDITY,
    Humidities,
    Pressures,
    Source,
    Temperatures,
)
from pipeline.atmosphere.estimate.state import TOP_M, Drift
from pipeline.atmosphere.refractive_index import enhancement_factor, saturation_vapour_pressure
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport

Array = NDArray[np.float64]

AT_ONCE_K, AT_ONCE_LENGTH_M, LATER_LENGTH_M = 1.2, 1500.0, 4000.0
"""How far the air of a sounding is from the flight's: 1.2 K at once (instrument, the way the
balloon drifted), and what age and distance add (see `nearness`), which correlates in height like
departures from the climatology. Judgement, not measured here."""

DEPARTURE_RH, DEPARTURE_RH_LENGTH_M = 0.15, 1000.0
DEPARTURE_STEP_M = 500.0

LEVEL_K, LEVEL_RH, LEVEL_LOG_P = 0.4, 0.04, 1e-3
"""Independent errors of a level of a sounding."""

WEATHER_LOG_P_PER_H, WEATHER_LOG_P_PER_M = 5e-4, 1.5e-8
"""Pressure changes by 0.5 hPa an hour, and by 1.5 hPa over 100 km: a wind of 12 m/s."""

STATION_K, STATION_RH, STATION_LOG_P = 1.5, 0.06, 5e-4
"""Two metres above the grass is not yet the free air; a station's pressure is good to 0.5 hPa."""

STATION_K2_PER_H = 2.0
"""Near the ground the day warms the air by some 5 K from dawn to noon, as in `windows`."""

THIN_M = 100.0
"""Levels of a sounding are averaged over this [m']."""

HUMIDITY_BELOW_M = 12_000.0


def of_the_sea(background: Climatology) -> list[Source]:
    """The climatology's pressure at sea level."""
    value = np.log(background.profile.pressure(np.zeros(1)))
    sigma = np.array([background.spread.pressure_ratio])
    return [Pressures("climatology", np.zeros(1), value, sigma, robust=False)]


def departures_of(
    soundings: Sequence[Sounding], background: Climatology, occasion: TimeAndPlace
) -> tuple[Drift, ...]:
    """How the air of each sounding departs from that of the flight, over its own heights."""
    gravity = background.profile.gravity
    found = []
    for i, sounding in enumerate(soundings):
        inside = _inside(sounding, background)
        if not bool(inside.any()):
            continue
        height = gravity.geopotential_height(sounding.h_m[inside])
        course = np.arange(height[0], height[-1] + DEPARTURE_STEP_M, DEPARTURE_STEP_M)
        more = unlikeness(*apart(sounding, occasion))
        later = SPREAD_K**2 * more
        variance = AT_ONCE_K**2 + later
        length = (AT_ONCE_K**2 * AT_ONCE_LENGTH_M + later * LATER_LENGTH_M) / variance
        humid = float(np.hypot(DEPARTURE_RH, SPREAD_RH * np.sqrt(more)))
        found += [
            Drift(f"{SOUNDING_DEPARTURE} {i}", course, float(np.sqrt(variance)), length),
            Drift(f"{SOUNDING_HUMIDITY} {i}", course, humid, DEPARTURE_RH_LENGTH_M),
        ]
    return tuple(found)


def _inside(sounding: Sounding, background: Climatology) -> NDArray[np.bool_]:
    """Levels where the background has air: a climatology ends at 30 km, a balloon at 35."""
    profile = background.profile
    top = min(TOP_M, profile.top_m - THIN_M)
    return np.asarray((sounding.h_m > profile.bottom_m + THIN_M) & (sounding.h_m < top))


def of_sounding(
    sounding: Sounding, number: int, background: Climatology, occasion: TimeAndPlace
) -> list[Source]:
    """Temperatures and humidities of a balloon, and its pressure at the lowest level.

    ``number`` is its place among the soundings, by which `departures_of` names its departure.
    """
    height = background.profile.gravity.geopotential_height(sounding.h_m)
    inside = _inside(sounding, background)
    if not bool(inside.any()):
        return []
    rh = _relative_humidity(
        sounding.vapour_pressure_pa, sounding.temperature_k, sounding.pressure_pa
    )
    name = sounding.name
    found: list[Source] = []
    h, t = _thinned(height[inside], sounding.temperature_k[inside])
    departure = f"{SOUNDING_DEPARTURE} {number}"
    found.append(Temperatures(name, h, t, np.full(h.size, LEVEL_K), departure))
    moist = inside & np.isfinite(rh) & (height < HUMIDITY_BELOW_M)
    if bool(moist.any()):
        h, u = _thinned(height[moist], rh[moist])
        departure = f"{SOUNDING_HUMIDITY} {number}"
        found.append(Humidities(name, h, u, np.full(h.size, LEVEL_RH), drift=departure))
    lowest = int(np.flatnonzero(inside)[0])
    level = np.log(sounding.pressure_pa[lowest : lowest + 1])
    hours, metres = apart(sounding, occasion)
    weather = np.hypot(WEATHER_LOG_P_PER_H * hours, WEATHER_LOG_P_PER_M * metres)
    sigma = np.array([float(np.hypot(LEVEL_LOG_P, weather))])
    found.append(Pressures(name, height[lowest : lowest + 1], level, sigma))
    return found


def of_report(
    report: SurfaceReport, background: Climatology, occasion: TimeAndPlace
) -> list[Source]:
    """What a station on the ground says of the air above it, less certain by its age."""
    height = background.profile.gravity.geopotential_height(np.array([report.h_m]))
    hours, _ = apart(report, occasion)
    name, pressure = report.name, report.pressure_pa
    found: list[Source] = []
    if np.isfinite(report.temperature_k):
        of_air = STATION_K**2 + report.sigma_temperature_k**2 + STATION_K2_PER_H * hours
        sigma = np.array([np.sqrt(of_air)])
        found.append(Temperatures(name, height, np.array([report.temperature_k]), sigma))
    if np.isfinite(pressure):
        instrument = np.hypot(STATION_LOG_P, report.sigma_pressure_pa / pressure)
        sigma = np.array([np.hypot(instrument, WEATHER_LOG_P_PER_H * hours)])
        found.append(Pressures(name, height, np.log([pressure]), sigma))
    else:
        pressure = float(background.profile.pressure(report.h_m))
    rh = _relative_humidity(report.vapour_pressure_pa, report.temperature_k, pressure)
    if bool(np.isfinite(rh)):
        sigma = np.array([np.hypot(STATION_RH, SPREAD_RH * np.sqrt(unlikeness(hours)))])
        found.append(Humidities(name, height, np.atleast_1d(rh), sigma))
    return found


def _relative_humidity(e: Array | float, t: Array | float, p: Array | float) -> Array:
    """Over water, between 0 and 1."""
    return np.clip(e / (enhancement_factor(t, p) * saturation_vapour_pressure(t)), 0.0, 1.0)


def _thinned(height: Array, value: Array) -> tuple[Array, Array]:
    """Means of levels in bins of 100 m'."""
    _, number = np.unique(np.floor(height / THIN_M), return_inverse=True)
    count = np.bincount(number)
    return np.bincount(number, height) / count, np.bincount(number, value) / count
