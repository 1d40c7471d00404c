"""Which channel plays which role: named in the mission file, or chosen if it is unambiguous."""

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.interpolation import interpolate
from unbend.messages import Message, Notes
from unbend.units import NANOSECONDS_PER_SECOND

# Roles for which the first of several channels of one rank is taken: the others are spares.
_FIRST_OF_EQUALS = {"position", "height", "attitude"}

# If the mission file names a channel for one of these roles, and it is absent, it is refused.
_REQUIRED = {"position", "attitude", "aircraft_attitude", "cabin_pressure", "cabin_temperature"}

_NAMES_PROPOSED = 3  # for a name that the log does not have
_LEAST_SIMILARITY = 0.4  # of a proposed name, as difflib counts it

# A barometer is compared with heights over this range or more [m]; over less, a closed compartment
# looks like free air.
_LEAST_HEIGHT_SPAN_M = 300.0
_FEWEST_PRESSURES = 10  # for the same comparison
_LARGEST_UNEXPLAINED = 0.01  # share of the pressure's variation that a parabola may leave
_HEIGHT_GAP_S = 5.0  # between heights
# A barometer that ends more than this before the heights is replaced by a spare [s].
LONGEST_SILENCE_S = 10.0


def assign_roles(
    channels: Iterable[Channel],
    named: Mapping[str, str],
    *,
    needs_cabin: bool,
    elsewhere: Collection[str] = (),
    empty: Collection[str] = (),
) -> tuple[dict[str, Channel], Notes]:
    """Choose a channel for each role; returns them by role, and notes on all choices.

    ``named``: role -> channel named in the mission file. ``needs_cabin``: whether the window needs
    cabin air from the log. ``elsewhere``: roles that a file other than the log fills. ``empty``:
    roles that no channel may play, by the mission file.

    A named channel that is absent refuses the mission if the role is needed, and is a loss if it is
    not. ``aircraft_attitude`` is filled only by name. The channels of events are chosen for each
    camera, by `choose_event_channel`.
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
    # After the height, which shows whether a barometer is outside or in the cabin.
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
    """The roles for which the mission file names a channel that exists and has their columns.

    A message reports each other role of ``named``.
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
    """The loss of a role if its named channel is absent, or lacks the columns of the role.

    ``name`` : of that channel. ``absent`` : all named channels that the log does not have. Refuses
    (MissionError CHANNEL-MISSING) if the role is needed.
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
        name=name, needed=ROLE_COLUMNS[role], columns=columns, similar=similar
    )
    if role in _REQUIRED:
        also_missing = [other for other in absent if other != name]
        raise messages.required_channel_missing(
            role=role, why=why, candidates=candidates, also_missing=also_missing
        )
    has_board = columns is not None and "board_temperature_k" in columns
    can_use_board = has_board and role == "temperature"
    return messages.named_channel_missing(
        role=role, why=why, candidates=candidates, can_use_board=can_use_board
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
    """Fill a role with the only candidate of the best rank, unless the mission file states it.

    Changes ``filled``. If several candidates have one rank, a warning names them and the next rank
    is tried; but in the roles `_FIRST_OF_EQUALS` the first of them gets the role. ``stated`` : the
    roles that the mission file names or leaves empty.
    """
    if role in filled or role in stated:
        return
    candidates = _candidates(filled, role, channels)
    for rank in sorted({channel.rank for channel in candidates}):
        equals = [channel for channel in candidates if channel.rank == rank]
        if len(equals) == 1 or role in _FIRST_OF_EQUALS:
            filled[role] = equals[0]
            yield messages.role_filled(role=role, channel=equals[0].name)
            return
        names = [channel.name for channel in equals]
        yield messages.role_ambiguous(role=role, candidates=names)


def _candidates(
    filled: Mapping[str, Channel], role: str, channels: tuple[Channel, ...]
) -> list[Channel]:
    """The channels that may take a role: they offer it and have its columns.

    A channel may have several roles, but not one outside and one in the cabin.
    """
    inside = role.startswith("cabin_")
    on_other_side = {  # names of channels that have a role on the other side of the window
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
    """Fill the role of a sensor outside and, if the cabin is needed, that of one in the cabin.

    Changes ``filled``. If the cabin is needed and neither role is decided yet, a sensor that could
    be in either place leaves both roles empty, and is reported. ``stated`` : as of `_fill`.
    """
    cabin_role = f"cabin_{role}"
    decided = {*filled, *stated}
    if needs_cabin and role not in decided and cabin_role not in decided:
        in_either_place = [
            channel.name
            for channel in channels
            if role in channel.roles and cabin_role in channel.roles
        ]
        if in_either_place:
            yield messages.outside_or_cabin(role=role, candidates=in_either_place)
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
    """Fill the roles of the barometers outside and in the cabin, by whether they follow the height.

    Changes ``filled``. A barometer that does not follow the height is in the cabin; all others,
    also undecided ones, count as outside. ``free``: the channels that are not named for a role.
    ``stated`` : as of `_fill`.
    """
    height = filled.get("height")
    if height is None:
        return
    decided = {*filled, *stated}
    seeks_outside = "pressure" not in decided
    seeks_cabin = needs_cabin and "cabin_pressure" not in decided
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
    """Fill the pressure outside with the first of the ``outdoors`` barometers, best rank first.

    If that ends before the flight does, the first one that goes on replaces it, if there is one.
    Changes ``filled``; reports the ``indoors`` barometers, which are not used here.
    """
    for channel in indoors:
        yield messages.barometer_not_outside(channel=channel.name)
    if not outdoors:
        return
    first = outdoors[0]
    to_the_end = (channel for channel in outdoors if _silent_s(channel, height) == 0.0)
    chosen = next(to_the_end, first)
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
    """How long before the heights a channel ends [s]; 0 up to `LONGEST_SILENCE_S`."""
    if len(channel) == 0 or len(height) == 0:
        return 0.0
    silent_ns = int(height.time_ns[-1]) - int(channel.time_ns[-1])  # int64 might overflow
    silent_s = silent_ns / NANOSECONDS_PER_SECOND
    return silent_s if silent_s > LONGEST_SILENCE_S else 0.0


def _fill_cabin_pressure(filled: dict[str, Channel], indoors: list[Channel]) -> Iterator[Message]:
    """Fill the pressure of the cabin if there is exactly one barometer ``indoors``.

    Changes ``filled``; several barometers are reported as ambiguous.
    """
    if len(indoors) == 1:
        filled["cabin_pressure"] = indoors[0]
        yield messages.role_filled(role="cabin_pressure", channel=indoors[0].name)
    elif indoors:
        names = [channel.name for channel in indoors]
        yield messages.role_ambiguous(role="cabin_pressure", candidates=names)


def follows_height(barometer: Channel, height: Channel) -> bool | None:
    """Whether a barometer's pressure falls with GNSS height as in free air; None if undecided.

    It does if the mean temperature that the fall of ln p implies is possible for air, and a
    parabola leaves less than 1 % of the variation of pressure unexplained. It is undecided if fewer
    than ten pressures have a height, or these heights span less than 300 m.
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
    # Imported late, because the import loads the whole package of the atmosphere.
    from unbend.atmosphere.hypsometry import fall_of_pressure

    fall = fall_of_pressure(height_m[is_known], np.log(pressure_pa[is_known]))
    return fall.is_of_air and fall.unexplained < _LARGEST_UNEXPLAINED
