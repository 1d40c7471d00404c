"""What `unbend inspect` prints of weather: models, soundings, and METARs."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from unbend.report.console import print_indented, print_labelled, print_rows, shown
from unbend.report.words import count

MAX_REPORTS = 12  # METARs that are printed
MAX_LEVELS = 40  # of a model that are all printed


def print_model(console: Console, contents: Mapping[str, Any], name: str) -> None:
    """Print the contents of a weather model's file, by the keys of `contents_of`."""
    console.print(f"[bold]{shown(name)}[/bold]: weather model, {contents['format']}")
    lines = [("grid", contents["grid"] or "no temperature on levels")]
    if contents["grid"] is not None:
        lines.append(("time", model_times(contents)))
        lines.append(("levels", model_levels(contents)))
        for axis in ("latitude", "longitude"):
            nodes = contents[f"{axis}_deg"]
            if nodes:
                extent = f"{nodes['from']:g}° to {nodes['to']:g}°"
                lines.append((axis, f"{extent}, {nodes['count']} nodes every {nodes['step']:g}°"))
        members = contents["members"]
        if members:
            lines.append(("members", f"{len(members)}, {members[0]} to {members[-1]}"))
    print_labelled(console, lines)
    cells = []
    for variable in contents["variables"]:
        cells.append([str(variable[key]) for key in ("name", "units", "levels", "long_name")])
    console.print()
    heads = ("variable", "unit", "levels", "name")
    print_rows(console, heads, cells, gap=2, left=(1, 3))


def model_times(contents: Mapping[str, Any]) -> str:
    """The number of times of a model's file, the first and last, and the longest forecast."""
    times = contents["times_utc"]
    text = f"{count(len(times), 'time')}, {joined_ends(times[0], times[-1])} UTC"
    longest_h = max(contents["lead_h"])
    if longest_h:
        text += f"; {longest_h:g} h since the forecast began"
    return text


def model_levels(contents: Mapping[str, Any]) -> str:
    """The number, kind and range of the levels of a model's file; few levels are all listed."""
    levels = contents["levels"]
    kind = contents["level_kind"]
    unit = "" if kind == "model" else " hPa"
    text = f"{len(levels)} {kind} levels, {levels[0]:g} to {levels[-1]:g}{unit}"
    if len(levels) <= MAX_LEVELS:
        text += f": {', '.join(f'{level:g}' for level in levels)}"
    return text


def joined_ends(first_utc: str, last_utc: str) -> str:
    """The first and the last time as a text; a single one if they are equal.

    >>> joined_ends("2025-06-12T09:00", "2025-06-12T12:00")
    '2025-06-12 09:00 to 2025-06-12 12:00'
    """
    ends = dict.fromkeys([first_utc, last_utc])
    return " to ".join(ends).replace("T", " ")


def print_sounding(console: Console, reading: Mapping[str, Any], name: str) -> None:
    """Print the contents of a sounding, by the keys of `reading_of_sounding`."""
    console.print(f"[bold]{shown(name)}[/bold]: sounding, read as {reading['format']}")
    time = "not stated: atmosphere.soundings needs time_utc"
    if reading["first_utc"] is not None:
        time = f"{joined_ends(reading['first_utc'], reading['last_utc'])} UTC"
    place = "not stated"
    if reading["latitude_deg"] is not None:
        longitude = "longitude not stated"
        if reading["longitude_deg"] is not None:
            longitude = f"{reading['longitude_deg']:.3f}°"
        place = f"{reading['latitude_deg']:.3f}°, {longitude}"
    used = f"{reading['levels']:,} of {count(reading['levels_in_file'], 'level')}"
    lines = [
        ("ascents", f"{reading['ascents']:,}; below is the first"),
        ("station", reading["station"] or "not stated"),
        ("time", time),
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
    """The lowest and highest value as a text with a unit; "unknown" for None."""
    if limits is None:
        return "unknown"
    low, high = limits
    return f"{low:g} to {high:g} {unit}"


def print_metars(console: Console, reports: Sequence[Mapping[str, Any]], name: str) -> None:
    """Print the contents of METARs, by the keys of `reading_of_report`; at least one report."""
    console.print(f"[bold]{shown(name)}[/bold]: {count(len(reports), 'METAR')}")
    rows = []
    for report in reports[:MAX_REPORTS]:
        numbers = (report["temperature_c"], report["dew_point_c"], report["qnh_hpa"])
        cells = ["" if value is None else f"{value:.1f}" for value in numbers]
        time = " ".join(text for text in (report["date"], report["stamp"]) if text)
        not_understood = "; ".join(report["notes"])
        rows.append((report["station"], time, *cells, not_understood))
    heads = ("station", "time", "T [°C]", "dew point [°C]", "QNH [hPa]", "not understood")
    print_rows(console, heads, rows, gap=2, left=(1, 5))
    hidden = len(reports) - len(rows)
    if hidden:
        print_indented(console, f"{hidden:,} more: --json shows all")
    text = reports[0]["text"]
    line = f'atmosphere: {{surface: [{{h_msl_m: HEIGHT_OF_STATION, metar: "{text}"}}]}}'
    print_labelled(console, [("mission file", line)])
