"""The formats of soundings, and which one a text is in.

IGRA, version 2, and its derived parameters (NOAA NCEI, igra2-data-format.txt and
igra2-derived-format.txt): fixed columns; -9999 missing, -8888 removed by the archive's own checks.
The heights of both are geopotential. A plain CSV states its units. Those of the University of
Wyoming are read in `unbend.atmosphere.soundings.wyoming`.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.ascents_of_tables import (
    columns_of_ascents,
    is_same_ascent,
    refuse_several,
)
from unbend.atmosphere.soundings.level_checks import check_levels
from unbend.atmosphere.soundings.levels import (
    Columns,
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
from unbend.atmosphere.soundings.wyoming import (
    is_wyoming_csv,
    is_wyoming_list,
    parse_wyoming_csv,
    parse_wyoming_list,
)
from unbend.messages import Ledger, Notes
from unbend.units import NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K, Array

_HEADER = re.compile(r"#[A-Z0-9]{11} \d{4} \d\d \d\d \d\d ")
_LONGEST_SOUNDING_HEADER = 75  # characters, with room; headers of derived parameters are longer
_NO_HOUR = 99  # the nominal hour is unknown
LAST_HOUR = 23
_DAY_S = 86_400


def is_igra(text: str) -> bool:
    """Whether a text begins with a header of IGRA, of soundings or of derived parameters."""
    return _HEADER.match(text) is not None


def is_igra_derived(text: str) -> bool:
    """Whether a text is of IGRA's derived parameters, by the length of its first header."""
    if not is_igra(text):
        return False
    header = text.split("\n", 1)[0].rstrip()
    return len(header) > _LONGEST_SOUNDING_HEADER


def parse_igra(text: str, where: str) -> list[RawLevels]:
    """The ascents of an IGRA v2 file."""
    ascents = []
    for block in _igra_blocks(text, where):
        lines = block.lines
        temperature_k = _igra_column(lines, 23, 27, 0.1) + ZERO_CELSIUS_K
        depression_k = _igra_column(lines, 35, 39, 0.1)
        place = _igra_place(block.header)
        raw = RawLevels(
            h_m=_igra_column(lines, 17, 21, 1.0),
            pressure_pa=_igra_column(lines, 10, 15, 1.0),
            temperature_k=temperature_k,
            dew_point_k=temperature_k - depression_k,
            relative_humidity=_igra_column(lines, 29, 33, 0.001),
            time_ns=_igra_time_ns(block),
            station=block.station,
            latitude_rad=place.latitude_rad,
            longitude_rad=place.longitude_rad,
            origin="IGRA v2",
            where=block.where,
            notes=_igra_lines_missing(block),
        )
        ascents.append(raw)
    return ascents


def parse_igra_derived(text: str, where: str) -> list[RawLevels]:
    """The ascents of an IGRA v2 file of derived parameters, which has no positions."""
    ascents = []
    for block in _igra_blocks(text, where):
        lines = block.lines
        reported = _igra_column(lines, 9, 15, 1.0)
        computed = _igra_column(lines, 17, 23, 1.0)
        raw = RawLevels(
            h_m=np.where(np.isfinite(reported), reported, computed),
            pressure_pa=_igra_column(lines, 1, 7, 1.0),
            temperature_k=_igra_column(lines, 25, 31, 0.1),
            vapour_pressure_pa=_igra_column(lines, 73, 79, 0.1),  # thousandths of a hectopascal
            time_ns=_igra_time_ns(block),
            station=block.station,
            origin="IGRA v2 derived",
            where=block.where,
            notes=_igra_lines_missing(block),
        )
        ascents.append(raw)
    return ascents


class _IgraBlock(NamedTuple):
    """The lines of an ascent in a file of IGRA."""

    header: str
    lines: list[str]  # one for each level
    where: str  # file and line of the header, for messages

    @property
    def station(self) -> str:
        """Identifier of the station."""
        return self.header[1:12]


