"""Soundings of the University of Wyoming: the text list of its web page, and its CSV.

Heights are geopotential. The list has columns seven places wide in which a field may be blank.
"""

import math
import re

import numpy as np

from pipeline.atmosphere.soundings.levels import (
    RawLevels,
    number,
    numbers,
    radians,
    table,
    to_si,
    utc_ns,
)
from pipeline.errors import InputError
from pipeline.ledger import Ledger

_WIDTH = 7
_TITLES = re.compile(r"^\s*PRES\s+HGHT\s+TEMP\s+DWPT", re.MULTILINE)
_INLINE = re.compile(r"PRES\s+hPa,\s*HGHT\s+m,\s*TEMP\s+C,\s*DWPT\s+C")
_TAG = re.compile(r"<[^>]+>")
_MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
_DATE = re.compile(r"(?P<hour>\d\d)Z (?P<day>\d\d?) (?P<month>[A-Z][a-z]{2}) (?P<year>\d{4})")

_CSV_COLUMNS = {
    "pressure": "pressure_hPa",
    "height": "geopotential height_m",
    "temperature": "temperature_C",
    "dew point": "dew point temperature_C",
    "relative humidity": "relative humidity_%",
}


def is_list(text: str) -> bool:
    """Whether a text is a Wyoming list: PRES HGHT TEMP DWPT above columns."""
    return bool(_TITLES.search(text) or _INLINE.search(text))


def is_csv(text: str) -> bool:
    """Whether a text is a Wyoming CSV, by its first line."""
    first = text.lstrip("\ufeff").split("\n", 1)[0]
    return _CSV_COLUMNS["pressure"] in first and _CSV_COLUMNS["height"] in first


def parse_list(text: str, where: str, _: Ledger) -> list[RawLevels]:
    """The ascent of a text list, with or without the page around it."""
    plain = _TAG.sub("", text)
    titles = _TITLES.search(plain)
    if titles is None:
        rows = [line.split() for line in plain.splitlines() if not line.startswith("#")]
        rows = [row for row in rows if len(row) >= 4]
    else:
        # Fields of the lines between the second rule and the first line that is no level.
        rows = []
        for line in plain[titles.start() :].splitlines()[1:]:
            fields = [line[i : i + _WIDTH] for i in range(0, 5 * _WIDTH, _WIDTH)]
            if math.isfinite(number(fields[0])):
                rows.append(fields)
            elif rows:
                break
    # Nominal time: ``Observation time: 110522/1200``, or ``12Z 22 May 2011`` in the heading.
    time_ns, stamp = None, _header_field(plain, "Observation time")
    match = _DATE.search(plain)
    if re.fullmatch(r"\d{6}/\d{4}", stamp):
        # Two digits of the year: the list goes back to 1973.
        century = "19" if stamp[:2] >= "73" else "20"
        day = f"{century}{stamp[:2]}-{stamp[2:4]}-{stamp[4:6]}"
        time_ns = utc_ns(f"{day}T{stamp[7:9]}:{stamp[9:11]}")
    elif match is not None and match["month"] in _MONTHS:
        month = _MONTHS.index(match["month"]) + 1
        time_ns = utc_ns(f"{match['year']}-{month:02d}-{int(match['day']):02d}T{match['hour']}:00")
    p, h, t, dew = (numbers(row[i] for row in rows) for i in range(4))
    relative = numbers(row[4] if len(row) > 4 else "" for row in rows)
    return [
        RawLevels(
            h_m=h,
            pressure_pa=to_si(p, "hpa"),
            temperature_k=to_si(t, "c"),
            dew_point_k=to_si(dew, "c"),
            relative_humidity=to_si(relative, "percent") if titles is not None else None,
            time_ns=time_ns,
            station=_header_field(plain, "Station identifier")
            or _header_field(plain, "Station number"),
            latitude_rad=radians(number(_header_field(plain, "Station latitude")), 90.0),
            longitude_rad=radians(number(_header_field(plain, "Station longitude")), 180.0),
            origin="University of Wyoming list",
            where=where,
            column_of={"pressure": "PRES hPa", "temperature": "TEMP C", "dew point": "DWPT C"},
        )
    ]


def _header_field(text: str, what: str) -> str:
    match = re.search(rf"{what}:\s*(\S+)", text)
    return match.group(1) if match else ""


def parse_csv(text: str, where: str, _: Ledger) -> list[RawLevels]:
    """The ascent of a Wyoming CSV; its time is that of the first level."""
    columns = table(text.splitlines(), where)
    missing = [name for name in _CSV_COLUMNS.values() if name not in columns]
    if missing:
        what = f"the Wyoming CSV has no column {missing[0]!r}"
        raise InputError(
            "SOUNDING-COLUMN", what, where=where, remedy="fetch the file again, with all columns"
        )
    values = {key: numbers(columns[name]) for key, name in _CSV_COLUMNS.items()}
    first = {name: next(iter(columns.get(name, [])), "") for name in ("time", "latitude",
                                                                     "longitude")}  # fmt: skip
    latitude, longitude = number(first["latitude"]), number(first["longitude"])
    nowhere = latitude < -90.0  # both are -99.99 for a station whose place is not known
    return [
        RawLevels(
            h_m=values["height"],
            pressure_pa=to_si(values["pressure"], "hpa"),
            temperature_k=to_si(values["temperature"], "c"),
            dew_point_k=to_si(values["dew point"], "c"),
            relative_humidity=to_si(values["relative humidity"], "percent"),
            time_ns=utc_ns(first["time"]),
            latitude_rad=radians(latitude, 90.0),
            longitude_rad=np.nan if nowhere else radians(longitude, 180.0),
            origin="University of Wyoming CSV",
            where=where,
            column_of=_CSV_COLUMNS,
        )
    ]
