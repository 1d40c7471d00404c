"""The air of a flight by least squares: everything measured, weighed by what is known of it.

Gauss-Newton on the state of `state`, with the readings of `measurements`: minimise
sum rho((y - f(x))/sigma) + (x - x_b)^T B^-1 (x - x_b). The loss rho is Student's for readings and
square for the background, so that readings can be outvoted and the background cannot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate.readings import Sources, sources_of
from pipeline.atmosphere.estimate.representativeness import TimeAndPlace
from pipeline.atmosphere.estimate.sensors import (
    Barometer,
    Humidities,
    Pressures,
    Source,
    Temperatures,
    Thermometer,
)
from pipeline.atmosphere.estimate.state import (
    Air,
    Fault,
    Layout,
    Prior,
    air_of,
    place_humid_knots,
    place_knots,
    prior_of,
)
from pipeline.atmosphere.profile import RELAXED, Profile, stack_layers
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport

Array = NDArray[np.float64]

FREEDOM = 4.0
"""Degrees of freedom of Student's loss: a bin 5 sigma off weighs a sixth."""

_QUANTITY: Mapping[type, str] = {
    Thermometer: "temperature",
    Barometer: "pressure",
    Temperatures: "temperature",
    Humidities: "humidity",
    Pressures: "pressure",
}

_HUBER = 3.0  # of the first iterations, while residuals are still those of the background
_HUBER_STEPS, _MOST_STEPS = 3, 80
_CONVERGED_K = 2e-3
_LEAST_SHARE = 1.0 / 64.0  # of a step, halved whenever it turns back
_REGAINED, _LATE, _REGAINED_LATE = 1.5, 20, 1.1  # by each that does not: slowly in the end
_EXPECTED_SQUARE = 0.786  # of a normal residual under Student's weights
_MOST_CORRELATED = 0.8  # no more can be told from the few bins of a flight
_CORRELATED = 0.2  # neighbouring residuals that correlate more than this are not independent


@dataclass(frozen=True)
class Nuisance:
    """A fault of a sensor as estimated."""

    name: str
    value: float
    sigma: float
    prior_sigma: float


@dataclass(frozen=True)
class Fit:
    """How a source fits, and how much it said.

    ``count`` of bins or levels; ``rms`` residual in sigmas; ``widened`` how far its sigmas were;
    ``told`` the number of unknowns that it determines (the trace of its share of the information
    times the covariance: Rodgers 2000, Eq. 2.80), which is its weight among the sources.
    """

    name: str
    quantity: str
    count: int
    rms: float
    widened: float
    told: float = 0.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """The air of a flight.

    ``profile`` has layers between the knots; ``covariance`` is that of the profile;
    ``background_sigma_k`` (k,) what the background knew of temperature at the knots;
    ``sources`` what was measured, with the outliers among the accepted samples of each sensor;
    ``state`` the solution itself, and ``converged`` whether it is one: temperatures moved by less
    than 2 mK in the last step.
    """

    profile: Profile
    covariance: ProfileCovariance
    background_sigma_k: Array
    nuisances: tuple[Nuisance, ...]
    fits: tuple[Fit, ...]
    sources: Sources
    state: Array
    converged: bool = True


@dataclass(frozen=True, eq=False)
class Solution:
    """State, its covariance, and the air of it."""

    x: Array
    covariance: Array
    air: Air
    fits: tuple[Fit, ...]
    converged: bool


