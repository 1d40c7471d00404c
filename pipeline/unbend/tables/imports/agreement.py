"""A trajectory, or the positions of camera events, against the log: time, place, height, attitude.

Values that cannot belong to the flight of the log are refused, with the correction that would make
them fit. A difference larger than the errors of autopilots is a warning or a loss.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.flight.channels import Channel
from unbend.flight.heights import HeightSystem, heights_at
from unbend.flight.rotations import ANGLE_MISTAKES, UNIT_MISTAKES
from unbend.flight.trajectory import attitude_at
from unbend.geodesy import principal_radii, wrapped
from unbend.messages import Kind, Ledger
from unbend.tables.imports import messages
from unbend.units import RADIANS, Array, Integers, Rows

_MAX_SAMPLES = 3000  # rows of the import that are compared
_MAX_GAP_S = 5.0  # of the log, across which it is interpolated
_MIN_ATTITUDES = 20  # fewer, as of a few events, do not separate one mistake from another
_NEVER_BEST_M = 1e9  # misfit of a shift that is not considered

# Seconds by which clocks are usually set wrong: leap seconds and their like, and time zones.
_SHIFTS_S = np.concatenate([np.arange(-60.0, 60.1, 0.5), 3600.0 * np.arange(-14.0, 14.1, 0.5)])


class _Limits(NamedTuple):
    """Limits of a difference: beyond the first it is a warning, beyond the second a loss."""

    warning: float
    loss: float


# The errors of autopilots are within the first limits.
_PLACE_M = _Limits(5.0, 20.0)
_HEIGHT_M = _Limits(10.0, 30.0)
_TILT_DEG = _Limits(3.0, 20.0)
_YAW_DEG = _Limits(10.0, 30.0)
_TIME_S = _Limits(0.15, 0.75)

_OTHER_FLIGHT_M = 100.0  # median distance of another place, or of another flight
_LARGE_TURN_DEG = 5.0  # difference of attitudes that needs an explanation, and that one may leave
_SMALL_TURN_DEG = 2.0  # another order of rotations differs by little where the angles are small
_ORDERS = ("ZYX", "ZXY", "YXZ", "YZX", "XYZ", "XZY")

_Correction = Callable[[Array, Array], tuple[Array, Array]]
_PLACE_MISTAKES: Mapping[str, _Correction] = {
    "with latitude and longitude exchanged": lambda lat, lon: (lon, lat),
    "with the opposite sign of the longitude": lambda lat, lon: (lat, -lon),
    "read as radians": lambda lat, lon: (lat / RADIANS["deg"], lon / RADIANS["deg"]),
    "read as degrees": lambda lat, lon: (lat * RADIANS["deg"], lon * RADIANS["deg"]),
    "read as grads": lambda lat, lon: (lat * 0.9, lon * 0.9),
}
"""Mistake about the columns of positions -> the correction of latitude and longitude [rad]."""


def compare_with_log(
    imported: Channel,
    log_channels: Mapping[str, Channel],
    heights: HeightSystem,
    ledger: Ledger,
    *,
    replaces: tuple[str, ...],
    angle_order: str = "ZYX",
) -> None:
    """Compare an imported channel with the log's own channels, and report the differences.

    ``log_channels`` are the log's channels by role: position, height, attitude. ``replaces`` are
    the roles that the import takes: height and attitude are compared only if they are among them.
    ``angle_order`` is the order of rotations by which the file's angles became attitudes.

    Refuses (MissionError) other times (TRAJECTORY-OVERLAP, TRAJECTORY-TIME), another place
    (TRAJECTORY-PLACE), heights above the other surface (TRAJECTORY-HEIGHT) and attitudes in another
    unit, sense or order (TRAJECTORY-ANGLES), where the log shows it.
    """
    position = log_channels.get("position")
    with_place = np.flatnonzero(np.isfinite(imported["lat_rad"]))
    if position is None or len(position) < 2 or with_place.size == 0:
        ledger.add(messages.trajectory_alone(where=imported.name))
        return
    sampled = np.linspace(0, with_place.size - 1, _MAX_SAMPLES).astype(int)
    rows = with_place[np.unique(sampled)]
    _compare_places(imported, rows, _Track(position), ledger)
    if "height" in replaces and "height" in log_channels:
        _compare_heights(imported, rows, log_channels["height"], heights, ledger)
    if "attitude" in replaces and "attitude" in log_channels:
        attitude = attitude_at(log_channels["attitude"], imported.time_ns[rows], _MAX_GAP_S)
        imported_quaternion = np.stack([imported[f"q_{axis}"][rows] for axis in "wxyz"], axis=1)
        _compare_attitudes(
            imported.name,
            imported_quaternion,
            attitude.quaternion,
            angle_order,
            ledger,
        )


class _Track:
    """The log's known positions as metres north and east of their middle.

    `local_m` converts other positions to the same metres; `distances` compares them by time.
    """

    def __init__(self, position: Channel) -> None:
        is_known = np.isfinite(position["lat_rad"]) & np.isfinite(position["lon_rad"])
        lat = position["lat_rad"][is_known]
        lon = position["lon_rad"][is_known]
        self.name = position.name
        self.time_ns = position.time_ns[is_known]
        self._origin_lat = float(np.median(lat))
        self._origin_lon = float(lon[lon.size // 2])
        self._seconds = (self.time_ns - self.time_ns[0]) * 1e-9
        self._local_places_m = self.local_m(lat, lon)

    def local_m(self, lat: Array, lon: Array) -> NDArray[np.complex128]:
        """(n,) north + 1j east [m] of positions [rad] from the track's middle.

        Good to a thousandth within 100 km.
        """
        meridian, vertical = principal_radii(self._origin_lat)
        north = (lat - self._origin_lat) * meridian
        east = wrapped(lon - self._origin_lon) * vertical * np.cos(self._origin_lat)
        return np.asarray(north + 1j * east)

    def distances(
        self,
        time_ns: Integers,
        places: NDArray[np.complex128],
        shift_s: float,
    ) -> Array:
        """Distance [m] of places (n,) at their times from the log's places ``shift_s`` later.

        ``places`` are those of `local_m`. The result leaves out places that are outside the log's
        time or in one of its gaps, so it may be shorter than (n,).
        """
        shifted_s = (time_ns - self.time_ns[0]) * 1e-9 + shift_s
        log_s = self._seconds
        after = np.clip(np.searchsorted(log_s, shifted_s), 1, log_s.size - 1)
        is_in_log = (shifted_s >= log_s[0]) & (shifted_s <= log_s[-1])
        is_in_gap = log_s[after] - log_s[after - 1] > _MAX_GAP_S
        is_compared = is_in_log & ~is_in_gap
        place_of_log = np.interp(shifted_s[is_compared], log_s, self._local_places_m)
        return np.asarray(np.abs(places[is_compared] - place_of_log))


@dataclass(frozen=True)
class _BestShift:
    """The shift with which a file and the log agree best: ``shift_s`` is added to the file's times.

    ``median_m`` is the median distance of the places with this shift.
    """

    shift_s: float
    median_m: float


def _best_shift(
    time_ns: Integers,
    places: NDArray[np.complex128],
    track: _Track,
) -> _BestShift:
    """The shift with the smallest median distance, near one of `_SHIFTS_S`, to a millisecond.

    A shift is considered only if it compares half as many places as the shift that compares most.
    """
    distances = [track.distances(time_ns, places, shift) for shift in _SHIFTS_S.tolist()]
    most_places = max(distance.size for distance in distances)
    min_places = max(most_places / 2, 1)

    def misfit(distance: Array) -> float:
        """Median distance [m] of the places that a shift compares."""
        return float(np.median(distance)) if distance.size >= min_places else _NEVER_BEST_M

    def misfit_of_shift(shift: float) -> float:
        return misfit(track.distances(time_ns, places, float(shift)))

    from scipy.optimize import minimize_scalar  # a fifth of a second, and few runs need it

    misfits = [misfit(distance) for distance in distances]
    coarse = _SHIFTS_S[np.argmin(misfits)]
    fine = minimize_scalar(
        misfit_of_shift,
        bounds=(coarse - 0.5, coarse + 0.5),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return _BestShift(float(fine.x), float(fine.fun))


def _compare_places(
    imported: Channel,
    rows: Rows,
    track: _Track,
    ledger: Ledger,
) -> None:
    """Report the distance from the log's positions, and the time offset that would reduce it.

    ``rows`` are the rows of ``imported`` that are compared. Refuses (MissionError) another time,
    no common time, and another place.
    """
    time_ns = imported.time_ns[rows]
    places = track.local_m(imported["lat_rad"][rows], imported["lon_rad"][rows])
    best = _best_shift(time_ns, places, track)
    distance = track.distances(time_ns, places, 0.0)
    median_m = float(np.median(distance)) if distance.size else np.inf
    is_better = best.median_m < 0.5 * median_m and median_m - best.median_m > 2.0
    is_far = median_m > _PLACE_M.warning and abs(best.shift_s) > _TIME_S.loss
    if is_better and is_far and best.median_m < _OTHER_FLIGHT_M:
        raise messages.trajectory_time(
            where=imported.name,
            shift_s=best.shift_s,
            log=track.name,
            best_m=best.median_m,
            now_m=median_m,
        )
    if distance.size == 0:
        raise messages.trajectory_overlap(
            where=imported.name,
            own=_span_text(imported.time_ns),
            log=_span_text(track.time_ns),
        )
    if median_m > _OTHER_FLIGHT_M:
        raise messages.trajectory_place(
            where=imported.name,
            away=_distance_text(median_m),
            log=track.name,
            hints=_place_hints(imported, track, median_m),
        )
    most_m = float(np.percentile(distance, 95.0))
    shift_s = abs(best.shift_s) if is_better else 0.0
    agrees = messages.trajectory_agrees(
        kind=_worst(
            _grade(max(median_m, most_m), _PLACE_M),
            _grade(shift_s, _TIME_S),
        ),
        where=imported.name,
        count=distance.size,
        log=track.name,
        median_m=median_m,
        most_m=most_m,
        shift_s=best.shift_s,
        shifted_m=best.median_m,
    )
    ledger.add(agrees)


def _place_hints(imported: Channel, track: _Track, median_m: float) -> str:
    """Text of the mistakes about the columns that would explain places far from the flight.

    ``median_m`` is the median distance without a correction; a mistake is named if its correction
    leaves less than 1 % of it. Empty without such a mistake.
    """
    hints = ""
    for mistake, correction in _PLACE_MISTAKES.items():
        lat, lon = correction(imported["lat_rad"], imported["lon_rad"])
        from_middle = np.abs(track.local_m(lat, lon))
        away_m = float(np.nanmedian(from_middle))
        if away_m < 0.01 * median_m:
            hints += f"; {mistake} it is {_distance_text(away_m)} from the centre of the flight"
    return hints


def _compare_heights(
    imported: Channel,
    rows: Rows,
    log_heights: Channel,
    heights: HeightSystem,
    ledger: Ledger,
) -> None:
    """Report the difference from the log's heights; ``rows`` of ``imported`` are compared.

    Refuses (MissionError) heights that fit the log much better above the other surface.
    """
    msl, ellipsoid = heights_at(log_heights, imported.time_ns[rows], heights, _MAX_GAP_S)
    column = imported.height_column or "h_msl_m"
    height = imported[column][rows]
    if column == "h_msl_m":
        surface = "msl"
        other_surface = "ellipsoid"
        difference = height - msl
        other_difference = height - ellipsoid
    else:
        surface = "ellipsoid"
        other_surface = "msl"
        difference = height - ellipsoid
        other_difference = height - msl
    if not np.isfinite(difference).any():
        ledger.add(messages.trajectory_height_alone(where=imported.name))
        return
    apart_m = float(np.nanmedian(difference))
    other_apart_m = np.inf
    if np.isfinite(other_difference).any():
        other_apart_m = float(np.nanmedian(other_difference))
    if abs(apart_m) > _HEIGHT_M.warning and abs(other_apart_m) < abs(apart_m) / 3.0:
        raise messages.trajectory_height(
            where=imported.name,
            apart=apart_m,
            own=log_heights.name,
            same=surface,
            by_other=other_apart_m,
            other=other_surface,
        )
    spread_m = float(np.nanpercentile(np.abs(difference - apart_m), 95.0))
    agrees = messages.trajectory_height_agrees(
        kind=_grade(max(abs(apart_m), spread_m), _HEIGHT_M),
        where=imported.name,
        count=rows.size,
        log=log_heights.name,
        apart_m=apart_m,
        spread_m=spread_m,
    )
    ledger.add(agrees)


def _compare_attitudes(
    name: str,
    imported_quaternion: Array,
    log_quaternion: Array,
    angle_order: str,
    ledger: Ledger,
) -> None:
    """Report the differences in tilt and yaw between imported attitudes and the log's.

    Both are quaternions (n, 4) w, x, y, z at the same times, NaN where unknown. Refuses
    (MissionError) attitudes that fit the log only in another unit, sense or order.
    """
    is_imported = np.isfinite(imported_quaternion).all(axis=1)
    in_both = is_imported & np.isfinite(log_quaternion).all(axis=1)
    count = int(in_both.sum())
    if count == 0:
        ledger.add(messages.trajectory_angles_alone(where=name))
        return
    imported = _rotations(imported_quaternion[in_both])
    logged = _rotations(log_quaternion[in_both])
    if count >= _MIN_ATTITUDES:
        _refuse_other_columns(name, imported, logged)
        _refuse_other_order(name, imported, logged, angle_order)
    down_imported = imported.as_matrix()[:, 2]
    down_logged = logged.as_matrix()[:, 2]
    cosine = np.sum(down_logged * down_imported, axis=1)
    tilt = np.arccos(np.clip(cosine, -1.0, 1.0))
    tilt_deg = float(np.degrees(np.median(tilt)))
    yaw_difference = imported.as_euler("ZYX")[:, 0] - logged.as_euler("ZYX")[:, 0]
    yaw_deg = float(np.degrees(np.median(wrapped(yaw_difference))))
    agrees = messages.trajectory_angles_agree(
        kind=_worst(
            _grade(tilt_deg, _TILT_DEG),
            _grade(abs(yaw_deg), _YAW_DEG),
        ),
        where=name,
        count=count,
        tilt_deg=tilt_deg,
        yaw_deg=yaw_deg,
    )
    ledger.add(agrees)


def _rotations(quaternion: Array) -> Rotation:
    """Rotations by (n, 4) quaternions w, x, y, z."""
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def _apart_deg(attitude: Rotation, logged: Rotation) -> float:
    """The angle [deg] between attitudes and the log's that nine of ten do not exceed."""
    angles = (logged.inv() * attitude).magnitude()
    return float(np.degrees(np.percentile(angles, 90.0)))


