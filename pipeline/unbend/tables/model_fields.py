"""The fields of a weather model around a flight; the other parts of the file are not read."""

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

FARTHEST_LONGITUDE_DEG = 540.0  # grids count from -180 or 0, some on for another full turn
LARGEST_LEVEL = 1e8  # Pa: even a surface pressure that was converted from hPa twice is less
FARTHEST_H = 6.0  # h between a time of the flight and the nearest time of the file

_PER_SECOND_SQUARED = re.compile(r"s\s*(?:\*\*|\^)?\s*-\s*2|/\s*s")  # m**2 s**-2, m^2/s^2
_NANOSECONDS_PER_HOUR = 3.6e12
_NODE_DIGITS = 12  # of nodes [rad] that are equal: some grids repeat their first longitude


@dataclass(frozen=True, eq=False)
class FlightArea:
    """Places (n,) [rad] and times (n,) [Unix ns] of the flight that needs columns of air."""

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
    """Read the fields of a weather model at the nodes, levels and times around a flight.

    ``member`` is the number of an ensemble's member, None for a file without members. Refuses
    (`InputError`, with codes MODEL-...) files of another kind or damaged, projected grids, missing
    fields, an ensemble without a member, levels that do not form a column, times far from the
    flight, and wrong units.
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
        not_in_file = np.empty(0)
        height = not_in_file
        if fields.height is not None:
            height = part.values(fields.height, level)
        surface = not_in_file
        if fields.surface is not None:
            values = part.values(fields.surface, is_constant=True)
            surface = values / fields.surface_units_per_metre
        log_surface_pa = not_in_file
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
    """The fields of a file that are read.

    ``humidity`` is relative if ``is_relative``, else specific. ``height`` is the geopotential on
    pressure levels; ``log_surface``, the logarithm of the surface pressure, belongs to model
    levels: one of the two is None. ``surface`` is the geopotential of the ground, None if absent.
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
        """The unit of ``surface``, in lower case.

        The name of the field if it states no unit, and "" without the field.
        """
        if self.surface is None:
            return ""
        return str(self.surface.attrs.get("units", self.surface.name)).lower()

    @property
    def surface_units_per_metre(self) -> float:
        """How many units of ``surface`` a geopotential metre is: 9.80665 if they are m2 s-2."""
        unit = self.unit_of_surface
        if unit == "z" or _PER_SECOND_SQUARED.search(unit):
            return STANDARD_GRAVITY
        return 1.0


def _fields_of(datasets: "Sequence[Dataset]", where: str) -> _Fields:
    """Find the fields that are needed; refuses a file that lacks one, and unusable grids or levels.

    ``where`` is the name of the file, for the messages.
    """
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
        # Only where the temperature is missing, the kind of levels is not known: both are named.
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
    """The levels of the temperature, None without a temperature on levels.

    Refuses grids that are not latitude-longitude, and levels that do not form a column.
    """
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
    """The names of all fields of a file, sorted, with commas; "nothing" without any."""
    names = {str(name) for dataset in datasets for name in dataset.data_vars}
    return ", ".join(sorted(names)) or "nothing"


def _refuse_other_levels(levels: FieldLevels, where: str) -> None:
    """Refuse too few pressure levels, repeated levels, and values that cannot be levels."""
    values = levels.values
    if values.size < FEWEST_LEVELS and not levels.of_model:
        raise model_field.too_few_levels(values, where, "in all")
    is_possible = bool(((values > 0.0) & (values <= LARGEST_LEVEL)).all())
    if not is_possible or np.unique(values).size < values.size:
        raise messages.model_axis(where=where, axis=levels.name)


def _refuse_missing_levels(level: Array, where: str) -> None:
    """Refuse model levels (l,), in increasing order, with gaps or without the lowest, 137."""
    without_gaps = np.arange(level[0], MODEL_LEVELS + 1.0)
    if not np.array_equal(level, without_gaps):
        raise messages.model_levels_incomplete(
            where=where,
            first=level[0],
            last=level[-1],
            total=level.size,
        )


