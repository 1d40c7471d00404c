"""What commands say of missions and logs: 80 columns wide in a terminal, messages also as CSV."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from unbend.ingest.utc_evidence import is_utc
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
from unbend.report.summary import flagged, next_steps, remarks, verdict
from unbend.report.words import count, shortened
from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.manifest.whole import Manifest

_COLOURS = {"finding": "red", "loss": "red", "warning": "yellow", "fallback": "cyan", "note": "dim"}

_MOST_CONTROL = 12
_MOST_UNCHANGED = 12
_MOST_REASONS = 6
_MOST_REPORTS = 12


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
        console.print(
            "  nothing to do: mission file, inputs and code did not change since the last run"
        )
    print_indented(console, shown(" ".join([verdict(manifest), *remarks(manifest)])))
    print_rows(console, summary.CORRECTION_HEAD, summary.correction_rows(manifest), gap=2)
    profile = manifest.results.profile
    effects = summary.effect_lines(profile.effect, profile.standard)
    for line in (summary.air_sentences(manifest), *effects):
        print_hanging(console, shown(line))
    if sentence := summary.control_sentence(manifest):
        print_indented(console, shown(sentence))
        rows = summary.control_rows(manifest, _MOST_CONTROL)
        print_rows(console, summary.CONTROL_HEAD, rows, gap=1)
    if left_out := flagged(manifest):
        print_indented(console, f"Flagged rows: {left_out}")
    ledger = manifest.results.ledger
    print_ledger(console, [entry for entry in ledger if entry.kind != Kind.NOTE])
    steps = next_steps(manifest)
    print_labelled(console, [("" if i else "next", step) for i, step in enumerate(steps)])
    for label, path in (("results", output), ("report ", f"{folder}/report.html")):
        console.print(f"  {label}  {shown(path)}", soft_wrap=True)


def in_short(manifest: Manifest) -> str:
    """A run in some words: rows, correction, losses and warnings."""
    shift = manifest.results.correction.shift_px
    kinds = [entry.kind for entry in manifest.results.ledger]
    rows = count(manifest.results.observations.rows, "observation")
    said = [f"{shift.count:,} of {rows}"]
    if shift.count:
        said.append(f"median {shift.median:.3g} px, 95 % below {shift.p95:.3g} px")
    for kind, many in (("loss", "losses"), ("finding", ""), ("warning", "")):
        if number := kinds.count(kind):
            said.append(f"[{_COLOURS[kind]}]{count(number, kind, many)}[/]")
    return ", ".join(said)


def print_unchanged(console: Console, names: Sequence[str], total: int) -> None:
    """Which of several missions needed no run; of many only how many."""
    what = "nothing to do: mission file, inputs and code did not change since the last run"
    for name in names if len(names) <= _MOST_UNCHANGED else ():
        console.print(f"[bold]{shown(name)}[/bold]")
        console.print(f"  {what}")
    if len(names) > _MOST_UNCHANGED:
        console.print(f"{len(names):,} of {count(total, 'mission')}")
        console.print(f"  {what}")


def print_ledger(console: Console, entries: Sequence[MessageRecord]) -> None:
    """Each entry of a ledger, the gravest first."""
    for kind, code, what in summary.ledger_rows(entries):
        print_hanging(console, f"[{_COLOURS[kind]}]{kind}[/] {shown(code)}: {shown(what)}")


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
    if lens := summary.lens_left_in(results):
        print_indented(console, shown(lens))
    print_labelled(console, lines)
    entries = [entry for entry in results.ledger if verbose or entry.kind != Kind.NOTE]
    print_ledger(console, entries)
    hidden = len(results.ledger) - len(entries)
    if hidden:
        print_indented(console, f"{count(hidden, 'note')}: all of them with -v")


def print_status(console: Console, name: str, reasons: Sequence[str]) -> None:
    console.print(f"[bold]{shown(name)}[/bold] {'would run' if reasons else 'unchanged'}")
    for reason in reasons[:_MOST_REASONS]:
        print_hanging(console, shown(reason))
    if len(reasons) > _MOST_REASONS:
        print_indented(console, f"and {count(len(reasons) - _MOST_REASONS, 'more reason')}")


_FIRST_STATIONS, _LAST_STATIONS = 25, 5
_BESIDE_NAMES, _SHORTEST_NAME = 63, 17  # characters of the other columns; of an image's name


def print_stations(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """The first and last stations as a table, how many there are, and why some cannot be used."""
    columns = columns_of("stations")
    heads = ("image\n", "UTC\n", *(head for head, *_ in columns), "status\n")
    table = plain_table(heads, gap=1)
    table.columns[-1].overflow, table.columns[-1].justify = "fold", "left"
    for column in table.columns[:-1]:
        column.no_wrap = True
    few = len(rows) <= _FIRST_STATIONS + _LAST_STATIONS
    for row in rows if few else (*rows[:_FIRST_STATIONS], None, *rows[-_LAST_STATIONS:]):
        if row is None:
            table.add_row("...")
            continue
        time = f"{row['time_utc']:%H:%M:%S.%f}"[:10] if row["time_utc"] else ""
        name = shortened(row["image"], max(console.width - _BESIDE_NAMES, _SHORTEST_NAME))
        table.add_row(escape(name), time, *cells_of(row, columns), row["status"])
    print_indented(console, table)
    if not few:
        hidden = len(rows) - _FIRST_STATIONS - _LAST_STATIONS
        print_indented(console, f"{hidden:,} rows are not shown: all of them with --csv FILE")
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
        print_indented(console, shown(line))


def print_log(console: Console, log: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints: flight, roles, and channels by the names of mission files."""
    console.print(f"[bold]{shown(name)}[/bold]: {log['format']}, {log['duration_s']:.1f} s")
    flight, boots = log["flight"], log["boots"]
    begin, end = ((log[f"{key}_utc"] or "")[:19].replace("T", " ") for key in ("start", "end"))
    times = "counts from boot; UTC is unknown"
    if begin:
        times = f"{begin} to {end if end[:10] != begin[:10] else end[11:]} UTC"
    reference = flight.get("height_reference")
    heights = take_off = "unknown"
    if reference and flight["lowest_m"] is not None:
        heights = f"{flight['lowest_m']:.0f} to {flight['highest_m']:.0f} m above {reference}"
    if flight.get("take_off_m") is not None:
        surface = flight.get("take_off_reference", reference)
        take_off = f"{flight['take_off_m']:.0f} m above {surface}, {take_off_by(flight)}"
    elif flight:
        take_off = "unknown: the aircraft is not at rest when the log begins"
    place = f"{flight['lat_deg']:.3f}°, {flight['lon_deg']:.3f}°" if flight else "unknown"
    print_labelled(
        console,
        [
            ("place", place),
            ("time", times),
            ("clock", log["time_base"]),
            ("heights", heights),
            ("take-off", take_off),
            ("messages", f"{sum(log['messages'].values()):,} of "
             f"{count(len(log['messages']), 'type')}, {count(log['bad_bytes'], 'bad byte')}, "
             f"{log['lost_messages']:,} lost" + (f", {boots} boots" if boots > 1 else "")),
        ],
    )  # fmt: skip
    print_clocks(console, log["clocks"])
    for vehicle in log["vehicles"] or [{"vehicle": "", "roles": log["roles"]}]:
        console.print()
        if vehicle["vehicle"]:
            console.print(f"  [bold]{shown(vehicle['vehicle'])}[/bold], one of several vehicles")
        print_roles(console, vehicle["roles"])
    print_receivers(console, log["receivers"])
    table = plain_table(("channel", "samples", "rate [Hz]", "gaps", "gaps [s]"), gap=2)
    # Names are copied into mission files: in one piece, and never cut.
    table.columns[0].overflow = "fold"
    for channel in log["channels"]:
        seconds = [gap["seconds"] for gap in channel["gaps"]]
        numbers = f"{channel['samples']:,}", f"{channel['rate_hz']:.3g}"
        gaps = (str(len(seconds)), f"{sum(seconds):.1f}") if seconds else ("", "")
        table.add_row(shown(channel["name"]), *numbers, *gaps)
    console.print()
    print_indented(console, table)
    console.print()
    print_ledger(console, [MessageRecord(**entry) for entry in log["ledger"]])


