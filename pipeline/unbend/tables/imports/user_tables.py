"""The user's CSV of orientations or events, with columns, units and orders of the mission file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from unbend.flight.heights import GeodeticOrigin
from unbend.flight.stations import NO_TIME
from unbend.messages import Ledger, Notes
from unbend.tables.geodata.geocentric_datums import GeocentricDatum
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated
from unbend.tables.text_columns import (
    angles_in_radians,
    degrees_of,
    largest_of,
    numbers_of,
    require_names,
    text_of_frame,
    text_table,
    unrepeated_table,
    utc_of_columns,
)
from unbend.units import DEGREE, RADIANS, Array, Integers, Names

_ANGLES = {
    "omega",
    "phi",
    "kappa",
    "roll",
    "pitch",
    "yaw",
    "q_w",
    "q_x",
    "q_y",
    "q_z",
}
_CODES_OF_ORIENTATION = (messages.ORIENTATION_CSV, messages.ORIENTATION_COLUMN)
LIMITS_DEG = {"latitude": 90.0, "longitude": 360.0}  # largest size of an angle of a place
_LARGEST_NORM_ERROR = 1e-3  # of quaternions, which are written with a few digits


@dataclass(frozen=True, eq=False)
class OrientationTable:
    """A table of orientations as read; (n,) arrays, ``angles`` (n, 3) [rad] or (n, 4) quaternions.

    ``position`` (n, 3) is latitude, longitude [rad] and height [m], or x, y, z [m]. ``camera`` is
    None without that column; ``time_ns`` is `NO_TIME` where unknown; ``sigmas`` are the columns of
    sigmas that the table has, by quantity, in SI units and radians. ``convergence_rad`` (n,) is the
    azimuth of the grid's north, ``heights`` the surface that a coordinate system states for them.
    ``frame`` is the frame of x, y, z that a file states: earth-centred, on WGS 84 or another datum,
    or the origin of east, north and up; ``crs`` is the coordinate system that it names for them.
    ``notes`` are messages of its reader.
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
    """Read a table of orientations by the stated names of its columns, or by usual names.

    Latitude and longitude are in degrees, heights, x, y, z in metres; the attitude is three angles
    in the stated unit, in the order of their columns, or q_w to q_z.

    Refuses (InputError) missing columns, text for numbers, images that occur twice, impossible
    latitudes and angles, and quaternions that are not rotations.
    """
    text_columns = {
        stated.columns["image"],
        stated.columns.get("camera", ""),
        *_USUAL_NAMES["image"],
    }
    table = unrepeated_table(path, messages.ORIENTATION_CSV, text_columns)
    usual = usual_columns(table.columns.tolist(), stated)
    if "time_utc" in usual and not table[usual["time_utc"]].str.strip().any():
        del usual["time_utc"]  # stations without a time
    if usual:
        ledger.add(messages.columns_by_usual_names(where=path.name, names=usual))
    columns = {**stated.columns, **usual}
    key = "stations.orientation.columns"
    needed = [(quantity, name, f"{key}.{quantity}") for quantity, name in columns.items()]
    require_names(messages.ORIENTATION_COLUMN, path, table.columns.tolist(), needed)
    return _orientation(table, path, replace(stated, columns=columns), ledger)


KEY_OF_KNOWN_POSITIONS = "stations.orientation.known_positions"

_USUAL_NAMES: Mapping[str, tuple[str, ...]] = {
    "image": ("imageName", "PhotoID", "Label", "filename", "image_name", "name"),
    "latitude": ("lat_deg", "latitude_deg", "lat"),
    "longitude": ("lon_deg", "longitude_deg", "lon", "long", "lng"),
    "x": ("x_m", "X/East", "X/Easting", "east", "easting"),
    "y": ("y_m", "Y/North", "Y/Northing", "north", "northing"),
    "z": ("z_m", "Z/Altitude", "up"),
}
"""Quantity -> names that programs give to its column, other than that of the quantity itself."""

