"""What a file says of an ascent -> a `Sounding`: refusals, and repairs that are counted.

Everything that is dropped, averaged, clipped or worked out stands in the ledger with its number.
Air that is odd but physical (steep layers, an index that grows with height) is kept, and said.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.refractive_index import (
    refractivity_gyer,
    vapour_pressure,
    virtual_temperature,
)
from pipeline.atmosphere.soundings.levels import Sounding
from pipeline.atmosphere.soundings.raw import Array, RawLevels
from pipeline.atmosphere.soundings.units import refuse_wrong_heights, refuse_wrong_units
from pipeline.errors import InputError
from pipeline.geodesy import Gravity, normal_gravity
from pipeline.ledger import Ledger
from pipeline.units import DEGREE, HYDROSTATIC_CONSTANT

FEWEST_LEVELS = 5
"""With fewer a sounding says less than the climatology and a surface report."""

_COLDEST_K, _WARMEST_K = 150.0, 340.0
_HIGHEST_PA = 110_000.0
_ADIABAT_K_PER_M = 9.8e-3
# Readings rounded to 0.1 K err by 1 K/km over 100 m, and by 5e-4 of n - 1 from level to level.
_SLICE_M = 100.0
_STEEPER_K_PER_M = 1e-3
_INDEX_ROUNDING = 5e-4
_ELSEWHERE_RAD = 45.0 * DEGREE


def check_levels(
    raw: RawLevels,
    ledger: Ledger,
    *,
    latitude_rad: float = math.nan,
    station_h_m: float = math.nan,
) -> Sounding:
    """Levels from the ground up, one at a height, from what a file said.

    Parameters
    ----------
    raw : the levels in the order of the file.
    latitude_rad : of the mission [rad], used where the file has none.
    station_h_m : height of the lowest level [m above sea level], where the file has no heights.

    Raises ``InputError`` where units are wrong, heights are missing or contradict pressure and
    temperature, or fewer than five levels are left. Geopotential metres become metres with
    Lambert's gravity at the latitude; ignoring it would cost up to 30 m at 10 km.
    """
    refuse_wrong_units(raw)
    gravity = _gravity(raw, latitude_rad, ledger)
    if not raw.geopotential:
        raw = replace(raw, h_m=gravity.geopotential_height(raw.h_m), geopotential=True)
    raw = _with_pressure_and_temperature(raw, ledger)
    raw = _sorted(raw, ledger)
    raw = replace(raw, vapour_pressure_pa=_humidity(raw, ledger))
    start = float(gravity.geopotential_height(station_h_m))
    raw = replace(raw, h_m=_heights(raw, start, ledger))
    raw = _one_at_a_pressure(raw, ledger)
    raw = _rising(raw, ledger)
    sounding = _sounding(raw, gravity)
    _say_what_is_odd(sounding, raw, ledger)
    return sounding


def _gravity(raw: RawLevels, latitude_rad: float, ledger: Ledger) -> Gravity:
    latitude = raw.latitude_rad if math.isfinite(raw.latitude_rad) else latitude_rad
    if not math.isfinite(latitude):
        ledger.fallback(
            "SOUNDING-LATITUDE",
            "the sounding's latitude is not known: its heights are those of 45 degrees, at most "
            "27 m wrong at 10 km",
            where=raw.where,
        )
        latitude = _ELSEWHERE_RAD
    return normal_gravity(latitude)


def _take(raw: RawLevels, keep: NDArray[np.bool_] | NDArray[np.intp]) -> RawLevels:
    """Some of the levels, in the order given."""

    def part(column: Array | None) -> Array | None:
        return None if column is None else column[keep]

    return replace(
        raw,
        h_m=raw.h_m[keep],
        pressure_pa=raw.pressure_pa[keep],
        temperature_k=raw.temperature_k[keep],
        dew_point_k=part(raw.dew_point_k),
        vapour_pressure_pa=part(raw.vapour_pressure_pa),
        relative_humidity=part(raw.relative_humidity),
    )


def _refuse_few(raw: RawLevels) -> RawLevels:
    count = raw.pressure_pa.size
    if count < FEWEST_LEVELS:
        raise InputError(
            "SOUNDING-LEVELS",
            f"{count} levels have a pressure and a temperature and are in order; "
            f"{FEWEST_LEVELS} are needed",
            where=raw.where,
            remedy="give another sounding, or the lowest level as a surface report",
        )
    return raw


def _with_pressure_and_temperature(raw: RawLevels, ledger: Ledger) -> RawLevels:
    """The levels that have both; pressures and temperatures that no air has count as missing."""
    if raw.lines_missing > 0:
        ledger.loss(
            "SOUNDING-TRUNCATED",
            f"the header announces {raw.lines_missing} levels more than there are",
            where=raw.where,
            count=raw.lines_missing,
        )
    p, t = raw.pressure_pa, raw.temperature_k
    has = np.isfinite(p) & np.isfinite(t)
    possible = (p > 0.0) & (p <= _HIGHEST_PA) & (t >= _COLDEST_K) & (t <= _WARMEST_K)
    missing, impossible = int((~has).sum()), int((has & ~possible).sum())
    if missing:
        ledger.note(
            "SOUNDING-MISSING",
            f"{missing} of {p.size} levels have no pressure or no temperature, and are not used",
            where=raw.where,
            count=missing,
        )
    if impossible:
        worst = int(np.flatnonzero(has & ~possible)[0])
        ledger.loss(
            "SOUNDING-RANGE",
            f"{impossible} levels have values that no air has, the first {p[worst] / 100.0:.1f} hPa"
            f" and {t[worst]:.1f} K",
            where=raw.where,
            count=impossible,
        )
    return _refuse_few(_take(raw, has & possible))


def _sorted(raw: RawLevels, ledger: Ledger) -> RawLevels:
    """The levels by falling pressure; at one pressure by height."""
    steps = np.diff(raw.pressure_pa)
    up = int((steps > 0.0).sum())
    if up:
        ledger.warning(
            "SOUNDING-UNSORTED",
            f"pressure rises {up} times from one level to the next: the levels are put in order",
            where=raw.where,
            count=up,
        )
        return _take(raw, np.argsort(-raw.pressure_pa, kind="stable"))
    return raw


def _humidity(raw: RawLevels, ledger: Ledger) -> Array:
    """Vapour pressure [Pa] from what there is, at most saturation over water; NaN if nothing."""
    t, p = raw.temperature_k, raw.pressure_pa
    e = np.full(t.shape, np.nan)
    if raw.vapour_pressure_pa is not None:
        e = raw.vapour_pressure_pa.copy()
    if raw.dew_point_k is not None:
        dew = raw.dew_point_k
        wild = np.isfinite(dew) & ~((dew >= _COLDEST_K) & (dew <= _WARMEST_K))
        if bool(wild.any()):
            ledger.warning(
                "SOUNDING-HUMIDITY-RANGE",
                f"{int(wild.sum())} levels have a dew point that no air has, the first "
                f"{dew[wild][0]:.1f} K: taken as unknown",
                where=raw.where,
                count=int(wild.sum()),
            )
        dew = np.where(wild, np.nan, dew)
        e = np.where(np.isfinite(e), e, vapour_pressure(1.0, dew, p))
    if raw.relative_humidity is not None:
        e = np.where(np.isfinite(e), e, vapour_pressure(raw.relative_humidity, t, p))
    negative = np.isfinite(e) & (e < 0.0)
    if bool(negative.any()):
        ledger.warning(
            "SOUNDING-HUMIDITY-NEGATIVE",
            f"{int(negative.sum())} levels have a humidity below zero: taken as unknown",
            where=raw.where,
            count=int(negative.sum()),
        )
        e[negative] = np.nan
    saturated = vapour_pressure(1.0, t, p)
    # A rounded dew point, 0.05 K of it, may pass saturation by 0.4 %: nothing to speak of.
    over = np.isfinite(e) & (e > saturated * 1.005)
    if bool(over.any()):
        ledger.warning(
            "SOUNDING-HUMIDITY-OVER",
            f"{int(over.sum())} levels have a dew point above the temperature or more than "
            f"100 % humidity, at most {100.0 * np.max(e[over] / saturated[over]):.0f} %: taken as "
            "saturated",
            where=raw.where,
            count=int(over.sum()),
        )
    return np.asarray(np.minimum(e, saturated))


def _thickness(raw: RawLevels) -> Array:
    """Hypsometric height [m'] of each level above the first, by trapezoids in ln p."""
    e = np.nan_to_num(_vapour(raw))
    virtual = virtual_temperature(raw.temperature_k, raw.pressure_pa, e)
    fall = -np.diff(np.log(raw.pressure_pa))
    steps = 0.5 * (virtual[1:] + virtual[:-1]) * fall / HYDROSTATIC_CONSTANT
    return np.concatenate([[0.0], np.cumsum(steps)])


def _heights(raw: RawLevels, start: float, ledger: Ledger) -> Array:
    """Geopotential heights [m'], worked out where the file has none; ``start`` of the lowest."""
    h = raw.h_m.copy()
    rise = _thickness(raw)
    if not bool(np.isfinite(h).any()):
        if not math.isfinite(start):
            raise InputError(
                "SOUNDING-HEIGHT",
                f"none of the {h.size} levels has a height",
                where=raw.where,
                remedy="say how high the station is above the sea (station_h_m)",
            )
        h[0] = start
    known = np.isfinite(h)
    refuse_wrong_heights(raw, h[known], rise[known])
    if not bool(known.all()):
        count = int((~known).sum())
        ledger.fallback(
            "SOUNDING-HEIGHTS",
            f"{count} levels have no height: it is worked out from pressure and temperature",
            where=raw.where,
            count=count,
        )
        # The departure of the reported heights from the hypsometric ones, carried to the gaps.
        h = np.where(known, h, rise + np.interp(rise, rise[known], (h - rise)[known]))
    return h


def _one_at_a_pressure(raw: RawLevels, ledger: Ledger) -> RawLevels:
    """Levels of one pressure, then those of one height, as their mean."""
    before = raw.pressure_pa.size
    raw = _mean_of_runs(raw, raw.pressure_pa)
    # Centimetres: rounding of a conversion must not tell two heights apart.
    raw = _mean_of_runs(raw, np.round(raw.h_m, 2))
    merged = before - raw.pressure_pa.size
    if merged:
        ledger.note(
            "SOUNDING-DUPLICATE",
            f"{merged} levels repeat the pressure or the height of another: averaged",
            where=raw.where,
            count=merged,
        )
    return raw


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


def _rising(raw: RawLevels, ledger: Ledger) -> RawLevels:
    """The levels without the fewest whose removal lets height rise as pressure falls."""
    keep = _longest_rise(raw.h_m)
    dropped = raw.h_m.size - keep.size
    if dropped:
        out = np.setdiff1d(np.arange(raw.h_m.size), keep)[0]
        ledger.warning(
            "SOUNDING-ORDER",
            f"{dropped} levels stand lower than one of higher pressure, the first at "
            f"{raw.h_m[out]:.0f} m and {raw.pressure_pa[out] / 100.0:.1f} hPa: not used",
            where=raw.where,
            count=dropped,
        )
    return _refuse_few(_take(raw, keep))


def _longest_rise(h: Array) -> NDArray[np.intp]:
    """Indices of the longest strictly increasing subsequence (patience sorting)."""
    tails: list[int] = []
    before = np.full(h.size, -1, dtype=np.intp)
    for i, value in enumerate(h):
        place = int(np.searchsorted(h[tails], value)) if tails else 0
        before[i] = tails[place - 1] if place else -1
        tails[place : place + 1] = [i]
    chain = []
    i = tails[-1] if tails else -1
    while i >= 0:
        chain.append(i)
        i = int(before[i])
    return np.array(chain[::-1], dtype=np.intp)


def _sounding(raw: RawLevels, gravity: Gravity) -> Sounding:
    return Sounding(
        gravity.height(raw.h_m),
        raw.pressure_pa,
        raw.temperature_k,
        _vapour(raw),
        raw.time_ns,
        raw.station,
        raw.latitude_rad,
        raw.longitude_rad,
        raw.origin,
    )


def _say_what_is_odd(sounding: Sounding, raw: RawLevels, ledger: Ledger) -> None:
    """Layers that are unstable, or in which air grows denser upwards: real, near hot ground."""
    grid = np.arange(sounding.h_m[0], sounding.h_m[-1], _SLICE_M)
    lapse = -np.diff(np.interp(grid, sounding.h_m, sounding.temperature_k)) / _SLICE_M
    steep = lapse > _ADIABAT_K_PER_M + _STEEPER_K_PER_M
    if count := int(steep.sum()):
        i = int(np.argmax(lapse))
        what = (
            f"over {_SLICE_M * count:.0f} m of height the air cools faster than dry air that "
            f"rises, at most by {1e3 * lapse[i]:.1f} K/km at {grid[i]:.0f} m: kept"
        )
        ledger.warning("SOUNDING-SUPERADIABATIC", what, where=raw.where, count=count)
    n = refractivity_gyer(
        sounding.temperature_k, sounding.pressure_pa, np.nan_to_num(sounding.vapour_pressure_pa)
    )
    rising = np.diff(n) > _INDEX_ROUNDING * n[:-1]
    if count := int(rising.sum()):
        i = int(np.argmax(rising))
        what = (
            f"in {count} layers the refractive index grows with height, the lowest at "
            f"{sounding.h_m[i]:.0f} m: light bends away from the ground there, a mirage: kept"
        )
        ledger.warning("SOUNDING-INDEX-RISES", what, where=raw.where, count=count)
