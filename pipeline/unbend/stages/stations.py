"""The stations of a mission: one row for each exposure, matched to the images."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.config import Mission
from unbend.config.event_sources import EventsSection
from unbend.errors import MissionError
from unbend.flight import exposures
from unbend.flight.channels import Channel
from unbend.flight.evidence.contradictions import contradictions_of_import
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.evidence.stretches import Stretch, flag_suspect
from unbend.flight.exposures import Events, events_of_channel, refuse_repeated_images
from unbend.flight.heights import HeightSystem
from unbend.flight.image_names import refuse_other_names, renamed
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations, flag_missing_aircraft_attitude, with_air
from unbend.flight.stations import (
    Stations,
    append_unmatched_images,
    join_stations,
    sigma_notes,
    unusable_station_notes,
)
from unbend.messages import Ledger
from unbend.stages.cabin_air import cabin_from_log
from unbend.stages.exposure_setup import camera_of_rows
from unbend.stages.inputs import FlightLog, read_camera_events
from unbend.stages.multi_image.image_events import assigned_stations
from unbend.stages.multi_image.oriented_stations import oriented_stations
from unbend.stages.multi_image.tie_point_checks import TieEvidence, check_tie_points
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.messages import points_repeated
from unbend.tables.tie_points import MOST_TIE_POINTS, draw_tie_points
from unbend.units import DEGREE


def exposure_events(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog,
    positions: Mapping[str, Channel], observed: tuple[str, ...], *, ledger: Ledger,
) -> list[Events]:  # fmt: skip
    """When each camera was exposed, by images as ``observed``; compared with the log."""
    section, differences = mission.events, mission.observations.match_names
    if section is None:
        return []
    events = events_of_cameras(mission, section, inputs, flight, positions, ledger=ledger)
    for k, one in enumerate(events):
        image = renamed(one.image, observed, differences, f"events, {one.camera}")
        events[k] = replace(one, image=ledger.take(image))
    refuse_repeated_images(events)
    if "position" in flight.roles:
        of_other = mission.stations.trajectory is not None
        key = section.time_key + (", stations.trajectory.time" if of_other else "")
        ledger.extend(exposures.span_notes(events, flight.roles["position"], key))
    return events


def events_of_cameras(
    mission: Mission, section: EventsSection, inputs: OpenedInputs, flight: FlightLog,
    positions: Mapping[str, Channel], *, ledger: Ledger,
) -> list[Events]:  # fmt: skip
    """When each camera was exposed, from the log, a table, or files with positions, by camera."""
    channels = flight.channels
    if section.log is not None:
        events = []
        for camera, source in section.log.items():
            channel = exposures.choose_event_channel(channels, source.channel)
            ledger.extend(exposures.trigger_notes(channels, channel))
            if source.delay_s == "from_feedback":
                lag = ledger.take(exposures.lag_from_feedback(channels, channel, camera))
            else:
                lag = source.delay_s, 0.0
            exposed = events_of_channel(channel, camera, source.image, *lag)
            events.append(ledger.take(exposed))
        return events
    if section.positions is not None:
        return [
            events_of_file(positions[camera], camera, source.image, source.delay_s, ledger)
            for camera, source in section.positions.items()
        ]
    csv = section.csv
    table = inputs.events
    if csv is None or table is None:
        raise MissionError("EVENTS-NONE", "the mission names no events", where="events")
    camera_of = camera_of_rows(mission, table.camera, csv.camera, table.time_ns.size, str(csv.path))
    # The log's UTC places the times of a table.
    utc_sigma_s = 0.0 if flight.log is None else float(np.nan_to_num(flight.log.utc_sigma_s))
    return [
        exposures.events_of_table(
            table.image, camera_of, table.time_ns, camera, csv.delay_s, sigma_s=utc_sigma_s
        )
        for camera in mission.cameras
    ]


def events_of_file(
    channel: Channel, camera: str, image: str, delay_s: float, ledger: Ledger
) -> Events:
    """Exposures of a file with positions, named by it or by a pattern."""
    index = channel["event_index"].astype(np.int64)
    reversed_rows = int(np.count_nonzero(np.diff(exposures.unwrapped_numbers(index)) < 0))
    if image != "{name}":
        events = ledger.take(events_of_channel(channel, camera, image, delay_s))
        if reversed_rows and "{index" in image:
            raise MissionError.of("EVENTS-ORDER", channel.name, reversed_rows=reversed_rows)
        _tell_order(reversed_rows, channel, ledger)
        if channel.source.message == "RTKLIB":
            return replace(events, counts="always")
        whole = np.array_equal(index, np.arange(1, index.size + 1))
        return replace(events, counts="maybe" if whole else "no")
    names = channel.labels.get("name")
    if names is None:
        raise MissionError.of("EVENTS-NAMELESS", channel.name)
    digits = [re.findall(r"\d{1,15}", name) for name in names]
    numbers = np.array([int(found[-1]) if found else 0 for found in digits], np.int64)
    _tell_order(int(np.count_nonzero(np.diff(numbers) < 0)), channel, ledger)
    time_ns = channel.time_ns + round(delay_s * 1e9)
    return Events(camera, np.array(names, dtype=object), time_ns)


def _tell_order(fallen: int, channel: Channel, ledger: Ledger) -> None:
    """A warning where most of a file's numbers fall as time goes on."""
    if 2 * fallen > (total := len(channel)) - 1:
        ledger.warning("EVENTS-ORDER/most", where=channel.name, count=fallen, total=total)


