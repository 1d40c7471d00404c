"""The messages of the flight package: codes, and a function for each message and refusal."""

from collections.abc import Sequence
from dataclasses import dataclass

from unbend.errors import Code, Counted, MissionError
from unbend.messages import Message, fallback, finding, loss, note, warning

# The clock.

TIME_FIT = Code(
    "TIME-FIT",
    means="How UTC is derived from the clock of the log, with the residuals.",
    effect=(
        "A note; a warning if the stamps scatter; a loss if one of the two clocks stepped and "
        "stayed there."
    ),
    remedy="If it is a loss, check the exposures near the step.",
)


def time_fit(*, where: str, rows: int, source: str, spread_ms: float, largest_ms: float) -> Message:
    """All stamps that relate a vehicle's clock to UTC agree."""
    return note(
        TIME_FIT,
        "UTC from {source}, which agree within {spread_ms:.0f} ms (p5 to p95), the farthest is "
        "{largest_ms:.0f} ms off",
        where=where,
        count=rows,
        source=source,
        spread_ms=spread_ms,
        largest_ms=largest_ms,
    )


def time_fit_but_for(
    *,
    where: str,
    far: int,
    source: str,
    spread_ms: float,
    largest_ms: float,
    limit_ms: float,
) -> Message:
    """A few of the stamps that relate a vehicle's clock to UTC are late or wrong."""
    return note(
        TIME_FIT,
        (
            "UTC from {source}, which agree within {spread_ms:.0f} ms (p5 to p95), the farthest is "
            "{largest_ms:.0f} ms off: {count} are off by more than {limit_ms:.0f} ms, because they "
            "came late or are wrong; the median is not affected"
        ),
        one=(
            "UTC from {source}, which agree within {spread_ms:.0f} ms (p5 to p95), the farthest is "
            "{largest_ms:.0f} ms off: 1 is off by more than {limit_ms:.0f} ms, because it came "
            "late or is wrong; the median is not affected"
        ),
        where=where,
        count=far,
        source=source,
        spread_ms=spread_ms,
        largest_ms=largest_ms,
        limit_ms=limit_ms,
    )


def clock_scatters(
    *,
    where: str,
    rows: int,
    source: str,
    spread_ms: float,
    largest_ms: float,
    sigma_ms: float,
) -> Message:
    """The stamps that relate a vehicle's clock to UTC scatter, without a step."""
    return warning(
        TIME_FIT,
        (
            "UTC from {source}, which scatter by {spread_ms:.0f} ms (p5 to p95), the farthest is "
            "{largest_ms:.0f} ms off: UTC is accurate to {sigma_ms:.0f} ms (1 sigma); the sigmas "
            "of stations of exposures by UTC include it"
        ),
        where=where,
        count=rows,
        source=source,
        spread_ms=spread_ms,
        largest_ms=largest_ms,
        sigma_ms=sigma_ms,
    )


def clock_stepped(
    *,
    where: str,
    far: int,
    source: str,
    spread_ms: float,
    largest_ms: float,
    limit_ms: float,
) -> Message:
    """The clock of the vehicle or of the receiver stepped."""
    return loss(
        TIME_FIT,
        (
            "UTC from {source}, which agree within {spread_ms:.0f} ms (p5 to p95), the farthest is "
            "{largest_ms:.0f} ms off, {count} are off by more than {limit_ms:.0f} ms: one of the "
            "two clocks stepped, and exposures by UTC may be off by the same time"
        ),
        one=(
            "UTC from {source}, which agree within {spread_ms:.0f} ms (p5 to p95), the farthest is "
            "{largest_ms:.0f} ms off, 1 is off by more than {limit_ms:.0f} ms: one of the two "
            "clocks stepped, and exposures by UTC may be off by the same time"
        ),
        where=where,
        count=far,
        source=source,
        spread_ms=spread_ms,
        largest_ms=largest_ms,
        limit_ms=limit_ms,
    )


# Channels and their roles.

ROLE = Code(
    "ROLE",
    means="Which channel of the log plays which role.",
    effect="As stated.",
    remedy="If it is the wrong channel, name another under log.channels.",
)


def role_filled(*, role: str, channel: str) -> Message:
    """A channel plays a role for which the mission file names none."""
    return note(ROLE, "{shown}: {channel}", where=role, shown=_shown(role), channel=channel)


ROLE_SPARE = Code(
    "ROLE-SPARE",
    means=(
        "The channel of a role has no values in a part of the flight, and a spare channel of the "
        "same kind has."
    ),
    effect=(
        "The spare channel is used there, with its own accuracy. A spare barometer is used for the "
        "whole flight."
    ),
    remedy="To use one channel all the time, name it under log.channels.",
)


def spare_plays_role(*, role: str, channel: str, spare: str, seconds: float) -> Message:
    """A channel ends, or begins late, and a spare gives its samples."""
    return fallback(
        ROLE_SPARE,
        "{shown}: {spare} for {seconds:.1f} s, because {channel} has no values there",
        where=role,
        shown=_shown(role),
        spare=spare,
        channel=channel,
        seconds=seconds,
    )


def spare_plays_all(*, role: str, channel: str, spare: str, seconds: float) -> Message:
    """A sensor ends before the flight does, and a spare plays its role for the whole flight."""
    return fallback(
        ROLE_SPARE,
        (
            "{shown}: {spare}, because {channel} has no values in the last {seconds:.1f} s of the "
            "flight"
        ),
        where=role,
        shown=_shown(role),
        spare=spare,
        channel=channel,
        seconds=seconds,
    )


