"""What the exports of stations have in common: which have a place, in one frame, what they show."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import unbend.geodesy as geodesy
from unbend.flight.rotations import in_turned_frame, matrices_of
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import straight_reach
from unbend.tables.exports import messages
from unbend.tables.exports.export_frames import origin_of
from unbend.tables.exports.format import FinishedRun
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
    lat, lon, h = stations.lat_rad[rows], stations.lon_rad[rows], stations.h_ellipsoid_m[rows]
    origin_deg = origin_of(lat, lon, h)
    origin = [np.radians(origin_deg[:1]), np.radians(origin_deg[1:2]), origin_deg[2:]]
    to_origin = geodesy.enu_from_ecef(*origin[:2])[0]
    axes = geodesy.enu_from_ecef(lat, lon) @ to_origin.T  # from the frame to the station's own
    horizontal = stations.sigma_horizontal_m[rows]
    sigma = np.stack([horizontal, horizontal, stations.sigma_height_m[rows]], axis=1)
    moved = geodesy.ecef_of_geodetic(lat, lon, h) - geodesy.ecef_of_geodetic(*origin)
    turned = in_turned_frame(stations.quaternion[rows], axes)
    covariance = np.swapaxes(axes, 1, 2) @ (sigma[:, :, None] ** 2 * axes)
    return OneFrame(origin_deg, to_origin, moved @ to_origin.T, turned, covariance)


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
    stations: Stations, cameras: Mapping[str, Camera], ground_m: Array, radius_m: float | None
) -> Array:
    """(s, 4, 2) longitude, latitude [deg] of the ground at the corners of each image.

    Counter-clockwise seen from above, from the upper left: straight lines through the corners, at
    the heights ``ground_m`` (s,) above sea level, NaN for none; refraction moves them by some
    metres. Longitudes go on beyond 180 degrees across that meridian. ``radius_m`` of the earth,
    None for the ellipsoid's. NaN for an image without ground, or a corner of which shows none.
    """
    corners = np.full((len(stations), 4, 2), np.nan)
    turn = matrices_of(stations.quaternion)
    height = np.where(np.isfinite(stations.h_ellipsoid_m), stations.h_ellipsoid_m, stations.h_msl_m)
    for name, camera in cameras.items():
        width, depth = camera.width_px, camera.height_px
        at = np.array([0.0, 0.0, width, width]), np.array([0.0, depth, depth, 0.0])
        u, v, _ = camera.rays(*at)
        rays = np.stack([u, v, np.ones(4)], axis=1) / np.sqrt(u * u + v * v + 1.0)[:, None]
        rows = np.flatnonzero((stations.camera == name) & (ground_m < stations.h_msl_m))
        for corner, ray in enumerate(rays):
            enu = np.einsum("nji,j->ni", turn[rows], ray)
            azimuth = np.arctan2(enu[:, 0], enu[:, 1])
            radius = radius_m or geodesy.euler_radius(stations.lat_rad[rows], azimuth)
            reach = straight_reach(
                stations.h_msl_m[rows], ground_m[rows], -enu[:, 2], radius=radius, far=False
            )
            lat, lon, _ = geodesy.offset_geodetic(
                stations.lat_rad[rows], stations.lon_rad[rows], height[rows], enu * reach[:, None]
            )
            lon = geodesy.longitudes_near(lon, stations.lon_rad[rows])
            corners[rows, corner] = np.degrees(np.stack([lon, lat], axis=1))
    corners[np.isnan(corners).any(axis=(1, 2))] = np.nan
    return corners
