"""Applanix SBET (17 little-endian doubles a row) and its standard deviations, smrmsg (10 doubles).

A row is: seconds of the week; latitude, longitude [rad]; height [m]; velocities x, y, z [m/s];
roll, pitch, platform heading, wander angle [rad]; accelerations [m/s2]; body rates [rad/s]. Of
smrmsg: seconds of the week; sigmas north, east, down [m], of the velocities [m/s], of roll, pitch
and heading [arcmin].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.errors import InputError
from pipeline.flight.channels import Array, Channel
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import (
    Stated,
    channel_of_rows,
    height_column,
    not_of_format,
    time_system,
    utc_of_week_seconds,
)
from pipeline.tables.imports.tracks import FASTEST_M_S, track_velocity, wrapped
from pipeline.units import ARCSEC

_ROW, _SIGMA_ROW = 17, 10
_ARCMIN = 60.0 * ARCSEC
_MOVING_M_S = 2.0
_LEAST_WANDER_RAD = np.radians(0.05)  # less does not matter for any camera


def read_sbet(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Position, velocity, attitude and body rates of an SBET, sigmas of its smrmsg.

    The true heading is platform heading minus wander angle by POSPac's convention. The sign is
    tested on each file: its velocities are in the wander frame too, and must be those of its
    positions once turned by the same angle; where they are not in that frame, by the heading
    against the course. Velocities and rates that contradict positions and attitude are left out.
    """
    rows = sbet_rows(path, ledger)
    system = time_system(path, stated)
    time_ns = utc_of_week_seconds(path, rows[:, 0], stated, system)
    order = np.argsort(time_ns, kind="stable")
    rows, time_ns = rows[order], time_ns[order]
    columns: dict[str, Array] = {
        "lat_rad": rows[:, 1],
        "lon_rad": wrapped(rows[:, 2]),
        height_column(path, stated): rows[:, 3],
    }
    sign, velocity = wander_sign(path, time_ns, rows, ledger)
    if velocity is not None:
        columns |= {"v_north_m_s": velocity.real, "v_east_m_s": velocity.imag}
        with np.errstate(all="ignore"):  # times may repeat
            climb = np.gradient(rows[:, 3], (time_ns - time_ns[0]) * 1e-9)
        downwards = [float(np.median(np.abs(climb + sign * rows[:, 6]))) for sign in (1.0, -1.0)]
        if min(downwards) < 0.3:
            columns["v_down_m_s"] = rows[:, 6] * (1.0 if downwards[0] <= downwards[1] else -1.0)
    heading = rows[:, 9] + sign * rows[:, 10]
    angles = np.stack([heading, rows[:, 8], rows[:, 7]], axis=1)
    attitude = Rotation.from_euler("ZYX", angles)
    quaternion = attitude.as_quat(canonical=True)
    columns |= {f"q_{axis}": quaternion[:, k] for k, axis in enumerate("xyzw")}
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    rates = turned / np.maximum(np.diff(time_ns) * 1e-9, 1e-4)[:, None]
    misfit = np.median(np.abs(rates - (rows[:-1, 14:17] + rows[1:, 14:17]) / 2.0))
    if misfit < 0.5 * np.median(np.abs(rates)):
        columns |= {f"rate_{axis}_rad_s": rows[:, 14 + k] for k, axis in enumerate("xyz")}
    if stated.accuracy is not None:
        columns |= smrmsg_sigmas(stated.accuracy, rows[:, 0])
    return channel_of_rows(path, "SBET", time_ns, columns, ledger,
                           readable=np.ones(time_ns.shape, np.bool_))  # fmt: skip


