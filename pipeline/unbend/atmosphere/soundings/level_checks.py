"""From the levels of a file to a `Sounding`: refusals, and repairs that are counted.

Units that cannot be what the file states are refused, as a silent repair may be wrong. Air that is
unusual but physical (steep layers, an index that grows with height) is kept, and reported.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from unbend.atmosphere import refractive_index
from unbend.atmosphere.air_samples import part_of
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.layer_checks import layer_notes
from unbend.atmosphere.soundings.levels import RawLevels, Sounding
from unbend.geodesy import normal_gravity
from unbend.messages import Notes
from unbend.units import (
    DEGREE,
    HECTOPASCAL,
    HYDROSTATIC_CONSTANT,
    ZERO_CELSIUS_K,
    Array,
    Mask,
    Rows,
)

FEWEST_LEVELS = 5
"""With fewer a sounding has less information than the climatology and a surface report."""

# What levels of soundings and of weather models have, from the ground to the stratosphere.
COLDEST_K = 150.0
WARMEST_K = 340.0
LOWEST_PA = 0.01  # at 110 km, above all rockets and models
HIGHEST_PA = 110_000.0

TOO_WET = 1.5  # a relative humidity that no air has
MOST_TOO_WET = 0.2  # share of levels that may have it by mistake

DEW_POINT_ABOVE_K = 1.0  # above the temperature: more than rounding, and sensors in cloud, make
MOST_LEVELS = 0.5  # share of levels with such dew points above which the column is wrong
NEARLY_ALL_LEVELS = 0.95  # share of levels that an explanation of the wrong column must fit

DRIEST_RH = 0.011  # a sensor that reads no more is dead, or its percent were divided by 100 twice

THICKNESS_RATIO = 0.03
"""Heights and the pressures and temperatures they were computed from agree within this share."""

_UNKNOWN_LATITUDE_RAD = 45.0 * DEGREE


class _Range(NamedTuple):
    """The lowest and the highest value that a quantity can have."""

    lowest: float
    highest: float

    def has(self, value: float) -> bool:
        """Whether a value is possible."""
        return self.lowest <= value <= self.highest


_DEW_POINT_K = _Range(150.0, 333.0)  # of any air, from the stratosphere to the Persian Gulf
_GROUND_PA = _Range(2_500.0, HIGHEST_PA)  # of the lowest level: from the Dead Sea up to 25 km
# Of the warmest level of a sounding: near the ground no air is below -75 C or above 60 C.
_WARMEST_LEVEL_K = _Range(198.0, 333.0)
_MAX_VAPOUR_PA = 10_000.0  # 46 C of dew point

_ROUNDED_DEW_POINT = 1.005
"""Ratio of vapour pressure to saturation that is not reported yet: rounding a dew point by 0.05 K
changes it by 0.4 %."""

_FILLS_C = np.array([-99.0, -99.9, -99.99])  # mark missing temperatures; no level is so cold

OUTLIER_SHARE = 0.05  # of the values of a column, which are ignored in a check of its unit


def check_levels(
    raw: RawLevels, *, latitude_rad: float = math.nan, station_h_m: float = math.nan
) -> tuple[Sounding, Notes]:
    """The sounding with the valid levels of a file, from the ground up, and messages about repairs.

    ``latitude_rad``: of the mission, used where the file has none. ``station_h_m``: height of the
    lowest level [m above sea level], used where the file has no heights. Raises ``InputError``
    where units are wrong, heights are missing or contradict pressure and temperature, or fewer than
    five levels remain. Geopotential heights become heights in metres with normal gravity at the
    latitude; without it they would be wrong by up to 30 m at 10 km.
    """
    refuse_wrong_units(raw)
    latitude = raw.latitude_rad if math.isfinite(raw.latitude_rad) else latitude_rad
    if not math.isfinite(latitude):
        raw = raw.noting(messages.sounding_latitude(where=raw.where))
        latitude = _UNKNOWN_LATITUDE_RAD
    gravity = normal_gravity(latitude)
    if not raw.geopotential:
        height = gravity.geopotential_height(raw.h_m)
        raw = replace(raw, h_m=height, geopotential=True)
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
    """Refuse (InputError) a column if its largest values do not occur near the ground.

    Then its unit is not what the file states. Columns are pressure, temperature and humidities.
    """
    pressure_pa = _largest(raw.pressure_pa)
    if pressure_pa is not None and not _GROUND_PA.has(pressure_pa):
        raise messages.sounding_pressure_unit(
            **_where_stated(raw, "pressure"),
            highest_pa=pressure_pa,
            likely=_likely_pressure(pressure_pa),
        )
    temperature_k = _largest(raw.temperature_k)
    if temperature_k is not None and not _WARMEST_LEVEL_K.has(temperature_k):
        raise messages.sounding_temperature_unit(
            **_where_stated(raw, "temperature"),
            warmest_k=temperature_k,
            likely=_likely_temperature(temperature_k),
        )
    dew_point_k = _largest(raw.dew_point_k)
    if dew_point_k is not None and not _DEW_POINT_K.has(dew_point_k):
        raise messages.sounding_dew_point_unit(
            **_where_stated(raw, "dew point"),
            highest_k=dew_point_k,
        )
    humidity = _largest(raw.relative_humidity)
    # Sensors read up to 1.1 in cloud. No sounding is below 1 % at all levels: the lowest kilometre
    # has more, even over deserts.
    if humidity is not None and (humidity > TOO_WET or humidity <= DRIEST_RH):
        raise messages.sounding_humidity_unit(
            **_where_stated(raw, "relative humidity"),
            highest=humidity,
        )
    vapour_pa = _largest(raw.vapour_pressure_pa)
    if vapour_pa is not None and vapour_pa > _MAX_VAPOUR_PA:
        raise messages.sounding_vapour_unit(
            **_where_stated(raw, "vapour pressure"),
            highest_pa=vapour_pa,
        )


def _where_stated(raw: RawLevels, quantity: str) -> dict[str, str]:
    """Arguments of messages: the file and the name of the column of a quantity, "" if unknown."""
    return {"where": raw.where, "column": raw.column_of.get(quantity, "")}


def _likely_pressure(pressure_pa: float) -> str:
    """Explanation of a highest pressure that does not occur near the ground, for a message."""
    if _GROUND_PA.has(pressure_pa * HECTOPASCAL):
        return "they look like hPa where Pa is stated"
    if _GROUND_PA.has(pressure_pa / HECTOPASCAL):
        return "they look like Pa where hPa is stated"
    return "this does not occur near the ground"


def _likely_temperature(warmest_k: float) -> str:
    """Explanation of an impossible temperature of the warmest level, for a message."""
    if warmest_k < 80.0:
        return "they look like Celsius where Kelvin is stated"
    if warmest_k > _WARMEST_LEVEL_K.lowest + ZERO_CELSIUS_K:
        return "they look like Kelvin where Celsius is stated"
    if warmest_k > _WARMEST_LEVEL_K.highest:
        return "they look like Fahrenheit"
    return "that is too cold for the warmest level of a sounding"


def refuse_wrong_heights(raw: RawLevels, h: Array, rise: Array) -> None:
    """Refuse (InputError) heights that contradict pressures and temperatures.

    ``h`` (n,) are the heights of the file, ``rise`` (n,) those above the first level by the
    hypsometric equation [m']. The heights of a balloon are computed by this equation and agree to
    0.05 %; feet, Fahrenheit or another balloon's heights do not. The thicknesses of layers are
    compared by their median ratio, which a single wrong level does not change.
    """
    apart = max(1, h.size // 4)  # levels from the base to the top of a layer
    hypsometric_m = rise[apart:] - rise[:-apart]
    stated_m = h[apart:] - h[:-apart]
    is_thick = hypsometric_m > 10.0
    if not bool(is_thick.any()):
        return
    ratio = float(np.median(stated_m[is_thick] / hypsometric_m[is_thick]))
    if abs(ratio - 1.0) > THICKNESS_RATIO:
        raise messages.sounding_inconsistent(where=raw.where, ratio=ratio)


def _largest(column: Array | None) -> float | None:
    """The largest value after the highest twentieth is ignored as outliers; None without values."""
    if column is None:
        return None
    values = column[np.isfinite(column)]
    if not values.size:
        return None
    return float(np.quantile(values, 1.0 - OUTLIER_SHARE, method="lower"))


def _refuse_few(raw: RawLevels) -> RawLevels:
    """The levels themselves; refuses (InputError) fewer than five."""
    count = raw.pressure_pa.size
    if count < FEWEST_LEVELS:
        raise messages.sounding_levels(where=raw.where, count=count, fewest=FEWEST_LEVELS)
    return raw


def _complete_levels(raw: RawLevels) -> RawLevels:
    """The levels with a possible pressure and temperature, by falling pressure.

    Levels that are left out, and levels out of order, are noted. Refuses (InputError) fewer than
    five.
    """
    p = raw.pressure_pa
    t = raw.temperature_k
    has_both = np.isfinite(p) & np.isfinite(t) & ~_is_fill(t)
    is_pressure = (p >= LOWEST_PA) & (p <= HIGHEST_PA)
    is_temperature = (t >= COLDEST_K) & (t <= WARMEST_K)
    is_possible = is_pressure & is_temperature
    missing = int((~has_both).sum())
    if missing:
        raw = raw.noting(messages.sounding_missing(where=raw.where, count=missing, total=p.size))
    wrong = np.flatnonzero(has_both & ~is_possible)
    if wrong.size:
        first = wrong[0]
        note = messages.sounding_range(
            where=raw.where,
            count=int(wrong.size),
            hpa=p[first] / HECTOPASCAL,
            kelvin=t[first],
        )
        raw = raw.noting(note)
    raw = _refuse_few(part_of(raw, has_both & is_possible))
    rises = int((np.diff(raw.pressure_pa) > 0.0).sum())
    if rises:
        raw = part_of(raw, np.argsort(-raw.pressure_pa, kind="stable"))
        raw = raw.noting(messages.sounding_unsorted(where=raw.where, count=rises))
    return raw


def _is_fill(kelvin: Array) -> Mask:
    """Mask of temperatures or dew points that mark a missing value, as -99.9 C (see `_FILLS_C`)."""
    departure = np.abs(kelvin[:, None] - ZERO_CELSIUS_K - _FILLS_C)
    return np.asarray(np.any(departure < 1e-6, axis=1))


def _with_vapour_pressure(raw: RawLevels) -> RawLevels:
    """The levels with vapour pressure, at most that of saturation over water; NaN where unknown.

    At each level it is that of the file, else by the dew point, else by the relative humidity.
    Impossible humidities are noted, or refused (InputError) if many.
    """
    t = raw.temperature_k
    p = raw.pressure_pa
    e = _vapour(raw).copy()
    if raw.dew_point_k is not None:
        raw, dew_point_k = _possible_dew_points(raw, raw.dew_point_k)
        _refuse_exchanged(raw, dew_point_k)
        e = np.where(np.isfinite(e), e, vapour_pressure(1.0, dew_point_k, p))
    if raw.relative_humidity is not None:
        e = np.where(np.isfinite(e), e, vapour_pressure(raw.relative_humidity, t, p))
    is_negative = np.isfinite(e) & (e < 0.0)
    negative = int(is_negative.sum())
    if negative:
        raw = raw.noting(messages.sounding_humidity_negative(where=raw.where, count=negative))
        e[is_negative] = np.nan
    saturated = vapour_pressure(1.0, t, p)
    is_over = np.isfinite(e) & (e > saturated * _ROUNDED_DEW_POINT)
    over = int(is_over.sum())
    if over:
        _refuse_too_wet(raw, e, saturated)
        wettest = np.max(e[is_over] / saturated[is_over])
        note = messages.sounding_humidity_over(
            where=raw.where,
            count=over,
            percent=100.0 * wettest,
        )
        raw = raw.noting(note)
    return replace(raw, vapour_pressure_pa=np.minimum(e, saturated))


def _possible_dew_points(raw: RawLevels, dew_point_k: Array) -> tuple[RawLevels, Array]:
    """The levels with a note about impossible dew points, and the dew points, NaN for these."""
    dew = np.where(_is_fill(dew_point_k), np.nan, dew_point_k)
    is_possible = (dew >= COLDEST_K) & (dew <= WARMEST_K)
    is_wrong = np.isfinite(dew) & ~is_possible
    wrong = int(is_wrong.sum())
    if wrong:
        note = messages.sounding_humidity_range(
            where=raw.where,
            count=wrong,
            first=dew[is_wrong][0],
        )
        raw = raw.noting(note)
    return raw, np.where(is_wrong, np.nan, dew)


def _refuse_exchanged(raw: RawLevels, dew_point_k: Array) -> None:
    """Refuse (InputError) dew points and temperatures that are exchanged.

    Then the dew points [K] are above the temperatures in most levels, and below in hardly any.
    Depressions of the dew point in place of dew points are above temperatures below freezing too:
    these, which are never negative in degC and do not fall with height, are left to
    `_refuse_too_wet`.
    """
    above_k = dew_point_k - raw.temperature_k
    is_known = np.isfinite(above_k)
    if not bool(is_known.any()):
        return
    share_far_above = float(np.mean(above_k[is_known] > DEW_POINT_ABOVE_K))
    share_not_below = float(np.mean(above_k[is_known] >= 0.0))
    if share_far_above <= MOST_LEVELS or share_not_below < NEARLY_ALL_LEVELS:
        return
    upward_k = dew_point_k[is_known]  # from the ground up
    is_never_negative = upward_k.min() >= ZERO_CELSIUS_K
    falls = upward_k[0] > upward_k[-1]
    are_depressions = is_never_negative and not falls
    if are_depressions:
        return
    raise messages.sounding_dew_points_exchanged(
        **_where_stated(raw, "dew point"),
        percent=100.0 * float(np.mean(above_k[is_known] > 0.0)),
    )


def _refuse_too_wet(raw: RawLevels, e: Array, saturated: Array) -> None:
    """Refuse (InputError) levels if more than a fifth have more than 150 % relative humidity.

    ``e`` (n,) are vapour pressures, NaN where unknown, ``saturated`` (n,) those of saturation [Pa].
    """
    has_humidity = np.isfinite(e)
    is_too_wet = e[has_humidity] > TOO_WET * saturated[has_humidity]
    share = float(np.mean(is_too_wet))
    if share <= MOST_TOO_WET:
        return
    quantity = "dew point" if raw.dew_point_k is not None else "relative humidity"
    raise messages.sounding_too_wet(
        **_where_stated(raw, quantity),
        quantity=quantity,
        percent=100.0 * share,
        limit_percent=100.0 * TOO_WET,
    )


def _with_heights(raw: RawLevels, lowest_h: float) -> RawLevels:
    """The levels with geopotential heights, computed by the hypsometric equation where missing.

    ``lowest_h`` [m'] is the height of the lowest level if the file has no height at all. Refuses
    (InputError) levels without any height, and heights that contradict pressure and temperature.
    """
    h = raw.h_m.copy()
    rise = _hypsometric_rise(raw)
    if not bool(np.isfinite(h).any()):
        if not math.isfinite(lowest_h):
            raise messages.sounding_height(where=raw.where, total=h.size)
        h[0] = lowest_h
    has_height = np.isfinite(h)
    refuse_wrong_heights(raw, h[has_height], rise[has_height])
    missing = int((~has_height).sum())
    if missing:
        raw = raw.noting(messages.sounding_heights(where=raw.where, count=missing))
        # Hypsometric heights plus the departure of stated ones, interpolated to the gaps.
        departure = (h - rise)[has_height]
        computed = rise + np.interp(rise, rise[has_height], departure)
        h = np.where(has_height, h, computed)
    return replace(raw, h_m=h)


def _hypsometric_rise(raw: RawLevels) -> Array:
    """(n,) heights [m'] of the levels above the first by the hypsometric equation.

    Virtual temperature is integrated over ln p by trapezoids; unknown humidity counts as dry.
    """
    virtual = refractive_index.virtual_temperature(
        raw.temperature_k,
        raw.pressure_pa,
        np.nan_to_num(_vapour(raw)),
    )
    fall = -np.diff(np.log(raw.pressure_pa))
    steps = 0.5 * (virtual[1:] + virtual[:-1]) * fall / HYDROSTATIC_CONSTANT
    return np.concatenate([[0.0], np.cumsum(steps)])


def _rising_levels(raw: RawLevels) -> RawLevels:
    """Levels with strictly rising height and strictly falling pressure.

    Neighbours of the same pressure or the same height are averaged. Then as few levels as possible
    are left out. Both are noted. Refuses (InputError) fewer than five levels.
    """
    levels = raw.pressure_pa.size
    raw = _mean_of_runs(raw, raw.pressure_pa)
    # Centimetres: rounding in a conversion does not make two heights different.
    raw = _mean_of_runs(raw, np.round(raw.h_m, 2))
    merged = levels - raw.pressure_pa.size
    if merged:
        raw = raw.noting(messages.sounding_duplicate(where=raw.where, count=merged))
    rising = _longest_rise(raw.h_m)
    left_out = np.setdiff1d(np.arange(raw.h_m.size), rising)
    if left_out.size:
        first = left_out[0]
        note = messages.sounding_order(
            where=raw.where,
            count=left_out.size,
            height_m=raw.h_m[first],
            hpa=raw.pressure_pa[first] / HECTOPASCAL,
        )
        raw = raw.noting(note)
    return _refuse_few(part_of(raw, rising))


def _longest_rise(h: Array) -> Rows:
    """The rows of the longest strictly increasing subsequence of heights, by patience sorting.

    >>> _longest_rise(np.array([0.0, 5.0, 3.0, 4.0, 9.0])).tolist()
    [0, 2, 3, 4]
    """
    # Item k: the last row of the rising sequence of k + 1 rows that ends lowest. The ends rise.
    last_of_length: list[int] = []
    previous = np.full(h.size, -1, dtype=np.intp)  # row before a row in its sequence, -1 without
    for row, height in enumerate(h):
        length = 0  # of the longest sequence that this row continues
        if last_of_length:
            length = int(np.searchsorted(h[last_of_length], height))
        if length:
            previous[row] = last_of_length[length - 1]
        last_of_length[length : length + 1] = [row]
    # Back from the end of the longest sequence.
    chain = last_of_length[-1:]
    while chain and previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return np.array(chain[::-1], dtype=np.intp)


def _mean_of_runs(raw: RawLevels, key: Array) -> RawLevels:
    """The levels with neighbours of equal ``key`` (n,) replaced by their mean.

    Missing values, as of humidity, are left out of the means. Dew points and relative humidities
    are dropped: vapour pressures are complete.
    """
    is_next_run = np.diff(key) != 0.0
    run = np.concatenate([[0], np.cumsum(is_next_run)])  # number of the run of each level
    has_no_equals = run[-1] == key.size - 1
    if has_no_equals:
        return raw
    return replace(
        raw,
        h_m=_means(raw.h_m, run),
        pressure_pa=_means(raw.pressure_pa, run),
        temperature_k=_means(raw.temperature_k, run),
        vapour_pressure_pa=_means(_vapour(raw), run),
        dew_point_k=None,
        relative_humidity=None,
    )


def _means(column: Array, group: Rows) -> Array:
    """Means of the finite values of each group; NaN for a group without any.

    ``group`` (n,) are numbers of groups, from 0 on.
    """
    has_value = np.isfinite(column)
    total = np.bincount(group, np.where(has_value, column, 0.0))
    count = np.bincount(group, has_value.astype(np.float64))
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)


def _vapour(raw: RawLevels) -> Array:
    """(n,) vapour pressures of the levels [Pa]; NaN where missing, or everywhere if not given."""
    if raw.vapour_pressure_pa is None:
        return np.full(raw.pressure_pa.shape, np.nan)
    return raw.vapour_pressure_pa
