"""What the exports of stations have in common: which have a place, in one frame, what they show."""

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


def placed_stations(run: FinishedRun, known: Mask, what: str, ledger: Ledger) -> Integers:
    """(n,) the stations that are ``known`` (s,); the others are a loss, ``what`` they lack."""
    missing = run.stations.image[~known]
    if missing.size:
        left_out = messages.stations_left_out(
            where="stations.parquet", count=missing.size, lacking=what, first=missing[0]
        )
        ledger.add(left_out)
    return np.flatnonzero(known).astype(np.int64)


@dataclass(frozen=True, eq=False)
class OneFrame:
    """Stations (n,) in the frame east, north, up at ``origin_deg``, up along the ellipsoid normal.

    ``origin_deg`` (3,) latitude, longitude [deg] and height above the ellipsoid [m] (WGS84);
    ``enu_from_ecef`` (3, 3). ``position_m`` (n, 3); ``quaternion`` (n, 4) as of stations, but
    turned from the horizon of each to that of the origin: 324 arcsec in 10 km.
    ``covariance_m2`` (n, 3, 3) of the positions, NaN where a sigma is unknown.
    """

    origin_deg: Array
    enu_from_ecef: Array
    position_m: Array
    quaternion: Array
    covariance_m2: Array


def stations_in_one_frame(run: FinishedRun, rows: Integers) -> OneFrame:
    """The stations of some rows, at least one, all with latitude, longitude and h_ellipsoid_m.

    The origin is the middle of their extent, to 1e-5 degrees and one metre.
    """
    stations = run.stations
    lat = stations.lat_rad[rows]
    lon = stations.lon_rad[rows]
    h = stations.h_ellipsoid_m[rows]
    origin_deg = origin_of(lat, lon, h)
    origin_lat = np.radians(origin_deg[:1])
    origin_lon = np.radians(origin_deg[1:2])
    to_origin = enu_from_ecef(origin_lat, origin_lon)[0]
    axes = enu_from_ecef(lat, lon) @ to_origin.T  # from the frame to the station's own
    origin_ecef = ecef_of_geodetic(origin_lat, origin_lon, origin_deg[2:])
    from_origin_ecef = ecef_of_geodetic(lat, lon, h) - origin_ecef
    horizontal = stations.sigma_horizontal_m[rows]
    vertical = stations.sigma_height_m[rows]
    sigma = np.stack([horizontal, horizontal, vertical], axis=1)
    variance = sigma[:, :, None] ** 2
    return OneFrame(
        origin_deg=origin_deg,
        enu_from_ecef=to_origin,
        position_m=from_origin_ecef @ to_origin.T,
        quaternion=in_turned_frame(stations.quaternion[rows], axes),
        covariance_m2=np.swapaxes(axes, 1, 2) @ (variance * axes),
    )


def footprints(run: FinishedRun, ledger: Ledger) -> Array:
    """(s, 4, 2) longitude, latitude [deg] of the ground at the corners of each image.

    As `ground_corners` at the height ``run.ground_m``. NaN for an image without ground, or a corner
    of which shows none (ledger: EXPORT-NO-GROUND).
    """
    cameras = {name: camera.camera for name, camera in run.cameras.items()}
    ground_m = np.where(run.exposures.usable, run.ground_m, np.nan)
    corners = ground_corners(run.stations, cameras, ground_m, run.exposures.radius_m)
    without = np.isnan(corners).any(axis=(1, 2))
    count = int((without & run.exposures.usable).sum())
    if count:
        ledger.add(messages.footprints_missing(where="observations", count=count))
    return corners


def ground_corners(
    stations: Stations,
    cameras: Mapping[str, Camera],
    ground_m: Array,
    radius_m: float | None,
) -> Array:
    """(s, 4, 2) longitude, latitude [deg] of the ground at the corners of each image.

    Counter-clockwise seen from above, from the upper left: straight lines through the corners, at
    the heights ``ground_m`` (s,) above sea level, NaN for none; refraction moves them by some
    metres. Longitudes go on beyond 180 degrees across that meridian. ``radius_m`` of the earth,
    None for the ellipsoid's. NaN for an image without ground, or a corner of which shows none.
    """
    corners = np.full((len(stations), 4, 2), np.nan)
    is_above_ground = ground_m < stations.h_msl_m
    for name, camera in cameras.items():
        rows = np.flatnonzero((stations.camera == name) & is_above_ground)
        camera_from_enu = matrices_of(stations.quaternion[rows])
        for corner, ray in enumerate(corner_rays(camera)):
            corners[rows, corner] = _places_on_ground(
                stations.rows(rows),
                np.einsum("nji,j->ni", camera_from_enu, ray),
                ground_m[rows],
                radius_m,
            )
    is_incomplete = np.isnan(corners).any(axis=(1, 2))
    corners[is_incomplete] = np.nan
    return corners


def corner_rays(camera: Camera) -> Array:
    """(4, 3) unit vectors through the corners of an image, from the upper left downwards."""
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
    """(n, 2) longitude, latitude [deg] where straight rays of stations end on the ground.

    ``direction_enu`` (n, 3) of unit length; longitudes within half a turn of the station's.
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
