"""Elevation models from files; truth is the array that was written, kept in memory."""

from __future__ import annotations

import numpy as np
import rasterio
from rasterio import Affine

from pipeline.refraction.status_codes import OK
from pipeline.tables.geodata.elevation import open_elevation
from tests.refraction.array_terrain import ArrayTerrain
from tests.refraction.test_terrain import STEP, landing, rays_from, relief

LAT, CELLS = -17.0, 1500


def write(path, heights, west, north):
    with rasterio.open(
        path, "w", driver="GTiff", height=heights.shape[0], width=heights.shape[1], count=1,
        dtype="float32", crs="EPSG:4326", transform=Affine(STEP, 0, west, 0, -STEP, north),
    ) as out:  # fmt: skip
        out.write(heights, 1)


def test_rasters_either_side_of_the_date_line_are_one_model(tmp_path):
    heights, north = relief(CELLS, CELLS), LAT + 0.5 * CELLS * STEP
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
    read, known = landing(model, *rays)[0], landing(memory, *rays)[0]
    np.testing.assert_array_equal(read.status, known.status)
    assert (known.status == OK).mean() > 0.9
    np.testing.assert_allclose(read.h_m, known.h_m, rtol=0.0, atol=1e-4)
    assert model.covers(*np.radians([[LAT, LAT, LAT], [179.9, -179.9, 0.0]])).tolist() == [
        True, True, True,  # the frame goes round the earth; 0 degrees are a hole of it
    ]  # fmt: skip
    row, column = model.nodes(*np.radians([[LAT, LAT, LAT], [179.9, -179.9, 0.0]]))
    assert np.isfinite(model.heights(row, column)).tolist() == [True, True, False]
