"""The Integrated Global Radiosonde Archive, version 2: soundings and derived parameters.

Formats: NOAA NCEI, igra2-data-format.txt and igra2-derived-format.txt. Fixed columns; heights are
geopotential. Fields: -9999 missing, -8888 removed by the archive's own checks.
"""

import re
from collections.abc import Iterator

import numpy as np

from pipeline.atmosphere.soundings.levels import RawLevels, number, numbers, radians, utc_ns
from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K, Array

_HEADER = re.compile(r"#[A-Z0-9]{11} \d{4} \d\d \d\d \d\d ")
_NO_HOUR = 99
_DAY_S = 86_400


def is_igra(text: str) -> bool:
    """Whether a text begins as a file of the archive."""
    return _HEADER.match(text) is not None


def is_derived(text: str) -> bool:
    """Whether it holds derived parameters: their header is longer."""
    return is_igra(text) and len(text.split("\n", 1)[0].rstrip()) > 75


def parse_igra(text: str, where: str, _: Ledger) -> list[RawLevels]:
    """The ascents of an IGRA v2 file."""
    return [
        RawLevels(
            h_m=_column(lines, 17, 21, 1.0),
            pressure_pa=_column(lines, 10, 15, 1.0),
            temperature_k=(t := _column(lines, 23, 27, 0.1) + ZERO_CELSIUS_K),
            dew_point_k=t - _column(lines, 35, 39, 0.1),
            relative_humidity=_column(lines, 29, 33, 0.001),
            time_ns=_time_ns(header),
            station=header[1:12],
            latitude_rad=radians(number(header[55:62]) * 1e-4, 90.0),
            longitude_rad=radians(number(header[63:71]) * 1e-4, 180.0),
            origin="IGRA v2",
            where=f"{where}, line {at}",
            lines_missing=_announced(header) - len(lines),
        )
        for header, lines, at in _blocks(text, where)
    ]


def parse_derived(text: str, where: str, _: Ledger) -> list[RawLevels]:
    """The ascents of an IGRA v2 file of derived parameters; it knows no position."""
    ascents = []
    for header, lines, at in _blocks(text, where):
        reported, computed = _column(lines, 9, 15, 1.0), _column(lines, 17, 23, 1.0)
        ascents.append(
            RawLevels(
                h_m=np.where(np.isfinite(reported), reported, computed),
                pressure_pa=_column(lines, 1, 7, 1.0),
                temperature_k=_column(lines, 25, 31, 0.1),
                vapour_pressure_pa=_column(lines, 73, 79, 0.1),  # thousandths of a hectopascal
                time_ns=_time_ns(header),
                station=header[1:12],
                origin="IGRA v2 derived",
                where=f"{where}, line {at}",
                lines_missing=_announced(header) - len(lines),
            )
        )
    return ascents


def _blocks(text: str, where: str) -> Iterator[tuple[str, list[str], int]]:
    """Header, its level lines, and the header's line number."""
    lines = text.splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("#")]
    if not heads:
        what = "is no IGRA file: none of its lines begins with # as the header of a sounding does"
        remedy = "leave out format, or name the one that the file has"
        raise InputError("SOUNDING-FORMAT", what, where=where, remedy=remedy)
    for head, after in zip(heads, [*heads[1:], len(lines)], strict=True):
        if not _HEADER.match(lines[head]):
            raise InputError(
                "SOUNDING-FORMAT",
                f"{lines[head][:24]!r} is no header of an IGRA sounding",
                where=f"{where}, line {head + 1}",
                remedy="fetch the station's file again",
            )
        yield lines[head], [line for line in lines[head + 1 : after] if line.strip()], head + 1


def _column(lines: list[str], first: int, last: int, scale: float) -> Array:
    """A column by the places of the format description, which count from one."""
    return numbers(line[first - 1 : last] for line in lines) * scale


def _announced(header: str) -> int:
    """How many levels the header promises."""
    count = number(header[32:36])
    return int(count) if np.isfinite(count) else 0


def _time_ns(header: str) -> int | None:
    """The release of the balloon, the nominal hour without one.

    The release time has no date: 2303 of the sounding of 00 UTC is the evening before.
    """
    year, month, day, hour = header[13:17], header[18:20], header[21:23], int(header[24:26])
    start = utc_ns(f"{year}-{month}-{day}")
    if start is None:
        return None
    midnight = start // NANOSECONDS_PER_SECOND
    release = number(header[27:31])
    is_known = np.isfinite(release) and release // 100 < 24 and release % 100 < 60
    if not is_known:
        nominal = None if hour == _NO_HOUR else midnight + 3600 * hour
        return None if nominal is None else nominal * NANOSECONDS_PER_SECOND
    seconds = 3600 * int(release // 100) + 60 * int(release % 100)
    if hour != _NO_HOUR:
        seconds += _DAY_S * round((3600 * hour - seconds) / _DAY_S)
    return (midnight + seconds) * NANOSECONDS_PER_SECOND
