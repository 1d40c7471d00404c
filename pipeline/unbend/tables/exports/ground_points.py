"""Where each observation is on the ground, and by how much the correction moved it there.

That is where the straight ray through the corrected image point reaches the ground height that the
run used. The shift leads there from where the straight ray through the measured point would land.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from unbend.flight.rotations import matrices_of
from unbend.geodesy import euler_radius, offset_geodetic, principal_radii, wrapped
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import straight_reach
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import (
    ExportFormat,
    FinishedRun,
    GridUse,
    Values,
    write_csv_stream,
)
from unbend.tables.exports.export_frames import (
    SEA_LEVEL_OF_RUN,
    WGS84_2D,
    ExportFrame,
    grid_frame,
    pixels_of_run,
)
from unbend.tables.exports.exported_block import ideal_coordinates
from unbend.tables.exports.stations_in_grid import place_columns, place_names
from unbend.tables.geodata.map_grids import MapGrid
from unbend.tables.writing import table_of
from unbend.tables.written_columns import schema_of
from unbend.units import Array, Integers, Mask

_COLUMNS = [
    "image",
    "point",
    "x_px",
    "y_px",
    "x_corrected_px",
    "y_corrected_px",
    "h_g_m",
    "status",
]
_FAR = "far_branch"  # the status of an observation at the second crossing of its height

ATTRIBUTES = ("h_g_m", "dx_px", "dy_px", "shift_x_m", "shift_y_m", "shift_m")
"""Columns of points: ground height, correction in the image, and shift on the ground, which is
along the axes of the coordinate system. They are fields of `PointsOnGround`."""


@dataclass(frozen=True, eq=False)
class RayLandings:
    """Where straight rays reach a height: (n,) latitude, longitude [rad], NaN where they do not."""

    lat_rad: Array
    lon_rad: Array


@dataclass(frozen=True, eq=False)
class PointsOnGround:
    """Observations (n,) on the ground, in the order of the run.

    ``x``, ``y`` in the unit of the grid, ``height`` in that of its heights; ``shift_x_m``,
    ``shift_y_m`` along its axes, NaN where the uncorrected ray does not land; ``h_g_m`` above sea
    level.
    """

    image: pa.ChunkedArray
    point: pa.ChunkedArray
    status: pa.ChunkedArray
    x: Array
    y: Array
    height: Array
    h_g_m: Array
    dx_px: Array
    dy_px: Array
    shift_x_m: Array
    shift_y_m: Array

    @property
    def shift_m(self) -> Array:
        """(n,) length of the shift [m]."""
        return np.hypot(self.shift_x_m, self.shift_y_m)


def ground_points(run: FinishedRun, grid: MapGrid, ledger: Ledger) -> Iterator[PointsOnGround]:
    """The observations of a run on the ground, part by part.

    Observations without a correction, a usable station or coordinates in ``grid`` are left out, and
    added as a loss after the last part.
    """
    total = 0
    written = 0
    for station, table in run.observations(_COLUMNS):
        total += table.num_rows
        points = points_of_part(run, grid, station, table)
        written += len(points.x)
        yield points
    if written < total:
        ledger.add(
            messages.points_without_place(where="observations", count=total - written, total=total)
        )


def points_of_part(
    run: FinishedRun, grid: MapGrid, station: Integers, table: pa.Table
) -> PointsOnGround:
    """The rows of a part of the observations that have coordinates on the ground.

    ``table`` has the columns `_COLUMNS`, ``station`` (m,) the row of each observation's station,
    -1 without one.
    """
    measured = [
        run.pixels.to_colmap(number_column(table, "x_px")),
        run.pixels.to_colmap(number_column(table, "y_px")),
    ]
    corrected = [
        run.pixels.to_colmap(number_column(table, "x_corrected_px")),
        run.pixels.to_colmap(number_column(table, "y_corrected_px")),
    ]
    h_g_m = number_column(table, "h_g_m")
    is_far = np.asarray(table["status"].to_pandas() == _FAR)
    apparent = landings_of_pixels(run, station, measured, h_g_m, is_far)
    true = landings_of_pixels(run, station, corrected, h_g_m, is_far)
    x, y = grid.coordinates(true.lat_rad, true.lon_rad)
    shift_x_m, shift_y_m = shifts(grid, apparent, true, (x, y), h_g_m)
    undulation = (run.stations.h_ellipsoid_m - run.stations.h_msl_m)[station]
    height = grid.height.heights(true.lat_rad, true.lon_rad, h_g_m, h_g_m + undulation)
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    kept = table.take(pa.array(rows))
    return PointsOnGround(
        image=kept["image"],
        point=kept["point"],
        status=kept["status"],
        x=x[rows],
        y=y[rows],
        height=height[rows],
        h_g_m=h_g_m[rows],
        dx_px=(corrected[0] - measured[0])[rows],
        dy_px=(corrected[1] - measured[1])[rows],
        shift_x_m=shift_x_m[rows],
        shift_y_m=shift_y_m[rows],
    )


def number_column(table: pa.Table, name: str) -> Array:
    """(n,) numbers of a column, NaN for null."""
    return np.asarray(table[name].to_numpy(), dtype=np.float64)


def landings_of_pixels(
    run: FinishedRun, station: Integers, xy_px: list[Array], h_g_m: Array, is_far: Mask
) -> RayLandings:
    """Where the straight rays through image points (n,) reach the ground heights ``h_g_m``.

    ``station`` (n,) : row of the image's station, -1 without one. ``xy_px`` : x and y in COLMAP's
    pixels. ``is_far`` (n,) : at the second crossing of the height instead of the first (status
    far_branch). NaN without a usable station.
    """
    lat = np.full(station.size, np.nan)
    lon = np.full(station.size, np.nan)
    is_seen = (station >= 0) & run.exposures.usable[station] & np.isfinite(xy_px[0] + h_g_m)
    for name, camera in run.cameras.items():
        rows = np.flatnonzero(is_seen & (run.stations.camera[station] == name))
        rays = rays_of_pixels(camera.camera, xy_px[0][rows], xy_px[1][rows])
        landings = landings_of_rays(run, station[rows], rays, h_g_m[rows], is_far[rows])
        lat[rows] = landings.lat_rad
        lon[rows] = landings.lon_rad
    return RayLandings(lat, lon)


def rays_of_pixels(camera: Camera, x_px: Array, y_px: Array) -> Array:
    """(n, 3) unit vectors in the camera through image points."""
    u, v = ideal_coordinates(camera, x_px, y_px)
    rays = np.stack([u, v, np.ones(u.size)], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def landings_of_rays(
    run: FinishedRun, station: Integers, rays: Array, h_g_m: Array, is_far: Mask
) -> RayLandings:
    """Where straight rays reach the heights ``h_g_m`` (n,) above sea level.

    ``station`` (n,) : rows of stations. ``rays`` (n, 3) : unit vectors in their cameras. ``is_far``
    (n,) : at the second crossing of the height.
    """
    stations = run.stations
    lat = stations.lat_rad[station]
    lon = stations.lon_rad[station]
    h_msl = stations.h_msl_m[station]
    h_ellipsoid = stations.h_ellipsoid_m[station]
    enu = np.einsum("nji,nj->ni", matrices_of(stations.quaternion[station]), rays)
    azimuth = np.arctan2(enu[:, 0], enu[:, 1])
    radius = run.exposures.radius_m or euler_radius(lat, azimuth)
    reach = straight_reach(h_msl, h_g_m, -enu[:, 2], radius=radius, far=is_far)
    height = np.where(np.isfinite(h_ellipsoid), h_ellipsoid, h_msl)
    ground_lat, ground_lon, _ = offset_geodetic(lat, lon, height, enu * reach[:, None])
    return RayLandings(ground_lat, ground_lon)


def shifts(
    grid: MapGrid, apparent: RayLandings, true: RayLandings, xy: tuple[Array, Array], h_g_m: Array
) -> tuple[Array, Array]:
    """(n,) shifts [m on the ground] along x and y of a map grid; else to the east and north.

    They lead from the ``apparent`` to the ``true`` landings; ``xy`` are the coordinates of the true
    ones in ``grid``. ``h_g_m`` : height above sea level. In a map grid the direction is that of the
    grid, but the length is that on the ground: the scale of the projection is divided out.
    """
    meridian, prime_vertical = principal_radii(true.lat_rad)
    lon_difference = wrapped(true.lon_rad - apparent.lon_rad)
    east = lon_difference * np.cos(true.lat_rad) * (prime_vertical + h_g_m)
    north = (true.lat_rad - apparent.lat_rad) * (meridian + h_g_m)
    if grid.is_geographic:
        return east, north
    x, y = grid.coordinates(apparent.lat_rad, apparent.lon_rad)
    along_x = xy[0] - x
    along_y = xy[1] - y
    length_in_grid = np.hypot(along_x, along_y)
    is_moved = length_in_grid > 0.0
    metres_per_unit = np.hypot(east, north) / np.where(is_moved, length_in_grid, 1.0)
    return metres_per_unit * along_x, metres_per_unit * along_y


def point_columns(grid: MapGrid, points: PointsOnGround) -> dict[str, Array]:
    """The numeric columns that are written of points: coordinates and `ATTRIBUTES`."""
    return place_columns(grid, points.x, points.y, points.height) | attributes_of(points)


def attributes_of(points: PointsOnGround) -> dict[str, Array]:
    """The columns `ATTRIBUTES` of points."""
    return {name: getattr(points, name) for name in ATTRIBUTES}


def write_points(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write a CSV with a row for each observation that `ground_points` places on the ground.

    The others are a loss in the ledger. Returns the number of rows.
    """
    grid = run.required_grid
    text = (pa.string(), "", "")  # without unit and meaning: a CSV has no place for them
    number = (pa.float64(), "", "")
    columns_of_schema = dict.fromkeys(("image", "point"), text)
    columns_of_schema |= dict.fromkeys((*place_names(grid), *ATTRIBUTES), number)
    columns_of_schema["status"] = text
    schema = schema_of(columns_of_schema, run.metadata)

    def tables() -> Iterator[pa.Table]:
        for points in ground_points(run, grid, ledger):
            columns: dict[str, object] = {**point_columns(grid, points)}
            columns["image"] = texts_of(points.image)
            columns["point"] = texts_of(points.point)
            columns["status"] = texts_of(points.status)
            yield table_of(columns, schema)

    return write_csv_stream(path, schema, tables())


def texts_of(column: pa.ChunkedArray) -> pa.Array:
    """A column as texts in one chunk; it may be a dictionary."""
    texts = column.cast(pa.string())
    return texts.combine_chunks()


def frame_of_points(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of points: coordinates in the grid, and image coordinates of the run."""
    return ExportFrame(
        positions=grid_frame(run.required_grid),
        pixels=pixels_of_run(run.pixels),
        ground_heights=SEA_LEVEL_OF_RUN,
    )


FORMATS = (
    ExportFormat(
        "points",
        "the place of each observation on the ground, with its shift there (--crs)",
        ".csv",
        write_points,
        frame_of_points,
        grid=GridUse(WGS84_2D),
    ),
)
