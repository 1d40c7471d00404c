"""Which image belongs to which camera pulse: by numbers, times, rhythm and tie points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import Assignment, assign
from unbend.block.image_evidence import CameraEvents, ImageEvidence
from unbend.config import Mission
from unbend.config.event_sources import EventsSection, FirstImage
from unbend.flight.exposures import Events, refuse_repeated_images
from unbend.flight.image_names import name_series
from unbend.flight.stations import NO_TIME, Stations
from unbend.messages import Ledger, Message, Notes
from unbend.stages.multi_image import messages
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
from unbend.stages.multi_image.image_numbers import counting_of, events_by_name
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints
from unbend.units import Integers, Mask

SECONDS_PER_HOUR = 3600.0
LARGEST_CLOCK_ERROR_S = 86_400.0  # beyond a day the images are hardly of this flight
FEW_CONTRADICTED = 0.02  # share of the numbers in names that evidence may contradict
MOST_LISTED_IMAGES = 3
MOST_LISTED_EVENTS = 8


@dataclass(frozen=True, eq=False)
class AssignedEvents:
    """The events that have an image, under its name, and their rows among all events."""

    events: Events
    rows: Integers

    @classmethod
    def of(cls, exposed: Events, rows: Integers) -> AssignedEvents:
        """Some rows of the events of a camera, under the names that they have."""
        return cls(Events(exposed.camera, exposed.image[rows], exposed.time_ns[rows]), rows)


def assigned_stations(
    mission: Mission,
    section: EventsSection,
    events: list[Events],
    stations: list[Stations],
    *,
    files: ImageTimes | None,
    observations: Observations,
    ties: TiePoints,
    ledger: Ledger,
) -> list[Stations]:
    """The stations of the events that have an image, camera by camera, under the image's name.

    ``stations`` are those of all ``events``, camera by camera. Events of a table, and of a file
    that names its images, keep the names that they have.
    """
    if section.csv is not None:
        return stations
    if section.images is not None and files is not None:
        report_absent(files, observations.images, section.images.path, ledger)
    stations_with_image = []
    events_with_image = []
    for exposed, event_stations in zip(events, stations, strict=True):
        pattern = section.patterns[exposed.camera]
        if pattern == "{name}":
            stations_with_image.append(event_stations)
            events_with_image.append(exposed)
            continue
        images = images_of_camera(pattern, observations.images, files)
        camera = mission.interior_orientations[exposed.camera]
        likelihoods: dict[str, Likelihood] = {}
        by_ties = tie_likelihood(ties, images, camera, event_stations)
        if by_ties is not None:
            likelihoods[TIES] = by_ties
        by_positions = position_likelihood(images, files, event_stations)
        if by_positions is not None:
            likelihoods["positions"] = by_positions
        anchor = section.stated_first_image(exposed.camera)
        assigned = ledger.take(assigned_events(exposed, images, files, anchor, likelihoods))
        named = replace(event_stations.rows(assigned.rows), image=assigned.events.image)
        stations_with_image.append(named)
        events_with_image.append(assigned.events)
    refuse_repeated_images(events_with_image)
    return stations_with_image


def report_absent(files: ImageTimes, observed: tuple[str, ...], where: str, ledger: Ledger) -> None:
    """A loss of observed images that are not among the files; refuses (IMAGES-OTHER) if all are."""
    absent = sorted(set(observed) - set(files.rows_of(observed)))
    if len(absent) == len(observed):
        raise messages.images_of_another_flight(
            where=where, absent=absent[0], files=str(files.file[0])
        )
    if absent:
        ledger.add(messages.images_absent(where=where, count=len(absent), first=absent[0]))


def assigned_events(
    exposed: Events,
    images: CameraImages,
    files: ImageTimes | None,
    anchor: FirstImage | None,
    likelihoods: Mapping[str, Likelihood],
) -> tuple[AssignedEvents, Notes]:
    """The events of a camera that have an image, and notes on how they were found.

    With the log's own numbers in the names of images, these decide:

    * an image whose likeliest event is another one than its number says has no event (undecided),
      if these are 2 % of the images at most;
    * if these are more, and tie points, times or positions contradict the numbers by a factor of
      1000, the mission is refused (EVENTS-CONTRADICTED);
    * if these are more, but the evidence against the numbers is weaker, all numbers hold.

    Without such numbers the likelihood decides. The mission is refused (EVENTS-AMBIGUOUS) if the
    next best assignment is not 1000 times less likely, or a part of the images may be shifted.
    """
    all_rows = np.arange(exposed.time_ns.size, dtype=np.int64)
    has_names = bool((exposed.image != "").all())
    if images.name.size == 0 or all_rows.size == 0:
        rows_with_names = all_rows if has_names else all_rows[:0]
        return AssignedEvents.of(exposed, rows_with_names), ()

    counting = counting_of(exposed, images, has_names=has_names)
    if counting.images.numbering == "index" and not counting.by_index:
        # The numbers begin anew, but the names of the events do not repeat.
        return AssignedEvents(exposed, all_rows), ()
    by_name = events_by_name(exposed, counting.images, by_index=counting.needs_index)
    evidence = evidence_of_images(exposed, counting.images, files)
    assignment = likeliest_assignment(exposed, counting.images, evidence, anchor, likelihoods)
    ties = likelihoods.get(TIES)
    if isinstance(ties, TieLikelihood) and not ties.fits(assignment.event):
        # No assignment lets the rays meet: mounts, cameras or times are wrong, not the events.
        without_ties = dict(likelihoods)
        del without_ties[TIES]
        return assigned_events(exposed, images, files, anchor, without_ties)
    if counting.by_index:
        decision = decided_by_numbers(
            assignment,
            by_name,
            exposed,
            images=counting.images,
            evidence=evidence,
            likelihoods=likelihoods,
        )
    else:
        refuse_ambiguity(assignment, assignment.reason, counting.images, exposed)
        decision = Decision(assignment, assignment.event, assignment.ambiguous)
    if exposed.counts == "maybe" or not counting.by_index:
        refuse_hole(decision.assignment, counting.images, exposed, likelihoods)
    notes = notes_of_assignment(*decision, counting.images, exposed)
    notes += notes_of_clock(decision.assignment, evidence)
    if counting.has_names and np.array_equal(decision.event, by_name):
        return AssignedEvents(exposed, all_rows), tuple(notes)
    assigned = named_events(exposed, counting.images, decision.event)
    unused = np.setdiff1d(all_rows, assigned.rows)
    if unused.size:
        notes.append(note_of_unused(unused, exposed))
    return assigned, tuple(notes)


class Decision(NamedTuple):
    """The assignment that holds, (k,) the event of each image, and (k,) which are undecided."""

    assignment: Assignment
    event: Integers
    undecided: Mask


def decided_by_numbers(
    assignment: Assignment,
    by_name: Integers,
    exposed: Events,
    *,
    images: CameraImages,
    evidence: ImageEvidence,
    likelihoods: Mapping[str, Likelihood],
) -> Decision:
    """The events ``by_name`` of images, of which few may be undecided by other evidence."""
    undecided = (assignment.event >= 0) & (assignment.event != by_name)
    if float(undecided.mean()) > FEW_CONTRADICTED:
        refuse_contradiction(
            assignment, by_name, images, exposed, evidence, likelihoods=likelihoods
        )
        # Not refused: what is likelier by less than the limit does not count.
        assignment = stated_assignment(assignment, by_name)
        undecided = np.zeros(by_name.shape, np.bool_)
    event = np.where(undecided, -1, by_name)
    return Decision(assignment, event, undecided)


def notes_of_clock(assignment: Assignment, evidence: ImageEvidence) -> Notes:
    """A note on the clock of a camera that is far off, if the images have times."""
    if evidence.time_s is None or abs(assignment.offset_s) <= LARGEST_CLOCK_ERROR_S:
        return ()
    hours = assignment.offset_s / SECONDS_PER_HOUR
    return (messages.camera_clock_off(where="events.images", hours=hours),)


def likeliest_assignment(
    exposed: Events,
    images: CameraImages,
    evidence: ImageEvidence,
    anchor: FirstImage | None,
    likelihoods: Mapping[str, Likelihood],
) -> Assignment:
    """The assignment of events to images that all evidence makes most likely.

    In the evidence that the assignment lists, the names of the ``likelihoods`` stand for the "tie
    points" of `assign`.
    """
    ties = likelihoods.get(TIES)
    assignment = assign(
        camera_events(exposed),
        evidence,
        first_image=anchor_rows(anchor, images, exposed),
        tie_points=joint_likelihood(likelihoods.values()) if likelihoods else None,
        share_met=ties.share_met if isinstance(ties, TieLikelihood) else None,
    )
    # `assign` calls every joint likelihood "tie points", whatever it is made of.
    names = " and ".join(likelihoods)
    listed = tuple(names if name == TIES else name for name in assignment.evidence)
    return replace(assignment, evidence=listed)


def named_events(exposed: Events, images: CameraImages, event: Integers) -> AssignedEvents:
    """The events of an assignment (k,) in their order, under the names of their images."""
    has_event = np.flatnonzero(event >= 0)
    image_rows = has_event[np.argsort(event[has_event], kind="stable")]
    rows = event[image_rows]
    return AssignedEvents(
        Events(exposed.camera, images.name[image_rows], exposed.time_ns[rows]), rows
    )


def refuse_contradiction(
    assignment: Assignment,
    by_name: Integers,
    images: CameraImages,
    exposed: Events,
    evidence: ImageEvidence,
    *,
    likelihoods: Mapping[str, Likelihood],
) -> None:
    """Refuse (EVENTS-CONTRADICTED) the log's numbers in names, if evidence says otherwise.

    Evidence are tie points, times, positions, and a pair that the mission file states. That images
    or events are usually not missing is no evidence here.
    """
    against = evidence_against_names(assignment, by_name, exposed, evidence, likelihoods)
    if sum(against.values()) <= LOG_RATIO_NEEDED:
        return
    decisive = [name for name, log_ratio in against.items() if log_ratio > 0.0]
    where = f"events.log.{exposed.camera}"
    raise messages.numbers_contradicted(
        where=where,
        of=where,
        evidence=" and ".join(decisive),
        found=describe_assignment(assignment, images, exposed),
    )


def evidence_against_names(
    assignment: Assignment,
    by_name: Integers,
    exposed: Events,
    evidence: ImageEvidence,
    likelihoods: Mapping[str, Likelihood],
) -> dict[str, float]:
    """By each evidence, how much more likely an assignment is than that of the names.

    ``by_name`` (k,) are the rows of the events that names claim. The values are natural logarithms.
    Only images count that have an event in the assignment and by their name.
    """
    is_in_both = (by_name >= 0) & (assignment.event >= 0)
    assigned = np.where(is_in_both, assignment.event, -1)
    claimed = np.where(is_in_both, by_name, -1)
    against = {}
    for name, likelihood in likelihoods.items():
        against[name] = likelihood(assigned) - likelihood(claimed)
    if evidence.time_s is not None:
        events = camera_events(exposed)
        sigma_s = float(np.nan_to_num(assignment.sigma_s))
        of_assigned = evidence.log_likelihood_of_times(events, assigned, sigma_s)
        against["times"] = of_assigned - evidence.log_likelihood_of_times(events, claimed, sigma_s)
    if "first_image" in assignment.evidence:
        # The mission file states a pair, which the assignment has and the names have not.
        against["first_image"] = np.inf
    return against


def stated_assignment(assignment: Assignment, by_name: Integers) -> Assignment:
    """The assignment that names claim, and no evidence contradicts."""
    return replace(
        assignment,
        event=by_name,
        residual_s=np.full(by_name.shape, np.nan),
        ambiguous=np.zeros(by_name.shape, np.bool_),
        runner_up=np.empty(0, np.int64),
        evidence=("names (index)",),
        offset_s=np.nan,
    )


def camera_events(exposed: Events) -> CameraEvents:
    """The events of a camera with times from the first one [s]."""
    return CameraEvents((exposed.time_ns - exposed.time_ns[0]) / 1e9, exposed.index)


def refuse_ambiguity(
    assignment: Assignment, why: str, images: CameraImages, exposed: Events
) -> None:
    """Refuse (EVENTS-AMBIGUOUS) an assignment, unless the reason ``why`` is empty."""
    if not why:
        return
    strays, mend = beside_the_log(images, exposed)
    raise messages.assignment_ambiguous(
        where=f"events.log.{exposed.camera}",
        strays=strays,
        why=why,
        found=describe_assignment(assignment, images, exposed),
        mend=mend,
        camera=exposed.camera,
        first=str(images.name[0]),
    )


def notes_of_assignment(
    assignment: Assignment,
    event: Integers,
    undecided: Mask,
    images: CameraImages,
    exposed: Events,
) -> list[Message]:
    """How many images have an event, and a loss of the images that evidence does not decide.

    ``event`` (k,) is the row of the event of each image, ``undecided`` (k,) a mask.
    """
    where = f"events.log.{exposed.camera}"
    description = describe_assignment(assignment, images, exposed)
    count = int((event >= 0).sum())
    notes = [messages.events_assigned(where=where, count=count, description=description)]
    if undecided.any():
        listed = ", ".join(images.name[undecided][:MOST_LISTED_IMAGES])
        notes.append(
            messages.events_undecided(where=where, count=int(undecided.sum()), images=listed)
        )
    return notes


def note_of_unused(unused: Integers, exposed: Events) -> Message:
    """A note of events without an image; ``unused`` are their rows."""
    numbers = unused + 1 if exposed.index is None else exposed.index[unused]
    listed = ", ".join(map(str, numbers[:MOST_LISTED_EVENTS]))
    if unused.size > MOST_LISTED_EVENTS:
        listed += " ..."
    where = f"events.log.{exposed.camera}"
    return messages.events_unused(where=where, count=int(unused.size), events=listed)


def refuse_hole(
    assignment: Assignment,
    images: CameraImages,
    exposed: Events,
    likelihoods: Mapping[str, Likelihood],
) -> None:
    """Refuse (EVENTS-AMBIGUOUS) where a part of the images may belong to other events."""
    hole = hole_between(assignment, images, exposed, likelihoods)
    if hole:
        why = f"a part of the images may be shifted, because {hole}"
        refuse_ambiguity(assignment, why, images, exposed)


def beside_the_log(images: CameraImages, exposed: Events) -> tuple[str, str]:
    """Two beginnings for a refusal: which few names do not fit the log, and what to do about them.

    Both are empty unless all other names may be the log's numbers.
    """
    index = exposed.index
    if index is None:
        return "", ""
    series = name_series(images.name)[0]  # the largest
    is_only_series = len(series.numbers) == images.name.size
    far = series.strays(index.tolist())
    if not far or not is_only_series:
        return "", ""
    difference = (
        f"{images.name.size} images, {index.size} events: {series.listed(far)} does not fit; the "
        f"other names may be the numbers of the log {index.min()} to {index.max()}; "
    )
    to_do = (
        f"write events.log.{exposed.camera}.image: {series.pattern('index')} if these are the "
        "numbers of the log, or correct the name in the observations; or "
    )
    return difference, to_do


def anchor_rows(
    anchor: FirstImage | None, images: CameraImages, exposed: Events
) -> tuple[int, int] | None:
    """Rows of the image and the event that the mission file says belong together."""
    if anchor is None:
        return None
    row = np.flatnonzero(images.name == anchor.image)
    count = exposed.time_ns.size
    if row.size == 0 or anchor.event > count:
        raise messages.first_image_missing(
            where=f"events.first_image.{exposed.camera}",
            image=anchor.image,
            event=anchor.event,
            events=count,
            first=str(images.name[0]),
        )
    return int(row[0]), anchor.event - 1


def evidence_of_images(
    exposed: Events, images: CameraImages, files: ImageTimes | None
) -> ImageEvidence:
    """Numbers of the images, and their times from the first event on where files have them."""
    evidence = ImageEvidence(
        images.name.size,
        number=images.number,
        numbering=images.numbering,
        total=-1 if exposed.lost else None,  # where pulses were lost, equal counts mean nothing
    )
    if files is None:
        return evidence
    time_ns = np.append(files.time_ns, NO_TIME)[images.file]
    timed = time_ns != NO_TIME
    if not bool(timed.any()):
        return evidence
    begin_ns = exposed.time_ns[0]
    seconds = (np.where(timed, time_ns, begin_ns) - begin_ns) / 1e9
    return replace(
        evidence,
        time_s=np.where(timed, seconds, np.nan),
        sigma_s=np.append(files.sigma_s, np.nan)[images.file],
        clock_sigma_s=files.clock_sigma_s,
    )


def describe_assignment(assignment: Assignment, images: CameraImages, exposed: Events) -> str:
    """An assignment with its residuals and its runner-up, in one sentence or two."""
    assigned = int((assignment.event >= 0).sum())
    text = f"{assigned} of {images.name.size} images and {exposed.time_ns.size} events"
    if assigned:
        first = int(np.argmax(assignment.event >= 0))
        event = assignment.event[first]
        number = event + 1 if exposed.index is None else exposed.index[event]
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
