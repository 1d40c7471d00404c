"""Plots of the commands as PNG or SVG: the air of a flight, and the flight from above.

In functions, the axes ``map_axis`` show longitude and latitude, and ``height_axis`` heights over
time.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unbend.atmosphere.air_samples import AirSamples
from unbend.errors import storage_errors
from unbend.flight.ground_times import LoggedPath
from unbend.flight.stations import NO_TIME, SUSPECT, Stations
from unbend.geodesy import longitudes_near
from unbend.refraction.effect import FlightAir
from unbend.report import messages
from unbend.report.air_curves import AGAINST_STANDARD, QUANTITIES, AirCurves, air_curves
from unbend.report.summary import effect_lines
from unbend.tables.manifest.results import EffectRecord
from unbend.units import Array, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours.
MEASURED = "#c2410c"
REJECTED = "#fdba74"
ADJUSTED = "#1d4ed8"
STANDARD = "#64748b"
UNUSABLE = "#7c3aed"
PART_OF_FLIGHT = "#93c5fd"

MAX_TRACK_POINTS = 20_000  # about; more are not visible
FOOT_OF_AXIS = 0.02  # of the axis's height: where events without a height are drawn

OPTIONS_OF_FORMAT: dict[str, dict[str, Any]] = {
    ".png": {"dpi": 130, "metadata": {"Software": None}},
    ".svg": {"metadata": {"Date": None}},
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw with the style of the report, then restore matplotlib's settings."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "unbend", "svg.fonttype": "path", "font.size": 9}):
        yield


def new_figure(
    columns: int, width: float, height: float, rows: int = 1
) -> tuple[Figure, list[Axes]]:
    """A figure of ``width`` and ``height`` [inch], and its axes, row by row from the upper left."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#e2e8f0", linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, list(axes)


@styled()
def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as .png or .svg, by the ending of ``path``; equal figures give equal bytes."""
    ending = path.suffix.lower()
    if ending not in OPTIONS_OF_FORMAT:
        raise messages.plot_format(where=path)
    content = io.BytesIO()
    figure.savefig(content, format=ending[1:], **OPTIONS_OF_FORMAT[ending])
    with storage_errors(path):
        path.write_bytes(content.getvalue())


@styled()
def flight_figure(
    stations: Stations, track: LoggedPath, stretches: Sequence[tuple[int, int]] = ()
) -> Figure:
    """A figure of a flight from above, and of its heights over time.

    It shows the track of the log, and the stations by whether they are ok, suspect or unusable.
    ``stretches`` : begin and end [Unix ns] of parts in which the log contradicts itself.
    """
    figure, (map_axis, height_axis) = new_figure(2, 10.2, 4.6)
    middle_lat = median_of_known(np.concatenate([stations.lat_rad, track.latitude_rad]))
    middle_lon = median_of_known(np.concatenate([stations.lon_rad, track.longitude_rad]))
    continuous_track = track._replace(
        longitude_rad=longitudes_near(track.longitude_rad, middle_lon)
    )
    continuous_stations = replace(stations, lon_rad=longitudes_near(stations.lon_rad, middle_lon))
    draw_track(map_axis, height_axis, continuous_track)
    draw_stretches(map_axis, height_axis, continuous_track, stretches)
    draw_stations(map_axis, height_axis, continuous_stations)
    map_axis.set_aspect(1.0 / max(0.01, float(np.cos(middle_lat))), adjustable="datalim")
    map_axis.ticklabel_format(useOffset=False)
    map_axis.locator_params(axis="x", nbins=5)
    map_axis.set_xlabel("longitude [deg]")
    map_axis.set_ylabel("latitude [deg]")
    label_times(height_axis, is_utc=not stations.from_boot.any())
    height_axis.set_ylabel("height above sea level [m]")
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    return figure


def median_of_known(values: Array) -> float:
    """The median of the finite values of an array; 0 without any."""
    if not np.isfinite(values).any():
        return 0.0
    return float(np.nanmedian(values))


def draw_track(map_axis: Axes, height_axis: Axes, track: LoggedPath) -> None:
    """Draw the track of a log as a line, from above and over time."""
    drawn = slice(None, None, max(1, track.time_ns.size // MAX_TRACK_POINTS))
    lon_deg = np.degrees(track.longitude_rad[drawn])
    lat_deg = np.degrees(track.latitude_rad[drawn])
    map_axis.plot(lon_deg, lat_deg, color=STANDARD, lw=0.7, label="log")
    time = track.time_ns[drawn].astype("datetime64[ns]")
    height_axis.plot(time, track.h_msl_m[drawn], color=STANDARD, lw=0.7)


def draw_stretches(
    map_axis: Axes, height_axis: Axes, track: LoggedPath, stretches: Sequence[tuple[int, int]]
) -> None:
    """Draw ``stretches`` of the log (begin, end [Unix ns]) as thick lines, and bands over time."""
    label: str | None = "suspect stretch"
    for begin_ns, end_ns in stretches:
        is_inside = (track.time_ns >= begin_ns) & (track.time_ns <= end_ns)
        map_axis.plot(
            np.degrees(track.longitude_rad[is_inside]),
            np.degrees(track.latitude_rad[is_inside]),
            color=REJECTED,
            lw=4.0,
            alpha=0.7,
            label=label,
        )
        stretch = np.array([begin_ns, end_ns]).astype("datetime64[ns]")
        height_axis.axvspan(*stretch, color=REJECTED, alpha=0.5)
        label = None  # the legend gets one entry for all stretches


def draw_stations(map_axis: Axes, height_axis: Axes, stations: Stations) -> None:
    """Draw stations that are ok, suspect or unusable, each with a mark and a colour."""
    is_suspect = stations.status == SUSPECT
    is_ok = stations.ok & ~is_suspect
    is_unusable = (stations.time_ns != NO_TIME) & ~stations.ok & ~is_suspect
    draw = partial(draw_rows, map_axis, height_axis, stations)
    draw(is_ok, marker=".", color=ADJUSTED, label="ok")
    draw(is_suspect, marker="x", color=MEASURED, label="suspect")
    draw(is_unusable, marker="|", color=UNUSABLE, label="cannot be used")


def draw_rows(
    map_axis: Axes,
    height_axis: Axes,
    stations: Stations,
    rows: Mask,
    *,
    marker: str,
    color: str,
    label: str,
) -> None:
    """Draw the stations of the mask ``rows`` (s,), from above and over time.

    Over time, stations without a height are at the foot of the axis.
    """
    if not rows.any():
        return
    style: dict[str, Any] = {"marker": marker, "ls": "", "color": color, "ms": 5}
    lon_deg = np.degrees(stations.lon_rad[rows])
    lat_deg = np.degrees(stations.lat_rad[rows])
    count = int(rows.sum())
    map_axis.plot(lon_deg, lat_deg, **style, label=f"{count:,} {label}")
    time = stations.time_ns.astype("datetime64[ns]")
    is_known = np.isfinite(stations.h_msl_m)
    with_height = rows & is_known
    height_axis.plot(time[with_height], stations.h_msl_m[with_height], **style)
    without_height = rows & ~is_known
    foot = np.full(without_height.sum(), FOOT_OF_AXIS)
    height_axis.plot(
        time[without_height], foot, **style, transform=height_axis.get_xaxis_transform()
    )


def label_times(axis: Axes, *, is_utc: bool) -> None:
    """Label the horizontal axis with times; if not ``is_utc``, they count from a boot."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    locator = AutoDateLocator()
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    label = "UTC" if is_utc else "time since boot"
    axis.set_xlabel(label)


