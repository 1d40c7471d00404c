"""What refraction real air has, over that in the standard atmosphere between the same heights.

The limits lie half as far again from the median as the outermost of 479 public ascents (Vienna
2015, North America, Darwin, dropsondes, convective afternoons), from the lowest level upwards: R at
45 degrees is 0.71 to 1.75 times the standard's over 1 km, 0.76 to 1.35 times over 3 km and 0.86 to
1.18 times over 8 km. Over less than 500 m the lowest layer decides, and may even turn its sign.
"""

import math
from typing import NamedTuple

import numpy as np

LOWEST_CLIMB_M = 500.0
CLIMB_M = [LOWEST_CLIMB_M, 1000.0, 2000.0, 4000.0, 8000.0]  # from the ground to the camera
LOWEST_FACTOR = [0.20, 0.55, 0.65, 0.70, 0.80]
HIGHEST_FACTOR = [3.30, 2.30, 1.80, 1.50, 1.32]
SURE_SIGMAS = 2.0  # of the factor, beyond a limit


class FactorLimits(NamedTuple):
    """The lowest and the highest R of real air, over that in the standard atmosphere."""

    lowest: float
    highest: float

    def are_surely_passed(self, factor: float, sigma: float) -> bool:
        """Whether a factor lies outside by more than its own sigma explains; NaN: has none."""
        allowed = 0.0
        if math.isfinite(sigma):
            allowed = SURE_SIGMAS * sigma
        is_too_low = factor + allowed < self.lowest
        is_too_high = factor - allowed > self.highest
        return is_too_low or is_too_high


def limits_of_factor(climb_m: float, usual_factor: float = 1.0) -> FactorLimits | None:
    """The limits for rays that climb so far, None where they may have any R.

    ``usual_factor`` is R in the climatology of place and season over that in the standard: where
    both differ, as in a polar winter, the limits reach from one to the other.

    >>> limits_of_factor(1000.0)
    FactorLimits(lowest=0.55, highest=2.3)
    """
    if climb_m < LOWEST_CLIMB_M:
        return None
    octaves = np.log2(CLIMB_M)
    octave = math.log2(climb_m)
    lowest = float(np.interp(octave, octaves, LOWEST_FACTOR))
    highest = float(np.interp(octave, octaves, HIGHEST_FACTOR))
    return FactorLimits(
        lowest=lowest * min(1.0, usual_factor),
        highest=highest * max(1.0, usual_factor),
    )
