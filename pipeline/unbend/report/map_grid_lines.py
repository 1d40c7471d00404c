"""The metric grid on the map of a report: lines of round coordinates, and their numbers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from unbend.tables.geodata.map_grids import MapGrid
from unbend.units import Array, round_step

Range = tuple[float, float]

MOST_PARTS = 6  # of the longer side of the map, between the lines: their numbers fit on a phone
_PLACES = 161  # of a line, so that it ends within a part in 160 of the frame
_FRAME_PLACES = 9  # on each side of the map, whose coordinates limit the lines


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
    def is_on_map(self) -> bool:
        """Whether a part of it is on the map."""
        return int(np.isfinite(self.lon_deg).sum()) > 1

    @property
    def end_deg(self) -> tuple[float, float]:
        """Longitude and latitude of its northern or eastern end on the map."""
        on_map = np.flatnonzero(np.isfinite(self.lon_deg))
        last = int(on_map[-1])
        lon = float(self.lon_deg[last])
        lat = float(self.lat_deg[last])
        return lon, lat


@dataclass(frozen=True, eq=False)
class MapFrame:
    """The frame of a map: a grid, and the limits of longitude and latitude [deg]."""

    grid: MapGrid
    lon_deg: Range
    lat_deg: Range

    def coordinates(self) -> tuple[Array, Array]:
        """x and y of places all over the map."""
        lon = np.linspace(*self.lon_deg, _FRAME_PLACES)
        lat = np.linspace(*self.lat_deg, _FRAME_PLACES)
        all_lon, all_lat = np.meshgrid(lon, lat)
        lat_rad = np.radians(all_lat.ravel())
        lon_rad = np.radians(all_lon.ravel())
        return self.grid.coordinates(lat_rad, lon_rad)

    def line(self, x: Array, y: Array, value: float, *, is_easting: bool) -> GridLine:
        """A line through coordinates (n,), of which one has a ``value`` everywhere."""
        west, east = self.lon_deg
        south, north = self.lat_deg
        lon, lat = self.grid.places(x, y)
        middle = 0.5 * (west + east)
        turns = np.round((middle - lon) / 360.0)
        lon += 360.0 * turns  # on across the 180th meridian
        is_inside = lon >= west
        is_inside &= lon <= east
        is_inside &= lat >= south
        is_inside &= lat <= north
        lon[~is_inside] = np.nan
        lat[~is_inside] = np.nan
        return GridLine(
            label=f"{value:,.0f}".replace(",", "\u202f"),
            is_easting=is_easting,
            lon_deg=lon,
            lat_deg=lat,
        )


def grid_lines(grid: MapGrid, lon_deg: Range, lat_deg: Range) -> list[GridLine]:
    """The lines of a grid on a map within limits [deg].

    The distance of the lines is 1, 2 or 5 times a power of ten.
    """
    frame = MapFrame(grid, lon_deg, lat_deg)
    x, y = frame.coordinates()
    along_x = np.linspace(np.nanmin(x), np.nanmax(x), _PLACES)
    along_y = np.linspace(np.nanmin(y), np.nanmax(y), _PLACES)
    width = float(np.ptp(along_x))
    depth = float(np.ptp(along_y))
    step = round_step(max(width, depth) / MOST_PARTS)
    lines = []
    for easting in multiples(along_x, step):
        x = np.full(_PLACES, easting)
        line = frame.line(x, along_y, easting, is_easting=True)
        lines.append(line)
    for northing in multiples(along_y, step):
        y = np.full(_PLACES, northing)
        line = frame.line(along_x, y, northing, is_easting=False)
        lines.append(line)
    return [line for line in lines if line.is_on_map]


def multiples(values: Array, step: float) -> Iterator[float]:
    """The multiples of a step between the first and the last of some values."""
    first = int(np.ceil(values[0] / step))
    last = int(np.floor(values[-1] / step))
    for number in range(first, last + 1):
        yield number * step
