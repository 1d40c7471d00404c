"""Elevation models from files; truth is the array that was written, kept in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_array_equal
from rasterio import Affine

from tests.refraction.array_terrain import ArrayTerrain
from tests.refraction.test_terrain import STEP, landing, rays_from, relief
from tests.tables.checks import assert_within
from tests.tables.geodata.rasters import write_raster
from unbend.refraction.status_codes import OK
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.geodata.gdal import raster_files

LAT = -17.0
CELLS = 1500


def opened(*paths, system=None):
    model, _ = open_elevation(list(paths), system, reference="msl", undulation=np.zeros_like)
    return model


def test_blocks_of_a_file_are_decoded_once_for_the_tiles_they_serve(tmp_path):
    """The first tile has the edges of the others, whose blocks stay in memory: the file may go."""
    heights = relief(1024, 1024)
    tiles = {"tiled": True, "blockxsize": 512, "blockysize": 512, "compress": "deflate"}
    transform = Affine(STEP, 0, 8.0, 0, -STEP, LAT)
    path = write_raster(tmp_path / "dem.tif", heights.astype(np.float32), transform, **tiles)
    model = opened(path)
    assert model.heights(np.array([3.0]), np.array([4.0])) == heights[3, 4]
    with path.open("r+b") as file:
        file.truncate(1000)
    assert model.heights(np.array([600.0]), np.array([700.0])) == heights[600, 700]


def test_rasters_either_side_of_the_date_line_are_one_model(tmp_path):
    heights = relief(CELLS, CELLS)
    north = LAT + 0.5 * CELLS * STEP
    half = CELLS // 2
    stored = heights.astype(np.float32)
    to_west = Affine(STEP, 0, 180.0 - half * STEP, 0, -STEP, north)
    to_east = Affine(STEP, 0, -180.0, 0, -STEP, north)
    west = write_raster(tmp_path / "west.tif", stored[:, :half], to_west)
    east = write_raster(tmp_path / "east.tif", stored[:, half:], to_east)
    model = opened(east, west)
    # Nodes are centres of cells.
    memory = ArrayTerrain(
        heights, north - 0.5 * STEP, -180.0 + 0.5 * STEP, STEP, STEP, around=432_000, first=-half
    )
    rays = rays_from(300, LAT, 180.0, 0.1, (3_000.0, 10_000.0), 3)
    assert 0 < (rays[1] > 0.0).sum() < 300
    landed = landing(model, *rays)[0]
    expected = landing(memory, *rays)[0]
    assert_array_equal(landed.status, expected.status)
    assert (expected.status == OK).mean() > 0.9
    assert_within(landed.h_m, expected.h_m, 1e-4)
    # The frame goes round the earth; 0 degrees are a hole of it.
    places = np.radians([[LAT, LAT, LAT], [179.9, -179.9, 0.0]])
    assert model.covers(*places).all()
    row, column = model.nodes(*places)
    assert np.isfinite(model.heights(row, column)).tolist() == [True, True, False]


BESIDE = {
    "GDAL_GEOREF_SOURCES": "INTERNAL",
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
}


@pytest.mark.parametrize("variable", [None, *BESIDE])
def test_what_gdal_reads_beside_a_raster_is_known_and_the_environment_changes_nothing(
    tmp_path, variable
):
    heights = np.full((300, 300), 7.0, np.float32)
    mask = np.full((300, 300), 255, np.uint8)
    mask[0, 0] = 0
    transform = Affine(0.5, 0, 8.0, 0, -0.5, 50.0)
    baseline = {"crs": None, "tfw": "YES", "profile": "BASELINE"}
    path = tmp_path / "dem.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False):
        write_raster(path, heights, transform, offset=100.0, mask=mask, **baseline)
    with rasterio.open(path) as source:
        beside = {Path(name) for name in source.files}
    names = {"dem.tif", "dem.tif.aux.xml", "dem.tif.msk", "dem.tfw"}
    assert {file.name for file in beside} == names
    assert set(raster_files(path)) == beside
    # As a variable of the environment does, which GDAL asks for behind its own options.
    with rasterio.Env(**{variable: BESIDE[variable]} if variable else {}):
        model = opened(path, system="EPSG:4326")
        read = model.heights(np.array([0.0, 3.0]), np.array([0.0, 3.0]))
    assert_array_equal(read, [np.nan, 107.0])
    row, column = model.nodes(*np.radians([[49.75], [8.25]]))
    assert_within([row, column], 0.0, 1e-9)
