"""The comparison page: the error of each published method against the spherical ray.

Its numbers are rounded, the same on every machine; the picture contains the hash of the text.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.padding import Padding

from unbend.atmosphere import standard_atmosphere
from unbend.refraction.angle import Comparison, compare_methods
from unbend.refraction.ray import refraction_angle
from unbend.report.console import plain_table
from unbend.units import ARCSEC, DEGREE, Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHTS_M = (500.0, 1000.0, 2000.0, 3000.0, 6000.0, 10_000.0, 15_000.0, 20_000.0)
"""Of the camera above sea level."""

GROUNDS_M = (0.0, 1500.0)
ANGLES_DEG = (15, 30, 45, 60, 70, 75, 80, 85)
LIMITS_ARCSEC = (0.1, 1.0)

_WHOLE_DEG = np.arange(0.0, 86.0)

_PLANE_FORMS = ("plane", "saastamoinen1974", "saastamoinen1974_ican")

_BANDS = ("#d9f0e3", "#fdecc8", "#f5c6c0")
_LABELS = ("below 0.1", "0.1 to 1", "above 1 arcsec")
_LINE = "#334155"
_RAISED = "#1d4ed8"
_TICKS_KM = (0.5, 1, 2, 5, 10, 20)


@dataclass(frozen=True)
class Accuracy:
    """Comparisons for each ground, at whole degrees to 85: of ``tables``, and closer ``curves``."""

    atmosphere: str
    tables: tuple[Comparison, ...]
    curves: tuple[Comparison, ...]
    colour_percent: float


def compare_all(atmosphere: str) -> Accuracy:
    """Every method over every height and ground of the page, in one standard atmosphere.

    With the index of 0.589 um, the light that the constants of the papers are for;
    ``colour_percent`` is what the default index (Ciddor, 0.55 um) adds at 6 km and 45 degrees.
    """
    air = standard_atmosphere(atmosphere, index="gyer")
    tables, curves = (
        tuple(
            compare_methods(air, heights[heights > ground], ground, _WHOLE_DEG * DEGREE)
            for ground in GROUNDS_M
        )
        for heights in (np.array(HEIGHTS_M), np.geomspace(HEIGHTS_M[0], HEIGHTS_M[-1], 80))
    )
    green = refraction_angle(standard_atmosphere(atmosphere), 6000.0, 0.0, 45.0 * DEGREE)
    yellow = refraction_angle(air, 6000.0, 0.0, 45.0 * DEGREE)
    return Accuracy(atmosphere, tables, curves, 100.0 * (green / yellow - 1.0))


def accuracy_page(accuracy: Accuracy, picture: str) -> str:
    """The page as Markdown; ``picture`` is the name of the image beside it."""
    from jinja2 import StrictUndefined, Template  # which no run needs

    level, raised = accuracy.tables
    rows = [level.methods.index(name) for name in _PLANE_FORMS]
    columns = [HEIGHTS_M.index(h_c) for h_c in (1000.0, 3000.0, 10_000.0)]
    fine, coarse = (
        [f"{a:.0f}°" for a in level.good_to(limit * ARCSEC)[rows][:, columns].min(0) / DEGREE]
        for limit in LIMITS_ARCSEC
    )
    gyer = max(
        np.nanmax(np.abs(comparison.error_rad[comparison.methods.index("gyer1996")])) / ARCSEC
        for comparison in accuracy.tables
    )

    def at_45(comparison: Comparison, name: str) -> tuple[float, str]:
        """Largest error of a method at 45 degrees [% of R], and the height where it is."""
        column = int(np.argmin(np.abs(comparison.nadir_angle_rad - 45.0 * DEGREE)))
        error = comparison.error_rad[comparison.methods.index(name), :, column]
        percent = 100.0 * np.abs(error / comparison.exact_rad[:, column])
        worst = int(np.nanargmax(percent))
        return float(percent[worst]), _km(float(comparison.h_c_m[worst]))

    text = files("unbend.report").joinpath("data/accuracy.md.j2").read_text("utf-8")
    made = Template(text, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    page: str = made.render(
        accuracy=accuracy, picture=picture, level=level, raised=raised, plane_forms=_PLANE_FORMS,
        fine=fine, coarse=coarse, gyer=gyer, at_45=at_45, good_to=_good_to_table,
        errors=_error_table,
    )  # fmt: skip
    return page.rstrip("\n") + "\n"


def _km(height_m: float) -> str:
    return f"{height_m / 1e3:g} km"


def _good_to_table(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    fine, coarse = (comparison.good_to(limit * ARCSEC) / DEGREE for limit in LIMITS_ARCSEC)
    rows = [
        [f"`{name}`"]
        + [
            "" if np.isnan(a) else f"{a:.0f} / {b:.0f}"
            for a, b in zip(fine[number], coarse[number], strict=True)
        ]
        for number, name in enumerate(comparison.methods)
    ]
    return ["", *(_km(h) for h in comparison.h_c_m)], rows


def _error_table(comparison: Comparison, values: Array) -> tuple[list[str], list[list[str]]]:
    """Values [rad] in arcsec by height and angle: three decimals below 10 arcsec, then one."""
    columns = [
        int(np.argmin(np.abs(comparison.nadir_angle_rad - angle * DEGREE))) for angle in ANGLES_DEG
    ]
    rows = []
    for h, of_height in zip(comparison.h_c_m, values[:, columns] / ARCSEC, strict=True):
        cells = [f"{value:.{3 if abs(value) < 10.0 else 1}f}" for value in of_height]
        cells = ["0.000" if cell == "-0.000" else cell for cell in cells]
        rows.append([_km(h), *("" if cell == "nan" else cell for cell in cells)])
    return ["camera", *(f"{angle}°" for angle in ANGLES_DEG)], rows


def text_hash(text: str) -> str:
    """SHA-256 of the page, which its picture has as description."""
    return hashlib.sha256(text.encode()).hexdigest()


def print_accuracy(console: Console, accuracy: Accuracy) -> None:
    """To which angle each method is good, in a terminal."""
    for comparison in accuracy.tables:
        console.print(
            f"[bold]ground at {comparison.h_g_m:.0f} m[/bold]: nadir angle to which the error "
            "stays below 0.1 / 1 arcsec"
        )
        head, rows = _good_to_table(comparison)
        table = plain_table([name or " " for name in head], gap=1)
        for row in rows:
            table.add_row(row[0].strip("`").replace("saastamoinen1974", "s1974"), *row[1:])
        console.print(Padding(table, (0, 0, 1, 0)))
    console.print("s1974 means saastamoinen1974; heights of the camera are above sea level")


def comparison_rows(accuracy: Accuracy) -> list[dict[str, Any]]:
    """To which nadir angle [deg] each method is good, by height and ground; None: not defined."""
    rows = []
    for comparison in accuracy.tables:
        angles = [comparison.good_to(limit * ARCSEC) / DEGREE for limit in LIMITS_ARCSEC]
        for method, height in np.ndindex(angles[0].shape):
            row = {
                f"good_to_{limit:g}_arcsec_deg": None if np.isnan(good) else float(good)
                for limit, good in zip(
                    LIMITS_ARCSEC, (a[method, height] for a in angles), strict=True
                )
            }
            h_c = float(comparison.h_c_m[height])
            head = {"method": comparison.methods[method], "h_c_m": h_c, "h_g_m": comparison.h_g_m}
            rows.append(head | row)
    return rows


def accuracy_png(curves: tuple[Comparison, ...], belongs_to: str) -> bytes:
    """The picture as PNG; its description is ``belongs_to``, the hash of the page."""
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 8}):
        buffer = io.BytesIO()
        note = {"Software": None, "Description": belongs_to}
        accuracy_figure(curves).savefig(buffer, format="png", dpi=110, metadata=note)
    return buffer.getvalue()


def accuracy_figure(curves: tuple[Comparison, ...]) -> Figure:
    """Nadir angle against height, a panel a method: bands of one ground, a line of another."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    comparison, raised = curves
    columns = 3
    rows = -(-len(comparison.methods) // columns)
    figure = Figure(figsize=(7.6, 2.1 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for number, (name, axis) in enumerate(zip(comparison.methods, axes.flat, strict=False)):
        axis.set_axis_on()
        axis.set_title(name, fontsize=8.5)
        _draw_method(axis, comparison, raised, number)
        if number % columns == 0:
            axis.set_ylabel("camera [km]")
        if number + columns >= len(comparison.methods):
            axis.set_xlabel("nadir angle [°]")
            axis.tick_params(labelbottom=True)
    handles: list[Any] = [
        Patch(facecolor=colour, edgecolor=_LINE, linewidth=0.5, label=label)
        for colour, label in (*zip(_BANDS, _LABELS, strict=True), ("white", "not defined"))
    ]
    label = f"1 arcsec, ground {raised.h_g_m:.0f} m"
    handles.append(Line2D([], [], color=_RAISED, ls="--", lw=1.2, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.suptitle(f"error of each method, ground at {comparison.h_g_m:.0f} m", fontsize=9.5)
    return figure


def _draw_method(axis: Axes, comparison: Comparison, raised: Comparison, number: int) -> None:
    """Bands of the size of the error over one ground, and the line of 1 arcsec over the other."""

    def logarithm(of: Comparison) -> tuple[Any, Any, Any]:
        """Angles [deg], heights [km] and log10 of the size of the error [arcsec], masked."""
        error = np.maximum(np.abs(of.error_rad[number]) / ARCSEC, 1e-6)
        size = np.ma.masked_invalid(np.log10(error))
        return of.nadir_angle_rad / DEGREE, of.h_c_m / 1e3, size

    angle, height, size = logarithm(comparison)
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
    angle, height, size = logarithm(raised)
    if size.min() < 0.0 < size.max():
        axis.contour(
            angle, height, size, levels=[0.0], colors=_RAISED, linewidths=1.2, linestyles="dashed"
        )
