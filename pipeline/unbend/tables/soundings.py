"""Reads soundings from files: text in any known format, or the netCDF of an ARM radiosonde."""

import math
import zlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

import numpy as np

from unbend.atmosphere import soundings
from unbend.atmosphere.soundings.levels import FILLS, LARGEST, place_of_numbers, to_si
from unbend.errors import Counted
from unbend.messages import Ledger
from unbend.tables import messages
from unbend.units import NANOSECONDS_PER_SECOND, Array

if TYPE_CHECKING:
    from scipy.io import netcdf_file

# Decades of one station take less; a larger file is of another kind, and would fill memory.
LARGEST_BYTES = 200_000_000
_LATEST_S = 7_258_118_400  # Unix seconds of the year 2200

# First bytes of files.
_ZIP = b"PK\x03\x04"
_NETCDF3 = b"CDF"
_HDF5 = b"\x89HDF"
# Variables of ARM's sondewnpn datastream -> their units.
_UNIT_OF_VARIABLE = {"pres": "hpa", "tdry": "c", "dp": "c", "rh": "percent", "alt": "m"}


def read_sounding(
    path: Path,
    ledger: Ledger,
    *,
    format_name: str = "auto",
    time_ns: int | None = None,
    latitude_rad: float = math.nan,
    station_h_m: float = math.nan,
) -> soundings.Sounding:
    """Read a sounding from a text file, an ARM netCDF file, or a ZIP archive of one file.

    Arguments are those of `parse_sounding`: ``format_name`` of a text, ``time_ns`` of the flight
    [Unix ns] for which the nearest ascent is taken, and latitude and height of the station for
    files that do not state them. A sounding without a station gets the name of the file. Raises
    ``InputError`` if the file cannot be read or is not a sounding.
    """
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST_BYTES else b""
    except OSError as error:
        raise messages.sounding_unreadable(where=path, strerror=str(error.strerror)) from None
    if size > LARGEST_BYTES:
        raise messages.sounding_size(where=path, size=size, largest_bytes=LARGEST_BYTES)
    if data.startswith(_ZIP):
        data = _unpacked(data, path)
    if data.startswith(_HDF5):
        raise messages.sounding_is_netcdf4(where=path)
    if data.startswith(_NETCDF3):
        raw = soundings.nearest_in_time([_levels_of_netcdf(data, path)], time_ns, path.name)
        checked = soundings.check_levels(raw, latitude_rad=latitude_rad, station_h_m=station_h_m)
        sounding = ledger.take(checked)
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            byte = data[error.start]
            raise messages.sounding_not_utf8(where=path, byte=byte, offset=error.start) from None
        sounding = soundings.parse_sounding(
            text,
            ledger,
            where=path.name,
            format_name=format_name,
            time_ns=time_ns,
            latitude_rad=latitude_rad,
            station_h_m=station_h_m,
        )
    return sounding if sounding.station else replace(sounding, station=path.name)


def ascents_in(path: Path) -> list[soundings.RawLevels]:
    """All ascents of a file, with their levels unchecked; empty if the file is not a sounding.

    Refuses (InputError) a damaged sounding.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            return []
        data = path.read_bytes()
    except OSError:
        return []
    if data.startswith(_ZIP):
        data = _unpacked(data, path)
    if data.startswith(_NETCDF3):
        return [_levels_of_netcdf(data, path)] if _has_names_of_arm(data) else []
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return []
    return soundings.ascents_of_text(text, path.name)


def _has_names_of_arm(data: bytes) -> bool:
    """Whether the bytes of a classic netCDF file contain the variables of ARM's radiosondes."""
    from scipy.io import netcdf_file

    try:
        with netcdf_file(BytesIO(data), "r", mmap=False) as file:
            return _UNIT_OF_VARIABLE.keys() <= file.variables.keys()
    except (OSError, TypeError, ValueError, IndexError, AttributeError):
        return False


