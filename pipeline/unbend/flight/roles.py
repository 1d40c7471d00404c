"""Which channel plays which role: named by the user, or chosen where it is unambiguous."""

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.interpolation import interpolate
from unbend.messages import Message, Notes
from unbend.units import NANOSECONDS_PER_SECOND

# Roles of which a second sensor is a spare: the first of several equals is taken.
_SPARES = {"position", "height", "attitude"}

# Roles without which nothing can be corrected, if the mission file names a channel for them.
_REQUIRED = {"position", "attitude", "aircraft_attitude", "cabin_pressure", "cabin_temperature"}

_NAMES_PROPOSED = 3  # for a name that the log does not have
_LEAST_SIMILARITY = 0.4  # of a proposed name, as difflib counts it

_LEAST_HEIGHT_SPAN_M = 300.0  # over less, a closed compartment cannot be told from free air [m]
_FEWEST_PRESSURES = 10
_LARGEST_UNEXPLAINED = 0.01  # part of the pressure's variation that a parabola may leave
_HEIGHT_GAP_S = 5.0
LONGEST_SILENCE_S = 10.0  # of a barometer before the end of the heights, that a spare is not needed


def assign_roles(
    channels: Iterable[Channel],
    named: Mapping[str, str],
    *,
    needs_cabin: bool,
    elsewhere: Collection[str] = (),
    empty: Collection[str] = (),
) -> tuple[dict[str, Channel], Notes]:
    """The channel of each role that can be filled, by role.

    ``named``: role -> channel named in the mission file. ``needs_cabin``: whether the window asks
    for cabin air from the log. ``elsewhere``: roles that a file other than the log fills.
    ``empty``: roles that no channel may play, as the mission file says.

    The notes hold each choice, and each role left empty. Named channels that are absent refuse the
    mission where the role is needed, and are a loss where it is not. ``aircraft_attitude`` is only
    ever named; `choose_event_channel` chooses those of events, one for each camera.
    """
    all_channels = tuple(channels)
    filled, notes = _named_roles(all_channels, named)
    _refuse_one_sensor_twice(filled)
    named_channels = {channel.name for channel in filled.values()}
    free = [channel for channel in all_channels if channel.name not in named_channels]
    notes += [messages.role_left_empty(role=role) for role in sorted(empty)]
    stated_roles = {*named, *empty}
    for role in ("height", "position", "attitude", "airspeed"):
        notes += _fill(filled, role, all_channels, stated_roles)
    if "height" not in {*filled, *empty} and "position" in filled:
        filled["height"] = filled["position"]
    # After the height, by which a barometer outside is told from one in the cabin.
    notes += _fill_barometers(filled, free, stated_roles, needs_cabin=needs_cabin)
    for role in ("temperature", "humidity"):
        notes += _fill_outside_and_cabin(
            filled, role, all_channels, stated_roles, needs_cabin=needs_cabin
        )
    for role in ("position", "attitude"):  # what the cabin lacks is reported camera by camera
        if role not in {*filled, *stated_roles, *elsewhere}:
            names = list(dict.fromkeys(channel.name for channel in all_channels))
            notes.append(messages.role_empty(role=role, channels=names))
    return filled, tuple(notes)


def _named_roles(
    channels: tuple[Channel, ...], named: Mapping[str, str]
) -> tuple[dict[str, Channel], list[Message]]:
    """The roles for which the mission file names a channel that is there and fits.

    The messages report the roles whose named channel does not.
    """
    by_name = {channel.name: channel for channel in channels}
    filled: dict[str, Channel] = {}
    notes: list[Message] = []
    for role, name in named.items():
        channel = by_name.get(name)
        if channel is not None and channel.fits_role(role):
            filled[role] = channel
        else:
            absent = [other for other in dict.fromkeys(named.values()) if other not in by_name]
            notes.append(_named_but_absent(channels, role, name, absent))
    return filled, notes


