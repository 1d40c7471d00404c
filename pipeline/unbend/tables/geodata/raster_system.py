"""The coordinate system of a raster, with its transformations from and to WGS 84."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from unbend.tables.geodata import messages
from unbend.tables.geodata.coordinate_systems import (
    SEA_LEVELS,
    horizontal_and_vertical,
    in_own_datum,
    to_wgs84,
)
from unbend.units import Array


@dataclass(frozen=True)
class RasterSystem:
    """The coordinate system of a raster.

    ``to_grid`` computes x, y of longitude and latitude on WGS 84 [deg], ``to_places`` the reverse;
    x, y are longitude, latitude [deg] in a geographic system. ``operation`` describes the
    transformation, ``is_good`` : its known accuracy is 1 m or better. ``vertical`` : name of the
    vertical datum, "" without one; ``is_sea_level`` : it is mean sea level; ``unit_m`` : its unit.
    """

    name: str
    is_geographic: bool
    to_grid: Callable[[Array, Array], tuple[Array, Array]]
    to_places: Callable[[Array, Array], tuple[Array, Array]]
    operation: str
    is_good: bool
    vertical: str = ""
    is_sea_level: bool = True
    unit_m: float = 1.0


def raster_system(
    file_crs: str, stated_crs: str | None, *, corners: Array, heights: str, where: str, key: str
) -> RasterSystem:
    """The coordinate system of a raster, WKT or EPSG, as it is in the file.

    ``stated_crs`` : that of the mission file, None if it states none. ``corners`` (2, n) : x and y
    of the raster's corners. ``heights`` : what its heights count from, as stated: msl or ellipsoid.
    The vertical part may be in either. Refuses (InputError) as `places_of` does, and two systems
    that differ (DEM-CRS).
    """
    horizontal, vertical = horizontal_and_vertical(file_crs, heights, where, key)
    stated, stated_vertical = horizontal_and_vertical(stated_crs or file_crs, heights, where, key)
    vertical = vertical or stated_vertical
    if not horizontal.equals(stated, ignore_axis_order=True):
        raise messages.dem_crs_stated(
            where=where, own=horizontal.name, other=stated.name, named=key
        )
    lon_lat = in_own_datum(horizontal, *corners)
    is_known = np.isfinite(lon_lat).all(axis=0)
    best = to_wgs84(horizontal, lon_lat[:, is_known], where, key)
    system = RasterSystem(
        name=horizontal.name,
        is_geographic=horizontal.is_geographic,
        to_grid=partial(best.transformer.transform, direction="INVERSE"),
        to_places=best.transformer.transform,
        operation=best.description,
        is_good=best.is_good,
    )
    if vertical is None:
        return system
    return replace(
        system,
        vertical=vertical.name,
        is_sea_level=vertical.name in SEA_LEVELS,
        unit_m=vertical.axis_info[0].unit_conversion_factor,
    )
