"""Median and maximum of a stream of any length, and its mean over the image, in fixed memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.refraction.image import Corrections
from pipeline.units import ARCSEC, Array, Integers, round_step

_LOWEST_EXPONENT = -12
_HIGHEST_EXPONENT = 8
_BINS_PER_DECADE = 500


@dataclass
class Distribution:
    """Distribution of non-negative magnitudes in logarithmic bins.

    The maximum is exact; quantiles are good to 0.25 % of their value.

    >>> distribution = Distribution()
    >>> distribution.add(np.arange(1.0, 1000.0))
    >>> abs(distribution.median / 500.0 - 1.0) < 0.005, distribution.maximum
    (True, 999.0)
    """

    counts: Integers = field(
        default_factory=lambda: np.zeros(
            (_HIGHEST_EXPONENT - _LOWEST_EXPONENT) * _BINS_PER_DECADE + 1, np.int64
        )
    )
    maximum: float = 0.0
    total: int = 0

    def add(self, values: Array) -> None:
        """Count values; zero falls into the lowest bin, NaN into none."""
        finite = np.isfinite(values)
        values = values if finite.all() else values[finite]
        if values.size == 0:
            return
        with np.errstate(divide="ignore"):
            exponent = np.log10(values)  # of zero minus infinity
        exponent -= _LOWEST_EXPONENT
        exponent *= _BINS_PER_DECADE
        np.clip(exponent, 0, self.counts.size - 1, out=exponent)
        self.counts += np.bincount(exponent.astype(np.int64), minlength=self.counts.size)
        self.maximum = max(self.maximum, float(values.max()))
        self.total += values.size

    def quantile(self, share: float) -> float | None:
        """The value that a share of the values does not exceed; None without values."""
        if self.total == 0:
            return None
        number = int(np.searchsorted(np.cumsum(self.counts), share * self.total))
        if number == 0:
            return 0.0
        middle = 10.0 ** ((number + 0.5) / _BINS_PER_DECADE + _LOWEST_EXPONENT)
        return float(min(middle, self.maximum))

    @property
    def median(self) -> float | None:
        """None without values."""
        return self.quantile(0.5)

    def __add__(self, other: Distribution) -> Distribution:
        return Distribution(
            self.counts + other.counts, max(self.maximum, other.maximum), self.total + other.total
        )

    def histogram(self, bins: int = 24) -> dict[str, Any]:
        """Counts in at most ``bins`` equal bins from zero: step of 1, 2 or 5, up to the maximum.

        A value counts in the bin of the middle of its logarithmic bin, 0.25 % off at most.

        >>> distribution = Distribution()
        >>> distribution.add(np.array([0.1, 2.5, 2.6, 9.9]))
        >>> distribution.histogram(10)
        {'step': 1.0, 'counts': [1, 0, 2, 0, 0, 0, 0, 0, 0, 1]}
        """
        if self.maximum <= 0.0:
            return {"step": 1.0, "counts": [self.total] if self.total else []}
        step = round_step(self.maximum / bins)
        filled = np.flatnonzero(self.counts)
        middle = 10.0 ** ((filled + 0.5) / _BINS_PER_DECADE + _LOWEST_EXPONENT)
        number = (np.minimum(middle, self.maximum * (1.0 - 1e-12)) / step).astype(np.int64)
        counts = np.bincount(number, self.counts[filled]).astype(np.int64)
        return {"step": step, "counts": counts.tolist()}

    def summary(self) -> dict[str, float | int | None]:
        """For the manifest: six digits are more than the bins hold."""

        def short(value: float | None) -> float | None:
            return None if value is None else float(f"{value:.3g}")

        return {
            "count": self.total,
            "median": short(self.median),
            "p95": short(self.quantile(0.95)),
            "maximum": float(f"{self.maximum:.6g}") if self.total else None,
        }


@dataclass
class ShiftGrid:
    """Mean shift of the image points over the format of a camera."""

    width_px: int
    height_px: int
    columns: int = 14
    rows: int = 10
    sums: Array = field(default_factory=lambda: np.zeros((3, 10, 14)))

    def add(self, x_px: Array, y_px: Array, dx_px: Array, dy_px: Array) -> None:
        """Add shifts at pixels."""
        column = np.clip(x_px / self.width_px * self.columns, 0, self.columns - 1).astype(np.intp)
        row = np.clip(y_px / self.height_px * self.rows, 0, self.rows - 1).astype(np.intp)
        cell = row * self.columns + column
        size = self.rows * self.columns
        for i, weight in enumerate((dx_px, dy_px, np.ones(x_px.shape))):
            counted = np.bincount(cell, weight, size)
            self.sums[i] += counted.reshape(self.rows, self.columns)

    def merge(self, other: ShiftGrid) -> None:
        """Add the sums of another grid of the same camera."""
        self.sums = self.sums + other.sums

    def means(self) -> tuple[Array, Array, Array, Array]:
        """Centres x, y and mean shifts dx, dy [px] of the cells that hold observations."""
        filled = self.sums[2] > 0
        row, column = np.nonzero(filled)
        return (
            (column + 0.5) * self.width_px / self.columns,
            (row + 0.5) * self.height_px / self.rows,
            self.sums[0][filled] / self.sums[2][filled],
            self.sums[1][filled] / self.sums[2][filled],
        )

    def field(self) -> dict[str, Any]:
        """Format of the image [px], and centre x, y and mean shift dx, dy [px] of each cell."""
        columns = zip(("x_px", "y_px", "dx_px", "dy_px"), self.means(), strict=True)
        return {"format_px": [self.width_px, self.height_px], "columns": self.columns} | {
            name: [float(f"{value:.5g}") for value in values] for name, values in columns
        }


DISTRIBUTIONS = ("shift_px", "shift_ground_m", "refraction_arcsec", "window_arcsec")
"""The quantities of which `ShiftStatistics` keeps distributions."""


@dataclass
class ShiftStatistics:
    """How large the correction was in the images of one camera, or of several."""

    grid: ShiftGrid
    shift_px: Distribution = field(default_factory=Distribution)
    shift_ground_m: Distribution = field(default_factory=Distribution)
    refraction_arcsec: Distribution = field(default_factory=Distribution)
    window_arcsec: Distribution = field(default_factory=Distribution)

    def add(self, x_px: Array, y_px: Array, corrections: Corrections) -> None:
        """Add the corrections of points measured at (x, y); those without one do not count."""
        good: Any = np.isfinite(corrections.dx_px)
        good = slice(None) if good.all() else good
        dx, dy = corrections.dx_px[good], corrections.dy_px[good]
        self.grid.add(x_px[good], y_px[good], dx, dy)
        self.shift_px.add(np.sqrt(dx * dx + dy * dy))
        self.shift_ground_m.add(corrections.shift_ground_m[good])
        self.refraction_arcsec.add(corrections.r_c_rad[good] / ARCSEC)
        self.window_arcsec.add(np.abs(corrections.r_cc_rad[good]) / ARCSEC)

    def merge(self, other: ShiftStatistics) -> None:
        """Add the statistics of other images of the same camera."""
        self.grid.merge(other.grid)
        for name in DISTRIBUTIONS:
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def distributions(self) -> dict[str, Distribution]:
        """The four distributions by name."""
        return {name: getattr(self, name) for name in DISTRIBUTIONS}

    def summary(self) -> dict[str, Any]:
        """Counts, medians and maxima, for the manifest."""
        return {name: distribution.summary() for name, distribution in self.distributions().items()}

    def figures(self) -> dict[str, Any]:
        """Histograms of the shift, and its field over the image, for the manifest."""
        return {
            "histogram_px": self.shift_px.histogram(),
            "histogram_m": self.shift_ground_m.histogram(),
            "field": self.grid.field(),
        }
