"""Distributions of a stream of magnitudes in fixed memory; quantiles of weighted values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from unbend.tables.manifest.results import DistributionRecord, HistogramRecord, Quantiles
from unbend.units import Array, Integers, round_step

_LOWEST_EXPONENT = -12  # the first bin begins at 1e-12; smaller values and zero fall into it
_HIGHEST_EXPONENT = 8  # the last bin begins at 1e8; larger values fall into it
_BINS_PER_DECADE = 500  # each is 0.46 % wide
_BINS = (_HIGHEST_EXPONENT - _LOWEST_EXPONENT) * _BINS_PER_DECADE + 1


@dataclass
class Distribution:
    """Distribution of non-negative magnitudes in logarithmic bins.

    The maximum is exact; quantiles are good to 0.23 % of their value, half the width of a bin.

    >>> distribution = Distribution()
    >>> distribution.add(np.arange(1.0, 1000.0))
    >>> abs(distribution.quantile(0.5) / 500.0 - 1.0) < 0.005, distribution.maximum
    (True, 999.0)
    """

    counts: Integers = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    maximum: float = 0.0
    total: int = 0

    def add(self, values: Array) -> None:
        """Count values; zero falls into the lowest bin, NaN and infinity are not counted."""
        finite = np.isfinite(values)
        if not finite.all():
            values = values[finite]
        if values.size == 0:
            return
        with np.errstate(divide="ignore"):
            exponent = np.log10(values)  # minus infinity for zero
        exponent -= _LOWEST_EXPONENT
        exponent *= _BINS_PER_DECADE
        np.clip(exponent, 0, self.counts.size - 1, out=exponent)
        self.counts += np.bincount(exponent.astype(np.int64), minlength=self.counts.size)
        self.maximum = max(self.maximum, float(values.max()))
        self.total += values.size

    def quantile(self, share: float) -> float | None:
        """The value that a share (0 to 1) of the values does not exceed; None without values.

        Each value counts as the middle of its bin, in the lowest bin as 0.
        """
        if self.total == 0:
            return None
        bin_number = int(np.searchsorted(np.cumsum(self.counts), share * self.total))
        if bin_number == 0:
            return 0.0
        middle = float(middle_of_bins(np.array(bin_number)))
        return min(middle, self.maximum)  # the middle of the last filled bin may be above it

    def __add__(self, other: Distribution) -> Distribution:
        return Distribution(
            counts=self.counts + other.counts,
            maximum=max(self.maximum, other.maximum),
            total=self.total + other.total,
        )

    def histogram(self, bins: int = 24) -> HistogramRecord:
        """Counts in at most ``bins`` bins from zero, with a step of 1, 2 or 5 times a power of 10.

        Each value counts as the middle of its logarithmic bin, which is 0.23 % off at most.
        ``counts[i]`` is for values from i to i + 1 steps.

        >>> distribution = Distribution()
        >>> distribution.add(np.array([0.1, 2.5, 2.6, 9.9]))
        >>> distribution.histogram(10)
        HistogramRecord(step=1.0, counts=[1, 0, 2, 0, 0, 0, 0, 0, 0, 1])
        """
        if self.total == 0:
            return HistogramRecord(1.0, [])
        if self.maximum <= 0.0:
            return HistogramRecord(1.0, [self.total])
        step = round_step(self.maximum / bins)
        filled = np.flatnonzero(self.counts)
        # A maximum that is a multiple of the step belongs to the last bin, not to one behind it.
        below_maximum = self.maximum * (1.0 - 1e-12)
        values = np.minimum(middle_of_bins(filled), below_maximum)
        step_number = (values / step).astype(np.int64)
        counts = np.bincount(step_number, self.counts[filled]).astype(np.int64)
        return HistogramRecord(step, counts.tolist())

    def summary(self) -> DistributionRecord:
        """Count, median and 95 % to three digits, and the maximum to six, for the manifest."""
        maximum = None
        if self.total:
            maximum = to_digits(self.maximum, 6)
        return DistributionRecord(
            count=self.total,
            median=to_digits(self.quantile(0.5), 3),
            p95=to_digits(self.quantile(0.95), 3),
            maximum=maximum,
        )


def middle_of_bins(number: Integers) -> Array:
    """The middle values of the logarithmic bins of a `Distribution` with these numbers."""
    exponent = (number + 0.5) / _BINS_PER_DECADE + _LOWEST_EXPONENT
    return np.asarray(10.0**exponent)


def to_digits(value: float | None, digits: int) -> float | None:
    """A number rounded to some significant digits; None stays None."""
    if value is None:
        return None
    return float(f"{value:.{digits}g}")


def median_and_p95(values: Array, weight: Array) -> Quantiles:
    """Weighted median and 95 % quantile of the finite values; ``values``, ``weight`` (n,)."""
    median = weighted_quantile(values, weight, 0.5)
    p95 = weighted_quantile(values, weight, 0.95)
    return Quantiles(median, p95)


def weighted_quantile(
    values: Array,
    weight: Array,
    share: float,
) -> float | None:
    """The value that a share (0 to 1) of the weight of the finite values does not exceed.

    It is one of the ``values`` (n,), to six digits; None if none is finite.

    >>> weighted_quantile(np.array([1.0, 5.0, 9.0]), np.array([1.0, 1.0, 3.0]), 0.5)
    9.0
    """
    order = np.argsort(values)
    order = order[np.isfinite(values[order])]
    if not order.size:
        return None
    weight_up_to = np.cumsum(weight[order])
    row = order[np.searchsorted(weight_up_to, share * weight_up_to[-1])]
    return float(f"{values[row]:.6g}")
