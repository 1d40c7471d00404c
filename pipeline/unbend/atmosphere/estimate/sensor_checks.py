"""Sensor checks: known biases are subtracted, then sensors are checked by physics."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from unbend.atmosphere.air_samples import BIN_M, AirSamples, SensorSamples, bin_by_height
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import messages
from unbend.atmosphere.estimate.hypotheses import IN_A_BAY, LIKELY
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS, SensorSettings
from unbend.atmosphere.estimate.solver import Estimate, FaultEstimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.hypsometry import Fall, fall_of_pressure
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason
from unbend.messages import Kind, Message, Notes
from unbend.units import HECTOPASCAL, Mask

CLIMB_TO_COMPARE_M = 200.0  # over less height the fall of pressure shows nothing [m]

STUCK_M, FEWEST_STUCK = 300.0, 5
"""A sensor with so many equal readings over so much height is stuck [m]."""

SLOWEST = {"temperature": 2e-3, "pressure": 5.0, "humidity": 1e-4}
"""Change a metre that coarse steps may hide: a thermometer that reports whole degrees may read the
same over 800 m of isothermal air [K/m, Pa/m, 1/m]."""

DRY, MOIST = 0.02, 0.97  # beyond these relative humidities a constant reading is plausible

UNLIKELY_SIGMAS, IMPOSSIBLE_SIGMAS = 5.0, 10.0
"""Departures of pressure at sea level from the climatology, whose sigma is about 1 %."""

CONTRADICTED = 4.0
"""Sigmas between a calibration and the estimate from the flight, at which one must be wrong."""

UNEXPECTED = 2.0
"""Expected sigmas, and one of its own, beyond which an error that nobody stated is a warning."""

LOST_SHARE, LOST_SIGMAS = 0.01, 3.0
"""A static pressure that loses more of its change than this, by so many sigmas, is a warning."""

_MISSION_KEY = "atmosphere.sensors"
_LEARNT = 0.7  # of the usual sigma: an estimate that gained less is no evidence
_READINGS = {
    SensorFault.THERMOMETER_BIAS: "temperature",
    SensorFault.PRESSURE_OFFSET: "pressure",
    SensorFault.HYGROMETER_BIAS: "humidity",
}


def subtract_known_biases(
    samples: AirSamples, settings: SensorSettings
) -> tuple[tuple[AirSamples, SensorSettings], Notes]:
    """Samples without the known biases, before any check, and settings in which these are 0; the
    report lists what remains, for example 0.3 K after 12.0 K were subtracted."""
    corrected, rest, texts = {}, dict(settings.calibration), []
    for fault, sensor in _READINGS.items():
        known, readings = rest.get(fault), getattr(samples, sensor)
        if known is None or not known.mean or readings is None:
            continue
        corrected[sensor] = replace(readings, value=readings.value - known.mean)
        rest[fault] = replace(known, mean=0.0, subtracted=known.mean)
        texts.append(f"{FAULT_TEXTS[fault]} of {readings.name} {known.mean:g}")
    entry = messages.air_calibrated(where=_MISSION_KEY, count=len(texts), biases="; ".join(texts))
    result = replace(samples, **corrected), replace(settings, calibration=rest)
    return result, (entry,) if texts else ()


def check_calibration(
    made: Estimate, settings: SensorSettings, estimated: Callable[[SensorSettings], Estimate]
) -> Notes:
    """A stated calibration that the flight contradicts, those that are not used, and errors that
    nobody stated and no working sensor has.

    Each stated value is compared with an estimate without it, in which the other sensors have their
    usual errors: a rare fault would explain a wrong calibration away. One wrong value makes others
    seem wrong, so only the worst is named.
    """
    mean = {fault.name: fault.mean for fault in made.readings.faults}
    worst, notes, large = CONTRADICTED, [], []
    for fault in made.faults:
        name, known = fault.fault, settings.calibration.get(fault.fault)
        if known is None:
            limit = UNEXPECTED * fault.prior_sigma + fault.sigma
            if name == SensorFault.PRESSURE_SCALE:
                limit = max(LOST_SHARE, LOST_SIGMAS * fault.sigma)
            if abs(fault.value - mean[name]) > limit:
                large.append(described_fault(fault))
            continue
        others = {n: value for n, value in settings.calibration.items() if n != name}
        usual = name != SensorFault.PRESSURE_SCALE
        free = estimated(replace(settings, calibration=others, usual_errors_only=usual))
        flown = next(other for other in free.faults if other.fault == name)
        sigmas = abs(flown.value - mean[name]) / math.hypot(flown.sigma, fault.prior_sigma)
        if flown.sigma < _LEARNT * flown.prior_sigma and sigmas > worst:
            worst = sigmas
            notes = [
                messages.air_calibration(
                    where=known.path,
                    fault=FAULT_TEXTS[name],
                    sigmas=sigmas,
                    stated=mean[name] + known.subtracted,
                    prior=fault.prior_sigma,
                    flown=flown.value + known.subtracted,
                    sigma=flown.sigma,
                )
            ]
    if large:
        notes.append(messages.air_sensors_large(count=len(large), faults="; ".join(large)))
    drifts = {drift.name for drift in made.readings.drifts}
    return *notes, *unused_calibration(set(settings.calibration) - set(mean) - drifts)


def described_fault(estimated: FaultEstimate) -> str:
    """A sensor fault with its sigma, for the ledger."""
    f = estimated.in_units()
    digits = max(1 - math.floor(math.log10(f.sigma)), 0)
    return f"{FAULT_TEXTS[f.fault]} {f.value:.{digits}f} ± {f.sigma:.{digits}f}"


def unused_calibration(faults: set[SensorFault]) -> Notes:
    """What is reported of stated calibrations of faults that no sensor in use has."""
    if not faults:
        return ()
    names = sorted(FAULT_TEXTS[fault] for fault in faults)
    unused = messages.calibration_unused(
        where=_MISSION_KEY, count=len(faults), faults=", ".join(names)
    )
    return (unused,)


def usable_sensors(samples: AirSamples, standard: Profile) -> tuple[AirSamples, Notes]:
    """The samples without sensors that contradict physics: readings must not stay the same during a
    climb, and pressure must fall with GNSS height as it does in air of 180 to 335 K."""
    notes: list[Message] = []
    kept: dict[str, Any] = {}
    for name, sensor in samples.sensors.items():
        if not bool((stuck := _stuck(sensor, name)).any()):
            continue
        value, extent = sensor.value[stuck][0], np.ptp(sensor.h_m[stuck])
        if name == "pressure":
            kept[name] = None
            notes.append(_indoors(sensor, f"stays at {value:.0f} Pa"))
            continue
        rest = sensor.reject(stuck, Reason.STUCK)
        kept[name] = rest if bool(rest.accepted.any()) else None
        notes.append(
            messages.air_stuck(
                where=sensor.name,
                count=int(stuck.sum()),
                value=value,
                extent=extent,
                total=int(sensor.accepted.sum()),
            )
        )
    samples = replace(samples, **kept)
    pressure, gravity = samples.pressure, standard.gravity
    if pressure is None or pressure.extent_m < CLIMB_TO_COMPARE_M:
        return samples, tuple(notes)
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(pressure.value) - np.log(standard.pressure(pressure.h_m))
    at = gravity.geopotential_height(pressure.h_m)
    height, middle = bin_by_height(at, pressure, BIN_M, departure)
    log_p = middle + np.log(standard.pressure(gravity.height(height)))
    fall = fall_of_pressure(height, log_p) if height.size >= 3 else Fall(None, 0.0)
    if not fall.is_of_air:
        implied = fall.implied_k
        what = "does not fall with height" if implied is None else f"implies {implied:.0f} K"
        notes.append(_indoors(pressure, what))
        samples = replace(samples, pressure=None)
    return samples, tuple(notes)


def _indoors(pressure: SensorSamples, what: str) -> Message:
    extent = pressure.extent_m
    return messages.air_not_outside(where=pressure.name, what_is_odd=what, extent=extent)


def maybe_in_a_bay(made: Estimate, samples: AirSamples) -> Notes:
    """A warning where a thermometer is more likely in a bay, or indoors, than outside."""
    chance = made.chances.get(IN_A_BAY.name, 0.0)
    temperature = samples.temperature
    if temperature is None or chance < LIKELY:
        return ()
    message = messages.air_isothermal(
        where=temperature.name,
        extent=temperature.extent_m,
        percent=100.0 * chance,
    )
    return (message,)


def _stuck(sensor: SensorSamples, name: str) -> Mask:
    """Which readings belong to a run of equal ones over more height than the steps explain."""
    stuck = np.zeros(sensor.value.size, dtype=bool)
    rows = np.flatnonzero(sensor.accepted)
    h, value = sensor.used()
    if rows.size < FEWEST_STUCK:
        return stuck
    start = np.concatenate([[0], 1 + np.flatnonzero(value[1:] != value[:-1])])
    count = np.diff(start, append=rows.size)
    extent = np.maximum.reduceat(h, start) - np.minimum.reduceat(h, start)
    long = (extent >= STUCK_M) & (count >= FEWEST_STUCK)
    if name == "humidity":
        long &= (value[start] > DRY) & (value[start] < MOIST)
    if bool(long.any()):
        steps = np.diff(np.unique(value))
        long &= extent >= STUCK_M + (float(steps.min()) / SLOWEST[name] if steps.size else 0.0)
    stuck[rows] = np.repeat(long, count)
    return stuck


def pressure_level(
    profile: Profile, background: Climatology, pressure: SensorSamples | None
) -> Message:
    """The residuals of the measured pressures, and whether their level is plausible: at sea level
    within 5 sigma of the climatology's (about 50 hPa; the deepest lows reach 6); 10 sigma, a tenth
    of the pressure, are no weather."""
    if pressure is None or not bool(pressure.accepted.any()):
        return messages.air_no_barometer()
    h, measured = pressure.used()
    residual = np.abs(measured - profile.pressure(h)) / HECTOPASCAL
    at_sea = float(profile.pressure(0.0))
    departure = np.log(at_sea / float(background.profile.pressure(0.0)))
    sigmas = abs(float(departure)) / background.spread.pressure_ratio
    kind = Kind.NOTE
    if sigmas > UNLIKELY_SIGMAS:
        kind = Kind.WARNING
    if sigmas > IMPOSSIBLE_SIGMAS:
        kind = Kind.LOSS
    return messages.air_anchor(
        kind=kind,
        where=pressure.name,
        count=int(measured.size),
        sigmas=sigmas,
        median=float(np.nanmedian(residual)),
        largest=np.nanmax(residual),
        at_sea=at_sea / HECTOPASCAL,
    )