def role_left_empty(*, role: str) -> Message:
    """The mission file says that no channel plays a role."""
    return note(
        ROLE,
        "{shown}: none, because log.channels.{role} is null",
        where=role,
        shown=_shown(role),
        role=role,
    )


ROLE_AMBIGUOUS = Code(
    "ROLE-AMBIGUOUS",
    means="Several channels could play a role, and none of them is used.",
    effect="The role stays empty, or another kind of sensor is used.",
    remedy="Name one of them under log.channels.<role>.",
)


def role_ambiguous(*, role: str, candidates: Sequence[str]) -> Message:
    """Several channels of one rank could play a role."""
    return warning(
        ROLE_AMBIGUOUS,
        "{listed} could each be the {shown}; none of them is used",
        where=f"log.channels.{role}",
        shown=_shown(role),
        listed=", ".join(candidates),
    )


def outside_or_cabin(*, role: str, candidates: Sequence[str]) -> Message:
    """Sensors that may be outside or in the cabin, where both are needed."""
    return warning(
        ROLE_AMBIGUOUS,
        "{listed}: is it the {role} outside or in the cabin? none of them is used; name "
        "log.channels.{role} and log.channels.cabin_{role}",
        where=f"log.channels.{role}",
        role=role,
        listed=", ".join(candidates),
    )


CHANNEL_MISSING = Code(
    "CHANNEL-MISSING",
    means=(
        "A named channel is not in the log, or lacks the columns of its role. Or no channel can "
        "have the role of the position or the attitude."
    ),
    effect=(
        "A refusal if a channel is named for the position, an attitude, or the pressure or "
        "temperature of the cabin. If not, a loss: the role stays empty."
    ),
    remedy="Name a channel that `unbend inspect` lists.",
)


def role_empty(*, role: str, channels: Sequence[str]) -> Message:
    """No channel of the log can play a role that every mission needs."""
    return loss(
        CHANNEL_MISSING,
        "no channel of the log can have the role {role}; it has {there}",
        where=f"log.channels.{role}",
        role=role,
        there=", ".join(channels) or "no channel at all",
    )


def why_channel_is_missing(
    *, name: str, needed: Sequence[str], columns: Sequence[str] | None, similar: Sequence[str]
) -> str:
    """The reason why a named channel cannot have a role, in words, for other messages.

    ``columns`` : of the channel; None if the log does not have it. ``needed`` : columns of the
    role. ``similar`` : names of the log that are like ``name``.
    """
    if columns is not None:
        return f"{name} has no {', '.join(needed)}; it has {', '.join(columns)}"
    if similar:
        return f"the log has no channel {name!r} (near: {', '.join(similar)})"
    return f"the log has no channel {name!r}"


def _candidates_in_words(candidates: Sequence[str], *, can_use_board: bool) -> str:
    """The channels that could have a role, and whether the temperature of a board could."""
    text = "no other channel can have this role"
    if candidates:
        text = f"channels for this role: {', '.join(candidates)}"
    if can_use_board:
        text += (
            "; atmosphere.board_temperature: true uses the temperature of its circuit board, minus "
            "about 10 K"
        )
    return text


def named_channel_missing(
    *, role: str, why: str, candidates: Sequence[str], can_use_board: bool
) -> Message:
    """A channel that is named for a role is missing, and the role can stay empty.

    ``why`` : as `why_channel_is_missing` gives it. ``candidates`` : other channels for the role.
    """
    return loss(
        CHANNEL_MISSING,
        "{why}; {others}",
        where=f"log.channels.{role}",
        why=why,
        others=_candidates_in_words(candidates, can_use_board=can_use_board),
    )


def required_channel_missing(
    *, role: str, why: str, candidates: Sequence[str], also_missing: Sequence[str]
) -> MissionError:
    """A channel that is named for a role is missing, and nothing can be corrected without it.

    ``candidates`` : other channels for the role. ``also_missing`` : other channels that the mission
    file names and the log does not have.
    """
    text = "{why}; {others}"
    remedy = "name a channel that `unbend inspect` lists"
    if also_missing:
        text += "; the log has no {also_missing} either"
        remedy += ", for each of these; or give the log of this mission"
    return MissionError(
        CHANNEL_MISSING,
        text,
        where=f"log.channels.{role}",
        remedy=remedy,
        why=why,
        others=_candidates_in_words(candidates, can_use_board=False),
        also_missing=", ".join(also_missing),
    )


CHANNEL_TWICE = Code(
    "CHANNEL-TWICE",
    means="The same sensor is named for the air outside and for the cabin.",
    effect="The mission is refused.",
    remedy="Name two sensors. If there is no cabin, leave the window out.",
)


def channel_twice(*, name: str, role: str) -> MissionError:
    """One channel is named for the air outside and for that of the cabin."""
    return MissionError(
        CHANNEL_TWICE,
        "{name} is named for the {role} outside and in the cabin",
        where=f"log.channels.{role}, log.channels.cabin_{role}",
        remedy="name two sensors; if there is no cabin, leave the window out",
        name=name,
        role=role,
    )


BARO_NOT_OUTSIDE = Code(
    "BARO-NOT-OUTSIDE",
    means=(
        "A barometer does not follow GNSS height as outside air does. It is in a closed "
        "compartment."
    ),
    effect="It is not used for the pressure outside. It may measure the pressure of the cabin.",
    remedy="Nothing. If the camera is in that compartment, name it as log.channels.cabin_pressure.",
)


