"""Messages that several log formats share: codes, and one function for each message and refusal.

Messages of a single format are in ``messages.py`` of its folder.
"""

from collections.abc import Mapping, Sequence

from unbend.errors import Code, Counted, LogError, MissionError
from unbend.flight.clock import WEEKS_PER_ROLLOVER
from unbend.flight.evidence.messages import CHANNEL_UNIT
from unbend.flight.messages import TIME_FIT
from unbend.ingest.utc_evidence import Witness, date_text
from unbend.messages import Kind, Message, fallback, loss, message, note, warning

# Opening a log.

LOG_MISSING = Code(
    "LOG-MISSING",
    means="There is no such file, or it is a folder, a pipe or a device.",
    effect="The log is refused.",
    remedy="Check the path of the log.",
)


def log_missing(*, path: str, what: str) -> LogError:
    """The path of a log does not lead to a file."""
    return LogError(
        LOG_MISSING, "{what}", where=path, remedy="check the path of the log", what=what
    )


LOG_EMPTY = Code(
    "LOG-EMPTY",
    means="The log has 0 bytes.",
    effect="The log is refused.",
    remedy="Copy it again from the vehicle or the ground station.",
)


def log_empty(*, path: str) -> LogError:
    """A log has no bytes."""
    return LogError(
        LOG_EMPTY,
        "the file has 0 bytes",
        where=path,
        remedy="copy it again from the vehicle or the ground station",
    )


LOG_UNREADABLE = Code(
    "LOG-UNREADABLE",
    means="The system cannot read the log.",
    effect="The log is refused.",
    remedy="Check permissions and the disk.",
)


def log_unreadable(*, path: str, reason: str) -> LogError:
    """The operating system refuses to read a log."""
    return LogError(
        LOG_UNREADABLE,
        "the system cannot read it: {reason}",
        where=path,
        remedy="check its permissions and the disk, or copy it again",
        reason=reason,
    )


LOG_CHANGED = Code(
    "LOG-CHANGED",
    means="The log grew or shrank while it was read.",
    effect="The log is refused.",
    remedy="Wait until it is complete.",
)


def log_changed(*, path: str, size: int, end: int) -> LogError:
    """A log is shorter than it was when its reading began."""
    return LogError(
        LOG_CHANGED,
        "it had {size} and now ends at byte {end}",
        where=path,
        remedy="wait until the log is complete, and read it again",
        size=Counted(size, "byte"),
        end=end,
    )


LOG_FORMAT = Code(
    "LOG-FORMAT",
    means=(
        "The file is not a log of a known format, has another format than its ending states, or "
        "contains no complete message."
    ),
    effect="The log is refused.",
    remedy=(
        "Give a .bin, .log, .tlog, .rlog, .mcap or .ulg. The refusal states how to rename or "
        "convert the file."
    ),
)


def wrong_extension(*, path: str, title: str, extension: str, usual: str) -> LogError:
    """The content of a log is of another format than its extension."""
    return LogError(
        LOG_FORMAT,
        "its content is {title}, its extension is {extension}",
        where=path,
        remedy="rename it to end in {usual} if this is the intended log",
        title=title,
        extension=extension or "missing",
        usual=usual,
    )


def needs_conversion(*, path: str, kind: str, remedy: str) -> LogError:
    """A file of a related format, which is not read."""
    return LogError(LOG_FORMAT, "the file is {kind}", where=path, remedy=remedy, kind=kind)


def unknown_format(*, path: str, extension: str, known: str) -> LogError:
    """Neither content nor extension is one of a known format."""
    return LogError(
        LOG_FORMAT,
        "neither content nor extension ({extension}) belongs to a known format",
        where=path,
        remedy="give one of {known}",
        extension=extension or "none",
        known=known,
    )


