"""What a flight log decides of its mission file, and what it leaves open."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unbend.batch.proposal.values import Proposed, words_of_proposals
from unbend.config.yaml_text import TODO
from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.compartments import LOWEST_PRESSURISED_M
from unbend.flight.evidence.impossible_samples import plausible_samples
from unbend.flight.ground_times import GroundEvidence
from unbend.flight.heights import height_system
from unbend.flight.mount import is_of_gimbal
from unbend.flight.roles import assign_roles
from unbend.flight.triggers import trigger_notes
from unbend.geodesy import longitudes_near, wrapped
from unbend.ingest import Log, open_log
from unbend.ingest.flight_log import utc_text
from unbend.ingest.overview import SEA_LEVEL, flight_of

OPEN_ROLES = ("ROLE-AMBIGUOUS", "CHANNEL-MISSING")
"""Codes of notes on roles that a log leaves open."""

LATE_TRIGGER = "EVENTS-TRIGGER-TIME"
"""Code of notes on channels of events that have the times of the triggers, not of the shutter."""


@dataclass(frozen=True)
class LogFacts:
    """What a log decides, for the template of the mission file.

    events : channels of exposures.
    remarks : what stands at the beginning of the file, in sentences.
    roles : keys under ``log.channels`` that are open.
    compartment : names of barometers in a closed compartment, which may be a pressurised cabin.
    takeoff : the height of the take-off, in words.
    gimbals : names of channels with attitudes of gimbals.
    trigger : names of channels of events with the times of the triggers.
    """

    events: tuple[Channel, ...] = ()
    remarks: tuple[str, ...] = ()
    roles: tuple[Proposed, ...] = ()
    compartment: str = ""
    takeoff: str = ""
    gimbals: str = ""
    trigger: str = ""


def facts_of_log(path: Path) -> LogFacts:
    """Read a log and decide what can be decided; refuses as `open_log`."""
    log = open_log(path)
    roles, notes = assign_roles(log.channels, {}, needs_cabin=False)
    plausible, questions = plausible_roles(roles)
    indoors = []
    open_roles: dict[str, None] = {}  # each once, in their order
    for note in notes:
        if note.code == "BARO-NOT-OUTSIDE":
            indoors.append(note.where)
        elif note.code in OPEN_ROLES:
            open_roles[note.where.removeprefix("log.channels.")] = None
    compartment = cabin_barometers_of(indoors, highest_of(plausible))
    for role in open_roles:
        questions += questions_of_role(role, log.channels, compartment)

    takeoff = takeoff_remark(plausible, GroundEvidence.of(log.channels))
    remarks = [time_remark(log), place_remark(plausible), heights_remark(plausible, takeoff)]
    decided = [f"{role} {roles[role].name}" for role in roles if role not in open_roles]
    remarks.append(f"detected automatically: {', '.join(decided)}")
    remarks.append(indoors_remark(indoors, compartment))
    events = best_of([channel for channel in log.channels if channel.fits_role("events")])
    return LogFacts(
        events=events,
        remarks=tuple(filter(None, remarks)),
        roles=tuple(questions),
        compartment=compartment,
        takeoff=takeoff,
        gimbals=", ".join(gimbal_channels(log)),
        trigger=", ".join(late_events(log, events)),
    )


def cabin_barometers_of(indoors: Sequence[str], highest_m: float) -> str:
    """The names of barometers that may be in a pressurised cabin; "" for none.

    ``indoors`` are those that do not follow the height, ``highest_m`` is that of the flight. A
    flight of unknown height (NaN) may be high.
    """
    if highest_m < LOWEST_PRESSURISED_M:
        return ""
    return ", ".join(indoors)


def indoors_remark(indoors: Sequence[str], cabin_barometers: str) -> str:
    """Remark on barometers that do not follow the height; "" if there are none.

    ``cabin_barometers`` names them if the flight is so high that they may be in a pressurised
    cabin, else it is "".
    """
    if not indoors:
        return ""
    if cabin_barometers:
        return f"{cabin_barometers} is in a closed compartment: it does not follow the height"
    return (
        f"{', '.join(indoors)} is not used: it does not follow the height. The flight is below "
        f"{LOWEST_PRESSURISED_M:.0f} m, where a second barometer is usually a spare of the "
        "autopilot, so no window is proposed; if the camera looks through the window of a "
        "pressurised cabin, write window: {cabin: log} under cameras.<name>"
    )


def highest_of(roles: Mapping[str, Channel]) -> float:
    """The greatest height of a flight [m]; NaN without heights."""
    height = roles.get("height")
    if height is None or height.height_column is None:
        return math.nan
    heights_m = height[height.height_column]
    known_m = heights_m[np.isfinite(heights_m)]
    if known_m.size == 0:
        return math.nan
    return float(np.max(known_m))


def plausible_roles(
    roles: Mapping[str, Channel],
) -> tuple[dict[str, Channel], list[Proposed]]:
    """The plausible samples of each role, and a question for each role in a wrong unit."""
    plausible = {}
    questions = []
    for role, channel in roles.items():
        try:
            plausible[role], _ = plausible_samples(channel, role)
        except MissionError as error:
            questions.append(Proposed(role, TODO, f"{error.what}; {error.remedy}"))
    return plausible, questions


def time_remark(log: Log) -> str:
    """When a log begins and ends, and what its times count from."""
    minutes = f"{log.duration_s / 60.0:.1f} minutes; {log.time_base}"
    if not log.has_utc:
        return f"{minutes}: state the day of the flight, mission.date"
    first = utc_text(log.start_ns)[:19]
    last = utc_text(log.end_ns)[:19]
    return f"{first} to {last} UTC, {minutes}"


def place_remark(roles: Mapping[str, Channel]) -> str:
    """The median place of a flight; empty without positions."""
    position = roles.get("position")
    if position is None or len(position) == 0:
        return ""
    longitude_rad = position["lon_rad"]
    known_rad = longitude_rad[np.isfinite(longitude_rad)]
    if known_rad.size == 0:
        return ""
    median_rad = np.median(longitudes_near(known_rad, known_rad[0]), keepdims=True)
    latitude_deg = np.degrees(np.nanmedian(position["lat_rad"]))
    longitude_deg = np.degrees(wrapped(median_rad))[0]
    return f"place: latitude {latitude_deg:.4f}, longitude {longitude_deg:.4f}"


def heights_remark(roles: Mapping[str, Channel], takeoff: str) -> str:
    """The heights of a flight, and of its take-off; empty without heights."""
    height = roles.get("height")
    if height is None or height.height_column is None:
        return ""
    heights_m = height[height.height_column]
    heights_m = heights_m[np.isfinite(heights_m)]  # the column of a role has finite values
    span = f"heights {heights_m.min():.0f} to {heights_m.max():.0f} m"
    remark = f"{span} above {surface_of_heights(height)} ({height.name})"
    return f"{remark}; {takeoff}" if takeoff else remark


def takeoff_remark(roles: Mapping[str, Channel], evidence: GroundEvidence) -> str:
    """The height of the take-off; empty where the log does not show it."""
    height = roles.get("height")
    position = roles.get("position")
    if height is None or height.height_column is None:
        return ""
    if position is None:
        return ""
    system, _ = height_system({"position": position}, None)
    flight = flight_of(position, height, evidence, home_m=system.home_h_msl_m)
    if flight.get("take_off_m") is None:
        return ""
    surface = "the sea" if flight["take_off_reference"] == SEA_LEVEL else "the ellipsoid"
    return f"take-off {flight['take_off_m']:.0f} m above {surface}"


def surface_of_heights(height: Channel) -> str:
    """What the heights of a channel count from, in words."""
    return "the sea" if height.height_column == "h_msl_m" else "the ellipsoid"


def gimbal_channels(log: Log) -> list[str]:
    """Names of the channels with attitudes of gimbals."""
    return [channel.name for channel in log.channels if is_of_gimbal(channel.source.message)]


def late_events(log: Log, events: tuple[Channel, ...]) -> list[str]:
    """Names of channels of events that have the times of the triggers, each once."""
    late: dict[str, None] = {}  # the names in their order
    for channel in events:
        for note in trigger_notes(log.channels, channel, log.parameters):
            if note.code == LATE_TRIGGER:
                late[channel.name] = None
    for note in log.ledger:
        if note.code == LATE_TRIGGER:
            late[note.where] = None
    return list(late)


def best_of(channels: list[Channel]) -> tuple[Channel, ...]:
    """The channels of the lowest rank."""
    lowest = min((channel.rank for channel in channels), default=0)
    return tuple(channel for channel in channels if channel.rank == lowest)


def questions_of_role(role: str, channels: tuple[Channel, ...], compartment: str) -> list[Proposed]:
    """The questions about a role that several channels could play, or no channel.

    Beside a barometer in a ``compartment`` a sensor may be that of the cabin: a second question.
    """
    able_channels = [
        channel for channel in channels if role in channel.roles and channel.fits_role(role)
    ]
    candidates = best_of(able_channels)
    if not candidates:
        remark = f"no channel of the log has the {role}; null if stations.trajectory gives it"
        return [Proposed(role, TODO, remark)]
    choices = " or ".join(channel.name + range_text(channel, role) for channel in candidates)
    outside = Proposed(role, TODO, f"{choices}: the sensor outside; null to use none")
    may_be_of_cabin = any(f"cabin_{role}" in channel.roles for channel in candidates)
    if not compartment or not may_be_of_cabin:
        return [outside]
    remark = f"{choices}: the sensor in the compartment of {compartment}; null if it has no sensor"
    return [outside, Proposed(f"cabin_{role}", TODO, remark)]


def range_text(channel: Channel, role: str) -> str:
    """The range of a sensor's finite readings in a usual unit, in brackets.

    Empty for a channel without finite readings, or whose column has no usual unit.
    """
    column = ROLE_COLUMNS[role][0]
    unit, factor, zero = words_of_proposals()["units"].get(column, ("", 1.0, 0.0))
    readings = channel[column]
    in_unit = readings[np.isfinite(readings)] / factor - zero
    if not unit or not in_unit.size:
        return ""
    return f" ({in_unit.min():.0f} to {in_unit.max():.0f} {unit})"
