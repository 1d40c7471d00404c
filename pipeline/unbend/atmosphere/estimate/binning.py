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
"""Noise of a sensor is independent after so long [s]: 10 Hz are not 20 times as good as 0.5 Hz."""

MOST_DIFFERENT = 0.5  # share of readings that differ, above which a sensor shows no steps

_SEVERAL = 5  # readings of a bin that show the scatter of a sensor


@dataclass(frozen=True, eq=False)
class Bins:
    """Means of readings in bins; (m,) arrays, in no particular order.

    Mean ``seconds`` since the epoch, geopotential ``height`` [m'] and value; ``sigma`` of it from
    the scatter of the ``count`` readings; ``rejected`` (n,) the outliers among all.
    """

    seconds: Array
    height: Array
    value: Array
    sigma: Array
    count: Integers
    rejected: Mask


@dataclass(frozen=True, eq=False)
class Digits:
    """The readings (n,) as a sensor gave them, and the ``step`` between two that it tells apart.

    The step is in the unit of the departures that are averaged.
    """

    reading: Array
    step: Array | float

    def sigma(self, use: Rows, bin_of: Rows) -> Array:
        """(m,) sigma of a reading for its last digit, in each bin of the rows in ``use``."""
        step = np.broadcast_to(self.step, self.reading.shape)
        of_rows = step[use] / np.sqrt(12.0)
        return np.bincount(bin_of, of_rows) / np.bincount(bin_of)

    def different(self, use: Rows, bin_of: Rows) -> Array:
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
    """Means without outliers, of readings alike in height, direction and time.

    ``seconds``, ``height``, ``value``: (n,) time [s], geopotential height [m'], reading in any
    unit, best as a departure from something that follows the height. ``accepted``: (n,) readings
    to use. ``width``, ``slice_s``: of a bin, in height [m'] and in time [s]. ``floor``: smallest
    scatter that is assumed. Scatter is 1.4826 times the median absolute deviation, that of the
    sensor or of the bin, whichever is larger. The last of the ``digits`` that were read is
    off by as much in all readings that are the same, so that only different ones average it.
    """
    use = np.flatnonzero(accepted & np.isfinite(height) & np.isfinite(value))
    rejected = np.zeros(seconds.size, dtype=bool)
    if use.size == 0:
        return _no_bins(rejected)
    direction = directions_of(seconds, height)[use]
    bin_of = bins_of(seconds[use], height[use], direction, width=width, slice_s=slice_s)
    reading = value[use]
    size = np.bincount(bin_of)
    of_digit = np.zeros(size.size) if digits is None else digits.sigma(use, bin_of)
    deviation = np.abs(reading - _medians(bin_of, reading, size)[bin_of])
    scatter = np.hypot(_scatter_of_bins(bin_of, deviation, size, floor), of_digit)
    is_outlier = deviation > OUTLIER_SIGMA * scatter[bin_of]
    rejected[use[is_outlier]] = True

    mean = _Means(bin_of, (~is_outlier).astype(np.float64))
    middle = mean.of(seconds[use])
    lasted = np.sqrt(12.0 * mean.of((seconds[use] - middle[bin_of]) ** 2))
    independent = np.minimum(mean.count, 1.0 + lasted / CORRELATED_S)
    sigma = scatter / np.sqrt(independent)
    if digits is not None:
        sigma = np.hypot(sigma, of_digit / digits.different(use, bin_of))
    return Bins(
        seconds=middle,
        height=mean.of(height[use]),
        value=mean.of(reading),
        sigma=sigma,
        count=mean.count.astype(np.int64),
        rejected=rejected,
    )


def _no_bins(rejected: Mask) -> Bins:
    return Bins(
        seconds=np.empty(0),
        height=np.empty(0),
        value=np.empty(0),
        sigma=np.empty(0),
        count=np.empty(0, np.int64),
        rejected=rejected,
    )


def directions_of(seconds: Array, height: Array) -> Array:
    """(n,) +1 climbing, 0 level, -1 descending: by the change of height over ten seconds."""
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
    """(n,) numbers of the bins of readings: of a slice of time, a direction and a level."""
    level = np.floor(height / width)
    levels = np.ptp(level) + 1.0
    time_slice = np.floor((seconds - seconds.min()) / slice_s)
    directed_slice = time_slice * 3.0 + direction + 1.0
    key = directed_slice * levels + level - level.min()
    _, bin_of = np.unique(key, return_inverse=True)
    return bin_of


def _scatter_of_bins(
    bin_of: Rows,
    deviation: Array,
    size: Integers,
    floor: float,
) -> Array:
    """(m,) sigma of a reading in each bin: that of the bin, or of the sensor if that is larger."""
    spread = 1.4826 * _medians(bin_of, deviation, size)
    of_sensor = floor
    is_full = size >= _SEVERAL
    if is_full.any():
        of_sensor = max(floor, float(np.median(spread[is_full])))
    return np.asarray(np.maximum(spread, of_sensor))


@dataclass(frozen=True, eq=False)
class _Means:
    """Means over the bins of readings (n,); ``weight`` (n,) is 1, or 0 of an outlier."""

    bin_of: Rows
    weight: Array

    @cached_property
    def count(self) -> Array:
        """(m,) how many readings each bin has."""
        return np.asarray(np.bincount(self.bin_of, self.weight), np.float64)

    def of(self, values: Array) -> Array:
        """(m,) means of values (n,)."""
        return np.asarray(np.bincount(self.bin_of, self.weight * values) / self.count)


def resolution_of(sensor: SensorSamples) -> float:
    """The smallest step between readings of a sensor that differ, to a hundredth of their unit.

    0 where few of them are the same: the last digit is then noise like other.

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
    """Median of the values of each bin."""
    ordered = value[np.lexsort((value, bin_of))]
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    lower = ordered[start + (size - 1) // 2]
    upper = ordered[start + size // 2]
    return np.asarray(0.5 * (lower + upper))