def no_whole_message(
    *, path: str, title: str, size: int, damage: Sequence[Message], known: str
) -> LogError:
    """A file with the extension of a format has no complete message; ``damage`` lists why."""
    listed = "".join(f"; {message.what} ({message.where})" for message in damage)
    return LogError(
        LOG_FORMAT,
        "no complete message of {title} in {size}{damage}",
        where=path,
        remedy="check that the log is complete; known formats are {known}",
        title=title,
        size=Counted(size, "byte"),
        damage=listed,
        known=known,
    )


LOG_NO_MESSAGES = Code(
    "LOG-NO-MESSAGES",
    means="The log has messages, but none with positions, attitudes, air data or camera events.",
    effect="The log is refused.",
    remedy="Check which messages the vehicle logs.",
)


def no_wanted_messages(
    *, path: str, total: int, kinds: Sequence[str], unread: Mapping[str, str]
) -> LogError:
    """No message of a log becomes a channel; ``unread``: a topic by encoding that is not read."""
    if unread:
        listed = [f"{encoding} ({topic})" for encoding, topic in unread.items()]
        return LogError(
            LOG_NO_MESSAGES,
            "{total}, but none that can be read: they are encoded as {encodings}",
            where=path,
            remedy="record or convert them as ROS 2 CDR with ros2msg definitions, protobuf or JSON",
            total=Counted(total, "message"),
            encodings=", ".join(listed),
        )
    return LogError(
        LOG_NO_MESSAGES,
        "{total}, but none with a position, an attitude, air data or camera events",
        where=path,
        remedy=(
            "check which messages the vehicle logs; this log has {kinds}, which `unbend inspect "
            "--type` shows"
        ),
        total=Counted(total, "message"),
        kinds=", ".join(kinds),
    )


# Requests to a log that was read.

LOG_NO_CHANNEL = Code(
    "LOG-NO-CHANNEL",
    means="The log has no channel of this name.",
    effect="The call is refused.",
    remedy="Take one of the names that the refusal lists.",
)


def no_channel(*, path: str, name: str, available: str) -> LogError:
    """A log has no channel of a name; ``available`` lists what it has."""
    return LogError(
        LOG_NO_CHANNEL,
        "no channel {name}",
        where=path,
        remedy="{available}",
        name=name,
        available=available,
    )


LOG_NO_TYPE = Code(
    "LOG-NO-TYPE",
    means="The log has no message of this type.",
    effect="The command is refused.",
    remedy="Choose one that `unbend inspect` lists.",
)


def no_message_type(*, path: str, name: str, available: str) -> LogError:
    """A log has no message of a type; ``available`` lists what it has."""
    return LogError(
        LOG_NO_TYPE,
        "no message of type {name}",
        where=path,
        remedy="{available}",
        name=name,
        available=available,
    )


LOG_NO_TABLE = Code(
    "LOG-NO-TABLE",
    means="A message type has no rows that can be written as a table.",
    effect="The command is refused.",
    remedy="Choose another type that `unbend inspect` lists.",
)


def no_table(*, path: str, name: str, instance: str | None) -> LogError:
    """A message type, or one of its instances, gives no table."""
    selected = name if instance is None else f"{name}, instance {instance},"
    return LogError(
        LOG_NO_TABLE,
        "{selected} has no rows that can be written as a table",
        where=path,
        remedy=(
            "choose another type or instance that `unbend inspect` lists; leave out --instance for "
            "a type that it lists without one"
        ),
        selected=selected,
    )


def not_a_unit_of_role(*, role: str, unit: str, columns: Sequence[str]) -> MissionError:
    """The mission file states a unit of another quantity."""
    return MissionError(
        CHANNEL_UNIT,
        "{unit} is not a unit of {quantity}",
        where=f"log.channels.{role}",
        remedy="its column is {columns}",
        unit=unit,
        quantity=role.replace("_", " "),
        columns=", ".join(columns),
    )


# Damage.

