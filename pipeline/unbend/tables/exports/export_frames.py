"""The frame of an export as values: what a program must know to read the exported file.

Positions, angles and image coordinates each have a frame of their own, None where the format has
none of them. `frame_record` writes them as plain values, for the JSON of an export.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from unbend.flight.stations import Stations
from unbend.geodesy import longitudes_near
from unbend.tables.geodata.map_grids import GridAxes, MapGrid
from unbend.tables.pixels import PixelSystem
from unbend.units import Array, Mask

WGS84_2D = "EPSG:4326"
WGS84_3D = "EPSG:4979"
ELLIPSOID_OF_WGS84 = "ellipsoid of WGS 84"
SEA_LEVEL_OF_RUN = "mean sea level, as in the run"

EAST_NORTH_UP = ("east", "north", "up")
LONGITUDE_LATITUDE_HEIGHT = ("longitude", "latitude", "height")
LATITUDE_LONGITUDE_HEIGHT = ("latitude", "longitude", "height")

PHOTOGRAMMETRIC_AXES = ("right", "up", "backward")
"""Directions of a camera's x, y and z, seen by the camera, in photogrammetry."""

COMPUTER_VISION_AXES = ("right", "down", "forward")
"""Directions of a camera's x, y and z in COLMAP, Pix4D, OpenSfM and in our own results."""


@dataclass(frozen=True)
class Origin:
    """Where a topocentric frame has its origin: on WGS 84, height above the ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    h_ellipsoid_m: float


@dataclass(frozen=True)
class PositionFrame:
    """What positions count from.

    ``kind`` : geographic, projected or topocentric. ``crs``, ``crs_name``, ``crs_wkt`` : EPSG code,
    name and WKT (ISO 19162) of the system; null where it has none. ``axes`` : the coordinates in
    the order in which they are written; ``axis_order_of_crs`` as the system itself defines them.
    ``units`` : of ``axes``. ``operation`` : how they were brought there from WGS 84.
    """

    kind: str
    axes: tuple[str, ...]
    units: tuple[str, ...]
    height_reference: str | None
    crs: str | None = None
    crs_name: str | None = None
    crs_wkt: str | None = None
    axis_order_of_crs: tuple[str, ...] | None = None
    operation: str | None = None
    origin: Origin | None = None


@dataclass(frozen=True)
class AngleFrame:
    """What orientations mean.

    ``written_as`` : omega_phi_kappa, quaternion_wxyz, rotation_matrix, rotation_vector. ``turns`` :
    from which axes to which, as "camera to frame". ``product`` : of the elementary rotations.
    ``frame_axes`` : directions of the frame's axes; up is the normal of the ellipsoid at
    ``frame_at``, that is "each station", or the "origin" of the positions. ``convergence_deg`` :
    lowest and highest azimuth of grid north; ``is_convergence_applied`` : kappa counts from there.
    """

    written_as: str
    turns: str
    camera_axes: tuple[str, str, str]
    frame_axes: tuple[str, str, str]
    frame_at: str
    unit: str | None = None
    product: str | None = None
    is_convergence_applied: bool = False
    convergence_deg: tuple[float, float] | None = None


@dataclass(frozen=True)
class ScaleOfGrid:
    """Scale of a grid at the stations, lowest and highest: its length of a metre on the ellipsoid.

    x and y contain the scale; ``is_in_heights``, ``is_in_principal_distance`` : heights or
    principal distances contain it too. A program that takes the grid for a Cartesian frame needs
    the scale in one of these two, or a correction of its own.
    """

    lowest: float
    highest: float
    is_in_heights: bool = False
    is_in_principal_distance: bool = False


@dataclass(frozen=True)
class PixelFrame:
    """What image coordinates mean: their origin in the image, directions of x and y, unit."""

    origin: str
    axes: tuple[str, str]
    unit: str


CORNER_PIXELS = PixelFrame("corner of the upper left pixel", ("right", "down"), "px")
CENTRE_PIXELS = PixelFrame("centre of the upper left pixel", ("right", "down"), "px")


@dataclass(frozen=True)
class ExportFrame:
    """The frames of an export, None for what the format does not have.

    ``ground_heights`` : what the heights of the ground in it count from.
    """

    positions: PositionFrame | None = None
    angles: AngleFrame | None = None
    scale: ScaleOfGrid | None = None
    pixels: PixelFrame | None = None
    ground_heights: str | None = None


def frame_record(frame: ExportFrame) -> Mapping[str, Any]:
    """The frame as plain values; keys for what the format does not have are null."""
    return asdict(frame)


def pixels_of_run(pixels: PixelSystem) -> PixelFrame:
    """The frame of a run's image coordinates, which are in the system of its observations."""
    return CENTRE_PIXELS if pixels.origin == "centre" else CORNER_PIXELS


