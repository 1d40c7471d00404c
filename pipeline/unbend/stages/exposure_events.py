"""When each camera was exposed: from the log, a table, or files with positions."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from unbend.config import Mission
from unbend.config.event_sources import EventsSection
from unbend.flight import exposures
from unbend.flight.channels import Channel
from unbend.flight.exposures import (
    Events,
    ExposureDelay,
    events_of_channel,
    refuse_repeated_images,
)
from unbend.flight.image_names import renamed_like_images
from unbend.flight.rotations import CAMERA_AT_REST, in_turned_frame
from unbend.flight.triggers import lag_from_feedback, shutter_finding, trigger_notes
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.stages.flight_log import FlightLog, time_range
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.imports.agreement import compare_with_log
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import EventTable
from unbend.units import Names

Positions = Mapping[str, Channel]
"""The channel of exposures with positions from a file, by camera."""


def read_positions(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> dict[str, Channel]:
    """Read the files of exposures with positions: a channel for each camera that has one.

    Attitudes of the camera in a file are converted to those of the aircraft, by the mount. Refuses
    (STATIONS-ATTITUDE) a file without attitudes, if neither a log nor a trajectory gives them.
    """
    positions = {}
    for camera, source in mission.position_events.items():
        statements = Stated(
            time_system=source.time.system,
            week=source.time.week,
            around_ns=time_range(flight.channels),
            heights=source.heights,
            grid=source.grid,
        )
        channel = inputs.camera_events[camera](statements, ledger)
        where = f"events.positions.{camera}"
        replaced: tuple[str, ...] = ("position", "height")
        gives_attitude = channel.fits_role("attitude") and not source.times_only
        if gives_attitude:
            channel = with_aircraft_attitude(mission, camera, channel)
            replaced += ("attitude",)
        elif mission.log is None and "attitude" not in flight.roles:
            # Without a log the roles are those of a trajectory, if there is one.
            raise messages.stations_without_attitude(where=where)
        places = "" if source.times_only else f", and the positions of the {source.reference_point}"
        ledger.add(
            messages.events_positions(
                where=where, count=len(channel), name=channel.name, camera=camera, places=places
            )
        )
        compare_with_log(channel, flight.logged_roles, flight.heights, ledger, replaces=replaced)
        positions[camera] = channel
    return positions


def with_aircraft_attitude(mission: Mission, camera: str, channel: Channel) -> Channel:
    """A channel of a camera's attitudes, with these converted to the aircraft's by the mount."""
    # The file's attitudes are of a body in which the camera has its default position.
    of_default_body = np.stack([channel[f"q_{axis}"] for axis in "wxyz"], axis=1)
    mount = mission.mounts[camera]
    of_aircraft = in_turned_frame(of_default_body, CAMERA_AT_REST.T @ mount.camera_from_body)
    columns = dict(channel.columns)
    for number, axis in enumerate("wxyz"):
        columns[f"q_{axis}"] = of_aircraft[:, number]
    return replace(channel, columns=columns)


def exposure_events(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    positions: Positions,
    ledger: Ledger,
) -> list[Events]:
    """When each camera was exposed, with the names of images as the observations have them.

    Notes report exposures outside the time of the positions. Refuses images that are exposed twice.
    """
    section = mission.events
    if section is None:
        return []
    observed = inputs.observations.images
    events = []
    for of_camera in events_of_cameras(mission, section, inputs, flight, positions, ledger=ledger):
        image = ledger.take(
            renamed_like_images(
                of_camera.image,
                observed,
                mission.observations.match_names,
                f"events, {of_camera.camera}",
            )
        )
        events.append(replace(of_camera, image=image))
    refuse_repeated_images(events)
    if "position" in flight.roles:
        key = section.time_key
        if mission.stations.trajectory is not None:
            key += ", stations.trajectory.time"
        ledger.extend(exposures.span_notes(events, flight.roles["position"], key))
    return events


def events_of_cameras(
    mission: Mission,
    section: EventsSection,
    inputs: OpenedInputs,
    flight: FlightLog,
    positions: Positions,
    *,
    ledger: Ledger,
) -> list[Events]:
    """When each camera was exposed: one `Events` for each camera that the source names.

    The source is the log, or files with positions, or the table of events. Refuses (EVENTS-NONE) a
    mission without any.
    """
    if section.log is not None:
        return events_of_log(section, flight, ledger)
    if section.positions is not None:
        events = []
        for camera, source in section.positions.items():
            channel = positions[camera]
            events.append(events_of_file(channel, camera, source.image, source.delay_s, ledger))
        return events
    if inputs.events is None:
        raise messages.no_events(where="events", what="events")
    return events_of_table(mission, section, inputs.events)


def events_of_log(section: EventsSection, flight: FlightLog, ledger: Ledger) -> list[Events]:
    """The exposures of each camera in a log, at the logged pulses plus the stated delay.

    The delay may come from the pulses of the camera's feedback (``delay_s: from_feedback``).
    """
    channels = flight.channels
    parameters = {} if flight.log is None else flight.log.parameters
    events = []
    for camera, source in (section.log or {}).items():
        channel = exposures.choose_event_channel(channels, source.channel)
        ledger.extend(trigger_notes(channels, channel, parameters))
        if source.delay_s == "from_feedback":
            delay = ledger.take(lag_from_feedback(channels, channel, camera))
        else:
            delay = ExposureDelay(source.delay_s)
            if source.delay_s == 0.0:
                ledger.extend(shutter_finding(channels, channel, camera))
        exposed = events_of_channel(channel, camera, source.image, delay)
        events.append(ledger.take(exposed))
    return events


def events_of_table(mission: Mission, section: EventsSection, table: EventTable) -> list[Events]:
    """The exposures of a table: one `Events` for each camera of the mission."""
    csv = section.csv
    if csv is None:
        raise messages.no_events(where="events", what="events")
    camera_of_row = camera_of_rows(
        mission, table.camera, csv.camera, table.time_ns.size, where=str(csv.path)
    )
    delay = ExposureDelay(csv.delay_s)
    return [
        exposures.events_of_table(table.image, camera_of_row, table.time_ns, camera, delay)
        for camera in mission.cameras
    ]


def camera_of_rows(
    mission: Mission, column: Names | None, stated_camera: str | None, count: int, *, where: str
) -> Names:
    """(n,) the name of the camera of each of the ``count`` rows of a table.

    It is that in the table's ``column`` of cameras; without one, the camera that the mission file
    states for all rows; without that, the mission's only camera. Refuses (EVENTS-CAMERA) rows of
    a camera that the mission file does not define, and rows of an unstated one of several cameras.
    """
    cameras = list(mission.cameras)
    names = column
    if names is None:
        if stated_camera is None and len(cameras) > 1:
            raise messages.camera_unstated(where=where, cameras=", ".join(cameras))
        names = np.full(count, stated_camera or cameras[0], dtype=object)
    for name in sorted(set(names.tolist()) - set(mission.cameras)):
        raise messages.events_of_unknown_camera(
            where=where, name=str(name), cameras=", ".join(mission.cameras)
        )
    return names


def events_of_file(
    channel: Channel, camera: str, image: str, delay_s: float, ledger: Ledger
) -> Events:
    """Exposures of a file with positions; ``image`` is "{name}" or a pattern of image names.

    "{name}" takes the names from the file. With a pattern ({index}, {n}) `Events.counts` records
    whether event numbers only count the file's rows, so that a lost event would shift them:

    * "always" for RTKLIB: its files have no event numbers;
    * "maybe" if the numbers are 1, 2, 3 ... without a gap, as a program that renumbers writes them;
    * "no" for other numbers.

    Refuses (EVENTS-ORDER) a pattern with {index} if a number is less than the one before.
    """
    if image == "{name}":
        return events_by_names(channel, camera, delay_s, ledger)
    numbers = channel["event_index"].astype(np.int64)
    falling_steps = int(np.count_nonzero(np.diff(exposures.unwrapped_numbers(numbers)) < 0))
    events = ledger.take(events_of_channel(channel, camera, image, ExposureDelay(delay_s)))
    if falling_steps and "{index" in image:
        raise messages.numbers_fall(where=channel.name, count=falling_steps)
    warn_of_order(falling_steps, channel, ledger)
    if channel.source.message == "RTKLIB":
        return replace(events, counts="always")
    count_from_one = np.arange(1, numbers.size + 1)
    if np.array_equal(numbers, count_from_one):
        return replace(events, counts="maybe")
    return replace(events, counts="no")


def events_by_names(channel: Channel, camera: str, delay_s: float, ledger: Ledger) -> Events:
    """Exposures of a file that names their images, ``delay_s`` after the times of the file.

    Refuses (EVENTS-NAMELESS) a file without names.
    """
    names = channel.labels.get("name")
    if names is None:
        raise messages.events_without_names(where=channel.name)
    numbers = np.array([last_number(name) for name in names], dtype=np.int64)
    warn_of_order(int(np.count_nonzero(np.diff(numbers) < 0)), channel, ledger)
    time_ns = channel.time_ns + round(delay_s * 1e9)
    return Events(camera, np.array(names, dtype=object), time_ns)


def last_number(name: str) -> int:
    """The last group of at most 15 digits in an image's name, as a number; 0 without digits.

    >>> last_number("DSC_0042.jpg")
    42
    """
    groups = re.findall(r"\d{1,15}", name)
    return int(groups[-1]) if groups else 0


def warn_of_order(falling_steps: int, channel: Channel, ledger: Ledger) -> None:
    """Warn if most numbers or names of a file decrease with time.

    ``falling_steps`` counts the events with a number below that of the event before.
    """
    total = len(channel)
    steps = total - 1
    if 2 * falling_steps > steps:
        ledger.add(messages.most_numbers_fall(where=channel.name, count=falling_steps, total=total))
