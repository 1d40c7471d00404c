"""From camera events to stations."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.flight import messages
from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.log_accuracy import AttitudeSigmas, LogAccuracy, PositionSigmas
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem, heights_at
from unbend.flight.interpolation import GAP_IN_CHANNEL, INSIDE, interpolate
from unbend.flight.mount import Mount, is_of_gimbal
from unbend.flight.rotations import NED_FROM_ENU, quaternion_products
from unbend.flight.stations import (
    HEIGHT_REFERENCE_UNKNOWN,
    IN_GAP,
    NO_ATTITUDE,
    NO_POSITION,
    OUTSIDE_LOG,
    STATION_OK,
    Stations,
    empty_stations,
)
from unbend.flight.trajectory import (
    Attitudes,
    HeightBend,
    Track,
    attitude_at,
    bend_of_heights,
    no_bend,
    track_at,
)
from unbend.messages import Notes
from unbend.units import Array, Mask


class ClockSigmas(NamedTuple):
    """How well the clock of the exposures agrees with those of three channels, 1 sigma [s].

    0 if both times are of one log, or both are UTC of a GNSS receiver.
    """

    position_s: float = 0.0
    height_s: float = 0.0
    attitude_s: float = 0.0


ONE_CLOCK = ClockSigmas()


def build_stations(
    events: Events,
    roles: Mapping[str, Channel],
    mount: Mount,
    heights: HeightSystem,
    max_gap_s: float,
    *,
    accuracy: LogAccuracy = LogAccuracy(),  # noqa: B008
    clocks: ClockSigmas = ONE_CLOCK,
) -> Stations:
    """Position, attitude and air at each exposure of one camera, with their sigmas.

    If an exposure is outside the log or in a gap, or position, attitude or height above sea level
    is unknown, its values are NaN, and its status is the first reason that applies. ``roles``: the
    channel of each role. ``accuracy``: of the samples of the log. ``clocks``: how well the clocks
    of exposures and channels agree.
    """
    time_ns = events.time_ns
    all_exposures = np.ones(time_ns.size, np.bool_)
    camera = np.full(time_ns.size, events.camera, dtype=object)
    stations = replace(empty_stations(events.image, camera, STATION_OK), time_ns=time_ns)
    if "position" not in roles:
        return stations.with_status(all_exposures, NO_POSITION)
    track = track_at(roles["position"], time_ns, max_gap_s)
    # The order counts: a station keeps the first status that is not ok.
    stations = _with_coverage(stations, track.coverage)
    stations = stations.with_status(np.isnan(track.lat_rad), NO_POSITION)
    if "attitude" not in roles:
        return stations.with_status(all_exposures, NO_ATTITUDE)
    attitudes = attitude_at(roles["attitude"], time_ns, max_gap_s)
    stations = _with_coverage(stations, attitudes.coverage)
    stations = stations.with_status(_unknown_rows(attitudes.quaternion), NO_ATTITUDE)
    if "height" not in roles:
        return stations.with_status(all_exposures, HEIGHT_REFERENCE_UNKNOWN)
    height = roles["height"]
    h_msl_m, h_ellipsoid_m = heights_at(height, time_ns, heights, max_gap_s)
    no_msl = np.isnan(h_msl_m)
    stations = stations.with_status(no_msl & np.isnan(h_ellipsoid_m), IN_GAP)
    # These have a height above the ellipsoid, but no undulation.
    stations = stations.with_status(no_msl, HEIGHT_REFERENCE_UNKNOWN)
    if height.height_column is None:
        bend = no_bend(time_ns.size)
    else:
        bend = bend_of_heights(height, height.height_column, time_ns, max_gap_s)
    is_complete = ~_unknown_rows(attitudes.quaternion) & np.isfinite(track.lat_rad)
    body_attitude = np.where(is_complete[:, None], attitudes.quaternion, np.nan)
    stations = replace(
        stations,
        lat_rad=track.lat_rad,
        lon_rad=track.lon_rad,
        h_msl_m=h_msl_m + bend.metres_up,
        h_ellipsoid_m=h_ellipsoid_m + bend.metres_up,
        quaternion=_from_enu(body_attitude, mount.camera_from_body),
    )
    sample_sigmas = _sigmas_of_samples(roles, time_ns, track.lat_rad, mount, accuracy)
    stations = _with_sigmas(
        stations, sample_sigmas, _Motion(track, attitudes, bend), _time_sigmas(events, clocks)
    )
    if any(mount.lever_arm_m):
        stations = stations.moved(_lever_arm_enu(body_attitude, mount))
    aircraft_attitude = _aircraft_attitude(roles, attitudes, time_ns, max_gap_s)
    stations = replace(stations, aircraft_quaternion=_from_enu(aircraft_attitude, np.eye(3)))
    return with_air(stations, roles, max_gap_s)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Position, attitude and height interpolated at the exposures, with their rates."""

    track: Track
    attitudes: Attitudes
    bend: HeightBend


