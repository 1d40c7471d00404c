"""The flight log of a mission: the channel of each role, the heights, and contradictions."""

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
    """A log with a channel for each role; the channels of roles have plausible values only.

    log : None if stations come from elsewhere.
    channels : all channels of the log that may play roles.
    roles : the channel of each role; the trajectory in the roles that it replaces.
    logged_roles : the channel of the log for each role, also where a trajectory replaces it.
    suspect, logged_suspect : stretches in which ``roles`` and ``logged_roles`` are contradicted.
    gimbal_attitudes : by camera, the attitude of its gimbal, if the mission file names one for it.
    """

    log: Log | None
    channels: tuple[Channel, ...]
    roles: Roles
    logged_roles: Roles
    heights: HeightSystem
    suspect: tuple[Stretch, ...] = ()
    logged_suspect: tuple[Stretch, ...] = ()
    accuracy: LogAccuracy = field(default_factory=LogAccuracy)
    gimbal_attitudes: Mapping[str, Channel] = field(default_factory=dict)

    def roles_of(self, camera: str) -> Roles:
        """The channel of each role for one camera.

        They are ``self.roles``. For a camera in ``gimbal_attitudes`` two of them differ:

        * "attitude" is the attitude of that gimbal;
        * "aircraft_attitude", if ``self.roles`` has none, is the attitude of ``self.roles``, unless
          this is of a gimbal, too.
        """
        if camera not in self.gimbal_attitudes:
            return self.roles
        camera_roles = self.roles | {"attitude": self.gimbal_attitudes[camera]}
        common_attitude = self.roles.get("attitude")
        if common_attitude is not None and not is_of_gimbal(common_attitude.source.message):
            camera_roles.setdefault("aircraft_attitude", common_attitude)
        return camera_roles

    def counts_from_boot(self, time_ns: Integers) -> Mask:
        """(n,) True for times that count from a boot of the autopilot, because the log has no UTC.

        Missing times (`NO_TIME`), and all times without a log, are False.
        """
        if self.log is None:
            return np.zeros(time_ns.shape, np.bool_)
        return np.asarray(~is_utc(time_ns) & (time_ns != NO_TIME), np.bool_)

    @property
    def track(self) -> GroundTrack | None:
        """Times and positions of the aircraft; None without a channel of positions."""
        position = self.roles.get("position")
        if position is None:
            return None
        return GroundTrack(position.time_ns, position["lat_rad"], position["lon_rad"])

    @property
    def ground(self) -> GroundEvidence:
        """Evidence of the log for when the aircraft is on the ground."""
        return GroundEvidence.of(self.channels)

    @property
    def air_roles(self) -> Roles:
        """The channel of each role for samples of the air: that of the log, if it has one.

        A trajectory is used only for roles that the log lacks: it may lack climb and descent.
        """
        return self.roles | self.logged_roles


def flight_log(mission: Mission, inputs: OpenedInputs, ledger: Ledger) -> FlightLog:
    """Assign the channels of a log to roles, and relate its heights to sea level.

    Without a log a trajectory plays all roles; refuses (STATIONS-ATTITUDE) a trajectory that has no
    attitudes then.
    """
    log = inputs.log if mission.log is not None else None
    if log is None and inputs.trajectory is None:
        heights = heights_of_roles(mission, inputs, {}, ledger)
        return FlightLog(log=None, channels=(), roles={}, logged_roles={}, heights=heights)

    channels = channels_of_log(mission, log, ledger)
    trajectory = read_trajectory(mission, inputs, channels, ledger)
    replaced = () if trajectory is None else replaced_roles(mission, trajectory)
    if log is None and "attitude" not in replaced:
        raise messages.stations_without_attitude(where="stations.trajectory")

    unexamined_roles = roles_of_channels(
        mission, channels, replaced, has_log=log is not None, ledger=ledger
    )
    gimbal_attitudes = gimbals_of_cameras(mission, channels, ledger)
    if log is not None:
        report_gimbals(mission, log, unexamined_roles, gimbal_attitudes, ledger)
    heights = heights_of_roles(mission, inputs, unexamined_roles, ledger)
    # Better sources of the log replace suspect samples.
    logged_roles, logged_suspect, notes = examine(channels, unexamined_roles)
    ledger.extend(notes)

    # What the stations are built from: the log, or the trajectory where it replaces the log.
    roles = dict(logged_roles)
    suspect = logged_suspect
    if trajectory is not None:
        suspect = tuple(stretch for stretch in logged_suspect if stretch.quantity not in replaced)
        suspect += contradictions_of_import(trajectory, replaced, logged_roles, logged_suspect)
        compare_with_log(
            trajectory,
            logged_roles,
            heights,
            ledger,
            replaces=replaced,
            angle_order=angle_order_of_trajectory(mission),
        )
        roles = with_trajectory(logged_roles, trajectory, replaced, ledger)
    ledger.extend(constant_sensors(roles))
    roles, accuracy = with_accuracy(roles, channels)
    evidence = GroundEvidence.of(channels)
    heights = with_begin_of_log(heights, roles, evidence, mission.max_gap_s)
    return FlightLog(
        log=log,
        channels=channels,
        roles=roles,
        logged_roles=logged_roles,
        heights=heights,
        suspect=suspect,
        logged_suspect=logged_suspect,
        accuracy=accuracy,
        gimbal_attitudes=gimbal_attitudes,
    )


