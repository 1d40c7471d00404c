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
    """The channels that may play roles: all if the log has one vehicle; if it has several

    * the channels of the vehicle that flew the mission. It is the sender of the events in use; if
      no events of the log are used, the sender of the channels that the mission file names;
    * channels that belong to no vehicle;
    * channels of other vehicles that are used or named, with a finding for each named one.

    ``named`` has the names of channels by role. Refuses (LOG-VEHICLES) a log of several vehicles
    if events and names show none of them as the one that flew, or more than one.
    """
    vehicles = Vehicles.of(channels)
    if not vehicles.names:
        return channels
    events = event_channels(mission, channels)
    by_name = {channel.name: channel for channel in channels}
    named_channels = {role: by_name[name] for role, name in named.items() if name in by_name}
    vehicle, deciding_channels = _vehicle_that_flew(vehicles, events, named_channels)
    if not vehicle:
        raise messages.vehicles_ambiguous(
            vehicles=[
                f"{name} ({_channel_list(vehicles, name, channels)})" for name in vehicles.names
            ],
            reason=deciding_channels,
        )
    ledger.add(
        messages.vehicle_chosen(vehicle=vehicle, vehicles=vehicles.names, channel=deciding_channels)
    )
    for role, channel in named_channels.items():
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
    used_or_named = {channel.name for channel in (*events, *named_channels.values())}
    for mount in mission.mount.values():
        if mount.attitude is not None:
            used_or_named.add(mount.attitude)
    return vehicles.channels_of(vehicle, channels, used_or_named)


def event_channels(mission: Mission, channels: tuple[Channel, ...]) -> list[Channel]:
    """The channels of the log with the exposures, one for each camera in ``events.log``."""
    if mission.events is None or mission.events.log is None:
        return []
    sources = mission.events.log.values()
    return [choose_event_channel(channels, source.channel) for source in sources]


def _vehicle_that_flew(
    vehicles: Vehicles,
    events: Sequence[Channel],
    named_channels: Mapping[str, Channel],
) -> tuple[str, str]:
    """The vehicle that sent the events, and the name of a channel that shows it.

    If no channel of events belongs to a vehicle, the channels that are named for position, height
    and attitude decide (``named_channels``, by role). Returns

    * "" and the names of a channel of each vehicle if these channels are of several;
    * "" and "" if no channel belongs to a vehicle.
    """
    flight_channels = [named_channels[role] for role in _FLIGHT_ROLES if role in named_channels]
    for candidates in (events, flight_channels):
        channel_of_vehicle = {vehicles.of_channel(channel): channel.name for channel in candidates}
        channel_of_vehicle.pop("", None)  # channels that belong to no vehicle
        if len(channel_of_vehicle) == 1:
            ((vehicle, channel),) = channel_of_vehicle.items()
            return vehicle, channel
        if channel_of_vehicle:
            return "", ", ".join(channel_of_vehicle.values())
    return "", ""


def _channel_list(
    vehicles: Vehicles,
    vehicle: str,
    channels: Sequence[Channel],
) -> str:
    """Names of a vehicle's channels that have positions or events, with commas, for a message."""
    return ", ".join(
        channel.name
        for channel in channels
        if vehicles.of_channel(channel) == vehicle and {"position", "events"} & set(channel.roles)
    )
