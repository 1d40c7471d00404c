"""What a person sees in a terminal 80 columns wide."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from pipeline.atmosphere.estimate.sensors import FAULT_TEXTS
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.radial import RadialTable
from pipeline.refraction.status import STATUS_NAMES
from pipeline.report.summary import (
    CORRECTION_HEAD,
    correction_rows,
    effect_lines,
    headline,
    ledger_rows,
    where_from,
)
from pipeline.tables.exports.radial import radial_columns
from pipeline.units import MICRORADIAN

# What a person is told of an angle's status; ok needs no word.
_CROSSINGS = {
    "beyond_grazing": "the near one of two crossings of the ground's height; with --distance the "
    "slant range decides",
    "far_branch": "the far one of two crossings of the ground's height, as the slant range says",
}
OVER_THE_HORIZON = (
    "no metres on the ground: the straight ray in the apparent direction passes over the horizon, "
    "and only the bent one lands"
)

_COLOURS = {"loss": "red", "warning": "yellow", "fallback": "cyan", "note": "dim"}


def print_run(
    console: Console, name: str, output: str, manifest: Mapping[str, Any], *, repeated: bool
) -> None:
    """The summary at the end of a mission."""
    console.print(f"[bold]{escape(name)}[/bold]")
    if repeated:
        console.print("  nothing to do: mission file, inputs and code are those of the last run")
    _paragraph(console, headline(manifest))
    table = Table(*CORRECTION_HEAD, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in table.columns[1:]:
        column.justify = "right"
    for row in correction_rows(manifest):
        table.add_row(*(escape(cell) for cell in row))
    console.print(Padding(table, (0, 0, 0, 2)))
    _paragraph(console, where_from(manifest))
    profile = manifest["profile"]
    for line in effect_lines(profile["effect"], profile["standard"]):
        _paragraph(console, line)
    flagged = {k: n for k, n in manifest["observations"]["status"].items() if k != "ok" and n}
    if flagged:
        _paragraph(console, "Flagged rows: " + ", ".join(f"{n:,} {k}" for k, n in flagged.items()))
    for kind, code, what in ledger_rows(manifest):
        if kind != "note":
            console.print(
                Padding(f"[{_COLOURS[kind]}]{kind}[/] {escape(code)}: {escape(what)}", (0, 0, 0, 2))
            )
    console.print(Padding(f"results in {escape(output)}", (0, 0, 0, 2)))
    console.print(Padding(f"report     {escape(output)}/report.html", (0, 0, 0, 2)))


def _paragraph(console: Console, text: str) -> None:
    console.print(Padding(escape(text), (0, 0, 0, 2)))


def print_log(console: Console, log: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints: channels in the words that the mission file takes."""
    seconds = f"channels over {log['duration_s']:.1f} s"
    console.print(f"[bold]{escape(name)}[/bold]: {log['format']}, {seconds}")
    console.print(f"  from {log['start_utc']} to {log['end_utc']}", highlight=False)
    console.print(f"  time: {escape(log['time_base'])}")
    counts = f"  {sum(log['messages'].values()):,} messages of {len(log['messages'])} types"
    boots = f", {log['boots']} boots" if log["boots"] > 1 else ""
    console.print(f"{counts}{boots}, {log['bad_bytes']:,} bad bytes, {log['lost_messages']:,} lost")
    table = Table(
        "channel", "samples", r"rate \[Hz]", "gaps", "can play", box=None, pad_edge=False,
        padding=(0, 1, 0, 0),
    )  # fmt: skip
    for column in table.columns[1:4]:
        column.justify = "right"
    # Names are copied into mission files: in one piece if 80 columns have room, and never cut.
    table.columns[0].no_wrap = all(len(channel["name"]) <= 38 for channel in log["channels"])
    table.columns[0].overflow = "fold"
    table.columns[4].min_width = len("cabin_temperature")
    for channel in log["channels"]:
        roles = ", ".join(channel["roles"]) or "only if named"
        table.add_row(
            escape(channel["name"]),
            f"{channel['samples']:,}",
            f"{channel['rate_hz']:.3g}",
            str(len(channel["gaps"])),
            roles,
        )
    console.print(Padding(table, (1, 0, 1, 2)))
    print_ledger(console, log["ledger"])


def print_fields(console: Console, title: str, rows: Sequence[Mapping[str, str]]) -> None:
    """The fields of one message type of a log."""
    console.print(f"[bold]{escape(title)}[/bold]")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    heads = ("field", "type", "first", "lowest", "highest")
    for name in heads:
        table.add_column(name, justify="right" if name in ("lowest", "highest") else "left")
    for row in rows:
        table.add_row(*(escape(row.get(name, "")) for name in heads))
    console.print(Padding(table, (1, 0, 1, 2)))


