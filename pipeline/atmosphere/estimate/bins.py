"""Readings of one sensor, averaged in bins of height, of way (up, level, down) and of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import climb_of

Array = NDArray[np.float64]

CLIMBING_M_S = 0.5
"""Slower than this an aircraft flies level; lag has a sign only above it [m/s]."""

OUTLIER_SIGMA = 4.5
"""Readings farther from the median of their bin are outliers: 7 in a million honest ones."""

CORRELATED_S = 2.0
"""Noise of a sensor is independent after so long [s]: 10 Hz are not 20 times as good as 0.5 Hz."""


@dataclass(frozen=True, eq=False)
class Bins:
    """Means of readings in bins; (m,) arrays, in no particular order.

    ``seconds`` mean time since the epoch that `bin_readings` was given, ``height`` mean
    geopotential [m'], ``value`` mean, ``sigma`` of the mean from the scatter of the readings,
    ``count`` of the readings averaged. ``rejected`` (n,) the outliers among all the readings.
    """

    seconds: Array
    height: Array
    value: Array
    sigma: Array
    count: NDArray[np.int64]
    rejected: NDArray[np.bool_]


def bin_readings(
    seconds: Array,
    height: Array,
    value: Array,
    accepted: NDArray[np.bool_],
    *,
    width: float,
    slice_s: float,
    floor: float,
) -> Bins:
    """Means without outliers, of readings alike in height, way and time.

    Parameters
    ----------
    seconds, height, value : (n,) time [s], geopotential height [m'], reading in any unit, best as
        a departure from something that follows the height (the bin's median must mean something).
    accepted : (n,) readings to use.
    width, slice_s : of a bin, in height [m'] and in time [s].
    floor : the least scatter a reading may be thought to have, unit of ``value``.

    Scatter is 1.4826 times the median absolute deviation, that of the sensor or of the bin,
    whichever is larger. Cost grows as n log n.
    """
    way = _way(seconds, height)
    use = np.flatnonzero(accepted & np.isfinite(height) & np.isfinite(value))
    rejected = np.zeros(seconds.size, dtype=bool)
    if use.size == 0:
        nothing = np.empty(0)
        return Bins(nothing, nothing, nothing, nothing, np.empty(0, np.int64), rejected)
    level = np.floor(height[use] / width)
    slices = np.floor((seconds[use] - seconds[use].min()) / slice_s)
    key = (slices * 3.0 + way[use] + 1.0) * (np.ptp(level) + 1.0) + level - level.min()
    _, bin_of = np.unique(key, return_inverse=True)
    size = np.bincount(bin_of)
    reading = value[use]
    deviation = np.abs(reading - _medians(bin_of, reading, size)[bin_of])
    spread = 1.4826 * _medians(bin_of, deviation, size)
    several = size >= 5
    common = max(floor, float(np.median(spread[several])) if several.any() else floor)
    scatter = np.maximum(spread, common)
    bad = deviation > OUTLIER_SIGMA * scatter[bin_of]
    rejected[use[bad]] = True
    good = (~bad).astype(np.float64)
    count = np.bincount(bin_of, good)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(bin_of, good * values) / count)

    moment = mean(seconds[use])
    lasted = np.sqrt(12.0 * mean((seconds[use] - moment[bin_of]) ** 2))
    independent = np.minimum(count, 1.0 + lasted / CORRELATED_S)
    return Bins(
        moment,
        mean(height[use]),
        mean(reading),
        scatter / np.sqrt(independent),
        count.astype(np.int64),
        rejected,
    )


def _medians(bin_of: NDArray[np.intp], value: Array, size: NDArray[np.int64]) -> Array:
    """Median of the values of each bin."""
    ordered = value[np.lexsort((value, bin_of))]
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    return np.asarray(0.5 * (ordered[start + (size - 1) // 2] + ordered[start + size // 2]))


def _way(seconds: Array, height: Array) -> Array:
    """+1 climbing, 0 level, -1 descending: by the change of height over ten seconds."""
    rate = climb_of(seconds, height) / 10.0
    return np.asarray(np.sign(rate) * (np.abs(rate) > CLIMBING_M_S))
