"""Estimates from several candidates in turn, until one passes its checks."""

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
    """What all estimates of a flight have in common: its time and place, and the expected air.

    ``standard``: the standard atmosphere that is shown for comparison. ``background``: the
    climatology that is adjusted. ``moisture``: gives the expected humidity.
    """

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
    """The estimates that were tried; the functions of this module add to it.

    ``tried``: the samples of each. ``faults``: why each did not pass. ``refused``: why a sensor is
    not used, by its quantity. ``notes``: messages for the ledger. ``passed``: the estimate that
    passed, None if there is none.
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
    """Try candidates in their order until the estimate of one passes its checks.

    A failed check may remove or change later candidates, for example leave out a thermometer.
    """
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
    """Make and check the estimate of a candidate, note the result in ``trials``.

    Returns the candidates that remain to be tried if it did not pass: without a thermometer or
    hygrometer that was found not to be outside, without a barometer that has no information alone.
    """
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
    """Note in ``trials`` that a thermometer is not used."""
    trials.refused["temperature"] = reason
    trials.notes.append(messages.thermometer_not_used(name=name, reason=reason))
    trials.faults.append(reason)


def _refuse_hygrometer(trials: Trials, samples: AirSamples, reason: str) -> None:
    """Note in ``trials`` that a hygrometer is not used."""
    trials.refused["humidity"] = reason
    name = "" if samples.humidity is None else samples.humidity.name
    trials.notes.append(messages.hygrometer_not_used(name=name, reason=reason))


def _without_hygrometer(candidate: Candidate) -> Candidate:
    """A candidate without its hygrometer."""
    samples = replace(candidate.samples, humidity=None)
    return replace(candidate, samples=samples)


def _is_credible(made: Estimate, expected: ExpectedAir) -> estimate_checks.Check:
    """Whether an estimate is plausible air, and predicts readings better than the background."""
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
    """Whether a barometer without thermometer makes the air more certain; else passed."""
    if candidate.basis != "barometer":
        return estimate_checks.PASSED
    return estimate_checks.has_information(made, expected.background, expected.moisture)


def _refuse_estimate(trials: Trials, candidate: Candidate, reason: str) -> None:
    """Note in ``trials`` that an estimate is not plausible, or is worse than the background."""
    implausible = messages.air_implausible(
        sources=candidate.reason,
        reason=reason,
        sensor="" if candidate.main is None else candidate.main.name,
    )
    trials.notes.append(implausible)
    trials.faults.append(reason)
