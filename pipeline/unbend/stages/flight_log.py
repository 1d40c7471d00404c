"""The flight log of a mission: its channels in their roles, its heights, its contradictions."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from unbend.config import Mission
from unbend.config.logs import NamedChannel
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.evidence.constant_sensors import constant_sensors
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.imported_channels import contradictions_of_import
from unbend.flight.evidence.impossible_samples import plausible_samples
from unbend.flight.evidence.log_accuracy import LogAccuracy, with_accuracy
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.ground_times import GroundEvidence
from unbend.flight.heights import (
    HeightSystem,
    height_system,
    to_geodetic,
    with_begin_of_log,
)
from unbend.flight.mount import Mount, gimbal_notes, is_of_gimbal, with_payload_attitude
from unbend.flight.roles import assign_roles
from unbend.flight.spares import with_spares
from unbend.flight.stations import NO_TIME
from unbend.ingest import Log
from unbend.ingest.field_maps import in_stated_unit
from unbend.ingest.utc_evidence import is_utc
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.vehicle import channels_of_one_vehicle
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.imports.agreement import compare_with_log
from unbend.tables.imports.stated import Stated
from unbend.units import Array, Integers, Mask

Roles = dict[str, Channel]
"""The channel that plays each role."""


class GroundTrack(NamedTuple):
    """(n,) times [Unix ns], latitudes and longitudes [rad] of a flight, as logged."""

    time_ns: Integers
    latitude_rad: Array
    longitude_rad: Array


@dataclass(frozen=True, eq=False)
class FlightLog:
    """A log after its channels were given their roles; these hold plausible values only.

    log : None where stations come from elsewhere.
    roles : the channel of each role; of a trajectory, where that replaces the log's.
    own : the channel of each role as the log alone fills them.
    suspect, own_suspect : stretches in which ``roles`` and ``own`` are contradicted.
    heads : the attitude of each camera that has a gimbal of its own.
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
        """The channel of each role for one camera.

        For a camera without a gimbal of its own they are ``self.roles``. With one (``heads``):

        * "attitude" is the channel of that gimbal;
        * "aircraft_attitude" is that of ``self.roles``, if it has one; else the attitude of
          ``self.roles``, unless this is a gimbal's, too;
        * all other roles are those of ``self.roles``.
        """
        if camera not in self.heads:
            return self.roles
        camera_roles = self.roles | {"attitude": self.heads[camera]}
        common_attitude = self.roles.get("attitude")
        if common_attitude is not None and not is_of_gimbal(common_attitude.source.message):
            camera_roles.setdefault("aircraft_attitude", common_attitude)
        return camera_roles

    def counts_from_boot(self, time_ns: Integers) -> Mask:
        """(n,) which times count from a boot, because the log has no UTC then."""
        if self.log is None:
            return np.zeros(time_ns.shape, np.bool_)
        return np.asarray(~is_utc(time_ns) & (time_ns != NO_TIME), np.bool_)

    @property
    def track(self) -> GroundTrack | None:
        """Where the aircraft was; None where no position is known."""
        position = self.roles.get("position")
        if position is None:
            return None
        return GroundTrack(position.time_ns, position["lat_rad"], position["lon_rad"])

    @property
    def ground(self) -> GroundEvidence:
        """What the log says of whether the aircraft stands on the ground."""
        return GroundEvidence.of(self.channels)

    @property
    def air_roles(self) -> Roles:
        """Roles for the air, at the log's own heights: a trajectory may lack climb and descent."""
        return self.roles | self.own


