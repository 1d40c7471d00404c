"""The trajectory in a user's CSV: the mission file states its columns, units and orders."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK
from unbend.geodesy import geodetic_of_ecef
from unbend.messages import Ledger
from unbend.tables.geodata.coordinate_systems import places_of
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated, channel_of_rows, without_impossible
from unbend.tables.imports.user_tables import LIMITS_DEG
from unbend.tables.text_columns import (
    angles_in_radians,
    degrees_of,
    numbers,
    text_table,
    utc_of_dates,
    utc_of_weeks,
)
from unbend.units import RADIANS, Array, Mask, whole_numbers

_LAST_US = 9 * 10**15  # since 1970: 2255, in nanoseconds within 64 bits
_SINCE_EPOCH_S = 1e8  # larger seconds count from 1970 or 1980; a week has only 6e5
_SMALLEST_RADIUS_M = 6.3e6  # of a position from the earth's centre; the ground has 6.357e6 or more
_LARGEST_RADIUS_M = 6.5e6  # the ground has 6.385e6 at most
_TIME_AND_PLACE = ("time", "week", "latitude", "longitude", "height", "x", "y", "z")
_COLUMNS_AS_IN_FILE = (
    "v_north_m_s",
    "v_east_m_s",
    "v_down_m_s",
    "sigma_h_m",
    "sigma_v_m",
    "q_w",
    "q_x",
    "q_y",
    "q_z",
)


def read_trajectory_csv(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Read a trajectory from a CSV as a channel with one row for each row that can be read.

    Times are dates with a time of day, seconds of the week, with the week in a column or not, or
    seconds since 1970 (UTC) or 1980 (GPST). Positions are latitude, longitude and height, or
    earth-centred x, y and z. In a stated coordinate system x and y are its axes, z is the height,
    and yaw and velocities count from grid north. The attitude is a quaternion (v_ned = R(q)
    v_body), or roll, pitch and yaw: rotations about the body's x, y and z in the stated order.
    """
    if not stated.columns:
        raise messages.columns_unstated(where=path)
    table = text_table(
        path,
        stated.columns,
        codes=(messages.IMPORT_FORMAT, messages.IMPORT_COLUMN),
        key="stations.trajectory.columns",
    )
    quantities = _trajectory_numbers(table, path, stated, ledger)
    columns = {name: quantities[name] for name in _COLUMNS_AS_IN_FILE if name in quantities}
    places = _trajectory_places(path, quantities, stated, ledger)
    columns["lat_rad"] = places.lat_rad
    columns["lon_rad"] = places.lon_rad
    columns[places.height_column] = places.height_m
    if "yaw" in quantities:
        columns |= _quaternion_columns(path, quantities, stated, table.index)
    columns = without_impossible(path, columns, ledger)
    if places.grid_north_rad is not None:
        columns = from_grid_north(columns, places.grid_north_rad)
    times = table[stated.columns["time"]].str.strip()
    time_ns, has_time = _utc(path, times, quantities, stated, ledger)
    coordinates = [places.lat_rad, places.lon_rad, places.height_m]
    has_place = np.isfinite(coordinates).all(axis=0)
    return channel_of_rows(
        path,
        "CSV",
        time_ns,
        columns,
        ledger,
        readable=has_time & has_place,
    )


def _trajectory_numbers(
    table: pd.DataFrame,
    path: Path,
    stated: Stated,
    ledger: Ledger,
) -> dict[str, Array]:
    """The numbers (n,) of each stated column, by quantity; NaN and reported where unreadable.

    Latitude and longitude in degrees may be written in degrees and minutes.
    """
    quantities = {quantity: numbers(table[name]) for quantity, name in stated.columns.items()}
    _report_unreadable(table, quantities, path, stated, ledger)
    if stated.position_unit == "deg":
        for quantity in quantities.keys() & LIMITS_DEG.keys():
            quantities[quantity] = degrees_of(
                table,
                stated.columns[quantity],
                path,
                messages.IMPORT_FORMAT,
                quantity=quantity,
            )
    return quantities


