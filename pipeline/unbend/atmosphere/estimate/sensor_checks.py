"""Checks of a flight's sensors, before and after the estimate; stated biases are subtracted."""

import math
from collections.abc import Callable, Sequence
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

STUCK_M = 300.0  # equal readings over so much height are of a sensor that is stuck [m]
FEWEST_STUCK = 5  # if there are so many

SLOWEST_CHANGE = {"temperature": 2e-3, "pressure": 5.0, "humidity": 1e-4}
"""Change with height that the resolution of a sensor may hide [K/m, Pa/m, 1/m]: a thermometer that
reports whole degrees may read the same over 800 m of isothermal air, 500 m more than `STUCK_M`."""

# Beyond these relative humidities a constant reading is plausible.
DRY = 0.02
MOIST = 0.97

# Departures of pressure at sea level from the climatology, whose sigma is about 1 %.
UNLIKELY_SIGMAS = 5.0  # about 50 hPa; the deepest lows reach 6
IMPOSSIBLE_SIGMAS = 10.0  # a tenth of the pressure is no weather

CONTRADICTED = 4.0
"""Sigmas between a calibration and the estimate from the flight, at which one must be wrong."""

UNEXPECTED = 2.0
"""An estimated error without a stated calibration is a warning if it is larger than so many of its
prior sigmas and one sigma of the estimate."""

LOST_SHARE = 0.01  # a static pressure that loses a larger share of its change is a warning
LOST_SIGMAS = 3.0  # if the share is also larger than so many of its sigmas

_MISSION_KEY = "atmosphere.sensors"
_LEARNT = 0.7  # of the prior sigma: an estimate with a larger sigma is not evidence
_QUANTITY_OF_BIAS = {
    SensorFault.THERMOMETER_BIAS: "temperature",
    SensorFault.PRESSURE_OFFSET: "pressure",
    SensorFault.HYGROMETER_BIAS: "humidity",
}


def subtract_known_biases(
    samples: AirSamples,
    settings: SensorSettings,
) -> tuple[tuple[AirSamples, SensorSettings], Notes]:
    """Samples from which the stated biases are subtracted, and settings in which these are 0.

    This is done before any check. The report lists the bias that the flight shows after this, for
    example 0.3 K after 12.0 K were subtracted.
    """
    corrected: dict[str, Any] = {}
    calibration = dict(settings.calibration)
    texts = []
    for fault, quantity in _QUANTITY_OF_BIAS.items():
        stated_bias = calibration.get(fault)
        sensor = samples.sensors.get(quantity)
        if stated_bias is None or not stated_bias.mean or sensor is None:
            continue
        corrected[quantity] = replace(sensor, value=sensor.value - stated_bias.mean)
        calibration[fault] = replace(stated_bias, mean=0.0, subtracted=stated_bias.mean)
        texts.append(f"{FAULT_TEXTS[fault]} of {sensor.name} {stated_bias.mean:g}")
    result = (
        replace(samples, **corrected),
        replace(settings, calibration=calibration),
    )
    if not texts:
        return result, ()
    entry = messages.air_calibrated(
        where=_MISSION_KEY,
        count=len(texts),
        biases="; ".join(texts),
    )
    return result, (entry,)


