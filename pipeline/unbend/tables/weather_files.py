"""A file of a weather model, netCDF or GRIB: what is in it, and its fields around a flight; the
only module that uses xarray. It imports pyproj first: loaded after ecCodes, pyproj crashes."""

import re
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.soundings import model_field
from unbend.atmosphere.soundings.level_checks import FEWEST_LEVELS
from unbend.atmosphere.soundings.model_field import ModelField
from unbend.errors import InputError
from unbend.geodesy import longitudes_near
from unbend.messages import Ledger
from unbend.tables import messages
from unbend.units import DEGREE, HECTOPASCAL, STANDARD_GRAVITY, Array, Integers, measured

FARTHEST_LONGITUDE_DEG = 540.0  # grids count from -180 or from 0, and some once around again
LARGEST_LEVEL = 1e8  # a pressure [Pa] with the unit of hectopascals twice
FARTHEST_H = 6.0  # farther from every time of the file a flight is refused [h]

_ENGINES = {b"CDF\x01": "scipy", b"CDF\x02": "scipy", b"\x89HDF": "h5netcdf", b"GRIB": "cfgrib"}
_READERS = ("xarray", "scipy", "h5netcdf", "h5py", "cfgrib", "eccodes", "gribapi")
_FORMATS = {"scipy": "netCDF classic", "h5netcdf": "netCDF-4", "cfgrib": "GRIB"}
_NAMES = {
    "temperature": {"t", "ta", "tmp", "temperature", "air_temperature"},
    "specific humidity": {"q", "hus", "spfh", "specific_humidity"},
    "relative humidity": {"r", "rh", "hur", "relative_humidity"},
    "geopotential": {"z", "gh", "zg", "hgt", "geopotential", "geopotential_height"},
    "surface geopotential": {"z", "orog", "surface_geopotential"},
    "log surface pressure": {"lnsp"},
}
_MODEL_LEVELS, _OF_MODEL = ("hybrid", "model_level"), re.compile("model|hybrid|sigma")
_LEVELS = ("level", "pressure_level", "plev", "lev", *_MODEL_LEVELS)
_LEVEL = re.compile(rf"isobaric|({'|'.join(_LEVELS)})$")
_LATITUDE, _LONGITUDE = ("latitude", "lat"), ("longitude", "lon")
_MEMBERS, _VERSIONS = ("number", "member", "realization", "ensemble"), ("expver",)
_TIMES, _RUNS = ("valid_time", "time"), ("forecast_reference_time", "reftime")
_PER_SECOND = re.compile(r"s\s*(?:\*\*|\^)?\s*-\s*2|/\s*s")
_HECTOPASCALS = ("hpa", "millibars", "millibar", "mbar", "mb")
_GRIB_HEAD = 16
_READ_GRID = "latitude-longitude"


def is_model_file(path: Path) -> bool:
    """Whether a file begins like netCDF or GRIB."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(4) in _ENGINES
    return False


@contextmanager
def open_datasets(path: Path) -> Iterator[tuple[list[Any], str]]:
    """The file as xarray's datasets, and its format; GRIB has one for each kind of level."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise messages.model_unreadable(where=path, why=str(error.strerror)) from None
    engine = _ENGINES.get(head)
    if engine is None:
        raise messages.model_format(where=path, head=repr(head))
    try:
        import pyproj  # noqa: F401  (before ecCodes)
        import xarray

        if engine == "cfgrib":
            import cfgrib
        elif engine == "h5netcdf":
            import h5netcdf  # noqa: F401
    except (ImportError, RuntimeError) as error:  # ecCodes without its library raises the latter
        raise messages.model_package(where=path, error=str(error)) from None
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
        frames = traceback.walk_tb(error.__traceback__)
        modules = {str(frame.f_globals.get("__name__")).partition(".")[0] for frame, _ in frames}
        if modules.isdisjoint(_READERS):
            raise
        raise messages.model_unreadable(where=path, why=str(error)[:200]) from None
    finally:
        for dataset in datasets:
            dataset.close()


