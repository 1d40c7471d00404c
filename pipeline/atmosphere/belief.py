"""Which sensors of the air outside are believed: physics, and one sensor against another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.hypsometry import Fall, fall_of_pressure
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.samples import BIN_M, AirSamples, Samples, bin_by_height
from pipeline.ledger import Ledger
from pipeline.units import HECTOPASCAL

LARGEST_DISAGREEMENT_K = 8.0
"""Thermometer against barometer and GNSS, mean over the common heights: more is a wrong sensor."""

CLIMB_TO_COMPARE_M = 1000.0
"""... but over less height than this the comparison itself is no better [m]."""

UNLIKELY_SIGMAS, IMPOSSIBLE_SIGMAS = 5.0, 10.0
"""Departures of pressure at sea level from the climatology, whose sigma is about 1 %."""


def believable(samples: AirSamples, standard: Profile, ledger: Ledger) -> AirSamples:
    """The samples without the sensors that contradict physics, or one another.

    Pressure must fall with GNSS height as it does in air of 180 to 335 K; a thermometer must agree
    with the temperature that this implies, or it measures something else (a board, the cabin).
    """
    temperature, pressure = samples.temperature, samples.pressure
    if pressure is None or pressure.extent_m < CLIMB_TO_COMPARE_M:
        return samples
    fall = _fall(pressure, standard)
    if fall is None or not fall.is_of_air:
        implied = None if fall is None else fall.implied_k
        found = "does not fall with height" if implied is None else f"implies {implied:.0f} K"
        ledger.loss(
            "AIR-NOT-OUTSIDE",
            f"the pressure of {pressure.name} {found} over {pressure.extent_m:.0f} m of GNSS "
            "height: it is not that of the air outside and is not used",
            where=pressure.name,
        )
        return replace(samples, pressure=None)
    excess = _excess_over_pressure(temperature, pressure, standard)
    if temperature is None or excess is None or samples.board_temperature:
        return samples
    if abs(excess) <= LARGEST_DISAGREEMENT_K:
        return samples
    ledger.loss(
        "AIR-THERMOMETER",
        f"{temperature.name} reads {excess:+.1f} K against what {pressure.name} and GNSS height "
        "imply: it does not measure the air outside and is not used",
        where=temperature.name,
    )
    return replace(samples, temperature=None)


def _fall(pressure: Samples, standard: Profile) -> Fall | None:
    """How pressure falls, by medians in bins of height; None where there are too few."""
    geopotential = standard.gravity.geopotential_height(pressure.h_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(pressure.value) - np.log(standard.pressure(pressure.h_m))
    height, middle = bin_by_height(geopotential, pressure, BIN_M, departure)
    if height.size < 3:
        return None
    log_p = middle + np.log(standard.pressure(standard.gravity.height(height)))
    return fall_of_pressure(height, log_p)


def _excess_over_pressure(
    temperature: Samples | None, pressure: Samples, standard: Profile
) -> float | None:
    """Mean excess [K] of a thermometer over what pressure implies for the same heights."""
    if temperature is None or temperature.extent_m < CLIMB_TO_COMPARE_M:
        return None
    low, high = np.min(temperature.used()[0]), np.max(temperature.used()[0])
    with np.errstate(invalid="ignore"):
        common = pressure.accepted & (pressure.h_m >= low) & (pressure.h_m <= high)
    beside = replace(pressure, accepted=common)
    if beside.extent_m < CLIMB_TO_COMPARE_M:
        return None
    fall = _fall(beside, standard)
    geopotential = standard.gravity.geopotential_height(temperature.h_m)
    _, binned = bin_by_height(geopotential, temperature, BIN_M)
    if fall is None or fall.implied_k is None or binned.size == 0:
        return None
    return float(np.mean(binned)) - fall.implied_k


def judge_level(
    profile: Profile, background: Climatology, pressure: Samples | None, ledger: Ledger
) -> None:
    """Say how well the profile carries the measured pressures, and whether their level can be.

    Pressure reduced to sea level must lie within 5 sigma of the climatology's (about 50 hPa; the
    deepest lows reach 6); a tenth of the pressure is no weather.
    """
    if pressure is None or not bool(pressure.accepted.any()):
        ledger.fallback(
            "AIR-NO-BAROMETER",
            "no static pressure outside: its level is that of a sounding, a station or the "
            "climatology",
        )
        return
    h, measured = pressure.used()
    residual = np.abs(measured - profile.pressure(h))
    at_sea = float(profile.pressure(0.0))
    departure = np.log(at_sea / float(background.profile.pressure(0.0)))
    sigmas = abs(float(departure)) / background.spread.pressure_ratio
    what = (
        f"pressure anchored to {pressure.name}: residuals of "
        f"{float(np.nanmedian(residual)) / HECTOPASCAL:.2f} hPa in the median, "
        f"{np.nanmax(residual) / HECTOPASCAL:.2f} hPa at most; {at_sea / HECTOPASCAL:.0f} hPa at "
        "sea level"
    )
    tell = ledger.note
    if sigmas > IMPOSSIBLE_SIGMAS:
        tell = ledger.loss
        what += f", {sigmas:.0f} sigma from the climatology: the barometer or its unit is wrong"
    elif sigmas > UNLIKELY_SIGMAS:
        tell = ledger.warning
        what += f", {sigmas:.0f} sigma from the climatology"
    tell("AIR-ANCHOR", what, where=pressure.name, count=int(measured.size))
