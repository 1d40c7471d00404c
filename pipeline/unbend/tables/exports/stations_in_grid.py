"""Stations in the grid of a map: coordinates, attitudes against its axes, convergence and scale.

Attitudes are relative to the vertical of each station, and to the grid's x and y there, which the
convergence turns against east and north.
"""

from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.rotations import enu_from_grid, in_turned_frame
from unbend.flight.stations import Stations
from unbend.tables.exports.export_frames import AngleFrame, angles_of_photogrammetry
from unbend.tables.geodata.map_grids import GridAxes, MapGrid
from unbend.units import Array, Integers


@dataclass(frozen=True, eq=False)
class StationsInGrid:
    """Stations (n,) in the grid of a map.

    ``x``, ``y`` : in the unit of the grid; ``height`` : in the unit of its heights. ``quaternion``
    (n, 4) : as of `Stations`, but from the axes of the grid at each station, x, y, up. ``axes`` :
    how these axes are directed.
    """

    x: Array
    y: Array
    height: Array
    quaternion: Array
    axes: GridAxes


def stations_in_grid(stations: Stations, rows: Integers, grid: MapGrid) -> StationsInGrid:
    """The stations of some rows in a grid, with x and y in its unit.

    ``rows`` must be those of stations that have coordinates in the grid.
    """
    lat = stations.lat_rad[rows]
    lon = stations.lon_rad[rows]
    x, y = grid.coordinates(lat, lon)
    height = grid.height.heights(lat, lon, stations.h_msl_m[rows], stations.h_ellipsoid_m[rows])
    axes = grid.axes_at(lat, lon)
    to_enu = enu_from_grid(axes.convergence_rad)
    quaternion = in_turned_frame(stations.quaternion[rows], to_enu)
    return StationsInGrid(x, y, height, quaternion, axes)


def grid_columns(grid: MapGrid, stations: StationsInGrid) -> dict[str, Array]:
    """Columns of coordinates, convergence and scale; their names end in the unit."""
    return place_columns(grid, stations.x, stations.y, stations.height) | {
        "convergence_deg": np.degrees(stations.axes.convergence_rad),
        "scale_factor": stations.axes.scale,
    }


def place_columns(grid: MapGrid, x: Array, y: Array, height: Array) -> dict[str, Array]:
    """Columns of coordinates (n,) in a grid; their names are those of `place_names`."""
    return dict(zip(place_names(grid), (x, y, height), strict=True))


def place_names(grid: MapGrid) -> tuple[str, str, str]:
    """The names of the columns of coordinates in a grid, which end in the unit: x_m, y_m, z_m."""
    x_name = "x"
    y_name = "y"
    z_name = "z"
    if grid.is_geographic:
        x_name = "lon"
        y_name = "lat"
    if grid.height.is_down:
        z_name = "depth"
    unit = grid.unit.suffix
    unit_of_height = grid.height.unit.suffix
    return f"{x_name}_{unit}", f"{y_name}_{unit}", f"{z_name}_{unit_of_height}"


def grid_angles(grid: MapGrid, axes: GridAxes) -> AngleFrame:
    """The meaning of omega, phi, kappa against a grid; ``axes`` are those at the stations."""
    convergence = None
    if axes.convergence_rad.size:
        degrees = np.degrees(axes.convergence_rad)
        convergence = (float(degrees.min()), float(degrees.max()))
    frame_axes = (f"grid {grid.axes[0]}", f"grid {grid.axes[1]}", "up")
    return replace(
        angles_of_photogrammetry(frame_axes, "each station"),
        is_convergence_applied=True,
        convergence_deg=convergence,
    )
