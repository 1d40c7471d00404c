"""Which sensors of the air outside are believed: physics, and one sensor against another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.atmosphere.hypsometry import COLDEST_K, WARMEST_K, implied_temperature
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.samples import BIN_M, AirSamples, Samples, bin_by_height
from pipeline.ledger import Ledger
from pipeline.units import HECTOPASCAL

LARGEST_DISAGREEMENT_K = 8.0
"""Thermometer against barometer and GNSS, mean over the common heights: more is a wrong sensor."""

CLIMB_TO_COMPARE_M = 1000.0
"""... but over less height than this the comparison itself is no better [m]."""

ANCHOR_WARNING_PA, ANCHOR_LOSS_PA = 150.0, 500.0
"""Residuals of the barometer against the profile that a sound pair of sensors does not reach."""


def believable(samples: AirSamples, standard: Profile, ledger: Ledger) -> AirSamples:
    """The samples without the sensors that contradict physics, or one another.

    Pressure must fall with GNSS height as it does in air of 180 to 335 K; a thermometer must agree
    with the temperature that this implies, or it measures something else (a board, the cabin).
    """
    temperature, pressure = samples.temperature, samples.pressure
    if pressure is None or pressure.extent_m < CLIMB_TO_COMPARE_M:
        return samples
    implied = implied_temperature(pressure, standard)
    if implied is None or not COLDEST_K < implied < WARMEST_K:
        found = "does not fall with height" if implied is None else f"implies {implied:.0f} K"
        ledger.loss(
            "AIR-NOT-OUTSIDE",
            f"the pressure of {pressure.name} {found} over {pressure.extent_m:.0f} m of GNSS "
            "height: it is not that of the air outside and is not used",
            where=pressure.name,
        )
        return replace(samples, pressure=None)
    excess = _excess_over_pressure(temperature, pressure, standard)
    if temperature is None or excess is None or abs(excess) <= LARGEST_DISAGREEMENT_K:
        return samples
    ledger.loss(
        "AIR-THERMOMETER",
        f"{temperature.name} reads {excess:+.1f} K against what {pressure.name} and GNSS height "
        "imply: it does not measure the air outside and is not used",
        where=temperature.name,
    )
    return replace(samples, temperature=None)


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
    implied = implied_temperature(beside, standard)
    geopotential = standard.gravity.geopotential_height(temperature.h_m)
    _, binned = bin_by_height(geopotential, temperature, BIN_M)
    return None if implied is None or binned.size == 0 else float(np.mean(binned)) - implied


def judge_anchor(profile: Profile, pressure: Samples | None, ledger: Ledger) -> None:
    """Say how well the measured pressures agree with the profile through the temperatures."""
    if pressure is None or not bool(pressure.accepted.any()):
        ledger.fallback(
            "AIR-NO-BAROMETER",
            "no static pressure outside: the profile keeps the standard's pressure at sea level",
        )
        return
    h, measured = pressure.used()
    residual = np.abs(measured - profile.pressure(h))
    middle = float(np.nanmedian(residual))
    what = (
        f"pressure anchored to {pressure.name}: residuals of {middle / HECTOPASCAL:.2f} hPa in the "
        f"median, {np.nanmax(residual) / HECTOPASCAL:.2f} hPa at most"
    )
    tell = ledger.note
    if middle > ANCHOR_LOSS_PA:
        tell = ledger.loss
        what += ": temperature and pressure cannot both be those of the air outside"
    elif middle > ANCHOR_WARNING_PA:
        tell = ledger.warning
        what += ": the sensors outside disagree"
    tell("AIR-ANCHOR", what, where=pressure.name, count=int(measured.size))