def barometer_not_outside(*, channel: str) -> Message:
    """A barometer whose pressure does not follow height as that of free air."""
    return note(
        BARO_NOT_OUTSIDE,
        (
            "{where} does not follow the GNSS height as outside air does: it is probably a "
            "barometer in a closed compartment"
        ),
        where=channel,
    )


# Gimbals.

GIMBAL_FRAME = Code(
    "GIMBAL-FRAME",
    means=(
        "The attitude is the attitude of a gimbal, so the mount angles are in the frame of its "
        "payload. The entry gives the viewing direction of each camera."
    ),
    effect="A note; a warning if the camera looks far away from the payload's forward axis.",
    remedy="A camera that looks along the payload's forward axis has pitch_deg: 90.",
)


def gimbal_frame(
    *, camera: str, attitude: str, from_forward_deg: float, from_nadir_deg: float, is_far: bool
) -> Message:
    """Where a camera on a gimbal looks; ``is_far``: far from the forward axis of its payload."""
    send = warning if is_far else note
    return send(
        GIMBAL_FRAME,
        (
            "{attitude} is the attitude: it belongs to the payload of a gimbal (forward, right, "
            "down). A camera with pitch_deg: 90 looks along the forward axis of the payload. With "
            "its mount, {camera} looks {from_forward_deg:.0f} deg away from that axis, and in the "
            "median {from_nadir_deg:.0f} deg from straight down"
        ),
        where=f"mount.{camera}",
        camera=camera,
        attitude=attitude,
        from_forward_deg=from_forward_deg,
        from_nadir_deg=from_nadir_deg,
    )


GIMBAL_IGNORED = Code(
    "GIMBAL-IGNORED",
    means="The log has messages of a gimbal, but no camera uses its attitude.",
    effect="Cameras are treated as fixed to the aircraft.",
    remedy="Name the gimbal's channel under log.channels.attitude or mount.<camera>.attitude.",
)


def gimbal_ignored(*, listed: str) -> Message:
    """The log has messages of a gimbal, and no camera follows it."""
    return warning(
        GIMBAL_IGNORED,
        (
            "the log has {listed} of a gimbal: a camera uses its attitude only if its channel is "
            "named as attitude; each camera is treated as fixed to the aircraft by its mount"
        ),
        listed=listed,
    )


GIMBAL_YAW = Code(
    "GIMBAL-YAW",
    means="In some rows, the yaw of the gimbal is relative to the nose.",
    effect=(
        "In these rows the yaw of the aircraft is added, or its whole attitude if the gimbal "
        "counters the motion of the aircraft."
    ),
    remedy="Nothing.",
)


def gimbal_yaw_added(*, gimbal: str, rows: int, total: int, aircraft: str) -> Message:
    """The yaw of the aircraft is added to the angles of a gimbal."""
    return note(
        GIMBAL_YAW,
        (
            "the yaw of {where} is relative to the nose in {count} of {total_rows}: the yaw of "
            "{aircraft} is added"
        ),
        where=gimbal,
        count=rows,
        total_rows=Counted(total, "row"),
        aircraft=aircraft,
    )


def gimbal_counters_motion(*, gimbal: str, rows: int, total: int, aircraft: str) -> Message:
    """The angles of a gimbal are those of its servos, which counter the aircraft's motion."""
    return note(
        GIMBAL_YAW,
        (
            "the yaw of {where} is relative to the nose in {count} of {total_rows}: its angles "
            "compensate the motion of {aircraft} and are added to its attitude"
        ),
        where=gimbal,
        count=rows,
        total_rows=Counted(total, "row"),
        aircraft=aircraft,
    )


# Heights.

HEIGHT_GEOID = Code(
    "HEIGHT-GEOID",
    means=(
        "The undulation in use differs by more than 3 m from EGM96, or mission.undulation_m from "
        "the two heights of the log. Above 10 m it is a finding."
    ),
    effect="If it is wrong, the heights that are computed with it are wrong by the same amount.",
    remedy="Check mission.undulation_m: its sign is ellipsoid minus sea level.",
)


def stated_undulation_off(
    *, channel: str, rows: int, stated_m: float, own_m: float, is_grave: bool
) -> Message:
    """The undulation of the mission file differs from that of the log's two heights (``own_m``)."""
    send = finding if is_grave else warning
    return send(
        HEIGHT_GEOID,
        (
            "mission.undulation_m is {stated_m:.1f} m, but the two heights of {where} differ by "
            "{own_m:.1f} m: where the log has both heights, they are used"
        ),
        where=channel,
        count=rows,
        stated_m=stated_m,
        own_m=own_m,
    )


def undulation_off(
    *,
    where: str,
    stations: int,
    used: str,
    off_m: float,
    egm96_m: float,
    other_sign_off_m: float | None,
    is_grave: bool,
) -> Message:
    """The undulation in use (``used``, in words) is far from EGM96.

    ``off_m`` : undulation minus EGM96, ``other_sign_off_m`` the same with the other sign, if that
    is near EGM96; else None.
    """
    other_sign = ""
    if other_sign_off_m is not None:
        other_sign = (
            f"; with the other sign it is {other_sign_off_m:+.1f} m from it: the undulation is the "
            "ellipsoidal height minus the height above sea level"
        )
    send = finding if is_grave else warning
    return send(
        HEIGHT_GEOID,
        "{used}, differs by {off_m:+.1f} m from EGM96, which has {egm96_m:.1f} m here{other_sign}",
        where=where,
        count=stations,
        used=used,
        off_m=off_m,
        egm96_m=egm96_m,
        other_sign=other_sign,
    )


