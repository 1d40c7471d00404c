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
SECONDS_OF_WEEKS = 3 * 604_800.0  # at the end of a week some files do not begin again at 0
LARGEST_CLIMB_MISFIT_M_S = 0.3  # of vertical velocities that agree with the heights
MOST_BACKWARD_ROWS = 0.01  # part of the rows; with more the column is not a time
LARGEST_ANGLES_RAD = np.array([1.0, 0.51, 2.0, 2.0]) * np.pi  # roll, pitch, heading, wander angle
LARGEST_SMRMSG = 1e5  # of any sigma of a smrmsg
_SBET_COLUMNS = 17  # doubles of a row
_SMRMSG_COLUMNS = 10
_ARCMIN = 60.0 * ARCSEC
_MIN_ROWS = 3  # fewer are too few to recognise a format
_MOVING_M_S = 2.0  # slower rows have no reliable course
_LEAST_WANDER_RAD = np.radians(0.05)  # less does not matter for any camera
_LARGEST_VELOCITY_MISFIT_M_S = 0.3  # of velocities that are those of the positions
_LARGEST_VELOCITY_MISFIT = 0.03  # the same, as a part of the speed

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
    """Read position, velocity, attitude and body rates of an SBET, and the sigmas of its smrmsg.

    By POSPac's convention the true heading is platform heading minus wander angle; on each file
    both signs are tested. Velocities and rates that contradict positions and attitude are left out.
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
    """The columns of the horizontal ``velocity`` (n,), and v_down_m_s if the heights confirm it.

    An SBET has its vertical velocity upwards or downwards: the heights decide its sign.
    """
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
    """The columns q_x to q_w, and the body rates if they agree with the change of attitude.

    ``sign``, 1 or -1, is that of the wander angle in the true heading.
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
    turns_rad = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    steps_s = np.maximum(np.diff(seconds), 1e-4)  # times may repeat
    rates = turns_rad / steps_s[:, None]
    rates_of_file = rows[:, BODY_RATES]
    rates_between = (rates_of_file[:-1] + rates_of_file[1:]) / 2.0
    misfit = np.median(np.abs(rates - rates_between))
    if misfit < 0.5 * np.median(np.abs(rates)):
        columns["rate_x_rad_s"] = rates_of_file[:, 0]
        columns["rate_y_rad_s"] = rates_of_file[:, 1]
        columns["rate_z_rad_s"] = rates_of_file[:, 2]
    return columns


def _doubles(content: bytes, width: int, kind: str = "<f8") -> Array:
    """(n, width) the complete rows of doubles in a file; bytes after the last one are left out."""
    count = len(content) // (8 * width)
    numbers = np.frombuffer(content, kind, count * width)
    return numbers.reshape(-1, width).astype(np.float64)


def _sbet_rows(path: Path, ledger: Ledger) -> Array:
    """(n, 17) rows of an SBET; refuses another file, and names its format if it is recognised."""
    content = path.read_bytes()
    rows = _doubles(content, _SBET_COLUMNS)
    refusal = _refusal_of(path, rows)
    if refusal is not None:
        if _refusal_of(path, _doubles(content, _SBET_COLUMNS, ">f8")) is None:
            raise messages.sbet_big_endian(where=path)
        if _are_sigmas(_doubles(content, _SMRMSG_COLUMNS)):
            raise messages.sbet_is_smrmsg(where=path)
        raise refusal
    bytes_left = len(content) % (8 * _SBET_COLUMNS)
    if bytes_left:
        cut = messages.file_cut(
            where=path.name,
            count=bytes_left,
            row=8 * _SBET_COLUMNS,
            rows=len(rows),
        )
        ledger.add(cut)
    return rows


def _are_measured(rows: Array) -> bool:
    """Whether all numbers are finite, and of a size that a measurement can have."""
    return bool(np.isfinite(measured(rows)).all())


def _refusal_of(path: Path, rows: Array) -> InputError | None:
    """The error for rows (n, 17) that cannot be those of an SBET; None if they can be."""
    if len(rows) < _MIN_ROWS:
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
        listed = ", ".join(f"{angle:.4g}" for angle in largest_angles)
        return messages.sbet_angles(where=path, largest=listed)
    return None


