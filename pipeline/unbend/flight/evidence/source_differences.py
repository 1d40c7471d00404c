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

# Noise makes two sources differ by as much, apart from lag and offset [m].
NOISE_MISFIT_M = {POSITION: 2.0, HEIGHT: 4.0}

_SIGMA_OF_MEDIAN = 1.48  # standard deviation of normal errors over their median absolute value

# Lag of a source behind another, by differences along the track.
_SLOWEST_M_S = 2.0  # slower samples show no lag
# Nor do samples with a squared speed below this share of the usual one (95th percentile).
_FAST_SHARE = 0.1
_FEWEST_FAST = 20  # fewer fast samples show no lag
_LAG_PARTS = 20  # of the flight; the lag of each is tried where the median lag does not fit
_LONGEST_LAG_S = 0.3  # of receivers; more is a constant offset, which looks like a lag along a line
_PART_OF_FLIGHT = 0.1  # two sources that agree in so large a part of it do not do so by chance

# Heights of a barometer.
_SLOPE_M = -8434.5  # dh / d ln p at 288.15 K
_FEWEST_PRESSURES = 30  # with a height, to fit their relation
_SPAN_OF_PARABOLA_M = 300.0  # of heights; over less, noise would bend the parabola
_LEAST_SCATTER_M = 1.0  # of heights about those of the pressure

_HOUR_NS = 3600 * NANOSECONDS_PER_SECOND

# Weather moves the height of a pressure: 0.5 hPa an hour.
WEATHER_M_PER_H = 4.2
# A parabola in ln p leaves this share of a height unexplained: after an inversion of 9 K in 250 m
# it is 15 m of 2 km. Hours of level flight do not show it in the scatter.
STRUCTURE_SHARE = 0.002


@dataclass(frozen=True, eq=False)
class Difference:
    """How far a source is from the ``other`` one, at the (n,) times of the other.

    NaN where either is missing, or the other's accuracy is poor.

    apart_m : (n, k) place by the source minus place by the other; the steps and the constant lag of
        the other are taken out.
    off_m : (n,) distance of ``apart_m`` from its usual value.
    lag_s : by how much the other is behind the source.
    limit_m : (n,) the largest ``off_m`` that noise or weather can cause.
    scatter_m : standard deviation of ``off_m`` in the samples that give the usual value.
    """

    other: SourcePath
    apart_m: Array
    off_m: Array
    lag_s: float
    limit_m: Array
    scatter_m: float

    @property
    def apart(self) -> list[Run]:
        """Runs of rows of the other source in which ``off_m`` exceeds its limit.

        A run begins and ends where ``off_m`` exceeds half of the limit.
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

    ``velocity`` (n, k) [m/s] at the times of the other source. ``steady_until_ns``: when ``source``
    first stepped and did not return; None if it did not. The usual offset is the median of all
    samples, or of those in which the two agree, if these are more than a tenth of the flight:

    * Positions, and heights of two receivers, agree where they differ by less than noise.
    * Other heights may have any offset. They agree before ``steady_until_ns``, nowhere if it is
      None. One of them follows a pressure, so that the air moves it: the limit grows with time and
      height from where the usual offset was (`air_change_m`).
    """
    noise_m = NOISE_MISFIT_M[quantity]
    are_receivers = is_receiver(source) and is_receiver(other.channel)
    agree_near_zero = quantity == POSITION or are_receivers
    known_velocity = np.nan_to_num(velocity)  # with 0, no lag is determined or taken out
    apart_m = _apart_with_lag(source, other, quantity)
    is_known = np.isfinite(apart_m).all(axis=1) & other.good
    lag = _constant_lag(
        apart_m, known_velocity, is_known, noise_m, may_agree_in_part=agree_near_zero
    )
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
    """(n,) sigmas [m] of how the air moves heights of a pressure, relative to ``settled`` samples.

    It grows with the time and the height from the median of the ``settled`` samples (n,), which are
    those that give the usual offset. 0 without any.
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
    """(n, k) metres from the other source to ``source``, at the times of the other source.

    The steps of the other source are taken out; its lag is still included.
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
    """By how many seconds the other source is behind, and (n,) True for samples that show it."""

    seconds: float
    shown_by: Mask


