"""Elevation models from files; truth is the array that was written, kept in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from tests.refraction.array_terrain import ArrayTerrain
from tests.refraction.test_terrain import STEP, landing, rays_from, relief
from unbend.refraction.status_codes import OK
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.geodata.gdal import raster_files

LAT = -17.0
CELLS = 1500


def write(path, heights, west, north):
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=heights.shape[0],
        width=heights.shape[1],
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=Affine(STEP, 0, west, 0, -STEP, north),
    ) as out:
        out.write(heights, 1)


def test_blocks_of_a_file_are_decoded_once_for_the_tiles_they_serve(tmp_path):
    """The first tile has the edges of the others, whose blocks stay in memory: the file may go."""
    heights = relief(1024, 1024)
    with rasterio.open(
        tmp_path / "dem.tif",
        "w",
        driver="GTiff",
        height=1024,
        width=1024,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=Affine(STEP, 0, 8.0, 0, -STEP, LAT),
        tiled=True,
        blockxsize=512,
        blockysize=512,
        compress="deflate",
    ) as out:
        out.write(heights, 1)
    model, _ = open_elevation(
        [tmp_path / "dem.tif"], None, reference="msl", undulation=np.zeros_like
    )
    assert model.heights(np.array([3.0]), np.array([4.0])) == heights[3, 4]
    with (tmp_path / "dem.tif").open("r+b") as file:
        file.truncate(1000)
    assert model.heights(np.array([600.0]), np.array([700.0])) == heights[600, 700]


def test_rasters_either_side_of_the_date_line_are_one_model(tmp_path):
    heights = relief(CELLS, CELLS)
    north = LAT + 0.5 * CELLS * STEP
    half = CELLS // 2
    write(tmp_path / "west.tif", heights[:, :half], 180.0 - half * STEP, north)
    write(tmp_path / "east.tif", heights[:, half:], -180.0, north)
    paths = [tmp_path / "east.tif", tmp_path / "west.tif"]
    model, _ = open_elevation(paths, None, reference="msl", undulation=np.zeros_like)
    # Nodes are centres of cells.
    memory = ArrayTerrain(
        heights, north - 0.5 * STEP, -180.0 + 0.5 * STEP, STEP, STEP, around=432_000, first=-half
    )
    rays = rays_from(300, LAT, 180.0, 0.1, (3_000.0, 10_000.0), 3)
    assert 0 < (rays[1] > 0.0).sum() < 300
    read = landing(model, *rays)[0]
    known = landing(memory, *rays)[0]
    np.testing.assert_array_equal(read.status, known.status)
    assert (known.status == OK).mean() > 0.9
    np.testing.assert_allclose(read.h_m, known.h_m, rtol=0.0, atol=1e-4)
    assert model.covers(*np.radians([[LAT, LAT, LAT], [179.9, -179.9, 0.0]])).tolist() == [
        True,
        True,
        True,  # the frame goes round the earth; 0 degrees are a hole of it
    ]
    row, column = model.nodes(*np.radians([[LAT, LAT, LAT], [179.9, -179.9, 0.0]]))
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
    path = tmp_path / "dem.tif"
    heights = np.full((300, 300), 7.0, np.float32)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=300,
            width=300,
            count=1,
            dtype="float32",
            transform=Affine(0.5, 0, 8.0, 0, -0.5, 50.0),
            tfw="YES",
            profile="BASELINE",
        ) as out,
    ):
        out.write(heights, 1)
        out.offsets, mask = (100.0,), np.full((300, 300), 255, np.uint8)
        mask[0, 0] = 0
        out.write_mask(mask)
    with rasterio.open(path) as source:
        beside = {Path(name) for name in source.files}
    assert {file.name for file in beside} == {
        "dem.tif",
        "dem.tif.aux.xml",
        "dem.tif.msk",
        "dem.tfw",
    }
    assert set(raster_files(path)) == beside
    # As a variable of the environment does, which GDAL asks for behind its own options.
    with rasterio.Env(**{variable: BESIDE[variable]} if variable else {}):
        model, _ = open_elevation([path], "EPSG:4326", reference="msl", undulation=np.zeros_like)
        read = model.heights(np.array([0.0, 3.0]), np.array([0.0, 3.0]))
    np.testing.assert_array_equal(read, [np.nan, 107.0])
    row, column = model.nodes(*np.radians([[49.75], [8.25]]))
    np.testing.assert_allclose([row, column], 0.0, atol=1e-9)
