"""Fields of a weather model on pressure or model levels, and the air of columns in them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.hypsometry import ADIABATIC_K_PER_M
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.soundings import level_checks, messages, model_levels
from unbend.atmosphere.soundings.level_checks import FEWEST_LEVELS, THICKNESS_RATIO
from unbend.errors import InputError
from unbend.geodesy import longitudes_near
from unbend.messages import Notes
from unbend.units import (
    DEGREE,
    HECTOPASCAL,
    HYDROSTATIC_CONSTANT,
    STANDARD_GRAVITY,
    VAPOUR_DEFICIT,
    Array,
    Integers,
    Mask,
    Rows,
)

EXTENSION_LAPSE = 6.5e-3
"""Below its lowest level a column goes on with 6.5 K/km, as the model's own pressure levels do."""


class _HumidityLimits(NamedTuple):
    """Limits of the humidities of a field; others show another unit."""

    driest: float  # lowest value of the driest level
    wettest_least: float  # lowest and highest value of the wettest level
    wettest_most: float


_RATIO = 0.622  # of the molar masses of water and dry air

# Limits of the pressure of the lowest level, which is near the ground [Pa].
_LOWEST_SURFACE_PA = 30_000.0
_HIGHEST_SURFACE_PA = level_checks.HIGHEST_PA

_MOST_FRACTION = 1.6  # relative humidities above this are in percent
_SPECIFIC = _HumidityLimits(-1e-3, 1e-6, 0.05)  # spectral models go below 0
_RELATIVE = _HumidityLimits(-0.3, 0.05, _MOST_FRACTION)

# Limits of the temperature of a level compared with that of the level below it; ERA5 and columns of
# 22 soundings reach 2 K beyond the adiabat and 1 K of inversion, above the ground.
_OVERTURNS_K = 8.0  # so much cooler than by the dry adiabat
_INVERSION_K = 25.0  # so much warmer, and in addition per metre
_INVERSION_K_PER_M = 0.05  # inversions of 30 K within 200 m exist over ice plateaus in winter

_LOWEST_GROUND_M = -600.0
_HIGHEST_GROUND_M = 9000.0
_WEATHER_LOG_P = 0.045  # largest departure of ln p at sea level from its mean: 969 to 1060 hPa
_SURFACE_LOG_P = 0.25  # largest departure of ln p at the surface from that by the scale height
_SEA_LEVEL_PA = 101_325.0
_SCALE_HEIGHT_M = 8000.0
_EARTH_KM = 6371.0
_WIDEST_STEP = 0.2  # from one node to the next [rad]; a wider one is a hole
_ROUNDING = 1e-9  # so far outside the nodes [rad] is inside
_MISSING = partial(np.empty, 0)


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """The air over n places on l levels from the top down: (n, l), NaN for a missing value."""

    height: Array  # geopotential [m']
    log_pressure: Array  # ln of the pressure in Pa
    temperature_k: Array
    vapour: Array  # e/p
    surface: Array  # (n,) geopotential height of the model's ground [m'], NaN if unknown


@dataclass(frozen=True, eq=False)
class _Corner:
    """One of the eight nodes about each of n places, in time, latitude and longitude."""

    places: Mask  # (n,) True for the k places where the weight of this node is above 0
    weight: Array  # (k,)
    time: Rows  # (k,) index of the node in the fields
    latitude: Rows
    longitude: Rows


