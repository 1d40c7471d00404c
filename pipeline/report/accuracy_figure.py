"""The picture of the comparison page: where the error of each method passes 0.1 and 1 arcsec."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.refraction.published.compare import Comparison
from pipeline.units import ARCSEC, DEGREE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BANDS = ("#d9f0e3", "#fdecc8", "#f5c6c0")
_LABELS = ("below 0.1", "0.1 to 1", "above 1 arcsec")
_LINE = "#334155"
_RAISED = "#1d4ed8"
_TICKS_KM = (0.5, 1, 2, 5, 10, 20)


def accuracy_png(over: tuple[Comparison, ...], belongs_to: str) -> bytes:
    """The picture as PNG; ``belongs_to`` is kept in it as its description."""
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 8}):
        buffer = io.BytesIO()
        note = {"Software": None, "Description": belongs_to}
        accuracy_figure(over).savefig(buffer, format="png", dpi=110, metadata=note)
    return buffer.getvalue()


def accuracy_figure(over: tuple[Comparison, ...]) -> Figure:
    """Nadir angle against height of the camera, a panel a method.

    ``over`` : the ground that is drawn, and another of which only one line is.
    """
    from matplotlib.figure import Figure

    comparison, raised = over
    columns = 3
    rows = -(-len(comparison.methods) // columns)
    figure = Figure(figsize=(7.6, 2.1 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for number, (name, axis) in enumerate(zip(comparison.methods, axes.flat, strict=False)):
        axis.set_axis_on()
        axis.set_title(name, fontsize=8.5)
        _draw(axis, comparison, number)
        _draw_raised(axis, raised, number)
        if number % columns == 0:
            axis.set_ylabel("camera [km]")
        if number + columns >= len(comparison.methods):
            axis.set_xlabel("nadir angle [°]")
            axis.tick_params(labelbottom=True)
    handles = _legend(raised.h_g_m)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.suptitle(f"error of each method, ground at {comparison.h_g_m:.0f} m", fontsize=9.5)
    return figure


def _legend(raised_m: float) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    named = [*zip(_BANDS, _LABELS, strict=True), ("white", "not defined")]
    patches = [
        Patch(facecolor=c, edgecolor=_LINE, linewidth=0.5, label=label) for c, label in named
    ]
    line = Line2D(
        [], [], color=_RAISED, ls="--", lw=1.2, label=f"1 arcsec, ground {raised_m:.0f} m"
    )
    return [*patches, line]


def _draw(axis: Axes, comparison: Comparison, number: int) -> None:
    """Bands of the size of the error, with a line where one goes over into the next."""
    angle, height, size = _logarithm(comparison, number)
    axis.contourf(angle, height, size, levels=[-7.0, -1.0, 0.0, 7.0], colors=_BANDS)
    axis.contour(
        angle, height, size, levels=[-1.0, 0.0], colors=_LINE, linewidths=(0.6, 1.0),
        linestyles="solid",
    )  # fmt: skip
    axis.set_yscale("log")
    axis.set_yticks(_TICKS_KM, [f"{tick:g}" for tick in _TICKS_KM])
    axis.set_yticks([], minor=True)
    axis.set_xticks([0, 30, 45, 60, 75, 85])
    axis.set_ylim(height[0], height[-1])


def _draw_raised(axis: Axes, comparison: Comparison, number: int) -> None:
    """Where the error passes 1 arcsec over the other ground, if it does."""
    angle, height, size = _logarithm(comparison, number)
    if size.min() < 0.0 < size.max():
        axis.contour(
            angle, height, size, levels=[0.0], colors=_RAISED, linewidths=1.2, linestyles="dashed"
        )


def _logarithm(comparison: Comparison, number: int) -> tuple[Any, Any, Any]:
    """Angles [deg], heights [km] and log10 of the size of the error [arcsec], masked."""
    error = np.maximum(np.abs(comparison.error_rad[number]) / ARCSEC, 1e-6)
    return (
        comparison.nadir_angle_rad / DEGREE,
        comparison.h_c_m / 1e3,
        np.ma.masked_invalid(np.log10(error)),
    )