def print_ledger(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """A ledger, the gravest entries first."""
    for kind, code, what in ledger_rows({"ledger": rows}):
        console.print(
            Padding(f"[{_COLOURS[kind]}]{kind}[/] {escape(code)}: {escape(what)}", (0, 0, 0, 2))
        )


def print_angle(console: Console, angle: Mapping[str, Any]) -> None:
    """One refraction angle in the units people use."""
    ground = angle["ground_m"]
    lines = [
        f"{angle['r_c_urad']:.6f} microradians",
        OVER_THE_HORIZON if ground is None else f"{ground:.6f} m on the ground",
    ]
    if angle["status"] in _CROSSINGS:
        lines.append(f"{angle['status']}: {_CROSSINGS[angle['status']]}")
    console.print(f"R_c    {angle['r_c_arcsec']:.6f} arcsec", highlight=False)
    for line in lines:
        console.print(Padding(line, (0, 0, 0, 7), expand=False))
    console.print(
        f"[dim]{angle['atmosphere']}, index {angle['index']}, {angle['method']}, radius "
        f"{angle['radius_m']:.0f} m[/dim]",
        highlight=False,
    )


def print_paper(console: Console, rows: Sequence[Mapping[str, Any]], notes: Sequence[str]) -> None:
    """A paper's figures, table by table: printed, as published, exact."""
    for head in dict.fromkeys((row["table"], row["quantity"], row["unit"]) for row in rows):
        names = (
            "h_c [km]",
            "h_g [km]",
            "zeta [deg]",
            "printed",
            "as published",
            "exact",
            "difference",
        )
        table = Table(
            *(escape(name) for name in names),
            title=escape(f"Table {head[0]}: {head[1]} [{head[2]}]"), box=None, title_justify="left",
        )  # fmt: skip
        for column in table.columns:
            column.justify = "right"
        for row in rows:
            if (row["table"], row["quantity"], row["unit"]) == head:
                table.add_row(
                    _number(row["h_c_m"], 3, 1e-3), _number(row["h_g_m"], 3, 1e-3),
                    _number(row["zeta_c_deg"], 4),
                    *(_number(row[key], 4) for key in _FIGURES),
                )  # fmt: skip
        console.print(table)
    for note in notes:
        console.print(Padding(escape(note), (0, 0, 0, 2)))


_FIGURES = ("printed", "as_published", "exact", "difference")


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """A figure without trailing zeros; nothing where there is none."""
    return "" if value is None else f"{value * factor:.{digits}f}".rstrip("0").rstrip(".")


def print_profile(console: Console, rows: Sequence[Mapping[str, Any]], standard: str) -> None:
    """A profile as a table, what the standard of that name has beside each figure."""
    heads = (
        "h\n[m]", "T\n[K]", "±\n", "std\n[K]", "p\n[hPa]", "std\n[hPa]", "e\n[hPa]", "std\n[hPa]",
        "N\n[ppm]", "±\n", "std\n[ppm]", "source\n",
    )  # fmt: skip
    table = Table(*(escape(head) for head in heads), box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for column in table.columns[:-1]:
        column.justify = "right"
    for row in rows:
        table.add_row(
            f"{row['h_m']:.0f}",
            f"{row['temperature_k']:.2f}",
            _sigma(row["sigma_temperature_k"]),
            f"[dim]{row['standard_temperature_k']:.2f}[/dim]",
            f"{row['pressure_pa'] / 100.0:.1f}",
            f"[dim]{row['standard_pressure_pa'] / 100.0:.1f}[/dim]",
            f"{row['vapour_pressure_pa'] / 100.0:.2f}",
            f"[dim]{row['standard_vapour_pressure_pa'] / 100.0:.2f}[/dim]",
            f"{row['refractivity'] * 1e6:.2f}",
            _sigma(row["sigma_refractivity"], 1e6),
            f"[dim]{row['standard_refractivity'] * 1e6:.2f}[/dim]",
            row["source"],
        )
    console.print(table)
    console.print(f"N is (n-1)e6; std is {escape(standard)} at the same height", highlight=False)


def _sigma(value: float | None, factor: float = 1.0) -> str:
    """To four characters."""
    if value is None:
        return ""
    return f"{value * factor:.2f}" if value * factor < 9.995 else f"{value * factor:.1f}"


def print_air(console: Console, air: FlightAir) -> None:
    """What the air of a flight was made from, and what it does to R."""
    adjustment = air.adjustment
    rows = [effect.row() for effect in air.effects]
    parts = [f"{len(air.series.timed_profiles)} profiles follow the air"] if air.windows else []
    for line in (
        *effect_lines(rows, adjustment.standard.name),
        *(use.sentence() for use in adjustment.sources),
        *(f"{FAULT_TEXTS[f.fault]}: {f.value:.3g} ± {f.sigma:.2g}" for f in adjustment.faults),
        *parts,
    ):
        _paragraph(console, line)


def print_check(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """What ``unbend check`` understood."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in lines:
        table.add_row(label, escape(text))
    console.print(Padding(table, (0, 0, 0, 2)))


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


def print_radial(console: Console, tables: Sequence[RadialTable]) -> None:
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
            cells = [_fixed(row[name], digits) for _, name, digits in shown]
            why = row["status"] if row["status"] != STATUS_NAMES[0] else ""
            printed.add_row(*cells[:1], cells[1] or why, *cells[2:])
        console.print(Padding(printed, (0, 0, 1, 0)))


def _manual(k_rad: float) -> str:
    if math.isnan(k_rad):
        return "where the Manual's formula has no value"
    return f"the Manual's formula {k_rad / MICRORADIAN:.2f}"


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
