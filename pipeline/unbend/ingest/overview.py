"""Summary of the flight of a log, and the channel that a mission would take for each role."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from unbend.atmosphere.rejection import count_by_reason, described_counts
from unbend.errors import MissionError
from unbend.flight.channels import Channel
from unbend.flight.evidence.impossible_samples import plausible_samples
from unbend.flight.evidence.sources import is_receiver
from unbend.flight.ground_times import NOTHING_SAID, GroundEvidence, LoggedPath, takeoff_of
from unbend.flight.heights import height_system
from unbend.flight.interpolation import interpolate
from unbend.flight.roles import assign_roles, follows_height
from unbend.flight.vehicles import Vehicles, median_distance_m
from unbend.ingest.utc_evidence import date_text, is_utc_time
from unbend.messages import Notes
from unbend.units import NANOSECONDS_PER_SECOND, Array

_ROLES = ("position", "height", "attitude", "pressure", "temperature", "humidity", "airspeed")
_CABIN = ("cabin_pressure", "cabin_temperature", "cabin_humidity")

MAX_HEIGHT_GAP_S = 5.0  # the longest gap across which heights are interpolated
HEIGHT_PERCENTILES = (0.1, 99.9)  # lowest and highest: single wrong samples are outside
SEA_LEVEL = "sea level"
_HEIGHT_REFERENCES = {"h_msl_m": SEA_LEVEL, "h_ellipsoid_m": "ellipsoid"}


def flight_of(
    position: Channel,
    height: Channel,
    evidence: GroundEvidence = NOTHING_SAID,
    home_m: float | None = None,
) -> dict[str, Any]:
    """Place, day and heights of a flight, from its channels of position and height.

    Latitude and longitude are those of the first known position, to 0.001 degrees (100 m).
    ``lowest_m`` and ``highest_m`` above ``height_reference`` are the percentiles
    `HEIGHT_PERCENTILES`. ``duration_s`` is the time from the first sample of the position to the
    last. The take-off is as of `_take_off`. Unknown values are None; without any position the
    result is empty.
    """
    lat_rad = position["lat_rad"]
    lon_rad = position["lon_rad"]
    has_place = np.isfinite(lat_rad + lon_rad)
    if not bool(has_place.any()):
        return {}
    column = height.height_column
    heights_m = np.full(len(position), np.nan)
    if column is not None:
        heights_m = interpolate(height, column, position.time_ns, max_gap_s=MAX_HEIGHT_GAP_S)
    lowest_m, highest_m = _limits_of_heights(heights_m)
    reference = _HEIGHT_REFERENCES.get(str(column))
    first = int(np.argmax(has_place))
    start_ns = int(position.time_ns[first])
    duration_s = (int(position.time_ns[-1]) - int(position.time_ns[0])) / NANOSECONDS_PER_SECOND
    return {
        "lat_deg": round(float(np.degrees(lat_rad[first])), 3),
        "lon_deg": round(float(np.degrees(lon_rad[first])), 3),
        "date_utc": date_text(start_ns) if is_utc_time(start_ns) else None,
        "duration_s": round(duration_s, 3),
        "height_reference": reference,
        "lowest_m": lowest_m,
        "highest_m": highest_m,
        **_take_off(position, heights_m, reference, evidence, home_m),
    }


def _take_off(
    position: Channel,
    heights_m: Array,
    reference: str | None,
    evidence: GroundEvidence,
    home_m: float | None,
) -> dict[str, Any]:
    """The height of the take-off, what it counts from, and how it is known.

    It is ``home_m``, the height above sea level that the log states, if it is given. Else it is the
    height at the begin of the log, above ``reference``. That is None if the vehicle moves there, or
    hovers by the ``evidence``, or if its height is unknown.
    """
    if home_m is not None:
        return {
            "take_off_m": round(home_m, 1),
            "take_off_reference": SEA_LEVEL,
            "take_off_by": "home of the autopilot",
        }
    path = LoggedPath(
        time_ns=position.time_ns,
        latitude_rad=position["lat_rad"],
        longitude_rad=position["lon_rad"],
        h_msl_m=heights_m,  # above `reference`; only its value at the begin is used
    )
    begin = takeoff_of(path, home_m=None, evidence=evidence)
    return {
        "take_off_m": None if begin is None else round(begin.h_msl_m, 1),
        "take_off_reference": reference,
        "take_off_by": "begin of the log",
    }


def _limits_of_heights(heights_m: Array) -> list[float | None]:
    """The lowest and the highest height at `HEIGHT_PERCENTILES`; None for both without heights."""
    known_m = heights_m[np.isfinite(heights_m)]
    if not known_m.size:
        return [None, None]
    limits_m: list[float | None] = np.percentile(known_m, HEIGHT_PERCENTILES).round(1).tolist()
    return limits_m


def roles_of(channels: Sequence[Channel]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The flight as by `flight_of`, and a row for each role with the channel chosen automatically.

    A row has ``rate_hz`` and ``samples`` of the channel, a ``remark`` (how good the samples are, or
    why no channel is chosen), and ``others``: channels that a mission file may name instead. The
    flight is empty without a channel of positions or of heights.
    """
    chosen, notes = assign_roles(channels, {}, needs_cabin=False)
    position = chosen.get("position")
    height = chosen.get("height")
    rows = []
    for role in (*_ROLES, *_CABIN, "events"):
        candidates = [channel.name for channel in channels if _can_play(channel, role)]
        channel = chosen.get(role)
        if channel is None:
            rows.append(_row(role, candidates, _why_none(role, candidates, notes)))
        else:
            rows.append(_row(role, candidates, remark_on(channel, role, height), channel))
    flight = {}
    if position is not None and height is not None:
        system, _ = height_system({"position": _plausible(position, "position")}, None)
        flight = flight_of(
            position, height, GroundEvidence.of(channels), home_m=system.home_h_msl_m
        )
    return flight, rows


