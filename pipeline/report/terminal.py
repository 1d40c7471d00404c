"""The output of the commands in a terminal 80 columns wide."""

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
from pipeline.refraction.angle import RadialTable
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.report import summary
from pipeline.report.verdict import flagged, next_steps, verdict
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

_COLOURS = {"finding": "red", "loss": "red", "warning": "yellow", "fallback": "cyan", "note": "dim"}

_MOST_CONTROL = 12

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


def print_run(
    console: Console, name: str, output: str, manifest: Mapping[str, Any], *, repeated: bool
) -> None:
    """Summary at the end of a mission; ``repeated`` if an earlier run was up to date."""
    console.print(f"[bold]{escape(name)}[/bold]")
    if repeated:
        console.print("  nothing to do: mission file, inputs and code are those of the last run")
    _print_indented(console, escape(verdict(manifest)))
    table = _table(summary.CORRECTION_HEAD, gap=2)
    for row in summary.correction_rows(manifest):
        table.add_row(*(escape(cell) for cell in row))
    _print_indented(console, table)
    profile = manifest["profile"]
    effects = summary.effect_lines(profile["effect"], profile["standard"])
    for line in (summary.air_sentences(manifest), *effects):
        _print_indented(console, escape(line))
    if sentence := summary.control_sentence(manifest):
        _print_indented(console, escape(sentence))
        table = _table(summary.CONTROL_HEAD, gap=1)
        for row in summary.control_rows(manifest, _MOST_CONTROL):
            table.add_row(*(escape(cell) for cell in row))
        _print_indented(console, table)
    if rows := flagged(manifest):
        _print_indented(console, f"Flagged rows: {rows}")
    print_ledger(console, [entry for entry in manifest["ledger"] if entry["kind"] != "note"])
    steps = next_steps(manifest)
    _print_labelled(console, [("" if i else "next", step) for i, step in enumerate(steps)])
    for label, path in (("results", output), ("report ", f"{output}/report.html")):
        console.print(f"  {label}  {escape(path)}", soft_wrap=True)


def print_ledger(console: Console, entries: Sequence[Mapping[str, Any]]) -> None:
    """Entries of a ledger, the gravest first."""
    for kind, code, what in summary.ledger_rows(entries):
        _print_indented(console, f"[{_COLOURS[kind]}]{kind}[/] {escape(code)}: {escape(what)}")


def print_check(
    console: Console, name: str, lines: Sequence[tuple[str, str]], manifest: Mapping[str, Any]
) -> None:
    """What ``unbend check`` read and expects of a run, and what the ledger of a run would hold."""
    verdict = "a run would end with code 3" if manifest["exit_code"] else "can be run"
    console.print(f"[bold]{escape(name)}[/bold] {verdict}")
    _print_labelled(console, lines)
    print_ledger(console, manifest["ledger"])


_STATION_COLUMNS = (
    ("lat\n[deg]", "lat_deg", ".5f"),
    ("lon\n[deg]", "lon_deg", ".5f"),
    ("± xy\n[m]", "sigma_horizontal_m", ".2f"),
    ("h\n[m]", "h_msl_m", ".1f"),
    ("± h\n[m]", "sigma_height_m", ".2f"),
    ("tilt\n± deg", "sigma_tilt_deg", ".2f"),
)
_FIRST_STATIONS, _LAST_STATIONS = 25, 5