def _named_but_absent(
    channels: tuple[Channel, ...], role: str, name: str, absent: list[str]
) -> Message:
    """The loss of a role whose named channel is absent or does not fit.

    ``absent`` : all named channels that the log does not have. Raises MissionError where the role
    is needed.
    """
    candidates = [channel.name for channel in channels if channel.fits_role(role)]
    named_channel = next((channel for channel in channels if channel.name == name), None)
    if named_channel is None:
        columns = None
        names = [channel.name for channel in channels]
        similar = difflib.get_close_matches(name, names, _NAMES_PROPOSED, _LEAST_SIMILARITY)
    else:
        columns = list(named_channel.columns)
        similar = []
    why = messages.why_channel_is_missing(
        name=name, needed=ROLE_COLUMNS[role], columns=columns, near=similar
    )
    if role in _REQUIRED:
        also_missing = [other for other in absent if other != name]
        raise messages.required_channel_missing(
            role=role, why=why, able=candidates, also_missing=also_missing
        )
    has_board = columns is not None and "board_temperature_k" in columns
    return messages.named_channel_missing(
        role=role, why=why, able=candidates, board=has_board and role == "temperature"
    )


def _refuse_one_sensor_twice(filled: Mapping[str, Channel]) -> None:
    """Refuse (MissionError CHANNEL-TWICE) a sensor named for outside and for the cabin."""
    for role in ("pressure", "temperature", "humidity"):
        outside = filled.get(role)
        inside = filled.get(f"cabin_{role}")
        if outside is not None and inside is not None and outside.name == inside.name:
            raise messages.channel_twice(name=outside.name, role=role)


def _fill(
    filled: dict[str, Channel], role: str, channels: tuple[Channel, ...], stated: Collection[str]
) -> Iterator[Message]:
    """Fill a role that was not stated with the only candidate of the best rank.

    Where several have a rank, none of them gets the role and the next rank is tried; but in the
    roles `_SPARES` the first of several gets it.
    """
    if role in filled or role in stated:
        return
    candidates = _candidates(filled, role, channels)
    for rank in sorted({channel.rank for channel in candidates}):
        equals = [channel for channel in candidates if channel.rank == rank]
        if len(equals) == 1 or role in _SPARES:
            filled[role] = equals[0]
            yield messages.role_filled(role=role, channel=equals[0].name)
            return
        names = [channel.name for channel in equals]
        yield messages.role_ambiguous(role=role, candidates=names)


def _candidates(
    filled: Mapping[str, Channel], role: str, channels: tuple[Channel, ...]
) -> list[Channel]:
    """The channels that may take a role.

    A channel may have several roles, but not one outside and one in the cabin.
    """
    inside = role.startswith("cabin_")
    on_other_side = {
        channel.name
        for other_role, channel in filled.items()
        if other_role.startswith("cabin_") != inside
    }
    return [
        channel
        for channel in channels
        if role in channel.roles and channel.fits_role(role) and channel.name not in on_other_side
    ]


def _fill_outside_and_cabin(
    filled: dict[str, Channel],
    role: str,
    channels: tuple[Channel, ...],
    stated: Collection[str],
    *,
    needs_cabin: bool,
) -> Iterator[Message]:
    """Fill the role of a sensor outside, and of that in the cabin where it is needed.

    Where the cabin is needed and neither role is given, a sensor that may play either leaves both
    roles empty, and is reported.
    """
    cabin_role = f"cabin_{role}"
    given = {*filled, *stated}
    if needs_cabin and role not in given and cabin_role not in given:
        either = [
            channel.name
            for channel in channels
            if role in channel.roles and cabin_role in channel.roles
        ]
        if either:
            yield messages.outside_or_cabin(role=role, candidates=either)
            return
    yield from _fill(filled, role, channels, stated)
    if needs_cabin:
        yield from _fill(filled, cabin_role, channels, stated)