def refuse_truncated(path: Path) -> None:
    """Refuse a GRIB file whose messages or their sections do not end where they say."""
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
            file.seek(max(min(start + length, size) - 4, 0))
            if not _GRIB_HEAD <= length <= size - start or file.read(4) != b"7777":
                raise messages.model_truncated(
                    where=path, number=number, start=start, length=length, size=size
                )
            at, digits = (start + _GRIB_HEAD, 4) if is_second else (start + 8, 3)
            while at != start + length - 4:  # ecCodes crashes where these are wrong
                file.seek(at)
                size_of = int.from_bytes(file.read(digits), "big")
                if not 5 <= size_of <= start + length - at:
                    raise messages.model_section_too_long(where=path, number=number, offset=at)
                at += size_of
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
    names = (str(d) for d in field.dims if _LEVEL.match(str(d).lower()))
    name = next(names, None)
    if name is None or name not in field.coords:
        return None
    attributes = {key: str(text).lower() for key, text in field[name].attrs.items()}
    values = np.asarray(field[name].values, np.float64)
    words = attributes.get("long_name", "") + attributes.get("standard_name", "")
    of_model = name.lower() in _MODEL_LEVELS or bool(_OF_MODEL.search(words))
    unit = attributes.get("units", "hpa" if values.max() < 2000.0 else "pa")
    if not of_model and unit in _HECTOPASCALS:
        values = values * HECTOPASCAL
    return _Levels(name, values, of_model)


def _find(datasets: Sequence[Any], quantity: str) -> Any | None:
    """The field of a quantity of the surface, or on levels; of several the one with most levels:
    GRIB has those above 1 hPa apart."""
    upper: list[tuple[int, int, Any]] = []
    surface: list[Any] = []
    for dataset in datasets:
        for name, field in dataset.data_vars.items():
            short = str(name).lower().split("_isobaric")[0]
            names = {short, *(field.attrs.get(of) for of in ("standard_name", "GRIB_shortName"))}
            levels = _levels(field)
            if not names & _NAMES[quantity]:
                continue
            of_level = any(str(c).lower() in _LEVELS for c in field.coords)
            kind = field.attrs.get("GRIB_typeOfLevel", "level" if of_level else "surface")
            if levels is not None:
                upper.append((levels.values.size, -len(upper), field))
                if levels.of_model:  # lnsp and z mean something at level 1 only
                    first = int(np.argmin(levels.values))
                    surface.append(field.isel({levels.name: first}, drop=True))
            elif kind in ("surface", "hybrid"):
                surface.append(field)
    if "surface" in quantity:
        return surface[0] if surface else None
    return max(upper)[2] if upper else None


# Models reach back to 1806 at most, and nanoseconds since 1970 end in 2262.
EARLIEST_TIME = np.datetime64("1800-01-01")
LATEST_TIME = np.datetime64("2200-01-01")
LONGEST_LEAD = np.timedelta64(3650, "D")  # of a forecast: those of seasons take months


def times_of(field: Any, where: str) -> tuple[str | None, Integers, Array]:
    """The dimension of time, the times (t,) [Unix ns], and hours (t,) since each run began.

    Refuses (MODEL-TIME) fields without a time that can be read, and times that no model has.
    """
    dims = [str(d) for d in field.dims if d in field.coords and field[d].dtype.kind in "mM"]
    dims = [d for d in dims if field.sizes[d] > 1]
    if len(dims) > 1:
        runs = " and ".join(f"{field.sizes[d]} of {d}" for d in dims)
        raise messages.model_several_runs(where=where, runs=runs)
    dim = dims[0] if dims else next((d for d in _TIMES if d in field.dims), None)
    name = next((n for n in ("valid_time", dim, "time") if n in field.coords), None)
    stamps = np.empty(0) if name is None else np.atleast_1d(field[name].values)
    if stamps.dtype.kind != "M" or stamps.size != (1 if dim is None else field.sizes[dim]):
        raise messages.model_without_time(where=where)
    stamps = possible_times(stamps, where)
    lead = np.zeros(stamps.size)
    if "step" in field.coords and field["step"].dtype.kind == "m":
        step = possible_steps(np.atleast_1d(field["step"].values), where)
        lead = lead + step / np.timedelta64(1, "h")
        if "valid_time" not in field.coords:  # these times are those of the run
            stamps = stamps + step
    for run in (name for name in _RUNS if name in field.coords):
        begin = possible_times(np.atleast_1d(field[run].values), where)
        lead = (stamps - begin) / np.timedelta64(1, "h")
    return dim, stamps.ravel().astype(np.int64), lead