def _constant_lag(
    apart_m: Array, velocity: Array, known: Mask, noise_m: float, *, may_agree_in_part: bool
) -> _Lag:
    """The constant lag of the other source, from differences along the track.

    ``apart_m``, ``velocity`` (n, k); ``known`` (n,) : the samples that count.

    * If too few samples are fast, it is 0, and all known samples count as those that show it.
    * If the lags of the fast samples scatter by more than noise, and the two sources
      ``may_agree_in_part`` of the flight only, it is the lag of such a part.
    * Else it is the median lag of the fast samples.
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
    if may_agree_in_part and scatter_m > noise_m:
        lag_s = _lag_of_a_part(lags, apart_m[is_fast], velocity[is_fast])
        return _Lag(lag_s, is_fast)
    return _Lag(median_s, is_fast)


def _lag_of_a_part(lags: Array, apart_m: Array, velocity: Array) -> float:
    """The lag [s] for which two sources are nearest in a tenth of (f,) samples.

    ``lags`` (f,) [s] of the samples, ``apart_m`` (f, k), ``velocity`` (f, k). The median of all
    lags is tried, and that of each twentieth of the flight unless it is longer than receivers have.
    """

    def distance_of_nearest(lag_s: float) -> float:
        """The 10th percentile of the distances that a lag leaves [m]."""
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
    """(n,) distances from the usual offset [m], and a mask (n,) of the samples that gave it."""

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
    """How far two sources are apart beyond the usual offset of each part of the other source.

    ``part`` (n,) : number of the part of each sample. Each has an offset of its own, because
    heights above home have a new home after a restart. It comes from the ``known`` samples (n,) of
    the part; if there are none, from all that have a difference. ``agree`` : as of `_usual_offset`.
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
    """The rows (n,) that give the usual offset of two sources, and the offset (k,) [m].

    It is the median difference of all usable rows; but that of the usable rows that agree if these
    are more than a tenth, and their median differs from the other by more than noise.
    """
    offset_m = np.median(apart_m[usable], axis=0)
    agreeing = usable & agree
    if np.count_nonzero(agreeing) > _PART_OF_FLIGHT * np.count_nonzero(usable):
        agreed_m = np.median(apart_m[agreeing], axis=0)
        if np.linalg.norm(agreed_m - offset_m) > noise_m:
            return agreeing, agreed_m
    return usable, offset_m


def height_of_pressure(barometer: Channel, height: Channel) -> Channel | None:
    """A barometer as a source of heights above sea level, by the flight's relation of h and ln p.

    The relation is a parabola, or a line of standard air if the heights span less than 300 m; it is
    fitted twice, the second time without outliers. None if too few pressures have a height.
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
    """(n,) heights of pressures, by a parabola in ln p that is fitted to the usable rows.

    If their heights span less than 300 m, it is a line with the slope of standard air.
    """
    if float(np.ptp(height_m[usable])) > _SPAN_OF_PARABOLA_M:
        parabola = np.polynomial.Polynomial.fit(log_p[usable], height_m[usable], 2)
        return np.asarray(parabola(log_p))
    without_slope_m = height_m[usable] - _SLOPE_M * log_p[usable]
    at_unit_pressure_m = float(np.median(without_slope_m))
    return at_unit_pressure_m + _SLOPE_M * log_p


def _is_near(height_m: Array, of_pressure_m: Array, of_air_m: Array) -> Mask:
    """(n,) True for heights within three sigmas, or 1 m, of those of the pressure.

    Three of the sigmas of the air, ``of_air_m``, are added to this limit.
    """
    off_m = np.abs(height_m - of_pressure_m)
    three_sigma_m = 3.0 * _SIGMA_OF_MEDIAN * float(np.nanmedian(off_m))
    limit_m = max(three_sigma_m, _LEAST_SCATTER_M) + 3.0 * of_air_m
    return np.asarray(off_m < limit_m)
