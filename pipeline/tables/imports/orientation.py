"""Tables of images as CSV: position and attitude, known positions, times of exposure."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from pipeline.errors import InputError
from pipeline.flight.heights import GeodeticOrigin
from pipeline.flight.stations import NO_TIME
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import Stated
from pipeline.tables.text_columns import angles_in_radians, numbers_of, text_table, utc_of_columns
from pipeline.units import RADIANS, Array, Integers, Names

_ANGLES = {
    "omega", "phi", "kappa", "roll", "pitch", "yaw", "q_w", "q_x", "q_y", "q_z",
}  # fmt: skip
_LIMITS_DEG = {"latitude": 90.0, "longitude": 360.0}
_LONGEST_NORM_ERROR = 1e-3


@dataclass(frozen=True, eq=False)
class OrientationTable:
    """A table of orientations as read; (n,) arrays, ``angles`` (n, 3) [rad] or (n, 4) quaternions.

    ``position`` (n, 3) is latitude, longitude [rad] and height [m], or x, y, z [m]. ``camera`` is
    None without that column; ``time_ns`` is `NO_TIME` where unknown; ``sigmas`` holds columns in SI
    and radians by quantity, for those that are there. ``convergence_rad`` (n,) is the azimuth of
    the grid's north, ``heights`` what a coordinate system says of them. ``frame`` is what a file
    says of the frame of its x, y, z: earth-centred, or the origin of east, north and up.
    """

    image: Names
    camera: Names | None
    time_ns: Integers
    position: Array
    angles: Array
    sigmas: Mapping[str, Array]
    convergence_rad: Array | float = 0.0
    heights: str | None = None
    frame: Literal["ecef"] | GeodeticOrigin | None = None


def read_orientation(path: Path, stated: Stated, ledger: Ledger) -> OrientationTable:
    """Read a table of orientations by the user's names of its columns.

    The columns that are stated have latitude and longitude in degrees, heights, x, y, z in metres;
    the attitude is three angles in the stated unit, in the order of their columns, or q_w to q_z.

    Refuses (InputError) columns that are not there, text for numbers, images that stand there
    twice, latitudes and angles that none can be, and quaternions that are no rotations.
    """
    names, unit = stated.columns, stated.angle_unit
    angle_names = [name for name in names if name in _ANGLES]
    table = _table_with(path, names, "stations.orientation.columns")
    value = _numbers(table, names, path)
    position = _positions(value, path, "stations.orientation.columns")
    angles = np.stack([value[name] for name in angle_names], axis=1)
    if len(angle_names) == 4:
        length = np.linalg.norm(angles, axis=1)
        if (wrong := np.abs(length - 1.0) > _LONGEST_NORM_ERROR).any():
            worst = int(np.nanargmax(np.abs(length - 1.0)))
            where, number = f"{path}, line {worst + 2}", int(wrong.sum())
            raise InputError.of(
                "ORIENTATION-QUATERNION", where, number=number, length=length[worst]
            )
        attitude = angles / length[:, None]
    else:
        attitude = angles_in_radians(angles, unit, path, "ORIENTATION-UNIT",
                                     "stations.orientation.unit")  # fmt: skip
    sigmas = {name: values for name, values in value.items() if name.startswith("sigma_")}
    for tilt in {"sigma_tilt", "sigma_yaw"} & sigmas.keys():
        sigmas[f"{tilt}_rad"] = sigmas.pop(tilt) * RADIANS[unit]
    time_ns = np.full(len(table), NO_TIME, np.int64)
    if "time_utc" in names or "gps_week" in names:
        clock = [names.get(name) for name in ("time_utc", "gps_week", "gps_seconds")]
        read_ns, good = utc_of_columns(table, *clock)
        time_ns[good] = read_ns[good]
        if bad := int((~good).sum()):
            ledger.loss("ORIENTATION-TIME", where=path.name, count=bad, line=np.argmin(good) + 2)
    camera = table[names["camera"]].to_numpy(object) if "camera" in names else None
    image = table[names["image"]].to_numpy(object)
    return OrientationTable(image, camera, time_ns, position, attitude, sigmas)


def read_known_positions(path: Path, names: Mapping[str, str]) -> tuple[Names, Array]:
    """Images, and (m, 3) their latitude, longitude [rad] and height [m], from a CSV."""
    key = "stations.orientation.known_positions"
    table = _table_with(path, names, key)
    position = _positions(_numbers(table, names, path), path, key)
    return table[names["image"]].to_numpy(object), position


def _table_with(path: Path, names: Mapping[str, str], key: str) -> pd.DataFrame:
    """A table that has the columns, and each image once."""
    table = text_table(path, names, codes=("ORIENTATION-CSV", "ORIENTATION-COLUMN"), key=key)
    images = table[names["image"]]
    if len(images) == 0:
        raise InputError.of("ORIENTATION-EMPTY", path)
    twice = images[images.duplicated(keep=False)]
    if len(twice):
        lines = ", ".join(str(row + 2) for row in twice.index[twice == twice.iloc[0]])
        raise InputError.of(
            "ORIENTATION-REPEATED", path, repeated=twice.nunique(), image=twice.iloc[0], lines=lines
        )
    return table


def _numbers(table: pd.DataFrame, names: Mapping[str, str], path: Path) -> dict[str, Array]:
    """The columns that hold numbers, by quantity."""
    return {
        quantity: numbers_of(table, column, path, "ORIENTATION-NUMBER")
        for quantity, column in names.items()
        if quantity not in ("image", "camera", "time_utc")
    }


def _positions(value: Mapping[str, Array], path: Path, key: str) -> Array:
    """(n, 3) positions, latitude and longitude in radians; refuses those of no place on earth."""
    if "x" in value:
        return np.stack([value[axis] for axis in "xyz"], axis=1)
    for quantity, limit in _LIMITS_DEG.items():
        wrong = np.abs(value[quantity]) > limit
        if bool(wrong.any()):
            swapped = quantity == "latitude" and bool((np.abs(value[quantity]) <= 360.0).all())
            raise InputError(
                "ORIENTATION-POSITION",
                f"{int(wrong.sum())} values of {quantity} lie beyond {limit:.0f} deg, the first "
                f"{value[quantity][np.argmax(wrong)]:g}"
                + ("; are latitude and longitude swapped?" if swapped else ""),
                where=f"{path}, line {int(np.argmax(wrong)) + 2}",
                remedy=f"name the columns under {key}; they hold degrees, no projected coordinates",
            )
    lat, lon = np.radians(value["latitude"]), np.radians(value["longitude"])
    return np.stack([lat, lon, value["height"]], axis=1)


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
    table = text_table(path, columns, codes=("EVENTS-CSV", "EVENTS-COLUMN"),
                       key="events.csv.columns")  # fmt: skip
    clock = [columns.get(name) for name in ("time_utc", "gps_week", "gps_seconds")]
    time_ns, good = utc_of_columns(table, *clock)
    if not bool(good.all()):
        rows = np.flatnonzero(~good)
        what = f"{rows.size} rows have no readable time, the first in line {rows[0] + 2}"
        ledger.loss("EVENTS-TIME", what, where=path.name, count=int(rows.size))
    if not bool(good.any()):
        raise InputError.of("EVENTS-EMPTY", path)
    table, time_ns = table[good], time_ns[good]
    camera = table[columns["camera"]].to_numpy(object) if "camera" in columns else None
    return EventTable(table[columns["image"]].to_numpy(object), camera, time_ns)
