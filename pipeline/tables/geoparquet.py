"""Points as GeoParquet 1.1 has them: well-known binary, and the metadata of their column.

Source: OGC GeoParquet 1.1.0; OGC 06-103r4 (well-known binary). In a geometry the longitude comes
first, whatever the order of the axes in the coordinate reference system.
"""

import json
import struct

from pipeline.units import WGS84_A, WGS84_F, Array

_AXES = {"subtype": "ellipsoidal", "axis": [
    {"name": "Geodetic latitude", "abbreviation": "Lat", "direction": "north", "unit": "degree"},
    {"name": "Geodetic longitude", "abbreviation": "Lon", "direction": "east", "unit": "degree"},
    {"name": "Ellipsoidal height", "abbreviation": "h", "direction": "up", "unit": "metre"},
]}  # fmt: skip
_WGS84_3D = {
    "$schema": "https://proj.org/schemas/v0.7/projjson.schema.json",
    "type": "GeographicCRS",
    "name": "WGS 84",
    "datum": {
        "type": "GeodeticReferenceFrame",
        "name": "World Geodetic System 1984",
        "ellipsoid": {
            "name": "WGS 84", "semi_major_axis": WGS84_A, "inverse_flattening": 1.0 / WGS84_F,
        },
    },
    "coordinate_system": _AXES,
    "id": {"authority": "EPSG", "code": 4979},
}  # fmt: skip


def geo_metadata(column: str) -> dict[str, str]:
    """The entry ``geo`` of a file's metadata, for a column of points in EPSG:4979."""
    described = {"encoding": "WKB", "geometry_types": ["Point", "Point Z"], "crs": _WGS84_3D}
    geo = {"version": "1.1.0", "primary_column": column, "columns": {column: described}}
    return {"geo": json.dumps(geo)}


def points_wkb(lon_deg: Array, lat_deg: Array, h_ellipsoid_m: Array) -> list[bytes | None]:
    """(n,) points; without height where that is unknown (NaN), None where there is no position.

    >>> import numpy as np
    >>> points_wkb(np.array([8.0]), np.array([47.0]), np.array([500.0]))[0].hex()[:10]
    '01e9030000'
    """
    points: list[bytes | None] = []
    for lon, lat, h in zip(lon_deg.tolist(), lat_deg.tolist(), h_ellipsoid_m.tolist(), strict=True):
        if lon != lon or lat != lat:
            points.append(None)
        elif h != h:
            points.append(struct.pack("<BI2d", 1, 1, lon, lat))
        else:
            points.append(struct.pack("<BI3d", 1, 1001, lon, lat, h))
    return points
