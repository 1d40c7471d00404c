"""From camera events to stations."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.flight import messages
from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem, heights_at
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
    GAP_IN_CHANNEL,
    INSIDE,
    Attitudes,
    HeightBend,
    Track,
    attitude_at,
    bend_of_heights,
    interpolate,
    no_bend,
    track_at,
)
from unbend.messages import Notes
from unbend.units import Array, Mask


def build_stations(
    events: Events,
    roles: Mapping[str, Channel],
    mount: Mount,
    heights: HeightSystem,
    max_gap_s: float,
    *,
    accuracy: LogAccuracy = LogAccuracy(),  # noqa: B008
) -> Stations:
    """Position, attitude and air at each exposure of one camera, with their sigmas.

    An exposure outside the log, in a gap of it, or without position, attitude or a height above
    sea level is not invented: its status gives the reason and its values are NaN. Each sigma is
    that of the log's samples by their ``accuracy``, of the interpolation between them, and of the
    exposure's time at its speed and rate of turn.
    """
    time_ns = events.time_ns
    every = np.ones(time_ns.size, np.bool_)
    camera = np.full(time_ns.size, events.camera, dtype=object)
    stations = replace(empty_stations(events.image, camera, STATION_OK), time_ns=time_ns)
    if "position" not in roles:
        return stations.with_status(every, NO_POSITION)
    track = track_at(roles["position"], time_ns, max_gap_s)
    stations = _with_coverage(stations, track.coverage)
    stations = stations.with_status(np.isnan(track.lat_rad), NO_POSITION)
    if "attitude" not in roles:
        return stations.with_status(every, NO_ATTITUDE)
    attitudes = attitude_at(roles["attitude"], time_ns, max_gap_s)
    stations = _with_coverage(stations, attitudes.coverage)
    stations = stations.with_status(_unknown_rows(attitudes.quaternion), NO_ATTITUDE)
    height = roles["height"]
    h_msl_m, h_ellipsoid_m = heights_at(height, time_ns, heights, max_gap_s)
    no_msl = np.isnan(h_msl_m)
    stations = stations.with_status(no_msl & np.isnan(h_ellipsoid_m), IN_GAP)
    stations = stations.with_status(no_msl, HEIGHT_REFERENCE_UNKNOWN)
    if height.height_column is None:
        bend = no_bend(time_ns.size)
    else:
        bend = bend_of_heights(height, height.height_column, time_ns, max_gap_s)
    placed = ~_unknown_rows(attitudes.quaternion) & np.isfinite(track.lat_rad)
    body_attitude = np.where(placed[:, None], attitudes.quaternion, np.nan)
    flown = _Flown(track, attitudes, bend)
    stations = replace(
        stations,
        lat_rad=track.lat_rad,
        lon_rad=track.lon_rad,
        h_msl_m=h_msl_m + bend.metres_up,
        h_ellipsoid_m=h_ellipsoid_m + bend.metres_up,
        quaternion=_from_enu(body_attitude, mount.camera_from_body),
    )
    stations = _with_sigmas(stations, events, flown, roles, mount, accuracy)
    if any(mount.lever_arm_m):
        stations = stations.moved(_lever_arm_enu(body_attitude, mount))
    aircraft = _aircraft_attitude(roles, attitudes, time_ns, max_gap_s)
    stations = replace(stations, aircraft_quaternion=_from_enu(aircraft, np.eye(3)))
    return with_air(stations, roles, max_gap_s)


@dataclass(frozen=True, eq=False)
class _Flown:
    """Position, attitude and height at the exposures, interpolated."""

    track: Track
    attitudes: Attitudes
    bend: HeightBend

    @property
    def variance_of_track(self) -> Array:
        """(n,) of the interpolation of places, per horizontal axis [m2]."""
        return np.asarray(np.square(self.track.sigma_m).mean(axis=1))

    @property
    def square_speed(self) -> Array:
        """(n,) per horizontal axis [m2/s2]."""
        return np.asarray(np.square(self.track.velocity_m_s).mean(axis=1))

    def variance_of_climb(self, late_s: Array | float) -> Array:
        """(n,) of heights at times of a sigma [m2]."""
        return np.asarray(np.square(late_s * self.bend.speed_down_m_s))

    def variance_of_turn(self, late_s: Array | float) -> Array:
        """(n, 3) of the interpolation of attitudes, and of times of a sigma [rad2]."""
        turned = self.attitudes.rate_rad_s * np.reshape(late_s, (-1, 1))
        return np.asarray(np.square(self.attitudes.sigma_rad) + np.square(turned))


def _with_coverage(stations: Stations, coverage: NDArray[np.uint8]) -> Stations:
    """Stations with the status of those in a gap of a channel, or beyond its ends."""
    in_gap = coverage == GAP_IN_CHANNEL
    outside = (coverage != INSIDE) & ~in_gap
    return stations.with_status(in_gap, IN_GAP).with_status(outside, OUTSIDE_LOG)


def _unknown_rows(quaternion: Array) -> Mask:
    return np.asarray(np.isnan(quaternion).any(axis=1))


def _with_sigmas(
    stations: Stations,
    events: Events,
    flown: _Flown,
    roles: Mapping[str, Channel],
    mount: Mount,
    accuracy: LogAccuracy,
) -> Stations:
    """Stations with their sigmas: of samples, of the interpolation, and of the exposure's time.

    Time, and with it the sampled rates, acts along one direction: half of it on each axis.
    """
    variance_of_time = np.square(events.sigma_time_s)
    horizontal, _ = accuracy.positions(roles["position"], events.time_ns)
    _, vertical = accuracy.positions(roles["height"], events.time_ns)
    tilt, yaw = _attitude_sigmas(
        roles["attitude"], events.time_ns, flown.track.lat_rad, mount, accuracy
    )
    variance_of_turn = flown.variance_of_turn(events.sigma_time_s)
    return replace(
        stations,
        sigma_horizontal_m=np.sqrt(
            np.square(horizontal) + flown.variance_of_track + variance_of_time * flown.square_speed
        ),
        sigma_height_m=np.sqrt(
            np.square(vertical)
            + np.square(flown.bend.sigma_m)
            + flown.variance_of_climb(events.sigma_time_s)
        ),
        sigma_tilt_rad=np.sqrt(np.square(tilt) + variance_of_turn[:, :2].mean(axis=1)),
        sigma_yaw_rad=np.sqrt(np.square(yaw) + variance_of_turn[:, 2]),
    )


def _attitude_sigmas(
    channel: Channel, time_ns: TimeArray, lat_rad: Array, mount: Mount, accuracy: LogAccuracy
) -> tuple[Array, Array]:
    """(n,) sigmas of samples of an attitude, about level axes and the vertical one [rad].

    Those that the mount states, else those of the log; its filter says nothing of a gimbal.
    """
    if is_of_gimbal(channel.source.message):
        accuracy = LogAccuracy()
    tilt, yaw = accuracy.attitude(channel, time_ns, lat_rad)
    if mount.sigma_tilt_rad is not None:
        tilt = np.full(time_ns.size, mount.sigma_tilt_rad)
    if mount.sigma_yaw_rad is not None:
        yaw = np.full(time_ns.size, mount.sigma_yaw_rad)
    return tilt, yaw


def _lever_arm_enu(body_attitude: Array, mount: Mount) -> Array:
    """(n, 3) east, north and up [m] from the position to the camera; NaN without attitude."""
    step = np.full((body_attitude.shape[0], 3), np.nan)
    known = ~_unknown_rows(body_attitude)
    if known.any():
        ned_from_body = Rotation.from_quat(body_attitude[known], scalar_first=True)
        step[known] = ned_from_body.apply(np.array(mount.lever_arm_m)) @ NED_FROM_ENU
    return step


def _aircraft_attitude(
    roles: Mapping[str, Channel], attitudes: Attitudes, time_ns: TimeArray, max_gap_s: float
) -> Array:
    """(n, 4) attitudes of the aircraft; NaN where a gimbal's is the only one."""
    if "aircraft_attitude" in roles:
        return attitude_at(roles["aircraft_attitude"], time_ns, max_gap_s).quaternion
    if is_of_gimbal(roles["attitude"].source.message):
        return np.full_like(attitudes.quaternion, np.nan)
    return attitudes.quaternion


