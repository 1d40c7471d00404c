"""From camera events to stations."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.flight import stations as at
from unbend.flight import trajectory
from unbend.flight.channels import Channel
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem, heights_at
from unbend.flight.mount import Mount, is_of_gimbal
from unbend.flight.rotations import NED_FROM_ENU, quaternion_products
from unbend.flight.stations import STATION_OK, Stations, empty_stations
from unbend.messages import Notes, loss
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
    n = time_ns.size
    camera = np.full(n, events.camera, dtype=object)
    stations = replace(empty_stations(events.image, camera, STATION_OK), time_ns=time_ns)
    if "position" not in roles:
        return stations.with_status(np.ones(n, bool), at.NO_POSITION)
    position, height = roles["position"], roles["height"]
    track = trajectory.track_at(position, time_ns, max_gap_s)
    h_msl, h_ellipsoid = heights_at(height, time_ns, heights, max_gap_s)
    missing = [*_not_covered(track.coverage), (np.isnan(track.lat_rad), at.NO_POSITION)]
    if "attitude" not in roles:
        return _with_first(stations, [*missing, (np.ones(n, np.bool_), at.NO_ATTITUDE)])
    turning = trajectory.attitude_at(roles["attitude"], time_ns, max_gap_s)
    attitude = turning.quaternion
    missing += _not_covered(turning.coverage)
    missing.append((np.asarray(np.isnan(attitude).any(axis=1)), at.NO_ATTITUDE))
    missing.append((np.isnan(h_msl) & np.isnan(h_ellipsoid), at.IN_GAP))
    missing.append((np.isnan(h_msl), at.HEIGHT_REFERENCE_UNKNOWN))
    stations = _with_first(stations, missing)
    bend, speed_down, sigma_bend = np.zeros((3, n))
    if height.height_column is not None:
        bends = trajectory.bend_of_heights(height, height.height_column, time_ns, max_gap_s)
        bend, speed_down, sigma_bend = bends
    # Time, and with it the sampled rates, acts along one direction: half of it on each axis.
    late = events.sigma_time_s
    of_time = np.square(late) * np.square(track.velocity_m_s).mean(axis=1)
    horizontal, _ = accuracy.positions(position, time_ns)
    _, vertical = accuracy.positions(height, time_ns)
    gimbal = is_of_gimbal(roles["attitude"].source.message)
    of_attitude = LogAccuracy() if gimbal else accuracy
    tilt, yaw = of_attitude.attitude(roles["attitude"], time_ns, track.lat_rad)
    tilt = tilt if mount.sigma_tilt_rad is None else np.full(n, mount.sigma_tilt_rad)
    yaw = yaw if mount.sigma_yaw_rad is None else np.full(n, mount.sigma_yaw_rad)
    turned = turning.rate_rad_s * np.reshape(late, (-1, 1))
    of_turn = np.square(turning.sigma_rad) + np.square(turned)
    of_track = np.square(track.sigma_m).mean(axis=1)
    of_climb = np.square(late * speed_down)
    known = np.isfinite(attitude).all(axis=1) & np.isfinite(track.lat_rad)
    stations = replace(
        stations,
        lat_rad=track.lat_rad,
        lon_rad=track.lon_rad,
        h_msl_m=h_msl + bend,
        h_ellipsoid_m=h_ellipsoid + bend,
        quaternion=_from_enu(np.where(known[:, None], attitude, np.nan), mount.camera_from_body),
        sigma_horizontal_m=np.sqrt(np.square(horizontal) + of_track + of_time),
        sigma_height_m=np.sqrt(np.square(vertical) + np.square(sigma_bend) + of_climb),
        sigma_tilt_rad=np.sqrt(np.square(tilt) + of_turn[:, :2].mean(axis=1)),
        sigma_yaw_rad=np.sqrt(np.square(yaw) + of_turn[:, 2]),
    )
    if any(mount.lever_arm_m) and known.any():
        step = np.full((n, 3), np.nan)
        ned_from_body = Rotation.from_quat(attitude[known], scalar_first=True)
        step[known] = ned_from_body.apply(np.array(mount.lever_arm_m)) @ NED_FROM_ENU
        stations = stations.moved(step)
    if "aircraft_attitude" in roles:
        attitude = trajectory.attitude_at(roles["aircraft_attitude"], time_ns, max_gap_s).quaternion
    elif gimbal:
        attitude = np.full_like(attitude, np.nan)
    stations = replace(stations, aircraft_quaternion=_from_enu(attitude, np.eye(3)))
    return with_air(stations, roles, max_gap_s)


def _with_first(stations: Stations, missing: Sequence[tuple[Mask, str]]) -> Stations:
    """Stations with the first of several statuses whose mask is True, ok without any."""
    masks, names = zip(*missing, strict=True)
    return replace(stations, status=np.select(masks, names, STATION_OK).astype(object))


def _not_covered(coverage: NDArray[np.uint8]) -> list[tuple[Mask, str]]:
    """Where a channel has a gap, or has ended."""
    outside = (coverage != trajectory.INSIDE) & (coverage != trajectory.GAP_IN_CHANNEL)
    return [(coverage == trajectory.GAP_IN_CHANNEL, at.IN_GAP), (outside, at.OUTSIDE_LOG)]


def _from_enu(attitude: Array, frame_from_body: Array) -> Array:
    """(n, 4) quaternions of v_frame = R(q) v_enu from attitudes v_ned = R(q) v_body; NaN stays."""
    frame, enu = (
        Rotation.from_matrix(matrix).as_quat() * np.ones((4, 1))
        for matrix in (frame_from_body, NED_FROM_ENU)
    )
    turns = quaternion_products(quaternion_products(frame, np.eye(4)), enu)  # linear in the middle
    found = attitude[:, [1, 2, 3, 0]] * [-1.0, -1.0, -1.0, 1.0] @ turns
    return np.where(found[:, 3:] < 0.0, -found, found)[:, [3, 0, 1, 2]]


def with_air(stations: Stations, roles: Mapping[str, Channel], max_gap_s: float) -> Stations:
    """Stations with the air that was measured outside and inside at the exposure."""

    def reading(role: str, column: str) -> Array:
        channel, time_ns = roles.get(role), stations.time_ns
        if channel is None:
            return np.full(time_ns.size, np.nan)
        return trajectory.interpolate(channel, column, time_ns, channel.gap_limit_s(max_gap_s))

    columns: dict[str, Any] = {}
    for prefix in ("", "cabin_"):
        pressure = reading(f"{prefix}pressure", "pressure_pa")
        temperature = reading(f"{prefix}temperature", "temperature_k")
        humidity = np.clip(reading(f"{prefix}humidity", "relative_humidity"), 0.0, 1.0)
        columns[f"{prefix}pressure_pa"] = pressure
        columns[f"{prefix}temperature_k"] = temperature
        columns[f"{prefix}vapour_pressure_pa"] = vapour_pressure(humidity, temperature, pressure)
    return replace(stations, **columns)


def flag_missing_aircraft_attitude(stations: Stations, camera: str) -> tuple[Stations, Notes]:
    """Mark exposures as suspect without the attitude of the aircraft that a window is fixed to."""
    missing = np.asarray(np.isnan(stations.aircraft_quaternion).any(axis=1))
    what = "no attitude of the aircraft (log.channels.aircraft_attitude): the direction of its "
    what += "window, seen from the camera, is not known"
    return mark_suspect(stations, camera, missing, "AIRCRAFT-ATTITUDE-MISSING", what)


def mark_suspect(
    stations: Stations, camera: str, missing: Mask, code: str, what: str
) -> tuple[Stations, Notes]:
    """Mark the exposures of a camera that lack something, with a loss that counts them."""
    missing = missing & (stations.camera == camera) & stations.ok
    count = int(missing.sum())
    if count == 0:
        return stations, ()
    entry = loss(code, f"{count} exposures have {what}", where=f"camera {camera}", count=count)
    return stations.as_suspect(missing, what, np.nan, use=False), (entry,)