def _plausible(channel: Channel, role: str) -> Channel:
    """The channel without implausible samples; unchanged if its unit is of another quantity."""
    try:
        kept, _ = plausible_samples(channel, role)
    except MissionError:
        return channel
    return kept


def vehicles_of(channels: Sequence[Channel]) -> list[dict[str, Any]]:
    """The flight and the roles of each vehicle; empty for a log of one vehicle."""
    vehicles = Vehicles.of(channels)
    rows = []
    for name in vehicles.names:
        flight, roles = roles_of(vehicles.channels_of(name, channels))
        rows.append({"vehicle": name, "flight": flight, "roles": roles})
    return rows


def receivers_of(channels: Sequence[Channel]) -> list[dict[str, Any]]:
    """A row for each receiver of a log: its vehicle, the roles it is used for, and why.

    With several vehicles each receiver is of one of them, because a sender of positions is a
    vehicle (`Vehicles.of`). A receiver of none would be left out.
    """
    vehicles = Vehicles.of(channels)
    rows = []
    for name in vehicles.names or ("",):  # "": a log of one vehicle does not name it
        of_vehicle = vehicles.channels_of(name, channels)
        chosen, _ = assign_roles(of_vehicle, {}, needs_cabin=False)
        for channel in of_vehicle:
            # a channel of no vehicle is among the channels of each
            if is_receiver(channel) and vehicles.of_channel(channel) == name:
                rows.append(
                    {
                        "channel": channel.name,
                        "vehicle": name,
                        "good_for": _use_of_receiver(channel, chosen),
                        "why": _why_of_receiver(channel, chosen),
                    }
                )
    return rows


def _use_of_receiver(channel: Channel, chosen: Mapping[str, Channel]) -> str:
    """The roles of a receiver; without a role, the channel of height that it can replace."""
    roles = [role for role in ("position", "height") if chosen.get(role) is channel]
    if roles:
        return ", ".join(roles)
    height = chosen.get("height")
    return "spare" if height is None else f"spare of {height.name}"


def _why_of_receiver(channel: Channel, chosen: Mapping[str, Channel]) -> str:
    """Its reported accuracy, its distance from the chosen position, and its early end."""
    reasons = []
    sigma_m = channel.get("sigma_h_m")
    hdop = channel.get("hdop")
    if np.isfinite(sigma_m).any():
        reasons.append(f"± {np.nanmedian(sigma_m):.2g} m, as reported")
    elif np.isfinite(hdop).any():
        reasons.append(f"HDOP {np.nanmedian(hdop):.2g}")
    else:
        reasons.append("no report of its accuracy")
    position = chosen.get("position")
    if position is not None and position is not channel:
        apart_m = median_distance_m(position, channel)
        if np.isfinite(apart_m):
            reasons.append(f"{apart_m:.1f} m from {position.name} in the median")
        silent_ns = int(position.time_ns[-1]) - int(channel.time_ns[-1])
        silent_s = silent_ns / NANOSECONDS_PER_SECOND
        if silent_s > MAX_HEIGHT_GAP_S:
            reasons.append(f"silent in the last {silent_s:.0f} s")
    return ", ".join(reasons)


def _row(
    role: str, candidates: Sequence[str], remark: str, channel: Channel | None = None
) -> dict[str, Any]:
    """The row of a role (`roles_of`); ``channel`` is None if none of the candidates is chosen."""
    name = None if channel is None else channel.name
    return {
        "role": role,
        "channel": name,
        "rate_hz": None if channel is None else channel.rate_hz,
        "samples": None if channel is None else len(channel),
        "others": [other for other in candidates if other != name],
        "remark": remark,
    }


def _can_play(channel: Channel, role: str) -> bool:
    """Whether a channel is a candidate for a role without being named, with all columns for it."""
    return role in channel.roles and channel.fits_role(role)


def _why_none(role: str, candidates: Sequence[str], notes: Notes) -> str:
    """Why none of the candidates is chosen for a role; ``notes`` are those of `assign_roles`."""
    if not candidates:
        return "none in the log"
    if role == "events":
        return "named for each camera: events.log"
    if role in _CABIN:
        return "only if a camera has a window"
    key = f"log.channels.{role}"
    if any(note.where == key for note in notes):
        return f"several are equal: name one ({key})"
    return f"none follows the height ({key})"


def remark_on(channel: Channel, role: str, height: Channel | None) -> str:
    """How good the samples of a channel are for a role, in a few words.

    The first remark that applies: the unit is of another quantity; samples are not used, and why;
    the pressure follows the height or not; the samples are plausible. ``height``: the channel
    chosen for that role, None without one.
    """
    try:
        kept, _ = plausible_samples(channel, role)
    except MissionError as error:  # a unit of another quantity
        return error.what
    rejected = count_by_reason([kept.removed.reason])
    if rejected:
        total = len(kept) + len(kept.removed)
        return f"not used of {total} samples: {described_counts(rejected)}"
    if role == "pressure" and height is not None:
        if follows_height(channel, height):
            return "follows the height"
        return "the range of heights is too small to decide if it is outside"
    return "plausible"
