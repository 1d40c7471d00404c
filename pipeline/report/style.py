"""What our plots share: their style, axes, colours, and how samples are drawn."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")
R = TypeVar("R")

MEASURED, REJECTED = "#c2410c", "#fdba74"
ADJUSTED = "#1d4ed8"
STANDARD = "#64748b"
_MOST_POINTS = 1500


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw in our style, and leave that of whoever called as it was."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        import matplotlib as mpl

        style = {"svg.hashsalt": "unbend", "svg.fonttype": "path", "font.size": 9}
        with mpl.rc_context(style):
            return draw(*args, **kwargs)

    return drawn


def new_figure(
    columns: int, width: float, height: float, rows: int = 1
) -> tuple[Figure, list[Axes]]:
    """A figure [inch] and its axes, row by row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#e2e8f0", linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, list(axes)


def height_range(samples: AirSamples) -> tuple[float, float]:
    """Heights to draw [m above sea level]: those sampled, and a margin."""
    heights = [
        s.h_m[np.isfinite(s.h_m)] for s in (samples.temperature, samples.pressure) if s is not None
    ]
    heights = [h for h in heights if h.size]
    if not heights:
        return 0.0, 10_000.0
    low, high = min(h.min() for h in heights), max(h.max() for h in heights)
    margin = max(0.08 * (high - low), 50.0)
    return float(low - margin), float(high + margin)


def scatter(
    axis: Axes,
    samples: SensorSamples,
    value: NDArray[np.float64],
    rejected: NDArray[np.bool_] | None = None,
) -> None:
    """Samples against height, those that are not used in another colour and in front.

    ``value`` (n,) in the unit of the axis; ``rejected`` (n,) outliers among the accepted.
    """
    used = samples.accepted if rejected is None else samples.accepted & ~rejected
    for mask, color, label in (
        (used, MEASURED, f"{samples.name}, used"),
        (~used, REJECTED, f"{samples.name}, not used"),
    ):
        chosen = np.flatnonzero(mask & np.isfinite(samples.h_m) & np.isfinite(value))
        chosen = chosen[:: max(1, chosen.size // _MOST_POINTS)]
        if chosen.size:
            axis.plot(
                value[chosen], samples.h_m[chosen], ".", ms=1.6, alpha=0.5, color=color,
                label=label, rasterized=True,
            )  # fmt: skip