def _are_sigmas(rows: Array) -> bool:
    """Whether rows (n, 10) can be those of a smrmsg file: increasing seconds, small sigmas."""
    if len(rows) < _MIN_ROWS or not _are_measured(rows):
        return False
    time = rows[:, 0]
    sigmas = rows[:, 1:]
    increase = np.median(np.diff(time))
    is_in_weeks = time.min() >= 0.0 and time.max() < SECONDS_OF_WEEKS
    are_small = sigmas.min() >= 0.0 and sigmas.max() < LARGEST_SMRMSG
    return bool(is_in_weeks and increase > 0.0 and are_small)


@dataclass(frozen=True, eq=False)
class _Movement:
    """The movement (n,) of an SBET's positions, with which other velocities are compared.

    track_velocity : (n,) velocity from the positions, against true north.
    wander_rad : (n,) wander angle.
    is_moving : (n,) the rows that are compared.
    speed_m_s : median speed of these rows.
    """

    track_velocity: Velocity
    wander_rad: Array
    is_moving: Mask
    speed_m_s: float

    def misfit(self, velocity: Velocity, sign: float) -> float:
        """Median distance [m/s] of a velocity (n,) in the wander frame from that of the positions.

        ``sign``, 1 or -1, is that of the wander angle by which the velocity is turned first.
        """
        turned = velocity * np.exp(1j * sign * self.wander_rad)
        difference = turned - self.track_velocity
        return float(np.median(np.abs(difference[self.is_moving])))

    def least_misfit(self, velocity: Velocity) -> float:
        """The misfit [m/s] with the better one of the two signs."""
        return min(self.misfit(velocity, -1.0), self.misfit(velocity, 1.0))


def wander_sign(
    path: Path,
    seconds: Array,
    rows: Array,
    ledger: Ledger,
) -> tuple[float, Velocity | None]:
    """The sign (1 or -1) of the wander angle in the true heading, and the velocity (n,) or None.

    Velocities of the file are in the wander frame: turned by the wander angle with the correct
    sign, they agree with the movement of the positions. If they agree with neither sign, or are all
    zero, the heading is compared with the course instead, and the velocity is None. If nothing
    moves, the sign is POSPac's, and the velocity is None.
    """
    track_velocity = ground_velocity(seconds, rows[:, LATITUDE], rows[:, LONGITUDE])
    is_moving = np.abs(track_velocity) > _MOVING_M_S
    if not bool(is_moving.any()):
        ledger.add(messages.wander_untested(where=path.name))
        return -1.0, None
    speed_m_s = float(np.median(np.abs(track_velocity[is_moving])))
    speeds_of_file = np.hypot(rows[is_moving, VELOCITY_X], rows[is_moving, VELOCITY_Y])
    file_speed_m_s = float(np.median(speeds_of_file))
    _refuse_other_speed(path, speed_m_s, file_speed_m_s)
    movement = _Movement(track_velocity, rows[:, WANDER_ANGLE], is_moving, speed_m_s)
    # y points left (frame north, west, up) or right.
    y_left = rows[:, VELOCITY_X] - 1j * rows[:, VELOCITY_Y]
    y_right = rows[:, VELOCITY_X] + 1j * rows[:, VELOCITY_Y]
    velocity = min(y_left, y_right, key=movement.least_misfit)
    misfit = movement.least_misfit(velocity)
    is_consistent = misfit < max(
        _LARGEST_VELOCITY_MISFIT_M_S,
        _LARGEST_VELOCITY_MISFIT * speed_m_s,
    )
    if is_consistent:
        sign = _best_wander_sign(path, movement, velocity, ledger, by_velocities=True)
        return sign, velocity * np.exp(1j * sign * movement.wander_rad)
    velocity_ahead = np.abs(track_velocity) * np.exp(1j * rows[:, PLATFORM_HEADING])
    sign = _best_wander_sign(path, movement, velocity_ahead, ledger, by_velocities=False)
    if file_speed_m_s > 0.0:
        ledger.add(messages.sbet_velocity_unused(where=path.name, misfits=misfit))
    return sign, None