_NAMES_OF_HEIGHTS = {"ellipsoid": ("h_ellipsoid_m",), "msl": ("h_msl_m",)}
_NAMES_OF_UNBEND_TABLE = {
    "image",
    "camera",
    "status",
    "time_utc",
    "lat_deg",
    "lon_deg",
    "h_ellipsoid_m",
    "omega_deg",
    "phi_deg",
    "kappa_deg",
    "sigma_horizontal_m",
    "sigma_height_m",
    "sigma_tilt_deg",
    "sigma_yaw_deg",
}
_NAMES_IN_UNBEND_TABLE = {"sigma_tilt": "sigma_tilt_deg", "sigma_yaw": "sigma_yaw_deg"}


def usual_columns(names: Sequence[str], stated: Stated) -> dict[str, str]:
    """Quantity -> column, for quantities with a column that is recognised by a usual name.

    ``names`` are the columns of the table. The column of a quantity that the mission file does not
    name has the quantity's name. If the table has no such column, the one column with that name in
    other case, or with a usual name, is used; of several, none. In a table of orientations that
    this package has written, all unstated quantities are recognised.
    """
    columns = {}
    for quantity, name in stated.columns.items():
        is_named = name != quantity
        if is_named or name in names:
            continue
        usual_names = _usual_names(quantity, stated)
        candidates = [candidate for candidate in names if candidate.lower() in usual_names]
        if len(candidates) == 1:
            columns[quantity] = candidates[0]
    is_unbend_table = set(names) >= _NAMES_OF_UNBEND_TABLE
    if is_unbend_table and stated.angle_unit == "deg":
        for quantity in stated.unstated:
            columns[quantity] = _NAMES_IN_UNBEND_TABLE.get(quantity, quantity)
    return columns


def _usual_names(quantity: str, stated: Stated) -> set[str]:
    """The usual names of the column of a quantity, in lower case."""
    usual = {quantity, *_USUAL_NAMES.get(quantity, ())}
    if quantity == "height":
        usual.update(_NAMES_OF_HEIGHTS.get(stated.heights or "", ()))
    if quantity in _ANGLES and not quantity.startswith("q_"):
        usual.add(f"{quantity}_{stated.angle_unit}")
    return {name.lower() for name in usual}


def orientation_of_frame(
    frame: pd.DataFrame, name: str, stated: Stated, ledger: Ledger
) -> OrientationTable:
    """Read a table of orientations in memory, as `read_orientation` but by stated names alone.

    ``name`` is the name of the table in messages.
    """
    key = "stations.orientation.columns"
    table = text_of_frame(frame, stated.columns, name, codes=_CODES_OF_ORIENTATION, key=key)
    return _orientation(table, Path(name), stated, ledger)


def _orientation(
    table: pd.DataFrame, path: Path, stated: Stated, ledger: Ledger
) -> OrientationTable:
    """Convert a table of texts, with the columns that ``stated`` names, to orientations.

    Rows without a readable time are reported, if the table has times.
    """
    names = stated.columns
    _refuse_repeated(table, names["image"], path)
    quantities = _numbers_by_quantity(table, names, path)
    position = _positions(quantities, path, "stations.orientation.columns", table.index)
    angles = _attitudes(quantities, table, path, stated)
    time_ns = np.full(len(table), NO_TIME, np.int64)
    if "time_utc" in names or "gps_week" in names:
        read_ns, is_time = utc_of_columns(table, names)
        time_ns[is_time] = read_ns[is_time]
        without_time = int((~is_time).sum())
        if without_time:
            first_row = int(np.argmin(is_time))
            lost = messages.orientations_without_time(
                where=path.name,
                count=without_time,
                line=int(table.index[first_row]),
            )
            ledger.add(lost)
    has_origin = set(_ORIGIN) <= set(table.columns)
    return OrientationTable(
        image=table[names["image"]].to_numpy(object),
        camera=table[names["camera"]].to_numpy(object) if "camera" in names else None,
        time_ns=time_ns,
        position=position,
        angles=angles,
        sigmas=_sigmas(quantities, RADIANS[stated.angle_unit]),
        frame=_origin_of_table(table, path) if has_origin else None,
    )


