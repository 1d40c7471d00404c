"""The air along a flight by a weather model: how the model's column changes from place to place.

A flight measures the air in its climb. Elsewhere, and at another time, the air is the measured
profile plus the model's column there minus the model's column where and when the climb was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from unbend.atmosphere import messages
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.series.ageing import SampleAges
from unbend.atmosphere.series.profile_series import (
    FINEST_CHANGE,
    PlaceInTime,
    ProfileSeries,
    TimedProfile,
)
from unbend.atmosphere.soundings.model_field import ModelColumns, ModelField
from unbend.messages import Notes
from unbend.units import VAPOUR_DEFICIT, Array, Integers, Rows

# In a flight that is shorter in both, all exposures have the air of one place and time.
LONG_KM = 30.0
LONG_H = 2.0

LEFT_BY_MODEL = 0.5
"""Share of a distance that counts where a model's differences are added: half of the variance of
the air's change remains. Set by judgement."""

_CELL_KM = 2.0  # exposures of a square and of ten minutes share a column of the model
_CELL_NS = 600 * 10**9
_EARTH_KM = 6371.0
_AGE_STEP_KM = 20.0  # profiles whose distances round to the same multiple are one
_LOWEST_CAMERA_M = 1.0  # above the ground; from a lower one there is no refraction to compare


class ColumnAir(NamedTuple):
    """One column of a model from the ground up.

    ``height`` (l,) [m']; ``values`` (3, l): T_M [K], e/p and ln p there.
    """

    height: Array
    values: Array


class WeightedPlace(NamedTuple):
    """Where and when air was sampled, and its share in a mixture."""

    place: PlaceInTime
    weight: float


@dataclass(frozen=True, eq=False)
class PlacedExposures:
    """Exposures (k,) of known place, and the number of the profile of each."""

    time_ns: Integers
    latitude_rad: Array
    longitude_rad: Array
    profile_number: Integers

    @cached_property
    def km_per_rad(self) -> Array:
        """(2,) kilometres in a radian of latitude, and in one of longitude at the mean latitude."""
        mean_latitude = self.latitude_rad.mean()
        return _EARTH_KM * np.array([1.0, np.cos(mean_latitude)])

    @cached_property
    def km(self) -> Array:
        """(2, k) kilometres north of the equator and east of Greenwich."""
        places = np.stack([self.latitude_rad, self.longitude_rad])
        return np.asarray(self.km_per_rad[:, None] * places)

    def km_of_origin(self, place: PlaceInTime) -> Array:
        """(2,) kilometres as in `km` of a place where air was sampled."""
        return np.asarray(self.km_per_rad * place[:2])

    def extent_km(self, origins: Mapping[PlaceInTime, ColumnAir]) -> float:
        """Diagonal [km] of the area of the exposures and of the places where air was sampled."""
        km_of_origins = [self.km_of_origin(place) for place in origins]
        km = np.hstack([self.km, np.array(km_of_origins).T])
        return float(np.hypot(*np.ptp(km, axis=1)))

    def extent_hours(self, origins: Mapping[PlaceInTime, ColumnAir]) -> float:
        """Time between the first and the last of exposures and samples."""
        times_ns = self.time_ns.tolist()
        for _, _, sampled_ns in origins:
            times_ns.append(sampled_ns)
        return float((max(times_ns) - min(times_ns)) / 3.6e12)


class ExposureCells(NamedTuple):
    """Cells (c,) of exposures (k,); those of a cell share a column of the model.

    ``profile_number`` (c,): in the series. ``first_exposure`` (c,): the exposure with the place of
    the column. ``cell_of_exposure`` (k,).
    """

    profile_number: Integers
    first_exposure: Rows
    cell_of_exposure: Rows


class ChangedAirs(NamedTuple):
    """Profiles with the model's changes, and the profile of each cell.

    ``airs``: the profiles of the series, then ``added`` changed ones. ``air_of_cell`` (c,): numbers
    in ``airs``. ``largest``: the largest change of ln R in absolute value.
    """

    airs: list[TimedProfile]
    added: int
    air_of_cell: Integers
    largest: float


