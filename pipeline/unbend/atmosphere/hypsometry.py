"""Hydrostatics: pressure, height and temperature by the weight of the air column."""

from dataclasses import dataclass

import numpy as np

from unbend.units import HYDROSTATIC_CONSTANT, Array, Rows

ADIABATIC_K_PER_M = 9.8e-3
"""Dry adiabatic lapse rate [K/m']: unsaturated air with a faster fall overturns within minutes."""

# Temperatures of air between the ground and the stratosphere [K]: pressures that imply others are
# not those outside.
COLDEST_K = 180.0
WARMEST_K = 335.0

LEAST_RISE_M = 1.0  # over a smaller range of heights the fall of pressure is not determined [m']
_SERIES_BELOW = 0.05  # of dT/T: the closed form of the moment loses 1e-16/x of its digits
_ORDER = np.arange(12)
_SERIES = (-1.0) ** _ORDER * (_ORDER + 1.0) / (_ORDER + 2.0)  # 1/2 - 2 x/3 + 3 x^2/4 - ...


@dataclass(frozen=True)
class Fall:
    """How pressure falls with height.

    ``implied_k``: the mean virtual temperature [K] that this implies, None if pressure does not
    fall, or heights differ too little. ``unexplained``: RMS of ln p about a parabola in height.
    """

    implied_k: float | None
    unexplained: float

    @property
    def is_of_air(self) -> bool:
        """Whether the implied temperature is that of possible air, 180 to 335 K."""
        if self.implied_k is None:
            return False
        return COLDEST_K < self.implied_k < WARMEST_K


def fall_of_pressure(
    height: Array,
    log_pressure: Array,
) -> Fall:
    """How pressure falls with height, with the mean virtual temperature that this implies.

    ``height`` (n,): heights [m'], or [m] within 0.5 %; ``log_pressure`` (n,): ln p there; n > 2.
    The temperature follows from the slope of a straight line (Gyer 1996, Eq. 53), over 1000 m of
    height to about 2 K.

    >>> h = np.array([0.0, 1000.0, 2000.0])
    >>> round(fall_of_pressure(h, -h / 8000.0).implied_k, 2)
    273.31
    """
    extent = float(np.ptp(height))
    if extent < LEAST_RISE_M:
        return Fall(implied_k=None, unexplained=float(np.std(log_pressure)))
    rise = height - height.mean()
    # full=True: no warning where only two heights differ, and the parabola is not unique.
    line, *_ = np.polyfit(rise, log_pressure, 1, full=True)
    parabola, *_ = np.polyfit(rise, log_pressure, 2, full=True)
    residual = log_pressure - np.polyval(parabola, rise)
    mean_square = np.mean(residual**2)
    unexplained = float(np.sqrt(mean_square))
    slope = float(line[0])
    if slope >= 0.0:
        return Fall(implied_k=None, unexplained=unexplained)
    return Fall(-HYDROSTATIC_CONSTANT / slope, unexplained)


def inverse_temperature_integral(
    edge: Array,
    virtual: Array,
    height: Array,
) -> tuple[Array, Array]:
    """Integral of dH/T_M from the lowest edge to each height (m,) [m'], and its derivatives.

    ``edge``, ``virtual``: (k,) geopotential heights [m'], increasing, and T_M there [K], linear
    between. Heights are within the edges. Returns the integral (m,) [m'/K], with which
    ln p = ln p_0 - (G M0 / R*) times the integral (Gyer 1996, Eq. 52 and 53), and its derivatives
    (m, k) by T_M at the edges [m'/K2].

    In a layer of thickness D from T_0 to T_1 = T_0 (1 + x) the integral is D ln(1 + x) / (T_0 x);
    its derivative by T_1 is -D/T_0^2 (ln(1 + x) - x/(1 + x)) / x^2, the last factor 1/2 - 2 x/3 +
    3 x^2/4 - ...; its derivative by T_0 is -D/(T_0 T_1) minus that by T_1.

    >>> edge, virtual = np.array([0.0, 1000.0]), np.array([250.0, 250.0])
    >>> integral, gradient = inverse_temperature_integral(edge, virtual, np.array([500.0]))
    >>> integral.tolist(), (gradient * 250.0**2).round(9).tolist()
    ([2.0], [[-375.0, -125.0]])
    """
    layer = _interval_of(edge, height)
    thickness = np.diff(edge)
    whole, by_lower, by_upper = _layer(thickness, virtual[:-1], virtual[1:])

    # The part of a height's own layer below it, where T_M is linear between the edges.
    rise = height - edge[layer]
    share = rise / thickness[layer]
    part, by_base, by_virtual_there = _layer(
        rise,
        virtual[layer],
        virtual[layer] + share * (virtual[layer + 1] - virtual[layer]),
    )
    integral = np.concatenate([[0.0], np.cumsum(whole)])[layer] + part

    # An edge's temperature is that of the top of a layer and of the base of the next.
    by_top = np.append(0.0, by_upper)
    by_edge = np.append(by_lower, 0.0) + by_top
    gradient = np.where(np.arange(edge.size) < layer[:, None], by_edge, 0.0)
    row = np.arange(height.size)
    gradient[row, layer] = by_top[layer] + by_base + (1.0 - share) * by_virtual_there
    gradient[row, layer + 1] = share * by_virtual_there
    return integral, gradient


def interpolation_weights(knot: Array, x: Array) -> Array:
    """(m, k) weights of values at knots (k,) in their linear interpolation to points ``x`` (m,).

    ``knot`` increases; beyond the knots the interpolation is constant.

    >>> interpolation_weights(np.array([0.0, 2.0, 4.0]), np.array([0.5, 5.0])).tolist()
    [[0.75, 0.25, 0.0], [0.0, 0.0, 1.0]]
    """
    weights = np.zeros((x.size, knot.size))
    x = np.clip(x, knot[0], knot[-1])
    lower = _interval_of(knot, x)
    upper = lower + 1
    share = (x - knot[lower]) / (knot[upper] - knot[lower])
    row = np.arange(x.size)
    weights[row, lower] = 1.0 - share
    weights[row, upper] = share
    return weights


def _interval_of(knot: Array, x: Array) -> Rows:
    """(m,) number of the interval between knots (k,) of each value (m,), from 0 to k - 2.

    Interval i is between knots i and i + 1; values beyond the knots are in the first or the last.
    """
    below = np.searchsorted(knot, x, side="right") - 1
    return np.clip(below, 0, knot.size - 2)


def _layer(
    thickness: Array,
    lower: Array,
    upper: Array,
) -> tuple[Array, Array, Array]:
    """(n,) integral of dH/T over each layer, and its derivatives by the two temperatures.

    ``lower``, ``upper`` (n,): temperatures at its base and top [K], linear between; formulas in
    `inverse_temperature_integral`.
    """
    x = upper / lower - 1.0
    is_isothermal = x == 0.0
    divisor = np.where(is_isothermal, 1.0, x)
    log = np.log1p(divisor)
    mean = np.where(is_isothermal, 1.0, log / divisor)
    integral = thickness * mean / lower

    is_small = np.abs(x) < _SERIES_BELOW
    small = np.where(is_small, x, 0.0)
    series = np.polynomial.polynomial.polyval(small, _SERIES)
    difference = log - divisor / (1.0 + divisor)
    closed = difference / divisor**2
    moment = np.where(is_small, series, closed)
    by_upper = -thickness * moment / lower**2
    by_both = -thickness / (lower * upper)
    by_lower = by_both - by_upper
    return integral, by_lower, by_upper
