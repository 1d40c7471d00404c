"""Radial tables for a person: refraction by nadir angle, one table a flying height."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from pipeline.refraction.radial import RadialTable
from pipeline.refraction.status import STATUS_NAMES
from pipeline.tables.exports.radial import radial_columns
from pipeline.units import MICRORADIAN

_COLUMNS = (
    ("nadir angle [deg]", "nadir_angle_deg", 2),
    ("R_c [arcsec]", "r_c_arcsec", 3),
    ("R_c [urad]", "r_c_urad", 2),
    ("ground [m]", "shift_ground_m", 3),
    ("radius [px]", "radius_px", 1),
    ("dr [px]", "dr_px", 4),
)


def radial_rows(tables: Sequence[RadialTable]) -> list[dict[str, Any]]:
    """The rows of radial tables one below the other, None for what is not there."""
    rows = []
    for table in tables:
        lists = {name: np.asarray(v).tolist() for name, v in radial_columns(table).items()}
        for values in zip(*lists.values(), strict=True):
            row = dict(zip(lists, values, strict=True))
            rows.append({name: None if value != value else value for name, value in row.items()})
    return rows


def show_radial(console: Console, tables: Sequence[RadialTable]) -> None:
    """Radial tables, each under its heights and its R at 45 degrees."""
    for table in tables:
        console.print(
            f"[bold]camera {table.h_c_m:g} m, ground {table.h_g_m:g} m[/bold]: R at 45 deg "
            f"{table.k_rad / MICRORADIAN:.2f} urad, {_manual(table.k_manual_rad)}"
        )
        with_image = bool(np.isfinite(table.radius_px).any())
        shown = _COLUMNS if with_image else _COLUMNS[:4]
        printed = Table(*(escape(head) for head, _, _ in shown), box=None)
        for column in printed.columns:
            column.justify = "right"
        for row in radial_rows([table]):
            cells = [_number(row[name], digits) for _, name, digits in shown]
            why = row["status"] if row["status"] != STATUS_NAMES[0] else ""
            printed.add_row(*cells[:1], cells[1] or why, *cells[2:])
        console.print(Padding(printed, (0, 0, 1, 0)))


def _manual(k_rad: float) -> str:
    if math.isnan(k_rad):
        return "where the Manual's formula has no value"
    return f"the Manual's formula {k_rad / MICRORADIAN:.2f}"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