HEIGHT_UNDULATION = Code(
    "HEIGHT-UNDULATION",
    means="The undulation at the stations, and its source.",
    effect="It relates heights above sea level and ellipsoid.",
    remedy="Nothing.",
)


def undulation_used(*, where: str, stations: int, used: str) -> Message:
    """Which undulation is used at the stations, and where it comes from."""
    return note(HEIGHT_UNDULATION, "{used}", where=where, count=stations, used=used)


GEOID_OUTSIDE = Code(
    "GEOID-OUTSIDE",
    means="Stations are outside the grid of the geoid, or where it has no values.",
    effect="Their other height is unknown.",
    remedy="Give mission.undulation_m, or a grid that covers the flight.",
)


def stations_outside_geoid(*, where: str, count: int, total: int, grid: str) -> Message:
    """Stations without an undulation."""
    return loss(
        GEOID_OUTSIDE,
        "{count} of {total_stations} are outside {grid}, or where it has no values",
        one="1 of {total_stations} is outside {grid}, or where it has no values",
        where=where,
        count=count,
        total_stations=Counted(total, "station"),
        grid=grid,
    )


HEIGHT_HOME = Code(
    "HEIGHT-HOME",
    means="The height of the take-off point, from the log.",
    effect=(
        "Ground heights relative to take-off use it, if it is steady and ground.home_h_msl_m is "
        "not stated."
    ),
    remedy="If it changes, state ground.home_h_msl_m.",
)


def home_height(*, channel: str, height_m: float) -> Message:
    """The take-off height of a log is steady."""
    return note(
        HEIGHT_HOME,
        "take-off height {height_m:.2f} m above mean sea level",
        where=channel,
        height_m=height_m,
    )


def home_height_changes(*, channel: str, low_m: float, high_m: float) -> Message:
    """The take-off height of a log changes."""
    return note(
        HEIGHT_HOME,
        "the take-off height of {where} changes between {low_m:.1f} and {high_m:.1f} m: it is not "
        "used",
        where=channel,
        low_m=low_m,
        high_m=high_m,
    )


HEIGHT_REFERENCE = Code(
    "HEIGHT-REFERENCE",
    means=(
        "Ground heights are relative to a surface of unknown height: the take-off point or the "
        "ellipsoid."
    ),
    effect="The mission is refused.",
    remedy="Give ground.home_h_msl_m, mission.undulation_m or a mission.geoid.",
)


def undulation_unknown() -> MissionError:
    """Ground heights above the ellipsoid, and no station has an undulation."""
    return MissionError(
        HEIGHT_REFERENCE,
        "ground heights are above the ellipsoid, and no undulation is known at any station",
        where="ground.reference",
        remedy=(
            "give mission.undulation_m (ellipsoidal minus mean sea level), or a mission.geoid that "
            "covers the flight"
        ),
    )


def home_unknown(*, begin_m: float | None) -> MissionError:
    """Ground heights relative to the take-off point, whose height is not known.

    ``begin_m`` is the height above sea level at which the log begins, if the aircraft stands there.
    """
    remedy = "give the height of the take-off above sea level: ground.home_h_msl_m"
    if begin_m is not None:
        remedy = (
            "the aircraft is at rest at {height} m above sea level when the log begins: if the "
            "heights are relative to that place, write ground.home_h_msl_m: {height}"
        )
    return MissionError(
        HEIGHT_REFERENCE,
        (
            "ground heights are relative to the take-off point, but the log gives no height of it, "
            "or more than one"
        ),
        where="ground.reference",
        remedy=remedy,
        height="" if begin_m is None else f"{begin_m:.1f}",
    )


HEIGHT_SAME = Code(
    "HEIGHT-SAME",
    means="Both heights of the log are equal. One is a copy of the other.",
    effect=(
        "They are treated as heights above the sea. If they are not, the stations are wrong by the "
        "undulation."
    ),
    remedy="Name another log.channels.height, or state the undulation.",
)


def heights_are_one(*, channel: str, rows: int, source: str, undulation_m: float | None) -> Message:
    """Both heights of a channel are the same numbers."""
    size = "" if undulation_m is None else f" of {undulation_m:.1f} m"
    return warning(
        HEIGHT_SAME,
        (
            "both heights of {where} are equal to the last digit in {in_rows}: one is a copy of "
            "the other, and the log does not show which one; they are treated as heights above "
            "mean sea level, and ellipsoidal heights are computed by {source}: if they are above "
            "the ellipsoid, the stations are wrong by the undulation{size}, and "
            "log.channels.height must name another channel"
        ),
        where=channel,
        count=rows,
        in_rows=Counted(rows, "row"),
        source=source,
        size=size,
    )


# Exposures.

EVENTS_CHANNEL = Code(
    "EVENTS-CHANNEL",
    means="The log has no event channel with this name. Or it has several, and none is named.",
    effect="The mission is refused.",
    remedy="Name one under events.log.<camera>.channel, or give the times in events.csv.",
)