LOG_BAD_BYTES = Code(
    "LOG-BAD-BYTES",
    means="Bytes of the log belong to no message: damage.",
    effect="The messages there are lost; the rest is read.",
    remedy="Copy the log again from its source.",
)


def bad_bytes(*, file: str, first: int, count: int, unit: str) -> Message:
    """Bytes between messages; ``unit`` is the format's word for a message."""
    return loss(
        LOG_BAD_BYTES,
        "{count} bytes belong to no {unit}",
        one="1 byte belongs to no {unit}",
        where=f"{file}, first at byte {first}",
        count=count,
        unit=unit,
    )


LOG_TRUNCATED = Code(
    "LOG-TRUNCATED",
    means="The last message or record is cut off, as when the power is lost.",
    effect="All complete messages before it were read.",
    remedy="Nothing, if the flight was over.",
)


def cut_off(*, file: str, count: int, unit: str) -> Message:
    """The end of a file cuts off a message; ``unit`` is the format's word for a message."""
    return loss(
        LOG_TRUNCATED,
        (
            "the last {unit} is cut off after {count} bytes, as when the power is lost: this "
            "format has no end mark; all complete ones before it were read"
        ),
        one=(
            "the last {unit} is cut off after 1 byte, as when the power is lost: this format has "
            "no end mark; all complete ones before it were read"
        ),
        where=file,
        count=count,
        unit=unit,
    )


LOG_TOO_LARGE = Code(
    "LOG-TOO-LARGE",
    means=(
        "A part of the log (a chunk, a number of names, definitions, power-ups, senders) is "
        "impossibly large. The log is damaged, or was made to exhaust the memory."
    ),
    effect="This part is not read. If nothing can be read without it, the log is refused.",
    remedy="Copy the log again. `docs/pages/limits.md` has the limits.",
)


def too_much_damage(*, file: str, first: int, places: int) -> Message:
    """A log is damaged at so many places that the rest of it is not searched for messages."""
    return loss(
        LOG_TOO_LARGE,
        "it is damaged at {places} places: the part after byte {first} is not read",
        where=file,
        places=places,
        first=first,
    )


def too_many_boots(*, count: int, most: int) -> LogError:
    """The time since boot of a log begins anew more often than a vehicle is switched on."""
    return LogError(
        LOG_TOO_LARGE,
        "its time since boot begins again {count} times or more; at most {most} power-ups are read",
        remedy="copy the log again, or cut it at a power-up",
        count=count,
        most=most,
    )


def too_many_definitions(*, name: str, most: int) -> LogError:
    """A log has too many different definitions of one message."""
    return LogError(
        LOG_TOO_LARGE,
        "{name} is defined in more than {most} different ways",
        remedy="copy the log again",
        name=name,
        most=most,
    )


def too_many_redefinitions(*, name: str, most: int) -> LogError:
    """Types of records in a binary log change their definition too often, last that of ``name``."""
    return LogError(
        LOG_TOO_LARGE,
        (
            "types of records change their definition more than {most} times; the last of them is "
            "{name}"
        ),
        remedy="copy the log again",
        name=name,
        most=most,
    )


def too_many_senders(*, count: int, most: int) -> LogError:
    """A telemetry log has too many senders."""
    return LogError(
        LOG_TOO_LARGE,
        "{senders} sent messages; at most {most} are read",
        remedy="copy the log again, or keep the messages of the vehicle",
        senders=Counted(count, "component"),
        most=most,
    )


def too_many_fields(*, count: int, most: int) -> LogError:
    """The formats of a PX4 log have too many fields, nested ones included."""
    return LogError(
        LOG_TOO_LARGE,
        "its formats have {fields} or more; at most {most} are read",
        remedy="copy the log again",
        fields=Counted(count, "field"),
        most=most,
    )


