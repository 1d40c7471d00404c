"""A plain CSV of levels, whose column names state the units."""

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
from pipeline.units import Array

# Name of a column -> quantity, unit.
COLUMNS = {
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
_PLACE = ("time_utc", "latitude_deg", "longitude_deg", "station")


def is_plain(text: str) -> bool:
    """Whether the first line that is no comment names a pressure and a temperature with units."""
    lines = (line for line in text.lstrip("\ufeff").splitlines() if not line.startswith("#"))
    names = {name.strip().lower() for name in next(lines, "").split(",")}
    return any(n.startswith("pressure") for n in names) and any(
        n.startswith("temperature") for n in names
    )


def parse_plain(text: str, where: str, ledger: Ledger) -> list[RawLevels]:
    """The ascent of a plain CSV; other columns are not read, which is noted."""
    columns = {name.lower(): fields for name, fields in table(text.splitlines(), where).items()}
    values: dict[str, Array] = {}
    column_of: dict[str, str] = {}
    for name in (name for name in COLUMNS if name in columns):
        quantity, unit = COLUMNS[name]
        if quantity in column_of:
            what = f"{column_of[quantity]} and {name} both give the {quantity}"
            raise InputError("SOUNDING-COLUMN", what, where=where, remedy="keep one of them")
        values[quantity], column_of[quantity] = to_si(numbers(columns[name]), unit), name
    for needed in ("pressure", "temperature"):
        if needed not in values:
            names = [name for name, (quantity, _) in COLUMNS.items() if quantity == needed]
            what = f"no column gives the {needed} with its unit; there are {', '.join(columns)}"
            raise InputError(
                "SOUNDING-COLUMN", what, where=where, remedy=f"name the column {' or '.join(names)}"
            )
    other = sorted(set(columns) - set(COLUMNS) - set(_PLACE))
    if other:
        what = f"columns that are not read: {', '.join(other)}"
        ledger.note("SOUNDING-COLUMNS-UNUSED", what, where=where, count=len(other))
    geopotential = "height" not in values
    time = next((text.strip() for text in columns.get("time_utc", []) if text.strip()), "")
    time_ns = utc_ns(time)
    if time and time_ns is None:
        what = f"time_utc {time[:40]!r} is no time like 2026-05-14T10:20:00Z: the sounding has none"
        ledger.warning("SOUNDING-TIME", what, where=where, count=1)
    unknown = np.full(values["pressure"].shape, np.nan)
    first = {name: next(iter(columns.get(name, [])), "") for name in _PLACE}
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
            latitude_rad=radians(number(first["latitude_deg"]), 90.0),
            longitude_rad=radians(number(first["longitude_deg"]), 180.0),
            origin="plain CSV",
            where=where,
            column_of=column_of,
        )
    ]
