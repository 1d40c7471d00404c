"""Levels of a sounding, as a file has them and as the estimator takes them; texts as numbers."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from unbend.atmosphere.soundings import messages
from unbend.messages import Message, Notes
from unbend.table_dialect import form_of, split_rows, with_decimal_points
from unbend.units import HECTOPASCAL, NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K, Array

FILLS = (-9999.0, -9999.9, -8888.0, -99999.0, 99999.0, 999999.0, -999.0)
"""Numbers that mark a missing value. 9999 is not among them: it may be a height."""

Columns = Mapping[str, list[str]]
"""The columns of a table by name, fields as text."""

LARGEST = 1e7  # larger values in any unit are invalid, such as the fill of netCDF, 9.97e36
_YEARS = (1900, 2200)  # of valid times; nanoseconds after 2262 do not fit into 64 bits

_UNIT: dict[str, Callable[[Array], Array]] = {
    **dict.fromkeys(("pa", "k", "m", "1"), lambda value: value),
    "hpa": lambda value: value * HECTOPASCAL,
    "c": lambda value: value + ZERO_CELSIUS_K,
    "percent": lambda value: value / 100.0,
}


@dataclass(frozen=True, eq=False)
class ColumnErrors:
    """Errors that the levels of a column of air share, at its place and time.

    One sigma for each level, or a single one for all. Errors of levels that are d apart in height
    correlate as exp(-d / length). ``log_pressure`` is one sigma of ln p at the lowest level. The
    defaults are those of a balloon (instrument, and drift with the wind), set by judgement.
    """

    temperature_k: Array | float = 1.2
    relative_humidity: Array | float = 0.15
    temperature_length_m: float = 1500.0
    humidity_length_m: float = 1000.0
    log_pressure: float = 1e-3


@dataclass(frozen=True, eq=False)
class Sounding:
    """Levels (n,) of one ascent, or of another column of air, from the ground up.

    ``h_m``: geometric heights above mean sea level [m], strictly increasing; pressure is strictly
    decreasing, vapour pressure NaN where it was not measured. ``time_ns``: release of the balloon,
    or the hour of the observation [Unix ns], None if unknown; ``station`` as the file has it, may
    be empty; position NaN where the file has none; ``origin``: the format it was read as; ``kind``:
    "sounding" or "weather model", for messages and as the basis of an estimate; ``errors`` of the
    column, to which age and distance add; ``across``: whether a coast or a ridge is between it and
    the flight.
    """

    h_m: Array
    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    time_ns: int | None = None
    station: str = ""
    latitude_rad: float = float("nan")
    longitude_rad: float = float("nan")
    origin: str = ""
    kind: str = "sounding"
    errors: ColumnErrors = field(default_factory=ColumnErrors)
    across: bool = False

    @property
    def name(self) -> str:
        """Kind, station and time (those that are known), for messages."""
        when = ""
        if self.time_ns is not None:
            when = str(np.datetime64(self.time_ns, "ns").astype("datetime64[m]"))
        return " ".join(word for word in (self.kind, self.station, when) if word)

    def __post_init__(self) -> None:
        columns = (self.h_m, self.pressure_pa, self.temperature_k, self.vapour_pressure_pa)
        if any(column.shape != (self.h_m.size,) for column in columns):
            raise ValueError("the columns of a sounding are vectors of one length")
        if not bool(np.all(np.diff(self.h_m) > 0.0) and np.all(np.diff(self.pressure_pa) < 0.0)):
            raise ValueError("a sounding rises, and its pressure falls")


@dataclass(frozen=True, eq=False)
class RawLevels:
    """The levels of one ascent in the order of the file; (n,) arrays, NaN for a missing value.

    ``h_m`` are heights above sea level [m], geopotential heights [m'] where ``geopotential`` is
    true. Humidity is in one or more of: dew point [K], vapour pressure [Pa], relative humidity over
    water [1]. ``where`` is the file, and the line where known, for messages. ``column_of`` gives
    names of the file's columns by quantity, as "dew point"; quantities may be missing in it.
    ``notes`` are messages about the file and its levels.
    """

    h_m: Array
    pressure_pa: Array
    temperature_k: Array
    geopotential: bool = True
    dew_point_k: Array | None = None
    vapour_pressure_pa: Array | None = None
    relative_humidity: Array | None = None
    time_ns: int | None = None
    station: str = ""
    latitude_rad: float = math.nan
    longitude_rad: float = math.nan
    origin: str = ""
    where: str = ""
    column_of: Mapping[str, str] = field(default_factory=dict)
    notes: Notes = ()

    def noting(self, *notes: Message) -> "RawLevels":
        """The same levels with further notes."""
        return replace(self, notes=(*self.notes, *notes))


def to_si(value: Array, unit: str) -> Array:
    """Values of the unit pa, hpa, k, c, m, 1 or percent converted to Pa, K, m or 1."""
    return _UNIT[unit](value)


def number(text: str) -> float:
    """A field as a number; NaN if it is not a number, is in `FILLS` or is larger than `LARGEST`.

    >>> number(" 12.5"), number("-9999"), number("///")
    (12.5, nan, nan)
    """
    if "_" in text:  # Python would read 1_0 as 10
        return math.nan
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if value not in FILLS and abs(value) <= LARGEST else math.nan


def numbers(texts: Iterable[str]) -> Array:
    """Fields of one column as numbers, each by `number`."""
    return np.array([number(text) for text in texts], dtype=np.float64)


def table(lines: Iterable[str], where: str) -> dict[str, list[str]]:
    """The columns of a table by name, fields as text; lines that begin with # are comments.

    `unbend.table_dialect` finds how fields are separated; decimal commas become points. Refuses
    (InputError) an empty table, one that cannot be read and one with a name twice. ``where`` is the
    file, for messages.
    """
    filled = [line for line in lines if line.strip() and not line.startswith("#")]
    if not filled:
        raise messages.sounding_without_lines(where=where)
    try:
        form = form_of([filled[0].lstrip("\ufeff"), *filled[1:]])
        rows = split_rows(filled[form.line_of_first_row - 1 :], form.separator)
    except ValueError as error:
        raise messages.sounding_no_table(where=where, error=str(error)) from None
    names = [name.strip() for name in form.names]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise messages.sounding_column_twice(where=where, column=twice[0])
    columns = {}
    for column, name in enumerate(names):
        fields = []
        for row in rows:
            # A row that was cut off has empty fields where it ends.
            is_there = column < len(row)
            fields.append(row[column] if is_there else "")
        with_points = with_decimal_points(fields, decimal_comma=form.decimal_comma)
        columns[name] = list(with_points)
    return columns


def utc_ns(text: str) -> int | None:
    """Unix nanoseconds of a time in ISO 8601, UTC where it has no offset, to a millisecond.

    None if the text is not such a time, or the year is not from 1900 to 2200.

    >>> utc_ns("2011-05-22 12:00:00") == utc_ns("2011-05-22T14:00:00+02:00") == 1306065600 * 10**9
    True
    >>> utc_ns("22.05.2011 12:00") is None
    True
    """
    try:
        time = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    if not _YEARS[0] <= time.year <= _YEARS[1]:
        return None
    time = time.replace(tzinfo=UTC) if time.tzinfo is None else time
    return round(time.timestamp() * 1000) * (NANOSECONDS_PER_SECOND // 1000)


@dataclass(frozen=True)
class PlaceOfSounding:
    """Latitude and longitude of a sounding [rad], NaN where the file does not state them."""

    latitude_rad: float = math.nan
    longitude_rad: float = math.nan


_NOT_STATED = ("", "nan", "na", "n/a", "none", "null", "-", "--", "///")
_UNKNOWN_DEG = (-99.99, -99.9, -98.8888, -998.8888)  # fills of Wyoming and, for ships, of IGRA


def place_of_numbers(latitude_deg: float, longitude_deg: float) -> PlaceOfSounding:
    """A place from degrees; longitudes may be from -180 to 360. NaN where they are out of range.

    >>> place = place_of_numbers(48.0, 343.65)
    >>> round(math.degrees(place.longitude_rad), 2)
    -16.35
    """
    if not abs(latitude_deg) <= 90.0 or not -180.0 <= longitude_deg <= 360.0:
        return PlaceOfSounding()
    east_deg = longitude_deg - 360.0 if longitude_deg > 180.0 else longitude_deg
    return PlaceOfSounding(math.radians(latitude_deg), math.radians(east_deg))


def stated_place(latitude: str, longitude: str, where: str) -> PlaceOfSounding:
    """The place that two fields of a file state in degrees; a latitude alone is kept.

    Empty fields and fill values state nothing: NaN. Refuses (InputError SOUNDING-PLACE) other
    fields that are not a latitude or a longitude.
    """
    north_deg = _stated_degrees(latitude)
    east_deg = _stated_degrees(longitude)
    is_latitude = math.isnan(north_deg) or abs(north_deg) <= 90.0
    is_longitude = math.isnan(east_deg) or -180.0 <= east_deg <= 360.0
    is_place = is_latitude and is_longitude
    if not is_place:
        raise messages.sounding_place(where=where, latitude=latitude, longitude=longitude)
    if math.isnan(east_deg):
        return PlaceOfSounding(math.radians(north_deg))
    return place_of_numbers(north_deg, east_deg)


def _stated_degrees(text: str) -> float:
    """The degrees of a field: NaN if empty or a fill value, infinite if it is not a number."""
    text = text.strip()
    if text.lower() in _NOT_STATED:
        return math.nan
    if "_" in text:
        return math.inf
    try:
        value = float(text)
    except ValueError:
        return math.inf
    return math.nan if value in FILLS or value in _UNKNOWN_DEG else value


_WITHOUT_HOUR = re.compile(r"\d{4}-?\d\d-?\d\d|\d{4}-?W\d\d(?:-?\d)?")


def first_stated(fields: Iterable[str]) -> str:
    """The first field of a column that is neither empty nor a fill value; "" if none is.

    >>> first_stated(["", "-9999", "48.25"])
    '48.25'
    """
    for text in fields:
        is_stated = not math.isnan(_stated_degrees(text))  # texts are infinite degrees
        if is_stated:
            return text.strip()
    return ""


def stated_time_ns(text: str, where: str) -> int | None:
    """The time that a field of a file states [Unix ns]; None if the field is empty.

    Refuses (InputError SOUNDING-TIME) a text that is not a time, such as a date without its hour.
    """
    if text.strip().lower() in _NOT_STATED:
        return None
    time_ns = utc_ns(text)
    is_date_alone = _WITHOUT_HOUR.fullmatch(text.strip()) is not None
    if time_ns is None or is_date_alone:
        raise messages.sounding_time(where=where, time=text.strip()[:40])
    return time_ns