def check_calibration(
    made: Estimate,
    settings: SensorSettings,
    estimate_with: Callable[[SensorSettings], Estimate],
) -> Notes:
    """Messages on stated calibrations, and on large errors without one.

    Three kinds: a stated calibration that the flight contradicts; an estimated error that is larger
    than that of a working sensor and has no calibration; calibrations of errors that no sensor in
    use has. ``made``: the estimate with the calibrations. ``estimate_with``: makes an estimate from
    the same flight with other settings. Each stated value is compared with an estimate without it,
    in which the other sensors have their usual errors, because a rare fault could explain a wrong
    calibration away. One wrong value makes others seem wrong, so only the worst is reported.
    """
    expected_value = {fault.name: fault.mean for fault in made.readings.faults}
    worst_sigmas = CONTRADICTED
    notes: list[Message] = []
    large = []
    for fault in made.faults:
        calibration = settings.calibration.get(fault.fault)
        expected = expected_value[fault.fault]
        if calibration is None:
            if _is_unexpected(fault, expected):
                large.append(described_fault(fault))
            continue
        flown = _estimated_without_statement(fault.fault, settings, estimate_with)
        departure = abs(flown.value - expected)
        sigmas = departure / math.hypot(flown.sigma, fault.prior_sigma)
        is_learnt = flown.sigma < _LEARNT * flown.prior_sigma
        if is_learnt and sigmas > worst_sigmas:
            worst_sigmas = sigmas
            contradicted = messages.air_calibration(
                where=calibration.path,
                fault=FAULT_TEXTS[fault.fault],
                sigmas=sigmas,
                stated=expected + calibration.subtracted,
                prior=fault.prior_sigma,
                flown=flown.value + calibration.subtracted,
                sigma=flown.sigma,
            )
            notes = [contradicted]
    if large:
        notes.append(messages.air_sensors_large(count=len(large), faults="; ".join(large)))
    drifts = {drift.name for drift in made.readings.drifts}
    unused = set(settings.calibration) - set(expected_value) - drifts
    return *notes, *unused_calibration(unused)


def _is_unexpected(fault: FaultEstimate, expected: float) -> bool:
    """Whether a fault without a stated calibration is larger than that of a working sensor.

    ``expected``: its prior mean.
    """
    limit = UNEXPECTED * fault.prior_sigma + fault.sigma
    if fault.fault == SensorFault.PRESSURE_SCALE:
        limit = max(LOST_SHARE, LOST_SIGMAS * fault.sigma)
    return abs(fault.value - expected) > limit


def _estimated_without_statement(
    name: SensorFault,
    settings: SensorSettings,
    estimate_with: Callable[[SensorSettings], Estimate],
) -> FaultEstimate:
    """A fault as the flight shows it if its calibration were not stated.

    The sensors have usual errors only, except that a leak may be large if it is the fault itself.
    """
    calibration = dict(settings.calibration)
    del calibration[name]
    usual = name != SensorFault.PRESSURE_SCALE
    unstated = replace(settings, calibration=calibration, usual_errors_only=usual)
    made = estimate_with(unstated)
    return next(fault for fault in made.faults if fault.fault == name)


def described_fault(estimated: FaultEstimate) -> str:
    """A sensor fault with value and sigma, in words for the ledger."""
    fault = estimated.in_units()
    digits = max(1 - math.floor(math.log10(fault.sigma)), 0)
    return f"{FAULT_TEXTS[fault.fault]} {fault.value:.{digits}f} ± {fault.sigma:.{digits}f}"


def unused_calibration(faults: set[SensorFault]) -> Notes:
    """The message on stated calibrations of ``faults``, which no sensor in use has, if any."""
    if not faults:
        return ()
    names = sorted(FAULT_TEXTS[fault] for fault in faults)
    unused = messages.calibration_unused(
        where=_MISSION_KEY,
        count=len(faults),
        faults=", ".join(names),
    )
    return (unused,)


