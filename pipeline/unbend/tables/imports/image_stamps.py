"""Times of exposures as the tags of images write them: EXIF, ISO 8601, Unix and GPS seconds."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from unbend.flight.clock import SECONDS_PER_WEEK, utc_of_gps
from unbend.flight.survey_dates import can_be_flown
from unbend.tables.text_columns import FIRST_WEEK_OF_SURVEYS

LARGEST_WEEK = 9_999  # of GPS, in 2171: larger ones would not fit into 64 bits of nanoseconds
_STAMP = re.compile(
    r"(\d{4})[:/-](\d\d)[:/-](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,](\d+))?\s*(Z|[+-]\d\d:?\d\d)?"
)
_UNIX = re.compile(r"(\d{9,10})(?:\.(\d+))?")
FARTHEST_ZONE_S = 14 * 3600


class Stamp(NamedTuple):
    """A time [Unix ns], and ``step_s``, the step [s] in which its text counts.

    Without ``is_utc`` it is local time, counted as though it were UTC. ``by_gps``: the time is of a
    GPS receiver, not of the camera's clock.
    """

    time_ns: int
    step_s: float
    is_utc: bool
    by_gps: bool = False


def parse_time(text: str, zone: str = "") -> Stamp | None:
    """Read a time as EXIF, ISO 8601 or Unix seconds write it; None for another text.

    None also for a time that is impossible for a survey: in the future, or of a clock that was
    never set. ``zone`` is a UTC offset stated elsewhere, such as OffsetTimeOriginal, used where the
    text has none; without any the time is local.

    >>> parse_time("2026:05:01 10:20:30.25", "+02:00")
    Stamp(time_ns=1777623630250000000, step_s=0.01, is_utc=True, by_gps=False)
    >>> parse_time("1777623630.5").is_utc, parse_time("0000:00:00 00:00:00")
    (True, None)
    """
    text = text.strip()
    unix = _UNIX.fullmatch(text)
    date = _STAMP.fullmatch(text)
    if unix is not None:
        seconds: int | None = int(unix[1])
        decimals = unix[2] or ""
        offset = "Z"
    elif date is not None:
        seconds = _seconds_of_date(date)
        decimals = date[7] or ""
        offset = date[8] or zone.strip()
    else:
        return None
    ahead_s = _seconds_of_zone(offset)
    is_impossible_zone = ahead_s is None and _ZONE.fullmatch(offset) is not None
    if seconds is None or is_impossible_zone:
        return None
    decimals = decimals[:9]
    seconds_utc = seconds - (ahead_s or 0)
    time_ns = seconds_utc * 10**9 + int(decimals.ljust(9, "0"))
    if not bool(can_be_flown(np.array([time_ns]))[0]):
        return None
    is_utc = ahead_s is not None or offset in ("Z", "UTC")
    return Stamp(time_ns, 10.0 ** -len(decimals), is_utc)


def _seconds_of_date(date: re.Match[str]) -> int | None:
    """A match of `_STAMP` as seconds since 1970, as though UTC; None for an impossible date."""
    year, month, day = (int(date[group]) for group in (1, 2, 3))
    hour, minute, second = (int(date[group]) for group in (4, 5, 6))
    try:
        moment = datetime(
            year,
            month,
            day,
            hour=hour,
            minute=minute,
            second=second,
            tzinfo=UTC,
        )
    except ValueError:
        return None
    return int(moment.timestamp())


_ZONE = re.compile(r"(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d)")


def _seconds_of_zone(offset: str) -> int | None:
    """How far a zone written as +05:30 is ahead of UTC [s]; None for another text or size.

    No zone on earth is more than 14 hours from UTC.

    >>> _seconds_of_zone("-0330"), _seconds_of_zone("+14:00"), _seconds_of_zone("+23:59")
    (-12600, 50400, None)
    """
    zone = _ZONE.fullmatch(offset)
    if zone is None:
        return None
    minutes = int(zone["minutes"])
    ahead_s = int(zone["hours"]) * 3600 + minutes * 60
    if ahead_s > FARTHEST_ZONE_S or minutes >= 60:
        return None
    return -ahead_s if zone["sign"] == "-" else ahead_s


def _stamp_of_week(week: str, seconds: str) -> Stamp | None:
    """The time of a GPS week and its seconds as text; None for other texts or impossible times."""
    is_week = re.fullmatch(r"\d{1,5}", week) is not None
    is_seconds = re.fullmatch(r"\d{1,6}(\.\d*)?", seconds) is not None
    if not (is_week and is_seconds):
        return None
    if int(week) < FIRST_WEEK_OF_SURVEYS or float(seconds) > SECONDS_PER_WEEK:
        return None
    _, _, decimals = seconds.partition(".")
    time_ns = utc_of_gps(min(int(week), LARGEST_WEEK), float(seconds)).reshape(1)
    if not bool(can_be_flown(time_ns)[0]):
        return None
    return Stamp(
        int(time_ns[0]),
        step_s=10.0 ** -len(decimals),
        is_utc=True,
        by_gps=True,
    )


def time_of_tags(tags: Mapping[str, str], zone: str) -> Stamp | None:
    """The time of an exposure by the best of its image's tags; None if no tag has a readable time.

    The order is that of `read_image_times`. ``tags`` are texts by tag in lower case (`read_tags`).
    ``zone`` is the UTC offset of the camera's clock, used where the tags state none; else "".
    """
    dji = parse_time(tags.get("utcatexposure", ""), "UTC")
    if dji is not None:
        return dji._replace(by_gps=True)
    week = tags.get("gpsweek", "").strip()
    seconds = tags.get("gpsseconds", "").strip().replace(",", ".")
    by_week = _stamp_of_week(week, seconds)
    if by_week is not None:
        return by_week
    date_of_original = tags.get("datetimeoriginal", "")
    date_of_digitized = tags.get("datetimedigitized", "") or tags.get("createdate", "")
    texts_and_zones = [
        (tags.get("timeutc", ""), "UTC"),
        (tags.get("unixtime", ""), zone),
        (tags.get("timestamp", ""), zone),
        (tags.get("subsecdatetimeoriginal", ""), zone),
        _text_and_zone(tags, date_of_original, "original", zone),
        _text_and_zone(tags, date_of_digitized, "digitized", zone),
    ]
    for text, zone_of_text in texts_and_zones:
        stamp = parse_time(text, zone_of_text)
        if stamp is not None:
            return stamp
    return gps_stamp(tags)


def _text_and_zone(
    tags: Mapping[str, str],
    date: str,
    kind: str,
    zone: str,
) -> tuple[str, str]:
    """The text of ``date`` with the fraction of its second, and its zone, from the image's tags.

    ``kind`` is the ending of the tags that belong to this date: original or digitized. ``zone`` is
    used where no tag states an offset.
    """
    fraction = tags.get(f"subsectime{kind}", "").strip()
    if fraction.isdigit():
        date = re.sub(r"^(\S+[ T]\d\d:\d\d:\d\d)(?!\.)", rf"\g<1>.{fraction}", date.strip())
    offset = tags.get(f"offsettime{kind}", "").strip() or tags.get("offsettime", "").strip()
    return date, offset or zone


def gps_stamp(tags: Mapping[str, str]) -> Stamp | None:
    """The time of the GPS receiver's fix by the tags of an image; None without a readable one."""
    date = tags.get("gpsdatestamp", "") or tags.get("gpsdate", "")
    stamp = parse_time(f"{date} {tags.get('gpstimestamp', '')}", "UTC")
    return None if stamp is None else stamp._replace(by_gps=True)