def table_too_wide(*, columns: int, rows: int, filled: int, most: int) -> LogError:
    """The messages of a table have different fields, so that most values would be missing."""
    return LogError(
        LOG_TOO_LARGE,
        "{rows} messages with {filled} values have {columns} fields together: the table would have "
        "more than {most} values",
        remedy="read the channels of the log instead of this table",
        rows=rows,
        filled=filled,
        columns=columns,
        most=most,
    )


def too_many_series(*, file: str, count: int, most: int) -> Message:
    """The log has more topics, senders or instances than channels are made of."""
    return loss(
        LOG_TOO_LARGE,
        "{count} messages are not read: the log has more than {most} topics, senders and instances",
        one="1 message is not read: the log has more than {most} topics, senders and instances",
        where=file,
        count=count,
        most=most,
    )


LOG_CRC = Code(
    "LOG-CRC",
    means="Messages, a chunk, the summary or the whole data section fail their checksum.",
    effect=(
        "Such messages, chunks and summaries are not used. If only the checksum of the data "
        "section fails, the data are used."
    ),
    remedy="Copy the log again from its source.",
)

LOG_LINK_LOSS = Code(
    "LOG-LINK-LOSS",
    means=(
        "The log is incomplete. The sequence numbers show that messages are missing. The radio "
        "link or the recorder lost them."
    ),
    effect=(
        "Stations and air are interpolated between the other messages. A run ends with exit code 3 "
        "until it is accepted."
    ),
    remedy="Use the log from the vehicle's card instead, or accept it with the reason.",
)

LOG_FIELDS = Code(
    "LOG-FIELDS",
    means="The log does not define a field that a message needs, such as the time or a position.",
    effect="The rows, or the values that need this field, are not used.",
    remedy="Update the firmware, or use another message.",
)


def rows_without_field(*, where: str, count: int, fields: Sequence[str]) -> Message:
    """A message lacks the fields without which its rows cannot be used."""
    return loss(
        LOG_FIELDS,
        "{count} rows cannot be used: the log defines no field for {fields}",
        one="1 row cannot be used: the log defines no field for {fields}",
        where=where,
        count=count,
        fields=", ".join(fields),
    )


LOG_DROPOUT = Code(
    "LOG-DROPOUT",
    means="The logger could not keep up: it dropped messages, and counted them.",
    effect=(
        "The log is incomplete. Exposures without a position or an attitude near them are flagged "
        "(in_gap), the others are not affected. A run ends with exit code 3 until it is "
        "accepted."
    ),
    remedy=(
        "If no image is in a gap, accept it with this reason. Next time log less, or to a faster "
        "card."
    ),
)


EVENTS_BOTH = Code(
    "EVENTS-BOTH",
    means="One topic has commands of the trigger and pulses of the shutter.",
    effect=(
        "They become two channels. The pulses keep the name. The name of the commands ends in "
        ".sent."
    ),
    remedy="Name the channel with the pulses.",
)


def pulses_and_commands(*, channel: str, pulses: int, sent: str, commands: int) -> Message:
    """One topic has pulses of a shutter, and commands of a trigger for the channel ``sent``."""
    return note(
        EVENTS_BOTH,
        "{pulses} rows are pulses of the shutter (channel {channel}), {commands} are commands of "
        "the trigger (channel {sent})",
        where=channel,
        count=pulses + commands,
        channel=channel,
        pulses=pulses,
        sent=sent,
        commands=commands,
    )


LOG_GAP = Code(
    "LOG-GAP",
    means="Nothing was logged for more than 1 s (a radio link: 3 s; PX4: from 0.1 s on).",
    effect=(
        "Exposures in this time may have no station (in_gap). If the vehicle's clock advanced in "
        "the meantime, the log is incomplete. A run then ends with exit code 3 until that is "
        "accepted."
    ),
    remedy="Check the card or the link; use another log, or accept it with the reason.",
)


