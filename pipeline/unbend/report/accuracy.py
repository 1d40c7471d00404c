"""The comparison page: the error of each published method against the spherical ray.

Its numbers are rounded, the same on every machine; the picture contains the hash of the text.
"""

from __future__ import annotations

import hashlib
import io
import math
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

WHOLE_DEG = np.arange(0.0, 86.0)
CURVE_HEIGHTS = 80  # of the picture, from the lowest to the highest of `HEIGHTS_M`

PLANE_FORMS = ("plane", "saastamoinen1974", "saastamoinen1974_ican")
PLANE_HEIGHTS_M = (1000.0, 3000.0, 10_000.0)
"""Forms for a plane earth, and the heights for which the page says to which angle they are good."""

BAND_OF_SIZE = {
    "below 0.1": "#d9f0e3",
    "0.1 to 1": "#fdecc8",
    "above 1 arcsec": "#f5c6c0",
}
"""Colours of the sizes of the error in the picture."""

LIMITS_OF_BANDS = (-7.0, -1.0, 0.0, 7.0)  # log10 of the error [arcsec]
LEAST_ARCSEC = 1e-6  # has a logarithm, unlike 0
LINE = "#334155"
RAISED = "#1d4ed8"
TICKS_KM = (0.5, 1, 2, 5, 10, 20)
PANELS_ACROSS = 3


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

    def comparisons(heights: Array) -> tuple[Comparison, ...]:
        """For each ground, from the heights above it."""
        made = []
        for ground in GROUNDS_M:
            above = heights[heights > ground]
            made.append(compare_methods(air, above, ground, WHOLE_DEG * DEGREE))
        return tuple(made)

    green = refraction_angle(standard_atmosphere(atmosphere), 6000.0, 0.0, 45.0 * DEGREE)
    yellow = refraction_angle(air, 6000.0, 0.0, 45.0 * DEGREE)
    return Accuracy(
        atmosphere=atmosphere,
        tables=comparisons(np.array(HEIGHTS_M)),
        curves=comparisons(np.geomspace(HEIGHTS_M[0], HEIGHTS_M[-1], CURVE_HEIGHTS)),
        colour_percent=100.0 * (green / yellow - 1.0),
    )


