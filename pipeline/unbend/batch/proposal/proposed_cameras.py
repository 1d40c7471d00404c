"""The cameras of a proposed mission file: their names, and the channels that fire them."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from unbend.batch.proposal.values import Proposed, yaml_text
from unbend.config.yaml_text import TODO
from unbend.flight.channels import Channel
from unbend.flight.image_names import NameSeries, name_series

MOST_CAMERAS = 12  # more series of names than this are not those of different cameras

EventNumbers = Mapping[str, list[int]]
"""The log's own numbers of the events of each channel, by its name."""


@dataclass(frozen=True)
class ProposedCamera:
    """A camera with the keys of its exposures, which are None if the log has no exposures.

    ``block`` is the camera's name in a block; "" without a block.
    """

    name: str
    channel: Proposed | None = None
    image: Proposed | None = None
    block: str = ""


@dataclass(frozen=True)
class Numbering:
    """How the numbers in the names of images are related to the events of channels.

    ``field`` is the field of a name pattern: ``index`` for the log's own numbers, ``n`` for
    numbers counted from 1, ``*`` for neither. ``channels`` are those whose events have the numbers
    of the images; none for ``*``.
    """

    field: str
    channels: tuple[str, ...] = ()

    def image_numbers(self, log_numbers: list[int]) -> Collection[int]:
        """The numbers in the names of the images of a channel's events.

        ``log_numbers`` are the log's own numbers of these events.
        """
        return range(1, len(log_numbers) + 1) if self.field == "n" else log_numbers


def proposed_cameras(
    channels: Sequence[Channel], images: tuple[str, ...], block_cameras: tuple[str, ...] = ()
) -> list[ProposedCamera]:
    """The cameras of a mission, each with the channel of its events.

    ``images`` are names of images. There is one camera for each series of image names; without
    series one for each of ``block_cameras``, the cameras of a block; without these one for each of
    ``channels``, those of exposures in the log; else one.
    """
    all_series = series_of_cameras(images, block_cameras, len(channels))
    count = len(all_series) or len(block_cameras) or len(channels) or 1
    names = names_of_cameras([series.camera for series in all_series] or [""] * count)
    event_numbers = {c.name: c["event_index"].astype(int).tolist() for c in channels}
    cameras = []
    for number, name in enumerate(names):
        channel = image = None
        if channels and all_series:
            channel = channel_of_series(number, all_series, event_numbers)
            image = image_of_series(all_series[number], event_numbers)
        elif channels:
            channel = channel_of_camera(number, count, event_numbers)
            remark = (
                "names of its images; {index} is the number in the log, as in IMG_{index:04d}.JPG"
            )
            image = Proposed("image", TODO, remark)
        block = block_cameras[number] if block_cameras else ""
        cameras.append(ProposedCamera(name, channel, image, block))
    return cameras


def series_of_cameras(
    images: tuple[str, ...], block_cameras: tuple[str, ...], channel_count: int
) -> list[NameSeries]:
    """A series of image names for each camera; [] if a block has another number of cameras."""
    all_series = name_series(images)
    if len(all_series) > max(MOST_CAMERAS, channel_count):
        # The series are not those of cameras: all images are assigned to one camera.
        all_series = [NameSeries("", 0, "", (0,), has_number=False)]
    if block_cameras and len(block_cameras) != len(all_series):
        return []
    return all_series


def names_of_cameras(words: list[str]) -> list[str]:
    """A different name for each camera: its word, or ``camera`` with its number for "".

    >>> names_of_cameras([""]), names_of_cameras(["nadir", "", "nadir"])
    (['camera'], ['nadir', 'camera_2', 'nadir_3'])
    """
    names: list[str] = []
    for number, word in enumerate(words, start=1):
        name = word or ("camera" if len(words) == 1 else f"camera_{number}")
        names.append(f"{name}_{number}" if name in names else name)
    return names


