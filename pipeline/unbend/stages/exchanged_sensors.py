"""Sensors of the air outside and of the cabin that a mission file has likely exchanged."""

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
"""Codes of losses that mean that a sensor is not outside, and the role of this sensor."""

DOUBTED = {**NOT_OUTSIDE, "AIR-ISOTHERMAL": "temperature"}
"""`NOT_OUTSIDE`, and a warning that a sensor does not seem to measure the air outside."""


def exchanged_sensors(
    mission: Mission, flight: FlightLog, stations: Stations, sources: AirSources, ledger: Ledger
) -> Iterator[Message]:
    """A finding for each quantity with sensors outside and in the cabin that seem exchanged.

    That is if ``ledger`` has a loss that the sensor stated as outside is not outside, and the
    sensor of the cabin passes all checks in its place. For these checks the air is estimated once
    more with the sensors exchanged. If a sensor of the other quantity is doubted then, its pair is
    exchanged too, and the air estimated again.
    """
    roles = flight.air_roles
    pairs = {role for role in NOT_OUTSIDE.values() if has_both_sensors(roles, role)}
    exchanged = roles_with_codes(ledger, NOT_OUTSIDE) & pairs
    tried: set[str] = set()
    passed: set[str] = set()
    while exchanged > tried:  # until no further role is exchanged
        tried = exchanged
        trial = Ledger()
        samples = trial.take(
            outside_air_samples(
                with_cabin_sensors(roles, tried),
                flight.heights,
                mission.max_gap_s,
                flight.logged_suspect,
                flight.ground,
            )
        )
        air = adjusted_profiles(mission, stations, samples, sources, trial)
        used = {use.quantity for use in air.adjustment.sensor_uses if use.used}
        doubted = roles_with_codes(trial, DOUBTED)
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


def has_both_sensors(roles: Mapping[str, Channel], role: str) -> bool:
    """Whether a role has a channel outside and another one in the cabin (``cabin_<role>``)."""
    outside = roles.get(role)
    cabin = roles.get(f"cabin_{role}")
    return outside is not None and cabin is not None and outside.name != cabin.name


def roles_with_codes(ledger: Ledger, role_of_code: Mapping[str, str]) -> set[str]:
    """The roles that belong to the codes of a ledger's entries; other codes do not count."""
    return {role_of_code[entry.code] for entry in ledger if entry.code in role_of_code}


def with_cabin_sensors(
    roles: Mapping[str, Channel], exchanged: Collection[str]
) -> dict[str, Channel]:
    """A copy of the roles, in which the cabin's channels play the ``exchanged`` roles outside."""
    changed = dict(roles)
    for role in exchanged:
        changed[role] = roles[f"cabin_{role}"]
    return changed
