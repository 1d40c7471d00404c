"""What commands say of missions: 80 columns wide in a terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape

from unbend.messages import Kind, MessageRecord
from unbend.report import summary
from unbend.report.console import (
    cells_of,
    columns_of,
    plain_table,
    print_hanging,
    print_indented,
    print_labelled,
    print_rows,
    shown,
)
from unbend.report.lens_sentences import lens_left_in
from unbend.report.summary import flagged, next_steps, remarks, verdict
from unbend.report.words import count, shortened
from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.manifest.whole import Manifest

COLOURS = {"finding": "red", "loss": "red", "warning": "yellow", "fallback": "cyan", "note": "dim"}

MAX_CONTROL_ROWS = 12
MAX_UNCHANGED = 12  # missions that are named
MAX_REASONS = 6

FIRST_STATIONS = 25
LAST_STATIONS = 5
WIDTH_BESIDE_NAMES = 63  # characters of the other columns
SHORTEST_NAME = 17  # characters of an image's name

NOTHING_TO_DO = "nothing to do: mission file, inputs and code did not change since the last run"


def print_run(
    console: Console,
    name: str,
    output: str,
    manifest: Manifest,
    *,
    repeated: bool,
    brief: bool = False,
) -> None:
    """Summary at the end of a mission, or a ``brief`` line; ``repeated`` if it was up to date."""
    folder = output
    if manifest.run.attempt:
        folder = f"{output}/attempts/{manifest.run.attempt}"
    if brief:
        line = f"[bold]{shown(name)}[/bold]: {in_short(manifest)}; {shown(folder)}/report.html"
        console.print(line, soft_wrap=True)
        return
    console.print(f"[bold]{shown(name)}[/bold]")
    if repeated:
        console.print(f"  {NOTHING_TO_DO}")
    print_indented(console, shown(" ".join([verdict(manifest), *remarks(manifest)])))
    print_rows(console, summary.CORRECTION_HEAD, summary.correction_rows(manifest), gap=2)
    profile = manifest.results.profile
    print_hanging(console, shown(summary.air_sentences(manifest)))
    for line in summary.effect_lines(profile.effect, profile.standard):
        print_hanging(console, shown(line))
    print_control(console, manifest)
    left_out = flagged(manifest)
    if left_out:
        print_indented(console, f"Flagged rows: {left_out}")
    ledger = manifest.results.ledger
    print_ledger(console, [entry for entry in ledger if entry.kind != Kind.NOTE])
    print_steps(console, next_steps(manifest))
    console.print(f"  results  {shown(output)}", soft_wrap=True)
    console.print(f"  report   {shown(folder)}/report.html", soft_wrap=True)


def print_control(console: Console, manifest: Manifest) -> None:
    """How control points and check points agree, if a mission has any."""
    sentence = summary.control_sentence(manifest)
    if sentence:
        print_indented(console, shown(sentence))
        rows = summary.control_rows(manifest, MAX_CONTROL_ROWS)
        print_rows(console, summary.CONTROL_HEAD, rows, gap=1)


def print_steps(console: Console, steps: Sequence[str]) -> None:
    """What to do next, the first step with a label."""
    lines = []
    label = "next"
    for step in steps:
        lines.append((label, step))
        label = ""
    print_labelled(console, lines)


def in_short(manifest: Manifest) -> str:
    """A run in some words: rows, correction, losses and warnings."""
    shift = manifest.results.correction.shift_px
    kinds = [entry.kind for entry in manifest.results.ledger]
    rows = count(manifest.results.observations.rows, "observation")
    parts = [f"{shift.count:,} of {rows}"]
    if shift.count:
        parts.append(f"median {shift.median:.3g} px, 95 % below {shift.p95:.3g} px")
    for kind, many in (("loss", "losses"), ("finding", ""), ("warning", "")):
        number = kinds.count(kind)
        if number:
            parts.append(f"[{COLOURS[kind]}]{count(number, kind, many)}[/]")
    return ", ".join(parts)


def print_unchanged(console: Console, names: Sequence[str], total: int) -> None:
    """Which of several missions needed no run; of many only how many."""
    titles = [f"[bold]{shown(name)}[/bold]" for name in names]
    if len(names) > MAX_UNCHANGED:
        titles = [f"{len(names):,} of {count(total, 'mission')}"]
    for title in titles:
        console.print(title)
        console.print(f"  {NOTHING_TO_DO}")


def print_ledger(console: Console, entries: Sequence[MessageRecord]) -> None:
    """Each entry of a ledger, the gravest first."""
    for kind, code, text in summary.ledger_rows(entries):
        print_hanging(console, f"[{COLOURS[kind]}]{kind}[/] {shown(code)}: {shown(text)}")


def print_check(
    console: Console,
    name: str,
    lines: Sequence[tuple[str, str]],
    results: ResultsRecord,
    *,
    verbose: bool,
) -> None:
    """What ``unbend check`` read and expects of a run, and what the ledger of a run would hold.

    Notes of the ledger are only counted, unless ``verbose``.
    """
    verdict = "a run would end with code 3" if results.exit_code else "can be run"
    console.print(f"[bold]{shown(name)}[/bold] {verdict}")
    lens = lens_left_in(results)
    if lens:
        print_indented(console, shown(lens))
    print_labelled(console, lines)
    entries = [entry for entry in results.ledger if verbose or entry.kind != Kind.NOTE]
    print_ledger(console, entries)
    hidden = len(results.ledger) - len(entries)
    if hidden:
        print_indented(console, f"{count(hidden, 'note')}: all of them with -v")


def print_status(console: Console, name: str, reasons: Sequence[str]) -> None:
    """Whether a mission would run, and why."""
    state = "would run" if reasons else "unchanged"
    console.print(f"[bold]{shown(name)}[/bold] {state}")
    for reason in reasons[:MAX_REASONS]:
        print_hanging(console, shown(reason))
    hidden = len(reasons) - MAX_REASONS
    if hidden > 0:
        print_indented(console, f"and {count(hidden, 'more reason')}")


def print_stations(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """The first and last stations as a table, how many there are, and why some cannot be used."""
    hidden = len(rows) - FIRST_STATIONS - LAST_STATIONS
    if hidden <= 0:
        print_station_rows(console, rows, [])
    else:
        print_station_rows(console, rows[:FIRST_STATIONS], rows[-LAST_STATIONS:])
        print_indented(console, f"{hidden:,} rows are not shown: all of them with --csv FILE")
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        key = (row["camera"] or "no camera", row["status"], row["suspect_reason"] or "")
        groups.setdefault(key, []).append(row)
    for (camera, status, reason), stations in groups.items():
        print_indented(console, shown(station_group(camera, status, reason, stations)))


def print_station_rows(
    console: Console, first: Sequence[Mapping[str, Any]], last: Sequence[Mapping[str, Any]]
) -> None:
    """A table of stations, with a gap before the last ones."""
    columns = columns_of("stations")
    heads = ("image\n", "UTC\n", *(column.head for column in columns), "status\n")
    table = plain_table(heads, gap=1)
    for column in table.columns[:-1]:
        column.no_wrap = True
    status = table.columns[-1]
    status.overflow = "fold"
    status.justify = "left"
    longest = max(console.width - WIDTH_BESIDE_NAMES, SHORTEST_NAME)

    def add_rows(rows: Sequence[Mapping[str, Any]]) -> None:
        for row in rows:
            name = shortened(row["image"], longest)
            time = ""
            if row["time_utc"]:
                time = f"{row['time_utc']:%H:%M:%S.%f}"[:10]
            table.add_row(escape(name), time, *cells_of(row, columns), row["status"])

    add_rows(first)
    if last:
        table.add_row("...")
        add_rows(last)
    print_indented(console, table)


def station_group(camera: str, status: str, reason: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Stations of a camera with one status: how many, which, why, and how far they are off."""
    text = f"{camera}: {len(rows):,} {status}"
    if status != "ok":
        first = rows[0]["image"]
        last = rows[-1]["image"]
        text += f", {first}" if len(rows) == 1 else f", {first} to {last}"
    if reason:
        text += f": {reason}"
    off_m = max(row["suspect_m"] or 0.0 for row in rows)
    if off_m:
        text += f" (up to {off_m:.0f} m off)"
    return text