IndexOfDimension = dict[str, Integers | int]
"""Name of a dimension -> the indices along it that are read, or one index of a member."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The part of each field that is read: nodes and times around the flight, and one member.

    ``time_ns`` (t,) [Unix ns], ``lead_h`` (t,), ``latitude_rad`` (y,) and ``longitude_rad`` (x,)
    are those of the part. ``axes`` are the names of the dimensions of latitude and longitude.
    ``index`` are the indices that are read, and ``labels`` all coordinates of these dimensions in
    the file, which every field must share with the temperature.
    """

    time_ns: Integers
    lead_h: Array
    latitude_rad: Array
    longitude_rad: Array
    axes: tuple[str, str]
    index: IndexOfDimension
    labels: dict[str, Array]
    where: str

    def values(
        self,
        field: "DataArray",
        level: Array | None = None,
        *,
        is_constant: bool = False,
    ) -> Array:
        """The part of a field as (t, l, y, x), NaN where it has no value.

        ``level`` (l,) are the levels to return; without them l is 1, for a field at the surface.
        Refuses a field of other nodes or times than the temperature. A field without times is
        repeated for each time if ``is_constant``, as the height of the ground is; else its one
        time must be that of the temperature.
        """
        levels = levels_of(field)
        version = dimension_of(field, VERSIONS)
        time = self._time_dimension(field)
        name_of_levels = None if levels is None else levels.name
        dimensions = (version, time, name_of_levels, *self.axes)
        order = [name for name in dimensions if name]
        index = {name: rows for name, rows in self.index.items() if name in field.dims}
        part = field.isel(index)
        self._refuse_elsewhere(field, part, order, is_time_right=time is not None or is_constant)
        single = {name: 0 for name in part.dims if name not in order}  # dimensions of length 1
        ordered = part.isel(single, drop=True).transpose(*order)
        values = np.asarray(ordered.values, np.float64)
        values = measured(values)  # NaN for fill values that the file does not state, and infinity
        if version is not None:  # ERA5, and its preliminary months where the final ones are NaN
            values = reduce(_filled, values)
        if time is None:
            values = np.broadcast_to(values, (self.time_ns.size, *values.shape))
        if levels is None or level is None:
            return values.reshape(values.shape[0], -1, *values.shape[-2:])
        return _on_levels(values, levels.values, level)

    def _time_dimension(self, field: "DataArray") -> str | None:
        """The dimension of times of a field, None if it has none.

        In ``index`` it is the dimension with several indices that is not an axis: a member has one
        index, which is not an array.
        """
        for name, rows in self.index.items():
            if name not in self.axes and name in field.dims and np.ndim(rows):
                return name
        return None

    def _refuse_elsewhere(
        self,
        field: "DataArray",
        part: "DataArray",
        order: Sequence[str],
        *,
        is_time_right: bool,
    ) -> None:
        """Refuse a field of other nodes, members or times than the temperature.

        ``part`` is the part of ``field`` that is read, ``order`` the dimensions it may have.
        ``is_time_right``: whether the times need no check beyond that of the dimensions.
        """
        different = []
        for name in self.index:
            if name in field.dims and not np.array_equal(field[name].values, self.labels[name]):
                different.append(name)
        different += [name for name in part.dims if name not in order and part.sizes[name] > 1]
        different += [name for name in self.axes if name not in field.dims]
        if not is_time_right and not self._has_same_times(field):
            different.append("time")
        if different:
            raise messages.model_variable_elsewhere(
                where=self.where,
                name=field.name,
                apart=", ".join(different),
            )

    def _has_same_times(self, field: "DataArray") -> bool:
        """Whether the time of a field without a dimension of times is that of the part."""
        if not any(name in field.coords for name in TIMES):
            return False
        return np.array_equal(self.time_ns, times_of(field, self.where).time_ns)


def _on_levels(values: Array, levels: Array, wanted: Array) -> Array:
    """Values (t, k, y, x) on ``levels`` (k,) as (t, l, y, x) on ``wanted`` (l,).

    Nothing is interpolated: a wanted level that is not among ``levels`` is NaN.
    """
    times, _, *nodes = values.shape
    on_wanted = np.full((times, wanted.size, *nodes), np.nan)
    _, to_rows, from_rows = np.intersect1d(wanted, levels, return_indices=True)
    on_wanted[:, to_rows] = values[:, from_rows]
    return on_wanted


def _filled(values: Array, substitutes: Array) -> Array:
    """The values, with ``substitutes`` of the same shape in the place of NaN."""
    return np.where(np.isnan(values), substitutes, values)


