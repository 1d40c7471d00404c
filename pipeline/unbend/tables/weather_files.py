"""A file of a weather model, netCDF or GRIB: opening it, and listing its contents.

The only module that imports xarray, and pyproj before it: loaded after ecCodes, pyproj crashes.
"""

import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from unbend.errors import InputError
from unbend.tables import messages
from unbend.tables.hdf5_probe import structure_is_readable
from unbend.tables.weather_fields import (
    LATITUDE,
    LONGITUDE,
    MEMBERS,
    dimension_of,
    find_field,
    grid_name,
    levels_of,
    minutes_of,
    times_of,
)
from unbend.units import HECTOPASCAL

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

# The first four bytes of a file -> xarray's engine.
_ENGINES = {b"CDF\x01": "scipy", b"CDF\x02": "scipy", b"\x89HDF": "h5netcdf", b"GRIB": "cfgrib"}
_READERS = ("xarray", "scipy", "h5netcdf", "h5py", "cfgrib", "eccodes", "gribapi")
_FORMATS = {"scipy": "netCDF classic", "h5netcdf": "netCDF-4", "cfgrib": "GRIB"}
_GRIB_HEAD = 16  # bytes of the first section of a message of edition 2
_GRIB_PADDING = 1 << 16  # bytes between messages at most
_GRIB_END = b"7777"
_LEAST_SECTION = 5  # bytes: its length and its number
_BEGIN_OF_SECTION = 10  # bytes, in which both editions state the size of their grid
_GRID_FOLLOWS = 0x80  # bit of the eighth byte of the first section, of edition 1
_MISSING = 0xFFFF  # two bytes that mean "not stated"
MOST_GRID_POINTS = 50_000_000
"""Of a field: the global models of 9 km have 6.6 million. A damaged field of equal values can state
any number of points in some hundred bytes, and ecCodes allocates memory for all of them."""
_LONG_MESSAGE = 0x800000  # bit of the length in edition 1: ECMWF's long messages count otherwise


def is_model_file(path: Path) -> bool:
    """Whether a file begins like netCDF or GRIB."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(4) in _ENGINES
    return False


@contextmanager
def open_datasets(path: Path) -> "Iterator[tuple[list[Dataset], str]]":
    """Open a file as xarray's datasets, and name its format; they are closed at the end.

    netCDF is one dataset, GRIB one for each kind of level. Refuses (InputError) damaged files, also
    when the damage is met while values are read in the ``with`` block.
    """
    engine = _engine_of(path)
    _import_readers(path, engine)
    datasets: list[Dataset] = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about changes in later versions of xarray
            datasets += _datasets_of(path, engine)
            yield datasets, _FORMATS[engine]
    except InputError:
        raise
    except Exception as error:  # xarray, its engines and ecCodes raise many kinds on damage
        if not _is_from_readers(error):
            raise
        raise messages.model_unreadable(where=path, why=str(error)[:200]) from None
    finally:
        for dataset in datasets:
            dataset.close()


def _engine_of(path: Path) -> str:
    """The name of xarray's engine for a file, by its first bytes; refuses other formats."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise messages.model_unreadable(where=path, why=str(error.strerror)) from None
    engine = _ENGINES.get(head)
    if engine is None:
        raise messages.model_format(where=path, head=repr(head))
    return engine


def _import_readers(path: Path, engine: str) -> None:
    """Import the packages that ``engine`` needs; refuses the file if one is not installed."""
    try:
        import pyproj  # noqa: F401  (before ecCodes)
        import xarray  # noqa: F401

        if engine == "cfgrib":
            import cfgrib  # noqa: F401
        elif engine == "h5netcdf":
            import h5netcdf  # noqa: F401
    except (ImportError, RuntimeError) as error:  # ecCodes without its library raises the latter
        raise messages.model_package(where=path, error=str(error)) from None


def _datasets_of(path: Path, engine: str) -> "Sequence[Dataset]":
    """Open the datasets of a file; refuses damage on which HDF5 or ecCodes hang or crash.

    The packages must have been imported by `_import_readers`.
    """
    import xarray

    if engine == "h5netcdf" and not structure_is_readable(path):
        raise messages.model_endless(where=path)
    if engine != "cfgrib":
        return [xarray.open_dataset(path, engine=engine, decode_timedelta=True)]
    import cfgrib

    refuse_truncated(path)
    datasets: Sequence[Dataset] = cfgrib.open_datasets(
        str(path),
        backend_kwargs={"indexpath": "", "errors": "raise"},
    )
    return datasets


def _is_from_readers(error: Exception) -> bool:
    """Whether the traceback of an error passes through one of the `_READERS`."""
    frames = traceback.walk_tb(error.__traceback__)
    modules = set()
    for frame, _ in frames:
        package, _, _ = str(frame.f_globals.get("__name__")).partition(".")
        modules.add(package)
    return not modules.isdisjoint(_READERS)


@dataclass(frozen=True)
class _GribMessage:
    """A message of a GRIB file: its number from 1, the offset of its first byte, its length."""

    number: int
    start: int
    length: int
    is_second_edition: bool


def refuse_truncated(path: Path) -> None:
    """Refuse a GRIB file with a message or section that does not end where its header states."""
    size = path.stat().st_size
    number = 0
    start = 0  # the end of the message before
    with path.open("rb") as file:
        while start < size:
            number += 1
            message = _next_message(file, number, start)
            if message is None:
                return
            start = message.start
            length = message.length
            file.seek(max(min(start + length, size) - len(_GRIB_END), 0))
            is_whole = _GRIB_HEAD <= length <= size - start
            if not is_whole or file.read(len(_GRIB_END)) != _GRIB_END:
                raise messages.model_truncated(
                    where=path,
                    number=number,
                    start=start,
                    length=length,
                    size=size,
                )
            _refuse_long_sections(file, path, message)
            start += length


