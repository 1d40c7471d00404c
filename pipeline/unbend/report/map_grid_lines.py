"""The metric grid on the map of a report: lines of round coordinates, and their numbers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from unbend.tables.geodata.map_grids import MapGrid
from unbend.units import Array, round_step

Range = tuple[float, float]
"""Lower and upper limit."""

MOST_PARTS = 6  # of the map's longer side between lines: more numbers do not fit on a phone
_PLACES = 161  # along a line: its end is within 1/160 of the edge of the map
_FRAME_PLACES = 9  # along each side of the map, for the range of its coordinates


@dataclass(frozen=True, eq=False)
class GridLine:
    """A line of one coordinate on the map.

    ``label`` is the coordinate with its thousands separated by narrow blanks. ``is_easting``: it is
    x, and the line runs north; else it is y. ``lon_deg``, ``lat_deg`` (n,) are places along the
    line, from south to north or west to east, NaN outside the map.
    """

    label: str
    is_easting: bool
    lon_deg: Array
    lat_deg: Array

    @property
    def is_on_map(self) -> bool:
        """Whether at least two places of the line are on the map."""
        return int(np.isfinite(self.lon_deg).sum()) > 1

    @property
    def end_deg(self) -> tuple[float, float]:
        """Longitude and latitude of the line's northern or eastern end on the map."""
        on_map = np.flatnonzero(np.isfinite(self.lon_deg))
        last = int(on_map[-1])
        lon = float(self.lon_deg[last])
        lat = float(self.lat_deg[last])
        return lon, lat


@dataclass(frozen=True, eq=False)
class MapFrame:
    """The frame of a map: its metric grid, and the limits of longitude and latitude [deg]."""

    grid: MapGrid
    lon_deg: Range
    lat_deg: Range

    def coordinates(self) -> tuple[Array, Array]:
        """x and y [m] of 81 places spread over the map."""
        lon = np.linspace(*self.lon_deg, _FRAME_PLACES)
        lat = np.linspace(*self.lat_deg, _FRAME_PLACES)
        all_lon, all_lat = np.meshgrid(lon, lat)
        lat_rad = np.radians(all_lat.ravel())
        lon_rad = np.radians(all_lon.ravel())
        return self.grid.coordinates(lat_rad, lon_rad)

    def line(self, x: Array, y: Array, value: float, *, is_easting: bool) -> GridLine:
        """The line through places with the coordinates ``x``, ``y`` (n,) [m].

        ``value`` is the coordinate that is equal along the line: x if ``is_easting``, else y.
        """
        west, east = self.lon_deg
        south, north = self.lat_deg
        lon, lat = self.grid.places(x, y)
        middle = 0.5 * (west + east)
        turns = np.round((middle - lon) / 360.0)
        lon += 360.0 * turns  # nearest to the map, which may cross the 180th meridian
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
    """The lines of a metric grid on a map with limits of longitude and latitude [deg].

    The distance between lines is 1, 2 or 5 times a power of ten [m].
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
    """The multiples of a step between the first and the last of increasing values."""
    first = int(np.ceil(values[0] / step))
    last = int(np.floor(values[-1] / step))
    for multiple in range(first, last + 1):
        yield multiple * step
