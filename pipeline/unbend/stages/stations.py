"""The stations of a mission: one row for each exposure, matched to the images."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from unbend.config import Mission
from unbend.flight import exposures
from unbend.flight.channels import Channel
from unbend.flight.evidence.exposure_places import ExposureEvidence, exposure_findings
from unbend.flight.evidence.imported_channels import contradictions_of_import
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.evidence.stretches import Stretch, flag_suspect
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.image_names import refuse_other_names
from unbend.flight.mount import Mount
from unbend.flight.station_builder import (
    ONE_CLOCK,
    ClockSigmas,
    build_stations,
    flag_missing_aircraft_attitude,
    with_air,
    with_logged_aircraft,
)
from unbend.flight.stations import (
    SigmaLimits,
    Stations,
    append_unmatched_images,
    join_stations,
    sigma_notes,
    unusable_station_notes,
)
from unbend.messages import Ledger, Message
from unbend.stages import messages
from unbend.stages.cabin_air import with_logged_cabin
from unbend.stages.exposure_events import exposure_events, read_positions
from unbend.stages.flight_log import FlightLog, flight_log
from unbend.stages.multi_image.image_events import assigned_stations
from unbend.stages.multi_image.oriented_stations import oriented_stations
from unbend.stages.multi_image.other_readings import (
    AngleReading,
    AngleRoad,
    StationsReading,
    intersected,
    refuse_other_reading,
    roads_of_angles,
)
from unbend.stages.multi_image.tie_point_checks import (
    FEWEST_TIE_POINTS,
    TieEvidence,
    check_tie_points,
)
from unbend.stages.observation_units import refuse_other_unit
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.messages import points_repeated
from unbend.tables.observations import Observations
from unbend.tables.tie_points import MOST_TIE_POINTS, TiePoints, draw_tie_points, tie_rays
from unbend.units import DEGREE


@dataclass(frozen=True, eq=False)
class StationBuilder:
    """Builds the stations of one camera at any times.

    roles : the channel of each role for this camera.
    suspect : stretches of time in which these channels are contradicted.
    offsets : a file of exposures that has the vector from the antenna to the camera at each; None
        if the lever arm of ``mount`` is used.
    clocks : how well the clock of the exposures agrees with those of the channels.
    """

    camera: str
    roles: Mapping[str, Channel]
    mount: Mount
    suspect: tuple[Stretch, ...]
    offsets: Channel | None
    heights: HeightSystem
    accuracy: LogAccuracy
    max_gap_s: float
    clocks: ClockSigmas

    @classmethod
    def of(
        cls, mission: Mission, flight: FlightLog, camera: str, positions: Channel | None
    ) -> "StationBuilder":
        """The builder for a camera; ``positions`` is its file of exposures with positions, or None.

        Such a file, unless only its times are used, replaces the channels of position and height,
        and that of the attitude if it has attitudes. Suspect are then:

        * suspect stretches of the log's attitude, unless the file replaces it;
        * stretches in which the log contradicts the position or the height of the file. Attitudes
          of a file are not compared with the log.

        Refuses (EVENTS-OFFSETS) a file without the vectors from antenna to camera, if
        ``lever_arm_m`` is from_events.
        """
        roles = flight.roles_of(camera)
        suspect = flight.suspect
        if positions is not None and not mission.position_events[camera].times_only:
            roles = roles | {"position": positions, "height": positions}
            if positions.fits_role("attitude"):
                roles = roles | {"attitude": positions}
                suspect = ()
            else:
                suspect = tuple(stretch for stretch in suspect if stretch.quantity == "attitude")
            suspect += contradictions_of_import(
                positions, ("position", "height"), flight.logged_roles, flight.logged_suspect
            )
        mount, needs_offsets = mount_of_camera(mission, camera)
        if needs_offsets and (positions is None or "offset_down_m" not in positions.columns):
            name = "" if positions is None else positions.name
            raise messages.events_without_offsets(where=name)
        return cls(
            camera=camera,
            roles=roles,
            mount=mount,
            suspect=suspect,
            offsets=positions if needs_offsets else None,
            heights=flight.heights,
            accuracy=flight.accuracy,
            max_gap_s=mission.max_gap_s,
            clocks=clock_sigmas(mission, flight, camera, roles),
        )

    def stations(self, events: Events) -> Stations:
        """The stations at some exposures; those in suspect stretches are not yet marked."""
        at_events = build_stations(
            events,
            self.roles,
            self.mount,
            self.heights,
            self.max_gap_s,
            accuracy=self.accuracy,
            clocks=self.clocks,
        )
        offsets = self.offsets
        if offsets is None:
            return at_events
        # Each station takes the offset of the event nearest in time: a delay is the same for all
        # exposures, and less than half the time between two.
        between_ns = (offsets.time_ns[:-1] + offsets.time_ns[1:]) // 2
        row = np.searchsorted(between_ns, at_events.time_ns)
        north = offsets["offset_north_m"][row]
        east = offsets["offset_east_m"][row]
        down = offsets["offset_down_m"][row]
        return at_events.moved(np.stack([east, north, -down], axis=1))

    def later(self, stations: Stations, seconds: float) -> Stations:
        """The stations of the same images as if they had been exposed ``seconds`` later."""
        time_ns = stations.time_ns + round(seconds * 1e9)
        return self.stations(Events(self.camera, stations.image, time_ns))


def clock_sigmas(
    mission: Mission, flight: FlightLog, camera: str, roles: Mapping[str, Channel]
) -> ClockSigmas:
    """How well the clock of a camera's exposures agrees with those of the channels in ``roles``.

    The clocks form a chain with a sigma for each step: UTC (of exposures of tables and files, and
    of trajectories), the clock of the log, and a second clock that a log may have (`SecondClock`).
    Between two clocks the sigma is that of all steps between them, on one clock it is 0. The sigma
    of the log's UTC counts as 0 if it is unknown.
    """
    log = flight.log
    if log is None or mission.events is None:
        return ONE_CLOCK
    logged = {channel.name for channel in flight.channels}
    second_clock = log.second_clock
    from_utc_to_log_s = float(np.nan_to_num(log.utc_sigma_s))
    from_log_to_second_s = second_clock.sigma_s if second_clock else 0.0
    sigma_of_steps_s = (from_utc_to_log_s, from_log_to_second_s)

    def clock_of(channel: Channel) -> int:
        """The place in the chain. 0: UTC, 1: the clock of the log, 2: its second clock."""
        if channel.name not in logged:
            return 0
        return 2 if second_clock and channel.name in second_clock.channels else 1

    clock_of_exposures = 0
    if mission.events.log is not None:
        source = mission.events.log[camera]
        event_channel = exposures.choose_event_channel(flight.channels, source.channel)
        clock_of_exposures = clock_of(event_channel)

    def sigma_s(role: str) -> float:
        if role not in roles:
            return 0.0
        first, last = sorted((clock_of_exposures, clock_of(roles[role])))
        return math.hypot(*sigma_of_steps_s[first:last])

    return ClockSigmas(sigma_s("position"), sigma_s("height"), sigma_s("attitude"))


def mount_of_camera(mission: Mission, camera: str) -> tuple[Mount, bool]:
    """The mount of a camera with the lever arm from the point that the positions are of.

    The second value is True if the stations need the vector from antenna to camera at each
    exposure, which a file of events has; the mount then has the lever arm 0.
    """
    mount = mission.mounts[camera]
    without_arm = replace(mount, lever_arm_m=(0.0, 0.0, 0.0))
    events = mission.position_events.get(camera)
    if events is not None and not events.times_only:
        if events.reference_point == "camera":
            return without_arm, False
        if events.format_name == "mrk":
            return without_arm, True
        return mount, False
    trajectory = mission.stations.trajectory
    if trajectory is None or not trajectory.moves_stations:
        return mount, False
    if trajectory.point == "camera":
        return without_arm, False
    if isinstance(trajectory.lever_arm_m, str):  # "from_events"
        return without_arm, True
    forward, right, down = np.add(mount.lever_arm_m, trajectory.lever_arm_m).tolist()
    return replace(mount, lever_arm_m=(forward, right, down)), False


def stations_of_mission(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    terrain: ElevationModel | None,
    ledger: Ledger,
) -> Stations:
    """Position, attitude and air of each exposure, checked by tie points; a row for each exposure.

    Exposures that cannot be used have a status other than ok. Observed images without an exposure
    are appended, with a status. ``terrain`` is for the checks.
    """
    observations = inputs.observations
    refuse_other_unit(mission, observations)

    # Stations at the exposures of each camera.
    positions = read_positions(mission, inputs, flight, ledger)
    events = exposure_events(mission, inputs, flight, positions, ledger)
    builders = []
    at_events = []
    for camera_events in events:
        camera = camera_events.camera
        builder = StationBuilder.of(mission, flight, camera, positions.get(camera))
        stations = builder.stations(camera_events)
        ledger.extend(findings_of_exposures(mission, flight, builder, camera_events))
        flagged = flag_suspect(stations, builder.suspect, use_suspect=mission.stations.use_suspect)
        builders.append(builder)
        at_events.append(ledger.take(flagged))

    # The exposures that have an image, camera by camera.
    ties = draw_tie_points(observations, MOST_TIE_POINTS)
    report_repeated_points(observations, ties, ledger)
    exposed = at_events
    if mission.events is not None:
        exposed = assigned_stations(
            mission,
            mission.events,
            events,
            at_events,
            files=inputs.image_times,
            observations=observations,
            ties=ties,
            ledger=ledger,
        )

    # The stations are those of the events, or those of the stated orientations.
    if mission.stations.orientation is None:
        stations = join_stations(exposed)
        refuse_other_readings_of_imports(
            mission, inputs, positions, exposed=exposed, stations=stations, ties=ties
        )
    else:
        oriented = oriented_stations(mission, inputs, flight, exposed, ties=ties, ledger=ledger)
        stations = with_air(oriented, flight.roles, mission.max_gap_s)
        stations = with_logged_aircraft(stations, flight.roles, mission.max_gap_s)

    def later(seconds: float) -> Stations:
        """The stations as if all exposures had been ``seconds`` later."""
        moved = []
        for builder, camera_stations in zip(builders, exposed, strict=True):
            moved.append(builder.later(camera_stations, seconds))
        return join_stations(moved)

    evidence = TieEvidence(
        mission=mission,
        heights=flight.heights,
        stations=stations,
        ties=ties,
        terrain=terrain,
        later=later if mission.stations.orientation is None else None,
    )
    check_tie_points(evidence, ledger)
    stations = with_cabins(mission, flight, stations, ledger)
    stations = replace(stations, from_boot=flight.counts_from_boot(stations.time_ns))
    cameras = {camera_events.camera for camera_events in events}
    return matched_stations(mission, flight, stations, cameras, observations.images, ledger=ledger)


def findings_of_exposures(
    mission: Mission, flight: FlightLog, builder: StationBuilder, events: Events
) -> Iterator[Message]:
    """Findings if positions that the log has of exposures differ from those of the stations.

    Only for events of a log.
    """
    if mission.events is None or mission.events.log is None:
        return
    source = mission.events.log[builder.camera]
    # The log's positions may be of its antenna or of the camera, and differ from the stations by
    # one of two lever arms: the mission file's, or the one that the stations are built with. The
    # longer one is allowed for.
    arms_m = [mission.mounts[builder.camera].lever_arm_m, builder.mount.lever_arm_m]
    yield from exposure_findings(
        ExposureEvidence(
            channel=exposures.choose_event_channel(flight.channels, source.channel),
            time_ns=events.time_ns,
            roles=builder.roles,
            log_roles=flight.logged_roles,
            accuracy=flight.accuracy,
            suspect=(*builder.suspect, *flight.logged_suspect),
            lever_arm_m=max(float(np.linalg.norm(arm)) for arm in arms_m),
            max_gap_s=mission.max_gap_s,
        )
    )


def refuse_other_readings_of_imports(
    mission: Mission,
    inputs: OpenedInputs,
    positions: Mapping[str, Channel],
    *,
    exposed: list[Stations],
    stations: Stations,
    ties: TiePoints,
) -> None:
    """Refuse (ORIENTATION-READING) imported angles if another reading fits tie points far better.

    Other readings are, for instance, another unit or order of the angles. ``exposed`` are the
    stations camera by camera, ``stations`` the same in one table.
    """
    roads = list(roads_of_angles(mission, inputs, positions))
    if not roads:
        return
    rays = tie_rays(ties, stations.image, stations.camera, mission.interior_orientations)
    if np.unique(rays.point).size < FEWEST_TIE_POINTS:
        return

    def read_anew(road: AngleRoad, reading: AngleReading) -> Stations:
        """The same stations, from the file of ``road`` with its angles read in another way."""
        changed_inputs = road.inputs_as(reading.change)
        changed_flight = flight_log(mission, changed_inputs, Ledger())
        changed_positions = read_positions(mission, changed_inputs, changed_flight, Ledger())
        parts = []
        for of_camera in exposed:
            if len(of_camera) == 0:
                continue
            camera = str(of_camera.camera[0])
            builder = StationBuilder.of(
                mission, changed_flight, camera, changed_positions.get(camera)
            )
            parts.append(builder.later(of_camera, seconds=0.0))
        return join_stations(parts)

    as_stated = intersected(stations, rays)
    for road in roads:
        readings = [
            StationsReading(
                reading.words, f"{road.key}: {reading.key}", partial(read_anew, road, reading)
            )
            for reading in road.readings
        ]
        refuse_other_reading(as_stated, readings, rays, where=road.path)


def report_repeated_points(observations: Observations, ties: TiePoints, ledger: Ledger) -> None:
    """Add a loss if points are observed twice in an image; for blocks this is done on opening."""
    if ties.repeated and not observations.is_block:
        ledger.add(
            points_repeated(
                where=observations.path.name, count=len(ties.repeated), first=ties.repeated[0]
            )
        )


def matched_stations(
    mission: Mission,
    flight: FlightLog,
    stations: Stations,
    cameras: set[str],
    observed: tuple[str, ...],
    *,
    ledger: Ledger,
) -> Stations:
    """The stations, and after them a row for each observed image without an exposure.

    Adds notes on images and stations that do not match, and on large sigmas. ``cameras`` are those
    with exposures, also if none of these became a station; ``observed`` are the observed images.
    """
    names = sorted({*stations.camera.tolist(), *cameras})
    images = {name: stations.image[stations.camera == name].tolist() for name in names}
    refuse_other_names(images, observed)
    ledger.extend(exposures.ground_shot_notes(stations, flight.roles, observed, flight.ground))
    where = "events" if mission.stations.orientation is None else "stations.orientation"
    stations = ledger.take(append_unmatched_images(stations, observed, where=where))
    ledger.extend(unusable_station_notes(stations))
    section = mission.stations
    tilt_deg = section.max_sigma_tilt_deg
    limits = SigmaLimits(
        horizontal_m=section.max_sigma_horizontal_m,
        height_m=section.max_sigma_height_m,
        tilt_rad=None if tilt_deg is None else tilt_deg * DEGREE,
    )
    ledger.extend(sigma_notes(stations, limits))
    return stations


def with_cabins(
    mission: Mission, flight: FlightLog, stations: Stations, ledger: Ledger
) -> Stations:
    """The stations with logged air of the cabins, marked if a window's direction is unknown.

    The direction is unknown without the attitude of the aircraft, if the window is fixed to it.
    """
    for name, window in mission.windows.items():
        if window.cabin is not None and mission.cameras[name].needs_cabin:
            logged = with_logged_cabin(stations, name, window.cabin, flight.channels, flight.roles)
            stations = ledger.take(logged)
        if window.frame == "body":
            stations = ledger.take(flag_missing_aircraft_attitude(stations, name))
    return stations
