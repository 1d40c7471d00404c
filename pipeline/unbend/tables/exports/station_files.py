"""Stations for other programs: tables of omega, phi, kappa; maps as GeoJSON (RFC 7946) and KML 2.2.

M = Rx(omega) Ry(phi) Rz(kappa) turns from the camera of photogrammetry (x right, y up, z backward)
to the horizon of each station, to one frame, or to the axes of a map's grid at each station; see
`unbend.flight.rotations`. Angles to the horizons and to one frame differ, because the vertical
turns 324 arcsec in 10 km. Angles to a grid differ from those to the horizon by the convergence.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa

from unbend.flight.rotations import opk_of_quaternion
from unbend.flight.stations import station_columns
from unbend.messages import Ledger
from unbend.tables.exports.export_format import (
    ExportFormat,
    FinishedRun,
    GridUse,
    Values,
    write_csv_stream,
)
from unbend.tables.exports.export_frames import (
    EAST_NORTH_UP,
    ELLIPSOID_OF_WGS84,
    LATITUDE_LONGITUDE_HEIGHT,
    SEA_LEVEL_OF_RUN,
    ExportFrame,
    angles_of_photogrammetry,
    block_positions,
    can_be_placed,
    geographic_frame,
    grid_frame,
    scale_of_grid,
)
from unbend.tables.exports.footprints import footprints, placed_stations, stations_in_one_frame
from unbend.tables.exports.stations_in_grid import grid_angles, grid_columns, stations_in_grid
from unbend.tables.geodata.map_grids import check_grid_axes
from unbend.tables.writing import table_of
from unbend.tables.written_columns import schema_of
from unbend.units import Array, Integers, Mask

_PLACES = ("lat_deg", "lon_deg", "h_ellipsoid_m")
_ANGLES = ("omega_deg", "phi_deg", "kappa_deg")
_AXES = ("x_m", "y_m", "z_m")
_WORDS = ("image", "camera", "status", "time_utc")
_SIGMAS = ("sigma_horizontal_m", "sigma_height_m", "sigma_tilt_deg", "sigma_yaw_deg")
_PROPERTIES = (
    "image",
    "camera",
    "h_msl_m",
    "h_ellipsoid_m",
    "sigma_horizontal_m",
    "sigma_height_m",
    "suspect_reason",
    "suspect_m",
    "status",
)


def write_at_stations(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write angles against the horizon of each station, or against the grid of the export, as CSV.

    Returns the number of rows.
    """
    rows = placed_rows(run, ledger)
    columns_written = columns_of_stations(run, rows)
    attitude = run.stations.quaternion[rows]
    names = [*_WORDS, *_PLACES, *_ANGLES, *_SIGMAS]
    if run.grid is not None:
        in_grid = stations_in_grid(run.stations, rows, run.grid)
        ledger.extend(
            check_grid_axes(in_grid.axes, crs=run.grid.identifier or "--crs", name=run.grid.name)
        )
        attitude = in_grid.quaternion
        columns_in_grid = grid_columns(run.grid, in_grid)
        columns_written |= columns_in_grid
        names += columns_in_grid
    columns_written |= angle_columns(attitude)
    return write_station_table(run, path, columns_written, names)


