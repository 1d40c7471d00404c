"""Grids of the geoid: EGM96 of the package, or the user's file, GTX or GeoTIFF."""

import struct
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow as pa

from unbend.geodesy import GeoidGrid
from unbend.tables.geodata import messages
from unbend.tables.geodata.gdal import INDEX_FORMATS, is_upright, may_unpack, opening_rasters

_GTX = struct.Struct(">4d2i")
"""The header of a GTX, big-endian: latitude and longitude of the first node, steps of latitude and
longitude [deg], rows, columns. Then float32 from the south-west corner, row by row to the north.
-88.8888 is a node without a value."""

_GTX_MISSING = np.float32(-88.8888)
_EGM96_ROWS = 721
_EGM96_COLUMNS = 1440
_BYTES_OF_VALUE = 4  # a float32
_LEAST_STEP_DEG = 1e-5  # a metre; geoids have steps of a kilometre
_LOWEST_UNDULATION_M = -120.0  # EGM96 has -107 to 86 m
_HIGHEST_UNDULATION_M = 100.0


@lru_cache(maxsize=1)
def package_geoid() -> GeoidGrid:
    """EGM96 on a grid of 15 minutes, the geoid of autopilots and receivers.

    Source: NGA, WW15MGH.GRD, public domain, in the form that PROJ distributes (egm96_15.gtx), bit
    for bit. Between nodes the bilinear value is within some decimetres of the full model.

    >>> grid = package_geoid()
    >>> round(float(grid.undulation(0.0, 0.0)), 2)  # published: 17.16
    17.16
    """
    packed = files("unbend.tables").joinpath("data/egm96_15.gtx.zst").read_bytes()
    size = _GTX.size + _BYTES_OF_VALUE * _EGM96_ROWS * _EGM96_COLUMNS
    content = pa.decompress(packed, size, "zstd", asbytes=True)
    head = content[: _GTX.size]
    # The file has the first bytes of all values, then the second bytes, and so on: that is smaller
    # than a packed GTX, and read ten times as fast as xz.
    planes = np.frombuffer(content, np.uint8, offset=_GTX.size)
    values = planes.reshape(_BYTES_OF_VALUE, -1).T.tobytes()
    return _grid_of_gtx(head + values, Path("EGM96, 15 minutes"))


def read_geoid(path: Path) -> GeoidGrid:
    """A user's grid of undulations [m], ellipsoidal minus orthometric height, GTX or GeoTIFF.

    GeoTIFFs need rasterio (the extra `rasters`), one band and geographic coordinates. Refuses
    (InputError GEOID-GRID) a file that is not such a grid, or has values outside -120 to 100 m.
    """
    try:
        if path.suffix.lower() == ".gtx":
            grid = _grid_of_gtx(path.read_bytes(), path)
        else:
            grid = _grid_of_raster(path)
    except (OSError, ValueError) as error:
        raise messages.geoid_unreadable(where=path, error=str(error)) from None
    is_known = ~np.isnan(grid.values_m)
    if not is_known.any():
        raise messages.geoid_without_values(where=path)
    lowest = float(grid.values_m[is_known].min())
    highest = float(grid.values_m[is_known].max())
    if lowest < _LOWEST_UNDULATION_M or highest > _HIGHEST_UNDULATION_M:
        raise messages.geoid_values(where=path, lowest=lowest, highest=highest)
    return grid


def _grid_of_gtx(content: bytes, path: Path) -> GeoidGrid:
    """The grid in the bytes of a GTX; refuses (GEOID-GRID) a wrong header or size.

    The grid is called by the name of ``path``.
    """
    if len(content) < _GTX.size:
        raise messages.geoid_header(where=path)
    south, west, d_lat, d_lon, rows, columns = _GTX.unpack_from(content)
    has_size = 0 < rows <= 100_000 and 0 < columns <= 100_000
    has_steps = _LEAST_STEP_DEG <= d_lat <= 180.0 and _LEAST_STEP_DEG <= d_lon <= 360.0
    has_corner = abs(south) <= 90.0 and abs(west) <= 360.0
    if not (has_size and has_steps and has_corner):
        raise messages.geoid_header(where=path)
    if len(content) != _GTX.size + _BYTES_OF_VALUE * rows * columns:
        raise messages.geoid_size(
            where=path,
            size=len(content),
            rows=rows,
            columns=columns,
        )
    stored = np.frombuffer(content, ">f4", offset=_GTX.size).reshape(rows, columns)
    values = np.where(stored == _GTX_MISSING, np.nan, stored)
    return GeoidGrid(
        name=path.name,
        values_m=values.astype(np.float32),
        south_deg=south,
        west_deg=west,
        step_lat_deg=d_lat,
        step_lon_deg=d_lon,
    )


def _grid_of_raster(path: Path) -> GeoidGrid:
    """The grid in a raster; refuses (GEOID-GRID) one that is not a geographic band, north up."""
    try:
        import rasterio
    except ImportError:
        raise messages.geoid_needs_rasterio(where=path) from None
    try:
        with opening_rasters(), rasterio.open(path) as raster:
            is_plain = raster.count == 1 and raster.driver not in INDEX_FORMATS
            if not (is_plain and raster.crs and raster.crs.is_geographic):
                raise messages.geoid_bands(where=path)
            affine = raster.transform
            if not is_upright(affine):
                raise messages.geoid_turned(where=path)
            unpacked_bytes = raster.height * raster.width * _BYTES_OF_VALUE
            if not may_unpack(path, unpacked_bytes):
                raise messages.geoid_too_large(where=path, unpacked_bytes=unpacked_bytes)
            stored = raster.read(1, masked=True).astype(np.float32)
            from_south = stored.filled(np.nan)[::-1]
            scale = np.float32(raster.scales[0])
            offset = np.float32(raster.offsets[0])
            # Numbers of a damaged raster may overflow; the caller refuses the results.
            with np.errstate(all="ignore"):
                values = from_south * scale + offset
    except rasterio.errors.RasterioError as error:
        raise messages.geoid_unreadable(where=path, error=str(error)) from None
    # Values belong to the centres of the cells.
    south = affine.f + affine.e * (values.shape[0] - 0.5)
    west = affine.c + 0.5 * affine.a
    return GeoidGrid(
        name=path.name,
        values_m=np.ascontiguousarray(values),
        south_deg=south,
        west_deg=west,
        step_lat_deg=-affine.e,
        step_lon_deg=affine.a,
    )
