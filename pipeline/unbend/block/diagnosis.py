"""What tie points say of a mission file: the decision between its likely mistakes.

The mistakes are those of `possible_mistakes` and `calibration_mistakes`, each with its estimate. A
hypothesis that is 1000 times as likely as what is stated, and larger than the stated sigmas
explain, is a finding.
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
BEST_LARGE_MISTAKES = 4  # that all points decide between
MAX_MISTAKES = 4  # that are looked for, one beside the other
POOR_FIT = 2.0  # misses over sigmas, beyond which anything may be wrong
FEW_MEET = 0.7  # share of points whose rays meet, below which anything may be wrong
FEW_BAD = 0.1  # of the rays of a camera: so many are no sign of a mistake
WORTH_A_LOOK = 0.3 * LOG_RATIO_NEEDED
EQUALLY_LIKELY = 0.1  # of a log likelihood ratio, within which two mistakes count as such
MISTAKEN_AT = 0.3  # within which of 1 a calibration is the mistaken one, and nothing between

MOUNT_REFINEMENTS = 3
LARGEST_REFINEMENT_RAD = np.radians(5.0)  # of a mistake that is still that one
MAX_RANKING_STEPS = 12  # of an amount by some points: 15 % of a principal distance, and settled
MAX_STEPS = 3  # by all points, from there
LARGEST_STEPS = 3.0  # that an amount changes by at once
SMALLEST_STEP = 0.1  # of the step before
SETTLED = 0.05  # of its sigma: an amount that changes by less is the most likely one

KEYS = {
    "TIES-MOUNT": "mount.{}",
    "TIES-FOCAL": "cameras.{}",
    "TIES-TIME": "events",
    "TIES-HEIGHT": "ground",
    "TIES-PIXELS": "observations.columns",
    "TIES-CAMERAS": "cameras",
    "TIES-CALIBRATION": "cameras.{}",
}
"""Where in the mission file each mistake stands, with the camera it is of."""


@dataclass(frozen=True)
class Finding:
    """A contradiction: code, key of the mission file, and one sentence with number and sigma."""

    code: str
    key: str
    what: str
    log_ratio: float  # natural logarithm of its likelihood over that of what is stated
    sigma_factor: float  # residuals of the rays alone over what their sigmas say, then
    also: tuple[str, ...] = ()  # the same of others that are nearly as likely
    cameras: tuple[str, ...] = ()  # that are concerned
    label: str = ""  # which mistake of its kind
    beyond_datums: bool = False  # heights differ by more than another datum or feet explain

    @property
    def subject(self) -> tuple[str, str, tuple[str, ...]]:
        """What two findings have in common that are estimates of one mistake."""
        return self.code, self.key, self.cameras


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis that is likely enough, with the ``gain`` of the log likelihood under it.

    ``text`` is empty where stated sigmas explain it. ``beyond_datums``: heights differ by more than
    another datum or feet explain.
    """

    hypothesis: PossibleMistake
    reading: Reading
    intersection: Intersection
    gain: float
    text: str
    beyond_datums: bool = False


def diagnosis(mission: StatedMission) -> tuple[Intersection, tuple[Finding, ...]]:
    """The intersection as stated, by the rays alone, and what contradicts the mission file.

    Nothing is tried where rays that meet exactly were not 1000 times as likely. Common errors of
    mounts, principal distances, heights and times are tried where their linear estimates gain; the
    large mistakes where rays do not meet as their sigmas say: some seconds with 2,000 points, 200
    of which rank them. The standard atmosphere's refraction is removed (`straightened`).
    """
    reading = Reading(mission.cameras)
    by_rays_alone = reading.intersected(mission.without_heights)
    mission = with_usable_heights(mission, by_rays_alone)
    intersection = reading.intersected(mission) if mission.heights_of else by_rays_alone
    points = ranking_points(by_rays_alone.point)
    findings: list[Finding] = []

    for _ in range(MAX_MISTAKES):
        if intersection.misfit <= LOG_RATIO_NEEDED:  # nothing can be more likely by as much
            break
        explanations = likely_explanations(mission, reading, intersection, points)
        if not any(explanation.text for explanation in explanations):
            break
        # What is more likely and matters to nobody is no finding, nor is what it explains.
        explanations.sort(key=lambda e: -e.gain - e.hypothesis.log_odds)
        best = explanations[0]
        reading = best.reading
        intersection = best.intersection
        if not best.text:
            continue
        finding = finding_of(mission, explanations)
        # What is estimated once more is said once.
        findings = [earlier for earlier in findings if earlier.subject != finding.subject]
        findings.append(finding)

    sigma_factor = findings[-1].sigma_factor if findings else by_rays_alone.sigma_factor
    text = scattered_heights(mission, intersection, sigma_factor)
    if text:
        findings.append(Finding("TIES-HEIGHT", "ground", text, np.inf, sigma_factor))
    return by_rays_alone, tuple(findings)