def possible_times(stamps: NDArray[Any], where: str) -> NDArray[Any]:
    """Times in nanoseconds; refuses those that no model has, and none at all (NaT).

    Compared in their own unit: numpy turns what nanoseconds do not hold into any other time.
    """
    is_time = stamps.dtype.kind == "M"
    if is_time:
        earliest = EARLIEST_TIME.astype(stamps.dtype)
        latest = LATEST_TIME.astype(stamps.dtype)
        is_time = bool(((stamps >= earliest) & (stamps <= latest)).all())
    if not is_time:
        raise messages.model_without_time(where=where)
    return stamps.astype("datetime64[ns]")


def possible_steps(steps: NDArray[Any], where: str) -> NDArray[Any]:
    """Times since a run began in nanoseconds; refuses those of no forecast."""
    longest = LONGEST_LEAD.astype(steps.dtype)
    if not bool(((steps >= -longest) & (steps <= longest)).all()):
        raise messages.model_without_time(where=where)
    return steps.astype("timedelta64[ns]")


def _refuse_other_places(degrees: Array, axis: str, where: str) -> None:
    """Refuse latitudes or longitudes [deg] of an axis that are no places on earth."""
    farthest = FARTHEST_LONGITUDE_DEG if axis.lower() in _LONGITUDE else 90.0
    if not bool((np.abs(degrees) <= farthest).all()):
        raise messages.model_axis(where=where, axis=axis)


def _refuse_other_levels(levels: "_Levels", where: str) -> None:
    """Refuse levels that are no pressures and no numbers of levels, or stand there twice."""
    values = levels.values
    is_possible = bool(((values > 0.0) & (values <= LARGEST_LEVEL)).all())
    if not is_possible or np.unique(values).size < values.size:
        raise messages.model_axis(where=where, axis=levels.name)


def _minutes(time_ns: Integers) -> Any:
    return time_ns.astype("datetime64[ns]").astype("datetime64[m]")


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
        upper = _find(datasets, "temperature")
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
            "times_utc": _minutes(time_ns).astype(str).tolist(),
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
    named = (v.attrs.get("grid_mapping_name") for d in datasets for v in d.variables.values())
    own = field.attrs.get("GRIB_gridType") or next((str(n) for n in named if n), None)
    has_axes = _dimension(field, _LATITUDE) and _dimension(field, _LONGITUDE)
    if has_axes and own in (None, "regular_ll", "regular_gg", "latitude_longitude"):
        return _READ_GRID
    return own or f"unnamed, with dimensions {', '.join(map(str, field.dims))}"


@dataclass(frozen=True, eq=False)
class FlightArea:
    """Places (n,) [rad] and times (n,) [Unix ns] that columns are taken at."""

    latitude_rad: Array
    longitude_rad: Array
    time_ns: Integers