def add_model_changes(
    series: ProfileSeries,
    field: ModelField,
    time_ns: Integers,
    latitude_rad: Array,
    longitude_rad: Array,
    *,
    h_c: list[float],
    h_g: float,
    measured: bool,
) -> tuple[ProfileSeries, Notes]:
    """The air of each exposure's own place, where a flight is longer than 30 km or two hours.

    ``time_ns``, ``latitude_rad``, ``longitude_rad``: (s,) of the exposures; places NaN where
    unknown, longitudes go on across the 180th meridian. Profiles of ``series`` have ``sampled_at``,
    or neighbours that have it. ``h_c``, ``h_g``: heights of cameras and of the ground [m above sea
    level]. ``measured``: whether the air was measured, so that the distance from its samples
    counts; else it is the model's own. Exposures share a profile where R differs by less than
    0.05 %. The model's differences leave the uncertainty of half a distance: that from the samples,
    and the height of the camera, because a ray at 45 degrees ends as far away as the camera is high
    (docs/pages/air/weather_model.md).
    """
    has_place = np.isfinite(latitude_rad + longitude_rad)
    if not bool(has_place.any()):
        return series, ()
    exposures = PlacedExposures(
        time_ns=time_ns[has_place],
        latitude_rad=latitude_rad[has_place],
        longitude_rad=longitude_rad[has_place],
        profile_number=series.profile_number[has_place],
    )
    origins = _columns_of_origins(series, field)
    length_km = exposures.extent_km(origins)
    hours = exposures.extent_hours(origins)
    if length_km < LONG_KM and hours < LONG_H:
        return series, ()
    cells = _cells_of(exposures)
    changed = _changed_airs(
        series,
        field,
        exposures,
        cells,
        origins,
        h_c=h_c,
        h_g=h_g,
        measured=measured,
    )
    numbers = series.profile_number.copy()
    numbers[has_place] = changed.air_of_cell[cells.cell_of_exposure]
    used, numbers = np.unique(numbers, return_inverse=True)
    used_airs = tuple(changed.airs[number] for number in used)
    entry = messages.air_by_place(
        count=changed.added,
        length_km=length_km,
        hours=hours,
        percent=100.0 * changed.largest,
    )
    return ProfileSeries(used_airs, numbers.astype(np.int64)), (entry,)


def _columns_of_origins(
    series: ProfileSeries,
    field: ModelField,
) -> dict[PlaceInTime, ColumnAir]:
    """The model's columns where and when the air of a series was sampled."""
    columns: dict[PlaceInTime, ColumnAir] = {}
    for air in series.timed_profiles:
        for place, _ in _origins(air):
            latitude, longitude, time_ns = place
            there = field.columns(
                np.array([latitude]),
                np.array([longitude]),
                np.array([time_ns]),
            )
            columns[place] = _column(there, 0)
    return columns


def _cells_of(exposures: PlacedExposures) -> ExposureCells:
    """Cells of exposures that share profile, ten minutes and square of 2 km."""
    slot = (exposures.time_ns - exposures.time_ns.min()) // _CELL_NS
    square = np.floor(exposures.km / _CELL_KM)
    keys = np.vstack([exposures.profile_number, slot, square])
    keys_of_cells, first_exposure, cell_of_exposure = np.unique(
        keys,
        axis=1,
        return_index=True,
        return_inverse=True,
    )
    profile_number = keys_of_cells[0].astype(np.int64)
    return ExposureCells(profile_number, first_exposure, cell_of_exposure.ravel())


def _changed_airs(
    series: ProfileSeries,
    field: ModelField,
    exposures: PlacedExposures,
    cells: ExposureCells,
    origins: Mapping[PlaceInTime, ColumnAir],
    *,
    h_c: list[float],
    h_g: float,
    measured: bool,
) -> ChangedAirs:
    """The air of each cell, with the model's change from where it was sampled to the cell.

    Cells of one profile share the air if their distances and changes of ln R round to the same.
    ``origins``: the model's columns where the air was sampled.
    """
    columns = field.columns(
        exposures.latitude_rad[cells.first_exposure],
        exposures.longitude_rad[cells.first_exposure],
        exposures.time_ns[cells.first_exposure],
    )
    airs = list(series.timed_profiles)
    number_of_key: dict[tuple[int, ...], int] = {}  # in ``airs``; key: profile, distance, changes
    air_of_cell = np.zeros(cells.first_exposure.size, np.int64)
    largest = 0.0
    for cell, exposure in enumerate(cells.first_exposure):
        profile_number = int(cells.profile_number[cell])
        air = series.timed_profiles[profile_number]
        away_km = (max(h_c) - h_g) * 1e-3
        if measured:
            away_km = _add_distances(away_km, air, exposures, exposure)
        changed = changed_air(air, _column(columns, cell), origins, h_g)
        changes = _changes_of_refraction(changed, air, h_c, h_g)
        largest = max([largest, *map(abs, changes)])
        rounded = [round(change / FINEST_CHANGE) for change in changes]
        key = (profile_number, round(away_km / _AGE_STEP_KM), *rounded)
        if key not in number_of_key:
            number_of_key[key] = len(airs)
            ages = _ages_with_distance(air, h_g, away_km)
            time_ns = int(exposures.time_ns[exposure])
            airs.append(replace(changed, time_ns=time_ns, ages=ages))
        air_of_cell[cell] = number_of_key[key]
    return ChangedAirs(airs, len(number_of_key), air_of_cell, largest)