def ranking_points(points: Integers) -> Integers:
    """Some of the points (p,), evenly over all of them."""
    rows = np.linspace(0, points.size - 1, RANKING_POINTS).astype(int)
    return np.asarray(points[np.unique(rows)[: points.size]], np.int64)


def finding_of(mission: StatedMission, explanations: list[Explanation]) -> Finding:
    """The best explanation, which comes first, with those that are nearly as likely."""
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
    if hypothesis.code == "TIES-PIXELS" and hypothesis.label == "upward":  # of no column
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
    """What explains the rays 1000 times as well as the ``current`` reading with its intersection.

    Some ``points`` rank the large mistakes and show what is worth a look.
    """
    is_poor = not intersection.sigma_factor < POOR_FIT or intersection.used.mean() < FEW_MEET
    least_gain = 0.0 if is_poor or intersection.most_bad > FEW_BAD else WORTH_A_LOOK
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
            explanation = Explanation(
                hypothesis=estimated,
                reading=reading,
                intersection=explained,
                gain=gain,
                text=text,
                beyond_datums=is_beyond_datums(mission, estimated, explained, sigma),
            )
            explanations.append(explanation)
    return explanations


def best_large_mistakes(
    mission: StatedMission, current: Reading, points: Integers
) -> list[PossibleMistake]:
    """The large mistakes that are the most likely by some points."""
    hypotheses = list(large_mistakes(mission, current))
    hypotheses.sort(key=lambda hypothesis: -likelihood(mission, hypothesis.reading, points))
    return hypotheses[:BEST_LARGE_MISTAKES]


def likelihood(mission: StatedMission, reading: Reading, points: Integers) -> float:
    """The log likelihood of a reading by some points; mirrored rays meet above their stations."""
    intersection = reading.intersected(mission, points)
    return intersection.log_likelihood if intersection.flying_height_m > 0.0 else -np.inf


def likely_calibrations(
    mission: StatedMission, current: Reading, intersection: Intersection
) -> list[Explanation]:
    """Other calibrations that are likely.

    A principal point that is off turns rays nearly as a mount does: only what no mount explains,
    turned to where the rays meet best, speaks of a calibration.
    """
    estimates = calibration_estimates(mission, current, intersection)
    largest_gain = max((estimate.gain for estimate in estimates), default=0.0)
    explanations = []
    for estimate in estimates:
        if estimate.gain <= (1.0 - EQUALLY_LIKELY) * largest_gain:
            continue
        hypothesis = replace(estimate.hypothesis, amount=estimate.amount)
        # Beside other mistakes it counts without the turns, if it then explains more.
        reading = hypothesis.reading
        without_turns = reading.intersected(mission).log_likelihood
        gain_without_turns = without_turns - intersection.log_likelihood
        explains_more = gain_without_turns > estimate.gain
        if not explains_more:
            reading = reading.settled(mission)
        gain = max(estimate.gain, gain_without_turns)
        explained = reading.intersected(mission)
        text = hypothesis.label
        explanations.append(Explanation(hypothesis, reading, explained, gain, text))
    return explanations


def calibration_estimates(
    mission: StatedMission, current: Reading, intersection: Intersection
) -> list[LinearEstimate]:
    """Other calibrations that gain enough beside turns of all cameras, and are whole mistakes."""
    turns = [intersection.orientations.turns_of(camera) for camera in current.cameras]
    beside = np.concatenate(turns, axis=2)
    calibrations = other_calibrations(current)
    estimates = []
    for estimate in linear_estimates(mission, current, intersection, calibrations, beside):
        is_whole = abs(estimate.amount - 1.0) < MISTAKEN_AT
        if is_whole and estimate.gain > LOG_RATIO_NEEDED:
            estimates.append(estimate)
    return estimates


# ---------------------------------------------------------------------- most likely amounts


def refined(
    mission: StatedMission, hypothesis: PossibleMistake, points: Integers | None
) -> tuple[PossibleMistake, float]:
    """A hypothesis at its most likely amount by some points or all, with the sigma of that."""
    if hypothesis.code == "TIES-MOUNT":
        return refined_mount(mission, hypothesis, points), 0.0
    return refined_amount(mission, hypothesis, points)


def refined_mount(
    mission: StatedMission, hypothesis: PossibleMistake, points: Integers | None
) -> PossibleMistake:
    """A mount turned to where the rays meet best; far from a mistake it loses its name."""
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
    """An amount at the top of parabolas through three log likelihoods, with the sigma they show.

    The sigma is infinite where no top was near, and for a mistake without an amount.
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
        if not curve < 0.0:  # no top is near: on, up the slope
            amount += farthest * float(np.sign(high - low))
            continue
        sigma = step / float(np.sqrt(-curve))
        change = float(np.clip(0.5 * step * (low - high) / curve, -farthest, farthest))
        amount += change
        # Where the top is beyond what was tried, shorter steps would not get there.
        if abs(change) > step:
            continue
        step = min(max(sigma, SMALLEST_STEP * step), step)
        if abs(change) < SETTLED * sigma:
            break
    return replace(hypothesis, amount=amount, step=step), sigma
