"""The formats of soundings, and which one a text is in.

IGRA, version 2, and its derived parameters (NOAA NCEI, igra2-data-format.txt and
igra2-derived-format.txt): fixed columns; -9999 missing, -8888 removed by the archive's own checks.
The University of Wyoming: the list of its web page, with columns seven places wide in which a field
may be blank, and its CSV. The heights of both are geopotential. A plain CSV states its units.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.level_checks import check_levels
from unbend.atmosphere.soundings.levels import (
    PlaceOfSounding,
    RawLevels,
    Sounding,
    first_stated,
    number,
    numbers,
    place_of_numbers,
    stated_place,
    stated_time_ns,
    table,
    to_si,
)
from unbend.messages import Ledger, Notes
from unbend.units import NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K, Array

_HEADER = re.compile(r"#[A-Z0-9]{11} \d{4} \d\d \d\d \d\d ")
_NO_HOUR = 99
_DAY_S = 86_400


def is_igra(text: str) -> bool:
    """Whether a text begins as a file of the archive."""
    return _HEADER.match(text) is not None


def is_igra_derived(text: str) -> bool:
    """Whether it holds derived parameters: their header is longer."""
    return is_igra(text) and len(text.split("\n", 1)[0].rstrip()) > 75


def parse_igra(text: str, where: str) -> list[RawLevels]:
    """The ascents of an IGRA v2 file."""
    return [
        RawLevels(
            h_m=_igra_column(lines, 17, 21, 1.0),
            pressure_pa=_igra_column(lines, 10, 15, 1.0),
            temperature_k=(t := _igra_column(lines, 23, 27, 0.1) + ZERO_CELSIUS_K),
            dew_point_k=t - _igra_column(lines, 35, 39, 0.1),
            relative_humidity=_igra_column(lines, 29, 33, 0.001),
            time_ns=_igra_time_ns(header, at),
            station=header[1:12],
            latitude_rad=_igra_place(header).latitude_rad,
            longitude_rad=_igra_place(header).longitude_rad,
            origin="IGRA v2",
            where=at,
            notes=_igra_lines_missing(header, lines, at),
        )
        for header, lines, at in _igra_blocks(text, where)
    ]


def parse_igra_derived(text: str, where: str) -> list[RawLevels]:
    """The ascents of an IGRA v2 file of derived parameters; it knows no position."""
    ascents = []
    for header, lines, at in _igra_blocks(text, where):
        reported, computed = _igra_column(lines, 9, 15, 1.0), _igra_column(lines, 17, 23, 1.0)
        ascents.append(
            RawLevels(
                h_m=np.where(np.isfinite(reported), reported, computed),
                pressure_pa=_igra_column(lines, 1, 7, 1.0),
                temperature_k=_igra_column(lines, 25, 31, 0.1),
                vapour_pressure_pa=_igra_column(lines, 73, 79, 0.1),  # thousandths of a hectopascal
                time_ns=_igra_time_ns(header, at),
                station=header[1:12],
                origin="IGRA v2 derived",
                where=at,
                notes=_igra_lines_missing(header, lines, at),
            )
        )
    return ascents


def _igra_blocks(text: str, where: str) -> Iterator[tuple[str, list[str], str]]:
    """Header, its level lines, and where the header stands."""
    lines = text.splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("#")]
    if not heads:
        raise messages.sounding_format_igra(where=where)
    for head, after in pairwise([*heads, len(lines)]):
        at = f"{where}, line {head + 1}"
        if not _HEADER.match(lines[head]):
            raise messages.sounding_format_header(where=at, header=lines[head][:24])
        yield lines[head], [line for line in lines[head + 1 : after] if line.strip()], at


def _igra_column(lines: list[str], first: int, last: int, scale: float) -> Array:
    """A column by the places of the format description, which count from one."""
    return numbers(line[first - 1 : last] for line in lines) * scale


def _igra_lines_missing(header: str, lines: list[str], at: str) -> Notes:
    """What is reported where the header promises more levels."""
    missing = number(header[32:36]) - len(lines)
    return (messages.sounding_truncated(where=at, count=int(missing)),) if missing > 0.0 else ()


def _igra_place(header: str) -> PlaceOfSounding:
    """The place of an ascent; unknown of ships, whose fields are filled."""
    return place_of_numbers(number(header[55:62]) * 1e-4, number(header[63:71]) * 1e-4)


def _igra_time_ns(header: str, at: str) -> int | None:
    """The release of the balloon, the nominal hour without one. The release has no date: 2303 of
    the sounding of 00 UTC is the evening before."""
    midnight = stated_time_ns(header[13:23].replace(" ", "-"), at)
    hour = int(header[24:26])
    release, seconds = number(header[27:31]), 3600 * hour
    if release // 100 < 24 and release % 100 < 60:
        seconds = 3600 * int(release // 100) + 60 * int(release % 100)
        if hour != _NO_HOUR:
            seconds += _DAY_S * round((3600 * hour - seconds) / _DAY_S)
    elif hour == _NO_HOUR:
        return None
    return None if midnight is None else midnight + seconds * NANOSECONDS_PER_SECOND


def _wyoming(columns: list[Array], **more: Any) -> RawLevels:
    """Levels of pressure, height, temperature, dew point and humidity in Wyoming's units."""
    p, h, t, dew, relative = columns
    return RawLevels(
        h_m=h,
        pressure_pa=to_si(p, "hpa"),
        temperature_k=to_si(t, "c"),
        dew_point_k=to_si(dew, "c"),
        relative_humidity=to_si(relative, "percent"),
        **more,
    )


