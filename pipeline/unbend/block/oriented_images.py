"""Images with position and attitude from another program: their frame, and their stations."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

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
from unbend.units import Array, Integers, Mask, Names, Rows

LARGEST_FIT_TILT_RAD = np.radians(1.0)  # sigma of a fitted vertical: 5 % of R
LARGEST_FIT_RESIDUAL = 0.02  # rms, in parts of the extent of the known positions
USUAL_FIT_RESIDUAL = 0.003  # of one position, as a share of the extent ...
USUAL_FIT_SIGMAS = 5.0  # ... and in sigmas: a position beyond both is reported
FIT_OUTLIER = 4.0  # times the rms of the other positions: a position beyond contradicts them
SUSPECTS_OF_FIT = 5  # worst positions that are left out one by one: an error moves the others
FAR_M = 10_000.0  # distance from the middle of all images ...
FAR_FACTOR = 20.0  # ... and the same in median distances: an image beyond both is elsewhere
FEW_LOOK_UP = 0.1  # share of images above the horizon up to which each is flagged
USUAL_STEP = 2.0  # median steps from image to image: a longer step leads to another line
MIN_STEPS = 10  # fewer do not show the sense of angles
SAME_SENSE = 0.5  # resultant length of image minus track azimuths: above it they agree
OTHER_SENSE = 0.8  # resultant length of their sums: above it the sense is the other one

ORIENTATION = "stations.orientation"  # key of the mission file
KNOWN_POSITIONS = "stations.orientation.known_positions"

SIGMAS_OF_BLOCK = (0.3, 0.3, 0.5, *np.radians([0.02, 0.02, 0.05]))
"""East, north, up [m], tilts and yaw [rad] of adjusted stations without sigmas: judgement."""


@dataclass(frozen=True, eq=False)
class CartesianFrame:
    """A frame of x, y, z on the earth: x_ecef = origin_m + scale * ecef_from_frame @ x."""

    ecef_from_frame: Array  # (3, 3)
    origin_m: Array  # (3,) earth-centred
    scale: float = 1.0  # metres in a unit of the frame
    tilt_rad: float = 0.0  # standard deviation of the vertical of a fitted frame, else 0

    def geodetic(self, xyz: Array) -> tuple[Array, Array, Array]:
        """Latitude, longitude [rad] and ellipsoidal height [m] of (n, 3) positions."""
        ecef_m = self.origin_m + self.scale * xyz @ self.ecef_from_frame.T
        return geodetic_of_ecef(*ecef_m.T)

    def local(self, geodetic: Array) -> Array:
        """(n, 3) x, y, z of places (n, 3): latitude, longitude [rad], ellipsoidal height [m]."""
        ecef = ecef_of_geodetic(*geodetic.T)
        return (ecef - self.origin_m) @ self.ecef_from_frame / self.scale

    def local_attitude(self, quaternion: Array, lat_rad: Array, lon_rad: Array) -> Array:
        """(n, 4) quaternions from this frame to the camera as those from east, north, up.

        East, north and up are those at each place.
        """
        ecef_from_enu = enu_from_ecef(lat_rad, lon_rad).transpose(0, 2, 1)
        return in_turned_frame(quaternion, self.ecef_from_frame.T @ ecef_from_enu)


ECEF = CartesianFrame(np.eye(3), np.zeros(3))


def topocentric(origin: GeodeticOrigin) -> CartesianFrame:
    """The frame whose x, y, z are east, north and up at one place."""
    lat_rad = np.array([origin.lat_rad])
    lon_rad = np.array([origin.lon_rad])
    h_m = np.array([origin.h_ellipsoid_m])
    ecef_from_enu = enu_from_ecef(lat_rad, lon_rad)[0].T
    return CartesianFrame(ecef_from_enu, ecef_of_geodetic(lat_rad, lon_rad, h_m)[0])


def fitted_frame(
    image: Names,
    xyz: Array,
    known_image: Names,
    known: Array,
    *,
    sigma_m: float = 1.0,
) -> tuple[CartesianFrame, Notes]:
    """Fit the frame of a model to known positions (similarity of seven parameters).

    Parameters
    ----------
    image, xyz : (n,) names and (n, 3) positions in the frame of the model.
    known_image, known : (m,) names and (m, 3) latitude, longitude [rad] and ellipsoidal height [m].
    sigma_m : least standard deviation of the known coordinates; residuals may show a larger one.

    Least squares with equal weights (Umeyama 1991; the rotation by scipy's align_vectors). Refuses
    (MissionError) fewer than three images that are in both, positions on a line, and residuals of
    more than 2 % of the extent (another model, a mirrored one, other names). Warns of three
    positions; a residual above 5 sigmas and 0.3 % of the extent, and a position that contradicts
    the others, are losses.
    """
    positions = positions_of_both(image, xyz, known_image, known)
    fit = similarity_fit(positions, sigma_m)
    contradictions = contradictions_of_fit(positions, fit, sigma_m)
    kind = Kind.LOSS if contradictions else Kind.NOTE
    if positions.count == 3:
        kind = Kind.LOSS if contradictions else Kind.WARNING
        contradictions.append(
            "three positions cannot be checked: an error in one height causes no residual, and the "
            "vertical is only as accurate as the positions; give more"
        )
    made = messages.orientation_fitted(
        kind=kind,
        where=KNOWN_POSITIONS,
        count=positions.count,
        scale=fit.frame.scale,
        fit=fit.text,
        tilt_deg=np.degrees(fit.frame.tilt_rad),
        sigma_m=fit.sigma_m,
        contradictions="".join(f"; {text}" for text in contradictions),
    )
    return fit.frame, (made,)


@dataclass(frozen=True, eq=False)
class PositionsOfBoth:
    """Images that have a position in the model and a known one."""

    name: Names  # (k,)
    model: Array  # (k, 3) x, y, z in the frame of the model
    earth: Array  # (k, 3) earth-centred [m]

    @property
    def count(self) -> int:
        """How many images these are."""
        return self.name.size

    @property
    def extent_m(self) -> float:
        """Diagonal of the box around the known positions [m]."""
        return float(np.linalg.norm(np.ptp(self.earth, axis=0)))


@dataclass(frozen=True, eq=False)
class SimilarityFit:
    """A frame that was fitted to known positions."""

    frame: CartesianFrame
    residual_m: Array  # (k,) distances after the fit
    sigma_m: float  # standard deviation of a known coordinate
    text: str  # the residuals in words


def positions_of_both(
    image: Names, xyz: Array, known_image: Names, known: Array
) -> PositionsOfBoth:
    """The images with a position in the model and a known one; refuses fewer than three.

    Arguments as in `fitted_frame`.
    """
    row_of_name = {}
    for row, name in enumerate(image.tolist()):
        row_of_name[composed(name)] = row
    model_rows = []
    known_rows = []
    for known_row, name in enumerate(known_image.tolist()):
        row = row_of_name.get(composed(name), -1)
        if row < 0:
            continue
        if np.isfinite(xyz[row]).all() and np.isfinite(known[known_row]).all():
            model_rows.append(row)
            known_rows.append(known_row)
    if len(model_rows) < 3:
        raise messages.orientation_known(
            where=KNOWN_POSITIONS, usable=len(model_rows), known=known_image.size
        )
    earth = ecef_of_geodetic(*known[known_rows].T)
    return PositionsOfBoth(image[model_rows], xyz[model_rows], earth)


def similarity_fit(positions: PositionsOfBoth, sigma_m: float) -> SimilarityFit:
    """Fit a frame to all positions; refuses positions on a line, and residuals that are large.

    ``sigma_m`` is the least standard deviation of the known coordinates.
    """
    count = positions.count
    model = positions.model
    length, width, _ = np.linalg.svd(model - model.mean(axis=0), compute_uv=False)
    if width < 1e-6 * length:
        raise messages.orientation_line(
            where=KNOWN_POSITIONS, size=count, sigma=sigma_m, tilt=np.inf
        )
    frame, miss = similarity(positions, np.ones(count, np.bool_))
    residual = np.linalg.norm(miss, axis=1)
    variance = np.sum(residual**2) / (3 * count - 7)
    sigma = max(sigma_m, np.sqrt(variance))
    rms = np.sqrt(np.mean(residual**2))
    worst = positions.name[np.argmax(residual)]
    text = (
        f"residuals of {rms:.2f} m (rms) over {positions.extent_m:.0f} m, the largest "
        f"{residual.max():.2f} m at {worst}"
    )
    if rms > LARGEST_FIT_RESIDUAL * positions.extent_m:
        raise messages.orientation_fit(where=KNOWN_POSITIONS, size=count, fit=text)
    tilt = float(sigma / (frame.scale * width))
    if tilt > LARGEST_FIT_TILT_RAD:
        raise messages.orientation_line(
            where=KNOWN_POSITIONS, size=count, sigma=sigma, tilt=np.degrees(tilt)
        )
    return SimilarityFit(replace(frame, tilt_rad=tilt), residual, sigma, text)


def contradictions_of_fit(
    positions: PositionsOfBoth, fit: SimilarityFit, sigma_m: float
) -> list[str]:
    """Contradictions in words: a large residual, and a position that contradicts the others."""
    contradictions = []
    usual_m = USUAL_FIT_SIGMAS * sigma_m
    residual = fit.residual_m
    if residual.max() > max(usual_m, USUAL_FIT_RESIDUAL * positions.extent_m):
        contradictions.append(
            f"{positions.name[np.argmax(residual)]} has a larger residual than a known position "
            "should have: a wrong position, or the name of another image"
        )
    if positions.count <= 4:  # without one of four, three are left: they fit whatever they are
        return contradictions
    fits_of_others = []
    for row in np.argsort(-residual)[:SUSPECTS_OF_FIT]:
        fits_of_others.append(fit_without(positions, int(row)))
    best = min(fits_of_others)
    if best.off_m > max(usual_m, FIT_OUTLIER * best.rms_m):
        contradictions.append(
            f"without {positions.name[best.row]} the others fit within {best.rms_m:.2f} m (rms), "
            f"and it is {best.off_m:.1f} m off: another image, or a wrong position"
        )
    return contradictions


class FitWithout(NamedTuple):
    """A fit without one position. Fits compare by ``rms_m``, their first field."""

    rms_m: float  # of the positions in the fit
    off_m: float  # residual of the position that is left out
    row: int  # of this position


def fit_without(positions: PositionsOfBoth, row: int) -> FitWithout:
    """Fit all positions except that of a row."""
    is_other = np.arange(positions.count) != row
    _, miss = similarity(positions, is_other)
    miss_m = np.linalg.norm(miss, axis=1)
    rms_m = float(np.sqrt(np.mean(miss_m[is_other] ** 2)))
    return FitWithout(rms_m, float(miss_m[row]), row)


def similarity(positions: PositionsOfBoth, use: Mask) -> tuple[CartesianFrame, Array]:
    """Fit a frame to the positions of a mask ``use`` (k,).

    Returns the frame, and earth minus fitted model of all positions (k, 3) [m].
    """
    model_middle = positions.model[use].mean(axis=0)
    earth_middle = positions.earth[use].mean(axis=0)
    model = positions.model - model_middle
    earth = positions.earth - earth_middle
    rotation, _ = Rotation.align_vectors(earth[use], model[use])
    turned = rotation.apply(model)
    product = np.sum(turned[use] * earth[use])
    scale = float(product / np.sum(turned[use] ** 2))
    ecef_from_frame = rotation.as_matrix()
    origin = earth_middle - scale * ecef_from_frame @ model_middle
    return CartesianFrame(ecef_from_frame, origin, scale), earth - scale * turned


@dataclass(frozen=True, eq=False)
class OrientedImages:
    """Oriented images; (n,) arrays, NaN where unknown."""

    image: Names
    camera: Names
    time_ns: Integers
    lat_rad: Array
    lon_rad: Array
    h_m: Array
    is_msl: bool  # heights above mean sea level; False: above the ellipsoid
    quaternion: Array  # (n, 4) from east, north, up at each image to the camera (or body)
    of_body: bool  # attitudes of the body, and positions of the origin of lever arms
    sigmas: Mapping[str, Any]  # by the names of fields of `Stations`


def stations_of_images(
    images: OrientedImages, mounts: Mapping[str, Mount], heights: HeightSystem
) -> Stations:
    """Stations of oriented images.

    Attitudes of the body are turned by the mount of the camera, and positions moved by its lever
    arm. The status of a station shows a missing position, height above the sea or attitude.
    """
    lat = images.lat_rad.copy()
    lon = images.lon_rad.copy()
    h = images.h_m.copy()
    camera_quaternion = images.quaternion.copy()
    body_quaternion = images.quaternion.copy()
    for camera, mount in mounts.items():
        rows = images.camera == camera
        attitude = matrices_of(images.quaternion[rows])
        if not images.of_body:
            body_quaternion[rows] = quaternions_of(mount.camera_from_body.T @ attitude)
            continue
        camera_quaternion[rows] = quaternions_of(mount.camera_from_body @ attitude)
        arm_enu = np.einsum("nji,j->ni", attitude, np.array(mount.lever_arm_m))
        step = np.nan_to_num(arm_enu)
        lat[rows], lon[rows], h[rows] = offset_geodetic(lat[rows], lon[rows], h[rows], step)
    undulation = heights.undulation(lat, lon)
    stations = replace(
        empty_stations(images.image, images.camera, STATION_OK),
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
    no_attitude = np.asarray(np.isnan(camera_quaternion).any(axis=1))
    return stations.with_status(no_attitude, NO_ATTITUDE)


def flag_above_horizon(stations: Stations) -> tuple[Stations, Notes]:
    """Mark images with a camera that looks above the horizon as suspect.

    Refuses (MissionError) if that are more than `FEW_LOOK_UP` of them: then the cause is another.
    """
    with np.errstate(invalid="ignore"):
        up = stations.ok & (matrices_of(stations.quaternion)[:, 2, 2] > 0.0)
    count = int(up.sum())
    total = int(stations.ok.sum())
    if count == 0:
        return stations, ()
    first = str(stations.image[np.argmax(up)])
    if count > FEW_LOOK_UP * total:
        raise messages.cameras_look_up(
            where=ORIENTATION,
            count=count,
            total=total,
            first=first,
        )
    reason = np.where(up, "looks above the horizon", stations.suspect_reason)
    stations = replace(stations, suspect_reason=reason).with_status(up, SUSPECT)
    loss = messages.some_cameras_look_up(
        where=ORIENTATION,
        count=count,
        total=total,
        first=first,
    )
    return stations, (loss,)


def flag_far_images(stations: Stations, *, use: bool) -> tuple[Stations, Notes]:
    """Mark images far from all others as suspect: a position of zero, or of another flight.

    ``use`` : whether suspect stations are used all the same.
    """
    ok = stations.ok
    place = ecef_of_geodetic(stations.lat_rad, stations.lon_rad, np.zeros(stations.image.size))
    if not bool(ok.any()):
        return stations, ()
    middle = np.median(place[ok], axis=0)
    distance = np.linalg.norm(place - middle, axis=1)
    limit = max(FAR_M, FAR_FACTOR * float(np.median(distance[ok])))
    with np.errstate(invalid="ignore"):
        is_far = ok & (distance > limit)
    if not bool(is_far.any()):
        return stations, ()
    first = int(np.argmax(is_far))
    loss = messages.orientation_far(
        where=ORIENTATION,
        count=int(is_far.sum()),
        total=int(ok.sum()),
        first=stations.image[first],
        limit_km=limit / 1000.0,
        away_km=distance[first] / 1000.0,
    )
    return stations.as_suspect(is_far, "far from all others", distance, use=use), (loss,)


def refuse_turned_images(stations: Stations) -> None:
    """Refuse (MissionError) images that turn against the flight.

    The azimuth of the image minus that of the track is the same in all lines, up to quarter turns:
    it follows from mount and drift. If their sum is the same instead, kappa or yaw has the opposite
    sense, or the rotation is the inverse.
    """
    differences = []  # by camera
    sums = []
    for camera in set(stations.camera[stations.ok].tolist()):
        rows = np.flatnonzero(stations.ok & (stations.camera == camera))
        azimuth, track = azimuths_along_lines(stations, rows)
        differences.append(azimuth - track)
        sums.append(azimuth + track)
    if sum(angles.size for angles in sums) < MIN_STEPS:
        return
    if agreement(sums) > OTHER_SENSE and agreement(differences) < SAME_SENSE:
        raise messages.orientation_turns(where=ORIENTATION)


def azimuths_along_lines(stations: Stations, rows: Rows) -> tuple[Array, Array]:
    """Azimuths [rad] of the tops of images, and of the track from there to the next image.

    ``rows`` are the stations of one camera; they are sorted by time if all have one. The last image
    of a flight line is left out.
    """
    if (stations.time_ns[rows] > 0).all():
        rows = rows[np.argsort(stations.time_ns[rows], kind="stable")]
    lat = stations.lat_rad[rows]
    lon = np.unwrap(stations.lon_rad[rows])
    north = np.diff(lat)
    east = np.diff(lon) * np.cos(lat[:-1])
    step = np.hypot(north, east)
    within_line = np.zeros(0, bool)
    if step.size:
        within_line = step < USUAL_STEP * np.median(step)
    track = np.arctan2(east, north)[within_line]
    top = -matrices_of(stations.quaternion[rows])[:-1, 1][within_line]
    return np.arctan2(top[:, 0], top[:, 1]), track


def agreement(angles_of_cameras: list[Array]) -> float:
    """How well angles [rad] agree up to quarter turns: 1 if they are equal, 0 if scattered.

    It is the mean resultant length of four times the angles; the angles of each camera agree among
    themselves.
    """
    resultants = [abs(np.exp(4j * angles).sum()) for angles in angles_of_cameras]
    return float(sum(resultants) / sum(angles.size for angles in angles_of_cameras))
