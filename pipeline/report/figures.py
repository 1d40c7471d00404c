"""The plots of the report as files, and the correction over the image."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError, StorageError
from pipeline.refraction.spread import ImageGrid
from pipeline.report.style import new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def as_svg(figure: Figure) -> str:
    """The figure as an SVG element; the same figure gives the same text."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


@styled
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


@styled
def correction_figure(grids: Mapping[str, ImageGrid]) -> Figure:
    """Mean shift of the image points over the format of each camera, as arrows and colour."""
    shown = {name: grid for name, grid in grids.items() if grid.sums[2].any()} or dict(grids)
    figure, axes = new_figure(len(shown), 3.9 * len(shown), 3.4)
    for axis, (name, grid) in zip(axes, shown.items(), strict=True):
        axis.set_title(name, fontsize=9)
        draw_shifts(figure, axis, grid)
    return figure


def draw_shifts(figure: Figure, axis: Axes, grid: ImageGrid) -> None:
    """The mean shifts of a grid as arrows over its image."""
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
