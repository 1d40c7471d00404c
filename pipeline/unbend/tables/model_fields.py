"""The fields of a weather model around a flight, of which only that part is read."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from unbend.atmosphere.soundings import model_field
from unbend.atmosphere.soundings.level_checks import FEWEST_LEVELS
from unbend.atmosphere.soundings.model_field import ModelField
from unbend.atmosphere.soundings.model_levels import MODEL_LEVELS
from unbend.geodesy import longitudes_near
from unbend.messages import Ledger
from unbend.tables import messages
from unbend.tables.weather_fields import (
    LAT_LON_GRID,
    LATITUDE,
    LONGITUDE,
    MEMBERS,
    TIMES,
    VERSIONS,
    FieldLevels,
    FieldTimes,
    dimension_of,
    find_field,
    grid_name,
    levels_of,
    minutes_of,
    times_of,
)
from unbend.tables.weather_files import open_datasets
from unbend.units import DEGREE, STANDARD_GRAVITY, Array, Integers, measured

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

FARTHEST_LONGITUDE_DEG = 540.0  # grids count from -180 or from 0, and some once around again
LARGEST_LEVEL = 1e8  # a pressure [Pa] with the unit of hectopascals twice
FARTHEST_H = 6.0  # farther from every time of the file a flight is refused [h]

_PER_SECOND = re.compile(r"s\s*(?:\*\*|\^)?\s*-\s*2|/\s*s")
_NANOSECONDS_PER_HOUR = 3.6e12
_NODE_DIGITS = 12  # of nodes [rad]: some grids have their first longitude again at their end


@dataclass(frozen=True, eq=False)
class FlightArea:
    """Places (n,) [rad] and times (n,) [Unix ns] that columns are taken at."""

    latitude_rad: Array
    longitude_rad: Array
    time_ns: Integers


def read_model_field(
    path: Path,
    area: FlightArea,
    ledger: Ledger,
    *,
    member: int | None = None,
) -> ModelField:
    """The fields of a weather model around a flight; only that part of the file is read.

    ``member`` of an ensemble. Refuses (`InputError`) files of another kind or damaged, projected
    grids, missing fields, an ensemble without a member, levels that make no column, another time
    and wrong units, each with a code of its own (MODEL-...).
    """
    where = path.name
    with open_datasets(path) as (datasets, _):
        fields = _fields_of(datasets, where)
        part = _part_of(fields.temperature, area, where, member)
        level = np.sort(fields.levels.values)
        if fields.levels.of_model:
            _refuse_missing_levels(level, where)
        temperature_k = part.values(fields.temperature, level)
        humidity = part.values(fields.humidity, level)
        nothing = np.empty(0)
        height = nothing
        if fields.height is not None:
            height = part.values(fields.height, level)
        surface = nothing
        if fields.surface is not None:
            surface = part.values(fields.surface, fixed=True) / fields.metre_of_surface
        log_surface_pa = nothing
        if fields.log_surface is not None:
            log_surface_pa = part.values(fields.log_surface)
        field = ModelField(
            name=where,
            time_ns=part.time_ns,
            lead_h=part.lead_h,
            level=level,
            latitude_rad=part.latitude_rad,
            longitude_rad=part.longitude_rad,
            temperature_k=temperature_k,
            humidity=humidity,
            height=height,
            surface=surface,
            log_surface_pa=log_surface_pa,
            relative=fields.is_relative,
            on_model_levels=fields.levels.of_model,
            ground_has_unit=fields.unit_of_surface != "z",
        )
    return ledger.take(model_field.checked_field(field, where))


@dataclass(frozen=True, eq=False)
class _Fields:
    """The fields that are read; those that a model on such levels has not, or needs not, are None.

    Humidity is specific, or relative (``is_relative``).
    """

    temperature: "DataArray"
    levels: FieldLevels
    humidity: "DataArray"
    is_relative: bool
    height: "DataArray | None"
    surface: "DataArray | None"
    log_surface: "DataArray | None"

    @property
    def unit_of_surface(self) -> str:
        """The unit of the ground's geopotential, or the name of a field without one."""
        if self.surface is None:
            return ""
        return str(self.surface.attrs.get("units", self.surface.name)).lower()

    @property
    def metre_of_surface(self) -> float:
        """What a geopotential metre is in that unit."""
        unit = self.unit_of_surface
        if unit == "z" or _PER_SECOND.search(unit):
            return STANDARD_GRAVITY
        return 1.0


