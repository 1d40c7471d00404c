"""The inputs of a mission: the table of observations, and the flight log with its channels."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from unbend.config import Mission
from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.evidence.contradictions import contradictions_of_import, examine
from unbend.flight.evidence.log_accuracy import LogAccuracy, with_accuracy
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem, height_system, to_geodetic
from unbend.flight.mount import gimbal_notes, is_of_gimbal, with_payload_attitude
from unbend.flight.roles import assign_roles
from unbend.flight.rotations import CAMERA_AT_REST, in_turned_frame
from unbend.ingest import Log
from unbend.ingest.field_maps import in_stated_unit
from unbend.messages import Ledger
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.imports.agreement import compare_with_log
from unbend.tables.imports.stated import Stated
from unbend.units import Array, Integers

Track = tuple[Integers, Array, Array]
"""Times [Unix ns], latitudes and longitudes [rad] of a flight."""


@dataclass(frozen=True, eq=False)
class FlightLog:
    """A log after its channels were given their roles; these hold plausible values only.

    ``suspect`` are stretches in which the log contradicts itself; ``own`` are the roles as it fills
    them, with ``own_suspect``; in ``roles`` a trajectory has replaced some. ``log`` is None where
    stations come from elsewhere; ``heads`` are attitudes of cameras with one of their own.
    """

    log: Log | None
    channels: tuple[Channel, ...]
    roles: dict[str, Channel]
    own: dict[str, Channel]
    heights: HeightSystem
    suspect: tuple[Stretch, ...] = ()
    own_suspect: tuple[Stretch, ...] = ()
    accuracy: LogAccuracy = field(default_factory=LogAccuracy)
    heads: Mapping[str, Channel] = field(default_factory=dict)

    def roles_of(self, camera: str) -> dict[str, Channel]:
        """The roles for one camera; beside its own head the attitude is that of the aircraft."""
        if camera not in self.heads:
            return self.roles
        aircraft = self.roles.get("attitude")
        fixed = aircraft is not None and not is_of_gimbal(aircraft.source.message)
        own = {"aircraft_attitude": aircraft} if aircraft is not None and fixed else {}
        return own | self.roles | {"attitude": self.heads[camera]}

    @property
    def track(self) -> Track | None:
        """Where the aircraft was, None where no position is known."""
        if (position := self.roles.get("position")) is None:
            return None
        return position.time_ns, position["lat_rad"], position["lon_rad"]

    @property
    def air_roles(self) -> dict[str, Channel]:
        """Roles for the air, at the log's own heights: a trajectory may lack climb and descent."""
        return self.roles | self.own


def flight_log(mission: Mission, inputs: OpenedInputs, ledger: Ledger) -> FlightLog:
    """Assign the channels of a log to roles, and relate its heights to sea level.

    Without a log a trajectory has all the roles; refuses (STATIONS-ATTITUDE) one without attitudes.
    """
    geoid = inputs.geoid or package_geoid()
    home, undulation_m = mission.ground.home_h_msl_m, mission.mission.undulation_m
    section = mission.stations.trajectory
    log, names = inputs.log, dict[str, str]()
    channels: tuple[Channel, ...] = ()
    heads = {camera: m.attitude for camera, m in mission.mount.items() if m.attitude is not None}
    if mission.log is not None and log is not None:
        names = {role: stated.name for role, stated in mission.log.channels.named().items()}
        channels = stated_channels(mission, log.channels)
        for attitude in dict.fromkeys([names.get("attitude", ""), *heads.values()]):
            of_one, gap_s = names | {"attitude": attitude}, mission.log.max_gap_s
            channels = ledger.take(with_payload_attitude(channels, of_one, gap_s))
    elif section is None:
        heights, _ = height_system({}, undulation_m, geoid, stated_home_m=home)
        return FlightLog(None, (), {}, {}, heights)
    needs_cabin = any(camera.needs_cabin_from_log for camera in mission.cameras.values())
    trajectory = read_trajectory(mission, inputs, channels, ledger)
    elsewhere = () if trajectory is None else replaced_roles(mission, trajectory)
    if log is None and "attitude" not in elsewhere:
        raise MissionError.of("STATIONS-ATTITUDE", "stations.trajectory")
    missed = elsewhere if log is not None else ("position", "attitude")
    roles = ledger.take(assign_roles(channels, names, needs_cabin=needs_cabin, elsewhere=missed))
    plausible = {
        role: ledger.take(plausible_samples(channel, role)) for role, channel in roles.items()
    }
    mounts = dict(mission.mounts)
    able = {channel.name: channel for channel in channels if channel.fits_role("attitude")}
    of_head: dict[str, Channel] = {}
    for camera, name in heads.items():
        if name not in able:
            where, there = f"mount.{camera}.attitude", ", ".join(able) or "none"
            raise MissionError.of("CHANNEL-MISSING/attitude", where, name=name, there=there)
        of_head[camera] = ledger.take(plausible_samples(able[name], "attitude"))
        ledger.extend(gimbal_notes({}, {"attitude": of_head[camera]}, {camera: mounts.pop(camera)}))
    if log is not None:
        ledger.extend(gimbal_notes({} if heads else log.messages, plausible, mounts))
    heights = ledger.take(height_system(plausible, undulation_m, geoid, stated_home_m=home))
    own, own_suspect, notes = examine(channels, plausible)
    plausible = dict(own)
    of_trajectory: tuple[Stretch, ...] = ()
    ledger.extend(notes)
    if trajectory is not None:
        of_trajectory = contradictions_of_import(trajectory, elsewhere, own, own_suspect)
        order = "ZYX" if section is None else section.angle_order
        compare_with_log(trajectory, own, heights, ledger, replaces=elsewhere, angle_order=order)
        for role in elsewhere:
            plausible[role] = ledger.take(plausible_samples(trajectory, role))
        plausible.setdefault("height", plausible["position"]) if "position" in plausible else None
        former = ", ".join(f"{role} of {own[role].name}" for role in elsewhere if role in own)
        what = f"{trajectory.name} gives {', '.join(elsewhere)}, "
        what += f"in place of {former}" if former else "which the log has not"
        ledger.note("TRAJECTORY-REPLACES", what, where="stations.trajectory")
    suspect = (*(d for d in own_suspect if d.quantity not in elsewhere), *of_trajectory)
    plausible, accuracy = with_accuracy(plausible, channels)
    return FlightLog(
        log, channels, plausible, own, heights, suspect, own_suspect, accuracy, of_head
    )


