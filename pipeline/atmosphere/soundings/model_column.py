"""The air of a flight by a weather model: its column at a place and time, as a sounding is taken.

Its errors are those of a good analysis. Against radiosondes ERA5 departs by about 1 K in the free
troposphere and up to 2 K in the lowest kilometre, and by 10 to 15 % in relative humidity (Hersbach
et al. 2020, Q. J. R. Meteorol. Soc. 146, sections 5 and 6; Graham et al. 2019, Geophys. Res. Lett.
46, p. 6138); the correlation over 2 km of height, and how a forecast ages, are set by judgement.
"""

import math

import numpy as np

from pipeline.atmosphere.soundings.level_checks import FEWEST_LEVELS
from pipeline.atmosphere.soundings.levels import ColumnErrors, Sounding
from pipeline.atmosphere.soundings.model_field import ModelField
from pipeline.errors import InputError
from pipeline.geodesy import normal_gravity
from pipeline.ledger import Entry, Notes, fallback, note
from pipeline.units import HECTOPASCAL, HYDROSTATIC_CONSTANT, VAPOUR_DEFICIT, Array

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
    where the lowest level is more than 20 m above the true ground the column goes on down to it,
    with growing sigma. Refuses (`InputError`) fewer than five levels (MODEL-LEVELS). Its time is
    the file's nearest to the flight.
    """
    latitude, longitude, time_ns = place
    where = field.name
    notes: list[Entry] = []
    gravity = normal_gravity(latitude)
    air = field.columns(np.array([latitude]), np.array([longitude]), np.array([time_ns]))
    height, t, vapour = (a[0, ::-1] for a in (air.height, air.temperature_k, air.vapour))
    log_p, surface = air.log_pressure[0, ::-1], float(air.surface[0])
    known = np.isfinite(height + t + vapour)
    ground = float(gravity.geopotential_height(ground_h_m))
    if math.isnan(ground):
        ground = 0.0 if math.isnan(surface) else surface
        notes.append(fallback("MODEL-GROUND", where=where, ground=ground))
    bottom = ground if math.isnan(surface) else max(surface, ground)
    with np.errstate(invalid="ignore"):
        under = known & (height < bottom)
        highest = float(gravity.geopotential_height(highest_h_m + _ABOVE_CAMERA_M))
        top = max(ground + _TOP_M, highest)
        used = known & ~under & (height < top)
    if count := int(under.sum()):
        notes.append(note("MODEL-UNDERGROUND", where=where, count=count, bottom=bottom))
    if used.sum() < FEWEST_LEVELS or bool(np.any(np.diff(height[used]) <= 0.0)):
        raise too_few_levels(np.exp(log_p[used]), where, "above the ground")
    above = log_p[known & (height >= top)]  # none: what is missing may have been the top
    if missing := int((~known & (log_p >= above[:1].max(initial=-math.inf))).sum()):
        notes.append(fallback("MODEL-MISSING", where=where, count=missing, total=known.size))
    height, t, vapour, log_p = height[used], t[used], vapour[used], log_p[used]
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
            notes.append(fallback(
                "MODEL-EXTENDED", where=where, depth=depth, ground=ground, sigma=sigma[0]
            ))  # fmt: skip
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
    return InputError.of(
        "MODEL-LEVELS", where, total=pressure_pa.size, which=which, listed=listed,
        fewest=FEWEST_LEVELS,
    )  # fmt: skip
