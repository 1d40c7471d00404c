"""From camera events to stations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.flight.channels import Array, Channel
from pipeline.flight.events import Events
from pipeline.flight.gimbals import is_of_gimbal
from pipeline.flight.heights import HeightSystem, heights_at
from pipeline.flight.mount import Mount
from pipeline.flight.stations import (
    HEIGHT_REFERENCE_UNKNOWN,
    IN_GAP,
    NO_ATTITUDE,
    NO_POSITION,
    OUTSIDE_LOG,
    STATION_OK,
    SUSPECT,
    Stations,
    empty_stations,
)
from pipeline.flight.trajectory import IN_GAP as GAP_VERDICT
from pipeline.flight.trajectory import (
    INSIDE,
    interpolate,
    interpolate_attitude,
    interpolate_position,
)
from pipeline.geodesy import offset_geodetic
from pipeline.ledger import Ledger

_NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def build_stations(
    events: Events,
    roles: Mapping[str, Channel],
    mount: Mount,
    heights: HeightSystem,
    max_gap_s: float,
) -> Stations:
    """Position, attitude and air at each exposure of one camera.

    An exposure outside the log, in a gap of it, or without position, attitude or a height above
    sea level is not invented: its status says why and its values are NaN.
    """
    n = events.time_ns.size
    camera = np.full(n, events.camera, dtype=object)
    blank = empty_stations(events.image, camera, STATION_OK)
    stations = replace(blank, time_ns=events.time_ns)
    time_ns = events.time_ns
    if "position" not in roles:
        return stations.with_status(np.ones(n, bool), NO_POSITION)
    position, height = roles["position"], roles["height"]
    lat, lon, where = interpolate_position(position, time_ns, max_gap_s)
    h_msl, h_ell = heights_at(height, time_ns, heights, max_gap_s)
    stations = _gaps(stations, where)
    stations = stations.with_status(np.isnan(lat), NO_POSITION)
    if "attitude" not in roles:
        return stations.with_status(np.ones(n, bool), NO_ATTITUDE)
    attitude, where = interpolate_attitude(roles["attitude"], time_ns, max_gap_s)
    stations = _gaps(stations, where)
    stations = stations.with_status(np.asarray(np.isnan(attitude).any(axis=1)), NO_ATTITUDE)
    no_height = np.isnan(h_msl) & np.isnan(h_ell)
    stations = stations.with_status(no_height, IN_GAP)
    stations = stations.with_status(np.isnan(h_msl), HEIGHT_REFERENCE_UNKNOWN)
    stations = replace(
        stations,
        sigma_horizontal_m=interpolate(position, "sigma_h_m", time_ns, max_gap_s),
        sigma_height_m=interpolate(height, "sigma_v_m", time_ns, max_gap_s),
    )
    stations = _oriented(stations, mount, lat, lon, h_msl, h_ell, attitude)
    if "aircraft_attitude" in roles:
        attitude, _ = interpolate_attitude(roles["aircraft_attitude"], time_ns, max_gap_s)
    elif is_of_gimbal(roles["attitude"].source.message):
        attitude = np.full_like(attitude, np.nan)
    stations = replace(stations, aircraft_quaternion=_body_from_enu(attitude))
    return _with_air(stations, roles, max_gap_s)


def _body_from_enu(attitude: Array) -> Array:
    """(n, 4) quaternions of v_body = R(q) v_enu from those of v_ned = R(q) v_body; NaN stays."""
    quaternion = np.full(attitude.shape, np.nan)
    known = np.isfinite(attitude).all(axis=1)
    if bool(known.any()):
        ned_from_body = Rotation.from_quat(attitude[known][:, [1, 2, 3, 0]])
        turn = ned_from_body.inv() * Rotation.from_matrix(_NED_FROM_ENU)
        quaternion[known] = turn.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    return quaternion


def _gaps(stations: Stations, coverage: NDArray[np.uint8]) -> Stations:
    stations = stations.with_status(coverage == GAP_VERDICT, IN_GAP)
    return stations.with_status((coverage != INSIDE) & (coverage != GAP_VERDICT), OUTSIDE_LOG)


def _oriented(
    stations: Stations,
    mount: Mount,
    lat: Array,
    lon: Array,
    h_msl: Array,
    h_ell: Array,
    attitude: Array,
) -> Stations:
    """Stations moved to the projection centre, with the camera's exterior orientation."""
    n = len(stations)
    quaternion = np.full((n, 4), np.nan)
    known = np.isfinite(attitude).all(axis=1) & np.isfinite(lat)
    lat, lon, h_msl, h_ell = lat.copy(), lon.copy(), h_msl.copy(), h_ell.copy()
    if bool(known.any()):
        ned_from_body = Rotation.from_quat(attitude[known][:, [1, 2, 3, 0]])
        camera_from_enu = (
            Rotation.from_matrix(mount.camera_from_body)
            * ned_from_body.inv()
            * Rotation.from_matrix(_NED_FROM_ENU)
        )
        quaternion[known] = camera_from_enu.as_quat(canonical=True)[:, [3, 0, 1, 2]]
        step = ned_from_body.apply(np.array(mount.lever_arm_m)) @ _NED_FROM_ENU
        # Only the difference counts here, so any height will do where the ellipsoidal is unknown.
        start = np.where(np.isfinite(h_ell[known]), h_ell[known], np.nan_to_num(h_msl[known]))
        lat[known], lon[known], end = offset_geodetic(lat[known], lon[known], start, step)
        h_msl[known] += end - start
        h_ell[known] += end - start
    return replace(
        stations,
        lat_rad=lat,
        lon_rad=lon,
        h_msl_m=h_msl,
        h_ellipsoid_m=h_ell,
        quaternion=quaternion,
    )


