"""Fields of a weather model in xarray's datasets: their quantities, levels, times and grid."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unbend.tables import messages
from unbend.units import HECTOPASCAL, Array, Integers

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

# Names of dimensions and coordinates, in lower case.
LATITUDE = ("latitude", "lat")
LONGITUDE = ("longitude", "lon")
MEMBERS = ("number", "member", "realization", "ensemble")
VERSIONS = ("expver",)  # ERA5: final data, and preliminary data of the last months
TIMES = ("valid_time", "time")
LAT_LON_GRID = "latitude-longitude"
QUANTITIES = {
    "temperature": {"t", "ta", "tmp", "temperature", "air_temperature"},
    "specific humidity": {"q", "hus", "spfh", "specific_humidity"},
    "relative humidity": {"r", "rh", "hur", "relative_humidity"},
    "geopotential": {"z", "gh", "zg", "hgt", "geopotential", "geopotential_height"},
    "surface geopotential": {"z", "orog", "surface_geopotential"},
    "log surface pressure": {"lnsp"},
}
"""Quantity -> names of its field, in netCDF, CF or GRIB."""

_RUN_TIMES = ("forecast_reference_time", "reftime")
_MODEL_LEVELS = ("hybrid", "model_level")
_WORDS_OF_MODEL_LEVELS = re.compile("model|hybrid|sigma")
_LEVELS = ("level", "pressure_level", "plev", "lev", *_MODEL_LEVELS)
_LEVEL = re.compile(rf"isobaric|({'|'.join(_LEVELS)})$")
_HECTOPASCALS = ("hpa", "millibars", "millibar", "mbar", "mb")
_MOST_HECTOPASCALS = 2000.0  # levels without a unit and larger numbers are in pascals
_LAT_LON_NAMES = (None, "regular_ll", "regular_gg", "latitude_longitude")  # of grids; None: unnamed

# Reanalyses reach back to 1806 at most, and nanoseconds since 1970 end in 2262.
EARLIEST_TIME = np.datetime64("1800-01-01")
LATEST_TIME = np.datetime64("2200-01-01")
LONGEST_LEAD = np.timedelta64(3650, "D")  # of a forecast: those of seasons take months
_HOUR = np.timedelta64(1, "h")


def dimension_of(field: "DataArray", names: Sequence[str]) -> str | None:
    """The dimension of a field with one of the ``names`` (in lower case), or None."""
    for dimension in field.dims:
        if str(dimension).lower() in names:
            return str(dimension)
    return None


@dataclass(frozen=True, eq=False)
class FieldLevels:
    """The levels of a field: the name of their dimension, and their values (l,).

    The values are numbers of model levels if ``of_model``, else pressures [Pa].
    """

    name: str
    values: Array
    of_model: bool


def levels_of(field: "DataArray") -> FieldLevels | None:
    """The levels of a field, None without a dimension of levels; pressures become pascals."""
    dimensions = [str(name) for name in field.dims if _LEVEL.match(str(name).lower())]
    if not dimensions or dimensions[0] not in field.coords:
        return None
    name = dimensions[0]
    attributes = {key: str(text).lower() for key, text in field[name].attrs.items()}
    values = np.asarray(field[name].values, np.float64)
    words = attributes.get("long_name", "") + attributes.get("standard_name", "")
    of_model = name.lower() in _MODEL_LEVELS or bool(_WORDS_OF_MODEL_LEVELS.search(words))
    usual_unit = "hpa" if values.max() < _MOST_HECTOPASCALS else "pa"
    unit = attributes.get("units", usual_unit)
    if not of_model and unit in _HECTOPASCALS:
        values = values * HECTOPASCAL
    return FieldLevels(name, values, of_model)


def find_field(datasets: "Sequence[Dataset]", quantity: str) -> "DataArray | None":
    """The field of one of `QUANTITIES`: on levels, or at the surface if its name contains that.

    None without such a field. Of several fields on levels it is the one with the most levels: in
    GRIB files, the levels above 1 hPa are a separate field.
    """
    with_most_levels: DataArray | None = None
    most_levels = 0
    for field in _fields_called(datasets, QUANTITIES[quantity]):
        levels = levels_of(field)
        if "surface" in quantity:
            surface_field = _at_surface(field, levels)
            if surface_field is not None:
                return surface_field
        elif levels is not None and levels.values.size > most_levels:
            with_most_levels = field
            most_levels = levels.values.size
    return with_most_levels


def _fields_called(
    datasets: "Sequence[Dataset]",
    names: set[str],
) -> "Iterator[DataArray]":
    """The fields that have one of the ``names``."""
    for dataset in datasets:
        for name, field in dataset.data_vars.items():
            if _names_of(field, str(name)) & names:
                yield field


def _at_surface(field: "DataArray", levels: FieldLevels | None) -> "DataArray | None":
    """A field at the surface, without a dimension of levels; None if it is on pressure levels.

    On model levels it is the first one: ECMWF stores lnsp and z of the surface there.
    """
    if levels is None:
        return field if _kind_of_level(field) in ("surface", "hybrid") else None
    if levels.of_model:
        first = int(np.argmin(levels.values))
        return field.isel({levels.name: first}, drop=True)
    return None


def _names_of(field: "DataArray", name: str) -> set[str | None]:
    """All names of a field: its name in the dataset, and those in its attributes, or None.

    The kind of level is cut off: "t_isobaric" becomes "t".
    """
    short_name = name.lower().split("_isobaric")[0]
    return {
        short_name,
        field.attrs.get("standard_name"),
        field.attrs.get("GRIB_shortName"),
    }


def _kind_of_level(field: "DataArray") -> str:
    """GRIB's name for the level of a field with one level, for example "surface"."""
    has_level = any(str(name).lower() in _LEVELS for name in field.coords)
    return str(field.attrs.get("GRIB_typeOfLevel", "level" if has_level else "surface"))


