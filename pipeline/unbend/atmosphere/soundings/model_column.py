"""The column of a weather model over a flight, as a `Sounding`.

Its errors are those of a good analysis. Against radiosondes ERA5 departs by about 1 K in the free
troposphere, up to 2 K in the lowest kilometre, and 10 to 15 % in relative humidity (Hersbach et al.
2020, Q. J. R. Meteorol. Soc. 146, sections 5 and 6; Graham et al. 2019, Geophys. Res. Lett. 46,
p. 6138); correlation over 2 km of height, and how a forecast ages, are set by judgement.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.air_samples import part_of
from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.level_checks import FEWEST_LEVELS
from unbend.atmosphere.soundings.levels import ColumnErrors, Sounding
from unbend.atmosphere.soundings.model_field import (
    EXTENSION_LAPSE,
    ModelColumns,
    ModelField,
    too_few_levels,
)
from unbend.geodesy import normal_gravity
from unbend.messages import Message, Notes
from unbend.units import (
    HECTOPASCAL,
    HYDROSTATIC_CONSTANT,
    STANDARD_GRAVITY,
    VAPOUR_DEFICIT,
    Array,
)

# One sigma of temperature up to 1000 m above the ground, and from 1500 m on.
LOW_K = 2.0
ALOFT_K = 1.0
LOW_M = 1000.0
ALOFT_M = 1500.0

HUMIDITY_RH = 0.15  # one sigma of relative humidity
ERROR_LENGTH_M = 2000.0  # correlation length of both in height
LEVEL_LOG_P = 1e-3  # one sigma of ln p at the lowest level

# What each day of lead time adds to the sigmas of a forecast: 2.7 K in all after five days.
FORECAST_K_PER_DAY = 0.5
FORECAST_RH_PER_DAY = 0.03
FORECAST_LOG_P_PER_DAY = 1e-3

# One sigma per metre of extension below the lowest level, as of a valley with an inversion.
EXTENSION_K_PER_M = 8e-3
EXTENSION_RH_PER_M = 2e-4

_EXTENSION_STEP_M = 100.0
_SMALLEST_EXTENSION_M = 20.0
_USUAL_STEP_M = 300.0  # between pressure levels 25 hPa apart

# A column ends at the higher of two heights, above the ground and above the highest camera. A
# higher end would make the knots of the estimate coarser.
_TOP_M = 10_000.0
_ABOVE_CAMERA_M = 2000.0

_THICKNESS_K = 10.0
"""Difference of the mean temperature of two levels from that by their heights, above which there is
a warning; ERA5 and columns of 22 soundings reach 5 K."""

_ANOTHER_GROUND_M = 50.0  # difference of the model's ground from the true one that is usual


@dataclass(frozen=True, eq=False)
class ColumnLevels:
    """Levels (l,) of a column from the ground up, with sigmas."""

    height: Array  # geopotential [m']
    temperature_k: Array
    vapour: Array  # e/p
    log_p: Array  # ln of the pressure in Pa
    sigma_k: Array  # of temperature
    sigma_rh: Array  # of relative humidity (0 to 1)


class Ends(NamedTuple):
    """Geopotential heights [m'] between which levels are used."""

    bottom: float
    top: float


def model_column(
    field: ModelField,
    place: tuple[float, float, int],
    *,
    ground_h_m: float,
    highest_h_m: float = 0.0,
) -> tuple[Sounding, Notes]:
    """The column of a model over a ``place``: latitude, longitude [rad] and time [Unix ns].

    ``ground_h_m``: height of the true ground [m above sea level], NaN if not known;
    ``highest_h_m``: of the highest camera. Levels under the model's or the true ground are left
    out. If the lowest of the others is more than 20 m above the true ground, the column is extended
    down to it, with growing sigmas. The time of the sounding is the nearest time of the file.
    Refuses (`InputError`) fewer than five levels.
    """
    latitude, longitude, time_ns = place
    notes: list[Message] = []
    gravity = normal_gravity(latitude)
    columns = field.columns(np.array([latitude]), np.array([longitude]), np.array([time_ns]))
    model_ground = float(columns.surface[0])
    ground = float(gravity.geopotential_height(ground_h_m))
    if math.isnan(ground):
        ground = 0.0 if math.isnan(model_ground) else model_ground
        notes.append(messages.model_ground(where=field.name, ground=ground))
    else:
        _refuse_ground_without_unit(field, model_ground, ground)
    ends = Ends(
        bottom=ground if math.isnan(model_ground) else max(model_ground, ground),
        top=max(
            ground + _TOP_M,
            float(gravity.geopotential_height(highest_h_m + _ABOVE_CAMERA_M)),
        ),
    )
    levels, left_out = _levels_between(_levels_of(columns, ground), ends, field.name)
    notes += left_out
    if field.height.size:  # else heights were computed from the temperatures
        notes += _thickness_notes(levels, field.name)

    depth = float(levels.height[0] - ground)
    if depth > _SMALLEST_EXTENSION_M:
        levels = _extended_down(levels, depth)
    if depth > _USUAL_STEP_M:
        notes.append(
            messages.model_extended(
                where=field.name,
                depth=depth,
                ground=ground,
                sigma=levels.sigma_k[0],
            )
        )
    pressure_pa = np.exp(levels.log_p)
    nearest = np.argmin(np.abs(field.time_ns - time_ns))
    column = Sounding(
        h_m=gravity.height(levels.height),
        pressure_pa=pressure_pa,
        temperature_k=levels.temperature_k,
        vapour_pressure_pa=levels.vapour * pressure_pa,
        time_ns=int(field.time_ns[nearest]),
        station=field.name,
        latitude_rad=latitude,
        longitude_rad=longitude,
        origin="column of fields",
        kind="weather model",
        errors=_column_errors(levels, max(depth, 0.0), _lead_days(field, time_ns)),
    )
    return column, tuple(notes)


def _levels_of(columns: ModelColumns, ground: float) -> ColumnLevels:
    """The levels of the first of ``columns`` from the ground up, NaN where the model has no air.

    ``ground``: its height [m'], above which the sigma of temperature falls with height.
    """
    height = columns.height[0, ::-1]
    sigma_k = np.interp(height - ground, [LOW_M, ALOFT_M], [LOW_K, ALOFT_K])
    return ColumnLevels(
        height=height,
        temperature_k=columns.temperature_k[0, ::-1],
        vapour=columns.vapour[0, ::-1],
        log_p=columns.log_pressure[0, ::-1],
        sigma_k=sigma_k,
        sigma_rh=np.full(height.size, HUMIDITY_RH),
    )


def _refuse_ground_without_unit(field: ModelField, model_ground: float, ground: float) -> None:
    """Refuse (InputError) a model's ground that fits the true one only in another unit.

    If the file states no unit, ``model_ground`` [m'] is its number divided by g, as if it were
    geopotential. It is refused if the number itself, as metres, fits ``ground`` [m'] much better.
    """
    if field.ground_has_unit:
        return
    metres = STANDARD_GRAVITY * model_ground
    if abs(model_ground - ground) > (_ANOTHER_GROUND_M + 2.0 * abs(metres - ground)):
        raise messages.model_units_ground(
            where=field.name,
            surface=model_ground,
            ground=ground,
            metres=metres,
        )


def _levels_between(
    levels: ColumnLevels,
    ends: Ends,
    where: str,
) -> tuple[ColumnLevels, list[Message]]:
    """The levels with air between two heights, and messages about levels that are left out.

    Refuses (InputError) fewer than five, or heights that do not rise from level to level.
    """
    notes: list[Message] = []
    height = levels.height
    has_air = np.isfinite(height + levels.temperature_k + levels.vapour)
    with np.errstate(invalid="ignore"):
        is_under = has_air & (height < ends.bottom)
        is_above = height >= ends.top
        used = has_air & ~is_under & (height < ends.top)
    underground = int(is_under.sum())
    if underground:
        note = messages.model_underground(where=where, count=underground, bottom=ends.bottom)
        notes.append(note)
    rises = bool(np.all(np.diff(height[used]) > 0.0))
    if used.sum() < FEWEST_LEVELS or not rises:
        raise too_few_levels(np.exp(levels.log_p[used]), where, "above the ground")
    # Levels without air have no height. Those below the first level above the top count as missing,
    # by their pressures; all do where no level is above the top.
    log_p_above = levels.log_p[has_air & is_above]
    first_log_p_above = log_p_above[0] if log_p_above.size else -math.inf
    missing = int((~has_air & (levels.log_p >= first_log_p_above)).sum())
    if missing:
        notes.append(messages.model_missing(where=where, count=missing, total=has_air.size))
    return part_of(levels, used), notes


def _thickness_notes(levels: ColumnLevels, where: str) -> list[Message]:
    """A warning about layers whose thickness implies another temperature than their levels have.

    It is about the worst layer; empty if none differs by more than 10 K.
    """
    virtual = levels.temperature_k / (1.0 - VAPOUR_DEFICIT * levels.vapour)
    mean = 0.5 * (virtual[1:] + virtual[:-1])
    rise = np.diff(levels.height)
    implied = -HYDROSTATIC_CONSTANT * rise / np.diff(levels.log_p)
    departure = np.abs(implied - mean)
    worst = int(np.argmax(departure))
    if not departure[worst] > _THICKNESS_K:
        return []
    lower_hpa, upper_hpa = np.exp(levels.log_p[worst : worst + 2]) / HECTOPASCAL
    note = messages.model_layer(
        where=where,
        lower=lower_hpa,
        upper=upper_hpa,
        mean=mean[worst],
        implied=implied[worst],
        count=int(np.sum(departure > _THICKNESS_K)),
    )
    return [note]


def _extended_down(levels: ColumnLevels, depth: float) -> ColumnLevels:
    """The levels, and below them further ones down to a ``depth`` [m'] under the lowest.

    e/p stays, temperature rises by 6.5 K/km, sigmas grow with the distance from the lowest level.
    """
    steps = math.ceil(depth / _EXTENSION_STEP_M)
    below = np.linspace(depth, 0.0, 1 + steps)[:-1]  # [m'] under the lowest, from the ground up
    lowest_k = levels.temperature_k[0]
    lowest_vapour = levels.vapour[0]
    warmer = lowest_k + EXTENSION_LAPSE * below
    # The hydrostatic equation with a constant lapse: p is a power of the temperature.
    exponent = HYDROSTATIC_CONSTANT * (1.0 - VAPOUR_DEFICIT * lowest_vapour) / EXTENSION_LAPSE
    log_p = levels.log_p[0] + exponent * np.log(warmer / lowest_k)
    sigma_k = np.hypot(levels.sigma_k[0], EXTENSION_K_PER_M * below)
    sigma_rh = np.hypot(HUMIDITY_RH, EXTENSION_RH_PER_M * below)
    return ColumnLevels(
        height=np.concatenate([levels.height[0] - below, levels.height]),
        temperature_k=np.concatenate([warmer, levels.temperature_k]),
        vapour=np.append(np.full(below.size, lowest_vapour), levels.vapour),
        log_p=np.concatenate([log_p, levels.log_p]),
        sigma_k=np.concatenate([sigma_k, levels.sigma_k]),
        sigma_rh=np.concatenate([sigma_rh, levels.sigma_rh]),
    )


def _lead_days(field: ModelField, time_ns: int) -> float:
    """Lead time of a field at a time [days since the forecast began]; 0 for an analysis."""
    if not field.lead_h.size:
        return 0.0
    lead_h = float(np.interp(time_ns, field.time_ns, field.lead_h))
    return lead_h / 24.0


def _column_errors(levels: ColumnLevels, depth: float, days: float) -> ColumnErrors:
    """The errors of a column: those of its levels and of ``days`` of forecast.

    ``depth`` [m'] is the part that was added under the lowest level of the model; an error of its
    lapse changes ln p at the ground.
    """
    lowest_k = float(levels.temperature_k[0])
    by_extension = HYDROSTATIC_CONSTANT * EXTENSION_K_PER_M * depth**2 / (2.0 * lowest_k**2)
    by_forecast = FORECAST_LOG_P_PER_DAY * days
    return ColumnErrors(
        temperature_k=np.hypot(levels.sigma_k, FORECAST_K_PER_DAY * days),
        relative_humidity=np.hypot(levels.sigma_rh, FORECAST_RH_PER_DAY * days),
        temperature_length_m=ERROR_LENGTH_M,
        humidity_length_m=ERROR_LENGTH_M,
        log_pressure=math.hypot(LEVEL_LOG_P, by_forecast, by_extension),
    )