def _attitudes(
    quantities: Mapping[str, Array],
    table: pd.DataFrame,
    path: Path,
    stated: Stated,
) -> Array:
    """(n, 3) angles [rad] in the order in which ``stated`` has them, or (n, 4) quaternions."""
    angle_names = [quantity for quantity in stated.columns if quantity in _ANGLES]
    angles = np.stack([quantities[name] for name in angle_names], axis=1)
    if len(angle_names) == 4:
        return _unit_quaternions(angles, table, path)
    return angles_in_radians(
        angles,
        stated.angle_unit,
        path,
        messages.ORIENTATION_UNIT,
        key="stations.orientation.unit",
        lines=table.index,
    )


def _sigmas(quantities: Mapping[str, Array], unit_rad: float) -> dict[str, Array]:
    """The standard deviations of a table in SI units and radians, by quantity.

    ``unit_rad`` is the size [rad] of the unit of angles in the table.
    """
    sigmas = {name: values for name, values in quantities.items() if name.startswith("sigma_")}
    for name in ("sigma_tilt", "sigma_yaw"):
        if name in sigmas:
            sigmas[f"{name}_rad"] = sigmas.pop(name) * unit_rad
    return sigmas


def _unit_quaternions(quaternion: Array, table: pd.DataFrame, path: Path) -> Array:
    """(n, 4) quaternions scaled to length 1; refuses lengths that differ from it by over 1e-3."""
    length = np.linalg.norm(quaternion, axis=1)
    error = np.abs(length - 1.0)
    is_wrong = error > _LARGEST_NORM_ERROR
    if is_wrong.any():
        worst = int(np.nanargmax(error))
        raise messages.orientation_quaternion(
            path=path,
            line=int(table.index[worst]),
            count=int(is_wrong.sum()),
            length=float(length[worst]),
        )
    return np.asarray(quaternion / length[:, None])


# Columns of the table opk-enu that this package writes; all rows have the same values.
_ORIGIN = ("origin_lat_deg", "origin_lon_deg", "origin_h_ellipsoid_m")


def _origin_of_table(table: pd.DataFrame, path: Path) -> GeodeticOrigin | None:
    """The origin of the table's frame of east, north and up, from the first row of `_ORIGIN`."""
    origin = [numbers_of(table, name, path, messages.ORIENTATION_NUMBER) for name in _ORIGIN]
    latitude, longitude, h_m = (float(values[0]) for values in origin)
    return GeodeticOrigin(latitude * DEGREE, longitude * DEGREE, h_m)


def read_known_positions(path: Path, names: Mapping[str, str]) -> tuple[Names, Array]:
    """Read images (m,), and (m, 3) their latitude, longitude [rad] and height [m], from a CSV.

    ``names`` are the columns of image, latitude, longitude and height, by quantity.
    """
    table = text_table(path, names, codes=_CODES_OF_ORIENTATION, key=KEY_OF_KNOWN_POSITIONS)
    return _known_positions(table, path, names)


def known_positions_of_frame(
    frame: pd.DataFrame, name: str, names: Mapping[str, str]
) -> tuple[Names, Array]:
    """As `read_known_positions`, of a table in memory; ``name`` is its name in messages."""
    table = text_of_frame(
        frame, names, name, codes=_CODES_OF_ORIENTATION, key=KEY_OF_KNOWN_POSITIONS
    )
    return _known_positions(table, Path(name), names)


def _known_positions(
    table: pd.DataFrame, path: Path, names: Mapping[str, str]
) -> tuple[Names, Array]:
    """The images and known positions of a table of texts; ``names`` are its columns by quantity."""
    _refuse_repeated(table, names["image"], path)
    quantities = _numbers_by_quantity(table, names, path)
    position = _positions(quantities, path, KEY_OF_KNOWN_POSITIONS, table.index)
    return table[names["image"]].to_numpy(object), position


def _refuse_repeated(table: pd.DataFrame, column: str, path: Path) -> None:
    """Refuse a table without rows, and a table with an image in two rows of ``column``."""
    images = table[column]
    if len(images) == 0:
        raise messages.orientations_empty(where=path)
    repeated = images[images.duplicated(keep=False)]
    if len(repeated):
        first_image = repeated.iloc[0]
        lines = repeated.index[repeated == first_image]
        raise messages.orientation_repeated(
            where=path,
            count=repeated.nunique(),
            image=first_image,
            lines=", ".join(str(line) for line in lines),
        )


