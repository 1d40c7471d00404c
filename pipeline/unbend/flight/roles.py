"""Which channel plays which role: named by the user, or chosen where it is unambiguous."""

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.trajectory import interpolate
from unbend.messages import Entry, Notes, loss, note, warning

# Roles of which a second sensor is a spare: the first of several equals is taken.
_SPARES = {"position", "height", "attitude"}

# Roles without which nothing can be corrected, if the mission file names a channel for them.
_REQUIRED = {"position", "attitude", "aircraft_attitude", "cabin_pressure", "cabin_temperature"}


def assign_roles(
    channels: Iterable[Channel],
    named: Mapping[str, str],
    *,
    needs_cabin: bool,
    elsewhere: Collection[str] = (),
) -> tuple[dict[str, Channel], Notes]:
    """The channel of each role that can be filled, by role.

    ``named``: role -> channel named in the mission file. ``needs_cabin``: whether the window asks
    for cabin air from the log. ``elsewhere``: roles that a file other than the log fills.

    The notes hold each choice, and each role left empty. Named channels that are absent refuse the
    mission where the role is needed, and are a loss where it is not. ``aircraft_attitude`` is only
    ever named; `choose_event_channel` chooses those of events, one for each camera.
    """
    everything = tuple(channels)
    by_name = {channel.name: channel for channel in everything}
    filled: dict[str, Channel] = {}
    notes: list[Entry] = []
    for role, name in named.items():
        channel = by_name.get(name)
        if channel is not None and channel.fits_role(role):
            filled[role] = channel
        else:
            notes.append(_named_but_absent(everything, role, name))
    for role in ("pressure", "temperature", "humidity"):
        outside, inside = filled.get(role), filled.get(f"cabin_{role}")
        if outside is not None and inside is not None and outside.name == inside.name:
            where = f"log.channels.{role}, log.channels.cabin_{role}"
            raise MissionError.of("CHANNEL-TWICE", where, name=outside.name, role=role)
    free = [c for c in everything if c.name not in {c.name for c in filled.values()}]
    for role in ("height", "position", "attitude", "airspeed"):
        notes += _fill(filled, role, everything, named)
    if "height" not in filled and "position" in filled:
        filled["height"] = filled["position"]
    notes += _fill_barometers(filled, free, named, needs_cabin)
    for role in ("temperature", "humidity"):
        inside_role = f"cabin_{role}"
        if needs_cabin and not {role, inside_role} & (filled.keys() | named.keys()):
            # Where both are needed, a sensor that may be outside or in the cabin gets neither role.
            either = [c.name for c in everything if {role, inside_role} <= set(c.roles)]
            if either:
                where, listed = f"log.channels.{role}", ", ".join(either)
                notes.append(warning("ROLE-AMBIGUOUS/cabin", where=where, listed=listed, role=role))
            continue
        notes += _fill(filled, role, everything, named)
        if needs_cabin:
            notes += _fill(filled, inside_role, everything, named)
    for role in ("position", "attitude"):  # what the cabin lacks is reported camera by camera
        if role not in {*filled, *named, *elsewhere}:
            there, where = ", ".join(by_name) or "no channel at all", f"log.channels.{role}"
            notes.append(loss("CHANNEL-MISSING/role", where=where, role=role, there=there))
    return filled, tuple(notes)


def _named_but_absent(channels: tuple[Channel, ...], role: str, name: str) -> Entry:
    """A loss for a named channel that is absent or does not fit; MissionError if it is needed."""
    channel = next((c for c in channels if c.name == name), None)
    if channel is not None:
        what = f"{name} has no {', '.join(ROLE_COLUMNS[role])}; it has {', '.join(channel.columns)}"
    else:
        near = difflib.get_close_matches(name, [c.name for c in channels], 3, 0.4)
        what = f"the log has no channel {name!r}" + (f" (near: {', '.join(near)})" if near else "")
    able = [c.name for c in channels if c.fits_role(role)]
    what += f"; could play this role: {', '.join(able)}" if able else "; nothing else could play it"
    if role == "temperature" and channel is not None and "board_temperature_k" in channel.columns:
        what += "; atmosphere.board_temperature: true takes its board's, less some 10 K"
    if role in _REQUIRED:
        remedy = "name a channel as `unbend inspect` prints it"
        raise MissionError("CHANNEL-MISSING", what, where=f"log.channels.{role}", remedy=remedy)
    return loss("CHANNEL-MISSING", what, where=f"log.channels.{role}")


