"""The air of a flight by robust least squares from everything that was measured.

Gauss-Newton on the state of `state`, with the observation equations of `sensors`: minimise
sum rho((y - f(x))/sigma) + (x - x_b)^T B^-1 (x - x_b). The loss rho is Student's for readings, so
that outliers lose weight, and square for the background.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate import hypotheses
from unbend.atmosphere.estimate.external_readings import TimeAndPlace
from unbend.atmosphere.estimate.hypotheses import Evidence, Hypothesis
from unbend.atmosphere.estimate.normal_equations import (
    HUBER_STEPS,
    Fit,
    drift_variances,
    normal_equations,
)
from unbend.atmosphere.estimate.readings import FlightReadings, collect_readings
from unbend.atmosphere.estimate.sensors import Readings, SensorSettings
from unbend.atmosphere.estimate.state import (
    AirAtKnots,
    Layout,
    Prior,
    SensorFault,
    air_of,
    place_humid_knots,
    place_knots,
    prior_of,
)
from unbend.atmosphere.layers import RELAXED, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.units import Array

_MOST_STEPS = 80
_CONVERGED_K = 2e-3
_SETTLED = 0.02  # relative change of inflation factors in the last step
_LEAST_SHARE = 1.0 / 64.0  # of a step, halved whenever it turns back
_REGAINED = 1.5  # times the share of a step, by each that does not turn back
_LATE = 20  # from this step on the share grows slowly, and drifts keep their size
_REGAINED_LATE = 1.1
_MISFIT_OF_A_MINIMUM = 5.0  # ln of a likelihood, by which a second minimum may be worse


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
        air = self.air
        layout = air.layout
        k = layout.knot.size
        reference_pa = float(np.exp(self.x[layout.log_p]))
        layers = stack_layers(
            layout.knot,
            air.virtual,
            air.vapour,
            (RELAXED,) * (k - 1),
            anchor=(layout.reference, reference_pa),
            constant=background.constant,
        )
        profile = Profile(
            layers,
            background.gravity,
            background.index,
            constant=background.constant,
        )
        by_state = np.zeros((2 * k + 1, layout.size))
        by_state[:k, layout.temperature] = np.diag(air.virtual_by_t)
        by_state[:k, layout.humidity] = air.virtual_by_rh[:, None] * air.spreading
        by_state[k, layout.log_p] = 1.0
        by_state[k + 1 :, layout.temperature] = np.diag(air.vapour_by_t)
        by_state[k + 1 :, layout.humidity] = air.vapour_by_rh[:, None] * air.spreading
        matrix = by_state @ self.covariance @ by_state.T
        symmetric = 0.5 * (matrix + matrix.T)
        return profile, ProfileCovariance(profile, layout.reference, symmetric)


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
    4 hours of three sensors at 10 Hz, 144,000 samples each, take about 2 CPU s.

    >>> from unbend.atmosphere.climatology import climatology
    >>> made = estimate(AirSamples(), climatology(latitude_rad=0.8, month=7.0))
    >>> made.covariance.sigma_temperature([0.0, 5000.0]).round(1).tolist()
    [6.7, 4.8]
    """
    settings = settings or SensorSettings()
    readings = collect_readings(
        samples,
        background,
        settings,
        soundings=soundings,
        surface=surface,
        flight=flight,
    )
    readings = _with_faults(readings, known)
    alternatives = hypotheses.hypotheses_of(layout_of(readings, background), readings.rare)
    solutions = _solved(alternatives, readings.sets, background, moisture or background)
    evidence = []
    for hypothesis, solution in zip(alternatives, solutions, strict=True):
        evidence.append(solution.evidence(hypothesis.share))
    chances = hypotheses.probabilities(evidence, readings.sets)
    fitting = hypotheses.best_fitting(evidence, chances)
    mixture = _mixture(solutions, chances, fitting, background.profile)
    profile, covariance = mixture.profile(background.profile)
    names = [hypothesis.name for hypothesis in alternatives]
    return Estimate(
        profile=profile,
        covariance=covariance,
        background_sigma_k=mixture.prior.sigma_temperature,
        faults=_fault_estimates(mixture, hypotheses.prior_sigmas(alternatives)),
        fits=mixture.fits,
        readings=readings,
        state=mixture.x,
        converged=mixture.converged,
        drift_scales=mixture.drift_scales,
        layout=alternatives[fitting].layout,
        chances=hypotheses.described_chances(names, chances),
    )


def _with_faults(readings: FlightReadings, estimated: Sequence[FaultEstimate]) -> FlightReadings:
    """Readings whose faults are expected as they were estimated before, where they were."""
    estimate_of = {estimate.fault: estimate for estimate in estimated}
    faults = []
    for fault in readings.faults:
        if fault.name in estimate_of:
            before = estimate_of[fault.name]
            faults.append(replace(fault, mean=before.value, sigma=before.sigma))
        else:
            faults.append(fault)
    rare = []
    for rare_fault in readings.rare:
        if estimate_of.keys().isdisjoint(rare_fault.faults):
            rare.append(rare_fault)
    return replace(readings, faults=tuple(faults), rare=tuple(rare))


