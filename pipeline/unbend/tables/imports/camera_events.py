"""Exposures with their positions: DJI's ``Timestamp.MRK`` and POSPac's exterior orientation.

A line of a ``.MRK`` is: number of the image, GPS seconds of the week, [week], offset from the
antenna to the camera north, east and downwards [mm], latitude, longitude [deg], ellipsoidal height
[m], sigmas north, east and up [m], quality (50 fixed, 34 float, 16 single, 0 none). DJI's manuals
call the position that "after compensation": it is the camera's.

POSPac's text has one line an event, after a header that names the columns, among them ``TIME (s)``,
``ELLIPSOID HEIGHT`` or ``ORTHOMETRIC HEIGHT``, ``LAT`` and ``LONG``; the line of units has ``lat,
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
_MRK_LINE = r"\[.*\].*,N.*,E.*,V.*,Lat.*,Lon.*,Ellh.*,.*,.*,Q"
_MRK_COLUMNS = (
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
_NO_SOLUTION = 0  # quality Q
_SINGLE_POINT = 16  # quality Q


def read_mrk(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Read a ``.MRK``: events with the position of the camera, and the offset from the antenna.

    ``event_index`` is the image's number; ``offset_north_m``, ``offset_east_m``, ``offset_down_m``
    lead from the antenna to the camera. Positions of quality 0 are unknown (NaN).
    """
    lines = read_text(path)
    is_of_mrk = np.array([re.search(_MRK_LINE, line) is not None for line in lines])
    if not is_of_mrk.any():
        raise messages.mrk_without_lines(where=path)
    table = split_lines(lines, _MRK_COLUMNS, r"\s*(?:\[|\]|,[A-Za-z]*|\s)\s*")
    file_columns = {name: numbers(table[name]) for name in _MRK_COLUMNS}
    file_columns["index"] = numbers(table["index"], LARGEST_EXACT)
    is_finite = np.isfinite(list(file_columns.values())).all(axis=0)
    time_system = stated.system_of(path, ledger, "gpst")
    time_ns = utc_of_weeks(file_columns["week"], file_columns["seconds"], time_system)
    is_lost = _lacks_position(path, file_columns, ledger)
    height_column = stated.height_column(path, ledger, "ellipsoid")
    columns = {
        "event_index": file_columns["index"],
        "offset_north_m": file_columns["N"] * _MILLIMETRE,
        "offset_east_m": file_columns["E"] * _MILLIMETRE,
        "offset_down_m": file_columns["V"] * _MILLIMETRE,
        "lat_rad": np.where(is_lost, np.nan, np.radians(file_columns["Lat"])),
        "lon_rad": np.where(is_lost, np.nan, np.radians(file_columns["Lon"])),
        height_column: np.where(is_lost, np.nan, file_columns["Ellh"]),
        "sigma_h_m": np.hypot(file_columns["sd_n"], file_columns["sd_e"]) / np.sqrt(2.0),
        "sigma_v_m": file_columns["sd_u"],
        "solution_quality": file_columns["Q"],
    }
    return channel_of_rows(
        path,
        "MRK",
        time_ns,
        columns,
        ledger,
        readable=is_of_mrk & is_finite,
    )


def _lacks_position(
    path: Path,
    file_columns: Mapping[str, Array],
    ledger: Ledger,
) -> Mask:
    """(n,) which events of a ``.MRK`` have no position; reports their number.

    Also reports events with a single-point position, which are kept.
    """
    is_at_zero = (file_columns["Lat"] == 0.0) & (file_columns["Lon"] == 0.0)
    is_lost = (file_columns["Q"] == _NO_SOLUTION) | is_at_zero
    count_lost = int(is_lost.sum())
    if count_lost:
        lost = messages.images_without_position(
            where=path.name,
            count=count_lost,
            total=is_lost.size,
            first=file_columns["index"][np.argmax(is_lost)],
        )
        ledger.add(lost)
    count_single = int(np.sum(file_columns["Q"] == _SINGLE_POINT))
    if count_single:
        single = messages.single_point_images(
            where=path.name,
            count=count_single,
            total=is_lost.size,
        )
        ledger.add(single)
    return np.asarray(is_lost)


# Another zone or projection shifts places by more; another datum, or rounded degrees, by less.
FARTHEST_FROM_GRID_M = 5000.0
SHOWN_SHIFT = 0.2  # part of a stated shift that the measured one may differ by
_TITLES = re.compile(
    r"EVENT|TIME(?=\s*\(s\))|EASTING|NORTHING|(?:ELLIPSOID|ORTHOMETRIC)(?=\s+HEIGHT)|OMEGA|PHI"
    r"|KAPPA|ROLL|PITCH|HEADING|LAT\b|LONG\b|\bID\b",
    re.IGNORECASE,
)