def _with_coverage(stations: Stations, coverage: NDArray[np.uint8]) -> Stations:
    """Give stations the status IN_GAP or OUTSIDE_LOG by their (s,) coverage by a channel.

    ``coverage`` is as in `Bracket`. Stations that are not ok keep their status.
    """
    in_gap = coverage == GAP_IN_CHANNEL
    outside = (coverage != INSIDE) & ~in_gap
    return stations.with_status(in_gap, IN_GAP).with_status(outside, OUTSIDE_LOG)


def _unknown_rows(quaternion: Array) -> Mask:
    """(n,) True where a row of an (n, 4) quaternion has a NaN."""
    return np.asarray(np.isnan(quaternion).any(axis=1))


class _SampleSigmas(NamedTuple):
    """Sigmas of the log's samples at (n,) exposures; interpolation and motion are not included."""

    position: PositionSigmas
    height_m: Array
    attitude: AttitudeSigmas


def _sigmas_of_samples(
    roles: Mapping[str, Channel],
    time_ns: TimeArray,
    lat_rad: Array,
    mount: Mount,
    accuracy: LogAccuracy,
) -> _SampleSigmas:
    """The sigmas of positions and heights by the log, and of attitudes by the mount or the log."""
    return _SampleSigmas(
        position=accuracy.positions(roles["position"], time_ns),
        height_m=accuracy.positions(roles["height"], time_ns).height_m,
        attitude=_attitude_sigmas(roles["attitude"], time_ns, lat_rad, mount, accuracy),
    )


def _attitude_sigmas(
    channel: Channel, time_ns: TimeArray, lat_rad: Array, mount: Mount, accuracy: LogAccuracy
) -> AttitudeSigmas:
    """The sigmas of an attitude: those that the mount states, else those by the log."""
    if is_of_gimbal(channel.source.message):
        accuracy = LogAccuracy()  # the filter of the aircraft does not apply to a gimbal
    tilt, yaw = accuracy.attitude(channel, time_ns, lat_rad)
    if mount.sigma_tilt_rad is not None:
        tilt = np.full(time_ns.size, mount.sigma_tilt_rad)
    if mount.sigma_yaw_rad is not None:
        yaw = np.full(time_ns.size, mount.sigma_yaw_rad)
    return AttitudeSigmas(tilt, yaw)


class _TimeSigmas(NamedTuple):
    """Sigmas of the exposures' times on the clocks of the channels [s], one or (n,)."""

    position_s: Array
    height_s: Array
    attitude_s: Array


def _time_sigmas(events: Events, clocks: ClockSigmas) -> _TimeSigmas:
    """The sigmas of the times of exposures on the clocks of the channels."""
    return _TimeSigmas(
        position_s=np.hypot(events.sigma_time_s, clocks.position_s),
        height_s=np.hypot(events.sigma_time_s, clocks.height_s),
        attitude_s=np.hypot(events.sigma_time_s, clocks.attitude_s),
    )


def _with_sigmas(
    stations: Stations, samples: _SampleSigmas, motion: _Motion, times: _TimeSigmas
) -> Stations:
    """Stations with their sigmas.

    Each is the root of the sum of three variances: of the log's samples, of the interpolation
    between them, and of the motion within the sigma of the exposure's time. Of two level axes,
    each gets half of the variance of interpolation and motion: the mean of both components.
    """
    track = motion.track
    bend = motion.bend
    interpolation_m2 = np.square(track.sigma_m).mean(axis=1)
    square_speed = np.square(track.velocity_m_s).mean(axis=1)
    moved_m2 = np.square(times.position_s) * square_speed
    horizontal_m2 = np.square(samples.position.horizontal_m) + interpolation_m2 + moved_m2

    climbed_m2 = np.square(times.height_s * bend.speed_down_m_s)
    height_m2 = np.square(samples.height_m) + np.square(bend.sigma_m) + climbed_m2

    attitudes = motion.attitudes
    turned_rad = attitudes.rate_rad_s * np.reshape(times.attitude_s, (-1, 1))
    turn_rad2 = np.square(attitudes.sigma_rad) + np.square(turned_rad)
    tilt_rad2 = np.square(samples.attitude.tilt_rad) + turn_rad2[:, :2].mean(axis=1)
    yaw_rad2 = np.square(samples.attitude.yaw_rad) + turn_rad2[:, 2]
    return replace(
        stations,
        sigma_horizontal_m=np.sqrt(horizontal_m2),
        sigma_height_m=np.sqrt(height_m2),
        sigma_tilt_rad=np.sqrt(tilt_rad2),
        sigma_yaw_rad=np.sqrt(yaw_rad2),
    )


def _lever_arm_enu(body_attitude: Array, mount: Mount) -> Array:
    """(n, 3) east, north and up [m] from the logged position to the camera; NaN without attitude.

    ``body_attitude``: (n, 4) w, x, y, z with v_ned = R(q) v_body.
    """
    arm_enu_m = np.full((body_attitude.shape[0], 3), np.nan)
    is_known = ~_unknown_rows(body_attitude)
    if is_known.any():
        ned_from_body = Rotation.from_quat(body_attitude[is_known], scalar_first=True)
        arm_enu_m[is_known] = ned_from_body.apply(np.array(mount.lever_arm_m)) @ NED_FROM_ENU
    return arm_enu_m


