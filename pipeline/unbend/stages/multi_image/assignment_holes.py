"""Whether an event or an image is missing, so that all images after it have wrong events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import Assignment
from unbend.flight.exposures import Events
from unbend.stages.multi_image.assignment_likelihoods import (
    TIES,
    Likelihood,
    TieLikelihood,
    evenly_spaced_of,
    joint_likelihood,
)
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.units import Integers

LARGEST_HOLE = 12  # events that a log may lack between two images
MOST_PLACES = 20  # where an event or an image may be missing: so many are tried


def hole_between(
    assignment: Assignment,
    images: CameraImages,
    events: Events,
    likelihoods: Mapping[str, Likelihood],
) -> str:
    """What shows that an event or an image is missing between others, in words; empty if nothing.

    All images after a missing event or image would belong to other events than assigned. In this
    order:

    * Nothing is missing unnoticed if the times of the images took part in the assignment.
    * Unless the user stated the event of an image, something is missing if there are fewer events
      than images (or than the largest number of counted images), or if the log lost events and
      there are no ``likelihoods`` to show where.
    * Something is missing at a place where the likelihoods show it (`is_shifted`).
    """
    if "times" in assignment.evidence:
        return ""
    images_count = images.name.size
    events_count = events.time_ns.size
    counted = images.numbering == "counted"
    events_needed = int(images.number.max()) if counted else images_count
    lost_somewhere = events.lost > 0 and not likelihoods
    is_event_missing = events_needed > events_count or lost_somewhere
    if is_event_missing and "first_image" not in assignment.evidence:
        if counted:
            return (
                f"{events_count} events for images counted up to {events_needed}: some events were "
                "lost"
            )
        return (
            f"{events_count} events for {images_count} images, and it is not known where events "
            "are missing in the log"
        )
    if not likelihoods:
        return ""
    order = np.argsort(images.number, kind="stable")  # rows of the images, by their numbers
    for place in places_of_holes(assignment, order, likelihoods):
        if is_shifted(
            assignment, images, order, place, events_count=events_count, likelihoods=likelihoods
        ):
            return f"one is missing near {images.name[order[place]]}"
    return ""


def places_of_holes(
    assignment: Assignment, order: Integers, likelihoods: Mapping[str, Likelihood]
) -> list[int]:
    """Indices into ``order`` before which an event or an image may be missing, at most 20.

    With tie points they are the places before and after each image that does not fit the others;
    without tie points they are evenly spaced. ``order`` (k,) sorts the images by number.
    """
    ties = likelihoods.get(TIES)
    if isinstance(ties, TieLikelihood):
        contradicted = np.flatnonzero(np.isin(order, ties.contradicted(assignment.event)))
        places = np.concatenate([contradicted, contradicted + 1])
        if places.size:
            places = evenly_spaced_of(places, MOST_PLACES)
    else:
        places = np.linspace(1, order.size - 1, MOST_PLACES).astype(int)
    inside = (places > 0) & (places < order.size)
    return [int(place) for place in np.unique(places[inside])]


def is_shifted(
    assignment: Assignment,
    images: CameraImages,
    order: Integers,
    place: int,
    *,
    events_count: int,
    likelihoods: Mapping[str, Likelihood],
) -> bool:
    """Whether the images before ``place`` in ``order``, or those from it on, fit better if shifted.

    They do if one of the `shifted_assignments` is 1000 times as likely as the assignment. Of the
    tie points only those count that images on both sides of the place show: a shift of one side
    changes nothing for the others.
    """
    across_place: list[Likelihood] = []
    for likelihood in likelihoods.values():
        if isinstance(likelihood, TieLikelihood):
            across_place.append(likelihood.across(order[:place]))
        else:
            across_place.append(likelihood)

    joint = joint_likelihood(across_place)
    needed = joint(assignment.event) + LOG_RATIO_NEEDED
    shifted_parts = shifted_assignments(assignment, images, order, place, events_count=events_count)
    return any(joint(event) > needed for event in shifted_parts)


def shifted_assignments(
    assignment: Assignment,
    images: CameraImages,
    order: Integers,
    place: int,
    *,
    events_count: int,
) -> Iterator[Integers]:
    """Assignments (k,) with the images before ``place`` in ``order``, or from it on, shifted.

    They are shifted to both sides by 1, 2 ... events, up to the difference between the counts of
    events and images (at least 2); beyond 12 only by that difference itself. An image that is
    shifted beyond the events has none (-1). A shift by which fewer than half of the shifted images
    have an event is left out.
    """
    event = assignment.event
    offset = int(np.median((event - images.number)[event >= 0]))
    surplus = max(2, abs(events_count - order.size))  # events without images, or the opposite
    sizes = {*range(1, min(surplus, LARGEST_HOLE) + 1), surplus}
    shifts = [sign * size for size in sizes for sign in (-1, 1)]
    for rows, shift in product((order[:place], order[place:]), shifts):
        shifted_event = images.number[rows] + offset + shift
        exists = (shifted_event >= 0) & (shifted_event < events_count)
        if 2 * exists.sum() >= rows.size:
            assignment_shifted = event.copy()
            assignment_shifted[rows] = np.where(exists, shifted_event, -1)
            yield assignment_shifted
