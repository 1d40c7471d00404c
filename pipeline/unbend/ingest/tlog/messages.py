"""Messages of the reader of telemetry logs: codes, and a function for each message."""

from collections.abc import Sequence

from unbend.errors import Code, Counted
from unbend.flight.messages import EVENTS_TRIGGER_TIME
from unbend.ingest.messages import LOG_CRC, LOG_GAP, LOG_LINK_LOSS, TIME_STRAY
from unbend.messages import Message, fallback, finding, loss, note, warning

# Messages that are not read, or missing.

LOG_UNKNOWN_ID = Code(
    "LOG-UNKNOWN-ID",
    means="Messages have ids that the MAVLink dialect does not define.",
    effect="They are not checked and not read.",
    remedy="Nothing, unless these messages are needed.",
)


def unknown_ids(*, file: str, first: int, count: int, ids: Sequence[int]) -> Message:
    """Between accepted frames there are frames of ids outside the dialect, one after the other."""
    return warning(
        LOG_UNKNOWN_ID,
        "{count} messages have ids that the dialect does not define ({ids}): not checked, not read",
        one="1 message has an id that the dialect does not define ({ids}): not checked, not read",
        where=f"{file}, first at byte {first}",
        count=count,
        ids=", ".join(map(str, ids)),
    )


def checksums_fail(*, file: str, first: int, count: int, name: str) -> Message:
    """Some messages of a type are damaged."""
    return loss(
        LOG_CRC,
        "{count} messages {name} fail their checksum",
        one="1 message {name} fails its checksum",
        where=f"{file}, first at byte {first}",
        count=count,
        name=name,
    )


LOG_DIALECT = Code(
    "LOG-DIALECT",
    means=(
        "All messages of a type fail their checksum. They were written with another version of the "
        "dialect. Or pymavlink was installed without its dialects."
    ),
    effect="None. These messages are not needed.",
    remedy="Nothing.",
)


def another_dialect(*, file: str, first: int, count: int, name: str) -> Message:
    """All messages of a type that is not needed fail their checksum."""
    return warning(
        LOG_DIALECT,
        (
            "{count} messages {name} fail their checksum, all of this type: another version of the "
            "dialect; they are not needed"
        ),
        one=(
            "1 message {name} fails its checksum, the only one of this type: another version of "
            "the dialect; it is not needed"
        ),
        where=f"{file}, first at byte {first}",
        count=count,
        name=name,
    )


def lost_by_radio(*, file: str, count: int, system: int, component: int) -> Message:
    """The sequence numbers of a sender have gaps."""
    return finding(
        LOG_LINK_LOSS,
        "the log is incomplete: at least {messages} of system {system}, component {component} are "
        "missing by their sequence numbers, which begin again after 256: the radio link lost them",
        one="the log is incomplete: at least {messages} of system {system}, component {component} "
        "is missing by its sequence number, which begins again after 256: the radio link lost it",
        where=file,
        count=count,
        messages=Counted(count, "message"),
        system=system,
        component=component,
    )


def sender_silent(
    *,
    file: str,
    byte: int,
    count: int,
    system: int,
    component: int,
    least_s: float,
    total_s: float,
) -> Message:
    """A sender's clock advances while nothing of it is recorded."""
    return finding(
        LOG_GAP,
        "the log is incomplete: nothing of system {system}, component {component} was recorded "
        "{times} for more than {least_s:.0f} s, {total_s:.1f} s in total, while its clock "
        "advanced: the link was down, or bytes are missing",
        where=f"{file}, first before byte {byte}",
        count=count,
        system=system,
        component=component,
        times=Counted(count, "time"),
        least_s=least_s,
        total_s=total_s,
    )


# Clocks.


def stray_stamps(*, file: str, first: int, count: int) -> Message:
    """Stamps of the ground station, which no checksum covers, jump and return."""
    return loss(
        TIME_STRAY,
        (
            "{count} messages have a time stamp of the ground station that does not fit their "
            "neighbours: the stamp before is used"
        ),
        one=(
            "1 message has a time stamp of the ground station that does not fit its neighbours: "
            "the stamp before is used"
        ),
        where=f"{file}, first at byte {first}",
        count=count,
    )


TIME_WRAP = Code(
    "TIME-WRAP",
    means="The 32-bit count of milliseconds since boot overflowed after 49.7 days.",
    effect="It is continued.",
    remedy="Nothing.",
)


def count_wrapped(*, sender: str, count: int) -> Message:
    """A sender was on for more than 49.7 days."""
    return note(
        TIME_WRAP,
        (
            "the 32-bit count of milliseconds since boot overflowed after 49.7 days, {times}: it "
            "is continued"
        ),
        where=sender,
        count=count,
        times=Counted(count, "time"),
    )


TIME_HOST_CLOCK = Code(
    "TIME-HOST-CLOCK",
    means="No message has the vehicle's UTC. The ground station's clock is used.",
    effect="Times may differ by seconds from UTC. Events of the same log still fit.",
    remedy="Use events of this log, not of another clock.",
)


def no_vehicle_time() -> Message:
    """No message of a log has a time of its own."""
    return fallback(
        TIME_HOST_CLOCK,
        (
            "no message has the vehicle's time: the ground station's clock is used, which may "
            "differ by seconds from UTC"
        ),
    )


def set_by_host_clock(
    *, sender: str, boot: int, count: int, spread_ms: float, sigma_s: float
) -> Message:
    """A sender has a time since boot, and no message that ties this to UTC."""
    return fallback(
        TIME_HOST_CLOCK,
        (
            "no SYSTEM_TIME with UTC: the clock is set by the stamps of {messages}, which come "
            "from the ground station: UTC is accurate to {sigma_s:.0f} s (1 sigma); the stamps "
            "scatter by {spread_ms:.0f} ms (p5 to p95)"
        ),
        where=f"{sender}, boot {boot}",
        count=count,
        messages=Counted(count, "message"),
        spread_ms=spread_ms,
        sigma_s=sigma_s,
    )


