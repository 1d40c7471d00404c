"""The comparison page: the error of each published method against the spherical ray.

Its numbers are rounded so that they are the same on every machine. The picture contains the hash of
the text, which shows whether the two belong together.
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
"""Heights of the camera above sea level."""

GROUNDS_M = (0.0, 1500.0)  # heights of the ground above sea level
ANGLES_DEG = (15, 30, 45, 60, 70, 75, 80, 85)  # nadir angles of the tables of errors
LIMITS_ARCSEC = (0.1, 1.0)  # of an error, to which the page states the largest angles

WHOLE_DEG = np.arange(0.0, 86.0)  # all nadir angles that are compared
PICTURE_HEIGHTS = 80  # of the camera, from the lowest to the highest of `HEIGHTS_M`

PLANE_FORMS = ("plane", "saastamoinen1974", "saastamoinen1974_ican")
"""Methods for a plane earth."""

PLANE_HEIGHTS_M = (1000.0, 3000.0, 10_000.0)
"""Heights of the camera for which the page states to which angle these methods are good."""

BAND_OF_SIZE = {
    "below 0.1": "#d9f0e3",
    "0.1 to 1": "#fdecc8",
    "above 1 arcsec": "#f5c6c0",
}
"""Range of the error [arcsec] -> its colour in the picture."""

LIMITS_OF_BANDS = (-7.0, -1.0, 0.0, 7.0)  # log10 of the error [arcsec], around these ranges
LEAST_ARCSEC = 1e-6  # smaller errors count as this: 0 has no logarithm
LINE_COLOUR = "#334155"
RAISED_COLOUR = "#1d4ed8"  # of the line for raised ground
TICKS_KM = (0.5, 1, 2, 5, 10, 20)
PANELS_ACROSS = 3


@dataclass(frozen=True)
class Accuracy:
    """Comparisons of all methods for each of `GROUNDS_M`, at whole degrees up to 85.

    ``tables`` have the heights of the page, ``curves`` those of the picture, which are closer.
    ``colour_percent`` is by how much R of the default index exceeds that of the comparison.
    """

    atmosphere: str
    tables: tuple[Comparison, ...]
    curves: tuple[Comparison, ...]
    colour_percent: float


def compare_all(atmosphere: str) -> Accuracy:
    """Compare all methods at all heights and grounds of the page, in one standard atmosphere.

    The index is that of 0.589 um (Gyer 1996), for which the papers state their constants.
    ``colour_percent`` compares the default index (Ciddor, 0.55 um) with it, at 6 km and 45 degrees.
    """
    air = standard_atmosphere(atmosphere, index="gyer")

    def comparisons(heights: Array) -> tuple[Comparison, ...]:
        """A comparison for each ground, with the camera ``heights`` [m] above it."""
        by_ground = []
        for ground in GROUNDS_M:
            above = heights[heights > ground]
            by_ground.append(compare_methods(air, above, ground, WHOLE_DEG * DEGREE))
        return tuple(by_ground)

    green = refraction_angle(standard_atmosphere(atmosphere), 6000.0, 0.0, 45.0 * DEGREE)
    yellow = refraction_angle(air, 6000.0, 0.0, 45.0 * DEGREE)
    return Accuracy(
        atmosphere=atmosphere,
        tables=comparisons(np.array(HEIGHTS_M)),
        curves=comparisons(np.geomspace(HEIGHTS_M[0], HEIGHTS_M[-1], PICTURE_HEIGHTS)),
        colour_percent=100.0 * (green / yellow - 1.0),
    )


def accuracy_page(accuracy: Accuracy, picture: str) -> str:
    """The page as Markdown; ``picture`` is the name of its image file in the same folder."""
    from jinja2 import StrictUndefined, Template  # imported here: only the page needs it

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
    """The nadir angle up to which all methods for a plane earth keep an error below the limit.

    One text for each of `PLANE_HEIGHTS_M`; ``comparison`` is one of all `HEIGHTS_M`.
    """
    methods = [comparison.methods.index(name) for name in PLANE_FORMS]
    heights = [HEIGHTS_M.index(h_c) for h_c in PLANE_HEIGHTS_M]
    angles = comparison.good_to(limit_arcsec * ARCSEC)[methods][:, heights]
    angles_of_worst = angles.min(axis=0) / DEGREE
    return [f"{angle:.0f}°" for angle in angles_of_worst]


def largest_error(comparison: Comparison, name: str) -> float:
    """The largest error of a method over all heights and angles [arcsec], without its sign."""
    error_rad = comparison.error_rad[comparison.methods.index(name)]
    return float(np.nanmax(np.abs(error_rad)) / ARCSEC)


def largest_at_45(comparison: Comparison, name: str) -> tuple[float, str]:
    """The largest error of a method at 45 degrees [% of R], and the height of the camera there."""
    column = nearest_column(comparison, 45.0)
    error = comparison.error_rad[comparison.methods.index(name), :, column]
    percent = 100.0 * np.abs(error / comparison.exact_rad[:, column])
    worst = int(np.nanargmax(percent))
    return float(percent[worst]), kilometres(float(comparison.h_c_m[worst]))


def nearest_column(comparison: Comparison, angle_deg: float) -> int:
    """The index of the nadir angle of a comparison that is nearest to an angle."""
    return int(np.argmin(np.abs(comparison.nadir_angle_rad - angle_deg * DEGREE)))


def kilometres(height_m: float) -> str:
    """A height [m] as a text in kilometres."""
    return f"{height_m / 1e3:g} km"


def good_to_table(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of a table: the angle [deg] to which each method is good, by height.

    A cell is "angle / angle" for the two `LIMITS_ARCSEC`; empty if the method is not defined.
    """
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
    """Heads and rows of a table in arcsec, by height and by `ANGLES_DEG`.

    ``values`` (heights, angles) [rad] are errors or refraction angles of the comparison.
    """
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
    """The SHA-256 of the page, which its picture contains as a description."""
    return hashlib.sha256(text.encode()).hexdigest()