def estimate(
    samples: AirSamples,
    background: Climatology,
    *,
    moisture: Climatology | None = None,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    occasion: TimeAndPlace | None = None,
    known: Sequence[Nuisance] = (),
) -> Estimate:
    """The air that samples, soundings and surface reports speak of, with its covariance.

    Parameters
    ----------
    samples : of the flight, or of a part of it.
    background : the climatology: expected air, spread, gravity and formula of the index.
    moisture : expected humidity, where the background is a dry standard.
    soundings, surface : of places and times near the flight.
    occasion : when and where the flight was; without it the samples tell the time.
    known : faults of the sensors as found before, which take the place of what is expected.

    With no samples at all it is the background with its own covariance. Cost grows linearly with
    the number of samples (binning) and with the cube of about 300 states: 4 hours of three
    sensors at 10 Hz, 144,000 samples each, take 0.6 s on one core.

    >>> from pipeline.atmosphere.climatology import climatology
    >>> made = estimate(AirSamples(), climatology(latitude_rad=0.8, month=7.0))
    >>> made.covariance.sigma_temperature([0.0, 5000.0]).round(1).tolist()
    [7.3, 4.9]
    """
    found = sources_of(samples, background, soundings, surface, occasion)
    before = {fault.name: fault for fault in known}
    found = replace(found, faults=tuple(_informed(f, before.get(f.name)) for f in found.faults))
    layout = layout_of(found, background)
    prior = prior_of(layout, background, moisture or background)
    solution = solve(layout, prior, found.sources, background.profile)
    profile, covariance = _profile_of(solution, background.profile)
    variance = np.diag(solution.covariance)
    nuisances = tuple(
        Nuisance(fault.name, float(solution.x[i]), float(np.sqrt(variance[i])), fault.sigma)
        for i, fault in enumerate(layout.faults, layout.level + 1)
    )
    return Estimate(
        profile,
        covariance,
        prior.sigma_temperature,
        nuisances,
        solution.fits,
        found,
        solution.x,
        solution.converged,
    )


def _informed(fault: Fault, before: Nuisance | None) -> Fault:
    """A fault with what was found of it before."""
    return fault if before is None else replace(fault, mean=before.value, sigma=before.sigma)


def layout_of(found: Sources, background: Climatology) -> Layout:
    """Knots for the heights that were measured; ln p stands at the lowest of them."""
    knot = place_knots(found.low, found.high, background.profile.layers.edge)
    humid = place_humid_knots(found.low, found.high)
    return Layout(knot, humid, found.low, found.faults, found.drifts)