def _next_message(file: IO[bytes], number: int, start: int) -> _GribMessage | None:
    """The next message at or after the byte ``start``, with its ``number``.

    None if only padding follows, or if ecCodes alone can tell the length of the message.
    """
    file.seek(start)
    padding = file.read(_GRIB_HEAD + _GRIB_PADDING).find(b"GRIB")
    if padding < 0:
        return None
    start += padding
    file.seek(start)
    head = file.read(_GRIB_HEAD)
    if len(head) == _GRIB_HEAD and head[7] == 2:
        length = int.from_bytes(head[8:16], "big")
        return _GribMessage(number, start, length, is_second_edition=True)
    length = int.from_bytes(head[4:7], "big")
    if length & _LONG_MESSAGE:
        return None
    return _GribMessage(number, start, length, is_second_edition=False)


def _refuse_long_sections(
    file: IO[bytes],
    path: Path,
    message: _GribMessage,
) -> None:
    """Refuse sections on which ecCodes crashes, or that fill the memory.

    These are sections that do not fit into their message, and grids of more than
    `MOST_GRID_POINTS`.
    """
    offset = message.start + 8  # edition 1: 8 bytes before the first section
    bytes_of_size = 3  # at the start of a section
    if message.is_second_edition:
        offset = message.start + _GRIB_HEAD
        bytes_of_size = 4
    end = message.start + message.length
    sections: list[bytes] = []
    while offset != end - len(_GRIB_END):
        file.seek(offset)
        section = file.read(_BEGIN_OF_SECTION)
        size = int.from_bytes(section[:bytes_of_size], "big")
        if not _LEAST_SECTION <= size <= end - offset:
            raise messages.model_section_too_long(where=path, number=message.number, offset=offset)
        sections.append(section)
        if message.is_second_edition:
            points = _points_of_second_edition(section)
        else:
            points = _points_of_first_edition(sections)
        if points > MOST_GRID_POINTS:
            raise messages.model_grid_too_large(
                where=path, number=message.number, points=points, most=MOST_GRID_POINTS
            )
        offset += size


def _points_of_second_edition(section: bytes) -> int:
    """How many grid points a section of edition 2 states; 0 if it does not define the grid.

    ``section`` are its first bytes: WMO FM 92 GRIB 2, section 3, octets 7 to 10.
    """
    is_grid = section[4] == 3
    return int.from_bytes(section[6:10], "big") if is_grid else 0


def _points_of_first_edition(sections: list[bytes]) -> int:
    """How many grid points the last section so far states, in edition 1; 0 if it has no grid.

    ``sections`` are the first bytes of each section so far. The second one defines the grid if a
    bit of the first is set.
    """
    if len(sections) != 2:
        return 0
    product, grid = sections
    if not product[7] & _GRID_FOLLOWS:
        return 0
    columns = int.from_bytes(grid[6:8], "big")
    rows = int.from_bytes(grid[8:10], "big")
    if _MISSING in (columns, rows):  # a reduced grid: the section lists the length of each row
        return 0
    return columns * rows


def contents_of(path: Path) -> dict[str, Any]:
    """The contents of a weather model's file for `unbend inspect`, without checks.

    Keys: format, variables (name, long_name, units, levels) and grid, None if there is no
    temperature on levels. Else more keys describe the temperature: level_kind (pressure | model),
    levels [hPa, or number], times_utc, lead_h, members, and latitude_deg and longitude_deg (from,
    to, step, count; None on a projected grid).
    """
    with open_datasets(path) as (datasets, format_name):
        variables = []
        for dataset in datasets:
            variables += [_description_of(field) for field in dataset.data_vars.values()]
        contents: dict[str, Any] = {"format": format_name, "variables": variables}
        temperature = find_field(datasets, "temperature")
        levels = None if temperature is None else levels_of(temperature)
        if temperature is None or levels is None:
            return contents | {"grid": None}
        times = times_of(temperature, path.name)
        member = dimension_of(temperature, MEMBERS)
        unit = 1.0 if levels.of_model else HECTOPASCAL
        return contents | {
            "grid": grid_name(datasets, temperature),
            "level_kind": "model" if levels.of_model else "pressure",
            "levels": np.sort(levels.values / unit).tolist(),
            "times_utc": minutes_of(times.time_ns).astype(str).tolist(),
            "lead_h": times.lead_h.tolist(),
            "members": [] if member is None else temperature[member].values.tolist(),
            "latitude_deg": _extent_of(temperature, LATITUDE),
            "longitude_deg": _extent_of(temperature, LONGITUDE),
        }


def _description_of(field: "DataArray") -> dict[str, object]:
    """Name, number of levels, long name and unit of a field, as `contents_of` lists them."""
    levels = levels_of(field)
    return {
        "name": str(field.name),
        "levels": 1 if levels is None else levels.values.size,
        "long_name": str(field.attrs.get("long_name", "")),
        "units": str(field.attrs.get("units", "")),
    }


def _extent_of(field: "DataArray", names: Sequence[str]) -> dict[str, float] | None:
    """Lowest and highest node, smallest step [deg] and number of nodes of an axis.

    ``names`` is LATITUDE or LONGITUDE; None if the field has no such dimension, or no nodes.
    """
    axis = dimension_of(field, names)
    if axis is None or field[axis].values.size == 0:
        return None
    nodes = np.sort(np.asarray(field[axis].values, np.float64))
    step = np.diff(nodes).min(initial=360.0)
    return {
        "from": round(float(nodes[0]), 6),
        "to": round(float(nodes[-1]), 6),
        "step": round(float(step), 6),
        "count": nodes.size,
    }
