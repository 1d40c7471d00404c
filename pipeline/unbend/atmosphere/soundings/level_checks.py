"""From the levels of a file to a `Sounding`: refusals, and repairs that are counted.

Units that cannot be what the file states are refused, as a silent repair may be wrong. Air that is
unusual but physical (steep layers, an index that grows with height) is kept, and reported.
"""

import math
from dataclasses import replace

import numpy as np

from unbend.atmosphere import refractive_index
from unbend.atmosphere.air_samples import part_of
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.layer_checks import layer_notes
from unbend.atmosphere.soundings.levels import RawLevels, Sounding
from unbend.geodesy import normal_gravity
from unbend.messages import Notes
from unbend.units import DEGREE, HECTOPASCAL, HYDROSTATIC_CONSTANT, ZERO_CELSIUS_K, Array, Mask

FEWEST_LEVELS = 5
"""With fewer a sounding has less information than the climatology and a surface report."""

COLDEST_K, WARMEST_K, HIGHEST_PA = 150.0, 340.0, 110_000.0
"""What levels of soundings and of weather models have, from the ground to the stratosphere."""

TOO_WET, MOST_TOO_WET = 1.5, 0.2
"""A relative humidity that no air has, and the share of levels that may have it by mistake."""

DRIEST_RH = 0.011  # relative humidities that reach no more are dead, or per cent of per cent

THICKNESS_RATIO = 0.03
"""Heights and the pressures and temperatures they were computed from agree within this share."""

_UNKNOWN_LATITUDE_RAD = 45.0 * DEGREE

# No sounding begins above 25 km, nor below the Dead Sea.
_DEW_POINT_K = (150.0, 333.0)  # of any air, from the stratosphere to the Persian Gulf
_MAX_VAPOUR_PA = 10_000.0  # 46 C of dew point
_GROUND_PA = (2_500.0, HIGHEST_PA)
# The warmest level of a sounding: air below -75 C or above 60 C is nowhere near the ground.
_WARMEST_LEVEL_K = (198.0, 333.0)

_FILLS_C = np.array([-99.0, -99.9, -99.99])  # of files of temperatures, none of which is so cold

WILD = 0.05  # share of a column that may be invalid without the rest being refused


def check_levels(
    raw: RawLevels, *, latitude_rad: float = math.nan, station_h_m: float = math.nan
) -> tuple[Sounding, Notes]:
    """Levels from the ground up, one at a height, from those of a file in its order.

    ``latitude_rad``: of the mission [rad], used where the file has none. ``station_h_m``: height of
    the lowest level [m above sea level], where the file has no heights. Raises ``InputError`` where
    units are wrong, heights are missing or contradict pressure and temperature, or fewer than five
    levels are left. Geopotential metres become metres with Lambert's gravity at the latitude;
    ignoring it would cost up to 30 m at 10 km.
    """
    refuse_wrong_units(raw)
    latitude = raw.latitude_rad if math.isfinite(raw.latitude_rad) else latitude_rad
    if not math.isfinite(latitude):
        raw = raw.noting(messages.sounding_latitude(where=raw.where))
        latitude = _UNKNOWN_LATITUDE_RAD
    gravity = normal_gravity(latitude)
    if not raw.geopotential:
        raw = replace(raw, h_m=gravity.geopotential_height(raw.h_m), geopotential=True)
    raw = _with_vapour_pressure(_complete_levels(raw))
    raw = _with_heights(raw, float(gravity.geopotential_height(station_h_m)))
    raw = _rising_levels(raw)
    sounding = Sounding(
        h_m=gravity.height(raw.h_m),
        pressure_pa=raw.pressure_pa,
        temperature_k=raw.temperature_k,
        vapour_pressure_pa=_vapour(raw),
        time_ns=raw.time_ns,
        station=raw.station,
        latitude_rad=raw.latitude_rad,
        longitude_rad=raw.longitude_rad,
        origin=raw.origin,
    )
    return sounding, (*raw.notes, *layer_notes(sounding, raw.where))


