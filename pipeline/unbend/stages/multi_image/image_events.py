"""Which image belongs to which camera pulse: by numbers, times, rhythm and tie points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import Assignment, assign
from unbend.block.image_evidence import ImageEvidence
from unbend.config import Mission
from unbend.config.event_sources import EventsSection, FirstImage
from unbend.flight.exposures import Events, refuse_repeated_images
from unbend.flight.image_names import name_series
from unbend.flight.stations import Stations
from unbend.messages import Ledger, Message, Notes
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.assignment_evidence import (
    anchor_rows,
    camera_events,
    evidence_of_images,
)
from unbend.stages.multi_image.assignment_holes import hole_between
from unbend.stages.multi_image.assignment_likelihoods import (
    TIES,
    Likelihood,
    TieLikelihood,
    joint_likelihood,
    position_likelihood,
    tie_likelihood,
)
from unbend.stages.multi_image.camera_images import CameraImages, images_of_camera
from unbend.stages.multi_image.image_numbers import claimed_events, counting_of
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints
from unbend.units import Integers, Mask

SECONDS_PER_HOUR = 3600.0
LARGEST_CLOCK_ERROR_S = 86_400.0  # beyond a day the images are hardly of this flight
FEW_CONTRADICTED = 0.02  # share of the images: if evidence contradicts more numbers, it is judged
MOST_LISTED_IMAGES = 3
MOST_LISTED_EVENTS = 8


@dataclass(frozen=True, eq=False)
class AssignedEvents:
    """The events of a camera that have an image, under its name.

    rows : their rows among all events of the camera.
    """

    events: Events
    rows: Integers

    @classmethod
    def of(cls, events: Events, rows: Integers) -> AssignedEvents:
        """The events in some ``rows`` of all events, under the names that the log gives them."""
        return cls(Events(events.camera, events.image[rows], events.time_ns[rows]), rows)


def assigned_stations(
    mission: Mission,
    section: EventsSection,
    events_of_cameras: list[Events],
    stations_of_cameras: list[Stations],
    *,
    files: ImageTimes | None,
    observations: Observations,
    ties: TiePoints,
    ledger: Ledger,
) -> list[Stations]:
    """The stations of the events that have an image, camera by camera, under the image's name.

    ``stations_of_cameras`` are those of all events, in the same order. Events of a table, and of a
    file that names its images, keep their names.
    """
    if section.csv is not None:
        return stations_of_cameras
    if section.images is not None and files is not None:
        report_absent(files, observations.images, section.images.path, ledger)
    stations_with_image = []
    events_with_image = []
    for events, stations in zip(events_of_cameras, stations_of_cameras, strict=True):
        pattern = section.patterns[events.camera]
        if pattern == "{name}":
            stations_with_image.append(stations)
            events_with_image.append(events)
            continue
        images = images_of_camera(pattern, observations.images, files)
        camera = mission.interior_orientations[events.camera]
        likelihoods: dict[str, Likelihood] = {}
        by_ties = tie_likelihood(ties, images, camera, stations)
        if by_ties is not None:
            likelihoods[TIES] = by_ties
        by_positions = position_likelihood(images, files, stations)
        if by_positions is not None:
            likelihoods["positions"] = by_positions
        anchor = section.stated_first_image(events.camera)
        assigned = ledger.take(assigned_events(events, images, files, anchor, likelihoods))
        named_stations = replace(stations.rows(assigned.rows), image=assigned.events.image)
        stations_with_image.append(named_stations)
        events_with_image.append(assigned.events)
    refuse_repeated_images(events_with_image)
    return stations_with_image


def report_absent(files: ImageTimes, observed: tuple[str, ...], where: str, ledger: Ledger) -> None:
    """Add a loss of observed images that are not among the files.

    Refuses (IMAGES-OTHER) files of which no image is observed. ``where`` is their path.
    """
    absent = sorted(set(observed) - set(files.rows_of(observed)))
    if len(absent) == len(observed):
        raise messages.images_of_another_flight(
            where=where, absent=absent[0], files=str(files.file[0])
        )
    if absent:
        ledger.add(messages.images_absent(where=where, count=len(absent), first=absent[0]))


def assigned_events(
    events: Events,
    images: CameraImages,
    files: ImageTimes | None,
    anchor: FirstImage | None,
    likelihoods: Mapping[str, Likelihood],
) -> tuple[AssignedEvents, Notes]:
    """The events of a camera that have an image, and notes on how they were assigned.

    If the names of images have the log's own numbers, these decide. Where the likeliest event of an
    image is not that of its number:

    * these images have no event (undecided), if they are 2 % of the images at most;
    * if they are more, and tie points, times or positions contradict the numbers by a factor of
      1000, the mission is refused (EVENTS-CONTRADICTED);
    * if they are more, but the evidence against the numbers is weaker, all numbers hold.

    Without such numbers the likelihood decides. The mission is refused (EVENTS-AMBIGUOUS) if the
    next best assignment is not 1000 times less likely, or a part of the images may be shifted.
    ``anchor`` is a pair of image and event that the mission file states.
    """
    all_rows = np.arange(events.time_ns.size, dtype=np.int64)
    has_names = bool((events.image != "").all())
    if images.name.size == 0 or all_rows.size == 0:
        rows_with_names = all_rows if has_names else all_rows[:0]
        return AssignedEvents.of(events, rows_with_names), ()

    counting = counting_of(events, images, has_names=has_names)
    if counting.images.numbering == "index" and not counting.by_index:
        # The log has no rising numbers (`Events.index` is None), but its names do not repeat.
        return AssignedEvents(events, all_rows), ()
    claimed_event = claimed_events(events, counting.images, by_index=counting.needs_index)
    evidence = evidence_of_images(events, counting.images, files)
    assignment = likeliest_assignment(events, counting.images, evidence, anchor, likelihoods)
    ties = likelihoods.get(TIES)
    if isinstance(ties, TieLikelihood) and not ties.fits(assignment.event):
        # No assignment lets the rays meet: mounts, cameras or times are wrong, not the events.
        without_ties = dict(likelihoods)
        del without_ties[TIES]
        return assigned_events(events, images, files, anchor, without_ties)
    if counting.by_index:
        decision = decided_by_numbers(
            assignment,
            claimed_event,
            events,
            images=counting.images,
            evidence=evidence,
            likelihoods=likelihoods,
        )
    else:
        refuse_ambiguity(assignment, assignment.reason, counting.images, events)
        decision = Decision(assignment, assignment.event, assignment.ambiguous)
    if events.counts == "maybe" or not counting.by_index:
        refuse_hole(decision.assignment, counting.images, events, likelihoods)
    notes = notes_of_assignment(
        decision.assignment, decision.event, decision.undecided, counting.images, events
    )
    notes += notes_of_clock(decision.assignment, evidence)
    if counting.has_names and np.array_equal(decision.event, claimed_event):
        return AssignedEvents(events, all_rows), tuple(notes)
    assigned = named_events(events, counting.images, decision.event)
    unused = np.setdiff1d(all_rows, assigned.rows)
    if unused.size:
        notes.append(note_of_unused(unused, events))
    return assigned, tuple(notes)


class Decision(NamedTuple):
    """Which event each image has.

    assignment : the assignment that holds, with its evidence.
    event : (k,) row of the event of each image, -1 for none; undecided images have none.
    undecided : (k,) images for which evidence and names give different events.
    """

    assignment: Assignment
    event: Integers
    undecided: Mask


def decided_by_numbers(
    assignment: Assignment,
    claimed_event: Integers,
    events: Events,
    *,
    images: CameraImages,
    evidence: ImageEvidence,
    likelihoods: Mapping[str, Likelihood],
) -> Decision:
    """The events that images claim by the log's numbers, unless other evidence contradicts.

    ``assignment`` is the likeliest by other evidence, ``claimed_event`` (k,) the row of the event
    by the number of each image. Up to 2 % of the images may differ: they are undecided.
    """
    undecided = (assignment.event >= 0) & (assignment.event != claimed_event)
    if float(undecided.mean()) > FEW_CONTRADICTED:
        refuse_contradiction(
            assignment, claimed_event, images, events, evidence, likelihoods=likelihoods
        )
        # Not refused: evidence that is weaker than the limit does not count, and all numbers hold.
        assignment = stated_assignment(assignment, claimed_event)
        undecided = np.zeros(claimed_event.shape, np.bool_)
    event = np.where(undecided, -1, claimed_event)
    return Decision(assignment, event, undecided)


def notes_of_clock(assignment: Assignment, evidence: ImageEvidence) -> Notes:
    """A warning if the clock of the camera is wrong by more than a day; () without image times."""
    if evidence.time_s is None or abs(assignment.offset_s) <= LARGEST_CLOCK_ERROR_S:
        return ()
    hours = assignment.offset_s / SECONDS_PER_HOUR
    return (messages.camera_clock_off(where="events.images", hours=hours),)


def likeliest_assignment(
    events: Events,
    images: CameraImages,
    evidence: ImageEvidence,
    anchor: FirstImage | None,
    likelihoods: Mapping[str, Likelihood],
) -> Assignment:
    """The assignment of events to images that all evidence makes most likely.

    Its list of evidence has the names of the ``likelihoods``.
    """
    ties = likelihoods.get(TIES)
    assignment = assign(
        camera_events(events),
        evidence,
        first_image=anchor_rows(anchor, images, events),
        tie_points=joint_likelihood(likelihoods.values()) if likelihoods else None,
        share_met=ties.share_met if isinstance(ties, TieLikelihood) else None,
    )
    # `assign` lists the joint likelihood as "tie points", whatever it is made of.
    names = " and ".join(likelihoods)
    evidence_names = tuple(names if name == TIES else name for name in assignment.evidence)
    return replace(assignment, evidence=evidence_names)


def named_events(events: Events, images: CameraImages, event: Integers) -> AssignedEvents:
    """The events that have an image, in the order of the log, under the names of their images.

    ``event`` (k,) is the row of the event of each image, -1 for none.
    """
    assigned_images = np.flatnonzero(event >= 0)
    image_rows = assigned_images[np.argsort(event[assigned_images], kind="stable")]
    rows = event[image_rows]
    return AssignedEvents(
        Events(events.camera, images.name[image_rows], events.time_ns[rows]), rows
    )


def refuse_contradiction(
    assignment: Assignment,
    claimed_event: Integers,
    images: CameraImages,
    events: Events,
    evidence: ImageEvidence,
    *,
    likelihoods: Mapping[str, Likelihood],
) -> None:
    """Refuse (EVENTS-CONTRADICTED) the log's numbers in names, if evidence contradicts them.

    Evidence are tie points, times, positions, and a pair that the mission file states, but not
    that images or events are rarely missing. It has to be 1000 times as likely by ``assignment`` as
    by the numbers.
    """
    against = evidence_against_names(assignment, claimed_event, events, evidence, likelihoods)
    if sum(against.values()) <= LOG_RATIO_NEEDED:
        return
    decisive = [name for name, log_ratio in against.items() if log_ratio > 0.0]
    where = f"events.log.{events.camera}"
    raise messages.numbers_contradicted(
        where=where,
        of=where,
        evidence=" and ".join(decisive),
        found=describe_assignment(assignment, images, events),
    )


def evidence_against_names(
    assignment: Assignment,
    claimed_event: Integers,
    events: Events,
    evidence: ImageEvidence,
    likelihoods: Mapping[str, Likelihood],
) -> dict[str, float]:
    """By kind of evidence, how much more likely ``assignment`` is than the events by the names.

    The values are natural logarithms of likelihood ratios. ``claimed_event`` (k,) is the row of the
    event by the name of each image, -1 for none. Only images count that have both events.
    """
    has_both = (claimed_event >= 0) & (assignment.event >= 0)
    assigned = np.where(has_both, assignment.event, -1)
    claimed = np.where(has_both, claimed_event, -1)
    against = {}
    for name, likelihood in likelihoods.items():
        against[name] = likelihood(assigned) - likelihood(claimed)
    if evidence.time_s is not None:
        timed_events = camera_events(events)
        sigma_s = float(np.nan_to_num(assignment.sigma_s))
        of_assigned = evidence.log_likelihood_of_times(timed_events, assigned, sigma_s)
        of_claimed = evidence.log_likelihood_of_times(timed_events, claimed, sigma_s)
        against["times"] = of_assigned - of_claimed
    if "first_image" in assignment.evidence:
        # The mission file states a pair that the assignment contains and the names do not.
        against["first_image"] = np.inf
    return against


def stated_assignment(assignment: Assignment, claimed_event: Integers) -> Assignment:
    """The assignment by the names of images alone: ``claimed_event`` (k,), no rival, no clock."""
    return replace(
        assignment,
        event=claimed_event,
        residual_s=np.full(claimed_event.shape, np.nan),
        ambiguous=np.zeros(claimed_event.shape, np.bool_),
        runner_up=np.empty(0, np.int64),
        evidence=("names (index)",),
        offset_s=np.nan,
    )


def refuse_ambiguity(
    assignment: Assignment, why: str, images: CameraImages, events: Events
) -> None:
    """Refuse (EVENTS-AMBIGUOUS) an assignment, unless the reason ``why`` is empty."""
    if not why:
        return
    strays, correction = stray_names_in_words(images, events)
    raise messages.assignment_ambiguous(
        where=f"events.log.{events.camera}",
        strays=strays,
        why=why,
        found=describe_assignment(assignment, images, events),
        mend=correction,
        camera=events.camera,
        first=str(images.name[0]),
    )


def notes_of_assignment(
    assignment: Assignment,
    event: Integers,
    undecided: Mask,
    images: CameraImages,
    events: Events,
) -> list[Message]:
    """A note of how many images have an event, and a loss of the images that are undecided.

    ``event`` (k,) is the row of the event of each image, -1 for none; ``undecided`` (k,) is True
    for images for which the evidence gives different events.
    """
    where = f"events.log.{events.camera}"
    description = describe_assignment(assignment, images, events)
    count = int((event >= 0).sum())
    notes = [messages.events_assigned(where=where, count=count, description=description)]
    if undecided.any():
        listed = ", ".join(images.name[undecided][:MOST_LISTED_IMAGES])
        notes.append(
            messages.events_undecided(where=where, count=int(undecided.sum()), images=listed)
        )
    return notes


def note_of_unused(unused: Integers, events: Events) -> Message:
    """A note of events without an image; ``unused`` are their rows."""
    # Events without numbers in the log are counted from 1.
    numbers = unused + 1 if events.index is None else events.index[unused]
    listed = ", ".join(map(str, numbers[:MOST_LISTED_EVENTS]))
    if unused.size > MOST_LISTED_EVENTS:
        listed += " ..."
    where = f"events.log.{events.camera}"
    return messages.events_unused(where=where, count=int(unused.size), events=listed)


def refuse_hole(
    assignment: Assignment,
    images: CameraImages,
    events: Events,
    likelihoods: Mapping[str, Likelihood],
) -> None:
    """Refuse (EVENTS-AMBIGUOUS) where a part of the images may belong to other events."""
    hole = hole_between(assignment, images, events, likelihoods)
    if hole:
        why = f"a part of the images may be shifted, because {hole}"
        refuse_ambiguity(assignment, why, images, events)


def stray_names_in_words(images: CameraImages, events: Events) -> tuple[str, str]:
    """Which names do not fit the log's numbers, and how to correct that: two beginnings of texts.

    Both are empty unless the names form one series with few strays, and all others may be the log's
    numbers.
    """
    index = events.index
    if index is None:
        return "", ""
    series = name_series(images.name)[0]  # the largest
    is_only_series = len(series.numbers) == images.name.size
    strays = series.strays(index.tolist())
    if not strays or not is_only_series:
        return "", ""
    difference = (
        f"{images.name.size} images, {index.size} events: {series.listed(strays)} does not fit; "
        f"the other names may be the numbers of the log {index.min()} to {index.max()}; "
    )
    correction = (
        f"write events.log.{events.camera}.image: {series.pattern('index')} if these are the "
        "numbers of the log, or correct the name in the observations; or "
    )
    return difference, correction


def describe_assignment(assignment: Assignment, images: CameraImages, events: Events) -> str:
    """An assignment with its residuals and its runner-up, in words."""
    assigned_count = int((assignment.event >= 0).sum())
    text = f"{assigned_count} of {images.name.size} images and {events.time_ns.size} events"
    if assigned_count:
        first = int(np.argmax(assignment.event >= 0))
        event = assignment.event[first]
        # Events without numbers in the log are counted from 1.
        number = event + 1 if events.index is None else events.index[event]
        text += f", {images.name[first]} of event {number}"
    text += f", by {', '.join(assignment.evidence)}"
    residual = assignment.residual_s[np.isfinite(assignment.residual_s)]
    if residual.size:
        rms = np.sqrt(np.mean(residual**2))
        most = np.abs(residual).max()
        text += f"; times fit to {rms:.3f} s rms, {most:.3f} s at most, "
        text += f"after {assignment.offset_s:+.3f} s and {1e6 * assignment.drift:+.1f} ppm"
    if assignment.runner_up.size:
        decades = assignment.log_ratio / np.log(10)
        noun = "event" if abs(assignment.shift) == 1 else "events"
        rival = f"the next best assignment ({assignment.shift:+d} {noun})"
        if decades > messages.CERTAIN_DECADES:
            text += f"; practically certain: {rival} is far less likely"
        else:
            text += f"; {rival} is 10^{decades:.0f} times less likely"
    return text