@styled()
def profile_figure(air: FlightAir, samples: AirSamples) -> Figure:
    """A figure of the air of a flight against height, with samples and the standard atmosphere.

    Panels show T, p, e, N, and N against the standard, with one sigma; the last panel states the
    effect on R.
    """
    figure, axes = new_figure(3, 10.2, 6.4, rows=2)
    curves = air_curves(air, samples, np.empty(0))
    labels = [*QUANTITIES, f"N against {curves.standard_name} [%]"]
    for column, label in enumerate(labels):
        axis = axes[column]
        draw_samples(axis, curves, column)
        draw_curves(axis, curves, column, air.adjustment.profile.name)
        axis.set_xlabel(label)
        axis.set_ylim(curves.h_m[0], curves.h_m[-1])
        is_leftmost = column % 3 == 0
        if is_leftmost:
            axis.set_ylabel("height above sea level [m]")
        else:
            axis.tick_params(labelleft=False)
    handles, texts = axes[0].get_legend_handles_labels()
    write_effects(axes[5], air, curves.standard_name)
    axes[5].legend(handles, texts, frameon=False, markerscale=5.0, loc="upper left")
    return figure


def draw_samples(axis: Axes, curves: AirCurves, column: int) -> None:
    """Draw the samples of a quantity as dots, those that are not used paler.

    ``column`` is the index of the quantity in `Curves`.
    """
    for sensor in curves.samples:
        if sensor.column != column:
            continue
        style: dict[str, Any] = {"ms": 1.6, "alpha": 0.5}
        used = f"{sensor.sensor}, used"
        axis.plot(sensor.values_used, sensor.h_used, ".", color=MEASURED, label=used, **style)
        not_used = f"{sensor.sensor}, not used"
        axis.plot(
            sensor.values_not_used,
            sensor.h_not_used,
            ".",
            color=REJECTED,
            label=not_used,
            **style,
        )


def draw_curves(axis: Axes, curves: AirCurves, column: int, name: str) -> None:
    """Draw the curves of a quantity: parts of the flight, the standard, and the whole flight.

    ``column`` is the index of the quantity in `Curves`, ``name`` the label of the flight's curve.
    """
    h_m = curves.h_m
    if column != AGAINST_STANDARD:
        label: str | None = "parts of the flight"
        for part in curves.parts:
            axis.plot(part[column], h_m, color=PART_OF_FLIGHT, lw=0.7, label=label)
            label = None  # the legend gets one entry for all parts
    standard = curves.standard[column]
    axis.plot(standard, h_m, color=STANDARD, lw=1.2, label=curves.standard_name)
    if curves.flight is None:
        return
    of_flight = curves.flight[column]
    if curves.sigma is not None:
        sigma = curves.sigma[column]
        axis.fill_betweenx(
            h_m,
            of_flight - sigma,
            of_flight + sigma,
            color=ADJUSTED,
            alpha=0.18,
            lw=0,
            label="one sigma",
        )
    axis.plot(of_flight, h_m, color=ADJUSTED, lw=1.3, label=name)


def write_effects(axis: Axes, air: FlightAir, standard_name: str) -> None:
    """Write the effect of the air on R as text into an empty panel."""
    effects = [EffectRecord.of(effect) for effect in air.effects]
    lines = effect_lines(effects, standard_name)
    paragraphs = [line.replace(": ", ":\n") for line in lines]
    text = "\n\n".join(paragraphs)
    axis.set_axis_off()
    axis.text(0.0, 0.0, text, va="bottom", transform=axis.transAxes)
