"""The air and refraction angles as text: profiles, one angle, radial tables, tables of papers."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table

from pipeline.atmosphere.estimate.sensors import FAULT_TEXTS
from pipeline.refraction.angle import RadialTable
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.report import summary
from pipeline.report.console import plain_table, print_indented, shown
from pipeline.report.words import significant, with_sigma
from pipeline.tables.exports.radial import radial_columns
from pipeline.units import HECTOPASCAL, MICRORADIAN

_STATUS_TEXTS = {
    "beyond_grazing": "the near one of two crossings of the ground's height; with --distance the "
    "slant range decides",
    "far_branch": "the far one of two crossings of the ground's height, as the slant range says",
}
_OVER_THE_HORIZON = (
    "no metres on the ground: the straight ray in the apparent direction passes over the horizon, "
    "and only the bent one lands"
)

_PAPER_COLUMNS = (
    ("h_c [km]", "h_c_m", 1e3, 3),
    ("h_g [km]", "h_g_m", 1e3, 3),
    ("zeta [deg]", "zeta_c_deg", 1.0, 4),
    ("printed", "printed", 1.0, 4),
    ("as published", "as_published", 1.0, 4),
    ("exact", "exact", 1.0, 4),
    ("difference", "difference", 1.0, 4),
)
_PROFILE_COLUMNS = (
    ("h\n[m]", "h_m", 1.0, ".0f"),
    ("T\n[K]", "temperature_k", 1.0, ".2f"),
    ("±\n", "sigma_temperature_k", 1.0, "sigma"),
    ("std\n[K]", "standard_temperature_k", 1.0, ".2f"),
    ("p\n[hPa]", "pressure_pa", HECTOPASCAL, ".1f"),
    ("std\n[hPa]", "standard_pressure_pa", HECTOPASCAL, ".1f"),
    ("e\n[hPa]", "vapour_pressure_pa", HECTOPASCAL, ".2f"),
    ("std\n[hPa]", "standard_vapour_pressure_pa", HECTOPASCAL, ".2f"),
    ("N\n[ppm]", "refractivity", 1e-6, ".2f"),
    ("±\n", "sigma_refractivity", 1e-6, "sigma"),
    ("std\n[ppm]", "standard_refractivity", 1e-6, ".2f"),
)
_RADIAL_COLUMNS = (
    ("nadir angle [deg]", "nadir_angle_deg", 2),
    ("R_c [arcsec]", "r_c_arcsec", 3),
    ("R_c [urad]", "r_c_urad", 2),
    ("ground [m]", "shift_ground_m", 3),
    ("radius [px]", "radius_px", 1),
    ("dr [px]", "dr_px", 4),
)


def print_angle(console: Console, angle: Mapping[str, Any]) -> None:
    """One refraction angle in arcsec, microradians and metres on the ground."""
    arcsec, urad, ground = (
        significant(angle[name], 5, smallest=1e-6)
        for name in ("r_c_arcsec", "r_c_urad", "ground_m")
    )
    over = angle["ground_m"] is None
    lines = [f"{urad} microradians", _OVER_THE_HORIZON if over else f"{ground} m on the ground"]
    if angle["status"] in _STATUS_TEXTS:
        lines.append(f"{angle['status']}: {_STATUS_TEXTS[angle['status']]}")
    console.print(f"R_c    {arcsec} arcsec", highlight=False)
    for line in lines:
        console.print(Padding(line, (0, 0, 0, 7), expand=False))
    console.print(
        f"[dim]{angle['atmosphere']}, index {angle['index']}, {angle['method']}, radius "
        f"{angle['radius_m']:.0f} m[/dim]",
        highlight=False,
    )


def print_paper(console: Console, rows: Sequence[Mapping[str, Any]], notes: Sequence[str]) -> None:
    """The tables of a paper: values as printed, as published, and exact."""
    keys = ("table", "quantity", "unit")
    for key in dict.fromkeys(tuple(row[name] for name in keys) for row in rows):
        table = Table(
            *(shown(head) for head, *_ in _PAPER_COLUMNS), box=None,
            title=shown(f"Table {key[0]}: {key[1]} [{key[2]}]"), title_justify="left",
        )  # fmt: skip
        for column in table.columns:
            column.justify = "right"
        for row in rows:
            if tuple(row[name] for name in keys) == key:
                table.add_row(*(
                    "" if row[name] is None
                    else f"{row[name] / unit:.{digits}f}".rstrip("0").rstrip(".")
                    for _, name, unit, digits in _PAPER_COLUMNS
                ))  # fmt: skip
        console.print(table)
    for note in notes:
        print_indented(console, shown(note))


def print_profile(console: Console, rows: Sequence[Mapping[str, Any]], standard: str) -> None:
    """A profile as a table, each quantity beside that of the standard."""
    table = plain_table((*(head for head, *_ in _PROFILE_COLUMNS), "source\n"), gap=1)
    table.columns[0].justify, table.columns[-1].justify = "right", "left"
    for row in rows:
        cells = []
        for _, name, unit, digits in _PROFILE_COLUMNS:
            value = None if row[name] is None else row[name] / unit
            if digits == "sigma":  # in four characters
                text = "" if value is None else f"{value:{'.2f' if value < 9.995 else '.1f'}}"
            else:
                text = f"{value:{digits}}"
            cells.append(f"[dim]{text}[/dim]" if name.startswith("standard") else text)
        table.add_row(*cells, row["source"])
    console.print(table)
    console.print(f"N is (n-1)e6; std is {shown(standard)} at the same height", highlight=False)


def print_air(console: Console, air: FlightAir) -> None:
    """The effect of the air of a flight on R, its sources and the estimated sensor errors."""
    adjustment = air.adjustment
    rows = [effect.row() for effect in air.effects]
    profiles = [f"{len(air.series.timed_profiles)} profiles follow the air"] if air.windows else []
    for line in (
        *summary.effect_lines(rows, adjustment.standard.name),
        *(use.sentence() for use in adjustment.sources),
        *(
            f"{FAULT_TEXTS[f.fault]}: {with_sigma(f.value, f.sigma)}"
            for f in (fault.in_units() for fault in adjustment.faults)
        ),
        *profiles,
    ):
        print_indented(console, shown(line))


def radial_rows(tables: Sequence[RadialTable]) -> list[dict[str, Any]]:
    """The rows of several radial tables, None where there is no value."""
    rows = []
    for table in tables:
        columns = {name: np.asarray(v).tolist() for name, v in radial_columns(table).items()}
        for values in zip(*columns.values(), strict=True):
            row = zip(columns, values, strict=True)
            rows.append({name: None if value != value else value for name, value in row})
    return rows


def print_radial(console: Console, tables: Sequence[RadialTable]) -> None:
    """Refraction by nadir angle, one table for each flying height."""
    for table in tables:
        manual = (
            "where the Manual's formula has no value"
            if math.isnan(table.k_manual_rad)
            else f"the Manual's formula {table.k_manual_rad / MICRORADIAN:.2f}"
        )
        console.print(
            f"[bold]camera {table.h_c_m:g} m, ground {table.h_g_m:g} m[/bold]: R at 45 deg "
            f"{table.k_rad / MICRORADIAN:.2f} urad, {manual}"
        )
        with_image = bool(np.isfinite(table.radius_px).any())
        columns = _RADIAL_COLUMNS if with_image else _RADIAL_COLUMNS[:4]
        printed = Table(*(shown(head) for head, _, _ in columns), box=None)
        for column in printed.columns:
            column.justify = "right"
        for row in radial_rows([table]):
            cells = [
                "" if row[name] is None else f"{row[name]:.{digits}f}"
                for _, name, digits in columns
            ]
            if not cells[1] and row["status"] != STATUS_NAMES[0]:
                cells[1] = row["status"]
            printed.add_row(*cells)
        console.print(Padding(printed, (0, 0, 1, 0)))
    if any(bool(np.isnan(t.shift_ground_m[np.isfinite(t.r_c_rad)]).any()) for t in tables):
        console.print(f"{_OVER_THE_HORIZON[:1].upper()}{_OVER_THE_HORIZON[1:]}.")
