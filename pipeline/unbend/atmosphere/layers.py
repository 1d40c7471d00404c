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

# Below this temperature difference across a layer Eq. 53 replaces Eq. 52: they agree to 2e-10 of
# pressure, while Eq. 52 evaluated as printed loses more and more digits (4e-9 here).
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
    not zero; for small L_b the result approaches Eq. 53 without loss of digits. ``pressure_base``
    [Pa], ``temperature_base`` [K]: at the base. ``rise``: dH above the base [m'], negative below.
    ``constant``: G M0 / R* [K/m'].

    >>> float(pressure_gradient_layer(101325.0, 288.15, -0.0065, 11000.0).round(2))
    22632.06
    """
    lapse = np.asarray(lapse, dtype=np.float64)
    rise = np.asarray(rise)
    temperature_base = np.asarray(temperature_base)
    log_warming = np.log1p(lapse * rise / temperature_base)
    return np.asarray(pressure_base * np.exp(-constant * log_warming / lapse))


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
    rise = np.asarray(rise)
    temperature_base = np.asarray(temperature_base)
    log_fall = -constant * rise / temperature_base
    return np.asarray(pressure_base * np.exp(log_fall))


@dataclass(frozen=True, eq=False)
class Layers:
    """Layers between geopotential heights, from the ground up.

    ``edge``: (m + 1,) boundaries [m'], increasing. The others are (m,): ``temperature`` T_M [K],
    ``pressure`` [Pa] and ``vapour`` e/p at the lower edge; ``lapse`` [K/m'] and ``vapour_slope``
    [1/m'], the gradients of T_M and e/p; ``source``: measured | barometric | relaxed | standard.
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
        is_increasing = bool(np.all(np.diff(self.edge) > 0.0))
        if self.edge.shape != (m + 1,) or not is_increasing:
            raise ValueError("layers need one more boundary than layers, increasing")
        is_positive = np.all(self.temperature > 0.0) and np.all(self.pressure > 0.0)
        if not bool(is_positive):
            raise ValueError("temperatures and pressures of layers must be positive")

    @property
    def edge_temperature(self) -> Array:
        """(m + 1,) T_M at the edges [K]."""
        upper_thickness = self.edge[-1] - self.edge[-2]
        top = self.temperature[-1] + self.lapse[-1] * upper_thickness
        return np.append(self.temperature, top)

    def sources_between(self, edge: Array) -> tuple[str, ...]:
        """The sources of layers between other edges (k,) [m']: those at the middles of these."""
        middle = 0.5 * (edge[1:] + edge[:-1])
        below = np.searchsorted(self.edge, middle, side="right") - 1
        layers = np.clip(below, 0, len(self.source) - 1)
        return tuple(self.source[layer] for layer in layers)

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
    thickness = np.diff(edge)
    warming = np.diff(temperature)
    warming[np.abs(warming) < _ISOTHERMAL_K] = 0.0
    lapse = warming / thickness
    base = temperature[:-1]
    fall = log_pressure_fall(base, lapse, thickness, constant)
    log_p = np.concatenate([[0.0], np.cumsum(fall)])

    anchor_height, anchor_pa = anchor
    below = np.searchsorted(edge, anchor_height, side="right") - 1
    layer = int(np.clip(below, 0, base.size - 1))
    rise = np.asarray(anchor_height - edge[layer])
    fall_to_anchor = log_pressure_fall(base[layer], lapse[layer], rise, constant)
    log_p += np.log(anchor_pa) - (log_p[layer] + fall_to_anchor)
    return Layers(
        edge=edge,
        temperature=base,
        lapse=lapse,
        pressure=np.exp(log_p[:-1]),
        vapour=vapour[:-1],
        vapour_slope=np.diff(vapour) / thickness,
        source=source,
    )


def log_pressure_fall(
    base: Array,
    lapse: Array,
    rise: Array,
    constant: float,
) -> Array:
    """ln(p / p_b) at a height ``rise`` [m'] above the base, negative for a fall of pressure.

    By Eq. 52 where the lapse rate [K/m'] is not zero, else by Eq. 53. ``base``: T_M at the base
    [K]; ``constant``: G M0 / R* [K/m'].
    """
    has_gradient = lapse != 0.0
    divisor = np.where(has_gradient, lapse, 1.0)
    by_52 = np.log(pressure_gradient_layer(1.0, base, divisor, rise, constant))
    by_53 = np.log(pressure_isothermal_layer(1.0, base, rise, constant))
    return np.asarray(np.where(has_gradient, by_52, by_53))
