"""Position and attitude of images from a CSV, and known positions of some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.flight.stations import NO_TIME
from pipeline.ledger import Notes, loss
from pipeline.tables.column_checks import no_such_column
from pipeline.tables.text_columns import numbers_of, text_table, utc_of_columns

Array = NDArray[np.float64]

TURN = {"deg": 360.0, "rad": 2.0 * np.pi, "grad": 400.0}
"""A full turn in each unit of angles."""

_LIMITS_DEG = {"latitude": 90.0, "longitude": 360.0}
_LONGEST_NORM_ERROR = 1e-3


@dataclass(frozen=True, eq=False)
class OrientationTable:
    """A table of orientations as read; (n,) arrays, ``angles`` (n, 3) [rad] or (n, 4) quaternions.

    ``position`` (n, 3) is latitude, longitude [rad] and height [m], or x, y, z [m]. ``camera`` is
    None without that column; ``time_ns`` is `NO_TIME` where unknown; ``sigmas`` holds columns in SI
    and radians by quantity, for those that are there.
    """

    image: NDArray[np.object_]
    camera: NDArray[np.object_] | None
    time_ns: NDArray[np.int64]
    position: Array
    angles: Array
    sigmas: Mapping[str, Array]


def read_orientation(
    path: Path, names: Mapping[str, str], angle_names: Sequence[str], *, unit: str
) -> tuple[OrientationTable, Notes]:
    """Read a table of orientations by the user's names of its columns.

    Parameters
    ----------
    names : quantity -> column. Latitude and longitude are in degrees, heights, x, y, z in metres.
    angle_names : the quantities of the attitude: three angles in ``unit``, or q_w to q_z.
    unit : of the angles, ``deg``, ``rad`` or ``grad``.

    Refuses (InputError) columns that are not there, text for numbers, images that stand there
    twice, latitudes and angles that none can be, and quaternions that are no rotations.
    """
    key = "stations.orientation.columns"
    table = _table_with(path, names, key)
    numbers = {
        quantity: numbers_of(table, column, path, "ORIENTATION-NUMBER")
        for quantity, column in names.items()
        if quantity not in ("image", "camera", "time_utc")
    }
    angles = np.stack([numbers[name] for name in angle_names], axis=1)
    for tilt in {"sigma_tilt", "sigma_yaw"} & numbers.keys():
        numbers[f"{tilt}_rad"] = numbers.pop(tilt) * (2.0 * np.pi / TURN[unit])
    position = _positions(numbers, path, key)
    time_ns, notes = np.full(len(table), NO_TIME, np.int64), []
    if "time_utc" in names or "gps_week" in names:
        clock = [names.get(name) for name in ("time_utc", "gps_week", "gps_seconds")]
        read_ns, good = utc_of_columns(table, *clock)
        time_ns[good] = read_ns[good]
        if not bool(good.all()):
            first = int(np.argmin(good))
            notes.append(
                loss(
                    "ORIENTATION-TIME",
                    f"{int((~good).sum())} rows have no readable time, the first in line "
                    f"{first + 2}: the air of the middle exposure is taken for them",
                    where=path.name,
                    count=int((~good).sum()),
                )
            )
    camera = table[names["camera"]].to_numpy(object) if "camera" in names else None
    sigmas = {name: values for name, values in numbers.items() if name.startswith("sigma_")}
    image = table[names["image"]].to_numpy(object)
    attitudes = _attitudes(angles, unit, path)
    return OrientationTable(image, camera, time_ns, position, attitudes, sigmas), tuple(notes)


def read_known_positions(path: Path, names: Mapping[str, str]) -> tuple[NDArray[np.object_], Array]:
    """Images, and (m, 3) their latitude, longitude [rad] and height [m], from a CSV."""
    table = _table_with(path, names, "stations.orientation.known_positions")
    numbers = {
        quantity: numbers_of(table, column, path, "ORIENTATION-NUMBER")
        for quantity, column in names.items()
        if quantity != "image"
    }
    position = _positions(numbers, path, "stations.orientation.known_positions")
    return table[names["image"]].to_numpy(object), position


def _table_with(path: Path, names: Mapping[str, str], key: str) -> pd.DataFrame:
    """A table that has the columns, and each image once."""
    table = text_table(path, "ORIENTATION-CSV")
    for quantity, column in names.items():
        if column not in table.columns:
            raise no_such_column(
                "ORIENTATION-COLUMN", path, column, there=list(table.columns),
                key=f"{key}.{quantity}", quantity=quantity,
            )  # fmt: skip
    images = table[names["image"]]
    if len(images) == 0:
        raise InputError(
            "ORIENTATION-EMPTY", "the table has no rows", where=str(path), remedy="write it again"
        )
    twice = images[images.duplicated(keep=False)]
    if len(twice):
        lines = ", ".join(str(row + 2) for row in twice.index[twice == twice.iloc[0]])
        raise InputError(
            "ORIENTATION-REPEATED",
            f"{twice.nunique()} images stand there more than once, for example "
            f"{twice.iloc[0]!r} in lines {lines}",
            where=str(path),
            remedy="keep one row an image",
        )
    return table


def _positions(numbers: Mapping[str, Array], path: Path, key: str) -> Array:
    """(n, 3) positions, latitude and longitude in radians; refuses those of no place on earth."""
    if "x" in numbers:
        return np.stack([numbers[axis] for axis in "xyz"], axis=1)
    for quantity, limit in _LIMITS_DEG.items():
        wrong = np.abs(numbers[quantity]) > limit
        if bool(wrong.any()):
            swapped = quantity == "latitude" and bool((np.abs(numbers[quantity]) <= 360.0).all())
            raise InputError(
                "ORIENTATION-POSITION",
                f"{int(wrong.sum())} values of {quantity} lie beyond {limit:.0f} deg, the first "
                f"{numbers[quantity][np.argmax(wrong)]:g}"
                + ("; are latitude and longitude swapped?" if swapped else ""),
                where=f"{path}, line {int(np.argmax(wrong)) + 2}",
                remedy=f"name the columns under {key}; they hold degrees, no projected coordinates",
            )
    degrees = [numbers["latitude"], numbers["longitude"]]
    return np.stack([*np.radians(degrees), numbers["height"]], axis=1)


def _attitudes(given: Array, unit: str, path: Path) -> Array:
    """(n, 3) angles in radians, or (n, 4) quaternions at unit length.

    Refuses angles of more than a turn, and quaternions whose length is not 1 to 0.001.
    """
    if given.shape[1] == 4:
        length = np.linalg.norm(given, axis=1)
        wrong = np.abs(length - 1.0) > _LONGEST_NORM_ERROR
        if not bool(wrong.any()):
            return np.asarray(given / length[:, None])
        worst = int(np.nanargmax(np.abs(length - 1.0)))
        raise InputError(
            "ORIENTATION-QUATERNION",
            f"{int(wrong.sum())} quaternions are no rotations: their length is not 1, the farthest "
            f"{length[worst]:.6g}",
            where=f"{path}, line {worst + 2}",
            remedy="name the columns q_w, q_x, q_y and q_z (w is the cosine of half the angle), "
            "and write them with all their digits",
        )
    beyond = (np.abs(given) > TURN[unit] * (1.0 + 1e-6)).any(axis=1)
    if not bool(beyond.any()):
        return given * (2.0 * np.pi / TURN[unit])
    worst_angle = float(np.nanmax(np.abs(given)))
    likely = next((other for other, turn in TURN.items() if worst_angle <= turn), None)
    raise InputError(
        "ORIENTATION-UNIT",
        f"{int(beyond.sum())} images have an angle of more than a turn ({TURN[unit]:g} {unit}), "
        f"up to {worst_angle:g}" + (f"; is the unit {likely}?" if likely else ""),
        where=f"{path}, line {int(np.argmax(beyond)) + 2}",
        remedy="state stations.orientation.unit (deg, rad or grad), or name the columns of angles",
    )
