"""Which vehicle of a log flew the mission, where the log has several."""

from collections.abc import Mapping, Sequence

from unbend.config import Mission
from unbend.flight.channels import Channel
from unbend.flight.exposures import choose_event_channel
from unbend.flight.vehicles import Vehicles
from unbend.messages import Ledger
from unbend.stages import messages

_FLIGHT_ROLES = ("position", "height", "attitude", "aircraft_attitude")


def channels_of_one_vehicle(
    mission: Mission,
    channels: tuple[Channel, ...],
    named: Mapping[str, str],
    ledger: Ledger,
) -> tuple[Channel, ...]:
    """The channels that may play roles: those of the vehicle that flew the mission.

    That is the vehicle whose events are used; without events of a log that of the channels which
    the mission file names (``named``, by role). Channels of no vehicle stay, and those that are
    named: the ledger has a finding for each of another vehicle. Refuses (LOG-VEHICLES) a log of
    several vehicles, none of which or several of which are named.
    """
    vehicles = Vehicles.of(channels)
    if not vehicles.names:
        return channels
    events = event_channels(mission, channels)
    by_name = {channel.name: channel for channel in channels}
    of_roles = {role: by_name[name] for role, name in named.items() if name in by_name}
    vehicle, reason = _vehicle_of(
        vehicles,
        events,
        of_roles,
    )
    if not vehicle:
        raise messages.vehicles_ambiguous(
            vehicles=[f"{name} ({_listed(vehicles, name, channels)})" for name in vehicles.names],
            reason=reason,
        )
    ledger.add(
        messages.vehicle_chosen(
            vehicle=vehicle,
            vehicles=vehicles.names,
            channel=reason,
        )
    )
    for role, channel in of_roles.items():
        other = vehicles.of_channel(channel)
        if other not in ("", vehicle):
            ledger.add(
                messages.role_of_another_vehicle(
                    role=role,
                    channel=channel.name,
                    other=other,
                    vehicle=vehicle,
                )
            )
    kept = {channel.name for channel in (*events, *of_roles.values())}
    kept |= {mount.attitude for mount in mission.mount.values() if mount.attitude is not None}
    return vehicles.channels_of(
        vehicle,
        channels,
        kept,
    )


def event_channels(mission: Mission, channels: tuple[Channel, ...]) -> list[Channel]:
    """The channels of the log whose events are the exposures of the cameras."""
    if mission.events is None or mission.events.log is None:
        return []
    sources = mission.events.log.values()
    return [choose_event_channel(channels, source.channel) for source in sources]


def _vehicle_of(
    vehicles: Vehicles,
    events: Sequence[Channel],
    of_roles: Mapping[str, Channel],
) -> tuple[str, str]:
    """The vehicle of the events, else of the roles of the flight, and the channel that says so.

    "" and the channels of several vehicles where that is not one.
    """
    flight = [of_roles[role] for role in _FLIGHT_ROLES if role in of_roles]
    for candidates in (events, flight):
        senders = {vehicles.of_channel(channel): channel.name for channel in candidates}
        senders.pop("", None)
        if len(senders) == 1:
            ((vehicle, channel),) = senders.items()
            return vehicle, channel
        if senders:
            return "", ", ".join(senders.values())
    return "", ""


def _listed(
    vehicles: Vehicles,
    vehicle: str,
    channels: Sequence[Channel],
) -> str:
    """The channels of positions and of events of a vehicle."""
    return ", ".join(
        channel.name
        for channel in channels
        if vehicles.of_channel(channel) == vehicle and {"position", "events"} & set(channel.roles)
    )