def _fields_of(datasets: "Sequence[Dataset]", where: str) -> _Fields:
    """The fields of a file; refuses other grids and levels, and a file that lacks one."""
    temperature = find_field(datasets, "temperature")
    levels = _levels_of_temperature(datasets, temperature, where)
    specific = find_field(datasets, "specific humidity")
    is_relative = specific is None
    humidity = find_field(datasets, "relative humidity") if is_relative else specific
    surface = find_field(datasets, "surface geopotential")
    if levels is not None and levels.of_model:
        height = None
        log_surface = find_field(datasets, "log surface pressure")
        needed = {"geopotential on levels": surface, "lnsp (at level 1)": log_surface}
    else:
        height = find_field(datasets, "geopotential")
        log_surface = None
        needed = {"geopotential on levels": height, "lnsp (at level 1)": temperature}
    lacking = [name for name, field in needed.items() if field is None]
    if humidity is None:
        lacking.insert(0, "specific or relative humidity on levels")
    if temperature is None:
        lacking.insert(0, "temperature on levels")
    if lacking or temperature is None or levels is None or humidity is None:
        raise messages.model_variable_missing(
            where=where,
            lacking=", no ".join(lacking),
            held=_names_in(datasets),
        )
    return _Fields(
        temperature=temperature,
        levels=levels,
        humidity=humidity,
        is_relative=is_relative,
        height=height,
        surface=surface,
        log_surface=log_surface,
    )


def _levels_of_temperature(
    datasets: "Sequence[Dataset]",
    temperature: "DataArray | None",
    where: str,
) -> FieldLevels | None:
    """The levels of a model; refuses another grid, and other levels than make a column."""
    if temperature is None:
        return None
    grid = grid_name(datasets, temperature)
    if grid != LAT_LON_GRID:
        raise messages.model_grid(where=where, grid=grid)
    levels = levels_of(temperature)
    if levels is not None:
        _refuse_other_levels(levels, where)
    return levels


def _names_in(datasets: "Sequence[Dataset]") -> str:
    """The names of all fields of a file."""
    names = {str(name) for dataset in datasets for name in dataset.data_vars}
    return ", ".join(sorted(names)) or "nothing"


def _refuse_other_levels(levels: FieldLevels, where: str) -> None:
    """Refuse too few pressures, and levels that are neither pressures nor numbers, or repeated."""
    values = levels.values
    if values.size < FEWEST_LEVELS and not levels.of_model:
        raise model_field.too_few_levels(values, where, "in all")
    is_possible = bool(((values > 0.0) & (values <= LARGEST_LEVEL)).all())
    if not is_possible or np.unique(values).size < values.size:
        raise messages.model_axis(where=where, axis=levels.name)


def _refuse_missing_levels(level: Array, where: str) -> None:
    """Refuse model levels (l,), in their order, that do not go down to the lowest."""
    whole = np.arange(level[0], MODEL_LEVELS + 1.0)
    if not np.array_equal(level, whole):
        raise messages.model_levels_incomplete(
            where=where,
            first=level[0],
            last=level[-1],
            total=level.size,
        )