def _igra_blocks(text: str, where: str) -> Iterator[_IgraBlock]:
    """The ascents of a file of IGRA one by one; refuses (InputError) lines # that are no header."""
    lines = text.splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("#")]
    if not heads:
        raise messages.sounding_format_igra(where=where)
    for head, next_head in pairwise([*heads, len(lines)]):
        header = lines[head]
        where_header = f"{where}, line {head + 1}"
        if not _HEADER.match(header):
            raise messages.sounding_format_header(where=where_header, header=header[:24])
        levels = [line for line in lines[head + 1 : next_head] if line.strip()]
        yield _IgraBlock(header, levels, where_header)


def _igra_column(lines: list[str], first: int, last: int, scale: float) -> Array:
    """A column of numbers, multiplied by ``scale``; NaN for missing values.

    ``first``, ``last``: places of its characters in a line, from 1 on as in the description of the
    format.
    """
    return numbers(line[first - 1 : last] for line in lines) * scale


def _igra_lines_missing(block: _IgraBlock) -> Notes:
    """A message if the header states more levels than the block has; else empty."""
    missing = number(block.header[32:36]) - len(block.lines)
    if not missing > 0.0:
        return ()
    return (messages.sounding_truncated(where=block.where, count=int(missing)),)


def _igra_place(header: str) -> PlaceOfSounding:
    """The place of an ascent; NaN for ships, where the header has fill values."""
    latitude_deg = number(header[55:62]) * 1e-4
    longitude_deg = number(header[63:71]) * 1e-4
    return place_of_numbers(latitude_deg, longitude_deg)


def _igra_time_ns(block: _IgraBlock) -> int | None:
    """The time of the release of the balloon [Unix ns], without one the nominal hour; else None.

    The date is that of the nominal hour. The release is within 12 hours of it: 2303 of a sounding
    of 00 UTC is on the evening before.
    """
    header = block.header
    date = header[13:23].replace(" ", "-")
    midnight = stated_time_ns(f"{date}T00:00", block.where)
    hour = int(header[24:26])
    if hour > LAST_HOUR and hour != _NO_HOUR:
        raise messages.sounding_time(where=block.where, time=header[13:26])
    nominal_s = 3600 * hour
    release_s = _seconds_of_release(number(header[27:31]))
    if release_s is None and hour == _NO_HOUR:
        return None
    if release_s is None:
        seconds = nominal_s
    elif hour == _NO_HOUR:
        seconds = release_s
    else:
        days = round((nominal_s - release_s) / _DAY_S)
        seconds = release_s + _DAY_S * days
    return None if midnight is None else midnight + seconds * NANOSECONDS_PER_SECOND


def _seconds_of_release(hhmm: float) -> int | None:
    """Seconds of the day of a time in the form 2303; None if it is not a time, as NaN and 9999."""
    hour = hhmm // 100
    minute = hhmm % 100
    if not (0 <= hour <= LAST_HOUR and minute < 60):
        return None
    return 3600 * int(hour) + 60 * int(minute)


