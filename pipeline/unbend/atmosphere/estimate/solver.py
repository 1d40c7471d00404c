"""The air of a flight by robust least squares from everything that was measured.

Gauss-Newton on the state of `state`, with the observation equations of `sensors`: minimise
sum rho((y - f(x))/sigma) + (x - x_b)^T B^-1 (x - x_b). The loss rho is Student's for readings, so
that outliers lose weight, and square for the background.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate import hypotheses
from unbend.atmosphere.estimate import state as states
from unbend.atmosphere.estimate.external_readings import TimeAndPlace
from unbend.atmosphere.estimate.hypotheses import Evidence, Hypothesis
from unbend.atmosphere.estimate.readings import FlightReadings, collect_readings
from unbend.atmosphere.estimate.sensors import Readings, SensorSettings
from unbend.atmosphere.estimate.state import AirAtKnots, Layout, Prior, SensorFault, air_of
from unbend.atmosphere.layers import RELAXED, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.units import Array

FREEDOM = 4.0  # degrees of freedom of Student's loss: a bin 5 sigma off weighs a sixth

_HUBER = 3.0  # of the first iterations, while residuals are still those of the background
_HUBER_STEPS, _MOST_STEPS = 3, 80
_CONVERGED_K = 2e-3
_SETTLED = 0.02  # relative change of inflation factors in the last step
_DRIFT_FREEDOM = 1.0  # that the expected size of a drift weighs, against those of the flight
_LEAST_SHARE = 1.0 / 64.0  # of a step, halved whenever it turns back
_REGAINED, _LATE, _REGAINED_LATE = 1.5, 20, 1.1  # by each that does not: slowly in the end
_EXPECTED_SQUARE = 0.786  # of a normal residual under Student's weights
_MOST_CORRELATED = 0.8  # the few bins of a flight do not determine more
_MISFIT_OF_A_MINIMUM = 5.0  # ln of a likelihood, by which a second minimum may be worse
_CORRELATED = 0.2  # neighbouring residuals that correlate more than this are not independent


@dataclass(frozen=True)
class FaultEstimate:
    """A sensor fault as estimated."""

    fault: SensorFault
    value: float
    sigma: float
    prior_sigma: float

    def in_units(self) -> "FaultEstimate":
        """The same in the unit of its text: the decay time, whose logarithm is estimated."""
        if self.fault is not SensorFault.TRANSIENT_DECAY:
            return self
        time = float(np.exp(self.value))
        return FaultEstimate(self.fault, time, time * self.sigma, time * self.prior_sigma)


@dataclass(frozen=True)
class Fit:
    """How a set of readings fits: ``count`` of bins or levels, ``rms`` residual in sigmas, and the
    factor by which its sigmas were multiplied.

    ``signal_freedom`` are its degrees of freedom for signal, its weight among the sources: the
    trace of its share of the information times the covariance (Rodgers 2000, Eq. 2.80).
    """

    name: str
    quantity: str
    count: int
    rms: float
    sigma_inflation: float
    signal_freedom: float = 0.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """The air of a flight, in layers between the knots.

    ``background_sigma_k`` (k,) prior sigma of temperature at the knots; ``state`` the solution
    itself, and ``converged`` whether temperatures moved by less than 2 mK in the last step;
    ``drift_scales`` the sigma of each drift over the expected one, by the residuals; ``layout``
    that of the hypothesis that fits best, and ``chances`` how probable each is, by its name.
    """

    profile: Profile
    covariance: ProfileCovariance
    background_sigma_k: Array
    faults: tuple[FaultEstimate, ...]
    fits: tuple[Fit, ...]
    readings: FlightReadings
    state: Array
    converged: bool
    drift_scales: Mapping[str, float]
    layout: Layout
    chances: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Solution:
    """State, its covariance, and the air of it.

    ``prior`` has the drifts as large as they are; ``weights`` (m,) are those of each set of
    readings in the last step.
    """

    x: Array
    covariance: Array
    air: AirAtKnots
    fits: tuple[Fit, ...]
    converged: bool
    drift_scales: Mapping[str, float]
    prior: Prior
    weights: tuple[Array, ...]

    @property
    def log_inflation(self) -> float:
        """Sum of ln of the factors by which the sigmas of its readings were multiplied."""
        return float(sum(fit.count * np.log(fit.sigma_inflation) for fit in self.fits))

    def evidence(self, share: float) -> Evidence:
        """What it says for its hypothesis, whose ``share`` is its probability beforehand."""
        return Evidence(share, self.air, self.prior, self.weights, self.log_inflation)

    def profile(self, background: Profile) -> tuple[Profile, ProfileCovariance]:
        """The layers of the state, and the covariance of what defines them: T_M, ln p, e/p."""
        air, layout, constant = self.air, self.air.layout, background.constant
        k = layout.knot.size
        layers = stack_layers(
            layout.knot, air.virtual, air.vapour, (RELAXED,) * (k - 1), constant=constant,
            anchor=(layout.reference, float(np.exp(self.x[layout.level]))),
        )  # fmt: skip
        profile = Profile(layers, background.gravity, background.index, constant=constant)
        by_state = np.zeros((2 * k + 1, layout.size))
        by_state[:k, layout.temperature] = np.diag(air.virtual_by_t)
        by_state[:k, layout.humidity] = air.virtual_by_rh[:, None] * air.spreading
        by_state[k, layout.level] = 1.0
        by_state[k + 1 :, layout.temperature] = np.diag(air.vapour_by_t)
        by_state[k + 1 :, layout.humidity] = air.vapour_by_rh[:, None] * air.spreading
        matrix = by_state @ self.covariance @ by_state.T
        return profile, ProfileCovariance(profile, layout.reference, 0.5 * (matrix + matrix.T))


def estimate(
    samples: AirSamples,
    background: Climatology,
    *,
    settings: SensorSettings | None = None,
    moisture: Climatology | None = None,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    flight: TimeAndPlace | None = None,
    known: Sequence[FaultEstimate] = (),
) -> Estimate:
    """The air by samples, soundings and surface reports, with its covariance.

    ``samples`` of the flight, or of a part of it; without any it is the background with its own
    covariance. ``moisture``: expected humidity, where the background is a dry standard. ``flight``:
    when and where it was; without it the samples give the time. ``known``: sensor faults as
    estimated before, which replace the expected ones.

    Cost grows linearly with the number of samples (binning) and with the cube of about 300 states:
    4 hours of three sensors at 10 Hz, 144,000 samples each, take 0.6 s on one core.

    >>> from unbend.atmosphere.climatology import climatology
    >>> made = estimate(AirSamples(), climatology(latitude_rad=0.8, month=7.0))
    >>> made.covariance.sigma_temperature([0.0, 5000.0]).round(1).tolist()
    [6.7, 4.9]
    """
    settings = settings or SensorSettings()
    readings = collect_readings(
        samples, background, settings, soundings=soundings, surface=surface, flight=flight
    )
    before = {f.fault: f for f in known}
    faults = tuple(
        replace(fault, mean=f.value, sigma=f.sigma) if (f := before.get(fault.name)) else fault
        for fault in readings.faults
    )
    rare = tuple(fault for fault in readings.rare if before.keys().isdisjoint(fault.faults))
    readings = replace(readings, faults=faults, rare=rare)
    every = hypotheses.hypotheses_of(layout_of(readings, background), rare)
    solutions = _solved(every, readings.sets, background, moisture or background)
    evidence = [
        solution.evidence(hypothesis.share)
        for hypothesis, solution in zip(every, solutions, strict=True)
    ]
    chances = hypotheses.probabilities(evidence, readings.sets)
    fitting = hypotheses.best_fitting(evidence, chances)
    solution = _mixture(solutions, chances, fitting, background.profile)
    return Estimate(
        *solution.profile(background.profile),
        solution.prior.sigma_temperature,
        _fault_estimates(solution, hypotheses.prior_sigmas(every)),
        solution.fits,
        readings,
        solution.x,
        solution.converged,
        solution.drift_scales,
        every[fitting].layout,
        hypotheses.described_chances([hypothesis.name for hypothesis in every], chances),
    )


def _solved(
    every: Sequence[Hypothesis],
    sets: Sequence[Readings],
    background: Climatology,
    moisture: Climatology,
) -> list[Solution]:
    """The solution of each hypothesis, the first of which is that of usual sensors.

    One that misfits by much more than another may be at a second minimum: it is solved again from
    where the other ended, and kept where that fits better.
    """
    profile = background.profile
    solutions = list[Solution]()
    priors = list[Prior]()
    for hypothesis in every:
        start = solutions[0].x if hypothesis.is_linear else None
        prior = states.prior_of(hypothesis.layout, background, moisture)
        priors.append(prior)
        solutions.append(solve(hypothesis.layout, prior, sets, profile, start))
    best = min(solutions, key=lambda solution: solution.log_inflation)
    for number, solution in enumerate(solutions):
        if solution.log_inflation < best.log_inflation + _MISFIT_OF_A_MINIMUM:
            continue
        again = solve(every[number].layout, priors[number], sets, profile, best.x)
        if again.log_inflation < solution.log_inflation:
            solutions[number] = again
    return solutions


def _mixture(
    solutions: Sequence[Solution], chances: Array, fitting: int, background: Profile
) -> Solution:
    """The solution of all hypotheses together.

    It is that which fits best, with the mean and covariance of the mixture.
    """
    solution = solutions[fitting]
    if len(solutions) == 1:
        return solution
    layout = solution.air.layout
    x, covariance = hypotheses.mixed_moments(
        [each.x for each in solutions], [each.covariance for each in solutions], chances
    )
    air = air_of(layout, x, solution.air.pressure_at_knots(), background.constant)
    return replace(solution, x=x, covariance=covariance, air=air)


def _fault_estimates(
    solution: Solution, prior_sigma: Mapping[states.SensorFault, float]
) -> tuple[FaultEstimate, ...]:
    """The sensor faults of a solution, with their sigma before the flight."""
    layout = solution.air.layout
    sigma = np.sqrt(np.diag(solution.covariance))
    return tuple(
        FaultEstimate(fault.name, float(solution.x[i]), float(sigma[i]), prior_sigma[fault.name])
        for i, fault in enumerate(layout.faults, layout.level + 1)
    )


def layout_of(readings: FlightReadings, background: Climatology) -> Layout:
    """Knots for the heights that were measured; ln p is a state at the lowest of them."""
    knot = states.place_knots(readings.low, readings.high, background.profile.layers.edge)
    humid = states.place_humid_knots(readings.low, readings.high)
    return Layout(knot, humid, readings.low, readings.faults, readings.drifts)


def solve(
    layout: Layout,
    prior: Prior,
    sets: Sequence[Readings],
    background: Profile,
    start: Array | None = None,
) -> Solution:
    """Gauss-Newton with iterated weights; C = (J^T W J + B^-1)^-1.

    Where the residuals of a set of readings are larger than its sigmas, or neighbours in it
    correlate, its sigmas are multiplied by an inflation factor until they fit, so that C is not too
    small. The sigma of a drift follows from the drift itself (`drift_variances`). ``start`` is a
    state near the solution; without it the iteration begins at the prior, with a loss that has one
    minimum. Lag times the shape of T(H) is not linear, and whole steps may oscillate (in 38 of 84
    flights, by 0.1 to 0.3 K): a step that turns back is halved.
    """
    x = prior.mean.copy() if start is None else start
    pressure = background.pressure(background.gravity.height(layout.knot))
    inflation, variance = np.ones(len(sets)), np.ones(len(layout.drifts))
    expected = prior
    share, before, converged = 1.0, np.zeros(layout.knot.size), False
    for step in range(0 if start is None else _HUBER_STEPS, _MOST_STEPS):
        air = air_of(layout, x, pressure, background.constant)
        prior = expected.with_drifts(layout, variance)
        normal, right, after, of_sets = _normal_equations(prior, sets, air, inflation, step)
        change = linalg.solve(normal, right, assume_a="pos")
        warming = change[layout.temperature]
        back = bool(warming @ before < 0.0)
        gain = _REGAINED if step < _LATE else _REGAINED_LATE
        share = max(0.5 * share, _LEAST_SHARE) if back else min(gain * share, 1.0)
        before, x = warming, layout.bounded(x + share * change)
        air = air_of(layout, x, pressure, background.constant)
        pressure = air.pressure_at_knots()
        moved = float(np.abs(warming).max()) * (share if back else 1.0)
        settled = bool(np.all(np.abs(after / inflation - 1.0) < _SETTLED))
        inflation = after
        if _HUBER_STEPS < step < _LATE:
            drifted = drift_variances(expected.precision, layout, x, normal, variance)
            settled = settled and bool(np.all(np.abs(drifted / variance - 1.0) < 2.0 * _SETTLED))
            variance = drifted
        converged = step > _HUBER_STEPS + 1 and settled and moved < _CONVERGED_K
        if converged:
            break
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    air = air_of(layout, x, pressure, background.constant)
    fits = tuple(
        replace(fit, signal_freedom=float(np.sum(covariance * information)))
        for fit, information, _ in of_sets
    )
    scales = zip((drift.name for drift in layout.drifts), np.sqrt(variance), strict=True)
    drift_scales = {name: float(scale) for name, scale in scales}
    weights = tuple(weight for *_, weight in of_sets)
    return Solution(x, covariance, air, fits, converged, drift_scales, prior, weights)


def drift_variances(
    precision: Array, layout: Layout, x: Array, normal: Array, variance: Array
) -> Array:
    """The variance of each drift over the expected one, by the drift d as estimated.

    Maximum of the marginal likelihood by MacKay's step (1992, Neural Comput. 4, 415, Eq. 4.8):
    (d^T P d + nu)/(gamma + nu), where P is the expected precision, gamma the degrees of freedom
    for signal of the drift, and nu those of the expectation itself.
    """
    after = np.ones(variance.size)
    factor = linalg.cho_factor(normal)
    for i, drift in enumerate(layout.drifts):
        least, most = drift.scales
        if least == most:
            continue
        where = layout.drift(drift.name)[1]
        columns = np.zeros((layout.size, drift.knot.size))
        columns[where] = precision[where, where] / variance[i]
        freedom = drift.knot.size - float(np.trace(linalg.cho_solve(factor, columns)[where]))
        square = float(x[where] @ precision[where, where] @ x[where])
        ratio = (square + _DRIFT_FREEDOM) / (freedom + _DRIFT_FREEDOM)
        after[i] = min(max(ratio, least**2), most**2)
    return after


def _normal_equations(
    prior: Prior, sets: Sequence[Readings], air: AirAtKnots, inflation: Array, step: int
) -> tuple[Array, Array, Array, list[tuple[Fit, Array, Array]]]:
    """Matrix and right side, and the inflation of the next step.

    And of each set its fit, its share of the matrix, and its weights.
    """
    normal, right = prior.precision.copy(), prior.precision @ (prior.mean - air.x)
    after = inflation.copy()
    of_sets = []
    for i, readings in enumerate(sets):
        predicted, jacobian = readings.predict(air)
        residual = readings.value - predicted
        sigma = readings.sigma * inflation[i]
        z = residual / sigma
        if not readings.robust:
            loss = np.ones(z.size)
        elif step < _HUBER_STEPS:
            loss = 1.0 / np.maximum(1.0, np.abs(z) / _HUBER)
        else:
            loss = (FREEDOM + 1.0) / (FREEDOM + z * z)
        weight = loss / sigma**2
        # A matrix times its own transpose costs half of a product of two.
        weighted = jacobian * np.sqrt(weight)[:, None]
        information = weighted.T @ weighted
        normal += information
        right += jacobian.T @ (weight * residual)
        if readings.robust and step > _HUBER_STEPS and z.size >= 5:
            # Ratio of the variance of the residuals to that of their sigmas. Readings are in the
            # order of their bins, so neighbours are near in time and height; a first-order process
            # with correlation r has means as uncertain as (1 + r)/(1 - r) times the variance.
            square = float(np.mean(loss * z * z)) / _EXPECTED_SQUARE
            bounded = np.sqrt(loss) * z
            pairs = np.sum(bounded[1:] ** 2 + bounded[:-1] ** 2)
            correlation = float(2.0 * np.sum(bounded[1:] * bounded[:-1]) / max(pairs, 1e-12))
            correlation = min(correlation, _MOST_CORRELATED)
            if correlation > _CORRELATED:
                square *= (1.0 + correlation) / (1.0 - correlation)
            after[i] = max(1.0, inflation[i] * np.sqrt(square))
        rms = float(np.sqrt(np.mean(np.square(residual / readings.sigma)))) if z.size else 0.0
        fit = Fit(readings.name, readings.quantity, z.size, rms, float(after[i]))
        of_sets.append((fit, information, weight))
    return normal, right, after, of_sets
