"""Layers of the air: Gyer 1996, Eq. 52 and 53.

In each layer the virtual temperature T_M (dry air of it has the density of the moist air) and the
vapour fraction e/p are linear in geopotential height; pressure follows in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.units import HYDROSTATIC_CONSTANT, Array

MEASURED = "measured"
BAROMETRIC = "barometric"
RELAXED = "relaxed"
STANDARD = "standard"

# Below this temperature difference across a layer Eq. 53 stands for Eq. 52: they agree to 2e-10 of
# pressure, while Eq. 52 evaluated as it is printed loses ever more digits (4e-9 here).
_ISOTHERMAL_K = 1e-7


def pressure_gradient_layer(
    pressure_base: ArrayLike,
    temperature_base: ArrayLike,
    lapse: ArrayLike,
    rise: ArrayLike,
    constant: float = HYDROSTATIC_CONSTANT,
) -> Array:
    """Pressure [Pa] in a layer with a temperature gradient (Gyer 1996, Eq. 52).

    p = p_b (T_b / (T_b + L_b dH)) ** (G M0 / (R* L_b)), with L_b in the exponent (the paper
    prints T_b) and the unit geopotential G, since gravity is already in H. ``lapse``: L_b [K/m'],
    not zero; however small, the result goes over into Eq. 53 without loss of digits. Base in [Pa]
    and [K]; ``rise``: dH [m'], negative below it. ``constant``: G M0 / R* [K/m'].

    >>> float(pressure_gradient_layer(101325.0, 288.15, -0.0065, 11000.0).round(2))
    22632.06
    """
    lapse = np.asarray(lapse, dtype=np.float64)
    warming = np.log1p(lapse * np.asarray(rise) / np.asarray(temperature_base))
    return np.asarray(pressure_base * np.exp(-constant * warming / lapse))


def pressure_isothermal_layer(
    pressure_base: ArrayLike,
    temperature_base: ArrayLike,
    rise: ArrayLike,
    constant: float = HYDROSTATIC_CONSTANT,
) -> Array:
    """Pressure [Pa] in a layer of constant temperature (Gyer 1996, Eq. 53).

    p = p_b exp(-G M0 dH / (R* T_b)); arguments as for `pressure_gradient_layer`.

    >>> float(pressure_isothermal_layer(22632.06, 216.65, 9000.0).round(1))
    5474.9
    """
    return np.asarray(
        pressure_base * np.exp(-constant * np.asarray(rise) / np.asarray(temperature_base))
    )


@dataclass(frozen=True, eq=False)
class Layers:
    """Layers between geopotential heights, from the ground up.

    ``edge``: (m + 1,) boundaries [m'], increasing. The others (m,): T_M [K], ``pressure`` [Pa] and
    ``vapour`` e/p at the lower edge, gradients of T_M [K/m'] and of e/p [1/m'], and ``source``:
    measured | barometric | relaxed | standard.
    """

    edge: Array
    temperature: Array
    lapse: Array
    pressure: Array
    vapour: Array
    vapour_slope: Array
    source: tuple[str, ...]

    def __post_init__(self) -> None:
        m = self.temperature.shape[0]
        if self.edge.shape != (m + 1,) or not bool(np.all(np.diff(self.edge) > 0.0)):
            raise ValueError("layers need one more boundary than layers, increasing")
        if not bool(np.all(self.temperature > 0.0) and np.all(self.pressure > 0.0)):
            raise ValueError("temperatures and pressures of layers must be positive")

    @property
    def edge_temperature(self) -> Array:
        """(m + 1,) T_M at the edges [K]."""
        top = self.temperature[-1] + self.lapse[-1] * (self.edge[-1] - self.edge[-2])
        return np.append(self.temperature, top)

    def sources_between(self, edge: Array) -> tuple[str, ...]:
        """Where layers between other edges (k,) [m'] come from: the source at their middles."""
        middle = 0.5 * (edge[1:] + edge[:-1])
        i = np.searchsorted(self.edge, middle, side="right") - 1
        return tuple(self.source[j] for j in np.clip(i, 0, len(self.source) - 1))

    @property
    def equation(self) -> NDArray[np.int16]:
        """(m,) 52 or 53: which of Gyer's equations gives the pressure."""
        return np.where(self.lapse == 0.0, 53, 52).astype(np.int16)


def stack_layers(
    edge: Array,
    temperature: Array,
    vapour: Array,
    source: tuple[str, ...],
    *,
    anchor: tuple[float, float],
    constant: float = HYDROSTATIC_CONSTANT,
) -> Layers:
    """Layers through T_M [K] and e/p (m + 1,) at their edges [m'], with pressure by Eq. 52-53.

    ``anchor``: a geopotential height [m'] within the edges and the pressure there [Pa].
    """
    thickness, warming = np.diff(edge), np.diff(temperature)
    warming[np.abs(warming) < _ISOTHERMAL_K] = 0.0
    base, lapse = temperature[:-1], warming / thickness
    fall = log_pressure_fall(base, lapse, thickness, constant)
    log_p = np.concatenate([[0.0], np.cumsum(fall)])
    height, pressure = anchor
    i = int(np.clip(np.searchsorted(edge, height, side="right") - 1, 0, base.size - 1))
    inside = log_pressure_fall(base[i], lapse[i], np.asarray(height - edge[i]), constant)
    log_p += np.log(pressure) - (log_p[i] + inside)
    return Layers(
        edge, base, lapse, np.exp(log_p[:-1]), vapour[:-1], np.diff(vapour) / thickness, source
    )


def log_pressure_fall(base: Array, lapse: Array, rise: Array, constant: float) -> Array:
    """ln(p / p_b) by Eq. 52 where the lapse rate is not zero, by Eq. 53 where it is."""
    safe = np.where(lapse != 0.0, lapse, 1.0)
    by_52 = np.log(pressure_gradient_layer(1.0, base, safe, rise, constant))
    by_53 = np.log(pressure_isothermal_layer(1.0, base, rise, constant))
    return np.asarray(np.where(lapse != 0.0, by_52, by_53))
