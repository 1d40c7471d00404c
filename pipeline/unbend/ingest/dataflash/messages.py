"""Messages of the reader of ArduPilot logs: codes, and one function for each message."""

from collections.abc import Sequence

from unbend.errors import Code, Counted
from unbend.ingest.messages import LOG_DROPOUT, LOG_FIELDS
from unbend.messages import Message, fallback, finding, loss, note

LOG_BAD_FORMAT = Code(
    "LOG-BAD-FORMAT",
    means="A record that defines a message type is not valid.",
    effect="Messages of that type are not read. Without such messages it is a note.",
    remedy="Copy the log again.",
)


def bad_definition(*, file: str, definition: str) -> Message:
    """A definition is damaged; bytes that belong to no record may be records of it."""
    return loss(
        LOG_BAD_FORMAT,
        "an FMT record is not valid: {definition}",
        where=file,
        count=1,
        definition=definition,
    )


def unused_bad_definition(*, file: str, definition: str) -> Message:
    """A definition is damaged, but no record is lost: all bytes belong to defined records."""
    return note(
        LOG_BAD_FORMAT,
        "an FMT record is not valid: {definition}; there is no record of it",
        where=file,
        definition=definition,
    )


LOG_REDEFINED = Code(
    "LOG-REDEFINED",
    means="The type of a field changes between text and numbers within the log.",
    effect="Values of the other type are not in any channel.",
    remedy="Nothing, unless the channel is needed.",
)


def field_redefined(*, message: str, field: str, count: int, total: int) -> Message:
    """Two definitions of a message give one field as text and as number."""
    return loss(
        LOG_REDEFINED,
        (
            "{count} of {total} values of {field} have another type (text or number) than in the "
            "last definition of the log: they are in its table, but not in a channel"
        ),
        one=(
            "1 of {total} values of {field} has another type (text or number) than in the last "
            "definition of the log: it is in its table, but not in a channel"
        ),
        where=message,
        count=count,
        total=total,
        field=field,
    )


def no_utc_fields(*, message: str, count: int, fields: Sequence[str]) -> Message:
    """The rows of a receiver lack fields from which UTC is computed."""
    return loss(
        LOG_FIELDS,
        "{count} rows give no UTC: the log defines no field {fields}",
        one="1 row gives no UTC: the log defines no field {fields}",
        where=message,
        count=count,
        fields=", ".join(fields),
    )


def no_time_field(*, message: str, count: int) -> Message:
    """The rows of a message carry no time."""
    return loss(
        LOG_FIELDS,
        "{count} rows have no time: the log defines no field TimeUS",
        one="1 row has no time: the log defines no field TimeUS",
        where=message,
        count=count,
    )


def no_text_field(*, message: str, field: str) -> Message:
    """The log does not define the field of the autopilot's texts, or not as text."""
    return loss(
        LOG_FIELDS,
        "its rows contain no text: the log defines no field {field} for it",
        where=message,
        field=field,
    )


def fields_not_numbers(*, message: str, count: int, fields: Sequence[str]) -> Message:
    """Fields that should be numbers are defined as texts or arrays."""
    return loss(
        LOG_FIELDS,
        "{fields} of {rows} are not numbers, by their definition",
        where=message,
        count=count,
        fields=", ".join(fields),
        rows=Counted(count, "row"),
    )


def columns_without_field(*, message: str, count: int, columns: Sequence[str]) -> Message:
    """No field of a message gives a column that its roles need."""
    return loss(
        LOG_FIELDS,
        "{count} rows have no {columns}: the log defines no field for it",
        one="1 row has no {columns}: the log defines no field for it",
        where=message,
        count=count,
        columns=", ".join(columns),
    )


def dropped_by_logger(*, message: str, count: int) -> Message:
    """The logger counted messages that it could not write."""
    return finding(
        LOG_DROPOUT,
        "the log is incomplete: the logger counted {dropped} that it dropped",
        where=f"{message}.Dp",
        count=count,
        dropped=Counted(count, "message"),
    )


LOG_INSTANCE = Code(
    "LOG-INSTANCE",
    means="Single rows have a sensor number that does not occur in other rows: damage.",
    effect="They are not used.",
    remedy="Copy the log again.",
)


_LISTED_INSTANCES = 8  # instance numbers in a message


def stray_instances(
    *, message: str, count: int, numbers: Sequence[int], most: int, main: int
) -> Message:
    """A few rows have instance numbers that other rows lack.

    ``main`` is the instance with most rows, ``most`` their number: a hundred times more.
    """
    listed = ", ".join(map(str, numbers[:_LISTED_INSTANCES]))
    if len(numbers) > _LISTED_INSTANCES:
        listed += ", ..."
    return loss(
        LOG_INSTANCE,
        (
            "{count} rows are of instances ({numbers}) that do not occur in other rows; {most} are "
            "of instance {main}: damage, they are not used"
        ),
        one=(
            "1 row is of an instance ({numbers}) that does not occur in other rows; {most} are of "
            "instance {main}: damage, it is not used"
        ),
        where=message,
        count=count,
        numbers=listed,
        most=most,
        main=main,
    )


EVENTS_FIX_TIME = Code(
    "EVENTS-FIX-TIME",
    means="Exposures of an old log have no time. It is derived from the GNSS fix that they name.",
    effect="Allowed substitute. The sigmas of the stations include the sigma of this time.",
    remedy="Nothing. A newer firmware logs the time.",
)


def exposures_timed_by_fix(
    *, count: int, known: int, unknown: int, half_interval_s: float, sigma_s: float
) -> Message:
    """Rows of CAM have the time of the last fix instead of their own.

    ``known``: how many of these fixes are in the log; ``unknown``: how many are not.
    """
    return fallback(
        EVENTS_FIX_TIME,
        (
            "{count} exposures have no time since boot: {known} get the time of the fix that they "
            "name, plus half an interval of the receiver ({half_interval_s:.3f} s), with a sigma "
            "of {sigma_s:.3f} s; {unknown} get the time of the record before them"
        ),
        one=(
            "1 exposure has no time since boot: {known} get the time of the fix that they name, "
            "plus half an interval of the receiver ({half_interval_s:.3f} s), with a sigma of "
            "{sigma_s:.3f} s; {unknown} get the time of the record before them"
        ),
        where="CAM",
        count=count,
        known=known,
        unknown=unknown,
        half_interval_s=half_interval_s,
        sigma_s=sigma_s,
    )