def _unpacked(data: bytes, path: Path) -> bytes:
    """The bytes of the only file in a ZIP archive; IGRA, for example, distributes such archives.

    Refuses (InputError SOUNDING-ZIP) archives that are damaged or contain several files or none,
    and (SOUNDING-SIZE) a file of more than `LARGEST_BYTES`.
    """
    try:
        with ZipFile(BytesIO(data)) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            if len(members) != 1:
                raise messages.sounding_archive(
                    where=path, why=f"it contains {Counted(len(members), 'file')}"
                )
            if members[0].file_size > LARGEST_BYTES:
                raise messages.sounding_size(
                    where=path, size=members[0].file_size, largest_bytes=LARGEST_BYTES
                )
            with archive.open(members[0]) as file:
                return file.read(LARGEST_BYTES)
    except (BadZipFile, NotImplementedError, RuntimeError, EOFError, zlib.error) as error:
        raise messages.sounding_archive(where=path, why=str(error)) from None


def _levels_of_netcdf(data: bytes, path: Path) -> soundings.RawLevels:
    """The levels of an ARM radiosonde from the bytes of a classic netCDF file, in SI units.

    Fill values become NaN. ``path`` is named in refusals.
    """
    from scipy.io import netcdf_file

    try:
        with netcdf_file(BytesIO(data), "r", mmap=False) as file:
            columns = {}
            for name, unit in _UNIT_OF_VARIABLE.items():
                if name not in file.variables:
                    raise messages.sounding_variable_missing(where=path, variable=name)
                columns[name] = to_si(_column(file, name), unit)
            latitude_deg = _first_value(file, "lat", math.nan)
            longitude_deg = _first_value(file, "lon", math.nan)
            base_s = 0  # Unix seconds; 0 if unknown
            if "base_time" in file.variables:
                base_s = int(file.variables["base_time"].getValue())
            offset_s = _first_value(file, "time_offset", 0.0)  # from the base to the first level
    except (
        OSError,
        TypeError,
        ValueError,
        IndexError,
        AttributeError,
        OverflowError,  # of an infinite time
    ) as error:
        # scipy raises these on damaged headers.
        raise messages.sounding_damaged(where=path, error=str(error)) from None
    release_ns = None
    if 0 < base_s < _LATEST_S:  # else unknown, or a fill value
        offset_s = offset_s if math.isfinite(offset_s) else 0.0
        release_ns = round((base_s + offset_s) * NANOSECONDS_PER_SECOND)
    where_released = place_of_numbers(latitude_deg, longitude_deg)
    return soundings.RawLevels(
        h_m=columns["alt"],
        pressure_pa=columns["pres"],
        temperature_k=columns["tdry"],
        # ARM does not state it, but the hypsometric equation reproduces these heights to 2e-4 up
        # to 24 km; geometric heights would differ by 0.7 % in the upper layers.
        geopotential=True,
        dew_point_k=columns["dp"],
        relative_humidity=columns["rh"],
        time_ns=release_ns,
        latitude_rad=where_released.latitude_rad,
        longitude_rad=where_released.longitude_rad,
        origin="ARM radiosonde netCDF",
        where=path.name,
        column_of={"pressure": "pres [hPa]", "temperature": "tdry [C]", "dew point": "dp [C]"},
    )


def _first_value(file: "netcdf_file", name: str, default: float) -> float:
    """The first value of a variable, NaN for a fill value; ``default`` without the variable."""
    if name not in file.variables:
        return default
    return float(_column(file, name)[0])


def _column(file: "netcdf_file", name: str) -> Array:
    """The values of a variable in its unit; NaN for fill values and impossibly large ones."""
    values = np.array(file.variables[name].data, dtype=np.float64)
    is_fill = np.isin(values, FILLS)
    is_possible = np.abs(values) <= LARGEST
    return np.where(is_possible & ~is_fill, values, np.nan)