def _with_air(stations: Stations, roles: Mapping[str, Channel], max_gap_s: float) -> Stations:
    """Stations with the air that was measured outside and inside at the exposure."""
    columns: dict[str, Any] = {}
    for prefix in ("", "cabin_"):
        reading = {}
        for role, column in (
            ("pressure", "pressure_pa"),
            ("temperature", "temperature_k"),
            ("humidity", "relative_humidity"),
        ):
            channel = roles.get(prefix + role)
            reading[role] = (
                interpolate(channel, column, stations.time_ns, channel.gap_limit_s(max_gap_s))
                if channel is not None
                else np.full(len(stations), np.nan)
            )
        columns[f"{prefix}pressure_pa"] = reading["pressure"]
        columns[f"{prefix}temperature_k"] = reading["temperature"]
        columns[f"{prefix}vapour_pressure_pa"] = vapour_pressure(
            np.clip(reading["humidity"], 0.0, 1.0), reading["temperature"], reading["pressure"]
        )
    return replace(stations, **columns)


def flag_missing_cabin_air(stations: Stations, camera: str, ledger: Ledger) -> Stations:
    """Mark exposures of a camera behind a window whose cabin air is unknown as suspect."""
    known = np.isfinite(stations.cabin_pressure_pa) & np.isfinite(stations.cabin_temperature_k)
    return _suspect(
        stations,
        camera,
        ~known,
        "CABIN-MISSING",
        "no cabin pressure or temperature: the window cannot be corrected",
        ledger,
    )


def flag_missing_aircraft_attitude(stations: Stations, camera: str, ledger: Ledger) -> Stations:
    """Mark exposures behind a window that is fixed to the aircraft as suspect without its attitude.

    For a camera whose window has its normal in the body frame.
    """
    return _suspect(
        stations,
        camera,
        np.asarray(np.isnan(stations.aircraft_quaternion).any(axis=1)),
        "AIRCRAFT-ATTITUDE-MISSING",
        "no attitude of the aircraft (log.channels.aircraft_attitude): how its window stands "
        "before the camera is not known",
        ledger,
    )


def _suspect(
    stations: Stations, camera: str, missing: NDArray[np.bool_], code: str, what: str,
    ledger: Ledger,
) -> Stations:  # fmt: skip
    """Mark the exposures of a camera that lack something, and enter how many."""
    missing = missing & (stations.camera == camera) & stations.ok
    count = int(missing.sum())
    if count:
        ledger.loss(code, f"{count} exposures have {what}", where=f"camera {camera}", count=count)
    return stations.with_status(missing, SUSPECT)