def _numbers_by_quantity(
    table: pd.DataFrame, names: Mapping[str, str], path: Path
) -> dict[str, Array]:
    """(n,) the columns of numbers, by quantity; latitude and longitude in degrees.

    ``names`` are the columns by quantity. Image, camera and time_utc are left out.
    """
    quantities = {}
    for quantity, column in names.items():
        if quantity in LIMITS_DEG:
            quantities[quantity] = degrees_of(
                table, column, path, messages.ORIENTATION_NUMBER, quantity=quantity
            )
        elif quantity not in ("image", "camera", "time_utc"):
            code = messages.ORIENTATION_NUMBER
            quantities[quantity] = numbers_of(table, column, path, code, largest_of(quantity))
    return quantities


def _positions(
    quantities: Mapping[str, Array], path: Path, key: str, lines: "pd.Index[Any]"
) -> Array:
    """(n, 3) x, y, z [m], or latitude, longitude [rad] and height [m]; NaN where these are 0, 0.

    Refuses latitudes and longitudes beyond `LIMITS_DEG`. ``key`` is the key of the mission file
    that names the columns; ``lines`` (n,) are the lines of the rows in the file.
    """
    if "x" in quantities:
        return np.stack([quantities[axis] for axis in "xyz"], axis=1)
    for quantity, limit in LIMITS_DEG.items():
        degrees = quantities[quantity]
        is_wrong = np.abs(degrees) > limit
        if bool(is_wrong.any()):
            row = int(np.argmax(is_wrong))
            raise messages.orientation_position(
                path=path,
                line=int(lines[row]),
                count=int(is_wrong.sum()),
                limit=limit,
                quantity=quantity,
                first=float(degrees[row]),
                swapped=quantity == "latitude" and _could_be_exchanged(quantities),
                key=key,
            )
    lat = np.radians(quantities["latitude"])
    lon = np.radians(quantities["longitude"])
    position = np.stack([lat, lon, quantities["height"]], axis=1)
    is_unset = (lat == 0.0) & (lon == 0.0)  # programs write 0 for unknown
    position[is_unset] = np.nan
    return position


def _could_be_exchanged(quantities: Mapping[str, Array]) -> bool:
    """Whether all latitudes [deg] could be longitudes, and all longitudes latitudes."""
    is_longitude = np.abs(quantities["latitude"]) <= LIMITS_DEG["longitude"]
    is_latitude = np.abs(quantities["longitude"]) <= LIMITS_DEG["latitude"]
    return bool(np.all(is_longitude & is_latitude))


@dataclass(frozen=True, eq=False)
class EventTable:
    """Exposures of a table: (m,) image, camera (None without that column), UTC [Unix ns]."""

    image: Names
    camera: Names | None
    time_ns: Integers


def read_events(path: Path, columns: Mapping[str, str], ledger: Ledger) -> EventTable:
    """Read a table of exposures; rows without a readable time are left out and reported.

    ``columns`` are the user's names by quantity: image, time_utc or gps_week and gps_seconds, and
    camera if there is one. Times without a zone are UTC; GPS seconds are reduced by the leap
    seconds of their date. Refuses (InputError) a table without a readable time.
    """
    table = text_table(
        path,
        columns,
        codes=(messages.EVENTS_CSV, messages.EVENTS_COLUMN),
        key="events.csv.columns",
    )
    time_ns, is_time = utc_of_columns(table, columns)
    if not bool(is_time.all()):
        lost_rows = np.flatnonzero(~is_time)
        line = int(table.index[lost_rows[0]])
        ledger.add(messages.events_without_time(where=path.name, count=lost_rows.size, line=line))
    if not bool(is_time.any()):
        raise messages.events_empty(where=path)
    table = table[is_time]
    return EventTable(
        image=table[columns["image"]].to_numpy(object),
        camera=table[columns["camera"]].to_numpy(object) if "camera" in columns else None,
        time_ns=time_ns[is_time],
    )