def read_model_field(
    path: Path, area: FlightArea, ledger: Ledger, *, member: int | None = None
) -> ModelField:
    """The fields of a weather model around a flight; only that part of the file is read.

    ``member`` of an ensemble. Refuses (`InputError`) files of another kind or damaged, projected
    grids, missing fields, an ensemble without a member, levels that make no column, another time
    and wrong units, each with a code of its own (MODEL-...).
    """
    where = path.name
    with open_datasets(path) as (datasets, _):
        t = _find(datasets, "temperature")
        if t is not None and (grid := grid_name(datasets, t)) != _READ_GRID:
            raise messages.model_grid(where=where, grid=grid)
        levels = None if t is None else _levels(t)
        if levels is not None and levels.values.size < FEWEST_LEVELS and not levels.of_model:
            raise model_field.too_few_levels(levels.values, where, "in all")
        if levels is not None:
            _refuse_other_levels(levels, where)
        found = {name: _find(datasets, name) for name in _NAMES}
        surface, log_surface = found["surface geopotential"], found["log surface pressure"]
        specific, humidity = found["specific humidity"], found["relative humidity"]
        humidity = specific if specific is not None else humidity
        of_model = levels is not None and levels.of_model
        height = None if of_model else found["geopotential"]
        lacking = [name for name, field in {
            "temperature on levels": t, "specific or relative humidity on levels": humidity,
            "geopotential on levels": surface if of_model else height,
            "lnsp (at level 1)": log_surface if of_model else t,
        }.items() if field is None]  # fmt: skip
        if lacking or t is None or levels is None:
            held = ", ".join(sorted({str(v) for d in datasets for v in d.data_vars})) or "nothing"
            raise messages.model_variable_missing(
                where=where, lacking=", no ".join(lacking), held=held
            )
        part = _Part.of(t, area, where, member)
        level = np.sort(levels.values)
        whole = np.arange(level[0], model_field.MODEL_LEVELS + 1.0)
        if of_model and not np.array_equal(level, whole):
            raise messages.model_levels_incomplete(
                where=where, first=level[0], last=level[-1], total=level.size
            )
        unit = "" if surface is None else str(surface.attrs.get("units", surface.name)).lower()
        metre = STANDARD_GRAVITY if unit == "z" or _PER_SECOND.search(unit) else 1.0
        field = ModelField(
            name=where, time_ns=part.time_ns, lead_h=part.lead_h, level=level,
            latitude_rad=part.latitude_rad, longitude_rad=part.longitude_rad,
            temperature_k=part.values(t, level), humidity=part.values(humidity, level),
            height=np.empty(0) if height is None else part.values(height, level),
            surface=np.empty(0) if surface is None else part.values(surface, fixed=True) / metre,
            log_surface_pa=part.values(log_surface) if of_model else np.empty(0),
            relative=specific is None, on_model_levels=of_model, ground_has_unit=unit != "z",
        )  # fmt: skip
    return ledger.take(model_field.checked_field(field, where))


