"""What may rarely be wrong with a sensor: the flight is estimated without and with each of it.

One normal distribution wide enough for what is rare would make every flight uncertain, and an
estimate without it is sure and wrong. So the air is a mixture: of the estimate with usual sensors
and of one for each rare fault, by how probable each is beforehand and with the flight's readings.
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

NOT_IMPROBABLE = 0.05  # a hypothesis with less chance excuses no misfit
MOST_BY_CLIMATOLOGY = 0.25
"""The largest chance of rare faults where nothing measures temperature. Air is rarely, but more
often than a normal distribution says, as far from the climatology as a pressure that loses 4 %
makes it look: an outbreak of arctic air over Vienna, 10 to 21 K too cold up to 6 km, was a leak
with 99.8 %. With this chance a leak that there is leaves an error of 1.7 sigma."""

LIKELY = 0.5  # a rare fault that is more probable than this is reported


@dataclass(frozen=True)
class RareFault:
    """What few sensors have: ``share`` of all.

    ``faults``: what is expected of a sensor that has it, by fault: by how much it is beyond the
    usual mean, and its sigma. ``drifts``: the sigma of drifts then. ``is_linear``: readings are
    linear in its faults, so that its estimate is found from the usual one as well as from nowhere.
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
"""A thermometer that is only partly in the outside air, or not at all. Bays have 10 K more or less
than `BAY_K`, and change with time."""

WARM_CLIMB = RareFault(
    "a thermometer that the climb warms", 0.1, {SensorFault.CLIMB_WARMTH: (0.0, 2.0)}
)
"""Engine power, or the sun on one heading."""

RARE_FAULTS = (LOST_PRESSURE, IN_A_BAY, WARM_CLIMB)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What the sensors of a flight may be like, and how probable that is beforehand (``share``).

    ``layout`` has their faults and drifts as expected then. ``is_linear``: see `RareFault`.
    """

    name: str
    share: float
    layout: Layout
    is_linear: bool = False


def hypotheses_of(layout: Layout, rare_faults: Sequence[RareFault]) -> list[Hypothesis]:
    """The sensors as they usually are, and with each rare fault that the flight may have."""
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
    """A fault as expected of a sensor that has what is rare."""
    if fault.name not in rare.faults:
        return fault
    beyond, sigma = rare.faults[fault.name]
    return replace(fault, mean=fault.mean + beyond, sigma=sigma)


def _drift_as_rare(drift: Drift | Departure, rare: RareFault) -> Drift | Departure:
    """A drift as expected of a sensor that has what is rare: alike at all heights."""
    if not isinstance(drift, Drift) or drift.name not in rare.drifts:
        return drift
    return replace(drift, sigma=rare.drifts[drift.name], scales=(1.0, 1.0))


def prior_sigmas(hypotheses: Sequence[Hypothesis]) -> dict[SensorFault, float]:
    """The sigma of each fault before the flight, about its usual mean, over all hypotheses."""
    usual = hypotheses[0].layout.faults
    variances = dict.fromkeys((fault.name for fault in usual), 0.0)
    for hypothesis in hypotheses:
        for fault, expected in zip(hypothesis.layout.faults, usual, strict=True):
            beyond_usual = fault.mean - expected.mean
            square = fault.sigma**2 + beyond_usual**2
            variances[fault.name] += hypothesis.share * square
    return {name: float(np.sqrt(variance)) for name, variance in variances.items()}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a solution says for its hypothesis, which has a ``share`` beforehand.

    Its ``air``, its ``prior``, the weights (m,) of each set of readings, and the sum of ln of the
    factors by which the sigmas of readings were multiplied.
    """

    share: float
    air: AirAtKnots
    prior: Prior
    weights: tuple[Array, ...]
    log_sigma: float


def probabilities(solved: Sequence[Evidence], sets: Sequence[Readings]) -> NDArray[np.float64]:
    """How probable each hypothesis is with the readings.

    The first is that of usual sensors. All are judged with the same weights of the readings: those
    of the hypothesis whose sigmas were inflated least. So no hypothesis excuses its misfit by
    larger sigmas. Where nothing measures temperature, the chances of all faults together are at
    most `MOST_BY_CLIMATOLOGY`.
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
    """Which hypothesis fits best, by the least inflation, of those that are not improbable.

    What none of these explains is a contradiction of the sensors.
    """
    possible = np.flatnonzero(chances >= NOT_IMPROBABLE)
    inflated = np.array([evidence.log_sigma for evidence in solved])
    order = np.lexsort((-chances[possible], inflated[possible]))
    return int(possible[order[0]])


def _log_likelihood(
    evidence: Evidence, sets: Sequence[Readings], weights: Sequence[Array]
) -> float:
    """ln of the marginal likelihood of the readings in the normal approximation.

    -(cost + ln det(C_prior) - ln det(C))/2, but for what is the same in all hypotheses, where the
    cost is that of the minimum which a last step with these weights would reach.
    """
    departure = evidence.prior.mean - evidence.air.x
    normal = evidence.prior.precision.copy()
    right = normal @ departure
    cost = float(departure @ right)
    for readings, weight in zip(sets, weights, strict=True):
        predicted, jacobian = readings.predict(evidence.air)
        residual = readings.value - predicted
        normal += (jacobian.T * weight) @ jacobian
        right += jacobian.T @ (weight * residual)
        cost += float(weight @ residual**2)
    cost -= float(right @ np.linalg.solve(normal, right))
    of_prior = float(np.linalg.slogdet(evidence.prior.precision)[1])
    of_posterior = float(np.linalg.slogdet(normal)[1])
    return 0.5 * (of_prior - of_posterior - cost)


def mixed_moments(
    states: Sequence[Array], covariances: Sequence[Array], chances: Array
) -> tuple[Array, Array]:
    """Mean and covariance of a mixture of normal distributions."""
    mean = np.average(states, axis=0, weights=chances)
    mixed = np.zeros_like(covariances[0])
    for chance, state, covariance in zip(chances, states, covariances, strict=True):
        away = state - mean
        mixed += chance * (covariance + np.outer(away, away))
    return mean, mixed


def described_chances(names: Sequence[str], chances: Array) -> Mapping[str, float]:
    """The probability of each hypothesis, by its name."""
    return {name: float(chance) for name, chance in zip(names, chances, strict=True)}