def _part_of(
    field: "DataArray",
    area: FlightArea,
    where: str,
    member: int | None,
) -> _Part:
    """The part of all fields around a flight; ``field`` is the temperature."""
    index: IndexOfDimension = _index_of_member(field, member, where)
    times = times_of(field, where)
    time_rows = _times_around(times, area, where)
    if times.dimension is not None:
        index[times.dimension] = time_rows
    middle_rad = float(np.median(area.longitude_rad))
    longitude_rad = longitudes_near(area.longitude_rad, middle_rad)
    latitude_axis = _axis_of(field, LATITUDE, where)
    longitude_axis = _axis_of(field, LONGITUDE, where)
    latitudes = latitude_axis.nodes_around(area.latitude_rad)
    longitudes = longitude_axis.longitudes_near(middle_rad).nodes_around(longitude_rad)
    index[latitudes.name] = latitudes.rows
    index[longitudes.name] = longitudes.rows
    _refuse_other_dimensions(field, index, where)
    return _Part(
        time_ns=times.time_ns[time_rows],
        lead_h=times.lead_h[time_rows],
        latitude_rad=latitudes.node_rad,
        longitude_rad=longitudes.node_rad,
        axes=(latitudes.name, longitudes.name),
        index=index,
        labels={name: field[name].values for name in index},
        where=where,
    )


def _index_of_member(field: "DataArray", member: int | None, where: str) -> IndexOfDimension:
    """The dimension of members and the index of the chosen one; empty without this dimension.

    ``member`` is the number that the mission names, or None. Refuses a number that the file does
    not contain, and an ensemble if no member is named.
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


def _times_around(times: FieldTimes, area: FlightArea, where: str) -> Integers:
    """Indices of the times from the last before a flight to the first after it, in their order.

    Refuses times if a part of the flight is more than `FARTHEST_H` away from each of them.
    """
    order = np.argsort(times.time_ns)
    time_ns = times.time_ns[order]
    begin_ns = int(area.time_ns.min())
    end_ns = int(area.time_ns.max())
    last_before = max(int(np.searchsorted(time_ns, begin_ns, side="right")) - 1, 0)
    first_after = min(int(np.searchsorted(time_ns, end_ns)), time_ns.size - 1)
    away_ns = np.abs(time_ns - np.unique(area.time_ns)[:, None]).min(axis=1)
    hours = float(away_ns.max()) / _NANOSECONDS_PER_HOUR
    if hours > FARTHEST_H:
        begin, end = minutes_of(time_ns[[0, -1]])
        raise messages.model_time(where=where, begin=begin, end=end, hours=hours)
    return order[last_before : first_after + 1]


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Nodes (k,) [rad] of the axis ``name`` in increasing order, and their indices in the file."""

    name: str
    node_rad: Array
    rows: Integers


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis of a grid: the name of its dimension, and nodes [rad] in the order of the file."""

    name: str
    node_rad: Array

    def longitudes_near(self, middle_rad: float) -> "_Axis":
        """The axis with its longitudes shifted by full turns to within half a turn of a middle."""
        return _Axis(self.name, longitudes_near(self.node_rad, middle_rad))

    def nodes_around(self, place_rad: Array) -> _Nodes:
        """The nodes that enclose places (n,) [rad], and one more on either side if there is one."""
        node_rad, rows = np.unique(
            np.round(self.node_rad, _NODE_DIGITS),
            return_index=True,
        )
        # With -1 the first node is that below the places, with +1 the last is that above them.
        low = max(int(np.searchsorted(node_rad, place_rad.min(), side="right")) - 2, 0)
        high = int(np.searchsorted(node_rad, place_rad.max())) + 2
        return _Nodes(self.name, node_rad[low:high], rows[low:high])


def _axis_of(
    field: "DataArray",
    names: Sequence[str],
    where: str,
) -> _Axis:
    """The axis of a field by one of its ``names``, LATITUDE or LONGITUDE.

    Refuses nodes beyond 90 degrees of latitude or `FARTHEST_LONGITUDE_DEG`.
    """
    name = str(dimension_of(field, names))  # a grid without it was refused
    degrees = np.asarray(field[name].values, np.float64)
    farthest_deg = FARTHEST_LONGITUDE_DEG if names is LONGITUDE else 90.0
    if not bool((np.abs(degrees) <= farthest_deg).all()):
        raise messages.model_axis(where=where, axis=name)
    return _Axis(name, degrees * DEGREE)


def _refuse_other_dimensions(field: "DataArray", index: IndexOfDimension, where: str) -> None:
    """Refuse a field with another long dimension than levels, versions and those of ``index``."""
    levels = levels_of(field)
    understood = {*index, dimension_of(field, VERSIONS)}
    if levels is not None:
        understood.add(levels.name)
    unknown = []
    for name, size in field.sizes.items():
        if size > 1 and name not in understood:
            unknown.append(f"{name} ({size})")
    if unknown:
        raise messages.model_dimension_unknown(where=where, dimensions=", ".join(unknown))