def write_in_one_frame(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write positions and angles in one frame, east, north, up at the block's middle, as CSV.

    Returns the number of rows.
    """
    rows = placed_rows(run, ledger)
    columns_written = columns_of_stations(run, rows)
    attitude = run.stations.quaternion[rows]
    if rows.size:
        frame = stations_in_one_frame(run, rows)
        attitude = frame.quaternion
        columns_written |= dict(zip(_AXES, frame.position_m.T, strict=True))
        for name, value in zip(_PLACES, frame.origin_deg, strict=True):
            columns_written[f"origin_{name}"] = np.full(rows.size, value)
    columns_written |= angle_columns(attitude)
    names = [*_WORDS, *_PLACES, *_ANGLES, *_SIGMAS, *_AXES]
    names += [f"origin_{name}" for name in _PLACES]
    return write_station_table(run, path, columns_written, names)


def placed_rows(run: FinishedRun, ledger: Ledger) -> Integers:
    """(n,) the rows of the stations that `has_orientation` is true for; the others are a loss."""
    lacking = "usable position, attitude and ellipsoidal height"
    if run.grid is not None:
        lacking = f"{lacking} within the transformation to {run.grid.name}"
    return placed_stations(run, has_orientation(run), lacking, ledger)


def has_orientation(run: FinishedRun) -> Mask:
    """(s,) which stations have position, height and attitude, and coordinates in a given grid."""
    stations = run.stations
    has_all = can_be_placed(stations)
    if run.grid is not None:
        x, y = run.grid.coordinates(stations.lat_rad, stations.lon_rad)
        has_all &= np.isfinite(x) & np.isfinite(y)
    return has_all


def columns_of_stations(run: FinishedRun, rows: Integers) -> dict[str, object]:
    """Names, times, positions and sigmas of the stations of some rows."""
    columns = station_columns(run.stations)
    return {name: columns[name][rows] for name in (*_WORDS, *_PLACES, *_SIGMAS)}


def angle_columns(quaternion: Array) -> dict[str, object]:
    """Columns of omega, phi, kappa [deg] of attitudes (n, 4)."""
    angles = np.degrees(opk_of_quaternion(quaternion))
    return dict(zip(_ANGLES, angles.T, strict=True))


def write_station_table(
    run: FinishedRun, path: Path, columns: Mapping[str, object], names: Sequence[str]
) -> int:
    """Write ``columns`` as CSV, in the order of ``names``; returns the number of rows."""
    types = dict.fromkeys(names, pa.float64())
    types |= dict.fromkeys(_WORDS, pa.string())
    types["time_utc"] = pa.timestamp("ns", "UTC")
    columns_of_schema = {name: (types[name], "", "") for name in names}
    schema = schema_of(columns_of_schema, run.metadata)
    return write_csv_stream(path, schema, [table_of(columns, schema)])


def frame_at_stations(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of `write_at_stations`."""
    if run.grid is None:
        return ExportFrame(
            positions=geographic_frame(ELLIPSOID_OF_WGS84, LATITUDE_LONGITUDE_HEIGHT),
            angles=angles_of_photogrammetry(EAST_NORTH_UP, "each station"),
        )
    rows = np.flatnonzero(has_orientation(run))
    axes = run.grid.axes_at(run.stations.lat_rad[rows], run.stations.lon_rad[rows])
    return ExportFrame(
        positions=grid_frame(run.grid),
        angles=grid_angles(run.grid, axes),
        scale=scale_of_grid(axes),
    )


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of `write_in_one_frame`."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_photogrammetry(EAST_NORTH_UP, "origin"),
    )


