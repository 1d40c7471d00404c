"""Applanix SBET (17 little-endian doubles a row) and its standard deviations, smrmsg (10 doubles).

A row is: seconds of the week; latitude, longitude [rad]; height [m]; velocities x, y, z [m/s];
roll, pitch, platform heading, wander angle [rad]; accelerations [m/s2]; body rates [rad/s]. Of
smrmsg: seconds of the week; sigmas north, east, down [m], of the velocities [m/s], of roll, pitch
and heading [arcmin].
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.errors import InputError
from unbend.flight.channels import Channel
from unbend.geodesy import principal_radii, wrapped
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated, channel_of_rows
from unbend.units import ARCSEC, Array, Mask, measured

FASTEST_M_S = 700.0  # no aircraft that takes pictures flies faster
SECONDS_OF_WEEKS = 3 * 604_800.0  # a file may count on for some weeks
LARGEST_CLIMB_MISFIT_M_S = 0.3  # of vertical velocities that are those of the heights
MOST_BACKWARD_ROWS = 0.01  # part of the rows; more of them are no times
LARGEST_ANGLES_RAD = np.array([1.0, 0.51, 2.0, 2.0]) * np.pi  # roll, pitch, heading, wander angle
LARGEST_SMRMSG = 1e5  # of any sigma of a smrmsg
_ROW = 17
_SIGMA_ROW = 10
_ARCMIN = 60.0 * ARCSEC
_FEWEST_ROWS = 3
_MOVING_M_S = 2.0
_LEAST_WANDER_RAD = np.radians(0.05)  # less does not matter for any camera

TIME = 0
LATITUDE = 1
LONGITUDE = 2
HEIGHT = 3
VELOCITY_X = 4
VELOCITY_Y = 5
VELOCITY_Z = 6
ROLL = 7
PITCH = 8
PLATFORM_HEADING = 9
WANDER_ANGLE = 10
BODY_RATES = slice(14, 17)
"""Columns of an SBET."""

Velocity = NDArray[np.complex128]  # north + 1j east [m/s]


def read_sbet(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Position, velocity, attitude and body rates of an SBET, sigmas of its smrmsg.

    The true heading is platform heading minus wander angle by POSPac's convention; on each file
    both signs are tried. Velocities and rates that contradict positions and attitude are left out.
    """
    rows = _sbet_rows(path, ledger)
    time_system = stated.system_of(path, ledger)
    time_ns = stated.utc_of_week_seconds(path, rows[:, TIME], time_system)
    order = np.argsort(time_ns, kind="stable")
    rows = rows[order]
    time_ns = time_ns[order]
    seconds = (time_ns - time_ns[0]) * 1e-9
    height_column = stated.height_column(path, ledger)
    columns = {
        "lat_rad": rows[:, LATITUDE],
        "lon_rad": wrapped(rows[:, LONGITUDE]),
        height_column: rows[:, HEIGHT],
    }
    sign, velocity = wander_sign(path, seconds, rows, ledger)
    if velocity is not None:
        columns |= _velocity_columns(seconds, rows, velocity)
    columns |= _attitude_columns(seconds, rows, sign)
    if stated.accuracy is not None:
        columns |= _smrmsg_sigmas(stated.accuracy, rows[:, TIME])
    return channel_of_rows(
        path,
        "SBET",
        time_ns,
        columns,
        ledger,
        readable=np.ones(time_ns.shape, np.bool_),
    )


def _velocity_columns(
    seconds: Array,
    rows: Array,
    velocity: Velocity,
) -> dict[str, Array]:
    """Horizontal velocities; the vertical one, with its sign, where the heights confirm it."""
    columns = {
        "v_north_m_s": velocity.real,
        "v_east_m_s": velocity.imag,
    }
    vertical = rows[:, VELOCITY_Z]
    with np.errstate(all="ignore"):  # times may repeat
        climb = np.gradient(rows[:, HEIGHT], seconds)
    misfit_upwards = np.median(np.abs(climb - vertical))
    misfit_downwards = np.median(np.abs(climb + vertical))
    if min(misfit_upwards, misfit_downwards) < LARGEST_CLIMB_MISFIT_M_S:
        is_down = misfit_downwards <= misfit_upwards
        columns["v_down_m_s"] = vertical * (1.0 if is_down else -1.0)
    return columns


