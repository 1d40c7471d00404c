"""Thermometer checks: a thermometer must read what the estimate without it predicts."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import messages
from unbend.atmosphere.estimate.estimate_checks import MISFIT, PASSED, Check, is_plausible
from unbend.atmosphere.estimate.hypotheses import IN_A_BAY
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.atmosphere.estimate.readings import collect_readings
from unbend.atmosphere.estimate.sensor_checks import LOST_SIGMAS
from unbend.atmosphere.estimate.sensors import Barometer, Readings, SensorSettings, Thermometer
from unbend.atmosphere.estimate.solver import Estimate, Solution, estimate, layout_of, solve
from unbend.atmosphere.estimate.state import SensorFault, prior_of
from unbend.atmosphere.rejection import Reason

MISFIT_K = 1.5
"""Readings of a thermometer disagree with the others where their inflated sigma is larger than this
too: the sun on its probe comes to 0.9 K."""

LARGEST_BIAS_K, LARGEST_CHANGE_K, COMPARED_SIGMAS = 8.0, 3.5, 3.5
"""A thermometer against what the barometer implies, in the mean and in its change from the lower to
the upper half: more, beside so many sigmas of the comparison, is a wrong sensor."""

CERTAIN_CHANCE = 0.99  # of being in a bay or indoors, above which a thermometer is not used

LARGE_DRIFT = 1.25
"""A drift that the residuals make so many times as large as expected may hide a wrong sensor."""

TOGETHER_S = 1800.0
"""Within so long the air hardly changes; over hours the readings of a good thermometer disagree."""

SHOWN_SHARE = 0.005  # known so well it is known by the height; 3 K of bias leave 0.01
LAYER_M = 100.0  # each weighs the same where a thermometer is compared [m']


def thermometer_is_outside(
    samples: AirSamples,
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    settings: SensorSettings,
) -> Check:
    """Whether the thermometer of a flight with a barometer (``made``: with both) can be outside.

    Not passed where it is surely in a bay. Nor where its readings, in the mean or in their change
    with height, are not those that the estimate without them predicts, though the barometer fits an
    air and is not seen to lose pressure; where within half an hour no air that the barometer allows
    has them; or where the barometer differs from any air that the thermometer allows, and fits
    plausible air of its own. All without soundings and stations; the last two with drifts of the
    expected size, since a large one could hide any contradiction.
    """
    temperature, pressure = samples.temperature, samples.pressure
    chance = made.chances.get(IN_A_BAY.name, 0.0)
    if temperature is not None and chance > CERTAIN_CHANCE:
        return Check(messages.thermometer_in_a_bay(percent=100.0 * chance))
    if temperature is None or pressure is None or settings.board_temperature:
        return PASSED
    flown = collect_readings(samples, background, settings)
    layout = layout_of(flown, background)
    others = [readings for readings in flown.sets if not isinstance(readings, Thermometer)]
    prior = prior_of(layout, background, moisture or background)
    without = solve(layout, prior, others, background.profile)
    check = PASSED
    for readings in flown.sets:
        if check and isinstance(readings, Thermometer):
            check = is_predicted(readings, without)
    barometer_fits = _largest_inflation(others, without.fits, Barometer) <= MISFIT
    if not check and barometer_fits and not barometer_loses_pressure(made):
        return check
    expected = replace(settings, usual_errors_only=True)
    estimate_of = partial(estimate, background=background, settings=expected, moisture=moisture)
    drifted = max(made.drift_scales.values(), default=1.0) > LARGE_DRIFT
    if drifted or _inflated_sigma_k(made) > MISFIT_K:
        # The flight until half an hour after its thermometer's first accepted reading.
        until = int(temperature.time_ns[temperature.accepted][0]) + round(TOGETHER_S * 1e9)
        early: dict[str, Any] = {
            name: sensor.reject(sensor.time_ns > until, Reason.LEFT_OUT)
            for name, sensor in samples.sensors.items()
        }
        inflated_k = _inflated_sigma_k(estimate_of(replace(samples, **early)))
        if inflated_k > MISFIT_K:
            reason = messages.thermometer_contradicts_barometer(
                minutes=TOGETHER_S / 60.0,
                barometer=pressure.name,
                kelvin=inflated_k,
                limit_k=MISFIT_K,
            )
            return Check(reason)
    if drifted or _sigma_inflation(made, Barometer) > MISFIT:
        inflation = _sigma_inflation(estimate_of(samples), Barometer)
        alone = estimate_of(replace(samples, temperature=None))
        fits = _sigma_inflation(alone, Barometer) <= MISFIT and is_plausible(alone, background)
        if inflation > MISFIT and fits:
            reason = messages.barometer_fits_other_temperatures(
                barometer=pressure.name, inflation=inflation, limit=MISFIT
            )
            return Check(reason)
    return PASSED


def barometer_loses_pressure(made: Estimate) -> bool:
    """Whether thermometer and barometer together show a static pressure that loses its change: the
    air that it implies is too warm, at 6 km twice as much as at the ground. A thermometer's bias
    does not grow so, and beside one indoors or in the sun the implied air is too cold."""
    fits = max(_sigma_inflation(made, kind) for kind in (Barometer, Thermometer)) <= MISFIT
    shares = (f for f in made.faults if f.fault is SensorFault.PRESSURE_SCALE)
    return fits and any(f.sigma < SHOWN_SHARE and f.value > LOST_SIGMAS * f.sigma for f in shares)


def is_predicted(thermometer: Thermometer, without: Solution) -> Check:
    """Whether temperatures are those that an estimate without them predicts, in the mean over their
    heights and in the change from the lower to the upper half of these, within the sigma of the
    prediction and of all faults of a thermometer. Pressure implies virtual temperatures: in air as
    dry as a desert's, temperatures as high as these."""
    air, layout, height = without.air, without.air.layout, thermometer.height
    moist = np.interp(height, layout.knot, air.virtual - air.temperature)
    predicted, jacobian = thermometer.predict(air)
    layer = np.floor((height - height.min()) / LAYER_M).astype(np.int64)
    weight = 1.0 / np.bincount(layer)[layer]
    upper = np.where(height >= 0.5 * (height.min() + height.max()), weight, 0.0)
    lower = weight - upper
    comparisons = [(weight / weight.sum(), LARGEST_BIAS_K, "reads")]
    if lower.any() and upper.any():
        what = f"from the lower to the upper half of {np.ptp(height):.0f} m changes by"
        comparisons.append((upper / upper.sum() - lower / lower.sum(), LARGEST_CHANGE_K, what))
    for weights, largest, what in comparisons:
        by_state = weights @ jacobian
        by_state[layout.fault(SensorFault.THERMOMETER_BIAS)] = 0.0  # ``largest`` is its limit
        sigma = float(np.sqrt(by_state @ without.covariance @ by_state))
        limit = float(np.hypot(largest, COMPARED_SIGMAS * sigma) + abs(weights @ moist))
        seen = float(weights @ (thermometer.value - predicted))
        if abs(seen) > limit:
            reason = messages.thermometer_not_as_predicted(
                reads=what, departure_k=seen, limit_k=limit
            )
            return Check(reason)
    return PASSED


def _inflated_sigma_k(made: Estimate) -> float:
    """Sigma [K] of a thermometer's readings with the inflation factor, 0 where that is small."""
    inflation = _sigma_inflation(made, Thermometer)
    sigmas = [np.median(s.sigma) for s in made.readings.sets if isinstance(s, Thermometer)]
    return inflation * float(max(sigmas, default=0.0)) if inflation > MISFIT else 0.0


def _sigma_inflation(made: Estimate, kind: type) -> float:
    """The largest sigma inflation factor of a kind of readings."""
    return _largest_inflation(made.readings.sets, made.fits, kind)


def _largest_inflation(sets: Sequence[Readings], fits: Sequence[Fit], kind: type) -> float:
    """The largest sigma inflation factor of a kind among readings and their fits."""
    largest = 1.0
    for readings, fit in zip(sets, fits, strict=True):
        if isinstance(readings, kind):
            largest = max(largest, fit.sigma_inflation)
    return largest