def nothing_logged(*, byte: int, count: int, seconds: float) -> Message:
    """The time since boot advances by more than 1 s between two records."""
    return warning(
        LOG_GAP,
        "{times} nothing was logged for more than 1 s, {seconds:.1f} s together: the logger "
        "stopped, or bytes are missing",
        where=f"first before byte {byte}",
        count=count,
        times=Counted(count, "time"),
        seconds=seconds,
    )


# Time.

TIME_STRAY = Code(
    "TIME-STRAY",
    means="Rows have a time that does not fit their neighbours: damage.",
    effect="They are not used.",
    remedy="Copy the log again.",
)


def stray_records(*, byte: int, count: int) -> Message:
    """The times of records jump and return."""
    return loss(
        TIME_STRAY,
        "{count} records have a time that does not fit their neighbours",
        one="1 record has a time that does not fit its neighbours",
        where=f"first at byte {byte}",
        count=count,
    )


def stray_rows(*, channel: str, first: int, count: int, total: int) -> Message:
    """The times of rows of a channel jump and return."""
    return loss(
        TIME_STRAY,
        "{count} of {total} rows have a time that does not fit their neighbours: they are not used",
        one="1 of {total} rows has a time that does not fit its neighbours: it is not used",
        where=f"{channel}, first at row {first}",
        count=count,
        total=total,
    )


TIME_REPEAT = Code(
    "TIME-REPEAT",
    means="Rows repeat the time of a row before.",
    effect="They are not used. It is a loss if they are exposures.",
    remedy="Nothing, unless exposures are lost.",
)


def repeated_rows(*, kind: Kind, channel: str, count: int, total: int) -> Message:
    """Rows have the time of the row before, or equal the first row with their time.

    ``kind``: a loss where the rows are exposures, else a note.
    """
    return message(
        kind,
        TIME_REPEAT,
        "{count} of {total} rows repeat the time of a row before and are not used",
        one="1 of {total} rows repeats the time of a row before and is not used",
        where=channel,
        count=count,
        total=total,
    )


TIME_BACKWARD = Code(
    "TIME-BACKWARD",
    means="Rows are out of order in time.",
    effect="They are not used.",
    remedy="Nothing, if they are few.",
)


def rows_out_of_order(*, channel: str, first: int, stamp: str, count: int, total: int) -> Message:
    """Rows are earlier than rows before them."""
    return loss(
        TIME_BACKWARD,
        "{count} of {total} rows are out of order in time and are not used",
        one="1 of {total} rows is out of order in time and is not used",
        where=f"{channel}, first at row {first}, stamped {stamp}",
        count=count,
        total=total,
    )


TIME_SET_BACK = Code(
    "TIME-SET-BACK",
    means="The clock of some messages was set back.",
    effect="Values are not interpolated across these steps.",
    remedy="Nothing.",
)


def clock_set_back(*, channel: str, count: int) -> Message:
    """The times of a channel step back and go on from there."""
    return warning(
        TIME_SET_BACK,
        "the clock of these messages was set back, {times}: values are not interpolated across "
        "these steps",
        one="the clock of these messages was set back, 1 time: values are not interpolated across "
        "this step",
        where=channel,
        count=count,
        times=Counted(count, "time"),
    )


TIME_REBOOT = Code(
    "TIME-REBOOT",
    means="The vehicle was restarted during the log.",
    effect="Each part has a separate clock. Values are not interpolated between the parts.",
    remedy="Nothing.",
)


def restarted(*, where: str, count: int) -> Message:
    """The difference of UTC and time since boot steps at a gap of the log."""
    return warning(
        TIME_REBOOT,
        (
            "{times} UTC and the time since boot disagree before and after a gap: the vehicle was "
            "restarted, although its time is later"
        ),
        where=where,
        count=count,
        times=Counted(count, "time"),
    )


TIME_NO_UTC = Code(
    "TIME-NO-UTC",
    means="The log has no UTC. Its time counts from boot or from zero.",
    effect="Events in this log can be used. Matching by UTC is impossible.",
    remedy="Take the exposures from the log itself.",
)