def frame_of_geojson(_run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of GeoJSON: stations on WGS 84, with heights above its ellipsoid.

    The ground heights of footprints are those of the run, above sea level.
    """
    return ExportFrame(
        positions=geographic_frame(ELLIPSOID_OF_WGS84), ground_heights=SEA_LEVEL_OF_RUN
    )


def frame_of_kml(_run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of KML, which defines it: positions on WGS 84, heights above sea level."""
    return ExportFrame(positions=geographic_frame(SEA_LEVEL_OF_RUN))


Ring = list[list[float]]
"""Longitude and latitude [deg] of a footprint's corners, the first one again at its end."""


def _rings(
    run: FinishedRun,
    is_placed: Mask,
    lacking: str,
    ledger: Ledger,
) -> Iterator[tuple[int, Ring]]:
    """The rows of the placed stations, each with its footprint, empty without one.

    ``is_placed`` (s,) : which stations have a position. The others are added as a loss, with
    ``lacking``, what they do not have. So are missing footprints.
    """
    corners = footprints(run, ledger)
    for row in placed_stations(run, is_placed, lacking, ledger).tolist():
        ring: Ring = []
        if np.isfinite(corners[row]).all():
            ring = corners[row].tolist()
            ring.append(ring[0])
        yield row, ring


def write_kml(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write a KML with a placemark for each station with a position and for each footprint.

    Returns the number of placemarks.
    """
    columns = station_columns(run.stations)
    is_placed = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["h_msl_m"])
    station_marks = []
    footprint_marks = []
    for row, ring in _rings(run, is_placed, "position above sea level", ledger):
        station_marks.append(_kml_station(columns, row))
        if ring:
            footprint_marks.append(_kml_footprint(columns["image"][row], ring))
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>' + _text("name", run.mission),
        *_kml_folder("stations", station_marks),
        *_kml_folder("footprints", footprint_marks),
        "</Document></kml>\n",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return len(station_marks) + len(footprint_marks)


def _kml_folder(name: str, marks: Sequence[str]) -> list[str]:
    """The lines of a folder of placemarks; ``marks`` are their contents."""
    placemarks = [f"<Placemark>{mark}</Placemark>" for mark in marks]
    return [f"<Folder><name>{name}</name>", *placemarks, "</Folder>"]


def _kml_station(columns: Mapping[str, Any], row: int) -> str:
    """The content of a station's placemark: name, description, time, position above sea level.

    ``columns`` are those of `station_columns`.
    """
    lon, lat, h = (float(columns[name][row]) for name in ("lon_deg", "lat_deg", "h_msl_m"))
    descriptions = [columns[name][row] for name in ("camera", "status", "suspect_reason")]
    text = _text("name", columns["image"][row])
    text += _text("description", ", ".join(part for part in descriptions if part))
    time = columns["time_utc"][row]
    if not np.isnat(time):
        when = np.datetime_as_string(time, unit="ms")
        text += f"<TimeStamp><when>{when}Z</when></TimeStamp>"
    # Absolute is above sea level, by definition of KML.
    text += "<Point><altitudeMode>absolute</altitudeMode>"
    return text + _text("coordinates", f"{lon!r},{lat!r},{h!r}") + "</Point>"


def _kml_footprint(image: str, ring: Ring) -> str:
    """The content of a footprint's placemark."""
    coordinates = " ".join(f"{lon!r},{lat!r}" for lon, lat in ring)
    boundary = f"<LinearRing>{_text('coordinates', coordinates)}</LinearRing>"
    polygon = f"<Polygon><outerBoundaryIs>{boundary}</outerBoundaryIs></Polygon>"
    return _text("name", image) + polygon


def _text(tag: str, text: str) -> str:
    """An XML element with a text; control characters, which XML forbids, become U+FFFD."""
    clean = "".join(c if c >= " " or c in "\t\n" else "\ufffd" for c in text)
    return f"<{tag}>{escape(clean)}</{tag}>"


def write_geojson(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write a GeoJSON with a point for each placed station and a polygon for each footprint.

    Returns the number of features.
    """
    columns = station_columns(run.stations)
    is_placed = np.isfinite(columns["lat_deg"])
    features = []
    for row, ring in _rings(run, is_placed, "position", ledger):
        features.append(_geojson_station(columns, row))
        if ring:
            polygon = {"type": "Polygon", "coordinates": [ring]}
            properties = {
                "image": columns["image"][row],
                "camera": columns["camera"][row],
                "kind": "footprint",
                "h_g_m": float(run.ground_m[row]),
            }
            features.append(_feature(polygon, properties))
    collection = {"type": "FeatureCollection", "features": features}
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
    return len(features)


def _geojson_station(columns: Mapping[str, Any], row: int) -> dict[str, Any]:
    """The feature of a station: a point, without height if that is unknown, and properties.

    Unknown properties are null. ``columns`` are those of `station_columns`.
    """
    properties = {}
    for name in _PROPERTIES:
        value = columns[name][row]
        is_unknown = value != value  # NaN
        properties[name] = None if is_unknown else value
    time = columns["time_utc"][row]
    properties["time_utc"] = None if np.isnat(time) else f"{time}Z"
    properties["kind"] = "station"
    position = [columns["lon_deg"][row], columns["lat_deg"][row]]
    height = columns["h_ellipsoid_m"][row]
    if not np.isnan(height):
        position.append(height)
    return _feature({"type": "Point", "coordinates": position}, properties)


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


_USE = (
    "these positions and angles contain neither earth curvature nor a map projection: adjust in a "
    "Cartesian frame, and switch off the program's own corrections of refraction and earth "
    "curvature"
)

_USE_IN_GRID = (
    "positions are in a map projection; angles are relative to its axes and to the vertical of "
    "each station: keep the program's corrections of earth curvature and of the scale of the "
    "projection on, and switch off its correction of refraction"
)

FORMATS = (
    ExportFormat(
        "opk",
        "omega, phi, kappa relative to east, north, up at each station, or to a grid (--crs)",
        ".csv",
        write_at_stations,
        frame_at_stations,
        use=_USE,
        grid=GridUse(needs_angles=True, use=_USE_IN_GRID),
    ),
    ExportFormat(
        "opk-enu",
        "omega, phi, kappa and x, y, z in one frame: east, north, up",
        ".csv",
        write_in_one_frame,
        frame_of_block,
        use=_USE,
    ),
    ExportFormat("geojson", "stations and footprints", ".geojson", write_geojson, frame_of_geojson),
    ExportFormat("kml", "stations and footprints", ".kml", write_kml, frame_of_kml),
)
