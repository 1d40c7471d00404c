"""Exposures with their positions: DJI's ``Timestamp.MRK`` and POSPac's exterior orientation.

A line of a ``.MRK`` is: number of the image, GPS seconds of the week, [week], offset from the
antenna to the camera north, east and downwards [mm], latitude, longitude [deg], ellipsoidal height
[m], sigmas north, east and up [m], quality (50 fixed, 34 float, 16 single, 0 none). DJI's manuals
call the position that "after compensation": it is the camera's.

POSPac's text has one line an event, after a header that names the columns, among them ``TIME (s)``,
``ELLIPSOID HEIGHT`` or ``ORTHOMETRIC HEIGHT``, ``LAT`` and ``LONG``; the line of units says ``lat,
long in Deg`` and ``orientation in Degrees``, that of the grid ``Zone:  UTM North 32``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from unbend.flight import rotations
from unbend.flight.channels import Channel
from unbend.messages import Ledger
from unbend.tables.geodata.coordinate_systems import grid_coordinates
from unbend.tables.imports import messages
from unbend.tables.imports.eo_head import EoHead, head_of_eo
from unbend.tables.imports.stated import HEIGHT_COLUMNS, Stated, channel_of_rows, read_text
from unbend.tables.text_columns import numbers, split_lines, utc_of_weeks
from unbend.units import LARGEST_EXACT, Array, Mask

_MILLIMETRE = 1e-3
_LINE = r"\[.*\].*,N.*,E.*,V.*,Lat.*,Lon.*,Ellh.*,.*,.*,Q"
_NAMES = (
    "index",
    "seconds",
    "week",
    "N",
    "E",
    "V",
    "Lat",
    "Lon",
    "Ellh",
    "sd_n",
    "sd_e",
    "sd_u",
    "Q",
)
_NO_SOLUTION = 0
_SINGLE_POINT = 16


def read_mrk(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Events with the position of the camera, and the way from the antenna to it.

    ``event_index`` is the image's number, ``offset_north_m``, ``offset_east_m``, ``offset_down_m``
    lead from the antenna to the camera. Positions of quality 0 are unknown.
    """
    lines = read_text(path)
    is_of_mrk = np.array([re.search(_LINE, line) is not None for line in lines])
    if not is_of_mrk.any():
        raise messages.mrk_without_lines(where=path)
    table = split_lines(lines, _NAMES, r"\s*(?:\[|\]|,[A-Za-z]*|\s)\s*")
    value = {name: numbers(table[name]) for name in _NAMES}
    value["index"] = numbers(table["index"], LARGEST_EXACT)
    is_finite = np.isfinite(list(value.values())).all(axis=0)
    time_system = stated.system_of(path, ledger, "gpst")
    time_ns = utc_of_weeks(value["week"], value["seconds"], time_system)
    is_lost = _without_position(path, value, ledger)
    height_column = stated.height_column(path, ledger, "ellipsoid")
    columns = {
        "event_index": value["index"],
        "offset_north_m": value["N"] * _MILLIMETRE,
        "offset_east_m": value["E"] * _MILLIMETRE,
        "offset_down_m": value["V"] * _MILLIMETRE,
        "lat_rad": np.where(is_lost, np.nan, np.radians(value["Lat"])),
        "lon_rad": np.where(is_lost, np.nan, np.radians(value["Lon"])),
        height_column: np.where(is_lost, np.nan, value["Ellh"]),
        "sigma_h_m": np.hypot(value["sd_n"], value["sd_e"]) / np.sqrt(2.0),
        "sigma_v_m": value["sd_u"],
        "solution_quality": value["Q"],
    }
    return channel_of_rows(
        path,
        "MRK",
        time_ns,
        columns,
        ledger,
        readable=is_of_mrk & is_finite,
    )


def _without_position(
    path: Path,
    value: Mapping[str, Array],
    ledger: Ledger,
) -> Mask:
    """(n,) which events of a ``.MRK`` have no position; these, and poor ones, are reported."""
    is_at_zero = (value["Lat"] == 0.0) & (value["Lon"] == 0.0)
    is_lost = (value["Q"] == _NO_SOLUTION) | is_at_zero
    count_lost = int(is_lost.sum())
    if count_lost:
        lost = messages.images_without_position(
            where=path.name,
            count=count_lost,
            total=is_lost.size,
            first=value["index"][np.argmax(is_lost)],
        )
        ledger.add(lost)
    count_single = int(np.sum(value["Q"] == _SINGLE_POINT))
    if count_single:
        single = messages.single_point_images(
            where=path.name,
            count=count_single,
            total=is_lost.size,
        )
        ledger.add(single)
    return np.asarray(is_lost)


# Another zone or projection is farther away; another datum, or rounded degrees, are nearer.
FARTHEST_FROM_GRID_M = 5000.0
SHOWN_SHIFT = 0.2  # of a stated shift, that it may differ from the one which is seen
_TITLES = re.compile(
    r"EVENT|TIME(?=\s*\(s\))|EASTING|NORTHING|(?:ELLIPSOID|ORTHOMETRIC)(?=\s+HEIGHT)|OMEGA|PHI"
    r"|KAPPA|ROLL|PITCH|HEADING|LAT\b|LONG\b|\bID\b",
    re.IGNORECASE,
)