@dataclass(frozen=True, eq=False)
class StationBuilder:
    """Makes stations of one camera at any times; ``offsets`` : a file of ways from the antenna."""

    camera: str
    roles: Mapping[str, Channel]
    mount: Mount
    suspect: tuple[Stretch, ...]
    offsets: Channel | None
    heights: HeightSystem
    accuracy: LogAccuracy
    max_gap_s: float

    @classmethod
    def of(
        cls, mission: Mission, flight: FlightLog, camera: str, positions: Channel | None
    ) -> StationBuilder:
        """That of a camera; a file of ``positions`` at its exposures replaces channels."""
        roles, suspect = flight.roles_of(camera), flight.suspect
        mount, from_events = mount_of(mission, camera)
        if positions is not None and not mission.position_events[camera].times_only:
            roles = roles | {"position": positions, "height": positions}
            if positions.fits_role("attitude"):
                roles, suspect = roles | {"attitude": positions}, ()
            suspect = (
                *(stretch for stretch in suspect if stretch.quantity == "attitude"),
                *contradictions_of_import(
                    positions, ("position", "height"), flight.own, flight.own_suspect
                ),
            )
        if from_events and (positions is None or "offset_down_m" not in positions.columns):
            raise MissionError.of("EVENTS-OFFSETS", "" if positions is None else positions.name)
        return cls(
            camera, roles, mount, suspect, positions if from_events else None, flight.heights,
            flight.accuracy, mission.max_gap_s,
        )  # fmt: skip

    def stations(self, events: Events) -> Stations:
        """The stations of some exposures, suspect or not."""
        stations = build_stations(
            events, self.roles, self.mount, self.heights, self.max_gap_s, accuracy=self.accuracy
        )
        if (file := self.offsets) is None:
            return stations
        # The row of the nearest event: a delay moves all alike, by less than half an interval.
        between = (file.time_ns[:-1] + file.time_ns[1:]) // 2
        row = np.searchsorted(between, stations.time_ns)
        north, east, down = (file[f"offset_{axis}_m"][row] for axis in ("north", "east", "down"))
        return stations.moved(np.stack([east, north, -down], axis=1))

    def later(self, stations: Stations, seconds: float) -> Stations:
        time_ns = stations.time_ns + round(seconds * 1e9)
        return self.stations(Events(self.camera, stations.image, time_ns))


