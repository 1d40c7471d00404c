"""The figures of the report: the correction over the image, the air of a flight, and files."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.errors import ConfigError, storage_errors
from pipeline.flight.stations import NO_TIME, SUSPECT, Stations
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.statistics import ShiftGrid
from pipeline.report.summary import effect_lines
from pipeline.units import HECTOPASCAL, ZERO_CELSIUS_K, Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")
R = TypeVar("R")

MEASURED, REJECTED = "#c2410c", "#fdba74"
ADJUSTED = "#1d4ed8"
STANDARD = "#64748b"
_TIME_WINDOW = "#93c5fd"
_MOST_POINTS = 1500
_PPM = 1e-6


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Decorator: draw with the style of the report, then restore matplotlib's settings."""

    @wraps(draw)
    def draw_styled(*args: P.args, **kwargs: P.kwargs) -> R:
        import matplotlib as mpl

        style = {"svg.hashsalt": "unbend", "svg.fonttype": "path", "font.size": 9}
        with mpl.rc_context(style):
            return draw(*args, **kwargs)

    return draw_styled


def new_figure(
    columns: int, width: float, height: float, rows: int = 1
) -> tuple[Figure, list[Axes]]:
    """A figure of a width and height [inch], and its axes row by row."""
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
    sampled = [s.h_m for s in (samples.temperature, samples.pressure) if s is not None]
    heights = np.concatenate([np.empty(0), *sampled])
    heights = heights[np.isfinite(heights)]
    if heights.size == 0:
        return 0.0, 10_000.0
    low, high = float(heights.min()), float(heights.max())
    margin = max(0.08 * (high - low), 50.0)
    return low - margin, high + margin


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
def as_png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    return buffer.getvalue()


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as .png or .svg, by the name of the file."""
    if path.suffix.lower() not in (".png", ".svg"):
        raise ConfigError(
            "PLOT-FORMAT", "a plot is written as .png or .svg", where=str(path),
            remedy="choose one of these endings",
        )  # fmt: skip
    content = as_png(figure) if path.suffix.lower() == ".png" else as_svg(figure).encode()
    with storage_errors(path):
        path.write_bytes(content)


@styled
def correction_figure(grids: Mapping[str, ShiftGrid]) -> Figure:
    """Mean shift of the image points over the format of each camera, as arrows and colour."""
    shown = {name: grid for name, grid in grids.items() if grid.sums[2].any()} or dict(grids)
    figure, axes = new_figure(len(shown), 3.9 * len(shown), 3.4)
    for axis, (name, grid) in zip(axes, shown.items(), strict=True):
        axis.set_title(name, fontsize=9)
        draw_shifts(figure, axis, grid)
    return figure


@styled
def flight_figure(
    stations: Stations,
    track: tuple[NDArray[np.int64], Array, Array, Array],
    stretches: Sequence[tuple[int, int]] = (),
) -> Figure:
    """A flight from above, and its height over time: stations, suspect ones, and rejected events.

    ``track`` : time [Unix ns], latitude, longitude [rad] and height above sea level [m] as logged;
    ``stretches`` : from when to when [Unix ns] the log contradicts itself. Events without a
    position have only their time.
    """
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    figure, (above, beside) = new_figure(2, 10.2, 4.6)
    time_ns, lat, lon, h = track
    places = np.concatenate([stations.lat_rad, lat]), np.concatenate([stations.lon_rad, lon])
    middle = [float(np.nanmedian(p)) if np.isfinite(p).any() else 0.0 for p in places]
    # Across the 180th meridian longitudes go on beyond 180 degrees.
    lon_stations, lon = (np.unwrap([np.full(x.shape, middle[1]), x], axis=0)[1]
                         for x in (stations.lon_rad, lon))  # fmt: skip
    every = slice(None, None, max(1, time_ns.size // 20_000))
    above.plot(np.degrees(lon[every]), np.degrees(lat[every]), color=STANDARD, lw=0.7, label="log")
    beside.plot(time_ns[every].astype("datetime64[ns]"), h[every], color=STANDARD, lw=0.7)
    for number, (begin, end) in enumerate(stretches):
        inside = (time_ns >= begin) & (time_ns <= end)
        above.plot(np.degrees(lon[inside]), np.degrees(lat[inside]), color=REJECTED, lw=4.0,
                   alpha=0.7, label="suspect stretch" if number == 0 else None)  # fmt: skip
        beside.axvspan(*np.array([begin, end]).astype("datetime64[ns]"), color=REJECTED, alpha=0.5)
    when = stations.time_ns.astype("datetime64[ns]")
    suspect = stations.status == SUSPECT
    timed = stations.time_ns != NO_TIME
    for rows, marker, color, label in (
        (stations.ok & ~suspect, ".", ADJUSTED, "ok"),
        (suspect, "x", MEASURED, "suspect"),
        (timed & ~stations.ok & ~suspect, "|", "#7c3aed", "cannot be used"),
    ):
        if not bool(rows.any()):
            continue
        style: dict[str, Any] = {"marker": marker, "ls": "", "color": color, "ms": 5}
        name = f"{int(rows.sum()):,} {label}"
        above.plot(np.degrees(lon_stations[rows]), np.degrees(stations.lat_rad[rows]), **style,
                   label=name)  # fmt: skip
        known = np.isfinite(stations.h_msl_m)
        beside.plot(when[rows & known], stations.h_msl_m[rows & known], **style)
        # At the foot of the axis where there is only a time.
        beside.plot(when[rows & ~known], np.full((rows & ~known).sum(), 0.02), **style,
                    transform=beside.get_xaxis_transform())  # fmt: skip
    above.set_aspect(1.0 / max(0.01, float(np.cos(middle[0]))), adjustable="datalim")
    above.ticklabel_format(useOffset=False)
    above.locator_params(axis="x", nbins=5)
    above.set_xlabel("longitude [deg]")
    above.set_ylabel("latitude [deg]")
    locator = AutoDateLocator()
    beside.xaxis.set_major_locator(locator)
    beside.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    beside.set_xlabel("UTC")
    beside.set_ylabel("height above sea level [m]")
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    return figure


def draw_shifts(figure: Figure, axis: Axes, grid: ShiftGrid) -> None:
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
    # The longest arrow spans 0.9 of a cell of the grid.
    longest = float(size.max())
    scale = 0.9 * grid.width_px / grid.columns / longest if longest > 0.0 else 1.0
    arrows = axis.quiver(
        x, y, dx * scale, dy * scale, size, angles="xy", scale_units="xy",
        scale=1.0, width=0.005, cmap="viridis",
    )  # fmt: skip
    figure.colorbar(arrows, ax=axis, label="shift [px]", shrink=0.8)


@styled
def profile_figure(air: FlightAir, samples: AirSamples) -> Figure:
    """T, p, e and N of the air and of the standard against height, and the effect on R.

    One-sigma bands where there is a covariance; the samples, those that are not used paler; thin
    lines for the parts of a long flight.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    figure, axes = new_figure(3, 10.2, 6.4, rows=2)
    profile, standard = air.adjustment.profile, air.adjustment.standard
    low, high = height_range(samples)
    h = np.linspace(max(low, profile.bottom_m), min(high, profile.top_m), 300)
    rejected = air.adjustment.rejected
    if samples.temperature is not None:
        t_celsius = samples.temperature.value - ZERO_CELSIUS_K
        scatter(axes[0], samples.temperature, t_celsius, rejected.get("temperature"))
    if samples.pressure is not None:
        p_hpa = samples.pressure.value / HECTOPASCAL
        scatter(axes[1], samples.pressure, p_hpa, rejected.get("pressure"))
    if samples.humidity is not None:
        at = samples.humidity.h_m
        humidity = np.clip(samples.humidity.value, 0.0, 1.0)
        e_pa = vapour_pressure(humidity, profile.temperature(at), profile.pressure(at))
        e_hpa = np.asarray(e_pa) / HECTOPASCAL
        scatter(axes[2], samples.humidity, e_hpa, rejected.get("humidity"))
    _draw_quantities(axes, air, h)
    for axis in axes[:5]:
        axis.set_ylim(low, high)
    # The layout leaves no room for a number at the very end of an axis.
    axes[2].xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    axes[1].set_xscale("log")
    axes[1].minorticks_off()
    axes[1].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes[1].xaxis.set_major_formatter(ScalarFormatter())
    for axis in (axes[0], axes[3]):
        axis.set_ylabel("height above sea level [m]")
    for axis in (axes[1], axes[2], axes[4]):
        axis.tick_params(labelleft=False)
    axes[5].set_axis_off()
    axes[5].legend(
        *axes[0].get_legend_handles_labels(), frameon=False, markerscale=5.0, loc="upper left"
    )
    lines = effect_lines([effect.row() for effect in air.effects], standard.name)
    text = "\n\n".join(line.replace(": ", ":\n") for line in lines)
    axes[5].text(0.0, 0.0, text, va="bottom", transform=axes[5].transAxes)
    return figure