def _aircraft_attitude(
    roles: Mapping[str, Channel], attitudes: Attitudes, time_ns: TimeArray, max_gap_s: float
) -> Array:
    """(n, 4) attitudes of the aircraft, w, x, y, z with v_ned = R(q) v_body.

    They are those of the role ``aircraft_attitude``, else those of the role ``attitude``, which
    ``attitudes`` has at the exposures; all NaN if these are a gimbal's.
    """
    if "aircraft_attitude" in roles:
        return attitude_at(roles["aircraft_attitude"], time_ns, max_gap_s).quaternion
    if is_of_gimbal(roles["attitude"].source.message):
        return np.full_like(attitudes.quaternion, np.nan)
    return attitudes.quaternion


def _from_enu(attitude: Array, frame_from_body: Array) -> Array:
    """(n, 4) quaternions with v_frame = R(q) v_enu, from attitudes with v_ned = R(q) v_body.

    All are w, x, y, z; rows of NaN stay NaN. ``frame_from_body`` is a (3, 3) rotation.
    """
    frame = np.tile(Rotation.from_matrix(frame_from_body).as_quat(), (4, 1))
    ned_from_enu = np.tile(Rotation.from_matrix(NED_FROM_ENU).as_quat(), (4, 1))
    # frame * q * ned_from_enu is linear in q: row k of the matrix is the product for the k-th basis
    # quaternion as q.
    matrix = quaternion_products(quaternion_products(frame, np.eye(4)), ned_from_enu)
    body_from_ned = attitude[:, [1, 2, 3, 0]] * [-1.0, -1.0, -1.0, 1.0]  # x, y, z, w; inverse
    frame_from_enu = body_from_ned @ matrix
    canonical = np.where(frame_from_enu[:, 3:] < 0.0, -frame_from_enu, frame_from_enu)
    return canonical[:, [3, 0, 1, 2]]  # w, x, y, z


def with_air(stations: Stations, roles: Mapping[str, Channel], max_gap_s: float) -> Stations:
    """Stations with the air measured at the exposures, outside and in the cabin."""

    def reading(role: str, column: str) -> Array:
        """(s,) values of a role's channel at the exposures; NaN without a channel."""
        channel = roles.get(role)
        if channel is None:
            return np.full(stations.time_ns.size, np.nan)
        return interpolate(channel, column, stations.time_ns, channel.gap_limit_s(max_gap_s))

    columns: dict[str, Any] = {}
    for prefix in ("", "cabin_"):
        pressure = reading(f"{prefix}pressure", "pressure_pa")
        temperature = reading(f"{prefix}temperature", "temperature_k")
        humidity = np.clip(reading(f"{prefix}humidity", "relative_humidity"), 0.0, 1.0)
        columns[f"{prefix}pressure_pa"] = pressure
        columns[f"{prefix}temperature_k"] = temperature
        columns[f"{prefix}vapour_pressure_pa"] = vapour_pressure(humidity, temperature, pressure)
    return replace(stations, **columns)


def with_logged_aircraft(
    stations: Stations, roles: Mapping[str, Channel], max_gap_s: float
) -> Stations:
    """Stations of oriented images with ``aircraft_quaternion`` by the role ``aircraft_attitude``.

    It is NaN where the channel has no attitude at the time of an image. Without a channel in this
    role the stations are returned unchanged.
    """
    channel = roles.get("aircraft_attitude")
    if channel is None:
        return stations
    attitude = attitude_at(channel, stations.time_ns, max_gap_s).quaternion
    return replace(stations, aircraft_quaternion=_from_enu(attitude, np.eye(3)))


NO_AIRCRAFT_ATTITUDE = (
    "no attitude of the aircraft (log.channels.aircraft_attitude): the direction of the window "
    "relative to the camera is not known"
)


def flag_missing_aircraft_attitude(stations: Stations, camera: str) -> tuple[Stations, Notes]:
    """Mark usable exposures of a camera as suspect if the attitude of the aircraft is unknown.

    Without it the direction of the aircraft's window is unknown.
    """
    is_missing = _unknown_rows(stations.aircraft_quaternion)
    stations, count = mark_suspect(stations, camera, is_missing, NO_AIRCRAFT_ATTITUDE)
    if count == 0:
        return stations, ()
    message = messages.aircraft_attitude_missing(
        camera=camera, count=count, reason=NO_AIRCRAFT_ATTITUDE
    )
    return stations, (message,)


def mark_suspect(
    stations: Stations, camera: str, is_missing: Mask, reason: str
) -> tuple[Stations, int]:
    """Mark usable exposures of a camera as suspect where ``is_missing`` (s,) is True.

    They are not usable afterwards. Returns the stations, and how many were marked.
    """
    suspect = is_missing & (stations.camera == camera) & stations.ok
    count = int(np.count_nonzero(suspect))
    if count == 0:
        return stations, 0
    return stations.as_suspect(suspect, reason, np.nan, use=False), count
