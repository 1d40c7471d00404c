"""Checks whether a thermometer is in the air outside, against the barometer of the flight."""

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
"""Largest inflated sigma of a thermometer outside [K]: with the sun on its probe it is 0.9 K."""

# Largest departures of a thermometer from what the barometer implies; the limit is the root of the
# sum of squares of one of these and of `COMPARED_SIGMAS` sigmas of the comparison.
LARGEST_BIAS_K = 8.0  # in the mean
LARGEST_CHANGE_K = 3.5  # in its change from the lower to the upper half
COMPARED_SIGMAS = 3.5

CERTAIN_CHANCE = 0.99  # of being in a bay or indoors, above which a thermometer is not used

LARGE_DRIFT = 1.25
"""A drift with a sigma so many times as large as expected may hide a wrong sensor."""

TOGETHER_S = 1800.0
"""First part of a flight in which thermometer and barometer are compared [s]: in it the air hardly
changes. Over hours the readings of a good thermometer disagree."""

SHOWN_SHARE = 0.005
"""Largest sigma of a lost share of pressure that heights have determined. A thermometer with a bias
of 3 K alone determines it to 0.01."""

LAYER_M = 100.0  # layers of this thickness have the same weight in a comparison [m']


def thermometer_is_outside(
    samples: AirSamples,
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    settings: SensorSettings,
) -> Check:
    """Whether the thermometer of a flight can be in the air outside.

    ``made``: the estimate from all sensors. Not passed in any of these cases:

    1. The thermometer is in a bay with a probability of 99 %.
    2. Its readings, in the mean or in their change with height, are not those that an estimate
       without them predicts, although the barometer fits this estimate and does not lose pressure.
    3. In the first half an hour no air fits both thermometer and barometer.
    4. The barometer fits no air together with the thermometer, but plausible air without it.

    Passed without a thermometer or barometer, or with one on a circuit board. Cases 2 to 4 are
    tested without soundings and stations, 3 and 4 with drifts of the expected size, because a large
    drift could hide any contradiction.
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
    """Whether temperatures of a flight are those that an estimate from its other sensors predicts.

    Passed too where the barometer does not fit that estimate, or loses pressure by ``made``, the
    estimate from all sensors.
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
    """The samples of a flight with all readings after ``until_ns`` [Unix ns] rejected."""
    early: dict[str, Any] = {}
    for quantity, sensor in samples.sensors.items():
        early[quantity] = sensor.reject(sensor.time_ns > until_ns, Reason.LEFT_OUT)
    return replace(samples, **early)


def barometer_loses_pressure(made: Estimate) -> bool:
    """Whether thermometer and barometer together show that the static pressure loses its change.

    The air that such a pressure implies is too warm, at 6 km twice as much as at the ground. The
    bias of a thermometer does not grow so; and where a thermometer is too warm, indoors or in the
    sun, the air that the pressure implies is colder than it reads.
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
    """A weighted sum of the readings of a thermometer, which is compared with its prediction.

    ``weights`` (m,): of the readings. ``largest_k``: by how much it may differ. ``reads``: words
    for a message.
    """

    weights: Array
    largest_k: float
    reads: str


def is_predicted(thermometer: Thermometer, without: Solution) -> Check:
    """Whether readings of a thermometer are those that an estimate ``without`` them predicts.

    Their mean over height, and their change from the lower to the upper half of the heights, are
    compared; limits include the sigma of the prediction and of all faults of a thermometer.
    Pressure implies virtual temperatures, and humidity is hardly known. So the limits also include
    the effect of the expected humidity: in dry air temperatures equal the virtual ones.
    """
    air = without.air
    layout = air.layout
    moist = np.interp(thermometer.height, layout.knot, air.virtual - air.temperature)  # [K]
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
    """The comparisons of readings at heights (m,) [m']: their mean, and the change with height.

    Layers of 100 m' have the same weight. The change is from the lower to the upper half of the
    heights; it is left out if one half has no readings.
    """
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
    """Inflated sigma of a thermometer's readings [K]; 0 if the inflation factor is at most 5."""
    inflation = _sigma_inflation(made, Thermometer)
    if inflation <= MISFIT:
        return 0.0
    sigma_k = 0.0
    for readings in made.readings.sets:
        if isinstance(readings, Thermometer):
            sigma_k = max(sigma_k, float(np.median(readings.sigma)))
    return inflation * sigma_k


def _sigma_inflation(made: Estimate, kind: type) -> float:
    """The largest sigma inflation factor of a kind of readings in an estimate; 1 without any."""
    return _largest_inflation(made.readings.sets, made.fits, kind)


def _largest_inflation(sets: Sequence[Readings], fits: Sequence[Fit], kind: type) -> float:
    """The largest sigma inflation factor of a kind among sets of readings; 1 without any.

    ``fits``: of the ``sets``, in their order. ``kind``: a class of `Readings`.
    """
    largest = 1.0
    for readings, fit in zip(sets, fits, strict=True):
        if isinstance(readings, kind):
            largest = max(largest, fit.sigma_inflation)
    return largest