def _fill_barometers(
    filled: dict[str, Channel],
    free: list[Channel],
    stated: Collection[str],
    *,
    needs_cabin: bool,
) -> Iterator[Message]:
    """Fill the roles of the barometers outside and in the cabin, by how they follow the height.

    A barometer that does not follow it is in the cabin; one that does, or of which that cannot be
    decided, counts as outside. ``free``: the channels that are not named for a role.
    """
    height = filled.get("height")
    if height is None:
        return
    given = {*filled, *stated}
    seeks_outside = "pressure" not in given
    seeks_cabin = needs_cabin and "cabin_pressure" not in given
    if not (seeks_outside or seeks_cabin):
        return
    barometers = [channel for channel in free if "pressure" in channel.roles]
    barometers.sort(key=lambda channel: (channel.rank, channel.name))
    indoors = [channel for channel in barometers if follows_height(channel, height) is False]
    if seeks_outside:
        outdoors = [channel for channel in barometers if channel not in indoors]
        yield from _fill_outside_pressure(filled, outdoors, indoors, height)
    if seeks_cabin:
        yield from _fill_cabin_pressure(filled, indoors)


def _fill_outside_pressure(
    filled: dict[str, Channel], outdoors: list[Channel], indoors: list[Channel], height: Channel
) -> Iterator[Message]:
    """Fill the pressure outside with the first barometer that may be outside.

    One that falls silent before the flight ends gives way to the first that goes on.
    """
    for channel in indoors:
        yield messages.barometer_not_outside(channel=channel.name)
    if not outdoors:
        return
    first = outdoors[0]
    chosen = next((channel for channel in outdoors if _silent_s(channel, height) == 0.0), first)
    filled["pressure"] = chosen
    if chosen is first:
        yield messages.role_filled(role="pressure", channel=first.name)
    else:
        yield messages.spare_plays_all(
            role="pressure",
            channel=first.name,
            spare=chosen.name,
            seconds=_silent_s(first, height),
        )


def _silent_s(channel: Channel, height: Channel) -> float:
    """How long [s] a channel has ended before the heights do; 0 for less than ten seconds."""
    if len(channel) == 0 or len(height) == 0:
        return 0.0
    silent_ns = int(height.time_ns[-1]) - int(channel.time_ns[-1])  # of numpy, they may overflow
    silent_s = silent_ns / NANOSECONDS_PER_SECOND
    return silent_s if silent_s > LONGEST_SILENCE_S else 0.0


def _fill_cabin_pressure(filled: dict[str, Channel], indoors: list[Channel]) -> Iterator[Message]:
    """Fill the pressure of the cabin, if exactly one barometer is in a closed compartment."""
    if len(indoors) == 1:
        filled["cabin_pressure"] = indoors[0]
        yield messages.role_filled(role="cabin_pressure", channel=indoors[0].name)
    elif indoors:
        names = [channel.name for channel in indoors]
        yield messages.role_ambiguous(role="cabin_pressure", candidates=names)


def follows_height(barometer: Channel, height: Channel) -> bool | None:
    """Whether a barometer's pressure falls with GNSS height as free air does.

    That is so if the mean temperature that the fall of ln p implies is one of air, and a parabola
    leaves less than 1 % of the variation of pressure unexplained. None where that cannot be
    decided: fewer than ten pressures have a height, or these span under 300 m.
    """
    column = height.height_column
    if column is None:
        return None
    height_m = interpolate(height, column, barometer.time_ns, max_gap_s=_HEIGHT_GAP_S)
    pressure_pa = barometer["pressure_pa"]
    is_known = np.isfinite(height_m) & (pressure_pa > 0.0)
    if np.count_nonzero(is_known) < _FEWEST_PRESSURES:
        return None
    if float(np.ptp(height_m[is_known])) < _LEAST_HEIGHT_SPAN_M:
        return None
    from unbend.atmosphere.hypsometry import fall_of_pressure  # with all of the atmosphere

    fall = fall_of_pressure(height_m[is_known], np.log(pressure_pa[is_known]))
    return fall.is_of_air and fall.unexplained < _LARGEST_UNEXPLAINED
