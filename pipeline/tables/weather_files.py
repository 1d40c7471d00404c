"""A file of a weather model, netCDF or GRIB: what is in it.

The only module that uses xarray. It imports pyproj first: loaded after ecCodes, pyproj crashes.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import InputError
from pipeline.units import HECTOPASCAL, Array, Integers

_ENGINES = {b"CDF\x01": "scipy", b"CDF\x02": "scipy", b"\x89HDF": "h5netcdf", b"GRIB": "cfgrib"}
_FORMATS = {"scipy": "netCDF classic", "h5netcdf": "netCDF-4", "cfgrib": "GRIB"}
_TEMPERATURE = {"t", "ta", "tmp", "temperature", "air_temperature"}
_MODEL_LEVELS = ("hybrid", "model_level")
_LEVELS = ("level", "pressure_level", "plev", "lev", *_MODEL_LEVELS)
_LATITUDE, _LONGITUDE = ("latitude", "lat"), ("longitude", "lon")
_MEMBERS = ("number", "member", "realization", "ensemble")
_HECTOPASCALS = ("hpa", "millibars", "millibar", "mbar", "mb")
_GRIB_HEAD = 16


def is_model_file(path: Path) -> bool:
    """Whether a file begins like netCDF or GRIB."""
    try:
        with path.open("rb") as file:
            return file.read(4) in _ENGINES
    except OSError:
        return False


@contextmanager
def open_datasets(path: Path) -> Iterator[tuple[list[Any], str]]:
    """The file as xarray's datasets, and its format; GRIB has one for each kind of level."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise _unreadable(path, error.strerror) from None
    engine = _ENGINES.get(head)
    if engine is None:
        what = f"begins with {head!r}: it is neither netCDF (classic or 4) nor GRIB"
        remedy = "download it as netCDF or GRIB; nccopy -k nc4 converts other kinds of netCDF"
        raise InputError("MODEL-FORMAT", what, where=str(path), remedy=remedy)
    try:
        import pyproj  # noqa: F401  (before ecCodes)
        import xarray

        if engine == "cfgrib":
            import cfgrib
        elif engine == "h5netcdf":
            import h5netcdf  # noqa: F401
    except (ImportError, RuntimeError) as error:  # ecCodes without its library raises the latter
        what = f"weather models are read by packages that are not installed: {error}"
        remedy = "pip install 'unbend[nwp]'"
        raise InputError("MODEL-PACKAGE", what, where=str(path), remedy=remedy) from None
    datasets: list[Any] = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of versions of xarray to come
            if engine == "cfgrib":
                refuse_truncated(path)
                options = {"indexpath": "", "errors": "raise"}
                datasets = cfgrib.open_datasets(str(path), backend_kwargs=options)
            else:
                datasets = [xarray.open_dataset(path, engine=engine, decode_timedelta=True)]
            yield datasets, _FORMATS[engine]
    except InputError:
        raise
    except Exception as error:  # of xarray, its engines and ecCodes, by what the damage hit
        raise _unreadable(path, error) from None
    finally:
        for dataset in datasets:
            dataset.close()


def _unreadable(path: Path, why: object) -> InputError:
    what = f"the file cannot be read: {str(why)[:200]}"
    return InputError("MODEL-UNREADABLE", what, where=str(path), remedy="download it again")


def refuse_truncated(path: Path) -> None:
    """Refuse a GRIB file whose messages do not end where they say."""
    size, start, number = path.stat().st_size, 0, 0
    with path.open("rb") as file:
        while start < size:
            file.seek(start)
            head = file.read(_GRIB_HEAD)
            skipped = (head + file.read(1 << 16)).find(b"GRIB")
            if skipped < 0:  # padding
                return
            start += skipped
            if skipped:
                continue
            number += 1
            is_second = len(head) == _GRIB_HEAD and head[7] == 2
            length = int.from_bytes(head[8:16] if is_second else head[4:7], "big")
            if not is_second and length & 0x800000:  # ECMWF's long messages count otherwise
                return
            file.seek(max(start + length - 4, 0))
            if length < _GRIB_HEAD or file.read(4) != b"7777":
                what = (
                    f"message {number} at byte {start} has {length} bytes by its header, and no "
                    f"end there; the file has {size} bytes"
                )
                remedy = "the download was cut off: fetch the file again"
                raise InputError("MODEL-TRUNCATED", what, where=str(path), remedy=remedy)
            start += length


def _dimension(field: Any, names: Sequence[str]) -> str | None:
    """The dimension of a field that has one of some names."""
    return next((str(d) for d in field.dims if str(d).lower() in names), None)


@dataclass(frozen=True, eq=False)
class _Levels:
    """The levels of a field: its dimension, (l,) numbers or pressures [Pa], and which they are."""

    name: str
    values: Array
    of_model: bool


