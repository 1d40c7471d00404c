"""Differences of two sources of position or height, beyond a constant lag and offset."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.sources import (
    SEVERAL,
    SOURCE_GAP_S,
    SourcePath,
    is_receiver,
    north_east_m,
    places_of,
)
from unbend.flight.evidence.stretches import HEIGHT, POSITION, Run, runs
from unbend.flight.interpolation import interpolate
from unbend.units import NANOSECONDS_PER_SECOND, Array, Mask, Rows

# Beyond lag and offset, two sources differ by as much through noise [m].
NOISE_MISFIT_M = {POSITION: 2.0, HEIGHT: 4.0}

_SIGMA_OF_MEDIAN = 1.48  # standard deviation of normal errors over their median absolute value

# Lag of a source behind another, by differences along the track.
_SLOWEST_M_S = 2.0  # slower samples show no lag
_FAST_SHARE = 0.1  # of the square of usual speeds (95th percentile): nor do samples below it
_FEWEST_FAST = 20  # samples: fewer show no lag
_LAG_PARTS = 20  # of the flight, whose lags are tried where the median one does not fit
_LONGEST_LAG_S = 0.3  # of receivers; more is a constant offset, which looks like a lag along a line
_PART_OF_FLIGHT = 0.1  # two sources do not agree by chance in so much of it, whatever the rest is

# Heights of a barometer.
_SLOPE_M = -8434.5  # dh / d ln p at 288.15 K
_FEWEST_PRESSURES = 30
_SPAN_OF_PARABOLA_M = 300.0  # of a flight: over less, noise would bend it
_LEAST_SCATTER_M = 1.0

_HOUR_NS = 3600 * NANOSECONDS_PER_SECOND

# What weather changes between the height of a pressure and that of a receiver: 0.5 hPa an hour.
WEATHER_M_PER_H = 4.2
# An inversion makes the relation of height and ln p none of a parabola: 9 K in 250 m leave 15 m of
# 2 km. Beside hours of level flight the climb has no share in the scatter.
STRUCTURE_SHARE = 0.002


@dataclass(frozen=True, eq=False)
class Difference:
    """How far a source is from another, at the (n,) times of the other.

    NaN where either is missing, or the other's accuracy is poor.

    apart_m : (n, k) place by the source minus place by the other, from which the other's own steps
        and its constant lag are taken out.
    off_m : (n,) distance of ``apart_m`` from its usual value.
    lag_s : by how much the other is behind the source.
    limit_m : (n,) the largest ``off_m`` that is noise, or weather.
    scatter_m : standard deviation of ``off_m`` on the samples that show its usual value.
    """

    other: SourcePath
    apart_m: Array
    off_m: Array
    lag_s: float
    limit_m: Array
    scatter_m: float

    @property
    def apart(self) -> list[Run]:
        """Rows of the other in which the two differ by more than noise.

        Such a run reaches as far as they differ by more than half of that.
        """
        with np.errstate(invalid="ignore"):
            is_half_off = self.off_m > 0.5 * self.limit_m
            is_off = self.off_m > self.limit_m
        return runs(self.other.channel.time_ns, is_half_off, is_off)


def source_difference(
    source: Channel,
    other: SourcePath,
    quantity: str,
    velocity: Array,
    *,
    steady_until_ns: int | None = None,
) -> Difference:
    """How far a source is from another source, beyond the usual offset of the two.

    ``velocity`` (n, k) [m/s] at the times of the other source. The usual offset is the median, or
    that of a tenth of the flight or more in which the two agree:

    * Positions, and heights of two receivers, agree where they differ by less than noise.
    * Other heights may have any offset. They agree before ``steady_until_ns``, when ``source``
      first stepped and did not return; nowhere if it never did. One of these follows a pressure, so
      that the air moves it: the limit grows with time and height from where the usual offset was
      (`air_change_m`).
    """
    noise_m = NOISE_MISFIT_M[quantity]
    are_receivers = is_receiver(source) and is_receiver(other.channel)
    agree_near_zero = quantity == POSITION or are_receivers
    known_velocity = np.nan_to_num(velocity)  # where it is unknown, no lag is seen or taken out
    apart_m = _apart_with_lag(source, other, quantity)
    is_known = np.isfinite(apart_m).all(axis=1) & other.good
    lag = _constant_lag(apart_m, known_velocity, is_known, noise_m, may_part=agree_near_zero)
    apart_m -= lag.seconds * known_velocity
    # A sample that is not good has either stepped away, and its step is taken out, or its accuracy
    # is poor.
    is_accurate = other.good | other.stepped_m.any(axis=1)
    apart_m[~is_accurate] = np.nan
    if agree_near_zero:
        agree = np.linalg.norm(apart_m, axis=1) < noise_m
    elif steady_until_ns is not None:
        agree = other.channel.time_ns < steady_until_ns
    else:
        agree = np.zeros(is_known.shape, np.bool_)
    misfit = _misfit(apart_m, other.part, lag.shown_by, agree, noise_m)
    least_limit_m = max(noise_m, SEVERAL * misfit.scatter_m)
    limit_m = np.full(is_known.size, least_limit_m)
    if not agree_near_zero:
        height_m = places_of(other.channel, quantity)[:, 0]
        of_air_m = air_change_m(other.channel.time_ns, height_m, misfit.settled)
        limit_m += SEVERAL * of_air_m
    return Difference(
        other=other,
        apart_m=apart_m,
        off_m=misfit.off_m,
        lag_s=lag.seconds,
        limit_m=limit_m,
        scatter_m=misfit.scatter_m,
    )


def air_change_m(time_ns: TimeArray, height_m: Array, settled: Mask) -> Array:
    """(n,) metres by which the air moves heights of a pressure from the ``settled`` samples on.

    Those samples show the usual height; their median time and height count. It is one sigma.
    """
    if not settled.any():
        return np.zeros(time_ns.shape)
    middle_ns = int(np.median(time_ns[settled]))
    middle_m = float(np.median(height_m[settled]))
    apart_ns = np.abs(time_ns - middle_ns)
    hours = apart_ns / _HOUR_NS
    by_weather_m = WEATHER_M_PER_H * hours
    by_structure_m = STRUCTURE_SHARE * np.abs(height_m - middle_m)
    return np.asarray(np.hypot(by_weather_m, by_structure_m))


def _apart_with_lag(source: Channel, other: SourcePath, quantity: str) -> Array:
    """(n, k) metres from the other source, whose own steps are taken out, to ``source``.

    They hold at the times of the other source; its lag is still in them.
    """
    # A height gives one column, a position two.
    components_of_places = places_of(source, quantity).T
    columns = dict(zip("xy", components_of_places, strict=False))
    placed = replace(source, columns=columns, labels={})
    gap_s = source.gap_limit_s(SOURCE_GAP_S)
    time_ns = other.channel.time_ns
    components = [interpolate(placed, name, time_ns, gap_s) for name in columns]
    other_places = places_of(other.channel, quantity)
    apart = np.stack(components, axis=1) - other_places
    apart_m = apart if quantity == HEIGHT else north_east_m(apart, other_places[:, 0])
    return np.asarray(apart_m + other.stepped_m)


class _Lag(NamedTuple):
    """By how many seconds the other source is behind, and the (n,) samples that show it."""

    seconds: float
    shown_by: Mask


def _constant_lag(
    apart_m: Array, velocity: Array, known: Mask, noise_m: float, *, may_part: bool
) -> _Lag:
    """The lag that differences along the track show, and the samples that show it.

    * Too few samples are fast: 0; all known samples count as showing that.
    * The lags of the fast samples scatter by more than noise, and the two sources may agree in a
      part of the flight only (``may_part``): the lag of such a part.
    * Else the median lag of the fast samples.
    """
    square_speed = np.sum(velocity**2, axis=1)
    usual_square = float(np.percentile(square_speed, 95.0))
    least_square = max(_SLOWEST_M_S**2, _FAST_SHARE * usual_square)
    is_fast = known & (square_speed > least_square)
    if np.count_nonzero(is_fast) < _FEWEST_FAST:
        return _Lag(0.0, known)
    along = np.sum(apart_m * velocity, axis=1)
    lags = along[is_fast] / square_speed[is_fast]
    median_s = float(np.median(lags))
    scatter_s = np.median(np.abs(lags - median_s))
    scatter_m = scatter_s * np.sqrt(np.median(square_speed))
    if may_part and scatter_m > noise_m:
        lag_s = _lag_of_a_part(lags, apart_m[is_fast], velocity[is_fast])
        return _Lag(lag_s, is_fast)
    return _Lag(median_s, is_fast)


def _lag_of_a_part(lags: Array, apart_m: Array, velocity: Array) -> float:
    """The lag [s] for which the 10th percentile of (f, k) differences is smallest.

    Two sources may agree in a part of the flight only: tried are the median of all (f,) lags, and
    that of each twentieth of the flight unless it is longer than receivers have.
    """

    def distance_of_nearest(lag_s: float) -> float:
        without_lag_m = apart_m - lag_s * velocity
        distance_m = np.linalg.norm(without_lag_m, axis=1)
        return float(np.percentile(distance_m, 100.0 * _PART_OF_FLIGHT))

    candidates = [float(np.median(lags))]
    for part in np.array_split(lags, _LAG_PARTS):
        lag_s = float(np.median(part))
        if abs(lag_s) < _LONGEST_LAG_S:
            candidates.append(lag_s)
    return min(candidates, key=distance_of_nearest)


class _Misfit(NamedTuple):
    """(n,) metres beyond the usual offset, and the samples on which that offset rests."""

    off_m: Array
    settled: Mask

    @property
    def scatter_m(self) -> float:
        """Standard deviation of ``off_m`` on the settled samples; 0 without one."""
        if not self.settled.any():
            return 0.0
        settled_off_m = self.off_m[self.settled]
        return _SIGMA_OF_MEDIAN * float(np.median(settled_off_m))


def _misfit(apart_m: Array, part: Rows, known: Mask, agree: Mask, noise_m: float) -> _Misfit:
    """How far two sources are apart beyond their usual offset, which each part has for itself.

    Each part of the other source has an offset of its own, because heights above home have a new
    home after a restart. The offset of a part rests on its ``known`` samples (n,); if there are
    none, on all whose difference is known.
    """
    off_m = np.full(part.size, np.nan)
    settled = np.zeros(part.size, np.bool_)
    for number in np.unique(part):
        in_part = part == number
        usable = in_part & known
        if not usable.any():
            usable = in_part & np.isfinite(apart_m).all(axis=1)
        if not usable.any():
            continue
        used, offset_m = _usual_offset(apart_m, usable, agree, noise_m)
        beyond_offset_m = apart_m[in_part] - offset_m
        off_m[in_part] = np.linalg.norm(beyond_offset_m, axis=1)
        settled |= used & known
    return _Misfit(off_m, settled)


def _usual_offset(
    apart_m: Array,
    usable: Mask,
    agree: Mask,
    noise_m: float,
) -> tuple[Mask, Array]:
    """The rows that show the usual offset of two sources, and their median difference (k,) [m].

    These are the usable rows that agree, if they are more than a tenth of the usable ones and their
    median is another by more than noise; else all usable rows.
    """
    offset_m = np.median(apart_m[usable], axis=0)
    agreeing = usable & agree
    if np.count_nonzero(agreeing) > _PART_OF_FLIGHT * np.count_nonzero(usable):
        agreed_m = np.median(apart_m[agreeing], axis=0)
        if np.linalg.norm(agreed_m - offset_m) > noise_m:
            return agreeing, agreed_m
    return usable, offset_m


def height_of_pressure(barometer: Channel, height: Channel) -> Channel | None:
    """A barometer as a source of heights, by the flight's own relation of height and ln p.

    The relation is a parabola, or a line of standard air where the flight spans under 300 m; it is
    fitted twice, the second time without outliers. None where too few pressures have a height.
    """
    column = height.height_column
    if column is None or "pressure_pa" not in barometer.columns:
        return None
    gap_s = height.gap_limit_s(SOURCE_GAP_S)
    height_m = interpolate(height, column, barometer.time_ns, gap_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_p = np.log(barometer["pressure_pa"])
    usable = np.isfinite(height_m) & np.isfinite(log_p)
    if np.count_nonzero(usable) < _FEWEST_PRESSURES:
        return None
    of_pressure_m = _height_by_log_p(log_p, height_m, usable)
    of_air_m = air_change_m(barometer.time_ns, of_pressure_m, usable)
    usable &= _is_near(height_m, of_pressure_m, of_air_m)
    of_pressure_m = _height_by_log_p(log_p, height_m, usable)
    return replace(
        barometer,
        columns={"h_msl_m": of_pressure_m},
        roles=(),
        labels={},
    )


def _height_by_log_p(log_p: Array, height_m: Array, usable: Mask) -> Array:
    """(n,) heights of pressures by a parabola in ln p through the usable rows.

    If these span less than 300 m it is a line with the slope of standard air.
    """
    if float(np.ptp(height_m[usable])) > _SPAN_OF_PARABOLA_M:
        parabola = np.polynomial.Polynomial.fit(log_p[usable], height_m[usable], 2)
        return np.asarray(parabola(log_p))
    without_slope_m = height_m[usable] - _SLOPE_M * log_p[usable]
    at_unit_pressure_m = float(np.median(without_slope_m))
    return at_unit_pressure_m + _SLOPE_M * log_p


def _is_near(height_m: Array, of_pressure_m: Array, of_air_m: Array) -> Mask:
    """(n,) which heights are within three sigma, or 1 m, of those of the pressure.

    The air adds three of its own sigma ``of_air_m``.
    """
    off_m = np.abs(height_m - of_pressure_m)
    three_sigma_m = 3.0 * _SIGMA_OF_MEDIAN * float(np.nanmedian(off_m))
    limit_m = max(three_sigma_m, _LEAST_SCATTER_M) + 3.0 * of_air_m
    return np.asarray(off_m < limit_m)