def print_stations(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """The first and last stations as a table, how many there are, and why some cannot be used."""
    heads = ("image\n", "UTC\n", *(head for head, *_ in _STATION_COLUMNS), "status\n")
    table = _table(heads, gap=1)
    table.columns[0].overflow = table.columns[-1].overflow = "fold"
    table.columns[-1].justify = "left"
    for column in table.columns[1:-1]:
        column.no_wrap = True
    few = len(rows) <= _FIRST_STATIONS + _LAST_STATIONS
    for row in rows if few else (*rows[:_FIRST_STATIONS], None, *rows[-_LAST_STATIONS:]):
        if row is None:
            table.add_row("...")
            continue
        time = f"{row['time_utc']:%H:%M:%S.%f}"[:10] if row["time_utc"] else ""
        cells = (
            "" if row[name] is None else f"{row[name]:{digits}}"
            for _, name, digits in _STATION_COLUMNS
        )
        table.add_row(escape(row["image"]), time, *cells, row["status"])
    _print_indented(console, table)
    if not few:
        hidden = len(rows) - _FIRST_STATIONS - _LAST_STATIONS
        _print_indented(console, f"{hidden:,} rows are not shown: all of them with --csv FILE")
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        key = row["camera"] or "no camera", row["status"], row["suspect_reason"] or ""
        groups.setdefault(key, []).append(row)
    for (camera, status, reason), of_group in groups.items():
        line = f"{camera}: {len(of_group):,} {status}"
        if status != "ok":
            names = [row["image"] for row in of_group]
            line += f", {names[0]}" if len(names) == 1 else f", {names[0]} to {names[-1]}"
        off = max((row["suspect_m"] or 0.0 for row in of_group), default=0.0)
        line += f": {reason}" if reason else ""
        line += f" (up to {off:.0f} m off)" if off else ""
        _print_indented(console, escape(line))


def print_log(console: Console, log: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints: the channels by the names that a mission file uses."""
    seconds = f"channels over {log['duration_s']:.1f} s"
    console.print(f"[bold]{escape(name)}[/bold]: {log['format']}, {seconds}")
    console.print(f"  from {log['start_utc']} to {log['end_utc']}", highlight=False)
    console.print(f"  time: {escape(log['time_base'])}")
    counts = f"  {sum(log['messages'].values()):,} messages of {len(log['messages'])} types"
    boots = f", {log['boots']} boots" if log["boots"] > 1 else ""
    console.print(f"{counts}{boots}, {log['bad_bytes']:,} bad bytes, {log['lost_messages']:,} lost")
    table = _table(("channel", "samples", "rate [Hz]", "gaps", "can play"), gap=1)
    # Names are copied into mission files: in one piece if 80 columns have room, and never cut.
    table.columns[0].no_wrap = all(len(channel["name"]) <= 38 for channel in log["channels"])
    table.columns[0].overflow = "fold"
    table.columns[4].justify = "left"
    table.columns[4].min_width = len("cabin_temperature")
    for channel in log["channels"]:
        numbers = f"{channel['samples']:,}", f"{channel['rate_hz']:.3g}", str(len(channel["gaps"]))
        roles = ", ".join(channel["roles"]) or "only if named"
        table.add_row(escape(channel["name"]), *numbers, roles)
    console.print(Padding(table, (1, 0, 1, 2)))
    print_ledger(console, log["ledger"])


def print_fields(console: Console, title: str, rows: Sequence[Mapping[str, str]]) -> None:
    """The fields of one message type of a log."""
    console.print(f"[bold]{escape(title)}[/bold]")
    heads = ("field", "type", "first", "lowest", "highest")
    table = _table(heads, gap=2)
    table.columns[1].justify = table.columns[2].justify = "left"
    for row in rows:
        table.add_row(*(escape(row.get(name, "")) for name in heads))
    console.print(Padding(table, (1, 0, 1, 2)))


def print_angle(console: Console, angle: Mapping[str, Any]) -> None:
    """One refraction angle in arcsec, microradians and metres on the ground."""
    ground = angle["ground_m"]
    lines = [
        f"{angle['r_c_urad']:.6f} microradians",
        _OVER_THE_HORIZON if ground is None else f"{ground:.6f} m on the ground",
    ]
    if angle["status"] in _STATUS_TEXTS:
        lines.append(f"{angle['status']}: {_STATUS_TEXTS[angle['status']]}")
    console.print(f"R_c    {angle['r_c_arcsec']:.6f} arcsec", highlight=False)
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
            *(escape(head) for head, *_ in _PAPER_COLUMNS), box=None,
            title=escape(f"Table {key[0]}: {key[1]} [{key[2]}]"), title_justify="left",
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
        _print_indented(console, escape(note))


def print_profile(console: Console, rows: Sequence[Mapping[str, Any]], standard: str) -> None:
    """A profile as a table, each quantity beside that of the standard."""
    table = _table((*(head for head, *_ in _PROFILE_COLUMNS), "source\n"), gap=1)
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
    console.print(f"N is (n-1)e6; std is {escape(standard)} at the same height", highlight=False)


def print_air(console: Console, air: FlightAir) -> None:
    """The effect of the air of a flight on R, its sources and the estimated sensor errors."""
    adjustment = air.adjustment
    rows = [effect.row() for effect in air.effects]
    profiles = [f"{len(air.series.timed_profiles)} profiles follow the air"] if air.windows else []
    for line in (
        *summary.effect_lines(rows, adjustment.standard.name),
        *(use.sentence() for use in adjustment.sources),
        *(
            f"{FAULT_TEXTS[f.fault]}: {f.value:.3g} ± {f.sigma:.2g}"
            for f in (fault.in_units() for fault in adjustment.faults)
        ),
        *profiles,
    ):
        _print_indented(console, escape(line))


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
        printed = Table(*(escape(head) for head, _, _ in columns), box=None)
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


def _print_indented(console: Console, content: str | Table) -> None:
    """Print markup or a table two columns to the right."""
    console.print(Padding(content, (0, 0, 0, 2)))


def _print_labelled(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """Lines with their labels in a column before them."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in lines:
        table.add_row(label, escape(text))
    _print_indented(console, table)


def _table(heads: Sequence[str], *, gap: int) -> Table:
    """A table without lines, all columns but the first aligned to the right."""
    table = Table(*(escape(h) for h in heads), box=None, pad_edge=False, padding=(0, gap, 0, 0))
    for column in table.columns[1:]:
        column.justify = "right"
    return table
