"""The profile of the air: layers in hydrostatic equilibrium, and the air at any height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.atmosphere.layers import MEASURED, Layers, log_pressure_fall, stack_layers
from unbend.atmosphere.refractive_index import IndexModel
from unbend.geodesy import Gravity
from unbend.notebook import html_table, new_axes
from unbend.units import HECTOPASCAL, HYDROSTATIC_CONSTANT, VAPOUR_DEFICIT, Array, Rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HIGHEST_PLOTTED_M = 12_000.0  # of a plot without heights: most cameras are below

_EDGE_SLACK_M = 1e-7  # a height computed from an edge may miss it by a rounding error [m']
_SHOWN_IN_NOTEBOOK = (
    "h_m",
    "temperature_k",
    "pressure_pa",
    "vapour_pressure_pa",
    "refractivity",
    "source",
)


@dataclass(frozen=True, eq=False)
class Profile:
    """Temperature, pressure, humidity and refractivity as functions of height.

    Heights are metres above mean sea level, of any shape; outside ``bottom_m`` to ``top_m`` the
    functions return NaN. ``name`` is a standard's, or ``adjusted``; ``constant`` G M0 / R* of the
    model [K/m'].
    """

    layers: Layers
    gravity: Gravity
    index: IndexModel = field(default_factory=IndexModel)
    name: str = "adjusted"
    constant: float = HYDROSTATIC_CONSTANT

    def __repr__(self) -> str:
        """Name, heights and layers, and the air at sea level, or at the bottom if that is higher.

        >>> from unbend.atmosphere import standard_atmosphere
        >>> standard_atmosphere("icao")
        <Profile icao: -4996 to 81020 m, 8 layers; at 0 m 288.15 K, 1013.25 hPa, n - 1 = 277.8e-6>
        """
        h_m = max(0.0, self.bottom_m)
        temperature_k = float(self.temperature(h_m))
        pressure_hpa = float(self.pressure(h_m)) / HECTOPASCAL
        refractivity = 1e6 * float(self.refractivity(h_m))
        return (
            f"<Profile {self.name}: {self.bottom_m:.0f} to {self.top_m:.0f} m, "
            f"{self.layers.edge.size - 1} layers; at {h_m:.0f} m {temperature_k:.2f} K, "
            f"{pressure_hpa:.2f} hPa, n - 1 = {refractivity:.1f}e-6>"
        )

    def _repr_html_(self) -> str:
        """The profile at the edges of its layers, as a notebook shows it."""
        table = profile_table(self)
        shown = {}
        for name in _SHOWN_IN_NOTEBOOK:
            shown[name] = table[name]
        return html_table(repr(self), shown)

    @property
    def extent(self) -> str:
        """Name and range of heights, for error messages."""
        return f"profile {self.name}, {self.bottom_m:.0f} to {self.top_m:.0f} m"

    @property
    def bottom_m(self) -> float:
        """Height of the lowest edge [m above sea level]."""
        return float(self.gravity.height(self.layers.edge[0]))

    @property
    def top_m(self) -> float:
        """Height of the highest edge [m above sea level]."""
        return float(self.gravity.height(self.layers.edge[-1]))

    @property
    def break_heights_m(self) -> Array:
        """(m + 1,) heights at which layers meet [m]."""
        return self.gravity.height(self.layers.edge)

    def layer_of(self, h: ArrayLike) -> Rows:
        """Number of the layer at a height, -1 outside the profile."""
        height = self.gravity.geopotential_height(h)
        edge = self.layers.edge
        below = np.searchsorted(edge, height, side="right") - 1
        layer = np.clip(below, 0, edge.size - 2)
        is_above_bottom = height >= edge[0] - _EDGE_SLACK_M
        is_below_top = height <= edge[-1] + _EDGE_SLACK_M
        return np.where(is_above_bottom & is_below_top, layer, -1)

    def state(self, h: ArrayLike) -> tuple[Array, Array, Array]:
        """T_M [K], p [Pa] and e/p at heights ``h`` [m above sea level]; NaN outside."""
        layers = self.layers
        layer = self.layer_of(h)
        rise = self.gravity.geopotential_height(h) - layers.edge[layer]
        rise = np.where(layer < 0, np.nan, rise)
        base = layers.temperature[layer]
        lapse = layers.lapse[layer]
        log_fall = log_pressure_fall(base, lapse, rise, self.constant)
        t_m = base + lapse * rise
        p = layers.pressure[layer] * np.exp(log_fall)
        vapour = layers.vapour[layer] + layers.vapour_slope[layer] * rise
        return t_m, p, vapour

    def virtual_temperature(self, h: ArrayLike) -> Array:
        """T_M [K] at heights ``h`` [m]."""
        return self.state(h)[0]

    def temperature(self, h: ArrayLike) -> Array:
        """Temperature [K] at heights ``h`` [m above sea level]; NaN outside the profile.

        >>> from unbend.atmosphere import standard_atmosphere
        >>> standard_atmosphere("us1976").temperature([0.0, 5000.0]).round(3).tolist()
        [288.15, 255.676]
        """
        t_m, _, vapour = self.state(h)
        return t_m * (1.0 - VAPOUR_DEFICIT * vapour)

    def pressure(self, h: ArrayLike) -> Array:
        """Pressure [Pa] at heights ``h`` [m above sea level]; NaN outside the profile.

        >>> from unbend.atmosphere import standard_atmosphere
        >>> standard_atmosphere("us1976").pressure(5000.0).round(1).item()
        54048.3
        """
        return self.state(h)[1]

    def vapour_pressure(self, h: ArrayLike) -> Array:
        """Partial pressure of water vapour [Pa] at heights ``h`` [m above sea level]."""
        _, p, vapour = self.state(h)
        return vapour * p

    def refractivity(self, h: ArrayLike) -> Array:
        """Refractivity n - 1 at heights ``h`` [m above sea level]; NaN outside the profile.

        >>> from unbend.atmosphere import standard_atmosphere
        >>> profile = standard_atmosphere("ardc1959", index="gyer")
        >>> (profile.refractivity(5000.0) * 1e6).round(2).item()
        166.64
        """
        t_m, p, vapour = self.state(h)
        t = t_m * (1.0 - VAPOUR_DEFICIT * vapour)
        return self.index.refractivity(t, p, vapour * p)

    def at_level(self, h: ArrayLike, pressure_pa: ArrayLike) -> Profile:
        """The profile with all pressures multiplied by one factor, to fit measured ones.

        The median of ln(measured / profile) becomes 0. ``h`` (n,): heights [m above sea level] of
        the pressures (n,) [Pa]; those outside the profile, or not finite, do not count.
        """
        measured_pa = np.asarray(pressure_pa, np.float64)
        log_ratio = np.log(measured_pa / self.pressure(h))
        log_ratio = log_ratio[np.isfinite(log_ratio)]
        if log_ratio.size == 0:
            return self
        factor = float(np.exp(np.median(log_ratio)))
        layers = replace(self.layers, pressure=self.layers.pressure * factor)
        return replace(self, layers=layers)

    def to_pandas(self, h: ArrayLike | None = None) -> Any:
        """The profile as a pandas DataFrame, at heights [m] or at its layer boundaries."""
        import pandas as pd

        return pd.DataFrame(profile_table(self, h))

    def plot(self, h: ArrayLike | None = None, axes: Sequence[Axes] | None = None) -> list[Axes]:
        """Draw temperature, pressure, vapour pressure and refractivity over height.

        ``h`` : (n,) heights [m above sea level]; by default from the bottom to 12 km. ``axes`` :
        four axes that another profile was drawn on; by default those of a new figure.
        Refuses (ConfigError PLOT-MATPLOTLIB) where matplotlib is not installed.
        """
        if axes is None:
            axes = new_axes(4)
        if h is None:
            h = np.linspace(self.bottom_m, min(self.top_m, HIGHEST_PLOTTED_M), 500)
        heights = np.asarray(h, np.float64)
        curves = {
            "temperature [K]": self.temperature(heights),
            "pressure [hPa]": self.pressure(heights) / HECTOPASCAL,
            "vapour pressure [hPa]": self.vapour_pressure(heights) / HECTOPASCAL,
            "(n - 1) 10^6": self.refractivity(heights) * 1e6,
        }
        for axis, (label, values) in zip(axes, curves.items(), strict=True):
            axis.plot(values, heights, label=self.name)
            axis.set_xlabel(label)
        axes[0].set_ylabel("height above sea level [m]")
        axes[0].legend()
        return list(axes)


def profile_table(profile: Profile, h: ArrayLike | None = None) -> dict[str, Any]:
    """The profile as columns; each pressure can be recomputed from its row by Eq. 52 or 53.

    ``h`` : (n,) heights [m above sea level]; by default the layer boundaries. ``t_base_k`` is the
    virtual temperature T_M at the layer's base; ``lapse_k_per_m`` is per geopotential metre.
    """
    if h is None:  # each layer at its lower edge, and the top of the last
        heights = profile.break_heights_m
        layer = np.minimum(np.arange(heights.size), heights.size - 2)
    else:
        heights = np.asarray(h, dtype=np.float64)
        layer = profile.layer_of(heights)
    if bool(np.any(layer < 0)):
        raise messages.heights_outside_profile(
            lowest_m=heights.min(), highest_m=heights.max(), where=profile.extent
        )
    layers = profile.layers
    return {
        "h_m": heights,
        "geopotential_m": profile.gravity.geopotential_height(heights),
        "temperature_k": profile.temperature(heights),
        "virtual_temperature_k": profile.virtual_temperature(heights),
        "pressure_pa": profile.pressure(heights),
        "vapour_pressure_pa": profile.vapour_pressure(heights),
        "refractivity": profile.refractivity(heights),
        "layer": layer.astype(np.int32),
        "equation": layers.equation[layer],
        "h_base_m": profile.gravity.height(layers.edge[layer]),
        "geopotential_base_m": layers.edge[layer],
        "t_base_k": layers.temperature[layer],
        "p_base_pa": layers.pressure[layer],
        "lapse_k_per_m": layers.lapse[layer],
        "source": np.array([layers.source[number] for number in layer], dtype=object),
    }


def heights_every(profile: Profile, step: float) -> Array:
    """Heights [m above sea level] at whole multiples of ``step`` inside a profile, to 30 km.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> heights_every(standard_atmosphere("us1976"), 10000.0).tolist()
    [0.0, 10000.0, 20000.0, 30000.0]
    """
    first = np.ceil(profile.bottom_m / step)
    last = np.floor(min(profile.top_m, 30_000.0) / step)
    return np.arange(first, last + 1.0) * step + 0.0


def profile_from_table(
    h: ArrayLike,
    temperature_k: ArrayLike,
    pressure_pa: ArrayLike,
    vapour_pressure_pa: ArrayLike = 0.0,
    *,
    gravity: Gravity,
    index: IndexModel | None = None,
    name: str = "table",
) -> Profile:
    """A profile through a table of the air, such as a sounding or a known truth.

    Temperature and humidity are those of the table. Pressure is hydrostatic (Eq. 52-53), because
    jumps of pressure between layers would reflect rays; its level fits the tabulated pressures in
    the median (`Profile.at_level`). ``h``: (n,) heights [m above sea level], increasing.
    """
    edge = gravity.geopotential_height(h)
    t = np.asarray(temperature_k, np.float64)
    p = np.asarray(pressure_pa, np.float64)
    e = np.asarray(vapour_pressure_pa, np.float64)
    vapour = np.broadcast_to(e, t.shape) / p
    layers = stack_layers(
        edge,
        t / (1.0 - VAPOUR_DEFICIT * vapour),
        vapour,
        (MEASURED,) * (edge.size - 1),
        anchor=(float(edge[0]), float(p[0])),
    )
    profile = Profile(layers, gravity, index or IndexModel(), name)
    return profile.at_level(gravity.height(edge), p)
