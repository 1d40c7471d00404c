"""The column of a weather model over a flight, taken as a sounding is.

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

# What a forecast adds with its lead time: 2.7 K after five days.
FORECAST_K_PER_DAY = 0.5
FORECAST_RH_PER_DAY = 0.03
FORECAST_LOG_P_PER_DAY = 1e-3

# What the lapse below the lowest level may be wrong by, in a valley with an inversion.
EXTENSION_K_PER_M = 8e-3
EXTENSION_RH_PER_M = 2e-4

_EXTENSION_STEP_M = 100.0
_SMALLEST_EXTENSION_M = 20.0
_USUAL_STEP_M = 300.0  # between pressure levels 25 hPa apart

# A column ends so far above the ground, or above the highest camera: knots of the estimate stay
# fine.
_TOP_M = 10_000.0
_ABOVE_CAMERA_M = 2000.0

_THICKNESS_K = 10.0
"""From the mean temperature of two levels to what their heights imply; ERA5 and columns of 22
soundings reach 5 K."""

_ANOTHER_GROUND_M = 50.0  # the model's ground beside the true one, before its unit is doubted


@dataclass(frozen=True, eq=False)
class ColumnLevels:
    """Levels (l,) from the ground up: height [m'], temperature [K], e/p and ln p, with sigmas."""

    height: Array
    temperature_k: Array
    vapour: Array
    log_p: Array
    sigma_k: Array
    sigma_rh: Array


class Ends(NamedTuple):
    """Between which geopotential heights [m'] levels are used."""

    bottom: float
    top: float


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
    if field.height.size:  # which heights of model levels are not
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
    """The levels of a single column from the ground up, NaN where the model has no air."""
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
    """Refuse a model's ground, of no stated unit, that fits the true one [m'] in metres only."""
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
    """The levels with air between two heights, at least five that rise; others are noted."""
    notes: list[Message] = []
    height = levels.height
    has_air = np.isfinite(height + levels.temperature_k + levels.vapour)
    with np.errstate(invalid="ignore"):
        under = has_air & (height < ends.bottom)
        is_above = height >= ends.top
        used = has_air & ~under & (height < ends.top)
    underground = int(under.sum())
    if underground:
        note = messages.model_underground(where=where, count=underground, bottom=ends.bottom)
        notes.append(note)
    rises = bool(np.all(np.diff(height[used]) > 0.0))
    if used.sum() < FEWEST_LEVELS or not rises:
        raise too_few_levels(np.exp(levels.log_p[used]), where, "above the ground")
    # Levels without air are missing below the top; without a level above it any may be.
    log_p_above = levels.log_p[has_air & is_above]
    top_log_p = log_p_above[0] if log_p_above.size else -math.inf
    missing = int((~has_air & (levels.log_p >= top_log_p)).sum())
    if missing:
        notes.append(messages.model_missing(where=where, count=missing, total=has_air.size))
    return part_of(levels, used), notes


def _thickness_notes(levels: ColumnLevels, where: str) -> list[Message]:
    """Layers whose heights imply another temperature than their levels have, if there are any."""
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
    """Levels that go on down by a depth [m'] in mixed air: e/p stays, sigmas grow."""
    steps = math.ceil(depth / _EXTENSION_STEP_M)
    below = np.linspace(depth, 0.0, 1 + steps)[:-1]  # [m'] under the lowest, from the ground up
    lowest_k = levels.temperature_k[0]
    lowest_vapour = levels.vapour[0]
    warmer = lowest_k + EXTENSION_LAPSE * below
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
    """Days since the forecast began, 0 of an analysis."""
    if not field.lead_h.size:
        return 0.0
    lead_h = float(np.interp(time_ns, field.time_ns, field.lead_h))
    return lead_h / 24.0


def _column_errors(levels: ColumnLevels, depth: float, days: float) -> ColumnErrors:
    """The errors of a column that was extended down by a depth [m'], after days of forecast."""
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