_WIDTH = 7
_TITLES = re.compile(r"^\s*PRES\s+HGHT\s+TEMP\s+DWPT", re.MULTILINE)
_INLINE = re.compile(r"PRES\s+hPa,\s*HGHT\s+m,\s*TEMP\s+C,\s*DWPT\s+C")
_TAG = re.compile(r"<[^>]+>")
_MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
# The heading of an ascent: "12Z 22 May 2011" until 2024, "12 UTC 22 May 2011" since.
_DATE = re.compile(
    r"(?P<hour>\d\d)(?:Z| UTC) (?P<day>\d\d?) (?P<month>[A-Z][a-z]{2})[a-z]* (?P<year>\d{4})"
)
_OBSERVED = re.compile(r"Observation time:\s*(?P<stamp>\S+)")
_HEADING = re.compile(r"^.*\bObservations (?:for|at)\b.*$", re.MULTILINE)
_STATION = re.compile(r"\bStation (?:identifier|number):\s*(\S+)")
_STATION_OF_HEADING = re.compile(r"\bStation (\w+) at\b|^(\w+) .*\bObservations at\b", re.MULTILINE)

_CSV_COLUMNS = {
    "pressure": "pressure_hPa",
    "height": "geopotential height_m",
    "temperature": "temperature_C",
    "dew point": "dew point temperature_C",
    "relative humidity": "relative humidity_%",
}


def is_wyoming_list(text: str) -> bool:
    """Whether a text is a Wyoming list: PRES HGHT TEMP DWPT above columns."""
    return bool(_TITLES.search(text) or _INLINE.search(text))


def is_wyoming_csv(text: str) -> bool:
    """Whether a text is a Wyoming CSV, by its first line."""
    first = text.lstrip("\ufeff").split("\n", 1)[0]
    return _CSV_COLUMNS["pressure"] in first and _CSV_COLUMNS["height"] in first


def parse_wyoming_list(text: str, where: str) -> list[RawLevels]:
    """The ascents of a text list, with or without the page around it."""
    plain = _TAG.sub("", text)
    return [_ascent_of_list(part, where) for part in _parts_of_list(plain)]


def _parts_of_list(plain: str) -> list[str]:
    """The text of each ascent of a page: from its heading, or its titles, to the next one's."""
    titles = [match.start() for match in _TITLES.finditer(plain)]
    headings = [match.start() for match in _HEADING.finditer(plain)]
    begins = [0]
    for title_before, title in pairwise(titles):
        between = [heading for heading in headings if title_before < heading < title]
        begins.append(between[-1] if between else title)
    return [plain[begin:end] for begin, end in pairwise([*begins, len(plain)])]


