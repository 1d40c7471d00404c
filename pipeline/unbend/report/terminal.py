"""What commands print about missions, wrapped to the width of the terminal."""

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

MAX_CONTROL_ROWS = 12  # control points in the table
MAX_UNCHANGED = 12  # missions that are named
MAX_REASONS = 6  # why a mission would run

FIRST_STATIONS = 25  # rows of the table of stations, before and after its gap
LAST_STATIONS = 5
WIDTH_WITHOUT_NAMES = 63  # characters of all columns but the names of images
SHORTEST_NAME = 17  # characters of an image's name, also in a narrower terminal

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
    """Print the summary at the end of a mission, or only one line if ``brief``.

    ``output`` is the folder or URL of the results. ``repeated``: the mission was up to date, so
    ``manifest`` is that of an earlier run.
    """
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
    """Print how well control points agree before and after; nothing without control points."""
    sentence = summary.control_sentence(manifest)
    if sentence:
        print_indented(console, shown(sentence))
        rows = summary.control_rows(manifest, MAX_CONTROL_ROWS)
        print_rows(console, summary.CONTROL_HEAD, rows, gap=1)


def print_steps(console: Console, steps: Sequence[str]) -> None:
    """Print what to do next, one step a line, the first with the label "next"."""
    lines = []
    label = "next"
    for step in steps:
        lines.append((label, step))
        label = ""
    print_labelled(console, lines)


def in_short(manifest: Manifest) -> str:
    """One line of markup about a run: rows, correction, losses, findings and warnings."""
    shift = manifest.results.correction.shift_px
    kinds = [entry.kind for entry in manifest.results.ledger]
    rows = count(manifest.results.observations.rows, "observation")
    parts = [f"{shift.count:,} of {rows}"]
    if shift.count:
        parts.append(f"median {shift.median:.3g} px, 95 % below {shift.p95:.3g} px")
    for kind, plural in (("loss", "losses"), ("finding", ""), ("warning", "")):
        number = kinds.count(kind)
        if number:
            parts.append(f"[{COLOURS[kind]}]{count(number, kind, plural)}[/]")
    return ", ".join(parts)


def print_unchanged(console: Console, names: Sequence[str], total: int) -> None:
    """Print which of ``total`` missions needed no run; only their number if they are many."""
    titles = [f"[bold]{shown(name)}[/bold]" for name in names]
    if len(names) > MAX_UNCHANGED:
        titles = [f"{len(names):,} of {count(total, 'mission')}"]
    for title in titles:
        console.print(title)
        console.print(f"  {NOTHING_TO_DO}")


def print_ledger(console: Console, entries: Sequence[MessageRecord]) -> None:
    """Print the entries of a ledger, the most severe kinds first."""
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
    """Print the result of ``unbend check``: what was read, and the ledger that a run would have.

    ``lines`` are labels and texts about the inputs, ``results`` those that are expected of a run.
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
    """Print whether a mission would run: only if there are ``reasons``, for example new inputs."""
    state = "would run" if reasons else "unchanged"
    console.print(f"[bold]{shown(name)}[/bold] {state}")
    for reason in reasons[:MAX_REASONS]:
        print_hanging(console, shown(reason))
    hidden = len(reasons) - MAX_REASONS
    if hidden > 0:
        print_indented(console, f"and {count(hidden, 'more reason')}")


def print_stations(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the first and last stations as a table, and a line for each group of all stations.

    ``rows`` have the columns of ``stations.parquet``. A group has the same camera, status and
    reason.
    """
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
    """Print a table of the ``first`` stations and, after a row of dots, the ``last`` if any."""
    columns = columns_of("stations")
    heads = ("image\n", "UTC\n", *(column.head for column in columns), "status\n")
    table = plain_table(heads, gap=1)
    for column in table.columns[:-1]:
        column.no_wrap = True
    status = table.columns[-1]
    status.overflow = "fold"
    status.justify = "left"
    longest = max(console.width - WIDTH_WITHOUT_NAMES, SHORTEST_NAME)

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
    """A sentence about stations ``rows`` of one camera, status and reason.

    It states their number, first and last image, the reason, and the largest ``suspect_m``.

    >>> row = {"image": "a.jpg", "suspect_m": 12.3}
    >>> station_group("nadir", "suspect", "far from the log", [row])
    'nadir: 1 suspect, a.jpg: far from the log (up to 12 m off)'
    """
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
