"""Elevation models from files; truth is the array that was written, kept in memory."""

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
    model, _ = open_elevation(
        list(paths),
        system,
        reference="msl",
        undulation=np.zeros_like,
    )
    return model


def test_blocks_of_a_file_are_decoded_once_for_the_tiles_they_serve():
    """The first tile has the edges of the others, whose blocks stay in memory: the file may go."""
    heights = relief(1024, 1024)
    path = write_raster(
        "dem.tif",
        heights.astype(np.float32),
        Affine(STEP, 0, 8.0, 0, -STEP, LAT),
        tiled=True,
        blockxsize=512,
        blockysize=512,
        compress="deflate",
    )
    model = opened(path)
    assert model.heights(np.array([3.0]), np.array([4.0])) == heights[3, 4]

    with path.open("r+b") as file:
        file.truncate(1000)

    assert model.heights(np.array([600.0]), np.array([700.0])) == heights[600, 700]


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("m", 100.0),
        ("Metre", 100.0),
        ("meter", 100.0),
        ("metres", 100.0),
        ("meters", 100.0),
        ("ft", 30.48),
        ("foot", 30.48),
        ("Feet", 30.48),
        ("us-ft", 30.48006),
        ("US survey foot", 30.48006),
    ],
)
def test_heights_in_the_unit_of_the_band(unit, metres):
    """A US survey foot is 1200/3937 m."""
    path = write_raster(
        "dem.tif",
        np.full((8, 8), 100.0, np.float32),
        Affine(STEP, 0, 8.0, 0, -STEP, LAT),
    )
    with rasterio.open(path, "r+") as raster:
        raster.units = [unit]
    model = opened(path)
    assert model.heights(np.array([3.0]), np.array([4.0])) == pytest.approx(metres, abs=1e-5)


def test_rasters_either_side_of_the_date_line_are_one_model():
    heights = relief(CELLS, CELLS)
    north = LAT + 0.5 * CELLS * STEP
    half = CELLS // 2
    stored = heights.astype(np.float32)
    west = write_raster(
        "west.tif",
        stored[:, :half],
        Affine(STEP, 0, 180.0 - half * STEP, 0, -STEP, north),
    )
    east = write_raster(
        "east.tif",
        stored[:, half:],
        Affine(STEP, 0, -180.0, 0, -STEP, north),
    )
    # Nodes are centres of cells.
    memory = ArrayTerrain(
        heights,
        north - 0.5 * STEP,
        -180.0 + 0.5 * STEP,
        STEP,
        STEP,
        around=432_000,
        first=-half,
    )
    rays = rays_from(300, LAT, 180.0, 0.1, (3_000.0, 10_000.0), 3)
    assert 0 < (rays[1] > 0.0).sum() < 300

    model = opened(east, west)

    landed, *_ = landing(model, *rays)
    expected, *_ = landing(memory, *rays)
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


@pytest.fixture
def with_files_beside():
    """A raster whose place, mask and offset are in files beside it."""
    heights = np.full((300, 300), 7.0, np.float32)
    mask = np.full((300, 300), 255, np.uint8)
    mask[0, 0] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False):
        return write_raster(
            "dem.tif",
            heights,
            Affine(0.5, 0, 8.0, 0, -0.5, 50.0),
            offset=100.0,
            mask=mask,
            crs=None,
            tfw="YES",
            profile="BASELINE",
        )


def test_what_gdal_reads_beside_a_raster_is_known(with_files_beside):
    with rasterio.open(with_files_beside) as source:
        files = {Path(name) for name in source.files}

    assert {file.name for file in files} == {
        "dem.tif",
        "dem.tif.aux.xml",
        "dem.tif.msk",
        "dem.tfw",
    }
    assert set(raster_files(with_files_beside)) == files


@pytest.mark.parametrize("variable", [None, *BESIDE])
def test_the_environment_does_not_change_what_gdal_reads_beside_a_raster(
    with_files_beside, variable
):
    """A variable of the environment, which GDAL asks for behind its own options."""
    settings = {}
    if variable is not None:
        settings[variable] = BESIDE[variable]
    nodes = np.array([0.0, 3.0])

    with rasterio.Env(**settings):
        model = opened(with_files_beside, system="EPSG:4326")
        heights = model.heights(nodes, nodes)

    assert_array_equal(heights, [np.nan, 107.0])
    first_node = model.nodes(*np.radians([[49.75], [8.25]]))
    assert_within(first_node, 0.0, 1e-9)