def take_off_by(flight: Mapping[str, Any]) -> str:
    """What the height of the take-off comes from, in words."""
    if flight.get("take_off_by") == "home of the autopilot":
        return "by the autopilot's heights above its home"
    return "where the log begins"


def print_clocks(console: Console, clocks: Sequence[Mapping[str, Any]]) -> None:
    """What each clock of a log is good for, and why; the one that gives UTC comes first."""
    lines = []
    for clock in clocks:
        parts = [clock["clock"], clock["use"]]
        if clock["utc"] is not None:
            parts.append(f"of {clock['utc']}")
        if clock["apart_s"]:
            parts.append(f"{clock['apart_s']:+.3g} s from it")
        if clock["sigma_s"] is not None:
            parts.append(f"good to {clock['sigma_s']:.2g} s")
        lines.append(("clock", f"{', '.join(parts)}: {clock['why']}"))
    if lines:
        console.print()
        print_labelled(console, lines)


def print_roles(console: Console, roles: Sequence[Mapping[str, Any]]) -> None:
    """The channel of each role, and what speaks for it."""
    rows = []
    for row in roles:
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:.3g}"
        remarks = [text for text in (row["remark"], ", ".join(row["others"])) if text]
        rows.append((row["role"], row["channel"] or "-", rate, "; also ".join(remarks)))
    print_rows(
        console,
        ("role", "channel", "rate [Hz]", "remark"),
        rows,
        gap=2,
        left=(1, 3),
    )


