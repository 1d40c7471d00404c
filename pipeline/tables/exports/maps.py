"""Stations and footprints for maps: GeoJSON (RFC 7946), and KML 2.2 above sea level."""

import json
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from pipeline.flight.stations import station_columns
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import footprints, placed_stations
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values


def write_kml(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
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


_PROPERTIES = (
    "image", "camera", "h_msl_m", "h_ellipsoid_m", "sigma_horizontal_m", "sigma_height_m",
    "suspect_reason", "suspect_m", "status",
)  # fmt: skip


def write_geojson(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A point for each station with a position, and a polygon for each footprint."""
    columns = station_columns(run.stations)
    corners = footprints(run, ledger)
    features: list[dict[str, Any]] = []
    known = np.isfinite(columns["lat_deg"])
    for row in placed_stations(run, known, "position", ledger):
        values = {name: columns[name][row] for name in _PROPERTIES}
        properties = {n: None if v != v else v for n, v in values.items()}
        time = columns["time_utc"][row]
        properties["time_utc"] = None if np.isnat(time) else f"{time}Z"
        place = [columns[name][row] for name in ("lon_deg", "lat_deg", "h_ellipsoid_m")]
        point = {"type": "Point", "coordinates": place if place[2] == place[2] else place[:2]}
        features.append(_feature(point, properties | {"kind": "station"}))
        if np.isfinite(corners[row]).all():
            ring = [*corners[row].tolist(), corners[row, 0].tolist()]
            polygon = {"type": "Polygon", "coordinates": [ring]}
            named = {"image": values["image"], "camera": values["camera"], "kind": "footprint"}
            features.append(_feature(polygon, named | {"h_g_m": float(run.ground_m[row])}))
    collection = {"type": "FeatureCollection", "features": features}
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
    return len(features)


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


FORMATS = (
    ExportFormat("geojson", "stations and footprints", ".geojson", write_geojson),
    ExportFormat("kml", "stations and footprints", ".kml", write_kml),
)
