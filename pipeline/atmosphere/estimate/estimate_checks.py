"""Estimate checks: it must be physical air, and predict readings that were held out of it."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.readings import part_of
from pipeline.atmosphere.estimate.sensors import Barometer, SensorSettings, Thermometer
from pipeline.atmosphere.estimate.solver import Estimate, estimate, layout_of, solve
from pipeline.atmosphere.estimate.state import air_of, prior_of
from pipeline.atmosphere.hypsometry import COLDEST_K, WARMEST_K, hats

ADIABATIC_K_PER_M = 9.8e-3
"""Unsaturated air whose temperature falls faster overturns within minutes [K/m']."""

OVERTURNING_M = 500.0
"""... but over less height than this a sunny field, or a lag, may show it [m']."""

CERTAIN = 3.0
"""Sigmas by which a lapse rate must exceed the adiabatic one."""

FARTHEST = 5.0
"""Sigmas of the climatology that no air of the real soundings comes near (2.9 at most)."""

MISFIT = 5.0
"""Readings with a larger sigma inflation factor disagree with the others."""

TOGETHER_S = 1800.0
"""Within so long the air hardly changes; over hours the readings of a good thermometer disagree."""

HARMLESS_K, HARMLESS_LOG_P = 1.0, 1e-3
"""Held-out residuals of so little are no reason to fall back: a sharp inversion leaves them."""


@dataclass(frozen=True)
class Check:
    """Result of a check: true where it is passed, else with the reason in words."""

    reason: str = ""

    def __bool__(self) -> bool:
        return not self.reason


PASSED = Check()


def is_plausible(made: Estimate, background: Climatology) -> Check:
    """Whether an estimate can be air, between the lowest and the highest measurement.

    Not passed: temperatures outside 180 to 335 K, a fall steeper than the dry adiabat by 3 sigma
    over 500 m, or a temperature 5 sigma from the climatology.
    """
    layers = made.profile.layers
    # A balloon goes higher than a climatology does.
    bounds = (layers.edge, background.profile.layers.edge)
    low = max(made.readings.low, *(float(edge[0]) for edge in bounds))
    high = min(made.readings.high, *(float(edge[-1]) for edge in bounds))
    h = np.arange(low, max(high, low + 1.0), 50.0)
    height = background.profile.gravity.height(h)
    t = made.profile.temperature(height)
    if not bool(np.all((t > COLDEST_K) & (t < WARMEST_K))):
        return Check(f"temperatures of {t.min():.0f} to {t.max():.0f} K are not those of air")
    spread = background.spread.sigma_temperature(made.profile.break_heights_m)
    sigma = np.interp(h, layers.edge, spread)
    departure = (t - background.profile.temperature(height)) / sigma
    worst = int(np.argmax(np.abs(departure)))
    if abs(departure[worst]) > FARTHEST:
        return Check(
            f"{t[worst]:.0f} K at {height[worst]:.0f} m is {abs(departure[worst]):.1f} sigma from "
            "the climatology"
        )
    over = round(OVERTURNING_M / 50.0)
    if h.size > over:
        # One sigma of T(h) - T(h + 500 m) [K]; that of T_M stands for it.
        weights = hats(layers.edge, h[:-over]) - hats(layers.edge, h[over:])
        matrix = made.covariance.matrix[: layers.edge.size, : layers.edge.size]
        sigma = np.sqrt(np.einsum("ij,ij->i", weights @ matrix, weights))
        excess = t[:-over] - t[over:] - ADIABATIC_K_PER_M * OVERTURNING_M - CERTAIN * sigma
        steepest = int(np.argmax(excess))
        if excess[steepest] > 0.0:
            lapse = (t[steepest] - t[steepest + over]) / OVERTURNING_M * 1000.0
            return Check(
                f"temperature falls by {lapse:.1f} K/km above {height[steepest]:.0f} m: air "
                "overturns at 9.8 K/km"
            )
    return PASSED


def is_better_than_background(
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    name: str = "the climatology",
) -> Check:
    """Whether an estimate predicts held-out readings better than its background (``name``) does.

    Every other bin of thermometer and barometer is held out; the estimate from the others must
    predict them, about their median, better than the background. Consistent readings do, even if
    all of them have the same error; unrelated noise does not.
    """
    measured = made.readings
    layout = layout_of(measured, background)
    prior = prior_of(layout, background, moisture or background)
    used, held_out = [], []
    for readings in measured.sets:
        odd = np.arange(readings.height.size) % 2 == 1
        if isinstance(readings, Thermometer | Barometer) and bool(odd.any()):
            used.append(part_of(readings, ~odd))
            held_out.append(part_of(readings, odd))
        else:
            used.append(readings)
    if not held_out:
        return PASSED
    profile = background.profile
    air = solve(layout, prior, used, profile, made.state).air
    pressure = profile.pressure(profile.gravity.height(layout.knot))
    expected = air_of(layout, prior.mean, pressure, profile.constant)
    for readings in held_out:
        residuals = (readings.value - readings.predict(a)[0] for a in (air, expected))
        # Median distance from the median, as one sigma.
        by_estimate, by_background = (
            float(1.4826 * np.median(np.abs(residual - np.median(residual))))
            for residual in residuals
        )
        is_pressure = isinstance(readings, Barometer)
        if by_estimate > max(by_background, HARMLESS_LOG_P if is_pressure else HARMLESS_K):
            unit, factor = ("%", 100.0) if is_pressure else ("K", 1.0)
            return Check(
                f"readings of {readings.name} that were held out differ by "
                f"{factor * by_estimate:.2f} {unit} from the estimate and by "
                f"{factor * by_background:.2f} {unit} from {name}"
            )
    return PASSED


def thermometer_is_outside(
    samples: AirSamples,
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    settings: SensorSettings,
) -> Check:
    """Whether the thermometer of a flight with a barometer can be outside.

    ``made`` is an estimate with both. Not passed where its readings within half an hour differ from
    those of any air that the barometer allows; or where the barometer differs from any air that the
    thermometer allows, and fits plausible air of its own. Both without soundings and stations.
    """
    temperature, pressure = samples.temperature, samples.pressure
    if temperature is None or pressure is None or settings.board_temperature:
        return PASSED

    def estimate_of(part: AirSamples) -> Estimate:
        return estimate(part, background, settings=settings, moisture=moisture)

    if _sigma_inflation(made, Thermometer) > MISFIT:
        # The flight until half an hour after its thermometer's first accepted reading.
        until = int(temperature.time_ns[temperature.accepted][0]) + round(TOGETHER_S * 1e9)
        early = {
            name: replace(sensor, accepted=sensor.accepted & (sensor.time_ns <= until))
            for name in ("temperature", "pressure", "humidity")
            if (sensor := getattr(samples, name)) is not None
        }
        inflation = _sigma_inflation(estimate_of(replace(samples, **early)), Thermometer)
        if inflation > MISFIT:
            return Check(
                f"its readings within {TOGETHER_S / 60.0:.0f} minutes, beside {pressure.name} "
                "against GNSS height, fit physical air only with a sigma inflation factor of "
                f"{inflation:.0f}"
            )
    if _sigma_inflation(made, Barometer) > MISFIT:
        inflation = _sigma_inflation(estimate_of(samples), Barometer)
        alone = estimate_of(replace(samples, temperature=None))
        fits = _sigma_inflation(alone, Barometer) <= MISFIT and is_plausible(alone, background)
        if inflation > MISFIT and fits:
            return Check(
                f"{pressure.name} against GNSS height fits plausible air, but with these "
                f"temperatures only with a sigma inflation factor of {inflation:.0f}"
            )
    return PASSED


def _sigma_inflation(made: Estimate, kind: type) -> float:
    """The largest sigma inflation factor of a kind of readings."""
    pairs = zip(made.readings.sets, made.fits, strict=True)
    return max((fit.sigma_inflation for s, fit in pairs if isinstance(s, kind)), default=1.0)