def _levels(field: Any) -> _Levels | None:
    """The levels of a field, None where it is that of one level."""
    name = next((str(d) for d in field.dims if str(d).lower() in _LEVELS
                 or str(d).lower().startswith("isobaric")), None)  # fmt: skip
    if name is None or name not in field.coords:
        return None
    attributes = {key: str(text).lower() for key, text in field[name].attrs.items()}
    values = np.asarray(field[name].values, np.float64)
    of_model = name.lower() in _MODEL_LEVELS or "model" in attributes.get("long_name", "")
    unit = attributes.get("units", "hpa" if values.max() < 2000.0 else "pa")
    if not of_model and unit in _HECTOPASCALS:
        values = values * HECTOPASCAL
    return _Levels(name, values, of_model)


def temperature_on_levels(datasets: Sequence[Any]) -> Any | None:
    """The temperature on levels, None where there is none."""
    for dataset in datasets:
        for name, field in dataset.data_vars.items():
            short = str(name).lower().split("_isobaric")[0]
            if (_levels(field) is not None
                    and {short, str(field.attrs.get("standard_name"))} & _TEMPERATURE):  # fmt: skip
                return field
    return None


def times_of(field: Any, where: str) -> tuple[str | None, Integers, Array]:
    """The dimension of time, the times (t,) [Unix ns], and hours (t,) since each run began."""
    dims = [str(d) for d in field.dims if d in field.coords and field[d].dtype.kind in "mM"]
    dims = [d for d in dims if field.sizes[d] > 1]
    if len(dims) > 1:
        runs = " and ".join(f"{field.sizes[d]} of {d}" for d in dims)
        what, remedy = f"it has {runs}: several runs of a forecast", "keep one run in the file"
        raise InputError("MODEL-TIME", what, where=where, remedy=remedy)
    dim = dims[0] if dims else next((d for d in ("valid_time", "time") if d in field.dims), None)
    name = next((n for n in ("valid_time", dim, "time") if n in field.coords), None)
    stamps = np.empty(0) if name is None else np.atleast_1d(field[name].values)
    if stamps.dtype.kind != "M" or stamps.size != (1 if dim is None else field.sizes[dim]):
        what, remedy = "its fields have no time that can be read", "download the file again"
        raise InputError("MODEL-TIME", what, where=where, remedy=remedy)
    lead = np.zeros(stamps.size)
    if "step" in field.coords and field["step"].dtype.kind == "m":
        lead = lead + np.atleast_1d(field["step"].values) / np.timedelta64(1, "h")
    return dim, stamps.astype("datetime64[ns]").astype(np.int64), lead


def contents_of(path: Path) -> dict[str, Any]:
    """What a file of a weather model holds, for `unbend inspect`: nothing is judged.

    Keys: format, grid, variables (name, long_name, units, levels), and of the temperature on
    levels level_kind (pressure | model), levels [hPa, or number], times_utc, lead_h, members,
    latitude_deg and longitude_deg (from, to, step, count; None on a projected grid).
    """
    with open_datasets(path) as (datasets, format_name):
        variables = []
        for field in (field for dataset in datasets for field in dataset.data_vars.values()):
            on = _levels(field)
            row = {"name": str(field.name), "levels": 1 if on is None else on.values.size}
            row |= {key: str(field.attrs.get(key, "")) for key in ("long_name", "units")}
            variables.append(row)
        upper = temperature_on_levels(datasets)
        contents: dict[str, Any] = {"format": format_name, "variables": variables}
        levels = None if upper is None else _levels(upper)
        if upper is None or levels is None:
            return contents | {"grid": None}
        _, time_ns, lead_h = times_of(upper, path.name)
        member = _dimension(upper, _MEMBERS)
        scale = 1.0 if levels.of_model else HECTOPASCAL
        contents |= {
            "grid": grid_name(datasets, upper),
            "level_kind": "model" if levels.of_model else "pressure",
            "levels": np.sort(levels.values / scale).tolist(),
            "times_utc": time_ns.astype("datetime64[ns]")
            .astype("datetime64[m]")
            .astype(str)
            .tolist(),
            "lead_h": lead_h.tolist(),
            "members": [] if member is None else upper[member].values.tolist(),
        }
        for key, names in (("latitude_deg", _LATITUDE), ("longitude_deg", _LONGITUDE)):
            axis = _dimension(upper, names)
            nodes = np.sort(np.asarray(upper[axis].values, np.float64)) if axis else np.empty(0)
            contents[key] = None if not nodes.size else {
                "from": round(float(nodes[0]), 6), "to": round(float(nodes[-1]), 6),
                "step": round(float(np.diff(nodes).min(initial=360.0)), 6), "count": nodes.size,
            }  # fmt: skip
        return contents


def grid_name(datasets: Sequence[Any], field: Any) -> str:
    """Which grid a field is on: latitude-longitude, or as GRIB or CF call another."""
    if _dimension(field, _LATITUDE) and _dimension(field, _LONGITUDE):
        return "latitude-longitude"
    named = (v.attrs.get("grid_mapping_name") for d in datasets for v in d.variables.values())
    own = field.attrs.get("GRIB_gridType") or next((str(n) for n in named if n), None)
    return own or f"unnamed, with dimensions {', '.join(map(str, field.dims))}"