def no_clock_of_system(*, sender: str, count: int) -> Message:
    """No component of a system has a clock."""
    return fallback(
        TIME_HOST_CLOCK,
        "no clock of this system is known: {count} messages have the time at which they were "
        "received, by a ground station's clock that may differ by seconds from UTC",
        one="no clock of this system is known: 1 message has the time at which it was "
        "received, by a ground station's clock that may differ by seconds from UTC",
        where=sender,
        count=count,
    )


TIME_OWN_UTC = Code(
    "TIME-OWN-UTC",
    means="The UTC of a camera component contradicts the time of reception of its messages.",
    effect="Its time since boot is used.",
    remedy="Set the camera's clock.",
)


def camera_utc_wrong(*, sender: str, count: int, late_s: float) -> Message:
    """The UTC of images does not fit the time at which they were received."""
    return loss(
        TIME_OWN_UTC,
        "the UTC of {images} is {late_s:.1f} s before they were received: that camera's clock is "
        "wrong, its time since boot is used",
        one="the UTC of {images} is {late_s:.1f} s before it was received: that camera's clock is "
        "wrong, its time since boot is used",
        where=sender,
        count=count,
        images=Counted(count, "image"),
        late_s=late_s,
    )


TIME_BORROWED = Code(
    "TIME-BORROWED",
    means="A component has no clock. The clock of another component of the vehicle is used.",
    effect=(
        "A note; a loss if the times do not fit. Then exposures may be late by the delay of the "
        "link."
    ),
    remedy="Log on the vehicle, or give the times of the images.",
)


def clock_borrowed(*, sender: str, count: int, lender: int, late_s: float) -> Message:
    """The times of a sender fit the clock of another component."""
    return note(
        TIME_BORROWED,
        (
            "it has no clock: the times of {count} messages are read with the clock of component "
            "{lender}; this fits, because they were received {late_s:.1f} s later"
        ),
        one=(
            "it has no clock: the time of 1 message is read with the clock of component {lender}; "
            "this fits, because it was received {late_s:.1f} s later"
        ),
        where=sender,
        count=count,
        lender=lender,
        late_s=late_s,
    )


def clock_not_borrowed(*, sender: str, count: int, lender: int, late_s: float) -> Message:
    """The times of a sender do not fit the clock of another component."""
    return loss(
        TIME_BORROWED,
        (
            "the times since boot of {count} messages do not fit the clock of component {lender}: "
            "with that clock they would be {late_s:.1f} s old when they were received; their clock "
            "is set by the time of reception, and exposures may be late by the delay of the link"
        ),
        one=(
            "the time since boot of 1 message does not fit the clock of component {lender}: with "
            "that clock it would be {late_s:.1f} s old when it was received; its clock is set by "
            "the time of reception, and exposures may be late by the delay of the link"
        ),
        where=sender,
        count=count,
        lender=lender,
        late_s=late_s,
    )


# Exposures.

EVENT_EMPTY = Code(
    "EVENT-EMPTY",
    means="Rows of camera feedback have neither time nor place. No exposure was made.",
    effect="They are not used.",
    remedy="Nothing.",
)


def empty_feedback(*, channel: str, count: int, total: int) -> Message:
    """Rows of CAMERA_FEEDBACK are empty."""
    return note(
        EVENT_EMPTY,
        "{count} of {total} rows have neither time nor place: no exposure",
        one="1 of {total} rows has neither time nor place: no exposure",
        where=channel,
        count=count,
        total=total,
    )


EVENT_REPEAT = Code(
    "EVENT-REPEAT",
    means="Rows repeat an exposure, because a ground station logs them twice.",
    effect="The first of each is used.",
    remedy="Nothing.",
)


def repeated_events(*, channel: str, count: int, total: int, what: str) -> Message:
    """Rows repeat ``what``: the time of an exposure, or an image."""
    return note(
        EVENT_REPEAT,
        "{count} of {total} rows repeat {what}",
        one="1 of {total} rows repeats {what}",
        where=channel,
        count=count,
        total=total,
        what=what,
    )


EVENT_NO_PULSE = Code(
    "EVENT-NO-PULSE",
    means=(
        "Image numbers of the log have no time. The camera was triggered, and its feedback was "
        "lost."
    ),
    effect="These images have no station.",
    remedy="If these images are needed, take their times from another source (events.csv).",
)


def numbers_without_feedback(*, channel: str, count: int, first: int) -> Message:
    """Image numbers are only in rows that repeat the time of another image."""
    return warning(
        EVENT_NO_PULSE,
        (
            "{count} image numbers have no time (the first is {first}): the camera was triggered, "
            "and its feedback was lost"
        ),
        one=(
            "1 image number has no time (it is {first}): the camera was triggered, and its "
            "feedback was lost"
        ),
        where=channel,
        count=count,
        first=first,
    )


def times_of_triggers(*, channel: str, count: int) -> Message:
    """The feedback of a camera has Unix time: that of the trigger command."""
    return note(
        EVENTS_TRIGGER_TIME,
        (
            "{count} exposures have Unix time, as autopilots send it without a feedback pin: it is "
            "the time of the trigger command, and the shutter opens later (70 to 530 ms were "
            "measured); state this delay as events.log.<camera>.delay_s"
        ),
        one=(
            "1 exposure has Unix time, as autopilots send it without a feedback pin: it is the "
            "time of the trigger command, and the shutter opens later (70 to 530 ms were "
            "measured); state this delay as events.log.<camera>.delay_s"
        ),
        where=channel,
        count=count,
    )
