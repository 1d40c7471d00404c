"""Whether an event or an image is missing in between, so that a part of the images is shifted."""

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
PLACES_OF_HOLES = 20  # that are looked at


def hole_between(
    assignment: Assignment,
    images: CameraImages,
    exposed: Events,
    likelihoods: Mapping[str, Likelihood],
) -> str:
    """What shows that an event or an image is missing in between, in words; empty if nothing.

    After a missing event or image all images up to the end would belong to other events than
    assigned. In this order:

    * Where the times of the images took part in the assignment, nothing is missing unnoticed.
    * Unless the user stated the event of an image: something is missing if there are fewer events
      than images (or than images are counted), or if the log lost events and none of
      ``likelihoods`` could show where.
    * Something is missing where the likelihoods speak for it (`is_shifted`).
    """
    if "times" in assignment.evidence:
        return ""
    images_count = images.name.size
    events_count = exposed.time_ns.size
    counted = images.numbering == "counted"
    events_needed = int(images.number.max()) if counted else images_count
    lost_somewhere = exposed.lost > 0 and not likelihoods
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
    order = np.argsort(images.number, kind="stable")  # of the images, by their numbers
    for place in places_of_holes(assignment, order, likelihoods):
        if is_shifted(
            assignment, images, order, place, events_count=events_count, likelihoods=likelihoods
        ):
            return f"one is missing near {images.name[order[place]]}"
    return ""


def places_of_holes(
    assignment: Assignment, order: Integers, likelihoods: Mapping[str, Likelihood]
) -> list[int]:
    """Places in the ``order`` of the images before which an event or an image may be missing.

    With tie points they are those before and after each image that does not fit the others; without
    tie points they are evenly spaced. At most 20.
    """
    ties = likelihoods.get(TIES)
    if isinstance(ties, TieLikelihood):
        contradicted = np.flatnonzero(np.isin(order, ties.contradicted(assignment.event)))
        places = np.concatenate([contradicted, contradicted + 1])
        if places.size:
            places = evenly_spaced_of(places, PLACES_OF_HOLES)
    else:
        places = np.linspace(1, order.size - 1, PLACES_OF_HOLES).astype(int)
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
    """Whether images before a place in their order, or from it on, fit far better shifted.

    They do if one of the `shifted_assignments` is 1000 times as likely as the assignment. Only tie
    points that images on both sides of the place show count, because they alone feel the shift.
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
    """Assignments (k,) with the images before a place in their order, or from it on, shifted.

    The shifts, to both sides, are by 1 event up to the difference of the numbers of events and
    images, which counts as 2 at least; of shifts beyond 12 only that difference itself is tried. An
    image that would be shifted beyond the events has none (-1). A shift that leaves fewer than half
    of the shifted images an event is left out.
    """
    event = assignment.event
    offset = int(np.median((event - images.number)[event >= 0]))
    surplus = max(2, abs(events_count - order.size))  # of events or of images
    sizes = {*range(1, min(surplus, LARGEST_HOLE) + 1), surplus}
    shifts = [sign * size for size in sizes for sign in (-1, 1)]
    for rows, shift in product((order[:place], order[place:]), shifts):
        moved = images.number[rows] + offset + shift
        is_event = (moved >= 0) & (moved < events_count)
        if 2 * is_event.sum() >= rows.size:
            shifted = event.copy()
            shifted[rows] = np.where(is_event, moved, -1)
            yield shifted
