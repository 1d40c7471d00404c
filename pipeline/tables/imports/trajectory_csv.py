"""A trajectory as CSV: columns, units and the order of angles as the mission file states them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.errors import InputError
from pipeline.flight.channels import Array, Channel, TimeArray
from pipeline.flight.clock import SECONDS_PER_WEEK
from pipeline.geodesy import geodetic_of_ecef
from pipeline.ledger import Ledger
from pipeline.tables.column_checks import no_such_column
from pipeline.tables.imports.stated import (
    RADIANS,
    Stated,
    channel_of_rows,
    height_column,
    not_of_format,
    number,
    time_system,
    utc_of_calendar,
    utc_of_week_seconds,
)
from pipeline.tables.text_columns import text_table

_SINCE_EPOCH_S = 1e8
"""Seconds beyond this count from an epoch, not from the beginning of a week."""

_AS_THEY_ARE = (
    "v_north_m_s", "v_east_m_s", "v_down_m_s", "sigma_h_m", "sigma_v_m", "q_w", "q_x", "q_y", "q_z",
)  # fmt: skip


def read_trajectory_csv(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """The rows of a CSV as a channel.

    Times are dates with a time of day, seconds of the week, with the week in a column or not, or
    seconds since 1970 (UTC) or 1980 (GPST). Positions are latitude, longitude and height, or
    earth-centred x, y and z. The attitude is a quaternion (v_ned = R(q) v_body), or roll, pitch and
    yaw: rotations about the body's x, y and z in the stated order.
    """
    if not stated.columns:
        raise not_of_format(path, "nothing says what its columns are",
                            "name them under stations.trajectory.columns")  # fmt: skip
    table = text_table(path, "IMPORT-FORMAT")
    for quantity, name in stated.columns.items():
        if name not in table.columns:
            raise no_such_column("IMPORT-COLUMN", path, name, there=list(table.columns),
                                 key="stations.trajectory.columns", quantity=quantity)  # fmt: skip
    value = {
        quantity: np.array([number(field) for field in table[name]])
        for quantity, name in stated.columns.items()
    }
    time_ns, readable = utc_of_column(path, table, value, stated)
    columns = {name: value[name] for name in _AS_THEY_ARE if name in value}
    if "x" in value:
        lat, lon, height = geodetic_of_ecef(value["x"], value["y"], value["z"])
        surface = height_column(path, stated, "ellipsoid")
        radius = float(np.nanmedian(np.sqrt(value["x"] ** 2 + value["y"] ** 2 + value["z"] ** 2)))
        if not 6.3e6 < radius < 6.5e6:
            raise InputError(
                "IMPORT-RANGE",
                f"x, y and z are {radius:.4g} m from the centre of the earth",
                where=str(path),
                remedy="name columns of earth-centred coordinates in metres (WGS84)",
            )
    else:
        unit = RADIANS[stated.position_unit]
        lat, lon, height = value["latitude"] * unit, value["longitude"] * unit, value["height"]
        surface = height_column(path, stated)
    columns |= {"lat_rad": lat, "lon_rad": lon, surface: height}
    if "yaw" in value:
        columns |= quaternions_of_angles(path, value, stated)
    readable = readable & np.isfinite(np.stack([lat, lon, height])).all(axis=0)
    return channel_of_rows(path, "CSV", time_ns, columns, ledger, readable=readable)


def utc_of_column(
    path: Path, table: pd.DataFrame, value: dict[str, Array], stated: Stated
) -> tuple[TimeArray, NDArray[np.bool_]]:
    """UTC of the rows, and which have a readable time."""
    seconds, system = value["time"], time_system(path, stated)
    if bool(np.isfinite(seconds).any()):
        readable = np.isfinite(seconds)
        week = value.get("week")
        if week is not None:
            readable &= np.isfinite(week)
        elif float(np.nanmedian(seconds)) > _SINCE_EPOCH_S:
            since = np.where(readable, seconds, 0.0)
            if system == "gpst":
                whole = np.floor(since / SECONDS_PER_WEEK)
                return utc_of_week_seconds(
                    path, since - whole * SECONDS_PER_WEEK, stated, system, whole
                ), readable
            return np.rint(since * 1e6).astype(np.int64) * 1000, readable
        return utc_of_week_seconds(path, seconds, stated, system, week), readable
    text = table[stated.columns["time"]].str.replace("/", "-")
    stamps = pd.to_datetime(text, format="ISO8601", errors="coerce", utc=True)
    zoned = text.str.contains(r"(?:Z|[+-][0-9]{2}:?[0-9]{2})$", regex=True)
    if system == "gpst" and bool(zoned.any()):
        raise InputError(
            "IMPORT-TIME-SYSTEM",
            f"{text.iloc[0]} has a time zone, which GPS time has not",
            where=str(path),
            remedy="give time: {system: utc}",
        )
    time_ns = stamps.to_numpy("datetime64[ns]").astype(np.int64)
    return utc_of_calendar(time_ns, system), stamps.notna().to_numpy()


def quaternions_of_angles(path: Path, value: dict[str, Array], stated: Stated) -> dict[str, Array]:
    """v_ned = R(q) v_body from roll, pitch and yaw in the stated unit and order."""
    unit = RADIANS[stated.angle_unit]
    by_axis = {"X": value["roll"], "Y": value["pitch"], "Z": value["yaw"]}
    worst = {name: float(np.fmax.reduce(np.abs(value[name]), initial=0.0))
             for name in ("roll", "pitch", "yaw")}  # fmt: skip
    limit = 2.0 * np.pi / unit * 1.0001
    if max(worst.values()) > limit:
        raise InputError(
            "IMPORT-ANGLES",
            f"roll, pitch and yaw reach {worst['roll']:.1f}, {worst['pitch']:.1f} and "
            f"{worst['yaw']:.1f}, more than the full circle of {limit:.4g} {stated.angle_unit}",
            where=str(path),
            remedy="state angle_unit: deg, rad or grad (400 in the circle)",
        )
    angles = np.stack([by_axis[axis] * unit for axis in stated.angle_order], axis=1)
    known = np.isfinite(angles).all(axis=1)
    quaternion = np.full((known.size, 4), np.nan)
    if bool(known.any()):
        turned = Rotation.from_euler(stated.angle_order, angles[known])
        quaternion[known] = turned.as_quat(canonical=True)
    return {f"q_{axis}": quaternion[:, k] for k, axis in enumerate("xyzw")}