def read_eo_text(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Events with the position of the camera; labels ``name`` from the column ID where it has one.

    The attitude is that of a body in which the camera is at rest (`CAMERA_AT_REST`). Seconds are
    those of the GPS week, or of UTC, as stated: the file does not say.
    """
    text = _read_eo(path)
    table = text.table
    value = {name: numbers(table[name]) for name in table.columns}
    if "EVENT" in table:
        value["EVENT"] = numbers(table["EVENT"], LARGEST_EXACT)
    height_column = stated.height_column(path, ledger, _SURFACES[text.height_title])
    columns = {
        "event_index": _event_numbers(value, len(table)),
        "lat_rad": np.radians(value["LAT"]),
        "lon_rad": np.radians(value["LONG"]),
        height_column: value[text.height_title],
    }
    time_system = stated.system_of(path, ledger)
    time_ns = stated.utc_of_week_seconds(path, value["TIME"], time_system)
    head = head_of_eo(text.head)
    grid = stated.grid or head.grid
    if grid is not None and value["LAT"].size and {"EASTING", "NORTHING"} <= value.keys():
        on_grid = places_on_grid(path, grid, value)
        columns |= without_shift(path, columns, head, on_grid, ledger)
    columns |= attitudes_of_eo(path, head, value, stated, ledger)
    needed = [value["TIME"], value["LAT"], value["LONG"], value[text.height_title]]
    return channel_of_rows(
        path,
        "EO",
        time_ns,
        columns,
        ledger,
        readable=np.asarray(np.isfinite(needed).all(axis=0)),
        labels={"name": tuple(table["ID"])} if "ID" in table else None,
    )


@dataclass(frozen=True, eq=False)
class _EoText:
    """POSPac's text: what stands above its titles, the fields below them, the title of heights."""

    head: str
    table: pd.DataFrame
    height_title: str


def _read_eo(path: Path) -> _EoText:
    """Read POSPac's text; refuses one without titles, without places, or not in degrees."""
    lines = read_text(path)
    line_of_titles = _line_of_titles(lines)
    if line_of_titles is None:
        raise messages.eo_without_titles(where=path)
    titles = [name.upper() for name in _TITLES.findall(lines[line_of_titles])]
    height_title = _title_of_heights(titles)
    if not height_title or "LAT" not in titles or "LONG" not in titles:
        raise messages.eo_without_places(where=path, titles=", ".join(titles))
    head = "\n".join(lines[:line_of_titles])
    if not re.search(r"lat\W+long\w* in deg", head, re.IGNORECASE):
        raise messages.eo_not_in_degrees(where=path)
    lines_below = lines[line_of_titles + 1 :]
    # A row has a digit in its second field; units and rules do not.
    rows = [line for line in lines_below if re.match(r"\s*\S+\s+\S*[0-9]", line)]
    return _EoText(head, split_lines(rows, titles, r"\s+"), height_title)


def _line_of_titles(lines: Sequence[str]) -> int | None:
    """The number of the line that names the columns, from 0."""
    for number, line in enumerate(lines):
        if re.search(r"TIME\s*\(s\)", line):
            return number
    return None


_SURFACES = {"ELLIPSOID": "ellipsoid", "ORTHOMETRIC": "msl"}
"""What the heights of a column count from, by the first word of its title."""


def _title_of_heights(titles: Sequence[str]) -> str:
    """The title of the heights, empty without one."""
    for title in titles:
        if title in _SURFACES:
            return title
    return ""


def _event_numbers(value: Mapping[str, Array], rows: int) -> Array:
    """The numbers of the events (n,); of those without one that of the row, from 1."""
    number_of_row = np.arange(1.0, rows + 1.0)
    event = value.get("EVENT", number_of_row)
    return np.where(np.isfinite(event), event, number_of_row)


@dataclass(frozen=True, eq=False)
class PlacesOnGrid:
    """The latitudes and longitudes of a file in its grid.

    convergence_rad : (n,) azimuth of the grid's north.
    apart_m : (2,) easting and northing minus those of latitude and longitude, in the median.
    away_m : the median distance between both.
    """

    convergence_rad: Array
    apart_m: Array
    away_m: float


def places_on_grid(path: Path, grid: str, value: Mapping[str, Array]) -> PlacesOnGrid:
    """Latitude and longitude by PROJ, compared with easting and northing where a file has these.

    Refuses (IMPORT-EO-GRID) a grid that is not known.
    """
    place = np.nan_to_num([value["LONG"], value["LAT"]])
    try:
        east_m, north_m, convergence_rad = grid_coordinates(grid, *place)
    except ValueError as error:
        raise messages.grid_unknown(where=path, grid=grid, error=str(error)) from None
    unknown = np.full(east_m.shape, np.nan)
    east_of_places = value.get("EASTING", unknown) - east_m
    north_of_places = value.get("NORTHING", unknown) - north_m
    apart_m = np.stack([east_of_places, north_of_places])
    apart_m = apart_m[:, np.isfinite(apart_m).all(axis=0)]
    if apart_m.size == 0:
        return PlacesOnGrid(convergence_rad, np.zeros(2), 0.0)
    return PlacesOnGrid(
        convergence_rad=convergence_rad,
        apart_m=np.median(apart_m, axis=1),
        away_m=float(np.median(np.hypot(*apart_m))),
    )


def without_shift(
    path: Path, columns: Mapping[str, Array], head: EoHead, places: PlacesOnGrid, ledger: Ledger
) -> dict[str, Array]:
    """The heights without the shift that the head states, if easting and northing have it alone.

    Latitude and longitude, which are used, show it: they lie apart from easting and northing by
    the shift, or not. Where they do not, they may have it too, which is a warning.
    """
    if not head.shift_m.any():
        return {}
    shift = ", ".join(f"{value:g}" for value in head.shift_m)
    horizontal_m = head.shift_m[:2]
    size_m = float(np.hypot(*horizontal_m))
    left_m = float(np.hypot(*(places.apart_m - horizontal_m)))
    if size_m == 0.0 or left_m >= SHOWN_SHIFT * size_m:
        ledger.add(messages.eo_shift_unknown(where=path.name, shift=shift))
        return {}
    ledger.add(messages.eo_shift_undone(where=path.name, shift=shift))
    heights = {}
    for name in HEIGHT_COLUMNS & columns.keys():
        heights[name] = columns[name] - head.shift_m[2]
    return heights


def attitudes_of_eo(
    path: Path,
    head: EoHead,
    value: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> dict[str, Array]:
    """The columns q_w to q_z by omega, phi and kappa in a grid, or by roll, pitch and heading.

    The axes of the grid are turned by its convergence at each event (PROJ's). Easting and northing
    prove the grid: refuses (InputError IMPORT-EO-GRID) one in which they lie elsewhere. Refuses
    (IMPORT-EO-HEAD) an order of the rotations that no photogrammetric angles have.
    """
    is_in_grid = "OMEGA" in value
    names = ("OMEGA", "PHI", "KAPPA") if is_in_grid else ("ROLL", "PITCH", "HEADING")
    if not set(names) <= value.keys() or value["LAT"].size == 0:
        return {}
    grid = stated.grid or head.grid
    if head.radians is None:
        missing = "'orientation in Degrees'"
        ledger.add(messages.eo_angles_unused(where=path.name, missing=missing))
        return {}
    if is_in_grid and grid is None:
        ledger.add(messages.eo_angles_unused(where=path.name, missing="its UTM zone"))
        return {}
    angles = np.stack([value[name] for name in names], axis=1) * head.radians
    if is_in_grid:
        order = order_of_rotations(head, path, ledger)
        columns_in_order = [names.index(name.upper()) for name in order.split("_")]
        angles_in_order = stated.angles_meant(angles[:, columns_in_order])
        camera = rotations.quaternion_of_opk(angles_in_order, order)
        convergence_rad = proved_convergence(path, str(grid), value)
        quaternion = body_at_rest(camera, convergence_rad)
    else:
        body = rotations.ned_from_body(stated.angles_meant(angles))
        quaternion = rotations.quaternions_of(body)
    return {
        "q_w": quaternion[:, 0],
        "q_x": quaternion[:, 1],
        "q_y": quaternion[:, 2],
        "q_z": quaternion[:, 3],
    }


def proved_convergence(path: Path, grid: str, value: Mapping[str, Array]) -> Array:
    """(n,) convergence of a grid [rad]; refuses (IMPORT-EO-GRID) one that lies elsewhere."""
    places = places_on_grid(path, grid, value)
    if not places.away_m < FARTHEST_FROM_GRID_M:
        raise messages.grid_elsewhere(where=path, grid=grid, away_m=places.away_m)
    return places.convergence_rad


def order_of_rotations(head: EoHead, path: Path, ledger: Ledger) -> str:
    """The order in which the angles turn; notes on it, and on a cardinal rotation of kappa.

    Refuses (IMPORT-EO-HEAD) an order that no photogrammetric angles have.
    """
    if head.order is None:
        raise messages.eo_order_unknown(where=path, rotations=head.rotations)
    ledger.add(messages.eo_order(where=path.name, rotations=head.rotations))
    if head.cardinal_deg:
        ledger.add(messages.eo_cardinal_rotation(where=path.name, turn_deg=head.cardinal_deg))
    return head.order


def body_at_rest(camera: Array, convergence_rad: Array) -> Array:
    """(n, 4) attitudes of a body in which the camera is at rest, of cameras against a grid."""
    enu_from_grid = rotations.enu_from_grid(convergence_rad)
    camera_from_enu = rotations.matrices_of(camera) @ enu_from_grid.transpose(0, 2, 1)
    enu_from_camera = camera_from_enu.transpose(0, 2, 1)
    ned_from_body = rotations.NED_FROM_ENU @ enu_from_camera @ rotations.CAMERA_AT_REST
    return rotations.quaternions_of(ned_from_body)
