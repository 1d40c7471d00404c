"""Rare sensor faults: the flight is estimated with usual sensors, and once with each rare fault.

A prior wide enough for rare faults would make every flight uncertain, and an estimate without them
is certain and wrong where there is one. So the air is a mixture of these estimates, weighted by the
probability of each: how frequent the fault is, and how well the flight's readings fit it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.estimate.sensors import Readings
from unbend.atmosphere.estimate.state import (
    AirAtKnots,
    Departure,
    Drift,
    Fault,
    Layout,
    Prior,
    SensorFault,
)
from unbend.units import Array

USUAL = "usual sensors"

NOT_IMPROBABLE = 0.05  # a hypothesis with less probability does not excuse a misfit
MOST_BY_CLIMATOLOGY = 0.25
"""The largest chance of rare faults where nothing measures temperature. Air is rarely, but more
often than a normal distribution says, as far from the climatology as a pressure that loses 4 %
makes it look: an outbreak of arctic air over Vienna, 10 to 21 K too cold up to 6 km, was a leak
with 99.8 %. With this chance a leak that there is leaves an error of 1.7 sigma."""

LIKELY = 0.5  # a rare fault that is more probable than this is reported


@dataclass(frozen=True)
class RareFault:
    """A condition that few sensors have; ``share`` is the fraction of sensors that have it.

    ``faults``: the prior of each sensor fault in this condition, as (what is added to the usual
    mean, sigma). ``drifts``: sigma of drifts in this condition, by their names. ``is_linear``:
    whether readings are linear in these faults; then its estimate may begin at that of usual
    sensors.
    """

    name: str
    share: float
    faults: Mapping[SensorFault, tuple[float, float]]
    drifts: Mapping[str, float] = field(default_factory=dict)
    is_linear: bool = True


LOST_PRESSURE = RareFault(
    "a static pressure that loses its change", 0.1, {SensorFault.PRESSURE_SCALE: (0.0, 0.03)}
)
"""A leak, a cabin's air: some per cent."""

IN_A_BAY = RareFault(
    "a thermometer in a bay",
    0.2,
    {SensorFault.BAY_SHARE: (0.5, 0.3), SensorFault.THERMOMETER_BIAS: (0.0, 6.0)},
    {SensorFault.THERMOMETER_DRIFT: 1.0},
    is_linear=False,
)
"""A thermometer that is only partly in the outside air, or not at all. Bays are some 10 K warmer
or colder than `sensors.BAY_K`, and change with time."""

WARM_CLIMB = RareFault(
    "a thermometer that the climb warms", 0.1, {SensorFault.CLIMB_WARMTH: (0.0, 2.0)}
)
"""Engine power, or the sun on one heading."""

RARE_FAULTS = (LOST_PRESSURE, IN_A_BAY, WARM_CLIMB)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An assumption on the sensors of a flight: that they are usual, or have a rare fault.

    ``share``: its probability before the flight. ``layout``: of the state, with the priors of
    faults and drifts under this assumption. ``is_linear``: see `RareFault`.
    """

    name: str
    share: float
    layout: Layout
    is_linear: bool = False


def hypotheses_of(layout: Layout, rare_faults: Sequence[RareFault]) -> list[Hypothesis]:
    """The hypotheses on a flight's sensors: usual sensors first, then each rare fault alone.

    ``layout``: with the usual priors.
    """
    usual_share = 1.0 - sum(rare.share for rare in rare_faults)
    hypotheses = [Hypothesis(USUAL, usual_share, layout)]
    for rare in rare_faults:
        faults = tuple(_fault_as_rare(fault, rare) for fault in layout.faults)
        drifts = tuple(_drift_as_rare(drift, rare) for drift in layout.drifts)
        with_fault = replace(layout, faults=faults, drifts=drifts)
        hypothesis = Hypothesis(
            name=rare.name,
            share=rare.share,
            layout=with_fault,
            is_linear=rare.is_linear,
        )
        hypotheses.append(hypothesis)
    return hypotheses


def _fault_as_rare(fault: Fault, rare: RareFault) -> Fault:
    """The prior of a fault for a sensor with a rare fault; unchanged if this is another fault."""
    if fault.name not in rare.faults:
        return fault
    added_mean, sigma = rare.faults[fault.name]
    return replace(fault, mean=fault.mean + added_mean, sigma=sigma)


def _drift_as_rare(drift: Drift | Departure, rare: RareFault) -> Drift | Departure:
    """The prior of a drift for a sensor with a rare fault: one fixed sigma at all knots.

    Unchanged if the rare fault does not concern it.
    """
    if not isinstance(drift, Drift) or drift.name not in rare.drifts:
        return drift
    return replace(drift, sigma=rare.drifts[drift.name], scales=(1.0, 1.0))


def prior_sigmas(hypotheses: Sequence[Hypothesis]) -> dict[SensorFault, float]:
    """The prior sigma of each fault about its usual mean, for the mixture of all hypotheses."""
    usual_faults = hypotheses[0].layout.faults
    variances = dict.fromkeys((fault.name for fault in usual_faults), 0.0)
    for hypothesis in hypotheses:
        for fault, usual_fault in zip(hypothesis.layout.faults, usual_faults, strict=True):
            added_mean = fault.mean - usual_fault.mean
            square = fault.sigma**2 + added_mean**2
            variances[fault.name] += hypothesis.share * square
    return {name: float(np.sqrt(variance)) for name, variance in variances.items()}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the probability of a hypothesis is computed from: its solution, and its prior.

    ``share``: probability of the hypothesis before the flight. ``air``: of the solution.
    ``weights``: (m,) of each set of readings. ``log_sigma``: sum over all readings of ln of their
    sigma inflation factor.
    """

    share: float
    air: AirAtKnots
    prior: Prior
    weights: tuple[Array, ...]
    log_sigma: float


