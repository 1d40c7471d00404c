"""Means of a sensor's readings in bins of height, of direction and of time, without outliers.

Directions are climb, level flight and descent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unbend.atmosphere.air_samples import SensorSamples, climb_of
from unbend.units import Array, Integers, Mask, Rows

CLIMBING_M_S = 0.5  # slower than this an aircraft flies level; lag has a sign only above it [m/s]
CLIMB_WINDOW_S = 10.0  # over which the rate of a climb is taken, about a reading [s]

OUTLIER_SIGMA = 4.5
"""Readings farther from the median of their bin are outliers: 7 in a million of normal errors."""

CORRELATED_S = 2.0
"""Noise of a sensor is independent after so long [s]: samples at 10 Hz have no more information
than samples every 2 s."""

MOST_DIFFERENT = 0.5  # share of readings that differ, above which a sensor shows no steps

_SEVERAL = 5  # readings of a bin that show the scatter of a sensor


@dataclass(frozen=True, eq=False)
class Bins:
    """Means of readings in bins; (m,) arrays, ordered by time slice, then direction, then height.

    Mean ``seconds`` since the start, geopotential ``height`` [m'] and ``value``; ``sigma`` of the
    mean value, from the scatter of the ``count`` readings. ``rejected`` (n,): which of all readings
    are outliers.
    """

    seconds: Array
    height: Array
    value: Array
    sigma: Array
    count: Integers
    rejected: Mask


@dataclass(frozen=True, eq=False)
class Digits:
    """The readings (n,) as a sensor gave them, and the ``step`` between two neighbouring ones.

    The step, one or (n,), is in the unit of the values that are averaged, which may be another.
    ``use`` (u,) are the rows that are averaged, ``bin_of`` (u,) the bin of each.
    """

    reading: Array
    step: Array | float

    def sigma(self, use: Rows, bin_of: Rows) -> Array:
        """(m,) mean sigma of a reading in each bin by rounding to the step: step / sqrt(12)."""
        step = np.broadcast_to(self.step, self.reading.shape)
        sigma_of_rows = step[use] / np.sqrt(12.0)
        return np.bincount(bin_of, sigma_of_rows) / np.bincount(bin_of)

    def count_different(self, use: Rows, bin_of: Rows) -> Array:
        """(m,) how many different readings each bin has."""
        pairs = np.unique(np.stack([bin_of, self.reading[use]]), axis=1)
        bins_of_pairs = pairs[0].astype(np.int64)
        return np.bincount(bins_of_pairs).astype(np.float64)


def bin_readings(
    seconds: Array,
    height: Array,
    value: Array,
    accepted: Mask,
    *,
    width: float,
    slice_s: float,
    floor: float,
    digits: Digits | None = None,
) -> Bins:
    """Means of readings in bins of height, direction of flight and time, without outliers.

    ``seconds``, ``height``, ``value``: (n,) time [s], geopotential height [m'], reading in any
    unit, best as a departure from a profile, so that height within a bin matters less.
    ``accepted``: (n,) readings to use. ``width``, ``slice_s``: of a bin, in height [m'] and in time
    [s]. ``floor``: smallest scatter that is assumed, in the unit of the values. Scatter is 1.4826
    times the median absolute deviation, of the bin or in the median of all bins, whichever is
    larger. ``digits``: the readings and their resolution; None if this is fine enough. Equal
    readings have the same rounding error, so only different ones average it.
    """
    use = np.flatnonzero(accepted & np.isfinite(height) & np.isfinite(value))
    rejected = np.zeros(seconds.size, dtype=bool)
    if use.size == 0:
        return _no_bins(rejected)
    direction = directions_of(seconds, height)[use]
    bin_of = bins_of(seconds[use], height[use], direction, width=width, slice_s=slice_s)
    reading = value[use]
    size = np.bincount(bin_of)
    rounding = np.zeros(size.size) if digits is None else digits.sigma(use, bin_of)
    deviation = np.abs(reading - _medians(bin_of, reading, size)[bin_of])
    scatter = np.hypot(_scatter_of_bins(bin_of, deviation, size, floor), rounding)
    is_outlier = deviation > OUTLIER_SIGMA * scatter[bin_of]
    rejected[use[is_outlier]] = True

    bins = _WeightedBins(bin_of, (~is_outlier).astype(np.float64))
    middle = bins.means(seconds[use])
    # Times spread evenly over a duration have a variance of a twelfth of its square.
    duration = np.sqrt(12.0 * bins.means((seconds[use] - middle[bin_of]) ** 2))
    independent = np.minimum(bins.count, 1.0 + duration / CORRELATED_S)
    sigma = scatter / np.sqrt(independent)
    if digits is not None:
        sigma = np.hypot(sigma, rounding / digits.count_different(use, bin_of))
    return Bins(
        seconds=middle,
        height=bins.means(height[use]),
        value=bins.means(reading),
        sigma=sigma,
        count=bins.count.astype(np.int64),
        rejected=rejected,
    )


def _no_bins(rejected: Mask) -> Bins:
    """Empty bins, where no reading can be used."""
    return Bins(
        seconds=np.empty(0),
        height=np.empty(0),
        value=np.empty(0),
        sigma=np.empty(0),
        count=np.empty(0, np.int64),
        rejected=rejected,
    )


def directions_of(seconds: Array, height: Array) -> Array:
    """(n,) 1 where climbing, 0 level, -1 descending, by the change of height over ten seconds.

    ``seconds``, ``height``: (n,) times [s] and heights [m'].
    """
    rate = climb_of(seconds, height) / CLIMB_WINDOW_S
    is_vertical = np.abs(rate) > CLIMBING_M_S
    return np.asarray(np.sign(rate) * is_vertical)


def bins_of(
    seconds: Array,
    height: Array,
    direction: Array,
    *,
    width: float,
    slice_s: float,
) -> Rows:
    """(n,) the bin of each reading, from 0: readings share a time slice, a direction and a level.

    ``direction`` (n,): see `directions_of`. ``width``, ``slice_s``: of a bin, in height [m'] and in
    time [s].
    """
    level = np.floor(height / width)
    levels = np.ptp(level) + 1.0
    time_slice = np.floor((seconds - seconds.min()) / slice_s)
    directed_slice = time_slice * 3.0 + direction + 1.0  # of the three directions: 0, 1 or 2
    key = directed_slice * levels + level - level.min()
    _, bin_of = np.unique(key, return_inverse=True)
    return bin_of


def _scatter_of_bins(
    bin_of: Rows,
    deviation: Array,
    size: Integers,
    floor: float,
) -> Array:
    """(m,) one sigma of a reading in each bin, by the scatter of the bin or of the whole sensor.

    The larger of both. ``deviation`` (n,): distance of each reading from the median of its bin.
    ``size`` (m,): readings in each bin. ``floor``: smallest scatter of a sensor.
    """
    scatter = 1.4826 * _medians(bin_of, deviation, size)
    scatter_of_sensor = floor
    is_full = size >= _SEVERAL
    if is_full.any():
        scatter_of_sensor = max(floor, float(np.median(scatter[is_full])))
    return np.asarray(np.maximum(scatter, scatter_of_sensor))


@dataclass(frozen=True, eq=False)
class _WeightedBins:
    """The bin of each reading (n,), and its ``weight`` (n,): 1, or 0 of an outlier."""

    bin_of: Rows
    weight: Array

    @cached_property
    def count(self) -> Array:
        """(m,) how many readings each bin has, without outliers."""
        return np.asarray(np.bincount(self.bin_of, self.weight), np.float64)

    def means(self, values: Array) -> Array:
        """(m,) means over each bin of values (n,), without outliers."""
        return np.asarray(np.bincount(self.bin_of, self.weight * values) / self.count)


def resolution_of(sensor: SensorSamples) -> float:
    """The smallest difference between different readings of a sensor, to a hundredth of their unit.

    0 if more than half of the readings are different: rounding is then part of the noise.

    >>> whole = np.array([101_300.0, 101_200.0]).repeat(3)
    >>> resolution_of(SensorSamples(np.arange(6), np.arange(6.0), whole))
    100.0
    """
    _, value = sensor.used()
    distinct = np.unique(np.round(value, 2))
    if distinct.size < 2 or distinct.size > MOST_DIFFERENT * value.size:
        return 0.0
    return float(np.diff(distinct).min())


def _medians(bin_of: Rows, value: Array, size: Integers) -> Array:
    """(m,) median of the values (n,) of each bin; ``size`` (m,) is how many it has."""
    ordered = value[np.lexsort((value, bin_of))]
    start = np.concatenate([[0], np.cumsum(size)[:-1]])  # of each bin among the ordered values
    lower = ordered[start + (size - 1) // 2]
    upper = ordered[start + size // 2]
    return np.asarray(0.5 * (lower + upper))