def sbet_rows(path: Path, ledger: Ledger) -> Array:
    """(n, 17) rows; refuses what is no SBET with what it is instead."""
    content = path.read_bytes()
    size = 8 * _ROW
    whole = len(content) // size
    little = np.frombuffer(content, "<f8", whole * _ROW).reshape(-1, _ROW)
    why = _implausible(little)
    if why:
        big = np.frombuffer(content, ">f8", whole * _ROW).reshape(-1, _ROW)
        if not _implausible(big):
            raise not_of_format(path, "its numbers are big-endian: an SBET is little-endian",
                                "export it again without swapping bytes")  # fmt: skip
        sigmas = np.frombuffer(content, "<f8", len(content) // 80 * _SIGMA_ROW)
        if _are_sigmas(sigmas.reshape(-1, _SIGMA_ROW)):
            raise not_of_format(
                path,
                "it has the rows of a smrmsg file (10 doubles): standard deviations, no trajectory",
                "give the SBET as path and this file as accuracy",
            )
        raise not_of_format(path, f"read as an SBET, {why}")
    left = len(content) - whole * size
    if left:
        ledger.loss(
            "IMPORT-CUT",
            f"the last {left} bytes are no whole row of {size}: the file was cut after "
            f"{whole} rows",
            where=path.name,
            count=left,
        )
    return np.asarray(little, np.float64)


def _implausible(rows: Array) -> str:
    """What in rows cannot be of an SBET; empty where nothing is."""
    if rows.shape[0] < 3:
        return f"it has {rows.shape[0]} rows"
    if not bool(np.isfinite(rows).all()):
        return "not all of its values are numbers"
    time, largest = rows[:, 0], np.abs(rows).max(axis=0)
    with np.errstate(over="ignore"):
        back = int(np.count_nonzero(np.diff(time) <= 0.0))
    if time.min() < 0.0 or time.max() > 3 * 604_800.0 or back > 0.01 * time.size:
        return "its first column is no time that increases"
    if largest[1] > np.pi / 2.0 or largest[2] > 2.0 * np.pi:
        return (
            f"latitude and longitude reach {largest[1]:.4g} and {largest[2]:.4g}: degrees, or "
            "exchanged, where an SBET has radians, latitude first"
        )
    if rows[:, 3].min() < -1_000.0 or largest[3] > 60_000.0:
        return f"heights are between {rows[:, 3].min():.4g} and {rows[:, 3].max():.4g} m"
    if bool((largest[7:11] > np.array([1.0, 0.51, 2.0, 2.0]) * np.pi).any()):
        reach = ", ".join(f"{angle:.4g}" for angle in largest[7:11])
        return f"roll, pitch, heading and wander angle reach {reach} radians: degrees?"
    return ""


def _are_sigmas(rows: Array) -> bool:
    return bool(
        rows.shape[0] > 2
        and np.isfinite(rows).all()
        and np.median(np.diff(rows[:, 0])) > 0.0
        and 0.0 <= rows[:, 0].min() <= rows[:, 0].max() < 3 * 604_800.0
        and rows[:, 1:].min() >= 0.0
        and rows[:, 1:].max() < 1e5
    )


def wander_sign(
    path: Path, time_ns: NDArray[np.int64], rows: Array, ledger: Ledger
) -> tuple[float, NDArray[np.complex128] | None]:
    """The sign of the wander angle in the true heading, and the velocity north + 1j east.

    The velocity is None where the file's has no frame in which it is that of the positions.
    """
    track = track_velocity(time_ns, rows[:, 1], rows[:, 2], 0.5)
    wander, speed = rows[:, 10], np.abs(track)
    with np.errstate(invalid="ignore"):
        moving = speed > _MOVING_M_S
    if not bool(moving.any()):
        ledger.note("IMPORT-WANDER", "nothing in the file moves: the true heading is taken as "
                    "platform heading minus wander angle", where=path.name)  # fmt: skip
        return -1.0, None
    usual = float(np.median(speed[moving]))
    said = float(np.median(np.hypot(rows[moving, 4], rows[moving, 5])))
    if usual > FASTEST_M_S or (said > 0.0 and not 0.8 < usual / said < 1.25):
        raise InputError(
            "IMPORT-SPEED",
            f"its positions move at {usual:.3g} m/s, its velocities say {said:.3g} m/s: latitude "
            "and longitude are not in radians, are exchanged, or the columns are others",
            where=str(path),
            remedy="export an SBET in radians, latitude before longitude",
        )
    # Mirrored where y points left (wander frame north, west, up), and turned by the wander angle.
    fits: dict[tuple[int, int], Any] = {
        (mirror, sign): (rows[:, 4] + 1j * mirror * rows[:, 5]) * np.exp(1j * sign * wander)
        for mirror in (-1, 1)
        for sign in (-1, 0, 1)
    }
    misfit = {key: float(np.median(np.abs(fit - track)[moving])) for key, fit in fits.items()}
    mirror, turned = min(misfit, key=misfit.__getitem__)
    trusted = misfit[mirror, turned] < max(0.3, 0.03 * usual)
    largest = float(np.abs(wander[moving]).max())
    minus, plus = misfit[mirror, -1], misfit[mirror, 1]
    how, unit = "velocities and positions", "m/s"
    if not (trusted and turned and max(minus, plus) > 3.0 * min(minus, plus)):
        course = np.angle(track[moving])
        minus, plus = (
            float(np.degrees(np.median(np.abs(wrapped(rows[moving, 9] + s * wander[moving]
                                                      - course))))) for s in (-1, 1)
        )  # fmt: skip
        how, unit = "heading and course", "deg"
    sign = -1.0 if minus <= plus else 1.0
    what = (
        f"true heading is platform heading {'minus' if sign < 0 else 'plus'} wander angle (up to "
        f"{np.degrees(largest):.2f} deg): {how} differ by {min(minus, plus):.2f} {unit} that way, "
        f"by {max(minus, plus):.2f} {unit} the other"
    )
    neither = unit == "deg" and min(minus, plus) > 30.0
    close = unit == "deg" and abs(plus - minus) < 0.5 * np.degrees(largest)
    if largest < _LEAST_WANDER_RAD:
        ledger.note("IMPORT-WANDER", "the wander angle is zero throughout", where=path.name)
    elif neither or close:
        sign = -1.0
        ledger.warning(
            "IMPORT-WANDER",
            f"the sign of the wander angle (up to {np.degrees(largest):.2f} deg) is that of "
            f"POSPac, heading minus wander angle: {how} do not decide it ({minus:.2f} against "
            f"{plus:.2f} deg)",
            where=path.name,
        )
    elif sign > 0:
        ledger.warning("IMPORT-WANDER", what + "; POSPac has the other sign", where=path.name)
    else:
        ledger.note("IMPORT-WANDER", what, where=path.name)
    if trusted:
        return sign, fits[mirror, turned]
    if said > 0.0:
        ledger.warning(
            "IMPORT-VELOCITY",
            f"its velocities are those of its positions in no frame ({misfit[mirror, turned]:.2f} "
            "m/s apart): they are not used",
            where=path.name,
        )
    return sign, None


def smrmsg_sigmas(path: Path, seconds: Array) -> dict[str, Array]:
    """Sigmas of a smrmsg file at the times of the SBET; NaN where it has none."""
    content = path.read_bytes()
    rows = np.frombuffer(content, "<f8", len(content) // 80 * _SIGMA_ROW).reshape(-1, _SIGMA_ROW)
    if len(content) % 80 or not _are_sigmas(rows):
        raise not_of_format(path, "it is no smrmsg file: rows of 10 doubles, time and sigmas",
                            "give the smrmsg file that was written with the SBET")  # fmt: skip
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    if rows[-1, 0] < seconds[0] or rows[0, 0] > seconds[-1]:
        raise not_of_format(
            path,
            f"its seconds of the week, {rows[0, 0]:.0f} to {rows[-1, 0]:.0f}, are not those of the "
            f"SBET, {seconds[0]:.0f} to {seconds[-1]:.0f}",
            "give the smrmsg file that was written with the SBET",
        )

    def at(values: Array) -> Array:
        return np.interp(seconds, rows[:, 0], values, left=np.nan, right=np.nan)

    return {
        "sigma_h_m": at(np.hypot(rows[:, 1], rows[:, 2]) / np.sqrt(2.0)),
        "sigma_v_m": at(rows[:, 3]),
        "sigma_tilt_rad": at(np.hypot(rows[:, 7], rows[:, 8]) / np.sqrt(2.0)) * _ARCMIN,
        "sigma_yaw_rad": at(rows[:, 9]) * _ARCMIN,
    }
