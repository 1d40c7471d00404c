"""GeoPackage: stations, footprints and points as layers, with styles for QGIS.

Source: OGC 12-128r18 (GeoPackage 1.3). A geometry is a header of eight bytes and WKB with x as
longitude or east, for any order of the axes in the coordinate system. The styles are in QGIS's
table ``layer_styles``: QGIS applies them when it opens the layers. Points show the shift as
enlarged arrows; one in twenty is longer than `LONGEST_ARROW_MM`.
"""

import sqlite3
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.stations import station_columns
from unbend.messages import Ledger
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, GridUse, Values
from unbend.tables.exports.export_frames import WGS84_2D
from unbend.tables.exports.footprints import footprints, placed_stations
from unbend.tables.exports.ground_points import (
    ATTRIBUTES,
    attributes_of,
    frame_of_points,
    ground_points,
)
from unbend.tables.geodata.map_grids import MapGrid
from unbend.tables.writing import points_wkb
from unbend.units import Array

LONGEST_ARROW_MM = 8.0
"""Length in QGIS that 95 % of the arrows do not exceed: longer ones hide their neighbours."""

_APPLICATION_ID = 0x47504B47  # "GPKG"
_VERSION = 10_300
_CUSTOM_SRS = 100_001  # of a system without a code of its own
_HEADER = struct.Struct("<2sBBi")  # magic, version, flags, number of the system
_LITTLE_ENDIAN = 1  # flags: no envelope

Row = tuple[object, ...]


@dataclass
class BoundingBox:
    """The smallest box around the coordinates that were included; ``low`` > ``high`` if none."""

    low: tuple[float, float] = (np.inf, np.inf)
    high: tuple[float, float] = (-np.inf, -np.inf)

    def include(self, x: Array, y: Array) -> None:
        """Enlarge the box so that it contains (n,) coordinates."""
        if x.size == 0:
            return
        self.low = min(self.low[0], float(x.min())), min(self.low[1], float(y.min()))
        self.high = max(self.high[0], float(x.max())), max(self.high[1], float(y.max()))


@dataclass(frozen=True)
class FeatureLayer:
    """A table of features.

    ``geometry`` : its type. ``columns`` : SQL types by name, without id and geometry. ``rows`` :
    geometry, then values of the columns. ``extent`` : complete when all rows have been read.
    """

    name: str
    geometry: str
    has_z: int  # as in GeoPackage: 0 prohibited, 1 mandatory, 2 optional
    about: str
    columns: Mapping[str, str]
    rows: Iterable[Row]
    extent: BoundingBox