def event_channel_unknown(*, name: str | None, channels: Sequence[str]) -> MissionError:
    """No event channel has the name, or several could be a camera's."""
    question = "which events belong to this camera?"
    if name:
        question = f"the log has no event channel {name!r}"
    return MissionError(
        EVENTS_CHANNEL,
        "{question}; the log has {there}",
        where="events.log",
        remedy="name one of them as channel, or give the times of the images in events.csv",
        question=question,
        there=", ".join(channels) or "no camera events at all",
    )


EVENTS_FEEDBACK = Code(
    "EVENTS-FEEDBACK",
    means=(
        "Fewer than ten triggers have a logged shutter pulse. So the lag cannot be computed from "
        "the feedback."
    ),
    effect="The mission is refused.",
    remedy="Give delay_s in seconds, or name the channel of the triggers (TRIG).",
)


def too_few_feedback_pairs(*, camera: str, channel: str, pairs: int, needed: int) -> MissionError:
    """Too few triggers have a logged pulse of their shutter."""
    return MissionError(
        EVENTS_FEEDBACK,
        (
            "{channel} has {triggers} with a logged shutter pulse; {needed} are needed to measure "
            "the lag"
        ),
        where=f"events.log.{camera}.delay_s",
        remedy="give the lag in seconds; or name the channel of the triggers (TRIG) of a camera "
        "with a feedback pin",
        channel=channel,
        triggers=Counted(pairs, "trigger"),
        needed=needed,
    )


EVENTS_SHUTTER_LAG = Code(
    "EVENTS-SHUTTER-LAG",
    means="The lag of the shutter after its trigger, from triggers with a logged shutter pulse.",
    effect="It is added to the times of all exposures of the camera.",
    remedy="Nothing.",
)


def shutter_lag(
    *, camera: str, channel: str, pairs: int, lag_ms: float, scatter_ms: float
) -> Message:
    """The lag of a shutter as its feedback shows it."""
    return note(
        EVENTS_SHUTTER_LAG,
        "the shutter of {camera} opens {lag_ms:.0f} ms after its trigger, with a scatter of "
        "{scatter_ms:.0f} ms, from {count} triggers with a logged shutter pulse",
        one=(
            "the shutter of {camera} opens {lag_ms:.0f} ms after its trigger, from 1 trigger with "
            "a logged shutter pulse"
        ),
        where=channel,
        count=pairs,
        camera=camera,
        lag_ms=lag_ms,
        scatter_ms=scatter_ms,
    )


EVENTS_LOST = Code(
    "EVENTS-LOST",
    means="Numbers of exposures have no event, or triggers have no shutter pulse.",
    effect="Their images have no station.",
    remedy="Take their times from another source (events.csv), or leave them out.",
)


def numbers_without_event(
    *, where: str, missing: int, listed: str, first: int, last: int
) -> Message:
    """Numbers that a log skips between others."""
    return loss(
        EVENTS_LOST,
        "{count} numbers between {first} and {last} have no event: {listed}",
        one="1 number between {first} and {last} has no event: {listed}",
        where=where,
        count=missing,
        first=first,
        last=last,
        listed=listed,
    )


def triggers_without_pulse(*, shutters: str, trigger: str, sent: int, events: int) -> Message:
    """A camera was triggered more often than its shutter opened."""
    return loss(
        EVENTS_LOST,
        "{sent} of {trigger}, {events} of {where}: {count} pulses were lost, their images have "
        "no station",
        one="{sent} of {trigger}, {events} of {where}: 1 pulse was lost, its image has no station",
        where=shutters,
        count=sent - events,
        sent=Counted(sent, "trigger"),
        events=Counted(events, "shutter event"),
        trigger=trigger,
    )


EVENTS_ON_GROUND = Code(
    "EVENTS-ON-GROUND",
    means="Exposures were made while the aircraft was on the ground: test shots.",
    effect=(
        "A note; a warning if they are in the observations; a loss if they are more than half of "
        "all exposures."
    ),
    remedy="If it is a loss, check the times of the events.",
)


def exposures_on_ground(*, names: Sequence[str], measured: int, are_most: bool) -> Message:
    """Exposures of an aircraft on the ground.

    ``measured`` : how many of them have observations. ``are_most`` : they are most of all.
    """
    send = note
    if are_most:
        send = loss
    elif measured:
        send = warning
    in_observations = ""
    if measured == 1:
        in_observations = "; 1 of them is in the observations"
    elif measured:
        in_observations = f"; {measured} of them are in the observations"
    return send(
        EVENTS_ON_GROUND,
        (
            "{count} exposures were made while the aircraft was on the ground: "
            "{listed}{in_observations}"
        ),
        one="1 exposure was made while the aircraft was on the ground: {listed}{in_observations}",
        where="events",
        count=len(names),
        listed=first_names(names, 5),
        in_observations=in_observations,
    )


EVENTS_REPEATED = Code(
    "EVENTS-REPEATED",
    means="Several exposures would have the same image name.",
    effect="The mission is refused.",
    remedy="Give each camera a different pattern, or one row for each image in events.csv.",
)


def image_names_repeated(*, total: int, example: str) -> MissionError:
    """Several exposures have one name."""
    return MissionError(
        EVENTS_REPEATED,
        "{total} image names belong to more than one exposure, for example '{example}'",
        one="1 image name belongs to more than one exposure, for example '{example}'",
        where="events",
        count=total,
        remedy=(
            "give each exposure a different name: a pattern for each camera, or one row for each "
            "image in events.csv"
        ),
        total=total,
        example=example,
    )


