"""How high the points lie that were measured in the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.tables.observations import Batch

Array = NDArray[np.float64]

LOWEST_GROUND_M, HIGHEST_GROUND_M = -600.0, 10_000.0
"""Ground heights outside this are no ground heights [m]."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights of the points above sea level: a constant, or a column plus what makes it so.

    ``offset_m`` (s,) is added per station: minus the undulation for ellipsoidal heights, the
    take-off height for relative ones. ``from_distance`` where they follow from the slant ranges.
    ``sigma_m`` is the one standard deviation of all of them, where there is one.
    """

    constant_m: float | None
    offset_m: Array
    from_distance: bool = False
    sigma_m: float | None = None

    def heights(self, batch: Batch, row: NDArray[np.int64]) -> Array:
        """(n,) heights above sea level [m] of the points of a batch."""
        if batch.ground is not None:
            given = batch.ground
        else:
            given = np.full(len(batch), self.constant_m, dtype=np.float64)
        given = plausible(given)
        offset = np.append(self.offset_m, np.nan)[row]
        # Without a station there is nothing to reduce with; the status says no_station anyway.
        return np.asarray(given + np.where(row < 0, 0.0, offset))

    def count_odd(self, batch: Batch) -> int:
        """How many heights of a batch are numbers, but those of no ground."""
        if batch.ground is None:
            return 0
        return int(np.count_nonzero(np.isfinite(batch.ground) & np.isnan(plausible(batch.ground))))

    def sigmas(self, batch: Batch) -> Array:
        """(n,) standard deviations of the heights [m], NaN where unknown."""
        if batch.ground_sigma is not None:
            return batch.ground_sigma
        return np.full(len(batch), np.nan if self.sigma_m is None else self.sigma_m)

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest height above sea level that a point can have [m]."""
        if self.constant_m is None:
            return LOWEST_GROUND_M, HIGHEST_GROUND_M
        offset = self.offset_m[np.isfinite(self.offset_m)]
        if offset.size == 0:
            offset = np.zeros(1)
        return self.constant_m + float(offset.min()), self.constant_m + float(offset.max())


def plausible(height_m: Array) -> Array:
    """Heights [m] with NaN for those of no ground."""
    sound = (height_m >= LOWEST_GROUND_M) & (height_m <= HIGHEST_GROUND_M)
    return np.where(sound, height_m, np.nan)
