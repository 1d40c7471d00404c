"""The user's CSV, by its names of columns, units and orders: trajectories, orientations, events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK
from unbend.flight.heights import GeodeticOrigin
from unbend.flight.stations import NO_TIME
from unbend.geodesy import geodetic_of_ecef
from unbend.messages import Ledger, Notes
from unbend.tables.geodata.coordinate_systems import GeocentricDatum, places_of
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated, channel_of_rows, without_impossible
from unbend.tables.text_columns import (
    angles_in_radians,
    degrees_of,
    largest_of,
    numbers,
    numbers_of,
    require_names,
    text_of_frame,
    text_table,
    unrepeated_table,
    utc_of_columns,
    utc_of_dates,
    utc_of_weeks,
)
from unbend.units import DEGREE, RADIANS, Array, Integers, Mask, Names, whole_numbers

_LAST_US = 9 * 10**15  # since 1970: 2255, in nanoseconds within 64 bits
_SINCE_EPOCH_S = 1e8  # seconds beyond this count from an epoch, not from the beginning of a week
_OF_EACH_ROW = ("time", "week", "latitude", "longitude", "height", "x", "y", "z")
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
        raise messages.columns_unstated(where=path)
    table = text_table(path, stated.columns, codes=(messages.IMPORT_FORMAT, messages.IMPORT_COLUMN),
                       key="stations.trajectory.columns")  # fmt: skip
    value = {quantity: numbers(table[name]) for quantity, name in stated.columns.items()}
    _report_unreadable(table, value, path, stated, ledger)
    if stated.position_unit == "deg":
        for quantity in value.keys() & _LIMITS_DEG.keys():
            name = stated.columns[quantity]
            value[quantity] = degrees_of(
                table, name, path, messages.IMPORT_FORMAT, quantity=quantity
            )
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
        _refuse_elsewhere_than_earth(path, value)
    else:
        unit = RADIANS[stated.position_unit]
        lat, lon, height = value["latitude"] * unit, value["longitude"] * unit, value["height"]
        surface = stated.height_column(path, ledger)
    columns |= {"lat_rad": lat, "lon_rad": lon, surface: height}
    if "yaw" in value:
        columns |= _quaternion_columns(path, value, stated, table.index)
    columns = without_impossible(path, columns, ledger)
    if grid_north is not None:
        columns = from_grid_north(columns, grid_north)
    time_ns, readable = _utc(path, table[stated.columns["time"]].str.strip(), value, stated, ledger)
    readable = readable & np.isfinite([lat, lon, height]).all(axis=0)
    return channel_of_rows(path, "CSV", time_ns, columns, ledger, readable=readable)


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
    path: Path, value: Mapping[str, Array], stated: Stated, lines: "pd.Index[Any]"
) -> dict[str, Array]:
    """The columns q_x to q_w of roll, pitch and yaw; NaN where one of these is unknown."""
    given = np.stack([value[name] for name in ("roll", "pitch", "yaw")], axis=1)
    angles_rad = angles_in_radians(
        given,
        stated.angle_unit,
        path,
        messages.IMPORT_ANGLES,
        key="stations.trajectory.angle_unit",
        lines=lines,
    )
    angles_rad = stated.angles_meant(angles_rad)
    known = np.isfinite(angles_rad).all(axis=1)
    axes = ["XYZ".index(axis) for axis in stated.angle_order]
    turn = Rotation.from_euler(stated.angle_order, angles_rad[known][:, axes])
    q = np.full((known.size, 4), np.nan)
    q[known] = turn.as_quat(canonical=True)
    return {f"q_{axis}": q[:, k] for k, axis in enumerate("xyzw")}


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
        unread = np.flatnonzero(is_stated & np.isnan(value[quantity]))
        if unread.size:
            ledger.add(
                messages.fields_unreadable(
                    where=path.name,
                    column=name,
                    count=unread.size,
                    line=int(table.index[unread[0]]),
                    first=table[name].iloc[unread[0]],
                )
            )


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
    path: Path, text: "pd.Series[str]", value: dict[str, Array], stated: Stated, ledger: Ledger
) -> tuple[TimeArray, Mask]:
    """UTC of the rows, and which have a readable time."""
    system, seconds = stated.system_of(path, ledger), value["time"]
    readable = np.isfinite(seconds)
    if not bool(readable.any()):
        if system == "gpst" and bool(text.str.contains(r"(?:Z|[+-]\d\d:?\d\d)$").any()):
            raise messages.gps_time_with_zone(where=path, time=text.iloc[0])
        return utc_of_dates(text, system)
    if "week" in value:
        readable = readable & np.isfinite(value["week"])
        return utc_of_weeks(value["week"], seconds, system), readable
    if float(np.nanmedian(seconds)) < _SINCE_EPOCH_S:
        return stated.utc_of_week_seconds(path, seconds, system), readable
    if system == "gpst":
        since_1980 = np.where(readable, seconds, 0.0)
        return utc_of_weeks(*np.divmod(since_1980, SECONDS_PER_WEEK), system), readable
    readable = readable & (seconds >= 0.0)  # -1 stands for an unknown time
    time_us = np.rint(np.where(readable, seconds, 0.0) * 1e6)
    return whole_numbers(time_us, -_LAST_US, _LAST_US) * 1000, readable


_ANGLES = {
    "omega", "phi", "kappa", "roll", "pitch", "yaw", "q_w", "q_x", "q_y", "q_z",
}  # fmt: skip
_CODES_OF_ORIENTATION = (messages.ORIENTATION_CSV, messages.ORIENTATION_COLUMN)
_LIMITS_DEG = {"latitude": 90.0, "longitude": 360.0}
_LONGEST_NORM_ERROR = 1e-3


@dataclass(frozen=True, eq=False)
class OrientationTable:
    """A table of orientations as read; (n,) arrays, ``angles`` (n, 3) [rad] or (n, 4) quaternions.

    ``position`` (n, 3) is latitude, longitude [rad] and height [m], or x, y, z [m]. ``camera`` is
    None without that column; ``time_ns`` is `NO_TIME` where unknown; ``sigmas`` holds columns in SI
    and radians by quantity, for those that are there. ``convergence_rad`` (n,) is the azimuth of
    the grid's north, ``heights`` what a coordinate system says of them. ``frame`` is what a file
    says of the frame of its x, y, z: earth-centred, on WGS 84 or of another datum, or the origin of
    east, north and up; ``crs`` is the coordinate system that it names for them. ``notes`` are what
    its reader has to say.
    """

    image: Names
    camera: Names | None
    time_ns: Integers
    position: Array
    angles: Array
    sigmas: Mapping[str, Array]
    convergence_rad: Array | float = 0.0
    heights: str | None = None
    frame: Literal["ecef"] | GeodeticOrigin | GeocentricDatum | None = None
    crs: str | None = None
    notes: Notes = ()


def read_orientation(path: Path, stated: Stated, ledger: Ledger) -> OrientationTable:
    """Read a table of orientations by the user's names of its columns.

    The columns that are stated have latitude and longitude in degrees, heights, x, y, z in metres;
    the attitude is three angles in the stated unit, in the order of their columns, or q_w to q_z.

    Refuses (InputError) columns that are not there, text for numbers, images that stand there
    twice, latitudes and angles that none can be, and quaternions that are no rotations.
    """
    of_names = {stated.columns["image"], stated.columns.get("camera", ""), *_USUAL_NAMES["image"]}
    table = unrepeated_table(path, _CODES_OF_ORIENTATION[0], of_names)
    usual = usual_columns(table.columns.tolist(), stated)
    if "time_utc" in usual and not table[usual["time_utc"]].str.strip().any():
        del usual["time_utc"]  # stations without a time
    if usual:
        ledger.add(messages.columns_by_usual_names(where=path.name, names=usual))
    columns = {**stated.columns, **usual}
    key = "stations.orientation.columns"
    wanted = [(quantity, name, f"{key}.{quantity}") for quantity, name in columns.items()]
    require_names(_CODES_OF_ORIENTATION[1], path, table.columns.tolist(), wanted)
    return _orientation(table, path, replace(stated, columns=columns), ledger)


_USUAL_NAMES: Mapping[str, tuple[str, ...]] = {
    "image": ("imageName", "PhotoID", "Label", "filename", "image_name", "name"),
    "latitude": ("lat_deg", "latitude_deg", "lat"),
    "longitude": ("lon_deg", "longitude_deg", "lon", "long", "lng"),
    "x": ("x_m", "X/East", "X/Easting", "east", "easting"),
    "y": ("y_m", "Y/North", "Y/Northing", "north", "northing"),
    "z": ("z_m", "Z/Altitude", "up"),
}
"""Names that programs give to columns of orientations, beside that of the quantity itself."""

_NAMES_OF_HEIGHTS = {"ellipsoid": ("h_ellipsoid_m",), "msl": ("h_msl_m",)}
_NAMES_OF_OWN_EXPORT = {
    "image", "camera", "status", "time_utc", "lat_deg", "lon_deg", "h_ellipsoid_m", "omega_deg",
    "phi_deg", "kappa_deg", "sigma_horizontal_m", "sigma_height_m", "sigma_tilt_deg",
    "sigma_yaw_deg",
}  # fmt: skip


_OWN_NAMES = {"sigma_tilt": "sigma_tilt_deg", "sigma_yaw": "sigma_yaw_deg"}


def usual_columns(names: Sequence[str], stated: Stated) -> dict[str, str]:
    """Quantity -> name, for quantities that the mission file does not name and programs usually do.

    A quantity that is not named has the name of its own; where the table has no such column, one in
    other case or of a usual name takes its place, if it is the only one. Of our own table of
    orientations everything is known that nothing states.
    """
    columns = {}
    for quantity, name in stated.columns.items():
        is_named = name != quantity
        if is_named or name in names:
            continue
        usual = _usual_names(quantity, stated)
        candidates = [known for known in names if known.lower() in usual]
        if len(candidates) == 1:
            columns[quantity] = candidates[0]
    if set(names) >= _NAMES_OF_OWN_EXPORT and stated.angle_unit == "deg":
        columns |= {quantity: _OWN_NAMES.get(quantity, quantity) for quantity in stated.unstated}
    return columns


def _usual_names(quantity: str, stated: Stated) -> set[str]:
    """The usual names of the column of a quantity, in small letters."""
    usual = {quantity, *_USUAL_NAMES.get(quantity, ())}
    if quantity == "height":
        usual.update(_NAMES_OF_HEIGHTS.get(stated.heights or "", ()))
    if quantity in _ANGLES and not quantity.startswith("q_"):
        usual.add(f"{quantity}_{stated.angle_unit}")
    return {name.lower() for name in usual}


def orientation_of_frame(
    frame: pd.DataFrame, name: str, stated: Stated, ledger: Ledger
) -> OrientationTable:
    """As `read_orientation` of a table in memory, which messages call ``name``."""
    key = "stations.orientation.columns"
    table = text_of_frame(frame, stated.columns, name, codes=_CODES_OF_ORIENTATION, key=key)
    return _orientation(table, Path(name), stated, ledger)


def _orientation(
    table: pd.DataFrame, path: Path, stated: Stated, ledger: Ledger
) -> OrientationTable:
    """The orientations of a table of text."""
    names, unit = stated.columns, stated.angle_unit
    angle_names = [name for name in names if name in _ANGLES]
    _refuse_repeated(table, names["image"], path)
    value = _numbers(table, names, path)
    position = _positions(value, path, "stations.orientation.columns", table.index)
    angles = np.stack([value[name] for name in angle_names], axis=1)
    if len(angle_names) == 4:
        attitude = _unit_quaternions(angles, table, path)
    else:
        attitude = angles_in_radians(
            angles,
            unit,
            path,
            messages.ORIENTATION_UNIT,
            key="stations.orientation.unit",
            lines=table.index,
        )
    sigmas = {name: values for name, values in value.items() if name.startswith("sigma_")}
    for tilt in {"sigma_tilt", "sigma_yaw"} & sigmas.keys():
        sigmas[f"{tilt}_rad"] = sigmas.pop(tilt) * RADIANS[unit]
    time_ns = np.full(len(table), NO_TIME, np.int64)
    if "time_utc" in names or "gps_week" in names:
        read_ns, good = utc_of_columns(table, names)
        time_ns[good] = read_ns[good]
        if bad := int((~good).sum()):
            line = int(table.index[int(np.argmin(good))])
            ledger.add(messages.orientations_without_time(where=path.name, count=bad, line=line))
    camera = table[names["camera"]].to_numpy(object) if "camera" in names else None
    image = table[names["image"]].to_numpy(object)
    frame = _frame_of_own_export(table, path) if set(_ORIGIN) <= set(table.columns) else None
    return OrientationTable(image, camera, time_ns, position, attitude, sigmas, frame=frame)


def _unit_quaternions(quaternion: Array, table: pd.DataFrame, path: Path) -> Array:
    """(n, 4) quaternions of length 1; refuses those whose length is another."""
    length = np.linalg.norm(quaternion, axis=1)
    error = np.abs(length - 1.0)
    wrong = error > _LONGEST_NORM_ERROR
    if wrong.any():
        worst = int(np.nanargmax(error))
        raise messages.orientation_quaternion(
            path=path,
            line=int(table.index[worst]),
            count=int(wrong.sum()),
            length=float(length[worst]),
        )
    return np.asarray(quaternion / length[:, None])


_ORIGIN = ("origin_lat_deg", "origin_lon_deg", "origin_h_ellipsoid_m")


def _frame_of_own_export(table: pd.DataFrame, path: Path) -> GeodeticOrigin | None:
    """The one place whose east, north and up is the frame of our own table ``opk-enu``."""
    origin = [numbers_of(table, name, path, messages.ORIENTATION_NUMBER) for name in _ORIGIN]
    latitude, longitude, h_m = (float(values[0]) for values in origin)
    return GeodeticOrigin(latitude * DEGREE, longitude * DEGREE, h_m)


def read_known_positions(path: Path, names: Mapping[str, str]) -> tuple[Names, Array]:
    """Images, and (m, 3) their latitude, longitude [rad] and height [m], from a CSV."""
    key = "stations.orientation.known_positions"
    table = text_table(path, names, codes=_CODES_OF_ORIENTATION, key=key)
    _refuse_repeated(table, names["image"], path)
    position = _positions(_numbers(table, names, path), path, key, table.index)
    return table[names["image"]].to_numpy(object), position


def _refuse_repeated(table: pd.DataFrame, column: str, path: Path) -> None:
    """Refuse a table without rows, and one that has an image twice."""
    images = table[column]
    if len(images) == 0:
        raise messages.orientations_empty(where=path)
    twice = images[images.duplicated(keep=False)]
    if len(twice):
        lines = ", ".join(str(line) for line in twice.index[twice == twice.iloc[0]])
        raise messages.orientation_repeated(
            where=path, count=twice.nunique(), image=twice.iloc[0], lines=lines
        )


def _numbers(table: pd.DataFrame, names: Mapping[str, str], path: Path) -> dict[str, Array]:
    """The columns that hold numbers, by quantity; latitude and longitude in degrees."""
    value = {}
    for quantity, column in names.items():
        if quantity in _LIMITS_DEG:
            value[quantity] = degrees_of(
                table, column, path, messages.ORIENTATION_NUMBER, quantity=quantity
            )
        elif quantity not in ("image", "camera", "time_utc"):
            code = messages.ORIENTATION_NUMBER
            value[quantity] = numbers_of(table, column, path, code, largest_of(quantity))
    return value


def _positions(value: Mapping[str, Array], path: Path, key: str, lines: "pd.Index[Any]") -> Array:
    """(n, 3) positions, latitude and longitude in radians; refuses those of no place on earth.

    ``lines`` (n,) are those of the rows.
    """
    if "x" in value:
        return np.stack([value[axis] for axis in "xyz"], axis=1)
    for quantity, limit in _LIMITS_DEG.items():
        wrong = np.abs(value[quantity]) > limit
        if bool(wrong.any()):
            swapped = quantity == "latitude" and bool((np.abs(value[quantity]) <= 360.0).all())
            row = int(np.argmax(wrong))
            raise messages.orientation_position(
                path=path,
                line=int(lines[row]),
                count=int(wrong.sum()),
                limit=limit,
                quantity=quantity,
                first=float(value[quantity][row]),
                swapped=swapped,
                key=key,
            )
    lat, lon = np.radians(value["latitude"]), np.radians(value["longitude"])
    position = np.stack([lat, lon, value["height"]], axis=1)
    is_unset = (lat == 0.0) & (lon == 0.0)  # as programs fill fields that they do not know
    position[is_unset] = np.nan
    return position


@dataclass(frozen=True, eq=False)
class EventTable:
    """Exposures as a table gave them; (m,) image, camera (or None), UTC [ns]."""

    image: Names
    camera: Names | None
    time_ns: Integers


def read_events(path: Path, columns: Mapping[str, str], ledger: Ledger) -> EventTable:
    """Read a table of exposures; a row without a readable time is a loss in the ledger.

    ``columns`` : image, time_utc or gps_week and gps_seconds, and camera where it is there -> the
    user's names. Times without a zone are UTC; GPS seconds are reduced by the leap seconds of
    their date.
    """
    table = text_table(path, columns, codes=(messages.EVENTS_CSV, messages.EVENTS_COLUMN),
                       key="events.csv.columns")  # fmt: skip
    time_ns, good = utc_of_columns(table, columns)
    if not bool(good.all()):
        rows = np.flatnonzero(~good)
        line = int(table.index[rows[0]])
        ledger.add(messages.events_without_time(where=path.name, count=rows.size, line=line))
    if not bool(good.any()):
        raise messages.events_empty(where=path)
    table, time_ns = table[good], time_ns[good]
    camera = table[columns["camera"]].to_numpy(object) if "camera" in columns else None
    return EventTable(table[columns["image"]].to_numpy(object), camera, time_ns)