def _solved(
    alternatives: Sequence[Hypothesis],
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
    for hypothesis in alternatives:
        start = solutions[0].x if hypothesis.is_linear else None
        prior = prior_of(hypothesis.layout, background, moisture)
        priors.append(prior)
        solutions.append(solve(hypothesis.layout, prior, sets, profile, start))
    best = min(solutions, key=lambda solution: solution.log_inflation)
    for number, solution in enumerate(solutions):
        if solution.log_inflation < best.log_inflation + _MISFIT_OF_A_MINIMUM:
            continue
        layout = alternatives[number].layout
        again = solve(layout, priors[number], sets, profile, best.x)
        if again.log_inflation < solution.log_inflation:
            solutions[number] = again
    return solutions


def _mixture(
    solutions: Sequence[Solution],
    chances: Array,
    fitting: int,
    background: Profile,
) -> Solution:
    """The solution of all hypotheses together.

    It is that which fits best, with the mean and covariance of the mixture.
    """
    solution = solutions[fitting]
    if len(solutions) == 1:
        return solution
    layout = solution.air.layout
    states_of_all = [alternative.x for alternative in solutions]
    covariances = [alternative.covariance for alternative in solutions]
    x, covariance = hypotheses.mixed_moments(states_of_all, covariances, chances)
    pressure = solution.air.pressure_at_knots()
    air = air_of(layout, x, pressure, background.constant)
    return replace(solution, x=x, covariance=covariance, air=air)


def _fault_estimates(
    solution: Solution,
    prior_sigma: Mapping[SensorFault, float],
) -> tuple[FaultEstimate, ...]:
    """The sensor faults of a solution, with their sigma before the flight."""
    layout = solution.air.layout
    sigma = np.sqrt(np.diag(solution.covariance))
    estimates = []
    for place, fault in enumerate(layout.faults, layout.first_fault):
        estimated = FaultEstimate(
            fault.name,
            value=float(solution.x[place]),
            sigma=float(sigma[place]),
            prior_sigma=prior_sigma[fault.name],
        )
        estimates.append(estimated)
    return tuple(estimates)


def layout_of(readings: FlightReadings, background: Climatology) -> Layout:
    """Knots for the heights that were measured; ln p is a state at the lowest of them."""
    knot = place_knots(readings.low, readings.high, background.profile.layers.edge)
    humid = place_humid_knots(readings.low, readings.high)
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
    expected = prior
    x = prior.mean.copy() if start is None else start
    first_step = 0 if start is None else HUBER_STEPS
    pressure = background.pressure(background.gravity.height(layout.knot))
    inflation = np.ones(len(sets))
    variance = np.ones(len(layout.drifts))
    length = _StepLength(np.zeros(layout.knot.size))
    for step in range(first_step, _MOST_STEPS):
        air = air_of(layout, x, pressure, background.constant)
        prior = expected.with_drifts(layout, variance)
        equations = normal_equations(prior, sets, air, inflation, step)
        change = equations.change()
        length.follow(change[layout.temperature], step)
        x = layout.bounded(x + length.share * change)
        air = air_of(layout, x, pressure, background.constant)
        pressure = air.pressure_at_knots()
        is_settled = _agree(equations.inflation, inflation, _SETTLED)
        inflation = equations.inflation
        if HUBER_STEPS < step < _LATE:
            drifted = drift_variances(expected.precision, layout, x, equations.normal, variance)
            is_settled = is_settled and _agree(drifted, variance, 2.0 * _SETTLED)
            variance = drifted
        is_late_enough = step > HUBER_STEPS + 1
        converged = is_late_enough and is_settled and length.moved_k < _CONVERGED_K
        if converged:
            break
    covariance = equations.covariance()
    return Solution(
        x=x,
        covariance=covariance,
        air=air_of(layout, x, pressure, background.constant),
        fits=equations.fits(covariance),
        converged=converged,
        drift_scales=_scales_by_name(layout, variance),
        prior=prior,
        weights=tuple(part.weight for part in equations.parts),
    )


@dataclass(eq=False)
class _StepLength:
    """The ``share`` of a step that is taken.

    It is halved whenever the temperatures, by their ``warming`` (k,) [K], turn back, and grows
    again with each step that does not.
    """

    warming: Array
    share: float = 1.0
    turns_back: bool = False

    def follow(self, warming: Array, step: int) -> None:
        """The share for a next step, from how it would change temperatures [K]."""
        self.turns_back = bool(warming @ self.warming < 0.0)
        self.warming = warming
        if self.turns_back:
            self.share = max(0.5 * self.share, _LEAST_SHARE)
            return
        gain = _REGAINED if step < _LATE else _REGAINED_LATE
        self.share = min(gain * self.share, 1.0)

    @property
    def moved_k(self) -> float:
        """The largest change of a temperature [K]; of a step that turns back, by its share."""
        largest_k = float(np.abs(self.warming).max())
        return largest_k * self.share if self.turns_back else largest_k


def _agree(values: Array, before: Array, share: float) -> bool:
    """Whether values have changed by less than a share of themselves."""
    return bool(np.all(np.abs(values / before - 1.0) < share))


def _scales_by_name(layout: Layout, variance: Array) -> dict[str, float]:
    """The sigma of each drift over the expected one."""
    scales = {}
    for drift, scale in zip(layout.drifts, np.sqrt(variance), strict=True):
        scales[drift.name] = float(scale)
    return scales