def refuse_wrong_units(raw: RawLevels) -> None:
    """Refuse pressures, temperatures or humidities whose largest values no ground has."""
    pressure_pa = _largest(raw.pressure_pa)
    if pressure_pa is not None and not _GROUND_PA[0] <= pressure_pa <= _GROUND_PA[1]:
        raise messages.sounding_pressure_unit(
            **_where_stated(raw, "pressure"),
            highest_pa=pressure_pa,
            likely=_likely_pressure(pressure_pa),
        )
    temperature_k = _largest(raw.temperature_k)
    if (
        temperature_k is not None
        and not _WARMEST_LEVEL_K[0] <= temperature_k <= _WARMEST_LEVEL_K[1]
    ):
        raise messages.sounding_temperature_unit(
            **_where_stated(raw, "temperature"),
            warmest_k=temperature_k,
            likely=_likely_temperature(temperature_k),
        )
    dew_point_k = None if raw.dew_point_k is None else _largest(raw.dew_point_k)
    if dew_point_k is not None and not _DEW_POINT_K[0] <= dew_point_k <= _DEW_POINT_K[1]:
        raise messages.sounding_dew_point_unit(
            **_where_stated(raw, "dew point"), highest_k=dew_point_k
        )
    humidity = None if raw.relative_humidity is None else _largest(raw.relative_humidity)
    # Sensors read up to 1.1 in cloud. All of a sounding below 1 % does not happen: the lowest
    # kilometre holds more, even over deserts.
    if humidity is not None and (humidity > TOO_WET or humidity <= DRIEST_RH):
        raise messages.sounding_humidity_unit(
            **_where_stated(raw, "relative humidity"), highest=humidity
        )
    vapour_pa = None if raw.vapour_pressure_pa is None else _largest(raw.vapour_pressure_pa)
    if vapour_pa is not None and vapour_pa > _MAX_VAPOUR_PA:
        raise messages.sounding_vapour_unit(
            **_where_stated(raw, "vapour pressure"), highest_pa=vapour_pa
        )


def _where_stated(raw: RawLevels, quantity: str) -> dict[str, str]:
    """The file and the column, if any, that a quantity comes from."""
    return {"where": raw.where, "column": raw.column_of.get(quantity, "")}


def _likely_pressure(pressure_pa: float) -> str:
    """What a highest pressure that no ground has may be."""
    if _GROUND_PA[0] <= pressure_pa * HECTOPASCAL <= _GROUND_PA[1]:
        return "they look like hPa where Pa is stated"
    if _GROUND_PA[0] <= pressure_pa / HECTOPASCAL <= _GROUND_PA[1]:
        return "they look like Pa where hPa is stated"
    return "this does not occur near the ground"


def _likely_temperature(warmest_k: float) -> str:
    """What a warmest level that no air has may be."""
    if warmest_k < 80.0:
        return "they look like Celsius where Kelvin is stated"
    if warmest_k > 198.0 + ZERO_CELSIUS_K:
        return "they look like Kelvin where Celsius is stated"
    if warmest_k > _WARMEST_LEVEL_K[1]:
        return "they look like Fahrenheit"
    return "that is too cold for the warmest level of a sounding"


