"""The contents of a sounding or a text of METARs as they are read, for `unbend inspect`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from unbend.atmosphere.metar import Metar, decode_metar, has_report
from unbend.atmosphere.soundings import RawLevels, check_levels
from unbend.tables.soundings import ascents_in
from unbend.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K, Array

LARGEST_METAR_FILE_BYTES = 10_000_000  # a year of one station has 2 MB


def reading_of_weather(path: Path) -> dict[str, Any] | None:
    """Read a file as a sounding or as METARs; None if it is neither.

    The key ``kind`` is ``sounding``, with the keys of `reading_of_sounding`, or ``metar``, with
    ``reports``. Raises InputError where a mission would refuse the file.
    """
    ascents = ascents_in(path)
    if ascents:
        return reading_of_sounding(ascents)
    reports = reports_in(path)
    if reports:
        return {"kind": "metar", "reports": [reading_of_report(report) for report in reports]}
    return None


def reading_of_sounding(ascents: Sequence[RawLevels]) -> dict[str, Any]:
    """Contents of the first ascent with levels, and the times of the first and last ascent.

    ``ascents``: at least one. Ranges are [lowest, highest]; a value is None if the file does not
    state it.
    """
    first = next((raw for raw in ascents if raw.pressure_pa.size), ascents[0])
    times_ns = [raw.time_ns for raw in ascents if raw.time_ns is not None]
    sounding, notes = check_levels(first)
    vapour_pressure_hpa = limits_of(sounding.vapour_pressure_pa / HECTOPASCAL)
    return {
        "kind": "sounding",
        "format": sounding.origin,
        "ascents": len(ascents),
        "first_utc": None if not times_ns else minute_of(min(times_ns)),
        "last_utc": None if not times_ns else minute_of(max(times_ns)),
        "station": sounding.station or None,
        "latitude_deg": rounded_degrees(sounding.latitude_rad),
        "longitude_deg": rounded_degrees(sounding.longitude_rad),
        "levels_in_file": int(first.pressure_pa.size),
        "levels": int(sounding.h_m.size),
        "h_m": limits_of(sounding.h_m),
        "heights": "geopotential" if first.geopotential else "geometric",
        "pressure_hpa": limits_of(sounding.pressure_pa / HECTOPASCAL),
        "temperature_c": limits_of(sounding.temperature_k - ZERO_CELSIUS_K),
        "vapour_pressure_hpa": vapour_pressure_hpa,
        "humidity": None if vapour_pressure_hpa is None else quantity_of_humidity(first),
        "columns": dict(first.column_of),
        "notes": [note.what for note in notes],
    }


def quantity_of_humidity(raw: RawLevels) -> str:
    """The quantities that a sounding states humidity as, for example "dew point"."""
    quantities = {
        "vapour pressure": raw.vapour_pressure_pa,
        "dew point": raw.dew_point_k,
        "relative humidity": raw.relative_humidity,
    }
    present = [name for name, values in quantities.items() if values is not None]
    return " and ".join(present)


def reports_in(path: Path) -> list[Metar]:
    """The METARs of a text file, one a line; empty if it has none or is not a text.

    Raises InputError for a line that begins as a report and cannot be decoded.
    """
    try:
        if path.stat().st_size > LARGEST_METAR_FILE_BYTES:
            return []
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return []
    reports = []
    for number, line in enumerate(text.splitlines(), start=1):
        if has_report(line):
            reports.append(decode_metar(line, f"{path.name}, line {number}"))
    return reports


def reading_of_report(report: Metar) -> dict[str, Any]:
    """Contents of a METAR by key; None for values that it does not state."""
    stamp = None
    if report.stamp is not None:
        day, hour, minute = report.stamp
        stamp = f"day {day}, {hour:02d}:{minute:02d} UTC"
    return {
        "station": report.station,
        "stamp": stamp,
        "date": None if report.date is None else str(report.date),
        "temperature_c": rounded(report.temperature_c),
        "dew_point_c": rounded(report.dew_point_c),
        "qnh_hpa": rounded(report.altimeter_pa / HECTOPASCAL),
        "text": report.text,
        "notes": list(report.complaints),
    }


def limits_of(values: Array) -> list[float] | None:
    """[lowest, highest] of the finite values, to two decimals; None if no value is finite."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    return [round(float(finite.min()), 2), round(float(finite.max()), 2)]


def rounded(value: float) -> float | None:
    """A number to two decimals; None for NaN, which means unknown."""
    return round(value, 2) if math.isfinite(value) else None


def rounded_degrees(angle_rad: float) -> float | None:
    """An angle in degrees, to four decimals; None for NaN, which means unknown."""
    return round(angle_rad / DEGREE, 4) if math.isfinite(angle_rad) else None


def minute_of(time_ns: int) -> str:
    """A time [Unix ns] as ISO 8601 in UTC, to the minute: 2025-06-12T09:30."""
    return str(np.datetime64(time_ns, "ns").astype("datetime64[m]"))