def _ascent_of_list(plain: str, where: str) -> RawLevels:
    """The only ascent of a part of a page."""
    titles = _TITLES.search(plain)
    rows = _rows_of_page(plain) if titles is None else _rows_of_list(plain[titles.start() :])
    columns = [numbers(row[i] if len(row) > i else "" for row in rows) for i in range(5)]
    if titles is None:  # the fifth column of a page without its titles is another
        columns[4] = np.full(len(rows), np.nan)
    place = stated_place(_labelled(plain, "latitude"), _labelled(plain, "longitude"), where)
    return _wyoming(
        columns,
        time_ns=_time_of_list(plain, where),
        station=_station_of_list(plain),
        latitude_rad=place.latitude_rad,
        longitude_rad=place.longitude_rad,
        origin="University of Wyoming list",
        where=where,
        column_of={"pressure": "PRES hPa", "temperature": "TEMP C", "dew point": "DWPT C"},
    )


def _rows_of_page(plain: str) -> list[list[str]]:
    """The levels of a page that gives its titles in one line: fields parted by blanks."""
    rows = [line.split() for line in plain.splitlines() if not line.startswith("#")]
    return [row for row in rows if len(row) >= 4]


def _rows_of_list(plain: str) -> list[list[str]]:
    """Fields of the lines between the second rule and the first line that is no level."""
    rows: list[list[str]] = []
    for line in plain.splitlines()[1:]:
        fields = [line[i : i + _WIDTH] for i in range(0, 5 * _WIDTH, _WIDTH)]
        if math.isfinite(number(fields[0])):
            rows.append(fields)
        elif rows:
            break
    return rows


def _labelled(plain: str, name: str) -> str:
    """The first field behind ``Station latitude:`` or ``Latitude:``; empty without one."""
    match = re.search(rf"\b{name}:\s*(\S+)", plain, re.IGNORECASE)
    return "" if match is None else match[1]


def _station_of_list(plain: str) -> str:
    """The station by its own line, else by the heading; empty without one."""
    match = _STATION.search(plain)
    if match is not None:
        return match[1]
    heading = _STATION_OF_HEADING.search(plain)
    return "" if heading is None else heading[1] or heading[2]


def _time_of_list(plain: str, where: str) -> int | None:
    """The nominal time of an ascent, by ``Observation time: 110522/1200`` or by its heading.

    None where it has neither; refuses (InputError SOUNDING-TIME) one that cannot be read.
    """
    observed = _OBSERVED.search(plain)
    if observed is not None:
        stamp = observed["stamp"]
        if re.fullmatch(r"\d{6}/\d{4}", stamp) is None:
            raise messages.sounding_time(where=where, time=stamp)
        # Two digits of the year: the list goes back to 1973.
        century = "19" if stamp[:2] >= "73" else "20"
        day = f"{century}{stamp[:2]}-{stamp[2:4]}-{stamp[4:6]}"
        return stated_time_ns(f"{day}T{stamp[7:9]}:{stamp[9:11]}", where)
    heading = _HEADING.search(plain)
    match = _DATE.search(plain)
    if match is not None and match["month"] in _MONTHS:
        month = _MONTHS.index(match["month"]) + 1
        day = f"{match['year']}-{month:02d}-{int(match['day']):02d}"
        return stated_time_ns(f"{day}T{match['hour']}:00", where)
    if heading is not None:
        raise messages.sounding_time(where=where, time=heading[0].strip())
    return None


LONGEST_ASCENT_H = 4.0  # a balloon rises for two hours, and falls for one


def _refuse_several(times: Sequence[str], where: str) -> None:
    """Refuse (`InputError`) rows of one table that no single ascent takes so long for."""
    known = [t for t in (stated_time_ns(time, where) for time in times) if t is not None]
    hours = (max(known) - min(known)) / 3.6e12 if known else 0.0
    if hours > LONGEST_ASCENT_H:
        raise messages.sounding_choice_rows(where=where, hours=hours)