def _refuse_other_speed(path: Path, speed_m_s: float, file_speed_m_s: float) -> None:
    """Refuse (InputError) a speed of the positions that is impossible, or not that of the file.

    ``speed_m_s`` is from the positions, ``file_speed_m_s`` from the velocities of the file; 0 means
    that the file has none, which is not compared.
    """
    is_too_fast = speed_m_s > FASTEST_M_S
    has_velocities = file_speed_m_s > 0.0
    is_other = has_velocities and not 0.8 < speed_m_s / file_speed_m_s < 1.25
    if is_too_fast or is_other:
        raise messages.sbet_speed(where=path, usual=speed_m_s, said=file_speed_m_s)


def _best_wander_sign(
    path: Path,
    movement: _Movement,
    velocity: Velocity,
    ledger: Ledger,
    *,
    by_velocities: bool,
) -> float:
    """The sign of the wander angle with which a velocity (n,) fits the positions better.

    It is POSPac's, -1, where the test does not decide. ``by_velocities``: ``velocity`` is that of
    the file; else it is straight ahead, with the speed of the positions. The test is reported.
    """
    minus_m_s = movement.misfit(velocity, -1.0)
    plus_m_s = movement.misfit(velocity, 1.0)
    wander = np.abs(movement.wander_rad[movement.is_moving])
    # Misfits of the two signs can differ by this part of the speed.
    largest_effect = 2.0 * float(np.abs(np.sin(wander)).max())
    is_good_fit = min(minus_m_s, plus_m_s) < 0.5 * movement.speed_m_s
    is_clear = abs(plus_m_s - minus_m_s) > 0.25 * largest_effect * movement.speed_m_s
    is_decided = is_good_fit and is_clear
    sign = 1.0 if is_decided and plus_m_s < minus_m_s else -1.0
    if largest_effect < 2.0 * _LEAST_WANDER_RAD:
        ledger.add(messages.wander_zero(where=path.name))
        return sign
    tested = messages.wander_sign(
        where=path.name,
        is_minus=sign < 0.0,
        is_decided=is_decided,
        by_velocities=by_velocities,
        most_deg=float(np.degrees(wander.max())),
        minus_m_s=minus_m_s,
        plus_m_s=plus_m_s,
    )
    ledger.add(tested)
    return sign


def ground_velocity(seconds: Array, lat_rad: Array, lon_rad: Array) -> Velocity:
    """(n,) velocity over the ground, north + 1j east [m/s], from positions (n,) at ``seconds``.

    It is the mean of the half second around each row, which at both ends is shorter.

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
    distance_m = northward * meridian + 1j * eastward * vertical * np.cos(lat_rad)
    return np.asarray(distance_m / np.maximum(after - before, 1e-3))


def _smrmsg_sigmas(path: Path, seconds: Array) -> dict[str, Array]:
    """The columns of sigmas of a smrmsg file at ``seconds`` (n,) of the week; NaN outside its time.

    Refuses (InputError) another file, and one without a time in common with ``seconds``.
    """
    content = path.read_bytes()
    rows = _doubles(content, _SMRMSG_COLUMNS)
    is_whole = len(content) % (8 * _SMRMSG_COLUMNS) == 0
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
        """(n,) a column of the file: 1 to 3 north, east, down [m], 7 to 9 roll, pitch, heading."""
        return np.interp(
            seconds,
            rows[:, 0],
            rows[:, column],
            left=np.nan,
            right=np.nan,
        )

    horizontal_m = np.hypot(sigma(1), sigma(2)) / np.sqrt(2.0)
    tilt_arcmin = np.hypot(sigma(7), sigma(8)) / np.sqrt(2.0)
    return {
        "sigma_h_m": horizontal_m,
        "sigma_v_m": sigma(3),
        "sigma_tilt_rad": tilt_arcmin * _ARCMIN,
        "sigma_yaw_rad": sigma(9) * _ARCMIN,
    }