def _add_distances(
    away_km: float,
    air: TimedProfile,
    exposures: PlacedExposures,
    exposure: int,
) -> float:
    """A distance [km] plus the weighted mean distance of an exposure from where air was sampled."""
    for place, weight in _origins(air):
        north, east = exposures.km[:, exposure] - exposures.km_of_origin(place)
        away_km += weight * float(np.hypot(north, east))
    return away_km


def _changes_of_refraction(
    changed: TimedProfile,
    air: TimedProfile,
    h_c: Sequence[float],
    h_g: float,
) -> list[float]:
    """The change of ln R from ``air`` to ``changed``, for each camera over 1 m above ground."""
    changes = []
    for height in h_c:
        if height > h_g + _LOWEST_CAMERA_M:
            changes.append(changed.change_from(air, [height], h_g))
    return changes


def _ages_with_distance(air: TimedProfile, h_g: float, away_km: float) -> SampleAges:
    """The ages of an air's samples, with the share `LEFT_BY_MODEL` of a distance added."""
    ages = air.ages or SampleAges(np.array([h_g]), np.zeros(1))
    added_m = 1e3 * LEFT_BY_MODEL * away_km
    metres = np.broadcast_to(ages.metres + added_m, ages.h_m.shape)
    return SampleAges(ages.h_m, ages.hours, metres)


def _origins(air: TimedProfile) -> list[WeightedPlace]:
    """Where and when the air was sampled, with weights that add up to 1."""
    if air.sampled_at is not None:
        return [WeightedPlace(air.sampled_at, 1.0)]
    if air.neighbours is None:
        raise ValueError("air that changes from place to place needs the place that it is of")
    earlier, later, share = air.neighbours
    origins = []
    for place, weight in _origins(earlier):
        origins.append(WeightedPlace(place, weight * (1.0 - share)))
    for place, weight in _origins(later):
        origins.append(WeightedPlace(place, weight * share))
    return origins


def _column(columns: ModelColumns, number: int) -> ColumnAir:
    """Column ``number`` of several columns of a model, at the levels where it has air.

    The model has its levels from the top down.
    """
    vapour = columns.vapour[number]
    virtual = columns.temperature_k[number] / (1.0 - VAPOUR_DEFICIT * vapour)
    values = np.stack([virtual, vapour, columns.log_pressure[number]])
    height = columns.height[number]
    has_air = np.isfinite(height + values.sum(axis=0))
    from_ground_up = np.flatnonzero(has_air)[::-1]
    return ColumnAir(height[from_ground_up], values[:, from_ground_up])


def changed_air(
    air: TimedProfile,
    here: ColumnAir,
    origins: Mapping[PlaceInTime, ColumnAir],
    h_g: float,
) -> TimedProfile:
    """The air plus the model's column ``here`` minus its columns where the air was sampled.

    ``origins``: these columns. ``h_g``: height of the ground [m above sea level], where ln p is
    changed by the model; elsewhere pressure follows by hydrostatics. Below the lowest and above the
    highest level that two columns share, their difference is constant.
    """
    profile = air.profile
    layers = profile.layers
    edge = layers.edge
    anchor = float(np.clip(profile.gravity.geopotential_height(h_g), edge[0], edge[-1]))
    heights = np.append(edge, anchor)
    change = np.zeros((3, heights.size))
    for place, weight in _origins(air):
        change += weight * _difference(here, origins[place], heights)

    top_vapour = layers.vapour[-1] + layers.vapour_slope[-1] * (edge[-1] - edge[-2])
    vapour = np.append(layers.vapour, top_vapour) + change[1, :-1]
    anchor_pa = profile.pressure(profile.gravity.height(anchor))
    pressure = anchor_pa * np.exp(change[2, -1])
    changed_layers = stack_layers(
        edge,
        layers.edge_temperature + change[0, :-1],
        np.maximum(vapour, 0.0),
        layers.source,
        anchor=(anchor, float(pressure)),
        constant=profile.constant,
    )
    changed = replace(profile, layers=changed_layers)
    if air.own_covariance is None:
        return replace(air, profile=changed)
    covariance = replace(air.own_covariance, profile=changed)
    return replace(air, profile=changed, own_covariance=covariance)


def _difference(here: ColumnAir, there: ColumnAir, heights: Array) -> Array:
    """(3, n) T_M, e/p and ln p of column ``here`` minus those of ``there``, at heights [m']."""
    lowest = max(here.height[0], there.height[0])
    highest = min(here.height[-1], there.height[-1])
    common = np.clip(heights, lowest, highest)
    differences = []
    for values_here, values_there in zip(here.values, there.values, strict=True):
        interpolated_here = np.interp(common, here.height, values_here)
        interpolated_there = np.interp(common, there.height, values_there)
        differences.append(interpolated_here - interpolated_there)
    return np.stack(differences)