def solve(
    layout: Layout,
    prior: Prior,
    sources: Sequence[Source],
    background: Profile,
    start: Array | None = None,
) -> Solution:
    """Gauss-Newton with iterated weights; C = (J^T W J + B^-1)^-1.

    Where the residuals of a source are larger than its sigmas say, or neighbours in it correlate
    (its errors are not independent, as the weights take them to be), its sigmas are widened until
    they fit: C never promises more than the residuals show. ``start`` is a state that is near
    already; else it begins at the prior, with a loss that has one minimum.

    The lag of a thermometer times the shape of T(H) is no straight line, and whole steps may jump
    to and fro for ever (in 38 of 84 flights, by 0.1 to 0.3 K): a step that turns back is halved.
    """
    x = prior.mean.copy() if start is None else start
    pressure = background.pressure(background.gravity.height(layout.knot))
    system = _System(np.empty(0), np.empty(0), np.ones(len(sources)), (), ())
    share, before, converged = 1.0, np.zeros(layout.knot.size), False
    for step in range(0 if start is None else _HUBER_STEPS, _MOST_STEPS):
        air = air_of(layout, x, pressure, background.constant)
        widened = system.widened
        system = _weighed(prior, sources, air, widened, step)
        change = linalg.solve(system.normal, system.right, assume_a="pos")
        warming = change[layout.temperature]
        back = bool(warming @ before < 0.0)
        regained = _REGAINED if step < _LATE else _REGAINED_LATE
        share = max(0.5 * share, _LEAST_SHARE) if back else min(regained * share, 1.0)
        before = warming
        x = layout.held(x + share * change)
        air = air_of(layout, x, pressure, background.constant)
        pressure = np.exp(air.log_pressure(layout.knot)[0])
        moved = float(np.abs(warming).max()) * (share if back else 1.0)
        settled = bool(np.all(np.abs(system.widened / widened - 1.0) < 0.02))
        converged = step > _HUBER_STEPS + 1 and settled and moved < _CONVERGED_K
        if converged:
            break
    air = air_of(layout, x, pressure, background.constant)
    covariance = np.asarray(np.linalg.inv(system.normal), dtype=np.float64)
    told = [float(np.sum(covariance * share)) for share in system.shares]
    fits = tuple(replace(f, told=t) for f, t in zip(system.fits, told, strict=True))
    return Solution(x, covariance, air, fits, converged)


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations at a state, the share of each source in them, and how it fits."""

    normal: Array
    right: Array
    widened: Array
    shares: tuple[Array, ...]
    fits: tuple[Fit, ...]


def _weighed(
    prior: Prior, sources: Sequence[Source], air: Air, widened: Array, step: int
) -> _System:
    """Prior and readings, each by what is known of it; ``widened`` is that of the next step."""
    normal, right = prior.precision.copy(), prior.precision @ (prior.mean - air.x)
    after = widened.copy()
    fits, shares = [], []
    for i, source in enumerate(sources):
        reading, jacobian = source.predict(air)
        residual = source.value - reading
        sigma = source.sigma * widened[i]
        z = residual / sigma
        loss = _loss_weight(z, step) if source.robust else np.ones(z.size)
        weight = loss / sigma**2
        shares.append((jacobian.T * weight) @ jacobian)
        normal += shares[-1]
        right += jacobian.T @ (weight * residual)
        if source.robust and step > _HUBER_STEPS:
            after[i] = max(1.0, widened[i] * np.sqrt(_excess(z, loss)))
        rms = float(np.sqrt(np.mean(np.square(residual / source.sigma)))) if z.size else 0.0
        quantity = _QUANTITY[type(source)]
        fits.append(Fit(source.name, quantity, z.size, rms, float(after[i])))
    return _System(normal, right, after, tuple(shares), tuple(fits))


def _loss_weight(z: Array, step: int) -> Array:
    """Weights of readings by their residuals [sigma]: Huber's to begin with, then Student's."""
    if step < _HUBER_STEPS:
        return 1.0 / np.maximum(1.0, np.abs(z) / _HUBER)
    return (FREEDOM + 1.0) / (FREEDOM + z * z)


def _excess(z: Array, loss: Array) -> float:
    """By how much the variance of residuals exceeds what their sigmas say.

    Readings are in the order of their bins, so neighbours are near in time and height; a first
    order process with correlation r has means as uncertain as (1 + r)/(1 - r) times the variance.
    """
    if z.size < 5:
        return 1.0
    square = float(np.mean(loss * z * z)) / _EXPECTED_SQUARE
    bounded = np.sqrt(loss) * z
    pairs = np.sum(bounded[1:] ** 2 + bounded[:-1] ** 2)
    together = float(2.0 * np.sum(bounded[1:] * bounded[:-1]) / max(pairs, 1e-12))
    together = min(together, _MOST_CORRELATED)
    if together > _CORRELATED:
        square *= (1.0 + together) / (1.0 - together)
    return square


def _profile_of(solution: Solution, background: Profile) -> tuple[Profile, ProfileCovariance]:
    """The layers of a state, and the covariance of what defines them: T_M, ln p, e/p."""
    air, layout = solution.air, solution.air.layout
    k = layout.knot.size
    layers = stack_layers(
        layout.knot,
        air.virtual,
        air.vapour,
        (RELAXED,) * (k - 1),
        anchor=(layout.reference, float(np.exp(solution.x[layout.level]))),
        constant=background.constant,
    )
    profile = Profile(layers, background.gravity, background.index, "adjusted", background.constant)
    by_state = np.zeros((2 * k + 1, layout.size))
    by_state[:k, layout.temperature] = np.diag(air.virtual_by_t)
    by_state[:k, layout.humidity] = air.virtual_by_rh[:, None] * air.spreading
    by_state[k, layout.level] = 1.0
    by_state[k + 1 :, layout.temperature] = np.diag(air.vapour_by_t)
    by_state[k + 1 :, layout.humidity] = air.vapour_by_rh[:, None] * air.spreading
    matrix = by_state @ solution.covariance @ by_state.T
    return profile, ProfileCovariance(profile, layout.reference, 0.5 * (matrix + matrix.T))