@dataclass(frozen=True, eq=False)
class _Part:
    """The part of each field that is read, nodes and times about the flight and one member:
    ``chosen`` rows by dimension, and the ``labels`` of these dimensions in the file."""

    time_ns: Integers
    lead_h: Array
    latitude_rad: Array
    longitude_rad: Array
    chosen: dict[str, Any]
    labels: dict[str, Any]
    where: str

    @classmethod
    def of(cls, field: Any, area: FlightArea, where: str, member: int | None) -> "_Part":
        """By the nodes of the temperature."""
        chosen: dict[str, Any] = {}
        name = next((n for n in field.coords if str(n).lower() in _MEMBERS), None)
        if name is not None and (member is not None or name in field.dims):
            members = np.atleast_1d(field[name].values).tolist()
            if member not in members:
                low, high = min(members), max(members)
                if member is None:
                    raise messages.model_member_unnamed(where=where, low=low, high=high)
                raise messages.model_member_unknown(where=where, low=low, high=high, member=member)
            if name in field.dims:
                chosen[name] = members.index(member)
        elif member is not None:
            raise messages.model_no_members(where=where, member=member)
        dim, time_ns, lead_h = times_of(field, where)
        order = np.argsort(time_ns)
        first, last = (int(t) for t in (area.time_ns.min(), area.time_ns.max()))
        low = max(int(np.searchsorted(time_ns[order], first, side="right")) - 1, 0)
        high = min(int(np.searchsorted(time_ns[order], last)), time_ns.size - 1)
        times = order[low : high + 1]
        if dim is not None:
            chosen[dim] = times
        away = np.abs(time_ns[order] - np.unique(area.time_ns)[:, None]).min(axis=1)
        hours = float(away.max()) / 3.6e12
        if hours > FARTHEST_H:
            begin, end = _minutes(time_ns[order[[0, -1]]])
            raise messages.model_time(where=where, begin=begin, end=end, hours=hours)
        nodes = []
        middle = float(np.median(area.longitude_rad))
        places = (area.latitude_rad, longitudes_near(area.longitude_rad, middle))
        for names, place in zip((_LATITUDE, _LONGITUDE), places, strict=True):
            axis = str(_dimension(field, names))  # a grid without it was refused
            degrees = np.asarray(field[axis].values, np.float64)
            _refuse_other_places(degrees, axis, where)
            node = degrees * DEGREE
            if names is _LONGITUDE:
                node = longitudes_near(node, middle)
            node, rows = np.unique(np.round(node, 12), return_index=True)
            low = max(int(np.searchsorted(node, place.min(), side="right")) - 2, 0)
            high = int(np.searchsorted(node, place.max())) + 2
            chosen[axis] = rows[low:high]
            nodes.append(node[low:high])
        levels = _levels(field)
        known = {*chosen, _dimension(field, _VERSIONS), levels and levels.name}
        unknown = [
            f"{d} ({size})" for d, size in field.sizes.items() if size > 1 and d not in known
        ]
        if unknown:
            raise messages.model_dimension_unknown(where=where, dimensions=", ".join(unknown))
        labels = {name: field[name].values for name in chosen}
        return cls(time_ns[times], lead_h[times], nodes[0], nodes[1], chosen, labels, where)

    def values(self, field: Any, level: Array | None = None, *, fixed: bool = False) -> Array:
        """A field as (t, l, y, x), NaN where it has no value; of the surface l is 1. Refuses other
        times, but of what is ``fixed``, as the ground."""
        levels = _levels(field)
        version, axes = _dimension(field, _VERSIONS), list(self.chosen)[-2:]
        time = next((d for d in self.chosen if d not in axes and d in field.dims
                     and np.ndim(self.chosen[d])), None)  # fmt: skip
        order = [d for d in (version, time, None if levels is None else levels.name, *axes) if d]
        others = [d for d in self.chosen if d in field.dims and not (
            np.array_equal(field[d].values, self.labels[d]))]  # fmt: skip
        taken = field.isel({d: rows for d, rows in self.chosen.items() if d in field.dims})
        others += [d for d in taken.dims if d not in order and taken.sizes[d] > 1]
        others += [d for d in axes if d not in field.dims]
        if time is None and not fixed:
            has_time = any(name in field.coords for name in _TIMES)
            if not has_time or not np.array_equal(self.time_ns, times_of(field, self.where)[1]):
                others.append("time")
        if others:
            apart = ", ".join(others)
            raise messages.model_variable_elsewhere(where=self.where, name=field.name, apart=apart)
        single = {d: 0 for d in taken.dims if d not in order}
        values = np.asarray(taken.isel(single, drop=True).transpose(*order).values, np.float64)
        values = measured(values)  # fill values that the file does not state, and infinite ones
        if version is not None:  # ERA5 and its preliminary months: each where the other is not
            values = reduce(lambda a, b: np.where(np.isnan(a), b, a), values)
        if time is None:
            values = np.broadcast_to(values, (self.time_ns.size, *values.shape))
        if levels is None or level is None:
            return values.reshape(values.shape[0], -1, *values.shape[-2:])
        # On other levels than the temperature a field has no value.
        whole = np.full((values.shape[0], level.size, *values.shape[2:]), np.nan)
        _, rows, from_rows = np.intersect1d(level, levels.values, return_indices=True)
        whole[:, rows] = values[:, from_rows]
        return whole
