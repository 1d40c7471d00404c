"""The plots of the report: the profile against the standard, the correction over the image."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.adjust import Adjustment
from pipeline.atmosphere.samples import AirSamples, Samples
from pipeline.errors import ConfigError, StorageError
from pipeline.refraction.spread import ImageGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")
R = TypeVar("R")

_MEASURED = "#c2410c"
_ADJUSTED = "#1d4ed8"
_STANDARD = "#64748b"
_MOST_POINTS = 1500


def _styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw in our style, and leave that of whoever called as it was."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        import matplotlib as mpl

        style = {"svg.hashsalt": "unbend", "svg.fonttype": "path", "font.size": 9}
        with mpl.rc_context(style):
            return draw(*args, **kwargs)

    return drawn


def _new_figure(columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#e2e8f0", linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, list(axes)


@_styled
def as_svg(figure: Figure) -> str:
    """The figure as an SVG element; the same figure gives the same text."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


@_styled
def as_png(figure: Figure, dpi: int = 130) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as .png or .svg, by the name of the file."""
    if path.suffix.lower() not in (".png", ".svg"):
        raise ConfigError(
            "PLOT-FORMAT", "a plot is written as .png or .svg", where=str(path),
            remedy="choose one of these endings",
        )  # fmt: skip
    content = as_png(figure) if path.suffix.lower() == ".png" else as_svg(figure).encode()
    try:
        path.write_bytes(content)
    except OSError as error:
        raise StorageError(
            "STORAGE-WRITE", str(error.strerror), where=str(path), remedy="choose another place"
        ) from None


@_styled
def profile_figure(adjustment: Adjustment, samples: AirSamples) -> Figure:
    """Temperature and refractivity of the adjusted profile and the standard, with the samples."""
    figure, (left, right) = _new_figure(2, 7.6, 3.6)
    _draw_temperature(left, adjustment, samples)
    profile, standard = adjustment.profile, adjustment.standard
    h = np.linspace(*_height_range(samples), 400)
    excess = 100.0 * (profile.refractivity(h) / standard.refractivity(h) - 1.0)
    right.axvline(0.0, color=_STANDARD, lw=1.2)
    right.plot(excess, h, color=_ADJUSTED, lw=1.4)
    right.set_xlabel(f"refractivity against {standard.name} [%]")
    right.tick_params(labelleft=False)
    return figure


@_styled
def effect_figure(
    adjustment: Adjustment, samples: AirSamples, camera: str, grid: ImageGrid
) -> Figure:
    """The air of a flight beside what it does to the images of one camera."""
    figure, (left, right) = _new_figure(2, 8.2, 3.4)
    _draw_temperature(left, adjustment, samples)
    left.set_title("the air: measured against standard", fontsize=9)
    _draw_shifts(figure, right, grid)
    right.set_title(f"what it does to the {camera} image", fontsize=9)
    return figure


def _draw_temperature(axis: Axes, adjustment: Adjustment, samples: AirSamples) -> None:
    profile, standard = adjustment.profile, adjustment.standard
    h = np.linspace(*_height_range(samples), 400)
    if samples.temperature is not None:
        _scatter(axis, samples.temperature)
    axis.plot(standard.temperature(h) - 273.15, h, color=_STANDARD, lw=1.2, label=standard.name)
    if profile is not standard:
        axis.plot(profile.temperature(h) - 273.15, h, color=_ADJUSTED, lw=1.4, label=profile.name)
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("height above sea level [m]")
    axis.legend(frameon=False, markerscale=4.0)


def _height_range(samples: AirSamples) -> tuple[float, float]:
    heights = [
        s.h_m[np.isfinite(s.h_m)] for s in (samples.temperature, samples.pressure) if s is not None
    ]
    heights = [h for h in heights if h.size]
    if not heights:
        return 0.0, 10_000.0
    low, high = min(h.min() for h in heights), max(h.max() for h in heights)
    margin = max(0.08 * (high - low), 50.0)
    return float(low - margin), float(high + margin)


def _scatter(axis: Axes, samples: Samples) -> None:
    step = max(1, samples.h_m.size // _MOST_POINTS)
    for mask, color, label in (
        (samples.accepted, _MEASURED, f"{samples.name}, used"),
        (~samples.accepted, "#fdba74", f"{samples.name}, not used"),
    ):
        chosen = np.flatnonzero(mask & np.isfinite(samples.h_m) & np.isfinite(samples.value))[
            ::step
        ]
        if chosen.size:
            axis.plot(
                samples.value[chosen] - 273.15, samples.h_m[chosen], ".", ms=1.6, alpha=0.5,
                color=color, label=label, rasterized=True,
            )  # fmt: skip


@_styled
def correction_figure(grids: Mapping[str, ImageGrid]) -> Figure:
    """Mean shift of the image points over the format of each camera, as arrows and colour."""
    shown = {name: grid for name, grid in grids.items() if grid.sums[2].any()} or dict(grids)
    figure, axes = _new_figure(len(shown), 3.9 * len(shown), 3.4)
    for axis, (name, grid) in zip(axes, shown.items(), strict=True):
        axis.set_title(name, fontsize=9)
        _draw_shifts(figure, axis, grid)
    return figure


def _draw_shifts(figure: Figure, axis: Axes, grid: ImageGrid) -> None:
    axis.set_xlim(0, grid.width_px)
    axis.set_ylim(grid.height_px, 0)
    axis.set_aspect("equal")
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel("x [px]")
    axis.set_ylabel("y [px]")
    x, y, dx, dy = grid.means()
    size = np.hypot(dx, dy)
    if size.size == 0:
        return
    arrows = axis.quiver(
        x, y, *_arrow_lengths(grid, dx, dy, size), size, angles="xy", scale_units="xy",
        scale=1.0, width=0.005, cmap="viridis",
    )  # fmt: skip
    figure.colorbar(arrows, ax=axis, label="shift [px]", shrink=0.8)


def _arrow_lengths(
    grid: ImageGrid, dx: NDArray[np.float64], dy: NDArray[np.float64], size: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Arrows drawn so that the longest spans one cell of the grid."""
    longest = float(size.max())
    scale = 0.9 * grid.width_px / grid.columns / longest if longest > 0.0 else 1.0
    return dx * scale, dy * scale