def geographic_frame(
    height_reference: str, axes: tuple[str, str, str] = LONGITUDE_LATITUDE_HEIGHT
) -> PositionFrame:
    """The frame of positions on WGS 84, written in the order of ``axes``.

    ``height_reference`` : what their heights count from, in words.
    """
    return PositionFrame(
        kind="geographic",
        axes=axes,
        units=("deg", "deg", "m"),
        height_reference=height_reference,
        crs=WGS84_3D if height_reference == ELLIPSOID_OF_WGS84 else WGS84_2D,
        crs_name="WGS 84",
        axis_order_of_crs=LATITUDE_LONGITUDE_HEIGHT,
    )


def grid_frame(grid: MapGrid) -> PositionFrame:
    """The frame of positions that are written in the coordinate system ``grid``."""
    axes = ("longitude", "latitude") if grid.is_geographic else grid.axes
    return PositionFrame(
        kind="geographic" if grid.is_geographic else "projected",
        axes=(*axes, "depth" if grid.height.is_down else "height"),
        units=(grid.unit.suffix, grid.unit.suffix, grid.height.unit.suffix),
        height_reference=grid.height.name,
        crs=grid.identifier or None,
        crs_name=grid.name,
        crs_wkt=grid.wkt,
        axis_order_of_crs=grid.axis_order,
        operation=grid.operation,
    )


def topocentric_frame(origin_deg: Array | None) -> PositionFrame:
    """The frame east, north, up at an origin; None if no station gives one.

    ``origin_deg`` (3,): latitude, longitude [deg], ellipsoidal height [m].
    """
    origin = None
    if origin_deg is not None:
        origin = Origin(*(float(value) for value in origin_deg))
    return PositionFrame(
        kind="topocentric",
        axes=EAST_NORTH_UP,
        units=("m", "m", "m"),
        height_reference="origin; the plane is level there, without earth curvature",
        origin=origin,
    )


def angles_of_photogrammetry(frame_axes: tuple[str, str, str], frame_at: str) -> AngleFrame:
    """The meaning of omega, phi, kappa [deg] that turn from the camera to a frame.

    ``frame_axes``, ``frame_at`` : as in `AngleFrame`.
    """
    return AngleFrame(
        written_as="omega_phi_kappa",
        turns="camera to frame",
        product="Rx(omega) Ry(phi) Rz(kappa)",
        camera_axes=PHOTOGRAMMETRIC_AXES,
        frame_axes=frame_axes,
        frame_at=frame_at,
        unit="deg",
    )


def angles_of_block(written_as: str, camera_axes: tuple[str, str, str]) -> AngleFrame:
    """The meaning of orientations that turn from the frame of a block to the camera.

    ``written_as``, ``camera_axes`` : as in `AngleFrame`.
    """
    return AngleFrame(
        written_as=written_as,
        turns="frame to camera",
        camera_axes=camera_axes,
        frame_axes=EAST_NORTH_UP,
        frame_at="origin",
    )


def scale_of_grid(axes: GridAxes) -> ScaleOfGrid | None:
    """The lowest and highest scale of a grid at the places of ``axes``; None without a place."""
    if axes.scale.size == 0:
        return None
    return ScaleOfGrid(float(np.min(axes.scale)), float(np.max(axes.scale)))


def can_be_placed(stations: Stations) -> Mask:
    """(s,) which stations are usable and have position, ellipsoidal height and attitude."""
    position = stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m
    is_known = np.isfinite([*stations.quaternion.T, *position]).all(axis=0)
    return np.asarray(stations.ok & is_known)


def origin_of(lat_rad: Array, lon_rad: Array, h_ellipsoid_m: Array) -> Array:
    """(3,) latitude, longitude [deg] and height [m] of the middle of the extent of (n,) places.

    Rounded to 1e-5 degrees and one metre. The places may be on both sides of the 180th meridian.
    """
    near_first_rad = longitudes_near(lon_rad, lon_rad[0])
    values_and_digits = (
        (np.degrees(lat_rad), 5),
        (np.degrees(near_first_rad), 5),
        (h_ellipsoid_m, 0),
    )
    middle = []
    for values, digits in values_and_digits:
        middle.append(round(0.5 * (float(values.min()) + float(values.max())), digits))
    return np.array(middle)


def block_positions(stations: Stations) -> PositionFrame:
    """The frame of a block's positions: east, north, up at the middle of its placed stations."""
    rows = np.flatnonzero(can_be_placed(stations))
    if rows.size == 0:
        return topocentric_frame(None)
    return topocentric_frame(
        origin_of(stations.lat_rad[rows], stations.lon_rad[rows], stations.h_ellipsoid_m[rows])
    )