def stations_of_mission(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, terrain: ElevationModel | None, *,
    ledger: Ledger,
) -> Stations:  # fmt: skip
    """Position, attitude and air of each exposure, or a status; checked by tie points."""
    observations = inputs.observations
    observed = observations.images
    positions = read_camera_events(mission, inputs, flight, ledger)
    events = exposure_events(mission, inputs, flight, positions, observed, ledger=ledger)
    builders = [
        StationBuilder.of(mission, flight, e.camera, positions.get(e.camera)) for e in events
    ]
    use_suspect = mission.stations.use_suspect
    parts = [
        ledger.take(flag_suspect(b.stations(e), b.suspect, use_suspect=use_suspect))
        for b, e in zip(builders, events, strict=True)
    ]
    ties = draw_tie_points(observations, MOST_TIE_POINTS)
    if ties.repeated and not observations.is_block:  # those of a block: where it is opened
        count, first = len(ties.repeated), ties.repeated[0]
        ledger.add(points_repeated(where=observations.path.name, count=count, first=first))
    if mission.events is not None:
        parts = assigned_stations(
            mission, mission.events, events, parts, files=inputs.image_times,
            observations=observations, ties=ties, ledger=ledger,
        )  # fmt: skip

    def later(seconds: float) -> Stations:
        of_cameras = zip(builders, parts, strict=True)
        return join_stations([builder.later(part, seconds) for builder, part in of_cameras])

    moves = later if mission.stations.orientation is None else None
    if moves:
        stations = join_stations(parts)
    else:
        oriented = oriented_stations(
            mission, inputs, flight, parts, observations=observations, ties=ties, ledger=ledger
        )
        stations = with_air(oriented, flight.roles, mission.max_gap_s)
    evidence = TieEvidence(mission, flight.heights, stations, ties, terrain, moves)
    check_tie_points(evidence, ledger)
    stations = with_cabins(mission, flight, stations, ledger)
    cameras = sorted(set(stations.camera.tolist()).union(exposed.camera for exposed in events))
    of_camera = {c: stations.image[stations.camera == c].tolist() for c in cameras}
    refuse_other_names(of_camera, observed)
    ledger.extend(exposures.ground_shot_notes(stations, flight.roles, observed))
    stations = ledger.take(append_unmatched_images(stations, observed))
    ledger.extend(unusable_station_notes(stations))
    limits = mission.stations
    tilt = None if limits.max_sigma_tilt_deg is None else limits.max_sigma_tilt_deg * DEGREE
    most = limits.max_sigma_horizontal_m, limits.max_sigma_height_m, tilt
    ledger.extend(sigma_notes(stations, *most))
    return stations


def with_cabins(
    mission: Mission, flight: FlightLog, stations: Stations, ledger: Ledger
) -> Stations:
    """The stations with the air in the cabin, and flagged where a window's direction is unknown."""
    for name, window in mission.windows.items():
        if window.cabin is not None and mission.cameras[name].needs_cabin:
            logged = cabin_from_log(stations, name, window.cabin, flight.channels, flight.roles)
            stations = ledger.take(logged)
        if window.frame == "body":
            stations = ledger.take(flag_missing_aircraft_attitude(stations, name))
    return stations


def mount_of(mission: Mission, camera: str) -> tuple[Mount, bool]:
    """The mount with its lever arm; True where the way to the camera is in the events' file."""
    mount = mission.mounts[camera]
    events = mission.position_events.get(camera)
    trajectory = mission.stations.trajectory
    at_camera = replace(mount, lever_arm_m=(0.0, 0.0, 0.0))
    if events is not None and not events.times_only:
        if events.reference_point == "camera":
            return at_camera, False
        return (at_camera, True) if events.format_name == "mrk" else (mount, False)
    if trajectory is None or not trajectory.moves_stations:
        return mount, False
    if isinstance(trajectory.lever_arm_m, str) or trajectory.point == "camera":
        return at_camera, trajectory.point != "camera"
    forward, right, down = np.add(mount.lever_arm_m, trajectory.lever_arm_m).tolist()
    return replace(mount, lever_arm_m=(forward, right, down)), False