@dataclass(frozen=True, eq=False)
class ModelField:
    """Fields of a weather model; times, nodes and levels are increasing.

    ``name`` is the file. ``time_ns`` (t,) [Unix ns]; ``lead_h`` (t,) hours since the forecast
    began, 0 or empty for an analysis;
    ``level`` (l,) pressures [Pa], or numbers of ECMWF's model levels (``on_model_levels``).
    Fields (t, l, y, x): temperature, ``humidity`` specific [kg/kg], or ``relative`` [1], and
    ``height`` geopotential of pressure levels [m']. Of the ground (t, 1, y, x): ``surface`` its
    geopotential height [m'], if known (``ground_has_unit`` is false where the file states none and
    geopotential is only likely); for model levels ``log_surface_pa`` ln of surface pressure [Pa].
    """

    name: str
    time_ns: Integers
    latitude_rad: Array
    longitude_rad: Array
    level: Array
    temperature_k: Array
    humidity: Array
    height: Array = field(default_factory=_MISSING)
    surface: Array = field(default_factory=_MISSING)
    log_surface_pa: Array = field(default_factory=_MISSING)
    lead_h: Array = field(default_factory=_MISSING)
    relative: bool = False
    on_model_levels: bool = False
    ground_has_unit: bool = True

    def columns(
        self,
        latitude_rad: Array,
        longitude_rad: Array,
        time_ns: Integers,
    ) -> ModelColumns:
        """The air over places (n,) at times (n,), interpolated between nodes and in time.

        Linear in latitude, longitude and time, on each level; before the first and after the last
        time the values of that time. On model levels p = (p_upper + p_lower)/2 of the half levels
        and H by `model_levels.level_heights`.
        """
        corners = self._corners(latitude_rad, longitude_rad, time_ns)
        t = interpolate(self.temperature_k, corners)
        humidity = interpolate(self.humidity, corners)
        surface = np.full(time_ns.size, np.nan)
        if self.surface.size:
            surface = interpolate(self.surface, corners)[:, 0]
        if self.on_model_levels:
            surface_pa = np.exp(interpolate(self.log_surface_pa, corners))
            half = self.half_levels(surface_pa)
            p = model_levels.level_pressures(half)
            vapour = self.vapour(humidity, t, p)
            virtual = t / (1.0 - VAPOUR_DEFICIT * vapour)
            height = model_levels.level_heights(half, virtual, surface)
        else:
            p = np.broadcast_to(self.level, t.shape)
            vapour = self.vapour(humidity, t, p)
            height = interpolate(self.height, corners)
        return ModelColumns(height, np.log(p), t, vapour, surface)

    def half_levels(self, surface_pa: Array) -> Array:
        """Pressures [Pa] (n, l + 1) of the half levels about the field's model levels.

        ``surface_pa``: surface pressures (n,) or (n, 1) [Pa].
        """
        first = int(self.level[0]) - 1
        return model_levels.half_levels(surface_pa)[:, first:]

    def _corners(
        self,
        latitude_rad: Array,
        longitude_rad: Array,
        time_ns: Integers,
    ) -> list[_Corner]:
        """The eight nodes about places (n,) at times (n,)."""
        mean_longitude = float(self.longitude_rad.mean())
        east = longitudes_near(longitude_rad, mean_longitude)
        first_ns = self.time_ns[0]
        positions = (
            position_among(self.time_ns - first_ns, time_ns - first_ns),
            position_among(self.latitude_rad, latitude_rad),
            position_among(self.longitude_rad, east),
        )
        return corners_about(positions)

    def vapour(self, humidity: Array, temperature_k: Array, pressure_pa: Array) -> Array:
        """e/p of humidities of the field's kind, at least 0: spectral models go below."""
        if self.relative:
            vapour = vapour_pressure(humidity, temperature_k, pressure_pa) / pressure_pa
        else:
            vapour = humidity / (_RATIO + VAPOUR_DEFICIT * humidity)
        return np.maximum(vapour, 0.0)

    def refuse_outside(self, latitude_rad: Array, longitude_rad: Array) -> None:
        """Refuse (`InputError`) places (n,) if one is outside the grid or in a hole of it."""
        east = longitudes_near(longitude_rad, float(self.longitude_rad.mean()))
        away_north = _outside(self.latitude_rad, latitude_rad)
        away_east = _outside(self.longitude_rad, east) * np.cos(latitude_rad)
        away_km = _EARTH_KM * np.hypot(away_north, away_east)
        worst = int(np.argmax(away_km))
        if away_km[worst] == 0.0:
            return
        raise messages.model_area(
            where=self.name,
            north=latitude_rad[worst] / DEGREE,
            east=east[worst] / DEGREE,
            away_km=away_km[worst],
            south_node=self.latitude_rad[0] / DEGREE,
            north_node=self.latitude_rad[-1] / DEGREE,
            west_node=self.longitude_rad[0] / DEGREE,
            east_node=self.longitude_rad[-1] / DEGREE,
        )


