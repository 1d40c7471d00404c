"""Soundings of the University of Wyoming: the list of its web page, and its CSV.

The list has columns seven places wide in which a field may be blank. The heights of both are
geopotential.
"""

import math
import re
from itertools import pairwise

import numpy as np

from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.ascents_of_tables import columns_of_ascents, refuse_several
from unbend.atmosphere.soundings.levels import (
    Columns,
    RawLevels,
    first_stated,
    number,
    numbers,
    stated_place,
    stated_time_ns,
    table,
    to_si,
)
from unbend.units import NANOSECONDS_PER_SECOND

_WIDTH = 7  # of a column of the list [characters]
_TITLES = re.compile(r"^\s*PRES\s+HGHT\s+TEMP\s+DWPT", re.MULTILINE)
_INLINE = re.compile(r"PRES\s+hPa,\s*HGHT\s+m,\s*TEMP\s+C,\s*DWPT\s+C")
_TAG = re.compile(r"<[^<>]+>")
_MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
# The heading of an ascent: "12Z 22 May 2011" until 2024, "12 UTC 22 May 2011" since.
_DATE = re.compile(
    r"(?<![\d:])(?P<hour>\d\d)(?::?(?P<minute>\d\d))? ?(?:Z|UTC) (?P<day>\d\d?) "
    r"(?P<month>[A-Z]{3})[A-Z]* (?P<year>\d{4})",
    re.IGNORECASE,
)
_OBSERVED = re.compile(r"Observation time:\s*(?P<stamp>\S+)")
_HEADING = re.compile(r"^.*\bObservations (?:for|at)\b.*$", re.MULTILINE | re.IGNORECASE)
# Dates in other forms than that of a heading: 2015-03-12, 20150312, 12 March 2015, March 12, 2015.
_LIKE_DATE = re.compile(
    r"(?<!\d)(?:19|20)\d\d([-/.]?)[01]\d\1[0-3]\d|[A-Z][a-z]{2,8}\.?,? (?:\d\d?, )?(?:19|20)\d\d\b"
)
# Largest difference of the time of observation from the nominal time in the heading: a balloon is
# released about an hour before it.
FARTHEST_FROM_HEADING_H = 3.0
_STATION = re.compile(r"\bStation (?:identifier|number):\s*(\S+)")
_STATION_OF_HEADING = re.compile(
    r"\bStation (\w+) at\b|^(\w+) .*\bObservations at\b", re.MULTILINE | re.IGNORECASE
)

_CSV_COLUMNS = {
    "pressure": "pressure_hPa",
    "height": "geopotential height_m",
    "temperature": "temperature_C",
    "dew point": "dew point temperature_C",
    "relative humidity": "relative humidity_%",
}


def is_wyoming_list(text: str) -> bool:
    """Whether a text has the titles of a Wyoming list: PRES HGHT TEMP DWPT."""
    has_titles = _TITLES.search(text) is not None
    has_titles_in_one_line = _INLINE.search(text) is not None
    return has_titles or has_titles_in_one_line


def is_wyoming_csv(text: str) -> bool:
    """Whether a text is a Wyoming CSV, by its first line."""
    first = text.lstrip("\ufeff").split("\n", 1)[0]
    return _CSV_COLUMNS["pressure"] in first and _CSV_COLUMNS["height"] in first


def parse_wyoming_list(text: str, where: str) -> list[RawLevels]:
    """The ascents of a Wyoming list, with or without the web page around it."""
    plain = _TAG.sub("", text)
    return [_ascent_of_list(part, where) for part in _parts_of_list(plain)]


def _parts_of_list(plain: str) -> list[str]:
    """The text of each ascent of a page without tags.

    A part begins at the last heading before the titles of its columns, or at these titles if there
    is no heading; the first part begins with the page.
    """
    titles = [match.start() for match in _TITLES.finditer(plain)]
    headings = [match.start() for match in _HEADING.finditer(plain)]
    begins = [0]
    for title_before, title in pairwise(titles):
        between = [heading for heading in headings if title_before < heading < title]
        begins.append(between[-1] if between else title)
    return [plain[begin:end] for begin, end in pairwise([*begins, len(plain)])]


def _ascent_of_list(plain: str, where: str) -> RawLevels:
    """The ascent in a part of a page, from `_parts_of_list`."""
    titles = _TITLES.search(plain)
    rows = _rows_of_page(plain) if titles is None else _rows_of_list(plain[titles.start() :])
    columns = []
    for column in range(5):
        fields = []
        for row in rows:
            is_there = len(row) > column
            fields.append(row[column] if is_there else "")
        columns.append(numbers(fields))
    if titles is None:  # with titles in one line, the fifth column is not relative humidity
        columns[4] = np.full(len(rows), np.nan)
    place = stated_place(_labelled(plain, "latitude"), _labelled(plain, "longitude"), where)
    return RawLevels(
        pressure_pa=to_si(columns[0], "hpa"),
        h_m=columns[1],
        temperature_k=to_si(columns[2], "c"),
        dew_point_k=to_si(columns[3], "c"),
        relative_humidity=to_si(columns[4], "percent"),
        time_ns=_time_of_list(plain, where),
        station=_station_of_list(plain),
        latitude_rad=place.latitude_rad,
        longitude_rad=place.longitude_rad,
        origin="University of Wyoming list",
        where=where,
        column_of={"pressure": "PRES hPa", "temperature": "TEMP C", "dew point": "DWPT C"},
    )


def _rows_of_page(plain: str) -> list[list[str]]:
    """Fields of the levels of a page with its titles in one line; blanks separate fields."""
    rows = [line.split() for line in plain.splitlines() if not line.startswith("#")]
    return [row for row in rows if len(row) >= 4]