def refuse_wrong_heights(raw: RawLevels, h: Array, rise: Array) -> None:
    """Refuse heights ``h`` (n,) [m'] that are not those by the hypsometric equation, ``rise``.

    A balloon's heights are computed by it and agree to 0.05 %; feet, Fahrenheit or another
    balloon's heights do not. A single wrong level does not move the median.
    """
    apart = max(1, h.size // 4)
    far = rise[apart:] - rise[:-apart]
    thick = far > 10.0
    if not bool(thick.any()):
        return
    ratio = float(np.median((h[apart:] - h[:-apart])[thick] / far[thick]))
    if abs(ratio - 1.0) > THICKNESS_RATIO:
        raise messages.sounding_inconsistent(where=raw.where, ratio=ratio)


def _largest(column: Array) -> float | None:
    """The largest value but for one in twenty: an outlier is no matter of units."""
    known = column[np.isfinite(column)]
    return float(np.quantile(known, 1.0 - WILD, method="lower")) if known.size else None


def _refuse_few(raw: RawLevels) -> RawLevels:
    count = raw.pressure_pa.size
    if count < FEWEST_LEVELS:
        raise messages.sounding_levels(where=raw.where, count=count, fewest=FEWEST_LEVELS)
    return raw


def _complete_levels(raw: RawLevels) -> RawLevels:
    """The levels with possible pressure and temperature, by falling pressure."""
    p, t = raw.pressure_pa, raw.temperature_k
    has = np.isfinite(p) & np.isfinite(t) & ~_is_fill(t)
    possible = (p > 0.0) & (p <= HIGHEST_PA) & (t >= COLDEST_K) & (t <= WARMEST_K)
    if missing := int((~has).sum()):
        raw = raw.noting(messages.sounding_missing(where=raw.where, count=missing, total=p.size))
    if (wrong := np.flatnonzero(has & ~possible)).size:
        hpa, kelvin, count = p[wrong[0]] / HECTOPASCAL, t[wrong[0]], int(wrong.size)
        raw = raw.noting(
            messages.sounding_range(where=raw.where, count=count, hpa=hpa, kelvin=kelvin)
        )
    raw = _refuse_few(part_of(raw, has & possible))
    if up := int((np.diff(raw.pressure_pa) > 0.0).sum()):
        raw = part_of(raw, np.argsort(-raw.pressure_pa, kind="stable"))
        raw = raw.noting(messages.sounding_unsorted(where=raw.where, count=up))
    return raw


def _is_fill(kelvin: Array) -> Mask:
    """Which temperatures or dew points are -99.9 C and the like: numbers for a missing value."""
    return np.asarray(np.any(np.abs(kelvin[:, None] - ZERO_CELSIUS_K - _FILLS_C) < 1e-6, axis=1))


def _with_vapour_pressure(raw: RawLevels) -> RawLevels:
    """Vapour pressure [Pa] from what there is, at most saturation over water; NaN if nothing."""
    t, p, e, where = raw.temperature_k, raw.pressure_pa, _vapour(raw).copy(), raw.where
    if raw.dew_point_k is not None:
        dew = np.where(_is_fill(raw.dew_point_k), np.nan, raw.dew_point_k)
        impossible = np.isfinite(dew) & ~((dew >= COLDEST_K) & (dew <= WARMEST_K))
        if count := int(impossible.sum()):
            first = dew[impossible][0]
            raw = raw.noting(
                messages.sounding_humidity_range(where=where, count=count, first=first)
            )
        dew = np.where(impossible, np.nan, dew)
        e = np.where(np.isfinite(e), e, vapour_pressure(1.0, dew, p))
    if raw.relative_humidity is not None:
        e = np.where(np.isfinite(e), e, vapour_pressure(raw.relative_humidity, t, p))
    negative = np.isfinite(e) & (e < 0.0)
    if count := int(negative.sum()):
        raw = raw.noting(messages.sounding_humidity_negative(where=where, count=count))
        e[negative] = np.nan
    saturated = vapour_pressure(1.0, t, p)
    # A rounded dew point, 0.05 K of it, may pass saturation by 0.4 %: not reported.
    over = np.isfinite(e) & (e > saturated * 1.005)
    if count := int(over.sum()):
        percent = 100.0 * np.max(e[over] / saturated[over])
        wet = float(np.mean(e[np.isfinite(e)] > TOO_WET * saturated[np.isfinite(e)]))
        if wet > MOST_TOO_WET:
            quantity = "dew point" if raw.dew_point_k is not None else "relative humidity"
            raise messages.sounding_too_wet(
                **_where_stated(raw, quantity),
                quantity=quantity,
                percent=100.0 * wet,
                limit_percent=100.0 * TOO_WET,
            )
        raw = raw.noting(messages.sounding_humidity_over(where=where, count=count, percent=percent))
    return replace(raw, vapour_pressure_pa=np.minimum(e, saturated))


def _with_heights(raw: RawLevels, start: float) -> RawLevels:
    """Geopotential heights [m'], computed where the file has none; ``start`` of the lowest."""
    h = raw.h_m.copy()
    # Hypsometric height of each level above the first, by trapezoids in ln p.
    virtual = refractive_index.virtual_temperature(
        raw.temperature_k, raw.pressure_pa, np.nan_to_num(_vapour(raw))
    )
    fall = -np.diff(np.log(raw.pressure_pa))
    steps = 0.5 * (virtual[1:] + virtual[:-1]) * fall / HYDROSTATIC_CONSTANT
    rise = np.concatenate([[0.0], np.cumsum(steps)])
    if not bool(np.isfinite(h).any()):
        if not math.isfinite(start):
            raise messages.sounding_height(where=raw.where, total=h.size)
        h[0] = start
    known = np.isfinite(h)
    refuse_wrong_heights(raw, h[known], rise[known])
    if count := int((~known).sum()):
        raw = raw.noting(messages.sounding_heights(where=raw.where, count=count))
        # The departure of the reported heights from the hypsometric ones, carried to the gaps.
        h = np.where(known, h, rise + np.interp(rise, rise[known], (h - rise)[known]))
    return replace(raw, h_m=h)


def _rising_levels(raw: RawLevels) -> RawLevels:
    """Means of levels of one pressure or one height, without the fewest levels whose removal lets
    height rise as pressure falls."""
    before, raw = raw.pressure_pa.size, _mean_of_runs(raw, raw.pressure_pa)
    # Centimetres: rounding in a conversion does not make two heights different.
    raw = _mean_of_runs(raw, np.round(raw.h_m, 2))
    if merged := before - raw.pressure_pa.size:
        raw = raw.noting(messages.sounding_duplicate(where=raw.where, count=merged))
    # The longest strictly increasing subsequence of heights, by patience sorting.
    tails: list[int] = []
    before_it = np.full(raw.h_m.size, -1, dtype=np.intp)
    for i, value in enumerate(raw.h_m):
        place = int(np.searchsorted(raw.h_m[tails], value)) if tails else 0
        before_it[i] = tails[place - 1] if place else -1
        tails[place : place + 1] = [i]
    chain = tails[-1:]
    while chain and before_it[chain[-1]] >= 0:
        chain.append(int(before_it[chain[-1]]))
    keep = np.array(chain[::-1], dtype=np.intp)
    if (out := np.setdiff1d(np.arange(raw.h_m.size), keep)).size:
        h, hpa = raw.h_m[out[0]], raw.pressure_pa[out[0]] / HECTOPASCAL
        raw = raw.noting(
            messages.sounding_order(where=raw.where, count=out.size, height_m=h, hpa=hpa)
        )
    return _refuse_few(part_of(raw, keep))


def _mean_of_runs(raw: RawLevels, key: Array) -> RawLevels:
    """Means over runs of equal neighbours; of humidity over the levels that have it."""
    number = np.concatenate([[0], np.cumsum(np.diff(key) != 0.0)])
    if number[-1] == key.size - 1:
        return raw

    def mean(column: Array) -> Array:
        known = np.isfinite(column)
        total = np.bincount(number, np.where(known, column, 0.0))
        count = np.bincount(number, known.astype(np.float64))
        return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)

    return replace(
        raw,
        h_m=mean(raw.h_m),
        pressure_pa=mean(raw.pressure_pa),
        temperature_k=mean(raw.temperature_k),
        vapour_pressure_pa=mean(_vapour(raw)),
        dew_point_k=None,
        relative_humidity=None,
    )


def _vapour(raw: RawLevels) -> Array:
    e = raw.vapour_pressure_pa
    return np.full(raw.pressure_pa.shape, np.nan) if e is None else e
