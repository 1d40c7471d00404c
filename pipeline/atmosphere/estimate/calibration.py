"""What is known of the sensors before the flight: taken from their readings, and compared."""

from __future__ import annotations

import math
from dataclasses import replace

from pipeline.atmosphere.air_samples import AirSamples, SensorCalibration
from pipeline.atmosphere.estimate.sensors import BIAS, HYGROMETER_FAULT, OFFSET
from pipeline.atmosphere.estimate.solver import Estimate
from pipeline.ledger import Ledger

CONTRADICTED = 4.0
"""Sigmas between what a calibration says and what the flight does, at which one must be wrong."""

_LEAST_LEARNT = 0.05  # of the expected sigma: less says nothing
_READINGS = {BIAS: "temperature", OFFSET: "pressure", HYGROMETER_FAULT.name: "humidity"}


def calibrated(samples: AirSamples, ledger: Ledger) -> AirSamples:
    """The samples without the biases that are known; what is left of these is expected about 0.

    Before anybody judges a sensor by its readings.
    """
    taken, rest, words = {}, dict(samples.calibration), []
    for name, sensor in _READINGS.items():
        known, readings = rest.get(name), getattr(samples, sensor)
        if known is None or not known.mean or readings is None:
            continue
        taken[sensor] = replace(readings, value=readings.value - known.mean)
        rest[name] = SensorCalibration(0.0, known.sigma, known.mean)
        words.append(f"{name} of {readings.name} {known.mean:g}")
    if words:
        ledger.note(
            "AIR-CALIBRATED",
            f"taken from the readings, as the mission file says: {'; '.join(words)}",
            where="atmosphere.sensors",
            count=len(words),
        )
    return replace(samples, **taken, calibration=rest)


def compare_calibration(made: Estimate, samples: AirSamples, ledger: Ledger) -> None:
    """Say where the flight contradicts what is known of its sensors, and what it does not use.

    If both are right, an estimate departs from what was expected by a sigma whose square is that
    of the expectation less that of the estimate. One fault that is stated wrongly draws others
    along, so only the worst is named.
    """
    expected = {fault.name: fault.mean for fault in made.sources.faults}
    worst, words = CONTRADICTED, ""
    for found in made.nuisances:
        known, prior = samples.calibration.get(found.name), found.prior_sigma
        learnt = prior**2 - found.sigma**2
        if known is None or learnt < (_LEAST_LEARNT * prior) ** 2:
            continue
        change = found.value - expected[found.name]
        if abs(change) > worst * math.sqrt(learnt):
            worst = abs(change) / math.sqrt(learnt)
            stated = expected[found.name] + known.taken
            alone = stated + change * prior**2 / learnt
            words = (
                f"{found.name}: {stated:.3g} ± {prior:.2g} by the mission file, {alone:.3g} by the "
                f"flight alone, {worst:.0f} sigma away: one of the two is wrong, or another sensor"
            )
    if words:
        ledger.warning("AIR-CALIBRATION", words, where="atmosphere.sensors")
    drifts = {drift.name for drift in made.sources.drifts}
    tell_unused(set(samples.calibration) - set(expected) - drifts, ledger)


def tell_unused(names: set[str], ledger: Ledger) -> None:
    """Say of which faults the mission file knows something that nothing here has."""
    if names:
        ledger.note(
            "AIR-CALIBRATION-UNUSED",
            f"no sensor that the air stands on has a {', '.join(sorted(names))}",
            where="atmosphere.sensors",
            count=len(names),
        )
