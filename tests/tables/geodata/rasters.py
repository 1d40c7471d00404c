"""Rasters and geoid grids that tests write."""

from pathlib import Path

import numpy as np
import rasterio

from unbend.geodesy import GeoidGrid


def write_raster(
    name,
    stored,
    transform,
    *,
    scale=1.0,
    offset=0.0,
    mask=None,
    **options,
):
    """A GeoTIFF of one band, in degrees unless another system is among the options."""
    path = Path(name)
    height, width = stored.shape
    size = {"height": height, "width": width, "count": 1, "dtype": stored.dtype}
    options = {"crs": "EPSG:4326", "transform": transform, **options}
    with rasterio.open(path, "w", driver="GTiff", **size, **options) as raster:
        raster.write(stored, 1)
        if (scale, offset) != (1.0, 0.0):
            raster.scales = (scale,)
            raster.offsets = (offset,)
        if mask is not None:
            raster.write_mask(mask)
    return path


def level_geoid(undulation_m, name="national.gtx"):
    """A grid of the whole earth with one undulation."""
    values = np.full((181, 361), undulation_m, np.float32)
    return GeoidGrid(name, values, -90.0, -180.0, 1.0, 1.0)
