"""Knots in geopotential height at which the state has temperatures and humidities."""

import numpy as np

from unbend.units import Array

FINEST_M = 50.0  # between knots of temperature at heights that were sampled [m']
MOST_FINE = 200  # knots there; where this is too few, they are farther apart

MARGIN_M = 100.0  # fine knots go on so far beyond the samples [m']
WIDENING = 1.25  # farther from the samples, each layer is so many times thicker than the last
WIDEST_M = 750.0  # and at most so thick [m']
TOP_M = 32_000.0  # above, the background's own breakpoints suffice [m']

HUMID_M = 250.0  # between knots of humidity [m']
HUMID_TOP_M = 15_000.0  # above, vapour weighs less than 1e-5 of n - 1 [m']
HUMID_BOTTOM_M = -4000.0


def place_knots(
    low: float,
    high: float,
    edge: Array,
) -> Array:
    """Knots [m'] of temperature: fine from ``low`` to ``high``, wider and wider beyond.

    ``low``, ``high``: lowest and highest measurement [m']. ``edge``: breakpoints of the background
    [m'], increasing; all of them are knots too, and the first and last are the ends.

    >>> place_knots(0.0, 200.0, np.array([-5000.0, 11e3, 20e3]))[14:20].round().tolist()
    [-100.0, -50.0, 0.0, 50.0, 100.0, 150.0]
    """
    bottom = edge[0]
    top = edge[-1]
    low = max(low - MARGIN_M, bottom + MARGIN_M)
    high = min(high + MARGIN_M, top - MARGIN_M)
    least_step = max(FINEST_M, (high - low) / MOST_FINE)
    steps = max(1, round((high - low) / least_step))
    fine = np.linspace(low, high, 1 + steps)
    step = fine[1] - fine[0]

    thickness = np.minimum(step * WIDENING ** np.arange(1, 100), WIDEST_M)
    distance = np.cumsum(thickness)
    above = high + distance
    above = above[above < min(TOP_M, top - step)]
    below = low - distance
    below = below[below > bottom + step]

    # A knot next to a breakpoint of the background would make a sliver of a layer.
    knots = np.concatenate([below[::-1], fine, above])
    distances = np.abs(knots[:, None] - edge)
    is_apart = distances.min(axis=1) > 0.4 * step
    return np.unique(np.concatenate([knots[is_apart], edge]))


def place_humid_knots(
    low: float,
    high: float,
) -> Array:
    """Knots [m'] of relative humidity: 250 m' apart about ``low`` to ``high``, 500 m' above.

    ``low``, ``high``: lowest and highest measurement [m']. The air at the last knot is taken as
    dry.
    """
    coarse_m = 2.0 * HUMID_M
    bottom = max(low - coarse_m, HUMID_BOTTOM_M)
    fine_top = min(high + coarse_m, HUMID_TOP_M - 3.0 * HUMID_M)
    fine_top = max(fine_top, bottom + HUMID_M)
    fine = np.arange(bottom, fine_top, HUMID_M)
    coarse = np.arange(fine[-1] + coarse_m, HUMID_TOP_M - HUMID_M, coarse_m)
    return np.concatenate([fine, coarse, [HUMID_TOP_M]])