def write_geopackage(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write the three layers and their styles; returns the number of features."""
    grid = run.required_grid
    number = srs_number(grid)
    shifts: list[Array] = []
    layers = (
        station_layer(run, grid, number, ledger),
        footprint_layer(run, grid, number, ledger),
        point_layer(run, grid, number, ledger, shifts),
    )
    count = 0
    with closing(sqlite3.connect(path)) as database, database:
        create_tables(database, grid, number)
        for layer in layers:
            count += add_layer(database, layer, number)
        add_styles(database, millimetres_a_metre(shifts))
    return count


def srs_number(grid: MapGrid) -> int:
    """The number of a coordinate system in the file: its EPSG code, or `_CUSTOM_SRS`."""
    code = grid.identifier.removeprefix("EPSG:")
    return int(code) if code.isdigit() else _CUSTOM_SRS


# ---------------------------------------------------------------------- layers


STATION_COLUMNS = {
    "image": "TEXT",
    "camera": "TEXT",
    "status": "TEXT",
    "suspect_reason": "TEXT",
    "time_utc": "DATETIME",
    "h_msl_m": "REAL",
    "h_ellipsoid_m": "REAL",
    "sigma_horizontal_m": "REAL",
    "sigma_height_m": "REAL",
}

FOOTPRINT_COLUMNS = {"image": "TEXT", "camera": "TEXT", "h_g_m": "REAL"}

POINT_COLUMNS = {
    "image": "TEXT",
    "point": "TEXT",
    "status": "TEXT",
    **dict.fromkeys(ATTRIBUTES, "REAL"),
}


def station_layer(run: FinishedRun, grid: MapGrid, number: int, ledger: Ledger) -> FeatureLayer:
    """The layer with a point for each station with a position, usable or not.

    ``number`` is that of the coordinate system. Other stations are a loss.
    """
    stations = run.stations
    x, y = grid.coordinates(stations.lat_rad, stations.lon_rad)
    rows = placed_stations(run, np.isfinite(x) & np.isfinite(y), "position", ledger)
    height = grid.height.heights(
        stations.lat_rad, stations.lon_rad, stations.h_msl_m, stations.h_ellipsoid_m
    )
    extent = BoundingBox()
    extent.include(x[rows], y[rows])
    columns = [geometries(points_wkb(x[rows], y[rows], height[rows]), number)]
    columns_of_all = station_columns(stations)
    for name in STATION_COLUMNS:
        values = np.asarray(columns_of_all[name])[rows]
        columns.append(times(values) if name == "time_utc" else plain(values))
    return FeatureLayer(
        "stations",
        "POINT",
        has_z=2,
        about="places of the exposures",
        columns=STATION_COLUMNS,
        rows=zip(*columns, strict=True),
        extent=extent,
    )


def footprint_layer(run: FinishedRun, grid: MapGrid, number: int, ledger: Ledger) -> FeatureLayer:
    """The layer with a polygon for each image with a footprint.

    ``number`` is that of the coordinate system. Usable images without a footprint are a loss.
    """
    corners_rad = np.radians(footprints(run, ledger))
    longitude_rad = corners_rad[:, :, 0].ravel()
    latitude_rad = corners_rad[:, :, 1].ravel()
    x, y = grid.coordinates(latitude_rad, longitude_rad)
    rings = np.stack([x, y], axis=1).reshape(-1, 4, 2)
    rows = np.flatnonzero(np.isfinite(rings).all(axis=(1, 2)))
    closed = np.concatenate([rings, rings[:, :1]], axis=1)[rows]
    extent = BoundingBox()
    extent.include(closed[:, :, 0].ravel(), closed[:, :, 1].ravel())
    columns = [
        geometries([polygon_wkb(ring) for ring in closed], number),
        plain(run.stations.image[rows]),
        plain(run.stations.camera[rows]),
        plain(run.ground_m[rows]),
    ]
    return FeatureLayer(
        "footprints",
        "POLYGON",
        has_z=0,
        about="footprints of the images on the ground, by straight lines through their corners",
        columns=FOOTPRINT_COLUMNS,
        rows=zip(*columns, strict=True),
        extent=extent,
    )


def point_layer(
    run: FinishedRun, grid: MapGrid, number: int, ledger: Ledger, shifts: list[Array]
) -> FeatureLayer:
    """The layer with a point for each observation on the ground.

    ``number`` is that of the coordinate system. While the rows are read, the lengths of the shifts
    [m] are appended to ``shifts``, an array (n,) for each part of the observations.
    """
    extent = BoundingBox()

    def rows() -> Iterator[Row]:
        for points in ground_points(run, grid, ledger):
            extent.include(points.x, points.y)
            shifts.append(points.shift_m[np.isfinite(points.shift_m)])
            columns = [geometries(points_wkb(points.x, points.y, points.height), number)]
            for text in (points.image, points.point, points.status):
                columns.append(text.to_pylist())
            for values in attributes_of(points).values():
                columns.append(plain(values))
            yield from zip(*columns, strict=True)

    return FeatureLayer(
        "points",
        "POINT",
        has_z=2,
        about=(
            "places where the corrected rays of observations reach the ground, with their shift "
            "there"
        ),
        columns=POINT_COLUMNS,
        rows=rows(),
        extent=extent,
    )


Column = list[object]
"""The values of a column as SQLite takes them."""


def plain(values: NDArray[Any]) -> Column:
    """Values as SQLite takes them; NaN becomes null."""
    return [None if value != value else value for value in values.tolist()]


def times(values: NDArray[np.datetime64]) -> Column:
    """Times in GeoPackage's text form, to the millisecond; NaT becomes null."""
    return [time_text(time) for time in values]


def time_text(time: np.datetime64) -> str | None:
    """A time in GeoPackage's text form, to the millisecond; None for NaT."""
    return None if np.isnat(time) else f"{np.datetime_as_string(time, unit='ms')}Z"


def geometries(shapes: Sequence[bytes | None], number: int) -> Column:
    """Geometries with GeoPackage's header, from WKB; ``number`` is that of the system."""
    header = _HEADER.pack(b"GP", 0, _LITTLE_ENDIAN, number)
    return [None if shape is None else header + shape for shape in shapes]


def polygon_wkb(ring: Array) -> bytes:
    """The WKB of a polygon of one closed ring (k, 2)."""
    coordinates = np.ascontiguousarray(ring, dtype="<f8").tobytes()
    # Little-endian, type polygon, one ring, points of the ring.
    return struct.pack("<BIII", 1, 3, 1, len(ring)) + coordinates


# ---------------------------------------------------------------------- tables of the file


def create_tables(database: sqlite3.Connection, grid: MapGrid, number: int) -> None:
    """Create the tables that each file has, with the coordinate system and its ``number``."""
    database.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
    database.execute(f"PRAGMA user_version = {_VERSION}")
    for statement in data_text("geopackage.sql").split(";\n"):
        database.execute(statement)
    authority = "EPSG" if number != _CUSTOM_SRS else "NONE"
    row = (grid.name, number, authority, number, grid.wkt1 or "undefined", grid.wkt)
    database.execute(
        "INSERT OR REPLACE INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization,"
        " organization_coordsys_id, definition, definition_12_063) VALUES (?, ?, ?, ?, ?, ?)",
        row,
    )


@cache
def data_text(name: str) -> str:
    """The text of a file of the package's data."""
    return files("unbend.tables").joinpath(f"data/{name}").read_text("utf-8").strip()


def add_layer(database: sqlite3.Connection, layer: FeatureLayer, srs_id: int) -> int:
    """Write a layer with coordinates in the system ``srs_id``; returns how many features it has."""
    types = "".join(f', "{name}" {kind}' for name, kind in layer.columns.items())
    database.execute(
        f'CREATE TABLE "{layer.name}" (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,'
        f" geom {layer.geometry}{types})"
    )
    names = "".join(f', "{name}"' for name in layer.columns)
    placeholders = ", ".join("?" * (1 + len(layer.columns)))
    insert = f'INSERT INTO "{layer.name}" (geom{names}) VALUES ({placeholders})'
    count = database.executemany(insert, layer.rows).rowcount
    low = layer.extent.low
    high = layer.extent.high
    is_empty = low[0] > high[0]
    box = (None, None, None, None) if is_empty else (*low, *high)
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, ?, ?, ?, ?, ?, ?, ?)",
        (layer.name, layer.name, layer.about, now_text(), *box, srs_id),
    )
    database.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, ?, 0)",
        (layer.name, layer.geometry, srs_id, layer.has_z),
    )
    return max(count, 0)  # it may be -1 without rows


