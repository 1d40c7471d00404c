"""From camera events to stations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.atmosphere.air import vapour_pressure
from pipeline.errors import MissionError
from pipeline.flight.channels import Channel
from pipeline.flight.heights import HeightSystem, heights_at
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

Array = NDArray[np.float64]

# A camera at rest in its mount looks down with the top of its image towards the nose: camera x is
# the body's y (right), camera y the body's -x (aft), camera z the body's z (down).
_CAMERA_FROM_REST = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Events:
    """Exposures of one camera: (m,) names and times (UTC, ns)."""

    camera: str
    image: NDArray[np.object_]
    time_ns: NDArray[np.int64]


@dataclass(frozen=True)
class Mount:
    """How a camera sits in the aircraft; angles [rad], lever arm [m] in the body frame."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def camera_from_body(self) -> Array:
        """(3, 3) rotation from the body (forward, right, down) to the camera.

        >>> looks_forward = Mount(pitch_rad=1.5707963267948966)
        >>> round(float((looks_forward.camera_from_body @ [1.0, 0.0, 0.0])[2]), 6)
        1.0
        """
        turn = Rotation.from_euler("ZYX", [self.yaw_rad, self.pitch_rad, self.roll_rad])
        return np.asarray(_CAMERA_FROM_REST @ turn.as_matrix().T)


def events_of_channel(
    channel: Channel, camera: str, pattern: str, delay_s: float, ledger: Ledger
) -> Events:
    """Exposures of an event channel, named by a pattern of ``{index}`` and ``{n}``.

    Numbers that the log skips are pulses that were lost: they go into the ledger. ``{index}`` is
    the number as the log has it, which may count modulo 65536.
    """
    index = channel["event_index"].astype(np.int64)
    names = [pattern.format(index=int(i), n=n) for n, i in enumerate(index, start=1)]
    if _report_skipped(channel, index, ledger) and "{n" in pattern:
        raise MissionError(
            "EVENTS-COUNTED",
            "the log has lost events: images counted by {n} would get the stations of others",
            where=f"events.log.{camera}, channel {channel.name}",
            remedy="name the images by {index}, or give their times in events.csv",
        )
    time_ns = channel.time_ns + round(delay_s * 1e9)
    return Events(camera, np.array(names, dtype=object), time_ns)


def events_of_table(
    image: NDArray[np.object_],
    camera_of: NDArray[Any],
    time_ns: NDArray[np.int64],
    camera: str,
    delay_s: float,
) -> Events:
    """Exposures of one camera from a table, with the offset of the table's clock taken out."""
    mine = camera_of == camera
    return Events(camera, image[mine], time_ns[mine] + round(delay_s * 1e9))


# Counts of 16 bits run over; a count that goes on farther than this from zero is one begun anew.
_COUNT_ROUND, _COUNT_NEAR = 1 << 16, 1 << 12


