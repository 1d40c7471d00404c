"""The trajectory in a user's CSV, by its names of columns, units and orders."""

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
_SINCE_EPOCH_S = 1e8  # seconds beyond this count from an epoch, not from the beginning of a week
_OF_EACH_ROW = ("time", "week", "latitude", "longitude", "height", "x", "y", "z")
_AS_THEY_ARE = (
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
    """The rows of a CSV as a channel.

    Times are dates with a time of day, seconds of the week, with the week in a column or not, or
    seconds since 1970 (UTC) or 1980 (GPST). Positions are latitude, longitude and height, or
    earth-centred x, y and z; in a stated coordinate system x and y are its, z is the height, and
    yaw and velocities count from grid north. The attitude is a quaternion (v_ned = R(q) v_body), or
    roll, pitch and yaw: rotations about the body's x, y and z in the stated order.
    """
    if not stated.columns:
        raise messages.columns_unstated(where=path)
    table = text_table(
        path,
        stated.columns,
        codes=(messages.IMPORT_FORMAT, messages.IMPORT_COLUMN),
        key="stations.trajectory.columns",
    )
    value = _trajectory_numbers(table, path, stated, ledger)
    columns = {name: value[name] for name in _AS_THEY_ARE if name in value}
    places = _trajectory_places(path, value, stated, ledger)
    columns["lat_rad"] = places.lat_rad
    columns["lon_rad"] = places.lon_rad
    columns[places.height_column] = places.height_m
    if "yaw" in value:
        columns |= _quaternion_columns(path, value, stated, table.index)
    columns = without_impossible(path, columns, ledger)
    if places.grid_north_rad is not None:
        columns = from_grid_north(columns, places.grid_north_rad)
    times = table[stated.columns["time"]].str.strip()
    time_ns, has_time = _utc(path, times, value, stated, ledger)
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
    """The numbers of all columns by their quantities; what cannot be read is reported."""
    value = {quantity: numbers(table[name]) for quantity, name in stated.columns.items()}
    _report_unreadable(table, value, path, stated, ledger)
    if stated.position_unit == "deg":
        for quantity in value.keys() & LIMITS_DEG.keys():
            value[quantity] = degrees_of(
                table,
                stated.columns[quantity],
                path,
                messages.IMPORT_FORMAT,
                quantity=quantity,
            )
    return value


@dataclass(frozen=True, eq=False)
class _Places:
    """Positions (n,) and what their heights are; azimuth of grid north where they have a grid."""

    lat_rad: Array
    lon_rad: Array
    height_m: Array
    height_column: str
    grid_north_rad: Array | None = None


def _trajectory_places(
    path: Path,
    value: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> _Places:
    """The positions of a trajectory, whichever coordinates it has."""
    if stated.crs is not None:
        return _places_in_system(path, stated.crs, value, stated, ledger)
    if "x" in value:
        lat_rad, lon_rad, height_m = geodetic_of_ecef(value["x"], value["y"], value["z"])
        height_column = stated.height_column(path, ledger, "ellipsoid")
        _refuse_elsewhere_than_earth(path, value)
        return _Places(lat_rad, lon_rad, height_m, height_column)
    unit = RADIANS[stated.position_unit]
    return _Places(
        lat_rad=value["latitude"] * unit,
        lon_rad=value["longitude"] * unit,
        height_m=value["height"],
        height_column=stated.height_column(path, ledger),
    )


def _places_in_system(
    path: Path,
    crs: str,
    value: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> _Places:
    """The positions of coordinates in a stated system, on WGS 84."""
    is_msl = stated.height_column(path, ledger) == "h_msl_m"
    if "x" in value:
        coordinates = (value["x"], value["y"], value["z"])
    else:
        degrees = RADIANS[stated.position_unit] / RADIANS["deg"]
        coordinates = (
            value["longitude"] * degrees,
            value["latitude"] * degrees,
            value["height"],
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


def _refuse_elsewhere_than_earth(path: Path, value: Mapping[str, Array]) -> None:
    """Refuse earth-centred x, y and z that are not near the earth's surface in the median."""
    radii_m = np.linalg.norm([value[axis] for axis in "xyz"], axis=0)
    known_m = radii_m[np.isfinite(radii_m)]
    if known_m.size == 0:
        raise messages.no_row_readable(where=path)
    radius_m = float(np.median(known_m))
    if not 6.3e6 < radius_m < 6.5e6:
        raise messages.not_on_earth(where=path, radius=radius_m)


def _quaternion_columns(
    path: Path,
    value: Mapping[str, Array],
    stated: Stated,
    lines: "pd.Index[Any]",
) -> dict[str, Array]:
    """The columns q_x to q_w of roll, pitch and yaw; NaN where one of these is unknown."""
    given = np.stack([value["roll"], value["pitch"], value["yaw"]], axis=1)
    angles_rad = angles_in_radians(
        given,
        stated.angle_unit,
        path,
        messages.IMPORT_ANGLES,
        key="stations.trajectory.angle_unit",
        lines=lines,
    )
    angles_rad = stated.angles_meant(angles_rad)
    is_known = np.isfinite(angles_rad).all(axis=1)
    axes = ["XYZ".index(axis) for axis in stated.angle_order]
    turn = Rotation.from_euler(stated.angle_order, angles_rad[is_known][:, axes])
    quaternion = np.full((len(angles_rad), 4), np.nan)
    quaternion[is_known] = turn.as_quat(canonical=True)
    return _columns_of_quaternion(quaternion)


def _columns_of_quaternion(quaternion: Array) -> dict[str, Array]:
    """The columns q_x to q_w of quaternions (n, 4) x, y, z, w."""
    return {
        "q_x": quaternion[:, 0],
        "q_y": quaternion[:, 1],
        "q_z": quaternion[:, 2],
        "q_w": quaternion[:, 3],
    }


# Words for a value that is not known, as programs write them.
_UNKNOWN_WORDS = ("", "nan", "none", "null", "n/a", "-", "--")


def _report_unreadable(
    table: pd.DataFrame, value: Mapping[str, Array], path: Path, stated: Stated, ledger: Ledger
) -> None:
    """A loss for each column beside time and place with fields that are no numbers.

    Rows whose time or place cannot be read are lost as a whole (see `channel_of_rows`).
    """
    for quantity, name in stated.columns.items():
        if quantity in _OF_EACH_ROW:
            continue
        words = table[name].str.strip().str.lower()
        is_stated = ~words.isin(_UNKNOWN_WORDS).to_numpy(np.bool_)
        rows_unread = np.flatnonzero(is_stated & np.isnan(value[quantity]))
        if rows_unread.size:
            first_row = rows_unread[0]
            lost = messages.fields_unreadable(
                where=path.name,
                column=name,
                count=rows_unread.size,
                line=int(table.index[first_row]),
                first=table[name].iloc[first_row],
            )
            ledger.add(lost)


def from_grid_north(columns: dict[str, Array], convergence_rad: Array) -> dict[str, Array]:
    """Columns with attitudes and velocities against true north instead of grid north."""
    columns = dict(columns)
    if "q_w" in columns:
        quaternion = np.stack([columns[f"q_{axis}"] for axis in "xyzw"], axis=1)
        is_known = np.isfinite(quaternion).all(axis=1)
        from_grid = Rotation.from_euler("z", convergence_rad[is_known, None])
        turned = from_grid * Rotation.from_quat(quaternion[is_known])
        quaternion[is_known] = turned.as_quat(canonical=True)
        columns |= _columns_of_quaternion(quaternion)
    if "v_north_m_s" in columns and "v_east_m_s" in columns:
        velocity = columns["v_north_m_s"] + 1j * columns["v_east_m_s"]
        velocity = velocity * np.exp(1j * convergence_rad)
        columns["v_north_m_s"] = velocity.real
        columns["v_east_m_s"] = velocity.imag
    return columns


def _utc(
    path: Path,
    text: "pd.Series[str]",
    value: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> tuple[TimeArray, Mask]:
    """UTC of the rows, and which have a readable time."""
    system = stated.system_of(path, ledger)
    is_time = value["time"] >= 0.0  # -1 stands for an unknown time
    seconds = np.where(is_time, value["time"], np.nan)
    if not bool(is_time.any()):
        has_zone = text.str.contains(r"(?:Z|[+-]\d\d:?\d\d)$")
        if system == "gpst" and bool(has_zone.any()):
            raise messages.gps_time_with_zone(where=path, time=text.iloc[0])
        return utc_of_dates(text, system)
    if "week" in value:
        time_ns = utc_of_weeks(value["week"], seconds, system)
        return time_ns, is_time & (value["week"] >= 0)
    if float(np.nanmedian(seconds)) < _SINCE_EPOCH_S:
        return stated.utc_of_week_seconds(path, seconds, system), is_time
    if system == "gpst":
        week, second_of_week = np.divmod(seconds, SECONDS_PER_WEEK)
        return utc_of_weeks(week, second_of_week, system), is_time
    time_us = np.rint(np.where(is_time, seconds, 0.0) * 1e6)
    return whole_numbers(time_us, -_LAST_US, _LAST_US) * 1000, is_time