def numbering_of(series: NameSeries, event_numbers: EventNumbers) -> Numbering:
    """How the numbers of a series of names are related to the events of a log.

    The first relation is returned that is true for a channel: (1) the images have the log's own
    numbers, from the first to the last; (2) they have the numbers of the events counted from 1, up
    to the last; (3) all images except a few have the log's own numbers.
    """
    by_index = [name for name, numbers in event_numbers.items() if series.counts_as(numbers)]
    if by_index:
        return Numbering("index", tuple(by_index))
    counted = []
    nearly = []
    for name, numbers in event_numbers.items():
        if series.counts_as(range(1, len(numbers) + 1)):
            counted.append(name)
        if series.strays(numbers):  # the few numbers that do not fit; empty if many do not
            nearly.append(name)
    if counted:
        return Numbering("n", tuple(counted))
    if nearly:
        return Numbering("index", tuple(nearly))
    return Numbering("*")


def channel_of_camera(number: int, count: int, event_numbers: EventNumbers) -> Proposed:
    """The channel of a camera, if the names of its images are unknown.

    ``number`` is the index of the camera, from 0. If there are as many channels as cameras
    (``count``), the channel is guessed by their order; otherwise the value is left open.
    """
    channels = list(event_numbers)
    if count != len(channels):
        return open_channel(channels, event_numbers)
    remark = ""
    if count > 1:
        remark = (
            "guessed: one camera for each channel; give it the name of the camera that the channel "
            "triggers"
        )
    return Proposed("channel", yaml_text(channels[number]), remark)


def channel_of_series(
    number: int, all_series: list[NameSeries], event_numbers: EventNumbers
) -> Proposed:
    """The channel that triggers the camera of a series of names; left open if it is not certain.

    ``number`` is the index of the series in ``all_series``, from 0. A channel is certain if it
    alone fits the series, and the names of no other camera fit it. The only channel of a log with
    the only series is certain even if it does not fit.
    """
    channels = list(event_numbers)
    numbering = numbering_of(all_series[number], event_numbers)
    fits = numbering.channels
    other_series = all_series[:number] + all_series[number + 1 :]
    has_rivals = False
    for channel in fits:
        image_numbers = numbering.image_numbers(event_numbers[channel])
        for series in other_series:
            if series.counts_as(image_numbers) or series.strays(image_numbers):
                has_rivals = True
    if len(fits) == 1 and not has_rivals:
        return Proposed("channel", yaml_text(fits[0]))
    if len(channels) == len(all_series) == 1:
        return Proposed("channel", yaml_text(channels[0]))
    return open_channel(fits or channels, event_numbers)


def open_channel(channels: Sequence[str], event_numbers: EventNumbers) -> Proposed:
    """The key ``channel`` with its value left open; its remark lists ``channels``."""
    choices = [f"{channel} ({len(event_numbers[channel])} events)" for channel in channels]
    return Proposed("channel", TODO, f"{' or '.join(choices)}: which of them triggers this camera")


def image_of_series(series: NameSeries, event_numbers: EventNumbers) -> Proposed:
    """The pattern of the names of a series, with a remark on why it is guessed."""
    numbering = numbering_of(series, event_numbers)
    if numbering.channels:
        strays = series.strays(event_numbers[numbering.channels[0]])
        fitting = [number for number in series.numbers if number not in strays]
        count = f"{len(fitting)} images count as the log does"
        remark = f"guessed: {count}, {fitting[0]} to {fitting[-1]}"
        if strays:
            remark += f"; not {series.listed(strays)}"
    else:
        remark = f"numbers and tie points assign {len(series.numbers)} images"
        log_numbers = set().union(*event_numbers.values())
        if series.has_number and not log_numbers.isdisjoint(series.numbers):
            remark += f"; or {series.pattern('index')}, if these are the log's numbers"
    pattern = json.dumps(series.pattern(numbering.field), ensure_ascii=False)
    return Proposed("image", pattern, remark)
