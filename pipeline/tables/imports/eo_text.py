"""POSPac's exterior orientation as text: one line an event, after a header.

The header names the columns, among them ``TIME (s)``, ``ELLIPSOID HEIGHT`` or ``ORTHOMETRIC
HEIGHT``, ``LAT`` and ``LONG``; the line of units says ``lat, long in Deg``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import (
    Stated,
    channel_of_rows,
    height_column,
    not_of_format,
    number,
    read_text,
    time_system,
    utc_of_week_seconds,
)

_TITLES = re.compile(
    r"#?\s*EVENT|TIME\s*\(s\)|EASTING|NORTHING|(?:ELLIPSOID|ORTHOMETRIC)\s+HEIGHT|OMEGA|PHI|KAPPA"
    r"|LAT\b|LONG\b|\bID\b",
    re.IGNORECASE,
)


def read_eo_text(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Events with the position of the camera; labels ``name`` from the column ID where it has one.

    Omega, phi and kappa count in the grid of the export and are not read here. Seconds are those
    of the GPS week, or of UTC, as stated: the file does not say.
    """
    lines = read_text(path)
    at = next((k for k, line in enumerate(lines) if re.search(r"TIME\s*\(s\)", line)), None)
    if at is None:
        raise not_of_format(path, "no line names the columns: '# EVENT  TIME (s)  EASTING ...'")
    titles = [re.sub(r"[#\s]+", " ", name).strip().upper()
              for name in _TITLES.findall(lines[at])]  # fmt: skip
    if "LAT" not in titles or "LONG" not in titles:
        raise not_of_format(
            path,
            f"its columns are {', '.join(titles)}: positions in a grid alone are not read",
            "export it with latitude and longitude (LAT, LONG)",
        )
    if not re.search(r"lat\W+long\w* in deg", "\n".join(lines[:at]), re.IGNORECASE):
        raise not_of_format(path, "its header does not say 'lat, long in Deg'",
                            "export latitude and longitude in degrees")  # fmt: skip
    rows = [line.split() for line in lines[at + 1 :] if re.match(r"\s*\S+\s+\S*[0-9]", line)]
    table = [(row + [""] * len(titles))[: len(titles)] for row in rows]
    names = [row[titles.index("ID")] for row in table] if "ID" in titles else []
    value = {name: np.array([number(row[k]) for row in table]) for k, name in enumerate(titles)}
    height = next(name for name in titles if name.endswith("HEIGHT"))
    above = "ellipsoid" if height.startswith("ELLIPSOID") else "msl"
    seconds = next(name for name in titles if name.startswith("TIME"))
    readable = np.isfinite(np.stack([value[n] for n in (seconds, "LAT", "LONG", height)])).all(0)
    count = np.arange(1.0, len(rows) + 1.0)
    event = value.get("EVENT", count)
    columns = {
        "event_index": np.where(np.isfinite(event), event, count),
        "lat_rad": np.radians(value["LAT"]),
        "lon_rad": np.radians(value["LONG"]),
        height_column(path, stated, above): value[height],
    }
    time_ns = utc_of_week_seconds(path, value[seconds], stated, time_system(path, stated))
    if "OMEGA" in titles:
        ledger.note("IMPORT-EO-ANGLES", "omega, phi and kappa count in the grid of the export: "
                    "attitudes are taken from elsewhere", where=path.name)  # fmt: skip
    labels = {"name": tuple(names)} if names else None
    return channel_of_rows(path, "EO", time_ns, columns, ledger, readable=readable, labels=labels)