@dataclass(frozen=True, eq=False)
class FieldTimes:
    """The dimension of time, the times (t,) [Unix ns], and hours (t,) since each run began.

    ``dimension`` is None for a field with a single time and no such dimension.
    """

    dimension: str | None
    time_ns: Integers
    lead_h: Array


def times_of(field: "DataArray", where: str) -> FieldTimes:
    """The times for which a field is valid, and how far each is a forecast.

    Refuses (MODEL-TIME) fields without a readable time, and impossible times.
    """
    dimension = _time_dimension(field, where)
    stamps = _stamps_of(field, dimension, where)
    lead_h = np.zeros(stamps.size)
    if "step" in field.coords and field["step"].dtype.kind == "m":
        step = possible_steps(np.atleast_1d(field["step"].values), where)
        lead_h = lead_h + step / _HOUR
        if "valid_time" not in field.coords:  # then the times are when the run began
            stamps = stamps + step
    for name in _RUN_TIMES:
        if name in field.coords:
            begin = possible_times(np.atleast_1d(field[name].values), where)
            lead_h = (stamps - begin) / _HOUR
    return FieldTimes(
        dimension,
        stamps.ravel().astype(np.int64),
        lead_h,
    )


def _time_dimension(field: "DataArray", where: str) -> str | None:
    """The dimension of times or forecast steps, None without one.

    Refuses a field with two such dimensions of several values, which is of several runs.
    """
    several = []
    for name in field.dims:
        is_time = name in field.coords and field[name].dtype.kind in "mM"
        if is_time and field.sizes[name] > 1:
            several.append(str(name))
    if len(several) > 1:
        runs = " and ".join(f"{field.sizes[name]} of {name}" for name in several)
        raise messages.model_several_runs(where=where, runs=runs)
    if several:
        return several[0]
    for name in TIMES:
        if name in field.dims:
            return name
    return None


def _stamps_of(
    field: "DataArray",
    dimension: str | None,
    where: str,
) -> NDArray[Any]:
    """The times (t,) along a dimension, or one time if that is None, as datetime64.

    Valid times are preferred; else they are when the run began. Refuses a field without times.
    """
    names = [name for name in ("valid_time", dimension, "time") if name in field.coords]
    stamps = np.atleast_1d(field[names[0]].values) if names else np.empty(0)
    count = 1 if dimension is None else field.sizes[dimension]
    if stamps.dtype.kind != "M" or stamps.size != count:
        raise messages.model_without_time(where=where)
    return possible_times(stamps, where)


def possible_times(stamps: NDArray[Any], where: str) -> NDArray[Any]:
    """Times of any unit in nanoseconds; refuses NaT and times before 1800 or after 2200.

    They are compared before the conversion, because numpy converts times beyond the range of
    nanoseconds to arbitrary other times.
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
    """Times since a run began, in nanoseconds; refuses more than ten years, and NaT."""
    longest = LONGEST_LEAD.astype(steps.dtype)
    is_step = (steps >= -longest) & (steps <= longest)
    if not bool(is_step.all()):
        raise messages.model_without_time(where=where)
    return steps.astype("timedelta64[ns]")


def minutes_of(time_ns: Integers) -> NDArray[np.datetime64]:
    """Times [Unix ns] as datetime64 in minutes, for texts."""
    return time_ns.astype("datetime64[ns]").astype("datetime64[m]")


def grid_name(datasets: "Sequence[Dataset]", field: "DataArray") -> str:
    """The grid of a field: `LAT_LON_GRID`, or the name that GRIB or CF give it."""
    grid_type = field.attrs.get("GRIB_gridType") or _grid_mapping(datasets)
    has_axes = dimension_of(field, LATITUDE) and dimension_of(field, LONGITUDE)
    if has_axes and grid_type in _LAT_LON_NAMES:
        return LAT_LON_GRID
    dimensions = ", ".join(map(str, field.dims))
    return grid_type or f"unnamed, with dimensions {dimensions}"


def _grid_mapping(datasets: "Sequence[Dataset]") -> str | None:
    """The name of the first grid mapping (CF) in the datasets, None without any."""
    for dataset in datasets:
        for variable in dataset.variables.values():
            name = variable.attrs.get("grid_mapping_name")
            if name:
                return str(name)
    return None
