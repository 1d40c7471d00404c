"""The metric grid on the map of a report: lines of round coordinates, and their numbers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from unbend.tables.geodata.map_grids import MapGrid
from unbend.units import Array, round_step

Range = tuple[float, float]

MOST_PARTS = 6  # of the longer side of the map, between the lines: their numbers fit on a phone
_PLACES = 161  # of a line, so that it ends within a part in 160 of the frame


@dataclass(frozen=True, eq=False)
class GridLine:
    """A line of one coordinate on the map.

    ``label`` : the coordinate, with thousands apart. ``is_easting`` : of x, else of y. ``lon_deg``,
    ``lat_deg`` (n,) are its places, NaN outside the map.
    """

    label: str
    is_easting: bool
    lon_deg: Array
    lat_deg: Array

    @property
    def end_deg(self) -> tuple[float, float]:
        """Longitude and latitude of its northern or eastern end on the map."""
        last = int(np.flatnonzero(np.isfinite(self.lon_deg))[-1])
        return float(self.lon_deg[last]), float(self.lat_deg[last])


def grid_lines(grid: MapGrid, lon_deg: Range, lat_deg: Range) -> list[GridLine]:
    """The lines of a grid on a map within limits [deg].

    The distance of the lines is 1, 2 or 5 times a power of ten.
    """
    lon, lat = border(lon_deg, lat_deg)
    x, y = grid.coordinates(np.radians(lat), np.radians(lon))
    limits_x = float(np.nanmin(x)), float(np.nanmax(x))
    limits_y = float(np.nanmin(y)), float(np.nanmax(y))
    longest = max(limits_x[1] - limits_x[0], limits_y[1] - limits_y[0])
    step = round_step(longest / MOST_PARTS)

    def inside(x: Array, y: Array) -> tuple[Array, Array]:
        """Places of coordinates, NaN outside the map."""
        lon, lat = grid.places(x, y)
        middle = 0.5 * (lon_deg[0] + lon_deg[1])
        lon = lon + 360.0 * np.round((middle - lon) / 360.0)  # on across the 180th meridian
        is_inside = (lon_deg[0] <= lon) & (lon <= lon_deg[1])
        is_inside &= (lat_deg[0] <= lat) & (lat <= lat_deg[1])
        return np.where(is_inside, lon, np.nan), np.where(is_inside, lat, np.nan)

    lines = []
    along_y = np.linspace(*limits_y, _PLACES)
    for value in multiples(limits_x, step):
        lines.append(line_of(inside, np.full(_PLACES, value), along_y, value, is_easting=True))
    along_x = np.linspace(*limits_x, _PLACES)
    for value in multiples(limits_y, step):
        lines.append(line_of(inside, along_x, np.full(_PLACES, value), value, is_easting=False))
    return [line for line in lines if np.isfinite(line.lon_deg).sum() > 1]


def border(lon_deg: Range, lat_deg: Range) -> tuple[Array, Array]:
    """Places on the frame of a map and in its middle [deg]."""
    lon = np.linspace(*lon_deg, 9)
    lat = np.linspace(*lat_deg, 9)
    grid_lon, grid_lat = np.meshgrid(lon, lat)
    return grid_lon.ravel(), grid_lat.ravel()


def multiples(limits: Range, step: float) -> Iterator[float]:
    """The multiples of a step within limits."""
    first = int(np.ceil(limits[0] / step))
    for number in range(first, int(np.floor(limits[1] / step)) + 1):
        yield number * step


def line_of(
    inside: Callable[[Array, Array], tuple[Array, Array]],
    x: Array,
    y: Array,
    value: float,
    *,
    is_easting: bool,
) -> GridLine:
    """A line through coordinates (n,), whose label is a ``value``."""
    lon, lat = inside(x, y)
    label = f"{value:,.0f}".replace(",", "\u202f")
    return GridLine(label, is_easting, lon, lat)
