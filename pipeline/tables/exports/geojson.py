"""Stations and footprints as GeoJSON (RFC 7946), heights above the ellipsoid."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.flight.stations import station_columns
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import footprints, placed_stations
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values

_PROPERTIES = (
    "image", "camera", "h_msl_m", "h_ellipsoid_m", "sigma_horizontal_m", "sigma_height_m",
    "suspect_reason", "suspect_m", "status",
)  # fmt: skip


def _write(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
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


FORMATS = (ExportFormat("geojson", "stations and footprints", ".geojson", _write),)
