"""What exports share: stations with a position, stations in one frame, footprints of images."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from unbend.flight.rotations import in_turned_frame, matrices_of
from unbend.flight.stations import Stations
from unbend.geodesy import (
    ecef_of_geodetic,
    enu_from_ecef,
    euler_radius,
    longitudes_near,
    offset_geodetic,
)
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import straight_reach
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import FinishedRun
from unbend.tables.exports.export_frames import origin_of
from unbend.units import Array, Integers, Mask


def placed_stations(run: FinishedRun, is_placed: Mask, lacking: str, ledger: Ledger) -> Integers:
    """(n,) the rows of the stations with ``is_placed`` (s,); the others are added as a loss.

    ``lacking`` : what the others do not have, for the message.
    """
    left_out_images = run.stations.image[~is_placed]
    if left_out_images.size:
        left_out = messages.stations_left_out(
            where="stations.parquet",
            count=left_out_images.size,
            lacking=lacking,
            first=left_out_images[0],
        )
        ledger.add(left_out)
    return np.flatnonzero(is_placed).astype(np.int64)


@dataclass(frozen=True, eq=False)
class StationsInFrame:
    """Stations (n,) in one frame: east, north, up at an origin, up along the ellipsoid normal.

    ``origin_deg`` (3,) : latitude, longitude [deg] and height above the ellipsoid [m] (WGS84).
    ``enu_from_ecef`` (3, 3) : rotation from earth-centred axes to the frame. ``position_m`` (n, 3),
    ``quaternion`` (n, 4) : positions in the frame, and rotations from it to the cameras; those of
    `Stations` are from the horizon of each station, which turns by 324 arcsec in 10 km.
    ``covariance_m2`` (n, 3, 3) : of the positions, NaN where a sigma is unknown.
    """

    origin_deg: Array
    enu_from_ecef: Array
    position_m: Array
    quaternion: Array
    covariance_m2: Array


def stations_in_one_frame(run: FinishedRun, rows: Integers) -> StationsInFrame:
    """The stations of some rows in the frame at the middle of their extent (`origin_of`).

    ``rows`` (n,), at least one, all with latitude, longitude and h_ellipsoid_m.
    """
    stations = run.stations
    lat = stations.lat_rad[rows]
    lon = stations.lon_rad[rows]
    h = stations.h_ellipsoid_m[rows]
    origin_deg = origin_of(lat, lon, h)
    origin_lat = np.radians(origin_deg[:1])
    origin_lon = np.radians(origin_deg[1:2])
    frame_from_ecef = enu_from_ecef(origin_lat, origin_lon)[0]
    enu_from_frame = enu_from_ecef(lat, lon) @ frame_from_ecef.T  # enu at each station
    origin_ecef = ecef_of_geodetic(origin_lat, origin_lon, origin_deg[2:])
    from_origin_ecef = ecef_of_geodetic(lat, lon, h) - origin_ecef
    horizontal = stations.sigma_horizontal_m[rows]
    vertical = stations.sigma_height_m[rows]
    sigma = np.stack([horizontal, horizontal, vertical], axis=1)
    variance = sigma[:, :, None] ** 2
    return StationsInFrame(
        origin_deg=origin_deg,
        enu_from_ecef=frame_from_ecef,
        position_m=from_origin_ecef @ frame_from_ecef.T,
        quaternion=in_turned_frame(stations.quaternion[rows], enu_from_frame),
        covariance_m2=np.swapaxes(enu_from_frame, 1, 2) @ (variance * enu_from_frame),
    )


def footprints(run: FinishedRun, ledger: Ledger) -> Array:
    """(s, 4, 2) longitude, latitude [deg] of the ground at the corners of each image.

    `ground_corners` at the heights ``run.ground_m``; NaN for unusable stations too. Usable stations
    without a footprint are a loss (EXPORT-NO-GROUND).
    """
    cameras = {name: camera.camera for name, camera in run.cameras.items()}
    ground_m = np.where(run.exposures.usable, run.ground_m, np.nan)
    corners = ground_corners(run.stations, cameras, ground_m, run.exposures.radius_m)
    is_missing = np.isnan(corners).any(axis=(1, 2))
    count = int((is_missing & run.exposures.usable).sum())
    if count:
        ledger.add(messages.footprints_missing(where="observations", count=count))
    return corners


def ground_corners(
    stations: Stations,
    cameras: Mapping[str, Camera],
    ground_m: Array,
    radius_m: float | None,
) -> Array:
    """(s, 4, 2) longitude, latitude [deg] where the corners of each image are on the ground.

    By straight rays: refraction moves them by some metres. The order is that of `corner_rays`,
    counter-clockwise seen from above. ``ground_m`` (s,) : height above sea level, NaN if unknown.
    ``radius_m`` : of the earth, None for that of the ellipsoid. Longitudes go on beyond 180 degrees
    across that meridian. All corners of an image are NaN if its ground is unknown, or a corner does
    not show the ground.
    """
    corners = np.full((len(stations), 4, 2), np.nan)
    is_above_ground = ground_m < stations.h_msl_m
    for name, camera in cameras.items():
        rows = np.flatnonzero((stations.camera == name) & is_above_ground)
        camera_from_enu = matrices_of(stations.quaternion[rows])
        for corner, ray in enumerate(corner_rays(camera)):
            direction_enu = np.einsum("nji,j->ni", camera_from_enu, ray)
            corners[rows, corner] = _places_on_ground(
                stations.rows(rows),
                direction_enu,
                ground_m[rows],
                radius_m,
            )
    is_incomplete = np.isnan(corners).any(axis=(1, 2))
    corners[is_incomplete] = np.nan
    return corners


def corner_rays(camera: Camera) -> Array:
    """(4, 3) unit vectors in the camera through the corners of an image.

    In the order upper left, lower left, lower right, upper right.
    """
    right = camera.width_px
    bottom = camera.height_px
    x_px = np.array([0.0, 0.0, right, right])
    y_px = np.array([0.0, bottom, bottom, 0.0])
    u, v, _ = camera.rays(x_px, y_px)
    length = np.sqrt(u * u + v * v + 1.0)
    return np.asarray(np.stack([u, v, np.ones(4)], axis=1) / length[:, None])


def _places_on_ground(
    stations: Stations,
    direction_enu: Array,
    ground_m: Array,
    radius_m: float | None,
) -> Array:
    """(n, 2) longitude, latitude [deg] where a straight ray of each station reaches the ground.

    NaN where it does not. ``direction_enu`` (n, 3) : unit vectors, east, north, up at the station.
    ``ground_m``, ``radius_m`` : as of `ground_corners`. Longitudes are within half a turn of the
    station's.
    """
    azimuth = np.arctan2(direction_enu[:, 0], direction_enu[:, 1])
    radius = radius_m or euler_radius(stations.lat_rad, azimuth)
    reach = straight_reach(
        stations.h_msl_m,
        ground_m,
        -direction_enu[:, 2],
        radius=radius,
        far=False,
    )
    h_ellipsoid = stations.h_ellipsoid_m
    height = np.where(np.isfinite(h_ellipsoid), h_ellipsoid, stations.h_msl_m)
    lat, lon, _ = offset_geodetic(
        stations.lat_rad,
        stations.lon_rad,
        height,
        direction_enu * reach[:, None],
    )
    lon = longitudes_near(lon, stations.lon_rad)
    return np.degrees(np.stack([lon, lat], axis=1))
