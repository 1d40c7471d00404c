"""Prints air and refraction angles: profiles, one angle, radial tables, tables of papers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Column, Table

from unbend.refraction.status_codes import STATUS_NAMES
from unbend.report import summary
from unbend.report.console import (
    Columns,
    cells_of,
    columns_of,
    plain_table,
    print_indented,
    shown,
)
from unbend.report.words import significant, with_sigma
from unbend.tables.manifest.results import EffectRecord
from unbend.units import MICRORADIAN

if TYPE_CHECKING:  # scipy: angles need none
    from unbend.refraction.angle import RadialTable
    from unbend.refraction.effect import FlightAir


def print_angle(console: Console, angle: Mapping[str, Any]) -> None:
    """Print a refraction angle in three units, and the settings that it was computed with.

    ``angle`` has the keys of ``unbend angle --json``; ground_m is None for a ray that does not
    reach the ground.
    """
    arcsec = significant(angle["r_c_arcsec"], 5, smallest=1e-6)
    microradians = significant(angle["r_c_urad"], 5, smallest=1e-6)
    texts = summary.report_texts()["angle"]
    on_ground = texts["over"]
    if angle["ground_m"] is not None:
        metres = significant(angle["ground_m"], 5, smallest=1e-6)
        on_ground = f"{metres} m on the ground"
    lines = [f"{microradians} microradians", on_ground]
    status = angle["status"]
    if status in texts:
        lines.append(f"{status}: {texts[status]}")
    console.print(f"R_c    {arcsec} arcsec", highlight=False)
    for line in lines:
        console.print(Padding(line, (0, 0, 0, 7), expand=False))
    light = f"{angle['wavelength_m'] * 1e6:g} um"
    console.print(
        f"[dim]{angle['atmosphere']}, index {angle['index']} at {light}, "
        f"{angle['method']}, radius "
        f"{angle['radius_m']:.0f} m[/dim]",
        highlight=False,
    )


def print_paper(console: Console, rows: Sequence[Mapping[str, Any]], notes: Sequence[str]) -> None:
    """Print the tables of a paper: its printed values, the published formula, and the exact values.

    A table of ``rows`` has the same table, quantity and unit. ``notes`` follow all tables.
    """
    keys = ("table", "quantity", "unit")
    columns = columns_of("paper")
    rows_of_table: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        key = tuple(row[name] for name in keys)
        rows_of_table.setdefault(key, []).append(row)
    for (number, quantity, unit), rows_of_key in rows_of_table.items():
        title = shown(f"Table {number}: {quantity} [{unit}]")
        table = Table(*_right_aligned(columns), box=None, title=title, title_justify="left")
        for row in rows_of_key:
            cells = cells_of(row, columns)
            table.add_row(*(cell.rstrip("0").rstrip(".") for cell in cells))
        console.print(table)
    for note in notes:
        print_indented(console, shown(note))


def _right_aligned(columns: Columns) -> list[Column]:
    """Columns of a printed table with their heads, aligned to the right."""
    return [Column(shown(column.head), justify="right") for column in columns]


def print_profile(console: Console, rows: Sequence[Mapping[str, Any]], standard: str) -> None:
    """Print a profile, a row a height, with the values of the standard atmosphere paler.

    ``standard`` is the name of that atmosphere.
    """
    columns = columns_of("profile")
    table = plain_table((*(column.head for column in columns), "source\n"), gap=1)
    table.columns[0].justify = "right"
    table.columns[-1].justify = "left"
    for row in rows:
        cells = cells_of(row, columns)
        for number, column in enumerate(columns):
            if column.name.startswith("standard"):
                cells[number] = f"[dim]{cells[number]}[/dim]"
        table.add_row(*cells, row["source"])
    console.print(table)
    console.print(f"N is (n-1)e6; std is {shown(standard)} at the same height", highlight=False)


def print_air(console: Console, air: FlightAir) -> None:
    """Print the effect of the air of a flight on R, its sources and the estimated sensor errors."""
    from unbend.atmosphere.estimate.sensors import FAULT_TEXTS  # scipy: angles need none

    adjustment = air.adjustment
    effects = [EffectRecord.of(effect) for effect in air.effects]
    lines = list(summary.effect_lines(effects, adjustment.standard.name))
    for use in adjustment.sources:
        lines.append(use.sentence())
    lines += [use.sentence() for use in adjustment.sensor_uses]
    for fault in adjustment.faults:
        in_units = fault.in_units()
        lines.append(f"{FAULT_TEXTS[in_units.fault]}: {with_sigma(in_units.value, in_units.sigma)}")
    if air.windows:
        lines.append(f"{len(air.series.timed_profiles)} profiles, because the air changes")
    for line in lines:
        print_indented(console, shown(line))


def radial_rows(tables: Sequence[RadialTable]) -> list[dict[str, Any]]:
    """The rows of all radial tables, by the names of their columns; None for NaN."""
    from unbend.tables.exports.correction_tables import radial_columns  # pandas: angles need none

    rows = []
    for table in tables:
        columns = radial_columns(table)
        lists = [np.asarray(column).tolist() for column in columns.values()]
        for values in zip(*lists, strict=True):
            row = dict(zip(columns, values, strict=True))
            for name, value in row.items():
                if value != value:  # NaN
                    row[name] = None
            rows.append(row)
    return rows


def print_radial(console: Console, tables: Sequence[RadialTable]) -> None:
    """Print radial tables, each below a line about its heights, and remarks on all of them."""
    for table in tables:
        manual = "the Manual's formula has no value"
        if not math.isnan(table.k_manual_rad):
            manual = f"the Manual's formula {table.k_manual_rad / MICRORADIAN:.2f}"
        console.print(
            f"[bold]camera {table.h_c_m:g} m, ground {table.h_g_m:g} m[/bold]: R at 45 deg "
            f"{table.k_rad / MICRORADIAN:.2f} urad, {manual}"
        )
        columns = columns_of("radial")
        if not np.isfinite(table.radius_px).any():
            columns = columns[:4]  # the others need an image
        printed = Table(*_right_aligned(columns), box=None)
        for row in radial_rows([table]):
            cells = cells_of(row, columns)
            is_ok = row["status"] == STATUS_NAMES[0]
            if not cells[1] and not is_ok:
                cells[1] = row["status"]  # in the place of the missing angle
            printed.add_row(*cells)
        console.print(Padding(printed, (0, 0, 1, 0)))
    if any(has_rays_over_the_horizon(table) for table in tables):
        over = summary.report_texts()["angle"]["over"]
        console.print(f"{over[:1].upper()}{over[1:]}.")
    wavelengths_m = sorted({table.wavelength_m for table in tables})
    light = ", ".join(f"{wavelength_m * 1e6:g}" for wavelength_m in wavelengths_m)
    console.print(f"Light of {light} um.")


def has_rays_over_the_horizon(table: RadialTable) -> bool:
    """Whether a ray of the table has an angle, but its straight line does not reach the ground."""
    is_defined = np.isfinite(table.r_c_rad)
    return bool(np.isnan(table.shift_ground_m[is_defined]).any())