def stated_channels(mission: Mission, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """The channels of the log on the earth, in the units and for the boards that are stated."""
    section = mission.log
    if section is None:
        return channels
    if section.local_origin is not None:
        origin = section.local_origin.build()
        channels = tuple(to_geodetic(channel, origin) for channel in channels)
    of_air = {"cabin_temperature"}
    of_air |= {"temperature"} if mission.atmosphere.board_temperature else set()
    named = section.channels.named()
    of_boards = {named[role].name for role in of_air & named.keys()}
    channels = tuple(board_as_air(c) if c.name in of_boards else c for c in channels)
    for role, stated in named.items():
        if (unit := stated.unit) is not None:
            name = stated.name
            channels = tuple(
                in_stated_unit(c, role, unit) if c.name == name else c for c in channels
            )
    return channels


def read_trajectory(
    mission: Mission, inputs: OpenedInputs, channels: tuple[Channel, ...], ledger: Ledger
) -> Channel | None:
    """The trajectory of a mission as a channel; None where it names none."""
    section = mission.stations.trajectory
    if section is None or inputs.trajectory is None:
        return None
    stated = Stated(
        time_system=section.time.system,
        week=section.time.week,
        around_ns=_time_range(channels),
        heights=section.heights,
        columns={} if section.columns is None else section.columns.named,
        position_unit=section.position_unit,
        angle_unit=section.angle_unit,
        angle_order=section.angle_order,
        crs=section.crs,
        geoid=inputs.geoid,
    )
    return inputs.trajectory(stated, ledger)


def replaced_roles(mission: Mission, trajectory: Channel) -> tuple[str, ...]:
    """The roles that a trajectory plays; refuses one that lacks what is to be replaced."""
    section = mission.stations.trajectory
    able = [role for role in ("position", "height", "attitude") if trajectory.fits_role(role)]
    if section is None or section.replaces is None:
        return tuple(able)
    for role in section.replaces:
        if role not in able:
            columns, there = ", ".join(ROLE_COLUMNS[role]), ", ".join(able)
            raise MissionError.of(
                "TRAJECTORY-REPLACES", trajectory.name, role=role, columns=columns, able=there
            )
    return tuple(section.replaces)


def read_camera_events(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> dict[str, Channel]:
    """The exposures of each camera that come from a file with their positions.

    Attitudes of cameras become those of the aircraft, by the mount. Refuses (STATIONS-ATTITUDE) a
    file without, where there is no log and no trajectory.
    """
    events = {}
    for camera, source in mission.position_events.items():
        time, around = source.time, _time_range(flight.channels)
        stated = Stated(time.system, time.week, around, source.heights, grid=source.grid)
        channel = inputs.camera_events[camera](stated, ledger)
        attitude = channel.fits_role("attitude") and not source.times_only
        if attitude:
            at_rest = np.stack([channel[f"q_{axis}"] for axis in "wxyz"], axis=1)
            mount = mission.mounts[camera]
            of_body = in_turned_frame(at_rest, CAMERA_AT_REST.T @ mount.camera_from_body)
            columns = {f"q_{axis}": of_body[:, k] for k, axis in enumerate("wxyz")}
            channel = replace(channel, columns=dict(channel.columns) | columns)
        elif "attitude" not in flight.roles and mission.log is None:
            raise MissionError.of("STATIONS-ATTITUDE", f"events.positions.{camera}")
        events[camera] = channel
        places = "" if source.times_only else f", and where the {source.reference_point} was then"
        what = f"{channel.name} says when {camera} was exposed{places}"
        where = f"events.positions.{camera}"
        ledger.note("EVENTS-POSITIONS", what, where=where, count=len(channel))
        replaces = ("position", "height", *(["attitude"] if attitude else []))
        compare_with_log(channel, flight.own, flight.heights, ledger, replaces=replaces)
    return events


def _time_range(channels: tuple[Channel, ...]) -> tuple[int, int] | None:
    """First and last time of the positions of a log, or of all that it has [Unix ns]."""
    filled = [channel for channel in channels if len(channel)]
    placed = [channel for channel in filled if channel.fits_role("position")] or filled
    if not placed:
        return None
    return min(int(c.time_ns[0]) for c in placed), max(int(c.time_ns[-1]) for c in placed)


def board_as_air(channel: Channel) -> Channel:
    """A barometer whose circuit board's temperature is taken for that of the air."""
    board = channel.columns.get("board_temperature_k")
    if board is None or "temperature_k" in channel.columns:
        return channel
    units = {"temperature_k": channel.logged_units.get("board_temperature_k", "")}
    return replace(
        channel,
        columns=dict(channel.columns) | {"temperature_k": board},
        logged_units=dict(channel.logged_units) | units,
    )
