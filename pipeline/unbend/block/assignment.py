"""Events to images by the best consistent assignment, with its runner-up.

How to use it, one camera at a time::

    events = CameraEvents(time_s, index=index)                 # of the log, in the order of time
    images = ImageEvidence(len(names), time_s=exif_s, sigma_s=12.0**-0.5,  # cut to whole seconds
                           number=number, numbering="counted")  # what the images say themselves
    assignment = assign(events, images)                        # or with first_image, tie_points
    if not assignment.accepted:                                # see assignment.reason, log_ratio
        ...
    rows = assignment.event                                    # (k,) row of events, -1 for none

A hypothesis is a clock (an offset and a drift of the camera's clock against the log's), or, where
the images have no times, what has to be added to their numbers; `alignment` gives its likelihood.
The runner-up is the best hypothesis that gives more than half of the images another event.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED, Axis, Shares
from unbend.block.image_evidence import CameraEvents, ImageEvidence
from unbend.units import Array, Integers, Mask

MAX_HYPOTHESES = 24  # offsets that are compared
MAX_WITH_POINTS = 400  # offsets that are compared where tie points help to decide
HOPELESS = 60.0  # log likelihood below the best one: tie points do not test such a hypothesis
ENOUGH_MEET = 0.8  # of the largest share of points that meet: such an assignment can win
MIN_RIVALS = 3  # that tie points test, however few points meet
LARGEST_SIGMA = 0.25  # of the median interval: times that fit only by chance give 0.37
FEW_AMBIGUOUS = 0.2  # of the images


@dataclass(frozen=True, eq=False)
class Assignment:
    """The best assignment of events to images (k,), and how much better it is than its rival."""

    event: Integers  # row of the event of each image, -1 for none
    residual_s: Array  # event minus image time after offset and drift, NaN without times
    ambiguous: Mask  # images between two events that are about as likely: they have no event
    repeated: Mask  # (m,) as of `CameraEvents`
    runner_up: Integers  # row of the event of each image by the best rival, -1 for none
    log_ratio: float  # log likelihood minus that of the rival, infinite without a rival
    reason: str  # why the assignment is refused; empty if it is not
    evidence: tuple[str, ...]  # kinds of evidence that were used, in words
    offset_s: float = np.nan  # event minus camera time at the middle image
    drift: float = np.nan
    sigma_s: float = np.nan  # standard deviation of an image's time, by the residuals

    @property
    def accepted(self) -> bool:
        """Whether the assignment may be used."""
        return not self.reason

    @property
    def shift(self) -> int:
        """By how many events the runner-up is later (median over images); 0 without one."""
        both = (self.runner_up >= 0) & (self.event >= 0)
        if not np.any(both):
            return 0
        apart = self.runner_up - self.event
        return int(np.median(apart[both]))


def assign(
    events: CameraEvents,
    images: ImageEvidence,
    *,
    first_image: tuple[int, int] | None = None,
    tie_points: Callable[[Integers], float] | None = None,
    share_met: Callable[[Integers], Array] | None = None,
) -> Assignment:
    """Assign events to images by times, numbers, names and, if given, tie points.

    Parameters
    ----------
    first_image : (row of an image, row of its event), stated by the user.
    tie_points : function that gives the log likelihood of an assignment ((k,) rows of events, -1
        for none) by rays that intersect. It is called for up to some hundred hypotheses.
    share_met : fast function that gives the share (c,) of tie points with rays that meet, under
        assignments (c, k). Then ``tie_points`` is called only for those that can win, and for some
        rivals.

    The assignment is refused (``reason``) if the likelihood of the runner-up is not 1000 times
    smaller, if counts are unequal and names are only ``counted``, if fewer than half of the images
    have an event, if times fit no better than by chance, and if ``first_image`` contradicts the
    other evidence.

    >>> times = np.array([0.0, 3.0, 6.1, 9.0, 40.0, 43.1, 46.0, 49.0])
    >>> camera_clock = ImageEvidence(5, time_s=times[2:7] + 7200.0, sigma_s=0.05)
    >>> assign(CameraEvents(times), camera_clock).event.tolist()
    [2, 3, 4, 5, 6]
    """
    axis = images.axis(events)
    if not can_be_assigned(axis, first_image):
        reason = "there are no events, or no times of the images that should have one"
        return empty_assignment(events, images, reason)

    candidates = MAX_WITH_POINTS if tie_points else MAX_HYPOTHESES
    offsets = axis.candidate_offsets(candidates)
    offsets = np.append(offsets, images.offsets_of_names(events, axis))
    if first_image is not None:
        offsets = np.append(offsets, offset_of_first_image(axis, first_image))
    axis = axis.with_sigma_inflated(axis.fitted_clocks(offsets))
    clocks, shares = axis.with_shifted_clocks(axis.fitted_clocks(offsets))
    hypotheses = scored_hypotheses(events, images, axis, clocks, shares)
    if tie_points is not None:
        hypotheses = scored_by_points(hypotheses, tie_points, share_met)

    choice = chosen_hypothesis(hypotheses, axis, first_image)
    event, ambiguous = axis.aligned(clocks[choice.best], shares)
    chosen = empty_assignment(events, images, "")
    chosen.event[axis.image_rows] = event
    chosen.ambiguous[axis.image_rows] = ambiguous
    evidence = evidence_of(events, images, axis)
    if tie_points is not None:
        evidence.append("tie points")
    if first_image is not None:
        evidence.append("first_image")
    chosen = replace(
        chosen,
        log_ratio=choice.log_ratio,
        runner_up=choice.runner_up,
        evidence=tuple(evidence),
    )
    if axis.is_time:
        chosen = with_clock(chosen, axis, clocks[choice.best])

    # Prices of missing events and images alone are no evidence against ``first_image``.
    contradiction = 0.0
    if axis.is_time or tie_points is not None or images.names_state_events(events):
        contradiction = choice.contradiction
    reason = why_refused(chosen, events, images, axis, contradiction)
    return replace(chosen, reason=reason)


def can_be_assigned(axis: Axis, first_image: tuple[int, int] | None) -> bool:
    """Whether the axis has events and images, and the image that the user stated."""
    if axis.events.size == 0 or axis.images.size == 0:
        return False
    return first_image is None or first_image[0] in axis.image_rows


def offset_of_first_image(axis: Axis, first_image: tuple[int, int]) -> float:
    """The offset under which ``first_image`` (row of an image, row of its event) is right."""
    image_row, event_row = first_image
    place = int(np.flatnonzero(axis.image_rows == image_row)[0])
    return float(axis.events[event_row] - axis.images[place])


def empty_assignment(events: CameraEvents, images: ImageEvidence, reason: str) -> Assignment:
    """An assignment in which no image has an event."""
    return Assignment(
        event=np.full(images.count, -1, np.int64),
        residual_s=np.full(images.count, np.nan),
        ambiguous=np.zeros(images.count, np.bool_),
        repeated=events.repeated,
        runner_up=np.full(images.count, -1, np.int64),
        log_ratio=0.0,
        reason=reason,
        evidence=(),
    )


def evidence_of(events: CameraEvents, images: ImageEvidence, axis: Axis) -> list[str]:
    """The kinds of evidence from events and images that were used, in words."""
    evidence = []
    if axis.is_time:
        evidence.append("times")
    by_number = images.number is not None and not axis.is_time
    if images.names_state_events(events) or by_number:
        evidence.append(f"names ({images.numbering})")
    if images.number is None and not axis.is_time:
        evidence.append("order")
    return evidence


def with_clock(assignment: Assignment, axis: Axis, clock: Array) -> Assignment:
    """An assignment by times with its clock (2,): offset, drift, sigma and residuals.

    Changes ``residual_s`` of the given assignment.
    """
    event = assignment.event[axis.image_rows]
    predicted_s = axis.predicted(clock[None])[0]
    residual_s = axis.events[event] - predicted_s
    residual_s[event < 0] = np.nan
    assignment.residual_s[axis.image_rows] = residual_s
    offset_s, drift = clock.tolist()
    sigma_s = float(axis.sigma.mean())
    return replace(assignment, offset_s=offset_s, drift=drift, sigma_s=sigma_s)


# ---------------------------------------------------------------------- hypotheses


@dataclass(frozen=True, eq=False)
class ScoredHypotheses:
    """Assignments under c clocks, and their log likelihoods."""

    rows: Integers  # (c, k) row of the event of each image, -1 for none
    score: Array  # (c,) log likelihood


@dataclass(frozen=True, eq=False)
class Choice:
    """The best hypothesis that agrees with ``first_image``, and its best rival.

    A rival gives most images another event.
    """

    best: int  # number of the hypothesis
    runner_up: Integers  # (k,) row of the event of each image by the rival, -1 for none
    log_ratio: float  # log likelihood of the best minus the rival; infinite without a rival
    contradiction: float  # log likelihood of the best of all, also against first_image, minus best


def scored_hypotheses(
    events: CameraEvents,
    images: ImageEvidence,
    axis: Axis,
    clocks: Array,
    shares: Shares,
) -> ScoredHypotheses:
    """The assignments under clocks (c, 2), scored by times or numbers and by names."""
    partners = axis.partners(clocks)
    rows = np.full((clocks.shape[0], images.count), -1, np.int64)
    rows[:, axis.image_rows] = partners
    score = axis.likelihoods(clocks, shares)
    score = score + axis.price_of_pauses(clocks, partners, shares)
    score = score + images.log_prior_of_names(events, rows)
    return ScoredHypotheses(rows, score)


def scored_by_points(
    hypotheses: ScoredHypotheses,
    tie_points: Callable[[Integers], float],
    share_met: Callable[[Integers], Array] | None,
) -> ScoredHypotheses:
    """Hypotheses with the log likelihoods of tie points added to their scores.

    A hypothesis that is `HOPELESS` below the best one gets the least of these log likelihoods,
    without a call of ``tie_points``. Equal assignments are computed once.
    """
    score = hypotheses.score.copy()
    is_hopeful = score > score.max() - HOPELESS
    hopeful_rows = hypotheses.rows[is_hopeful]
    unique_rows, row_in_unique = np.unique(hopeful_rows, axis=0, return_inverse=True)
    by_points = likelihoods_by_points(unique_rows, tie_points, share_met)
    score[is_hopeful] += by_points[row_in_unique.ravel()]
    score[~is_hopeful] += by_points.min()
    return replace(hypotheses, score=score)


def likelihoods_by_points(
    rows: Integers,
    tie_points: Callable[[Integers], float],
    share_met: Callable[[Integers], Array] | None,
) -> Array:
    """(c,) log likelihoods of assignments (c, k) by tie points.

    With ``share_met``, they are computed only for assignments that can win: at least `ENOUGH_MEET`
    times the largest share of points meets, or they are among the best rivals. Others get the least
    of these values. If fewer than half of the points meet under every assignment, all are computed.
    """
    can_win = np.ones(rows.shape[0], np.bool_)
    met = None if share_met is None else share_met(rows)
    if met is not None and met.max() >= 0.5:
        can_win = met >= ENOUGH_MEET * met.max()
        best = rows[np.argmax(met)]
        is_rival = np.mean(rows != best, axis=1) > 0.5
        met_by_rivals = np.where(is_rival, met, -1.0)
        rivals = np.argsort(-met_by_rivals, kind="stable")
        can_win[rivals[:MIN_RIVALS]] = True
    likelihoods = np.array([tie_points(event) for event in rows[can_win]])
    of_all = np.full(can_win.shape, likelihoods.min())
    of_all[can_win] = likelihoods
    return of_all


def chosen_hypothesis(
    hypotheses: ScoredHypotheses, axis: Axis, first_image: tuple[int, int] | None
) -> Choice:
    """The best hypothesis that agrees with ``first_image``, and the best rival that does.

    Pulses are compared, not events: a repeat of a pulse is the same pulse.
    """
    rows = hypotheses.rows
    score = hypotheses.score
    has_event = rows >= 0
    pulses = np.where(has_event, axis.pulse[rows], -1)
    allowed = np.ones(score.shape, np.bool_)
    if first_image is not None:
        image_row, event_row = first_image
        allowed = pulses[:, image_row] == axis.pulse[event_row]
    best = best_of(score, allowed)
    changed = np.sum(pulses != pulses[best], axis=1)
    assigned = np.sum(has_event | has_event[best], axis=1)
    is_rival = allowed & (changed > 0.5 * assigned)
    rival = best_of(score, is_rival)
    log_ratio = np.inf
    runner_up = np.full(rows.shape[1], -1, np.int64)
    if is_rival[rival]:
        log_ratio = float(score[best] - score[rival])
        runner_up = rows[rival]
    contradiction = float(score.max() - score[best])
    return Choice(best, runner_up, log_ratio, contradiction)


def best_of(score: Array, allowed: Mask) -> int:
    """The row of the highest score that is allowed; 0 if none is allowed."""
    return int(np.argmax(np.where(allowed, score, -np.inf)))


# ---------------------------------------------------------------------- refusals


def why_refused(
    assignment: Assignment,
    events: CameraEvents,
    images: ImageEvidence,
    axis: Axis,
    contradiction: float,
) -> str:
    """Why an assignment is refused; empty if it is accepted.

    ``contradiction`` is the log likelihood of the best assignment without ``first_image`` minus
    that of this one, 0 or more.
    """
    ambiguous = int(np.count_nonzero(assignment.ambiguous))
    placed = int(np.count_nonzero(assignment.event >= 0)) + ambiguous
    if contradiction > LOG_RATIO_NEEDED:
        pair = "the image and its event that were stated"
        return f"{pair} contradict the other evidence by e^{contradiction:.0f}"
    if placed < 0.5 * images.count:
        return f"only {placed} of {images.count} images could be assigned to an event"
    if ambiguous > FEW_AMBIGUOUS * images.count:
        return f"{ambiguous} of {images.count} images are between two events"
    if axis.is_time and assignment.sigma_s > LARGEST_SIGMA * axis.interval:
        sizes = f"residuals of {assignment.sigma_s:.2g} s, events {axis.interval:.2g} s apart"
        return f"the times fit no better than by chance: {sizes}"
    only_times = axis.is_time and len(assignment.evidence) == 1
    if only_times and placed < 3 and np.isinf(axis.offset_sigma):
        return f"{placed} images have no pattern of intervals"
    if assignment.log_ratio >= LOG_RATIO_NEEDED:
        return ""
    if assignment.evidence[-1] == "names (counted)" and not images.names_state_events(events):
        counts = f"counted up to {int(np.max(axis.images))} and {events.time_s.size} events"
        why = "numbers alone do not decide the assignment of images to events"
        return f"{images.count} images {counts}: {why}"
    times = f"{np.exp(max(0.0, assignment.log_ratio)):.3g} times less likely"
    return f"shifted by {assignment.shift:+d} events it is only {times}"