def _attitude_columns(
    seconds: Array,
    rows: Array,
    sign: float,
) -> dict[str, Array]:
    """Quaternions, and the body rates where the attitudes turn as they say.

    ``sign`` is that of the wander angle in the true heading.
    """
    heading = rows[:, PLATFORM_HEADING] + sign * rows[:, WANDER_ANGLE]
    angles = np.stack(
        [heading, rows[:, PITCH], rows[:, ROLL]],
        axis=1,
    )
    attitude = Rotation.from_euler("ZYX", angles)
    quaternion = attitude.as_quat(canonical=True)
    columns = {
        "q_x": quaternion[:, 0],
        "q_y": quaternion[:, 1],
        "q_z": quaternion[:, 2],
        "q_w": quaternion[:, 3],
    }
    turns = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    steps_s = np.maximum(np.diff(seconds), 1e-4)
    rates = turns / steps_s[:, None]
    rates_of_file = rows[:, BODY_RATES]
    rates_between = (rates_of_file[:-1] + rates_of_file[1:]) / 2.0
    misfit = np.median(np.abs(rates - rates_between))
    if misfit < 0.5 * np.median(np.abs(rates)):
        columns["rate_x_rad_s"] = rates_of_file[:, 0]
        columns["rate_y_rad_s"] = rates_of_file[:, 1]
        columns["rate_z_rad_s"] = rates_of_file[:, 2]
    return columns


def _doubles(content: bytes, width: int, kind: str = "<f8") -> Array:
    """The whole rows of a file."""
    rows = len(content) // (8 * width)
    numbers = np.frombuffer(content, kind, rows * width)
    return numbers.reshape(-1, width).astype(np.float64)


def _sbet_rows(path: Path, ledger: Ledger) -> Array:
    """(n, 17) rows; refuses what is no SBET with what it is instead."""
    content = path.read_bytes()
    rows = _doubles(content, _ROW)
    refusal = _refusal_of(path, rows)
    if refusal is not None:
        if _refusal_of(path, _doubles(content, _ROW, ">f8")) is None:
            raise messages.sbet_big_endian(where=path)
        if _are_sigmas(_doubles(content, _SIGMA_ROW)):
            raise messages.sbet_is_smrmsg(where=path)
        raise refusal
    bytes_left = len(content) % (8 * _ROW)
    if bytes_left:
        cut = messages.file_cut(
            where=path.name,
            count=bytes_left,
            row=8 * _ROW,
            rows=len(rows),
        )
        ledger.add(cut)
    return rows


def _are_measured(rows: Array) -> bool:
    """Whether all numbers are finite, and none beyond anything that is measured."""
    return bool(np.isfinite(measured(rows)).all())


def _refusal_of(path: Path, rows: Array) -> InputError | None:
    """The refusal of rows that cannot be those of an SBET; None where they can."""
    if len(rows) < _FEWEST_ROWS:
        return messages.sbet_too_short(where=path, rows=len(rows))
    if not _are_measured(rows):
        return messages.sbet_not_numbers(where=path)
    time = rows[:, TIME]
    height = rows[:, HEIGHT]
    backward = np.count_nonzero(np.diff(time) <= 0.0)
    is_in_weeks = time.min() >= 0.0 and time.max() <= SECONDS_OF_WEEKS
    if not is_in_weeks or backward > MOST_BACKWARD_ROWS * time.size:
        return messages.sbet_without_time(where=path)
    largest = np.abs(rows).max(axis=0)
    if largest[LATITUDE] > np.pi / 2.0 or largest[LONGITUDE] > 2.0 * np.pi:
        return messages.sbet_places(
            where=path,
            latitude=float(largest[LATITUDE]),
            longitude=float(largest[LONGITUDE]),
        )
    if height.min() < -1_000.0 or height.max() > 60_000.0:
        return messages.sbet_heights(
            where=path,
            lowest=float(height.min()),
            highest=float(height.max()),
        )
    largest_angles = largest[ROLL : WANDER_ANGLE + 1]
    if bool((largest_angles > LARGEST_ANGLES_RAD).any()):
        reach = ", ".join(f"{angle:.4g}" for angle in largest_angles)
        return messages.sbet_angles(where=path, largest=reach)
    return None


