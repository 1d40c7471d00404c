"""The flight log of a mission: its channels in their roles, its heights, its contradictions."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from unbend.config import Mission
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.evidence.contradictions import contradictions_of_import, examine
from unbend.flight.evidence.log_accuracy import LogAccuracy, with_accuracy
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem, height_system, to_geodetic
from unbend.flight.mount import Mount, gimbal_notes, is_of_gimbal, with_payload_attitude
from unbend.flight.roles import assign_roles
from unbend.ingest import Log
from unbend.ingest.field_maps import in_stated_unit
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.imports.agreement import compare_with_log
from unbend.tables.imports.stated import Stated
from unbend.units import Array, Integers

Track = tuple[Integers, Array, Array]
"""Times [Unix ns], latitudes and longitudes [rad] of a flight."""

Roles = dict[str, Channel]
"""The channel that plays each role."""


@dataclass(frozen=True, eq=False)
class FlightLog:
    """A log after its channels were given their roles; these hold plausible values only.

    ``suspect`` are stretches in which the log contradicts itself; ``own`` are the roles as it fills
    them, with ``own_suspect``; in ``roles`` a trajectory has replaced some. ``log`` is None where
    stations come from elsewhere; ``heads`` are attitudes of cameras with one of their own.
    """

    log: Log | None
    channels: tuple[Channel, ...]
    roles: Roles
    own: Roles
    heights: HeightSystem
    suspect: tuple[Stretch, ...] = ()
    own_suspect: tuple[Stretch, ...] = ()
    accuracy: LogAccuracy = field(default_factory=LogAccuracy)
    heads: Mapping[str, Channel] = field(default_factory=dict)

    def roles_of(self, camera: str) -> Roles:
        """The roles for one camera; beside its own head the attitude is that of the aircraft."""
        if camera not in self.heads:
            return self.roles
        roles = self.roles | {"attitude": self.heads[camera]}
        aircraft = self.roles.get("attitude")
        if aircraft is not None and not is_of_gimbal(aircraft.source.message):
            roles.setdefault("aircraft_attitude", aircraft)
        return roles

    @property
    def track(self) -> Track | None:
        """Where the aircraft was, None where no position is known."""
        position = self.roles.get("position")
        if position is None:
            return None
        return position.time_ns, position["lat_rad"], position["lon_rad"]

    @property
    def air_roles(self) -> Roles:
        """Roles for the air, at the log's own heights: a trajectory may lack climb and descent."""
        return self.roles | self.own


def flight_log(mission: Mission, inputs: OpenedInputs, ledger: Ledger) -> FlightLog:
    """Assign the channels of a log to roles, and relate its heights to sea level.

    Without a log a trajectory has all the roles; refuses (STATIONS-ATTITUDE) one without attitudes.
    """
    log = inputs.log if mission.log is not None else None
    if log is None and inputs.trajectory is None:
        return FlightLog(None, (), {}, {}, heights_of_roles(mission, inputs, {}, Ledger()))

    channels = channels_of_log(mission, log, ledger)
    trajectory = read_trajectory(mission, inputs, channels, ledger)
    replaced = () if trajectory is None else replaced_roles(mission, trajectory)
    if log is None and "attitude" not in replaced:
        raise messages.stations_without_attitude(where="stations.trajectory")

    roles = roles_of_channels(mission, channels, replaced, has_log=log is not None, ledger=ledger)
    heads = heads_of_cameras(mission, channels, ledger)
    if log is not None:
        mounts = {camera: m for camera, m in mission.mounts.items() if camera not in heads}
        kinds = {} if heads else log.messages
        ledger.extend(gimbal_notes(kinds, roles, mounts))
    heights = heights_of_roles(mission, inputs, roles, ledger)
    own, own_suspect, notes = examine(channels, roles)
    ledger.extend(notes)

    roles = dict(own)
    suspect = tuple(stretch for stretch in own_suspect if stretch.quantity not in replaced)
    if trajectory is not None:
        suspect += contradictions_of_import(trajectory, replaced, own, own_suspect)
        section = mission.stations.trajectory
        order = "ZYX" if section is None else section.angle_order
        compare_with_log(trajectory, own, heights, ledger, replaces=replaced, angle_order=order)
        roles = with_trajectory(roles, trajectory, replaced, own, ledger)
    roles, accuracy = with_accuracy(roles, channels)
    return FlightLog(
        log=log,
        channels=channels,
        roles=roles,
        own=own,
        heights=heights,
        suspect=suspect,
        own_suspect=own_suspect,
        accuracy=accuracy,
        heads=heads,
    )


def channels_of_log(mission: Mission, log: Log | None, ledger: Ledger) -> tuple[Channel, ...]:
    """The channels of a log as the mission file states them, with attitudes of payloads."""
    section = mission.log
    if section is None or log is None:
        return ()
    names = names_of_roles(mission)
    channels = stated_channels(mission, log.channels)
    heads = [mount.attitude for mount in mission.mount.values() if mount.attitude is not None]
    for attitude in dict.fromkeys([names.get("attitude", ""), *heads]):
        named = names | {"attitude": attitude}
        channels = ledger.take(with_payload_attitude(channels, named, section.max_gap_s))
    return channels