def _fill(
    filled: dict[str, Channel], role: str, channels: tuple[Channel, ...], named: Mapping[str, str]
) -> Iterator[Entry]:
    """Fill a role that was not named, from the candidates of the best rank."""
    if role in filled or role in named:
        return
    # A channel may serve a role it was not named for, except that inside is never outside.
    inside = role.startswith("cabin_")
    used = {c.name for r, c in filled.items() if r.startswith("cabin_") != inside}
    able = (c for c in channels if role in c.roles and c.fits_role(role))
    candidates = [c for c in able if c.name not in used]
    shown = role.replace("_", " ")
    while candidates:
        best = min(c.rank for c in candidates)
        equals = [c for c in candidates if c.rank == best]
        if len(equals) == 1 or role in _SPARES:
            filled[role] = equals[0]
            yield note("ROLE", f"{shown}: {equals[0].name}", where=role)
            break
        names = ", ".join(c.name for c in equals)
        what = f"{names} could each be the {shown}; none of them is used"
        yield warning("ROLE-AMBIGUOUS", what, where=f"log.channels.{role}")
        candidates = [c for c in candidates if c.rank > best]


def _fill_barometers(
    filled: dict[str, Channel], free: list[Channel], named: Mapping[str, str], needs_cabin: bool
) -> Iterator[Entry]:
    """Distinguish barometers outside and in the cabin by how their pressure follows height."""
    barometers = sorted((c for c in free if "pressure" in c.roles), key=lambda c: (c.rank, c.name))
    height = filled.get("height")
    settled = filled.keys() | named.keys()
    seek_cabin = needs_cabin and "cabin_pressure" not in settled
    if height is None or ("pressure" in settled and not seek_cabin):
        return
    indoors = [channel for channel in barometers if follows_height(channel, height) is False]
    if "pressure" not in settled:
        yield from (note("BARO-NOT-OUTSIDE", where=channel.name) for channel in indoors)
        outside = [channel for channel in barometers if channel not in indoors]
        if outside:
            filled["pressure"] = outside[0]
            yield note("ROLE", f"pressure: {outside[0].name}", where="pressure")
    if seek_cabin and len(indoors) == 1:
        filled["cabin_pressure"] = indoors[0]
        yield note("ROLE", f"cabin pressure: {indoors[0].name}", where="cabin_pressure")
    elif seek_cabin and indoors:
        what = f"{', '.join(c.name for c in indoors)} could each be the cabin pressure"
        yield warning("ROLE-AMBIGUOUS", what, where="log.channels.cabin_pressure")


def follows_height(barometer: Channel, height: Channel) -> bool | None:
    """Whether a barometer's pressure falls with GNSS height as free air does.

    The mean temperature that the fall of ln p implies must be one of air, and a parabola leave
    less than 1 % of pressure unexplained. None where the flight spans under 300 m of height, too
    little to decide.
    """
    column = height.height_column
    if column is None:
        return None
    h = interpolate(height, column, barometer.time_ns, max_gap_s=5.0)
    p = barometer["pressure_pa"]
    use = np.isfinite(h) & (p > 0.0)
    if use.sum() < 10 or float(np.ptp(h[use])) < 300.0:
        return None
    from unbend.atmosphere.hypsometry import fall_of_pressure  # with all of the atmosphere

    fall = fall_of_pressure(h[use], np.log(p[use]))
    return fall.is_of_air and fall.unexplained < 0.01
