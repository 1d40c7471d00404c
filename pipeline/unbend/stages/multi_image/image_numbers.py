"""How the numbers in the names of a camera's images count, and which events they name."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from unbend.flight.exposures import Events
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.units import Integers


class Counting(NamedTuple):
    """How the numbers in the names of images count.

    images : with the numbering that holds.
    by_index : whether the numbers are those that the log gives to its events.
    has_names : whether the names that the log gives to its events hold.
    """

    images: CameraImages
    by_index: bool
    has_names: bool

    @property
    def needs_index(self) -> bool:
        """Whether the log's numbers alone say which event belongs to a name."""
        return self.by_index and not self.has_names


def counting_of(exposed: Events, images: CameraImages, *, has_names: bool) -> Counting:
    """How numbers count; without the log's numbers they hold only beside names (``has_names``)."""
    if is_counted(exposed, images):
        counted = replace(images, numbering="counted")
        return Counting(counted, by_index=False, has_names=False)
    by_index = images.numbering == "index" and exposed.index is not None
    if images.numbering == "index" and not by_index and not has_names:
        images = replace(images, numbering="sequence")
    return Counting(images, by_index, has_names)


def is_counted(exposed: Events, images: CameraImages) -> bool:
    """Whether numbers that are said to be the log's are counted from its first event."""
    if images.numbering != "index":
        return False
    if exposed.counts == "always":
        return True
    highest = int(images.number.max())
    return exposed.counts == "maybe" and highest > exposed.time_ns.size


def events_by_name(exposed: Events, images: CameraImages, *, by_index: bool) -> Integers:
    """(k,) rows of the events that have the images' names, or numbers; -1 for none."""
    if by_index and exposed.index is not None:
        keys = exposed.index.tolist()
        wanted = images.number.tolist()
    else:
        keys = exposed.image.tolist()
        wanted = images.name.tolist()
    row_of = {key: row for row, key in enumerate(keys) if key != ""}
    rows = [row_of.get(key, -1) for key in wanted]
    return np.array(rows, np.int64)