def parse_wyoming_csv(text: str, where: str) -> list[RawLevels]:
    """The ascent of a Wyoming CSV; its time is that of the first level."""
    columns = table(text.splitlines(), where)
    missing = [name for name in _CSV_COLUMNS.values() if name not in columns]
    if missing:
        raise messages.sounding_column_wyoming(where=where, missing=missing[0])
    time, north, east = (
        first_stated(columns.get(name, [])) for name in ("time", "latitude", "longitude")
    )
    _refuse_several(columns.get("time", []), where)
    place = stated_place(north, east, where)
    return [
        _wyoming(
            [numbers(columns[name]) for name in _CSV_COLUMNS.values()],
            time_ns=stated_time_ns(time, where),
            latitude_rad=place.latitude_rad,
            longitude_rad=place.longitude_rad,
            origin="University of Wyoming CSV",
            where=where,
            column_of=_CSV_COLUMNS,
        )
    ]


# Name of a column -> quantity, unit.
PLAIN_COLUMNS = {
    "h_m": ("height", "m"),
    "geopotential_m": ("geopotential", "m"),
    "pressure_pa": ("pressure", "pa"),
    "pressure_hpa": ("pressure", "hpa"),
    "temperature_k": ("temperature", "k"),
    "temperature_c": ("temperature", "c"),
    "dew_point_k": ("dew point", "k"),
    "dew_point_c": ("dew point", "c"),
    "vapour_pressure_pa": ("vapour pressure", "pa"),
    "vapour_pressure_hpa": ("vapour pressure", "hpa"),
    "relative_humidity": ("relative humidity", "1"),
    "relative_humidity_percent": ("relative humidity", "percent"),
}
PLACE_COLUMNS = ("time_utc", "latitude_deg", "longitude_deg", "station")


def is_plain(text: str) -> bool:
    """Whether the first line that is no comment names a pressure and a temperature with units."""
    lines = (line for line in text.lstrip("\ufeff").splitlines() if not line.startswith("#"))
    names = {name.strip().lower() for name in re.split(r"[,;\t|]", next(lines, ""))}
    return any(n.startswith("pressure") for n in names) and any(
        n.startswith("temperature") for n in names
    )


def parse_plain(text: str, where: str) -> list[RawLevels]:
    """The ascent of a plain CSV; other columns are not read, which is noted."""
    columns = {name.lower(): fields for name, fields in table(text.splitlines(), where).items()}
    values: dict[str, Array] = {}
    column_of: dict[str, str] = {}
    for name in (name for name in PLAIN_COLUMNS if name in columns):
        quantity, unit = PLAIN_COLUMNS[name]
        if quantity in column_of:
            raise messages.sounding_quantity_twice(
                where=where, column=column_of[quantity], other=name, quantity=quantity
            )
        values[quantity], column_of[quantity] = to_si(numbers(columns[name]), unit), name
    for needed in ("pressure", "temperature"):
        if needed not in values:
            names = [name for name, (quantity, _) in PLAIN_COLUMNS.items() if quantity == needed]
            raise messages.sounding_column(
                where=where, needed=needed, present=", ".join(columns), names=" or ".join(names)
            )
    notes: Notes = ()
    unread = sorted(set(columns) - set(PLAIN_COLUMNS) - set(PLACE_COLUMNS))
    if unread:
        notes = (
            messages.sounding_columns_unused(
                where=where, count=len(unread), columns=", ".join(unread)
            ),
        )
    geopotential = "height" not in values
    time_ns = stated_time_ns(first_stated(columns.get("time_utc", [])), where)
    _refuse_several(columns.get("time_utc", []), where)
    unknown = np.full(values["pressure"].shape, np.nan)
    first = {name: first_stated(columns.get(name, [])) for name in PLACE_COLUMNS}
    place = stated_place(first["latitude_deg"], first["longitude_deg"], where)
    return [
        RawLevels(
            h_m=values.get("geopotential" if geopotential else "height", unknown),
            pressure_pa=values["pressure"],
            temperature_k=values["temperature"],
            geopotential=geopotential,
            dew_point_k=values.get("dew point"),
            vapour_pressure_pa=values.get("vapour pressure"),
            relative_humidity=values.get("relative humidity"),
            time_ns=time_ns,
            station=first["station"].strip(),
            latitude_rad=place.latitude_rad,
            longitude_rad=place.longitude_rad,
            origin="plain CSV",
            where=where,
            column_of=column_of,
            notes=notes,
        )
    ]