def _refuse_other_columns(name: str, imported: Rotation, logged: Rotation) -> None:
    """Refuse angles in another unit, sense or column, if correcting that makes them fit the log."""
    size_deg = _apart_deg(imported, logged)
    if size_deg <= _LARGE_TURN_DEG:
        return
    yaw, pitch, roll = imported.as_euler("ZYX").T
    for mistake, correction in (UNIT_MISTAKES | ANGLE_MISTAKES).items():
        roll_pitch_yaw = correction(roll, pitch, yaw)
        corrected = Rotation.from_euler("ZYX", np.stack(roll_pitch_yaw[::-1], axis=1))
        left_deg = _apart_deg(corrected, logged)
        if left_deg < min(_LARGE_TURN_DEG, size_deg / 3.0):
            raise messages.trajectory_angles_columns(
                where=name,
                size_deg=size_deg,
                mistake=mistake.format("roll", "pitch", "yaw"),
                left_deg=left_deg,
            )


def _refuse_other_order(
    name: str,
    imported: Rotation,
    logged: Rotation,
    angle_order: str,
) -> None:
    """Refuse angles that fit the log if they turn in another order than ``angle_order``."""
    size_deg = _apart_deg(imported, logged)
    if size_deg <= _SMALL_TURN_DEG:
        return
    sequence: Any = angle_order
    angles_of_file = imported.as_euler(sequence).T
    angle_about_axis = dict(zip(sequence, angles_of_file, strict=True))
    for order in _ORDERS:
        if order == angle_order:
            continue
        angles = np.stack([angle_about_axis[axis] for axis in order], axis=1)
        left_deg = _apart_deg(Rotation.from_euler(order, angles), logged)
        if left_deg < min(_LARGE_TURN_DEG, size_deg / 3.0):
            raise messages.trajectory_angles(
                where=name,
                size_deg=size_deg,
                order=order,
                left_deg=left_deg,
            )


_GRADES = (Kind.NOTE, Kind.WARNING, Kind.LOSS)  # by the number of limits that are exceeded


def _grade(size: float, limits: _Limits) -> Kind:
    """A note, a warning or a loss, by the limits that a difference exceeds."""
    exceeded = sum(size > limit for limit in limits)
    return _GRADES[exceeded]


def _worst(*kinds: Kind) -> Kind:
    """The most serious kind."""
    return max(kinds, key=_GRADES.index)


def _distance_text(distance: float) -> str:
    if distance > 10_000.0:
        return f"{distance / 1000.0:,.0f} km"
    return f"{distance:.0f} m"


def _span_text(time_ns: Integers) -> str:
    ends = time_ns[[0, -1]].astype("datetime64[ns]")
    first, last = ends.astype("datetime64[s]")
    return f"{first} to {last} UTC"