EVENTS_SPAN = Code(
    "EVENTS-SPAN",
    means=(
        "Events are outside the time of the flight. The entry gives a time shift that would bring "
        "more of them into the flight, if leap seconds, a time zone, a day, a week or a common "
        "begin gives one."
    ),
    effect="A warning. Refused if more than half of all events are outside the flight.",
    remedy=(
        "Check the time system: GPS time is 18 s ahead of UTC, local time by its zone. Or name the "
        "log of this flight."
    ),
)


_BEYOND_FLIGHT = (
    "{count} of {total_events} are outside the flight: events {of_events}, "
    "{channel} {of_flight}; {shift_that_fits}"
)
_ONE_BEYOND_FLIGHT = (
    "1 of {total_events} is outside the flight: events {of_events}, "
    "{channel} {of_flight}; {shift_that_fits}"
)


@dataclass(frozen=True)
class BeyondFlight:
    """Events beyond the time of a flight."""

    key: str  # where the mission file states the times
    beyond: int  # how many events are
    total: int  # events
    span_of_events: str  # from the first event to the last
    channel: str  # that gives the time of the flight
    span_of_flight: str  # from its first sample to its last
    shift_that_fits: str  # which shift of time would bring how many events into the flight


def events_beyond_flight(events: BeyondFlight) -> Message:
    """Few events beyond the time of the flight, and the shift by which they would fit."""
    return warning(
        EVENTS_SPAN,
        _BEYOND_FLIGHT,
        one=_ONE_BEYOND_FLIGHT,
        where=events.key,
        count=events.beyond,
        total_events=Counted(events.total, "event"),
        of_events=events.span_of_events,
        channel=events.channel,
        of_flight=events.span_of_flight,
        shift_that_fits=events.shift_that_fits,
    )


def most_events_beyond_flight(events: BeyondFlight) -> MissionError:
    """More than half of the events are before or after the flight."""
    return MissionError(
        EVENTS_SPAN,
        _BEYOND_FLIGHT,
        one=_ONE_BEYOND_FLIGHT,
        where=events.key,
        count=events.beyond,
        remedy="check {where} (GPS time is 18 s ahead of UTC, local time by its zone), or add the "
        "offset to delay_s; or name the events and the log of one flight",
        total_events=Counted(events.total, "event"),
        of_events=events.span_of_events,
        channel=events.channel,
        of_flight=events.span_of_flight,
        shift_that_fits=events.shift_that_fits,
    )


EVENTS_TRIGGER_TIME = Code(
    "EVENTS-TRIGGER-TIME",
    means=(
        "The events of a camera are the commands of its trigger, not the pulses of its shutter. Or "
        "they may be, if the log does not show it."
    ),
    effect=(
        "Without delay_s, the exposures are too early: 70 to 530 ms were measured. That is metres "
        "along the track."
    ),
    remedy="Measure the delay and state events.log.<camera>.delay_s.",
)


def trigger_times(*, channel: str, events: int) -> Message:
    """The events of a camera are the commands of its trigger."""
    return note(
        EVENTS_TRIGGER_TIME,
        "{where} has the times of the trigger commands: the shutter opens later (70 to 530 ms were "
        "measured), which events.log.<camera>.delay_s takes into account",
        where=channel,
        count=events,
    )


EVENTS_NOT_SHUTTER = Code(
    "EVENTS-NOT-SHUTTER",
    means=(
        "The mission file takes the commands of a trigger for the exposures, without a delay, and "
        "the log has the pulses of the shutter too."
    ),
    effect="Stations are metres too early along the track.",
    remedy=(
        "Name the channel of the pulses under events.log.<camera>.channel, or write delay_s: "
        "from_feedback."
    ),
)


def shutter_not_used(*, camera: str, trigger: str, shutters: str, lag_ms: float) -> Message:
    """Commands of a trigger are the exposures, although the pulses of the shutter are logged."""
    return finding(
        EVENTS_NOT_SHUTTER,
        "{where} names {trigger}, the commands of the trigger; the log has the pulses of the "
        "shutter in {shutters}, {lag_ms:.0f} ms later in the median",
        where=f"events.log.{camera}.channel",
        trigger=trigger,
        shutters=shutters,
        lag_ms=lag_ms,
    )


def perhaps_trigger_times(*, channel: str, events: int, parameter: str) -> Message:
    """The log does not say whether captures have the times of triggers or of the shutter."""
    return note(
        EVENTS_TRIGGER_TIME,
        (
            "{where} has the times of the trigger commands if {parameter} was 0, which is not "
            "logged: in this case the shutter opens later; state this delay as "
            "events.log.<camera>.delay_s"
        ),
        where=channel,
        count=events,
        parameter=parameter,
    )


# Names of images.

IMAGES_OTHER = Code(
    "IMAGES-OTHER",
    means=(
        "None of the images of the observations matches a file, or an exposure of a camera. Their "
        "names differ."
    ),
    effect="The mission is refused.",
    remedy=(
        "State observations.match_names, or correct the pattern under events (image), or "
        "events.images.path."
    ),
)


