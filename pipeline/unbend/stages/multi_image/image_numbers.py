"""How the numbers in the names of a camera's images count, and which events they name."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from unbend.flight.exposures import Events
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.units import Integers


class Counting(NamedTuple):
    """What the numbers in the names of images count.

    images : the images, with the numbering that the log confirms.
    by_index : whether the numbers are those that the log gives to its events.
    has_names : whether the log gives names to its events, and these are to be used.
    """

    images: CameraImages
    by_index: bool
    has_names: bool

    @property
    def needs_index(self) -> bool:
        """Whether an image claims its event by the log's number, because events have no names."""
        return self.by_index and not self.has_names


def counting_of(events: Events, images: CameraImages, *, has_names: bool) -> Counting:
    """Decide what the numbers in the names of ``images`` count, where they should be the log's.

    They are counted from the first event if the log's numbers are mere row numbers (`is_counted`).
    They count the images themselves (sequence) if its events have neither numbers nor names
    (``has_names``).
    """
    if is_counted(events, images):
        counted = replace(images, numbering="counted")
        return Counting(counted, by_index=False, has_names=False)
    by_index = images.numbering == "index" and events.index is not None
    if images.numbering == "index" and not by_index and not has_names:
        images = replace(images, numbering="sequence")
    return Counting(images, by_index, has_names)


def is_counted(events: Events, images: CameraImages) -> bool:
    """Whether numbers that should be the log's are counted from its first event.

    They are if the log's file has only row numbers. If it may have (`Events.counts`), they are if
    the largest number of an image exceeds the count of events.
    """
    if images.numbering != "index":
        return False
    if events.counts == "always":
        return True
    highest = int(images.number.max())
    return events.counts == "maybe" and highest > events.time_ns.size


def claimed_events(events: Events, images: CameraImages, *, by_index: bool) -> Integers:
    """(k,) row of the event that each image claims by its name; -1 for none.

    ``by_index`` : by the number in its name, as the log numbers its events.
    """
    if by_index and events.index is not None:
        keys_of_events = events.index.tolist()
        keys_of_images = images.number.tolist()
    else:
        keys_of_events = events.image.tolist()
        keys_of_images = images.name.tolist()
    row_of_key = {key: row for row, key in enumerate(keys_of_events) if key != ""}
    rows = [row_of_key.get(key, -1) for key in keys_of_images]
    return np.array(rows, np.int64)