# Quantity and unit by the name of a column.
PLAIN_COLUMNS = {
    "h_m": ("height", "m"),
    "h_msl_m": ("height", "m"),
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
# Other names by the name of a column. These columns show which rows are of one ascent.
PLACE_COLUMNS = {
    "ascent": (),
    "station": (),
    "time_utc": (),
    "latitude_deg": ("latitude", "lat"),
    "longitude_deg": ("longitude", "lon", "long"),
}


def is_plain(text: str) -> bool:
    """Whether the first line that is not a comment has names of a pressure and a temperature."""
    lines = (line for line in text.lstrip("\ufeff").splitlines() if not line.startswith("#"))
    has_pressure = False
    has_temperature = False
    for field in re.split(r"[,;\t|]", next(lines, "")):
        name = field.strip().lower()
        has_pressure |= name.startswith("pressure")
        has_temperature |= name.startswith("temperature")
    return has_pressure and has_temperature


def parse_plain(text: str, where: str) -> list[RawLevels]:
    """The ascents of a plain CSV, with a message about columns that are not read.

    Columns are those of `PLAIN_COLUMNS` and `PLACE_COLUMNS`, in upper or lower case.
    """
    columns = {}
    for name, fields in table(text.splitlines(), where).items():
        columns[name.lower()] = fields
    for name, column_names in PLACE_COLUMNS.items():
        for other in column_names:
            if other in columns and name not in columns:
                columns[name] = columns.pop(other)
    column_of = _columns_of_quantities(columns, where)
    _refuse_other_times(columns, where)
    unread = sorted(set(columns) - set(PLAIN_COLUMNS) - set(PLACE_COLUMNS))
    notes: Notes = ()
    if unread:
        names = ", ".join(unread)
        notes = (messages.sounding_columns_unused(where=where, count=len(unread), columns=names),)
    ascents = columns_of_ascents(columns, PLACE_COLUMNS, columns[column_of["pressure"]])
    return [_ascent_of_plain(ascent, column_of, where).noting(*notes) for ascent in ascents]


def _columns_of_quantities(columns: Columns, where: str) -> dict[str, str]:
    """The name of the column of each quantity that a plain CSV has.

    Refuses (InputError) two columns of a quantity, and a table without pressure or temperature.
    """
    column_of: dict[str, str] = {}
    for name, (quantity, _) in PLAIN_COLUMNS.items():
        if name not in columns:
            continue
        if quantity in column_of:
            raise messages.sounding_quantity_twice(
                where=where,
                column=column_of[quantity],
                other=name,
                quantity=quantity,
            )
        column_of[quantity] = name
    for needed in ("pressure", "temperature"):
        if needed not in column_of:
            names = [name for name, (quantity, _) in PLAIN_COLUMNS.items() if quantity == needed]
            raise messages.sounding_column(
                where=where,
                needed=needed,
                present=", ".join(columns),
                names=" or ".join(names),
            )
    return column_of


_NAME_OF_TIME = re.compile(r"time|date|utc|valid")
_NAME_OF_DATE = re.compile(r"date")


def _refuse_other_times(columns: Columns, where: str) -> None:
    """Refuse (InputError SOUNDING-TIME) a time in another column if ``time_utc`` has none.

    The name of such a column contains time, date, utc or valid. A column of plain numbers, such as
    seconds since launch, passes unless its name contains date.
    """
    if first_stated(columns.get("time_utc", [])):
        return
    for name, fields in columns.items():
        first_time = first_stated(fields)
        is_date = _NAME_OF_DATE.search(name) is not None
        is_text = math.isnan(number(first_time))
        if _NAME_OF_TIME.search(name) and first_time and (is_text or is_date):
            raise messages.sounding_time_column(where=where, column=name, time=first_time)


def _ascent_of_plain(columns: Columns, column_of: Mapping[str, str], where: str) -> RawLevels:
    """The ascent in columns of a plain CSV; refuses (InputError) rows of several ascents.

    ``column_of``: names of columns by quantity, from `_columns_of_quantities`.
    """
    values = {}
    for quantity, name in column_of.items():
        _, unit = PLAIN_COLUMNS[name]
        values[quantity] = to_si(numbers(columns[name]), unit)
    refuse_several(columns.get("time_utc", []), values["pressure"], where)
    stated = {name: first_stated(columns.get(name, [])) for name in PLACE_COLUMNS}
    place = stated_place(stated["latitude_deg"], stated["longitude_deg"], where)
    unknown = np.full(values["pressure"].shape, np.nan)
    geopotential = "height" not in values
    return RawLevels(
        h_m=values.get("geopotential" if geopotential else "height", unknown),
        pressure_pa=values["pressure"],
        temperature_k=values["temperature"],
        geopotential=geopotential,
        dew_point_k=values.get("dew point"),
        vapour_pressure_pa=values.get("vapour pressure"),
        relative_humidity=values.get("relative humidity"),
        time_ns=stated_time_ns(stated["time_utc"], where),
        station=stated["station"],
        latitude_rad=place.latitude_rad,
        longitude_rad=place.longitude_rad,
        origin="plain CSV",
        where=where,
        column_of=column_of,
    )


FORMATS: dict[str, tuple[Callable[[str], bool], Callable[[str, str], list[RawLevels]]]] = {
    "igra_derived": (is_igra_derived, parse_igra_derived),
    "igra": (is_igra, parse_igra),
    "wyoming_csv": (is_wyoming_csv, parse_wyoming_csv),
    "wyoming_list": (is_wyoming_list, parse_wyoming_list),
    "csv": (is_plain, parse_plain),
}
"""By the name of a format: the function that recognises a text, and the function that reads it. The
first format that recognises a text is used."""


def format_of(text: str) -> str:
    """The name of the first format that recognises a text; "" if none does.

    >>> format_of("h_m,pressure_hpa,temperature_c"), format_of("image,x,y")
    ('csv', '')
    """
    for name, (recognises, _) in FORMATS.items():
        if recognises(text):
            return name
    return ""


def ascents_of_text(text: str, where: str) -> list[RawLevels]:
    """All ascents of a text, unchecked; empty if no format recognises it.

    ``where``: the file, for messages.
    """
    name = format_of(text)
    if not name:
        return []
    _, parse = FORMATS[name]
    return parse(text, where)


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
    """The checked sounding of a text in one of `FORMATS`; of several the nearest in time.

    ``text``: IGRA v2 (soundings or derived), University of Wyoming list or CSV, or a plain CSV with
    columns such as h_m, pressure_hpa, temperature_c, dew_point_c. ``where``: the file's name, for
    messages. ``format_name``: one of `FORMATS`, or ``auto``. ``time_ns``: time of the flight
    [Unix ns], needed if the text contains several soundings. ``latitude_rad``, ``station_h_m``
    [m above sea level] are used where the text has none, see `check_levels`.

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
        name = format_of(text)
        if not name:
            begins = text.lstrip()[:60].splitlines()
            raise messages.sounding_format(where=where, begins=begins[0] if begins else "")
    if name not in FORMATS:
        names = ", ".join(FORMATS)
        raise messages.sounding_format_name(where=where, name=name, names=names)
    _, parse = FORMATS[name]
    raw = nearest_in_time(parse(text, where), time_ns, where)
    return ledger.take(check_levels(raw, latitude_rad=latitude_rad, station_h_m=station_h_m))


def nearest_in_time(
    ascents: list[RawLevels],
    time_ns: int | None,
    where: str,
) -> RawLevels:
    """The ascent nearest to a time [Unix ns], with messages; without a time the only ascent.

    Ascents without levels do not count. Refuses (InputError) a choice that cannot be made, and a
    file without levels.
    """
    full = [raw for raw in ascents if raw.pressure_pa.size]
    if not full:
        raise messages.sounding_empty(where=where)
    notes: Notes = ()
    empty = len(ascents) - len(full)
    if empty:  # a file that was cut off may end with a header
        notes = (messages.sounding_cut_off(where=where, count=empty),)
    if len(full) == 1 and (time_ns is None or full[0].time_ns is None):
        return full[0].noting(*notes)
    if time_ns is None:
        raise messages.sounding_choice(where=where, total=len(full))
    raw, apart_ns = _nearest_of_dated(full, time_ns, where)
    hours = apart_ns / NANOSECONDS_PER_SECOND / 3600.0
    if len(full) > 1:
        notes += (messages.sounding_chosen(where=raw.where, count=len(full), hours=hours),)
    return raw.noting(*notes)


def _nearest_of_dated(
    ascents: list[RawLevels],
    time_ns: int,
    where: str,
) -> tuple[RawLevels, int]:
    """The ascent nearest to a time [Unix ns], and the absolute difference of their times [ns].

    Refuses (InputError) ascents without any time, and different ascents of the nearest time.
    """
    dated = [(abs(raw.time_ns - time_ns), raw) for raw in ascents if raw.time_ns is not None]
    if not dated:
        raise messages.sounding_choice_undated(where=where, total=len(ascents))
    apart_ns, nearest = min(dated, key=lambda pair: pair[0])
    same_time = [raw for _, raw in dated if raw.time_ns == nearest.time_ns]
    if not all(is_same_ascent(nearest, raw) for raw in same_time):
        raise messages.sounding_choice_same_time(where=where, total=len(same_time))
    return nearest, apart_ns
