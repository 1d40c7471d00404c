"""Stations for other programs: tables of omega, phi, kappa; maps as GeoJSON (RFC 7946) and KML 2.2.

M = Rx(omega) Ry(phi) Rz(kappa) turns from the camera of photogrammetry (x right, y up, z backward)
to each station's own horizon, or to one frame; see `unbend.flight.rotations`. The vertical turns
324 arcsec in 10 km: angles of the two formats differ by that.
"""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa

from unbend.flight.rotations import opk_of_quaternion
from unbend.flight.stations import station_columns
from unbend.messages import Ledger
from unbend.tables.exports.footprints import footprints, placed_stations, stations_in_one_frame
from unbend.tables.exports.format import ExportFormat, FinishedRun, Values, write_csv_stream
from unbend.tables.schemas import schema_of
from unbend.tables.writing import table_of
from unbend.units import Mask

_PLACES = ("lat_deg", "lon_deg", "h_ellipsoid_m")
_ANGLES = ("omega_deg", "phi_deg", "kappa_deg")
_AXES = ("x_m", "y_m", "z_m")
_WORDS = ("image", "camera", "status", "time_utc")
_SIGMAS = ("sigma_horizontal_m", "sigma_height_m", "sigma_tilt_deg", "sigma_yaw_deg")
_PROPERTIES = (
    "image", "camera", "h_msl_m", "h_ellipsoid_m", "sigma_horizontal_m", "sigma_height_m",
    "suspect_reason", "suspect_m", "status",
)  # fmt: skip


def _write(topocentric: bool, run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A row for each usable station with a height above the ellipsoid."""
    stations, columns = run.stations, station_columns(run.stations)
    known = stations.ok & np.isfinite([*stations.quaternion.T, *map(columns.get, _PLACES)]).all(0)
    rows = placed_stations(run, known, "usable position, attitude and ellipsoidal height", ledger)
    attitude = stations.quaternion[rows]
    found: dict[str, object] = {n: columns[n][rows] for n in (*_WORDS, *_PLACES, *_SIGMAS)}
    if topocentric and rows.size:
        frame = stations_in_one_frame(run, rows)
        attitude = frame.quaternion
        found |= dict(zip(_AXES, frame.position_m.T, strict=True))
        origin = zip(_PLACES, frame.origin_deg, strict=True)
        found |= {f"origin_{name}": np.full(rows.size, value) for name, value in origin}
    angles = np.degrees(opk_of_quaternion(attitude))
    found |= dict(zip(_ANGLES, angles.T, strict=True))
    names = [*_WORDS, *_PLACES, *_ANGLES, *_SIGMAS]
    if topocentric:
        names += [*_AXES, *(f"origin_{name}" for name in _PLACES)]
    texts = dict.fromkeys(_WORDS, pa.string()) | {"time_utc": pa.timestamp("ns", "UTC")}
    kinds = {name: (texts.get(name, pa.float64()), "", "") for name in names}
    schema = schema_of(kinds, run.metadata)
    return write_csv_stream(path, schema, [table_of(found, schema)])


def _rings(
    run: FinishedRun, known: Mask, what: str, ledger: Ledger
) -> Iterator[tuple[int, list[list[float]]]]:
    """The stations that are known, and the closed footprint of each, empty where it has none."""
    corners = footprints(run, ledger)
    for row in placed_stations(run, known, what, ledger).tolist():
        whole = bool(np.isfinite(corners[row]).all())
        yield row, [*corners[row].tolist(), corners[row, 0].tolist()] if whole else []


def write_kml(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A placemark for each station with a place and one for each footprint, in two folders."""
    columns, stations, grounds = station_columns(run.stations), list[str](), list[str]()
    known = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["h_msl_m"])
    for row, ring in _rings(run, known, "position above sea level", ledger):
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
        if ring:
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


def write_geojson(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A point for each station with a position, and a polygon for each footprint."""
    columns, features = station_columns(run.stations), list[dict[str, Any]]()
    for row, ring in _rings(run, np.isfinite(columns["lat_deg"]), "position", ledger):
        values = {name: columns[name][row] for name in _PROPERTIES}
        properties = {n: None if v != v else v for n, v in values.items()}
        time = columns["time_utc"][row]
        properties["time_utc"] = None if np.isnat(time) else f"{time}Z"
        place = [columns[name][row] for name in ("lon_deg", "lat_deg", "h_ellipsoid_m")]
        point = {"type": "Point", "coordinates": place if place[2] == place[2] else place[:2]}
        features.append(_feature(point, properties | {"kind": "station"}))
        if ring:
            polygon = {"type": "Polygon", "coordinates": [ring]}
            named = {"image": values["image"], "camera": values["camera"], "kind": "footprint"}
            features.append(_feature(polygon, named | {"h_g_m": float(run.ground_m[row])}))
    collection = {"type": "FeatureCollection", "features": features}
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
    return len(features)


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


_USE = (
    "neither earth curvature nor a map projection is in these positions and angles: adjust in a "
    "Cartesian frame, with the program's own corrections of refraction and earth curvature off"
)

FORMATS = (
    ExportFormat("opk", "omega, phi, kappa against each station's east, north, up", ".csv",
                 partial(_write, False), use=_USE),
    ExportFormat("opk-enu", "omega, phi, kappa and x, y, z in one frame: east, north, up", ".csv",
                 partial(_write, True), use=_USE),
    ExportFormat("geojson", "stations and footprints", ".geojson", write_geojson),
    ExportFormat("kml", "stations and footprints", ".kml", write_kml),
)  # fmt: skip
