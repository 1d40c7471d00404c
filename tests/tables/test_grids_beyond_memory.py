"""Files of some kilobytes that state grids of gigabytes: refused before room is made for them."""

import numpy as np
import pyproj  # noqa: F401  (before ecCodes)
import pytest

from tests.helpers import refused
from tests.tables.grib_messages import write_grib
from unbend.errors import InputError
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.weather_files import MOST_GRID_POINTS, contents_of

pytest.importorskip("eccodes")
rasterio = pytest.importorskip("rasterio")

COLUMNS = 60_000
ROWS = 30_001
LARGEST_FILE = 100_000  # bytes of each file here


@pytest.mark.parametrize("edition", [1, 2])
def test_a_field_of_equal_values_has_a_grid_within_the_limit(tmp_path, edition):
    """It has no more bytes for more points."""
    path = tmp_path / "model.grib"
    points = COLUMNS * ROWS
    keys = f"Ni={COLUMNS},Nj={ROWS},bitsPerValue=0"
    if edition == 2:
        keys += f",numberOfDataPoints={points},numberOfValues={points}"
    write_grib(path, [keys], edition)
    assert path.stat().st_size < LARGEST_FILE
    with refused("MODEL-UNREADABLE", InputError, says=f"{points:,} points"):
        contents_of(path)


def test_grids_of_real_models_are_within_the_limit():
    columns = 3600  # every 0.1 degrees
    rows = 1801
    assert columns * rows < MOST_GRID_POINTS


def write_sparse_raster(path, side, *, block, crs, step):
    """A GeoTIFF of which no value is in the file."""
    transform = rasterio.Affine(step, 0.0, 5.0, 0.0, -step, 50.0)
    raster = rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=side,
        height=side,
        count=1,
        dtype="float32",
        crs=crs,
        transform=transform,
        sparse_ok=True,
        tiled=block < side,
        blockxsize=block,
        blockysize=block,
        compress="deflate",
    )
    raster.close()


def read_elevation(path):
    model, _ = open_elevation([path], None, reference="msl", undulation=np.zeros_like)
    return model


DEGREES = {"crs": "EPSG:4326", "step": 1e-5}
METRES = {"crs": "EPSG:32632", "step": 1.0}


@pytest.mark.parametrize(
    ("read", "side", "block", "grid", "code", "size"),
    [
        (read_geoid, 100_000, 4096, DEGREES, "GEOID-GRID", "40,000,000,000 bytes"),
        (read_elevation, 40_000, 40_000, METRES, "DEM-RASTER", "6,400,000,000 bytes"),
    ],
    ids=["geoid", "elevation model in one strip"],
)
def test_a_raster_has_values_in_proportion_to_its_file(
    tmp_path, read, side, block, grid, code, size
):
    path = tmp_path / "sparse.tif"
    write_sparse_raster(path, side, block=block, **grid)
    assert path.stat().st_size < LARGEST_FILE
    with refused(code, InputError, says=size):
        read(path)


def test_a_sparse_elevation_model_in_tiles_is_read(tmp_path):
    path = tmp_path / "tiles.tif"
    write_sparse_raster(path, 40_000, block=512, **METRES)
    assert read_elevation(path).size == (40_000, 40_000)