def position_among(nodes: Array | Integers, values: Array | Integers) -> Array:
    """Fractional indices (n,) of values (n,) in rising nodes; beyond the ends that of the end.

    >>> position_among(np.array([10.0, 20.0, 40.0]), np.array([5.0, 15.0, 35.0])).tolist()
    [0.0, 0.5, 1.75]
    """
    return np.interp(values, nodes, np.arange(nodes.size))


def corners_about(positions: Sequence[Array]) -> list[_Corner]:
    """The eight nodes about n places, with weights.

    ``positions``: fractional indices (n,) in time, in latitude and in longitude.
    """
    corners = []
    for uppers in product((False, True), repeat=3):
        weight = np.ones(positions[0].size)
        rows: list[Rows] = []
        for position, is_upper in zip(positions, uppers, strict=True):
            lower = np.floor(position)
            share = position - lower
            if is_upper:
                weight *= share
                rows.append(np.ceil(position).astype(np.intp))
            else:
                weight *= 1.0 - share
                rows.append(lower.astype(np.intp))
        used = weight > 0.0
        time, latitude, longitude = (row[used] for row in rows)
        corners.append(_Corner(used, weight[used], time, latitude, longitude))
    return corners


def interpolate(values: Array, corners: Sequence[_Corner]) -> Array:
    """(n, l) weighted means of a field (t, l, y, x) over the corners about n places."""
    total = np.zeros((corners[0].places.size, values.shape[1]))
    for corner in corners:
        columns = values[corner.time, :, corner.latitude, corner.longitude]
        total[corner.places] += corner.weight[:, None] * columns
    return total


def _outside(node: Array, x: Array) -> Array:
    """(n,) how far ``x`` (n,) are outside of the range of rising nodes [rad], 0 inside.

    Inside a hole, a step between nodes of more than 1.5 usual steps or 0.2 rad, the distance to the
    nearest node.
    """
    away = np.maximum(np.maximum(node[0] - x, x - node[-1]), 0.0)
    if node.size > 1:
        upper = np.clip(np.searchsorted(node, x), 1, node.size - 1)
        lower = upper - 1
        step = node[upper] - node[lower]
        usual_step = float(np.median(np.diff(node)))
        is_wide = (step > 1.5 * usual_step) | (step > _WIDEST_STEP)
        in_hole = (away == 0.0) & is_wide
        to_node = np.minimum(x - node[lower], node[upper] - x)
        away = np.where(in_hole, to_node, away)
    return np.where(away > _ROUNDING, away, 0.0)


