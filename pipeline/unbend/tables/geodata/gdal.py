"""What GDAL reads for a raster, and how: the same on every machine."""

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
"""Bytes for blocks of files, which tiles share at their edges (by default 5 % of the memory). Half
of the time of a tile is decompression: on all cores. The rest are GDAL's defaults, which variables
of the environment would change, and with them where a raster lies."""

NAME_OTHERS = "GTI", "STACIT", "STACTA", "TIL", "VRT", "WCS", "WMS", "WMTS"
"""Formats of files that name other rasters, whose change no hash of theirs would show."""

FIXED_BYTES = 256_000_000
MOST_BYTES_A_BYTE = 100
"""Of values that are unpacked at once, for any file and for each of its bytes. Heights shrink to a
tenth at best; a sparse raster of some kB can state terabytes."""

# Endings of files that GDAL does not read beside a raster: a mission's may be called like it.
_OTHERS = re.compile(r"csv|err|html|log|mcap|out|parquet|tlog|toml|ulg|ya?ml")
_SETTLED_NS = 2_000_000_000  # a folder changed within this time may change again unseen


@contextmanager
def opening_rasters() -> Iterator[None]:
    """Open rasters with `GDAL_OPTIONS`, and without a warning of one that has no frame.

    Such a raster is refused by its transform, which is the identity.
    """
    import rasterio

    with rasterio.Env(**GDAL_OPTIONS), warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        yield


def may_unpack(path: Path, unpacked_bytes: int) -> bool:
    """Whether so many bytes of values are in proportion to the size of a raster's files."""
    if unpacked_bytes <= FIXED_BYTES:  # nearly always: no file is looked at
        return True
    file_bytes = sum(file.stat().st_size for file in raster_files(path))
    return unpacked_bytes <= FIXED_BYTES + MOST_BYTES_A_BYTE * file_bytes


def is_upright(transform: Sequence[float]) -> bool:
    """Whether the rows of a raster run to the east and its columns to the south, by finite steps.

    ``transform`` : of a raster, as rasterio has it.

    >>> is_upright((0.25, 0.0, 7.0, 0.0, -0.25, 46.0))
    True
    >>> is_upright((0.25, 0.0, 7.0, 0.0, 0.25, 46.0))
    False
    """
    step_east, turn, west = transform[:3]
    other_turn, step_north, north = transform[3:6]
    if not all(math.isfinite(number) for number in (step_east, west, step_north, north)):
        return False
    runs_east = step_east > 0.0
    runs_south = step_north < 0.0
    is_turned = turn != 0.0 or other_turn != 0.0
    return runs_east and runs_south and not is_turned


def raster_files(path: Path) -> tuple[Path, ...]:
    """A raster and the files beside it that GDAL takes its frame, scale, unit and holes from.

    Those that are called like its stem, with or without more behind a dot, in any case of letters:
    of dem.tif dem.tif.aux.xml, dem.tif.msk, dem.tfw, DEM.prj. Of an Arc/Info grid (.adf) all that
    are in its folder.
    """
    folder = path.parent
    changed = folder.stat().st_mtime_ns if folder.is_dir() else 0
    settled = changed + _SETTLED_NS < time.time_ns()
    names_in_folder = _by_beginning if settled else _by_beginning.__wrapped__
    beginning = "" if path.suffix.lower() == ".adf" else path.stem.lower()
    files = [path]
    for name in names_in_folder(folder, changed).get(beginning, ()):
        file = folder / name
        if name != path.name and file.is_file():
            files.append(file)
    return tuple(files)


@lru_cache(maxsize=64)
def _by_beginning(folder: Path, changed: int) -> dict[str, list[str]]:
    """The names in a folder, sorted, by each beginning that ends at a dot; "" is one too."""
    names: dict[str, list[str]] = {}
    if not changed:  # no such folder
        return names
    for name in sorted(os.listdir(folder)):
        words = name.lower().split(".")
        if _OTHERS.fullmatch(words[-1]):
            continue
        for count in range(len(words) + 1):
            beginning = ".".join(words[:count])
            names.setdefault(beginning, []).append(name)
    return names