def usable_sensors(samples: AirSamples, standard: Profile) -> tuple[AirSamples, Notes]:
    """The samples without readings and sensors that contradict physics, and messages on these.

    Readings must not stay the same during a climb: such readings are rejected, of a barometer all.
    Pressure must fall with GNSS height as in air of 180 to 335 K, else the barometer is not used.
    """
    notes: list[Message] = []
    checked: dict[str, Any] = {}
    for quantity, sensor in samples.sensors.items():
        is_stuck = _stuck_rows(sensor, quantity)
        if not bool(is_stuck.any()):
            continue
        value = sensor.value[is_stuck][0]
        if quantity == "pressure":
            checked[quantity] = None
            notes.append(_indoors(sensor, f"stays at {value:.0f} Pa"))
            continue
        usable = sensor.reject(is_stuck, Reason.STUCK)
        checked[quantity] = usable if bool(usable.accepted.any()) else None
        stuck = messages.air_stuck(
            where=sensor.name,
            count=int(is_stuck.sum()),
            value=value,
            extent=np.ptp(sensor.h_m[is_stuck]),
            total=int(sensor.accepted.sum()),
        )
        notes.append(stuck)
    samples = replace(samples, **checked)
    pressure = samples.pressure
    if pressure is None or pressure.extent_m < CLIMB_TO_COMPARE_M:
        return samples, tuple(notes)
    fall = _fall_outside(pressure, standard)
    if not fall.is_of_air:
        oddity = "does not fall with height"
        if fall.implied_k is not None:
            oddity = f"implies {fall.implied_k:.0f} K"
        notes.append(_indoors(pressure, oddity))
        samples = replace(samples, pressure=None)
    return samples, tuple(notes)


def _fall_outside(pressure: SensorSamples, standard: Profile) -> Fall:
    """How a pressure falls with height, by medians in bins of its departure from a standard.

    Without a fall, and so not that of air, where fewer than three bins have readings.
    """
    gravity = standard.gravity
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(pressure.value) - np.log(standard.pressure(pressure.h_m))
    heights = gravity.geopotential_height(pressure.h_m)
    height, mean_departure = bin_by_height(heights, pressure, BIN_M, departure)
    if height.size < 3:
        return Fall(None, 0.0)
    log_p = mean_departure + np.log(standard.pressure(gravity.height(height)))
    return fall_of_pressure(height, log_p)


def _indoors(pressure: SensorSamples, oddity: str) -> Message:
    """Message that a pressure is not that of the air outside; ``oddity`` in words."""
    return messages.air_not_outside(
        where=pressure.name,
        what_is_odd=oddity,
        extent=pressure.extent_m,
    )


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


def _stuck_rows(sensor: SensorSamples, quantity: str) -> Mask:
    """(n,) which readings are in a run of equal ones over more height than the resolution explains.

    The resolution is the smallest difference between readings. A relative humidity may stay below
    2 % or above 97 %. Rejected readings are never stuck.
    """
    stuck = np.zeros(sensor.value.size, dtype=bool)
    rows = np.flatnonzero(sensor.accepted)
    h, value = sensor.used()
    if rows.size < FEWEST_STUCK:
        return stuck
    last_of_run = np.flatnonzero(value[1:] != value[:-1])  # of all runs but the last
    start = np.concatenate([[0], 1 + last_of_run])
    count = np.diff(start, append=rows.size)
    extent = np.maximum.reduceat(h, start) - np.minimum.reduceat(h, start)
    resolutions = np.diff(np.unique(value))
    hidden_m = 0.0
    if resolutions.size:
        hidden_m = float(resolutions.min()) / SLOWEST_CHANGE[quantity]
    is_stuck = (extent >= STUCK_M + hidden_m) & (count >= FEWEST_STUCK)
    if quantity == "humidity":
        is_stuck &= (value[start] > DRY) & (value[start] < MOIST)
    stuck[rows] = np.repeat(is_stuck, count)
    return stuck


def pressure_level(
    profile: Profile,
    background: Climatology,
    pressure: SensorSamples | None,
    *,
    other_sources: Sequence[str],
) -> Message:
    """The message on the level of the profile's pressure, and how well measured pressures fit it.

    A note if the pressure at sea level is within 5 sigma of the climatology, a warning if farther,
    a loss from 10 sigma on, which weather does not reach. Without measured pressures it names what
    gives the level instead: ``other_sources``, or the background where there are none.
    """
    if pressure is None or not bool(pressure.accepted.any()):
        source = " and ".join(other_sources) or f"the climatology {background.profile.name}"
        return messages.air_no_barometer(source=source)
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