def report_gimbals(
    mission: Mission,
    log: Log,
    roles: Roles,
    gimbal_attitudes: Mapping[str, Channel],
    ledger: Ledger,
) -> None:
    """Note for each camera that is not in ``gimbal_attitudes`` if a gimbal of the log turns it."""
    mounts = {
        camera: mount for camera, mount in mission.mounts.items() if camera not in gimbal_attitudes
    }
    # With counts of messages, `gimbal_notes` reports that gimbals of the log are not used.
    message_counts = {} if gimbal_attitudes else log.messages
    ledger.extend(gimbal_notes(message_counts, roles, mounts))


def channels_of_log(mission: Mission, log: Log | None, ledger: Ledger) -> tuple[Channel, ...]:
    """The channels of the log that may play roles, with what the mission file states of them.

    Of a log of several vehicles they are those of the vehicle that flew the mission. A channel of a
    gimbal that ``log.channels`` or a mount names as attitude gets the attitude of its payload.
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
    """The names of the channels that the mission file names, by role."""
    if mission.log is None:
        return {}
    return {role: channel.name for role, channel in mission.log.channels.named().items()}


def stated_channels(mission: Mission, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """The channels of the log, converted by what the mission file states of them.

    Local positions become latitudes and longitudes; the temperature of a circuit board that is
    named as thermometer becomes that of the air; values are converted from stated units to SI.
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
    converted = []
    for channel in channels:
        as_air = board_as_air(channel) if channel.name in board_names else channel
        converted.append(from_stated_units(as_air, named))
    return tuple(converted)


def from_stated_units(channel: Channel, named: Mapping[str, NamedChannel]) -> Channel:
    """A channel with values converted to SI from the units that the mission file states.

    ``named`` has the name and unit of the channel of each role; a unit of None converts nothing.
    """
    for role, named_channel in named.items():
        if named_channel.unit is not None and named_channel.name == channel.name:
            channel = in_stated_unit(channel, role, named_channel.unit)
    return channel


def board_as_air(channel: Channel) -> Channel:
    """A barometer with the temperature of its circuit board as temperature of the air, uncorrected.

    A channel without a temperature of the board, or with one of the air, is returned as it is.
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
    """The trajectory of a mission as a channel; None if it names none.

    ``channels`` of the log give the time in which GPS weeks are looked for.
    """
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
    """The order of rotations of the trajectory's angles; "ZYX", the usual one, without any."""
    section = mission.stations.trajectory
    return "ZYX" if section is None else section.angle_order


def replaced_roles(mission: Mission, trajectory: Channel) -> tuple[str, ...]:
    """The roles that a trajectory plays instead of the log: those stated, else all that it can.

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

    ``replaced`` are roles that a trajectory plays: they may be missing in the log. Without a log
    every role may be missing.
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


def gimbals_of_cameras(
    mission: Mission, channels: tuple[Channel, ...], ledger: Ledger
) -> dict[str, Channel]:
    """The attitude of the gimbal that the mission file names for a camera, by camera.

    The key is ``mount.<camera>.attitude``. Refuses (CHANNEL-MISSING) the name of a channel that is
    not in the log or has no attitudes.
    """
    attitudes = {channel.name: channel for channel in channels if channel.fits_role("attitude")}
    gimbal_attitudes = {}
    for camera, section in mission.mount.items():
        name = section.attitude
        if name is None:
            continue
        if name not in attitudes:
            raise messages.attitude_channel_missing(
                where=f"mount.{camera}.attitude", name=name, there=", ".join(attitudes) or "none"
            )
        attitude = ledger.take(plausible_samples(attitudes[name], "attitude"))
        mount: Mount = mission.mounts[camera]
        ledger.extend(gimbal_notes({}, {"attitude": attitude}, {camera: mount}))
        gimbal_attitudes[camera] = attitude
    return gimbal_attitudes


def heights_of_roles(
    mission: Mission, inputs: OpenedInputs, roles: Roles, ledger: Ledger
) -> HeightSystem:
    """How heights above sea level, above the ellipsoid and above the take-off relate."""
    return ledger.take(
        height_system(
            roles,
            mission.mission.undulation_m,
            inputs.geoid or package_geoid(),
            stated_home_m=mission.ground.home_h_msl_m,
        )
    )


def with_trajectory(
    logged_roles: Roles, trajectory: Channel, replaced: tuple[str, ...], ledger: Ledger
) -> Roles:
    """The channel of each role: the trajectory in the ``replaced`` roles, the log's in the others.

    If the trajectory replaces the position, and the log has no heights, it gives the heights too.
    A note names the roles of the trajectory.
    """
    played = list(replaced)
    if "position" in replaced and "height" not in {*replaced, *logged_roles}:
        played.append("height")
    roles = dict(logged_roles)
    for role in played:
        roles[role] = ledger.take(plausible_samples(trajectory, role))
    former_roles = [role for role in played if role in logged_roles]
    former = ", ".join(f"{role} of {logged_roles[role].name}" for role in former_roles)
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
    """First and last time [Unix ns] of the channels with positions, or of all if none has these.

    None if no channel has samples.
    """
    with_samples = [channel for channel in channels if len(channel)]
    positions = [channel for channel in with_samples if channel.fits_role("position")]
    timed = positions or with_samples
    if not timed:
        return None
    first = min(int(channel.time_ns[0]) for channel in timed)
    last = max(int(channel.time_ns[-1]) for channel in timed)
    return first, last
