"""What `unbend inspect` prints of a log: flight, clocks, roles, channels, fields of a message."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table

from unbend.messages import MessageRecord
from unbend.report.console import plain_table, print_indented, print_labelled, print_rows, shown
from unbend.report.terminal import print_ledger
from unbend.report.words import count

ANY_VEHICLE = ""  # of a log with one vehicle, which has no name


def print_log(console: Console, log: Mapping[str, Any], name: str) -> None:
    """What ``unbend inspect`` prints: flight, roles, and channels by the names of mission files."""
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
    vehicles = log["vehicles"] or [{"vehicle": ANY_VEHICLE, "roles": log["roles"]}]
    for vehicle in vehicles:
        console.print()
        if vehicle["vehicle"] != ANY_VEHICLE:
            console.print(f"  [bold]{shown(vehicle['vehicle'])}[/bold], one of several vehicles")
        print_roles(console, vehicle["roles"])
    print_receivers(console, log["receivers"])
    console.print()
    print_indented(console, channel_table(log["channels"]))
    console.print()
    print_ledger(console, [MessageRecord(**entry) for entry in log["ledger"]])


def place_of(flight: Mapping[str, Any]) -> str:
    """Where a flight was, to 100 m."""
    if not flight:
        return "unknown"
    return f"{flight['lat_deg']:.3f}°, {flight['lon_deg']:.3f}°"


def times_of(log: Mapping[str, Any]) -> str:
    """When a log begins and ends; the date of the end only where it is another one."""
    if not log["start_utc"]:
        return "counts from boot; UTC is unknown"
    begin = log["start_utc"][:19].replace("T", " ")
    end = (log["end_utc"] or "")[:19].replace("T", " ")
    if end[:10] == begin[:10]:
        end = end[11:]
    return f"{begin} to {end} UTC"


def heights_of(flight: Mapping[str, Any]) -> str:
    """The range of heights of a flight, and what they refer to."""
    reference = flight.get("height_reference")
    if not reference or flight["lowest_m"] is None:
        return "unknown"
    return f"{flight['lowest_m']:.0f} to {flight['highest_m']:.0f} m above {reference}"


def take_off_of(flight: Mapping[str, Any]) -> str:
    """The height of the take-off, and what it comes from."""
    if not flight:
        return "unknown"
    if flight.get("take_off_m") is None:
        return "unknown: the aircraft is not at rest when the log begins"
    surface = flight.get("take_off_reference", flight.get("height_reference"))
    return f"{flight['take_off_m']:.0f} m above {surface}, {take_off_by(flight)}"


def take_off_by(flight: Mapping[str, Any]) -> str:
    """What the height of the take-off comes from, in words."""
    if flight.get("take_off_by") == "home of the autopilot":
        return "by the autopilot's heights above its home"
    return "where the log begins"


def messages_of(log: Mapping[str, Any]) -> str:
    """How many messages of how many types a log has, and what is damaged or lost."""
    total = sum(log["messages"].values())
    types = count(len(log["messages"]), "type")
    bad_bytes = count(log["bad_bytes"], "bad byte")
    text = f"{total:,} of {types}, {bad_bytes}, {log['lost_messages']:,} lost"
    if log["boots"] > 1:
        text += f", {log['boots']} boots"
    return text


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


def channel_table(channels: Sequence[Mapping[str, Any]]) -> Table:
    """Samples, rate and gaps of each channel."""
    table = plain_table(("channel", "samples", "rate [Hz]", "gaps", "gaps [s]"), gap=2)
    # Names are copied into mission files: in one piece, and never cut.
    table.columns[0].overflow = "fold"
    for channel in channels:
        gaps_s = [gap["seconds"] for gap in channel["gaps"]]
        number = ""
        together = ""
        if gaps_s:
            number = str(len(gaps_s))
            together = f"{sum(gaps_s):.1f}"
        samples = f"{channel['samples']:,}"
        rate = f"{channel['rate_hz']:.3g}"
        table.add_row(shown(channel["name"]), samples, rate, number, together)
    return table


def print_fields(console: Console, title: str, rows: Sequence[Mapping[str, str]]) -> None:
    """The fields of a message: type, first value, and the range of its numbers."""
    console.print(f"[bold]{shown(title)}[/bold]")
    heads = ("field", "type", "first", "lowest", "highest")
    table = plain_table(heads, gap=2)
    table.columns[1].justify = "left"
    table.columns[2].justify = "left"
    for row in rows:
        table.add_row(*(shown(row.get(name, "")) for name in heads))
    console.print(Padding(table, (1, 0, 1, 2)))
