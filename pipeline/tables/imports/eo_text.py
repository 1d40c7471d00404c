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
from pipeline.tables.imports.stated import Stated, channel_of_rows, not_of_format, read_text
from pipeline.tables.text_columns import numbers, split_lines

_TITLES = re.compile(
    r"EVENT|TIME(?=\s*\(s\))|EASTING|NORTHING|(?:ELLIPSOID|ORTHOMETRIC)(?=\s+HEIGHT)|OMEGA|PHI"
    r"|KAPPA|LAT\b|LONG\b|\bID\b",
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
    titles = [name.upper() for name in _TITLES.findall(lines[at])]
    above = next((name for name in titles if name in ("ELLIPSOID", "ORTHOMETRIC")), "")
    if not above or "LAT" not in titles or "LONG" not in titles:
        raise not_of_format(
            path, f"its columns are {', '.join(titles)}: positions in a grid alone are not read",
            "export it with latitude, longitude (LAT, LONG) and height",
        )  # fmt: skip
    if not re.search(r"lat\W+long\w* in deg", "\n".join(lines[:at]), re.IGNORECASE):
        raise not_of_format(path, "its header does not say 'lat, long in Deg'",
                            "export latitude and longitude in degrees")  # fmt: skip
    rows = [line for line in lines[at + 1 :] if re.match(r"\s*\S+\s+\S*[0-9]", line)]
    table = split_lines(rows, titles, r"\s+")
    value = {name: numbers(table[name]) for name in titles}
    needed = np.stack([value[name] for name in ("TIME", "LAT", "LONG", above)])
    readable = np.asarray(np.isfinite(needed).all(axis=0))
    count = np.arange(1.0, len(rows) + 1.0)
    event = value.get("EVENT", count)
    surface = "ellipsoid" if above == "ELLIPSOID" else "msl"
    columns = {
        "event_index": np.where(np.isfinite(event), event, count),
        "lat_rad": np.radians(value["LAT"]),
        "lon_rad": np.radians(value["LONG"]),
        stated.height_column(path, ledger, surface): value[above],
    }
    time_ns = stated.utc_of_week_seconds(path, value["TIME"], stated.system_of(path, ledger))
    if "OMEGA" in titles:
        ledger.note("IMPORT-EO-ANGLES", "omega, phi and kappa count in the grid of the export: "
                    "attitudes are taken from elsewhere", where=path.name)  # fmt: skip
    labels = {"name": tuple(table["ID"])} if "ID" in titles else None
    return channel_of_rows(path, "EO", time_ns, columns, ledger, readable=readable, labels=labels)
