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
from unbend.atmosphere.estimate.knots import place_humid_knots, place_knots
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
_LEAST_SHARE = 1.0 / 64.0  # of a step that is taken; it is halved whenever the step turns back
_REGAINED = 1.5  # factor by which the share grows with each step that does not turn back
_LATE = 20  # from this step on the share grows slowly, and drifts keep their variance
_REGAINED_LATE = 1.1  # the same factor from then on
_MISFIT_OF_A_MINIMUM = 5.0  # a log inflation larger by this is suspected to be a second minimum


@dataclass(frozen=True)
class FaultEstimate:
    """A sensor fault as estimated, in the unit of the state, with its sigma before the flight."""

    fault: SensorFault
    value: float
    sigma: float
    prior_sigma: float

    def in_units(self) -> "FaultEstimate":
        """The fault in the unit of its text (`sensors.FAULT_TEXTS`).

        Only the decay time differs: the state has its logarithm, the text has seconds.
        """
        if self.fault is not SensorFault.TRANSIENT_DECAY:
            return self
        time_s = float(np.exp(self.value))
        return FaultEstimate(self.fault, time_s, time_s * self.sigma, time_s * self.prior_sigma)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The air of a flight, in layers between the knots, and how it was estimated.

    ``background_sigma_k`` (k,): prior sigma of temperature at the knots. ``fits``: of each set of
    ``readings``. ``state`` (s,): the solution. ``converged``: whether temperatures moved by less
    than 2 mK in the last step. ``drift_scales``: by name, the sigma of each drift over the expected
    one. ``layout``: of the state, by the hypothesis that fits best. ``chances``: probability of
    each hypothesis on the sensors, by its name.
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
    """The solution of one hypothesis: state ``x`` (s,), its covariance (s, s), and its air.

    ``prior``: with the variances of drifts that the flight shows. ``weights``: (m,) of each set of
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
        """Sum over all readings of ln of their sigma inflation factor: 0 where all fit."""
        return float(sum(fit.count * np.log(fit.sigma_inflation) for fit in self.fits))

    def evidence(self, share: float) -> Evidence:
        """The evidence for the hypothesis of this solution.

        ``share``: its probability before the flight.
        """
        return Evidence(share, self.air, self.prior, self.weights, self.log_inflation)

    def profile(self, background: Profile) -> tuple[Profile, ProfileCovariance]:
        """The profile of the state, and the covariance of T_M, ln p and e/p, which define it.

        Gravity, index formula and constant are those of ``background``.
        """
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
    known_faults: Sequence[FaultEstimate] = (),
) -> Estimate:
    """The air by samples, soundings and surface reports, with its covariance.

    ``samples``: of the flight, or of a part of it; without any source the result is the background
    with its own covariance. ``moisture``: gives the expected humidity where the background is a dry
    standard. ``flight``: when and where it was; by default the samples give the time.
    ``known_faults``: sensor faults as estimated before; they replace the prior of these faults.

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
    readings = _with_known_faults(readings, known_faults)
    alternatives = hypotheses.hypotheses_of(layout_of(readings, background), readings.rare)
    solutions = _solve_hypotheses(alternatives, readings.sets, background, moisture or background)
    evidence = []
    for hypothesis, solution in zip(alternatives, solutions, strict=True):
        evidence.append(solution.evidence(hypothesis.share))
    chances = hypotheses.probabilities(evidence, readings.sets)
    best = hypotheses.best_fitting(evidence, chances)
    mixture = _mixture(solutions, chances, best, background.profile)
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
        layout=alternatives[best].layout,
        chances=hypotheses.described_chances(names, chances),
    )


def _with_known_faults(
    readings: FlightReadings, known_faults: Sequence[FaultEstimate]
) -> FlightReadings:
    """Readings with the prior mean and sigma of known faults replaced by their estimates.

    A rare fault that concerns any of the known faults is no longer considered.
    """
    estimate_of = {estimate.fault: estimate for estimate in known_faults}
    faults = []
    for fault in readings.faults:
        if fault.name in estimate_of:
            known_fault = estimate_of[fault.name]
            faults.append(replace(fault, mean=known_fault.value, sigma=known_fault.sigma))
        else:
            faults.append(fault)
    rare = []
    for rare_fault in readings.rare:
        if estimate_of.keys().isdisjoint(rare_fault.faults):
            rare.append(rare_fault)
    return replace(readings, faults=tuple(faults), rare=tuple(rare))