def print_accuracy(console: Console, accuracy: Accuracy) -> None:
    """Print tables of the angle to which each method is good, in a terminal."""
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
    """Rows with the nadir angle [deg] to which a method is good, by height and ground.

    None if the method is not defined there.
    """
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
                row[key] = number_or_none(float(angles_deg[method, height]))
            rows.append(row)
    return rows


def number_or_none(value: float) -> float | None:
    """The number, or None for NaN, which JSON lacks."""
    if np.isnan(value):
        return None
    return value


def accuracy_png(curves: tuple[Comparison, ...], page_hash: str) -> bytes:
    """The picture as PNG, with ``page_hash`` (see `text_hash`) as its description."""
    from matplotlib import rc_context

    with rc_context({"font.size": 8}):
        buffer = io.BytesIO()
        note = {"Software": None, "Description": page_hash}
        accuracy_figure(curves).savefig(buffer, format="png", dpi=110, metadata=note)
    return buffer.getvalue()


def accuracy_figure(curves: tuple[Comparison, ...]) -> Figure:
    """The picture: a panel for each method, with nadir angle and height of the camera as axes.

    Colours show the size of the error over the first of the two grounds of ``curves``, and a dashed
    line is where it is 1 arcsec over the second, raised one.
    """
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
    """Entries of the legend: a patch for each colour, and the line for raised ground."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for size, colour in (BAND_OF_SIZE | {"not defined": "white"}).items():
        patch = Patch(facecolor=colour, edgecolor=LINE_COLOUR, linewidth=0.5, label=size)
        handles.append(patch)
    label = f"1 arcsec, ground {raised.h_g_m:.0f} m"
    line = Line2D([], [], color=RAISED_COLOUR, ls="--", lw=1.2, label=label)
    handles.append(line)
    return handles


def draw_method(axis: Axes, comparison: Comparison, raised: Comparison, number: int) -> None:
    """Draw the panel of the method with the index ``number``; see `accuracy_figure`."""
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
        colors=LINE_COLOUR,
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
            colors=RAISED_COLOUR,
            linewidths=1.2,
            linestyles="dashed",
        )


def logarithm_of_error(comparison: Comparison, number: int) -> np.ma.MaskedArray[Any, Any]:
    """(heights, angles) log10 of the size of the error [arcsec] of the method ``number``.

    Masked where the method is not defined.
    """
    error_arcsec = np.abs(comparison.error_rad[number]) / ARCSEC
    size = np.log10(np.maximum(error_arcsec, LEAST_ARCSEC))
    return np.ma.masked_invalid(size)
