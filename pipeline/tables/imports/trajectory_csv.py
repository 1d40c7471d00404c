"""A trajectory as CSV: columns, units and the order of angles as the mission file states them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pipeline.errors import InputError
from pipeline.flight.channels import Channel, TimeArray
from pipeline.flight.clock import SECONDS_PER_WEEK
from pipeline.geodesy import geodetic_of_ecef
from pipeline.ledger import Ledger
from pipeline.tables import text_columns
from pipeline.tables.geodata.coordinate_systems import places_of
from pipeline.tables.imports.stated import Stated, channel_of_rows
from pipeline.units import RADIANS, Array, Mask

_SINCE_EPOCH_S = 1e8
"""Seconds beyond this count from an epoch, not from the beginning of a week."""

_AS_THEY_ARE = (
    "v_north_m_s", "v_east_m_s", "v_down_m_s", "sigma_h_m", "sigma_v_m", "q_w", "q_x", "q_y", "q_z",
)  # fmt: skip


def read_trajectory_csv(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """The rows of a CSV as a channel.

    Times are dates with a time of day, seconds of the week, with the week in a column or not, or
    seconds since 1970 (UTC) or 1980 (GPST). Positions are latitude, longitude and height, or
    earth-centred x, y and z; in a stated coordinate system x and y are its, z is the height, and
    yaw and velocities count from grid north. The attitude is a quaternion (v_ned = R(q) v_body), or
    roll, pitch and yaw: rotations about the body's x, y and z in the stated order.
    """
    if not stated.columns:
        raise InputError.of("IMPORT-FORMAT/csv-columns", path)
    table = text_columns.text_table(path, stated.columns, codes=("IMPORT-FORMAT", "IMPORT-COLUMN"),
                       key="stations.trajectory.columns")  # fmt: skip
    value = {
        quantity: text_columns.numbers(table[name]) for quantity, name in stated.columns.items()
    }
    columns = {name: value[name] for name in _AS_THEY_ARE if name in value}
    grid_north: Array | None = None
    if stated.crs is not None:
        heights = "msl" if stated.height_column(path, ledger) == "h_msl_m" else "ellipsoid"
        if "x" in value:
            given = value["x"], value["y"], value["z"]
        else:
            unit = RADIANS[stated.position_unit] / RADIANS["deg"]
            given = value["longitude"] * unit, value["latitude"] * unit, value["height"]
        places, notes = places_of(stated.crs, given, heights=heights, geoid=stated.geoid,
                                  where=str(path), key="stations.trajectory.crs")  # fmt: skip
        ledger.extend(notes)
        lat, lon, height = places.lat_rad, places.lon_rad, places.h_m
        surface = "h_msl_m" if places.heights == "msl" else "h_ellipsoid_m"
        grid_north = np.nan_to_num(places.convergence_rad)
    elif "x" in value:
        lat, lon, height = geodetic_of_ecef(value["x"], value["y"], value["z"])
        surface = stated.height_column(path, ledger, "ellipsoid")
        radius = float(np.nanmedian(np.linalg.norm([value[axis] for axis in "xyz"], axis=0)))
        if not 6.3e6 < radius < 6.5e6:
            raise InputError.of("IMPORT-RANGE/read-trajectory-csv", path, radius=radius)
    else:
        unit = RADIANS[stated.position_unit]
        lat, lon, height = value["latitude"] * unit, value["longitude"] * unit, value["height"]
        surface = stated.height_column(path, ledger)
    columns |= {"lat_rad": lat, "lon_rad": lon, surface: height}
    if "yaw" in value:
        angles = np.stack([value[name] for name in ("roll", "pitch", "yaw")], axis=1)
        angles = text_columns.angles_in_radians(angles, stated.angle_unit, path, "IMPORT-ANGLES",
                                   "stations.trajectory.angle_unit")  # fmt: skip
        known = np.isfinite(angles).all(axis=1)
        in_order = angles[known][:, ["XYZ".index(axis) for axis in stated.angle_order]]
        q = np.full((known.size, 4), np.nan)
        q[known] = Rotation.from_euler(stated.angle_order, in_order).as_quat(canonical=True)
        columns |= {f"q_{axis}": q[:, k] for k, axis in enumerate("xyzw")}
    if grid_north is not None:
        columns = from_grid_north(columns, grid_north)
    time_ns, readable = _utc(path, table[stated.columns["time"]].str.strip(), value, stated, ledger)
    readable = readable & np.isfinite([lat, lon, height]).all(axis=0)
    return channel_of_rows(path, "CSV", time_ns, columns, ledger, readable=readable)


def from_grid_north(columns: dict[str, Array], convergence_rad: Array) -> dict[str, Array]:
    """Columns with attitudes and velocities against true north instead of grid north."""
    columns, names = dict(columns), ("q_x", "q_y", "q_z", "q_w")
    if "q_w" in columns:
        q = np.stack([columns[name] for name in names], axis=1)
        known = np.isfinite(q).all(axis=1)
        turn = Rotation.from_euler("z", convergence_rad[known, None])
        q[known] = (turn * Rotation.from_quat(q[known])).as_quat(canonical=True)
        columns |= dict(zip(names, q.T, strict=True))
    if "v_north_m_s" in columns and "v_east_m_s" in columns:
        velocity = columns["v_north_m_s"] + 1j * columns["v_east_m_s"]
        velocity = velocity * np.exp(1j * convergence_rad)
        columns |= {"v_north_m_s": velocity.real, "v_east_m_s": velocity.imag}
    return columns


def _utc(
    path: Path, text: pd.Series[str], value: dict[str, Array], stated: Stated, ledger: Ledger
) -> tuple[TimeArray, Mask]:
    """UTC of the rows, and which have a readable time."""
    system, seconds = stated.system_of(path, ledger), value["time"]
    readable = np.isfinite(seconds)
    if not bool(readable.any()):
        if system == "gpst" and bool(text.str.contains(r"(?:Z|[+-]\d\d:?\d\d)$").any()):
            raise InputError.of("IMPORT-TIME-SYSTEM", path, text=text.iloc[0])
        return text_columns.utc_of_dates(text, system)
    if "week" in value:
        readable = readable & np.isfinite(value["week"])
        return text_columns.utc_of_weeks(value["week"], seconds, system), readable
    if float(np.nanmedian(seconds)) < _SINCE_EPOCH_S:
        return stated.utc_of_week_seconds(path, seconds, system), readable
    if system == "gpst":
        return text_columns.utc_of_weeks(*np.divmod(seconds, SECONDS_PER_WEEK), system), readable
    return np.rint(np.where(readable, seconds, 0.0) * 1e6).astype(np.int64) * 1000, readable