def _draw_quantities(axes: Sequence[Axes], air: FlightAir, h: Array) -> None:
    """T, p, e, N and N relative to the standard at heights h, with one-sigma bands."""
    profile, standard = air.adjustment.profile, air.adjustment.standard
    covariance = air.adjustment.covariance
    windows = [window.air.profile for window in air.windows if not window.why_not]
    n_standard = standard.refractivity(h)
    against_standard = f"n - 1 against {standard.name} [%]"

    def quantities(air_profile: Profile) -> dict[str, Array]:
        n = air_profile.refractivity(h)
        return {
            "temperature [°C]": air_profile.temperature(h) - ZERO_CELSIUS_K,
            "pressure [hPa]": air_profile.pressure(h) / HECTOPASCAL,
            "vapour pressure [hPa]": air_profile.vapour_pressure(h) / HECTOPASCAL,
            "(n - 1) 10⁶": n / _PPM,
            against_standard: 100.0 * (n / n_standard - 1.0),
        }

    sigmas: dict[str, Array] = {}
    if covariance is not None:
        sigma_n = covariance.sigma_refractivity(h)
        sigmas = {
            "temperature [°C]": covariance.sigma_temperature(h),
            "pressure [hPa]": covariance.sigma_log_pressure(h) * profile.pressure(h) / HECTOPASCAL,
            "vapour pressure [hPa]": covariance.sigma_vapour_pressure(h) / HECTOPASCAL,
            "(n - 1) 10⁶": sigma_n / _PPM,
            against_standard: 100.0 * sigma_n / n_standard,
        }
    of_windows = [quantities(window_profile) for window_profile in windows]
    of_standard = quantities(standard)
    for axis, (label, value) in zip(axes, quantities(profile).items(), strict=False):
        axis.set_xlabel(label)
        for number, of_window in enumerate(of_windows if label != against_standard else ()):
            named = "parts of the flight" if number == 0 else None
            axis.plot(of_window[label], h, color=_TIME_WINDOW, lw=0.7, label=named)
        axis.plot(of_standard[label], h, color=STANDARD, lw=1.2, label=standard.name)
        if profile is standard:
            continue
        if label in sigmas:
            sigma = sigmas[label]
            axis.fill_betweenx(
                h, value - sigma, value + sigma, color=ADJUSTED, alpha=0.18, lw=0,
                label="one sigma",
            )  # fmt: skip
        axis.plot(value, h, color=ADJUSTED, lw=1.3, label=profile.name)
