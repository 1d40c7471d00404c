"""Plots of the commands as PNG or SVG: the air of a flight, and the flight itself."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.air_samples import AirSamples
from unbend.errors import storage_errors
from unbend.flight.stations import NO_TIME, SUSPECT, Stations
from unbend.geodesy import longitudes_near
from unbend.refraction.effect import FlightAir
from unbend.report import messages
from unbend.report.flown import QUANTITIES, air_curves
from unbend.report.summary import effect_lines
from unbend.tables.manifest.results import EffectRecord
from unbend.units import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED, REJECTED = "#c2410c", "#fdba74"
ADJUSTED = "#1d4ed8"
STANDARD = "#64748b"
_TIME_WINDOW = "#93c5fd"


@contextmanager
def styled() -> Iterator[None]:
    """Draw with the style of the report, then restore matplotlib's settings."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.hashsalt": "unbend", "svg.fonttype": "path", "font.size": 9}):
        yield


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


_OPTIONS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": 130, "metadata": {"Software": None}}, ".svg": {"metadata": {"Date": None}},
}  # fmt: skip


@styled()
def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as .png or .svg, by the name of the file; the same gives the same bytes."""
    ending = path.suffix.lower()
    if ending not in _OPTIONS:
        raise messages.plot_format(where=path)
    content = io.BytesIO()
    figure.savefig(content, format=ending[1:], **_OPTIONS[ending])
    with storage_errors(path):
        path.write_bytes(content.getvalue())


@styled()
def flight_figure(
    stations: Stations,
    track: tuple[NDArray[np.int64], Array, Array, Array],
    stretches: Sequence[tuple[int, int]] = (),
) -> Figure:
    """A flight from above, and its height over time: stations, suspect ones, and rejected events.

    ``track`` : time [Unix ns], latitude, longitude [rad] and height above sea level [m] as logged;
    ``stretches`` : from when to when [Unix ns] the log contradicts itself.
    """
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    figure, (above, beside) = new_figure(2, 10.2, 4.6)
    time_ns, lat, lon, h = track
    places = np.concatenate([stations.lat_rad, lat]), np.concatenate([stations.lon_rad, lon])
    middle = [float(np.nanmedian(p)) if np.isfinite(p).any() else 0.0 for p in places]
    lon_stations, lon = (longitudes_near(x, middle[1]) for x in (stations.lon_rad, lon))
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
    axis = "UTC"
    if stations.from_boot.any():
        axis = "time since boot"
    beside.set_xlabel(axis)
    beside.set_ylabel("height above sea level [m]")
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    return figure


@styled()
def profile_figure(air: FlightAir, samples: AirSamples) -> Figure:
    """T, p, e, N of the air with one sigma, of samples and the standard, and the effect on R."""
    figure, axes = new_figure(3, 10.2, 6.4, rows=2)
    curves = air_curves(air, samples, np.empty(0))
    h, ours, sigma = curves["h_m"], curves["ours"], curves["sigma"]
    for i, axis in enumerate(axes[:5]):
        for sensor in (s for s in curves["samples"] if s["column"] == i):
            for used, color in (("used", MEASURED), ("not used", REJECTED)):
                name = used.replace(" ", "_")
                axis.plot(sensor[f"values_{name}"], sensor[f"h_{name}"], ".", ms=1.6, alpha=0.5,
                          color=color, label=f"{sensor['sensor']}, {used}")  # fmt: skip
        for number, part in enumerate(curves["parts"] if i < 4 else ()):
            label = "parts of the flight" if number == 0 else None
            axis.plot(part[i], h, color=_TIME_WINDOW, lw=0.7, label=label)
        axis.plot(curves["standard"][i], h, color=STANDARD, lw=1.2, label=curves["standard_name"])
        if ours is not None and sigma is not None:
            axis.fill_betweenx(h, ours[i] - sigma[i], ours[i] + sigma[i], color=ADJUSTED,
                               alpha=0.18, lw=0, label="one sigma")  # fmt: skip
        if ours is not None:
            axis.plot(ours[i], h, color=ADJUSTED, lw=1.3, label=air.adjustment.profile.name)
        axis.set_xlabel([*QUANTITIES, f"N against {curves['standard_name']} [%]"][i])
        axis.set_ylim(h[0], h[-1])
        if i in (0, 3):
            axis.set_ylabel("height above sea level [m]")
        else:
            axis.tick_params(labelleft=False)
    axes[5].set_axis_off()
    axes[5].legend(
        *axes[0].get_legend_handles_labels(), frameon=False, markerscale=5.0, loc="upper left"
    )
    effects = [EffectRecord.of(effect) for effect in air.effects]
    lines = effect_lines(effects, curves["standard_name"])
    text = "\n\n".join(line.replace(": ", ":\n") for line in lines)
    axes[5].text(0.0, 0.0, text, va="bottom", transform=axes[5].transAxes)
    return figure
