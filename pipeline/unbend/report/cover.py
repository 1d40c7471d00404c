"""The first lines of a report: client, operator, time of the flight, and coordinate systems."""

from collections.abc import Mapping
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

from unbend.report.figure_data import Flown
from unbend.tables.manifest.whole import Manifest

PROCESSED = "<!-- processed -->"
"""Placeholder in the page of a run, for which `unbend report` inserts the time of processing."""


def title_of(manifest: Manifest) -> str:
    """The title of the report: that of the mission file, else the name of the mission."""
    return manifest.sections.mission.title or manifest.run.mission


def cover_rows(manifest: Manifest, flown: Flown) -> Mapping[str, str]:
    """Label -> text of the first lines; lines without a text are left out."""
    section = manifest.sections.mission
    rows = {
        "Client": section.client,
        "Operator": section.operator,
        "Mission": manifest.run.mission if section.title else None,
        "Flown": flown_on(manifest),
        "Coordinates": coordinate_systems(flown),
    }
    return {name: text for name, text in rows.items() if text}


def flown_on(manifest: Manifest) -> str:
    """The day and the times of the first and last exposure, in the stated time zone and in UTC.

    If they are unknown, the stated date.
    """
    flight = manifest.results.flight
    if not flight.begin_utc or not flight.end_utc:
        date = stated_date(manifest)
        return "unknown: the exposures have no UTC" if date is None else f"{date} (stated)"
    begin = datetime.fromisoformat(flight.begin_utc)
    end = datetime.fromisoformat(flight.end_utc)
    zone = manifest.sections.mission.time_zone
    in_utc = f"{span(begin, end)} UTC"
    if zone is None or zone == "UTC":
        return in_utc
    local = ZoneInfo(zone)
    return f"{span(begin.astimezone(local), end.astimezone(local))} {zone} ({in_utc})"


def stated_date(manifest: Manifest) -> str | None:
    """The date in the mission file: that of the orientations, else of the mission, or None."""
    orientation = manifest.sections.stations.orientation or {}
    return orientation.get("date") or manifest.sections.mission.date


def span(begin: datetime, end: datetime) -> str:
    """The begin and end of a flight as a text; the day only once if it is the same.

    >>> span(datetime(2025, 6, 12, 23, 50), datetime(2025, 6, 13, 0, 10))
    '2025-06-12, 23:50:00 to 2025-06-13, 00:10:00'
    """
    first = begin.strftime("%Y-%m-%d, %H:%M:%S")
    last = end.strftime("%H:%M:%S" if begin.date() == end.date() else "%Y-%m-%d, %H:%M:%S")
    return f"{first} to {last}"


def coordinate_systems(flown: Flown) -> str:
    """The coordinate systems of the results and of the map, as a text."""
    text = "WGS 84 (EPSG:4979); heights above mean sea level and above the ellipsoid"
    if flown.grid is not None:
        text += f"; map grid {flown.grid.name.removeprefix('WGS 84 / ')} ({flown.grid.identifier})"
    return text


def paragraphs(text: str | None) -> list[str]:
    """The paragraphs of a free text, which are separated by empty lines; each in one line.

    >>> paragraphs("First flight.\\n\\nThe second\\nwas better.")
    ['First flight.', 'The second was better.']
    """
    parts: list[str] = []
    for block in (text or "").replace("\r\n", "\n").split("\n\n"):
        words = " ".join(block.split())
        if words:
            parts.append(words)
    return parts


def time_of_processing(time_s: float, zone: str | None) -> str:
    """A time [Unix s] as a text to the minute, in a time zone; None: UTC.

    >>> time_of_processing(0.0, None), time_of_processing(0.0, "Europe/Zurich")
    ('1970-01-01 00:00 UTC', '1970-01-01 01:00 Europe/Zurich')
    """
    time = datetime.fromtimestamp(time_s, UTC)
    if zone is not None:
        time = time.astimezone(ZoneInfo(zone))
    return f"{time:%Y-%m-%d %H:%M} {zone or 'UTC'}"


def css_text(text: str) -> str:
    """A text as a string literal of CSS within HTML; all characters that could end it are escaped.

    >>> print(css_text('A "B" </style> é'))
    "A \\22 B\\22  \\3c /style\\3e  é"
    """
    escaped = ""
    for character in text:
        is_plain = character.isalnum() or character in " .,;:-_()/+"
        escaped += character if is_plain else f"\\{ord(character):x} "
    return f'"{escaped}"'
