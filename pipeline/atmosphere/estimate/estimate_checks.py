"""Whether an estimate may stand: it must look like air, and foretell what it was not shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.readings import part_of
from pipeline.atmosphere.estimate.sensors import Barometer, Thermometer
from pipeline.atmosphere.estimate.solver import Estimate, estimate, layout_of, solve
from pipeline.atmosphere.estimate.state import air_of, prior_of
from pipeline.atmosphere.hypsometry import COLDEST_K, WARMEST_K, hats

Array = NDArray[np.float64]

ADIABATIC_K_PER_M = 9.8e-3
"""Unsaturated air whose temperature falls faster overturns within minutes [K/m']."""

OVERTURNING_M = 500.0
"""... but over less height than this a sunny field, or a lag, may show it [m']."""

CERTAIN = 3.0
"""Sigmas by which a lapse rate must exceed the adiabatic one."""

FARTHEST = 5.0
"""Sigmas of the climatology that no air of the real soundings comes near (2.9 at most)."""

MISFIT = 5.0
"""A source whose sigmas had to be widened more than this disagrees with the others."""

TOGETHER_S = 1800.0
"""Within so long the air hardly changes; over hours the readings of a good thermometer disagree."""

HARMLESS_K, HARMLESS_LOG_P = 1.0, 1e-3
"""Held-out residuals of so little are no reason to fall back: a sharp inversion leaves them."""


def implausible(made: Estimate, background: Climatology) -> str | None:
    """Why an estimate cannot be air, in words; None where it can.

    Looks at the knots between the lowest and the highest measurement: temperatures outside 180
    to 335 K, a fall steeper than the dry adiabat by 3 sigma over 500 m, or a temperature 5 sigma
    from the climatology.
    """
    layers = made.profile.layers
    # A balloon goes higher than a climatology does.
    bounds = (layers.edge, background.profile.layers.edge)
    low = max(made.sources.low, *(float(edge[0]) for edge in bounds))
    high = min(made.sources.high, *(float(edge[-1]) for edge in bounds))
    h = np.arange(low, max(high, low + 1.0), 50.0)
    height = background.profile.gravity.height(h)
    t = made.profile.temperature(height)
    if not bool(np.all((t > COLDEST_K) & (t < WARMEST_K))):
        return f"temperatures of {t.min():.0f} to {t.max():.0f} K are none of air"
    spread = background.spread.sigma_temperature(made.profile.break_heights_m)
    sigma = np.interp(h, layers.edge, spread)
    departure = (t - background.profile.temperature(height)) / sigma
    worst = int(np.argmax(np.abs(departure)))
    if abs(departure[worst]) > FARTHEST:
        return (
            f"{t[worst]:.0f} K at {height[worst]:.0f} m is {abs(departure[worst]):.1f} sigma from "
            "the climatology"
        )
    over = round(OVERTURNING_M / 50.0)
    if h.size > over:
        fall = t[:-over] - t[over:] - ADIABATIC_K_PER_M * OVERTURNING_M
        excess = fall - CERTAIN * _sigma_of_difference(made, h, over)
        steepest = int(np.argmax(excess))
        if excess[steepest] > 0.0:
            lapse = (t[steepest] - t[steepest + over]) / OVERTURNING_M * 1000.0
            return (
                f"temperature falls by {lapse:.1f} K/km above {height[steepest]:.0f} m: air "
                "overturns at 9.8 K/km"
            )
    return None


def _sigma_of_difference(made: Estimate, h: Array, over: int) -> Array:
    """One sigma of T(h) - T(h + 500 m) [K]; that of T_M stands for it."""
    edge = made.profile.layers.edge
    weights = hats(edge, h[:-over]) - hats(edge, h[over:])
    matrix = made.covariance.matrix[: edge.size, : edge.size]
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", weights @ matrix, weights)))


def worse_than_climatology(
    made: Estimate,
    background: Climatology,
    moisture: Climatology | None,
    called: str = "the climatology",
) -> str | None:
    """Why an estimate would be worse than its background, in words; None where it is better.

    Every other bin of thermometer and barometer is held out; the estimate from the others must
    foretell them, about their median, better than the climatology does. Readings that belong
    together do, whatever is wrong with them all; noise from nowhere does not.
    """
    found = made.sources
    layout = layout_of(found, background)
    prior = prior_of(layout, background, moisture or background)
    flown = [s for s in found.sources if isinstance(s, Thermometer | Barometer)]
    shown, hidden = [], []
    for source in found.sources:
        other = np.arange(source.height.size) % 2 == 1
        if source in flown and bool(other.any()):
            shown.append(part_of(source, ~other))
            hidden.append(part_of(source, other))
        else:
            shown.append(source)
    if not hidden:
        return None
    profile = background.profile
    air = solve(layout, prior, shown, profile, made.state).air
    pressure = profile.pressure(profile.gravity.height(layout.knot))
    expected = air_of(layout, prior.mean, pressure, profile.constant)
    for source in hidden:
        ours, theirs = (_misfit(source.value - source.predict(a)[0]) for a in (air, expected))
        harmless = HARMLESS_LOG_P if isinstance(source, Barometer) else HARMLESS_K
        if ours > max(theirs, harmless):
            unit, factor = ("%", 100.0) if isinstance(source, Barometer) else ("K", 1.0)
            return (
                f"readings of {source.name} that were held out differ by {factor * ours:.2f} "
                f"{unit} from the estimate and by {factor * theirs:.2f} {unit} from {called}"
            )
    return None


def not_outside(
    samples: AirSamples, made: Estimate, background: Climatology, moisture: Climatology | None
) -> str | None:
    """Why the thermometer of a flight with a barometer cannot be outside; None where it can.

    ``made`` is an estimate with both. Its readings within half an hour differ from those of any air
    that the barometer allows; or the barometer does from any that the thermometer allows, and fits
    plausible air of its own. Both without soundings and stations.
    """
    temperature, pressure = samples.temperature, samples.pressure
    if temperature is None or pressure is None or samples.board_temperature:
        return None

    def air_of_flight(part: AirSamples) -> Estimate:
        return estimate(part, background, moisture=moisture)

    if _widened(made, Thermometer) > MISFIT:
        widened = _widened(air_of_flight(_half_an_hour(samples)), Thermometer)
        if widened > MISFIT:
            return (
                f"its readings within {TOGETHER_S / 60.0:.0f} minutes, beside {pressure.name} "
                f"against GNSS height, fit air only with sigmas widened {widened:.0f} times"
            )
    if _widened(made, Barometer) > MISFIT:
        widened = _widened(air_of_flight(samples), Barometer)
        alone = air_of_flight(replace(samples, temperature=None))
        fits = _widened(alone, Barometer) <= MISFIT and implausible(alone, background) is None
        if widened > MISFIT and fits:
            return (
                f"{pressure.name} against GNSS height fits plausible air, but with these "
                f"temperatures only if its sigmas are widened {widened:.0f} times"
            )
    return None


def _half_an_hour(samples: AirSamples) -> AirSamples:
    """The flight until half an hour after its thermometer's first accepted reading."""
    sensor = samples.temperature
    if sensor is None or not bool(sensor.accepted.any()):
        return samples
    until = int(sensor.time_ns[sensor.accepted][0]) + round(TOGETHER_S * 1e9)

    def early(part: SensorSamples | None) -> SensorSamples | None:
        return part and replace(part, accepted=part.accepted & (part.time_ns <= until))

    return replace(
        samples,
        temperature=early(samples.temperature),
        pressure=early(samples.pressure),
        humidity=early(samples.humidity),
    )


def _widened(made: Estimate, kind: type) -> float:
    """How far the sigmas of a kind of source were widened."""
    sources = zip(made.sources.sources, made.fits, strict=True)
    return max((fit.widened for source, fit in sources if isinstance(source, kind)), default=1.0)


def _misfit(residual: Array) -> float:
    """Median distance from the median, as one sigma."""
    return float(1.4826 * np.median(np.abs(residual - np.median(residual))))