def _rows_of_list(plain: str) -> list[list[str]]:
    """The first five fields of each level below the titles, with which ``plain`` begins.

    A level is a line with a number in its first field. The first other line below levels ends them.
    """
    rows: list[list[str]] = []
    for line in plain.splitlines()[1:]:
        fields = [line[i : i + _WIDTH] for i in range(0, 5 * _WIDTH, _WIDTH)]
        if math.isfinite(number(fields[0])):
            rows.append(fields)
        elif rows:
            break
    return rows


def _labelled(plain: str, name: str) -> str:
    """The first word behind a label such as ``Station latitude:`` or ``Lat =``; "" without one.

    ``name`` is latitude or longitude; its first three letters are enough.
    """
    match = re.search(
        rf"\b{name[:3]}(?:{name[3:]})?\s*[:=]\s*(\S+?),?(?:\s|$)", plain, re.IGNORECASE
    )
    return "" if match is None else match[1]


def _station_of_list(plain: str) -> str:
    """The station by the line ``Station number:``, else by the heading; "" without both."""
    match = _STATION.search(plain)
    if match is not None:
        return match[1]
    heading = _STATION_OF_HEADING.search(plain)
    if heading is None:
        return ""
    return heading[1] or heading[2]


def _time_of_list(plain: str, where: str) -> int | None:
    """The time of an ascent [Unix ns], by ``Observation time: 110522/1200``, else by its heading.

    None where there is neither. Refuses (InputError SOUNDING-TIME) a time that cannot be read, and
    two that contradict each other.
    """
    observed_ns = _observed_ns(plain, where)
    heading_ns = _heading_ns(plain, where, is_needed=observed_ns is None)
    if observed_ns is None:
        return heading_ns
    if heading_ns is None:
        return observed_ns
    apart_ns = abs(observed_ns - heading_ns)
    hours = apart_ns / NANOSECONDS_PER_SECOND / 3600.0
    if hours > FARTHEST_FROM_HEADING_H:
        raise messages.sounding_two_times(where=where, hours=hours)
    return observed_ns


def _observed_ns(plain: str, where: str) -> int | None:
    """The time behind ``Observation time:`` [Unix ns]; None without one."""
    observed = _OBSERVED.search(plain)
    if observed is None:
        return None
    stamp = observed["stamp"]
    if re.fullmatch(r"\d{6}/\d{4}", stamp) is None:
        raise messages.sounding_time(where=where, time=stamp)
    # Two digits of the year: the list goes back to 1973.
    century = "19" if stamp[:2] >= "73" else "20"
    day = f"{century}{stamp[:2]}-{stamp[2:4]}-{stamp[4:6]}"
    return stated_time_ns(f"{day}T{stamp[7:9]}:{stamp[9:11]}", where)


def _heading_ns(plain: str, where: str, *, is_needed: bool) -> int | None:
    """The nominal time in the heading of an ascent [Unix ns]; None without one.

    With ``is_needed`` (there is no other time) a heading or a date that cannot be read is refused
    (InputError SOUNDING-TIME).
    """
    titles = _TITLES.search(plain)
    head = plain if titles is None else plain[: titles.start()]
    match = _DATE.search(head)
    month_name = "" if match is None else match["month"].title()
    if match is not None and month_name in _MONTHS:
        month = _MONTHS.index(month_name) + 1
        day = int(match["day"])
        date = f"{match['year']}-{month:02d}-{day:02d}"
        minute = match["minute"] or "00"
        return stated_time_ns(f"{date}T{match['hour']}:{minute}", where)
    unread = _HEADING.search(head)
    if unread is None and titles is not None:  # else ``head`` includes the levels
        unread = _LIKE_DATE.search(head)
    if unread is not None and is_needed:
        raise messages.sounding_time(where=where, time=unread[0].strip())
    return None


def parse_wyoming_csv(text: str, where: str) -> list[RawLevels]:
    """The ascents of a Wyoming CSV. The time of each is the first that one of its levels has."""
    columns = table(text.splitlines(), where)
    missing = [name for name in _CSV_COLUMNS.values() if name not in columns]
    if missing:
        raise messages.sounding_column_wyoming(where=where, missing=missing[0])
    identity = ("time", "latitude", "longitude")
    ascents = columns_of_ascents(columns, identity, columns[_CSV_COLUMNS["pressure"]])
    return [_ascent_of_wyoming_csv(ascent, where) for ascent in ascents]


def _ascent_of_wyoming_csv(columns: Columns, where: str) -> RawLevels:
    """The ascent in columns of a Wyoming CSV; refuses (InputError) rows of several ascents."""
    values = {}
    for quantity, name in _CSV_COLUMNS.items():
        values[quantity] = numbers(columns[name])
    times = columns.get("time", [])
    refuse_several(times, values["pressure"], where)
    north = first_stated(columns.get("latitude", []))
    east = first_stated(columns.get("longitude", []))
    place = stated_place(north, east, where)
    return RawLevels(
        h_m=values["height"],
        pressure_pa=to_si(values["pressure"], "hpa"),
        temperature_k=to_si(values["temperature"], "c"),
        dew_point_k=to_si(values["dew point"], "c"),
        relative_humidity=to_si(values["relative humidity"], "percent"),
        time_ns=stated_time_ns(first_stated(times), where),
        latitude_rad=place.latitude_rad,
        longitude_rad=place.longitude_rad,
        origin="University of Wyoming CSV",
        where=where,
        column_of=_CSV_COLUMNS,
    )