def _solve_hypotheses(
    alternatives: Sequence[Hypothesis],
    sets: Sequence[Readings],
    background: Climatology,
    moisture: Climatology,
) -> list[Solution]:
    """The solution of each hypothesis, in their order; the first is that of usual sensors.

    A solution that fits much worse than the best one may be at a second minimum: its hypothesis is
    solved again from the state of the best, and the better of the two solutions is taken.
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
        fits_well = solution.log_inflation < best.log_inflation + _MISFIT_OF_A_MINIMUM
        if fits_well:
            continue
        layout = alternatives[number].layout
        again = solve(layout, priors[number], sets, profile, best.x)
        if again.log_inflation < solution.log_inflation:
            solutions[number] = again
    return solutions


def _mixture(
    solutions: Sequence[Solution],
    chances: Array,
    best: int,
    background: Profile,
) -> Solution:
    """The solution number ``best``, with the mean and covariance of the mixture of all solutions.

    ``chances``: the probability of each solution's hypothesis.
    """
    solution = solutions[best]
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
    """The sensor faults of a solution; ``prior_sigma`` is their sigma before the flight."""
    layout = solution.air.layout
    sigma = np.sqrt(np.diag(solution.covariance))
    estimates = []
    for index, fault in enumerate(layout.faults, layout.first_fault):
        estimated = FaultEstimate(
            fault.name,
            value=float(solution.x[index]),
            sigma=float(sigma[index]),
            prior_sigma=prior_sigma[fault.name],
        )
        estimates.append(estimated)
    return tuple(estimates)


def layout_of(readings: FlightReadings, background: Climatology) -> Layout:
    """The layout of the state: knots for the measured heights, and ln p at the lowest of these."""
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
    """The state by Gauss-Newton with iterated weights; its covariance is (J^T W J + B^-1)^-1.

    Where the residuals of a set of readings are larger than its sigmas, or neighbours in it
    correlate, its sigmas are multiplied by an inflation factor until they fit, so that the
    covariance is not too small. The variance of a drift follows from the estimated drift
    (`drift_variances`). ``start`` (s,): a state near the solution; without it the iteration begins
    at the prior, with a loss that has one minimum. The equations are not linear in lag and T(H)
    together, and whole steps may oscillate (in 38 of 84 flights, by 0.1 to 0.3 K): the share of the
    step that is taken is halved when it turns back.
    """
    expected_prior = prior
    x = prior.mean.copy() if start is None else start
    first_step = 0 if start is None else HUBER_STEPS
    pressure = background.pressure(background.gravity.height(layout.knot))
    inflation = np.ones(len(sets))
    variance = np.ones(len(layout.drifts))  # of each drift over the expected one
    step_length = _StepLength(np.zeros(layout.knot.size))
    for step in range(first_step, _MOST_STEPS):
        air = air_of(layout, x, pressure, background.constant)
        prior = expected_prior.with_drifts(layout, variance)
        equations = normal_equations(prior, sets, air, inflation, step)
        change = equations.change()
        step_length.follow(change[layout.temperature], step)
        x = layout.bounded(x + step_length.share * change)
        air = air_of(layout, x, pressure, background.constant)
        pressure = air.pressure_at_knots()
        is_settled = _has_hardly_changed(equations.inflation, inflation, _SETTLED)
        inflation = equations.inflation
        if HUBER_STEPS < step < _LATE:
            previous = variance
            variance = drift_variances(
                expected_prior.precision, layout, x, equations.normal, previous
            )
            is_settled = is_settled and _has_hardly_changed(variance, previous, 2.0 * _SETTLED)
        is_late_enough = step > HUBER_STEPS + 1
        converged = is_late_enough and is_settled and step_length.moved_k < _CONVERGED_K
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
    """The ``share`` of each step that is taken, 1/64 to 1.

    ``warming`` (k,): change of the temperatures [K] by the whole of the last step. The share is
    halved when a step ``turns_back``, that is against the one before, and grows again with each
    step that does not.
    """

    warming: Array
    share: float = 1.0
    turns_back: bool = False

    def follow(self, warming: Array, step: int) -> None:
        """Set the share for step number ``step``, which as a whole would warm by ``warming``."""
        self.turns_back = bool(warming @ self.warming < 0.0)
        self.warming = warming
        if self.turns_back:
            self.share = max(0.5 * self.share, _LEAST_SHARE)
            return
        gain = _REGAINED if step < _LATE else _REGAINED_LATE
        self.share = min(gain * self.share, 1.0)

    @property
    def moved_k(self) -> float:
        """The largest change of a temperature [K] by the whole step; by its share if it turns back.

        A share that was small only because of earlier steps would look like convergence.
        """
        largest_k = float(np.abs(self.warming).max())
        return largest_k * self.share if self.turns_back else largest_k


def _has_hardly_changed(values: Array, before: Array, limit: float) -> bool:
    """Whether all relative changes of values are smaller than a limit."""
    return bool(np.all(np.abs(values / before - 1.0) < limit))


def _scales_by_name(layout: Layout, variance: Array) -> dict[str, float]:
    """The sigma of each drift over the expected one, from the ratio of variances (d,)."""
    scales = {}
    for drift, scale in zip(layout.drifts, np.sqrt(variance), strict=True):
        scales[drift.name] = float(scale)
    return scales