FAR_HOURS = 6.0  # a sounding farther in time is reported: the boundary layer has changed


FORMATS: dict[str, tuple[Callable[[str], bool], Callable[[str, str], list[RawLevels]]]] = {
    "igra_derived": (is_igra_derived, parse_igra_derived),
    "igra": (is_igra, parse_igra),
    "wyoming_csv": (is_wyoming_csv, parse_wyoming_csv),
    "wyoming_list": (is_wyoming_list, parse_wyoming_list),
    "csv": (is_plain, parse_plain),
}
"""How a text in a format is recognised and read. In this order a text is tried; the first that
recognises it reads it."""


def parse_sounding(
    text: str,
    ledger: Ledger,
    *,
    where: str = "sounding",
    format_name: str = "auto",
    time_ns: int | None = None,
    latitude_rad: float = math.nan,
    station_h_m: float = math.nan,
) -> Sounding:
    """The sounding of a text, in whichever format; of several the one nearest in time.

    ``text``: IGRA v2 (soundings or derived), University of Wyoming list or CSV, or a plain CSV with
    columns such as h_m, pressure_hpa, temperature_c, dew_point_c. ``where``: the file's name, for
    refusals and the ledger. ``format_name``: one of `FORMATS`, or ``auto``. ``time_ns``: of the
    flight [Unix ns]; needed to choose where the text holds several soundings. ``latitude_rad``
    [rad], ``station_h_m`` [m above sea level] where the text has none.

    Raises ``InputError``: no such format, wrong units, contradictory heights, fewer than five
    levels. Repairs are counted in the ledger.

    >>> text = "h_m,pressure_hpa,temperature_c\\n" + "".join(
    ...     f"{h},{1013.25 * (1 - 2.25577e-5 * h) ** 5.25588},{15 - 0.0065 * h}\\n"
    ...     for h in range(0, 5000, 500))
    >>> parse_sounding(text, Ledger()).temperature_k.round(2).tolist()[:3]
    [288.15, 284.9, 281.65]
    """
    name = format_name
    if name == "auto":
        name = next((name for name, (is_it, _) in FORMATS.items() if is_it(text)), "")
        if not name:
            begins = text.lstrip()[:60].splitlines()
            raise messages.sounding_format(where=where, begins=begins[0] if begins else "")
    if name not in FORMATS:
        names = ", ".join(FORMATS)
        raise messages.sounding_format_name(where=where, name=name, names=names)
    raw = nearest_in_time(FORMATS[name][1](text, where), time_ns, where)
    return ledger.take(check_levels(raw, latitude_rad=latitude_rad, station_h_m=station_h_m))


def nearest_in_time(ascents: list[RawLevels], time_ns: int | None, where: str) -> RawLevels:
    """Of several ascents the one released nearest to a time; without a time, the only one."""
    full = [raw for raw in ascents if raw.pressure_pa.size]
    if not full:
        raise messages.sounding_empty(where=where)
    notes: Notes = ()
    if count := len(ascents) - len(full):  # a file that was cut off may end with a header
        notes = (messages.sounding_cut_off(where=where, count=count),)
    if len(full) == 1 and (time_ns is None or full[0].time_ns is None):
        return full[0].noting(*notes)
    if time_ns is None:
        raise messages.sounding_choice(where=where, total=len(full))
    dated = [(abs(raw.time_ns - time_ns), raw) for raw in full if raw.time_ns is not None]
    if not dated:
        raise messages.sounding_choice_undated(where=where, total=len(full))
    apart, raw = min(dated, key=lambda pair: pair[0])
    hours = apart / NANOSECONDS_PER_SECOND / 3600.0
    if hours > FAR_HOURS:
        notes += (messages.sounding_far_in_time(where=raw.where, hours=hours),)
    if len(full) > 1:
        notes += (messages.sounding_chosen(where=raw.where, count=len(full), hours=hours),)
    return raw.noting(*notes)
