"""The files and options with which GDAL reads a raster: the same on each machine."""

import math
import os
import re
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

GDAL_OPTIONS = {
    "GDAL_CACHEMAX": 96_000_000,
    "GDAL_NUM_THREADS": "ALL_CPUS",
    "GDAL_GEOREF_SOURCES": "PAM,INTERNAL,TABFILE,WORLDFILE,XML",
    "GDAL_PAM_ENABLED": "YES",
    "GDAL_DISABLE_READDIR_ON_OPEN": "FALSE",
    "GTIFF_POINT_GEO_IGNORE": "FALSE",
}
"""GDAL_CACHEMAX : bytes for decoded blocks, which tiles share at their edges; by default 5 % of the
memory. GDAL_NUM_THREADS : half of the time of a tile is decompression. The others are GDAL's
defaults, stated here because environment variables can change them, and with them the position of
a raster."""

INDEX_FORMATS = "DIMAP", "GTI", "STACIT", "STACTA", "TIL", "VRT", "WCS", "WMS", "WMTS"
"""GDAL's drivers of files that name other rasters: their hash does not show a change of those."""

FIXED_BYTES = 256_000_000
BYTES_OF_FILE_BYTE = 100
"""So many bytes of values may be unpacked at once: a fixed number, and a number for each byte of
the file. Heights shrink to a tenth at best; a sparse raster of some kB can state terabytes."""

# Endings of files of a mission that may have the raster's stem; GDAL does not read such files.
_NOT_OF_GDAL = re.compile(r"csv|err|html|log|mcap|out|parquet|tlog|toml|ulg|ya?ml")
# A folder that changed within this time is listed again: a further change need not alter its time.
_SETTLED_NS = 2_000_000_000


@contextmanager
def opening_rasters() -> Iterator[None]:
    """Open rasters with `GDAL_OPTIONS`, and without the warning that one is not georeferenced.

    Such a raster has the identity as its transform, and is refused because of that.
    """
    import rasterio

    with rasterio.Env(**GDAL_OPTIONS), warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        yield


def may_unpack(path: Path, unpacked_bytes: int) -> bool:
    """Whether a number of bytes of values is plausible for the size of a raster's files."""
    if unpacked_bytes <= FIXED_BYTES:  # the usual case, without access to the files
        return True
    file_bytes = sum(file.stat().st_size for file in raster_files(path))
    return unpacked_bytes <= FIXED_BYTES + BYTES_OF_FILE_BYTE * file_bytes


def is_upright(transform: Sequence[float]) -> bool:
    """Whether the rows of a raster run to the east and its columns to the south, by finite steps.

    ``transform`` : rasterio's affine of the raster: x = a column + b row + c, y = d column + e row
    + f, in the order a to f.

    >>> is_upright((0.25, 0.0, 7.0, 0.0, -0.25, 46.0))
    True
    >>> is_upright((0.25, 0.0, 7.0, 0.0, 0.25, 46.0))
    False
    """
    x_by_column, x_by_row, west = transform[:3]
    y_by_column, y_by_row, north = transform[3:6]
    if not all(math.isfinite(number) for number in (x_by_column, west, y_by_row, north)):
        return False
    runs_east = x_by_column > 0.0
    runs_south = y_by_row < 0.0
    is_turned = x_by_row != 0.0 or y_by_column != 0.0
    return runs_east and runs_south and not is_turned


def raster_files(path: Path) -> tuple[Path, ...]:
    """A raster, and the files that GDAL may take its georeference, scale, unit and holes from.

    These are the files in its folder with its stem, or its stem and a dot at the beginning, in any
    case of letters: for dem.tif dem.tif.aux.xml, dem.tif.msk, dem.tfw, DEM.prj. For an Arc/Info
    grid (.adf) all files in its folder.
    """
    folder = path.parent
    changed_ns = folder.stat().st_mtime_ns if folder.is_dir() else 0
    is_settled = changed_ns + _SETTLED_NS < time.time_ns()
    list_names = _names_by_beginning if is_settled else _names_by_beginning.__wrapped__
    beginning = "" if path.suffix.lower() == ".adf" else path.stem.lower()
    files = [path]
    for name in list_names(folder, changed_ns).get(beginning, ()):
        file = folder / name
        if name != path.name and file.is_file():
            files.append(file)
    return tuple(files)


@lru_cache(maxsize=64)
def _names_by_beginning(folder: Path, changed_ns: int) -> dict[str, list[str]]:
    """The sorted names in a folder, by each of their beginnings up to a dot, in lower case.

    a.tif.msk is in "", "a", "a.tif" and "a.tif.msk". ``changed_ns`` is the time of the folder's
    last change, a key of the cache; 0 for a folder that does not exist.
    """
    names: dict[str, list[str]] = {}
    if not changed_ns:
        return names
    for name in sorted(os.listdir(folder)):
        parts = name.lower().split(".")
        if _NOT_OF_GDAL.fullmatch(parts[-1]):
            continue
        for count in range(len(parts) + 1):
            beginning = ".".join(parts[:count])
            names.setdefault(beginning, []).append(name)
    return names
