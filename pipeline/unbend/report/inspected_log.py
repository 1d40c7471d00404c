"""What `unbend inspect` prints of a log: flight, clocks, roles, channels, fields of a message.

The contents of a log are plain values by key, as `unbend inspect --json` prints them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table

from unbend.messages import MessageRecord
from unbend.report.console import plain_table, print_indented, print_labelled, print_rows, shown
from unbend.report.terminal import print_ledger
from unbend.report.words import count

UNNAMED_VEHICLE = ""  # the only vehicle of a log


def print_log(console: Console, log: Mapping[str, Any], name: str) -> None:
    """Print the contents of a log: flight, clocks, roles, receivers, channels and the ledger.

    Channels have the names that mission files use for them.
    """
    console.print(f"[bold]{shown(name)}[/bold]: {log['format']}, {log['duration_s']:.1f} s")
    flight = log["flight"]
    print_labelled(
        console,
        [
            ("place", place_of(flight)),
            ("time", times_of(log)),
            ("clock", log["time_base"]),
            ("heights", heights_of(flight)),
            ("take-off", take_off_of(flight)),
            ("messages", messages_of(log)),
        ],
    )
    print_clocks(console, log["clocks"])
    vehicles = log["vehicles"] or [{"vehicle": UNNAMED_VEHICLE, "roles": log["roles"]}]
    for vehicle in vehicles:
        console.print()
        if vehicle["vehicle"] != UNNAMED_VEHICLE:
            console.print(f"  [bold]{shown(vehicle['vehicle'])}[/bold], one of several vehicles")
        print_roles(console, vehicle["roles"])
    print_receivers(console, log["receivers"])
    console.print()
    print_indented(console, channel_table(log["channels"]))
    console.print()
    print_ledger(console, [MessageRecord(**entry) for entry in log["ledger"]])


def place_of(flight: Mapping[str, Any]) -> str:
    """Latitude and longitude of a flight, to 100 m."""
    if not flight:
        return "unknown"
    return f"{flight['lat_deg']:.3f}°, {flight['lon_deg']:.3f}°"


def times_of(log: Mapping[str, Any]) -> str:
    """When a log begins and ends; the date of the end only if it is another day."""
    if not log["start_utc"]:
        return "counts from boot; UTC is unknown"
    begin = log["start_utc"][:19].replace("T", " ")
    end = (log["end_utc"] or "")[:19].replace("T", " ")
    if end[:10] == begin[:10]:
        end = end[11:]
    return f"{begin} to {end} UTC"


def heights_of(flight: Mapping[str, Any]) -> str:
    """The range of heights of a flight, and their reference."""
    reference = flight.get("height_reference")
    if not reference or flight["lowest_m"] is None:
        return "unknown"
    return f"{flight['lowest_m']:.0f} to {flight['highest_m']:.0f} m above {reference}"


def take_off_of(flight: Mapping[str, Any]) -> str:
    """The height of the take-off, and how it was found."""
    if not flight:
        return "unknown"
    if flight.get("take_off_m") is None:
        if flight.get("lowest_m") is None:
            return "unknown: the log has no heights at its positions"
        return "unknown: the aircraft is not at rest when the log begins"
    surface = flight.get("take_off_reference", flight.get("height_reference"))
    return f"{flight['take_off_m']:.0f} m above {surface}, {source_of_take_off(flight)}"


def source_of_take_off(flight: Mapping[str, Any]) -> str:
    """How the height of the take-off was found, in words."""
    if flight.get("take_off_by") == "home of the autopilot":
        return "by the autopilot's heights above its home"
    return "where the log begins"


def messages_of(log: Mapping[str, Any]) -> str:
    """The numbers of messages, types, damaged bytes and lost messages of a log."""
    total = sum(log["messages"].values())
    types = count(len(log["messages"]), "type")
    bad_bytes = count(log["bad_bytes"], "bad byte")
    text = f"{total:,} of {types}, {bad_bytes}, {log['lost_messages']:,} lost"
    if log["boots"] > 1:
        text += f", {log['boots']} boots"
    return text


def print_clocks(console: Console, clocks: Sequence[Mapping[str, Any]]) -> None:
    """Print the use of each clock of a log, its deviation from UTC, and the reason for the use.

    The first clock is the one that gives UTC; ``apart_s`` is the difference from it.
    """
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
    """Print the channel that has each role, for example position, and remarks on the choice."""
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
    """Print the use of each receiver and the reason, if there are several."""
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


def channel_table(channels: Sequence[Mapping[str, Any]]) -> Table:
    """A table with the samples, rate and gaps of each channel."""
    table = plain_table(("channel", "samples", "rate [Hz]", "gaps", "gaps [s]"), gap=2)
    # Names are copied into mission files, so they must not be cut.
    table.columns[0].overflow = "fold"
    for channel in channels:
        gaps_s = [gap["seconds"] for gap in channel["gaps"]]
        gaps = ""
        total_s = ""
        if gaps_s:
            gaps = str(len(gaps_s))
            total_s = f"{sum(gaps_s):.1f}"
        samples = f"{channel['samples']:,}"
        rate = f"{channel['rate_hz']:.3g}"
        table.add_row(shown(channel["name"]), samples, rate, gaps, total_s)
    return table


def print_fields(console: Console, title: str, rows: Sequence[Mapping[str, str]]) -> None:
    """Print the fields of a type of messages; ``rows`` are those of `field_rows`."""
    console.print(f"[bold]{shown(title)}[/bold]")
    heads = ("field", "type", "first", "lowest", "highest")
    table = plain_table(heads, gap=2)
    table.columns[1].justify = "left"
    table.columns[2].justify = "left"
    for row in rows:
        table.add_row(*(shown(row.get(name, "")) for name in heads))
    console.print(Padding(table, (1, 0, 1, 2)))
