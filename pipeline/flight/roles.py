"""Which channel plays which role: named by the user, or found where it is unambiguous."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.hypsometry import fall_of_pressure
from pipeline.errors import MissionError
from pipeline.flight.channels import ROLE_COLUMNS, Channel
from pipeline.flight.trajectory import interpolate
from pipeline.ledger import Ledger

Array = NDArray[np.float64]

# Roles of which a second sensor is a spare: the first of several equals is taken.
_SPARES = {"position", "height", "attitude"}


def assign_roles(
    channels: Iterable[Channel],
    wishes: Mapping[str, str],
    ledger: Ledger,
    *,
    needs_cabin: bool,
) -> dict[str, Channel]:
    """The channel of each role that can be filled, by role.

    Parameters
    ----------
    channels : all channels of the log.
    wishes : role -> channel named in the mission file.
    ledger : receives each choice, and each role left empty.
    needs_cabin : whether the window asks for cabin air from the log.

    Named channels that are absent refuse the mission where the role is needed, and are a loss in
    the ledger where it is not. ``aircraft_attitude`` is only ever named. The event channels are
    chosen by `exposures`, one a camera.
    """
    everything = tuple(channels)
    required = {"position", "attitude", "aircraft_attitude", "cabin_pressure", "cabin_temperature"}
    filled: dict[str, Channel] = {}
    for role, name in wishes.items():
        channel = _named(everything, role, name, role in required, ledger)
        if channel is not None:
            filled[role] = channel
    _refuse_twins(filled)
    taken = {channel.name for channel in filled.values()}
    for role in ("height", "position", "attitude", "airspeed"):
        _fill(filled, role, everything, ledger, wishes)
    if "height" not in filled and "position" in filled:
        filled["height"] = filled["position"]
    _fill_barometers(filled, everything, taken, ledger, wishes, needs_cabin)
    for role in ("temperature", "humidity"):
        inside = f"cabin_{role}"
        if needs_cabin and not {role, inside} & (filled.keys() | wishes.keys()):
            _warn_of_both(role, everything, ledger)
            continue
        _fill(filled, role, everything, ledger, wishes)
        if needs_cabin:
            _fill(filled, inside, everything, ledger, wishes)
    needed = ["position", "attitude"] + (["cabin_pressure", "cabin_temperature"] * needs_cabin)
    for role in needed:
        if role not in filled and role not in wishes:
            there = ", ".join(channel.name for channel in everything) or "no channel at all"
            ledger.loss(
                "CHANNEL-MISSING",
                f"no channel of the log can be taken for the {role.replace('_', ' ')}; it has "
                f"{there}",
                where=f"log.channels.{role}",
            )
    return filled


def _named(
    channels: tuple[Channel, ...], role: str, name: str, required: bool, ledger: Ledger
) -> Channel | None:
    """The channel that the mission file names for a role."""
    by_name = {channel.name: channel for channel in channels}
    channel = by_name.get(name)
    if channel is not None and channel.fits_role(role):
        return channel
    able = [c.name for c in channels if c.fits_role(role)]
    near = difflib.get_close_matches(name, by_name, 3, 0.4)
    if channel is not None:
        what = f"{name} has no {', '.join(ROLE_COLUMNS[role])}; it has {', '.join(channel.columns)}"
    else:
        what = f"the log has no channel {name!r}" + (f" (near: {', '.join(near)})" if near else "")
    instead = f"could play this role: {', '.join(able)}" if able else "nothing else could play it"
    if role == "temperature" and channel is not None and "board_temperature_k" in channel.columns:
        instead += "; atmosphere.board_temperature: true takes its board's, less some 10 K"
    if required:
        raise MissionError(
            "CHANNEL-MISSING",
            f"{what}; {instead}",
            where=f"log.channels.{role}",
            remedy="name a channel as `unbend inspect` prints it",
        )
    ledger.loss("CHANNEL-MISSING", f"{what}; {instead}", where=f"log.channels.{role}")
    return None


def _refuse_twins(filled: Mapping[str, Channel]) -> None:
    """Refuse one channel for the air outside and in the cabin."""
    for role in ("pressure", "temperature", "humidity"):
        outside, inside = filled.get(role), filled.get(f"cabin_{role}")
        if outside is not None and inside is not None and outside.name == inside.name:
            raise MissionError(
                "CHANNEL-TWICE",
                f"{outside.name} is named for the {role} outside and in the cabin",
                where=f"log.channels.{role}, log.channels.cabin_{role}",
                remedy="name two sensors, or leave the window away where there is no cabin",
            )


def _fill(
    filled: dict[str, Channel],
    role: str,
    channels: tuple[Channel, ...],
    ledger: Ledger,
    wishes: Mapping[str, str],
) -> None:
    """Fill a role that was not named, from the candidates of the best rank."""
    if role in filled or role in wishes:
        return
    candidates = [c for c in channels if role in c.roles and c.fits_role(role)]
    # A channel may serve a role it was not named for, except that inside is never outside.
    used = {
        c.name for r, c in filled.items() if r.startswith("cabin_") != role.startswith("cabin_")
    }
    candidates = [c for c in candidates if c.name not in used]
    while candidates:
        best = min(candidate.rank for candidate in candidates)
        equals = [candidate for candidate in candidates if candidate.rank == best]
        if len(equals) == 1 or role in _SPARES:
            filled[role] = equals[0]
            ledger.note("ROLE", f"{role.replace('_', ' ')}: {equals[0].name}", where=role)
            return
        ledger.warning(
            "ROLE-AMBIGUOUS",
            f"{', '.join(c.name for c in equals)} could each be the {role.replace('_', ' ')}; "
            "none of them is used",
            where=f"log.channels.{role}",
        )
        candidates = [candidate for candidate in candidates if candidate.rank > best]


def _warn_of_both(role: str, channels: tuple[Channel, ...], ledger: Ledger) -> None:
    """A sensor that may sit outside or in the cabin is not guessed at, if both are asked for."""
    either = [c.name for c in channels if {role, f"cabin_{role}"} <= set(c.roles)]
    if either:
        ledger.warning(
            "ROLE-AMBIGUOUS",
            f"{', '.join(either)}: is it the {role} outside or in the cabin? none of them is used; "
            f"name log.channels.{role} and log.channels.cabin_{role}",
            where=f"log.channels.{role}",
        )


def _fill_barometers(
    filled: dict[str, Channel],
    channels: tuple[Channel, ...],
    taken: set[str],
    ledger: Ledger,
    wishes: Mapping[str, str],
    needs_cabin: bool,
) -> None:
    """Tell the barometer outside from the one in the cabin by how pressure follows height."""
    free = [c for c in channels if "pressure" in c.roles and c.name not in taken]
    free.sort(key=lambda channel: (channel.rank, channel.name))
    height = filled.get("height")
    settled = filled.keys() | wishes.keys()
    seek_cabin = needs_cabin and "cabin_pressure" not in settled
    if height is None or ("pressure" in settled and not seek_cabin):
        return
    indoors = [channel for channel in free if follows_height(channel, height) is False]
    if "pressure" not in settled:
        for channel in indoors:
            ledger.note(
                "BARO-NOT-OUTSIDE",
                f"{channel.name} does not follow the GNSS height as outside air does: it is taken "
                "for a barometer in a closed compartment",
                where=channel.name,
            )
        outside = [channel for channel in free if channel not in indoors]
        if outside:
            filled["pressure"] = outside[0]
            ledger.note("ROLE", f"pressure: {outside[0].name}", where="pressure")
    if not seek_cabin:
        return
    if len(indoors) == 1:
        filled["cabin_pressure"] = indoors[0]
        ledger.note("ROLE", f"cabin pressure: {indoors[0].name}", where="cabin_pressure")
    elif indoors:
        ledger.warning(
            "ROLE-AMBIGUOUS",
            f"{', '.join(c.name for c in indoors)} could each be the cabin pressure",
            where="log.channels.cabin_pressure",
        )


def follows_height(barometer: Channel, height: Channel) -> bool | None:
    """Whether a barometer's pressure falls with GNSS height as free air does.

    The mean temperature that the fall of ln p implies must be one of air, and a parabola leave
    less than 1 % of pressure unexplained. None where the flight spans under 300 m of height, too
    little to tell.
    """
    column = height.height_column
    if column is None:
        return None
    h = interpolate(height, column, barometer.time_ns, max_gap_s=5.0)
    p = barometer["pressure_pa"]
    use = np.isfinite(h) & (p > 0.0)
    if use.sum() < 10 or float(np.ptp(h[use])) < 300.0:
        return None
    fall = fall_of_pressure(h[use], np.log(p[use]))
    return fall.is_of_air and fall.unexplained < 0.01