def checked_field(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """The field in the units of `ModelField`, which its numbers show, and messages about repairs.

    Pressures are in hPa or Pa: the highest is between 300 and 1100 hPa. Heights are geopotential
    [m2/s2] or geopotential metres, by the hydrostatic equation. Relative humidity is in percent or
    a fraction. Refuses (`InputError`) numbers that fit neither, and impossible air.
    """
    if not _has_values(field):
        raise messages.model_without_values(where=where)
    _refuse_temperatures(field, where)
    field = _with_fraction(field)
    _refuse_humidities(field, where)
    field, ground_notes = _checked_ground(field, where)
    if field.on_model_levels:
        surface_pa = np.exp(field.log_surface_pa[:, 0])
        half = field.half_levels(surface_pa.ravel())
        pressures = model_levels.level_pressures(half)
        shape = (*surface_pa.shape, pressures.shape[1])
        by_time_and_level = np.moveaxis(pressures.reshape(shape), -1, 1)
        _refuse_temperature_jumps(field, by_time_and_level, where)
        return field, ground_notes
    field, pressure_notes = _with_pascals(field, where)
    field = _with_geopotential_metres(field, where)
    _refuse_temperature_jumps(field, field.level[:, None, None], where)
    return field, pressure_notes


def _has_values(field: ModelField) -> bool:
    """Whether a field has air at one place at least, and on pressure levels a height too."""
    has_air = np.isfinite(field.temperature_k + field.humidity)
    if field.on_model_levels:
        return bool(has_air.any())
    has_height = np.isfinite(field.height)
    return bool(has_air.any() and has_height.any())


def _refuse_temperatures(field: ModelField, where: str) -> None:
    """Refuse (`InputError`) temperatures outside 150 to 340 K."""
    coldest = float(np.nanmin(field.temperature_k))
    warmest = float(np.nanmax(field.temperature_k))
    if level_checks.COLDEST_K <= coldest <= warmest <= level_checks.WARMEST_K:
        return
    raise messages.model_temperatures(
        where=where,
        coldest_k=coldest,
        warmest_k=warmest,
    )


def _with_fraction(field: ModelField) -> ModelField:
    """The field with its relative humidity, if it has that, as a fraction."""
    if field.relative and np.nanmax(field.humidity) > _MOST_FRACTION:
        return replace(field, humidity=field.humidity / 100.0)
    return field


def _refuse_humidities(field: ModelField, where: str) -> None:
    """Refuse (`InputError`) humidities that can be neither kg/kg nor a fraction."""
    driest = float(np.nanmin(field.humidity))
    wettest = float(np.nanmax(field.humidity))
    kind = "relative" if field.relative else "specific"
    limits = _RELATIVE if field.relative else _SPECIFIC
    wettest_is_possible = limits.wettest_least <= wettest <= limits.wettest_most
    if driest < limits.driest or not wettest_is_possible:
        raise messages.model_humidities(
            where=where,
            kind=kind,
            driest=driest,
            wettest=wettest,
        )


def _checked_ground(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """The field with its ground, if known, in geopotential metres, and messages about repairs.

    Refuses (`InputError`) a ground that is higher or lower than any, and on model levels one that
    contradicts the surface pressure.
    """
    notes: Notes = ()
    if not bool(np.isfinite(field.surface).any()):
        return field, notes
    lowest = float(np.nanmin(field.surface))
    highest = float(np.nanmax(field.surface))
    if not _LOWEST_GROUND_M <= lowest <= highest <= _HIGHEST_GROUND_M:
        raise messages.model_ground_height(where=where, highest_m=highest)
    if not field.on_model_levels:
        return field, notes
    if not field.ground_has_unit:
        field, notes = _with_likely_ground(field, where)
    expected = math.log(_SEA_LEVEL_PA) - field.surface / _SCALE_HEIGHT_M
    departures = np.abs(field.log_surface_pa - expected)
    departure = float(np.nanmax(departures))
    if departure > _SURFACE_LOG_P:
        raise messages.model_surface_pressure(where=where, departure=departure)
    return field, notes


def _with_likely_ground(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """The field with its ground in metres, where only metres fit the surface pressure.

    The file states no unit for its ground. Geopotential was assumed, so that ``field.surface`` is
    the file's number over g. The file's number is metres where pressure reduced to sea level fits
    the weather from that height, but not from the assumed one. That repair is noted.
    """
    number_in_file = field.surface * STANDARD_GRAVITY
    geopotential_fits = _sea_level_departure(field, field.surface) < _WEATHER_LOG_P
    metres_fit = _sea_level_departure(field, number_in_file) < _WEATHER_LOG_P
    if geopotential_fits or not metres_fit:
        return field, ()
    repaired = messages.model_ground_unit(
        where=where,
        count=number_in_file.size,
        highest=float(np.nanmax(number_in_file)),
    )
    return replace(field, surface=number_in_file, ground_has_unit=True), (repaired,)


def _sea_level_departure(field: ModelField, ground: Array) -> float:
    """Departure of ln of the median sea-level pressure from that of the standard atmosphere.

    Surface pressure is reduced from a ``ground`` [m'] to sea level. Infinite if no place has
    pressure, temperature and ground.
    """
    lowest_level_k = field.temperature_k[:, -1:]
    mean_k = lowest_level_k + 0.5 * EXTENSION_LAPSE * ground
    reduced = field.log_surface_pa + HYDROSTATIC_CONSTANT * ground / mean_k
    if not bool(np.isfinite(reduced).any()):
        return math.inf
    return abs(float(np.nanmedian(reduced)) - math.log(_SEA_LEVEL_PA))


def _with_pascals(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """The field with pressures in Pa; the highest must be near the ground.

    A message is returned if the pressures fit only after a conversion between hPa and Pa.
    """
    highest = float(field.level[-1])
    if _is_near_ground(highest):
        return field, ()
    for factor in (HECTOPASCAL, 1.0 / HECTOPASCAL):
        if _is_near_ground(factor * highest):
            note = messages.model_pressure_unit(where=where, lowest=highest, factor=factor)
            return replace(field, level=factor * field.level), (note,)
    raise messages.model_highest_pressure(where=where, highest_pa=highest)


def _is_near_ground(pressure_pa: float) -> bool:
    """Whether the lowest level of a model may have this pressure."""
    return _LOWEST_SURFACE_PA <= pressure_pa <= _HIGHEST_SURFACE_PA


def _with_geopotential_metres(field: ModelField, where: str) -> ModelField:
    """The field with heights in m': if they are m2/s2, they are divided by g.

    The thickness of its layers by the hydrostatic equation decides, at its first time.
    """
    t = field.temperature_k[0]
    mean_k = 0.5 * (t[1:] + t[:-1])
    fall = np.diff(np.log(field.level))
    hydrostatic = mean_k * fall[:, None, None]
    thickness = -HYDROSTATIC_CONSTANT * np.diff(field.height[0], axis=0)
    ratio = float(np.nanmedian(thickness / hydrostatic))
    if abs(ratio / STANDARD_GRAVITY - 1.0) < THICKNESS_RATIO:
        return replace(field, height=field.height / STANDARD_GRAVITY)
    if not abs(ratio - 1.0) < THICKNESS_RATIO:
        raise messages.model_thickness(where=where, ratio=ratio)
    return field


def _refuse_temperature_jumps(field: ModelField, pressure_pa: Array, where: str) -> None:
    """Refuse (`InputError`) temperatures that change from level to level as in no air.

    Air overturns where it cools upwards by more than 9.8 K/km; inversions have limits too.
    ``pressure_pa`` (l, 1, 1) or (t, l, y, x) of the levels [Pa].
    """
    t = field.temperature_k
    mean_k = 0.5 * (t[:, 1:] + t[:, :-1])
    fall = np.diff(np.log(pressure_pa), axis=-3)
    thick = mean_k * fall / HYDROSTATIC_CONSTANT  # [m']
    warming = -np.diff(t, axis=1)  # upwards
    overturns = -warming - ADIABATIC_K_PER_M * thick - _OVERTURNS_K
    inversion = warming - _INVERSION_K_PER_M * thick - _INVERSION_K
    beyond = np.fmax(overturns, inversion)
    if not bool(np.any(beyond > 0.0)):
        return
    time, upper, y, x = np.unravel_index(int(np.nanargmax(beyond)), beyond.shape)
    lower = upper + 1
    raise messages.model_levels_jump(
        where=where,
        lower=_level_name(field, int(lower)),
        upper=_level_name(field, int(upper)),
        lower_k=t[time, lower, y, x],
        upper_k=t[time, upper, y, x],
        thick=thick[time, upper, y, x],
        north=field.latitude_rad[y] / DEGREE,
        east=field.longitude_rad[x] / DEGREE,
    )


def _level_name(field: ModelField, number: int) -> str:
    """Name of the level with the index ``number``, for messages: its model level or pressure."""
    if field.on_model_levels:
        return f"level {field.level[number]:.0f}"
    return f"{field.level[number] / HECTOPASCAL:g} hPa"


def too_few_levels(pressure_pa: Array, where: str, which: str) -> InputError:
    """The error about levels that are too few for a profile, or do not rise.

    ``which`` follows "5 levels" in the message, as "above the ground".
    """
    lowest_pressures = np.sort(pressure_pa)[:8]
    hectopascals = [f"{pressure / HECTOPASCAL:.4g}" for pressure in lowest_pressures]
    return messages.model_levels(
        where=where,
        total=pressure_pa.size,
        which=which,
        listed=", ".join(hectopascals) or "no",
        fewest=FEWEST_LEVELS,
    )
