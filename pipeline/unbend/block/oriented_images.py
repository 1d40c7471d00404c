"""Images whose position and attitude another program has determined: their frame, and stations."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block import messages
from unbend.flight.heights import GeodeticOrigin, HeightSystem
from unbend.flight.image_names import composed
from unbend.flight.mount import Mount
from unbend.flight.rotations import in_turned_frame, matrices_of, quaternions_of
from unbend.flight.stations import (
    HEIGHT_REFERENCE_UNKNOWN,
    NO_ATTITUDE,
    NO_POSITION,
    STATION_OK,
    SUSPECT,
    Stations,
    empty_stations,
)
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef, offset_geodetic
from unbend.messages import Kind, Notes
from unbend.units import Array, Integers, Mask, Names

# A vertical that known positions determine no better than this is none (1 deg is 5 % of R).
LARGEST_FIT_TILT_RAD = np.radians(1.0)
# Residuals in parts of the extent of the known positions above which a fit is none; the largest
# one, in parts of it and in sigmas, above which it is reported; and in residuals of the others.
LARGEST_FIT_RESIDUAL, USUAL_FIT_RESIDUAL, USUAL_FIT_SIGMAS, FIT_OUTLIER = 0.02, 0.003, 5.0, 4.0
# An image beyond both, the latter in median distances from the middle, is elsewhere.
FAR_M, FAR_FACTOR = 10_000.0, 20.0
FEW_LOOK_UP = 0.1  # of so few images above the horizon each is flagged; more have another cause

SIGMAS_OF_BLOCK = (0.3, 0.3, 0.5, *np.radians([0.02, 0.02, 0.05]))
"""East, north, up [m], tilts and yaw [rad] of adjusted stations without sigmas: judgement."""


@dataclass(frozen=True, eq=False)
class CartesianFrame:
    """A frame of x, y, z on the earth: x_ecef = origin_m + scale * ecef_from_frame @ x.

    ``tilt_rad`` is the standard deviation of its vertical where it was fitted, else 0.
    """

    ecef_from_frame: Array
    origin_m: Array
    scale: float = 1.0
    tilt_rad: float = 0.0

    def geodetic(self, xyz: Array) -> tuple[Array, Array, Array]:
        """Latitude, longitude [rad] and ellipsoidal height [m] of (n, 3) positions."""
        return geodetic_of_ecef(*(self.origin_m + self.scale * xyz @ self.ecef_from_frame.T).T)

    def local(self, geodetic: Array) -> Array:
        """(n, 3) x, y, z of latitudes, longitudes [rad] and ellipsoidal heights [m]."""
        ecef = ecef_of_geodetic(*geodetic.T)
        return (ecef - self.origin_m) @ self.ecef_from_frame / self.scale

    def local_attitude(self, quaternion: Array, lat_rad: Array, lon_rad: Array) -> Array:
        """(n, 4) attitudes against this frame as those against east, north, up at each place."""
        ecef_from_enu = enu_from_ecef(lat_rad, lon_rad).transpose(0, 2, 1)
        return in_turned_frame(quaternion, self.ecef_from_frame.T @ ecef_from_enu)


ECEF = CartesianFrame(np.eye(3), np.zeros(3))


def topocentric(origin: GeodeticOrigin) -> CartesianFrame:
    """The frame whose x, y, z are east, north and up at one place."""
    place = (np.array([origin.lat_rad]), np.array([origin.lon_rad]))
    height = np.array([origin.h_ellipsoid_m])
    return CartesianFrame(enu_from_ecef(*place)[0].T, ecef_of_geodetic(*place, height)[0])


def fitted_frame(
    image: Names, xyz: Array, known_image: Names, known: Array, *, sigma_m: float = 1.0,
) -> tuple[CartesianFrame, Notes]:  # fmt: skip
    """The frame of a model, by a similarity of seven parameters through known positions.

    Parameters
    ----------
    image, xyz : (n,) names and (n, 3) positions in the frame of the model.
    known_image, known : (m,) names and (m, 3) latitude, longitude [rad] and ellipsoidal height [m].
    sigma_m : standard deviation of the known coordinates, at least: few residuals say little.

    Least squares with equal weights (Umeyama 1991; the rotation by scipy's align_vectors). Refuses
    (MissionError) fewer than three images that are in both, positions on a line, and residuals of
    more than 2 % of the extent (another model, a mirrored one, other names). Warns of three
    positions; a residual above 5 sigmas and 0.3 % of the extent, and a position that contradicts
    the others, are losses.
    """
    where = "stations.orientation.known_positions"
    names, model, earth = _positions_of_both(image, xyz, known_image, known)
    middle = model.mean(axis=0)
    spread = np.linalg.svd(model - middle, compute_uv=False)
    extent = float(np.linalg.norm(np.ptp(earth, axis=0)))
    tilt, sigma, fit = np.inf, sigma_m, ""
    if spread[1] >= 1e-6 * spread[0]:
        frame, miss = _similarity(model, earth, np.ones(names.size, np.bool_))
        residual = np.linalg.norm(miss, axis=1)
        sigma = max(sigma_m, np.sqrt(np.sum(residual**2) / (3 * names.size - 7)))
        tilt, rms = float(sigma / (frame.scale * spread[1])), np.sqrt(np.mean(residual**2))
        worst = names[np.argmax(residual)]
        fit = (f"residuals of {rms:.2f} m (rms) over {extent:.0f} m, the largest "
               f"{residual.max():.2f} m at {worst}")  # fmt: skip
        if rms > LARGEST_FIT_RESIDUAL * extent:
            raise messages.orientation_fit(where=where, size=names.size, fit=fit)
    if tilt > LARGEST_FIT_TILT_RAD:
        raise messages.orientation_line(
            where=where, size=names.size, sigma=sigma, tilt=np.degrees(tilt)
        )
    contradictions = _contradictions_of_fit(names, model, earth, residual, sigma_m)
    frame = replace(frame, tilt_rad=tilt)
    kind = Kind.LOSS if contradictions else Kind.NOTE
    if names.size == 3:
        kind = Kind.LOSS if contradictions else Kind.WARNING
        contradictions.append(
            "nothing checks three positions: an error of one height leaves no residual, and the "
            "vertical is only as good as they are; give more"
        )
    made = messages.orientation_fitted(
        kind=kind,
        where=where,
        count=names.size,
        scale=frame.scale,
        fit=fit,
        tilt_deg=np.degrees(tilt),
        sigma_m=sigma,
        contradictions="".join(f"; {text}" for text in contradictions),
    )
    return frame, (made,)


def _positions_of_both(
    image: Names, xyz: Array, known_image: Names, known: Array
) -> tuple[Names, Array, Array]:
    """Names of the images that model and known positions share, and both positions (k, 3) [m]."""
    row = {}
    for number, name in enumerate(image.tolist()):
        row[composed(name)] = number
    pairs = []
    for k, name in enumerate(known_image.tolist()):
        if composed(name) in row:
            pairs.append((row[composed(name)], k))
    usable = [(i, k) for i, k in pairs if np.isfinite(xyz[i]).all() and np.isfinite(known[k]).all()]
    if len(usable) < 3:
        where = "stations.orientation.known_positions"
        raise messages.orientation_known(where=where, usable=len(usable), known=known_image.size)
    of_model, of_earth = np.array(usable).T
    return image[of_model], xyz[of_model], ecef_of_geodetic(*known[of_earth].T)


def _contradictions_of_fit(
    names: Names, model: Array, earth: Array, residual: Array, sigma_m: float
) -> list[str]:
    """What speaks against a fit that its residuals allow."""
    contradictions, count = [], names.size
    usual, extent = USUAL_FIT_SIGMAS * sigma_m, float(np.linalg.norm(np.ptp(earth, axis=0)))
    if residual.max() > max(usual, USUAL_FIT_RESIDUAL * extent):
        contradictions.append(
            f"{names[np.argmax(residual)]} misses by more than known positions should: a wrong "
            "position, or the name of another image"
        )
    alone = []
    # Of the five that fit worst: one error moves the others. Four without one leave three.
    for k in np.argsort(-residual)[:5] if count > 4 else ():
        others = np.arange(count) != k
        miss = np.linalg.norm(_similarity(model, earth, others)[1], axis=1)
        alone.append((float(np.sqrt(np.mean(miss[others] ** 2))), float(miss[k]), int(k)))
    for rest, off, k in sorted(alone)[:1]:
        if off > max(usual, FIT_OUTLIER * rest):
            contradictions.append(
                f"without {names[k]} the others fit to {rest:.2f} m (rms), and it is "
                f"{off:.1f} m off: another image, or a wrong position"
            )
    return contradictions


def _similarity(model: Array, earth: Array, use: Mask) -> tuple[CartesianFrame, Array]:
    """The frame through some of the positions, and what all of them (n, 3) miss it by [m]."""
    middle, centre = model[use].mean(axis=0), earth[use].mean(axis=0)
    rotation, _ = Rotation.align_vectors(earth[use] - centre, model[use] - middle)
    turned = rotation.apply(model - middle)
    scale = float(np.sum(turned[use] * (earth - centre)[use]) / np.sum(turned[use] ** 2))
    matrix = rotation.as_matrix()
    frame = CartesianFrame(matrix, centre - scale * matrix @ middle, scale)
    return frame, earth - centre - scale * turned


@dataclass(frozen=True, eq=False)
class OrientedImages:
    """Oriented images against east, north, up at each; (n,) arrays, SI and radians, NaN unknown.

    ``quaternion`` (n, 4) turns to the camera, or to the body where ``of_body``: then the position
    is that of the point the lever arms count from. ``h_m`` is above the ellipsoid, or above mean
    sea level where ``is_msl``. ``sigmas`` by the names of `Stations`.
    """

    image: Names
    camera: Names
    time_ns: Integers
    lat_rad: Array
    lon_rad: Array
    h_m: Array
    is_msl: bool
    quaternion: Array
    of_body: bool
    sigmas: Mapping[str, Any]


def stations_of_images(
    images: OrientedImages, mounts: Mapping[str, Mount], heights: HeightSystem
) -> Stations:
    """Stations of oriented images; what one lacks, its height above the sea too, is its status."""
    lat, lon, h = images.lat_rad.copy(), images.lon_rad.copy(), images.h_m.copy()
    camera_quaternion, body_quaternion = images.quaternion.copy(), images.quaternion.copy()
    for camera, mount in mounts.items():
        rows = images.camera == camera
        given, camera_from_body = matrices_of(images.quaternion[rows]), mount.camera_from_body
        if not images.of_body:
            body_quaternion[rows] = quaternions_of(camera_from_body.T @ given)
            continue
        camera_quaternion[rows] = quaternions_of(camera_from_body @ given)
        step = np.nan_to_num(np.einsum("nji,j->ni", given, np.array(mount.lever_arm_m)))
        lat[rows], lon[rows], h[rows] = offset_geodetic(lat[rows], lon[rows], h[rows], step)
    undulation = heights.undulation(lat, lon)
    stations = empty_stations(images.image, images.camera, STATION_OK)
    stations = replace(
        stations,
        time_ns=images.time_ns,
        lat_rad=lat,
        lon_rad=np.mod(lon + np.pi, 2.0 * np.pi) - np.pi,
        h_msl_m=h if images.is_msl else h - undulation,
        h_ellipsoid_m=h + undulation if images.is_msl else h,
        quaternion=camera_quaternion,
        aircraft_quaternion=body_quaternion,
        **images.sigmas,
    )
    stations = stations.with_status(np.asarray(np.isnan(lat + lon + h)), NO_POSITION)
    stations = stations.with_status(np.isnan(stations.h_msl_m), HEIGHT_REFERENCE_UNKNOWN)
    unknown = np.asarray(np.isnan(camera_quaternion).any(axis=1))
    return stations.with_status(unknown, NO_ATTITUDE)


def flag_above_horizon(stations: Stations) -> tuple[Stations, Notes]:
    """Mark cameras that look above the horizon as suspect; refuses where more than few do."""
    with np.errstate(invalid="ignore"):
        up = stations.ok & (matrices_of(stations.quaternion)[:, 2, 2] > 0.0)
    count = int(up.sum())
    total = int(stations.ok.sum())
    if count == 0:
        return stations, ()
    first = str(stations.image[np.argmax(up)])
    where = "stations.orientation"
    if count > FEW_LOOK_UP * total:
        raise messages.cameras_look_up(where=where, count=count, total=total, first=first)
    reason = np.where(up, "looks above the horizon", stations.suspect_reason)
    stations = replace(stations, suspect_reason=reason).with_status(up, SUSPECT)
    suspect = messages.some_cameras_look_up(where=where, count=count, total=total, first=first)
    return stations, (suspect,)


def flag_far_images(stations: Stations, *, use: bool) -> tuple[Stations, Notes]:
    """Mark images far from all others as suspect: a position of zero, or of another flight."""
    place = ecef_of_geodetic(stations.lat_rad, stations.lon_rad, np.zeros(stations.image.size))
    if not bool(stations.ok.any()):
        return stations, ()
    distance = np.linalg.norm(place - np.median(place[stations.ok], axis=0), axis=1)
    limit = max(FAR_M, FAR_FACTOR * float(np.median(distance[stations.ok])))
    with np.errstate(invalid="ignore"):
        far = stations.ok & (distance > limit)
    if not bool(far.any()):
        return stations, ()
    first = int(np.argmax(far))
    entry = messages.orientation_far(
        where="stations.orientation",
        count=int(far.sum()),
        total=int(stations.ok.sum()),
        first=stations.image[first],
        limit_km=limit / 1000.0,
        away_km=distance[first] / 1000.0,
    )
    return stations.as_suspect(far, "far from all others", distance, use=use), (entry,)


def refuse_turned_images(stations: Stations) -> None:
    """Refuse (MissionError) images that turn against the flight.

    The angle between the sides of the image and the track is that of the mount and the drift, the
    same in all lines but for quarter turns. Where instead the sum of the two azimuths is the same,
    the sense of kappa or yaw is the other one, or the rotation is the inverse.
    """
    differences, sums = [], []
    for camera in set(stations.camera[stations.ok].tolist()):
        rows = np.flatnonzero(stations.ok & (stations.camera == camera))
        if (stations.time_ns[rows] > 0).all():
            rows = rows[np.argsort(stations.time_ns[rows], kind="stable")]
        lat, lon = stations.lat_rad[rows], np.unwrap(stations.lon_rad[rows])
        north, east = np.diff(lat), np.diff(lon) * np.cos(lat[:-1])
        step = np.hypot(north, east)
        along = step < 2.0 * np.median(step) if step.size else np.zeros(0, bool)
        track = np.arctan2(east, north)[along]
        top = -matrices_of(stations.quaternion[rows])[:-1, 1][along]
        azimuth = np.arctan2(top[:, 0], top[:, 1])
        differences.append(azimuth - track)
        sums.append(azimuth + track)
    if sum(part.size for part in sums) < 10:
        return
    # Four times the angle, in which quarter turns are none; of each camera about its own mean.
    same, against = (
        sum(abs(np.exp(4j * part).sum()) for part in parts) / sum(part.size for part in parts)
        for parts in (differences, sums)
    )
    if against > 0.8 and same < 0.5:
        raise messages.orientation_turns(where="stations.orientation")