def _are_sigmas(rows: Array) -> bool:
    """Whether rows of ten can be those of a smrmsg file: increasing seconds, small sigmas."""
    if len(rows) < _FEWEST_ROWS or not _are_measured(rows):
        return False
    time = rows[:, 0]
    sigmas = rows[:, 1:]
    increase = np.median(np.diff(time))
    is_in_weeks = time.min() >= 0.0 and time.max() < SECONDS_OF_WEEKS
    are_small = sigmas.min() >= 0.0 and sigmas.max() < LARGEST_SMRMSG
    return bool(is_in_weeks and increase > 0.0 and are_small)


@dataclass(frozen=True, eq=False)
class _Movement:
    """What an SBET is tried against while it moves: (n,) velocity of its positions, wander angle.

    ``usual_m_s`` is the median speed of the moving part.
    """

    track: Velocity
    wander_rad: Array
    is_moving: Mask
    usual_m_s: float

    def misfit(self, velocity: Velocity, sign: float) -> float:
        """Median difference [m/s] of a velocity in the wander frame, turned with a sign."""
        turned = velocity * np.exp(1j * sign * self.wander_rad)
        difference = turned - self.track
        return float(np.median(np.abs(difference[self.is_moving])))

    def least_misfit(self, velocity: Velocity) -> float:
        """The misfit [m/s] with the better of both signs."""
        return min(self.misfit(velocity, -1.0), self.misfit(velocity, 1.0))


def wander_sign(
    path: Path,
    seconds: Array,
    rows: Array,
    ledger: Ledger,
) -> tuple[float, Velocity | None]:
    """The sign of the wander angle in the true heading, and the velocity north + 1j east.

    Velocities of the file are in the wander frame: turned by the wander angle, with the right sign,
    they agree with the movement of the positions. Where they agree with neither sign, or are all
    zero, the heading is tried against the course, and the velocity is None. If nothing moves, the
    sign is POSPac's, and the velocity is None.
    """
    track = ground_velocity(seconds, rows[:, LATITUDE], rows[:, LONGITUDE])
    is_moving = np.abs(track) > _MOVING_M_S
    if not bool(is_moving.any()):
        ledger.add(messages.wander_untested(where=path.name))
        return -1.0, None
    usual_m_s = float(np.median(np.abs(track[is_moving])))
    speed = np.hypot(rows[is_moving, VELOCITY_X], rows[is_moving, VELOCITY_Y])
    speed_of_file = float(np.median(speed))
    _refuse_other_speed(path, usual_m_s, speed_of_file)
    movement = _Movement(track, rows[:, WANDER_ANGLE], is_moving, usual_m_s)
    # y points left (frame north, west, up) or right.
    y_left = rows[:, VELOCITY_X] - 1j * rows[:, VELOCITY_Y]
    y_right = rows[:, VELOCITY_X] + 1j * rows[:, VELOCITY_Y]
    velocity = min(y_left, y_right, key=movement.least_misfit)
    misfit = movement.least_misfit(velocity)
    is_consistent = misfit < max(0.3, 0.03 * usual_m_s)
    if is_consistent:
        sign = _tried_sign(path, movement, velocity, ledger, by_velocities=True)
        return sign, velocity * np.exp(1j * sign * movement.wander_rad)
    forward = np.abs(track) * np.exp(1j * rows[:, PLATFORM_HEADING])
    sign = _tried_sign(path, movement, forward, ledger, by_velocities=False)
    if speed_of_file > 0.0:
        ledger.add(messages.sbet_velocity_unused(where=path.name, misfits=misfit))
    return sign, None