def no_image_of_camera(
    *,
    camera: str,
    unknown: int,
    image: str,
    exposures: int,
    example: str | None,
    proposal: str,
) -> MissionError:
    """None of the exposures of a camera is an image of the observations."""
    called = "" if example is None else f", which have names like {name_in_bytes(example)}"
    more = f"; {proposal}" if proposal else ""
    return MissionError(
        IMAGES_OTHER,
        "none of {unknown_images} of the observations, like {like}, is one of the "
        "{of_camera} of {camera}{called}{more}",
        where=f"observations, {camera}",
        remedy="state observations.match_names, or correct the pattern under events (the image of "
        "{camera}), or the names of the images",
        unknown_images=Counted(unknown, "image"),
        like=name_in_bytes(image),
        of_camera=Counted(exposures, "exposure"),
        camera=camera,
        called=called,
        more=more,
    )


def difference_in_names(*, matched: int, differences: Sequence[str], name: str, image: str) -> str:
    """How many images would match if names might have these differences; for other messages."""
    key = f"observations.match_names: [{', '.join(differences)}]"
    return f"{matched} of them would match with {key}, for example {image!r} with {name!r}"


IMAGES_RENAMED = Code(
    "IMAGES-RENAMED",
    means="Exposures get the image names of the observations, because of observations.match_names.",
    effect="As stated.",
    remedy="Check the example in the entry.",
)


def images_renamed(
    *, where: str, count: int, differences: Sequence[str], name: str, image: str
) -> Message:
    """Exposures take the names that the observations have."""
    return note(
        IMAGES_RENAMED,
        (
            "{count} names differ from the images of the observations only in {differences}: "
            "{name} is {image}"
        ),
        one=(
            "1 name differs from the image of the observations only in {differences}: {name} is "
            "{image}"
        ),
        where=where,
        count=count,
        differences=" and ".join(differences) or "composed characters (Unicode NFC and NFD)",
        name=name_in_bytes(name),
        image=name_in_bytes(image),
    )


IMAGES_UNMATCHED = Code(
    "IMAGES-UNMATCHED",
    means="Images of the observations have no exposure.",
    effect="Their rows have the status no_station, and no corrected values.",
    remedy="Check the pattern or the names. Lost pulses cannot be repaired.",
)


def images_unmatched(
    *, where: str, images: Sequence[str], unused: Sequence[str], like: str | None, proposal: str
) -> Message:
    """Images of the observations without an exposure; ``where``: the key that names the exposures.

    ``unused`` : exposures without observations. ``like`` : an exposure with a similar name.
    ``proposal`` : of `propose_differences` or `names_shifted`, "" without one.
    """
    hint = ""
    if unused:
        hint = f"; exposures without observations: {first_names(names_in_bytes(unused), 3)}"
    elif like is not None:
        hint = f"; exposures have names like {name_in_bytes(like)}"
    if proposal:
        hint += f"; {proposal}"
    return loss(
        IMAGES_UNMATCHED,
        "{count} images have observations but no exposure: {listed}{hint}",
        one="1 image has observations but no exposure: {listed}{hint}",
        where=where,
        count=len(images),
        listed=first_names(names_in_bytes(images), 3),
        hint=hint,
    )


def names_shifted(*, shift: int) -> str:
    """A hint that images and exposures of equal names may not belong to each other.

    By ``shift`` numbers the images are later than the exposures, or earlier if it is negative.
    """
    return (
        f"the numbers of the images look shifted by {shift:+d}: if they are, every image has the "
        "exposure of another one; check the number of the first image"
    )


# Stations.

STATIONS_UNUSED = Code(
    "STATIONS-UNUSED",
    means="Exposures have no observations.",
    effect="None.",
    remedy=(
        "None, unless IMAGES-UNMATCHED names images: their names may be mistyped, and these "
        "exposures may belong to them."
    ),
)


def exposures_unused(*, images: Sequence[str]) -> Message:
    """Exposures whose images have no observations."""
    return note(
        STATIONS_UNUSED,
        "{count} exposures have no observations: {listed}",
        one="1 exposure has no observations: {listed}",
        count=len(images),
        listed=first_names(images, 3),
    )


STATIONS_FLAGGED = Code(
    "STATIONS-FLAGGED",
    means=(
        "Exposures have no usable station. The entry gives the status: outside_log, in_gap, "
        "no_position, no_attitude or another."
    ),
    effect=(
        "Their observations have no corrected values, but for suspect stations if "
        "stations.use_suspect is true. The run ends with exit code 3."
    ),
    remedy="Check times and gaps of the log, or give a trajectory.",
)


def stations_flagged(*, status: str, images: Sequence[str]) -> Message:
    """Exposures of one status that is not ok."""
    return loss(
        STATIONS_FLAGGED,
        "{count} exposures are {status}: {listed}",
        one="1 exposure is {status}: {listed}",
        count=len(images),
        status=status,
        listed=first_names(images, 3),
    )


STATIONS_HEIGHT = Code(
    "STATIONS-HEIGHT",
    means="Barometer and GNSS height contradict each other at stations.",
    effect="They are suspect, and have no corrected values unless stations.use_suspect is true.",
    remedy="Check the log at these times. A trajectory can replace the heights.",
)


def station_heights_suspect(*, count: int, worst_hpa: float, first: str) -> Message:
    """Stations at which barometer and GNSS height disagree."""
    return loss(
        STATIONS_HEIGHT,
        "{count} stations are suspect: barometer and GNSS height are up to {worst_hpa:.0f} hPa "
        "apart there, the first {first}",
        one="1 station is suspect: barometer and GNSS height are {worst_hpa:.0f} hPa apart there, "
        "{first}",
        count=count,
        worst_hpa=worst_hpa,
        first=first,
    )


