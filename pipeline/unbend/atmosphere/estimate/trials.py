"""Estimates in turn: the first of several candidates that passes the checks of estimates."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import estimate_checks, messages, thermometer_checks
from unbend.atmosphere.estimate.candidates import Candidate
from unbend.atmosphere.estimate.external_readings import TimeAndPlace
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.solver import Estimate, estimate
from unbend.atmosphere.profile import Profile
from unbend.messages import Message


@dataclass(frozen=True, eq=False)
class ExpectedAir:
    """What the estimates of a flight begin with: when and where it was, and the air there."""

    flight: TimeAndPlace
    standard: Profile
    background: Climatology
    moisture: Climatology

    def estimate_of(self, candidate: Candidate, settings: SensorSettings) -> Estimate:
        """The estimate from a candidate's samples and sources."""
        return estimate(
            candidate.samples,
            self.background,
            settings=settings,
            moisture=self.moisture,
            soundings=candidate.external.soundings,
            surface=candidate.external.surface,
            flight=self.flight,
        )


class Passed(NamedTuple):
    """A candidate and its estimate, which passed the checks."""

    candidate: Candidate
    made: Estimate


@dataclass(eq=False)
class Trials:
    """The samples of the estimates that were ``tried``, why they failed, and the one that passed.

    ``refused`` are the sensors that are not used, by their quantity, and why.
    """

    tried: list[AirSamples] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    notes: list[Message] = field(default_factory=list)
    passed: Passed | None = None


def first_that_passes(
    choices: Sequence[Candidate],
    expected: ExpectedAir,
    settings: SensorSettings,
) -> Trials:
    """The first estimate that passes its checks, and those before it."""
    trials = Trials()
    remaining = list(choices)
    while remaining and trials.passed is None:
        candidate = remaining.pop(0)
        remaining = _try(trials, candidate, remaining, expected, settings)
    return trials


def _try(
    trials: Trials,
    candidate: Candidate,
    remaining: list[Candidate],
    expected: ExpectedAir,
    settings: SensorSettings,
) -> list[Candidate]:
    """Check the estimate of a candidate; what remains to be tried if it does not pass."""
    trials.tried.append(candidate.samples)
    made = expected.estimate_of(candidate, settings)
    outside = thermometer_checks.thermometer_is_outside(
        candidate.samples,
        made,
        expected.background,
        expected.moisture,
        settings,
    )
    if not outside and candidate.main is not None:
        _refuse_thermometer(trials, candidate.main.name, outside.reason)
        return [other for other in remaining if other.samples.temperature is None]
    hygrometer = estimate_checks.hygrometer_is_outside(made, expected.moisture)
    if not hygrometer:
        _refuse_hygrometer(trials, candidate.samples, hygrometer.reason)
        return [_without_hygrometer(other) for other in (candidate, *remaining)]
    informed = _has_information(candidate, made, expected)
    if not informed:
        trials.faults.append(f"{candidate.reason}, but {informed.reason}")
        return [other for other in remaining if other.basis != "barometer"]
    credible = _is_credible(made, expected)
    if credible:
        trials.passed = Passed(candidate, made)
    else:
        _refuse_estimate(trials, candidate, credible.reason)
    return remaining


def _refuse_thermometer(trials: Trials, name: str, reason: str) -> None:
    """Note that a thermometer is not used."""
    trials.refused["temperature"] = reason
    trials.notes.append(messages.thermometer_not_used(name=name, reason=reason))
    trials.faults.append(reason)


def _refuse_hygrometer(trials: Trials, samples: AirSamples, reason: str) -> None:
    """Note that a hygrometer is not used."""
    trials.refused["humidity"] = reason
    name = "" if samples.humidity is None else samples.humidity.name
    trials.notes.append(messages.hygrometer_not_used(name=name, reason=reason))


def _without_hygrometer(candidate: Candidate) -> Candidate:
    """A candidate without its hygrometer."""
    samples = replace(candidate.samples, humidity=None)
    return replace(candidate, samples=samples)


def _is_credible(made: Estimate, expected: ExpectedAir) -> estimate_checks.Check:
    """Whether an estimate can be air, and predicts readings better than the background does."""
    plausible = estimate_checks.is_plausible(made, expected.background)
    if not plausible:
        return plausible
    return estimate_checks.is_better_than_background(
        made,
        expected.background,
        expected.moisture,
    )


def _has_information(
    candidate: Candidate,
    made: Estimate,
    expected: ExpectedAir,
) -> estimate_checks.Check:
    """Whether an estimate that rests on a barometer alone knows more than without it."""
    if candidate.basis != "barometer":
        return estimate_checks.PASSED
    return estimate_checks.has_information(made, expected.background, expected.moisture)


def _refuse_estimate(trials: Trials, candidate: Candidate, reason: str) -> None:
    """Note that an estimate cannot be air, or is worse than the background."""
    implausible = messages.air_implausible(
        sources=candidate.reason,
        reason=reason,
        sensor="" if candidate.main is None else candidate.main.name,
    )
    trials.notes.append(implausible)
    trials.faults.append(reason)