def probabilities(solved: Sequence[Evidence], sets: Sequence[Readings]) -> NDArray[np.float64]:
    """(h,) the probability of each hypothesis, given the readings ``sets``; the sum is 1.

    ``solved``: the evidence for each, usual sensors first. All are compared with the same weights
    of the readings, those of the hypothesis with the least inflated sigmas, so that no hypothesis
    excuses its misfit by larger sigmas. Where nothing measures temperature, the probability of all
    rare faults together is at most `MOST_BY_CLIMATOLOGY`.
    """
    best = min(solved, key=lambda evidence: evidence.log_sigma)
    logs = np.zeros(len(solved))
    for number, evidence in enumerate(solved):
        log_likelihood = _log_likelihood(evidence, sets, best.weights)
        logs[number] = np.log(evidence.share) + log_likelihood
    chances = np.exp(logs - logs.max())
    chances /= chances.sum()
    has_temperature = any(readings.quantity == "temperature" for readings in sets)
    of_faults = float(chances[1:].sum())
    if not has_temperature and of_faults > MOST_BY_CLIMATOLOGY:
        chances[1:] *= MOST_BY_CLIMATOLOGY / of_faults
        chances[0] = 1.0 - MOST_BY_CLIMATOLOGY
    return np.asarray(chances)


def best_fitting(solved: Sequence[Evidence], chances: Array) -> int:
    """The number of the hypothesis with the least inflated sigmas, of those of 5 % or more.

    Of equal ones the more probable. If even this one misfits, the sensors contradict each other.
    """
    possible = np.flatnonzero(chances >= NOT_IMPROBABLE)
    log_sigmas = np.array([evidence.log_sigma for evidence in solved])
    order = np.lexsort((-chances[possible], log_sigmas[possible]))  # the last key comes first
    return int(possible[order[0]])


def _log_likelihood(
    evidence: Evidence, sets: Sequence[Readings], weights: Sequence[Array]
) -> float:
    """ln of the marginal likelihood of the readings under a hypothesis, in normal approximation.

    -(cost + ln det(C_prior) - ln det(C))/2; terms that are the same in all hypotheses are left out.
    The cost is the least that one more Gauss-Newton step from the solution reaches. ``weights``:
    (m,) of each set of readings, the same for all hypotheses.
    """
    departure = evidence.prior.mean - evidence.air.x
    normal = evidence.prior.precision.copy()
    gradient = normal @ departure
    cost = float(departure @ gradient)
    for readings, weight in zip(sets, weights, strict=True):
        predicted, jacobian = readings.predict(evidence.air)
        residual = readings.value - predicted
        normal += (jacobian.T * weight) @ jacobian
        gradient += jacobian.T @ (weight * residual)
        cost += float(weight @ residual**2)
    cost -= float(gradient @ np.linalg.solve(normal, gradient))
    of_prior = float(np.linalg.slogdet(evidence.prior.precision)[1])
    of_posterior = float(np.linalg.slogdet(normal)[1])
    return 0.5 * (of_prior - of_posterior - cost)


def mixed_moments(
    states: Sequence[Array], covariances: Sequence[Array], chances: Array
) -> tuple[Array, Array]:
    """Mean (s,) and covariance (s, s) of a mixture of normal distributions.

    ``states``: the mean of each; ``chances`` (h,): the probability of each.
    """
    mean = np.average(states, axis=0, weights=chances)
    mixed = np.zeros_like(covariances[0])
    for chance, state, covariance in zip(chances, states, covariances, strict=True):
        away = state - mean
        mixed += chance * (covariance + np.outer(away, away))
    return mean, mixed


def described_chances(names: Sequence[str], chances: Array) -> Mapping[str, float]:
    """The probability of each hypothesis, by its name."""
    return {name: float(chance) for name, chance in zip(names, chances, strict=True)}
