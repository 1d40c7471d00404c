"""Fields of a weather model on pressure or model levels, and the air of columns in them.

ECMWF's 137 model levels lie between half levels of pressure a + b p_s; `data/ecmwf_l137.csv` has
a and b of ECMWF's L137 definition (a to six decimals, b to nine digits as in its GRIB files).

A column at the place and time of a flight is taken as a sounding is, with the errors of a good
analysis. Against radiosondes ERA5 departs by about 1 K in the free troposphere, up to 2 K in the
lowest kilometre, and 10 to 15 % in relative humidity (Hersbach et al. 2020, Q. J. R. Meteorol. Soc.
146, sections 5 and 6; Graham et al. 2019, Geophys. Res. Lett. 46, p. 6138); correlation over 2 km
of height, and how a forecast ages, are set by judgement.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import product

import numpy as np

from unbend.atmosphere.climate_tables import rows_of
from unbend.atmosphere.hypsometry import ADIABATIC_K_PER_M
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.soundings import level_checks, messages
from unbend.atmosphere.soundings.level_checks import FEWEST_LEVELS, THICKNESS_RATIO
from unbend.atmosphere.soundings.levels import ColumnErrors, Sounding
from unbend.errors import InputError
from unbend.geodesy import longitudes_near, normal_gravity
from unbend.messages import Message, Notes
from unbend.units import (
    DEGREE,
    HECTOPASCAL,
    HYDROSTATIC_CONSTANT,
    STANDARD_GRAVITY,
    VAPOUR_DEFICIT,
    Array,
    Integers,
    Rows,
)

MODEL_LEVELS = 137  # of ERA5 and of ECMWF's forecasts since 2013

_RATIO = 0.622  # of the molar masses of water and dry air
_SURFACE_PA = 30_000.0, level_checks.HIGHEST_PA  # the highest of levels that reach the ground
_MOST_FRACTION = 1.6
_SPECIFIC, _RELATIVE = (-1e-3, 1e-6, 0.05), (-0.3, 0.05, _MOST_FRACTION)
"""Of the driest level at least, where spectral models go below 0; of the wettest from, to."""
_OVERTURNS_K, _INVERSION_K, _INVERSION_K_PER_M, _THICKNESS_K = 8.0, 25.0, 0.05, 10.0
"""From level to level: cooler than by the adiabat, warmer, this per metre; the mean of two against
their heights. ERA5 and columns of 22 soundings reach 2, 1 and 5 K above the ground; inversions of
30 K within 200 m stand over ice plateaus in winter."""
_WEATHER_LOG_P = 0.045  # of sea-level pressure: 969 to 1060 hPa
_ANOTHER_GROUND_M = 50.0
_EARTH_KM, _SEA_LEVEL_PA, _SCALE_HEIGHT_M = 6371.0, 101_325.0, 8000.0
_WIDEST_STEP, _ROUNDING = 0.2, 1e-9  # of nodes [rad]
_GROUND_M, _SURFACE_LOG_P = (-600.0, 9000.0), 0.25
_MISSING = partial(np.empty, 0)


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """The air over n places: (n, l) arrays from the top down, NaN where a field has no value;
    heights are geopotential [m'], ``vapour`` is e/p, ``surface`` (n,) the model's ground."""

    height: Array
    log_pressure: Array
    temperature_k: Array
    vapour: Array
    surface: Array


@dataclass(frozen=True, eq=False)
class ModelField:
    """A model's fields as its file, ``name``, has them; times, nodes and levels are increasing.

    ``time_ns`` (t,) [Unix ns]; ``lead_h`` (t,) hours since the forecast began, 0 of an analysis;
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

    def columns(self, latitude_rad: Array, longitude_rad: Array, time_ns: Integers) -> ModelColumns:
        """The air over places (n,) at times (n,), interpolated between nodes and in time.

        Linear in latitude, longitude and time, on each level; beyond the first and the last time
        that time's. On model levels p = (p_upper + p_lower)/2 of the half levels and H by the
        hydrostatic equation in the model's own form (IFS documentation CY41R2, part III, Eq. 2.21
        to 2.23); against an integrated column 1e-4 of p up to 30 km.
        """
        longitude_rad = longitudes_near(longitude_rad, float(self.longitude_rad.mean()))
        pairs = (
            (time_ns - self.time_ns[0], self.time_ns - self.time_ns[0]),
            (latitude_rad, self.latitude_rad),
            (longitude_rad, self.longitude_rad),
        )
        axes = [np.interp(x, node, np.arange(node.size)) for x, node in pairs]

        def at(field: Array) -> Array:
            total = np.zeros((time_ns.size, field.shape[1]))
            for upper in product((False, True), repeat=3):
                weight = np.ones(time_ns.size)
                rows: list[Rows] = []
                for axis, up in zip(axes, upper, strict=True):
                    low = np.floor(axis)
                    weight *= axis - low if up else 1.0 - (axis - low)
                    rows.append((np.ceil(axis) if up else low).astype(np.intp))
                used = weight > 0.0
                t, y, x = (row[used] for row in rows)
                total[used] += weight[used, None] * field[t, :, y, x]
            return total

        t, humidity = at(self.temperature_k), at(self.humidity)
        surface = at(self.surface)[:, 0] if self.surface.size else np.full(time_ns.size, np.nan)
        if self.on_model_levels:
            half = half_levels(np.exp(at(self.log_surface_pa)))[:, int(self.level[0]) - 1 :]
            p = 0.5 * (half[:, 1:] + half[:, :-1])
        else:
            p = np.broadcast_to(self.level, t.shape)
        vapour = self.vapour(humidity, t, p)
        if self.on_model_levels:
            height = level_heights(half, t / (1.0 - VAPOUR_DEFICIT * vapour), surface)
        else:
            height = at(self.height)
        return ModelColumns(height, np.log(p), t, vapour, surface)

    def vapour(self, humidity: Array, temperature_k: Array, pressure_pa: Array) -> Array:
        """e/p of the file's humidities, at least 0: spectral models go below."""
        if self.relative:
            vapour = vapour_pressure(humidity, temperature_k, pressure_pa) / pressure_pa
        else:
            vapour = humidity / (_RATIO + VAPOUR_DEFICIT * humidity)
        return np.maximum(vapour, 0.0)

    def refuse_outside(self, latitude_rad: Array, longitude_rad: Array) -> None:
        """Refuse (`InputError`) places (n,) outside the grid, or in a hole of it: how far."""
        east = longitudes_near(longitude_rad, float(self.longitude_rad.mean()))
        away = _EARTH_KM * np.hypot(
            _outside(self.latitude_rad, latitude_rad),
            _outside(self.longitude_rad, east) * np.cos(latitude_rad),
        )
        worst = int(np.argmax(away))
        if away[worst] == 0.0:
            return
        y, x = (nodes[[0, -1]] / DEGREE for nodes in (self.latitude_rad, self.longitude_rad))
        raise messages.model_area(
            where=self.name,
            north=latitude_rad[worst] / DEGREE,
            east=east[worst] / DEGREE,
            away_km=away[worst],
            south_node=y[0],
            north_node=y[1],
            west_node=x[0],
            east_node=x[1],
        )


def _outside(node: Array, x: Array) -> Array:
    """(n,) distances from the nodes [rad]; inside them 0, but in a gap of 1.5 steps or 11°."""
    away = np.maximum(np.maximum(node[0] - x, x - node[-1]), 0.0)
    if node.size > 1:
        i = np.clip(np.searchsorted(node, x), 1, node.size - 1)
        step, usual = node[i] - node[i - 1], float(np.median(np.diff(node)))
        hole = (away == 0.0) & ((step > 1.5 * usual) | (step > _WIDEST_STEP))
        away = np.where(hole, np.minimum(x - node[i - 1], node[i] - x), away)
    return np.where(away > _ROUNDING, away, 0.0)


@cache
def level_coefficients() -> Array:
    """(2, 138): a [Pa] and b of the half levels."""
    rows = rows_of("ecmwf_l137.csv")
    return np.array([[float(row["a_pa"]), float(row["b"])] for row in rows]).T


def half_levels(surface_pa: Array) -> Array:
    """(n, 138) pressures [Pa] of the half levels over surface pressures (n,) or (n, 1) [Pa].

    >>> half_levels(np.array([101325.0]))[0, [1, 100, 136, 137]].round(2).tolist()
    [2.0, 60016.68, 101084.87, 101325.0]
    """
    a, b = level_coefficients()
    return np.asarray(a + b * np.reshape(surface_pa, (-1, 1)))


def level_heights(half: Array, virtual: Array, surface: Array) -> Array:
    """(n, l) geopotential heights [m'] of model levels, from the ground ``surface`` (n,) up.

    ``half`` (n, l + 1) pressures of the half levels about them, ``virtual`` T_M [K] on them.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = np.log(half[:, 1:] / half[:, :-1])
        alpha = 1.0 - half[:, :-1] / np.diff(half, axis=1) * fall
    top = half[:, 0] <= 0.0  # the uppermost layer ends at no pressure
    alpha[top, 0], fall[top, 0] = math.log(2.0), 0.0
    layer = virtual * fall / HYDROSTATIC_CONSTANT
    below = np.cumsum(layer[:, ::-1], axis=1)[:, ::-1] - layer
    return np.asarray(surface[:, None] + below + alpha * virtual / HYDROSTATIC_CONSTANT)


def _has_values(field: ModelField) -> bool:
    """Whether a field has air at one place at least, and heights where these are not computed."""
    has_air = np.isfinite(field.temperature_k + field.humidity)
    if field.on_model_levels:
        return bool(has_air.any())
    has_height = np.isfinite(field.height)
    return bool(has_air.any() and has_height.any())


def checked_field(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """A field whose units are what its numbers can only be; repairs are noted.

    Pressures in hPa or Pa, by the highest between 300 and 1100 hPa; geopotential [m2/s2] or metres
    of it by the hydrostatic equation; relative humidity in percent or as a fraction. Refuses
    (`InputError`) what is neither.
    """
    notes: Notes = ()
    t, q = field.temperature_k, field.humidity
    if not _has_values(field):
        raise messages.model_without_values(where=where)
    low = float(np.nanmin(t))
    high = float(np.nanmax(t))
    if not level_checks.COLDEST_K <= low <= high <= level_checks.WARMEST_K:
        raise messages.model_temperatures(where=where, coldest_k=low, warmest_k=high)
    if field.relative and np.nanmax(q) > _MOST_FRACTION:
        field = replace(field, humidity=q / 100.0)
    driest, wettest = float(np.nanmin(field.humidity)), float(np.nanmax(field.humidity))
    lowest, least, most = _RELATIVE if field.relative else _SPECIFIC
    if driest < lowest or not least <= wettest <= most:
        kind = "relative" if field.relative else "specific"
        raise messages.model_humidities(where=where, kind=kind, driest=driest, wettest=wettest)
    if bool(np.isfinite(field.surface).any()):
        ground = field.surface
        if not _GROUND_M[0] <= float(np.nanmin(ground)) <= float(np.nanmax(ground)) <= _GROUND_M[1]:
            raise messages.model_ground_height(where=where, highest_m=np.nanmax(ground))
        if field.on_model_levels:
            if not field.ground_has_unit:
                field, notes = _likely_ground(field, where)
                ground = field.surface
            expected = math.log(_SEA_LEVEL_PA) - ground / _SCALE_HEIGHT_M
            off = float(np.nanmax(np.abs(field.log_surface_pa - expected)))
            if off > _SURFACE_LOG_P:
                raise messages.model_surface_pressure(where=where, departure=off)
    if field.on_model_levels:
        surface_pa = np.exp(field.log_surface_pa[:, 0])
        half = half_levels(surface_pa.ravel())[:, int(field.level[0]) - 1 :]
        full = 0.5 * (half[:, 1:] + half[:, :-1])
        shape = (*surface_pa.shape, full.shape[1])
        refuse_wrong_level(field, np.moveaxis(full.reshape(shape), -1, 1), where)
        return field, notes
    lowest = float(field.level[-1])
    if not _SURFACE_PA[0] <= lowest <= _SURFACE_PA[1]:
        factor = next((f for f in (HECTOPASCAL, 1.0 / HECTOPASCAL)
                       if _SURFACE_PA[0] <= f * lowest <= _SURFACE_PA[1]), None)  # fmt: skip
        if factor is None:
            raise messages.model_highest_pressure(where=where, highest_pa=lowest)
        notes = (messages.model_pressure_unit(where=where, lowest=lowest, factor=factor),)
        field = replace(field, level=factor * field.level)
    layers = 0.5 * (t[0, 1:] + t[0, :-1]) * np.diff(np.log(field.level))[:, None, None]
    thickness = -HYDROSTATIC_CONSTANT * np.diff(field.height[0], axis=0)
    ratio = float(np.nanmedian(thickness / layers))
    if abs(ratio / STANDARD_GRAVITY - 1.0) < THICKNESS_RATIO:
        field = replace(field, height=field.height / STANDARD_GRAVITY)
    elif not abs(ratio - 1.0) < THICKNESS_RATIO:
        raise messages.model_thickness(where=where, ratio=ratio)
    refuse_wrong_level(field, field.level[:, None, None], where)
    return field, notes


def _likely_ground(field: ModelField, where: str) -> tuple[ModelField, Notes]:
    """The ground in metres where the surface pressure is weather at no height else, and noted."""
    warmth = field.temperature_k[:, -1:]

    def departure(height: Array) -> float:
        """Of the pressure reduced to sea level from its mean, as a logarithm."""
        middle = warmth + 0.5 * EXTENSION_LAPSE * height
        reduced = field.log_surface_pa + HYDROSTATIC_CONSTANT * height / middle
        return abs(float(np.nanmedian(reduced)) - math.log(_SEA_LEVEL_PA))

    metres = field.surface * STANDARD_GRAVITY
    off, other = departure(field.surface), departure(metres)
    if off < _WEATHER_LOG_P or other > _WEATHER_LOG_P:
        return field, ()
    highest = float(np.nanmax(metres))
    repaired = messages.model_ground_unit(where=where, count=metres.size, highest=highest)
    return replace(field, surface=metres, ground_has_unit=True), (repaired,)


def refuse_wrong_level(field: ModelField, pressure_pa: Array, where: str) -> None:
    """Refuse (`InputError`) temperatures that no air has one above the other: it overturns where it
    cools by more than 9.8 K/km. ``pressure_pa`` (l, 1, 1) or (t, l, y, x)."""
    t, log_p = field.temperature_k, np.log(pressure_pa)
    thick = 0.5 * (t[:, 1:] + t[:, :-1]) * np.diff(log_p, axis=-3) / HYDROSTATIC_CONSTANT  # [m']
    warmer = -np.diff(t, axis=1)  # upwards
    beyond = np.fmax(
        -warmer - ADIABATIC_K_PER_M * thick - _OVERTURNS_K,
        warmer - _INVERSION_K_PER_M * thick - _INVERSION_K,
    )
    if not bool(np.any(beyond > 0.0)):
        return
    i, upper, y, x = np.unravel_index(int(np.nanargmax(beyond)), beyond.shape)
    on = {row: f"level {field.level[row]:.0f}" if field.on_model_levels
          else f"{field.level[row] / HECTOPASCAL:g} hPa" for row in (upper, upper + 1)}  # fmt: skip
    raise messages.model_levels_jump(
        where=where,
        lower=on[upper + 1],
        upper=on[upper],
        lower_k=t[i, upper + 1, y, x],
        upper_k=t[i, upper, y, x],
        thick=thick[i, upper, y, x],
        north=field.latitude_rad[y] / DEGREE,
        east=field.longitude_rad[x] / DEGREE,
    )


LOW_K, ALOFT_K, LOW_M, ALOFT_M = 2.0, 1.0, 1000.0, 1500.0
HUMIDITY_RH, ERROR_LENGTH_M, LEVEL_LOG_P = 0.15, 2000.0, 1e-3
"""One sigma up to 1000 m above the ground and from 1500 m on; of relative humidity; the correlation
length of both in height; of ln p at the lowest level."""

FORECAST_K_PER_DAY, FORECAST_RH_PER_DAY, FORECAST_LOG_P_PER_DAY = 0.5, 0.03, 1e-3
"""What a forecast adds with its lead time: 2.7 K after five days."""

EXTENSION_LAPSE, EXTENSION_K_PER_M, EXTENSION_RH_PER_M = 6.5e-3, 8e-3, 2e-4
"""Below its lowest level a column goes on with 6.5 K/km, as the model's own pressure levels do; in
a valley with an inversion that is wrong by 8 K per kilometre, in relative humidity by 0.2."""

_EXTENSION_STEP_M, _SMALLEST_EXTENSION_M = 100.0, 20.0
_USUAL_STEP_M = 300.0  # between pressure levels 25 hPa apart
_TOP_M, _ABOVE_CAMERA_M = 10_000.0, 2000.0
"""A column ends so far above the ground, or above the highest camera: knots of the estimate stay
fine."""


def model_column(
    field: ModelField,
    place: tuple[float, float, int],
    *,
    ground_h_m: float,
    highest_h_m: float = 0.0,
) -> tuple[Sounding, Notes]:
    """The column of a model over a place: latitude, longitude [rad] and time [Unix ns].

    ``ground_h_m`` of the true ground, NaN where it is not known; ``highest_h_m`` of the highest
    camera [m above sea level]. Levels under the ground, the model's or the true one, are left out;
    where the lowest is more than 20 m above the true ground the column goes on down to it, with
    growing sigma. Refuses (`InputError`) fewer than five levels. Its time is the file's nearest.
    """
    (latitude, longitude, time_ns), where = place, field.name
    notes, gravity = list[Message](), normal_gravity(latitude)
    air = field.columns(np.array([latitude]), np.array([longitude]), np.array([time_ns]))
    height, t, vapour = (a[0, ::-1] for a in (air.height, air.temperature_k, air.vapour))
    log_p, surface = air.log_pressure[0, ::-1], float(air.surface[0])
    known = np.isfinite(height + t + vapour)
    ground = float(gravity.geopotential_height(ground_h_m))
    if math.isnan(ground):
        ground = 0.0 if math.isnan(surface) else surface
        notes.append(messages.model_ground(where=where, ground=ground))
    elif not field.ground_has_unit and abs(surface - ground) > (
        _ANOTHER_GROUND_M + 2.0 * abs(STANDARD_GRAVITY * surface - ground)
    ):
        raise messages.model_units_ground(
            where=where, surface=surface, ground=ground, metres=STANDARD_GRAVITY * surface
        )
    bottom = ground if math.isnan(surface) else max(surface, ground)
    with np.errstate(invalid="ignore"):
        under = known & (height < bottom)
        highest = float(gravity.geopotential_height(highest_h_m + _ABOVE_CAMERA_M))
        top = max(ground + _TOP_M, highest)
        used = known & ~under & (height < top)
    if count := int(under.sum()):
        notes.append(messages.model_underground(where=where, count=count, bottom=bottom))
    if used.sum() < FEWEST_LEVELS or bool(np.any(np.diff(height[used]) <= 0.0)):
        raise too_few_levels(np.exp(log_p[used]), where, "above the ground")
    above = log_p[known & (height >= top)]  # none: what is missing may have been the top
    if missing := int((~known & (log_p >= above[:1].max(initial=-math.inf))).sum()):
        notes.append(messages.model_missing(where=where, count=missing, total=known.size))
    height, t, vapour, log_p = height[used], t[used], vapour[used], log_p[used]
    if field.height.size:  # which heights of model levels are not
        virtual = t / (1.0 - VAPOUR_DEFICIT * vapour)
        mean = 0.5 * (virtual[1:] + virtual[:-1])
        implied = -HYDROSTATIC_CONSTANT * np.diff(height) / np.diff(log_p)
        worst = int(np.argmax(np.abs(implied - mean)))
        if abs(implied[worst] - mean[worst]) > _THICKNESS_K:
            lower, upper = np.exp(log_p[worst : worst + 2]) / HECTOPASCAL
            notes.append(
                messages.model_layer(
                    where=where,
                    lower=lower,
                    upper=upper,
                    mean=mean[worst],
                    implied=implied[worst],
                    count=int(np.sum(np.abs(implied - mean) > _THICKNESS_K)),
                )
            )
    above = height - ground
    days = float(np.interp(time_ns, field.time_ns, field.lead_h)) / 24.0 if field.lead_h.size else 0
    sigma = np.interp(above, [LOW_M, ALOFT_M], [LOW_K, ALOFT_K])
    sigma_rh = np.full(t.size, HUMIDITY_RH)
    if (depth := float(above[0])) > _SMALLEST_EXTENSION_M:
        # [m'] under the lowest level, from the ground up; mixed air: e/p stays
        below = np.linspace(depth, 0.0, 1 + math.ceil(depth / _EXTENSION_STEP_M))[:-1]
        warmer = t[0] + EXTENSION_LAPSE * below
        exponent = HYDROSTATIC_CONSTANT * (1.0 - VAPOUR_DEFICIT * vapour[0]) / EXTENSION_LAPSE
        log_p = np.concatenate([log_p[0] + exponent * np.log(warmer / t[0]), log_p])
        height = np.concatenate([height[0] - below, height])
        t, vapour = np.concatenate([warmer, t]), np.append(np.full(below.size, vapour[0]), vapour)
        sigma = np.concatenate([np.hypot(sigma[0], EXTENSION_K_PER_M * below), sigma])
        sigma_rh = np.concatenate([np.hypot(HUMIDITY_RH, EXTENSION_RH_PER_M * below), sigma_rh])
        if depth > _USUAL_STEP_M:
            notes.append(
                messages.model_extended(where=where, depth=depth, ground=ground, sigma=sigma[0])
            )
    depth = max(depth, 0.0)
    level = HYDROSTATIC_CONSTANT * EXTENSION_K_PER_M * depth**2 / (2.0 * float(t[0]) ** 2)
    p = np.exp(log_p)
    column = Sounding(
        gravity.height(height), p, t, vapour * p,
        int(field.time_ns[np.argmin(np.abs(field.time_ns - time_ns))]),
        where, latitude, longitude, "column of fields", "weather model",
        ColumnErrors(
            np.hypot(sigma, FORECAST_K_PER_DAY * days),
            np.hypot(sigma_rh, FORECAST_RH_PER_DAY * days),
            ERROR_LENGTH_M, ERROR_LENGTH_M,
            math.hypot(LEVEL_LOG_P, FORECAST_LOG_P_PER_DAY * days, level),
        ),
    )  # fmt: skip
    return column, tuple(notes)


def too_few_levels(pressure_pa: Array, where: str, which: str) -> InputError:
    """The refusal of levels that make no profile."""
    listed = ", ".join(f"{p / HECTOPASCAL:.4g}" for p in np.sort(pressure_pa)[:8]) or "no"
    return messages.model_levels(
        where=where, total=pressure_pa.size, which=which, listed=listed, fewest=FEWEST_LEVELS
    )
