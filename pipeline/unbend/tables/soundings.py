"""A sounding from disk: text in any known format, or the netCDF of an ARM radiosonde."""

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

# Room for decades of one station; a larger file is of another kind, and would fill memory.
LARGEST_BYTES = 200_000_000
_ZIP = b"PK\x03\x04"
_LATEST_S = 7_258_118_400  # the year 2200

_NETCDF3 = b"CDF"
_HDF5 = b"\x89HDF"
# Names of ARM's sondewnpn datastream: variable, quantity's unit.
_VARIABLES = {"pres": "hpa", "tdry": "c", "dp": "c", "rh": "percent", "alt": "m"}


def read_sounding(
    path: Path,
    ledger: Ledger,
    *,
    format_name: str = "auto",
    time_ns: int | None = None,
    latitude_rad: float = math.nan,
    station_h_m: float = math.nan,
) -> soundings.Sounding:
    """Read a sounding; arguments as for `parse_sounding`. A nameless one is called by its file.

    Raises ``InputError`` where the file cannot be read or is none.
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
        raw = soundings.nearest_in_time([_netcdf(data, path)], time_ns, path.name)
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
    """All ascents of a file as they are in it, unchecked; empty where it is no sounding.

    Refuses (InputError) a file that is a sounding and cannot be read as one.
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
        return [_netcdf(data, path)] if _has_names_of_arm(data) else []
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return []
    return soundings.ascents_of_text(text, path.name)


def _has_names_of_arm(data: bytes) -> bool:
    """Whether a classic netCDF file has the variables of a radiosonde of ARM."""
    from scipy.io import netcdf_file

    try:
        with netcdf_file(BytesIO(data), "r", mmap=False) as file:
            return _VARIABLES.keys() <= file.variables.keys()
    except (OSError, TypeError, ValueError, IndexError, AttributeError):
        return False


def _unpacked(data: bytes, path: Path) -> bytes:
    """The only file of a ZIP archive, as archives distribute their station files.

    Refuses (InputError SOUNDING-ZIP) archives that are damaged, or hold no file or several, and
    (SOUNDING-SIZE) one that unpacks to more than `LARGEST_BYTES`.
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


def _netcdf(data: bytes, path: Path) -> soundings.RawLevels:
    """The levels of a classic netCDF file with ARM's names; fill values become NaN."""
    from scipy.io import netcdf_file

    try:
        with netcdf_file(BytesIO(data), "r", mmap=False) as file:
            columns = {}
            for name, unit in _VARIABLES.items():
                if name not in file.variables:
                    raise messages.sounding_variable_missing(where=path, variable=name)
                columns[name] = to_si(_column(file, name), unit)
            latitude_deg = _first_value(file, "lat", math.nan)
            longitude_deg = _first_value(file, "lon", math.nan)
            start = 0  # a fill value is no time, and none is none
            if "base_time" in file.variables:
                start = int(file.variables["base_time"].getValue())
            offset = _first_value(file, "time_offset", 0.0)
    except (
        OSError,
        TypeError,
        ValueError,
        IndexError,
        AttributeError,
        OverflowError,  # of an infinite time
    ) as error:
        # What scipy raises on a damaged header, by what the damage hit.
        raise messages.sounding_damaged(where=path, error=str(error)) from None
    release_ns = None
    if 0 < start < _LATEST_S:
        since = offset if math.isfinite(offset) else 0.0
        release_ns = round((start + since) * NANOSECONDS_PER_SECOND)
    where_released = place_of_numbers(latitude_deg, longitude_deg)
    return soundings.RawLevels(
        h_m=columns["alt"],
        pressure_pa=columns["pres"],
        temperature_k=columns["tdry"],
        # ARM does not say so, but they are: the hypsometric equation gives them to 2e-4 up to
        # 24 km, where geometric heights would be 0.7 % off in the upper layers.
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
    """The first value of a variable, ``default`` where the file has none of that name."""
    if name not in file.variables:
        return default
    return float(_column(file, name)[0])


def _column(file: "netcdf_file", name: str) -> Array:
    """The values of a variable; NaN for fill values, and beyond all that is measured."""
    values = np.array(file.variables[name].data, dtype=np.float64)
    is_fill = np.isin(values, FILLS)
    is_possible = np.abs(values) <= LARGEST
    return np.where(is_possible & ~is_fill, values, np.nan)
