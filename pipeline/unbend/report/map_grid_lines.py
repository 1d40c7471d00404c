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
    def end_deg(self) -> tuple[float, float]:
        """Longitude and latitude of its northern or eastern end on the map."""
        last = int(np.flatnonzero(np.isfinite(self.lon_deg))[-1])
        return float(self.lon_deg[last]), float(self.lat_deg[last])


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
        lon_of_all, lat_of_all = np.meshgrid(lon, lat)
        return self.grid.coordinates(np.radians(lat_of_all.ravel()), np.radians(lon_of_all.ravel()))

    def line(self, x: Array, y: Array, value: float, *, is_easting: bool) -> GridLine:
        """A line through coordinates (n,), of which one has a ``value`` everywhere."""
        lon, lat = self.grid.places(x, y)
        middle = 0.5 * sum(self.lon_deg)
        lon = lon + 360.0 * np.round((middle - lon) / 360.0)  # on across the 180th meridian
        is_inside = (self.lon_deg[0] <= lon) & (lon <= self.lon_deg[1])
        is_inside &= (self.lat_deg[0] <= lat) & (lat <= self.lat_deg[1])
        label = f"{value:,.0f}".replace(",", "\u202f")
        lon_inside = np.where(is_inside, lon, np.nan)
        lat_inside = np.where(is_inside, lat, np.nan)
        return GridLine(label, is_easting, lon_inside, lat_inside)


def grid_lines(grid: MapGrid, lon_deg: Range, lat_deg: Range) -> list[GridLine]:
    """The lines of a grid on a map within limits [deg].

    The distance of the lines is 1, 2 or 5 times a power of ten.
    """
    frame = MapFrame(grid, lon_deg, lat_deg)
    x, y = frame.coordinates()
    along_x = np.linspace(np.nanmin(x), np.nanmax(x), _PLACES)
    along_y = np.linspace(np.nanmin(y), np.nanmax(y), _PLACES)
    step = round_step(float(max(np.ptp(along_x), np.ptp(along_y))) / MOST_PARTS)
    lines = []
    for value in multiples(along_x, step):
        lines.append(frame.line(np.full(_PLACES, value), along_y, value, is_easting=True))
    for value in multiples(along_y, step):
        lines.append(frame.line(along_x, np.full(_PLACES, value), value, is_easting=False))
    return [line for line in lines if np.isfinite(line.lon_deg).sum() > 1]


def multiples(values: Array, step: float) -> Iterator[float]:
    """The multiples of a step between the first and the last of some values."""
    first = int(np.ceil(values[0] / step))
    last = int(np.floor(values[-1] / step))
    for number in range(first, last + 1):
        yield number * step