@dataclass(frozen=True, eq=False)
class _Places:
    """Positions (n,) of a trajectory on WGS 84.

    ``height_column`` is the channel's column for these heights. ``grid_north_rad`` (n,) is the
    azimuth of grid north; None for positions without a stated coordinate system.
    """

    lat_rad: Array
    lon_rad: Array
    height_m: Array
    height_column: str
    grid_north_rad: Array | None = None


def _trajectory_places(
    path: Path,
    quantities: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> _Places:
    """The positions of a trajectory in a stated system, earth-centred, or geographic."""
    if stated.crs is not None:
        return _places_in_system(path, stated.crs, quantities, stated, ledger)
    if "x" in quantities:
        lat_rad, lon_rad, height_m = geodetic_of_ecef(
            quantities["x"], quantities["y"], quantities["z"]
        )
        height_column = stated.height_column(path, ledger, "ellipsoid")
        _refuse_far_from_ground(path, quantities)
        return _Places(lat_rad, lon_rad, height_m, height_column)
    unit_rad = RADIANS[stated.position_unit]
    return _Places(
        lat_rad=quantities["latitude"] * unit_rad,
        lon_rad=quantities["longitude"] * unit_rad,
        height_m=quantities["height"],
        height_column=stated.height_column(path, ledger),
    )


def _places_in_system(
    path: Path,
    crs: str,
    quantities: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> _Places:
    """Transform positions from the stated coordinate system ``crs`` to WGS 84."""
    is_msl = stated.height_column(path, ledger) == "h_msl_m"
    if "x" in quantities:
        coordinates = (quantities["x"], quantities["y"], quantities["z"])
    else:
        unit_deg = RADIANS[stated.position_unit] / RADIANS["deg"]
        coordinates = (
            quantities["longitude"] * unit_deg,
            quantities["latitude"] * unit_deg,
            quantities["height"],
        )
    places, notes = places_of(
        crs,
        coordinates,
        heights="msl" if is_msl else "ellipsoid",
        geoid=stated.geoid,
        where=str(path),
        key="stations.trajectory.crs",
    )
    ledger.extend(notes)
    return _Places(
        lat_rad=places.lat_rad,
        lon_rad=places.lon_rad,
        height_m=places.h_m,
        height_column="h_msl_m" if places.heights == "msl" else "h_ellipsoid_m",
        grid_north_rad=np.nan_to_num(places.convergence_rad),
    )


def _refuse_far_from_ground(path: Path, quantities: Mapping[str, Array]) -> None:
    """Refuse earth-centred x, y and z [m] with a median that is far from the earth's surface."""
    radii_m = np.linalg.norm([quantities[axis] for axis in "xyz"], axis=0)
    finite_radii_m = radii_m[np.isfinite(radii_m)]
    if finite_radii_m.size == 0:
        raise messages.no_row_readable(where=path)
    radius_m = float(np.median(finite_radii_m))
    if not _SMALLEST_RADIUS_M < radius_m < _LARGEST_RADIUS_M:
        raise messages.not_on_earth(where=path, radius=radius_m)


def _quaternion_columns(
    path: Path,
    quantities: Mapping[str, Array],
    stated: Stated,
    lines: "pd.Index[Any]",
) -> dict[str, Array]:
    """The columns q_x to q_w of roll, pitch and yaw; NaN where one of the three is unknown.

    ``lines`` (n,) are the lines of the rows in the file, for a refusal.
    """
    roll_pitch_yaw = np.stack(
        [quantities["roll"], quantities["pitch"], quantities["yaw"]],
        axis=1,
    )
    angles_rad = angles_in_radians(
        roll_pitch_yaw,
        stated.angle_unit,
        path,
        messages.IMPORT_ANGLES,
        key="stations.trajectory.angle_unit",
        lines=lines,
    )
    angles_rad = stated.angles_meant(angles_rad)
    is_known = np.isfinite(angles_rad).all(axis=1)
    columns_in_order = ["XYZ".index(axis) for axis in stated.angle_order]
    angles_in_order = angles_rad[is_known][:, columns_in_order]
    attitude = Rotation.from_euler(stated.angle_order, angles_in_order)
    quaternion = np.full((len(angles_rad), 4), np.nan)
    quaternion[is_known] = attitude.as_quat(canonical=True)
    return _columns_of_quaternion(quaternion)


def _columns_of_quaternion(quaternion: Array) -> dict[str, Array]:
    """The columns q_x to q_w of quaternions (n, 4) x, y, z, w."""
    return {
        "q_x": quaternion[:, 0],
        "q_y": quaternion[:, 1],
        "q_z": quaternion[:, 2],
        "q_w": quaternion[:, 3],
    }


# Texts that programs write for an unknown value, in lower case.
_UNKNOWN_WORDS = ("", "nan", "none", "null", "n/a", "-", "--")


def _report_unreadable(
    table: pd.DataFrame, quantities: Mapping[str, Array], path: Path, stated: Stated, ledger: Ledger
) -> None:
    """Report a loss for each column with fields that are neither numbers nor words for unknown.

    Columns of time and place are left out: a row without these is lost as a whole (see
    `channel_of_rows`). ``table`` has the texts of the numbers in ``quantities``.
    """
    for quantity, name in stated.columns.items():
        if quantity in _TIME_AND_PLACE:
            continue
        texts = table[name].str.strip().str.lower()
        is_stated = ~texts.isin(_UNKNOWN_WORDS).to_numpy(np.bool_)
        rows_unread = np.flatnonzero(is_stated & np.isnan(quantities[quantity]))
        if rows_unread.size:
            first_row = rows_unread[0]
            unreadable = messages.fields_unreadable(
                where=path.name,
                column=name,
                count=rows_unread.size,
                line=int(table.index[first_row]),
                first=table[name].iloc[first_row],
            )
            ledger.add(unreadable)


def from_grid_north(columns: dict[str, Array], convergence_rad: Array) -> dict[str, Array]:
    """A copy of the columns, with attitudes and velocities turned from grid north to true north.

    ``convergence_rad`` (n,) is the azimuth of grid north.
    """
    columns = dict(columns)
    if "q_w" in columns:
        quaternion = np.stack([columns[f"q_{axis}"] for axis in "xyzw"], axis=1)
        is_known = np.isfinite(quaternion).all(axis=1)
        true_from_grid = Rotation.from_euler("z", convergence_rad[is_known, None])
        attitude = true_from_grid * Rotation.from_quat(quaternion[is_known])
        quaternion[is_known] = attitude.as_quat(canonical=True)
        columns |= _columns_of_quaternion(quaternion)
    if "v_north_m_s" in columns and "v_east_m_s" in columns:
        velocity = columns["v_north_m_s"] + 1j * columns["v_east_m_s"]
        velocity = velocity * np.exp(1j * convergence_rad)
        columns["v_north_m_s"] = velocity.real
        columns["v_east_m_s"] = velocity.imag
    return columns


def _utc(
    path: Path,
    times: "pd.Series[str]",
    quantities: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> tuple[TimeArray, Mask]:
    """UTC (n,) of the rows, and which rows have a readable time.

    ``times`` (n,) are the fields as written. They are read as dates if none is a number, else as
    seconds: of the week in a column, of a week without column, or since 1970 (UTC) or 1980 (GPST).
    """
    system = stated.system_of(path, ledger)
    is_time = quantities["time"] >= 0.0  # NaN for dates; programs write -1 for unknown
    seconds = np.where(is_time, quantities["time"], np.nan)
    if not bool(is_time.any()):
        has_zone = times.str.contains(r"(?:Z|[+-]\d\d:?\d\d)$")
        if system == "gpst" and bool(has_zone.any()):
            raise messages.gps_time_with_zone(where=path, time=times.iloc[0])
        return utc_of_dates(times, system)
    if "week" in quantities:
        time_ns = utc_of_weeks(quantities["week"], seconds, system)
        return time_ns, is_time & (quantities["week"] >= 0)
    if float(np.nanmedian(seconds)) < _SINCE_EPOCH_S:
        return stated.utc_of_week_seconds(path, seconds, system), is_time
    if system == "gpst":
        week, second_of_week = np.divmod(seconds, SECONDS_PER_WEEK)
        return utc_of_weeks(week, second_of_week, system), is_time
    time_us = np.rint(np.where(is_time, seconds, 0.0) * 1e6)
    return whole_numbers(time_us, -_LAST_US, _LAST_US) * 1000, is_time
