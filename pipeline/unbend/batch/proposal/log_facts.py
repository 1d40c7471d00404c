"""Values of a mission file that a flight log decides, and questions that it leaves open."""

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
"""Codes of notes on roles that several channels of a log could play, or none."""

LATE_TRIGGER = "EVENTS-TRIGGER-TIME"
"""Code of notes on channels of events with the times of the triggers, not of the shutter."""


@dataclass(frozen=True)
class LogFacts:
    """What a log decides, for the template of the mission file. Texts are "" if unknown.

    events : channels of exposures.
    remarks : sentences for the beginning of the file.
    roles : keys under ``log.channels`` with values that are left open.
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
    """Read a log, and decide the values of its mission file; refuses as `open_log`."""
    log = open_log(path)
    roles, notes = assign_roles(log.channels, {}, needs_cabin=False)
    plausible, questions = plausible_roles(roles)
    enclosed = []
    open_roles: dict[str, None] = {}  # each once, in their order
    for note in notes:
        if note.code == "BARO-NOT-OUTSIDE":
            enclosed.append(note.where)
        elif note.code in OPEN_ROLES:
            open_roles[note.where.removeprefix("log.channels.")] = None
    compartment = cabin_barometers_of(enclosed, highest_of(plausible))
    for role in open_roles:
        questions += questions_of_role(role, log.channels, compartment)

    takeoff = takeoff_remark(plausible, GroundEvidence.of(log.channels))
    remarks = [time_remark(log), place_remark(plausible), heights_remark(plausible, takeoff)]
    decided = [f"{role} {roles[role].name}" for role in roles if role not in open_roles]
    remarks.append(f"detected automatically: {', '.join(decided)}")
    remarks.append(enclosed_remark(enclosed, compartment))
    events = channels_of_lowest_rank(
        [channel for channel in log.channels if channel.fits_role("events")]
    )
    return LogFacts(
        events=events,
        remarks=tuple(filter(None, remarks)),
        roles=tuple(questions),
        compartment=compartment,
        takeoff=takeoff,
        gimbals=", ".join(gimbal_channels(log)),
        trigger=", ".join(late_events(log, events)),
    )


def cabin_barometers_of(enclosed: Sequence[str], highest_m: float) -> str:
    """The names of barometers that may be in a pressurised cabin; "" for none.

    ``enclosed`` are the barometers that do not follow the height, ``highest_m`` is the greatest
    height of the flight. A flight of unknown height (NaN) counts as high.
    """
    if highest_m < LOWEST_PRESSURISED_M:
        return ""
    return ", ".join(enclosed)


def enclosed_remark(enclosed: Sequence[str], cabin_barometers: str) -> str:
    """Remark on barometers that do not follow the height; "" if there are none.

    ``cabin_barometers`` names them if the flight is so high that they may be in a pressurised
    cabin, else it is "".
    """
    if not enclosed:
        return ""
    if cabin_barometers:
        return f"{cabin_barometers} is in a closed compartment: it does not follow the height"
    return (
        f"{', '.join(enclosed)} is not used: it does not follow the height. The flight is below "
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
    finite_m = heights_m[np.isfinite(heights_m)]
    if finite_m.size == 0:
        return math.nan
    return float(np.max(finite_m))


def plausible_roles(
    roles: Mapping[str, Channel],
) -> tuple[dict[str, Channel], list[Proposed]]:
    """The channel of each role without implausible samples, and questions.

    A channel with values in a wrong unit is left out, with a question for its role.
    """
    plausible = {}
    questions = []
    for role, channel in roles.items():
        try:
            plausible[role], _ = plausible_samples(channel, role)
        except MissionError as error:
            questions.append(Proposed(role, TODO, f"{error.what}; {error.remedy}"))
    return plausible, questions


def time_remark(log: Log) -> str:
    """Remark on the begin, end and duration of a log, and what its times count from."""
    minutes = f"{log.duration_s / 60.0:.1f} minutes; {log.time_base}"
    if not log.has_utc:
        return f"{minutes}: state the day of the flight, mission.date"
    first = utc_text(log.start_ns)[:19]
    last = utc_text(log.end_ns)[:19]
    return f"{first} to {last} UTC, {minutes}"


def place_remark(roles: Mapping[str, Channel]) -> str:
    """Remark on the median place of a flight; "" without positions."""
    position = roles.get("position")
    if position is None or len(position) == 0:
        return ""
    longitude_rad = position["lon_rad"]
    finite_rad = longitude_rad[np.isfinite(longitude_rad)]
    if finite_rad.size == 0:
        return ""
    # Continuous across 180 degrees, where a median of wrapped longitudes would be wrong.
    continuous_rad = longitudes_near(finite_rad, finite_rad[0])
    median_rad = np.median(continuous_rad, keepdims=True)
    latitude_deg = np.degrees(np.nanmedian(position["lat_rad"]))
    longitude_deg = np.degrees(wrapped(median_rad))[0]
    return f"place: latitude {latitude_deg:.4f}, longitude {longitude_deg:.4f}"


def heights_remark(roles: Mapping[str, Channel], takeoff: str) -> str:
    """Remark on the heights of a flight and of its take-off; "" without heights.

    ``takeoff`` is the remark on the take-off.
    """
    height = roles.get("height")
    if height is None or height.height_column is None:
        return ""
    heights_m = height[height.height_column]
    heights_m = heights_m[np.isfinite(heights_m)]  # the column of a role has finite values
    span = f"heights {heights_m.min():.0f} to {heights_m.max():.0f} m"
    remark = f"{span} above {surface_of_heights(height)} ({height.name})"
    return f"{remark}; {takeoff}" if takeoff else remark


def takeoff_remark(roles: Mapping[str, Channel], evidence: GroundEvidence) -> str:
    """Remark on the height of the take-off; "" if the log does not show it."""
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
    """The surface that the heights of a channel count from, in words."""
    return "the sea" if height.height_column == "h_msl_m" else "the ellipsoid"


def gimbal_channels(log: Log) -> list[str]:
    """Names of the channels with attitudes of gimbals."""
    return [channel.name for channel in log.channels if is_of_gimbal(channel.source.message)]


def late_events(log: Log, events: tuple[Channel, ...]) -> list[str]:
    """Names of channels of events that have the times of the triggers, each once."""
    late: dict[str, None] = {}  # the names in their order, each once
    for channel in events:
        for note in trigger_notes(log.channels, channel, log.parameters):
            if note.code == LATE_TRIGGER:
                late[channel.name] = None
    for note in log.ledger:
        if note.code == LATE_TRIGGER:
            late[note.where] = None
    return list(late)


def channels_of_lowest_rank(channels: list[Channel]) -> tuple[Channel, ...]:
    """All channels that have the lowest, that is the best, rank among ``channels``."""
    lowest = min((channel.rank for channel in channels), default=0)
    return tuple(channel for channel in channels if channel.rank == lowest)


def questions_of_role(role: str, channels: tuple[Channel, ...], compartment: str) -> list[Proposed]:
    """The questions about a role that several channels could play, or no channel.

    If there are barometers in a ``compartment`` (their names, "" for none), a candidate may be the
    sensor of the cabin, which is a second question.
    """
    fitting = [channel for channel in channels if role in channel.roles and channel.fits_role(role)]
    candidates = channels_of_lowest_rank(fitting)
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
    """The range of a sensor's finite readings in a usual unit, as " (10 to 25 °C)".

    "" for a channel without finite readings, or with a column without a usual unit.
    """
    column = ROLE_COLUMNS[role][0]
    unit, unit_size, zero = words_of_proposals()["units"].get(column, ("", 1.0, 0.0))
    readings = channel[column]
    in_unit = readings[np.isfinite(readings)] / unit_size - zero
    if not unit or not in_unit.size:
        return ""
    return f" ({in_unit.min():.0f} to {in_unit.max():.0f} {unit})"