def flight_log(mission: Mission, inputs: OpenedInputs, ledger: Ledger) -> FlightLog:
    """Assign the channels of a log to roles, and relate its heights to sea level.

    Without a log a trajectory plays all roles; refuses (STATIONS-ATTITUDE) a trajectory that has no
    attitudes then.
    """
    log = inputs.log if mission.log is not None else None
    if log is None and inputs.trajectory is None:
        heights = heights_of_roles(mission, inputs, {}, ledger)
        return FlightLog(log=None, channels=(), roles={}, own={}, heights=heights)

    channels = channels_of_log(mission, log, ledger)
    trajectory = read_trajectory(mission, inputs, channels, ledger)
    replaced = () if trajectory is None else replaced_roles(mission, trajectory)
    if log is None and "attitude" not in replaced:
        raise messages.stations_without_attitude(where="stations.trajectory")

    logged_roles = roles_of_channels(
        mission, channels, replaced, has_log=log is not None, ledger=ledger
    )
    heads = heads_of_cameras(mission, channels, ledger)
    if log is not None:
        report_gimbals(mission, log, logged_roles, heads, ledger)
    heights = heights_of_roles(mission, inputs, logged_roles, ledger)
    # Better sources of the log replace suspect samples.
    examined_roles, own_suspect, notes = examine(channels, logged_roles)
    ledger.extend(notes)

    # What the stations are built from: the log, or the trajectory where it replaces the log.
    roles = dict(examined_roles)
    suspect = own_suspect
    if trajectory is not None:
        suspect = tuple(stretch for stretch in own_suspect if stretch.quantity not in replaced)
        suspect += contradictions_of_import(trajectory, replaced, examined_roles, own_suspect)
        compare_with_log(
            trajectory,
            examined_roles,
            heights,
            ledger,
            replaces=replaced,
            angle_order=angle_order_of_trajectory(mission),
        )
        roles = with_trajectory(examined_roles, trajectory, replaced, ledger)
    ledger.extend(constant_sensors(roles))
    roles, accuracy = with_accuracy(roles, channels)
    evidence = GroundEvidence.of(channels)
    heights = with_begin_of_log(heights, roles, evidence, mission.max_gap_s)
    return FlightLog(
        log=log,
        channels=channels,
        roles=roles,
        own=examined_roles,
        heights=heights,
        suspect=suspect,
        own_suspect=own_suspect,
        accuracy=accuracy,
        heads=heads,
    )


def report_gimbals(
    mission: Mission, log: Log, roles: Roles, heads: Mapping[str, Channel], ledger: Ledger
) -> None:
    """Notes on the cameras without a gimbal of their own: whether one of the log turns them."""
    mounts = {camera: mount for camera, mount in mission.mounts.items() if camera not in heads}
    # By the counts of messages a log is reported whose gimbals are not used; ``heads`` use them.
    message_counts = {} if heads else log.messages
    ledger.extend(gimbal_notes(message_counts, roles, mounts))


def channels_of_log(mission: Mission, log: Log | None, ledger: Ledger) -> tuple[Channel, ...]:
    """The channels of a log as the mission file states them, of the vehicle that flew it.

    The attitude that ``log.channels`` names, and that of each mount, may be of a gimbal: its
    channel then has the attitude of the payload.
    """
    section = mission.log
    if section is None or log is None:
        return ()
    names = names_of_roles(mission)
    channels = stated_channels(mission, log.channels)
    channels = channels_of_one_vehicle(mission, channels, names, ledger)
    attitudes = [names.get("attitude", "")]  # "" if none is named
    for mount in mission.mount.values():
        if mount.attitude is not None:
            attitudes.append(mount.attitude)
    for attitude in dict.fromkeys(attitudes):
        named = names | {"attitude": attitude}
        channels = ledger.take(with_payload_attitude(channels, named, section.max_gap_s))
    return channels


def names_of_roles(mission: Mission) -> dict[str, str]:
    """The channels that the mission file names, by their roles."""
    if mission.log is None:
        return {}
    return {role: channel.name for role, channel in mission.log.channels.named().items()}