def no_utc(*, where: str, utc_of: str) -> Message:
    """No clock of the log gives UTC; ``utc_of`` names what gives it in this format."""
    return fallback(
        TIME_NO_UTC,
        "no {utc_of}: time counts from boot and is shown as 1970; events in this log can be used, "
        "matching by UTC is impossible",
        where=where,
        utc_of=utc_of,
    )


TIME_SOURCES = Code(
    "TIME-SOURCES",
    means="Two sources of UTC in the log contradict each other.",
    effect="The better one is used.",
    remedy="Check the receivers.",
)


def sources_disagree(*, where: str, rows: int, source: str, apart_s: float, used: str) -> Message:
    """A source of UTC, of so many ``rows``, differs by more than 1 s from the source in use."""
    return loss(
        TIME_SOURCES,
        "{source} give a UTC that differs by {apart_s:+.3f} s from that of {used}, which are used",
        one=(
            "{source} gives a UTC that differs by {apart_s:+.3f} s from that of {used}, which are "
            "used"
        ),
        where=where,
        count=rows,
        source=source,
        apart_s=apart_s,
        used=used,
    )


def recorder_disagrees(*, where: str, recorder: str, apart_s: float, used: str) -> Message:
    """The clock of the ground station or the recorder is more than a minute from UTC."""
    return warning(
        TIME_SOURCES,
        (
            "the time of the {recorder} differs by {apart_s:+.0f} s from the UTC of {used}, which "
            "are used"
        ),
        where=where,
        recorder=recorder,
        apart_s=apart_s,
        used=used,
    )


TIME_WEEK_ROLLOVER = Code(
    "TIME-WEEK-ROLLOVER",
    means=(
        "A receiver counts weeks modulo 1024. Its date is wrong by 19.6 years or a multiple of it."
    ),
    effect=(
        "The date is corrected by this amount, because the other clocks of the log agree with it "
        "or no other date is possible."
    ),
    remedy="Check the date in the report. Update the receiver's firmware.",
)


def week_rollover(
    *,
    where: str,
    source: str,
    count: int,
    stated: str,
    moved: str,
    rollovers: int,
    clocks: Sequence[Witness],
) -> Message:
    """The date of a source of UTC is off by rollovers of the GPS week."""
    return warning(
        TIME_WEEK_ROLLOVER,
        (
            "UTC of {source} is {stated}: the receiver counts weeks modulo 1024; {weeks} weeks "
            "later is {moved}, {evidence}"
        ),
        where=where,
        count=count,
        source=source,
        stated=stated,
        moved=moved,
        weeks=WEEKS_PER_ROLLOVER * rollovers,
        evidence=_agrees_with(clocks) or "the only possible date",
    )


def _agrees_with(clocks: Sequence[Witness]) -> str:
    """The other clocks of a log with the dates that they state; empty without any."""
    dates = [f"{clock.name} ({date_text(clock.time_ns)})" for clock in clocks]
    return f"which agrees with {', '.join(dates)}" if dates else ""


TIME_IMPOSSIBLE = Code(
    "TIME-IMPOSSIBLE",
    means=(
        "A clock of the log states an impossible date. Or no receiver has set the clock, and the "
        "other clocks contradict it."
    ),
    effect="It is not used. UTC is taken from the other clocks, or is unknown.",
    remedy="If no other clock has the date, state mission.date.",
)


def utc_not_accepted(*, where: str, source: str, stated: str, clocks: Sequence[Witness]) -> Message:
    """The date of a source of UTC is impossible, or contradicted by better clocks."""
    other_clocks = [f"{clock.name} of {date_text(clock.time_ns)}" for clock in clocks]
    return warning(
        TIME_IMPOSSIBLE,
        (
            "UTC of {source} is {stated}, which is impossible or contradicted ({others}): it is "
            "not used"
        ),
        where=where,
        source=source,
        stated=stated,
        others=", ".join(other_clocks) or "no other clock gives the date",
    )


