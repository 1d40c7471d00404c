"""The figures of the report: the correction over the image, the air of a flight, and files."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.errors import ConfigError, StorageError
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.spread import ImageGrid
from pipeline.report.summary import effect_lines
from pipeline.units import HECTOPASCAL, ZERO_CELSIUS_K

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_WINDOW = "#93c5fd"
_PPM = 1e6

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
    """SensorSamples against height, those that are not used in another colour and in front.

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


@styled
def profile_figure(air: FlightAir, samples: AirSamples) -> Figure:
    """T, p, e and N of the air and of the standard against height, and the effect on R.

    One-sigma bands where there is a covariance; the samples, those that are not used paler; thin
    lines for the parts of a long flight.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    figure, axes = new_figure(3, 10.2, 6.4, rows=2)
    adjustment = air.adjustment
    profile, standard, covariance = adjustment.profile, adjustment.standard, adjustment.covariance
    low, high = height_range(samples)
    h = np.linspace(max(low, profile.bottom_m), min(high, profile.top_m), 300)
    p = profile.pressure(h)
    sigmas: Sequence[Array | None] = (None,) * 4
    if covariance is not None:
        sigmas = (
            covariance.sigma_temperature(h),
            covariance.sigma_log_pressure(h) * p / HECTOPASCAL,
            covariance.sigma_vapour_pressure(h) / HECTOPASCAL,
            covariance.sigma_refractivity(h) * _PPM,
        )
    _draw_samples(axes, air, samples)
    windows = [w.air.profile for w in air.windows if not w.why_not]
    labels = ("temperature [°C]", "pressure [hPa]", "vapour pressure [hPa]", "(n - 1) 10⁶")
    quantities = [_quantities(one, h) for one in (profile, standard, *windows)]
    for i, (axis, label, sigma) in enumerate(zip(axes, labels, sigmas, strict=False)):
        for number, others in enumerate(quantities[2:]):
            named = "parts of the flight" if number == 0 else None
            axis.plot(others[i], h, color=_WINDOW, lw=0.7, label=named)
        axis.plot(quantities[1][i], h, color=STANDARD, lw=1.2, label=standard.name)
        if profile is not standard:
            _draw_band(axis, quantities[0][i], sigma, h)
            axis.plot(quantities[0][i], h, color=ADJUSTED, lw=1.3, label=profile.name)
        axis.set_xlabel(label)
        axis.set_ylim(low, high)
    # The layout leaves no room for a number at the very end of an axis.
    axes[2].xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    axes[1].set_xscale("log")
    axes[1].minorticks_off()
    axes[1].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes[1].xaxis.set_major_formatter(ScalarFormatter())
    _draw_against(axes[4], air, h, sigmas[3])
    axes[4].set_ylim(low, high)
    for axis in (axes[0], axes[3]):
        axis.set_ylabel("height above sea level [m]")
    for axis in (axes[1], axes[2], axes[4]):
        axis.tick_params(labelleft=False)
    _write_effect(axes[5], axes[0], air)
    return figure


def _quantities(profile: Profile, h: Array) -> tuple[Array, Array, Array, Array]:
    """In the units of the axes."""
    return (
        profile.temperature(h) - ZERO_CELSIUS_K,
        profile.pressure(h) / HECTOPASCAL,
        profile.vapour_pressure(h) / HECTOPASCAL,
        profile.refractivity(h) * _PPM,
    )


def _draw_band(axis: Axes, value: Array, sigma: Array | None, h: Array) -> None:
    if sigma is not None:
        axis.fill_betweenx(
            h, value - sigma, value + sigma, color=ADJUSTED, alpha=0.18, lw=0, label="one sigma"
        )


def _draw_samples(axes: Sequence[Axes], air: FlightAir, samples: AirSamples) -> None:
    rejected, profile = air.adjustment.rejected, air.adjustment.profile
    warm, weighed, moist = samples.temperature, samples.pressure, samples.humidity
    if warm is not None:
        scatter(axes[0], warm, warm.value - ZERO_CELSIUS_K, rejected.get("temperature"))
    if weighed is not None:
        scatter(axes[1], weighed, weighed.value / HECTOPASCAL, rejected.get("pressure"))
    if moist is not None:
        t, p = profile.temperature(moist.h_m), profile.pressure(moist.h_m)
        e = vapour_pressure(np.clip(moist.value, 0.0, 1.0), t, p) / HECTOPASCAL
        scatter(axes[2], moist, np.asarray(e), rejected.get("humidity"))


def _draw_against(axis: Axes, air: FlightAir, h: Array, sigma: Array | None) -> None:
    """Refractivity against the standard, where a sigma can be seen."""
    profile, standard = air.adjustment.profile, air.adjustment.standard
    n = standard.refractivity(h)
    excess = 100.0 * (profile.refractivity(h) / n - 1.0)
    axis.axvline(0.0, color=STANDARD, lw=1.2)
    if profile is not standard:
        _draw_band(axis, excess, None if sigma is None else 100.0 * sigma / _PPM / n, h)
        axis.plot(excess, h, color=ADJUSTED, lw=1.3)
    axis.set_xlabel(f"n - 1 against {standard.name} [%]")


def _write_effect(axis: Axes, labelled: Axes, air: FlightAir) -> None:
    """The legend, and what the air does to R."""
    axis.set_axis_off()
    handles, names = labelled.get_legend_handles_labels()
    axis.legend(handles, names, frameon=False, markerscale=5.0, loc="upper left")
    rows = [effect.row() for effect in air.effects]
    lines = effect_lines(rows, air.adjustment.standard.name)
    broken = "\n\n".join(line.replace(": ", ":\n") for line in lines)
    axis.text(0.0, 0.0, broken, va="bottom", transform=axis.transAxes)