def stated_channels(mission: Mission, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """The channels of the log with what the mission file states of them.

    Local positions are placed on the earth; circuit boards named as thermometers count as air;
    values are converted from the units that the mission file states.
    """
    section = mission.log
    if section is None:
        return channels
    if section.local_origin is not None:
        origin = section.local_origin.build()
        channels = tuple(to_geodetic(channel, origin) for channel in channels)
    named = section.channels.named()
    board_roles = {"cabin_temperature"}
    if mission.atmosphere.board_temperature:
        board_roles.add("temperature")
    board_names = {named[role].name for role in board_roles & named.keys()}
    channels_of_columns = []
    for channel in channels:
        as_air = board_as_air(channel) if channel.name in board_names else channel
        channels_of_columns.append(in_stated_units(as_air, named))
    return tuple(channels_of_columns)


def in_stated_units(channel: Channel, named: Mapping[str, NamedChannel]) -> Channel:
    """A channel with the values of its roles in SI; ``named`` are channels and units by role."""
    for role, named_channel in named.items():
        if named_channel.unit is not None and named_channel.name == channel.name:
            channel = in_stated_unit(channel, role, named_channel.unit)
    return channel


def board_as_air(channel: Channel) -> Channel:
    """A barometer with the temperature of its circuit board as that of the air.

    A channel without a board, or with a thermometer, is returned as it is.
    """
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
    statements = Stated(
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
    return inputs.trajectory(statements, ledger)


def angle_order_of_trajectory(mission: Mission) -> str:
    """The order in which the angles of the trajectory turn; ZYX, the usual one, without any."""
    section = mission.stations.trajectory
    return "ZYX" if section is None else section.angle_order


def replaced_roles(mission: Mission, trajectory: Channel) -> tuple[str, ...]:
    """The roles that a trajectory plays in place of the log: those stated, or all that it can.

    Refuses (TRAJECTORY-REPLACES) a trajectory without the columns of a stated role.
    """
    section = mission.stations.trajectory
    playable = [role for role in ("position", "height", "attitude") if trajectory.fits_role(role)]
    if section is None or section.replaces is None:
        return tuple(playable)
    for role in section.replaces:
        if role not in playable:
            raise messages.trajectory_lacks_role(
                where=trajectory.name,
                role=role,
                columns=", ".join(ROLE_COLUMNS[role]),
                able=", ".join(playable),
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
    """The channel of the log in each role, with its plausible samples only.

    ``replaced`` are roles that a trajectory plays: the log need not fill them. Without a log no
    role is missed.
    """
    played_elsewhere = replaced if has_log else ("position", "attitude")
    assigned = ledger.take(
        assign_roles(
            channels,
            names_of_roles(mission),
            needs_cabin=any(camera.needs_cabin_from_log for camera in mission.cameras.values()),
            elsewhere=played_elsewhere,
            empty=() if mission.log is None else mission.log.channels.unused_roles,
        )
    )
    plausible = {}
    for role, channel in assigned.items():
        plausible[role] = ledger.take(plausible_samples(channel, role))
    return ledger.take(with_spares(plausible, channels, names_of_roles(mission)))


def heads_of_cameras(
    mission: Mission, channels: tuple[Channel, ...], ledger: Ledger
) -> dict[str, Channel]:
    """The attitude of each camera with a gimbal of its own, ``mount.<camera>.attitude``.

    Refuses (CHANNEL-MISSING) a name that no channel with attitudes has.
    """
    attitudes = {channel.name: channel for channel in channels if channel.fits_role("attitude")}
    heads = {}
    for camera, section in mission.mount.items():
        name = section.attitude
        if name is None:
            continue
        if name not in attitudes:
            raise messages.attitude_channel_missing(
                where=f"mount.{camera}.attitude", name=name, there=", ".join(attitudes) or "none"
            )
        head = ledger.take(plausible_samples(attitudes[name], "attitude"))
        mount: Mount = mission.mounts[camera]
        ledger.extend(gimbal_notes({}, {"attitude": head}, {camera: mount}))
        heads[camera] = head
    return heads


def heights_of_roles(
    mission: Mission, inputs: OpenedInputs, roles: Roles, ledger: Ledger
) -> HeightSystem:
    """How the heights of a log, above sea level and above the ellipsoid, relate."""
    return ledger.take(
        height_system(
            roles,
            mission.mission.undulation_m,
            inputs.geoid or package_geoid(),
            stated_home_m=mission.ground.home_h_msl_m,
        )
    )


def with_trajectory(
    own: Roles, trajectory: Channel, replaced: tuple[str, ...], ledger: Ledger
) -> Roles:
    """The roles with the trajectory in the ``replaced`` ones, and the log's ``own`` in the others.

    A log without heights gets those of the trajectory along with its positions. The ledger names
    what the trajectory gives.
    """
    played = list(replaced)
    if "position" in replaced and "height" not in {*replaced, *own}:
        played.append("height")
    roles = dict(own)
    for role in played:
        roles[role] = ledger.take(plausible_samples(trajectory, role))
    former = ", ".join(f"{role} of {own[role].name}" for role in played if role in own)
    ledger.add(
        messages.trajectory_replaces(
            where="stations.trajectory",
            name=trajectory.name,
            roles=", ".join(played),
            former=f"instead of {former}" if former else "which the log does not have",
        )
    )
    return roles


def time_range(channels: tuple[Channel, ...]) -> tuple[int, int] | None:
    """First and last time [Unix ns] of the positions of a log, or of all channels without these.

    None for a log without samples.
    """
    filled = [channel for channel in channels if len(channel)]
    positions = [channel for channel in filled if channel.fits_role("position")]
    timed = positions or filled
    if not timed:
        return None
    first = min(int(channel.time_ns[0]) for channel in timed)
    last = max(int(channel.time_ns[-1]) for channel in timed)
    return first, last