STATIONS_SIGMA = Code(
    "STATIONS-SIGMA",
    means=(
        "The median sigmas of the stations. As a loss: stations with larger sigmas than the "
        "mission allows."
    ),
    effect="If it is a loss, the run ends with exit code 3.",
    remedy="Give a better trajectory, or increase the largest sigmas under stations.",
)


def stations_worse_than_needed(
    *,
    count: int,
    total: int,
    quantity: str,
    limit: float,
    unit: str,
    worst: str,
    sigma: float | None,
) -> Message:
    """Stations whose sigma exceeds a limit of the mission, or is not known."""
    size = "an unknown sigma" if sigma is None else f"{sigma:.2f} {unit}"
    return loss(
        STATIONS_SIGMA,
        (
            "{count} of {total_stations} have larger sigmas than the mission allows: {quantity} "
            "{limit:g} {unit}, the worst is {worst} with {size}"
        ),
        one=(
            "1 of {total_stations} has a larger sigma than the mission allows: {quantity} "
            "{limit:g} {unit}, it is {worst} with {size}"
        ),
        where="stations",
        count=count,
        total_stations=Counted(total, "station"),
        quantity=quantity,
        limit=limit,
        unit=unit,
        worst=worst,
        size=size,
    )


def station_sigmas(*, stations: int, medians: Sequence[str]) -> Message:
    """How well the stations are known, in the median."""
    return note(
        STATIONS_SIGMA,
        "median sigmas of the stations: {medians}",
        where="stations",
        count=stations,
        medians=", ".join(medians),
    )


AIRCRAFT_ATTITUDE_MISSING = Code(
    "AIRCRAFT-ATTITUDE-MISSING",
    means=(
        "A window is fixed to the aircraft (frame: body), but the attitude of the aircraft is not "
        "known for some exposures."
    ),
    effect="These stations are suspect. Their observations have no corrected values.",
    remedy="Name log.channels.aircraft_attitude.",
)


def aircraft_attitude_missing(*, camera: str, count: int, reason: str) -> Message:
    """Exposures through a window that is fixed to an aircraft of unknown attitude."""
    return loss(
        AIRCRAFT_ATTITUDE_MISSING,
        "{count} exposures have {reason}",
        one="1 exposure has {reason}",
        where=f"camera {camera}",
        count=count,
        reason=reason,
    )


# The air outside.

AIR_GROUND_SOAK = Code(
    "AIR-GROUND-SOAK",
    means=(
        "Readings of thermometer and hygrometer on the ground and shortly after take-off show the "
        "airfield, not the free air."
    ),
    effect="These readings are not used.",
    remedy="Nothing.",
)


def ground_soak(*, channel: str, count: int, seconds: float) -> Message:
    """Readings that show the airfield."""
    return note(
        AIR_GROUND_SOAK,
        "{count} readings on the ground or within {seconds:.0f} s of take-off are not used",
        one="1 reading on the ground or within {seconds:.0f} s of take-off is not used",
        where=channel,
        count=count,
        seconds=seconds,
    )


AIR_HEIGHT_FUSED = Code(
    "AIR-HEIGHT-FUSED",
    means="The only height in the log is a height that the autopilot fused with its barometer.",
    effect=(
        "The barometer gives the level of the pressure, but no temperatures, because the height is "
        "not an independent measurement."
    ),
    remedy="Log the messages of the receiver (GPS), or give stations.trajectory.",
)


def height_is_fused(*, channel: str, level_m: float) -> Message:
    """The only height of a log follows its barometer."""
    return warning(
        AIR_HEIGHT_FUSED,
        (
            "{where} is a position that the autopilot fused with its barometer, and no receiver "
            "gives a height: pressures give no temperatures; only the pressures of the lowest "
            "{level_m:.0f} m are used, for the level"
        ),
        where=channel,
        level_m=level_m,
    )


AIR_SUSPECT_HEIGHT = Code(
    "AIR-SUSPECT-HEIGHT",
    means="Readings were taken at times when other evidence contradicts the heights of the log.",
    effect="They are not used.",
    remedy="See the entries SENSOR-* and STATIONS-SUSPECT about these heights.",
)


def readings_at_suspect_heights(*, channel: str, count: int) -> Message:
    """Readings at heights that other evidence contradicts."""
    return warning(
        AIR_SUSPECT_HEIGHT,
        "{count} readings are not used, at heights that other evidence contradicts",
        one="1 reading is not used, at a height that other evidence contradicts",
        where=channel,
        count=count,
    )


def name_in_bytes(name: str) -> str:
    """A name in quotation marks, with its bytes where two names can look alike and differ.

    >>> name_in_bytes("a.jpg")
    "'a.jpg'"
    """
    shown = repr(name)
    return shown if name.isascii() else f"{shown} (in UTF-8 {name.encode()!r})"


def names_in_bytes(names: Sequence[str]) -> list[str]:
    """Names for a list: those of plain characters as they are, others as `name_in_bytes`."""
    return [name if name.isascii() else name_in_bytes(name) for name in names]


def first_names(names: Sequence[str], most: int) -> str:
    """The first of several names, with dots where there are more.

    >>> first_names(["a", "b", "c"], 2)
    'a, b ...'
    """
    listed = ", ".join(names[:most])
    if len(names) > most:
        return f"{listed} ..."
    return listed


def _shown(role: str) -> str:
    """A role as a text shows it: with blanks."""
    return role.replace("_", " ")