def read_eo_text(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Read POSPac's exterior orientations: events with position and attitude of the camera.

    The label ``name`` is from the column ID, if there is one. The attitude is that of a body in
    which the camera is at rest (`CAMERA_AT_REST`). The mission file states whether the seconds of
    the week are GPS time or UTC: the file does not.
    """
    text = _read_eo(path)
    table = text.table
    file_columns = {name: numbers(table[name]) for name in table.columns}
    if "EVENT" in table:
        file_columns["EVENT"] = numbers(table["EVENT"], LARGEST_EXACT)
    height_column = stated.height_column(path, ledger, _SURFACES[text.height_title])
    columns = {
        "event_index": _event_numbers(file_columns, len(table)),
        "lat_rad": np.radians(file_columns["LAT"]),
        "lon_rad": np.radians(file_columns["LONG"]),
        height_column: file_columns[text.height_title],
    }
    time_system = stated.system_of(path, ledger)
    time_ns = stated.utc_of_week_seconds(path, file_columns["TIME"], time_system)
    head = head_of_eo(text.head)
    grid = stated.grid or head.grid
    if (
        grid is not None
        and file_columns["LAT"].size
        and {"EASTING", "NORTHING"} <= file_columns.keys()
    ):
        on_grid = places_on_grid(path, grid, file_columns)
        columns |= heights_without_shift(path, columns, head, on_grid, ledger)
    columns |= attitudes_of_eo(path, head, file_columns, stated, ledger)
    needed = [
        file_columns["TIME"],
        file_columns["LAT"],
        file_columns["LONG"],
        file_columns[text.height_title],
    ]
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
    """POSPac's text: ``head`` is the text above the titles, ``table`` the fields below them.

    ``height_title`` is the title of the heights, a key of `_SURFACES`.
    """

    head: str
    table: pd.DataFrame
    height_title: str


def _read_eo(path: Path) -> _EoText:
    """Read POSPac's text; refuses a text without titles, without places, or not in degrees."""
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
    """The index of the line that names the columns, from 0; None without one."""
    for number, line in enumerate(lines):
        if re.search(r"TIME\s*\(s\)", line):
            return number
    return None


_SURFACES = {"ELLIPSOID": "ellipsoid", "ORTHOMETRIC": "msl"}
"""Title of the column of heights -> the surface that these count from."""


def _title_of_heights(titles: Sequence[str]) -> str:
    """The title of the heights, empty without one."""
    for title in titles:
        if title in _SURFACES:
            return title
    return ""


def _event_numbers(file_columns: Mapping[str, Array], rows: int) -> Array:
    """(n,) the numbers of the events; for an event without a number that of its row, from 1."""
    row_number = np.arange(1.0, rows + 1.0)
    event_number = file_columns.get("EVENT", row_number)
    return np.where(np.isfinite(event_number), event_number, row_number)


@dataclass(frozen=True, eq=False)
class PlacesOnGrid:
    """The latitudes and longitudes of a file, compared with its eastings and northings in a grid.

    convergence_rad : (n,) azimuth of the grid's north.
    difference_m : (2,) median of the file's eastings and northings minus those that PROJ computes
        from latitude and longitude; 0 where the file has none.
    distance_m : median distance between the two; 0 where the file has none.
    """

    convergence_rad: Array
    difference_m: Array
    distance_m: float


def places_on_grid(path: Path, grid: str, file_columns: Mapping[str, Array]) -> PlacesOnGrid:
    """Convert latitude and longitude to ``grid`` by PROJ, and compare with easting and northing.

    Refuses (IMPORT-EO-GRID) a grid that is not known.
    """
    lon_lat_deg = np.nan_to_num([file_columns["LONG"], file_columns["LAT"]])
    try:
        east_m, north_m, convergence_rad = grid_coordinates(grid, *lon_lat_deg)
    except ValueError as error:
        raise messages.grid_unknown(where=path, grid=grid, error=str(error)) from None
    unknown = np.full(east_m.shape, np.nan)
    east_difference_m = file_columns.get("EASTING", unknown) - east_m
    north_difference_m = file_columns.get("NORTHING", unknown) - north_m
    differences_m = np.stack([east_difference_m, north_difference_m])
    differences_m = differences_m[:, np.isfinite(differences_m).all(axis=0)]
    if differences_m.size == 0:
        return PlacesOnGrid(convergence_rad, np.zeros(2), 0.0)
    return PlacesOnGrid(
        convergence_rad=convergence_rad,
        difference_m=np.median(differences_m, axis=1),
        distance_m=float(np.median(np.hypot(*differences_m))),
    )


def heights_without_shift(
    path: Path, columns: Mapping[str, Array], head: EoHead, places: PlacesOnGrid, ledger: Ledger
) -> dict[str, Array]:
    """The columns of heights minus the shift that the head states; empty if it stays.

    It is subtracted if easting and northing differ from latitude and longitude by the stated shift:
    then X, Y, Z were shifted, and latitude and longitude, which are used, were not. If they do not
    differ by it, all may be shifted or none, which is a warning.
    """
    if not head.shift_m.any():
        return {}
    shift = ", ".join(f"{part_m:g}" for part_m in head.shift_m)
    horizontal_m = head.shift_m[:2]
    shift_size_m = float(np.hypot(*horizontal_m))
    mismatch_m = float(np.hypot(*(places.difference_m - horizontal_m)))
    if shift_size_m == 0.0 or mismatch_m >= SHOWN_SHIFT * shift_size_m:
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
    file_columns: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> dict[str, Array]:
    """The columns q_w to q_z from omega, phi and kappa in a grid, or from roll, pitch and heading.

    Empty without these angles, or if the head does not state their unit or grid, which is
    reported. The axes of the grid are turned by its convergence at each event (PROJ's). Refuses
    (InputError IMPORT-EO-GRID) a grid in which easting and northing contradict latitude and
    longitude, and (IMPORT-EO-HEAD) an order of the rotations other than `ORDERS`.
    """
    is_in_grid = "OMEGA" in file_columns
    names = ("OMEGA", "PHI", "KAPPA") if is_in_grid else ("ROLL", "PITCH", "HEADING")
    if not set(names) <= file_columns.keys() or file_columns["LAT"].size == 0:
        return {}
    grid = stated.grid or head.grid
    if head.unit_rad is None:
        missing = "'orientation in Degrees'"
        ledger.add(messages.eo_angles_unused(where=path.name, missing=missing))
        return {}
    if is_in_grid and grid is None:
        hint = "; events.positions.<camera>.grid states the grid"
        ledger.add(messages.eo_angles_unused(where=path.name, missing="its UTM zone", hint=hint))
        return {}
    angles = np.stack([file_columns[name] for name in names], axis=1) * head.unit_rad
    if is_in_grid:
        order = order_of_rotations(head, path, ledger)
        columns_in_order = [names.index(name.upper()) for name in order.split("_")]
        angles_in_order = stated.angles_meant(angles[:, columns_in_order])
        camera = rotations.quaternion_of_opk(angles_in_order, order)
        convergence_rad = convergence_of_grid(path, str(grid), file_columns)
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


def convergence_of_grid(path: Path, grid: str, file_columns: Mapping[str, Array]) -> Array:
    """(n,) azimuth of grid north [rad] at the places of a file.

    Refuses (IMPORT-EO-GRID) a grid in which the file's eastings and northings are far from its
    latitudes and longitudes.
    """
    places = places_on_grid(path, grid, file_columns)
    if not places.distance_m < FARTHEST_FROM_GRID_M:
        raise messages.grid_elsewhere(where=path, grid=grid, away_m=places.distance_m)
    return places.convergence_rad


def order_of_rotations(head: EoHead, path: Path, ledger: Ledger) -> str:
    """The order of the rotations, one of `ORDERS`; reports it, and a cardinal rotation of kappa.

    Refuses (IMPORT-EO-HEAD) another order.
    """
    if head.order is None:
        raise messages.eo_order_unknown(where=path, rotations=head.rotations)
    ledger.add(messages.eo_order(where=path.name, rotations=head.rotations))
    if head.cardinal_deg:
        ledger.add(messages.eo_cardinal_rotation(where=path.name, turn_deg=head.cardinal_deg))
    return head.order


def body_at_rest(camera: Array, convergence_rad: Array) -> Array:
    """(n, 4) quaternions of the bodies in which the cameras are at rest (`CAMERA_AT_REST`).

    ``camera`` (n, 4) are quaternions of the cameras against the axes of a grid, ``convergence_rad``
    (n,) the azimuths of its north.
    """
    enu_from_grid = rotations.enu_from_grid(convergence_rad)
    camera_from_enu = rotations.matrices_of(camera) @ enu_from_grid.transpose(0, 2, 1)
    enu_from_camera = camera_from_enu.transpose(0, 2, 1)
    ned_from_body = rotations.NED_FROM_ENU @ enu_from_camera @ rotations.CAMERA_AT_REST
    return rotations.quaternions_of(ned_from_body)
