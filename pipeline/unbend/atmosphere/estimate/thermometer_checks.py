"""Thermometer checks: a thermometer must read what the estimate without it predicts."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

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
from unbend.units import Array

MISFIT_K = 1.5
"""Readings of a thermometer disagree with the others where their inflated sigma is larger than this
too: the sun on its probe comes to 0.9 K."""

# A thermometer against what the barometer implies: more is a wrong sensor.
LARGEST_BIAS_K = 8.0  # in the mean
LARGEST_CHANGE_K = 3.5  # in its change from the lower to the upper half
COMPARED_SIGMAS = 3.5  # of the comparison, beside these

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
    temperature = samples.temperature
    pressure = samples.pressure
    chance = made.chances.get(IN_A_BAY.name, 0.0)
    if temperature is not None and chance > CERTAIN_CHANCE:
        return Check(messages.thermometer_in_a_bay(percent=100.0 * chance))
    if temperature is None or pressure is None or settings.board_temperature:
        return PASSED
    check = _predicted_without_thermometer(samples, made, background, moisture, settings)
    if not check:
        return check
    expected = replace(settings, usual_errors_only=True)
    estimate_of = partial(estimate, background=background, settings=expected, moisture=moisture)
    has_drifted = max(made.drift_scales.values(), default=1.0) > LARGE_DRIFT
    if has_drifted or _inflated_sigma_k(made) > MISFIT_K:
        first_ns = int(temperature.time_ns[temperature.accepted][0])
        early = _until(samples, first_ns + round(TOGETHER_S * 1e9))
        inflated_k = _inflated_sigma_k(estimate_of(early))
        if inflated_k > MISFIT_K:
            reason = messages.thermometer_contradicts_barometer(
                minutes=TOGETHER_S / 60.0,
                barometer=pressure.name,
                kelvin=inflated_k,
                limit_k=MISFIT_K,
            )
            return Check(reason)
    if has_drifted or _sigma_inflation(made, Barometer) > MISFIT:
        inflation = _sigma_inflation(estimate_of(samples), Barometer)
        alone = estimate_of(replace(samples, temperature=None))
        fits_alone = _sigma_inflation(alone, Barometer) <= MISFIT
        if inflation > MISFIT and fits_alone and is_plausible(alone, background):
            reason = messages.barometer_fits_other_temperatures(
                barometer=pressure.name,
                inflation=inflation,
                limit=MISFIT,
            )
            return Check(reason)
    return PASSED


def _predicted_without_thermometer(
    samples: AirSamples,
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    settings: SensorSettings,
) -> Check:
    """Whether temperatures are those that the estimate without them predicts.

    Passed too where its barometer fits no air, or is seen to lose pressure (``made``: with both).
    """
    flown = collect_readings(samples, background, settings)
    layout = layout_of(flown, background)
    other_sets = [readings for readings in flown.sets if not isinstance(readings, Thermometer)]
    prior = prior_of(layout, background, moisture or background)
    without = solve(layout, prior, other_sets, background.profile)
    check = PASSED
    for readings in flown.sets:
        if check and isinstance(readings, Thermometer):
            check = is_predicted(readings, without)
    barometer_fits = _largest_inflation(other_sets, without.fits, Barometer) <= MISFIT
    if not check and barometer_fits and not barometer_loses_pressure(made):
        return check
    return PASSED


def _until(samples: AirSamples, until_ns: int) -> AirSamples:
    """The samples of a flight until a time [Unix ns]."""
    early: dict[str, Any] = {}
    for quantity, sensor in samples.sensors.items():
        early[quantity] = sensor.reject(sensor.time_ns > until_ns, Reason.LEFT_OUT)
    return replace(samples, **early)


def barometer_loses_pressure(made: Estimate) -> bool:
    """Whether thermometer and barometer together show a static pressure that loses its change.

    The air that it implies is too warm, at 6 km twice as much as at the ground. A thermometer's
    bias does not grow so, and beside one indoors or in the sun the implied air is too cold.
    """
    barometer_fits = _sigma_inflation(made, Barometer) <= MISFIT
    thermometer_fits = _sigma_inflation(made, Thermometer) <= MISFIT
    if not (barometer_fits and thermometer_fits):
        return False
    for fault in made.faults:
        if fault.fault is SensorFault.PRESSURE_SCALE and fault.sigma < SHOWN_SHARE:
            return fault.value > LOST_SIGMAS * fault.sigma
    return False


class _Comparison(NamedTuple):
    """A mean of readings by ``weights`` (m,), by how much it may differ, and the words for it."""

    weights: Array
    largest_k: float
    reads: str


def is_predicted(thermometer: Thermometer, without: Solution) -> Check:
    """Whether temperatures are those that an estimate without them predicts.

    In the mean over their heights and in the change from the lower to the upper half of these,
    within the sigma of the prediction and of all faults of a thermometer. Pressure implies virtual
    temperatures: in air as dry as a desert's, temperatures as high as these.
    """
    air = without.air
    layout = air.layout
    moist = np.interp(thermometer.height, layout.knot, air.virtual - air.temperature)
    predicted, jacobian = thermometer.predict(air)
    for weights, largest_k, reads in _comparisons(thermometer.height):
        by_state = weights @ jacobian
        by_state[layout.fault(SensorFault.THERMOMETER_BIAS)] = 0.0  # ``largest_k`` is its limit
        sigma = float(np.sqrt(by_state @ without.covariance @ by_state))
        limit = float(np.hypot(largest_k, COMPARED_SIGMAS * sigma) + abs(weights @ moist))
        departure = float(weights @ (thermometer.value - predicted))
        if abs(departure) > limit:
            reason = messages.thermometer_not_as_predicted(
                reads=reads,
                departure_k=departure,
                limit_k=limit,
            )
            return Check(reason)
    return PASSED


def _comparisons(height: Array) -> list[_Comparison]:
    """The mean over heights (m,) [m'] and the change between their halves; layers weigh alike."""
    layer = np.floor((height - height.min()) / LAYER_M).astype(np.int64)
    weight = 1.0 / np.bincount(layer)[layer]
    comparisons = [_Comparison(weight / weight.sum(), LARGEST_BIAS_K, "reads")]
    middle = 0.5 * (height.min() + height.max())
    upper = np.where(height >= middle, weight, 0.0)
    lower = weight - upper
    if lower.any() and upper.any():
        change = upper / upper.sum() - lower / lower.sum()
        reads = f"from the lower to the upper half of {np.ptp(height):.0f} m changes by"
        comparisons.append(_Comparison(change, LARGEST_CHANGE_K, reads))
    return comparisons


def _inflated_sigma_k(made: Estimate) -> float:
    """Sigma [K] of a thermometer's readings with the inflation factor, 0 where that is small."""
    inflation = _sigma_inflation(made, Thermometer)
    if inflation <= MISFIT:
        return 0.0
    sigma_k = 0.0
    for readings in made.readings.sets:
        if isinstance(readings, Thermometer):
            sigma_k = max(sigma_k, float(np.median(readings.sigma)))
    return inflation * sigma_k


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
