"""Stations and footprints as KML 2.2: heights above sea level, footprints on the ground."""

from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from pipeline.flight.stations import station_columns
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import footprints, placed_stations
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values


def _write(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A placemark for each station with a place and one for each footprint, in two folders."""
    columns = station_columns(run.stations)
    corners, stations, grounds = footprints(run, ledger), [], []
    known = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["h_msl_m"])
    for row in placed_stations(run, known, "position above sea level", ledger):
        lon, lat, h = (float(columns[name][row]) for name in ("lon_deg", "lat_deg", "h_msl_m"))
        words = [columns[name][row] for name in ("camera", "status", "suspect_reason")]
        mark = _text("name", columns["image"][row])
        text = mark + _text("description", ", ".join(word for word in words if word))
        if not np.isnat(columns["time_utc"][row]):
            when = np.datetime_as_string(columns["time_utc"][row], unit="ms")
            text += f"<TimeStamp><when>{when}Z</when></TimeStamp>"
        # Absolute is above sea level, by definition of KML.
        text += "<Point><altitudeMode>absolute</altitudeMode>"
        text += _text("coordinates", f"{lon!r},{lat!r},{h!r}") + "</Point>"
        stations.append(text)
        if np.isfinite(corners[row]).all():
            ring = [*corners[row].tolist(), corners[row, 0].tolist()]
            places = _text("coordinates", " ".join(f"{x!r},{y!r}" for x, y in ring))
            grounds.append(f"{mark}<Polygon><outerBoundaryIs><LinearRing>{places}</LinearRing>"
                           "</outerBoundaryIs></Polygon>")  # fmt: skip
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>' + _text("name", run.mission),
    ]
    for name, marks in (("stations", stations), ("footprints", grounds)):
        placemarks = [f"<Placemark>{mark}</Placemark>" for mark in marks]
        lines += [f"<Folder><name>{name}</name>", *placemarks, "</Folder>"]
    path.write_text("\n".join([*lines, "</Document></kml>\n"]), encoding="utf-8")
    return len(stations) + len(grounds)


def _text(tag: str, text: str) -> str:
    """An element with a text; XML has no control characters, not even escaped."""
    clean = "".join(c if c >= " " or c in "\t\n" else "\ufffd" for c in text)
    return f"<{tag}>{escape(clean)}</{tag}>"


FORMATS = (ExportFormat("kml", "stations and footprints", ".kml", _write),)
