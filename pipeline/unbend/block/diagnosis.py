"""Find likely mistakes in a mission file by tie points.

The possible mistakes are those of `possible_mistakes` and `calibration_mistakes`, each with its
estimate. A mistake is a finding if it is 1000 times as likely as the stated values, and larger than
the stated sigmas explain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.errors_in_words import error_in_words, is_beyond_datums
from unbend.block.given_heights import scattered_heights, with_usable_heights
from unbend.block.intersection import Intersection
from unbend.block.possible_mistakes import (
    LinearEstimate,
    PossibleMistake,
    Reading,
    StatedMission,
    large_mistakes,
    linear_estimates,
    other_calibrations,
    small_errors,
)
from unbend.units import Integers

RANKING_POINTS = 200  # enough to order the large mistakes; all points decide among the best
BEST_LARGE_MISTAKES = 4  # large mistakes that are compared by all points
MAX_MISTAKES = 4  # that are searched one after the other, each with the former ones corrected
POOR_FIT = 2.0  # residuals over sigmas: above it, large mistakes are tried
FEW_MEET = 0.7  # share of points with rays that meet: below it, large mistakes are tried
FEW_BAD = 0.1  # share of the rays of a camera: so many bad rays are no sign of a mistake
WORTH_A_LOOK = 0.3 * LOG_RATIO_NEEDED  # gain of the log likelihood for a closer estimate
EQUALLY_LIKELY = 0.1  # share of a gain: mistakes with gains within it are equally likely
MISTAKEN_AT = 0.3  # a calibration is the mistaken one if its estimated amount is so near to 1

MOUNT_REFINEMENTS = 3
LARGEST_REFINEMENT_RAD = np.radians(5.0)  # a mount that is refined by more is another mistake
MAX_RANKING_STEPS = 12  # of an amount by the ranking points: reaches 15 % of a focal length
MAX_STEPS = 3  # of an amount by all points, from there
LARGEST_STEPS = 3.0  # step lengths by which an amount changes at most in one step
SMALLEST_STEP = 0.1  # of the former step length
SETTLED = 0.05  # of the sigma: an amount that changes by less is final

KEYS = {
    "TIES-MOUNT": "mount.{}",
    "TIES-FOCAL": "cameras.{}",
    "TIES-TIME": "events",
    "TIES-HEIGHT": "ground",
    "TIES-PIXELS": "observations.columns",
    "TIES-CAMERAS": "cameras",
    "TIES-CALIBRATION": "cameras.{}",
}
"""Key of the mission file for each mistake; {} is the name of the camera."""


@dataclass(frozen=True)
class Finding:
    """A likely mistake in the mission file."""

    code: str
    key: str  # of the mission file
    what: str  # one sentence with number and sigma
    log_ratio: float  # log likelihood with the mistake corrected, minus that as stated
    sigma_factor: float  # residuals of the rays over their sigmas, with the mistake corrected
    also: tuple[str, ...] = ()  # sentences of other mistakes that are nearly as likely
    cameras: tuple[str, ...] = ()  # with the mistake; empty if it concerns all stations
    label: str = ""  # which mistake of its kind
    beyond_datums: bool = False  # heights differ by more than another datum or feet explain

    @property
    def subject(self) -> tuple[str, str, tuple[str, ...]]:
        """Key for comparison: equal for two estimates of the same mistake."""
        return self.code, self.key, self.cameras


@dataclass(frozen=True, eq=False)
class Explanation:
    """A possible mistake that is likely enough to explain the rays."""

    hypothesis: PossibleMistake
    reading: Reading  # with the mistake corrected
    intersection: Intersection  # of that reading
    gain: float  # of the log likelihood
    text: str  # empty if the stated sigmas explain the mistake, or it is too small to matter
    beyond_datums: bool = False  # heights differ by more than another datum or feet explain


def diagnosis(mission: StatedMission) -> tuple[Intersection, tuple[Finding, ...]]:
    """The intersection of the rays as stated, without given heights, and the likely mistakes.

    Nothing is tried if rays that meet exactly were less than 1000 times as likely. Small errors of
    mounts, principal distances, heights and times are tried if their linear estimates improve the
    likelihood, large mistakes if the rays fit their sigmas poorly: this takes some seconds with
    2,000 points. Mistakes are searched one after the other, with the former ones corrected. The
    refraction of the standard atmosphere is removed from the rays (`straightened`).
    """
    reading = Reading(mission.cameras)
    by_rays_alone = reading.intersected(mission.without_heights)
    mission = with_usable_heights(mission, by_rays_alone)
    intersection = reading.intersected(mission) if mission.heights_of else by_rays_alone
    points = ranking_points(by_rays_alone.point)
    findings: list[Finding] = []

    for _ in range(MAX_MISTAKES):
        if intersection.misfit <= LOG_RATIO_NEEDED:  # no mistake can gain as much
            break
        explanations = likely_explanations(mission, reading, intersection, points)
        if not any(explanation.text for explanation in explanations):
            break
        # The best explanation is corrected, also one without a text, which is not reported.
        explanations.sort(key=lambda e: -e.gain - e.hypothesis.log_odds)
        best = explanations[0]
        reading = best.reading
        intersection = best.intersection
        if not best.text:
            continue
        finding = finding_of(mission, explanations)
        # A later estimate of the same mistake replaces the earlier one.
        findings = [earlier for earlier in findings if earlier.subject != finding.subject]
        findings.append(finding)

    sigma_factor = findings[-1].sigma_factor if findings else by_rays_alone.sigma_factor
    text = scattered_heights(mission, intersection, sigma_factor)
    if text:
        findings.append(Finding("TIES-HEIGHT", "ground", text, np.inf, sigma_factor))
    return by_rays_alone, tuple(findings)


def ranking_points(points: Integers) -> Integers:
    """At most `RANKING_POINTS` of the numbers of points (p,), evenly spaced."""
    rows = np.linspace(0, points.size - 1, RANKING_POINTS).astype(int)
    unique_rows = np.unique(rows)[: points.size]  # none of no points
    return np.asarray(points[unique_rows], np.int64)


def finding_of(mission: StatedMission, explanations: list[Explanation]) -> Finding:
    """The finding for the first explanation, which is the best one.

    It lists in ``also`` other explanations with a nearly equal gain.
    """
    best = explanations[0]
    hypothesis = best.hypothesis
    also: dict[tuple[str, str], str] = {}
    for explanation in explanations:
        if explanation.text and explanation.gain > (1.0 - EQUALLY_LIKELY) * best.gain:
            also[explanation.hypothesis.subject] = explanation.text
    also.pop(hypothesis.subject, None)
    key = KEYS[hypothesis.code].format(hypothesis.camera).rstrip(".")
    if hypothesis.code == "TIES-MOUNT" and not mission.mounts:  # orientations are stated
        key = "stations.orientation"
    if hypothesis.code == "TIES-PIXELS" and hypothesis.label == "upward":  # no column is wrong
        key = "observations"
    return Finding(
        code=hypothesis.code,
        key=key,
        what=best.text,
        log_ratio=best.gain,
        sigma_factor=best.reading.intersected(mission.without_heights).sigma_factor,
        also=tuple(also.values()),
        cameras=hypothesis.cameras,
        label=hypothesis.label,
        beyond_datums=best.beyond_datums,
    )


# ---------------------------------------------------------------------- which mistakes are likely


def likely_explanations(
    mission: StatedMission, current: Reading, intersection: Intersection, points: Integers
) -> list[Explanation]:
    """Mistakes that make the rays 1000 times as likely as the ``current`` reading does.

    ``intersection`` is that of the current reading. The ranking ``points`` order the large
    mistakes, and rule out mistakes before all points are intersected.
    """
    fits_poorly = not intersection.sigma_factor < POOR_FIT  # also if it is NaN
    is_poor = fits_poorly or intersection.used.mean() < FEW_MEET
    least_gain = 0.0 if is_poor or intersection.largest_bad_share > FEW_BAD else WORTH_A_LOOK
    hypotheses = list(small_errors(mission, current, intersection, least_gain))
    if is_poor:
        hypotheses += best_large_mistakes(mission, current, points)
    explanations = likely_calibrations(mission, current, intersection)
    if not hypotheses:
        return explanations
    least_likelihood = likelihood(mission, current, points) + WORTH_A_LOOK
    for hypothesis in hypotheses:
        roughly, _ = refined(mission, hypothesis, points)
        if likelihood(mission, roughly.reading, points) < least_likelihood:
            continue
        estimated, sigma = refined(mission, roughly, None)
        reading = estimated.reading
        explained = reading.intersected(mission)
        gain = explained.log_likelihood - intersection.log_likelihood
        if gain + min(0.0, estimated.log_odds) > LOG_RATIO_NEEDED:
            text = error_in_words(mission, estimated, explained, sigma)
            explanations.append(
                Explanation(
                    hypothesis=estimated,
                    reading=reading,
                    intersection=explained,
                    gain=gain,
                    text=text,
                    beyond_datums=is_beyond_datums(mission, estimated, explained, sigma),
                )
            )
    return explanations


def best_large_mistakes(
    mission: StatedMission, current: Reading, points: Integers
) -> list[PossibleMistake]:
    """The `BEST_LARGE_MISTAKES` large mistakes that are likeliest by some points."""
    hypotheses = list(large_mistakes(mission, current))
    hypotheses.sort(key=lambda hypothesis: -likelihood(mission, hypothesis.reading, points))
    return hypotheses[:BEST_LARGE_MISTAKES]


def likelihood(mission: StatedMission, reading: Reading, points: Integers) -> float:
    """The log likelihood of a reading by some points; -inf if they are above their stations.

    There mirrored rays meet.
    """
    intersection = reading.intersected(mission, points)
    return intersection.log_likelihood if intersection.flying_height_m > 0.0 else -np.inf


def likely_calibrations(
    mission: StatedMission, current: Reading, intersection: Intersection
) -> list[Explanation]:
    """Mistakes in calibrations that are likely.

    A wrong principal point turns the rays nearly as a mount does. So the gain of a calibration
    counts in addition to the best turns of all cameras.
    """
    estimates = calibration_estimates(mission, current, intersection)
    largest_gain = max((estimate.gain for estimate in estimates), default=0.0)
    explanations = []
    for estimate in estimates:
        if estimate.gain <= (1.0 - EQUALLY_LIKELY) * largest_gain:
            continue
        hypothesis = replace(estimate.hypothesis, amount=estimate.amount)
        # With other mistakes in the file, the calibration may gain more without the turns.
        reading = hypothesis.reading
        without_turns = reading.intersected(mission).log_likelihood
        gain_without_turns = without_turns - intersection.log_likelihood
        explains_more = gain_without_turns > estimate.gain
        if not explains_more:
            reading = reading.with_best_turns(mission)
        gain = max(estimate.gain, gain_without_turns)
        explained = reading.intersected(mission)
        text = hypothesis.label
        explanations.append(Explanation(hypothesis, reading, explained, gain, text))
    return explanations


def calibration_estimates(
    mission: StatedMission, current: Reading, intersection: Intersection
) -> list[LinearEstimate]:
    """Mistakes in calibrations that gain enough in addition to turns of all cameras.

    Only those with an estimated amount near 1: the whole mistake, not a part of it.
    """
    turns = [intersection.orientations.turns_of(camera) for camera in current.cameras]
    shared = np.concatenate(turns, axis=2)
    calibrations = other_calibrations(current)
    estimates = []
    for estimate in linear_estimates(mission, current, intersection, calibrations, shared):
        is_whole = abs(estimate.amount - 1.0) < MISTAKEN_AT
        if is_whole and estimate.gain > LOG_RATIO_NEEDED:
            estimates.append(estimate)
    return estimates


# ---------------------------------------------------------------------- most likely amounts


def refined(
    mission: StatedMission, hypothesis: PossibleMistake, points: Integers | None
) -> tuple[PossibleMistake, float]:
    """A hypothesis at its most likely amount, and the sigma of the amount; 0 for a mount.

    ``points`` are the numbers of the points that are used; None for all.
    """
    if hypothesis.code == "TIES-MOUNT":
        return refined_mount(mission, hypothesis, points), 0.0
    return refined_amount(mission, hypothesis, points)


def refined_mount(
    mission: StatedMission, hypothesis: PossibleMistake, points: Integers | None
) -> PossibleMistake:
    """The hypothesis of a mount, turned further to where the rays meet best.

    It loses its label if that is more than `LARGEST_REFINEMENT_RAD` from the labelled mistake.
    """
    camera = hypothesis.camera
    reading = hypothesis.reading
    for _ in range(MOUNT_REFINEMENTS):
        vector, _ = reading.intersected(mission, points).camera_rotation(camera)
        reading = reading.turned(camera, Rotation.from_rotvec(vector).as_matrix())
    first_turn = hypothesis.reading.turns[camera]
    moved = Rotation.from_matrix(reading.turns[camera] @ first_turn.T)
    same_mistake = moved.magnitude() < LARGEST_REFINEMENT_RAD
    return replace(
        hypothesis,
        reading_by=lambda _: reading,
        label=hypothesis.label if same_mistake else "",
    )


def refined_amount(
    mission: StatedMission, hypothesis: PossibleMistake, points: Integers | None
) -> tuple[PossibleMistake, float]:
    """A hypothesis at its most likely amount, and the sigma of the amount.

    The amount moves to the top of a parabola through the log likelihoods at three amounts, until it
    changes little. The sigma follows from the curvature there; it is infinite if no top was near,
    and for a mistake without an amount.
    """
    amount = hypothesis.amount
    step = hypothesis.step
    sigma = np.inf
    if not step:
        return hypothesis, sigma
    most_steps = MAX_STEPS if points is None else MAX_RANKING_STEPS
    for _ in range(most_steps):
        likelihoods = []
        for tried in (amount - step, amount, amount + step):
            intersection = hypothesis.reading_by(tried).intersected(mission, points)
            likelihoods.append(intersection.log_likelihood)
        low, middle, high = likelihoods
        curve = low - 2.0 * middle + high
        farthest = LARGEST_STEPS * step
        if not np.isfinite(curve) or high == low == middle:
            break
        if not curve < 0.0:  # no top is near: go up the slope
            amount += farthest * float(np.sign(high - low))
            continue
        sigma = step / float(np.sqrt(-curve))
        change = float(np.clip(0.5 * step * (low - high) / curve, -farthest, farthest))
        amount += change
        # The top is beyond the tried amounts: shorter steps would not get there.
        if abs(change) > step:
            continue
        step = min(max(sigma, SMALLEST_STEP * step), step)
        if abs(change) < SETTLED * sigma:
            break
    return replace(hypothesis, amount=amount, step=step), sigma