def names_of_roles(mission: Mission) -> dict[str, str]:
    """The channels that the mission file names, by their roles."""
    if mission.log is None:
        return {}
    return {role: stated.name for role, stated in mission.log.channels.named().items()}


def stated_channels(mission: Mission, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """The channels of the log on the earth, in the units and for the boards that are stated."""
    section = mission.log
    if section is None:
        return channels
    if section.local_origin is not None:
        origin = section.local_origin.build()
        channels = tuple(to_geodetic(channel, origin) for channel in channels)
    named = section.channels.named()
    boards = {"cabin_temperature"}
    if mission.atmosphere.board_temperature:
        boards.add("temperature")
    names_of_boards = {named[role].name for role in boards & named.keys()}
    stated = list(channels)
    for number, channel in enumerate(stated):
        if channel.name in names_of_boards:
            channel = board_as_air(channel)
        for role, of_role in named.items():
            if of_role.unit is not None and of_role.name == channel.name:
                channel = in_stated_unit(channel, role, of_role.unit)
        stated[number] = channel
    return tuple(stated)


def board_as_air(channel: Channel) -> Channel:
    """A barometer whose circuit board's temperature is taken for that of the air."""
    board = channel.columns.get("board_temperature_k")
    if board is None or "temperature_k" in channel.columns:
        return channel
    unit = channel.logged_units.get("board_temperature_k", "")
    return replace(
        channel,
        columns=dict(channel.columns) | {"temperature_k": board},
        logged_units=dict(channel.logged_units) | {"temperature_k": unit},
    )


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
        around_ns=time_range(channels),
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
            raise messages.trajectory_lacks_role(
                where=trajectory.name,
                role=role,
                columns=", ".join(ROLE_COLUMNS[role]),
                able=", ".join(able),
            )
    return tuple(section.replaces)


def roles_of_channels(
    mission: Mission,
    channels: tuple[Channel, ...],
    replaced: tuple[str, ...],
    *,
    has_log: bool,
    ledger: Ledger,
) -> Roles:
    """The plausible samples of the channel of each role; some a trajectory ``replaced``."""
    roles = ledger.take(
        assign_roles(
            channels,
            names_of_roles(mission),
            needs_cabin=any(camera.needs_cabin_from_log for camera in mission.cameras.values()),
            elsewhere=replaced if has_log else ("position", "attitude"),
        )
    )
    return {role: ledger.take(plausible_samples(channel, role)) for role, channel in roles.items()}


def heads_of_cameras(
    mission: Mission, channels: tuple[Channel, ...], ledger: Ledger
) -> dict[str, Channel]:
    """Attitudes of cameras with a gimbal of their own; refuses (CHANNEL-MISSING) an unknown one."""
    able = {channel.name: channel for channel in channels if channel.fits_role("attitude")}
    heads = {}
    for camera, section in mission.mount.items():
        name = section.attitude
        if name is None:
            continue
        if name not in able:
            raise messages.attitude_channel_missing(
                where=f"mount.{camera}.attitude", name=name, there=", ".join(able) or "none"
            )
        heads[camera] = ledger.take(plausible_samples(able[name], "attitude"))
        mount: Mount = mission.mounts[camera]
        ledger.extend(gimbal_notes({}, {"attitude": heads[camera]}, {camera: mount}))
    return heads


def heights_of_roles(
    mission: Mission, inputs: OpenedInputs, roles: Roles, ledger: Ledger
) -> HeightSystem:
    """How the heights of a log relate to sea level."""
    return ledger.take(
        height_system(
            roles,
            mission.mission.undulation_m,
            inputs.geoid or package_geoid(),
            stated_home_m=mission.ground.home_h_msl_m,
        )
    )


def with_trajectory(
    roles: Roles, trajectory: Channel, replaced: tuple[str, ...], own: Roles, ledger: Ledger
) -> Roles:
    """The roles of the log, with those that the trajectory plays; the ledger names these.

    ``replaced`` are the roles that the mission file gives to the trajectory, ``own`` those of the
    log alone. A log without heights gets those of the trajectory along with its positions.
    """
    played = list(replaced)
    if "position" in replaced and "height" not in {*replaced, *own}:
        played.append("height")
    roles = dict(roles)
    for role in played:
        roles[role] = ledger.take(plausible_samples(trajectory, role))
    former = ", ".join(f"{role} of {own[role].name}" for role in played if role in own)
    ledger.add(
        messages.trajectory_replaces(
            where="stations.trajectory",
            name=trajectory.name,
            roles=", ".join(played),
            former=f"in place of {former}" if former else "which the log has not",
        )
    )
    return roles


def time_range(channels: tuple[Channel, ...]) -> tuple[int, int] | None:
    """First and last time of the positions of a log, or of all that it has [Unix ns]."""
    filled = [channel for channel in channels if len(channel)]
    placed = [channel for channel in filled if channel.fits_role("position")] or filled
    if not placed:
        return None
    first = min(int(channel.time_ns[0]) for channel in placed)
    last = max(int(channel.time_ns[-1]) for channel in placed)
    return first, last