def accuracy_page(accuracy: Accuracy, picture: str) -> str:
    """The page as Markdown; ``picture`` is the name of the image beside it."""
    from jinja2 import StrictUndefined, Template  # which no run needs

    text = files("unbend.report").joinpath("data/accuracy.md.j2").read_text("utf-8")
    template = Template(text, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    level, raised = accuracy.tables
    fine, coarse = LIMITS_ARCSEC
    page: str = template.render(
        accuracy=accuracy,
        picture=picture,
        level=level,
        raised=raised,
        plane_forms=PLANE_FORMS,
        fine=plane_forms_good_to(level, fine),
        coarse=plane_forms_good_to(level, coarse),
        gyer=max(largest_error(comparison, "gyer1996") for comparison in accuracy.tables),
        at_45=largest_at_45,
        good_to=good_to_table,
        errors=error_table,
    )
    return page.rstrip("\n") + "\n"


def plane_forms_good_to(comparison: Comparison, limit_arcsec: float) -> list[str]:
    """To which nadir angle the forms for a plane earth are good, by `PLANE_HEIGHTS_M`."""
    rows = [comparison.methods.index(name) for name in PLANE_FORMS]
    columns = [HEIGHTS_M.index(h_c) for h_c in PLANE_HEIGHTS_M]
    angles = comparison.good_to(limit_arcsec * ARCSEC)[rows][:, columns]
    worst_form = angles.min(axis=0) / DEGREE
    return [f"{angle:.0f}°" for angle in worst_form]


def largest_error(comparison: Comparison, name: str) -> float:
    """Largest error of a method [arcsec]."""
    error_rad = comparison.error_rad[comparison.methods.index(name)]
    return float(np.nanmax(np.abs(error_rad)) / ARCSEC)


def largest_at_45(comparison: Comparison, name: str) -> tuple[float, str]:
    """Largest error of a method at 45 degrees [% of R], and the height where it is."""
    column = nearest_column(comparison, 45.0)
    error = comparison.error_rad[comparison.methods.index(name), :, column]
    percent = 100.0 * np.abs(error / comparison.exact_rad[:, column])
    worst = int(np.nanargmax(percent))
    return float(percent[worst]), kilometres(float(comparison.h_c_m[worst]))


def nearest_column(comparison: Comparison, angle_deg: float) -> int:
    """The column of a comparison whose nadir angle is nearest."""
    return int(np.argmin(np.abs(comparison.nadir_angle_rad - angle_deg * DEGREE)))


def kilometres(height_m: float) -> str:
    """A height as the page writes it."""
    return f"{height_m / 1e3:g} km"


def good_to_table(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: to which angle [deg] each method is good, for both limits, by height."""
    fine_arcsec, coarse_arcsec = LIMITS_ARCSEC
    fine = comparison.good_to(fine_arcsec * ARCSEC) / DEGREE
    coarse = comparison.good_to(coarse_arcsec * ARCSEC) / DEGREE
    rows = []
    for number, name in enumerate(comparison.methods):
        cells = [f"`{name}`"]
        for fine_deg, coarse_deg in zip(fine[number], coarse[number], strict=True):
            cell = ""
            if not np.isnan(fine_deg):
                cell = f"{fine_deg:.0f} / {coarse_deg:.0f}"
            cells.append(cell)
        rows.append(cells)
    heads = [""]
    heads += [kilometres(height_m) for height_m in comparison.h_c_m]
    return heads, rows


def error_table(comparison: Comparison, values: Array) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: values [rad] in arcsec by height and angle."""
    columns = [nearest_column(comparison, angle) for angle in ANGLES_DEG]
    values_arcsec = values[:, columns] / ARCSEC
    rows = []
    for height_m, of_height in zip(comparison.h_c_m, values_arcsec, strict=True):
        cells = [kilometres(height_m)]
        cells += [arcsec_text(value) for value in of_height]
        rows.append(cells)
    heads = ["camera"]
    heads += [f"{angle}°" for angle in ANGLES_DEG]
    return heads, rows


def arcsec_text(value: float) -> str:
    """A number with three decimals below 10, then one; empty for NaN.

    >>> arcsec_text(-0.0001), arcsec_text(-12.34)
    ('0.000', '-12.3')
    """
    if np.isnan(value):
        return ""
    decimals = 3 if abs(value) < 10.0 else 1
    text = f"{value:.{decimals}f}"
    return "0.000" if text == "-0.000" else text


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
        heads, rows = good_to_table(comparison)
        table = plain_table([name or " " for name in heads], gap=1)
        for row in rows:
            table.add_row(row[0].strip("`").replace("saastamoinen1974", "s1974"), *row[1:])
        console.print(Padding(table, (0, 0, 1, 0)))
    console.print("s1974 means saastamoinen1974; heights of the camera are above sea level")


def comparison_rows(accuracy: Accuracy) -> list[dict[str, Any]]:
    """To which nadir angle [deg] each method is good, by height and ground; None: not defined."""
    rows = []
    for comparison in accuracy.tables:
        angles_by_limit = {}
        for limit in LIMITS_ARCSEC:
            key = f"good_to_{limit:g}_arcsec_deg"
            angles_by_limit[key] = comparison.good_to(limit * ARCSEC) / DEGREE
        for method, height in np.ndindex(comparison.error_rad.shape[:2]):
            row: dict[str, Any] = {
                "method": comparison.methods[method],
                "h_c_m": float(comparison.h_c_m[height]),
                "h_g_m": comparison.h_g_m,
            }
            for key, angles_deg in angles_by_limit.items():
                row[key] = known_number(float(angles_deg[method, height]))
            rows.append(row)
    return rows


def known_number(value: float) -> float | None:
    """A number for JSON, None for NaN."""
    if np.isnan(value):
        return None
    return value


def accuracy_png(curves: tuple[Comparison, ...], belongs_to: str) -> bytes:
    """The picture as PNG; its description is ``belongs_to``, the hash of the page."""
    from matplotlib import rc_context

    with rc_context({"font.size": 8}):
        buffer = io.BytesIO()
        note = {"Software": None, "Description": belongs_to}
        accuracy_figure(curves).savefig(buffer, format="png", dpi=110, metadata=note)
    return buffer.getvalue()


def accuracy_figure(curves: tuple[Comparison, ...]) -> Figure:
    """Nadir angle against height, a panel a method: bands of one ground, a line of another."""
    from matplotlib.figure import Figure

    comparison, raised = curves
    panels = len(comparison.methods)
    rows = math.ceil(panels / PANELS_ACROSS)
    figure = Figure(figsize=(7.6, 2.1 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, PANELS_ACROSS, sharex=True, sharey=True, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for number, (name, axis) in enumerate(zip(comparison.methods, axes.flat, strict=False)):
        axis.set_axis_on()
        axis.set_title(name, fontsize=8.5)
        draw_method(axis, comparison, raised, number)
        is_leftmost = number % PANELS_ACROSS == 0
        if is_leftmost:
            axis.set_ylabel("camera [km]")
        is_lowest = number + PANELS_ACROSS >= panels
        if is_lowest:
            axis.set_xlabel("nadir angle [°]")
            axis.tick_params(labelbottom=True)
    handles = legend_handles(raised)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.suptitle(f"error of each method, ground at {comparison.h_g_m:.0f} m", fontsize=9.5)
    return figure


def legend_handles(raised: Comparison) -> list[Any]:
    """A patch for each band of the error, and the line of 1 arcsec over raised ground."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for size, colour in (BAND_OF_SIZE | {"not defined": "white"}).items():
        patch = Patch(facecolor=colour, edgecolor=LINE, linewidth=0.5, label=size)
        handles.append(patch)
    label = f"1 arcsec, ground {raised.h_g_m:.0f} m"
    line = Line2D([], [], color=RAISED, ls="--", lw=1.2, label=label)
    handles.append(line)
    return handles


def draw_method(axis: Axes, comparison: Comparison, raised: Comparison, number: int) -> None:
    """Bands of the size of the error over one ground, and the line of 1 arcsec over the other."""
    angle_deg = comparison.nadir_angle_rad / DEGREE
    height_km = comparison.h_c_m / 1e3
    size = logarithm_of_error(comparison, number)
    colours = tuple(BAND_OF_SIZE.values())
    axis.contourf(angle_deg, height_km, size, levels=LIMITS_OF_BANDS, colors=colours)
    axis.contour(
        angle_deg,
        height_km,
        size,
        levels=LIMITS_OF_BANDS[1:-1],
        colors=LINE,
        linewidths=(0.6, 1.0),
        linestyles="solid",
    )
    axis.set_yscale("log")
    axis.set_yticks(TICKS_KM, [f"{tick:g}" for tick in TICKS_KM])
    axis.set_yticks([], minor=True)
    axis.set_xticks([0, 30, 45, 60, 75, 85])
    axis.set_ylim(height_km[0], height_km[-1])
    size_over_raised = logarithm_of_error(raised, number)
    if size_over_raised.min() < 0.0 < size_over_raised.max():
        axis.contour(
            raised.nadir_angle_rad / DEGREE,
            raised.h_c_m / 1e3,
            size_over_raised,
            levels=[0.0],
            colors=RAISED,
            linewidths=1.2,
            linestyles="dashed",
        )


def logarithm_of_error(comparison: Comparison, number: int) -> np.ma.MaskedArray[Any, Any]:
    """log10 of the size of a method's error [arcsec], masked where it is not defined."""
    error_arcsec = np.abs(comparison.error_rad[number]) / ARCSEC
    size = np.log10(np.maximum(error_arcsec, LEAST_ARCSEC))
    return np.ma.masked_invalid(size)
