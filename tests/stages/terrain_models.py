"""The simulator's terrain in cells of a coordinate system, and grids of undulations."""

import struct
from functools import cache

import numpy as np
import pyproj
from rasterio import Affine

from unbend.simulate.flight import FIELD_LAT_RAD, FIELD_LON_RAD, geographic, terrain_m

CELLS = 800


def terrain_at(lat_deg, lon_deg):
    """The simulator's terrain at places, by its own linear map."""
    lat_1, lon_1 = geographic(np.array(1.0), np.array(1.0))
    rad_per_m_north = float(lat_1) - FIELD_LAT_RAD
    rad_per_m_east = float(lon_1) - FIELD_LON_RAD
    north = (np.radians(lat_deg) - FIELD_LAT_RAD) / rad_per_m_north
    east = (np.radians(lon_deg) - FIELD_LON_RAD) / rad_per_m_east
    return terrain_m(east, north)


@cache
def terrain_grid(crs, lon_deg, lat_deg, step_m):
    """The terrain about a place in the cells of a coordinate system, and where these are."""
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    step = step_m
    if pyproj.CRS(crs).is_geographic:
        step /= 111_000.0
    half = CELLS / 2 * step
    x, y = to_grid.transform(lon_deg, lat_deg)
    west = x - half
    north = y + half
    centres = (np.arange(CELLS) + 0.5) * step
    places = np.meshgrid(west + centres, north - centres)
    lon, lat = to_grid.transform(*places, direction="INVERSE")
    return terrain_at(lat, lon), Affine(step, 0.0, west, 0.0, -step, north)


def gtx(south_deg, west_deg, step_deg, undulation_m):
    """A grid of undulations, whose rows begin in the south."""
    head = struct.pack(
        ">4d2i",
        south_deg,
        west_deg,
        step_deg,
        step_deg,
        *undulation_m.shape,
    )
    return head + undulation_m.astype(">f4").tobytes()
