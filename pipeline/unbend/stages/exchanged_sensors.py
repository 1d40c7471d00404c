"""Sensors of the air outside and of the cabin that a mission file has exchanged."""

from collections.abc import Collection, Iterator, Mapping

from unbend.atmosphere.estimate.sensor_checks import CLIMB_TO_COMPARE_M
from unbend.config import Mission
from unbend.flight.channels import Channel
from unbend.flight.outside_air import outside_air_samples
from unbend.flight.stations import Stations
from unbend.messages import Ledger, Message
from unbend.stages import messages
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.stages.air_sources import AirSources
from unbend.stages.flight_log import FlightLog

NOT_OUTSIDE = {"AIR-NOT-OUTSIDE": "pressure", "AIR-THERMOMETER": "temperature"}
"""Codes of losses by which a sensor is not outside, with the role that it has."""

DOUBTED = {**NOT_OUTSIDE, "AIR-ISOTHERMAL": "temperature"}
"""The same, and that of a warning: a sensor with one of them does not behave as outside."""


def exchanged_sensors(
    mission: Mission, flight: FlightLog, stations: Stations, sources: AirSources, ledger: Ledger
) -> Iterator[Message]:
    """A finding for each pair of sensors, outside and in the cabin, that seem exchanged.

    The sensor stated as outside was found not to be outside, and the one stated as the cabin's
    passes all checks in its place. The air is estimated once more for that, and again if another
    sensor is found not to be outside then.
    """
    roles = flight.air_roles
    pairs = {role for role in NOT_OUTSIDE.values() if is_pair(roles, role)}
    exchanged = roles_with(ledger, NOT_OUTSIDE) & pairs
    tried: set[str] = set()
    passed: set[str] = set()
    while exchanged > tried:
        tried = exchanged
        trial = Ledger()
        samples = trial.take(
            outside_air_samples(
                with_exchanged(roles, tried),
                flight.heights,
                mission.max_gap_s,
                flight.own_suspect,
                flight.ground,
            )
        )
        air = adjusted_profiles(mission, stations, samples, sources, trial)
        used = {use.quantity for use in air.adjustment.sensor_uses if use.used}
        doubted = roles_with(trial, DOUBTED)
        passed = set()
        for role in (tried - doubted) & used:
            sensor = samples.sensors.get(role)
            if sensor is not None and sensor.extent_m >= CLIMB_TO_COMPARE_M:
                passed.add(role)
        exchanged = tried | (doubted & pairs)
    for role in sorted(passed):
        yield messages.sensors_exchanged(
            where=f"log.channels.{role}",
            quantity=role,
            outside=roles[role].name,
            cabin=roles[f"cabin_{role}"].name,
        )


def is_pair(roles: Mapping[str, Channel], role: str) -> bool:
    """Whether different channels play a role outside and in the cabin."""
    outside = roles.get(role)
    cabin = roles.get(f"cabin_{role}")
    return outside is not None and cabin is not None and outside.name != cabin.name


def roles_with(ledger: Ledger, role_of_code: Mapping[str, str]) -> set[str]:
    """The roles of which a ledger has one of the codes."""
    return {role_of_code[entry.code] for entry in ledger if entry.code in role_of_code}


def with_exchanged(roles: Mapping[str, Channel], exchanged: Collection[str]) -> dict[str, Channel]:
    """The roles with the channels of the cabin outside, for some of them."""
    changed = dict(roles)
    for role in exchanged:
        changed[role] = roles[f"cabin_{role}"]
    return changed
