"""What a log says of its flight, and which channel a mission would take for each role."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from unbend.atmosphere.rejection import Reason, count_by_reason, described_counts
from unbend.errors import MissionError
from unbend.flight.channels import Channel
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.roles import assign_roles, follows_height
from unbend.flight.trajectory import interpolate, takeoff_of

_ROLES = ("position", "height", "attitude", "pressure", "temperature", "humidity", "airspeed")
_CABIN = ("cabin_pressure", "cabin_temperature", "cabin_humidity")


def flight_of(position: Channel, height: Channel) -> dict[str, Any]:
    """Place, day and heights of a flight, from its channels of position and height.

    Latitude and longitude where the log begins, to 0.001 degrees (100 m). Heights [m] above
    ``height_reference``, 0.1 to 99.9 percentile; ``take_off_m`` where the log begins standing
    still.
    """
    known = np.isfinite(position["lat_rad"] + position["lon_rad"])
    if not bool(known.any()):
        return {}
    column = height.height_column
    h = np.full(len(position), np.nan)
    if column is not None:
        h = interpolate(height, column, position.time_ns, max_gap_s=5.0)
    lat, lon = position["lat_rad"], position["lon_rad"]
    start = takeoff_of((position.time_ns, lat, lon, h), None)
    first = int(np.argmax(known))
    some = h[np.isfinite(h)]
    low, high = np.percentile(some, (0.1, 99.9)).round(1).tolist() if some.size else (None, None)
    return {
        "lat_deg": round(float(np.degrees(lat[first])), 3),
        "lon_deg": round(float(np.degrees(lon[first])), 3),
        "date_utc": str(np.datetime64(int(position.time_ns[first]), "ns").astype("datetime64[D]")),
        "duration_s": round(float(position.time_ns[-1] - position.time_ns[0]) / 1e9, 3),
        "height_reference": {"h_msl_m": "sea level", "h_ellipsoid_m": "ellipsoid"}.get(str(column)),
        "lowest_m": low,
        "highest_m": high,
        "take_off_m": None if start is None else round(start.h_msl_m, 1),
    }


def roles_of(channels: Sequence[Channel]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The flight (`flight_of`), and for each role its channel as of a mission file that names none.

    ``rate_hz``, ``samples``, a ``remark`` (true samples, or what lacks), ``others`` to be named.
    """
    chosen, notes = assign_roles(channels, {}, needs_cabin=False)
    height = chosen.get("height")
    rows = []
    for role in (*_ROLES, *_CABIN, "events"):
        able = [c.name for c in channels if role in c.roles and c.fits_role(role)]
        channel = chosen.get(role)
        named = channel.name if channel is not None else None
        row: dict[str, Any] = {
            "role": role, "channel": named, "rate_hz": None, "samples": None,
            "others": [name for name in able if name != named],
        }  # fmt: skip
        if channel is not None:
            rejected = rejected_samples(channel, role)
            row |= {"rate_hz": channel.rate_hz, "samples": len(channel)}
            row["rejected"] = {reason.text: count for reason, count in rejected.items()}
            row["remark"] = remark_on(channel, role, height)
        elif not able:
            row["remark"] = "none in the log"
        elif role == "events":
            row["remark"] = "named for each camera: events.log"
        elif role in _CABIN:
            row["remark"] = "only where a camera has a window"
        else:
            ambiguous = any(e.where == f"log.channels.{role}" for e in notes)
            why = "several are equal: name one" if ambiguous else "none follows the height"
            row["remark"] = f"{why} (log.channels.{role})"
        rows.append(row)
    found = chosen.get("position")
    flight = {} if found is None or height is None else flight_of(found, height)
    return flight, rows


def rejected_samples(channel: Channel, role: str) -> dict[Reason, int]:
    """How many samples of a channel its role does not use, and why; none where its unit is wrong.

    What only a mission decides (heights, take-off) is not counted.
    """
    try:
        kept, _ = plausible_samples(channel, role)
    except MissionError:
        return {}
    return count_by_reason([kept.removed.reason])


def remark_on(channel: Channel, role: str, height: Channel | None) -> str:
    """Whether the samples of a channel can be what its role asks for, in a few words."""
    try:
        kept, _ = plausible_samples(channel, role)
    except MissionError as error:  # another unit
        return error.what
    rejected = count_by_reason([kept.removed.reason])
    if rejected:
        total = len(kept) + len(kept.removed)
        return f"not used of {total} samples: {described_counts(rejected)}"
    if role == "pressure" and height is not None:
        follows = follows_height(channel, height)
        return "follows the height" if follows else "too little height to tell if it is outside"
    return "plausible"