def utc_accuracy(
    *, receiver: str, fixes: int, sigma_s: float, delay_s: float, origin: str
) -> Message:
    """How accurate UTC is, by the delay of the receiver's fixes."""
    return note(
        TIME_FIT,
        "UTC is accurate to {sigma_ms:.0f} ms (1 sigma): fixes are stamped {delay_ms:.0f} ms "
        "after their epoch, {origin}",
        where=receiver,
        count=fixes,
        sigma_ms=sigma_s * 1e3,
        delay_ms=delay_s * 1e3,
        origin=origin,
    )


def fix_delay(
    *, receiver: str, fixes: int, utc_sigma_s: float | None, delay_s: float, origin: str
) -> Message:
    """How late fixes are stamped, in a log that has UTC from another clock than the receiver's.

    ``utc_sigma_s``: of this UTC [s]; None if UTC is unknown.
    """
    accuracy = (
        "is unknown" if utc_sigma_s is None else f"is accurate to {utc_sigma_s:.1f} s (1 sigma)"
    )
    return note(
        TIME_FIT,
        "UTC {accuracy}; fixes are stamped {delay_ms:.0f} ms after their epoch, {origin}",
        where=receiver,
        count=fixes,
        accuracy=accuracy,
        delay_ms=delay_s * 1e3,
        origin=origin,
    )


# Positions and exposures.

POSITION_NO_FIX = Code(
    "POSITION-NO-FIX",
    means="Rows of a receiver have no fix.",
    effect="They are not used.",
    remedy="Nothing.",
)


def rows_without_fix(*, channel: str, count: int, total: int) -> Message:
    """Rows of a position have no fix, or the place 0, 0."""
    return note(
        POSITION_NO_FIX,
        "{count} of {total} rows have no fix and are not used",
        one="1 of {total} rows has no fix and is not used",
        where=channel,
        count=count,
        total=total,
    )


HEIGHT_ELLIPSOID = Code(
    "HEIGHT-ELLIPSOID",
    means="A parameter of the autopilot selects GNSS heights above the ellipsoid.",
    effect=(
        "The heights of the log are treated as ellipsoidal heights, and reduced by the undulation. "
        "Heights that the log computed with an undulation stay."
    ),
    remedy="Nothing.",
)


def heights_above_ellipsoid(*, where: str, parameter: str) -> Message:
    """A parameter makes the autopilot use the receiver's height above the ellipsoid."""
    return note(
        HEIGHT_ELLIPSOID,
        (
            "the parameter {parameter} selects GNSS heights above the ellipsoid: all heights of "
            "this log are ellipsoidal, except those that are computed with the undulation"
        ),
        where=where,
        parameter=parameter,
    )


EVENT_FAILED = Code(
    "EVENT-FAILED",
    means="Rows report that the camera took no image.",
    effect="They are not used as exposures.",
    remedy="Check the camera's storage and trigger, if there are many.",
)


def failed_exposures(*, channel: str, count: int, total: int) -> Message:
    """Rows of a camera report a failure."""
    return warning(
        EVENT_FAILED,
        "{count} of {total} rows report that the camera took no image",
        one="1 of {total} rows reports that the camera took no image",
        where=channel,
        count=count,
        total=total,
    )


EVENT_NO_INDEX = Code(
    "EVENT-NO-INDEX",
    means="All exposures of the log have the image index 0.",
    effect="They are numbered from 0 in the order of time.",
    remedy="Check the pattern under events.log.<camera>.image.",
)


def exposures_without_index(*, channel: str, count: int) -> Message:
    """The image index of a camera is never filled in."""
    return note(
        EVENT_NO_INDEX,
        "all {count} rows have the index 0: they are numbered from 0 in order",
        one="the only row has the index 0: it is numbered from 0",
        where=channel,
        count=count,
    )
