"""Applanix SBET (17 little-endian doubles a row) and its standard deviations, smrmsg (10 doubles).

A row is: seconds of the week; latitude, longitude [rad]; height [m]; velocities x, y, z [m/s];
roll, pitch, platform heading, wander angle [rad]; accelerations [m/s2]; body rates [rad/s]. Of
smrmsg: seconds of the week; sigmas north, east, down [m], of the velocities [m/s], of roll, pitch
and heading [arcmin].
"""

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
from unbend.units import ARCSEC, Array, measured

FASTEST_M_S = 700.0  # no aircraft that takes pictures flies faster
_ROW, _SIGMA_ROW = 17, 10
_ARCMIN = 60.0 * ARCSEC
_FEWEST_ROWS = 3
_MOVING_M_S = 2.0
_LEAST_WANDER_RAD = np.radians(0.05)  # less does not matter for any camera


def read_sbet(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Position, velocity, attitude and body rates of an SBET, sigmas of its smrmsg.

    The true heading is platform heading minus wander angle by POSPac's convention; on each file
    both signs are tried. Velocities and rates that contradict positions and attitude are left out.
    """
    rows = _sbet_rows(path, ledger)
    time_ns = stated.utc_of_week_seconds(path, rows[:, 0], stated.system_of(path, ledger))
    order = np.argsort(time_ns, kind="stable")
    rows, time_ns = rows[order], time_ns[order]
    seconds = (time_ns - time_ns[0]) * 1e-9
    surface = stated.height_column(path, ledger)
    columns = {"lat_rad": rows[:, 1], "lon_rad": wrapped(rows[:, 2]), surface: rows[:, 3]}
    sign, velocity = wander_sign(path, seconds, rows, ledger)
    if velocity is not None:
        columns |= {"v_north_m_s": velocity.real, "v_east_m_s": velocity.imag}
        with np.errstate(all="ignore"):  # times may repeat
            climb = np.gradient(rows[:, 3], seconds)
        upwards, downwards = (np.median(np.abs(climb - s * rows[:, 6])) for s in (1.0, -1.0))
        if min(upwards, downwards) < 0.3:
            columns["v_down_m_s"] = rows[:, 6] * (1.0 if downwards <= upwards else -1.0)
    heading = rows[:, 9] + sign * rows[:, 10]
    attitude = Rotation.from_euler("ZYX", np.stack([heading, rows[:, 8], rows[:, 7]], axis=1))
    columns |= dict(zip(("q_x", "q_y", "q_z", "q_w"), attitude.as_quat(canonical=True).T,
                        strict=True))  # fmt: skip
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    rates = turned / np.maximum(np.diff(seconds), 1e-4)[:, None]
    misfit = np.abs(rates - (rows[:-1, 14:17] + rows[1:, 14:17]) / 2.0)
    if np.median(misfit) < 0.5 * np.median(np.abs(rates)):
        columns |= {f"rate_{axis}_rad_s": rows[:, 14 + k] for k, axis in enumerate("xyz")}
    if stated.accuracy is not None:
        columns |= _smrmsg_sigmas(stated.accuracy, rows[:, 0])
    return channel_of_rows(path, "SBET", time_ns, columns, ledger,
                           readable=np.ones(time_ns.shape, np.bool_))  # fmt: skip


def _doubles(content: bytes, width: int, kind: str = "<f8") -> Array:
    """The whole rows of a file."""
    whole = len(content) // (8 * width) * width
    return np.frombuffer(content, kind, whole).reshape(-1, width).astype(np.float64)


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
    if left := len(content) % (8 * _ROW):
        ledger.add(messages.file_cut(where=path.name, count=left, row=8 * _ROW, rows=len(rows)))
    return rows


def _are_measured(rows: Array) -> bool:
    """Whether all numbers are finite, and none beyond anything that is measured."""
    return bool(np.isfinite(measured(rows)).all())


def _refusal_of(path: Path, rows: Array) -> InputError | None:
    """The refusal of rows that cannot be of an SBET; None where they can."""
    if len(rows) < _FEWEST_ROWS:
        return messages.sbet_too_short(where=path, rows=len(rows))
    if not _are_measured(rows):
        return messages.sbet_not_numbers(where=path)
    time = rows[:, 0]
    height = rows[:, 3]
    largest = np.abs(rows).max(axis=0)
    back = np.count_nonzero(np.diff(time) <= 0.0)
    if time.min() < 0.0 or time.max() > 3 * 604_800.0 or back > 0.01 * time.size:
        return messages.sbet_without_time(where=path)
    if largest[1] > np.pi / 2.0 or largest[2] > 2.0 * np.pi:
        return messages.sbet_places(
            where=path, latitude=float(largest[1]), longitude=float(largest[2])
        )
    if height.min() < -1_000.0 or height.max() > 60_000.0:
        return messages.sbet_heights(
            where=path, lowest=float(height.min()), highest=float(height.max())
        )
    if bool((largest[7:11] > np.array([1.0, 0.51, 2.0, 2.0]) * np.pi).any()):
        reach = ", ".join(f"{angle:.4g}" for angle in largest[7:11])
        return messages.sbet_angles(where=path, largest=reach)
    return None


def _are_sigmas(rows: Array) -> bool:
    """Whether rows of ten can be those of a smrmsg file: increasing seconds, small sigmas."""
    if len(rows) < _FEWEST_ROWS or not _are_measured(rows):
        return False
    time = rows[:, 0]
    sigmas = rows[:, 1:]
    increase = np.median(np.diff(time))
    in_week = time.min() >= 0.0 and time.max() < 3 * 604_800.0
    return bool(in_week and increase > 0.0 and sigmas.min() >= 0.0 and sigmas.max() < 1e5)


def wander_sign(
    path: Path, seconds: Array, rows: Array, ledger: Ledger
) -> tuple[float, NDArray[np.complex128] | None]:
    """The sign of the wander angle in the true heading, and the velocity north + 1j east.

    Velocities are in the wander frame: turned by the same angle they are those of the positions.
    Where the file has none that are, the heading is tried against the course. The velocity is None
    where the file's is that of the positions in no frame.
    """
    track, wander = ground_velocity(seconds, rows[:, 1], rows[:, 2]), rows[:, 10]
    moving = np.abs(track) > _MOVING_M_S
    if not bool(moving.any()):
        ledger.add(messages.wander_untested(where=path.name))
        return -1.0, None
    usual = float(np.median(np.abs(track[moving])))
    said = float(np.median(np.hypot(rows[moving, 4], rows[moving, 5])))
    if usual > FASTEST_M_S or (said > 0.0 and not 0.8 < usual / said < 1.25):
        raise messages.sbet_speed(where=path, usual=usual, said=said)

    def misfits(velocity: NDArray[np.complex128]) -> list[float]:
        """Against the movement of the positions, with the wander angle subtracted and added."""
        turned = (velocity * np.exp(1j * sign * wander) - track for sign in (-1.0, 1.0))
        return [float(np.median(np.abs(difference[moving]))) for difference in turned]

    # y points left (frame north, west, up) or right.
    velocity = min((rows[:, 4] + 1j * side * rows[:, 5] for side in (-1, 1)),
                   key=lambda able: min(misfits(able)))  # fmt: skip
    consistent = min(misfits(velocity)) < max(0.3, 0.03 * usual)
    forward = np.abs(track) * np.exp(1j * rows[:, 9])
    minus, plus = misfits(velocity if consistent else forward)
    largest = 2.0 * float(np.abs(np.sin(wander[moving])).max())
    decided = min(minus, plus) < 0.5 * usual and abs(plus - minus) > 0.25 * largest * usual
    sign = 1.0 if decided and plus < minus else -1.0
    if largest < 2.0 * _LEAST_WANDER_RAD:
        ledger.add(messages.wander_zero(where=path.name))
    else:
        tested = messages.wander_sign(
            where=path.name,
            is_minus=sign < 0.0,
            is_decided=decided,
            by_velocities=consistent,
            most_deg=float(np.degrees(np.abs(wander[moving]).max())),
            minus_m_s=minus,
            plus_m_s=plus,
        )
        ledger.add(tested)
    if consistent:
        return sign, velocity * np.exp(1j * sign * wander)
    if said > 0.0:
        ledger.add(messages.sbet_velocity_unused(where=path.name, misfits=min(misfits(velocity))))
    return sign, None


def ground_velocity(seconds: Array, lat_rad: Array, lon_rad: Array) -> NDArray[np.complex128]:
    """(n,) velocity over the ground, north + 1j east [m/s], from positions half a second apart.

    >>> seconds = np.arange(5.0)
    >>> ground_velocity(seconds, np.zeros(5), np.arange(5) * 1e-6)[2].round(3)
    np.complex128(6.378j)
    """
    ends = np.clip(seconds + np.array([[-0.25], [0.25]]), seconds[0], seconds[-1])
    moved = np.diff([np.interp(ends, seconds, angle) for angle in (lat_rad, np.unwrap(lon_rad))],
                    axis=1)[:, 0]  # fmt: skip
    meridian, vertical = principal_radii(lat_rad)
    metres = moved[0] * meridian + 1j * moved[1] * vertical * np.cos(lat_rad)
    return np.asarray(metres / np.maximum(ends[1] - ends[0], 1e-3))


def _smrmsg_sigmas(path: Path, seconds: Array) -> dict[str, Array]:
    """Sigmas of a smrmsg file at the times of the SBET; NaN where it has none."""
    content = path.read_bytes()
    rows = _doubles(content, _SIGMA_ROW)
    if len(content) % (8 * _SIGMA_ROW) or not _are_sigmas(rows):
        raise messages.not_smrmsg(where=path)
    if rows[:, 0].max() < seconds[0] or rows[:, 0].min() > seconds[-1]:
        raise messages.smrmsg_of_other_times(
            where=path,
            begin=float(rows[0, 0]),
            end=float(rows[-1, 0]),
            sbet_begin=float(seconds[0]),
            sbet_end=float(seconds[-1]),
        )
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    north, east, down, roll, pitch, heading = (
        np.interp(seconds, rows[:, 0], rows[:, k], left=np.nan, right=np.nan)
        for k in (1, 2, 3, 7, 8, 9)
    )
    return {
        "sigma_h_m": np.hypot(north, east) / np.sqrt(2.0),
        "sigma_v_m": down,
        "sigma_tilt_rad": np.hypot(roll, pitch) / np.sqrt(2.0) * _ARCMIN,
        "sigma_yaw_rad": heading * _ARCMIN,
    }