def now_text() -> str:
    """The present time in GeoPackage's text form."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")


# ---------------------------------------------------------------------- styles


def millimetres_a_metre(shifts: Sequence[Array]) -> float:
    """The length of the arrow of a shift of 1 m [mm], so that 95 % are within `LONGEST_ARROW_MM`.

    ``shifts`` : arrays of lengths [m]. 1 mm if there are no shifts, or 95 % of them are zero.
    """
    lengths_m = np.concatenate([*shifts, np.empty(0)])
    longest_m = float(np.quantile(lengths_m, 0.95)) if lengths_m.size else 0.0
    return LONGEST_ARROW_MM / longest_m if longest_m > 0.0 else 1.0


def add_styles(database: sqlite3.Connection, mm_a_metre: float) -> None:
    """Add a default style of each layer to QGIS's table of styles, and list that table.

    ``mm_a_metre`` : length of the arrow of a shift of 1 m.
    """
    about = f"arrows: shift by the correction, 1 m is {mm_a_metre:.4g} mm"
    styles = (
        ("points", "correction on the ground", about),
        ("footprints", "footprints", "outlines of the footprints"),
        ("stations", "stations", "projection centres"),
    )
    for layer, name, description in styles:
        text = Template(data_text(f"style_{layer}.qml")).substitute(mm_a_metre=f"{mm_a_metre:.9g}")
        database.execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name,"
            " f_geometry_column, styleName, styleQML, useAsDefault, description, update_time)"
            " VALUES ('', '', ?, 'geom', ?, ?, 1, ?, ?)",
            (layer, name, text, description, now_text()),
        )
    database.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change)"
        " VALUES ('layer_styles', 'attributes', 'layer_styles', ?)",
        (now_text(),),
    )


FORMATS = (
    ExportFormat(
        "geopackage",
        "stations, footprints, points with their shift, styled for QGIS (--crs)",
        ".gpkg",
        write_geopackage,
        frame_of_points,
        grid=GridUse(WGS84_2D),
    ),
)