def counted_on(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Image numbers that count on where a number of 16 bits ran over.

    Parameters
    ----------
    index : (n,) in the order of their time, of one power-up.

    >>> counted_on(np.array([65534, 65535, 1, 2]))
    array([65534, 65535, 65537, 65538])
    """
    step = np.diff(index)
    ran_over = (step < 0) & (step + _COUNT_ROUND < _COUNT_NEAR)
    went_back = (step > 0) & (_COUNT_ROUND - step < _COUNT_NEAR)  # one of before, told late
    rounds = np.cumsum(ran_over.astype(np.int64) - went_back)
    return np.asarray(index + _COUNT_ROUND * np.append(0, rounds), np.int64)


def _report_skipped(channel: Channel, index: NDArray[np.int64], ledger: Ledger) -> int:
    """How many numbers of a power-up have no event between others; they go into the ledger."""
    lost = 0
    for boot in np.unique(channel.boot):
        counted = counted_on(index[channel.boot == boot])
        known = np.unique(counted)
        gaps = np.diff(known) - 1
        missing = int(gaps.sum())
        if missing == 0:
            continue
        lost += missing
        holes = zip(known[:-1][gaps > 0][:4].tolist(), gaps[gaps > 0][:4].tolist(), strict=True)
        first = [
            f"{_sent(low + 1)}" if gap == 1 else f"{_sent(low + 1)} to {_sent(low + gap)}"
            for low, gap in holes
        ]
        more = " ..." if np.count_nonzero(gaps) > 4 else ""
        ledger.loss(
            "EVENTS-LOST",
            f"{missing} numbers between {_sent(int(known[0]))} and {_sent(int(known[-1]))} have "
            f"no event: {', '.join(first)}{more}",
            where=channel.name if int(channel.boot[-1]) == 0 else f"{channel.name}, boot {boot}",
            count=missing,
        )
    return lost


def _sent(counted: int) -> int:
    """A counted number as the log has it."""
    return counted % _COUNT_ROUND if counted >= _COUNT_ROUND else counted


def choose_event_channel(channels: tuple[Channel, ...], name: str | None) -> Channel:
    """The event channel of a camera: the one that was named, or the only one of the best rank."""
    able = [c for c in channels if c.can_play("events")]
    candidates = [c for c in able if c.name == name] if name else able
    if candidates:
        best = [c for c in candidates if c.rank == min(c.rank for c in candidates)]
        if len(best) == 1:
            return best[0]
    there = ", ".join(f"{c.name} ({len(c)})" for c in able) or "no camera events at all"
    what = f"the log has no event channel {name!r}" if name else "which events are this camera's?"
    raise MissionError(
        "EVENTS-CHANNEL",
        f"{what}; the log has {there}",
        where="events.log",
        remedy="name one of them as channel, or give the times of the images in events.csv",
    )


def account_for_triggers(channels: tuple[Channel, ...], chosen: Channel, ledger: Ledger) -> None:
    """Say how many triggers have no shutter event, and when the events are triggers themselves."""
    triggers = [c for c in channels if c.source.message == "TRIG"]
    if chosen.source.message in ("TRIG", "CAMERA_TRIGGER") or (
        chosen.source.message == "CAM" and not triggers
    ):
        ledger.note(
            "EVENTS-TRIGGER-TIME",
            f"{chosen.name} has the times of the trigger commands, for want of a feedback pin: the "
            "shutter opens later (70 to 160 ms were measured), which events.log.<camera>.delay_s "
            "takes into account",
            where=chosen.name,
            count=len(chosen),
        )
    if chosen.source.message not in ("CAM", "CAMERA_FEEDBACK"):
        return
    own = [c for c in triggers if c.source.instance == chosen.source.instance]
    for channel in own or triggers[:1]:
        if len(channel) > len(chosen):
            ledger.loss(
                "EVENTS-LOST",
                f"{len(channel)} triggers of {channel.name}, {len(chosen)} shutter events of "
                f"{chosen.name}: {len(channel) - len(chosen)} pulses were lost, their images "
                "have no station",
                where=chosen.name,
                count=len(channel) - len(chosen),
            )


def refuse_repeated_images(events: list[Events]) -> None:
    """Refuse two exposures of one name: the observations could belong to either."""
    names = np.concatenate([e.image for e in events]) if events else np.empty(0, object)
    unique, count = np.unique(names.astype(str), return_counts=True)
    if bool((count > 1).any()):
        twice = unique[count > 1]
        raise MissionError(
            "EVENTS-REPEATED",
            f"{twice.size} image names stand for more than one exposure, for example '{twice[0]}'",
            where="events",
            remedy="give each exposure a name of its own: a pattern for each camera, or one row "
            "an image in events.csv",
        )


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


def _gaps(stations: Stations, verdict: NDArray[np.uint8]) -> Stations:
    stations = stations.with_status(verdict == GAP_VERDICT, IN_GAP)
    return stations.with_status((verdict != INSIDE) & (verdict != GAP_VERDICT), OUTSIDE_LOG)


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


def require_cabin_air(stations: Stations, camera: str, ledger: Ledger) -> Stations:
    """Mark exposures of a camera behind a window whose cabin air is unknown as suspect."""
    missing = (stations.camera == camera) & ~(
        np.isfinite(stations.cabin_pressure_pa) & np.isfinite(stations.cabin_temperature_k)
    )
    missing &= stations.ok
    if bool(missing.any()):
        ledger.loss(
            "CABIN-MISSING",
            f"{int(missing.sum())} exposures have no cabin pressure or temperature: the window "
            "cannot be corrected",
            where=f"camera {camera}",
            count=int(missing.sum()),
        )
    return stations.with_status(missing, SUSPECT)


def require_aircraft_attitude(stations: Stations, camera: str, ledger: Ledger) -> Stations:
    """Mark exposures behind a window that is fixed to the aircraft as suspect without its attitude.

    For a camera whose window has its normal in the body frame.
    """
    missing = (stations.camera == camera) & np.isnan(stations.aircraft_quaternion).any(axis=1)
    missing &= stations.ok
    if bool(missing.any()):
        ledger.loss(
            "AIRCRAFT-ATTITUDE-MISSING",
            f"{int(missing.sum())} exposures have no attitude of the aircraft: how its window "
            "stands before the camera is not known",
            where=f"camera {camera}",
            count=int(missing.sum()),
        )
    return stations.with_status(missing, SUSPECT)