def _from_enu(attitude: Array, frame_from_body: Array) -> Array:
    """(n, 4) quaternions of v_frame = R(q) v_enu from attitudes v_ned = R(q) v_body; NaN stays."""
    basis = np.eye(4)
    frame = np.tile(Rotation.from_matrix(frame_from_body).as_quat(), (4, 1))
    enu = np.tile(Rotation.from_matrix(NED_FROM_ENU).as_quat(), (4, 1))
    # The product is linear in the quaternion in the middle: a matrix of those of the basis.
    turns = quaternion_products(quaternion_products(frame, basis), enu)
    body_from_ned = attitude[:, [1, 2, 3, 0]] * [-1.0, -1.0, -1.0, 1.0]
    turned = body_from_ned @ turns
    canonical = np.where(turned[:, 3:] < 0.0, -turned, turned)
    return canonical[:, [3, 0, 1, 2]]


def with_air(stations: Stations, roles: Mapping[str, Channel], max_gap_s: float) -> Stations:
    """Stations with the air that was measured outside and inside at the exposure."""

    def reading(role: str, column: str) -> Array:
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


NO_AIRCRAFT_ATTITUDE = (
    "no attitude of the aircraft (log.channels.aircraft_attitude): the direction of its window, "
    "seen from the camera, is not known"
)


def flag_missing_aircraft_attitude(stations: Stations, camera: str) -> tuple[Stations, Notes]:
    """Mark exposures as suspect without the attitude of the aircraft that a window is fixed to."""
    missing = _unknown_rows(stations.aircraft_quaternion)
    stations, count = mark_suspect(stations, camera, missing, NO_AIRCRAFT_ATTITUDE)
    if count == 0:
        return stations, ()
    message = messages.aircraft_attitude_missing(
        camera=camera, count=count, reason=NO_AIRCRAFT_ATTITUDE
    )
    return stations, (message,)


def mark_suspect(
    stations: Stations, camera: str, missing: Mask, reason: str
) -> tuple[Stations, int]:
    """Mark the exposures of a camera that lack something; returns how many there are."""
    suspect = missing & (stations.camera == camera) & stations.ok
    count = int(np.count_nonzero(suspect))
    if count == 0:
        return stations, 0
    return stations.as_suspect(suspect, reason, np.nan, use=False), count
