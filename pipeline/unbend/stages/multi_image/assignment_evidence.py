"""What events, images and the mission file give `assign` to decide by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unbend.block.image_evidence import CameraEvents, ImageEvidence
from unbend.config.event_sources import FirstImage
from unbend.flight.exposures import Events
from unbend.flight.stations import NO_TIME
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.tables.imports.exif import ImageTimes


def camera_events(events: Events) -> CameraEvents:
    """The events of a camera, with their times from the first event on [s]."""
    return CameraEvents((events.time_ns - events.time_ns[0]) / 1e9, events.index)


def anchor_rows(
    anchor: FirstImage | None, images: CameraImages, events: Events
) -> tuple[int, int] | None:
    """Rows of the image and of the event that the mission file states as a pair; None without one.

    Refuses (EVENTS-FIRST-IMAGE) an image or event that does not exist.
    """
    if anchor is None:
        return None
    row = np.flatnonzero(images.name == anchor.image)
    count = events.time_ns.size
    if row.size == 0 or anchor.event > count:
        raise messages.first_image_missing(
            where=f"events.first_image.{events.camera}",
            image=anchor.image,
            event=anchor.event,
            events=count,
            first=str(images.name[0]),
        )
    return int(row[0]), anchor.event - 1  # the mission file counts events from 1


def evidence_of_images(
    events: Events, images: CameraImages, files: ImageTimes | None
) -> ImageEvidence:
    """Numbers of the images; and their times [s] from the first event on, if the files have any."""
    evidence = ImageEvidence(
        images.name.size,
        number=images.number,
        numbering=images.numbering,
        total=-1 if events.lost else None,  # where pulses were lost, equal counts mean nothing
    )
    if files is None:
        return evidence
    # The last element is for an image without a file, whose row is -1.
    time_ns = np.append(files.time_ns, NO_TIME)[images.file]
    has_time = time_ns != NO_TIME
    if not bool(has_time.any()):
        return evidence
    begin_ns = events.time_ns[0]
    seconds = (np.where(has_time, time_ns, begin_ns) - begin_ns) / 1e9
    return replace(
        evidence,
        time_s=np.where(has_time, seconds, np.nan),
        sigma_s=np.append(files.sigma_s, np.nan)[images.file],
        clock_sigma_s=files.clock_sigma_s,
    )