def print_receivers(console: Console, receivers: Sequence[Mapping[str, str]]) -> None:
    """What each of several receivers is good for, and why."""
    if len(receivers) < 2:
        return
    rows = [(row["channel"], row["good_for"], row["why"]) for row in receivers]
    console.print()
    print_rows(
        console,
        ("receiver", "good for", "why"),
        rows,
        gap=2,
        left=(1, 2),
    )


def print_model(console: Console, contents: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints of a weather model's file: time, area, levels, variables."""
    console.print(f"[bold]{shown(name)}[/bold]: weather model, {contents['format']}")
    lines = [("grid", contents["grid"] or "no temperature on levels")]
    if contents["grid"] is not None:
        times, leads, levels = contents["times_utc"], contents["lead_h"], contents["levels"]
        unit, members = "" if contents["level_kind"] == "model" else " hPa", contents["members"]
        between = " to ".join(t.replace("T", " ") for t in dict.fromkeys((times[0], times[-1])))
        lead = f"; {max(leads):g} h since the forecast began" if max(leads) else ""
        lines += [
            ("time", f"{count(len(times), 'time')}, {between} UTC{lead}"),
            ("levels", f"{len(levels)} {contents['level_kind']} levels, {levels[0]:g} to "
             f"{levels[-1]:g}{unit}" + (f": {', '.join(f'{v:g}' for v in levels)}"
                                        if len(levels) <= 40 else "")),
        ]  # fmt: skip
        for axis in ("latitude", "longitude"):
            if node := contents[f"{axis}_deg"]:
                text = f"{node['from']:g}° to {node['to']:g}°, {node['count']} nodes every "
                lines.append((axis, f"{text}{node['step']:g}°"))
        if members:
            text = f"{len(members)}, {members[0]} to {members[-1]}"
            lines.append(("members", text))
    print_labelled(console, lines)
    keys = "name", "units", "levels", "long_name"
    cells = [[str(row[key]) for key in keys] for row in contents["variables"]]
    console.print()
    heads = "variable", "unit", "levels", "name"
    print_rows(
        console,
        heads,
        cells,
        gap=2,
        left=(1, 3),
    )


def print_sounding(console: Console, reading: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints of a sounding: how its first ascent is read."""
    console.print(f"[bold]{shown(name)}[/bold]: sounding, read as {reading['format']}")
    when = "not stated: atmosphere.soundings needs time_utc"
    if reading["first_utc"] is not None:
        ends = dict.fromkeys([reading["first_utc"], reading["last_utc"]])
        when = f"{' to '.join(ends).replace('T', ' ')} UTC"
    place = "not stated"
    if reading["latitude_deg"] is not None:
        place = f"{reading['latitude_deg']:.3f}°, {reading['longitude_deg']:.3f}°"
    used = f"{reading['levels']:,} of {count(reading['levels_in_file'], 'level')}"
    lines = [
        ("ascents", f"{reading['ascents']:,}; below is the first"),
        ("station", reading["station"] or "not stated"),
        ("time", when),
        ("place", place),
        ("levels", f"{used} used; heights in the file are {reading['heights']}"),
        ("height", span_text(reading["h_m"], "m above sea level")),
        ("pressure", span_text(reading["pressure_hpa"], "hPa")),
        ("temperature", span_text(reading["temperature_c"], "°C")),
    ]
    humidity = "none: dry air is assumed, or other sources are used"
    if reading["humidity"] is not None:
        vapour = span_text(reading["vapour_pressure_hpa"], "hPa of vapour")
        humidity = f"{vapour}, from {reading['humidity']}"
    lines.append(("humidity", humidity))
    for quantity, column in reading["columns"].items():
        lines.append((f"{quantity} from", f"column {column}"))
    lines += [("note", text) for text in reading["notes"]]
    lines.append(("mission file", f"atmosphere: {{soundings: [{{path: {name}}}]}}"))
    print_labelled(console, lines)


def span_text(limits: Sequence[float] | None, unit: str) -> str:
    """Lowest to highest value, with a unit."""
    return "unknown" if limits is None else f"{limits[0]:g} to {limits[1]:g} {unit}"


def print_metars(console: Console, reports: Sequence[Mapping[str, Any]], name: str) -> None:
    """What ``unbend inspect`` prints of a text of METARs: what each report states."""
    console.print(f"[bold]{shown(name)}[/bold]: {count(len(reports), 'METAR')}")
    rows = []
    for report in reports[:_MOST_REPORTS]:
        numbers = (report["temperature_c"], report["dew_point_c"], report["qnh_hpa"])
        cells = ["" if value is None else f"{value:.1f}" for value in numbers]
        when = " ".join(text for text in (report["date"], report["stamp"]) if text)
        rows.append((report["station"], when, *cells, "; ".join(report["notes"])))
    heads = ("station", "time", "T [°C]", "dew point [°C]", "QNH [hPa]", "not understood")
    print_rows(console, heads, rows, gap=2, left=(1, 5))
    hidden = len(reports) - len(rows)
    if hidden:
        print_indented(console, f"{hidden:,} more: --json shows all")
    text = reports[0]["text"]
    line = f'atmosphere: {{surface: [{{h_msl_m: HEIGHT_OF_STATION, metar: "{text}"}}]}}'
    print_labelled(console, [("mission file", line)])


def print_fields(console: Console, title: str, rows: Sequence[Mapping[str, str]]) -> None:
    console.print(f"[bold]{shown(title)}[/bold]")
    heads = ("field", "type", "first", "lowest", "highest")
    table = plain_table(heads, gap=2)
    table.columns[1].justify = table.columns[2].justify = "left"
    for row in rows:
        table.add_row(*(shown(row.get(name, "")) for name in heads))
    console.print(Padding(table, (1, 0, 1, 2)))


BLOCK = 8192  # rows made text at once

Columns = Mapping[str, NDArray[Any]]


def write_messages_csv(stream: TextIO, columns: Columns) -> None:
    """Columns of one length as CSV: numbers exactly, times as ISO 8601, an array as many columns.

    A time that counts from a boot is no UTC: its field is empty; the log's own columns have it.

    >>> import sys
    >>> times_ns = np.array([1_500_000_000 * 10**9, 0])
    >>> write_messages_csv(sys.stdout, {"time_ns": times_ns, "Temp": np.array([2.5, 2.6])})
    time_utc,Temp
    2017-07-14T02:40:00.000000000Z,2.5
    ,2.6
    """
    flat = dict(_flat(columns))
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time_utc" if name == "time_ns" else name for name in flat])
    rows = len(next(iter(flat.values())))
    for begin in range(0, rows, BLOCK):
        block = (_values(name, column[begin : begin + BLOCK]) for name, column in flat.items())
        writer.writerows(zip(*block, strict=True))


def field_rows(columns: Columns) -> list[dict[str, str]]:
    """A row for each field: type, first value, and the range of its finite numbers."""
    rows = []
    for name, column in _flat(columns):
        values = _values(name, column[:1])
        row = {"field": name, "type": str(column.dtype), "first": str(values[0]) if values else ""}
        finite = column[np.isfinite(column)] if column.dtype.kind in "iuf" else column[:0]
        if finite.size and name != "time_ns":
            row |= {"lowest": f"{finite.min():.10g}", "highest": f"{finite.max():.10g}"}
        rows.append(row)
    return rows


def _flat(columns: Columns) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, column in columns.items():
        if column.ndim == 1:
            yield name, column
            continue
        wide = column.reshape(column.shape[0], -1)
        for k in range(wide.shape[1]):
            yield f"{name}[{k}]", wide[:, k]


def _values(name: str, column: NDArray[Any]) -> list[Any]:
    if name != "time_ns":
        return list(column.tolist())
    times = column.astype("datetime64[ns]")
    texts = np.char.add(np.datetime_as_string(times), "Z")
    in_utc = np.where(is_utc(column), texts, "")
    return list(in_utc.tolist())