def _refuse_other_speed(path: Path, usual_m_s: float, speed_of_file: float) -> None:
    """Refuse (InputError) positions that no aircraft flies, or not as fast as the velocities.

    Velocities of zero are those of a file without any: they are not compared.
    """
    is_too_fast = usual_m_s > FASTEST_M_S
    is_other = speed_of_file > 0.0 and not 0.8 < usual_m_s / speed_of_file < 1.25
    if is_too_fast or is_other:
        raise messages.sbet_speed(where=path, usual=usual_m_s, said=speed_of_file)


def _tried_sign(
    path: Path,
    movement: _Movement,
    velocity: Velocity,
    ledger: Ledger,
    *,
    by_velocities: bool,
) -> float:
    """The sign with which a velocity is that of the positions; POSPac's where both are alike.

    The velocity is that of the file (``by_velocities``), or straight ahead with the speed of the
    positions.
    """
    minus = movement.misfit(velocity, -1.0)
    plus = movement.misfit(velocity, 1.0)
    wander = np.abs(movement.wander_rad[movement.is_moving])
    # What both signs differ by at most, as a part of the speed.
    largest = 2.0 * float(np.abs(np.sin(wander)).max())
    fits = min(minus, plus) < 0.5 * movement.usual_m_s
    differ = abs(plus - minus) > 0.25 * largest * movement.usual_m_s
    is_decided = fits and differ
    sign = 1.0 if is_decided and plus < minus else -1.0
    if largest < 2.0 * _LEAST_WANDER_RAD:
        ledger.add(messages.wander_zero(where=path.name))
        return sign
    tested = messages.wander_sign(
        where=path.name,
        is_minus=sign < 0.0,
        is_decided=is_decided,
        by_velocities=by_velocities,
        most_deg=float(np.degrees(wander.max())),
        minus_m_s=minus,
        plus_m_s=plus,
    )
    ledger.add(tested)
    return sign


def ground_velocity(seconds: Array, lat_rad: Array, lon_rad: Array) -> Velocity:
    """(n,) velocity over the ground, north + 1j east [m/s], from positions half a second apart.

    >>> seconds = np.arange(5.0)
    >>> ground_velocity(seconds, np.zeros(5), np.arange(5) * 1e-6)[2].round(3)
    np.complex128(6.378j)
    """
    before = np.clip(seconds - 0.25, seconds[0], seconds[-1])
    after = np.clip(seconds + 0.25, seconds[0], seconds[-1])
    lon_rad = np.unwrap(lon_rad)
    northward = np.interp(after, seconds, lat_rad) - np.interp(before, seconds, lat_rad)
    eastward = np.interp(after, seconds, lon_rad) - np.interp(before, seconds, lon_rad)
    meridian, vertical = principal_radii(lat_rad)
    metres = northward * meridian + 1j * eastward * vertical * np.cos(lat_rad)
    return np.asarray(metres / np.maximum(after - before, 1e-3))


def _smrmsg_sigmas(path: Path, seconds: Array) -> dict[str, Array]:
    """Sigmas of a smrmsg file at the times of the SBET; NaN where it has none."""
    content = path.read_bytes()
    rows = _doubles(content, _SIGMA_ROW)
    is_whole = len(content) % (8 * _SIGMA_ROW) == 0
    if not is_whole or not _are_sigmas(rows):
        raise messages.not_smrmsg(where=path)
    time = rows[:, 0]
    if time.max() < seconds[0] or time.min() > seconds[-1]:
        raise messages.smrmsg_of_other_times(
            where=path,
            begin=float(time[0]),
            end=float(time[-1]),
            sbet_begin=float(seconds[0]),
            sbet_end=float(seconds[-1]),
        )
    rows = rows[np.argsort(time, kind="stable")]

    def sigma(column: int) -> Array:
        return np.interp(
            seconds,
            rows[:, 0],
            rows[:, column],
            left=np.nan,
            right=np.nan,
        )

    horizontal = np.hypot(sigma(1), sigma(2)) / np.sqrt(2.0)
    tilt_arcmin = np.hypot(sigma(7), sigma(8)) / np.sqrt(2.0)
    return {
        "sigma_h_m": horizontal,
        "sigma_v_m": sigma(3),
        "sigma_tilt_rad": tilt_arcmin * _ARCMIN,
        "sigma_yaw_rad": sigma(9) * _ARCMIN,
    }
