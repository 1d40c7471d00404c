"""Dates that a mission file states."""

from datetime import UTC, date, datetime
from typing import Annotated

from pydantic import AfterValidator

from unbend.config.section import SectionError
from unbend.flight.survey_dates import latest_ns
from unbend.units import NANOSECONDS_PER_SECOND

EARLIEST_DATE = date(1900, 1, 1)  # an earlier one is a typing error


def checked_date(value: str) -> str:
    """Check a day, perhaps with a time, and return it as it is; raises `SectionError` for others.

    It is not before `EARLIEST_DATE` and not in the future.
    """
    if not _is_survey_date(value):
        raise SectionError("is not a date like 2026-05-14 or 2026-05-14T10:20")
    if _nanoseconds_of_text(value) > latest_ns():
        raise SectionError("is in the future")
    return value


def checked_time(value: str) -> str:
    """Check a time and return it as it is; raises `SectionError` as `checked_date`."""
    if not _is_survey_date(value) or _nanoseconds_of_text(value) > latest_ns():
        raise SectionError("is not a time like 2026-05-14T10:20:00Z")
    return value


def _is_survey_date(value: str) -> bool:
    """Whether a text is a date, with or without a time, and not before `EARLIEST_DATE`."""
    try:
        day = datetime.fromisoformat(value).date()
    except ValueError:
        return False
    return day >= EARLIEST_DATE


StatedDate = Annotated[str, AfterValidator(checked_date)]
"""A value of a mission file that `checked_date` accepts."""

StatedTime = Annotated[str, AfterValidator(checked_time)]
"""A value of a mission file that `checked_time` accepts."""


def nanoseconds_of_time(value: str) -> int:
    """A stated time [Unix ns], UTC where it has no offset.

    >>> nanoseconds_of_time("1970-01-01T01:00:00+00:30")
    1800000000000
    """
    time = datetime.fromisoformat(value)
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    return round(time.timestamp()) * NANOSECONDS_PER_SECOND


def is_day_alone(value: str) -> bool:
    """Whether a stated date has no time of the day.

    >>> is_day_alone("2026-05-14"), is_day_alone("2026-05-14T12:00")
    (True, False)
    """
    return len(value) == len("2026-05-14")


def nanoseconds_of_date(value: str | None) -> int | None:
    """A stated date [Unix ns], UTC, None without one; a day without a time counts as its noon.

    >>> nanoseconds_of_date("2026-05-14") == nanoseconds_of_date("2026-05-14T12:00")
    True
    """
    return None if value is None else _nanoseconds_of_text(value)


def _nanoseconds_of_text(value: str) -> int:
    """As `nanoseconds_of_date`, for a date that is stated."""
    return nanoseconds_of_time(f"{value}T12:00" if is_day_alone(value) else value)