Rows = dict[str, Integers | int]
"""What is read of each dimension: rows, or the one of a member."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The part of each field that is read, nodes and times about the flight and one member.

    ``axes`` are the dimensions of latitude and longitude, ``chosen`` the rows by dimension, and
    ``labels`` those of these dimensions in the file.
    """

    time_ns: Integers
    lead_h: Array
    latitude_rad: Array
    longitude_rad: Array
    axes: tuple[str, str]
    chosen: Rows
    labels: dict[str, Array]
    where: str

    def values(
        self,
        field: "DataArray",
        level: Array | None = None,
        *,
        fixed: bool = False,
    ) -> Array:
        """A field as (t, l, y, x), NaN where it has no value; of the surface l is 1.

        Refuses other times, but of what is ``fixed``, as the ground.
        """
        levels = levels_of(field)
        version = dimension_of(field, VERSIONS)
        time = self._time_dimension(field)
        name_of_levels = None if levels is None else levels.name
        dimensions = (version, time, name_of_levels, *self.axes)
        order = [name for name in dimensions if name]
        rows = {name: chosen for name, chosen in self.chosen.items() if name in field.dims}
        taken = field.isel(rows)
        self._refuse_elsewhere(field, taken, order, has_time=time is not None or fixed)
        single = {name: 0 for name in taken.dims if name not in order}
        ordered = taken.isel(single, drop=True).transpose(*order)
        values = np.asarray(ordered.values, np.float64)
        values = measured(values)  # fill values that the file does not state, and infinite ones
        if version is not None:  # ERA5 and its preliminary months: each where the other is not
            values = reduce(_filled, values)
        if time is None:
            values = np.broadcast_to(values, (self.time_ns.size, *values.shape))
        if levels is None or level is None:
            return values.reshape(values.shape[0], -1, *values.shape[-2:])
        return _on_levels(values, levels.values, level)

    def _time_dimension(self, field: "DataArray") -> str | None:
        """The dimension of a field that has the times, None if it has one time or none."""
        for name, rows in self.chosen.items():
            if name not in self.axes and name in field.dims and np.ndim(rows):
                return name
        return None

    def _refuse_elsewhere(
        self,
        field: "DataArray",
        taken: "DataArray",
        order: Sequence[str],
        *,
        has_time: bool,
    ) -> None:
        """Refuse a field of other nodes, members or times than the temperature.

        ``taken`` is the part that is read, ``order`` its dimensions.
        """
        apart = []
        for name in self.chosen:
            if name in field.dims and not np.array_equal(field[name].values, self.labels[name]):
                apart.append(name)
        apart += [name for name in taken.dims if name not in order and taken.sizes[name] > 1]
        apart += [name for name in self.axes if name not in field.dims]
        if not has_time and not self._has_same_times(field):
            apart.append("time")
        if apart:
            raise messages.model_variable_elsewhere(
                where=self.where,
                name=field.name,
                apart=", ".join(apart),
            )

    def _has_same_times(self, field: "DataArray") -> bool:
        """Whether a field without a dimension of time is of the times that are read."""
        if not any(name in field.coords for name in TIMES):
            return False
        return np.array_equal(self.time_ns, times_of(field, self.where).time_ns)


def _on_levels(values: Array, levels: Array, wanted: Array) -> Array:
    """Values (t, l, y, x) on other levels than those (l,) of a field, NaN where it has none."""
    times, _, *nodes = values.shape
    on_levels = np.full((times, wanted.size, *nodes), np.nan)
    _, to_rows, from_rows = np.intersect1d(wanted, levels, return_indices=True)
    on_levels[:, to_rows] = values[:, from_rows]
    return on_levels


def _filled(values: Array, others: Array) -> Array:
    """Values, and others where these are unknown."""
    return np.where(np.isnan(values), others, values)


def _part_of(
    field: "DataArray",
    area: FlightArea,
    where: str,
    member: int | None,
) -> _Part:
    """What is read around a flight, by the nodes of the temperature."""
    chosen: Rows = _chosen_member(field, member, where)
    times = times_of(field, where)
    time_rows = _rows_about(times, area, where)
    if times.dimension is not None:
        chosen[times.dimension] = time_rows
    middle = float(np.median(area.longitude_rad))
    longitude_rad = longitudes_near(area.longitude_rad, middle)
    latitude = _axis_of(field, LATITUDE, where)
    longitude = _axis_of(field, LONGITUDE, where)
    latitudes = latitude.about(area.latitude_rad)
    longitudes = longitude.near(middle).about(longitude_rad)
    chosen[latitudes.name] = latitudes.rows
    chosen[longitudes.name] = longitudes.rows
    _refuse_other_dimensions(field, chosen, where)
    return _Part(
        time_ns=times.time_ns[time_rows],
        lead_h=times.lead_h[time_rows],
        latitude_rad=latitudes.node_rad,
        longitude_rad=longitudes.node_rad,
        axes=(latitudes.name, longitudes.name),
        chosen=chosen,
        labels={name: field[name].values for name in chosen},
        where=where,
    )


