"""Pressure, height and temperature: what the weight of the air column ties together."""

from dataclasses import dataclass

import numpy as np

from unbend.units import HYDROSTATIC_CONSTANT, Array

ADIABATIC_K_PER_M = 9.8e-3
"""Unsaturated air whose temperature falls faster overturns within minutes [K/m']."""

COLDEST_K, WARMEST_K = 180.0, 335.0
"""Temperatures that air has; what pressure implies outside them is not the air outside [K]."""

LEAST_RISE_M = 1.0  # less tells nothing of the fall of pressure
_SERIES_BELOW = 0.05  # of dT/T: the closed form of the moment loses 1e-16/x of its digits
_ORDER = np.arange(12)
_SERIES = (-1.0) ** _ORDER * (_ORDER + 1.0) / (_ORDER + 2.0)


@dataclass(frozen=True)
class Fall:
    """How pressure falls with height: the mean virtual temperature [K] that this implies, None
    where it does not fall, and the RMS of ln p ``unexplained`` by a parabola in height."""

    implied_k: float | None
    unexplained: float

    @property
    def is_of_air(self) -> bool:
        """Whether air of 180 to 335 K can have it."""
        return self.implied_k is not None and COLDEST_K < self.implied_k < WARMEST_K


def fall_of_pressure(height: Array, log_pressure: Array) -> Fall:
    """The mean virtual temperature that the fall of pressure with height implies.

    ``height`` (n,) heights [m'], or [m] within 0.5 %; ``log_pressure`` (n,) ln p there; n > 2. By
    the slope of a straight line (Gyer 1996, Eq. 53); 1000 m of height give it to about 2 K.

    >>> h = np.array([0.0, 1000.0, 2000.0])
    >>> round(fall_of_pressure(h, -h / 8000.0).implied_k, 2)
    273.31
    """
    if float(np.ptp(height)) < LEAST_RISE_M:
        return Fall(None, float(np.std(log_pressure)))
    rise = height - height.mean()
    # full=True: no warning where only two heights differ, and the parabola is not unique.
    slope = float(np.polyfit(rise, log_pressure, 1, full=True)[0][0])
    parabola = np.polyfit(rise, log_pressure, 2, full=True)[0]
    rest = log_pressure - np.polyval(parabola, rise)
    implied = None if slope >= 0.0 else -HYDROSTATIC_CONSTANT / slope
    return Fall(implied, float(np.sqrt(np.mean(rest**2))))


def column(edge: Array, virtual: Array, height: Array) -> tuple[Array, Array]:
    """Integral of dH/T_M from the lowest edge to heights (m,) [m'] within the edges, and gradient.

    ``edge``, ``virtual``: (k,) geopotential heights [m'], increasing, and T_M there [K], linear
    between. Returns the integral (m,) [m'/K]: ln p = ln p_0 - (G M0 / R*) times this is Gyer 1996,
    Eq. 52 and 53; and its derivatives (m, k) by T_M at the edges [m'/K2].

    In a layer of thickness D from T_0 to T_1 = T_0 (1 + x) the integral is D ln(1 + x) / (T_0 x);
    its derivative by T_1 is -D/T_0^2 (ln(1 + x) - x/(1 + x)) / x^2, the last factor 1/2 - 2 x/3 +
    3 x^2/4 - ...; by T_0 it is what that leaves of -D/(T_0 T_1).

    >>> edge, virtual = np.array([0.0, 1000.0]), np.array([250.0, 250.0])
    >>> integral, gradient = column(edge, virtual, np.array([500.0]))
    >>> integral.tolist(), (gradient * 250.0**2).round(9).tolist()
    ([2.0], [[-375.0, -125.0]])
    """
    i = np.clip(np.searchsorted(edge, height, side="right") - 1, 0, edge.size - 2)
    thickness = np.diff(edge)
    whole, by_lower, by_upper = _layer(thickness, virtual[:-1], virtual[1:])
    share = (height - edge[i]) / thickness[i]
    inside = virtual[i] + share * (virtual[i + 1] - virtual[i])
    part, by_base, by_inside = _layer(height - edge[i], virtual[i], inside)
    integral = np.concatenate([[0.0], np.cumsum(whole)])[i] + part

    below = np.append(0.0, by_upper)
    at_edge = np.append(by_lower, 0.0) + below
    gradient = np.where(np.arange(edge.size) < i[:, None], at_edge, 0.0)
    row = np.arange(height.size)
    gradient[row, i] = below[i] + by_base + (1.0 - share) * by_inside
    gradient[row, i + 1] = share * by_inside
    return integral, gradient


def hats(knot: Array, x: Array) -> Array:
    """(m, k) weights of linear interpolation between knots, constant beyond them.

    >>> hats(np.array([0.0, 2.0, 4.0]), np.array([0.5, 5.0])).tolist()
    [[0.75, 0.25, 0.0], [0.0, 0.0, 1.0]]
    """
    weights = np.zeros((x.size, knot.size))
    x = np.clip(x, knot[0], knot[-1])
    i = np.clip(np.searchsorted(knot, x, side="right") - 1, 0, knot.size - 2)
    share = (x - knot[i]) / (knot[i + 1] - knot[i])
    row = np.arange(x.size)
    weights[row, i] = 1.0 - share
    weights[row, i + 1] = share
    return weights


def _layer(thickness: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
    """Integral of dH/T over layers, and its derivatives by the lower and upper temperature."""
    x = upper / lower - 1.0
    safe = np.where(x == 0.0, 1.0, x)
    log = np.log1p(safe)
    mean = np.where(x == 0.0, 1.0, log / safe)
    thin = np.abs(x) < _SERIES_BELOW
    series = np.polynomial.polynomial.polyval(np.where(thin, x, 0.0), _SERIES)
    moment = np.where(thin, series, (log - safe / (1.0 + safe)) / safe**2)
    by_upper = -thickness * moment / lower**2
    by_lower = -thickness / (lower * upper) - by_upper
    return thickness * mean / lower, by_lower, by_upper