def _chosen_member(field: "DataArray", member: int | None, where: str) -> Rows:
    """The row of a member of an ensemble; refuses one that is not there, and an ensemble without.

    Empty where the file is no ensemble, or has one member alone.
    """
    names = [name for name in field.coords if str(name).lower() in MEMBERS]
    if not names:
        if member is not None:
            raise messages.model_no_members(where=where, member=member)
        return {}
    name = names[0]
    is_dimension = name in field.dims
    if member is None and not is_dimension:
        return {}
    members = np.atleast_1d(field[name].values).tolist()
    if member not in members:
        low = min(members)
        high = max(members)
        if member is None:
            raise messages.model_member_unnamed(where=where, low=low, high=high)
        raise messages.model_member_unknown(where=where, low=low, high=high, member=member)
    return {name: members.index(member)} if is_dimension else {}


def _rows_about(times: FieldTimes, area: FlightArea, where: str) -> Integers:
    """The rows of the times before, during and after a flight; refuses those of other hours."""
    order = np.argsort(times.time_ns)
    time_ns = times.time_ns[order]
    first_ns = int(area.time_ns.min())
    last_ns = int(area.time_ns.max())
    low = max(int(np.searchsorted(time_ns, first_ns, side="right")) - 1, 0)
    high = min(int(np.searchsorted(time_ns, last_ns)), time_ns.size - 1)
    away_ns = np.abs(time_ns - np.unique(area.time_ns)[:, None]).min(axis=1)
    hours = float(away_ns.max()) / _NANOSECONDS_PER_HOUR
    if hours > FARTHEST_H:
        begin, end = minutes_of(time_ns[[0, -1]])
        raise messages.model_time(where=where, begin=begin, end=end, hours=hours)
    return order[low : high + 1]


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Nodes (k,) [rad] of an axis in increasing order, and their rows in the file."""

    name: str
    node_rad: Array
    rows: Integers


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis of a grid: its dimension, and its nodes [rad] in the order of the file."""

    name: str
    node_rad: Array

    def near(self, middle_rad: float) -> "_Axis":
        """Longitudes within half a turn of one."""
        return _Axis(self.name, longitudes_near(self.node_rad, middle_rad))

    def about(self, place_rad: Array) -> _Nodes:
        """The nodes about some places (n,), with one more on either side."""
        node_rad, rows = np.unique(
            np.round(self.node_rad, _NODE_DIGITS),
            return_index=True,
        )
        low = max(int(np.searchsorted(node_rad, place_rad.min(), side="right")) - 2, 0)
        high = int(np.searchsorted(node_rad, place_rad.max())) + 2
        return _Nodes(self.name, node_rad[low:high], rows[low:high])


def _axis_of(
    field: "DataArray",
    names: Sequence[str],
    where: str,
) -> _Axis:
    """An axis of a field; refuses nodes that are no places on earth."""
    name = str(dimension_of(field, names))  # a grid without it was refused
    degrees = np.asarray(field[name].values, np.float64)
    farthest_deg = FARTHEST_LONGITUDE_DEG if names is LONGITUDE else 90.0
    if not bool((np.abs(degrees) <= farthest_deg).all()):
        raise messages.model_axis(where=where, axis=name)
    return _Axis(name, degrees * DEGREE)


def _refuse_other_dimensions(field: "DataArray", chosen: Rows, where: str) -> None:
    """Refuse a field with a dimension of several rows of which none was chosen."""
    levels = levels_of(field)
    understood = {*chosen, dimension_of(field, VERSIONS)}
    if levels is not None:
        understood.add(levels.name)
    dimensions = []
    for name, size in field.sizes.items():
        if size > 1 and name not in understood:
            dimensions.append(f"{name} ({size})")
    if dimensions:
        raise messages.model_dimension_unknown(where=where, dimensions=", ".join(dimensions))
