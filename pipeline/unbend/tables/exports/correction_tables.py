"""Corrections as tables: on a grid over every image, and by nadir angle for each flying height."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from unbend.geodesy import euler_radius
from unbend.messages import Ledger
from unbend.refraction.angle import RadialTable, angles_to, radial_table
from unbend.refraction.image import Corrections, correct_observations, lattice_nodes
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import FinishedRun, Option, Tables, Values, parquet_and_csv
from unbend.tables.writing import table_of
from unbend.tables.written_columns import columns_of, schema_of
from unbend.units import ARCSEC, DEGREE, MICRORADIAN, Array, Integers

_MOST_ROWS = 250_000  # of a lattice that are in memory at a time
_LARGEST_DEG = 80.0  # nadir angle of radial tables
_STEP_DEG = 1.0  # of nadir angles of radial tables
_SAME_HEIGHT = 0.02  # heights above ground within 2 % share a table: R differs by less than 2 %


def lattice_tables(run: FinishedRun, values: Values, ledger: Ledger) -> Tables:
    """The corrections on a lattice over each usable image.

    Losses: images without a usable station, which have no lattice, and images without a ground
    height, which have one without corrections.
    """
    usable = run.exposures.usable
    left_out = run.stations.image[~usable]
    if left_out.size:
        lost = messages.images_without_lattice(
            where="stations.parquet",
            count=left_out.size,
            first=left_out[0],
        )
        ledger.add(lost)
    without_ground = int(np.sum(usable & ~np.isfinite(run.ground_m)))
    if without_ground:
        ledger.add(messages.lattice_without_ground(where="observations", count=without_ground))
    columns = values["columns"]
    rows = values["rows"]
    metadata = {
        **run.metadata,
        "unbend.lattice": f"{columns} columns, {rows} rows, row by row",
    }
    schema = schema_of(columns_of("lattice"), metadata)

    def tables() -> Iterator[pa.Table]:
        """Tables of some images each: camera by camera, images in the order of the stations."""
        images = int(usable.sum())
        run.progress.start("computing corrections", images)
        for name, camera in run.cameras.items():
            x, y = lattice_nodes(camera.camera, columns, rows)
            for part, corrections in lattice_parts(run, name, run.usable_rows(name), (x, y)):
                columns_of_table = {
                    "image": np.repeat(run.stations.image[part], x.size),
                    "x_px": np.tile(run.pixels.from_colmap(x), part.size),
                    "y_px": np.tile(run.pixels.from_colmap(y), part.size),
                    "dx_px": corrections.dx_px,
                    "dy_px": corrections.dy_px,
                    "h_g_m": np.repeat(run.ground_m[part], x.size),
                    "status": pa.array(STATUS_NAMES).take(pa.array(corrections.status)),
                }
                yield table_of(columns_of_table, schema)
                run.progress.advance(part.size)

    return schema, tables()


def lattice_parts(
    run: FinishedRun,
    camera: str,
    stations: Integers,
    nodes: tuple[Array, Array],
) -> Iterator[tuple[Integers, Corrections]]:
    """Corrections of a camera at the same k nodes in the images of some of its stations.

    ``stations`` are rows, ``nodes`` x and y, (k,) in COLMAP's pixels. Yields parts: the rows (s,)
    of successive stations in one air, and their (s * k,) corrections, all nodes of the first
    station first. At a node nothing is approximated; between nodes the bilinear interpolation errs
    by an eighth of the curvature of the shift across a cell.
    """
    x_px, y_px = nodes
    stations_of_part = max(1, _MOST_ROWS // x_px.size)
    starts_of_airs = np.flatnonzero(np.diff(run.air.profile_number[stations])) + 1
    for in_one_air in np.split(stations, starts_of_airs):
        for first in range(0, in_one_air.size, stations_of_part):
            part = in_one_air[first : first + stations_of_part]
            rays = run.rays[run.air.profile_number[part[0]]]
            corrections = correct_observations(
                np.tile(x_px, part.size),
                np.tile(y_px, part.size),
                np.repeat(run.ground_m[part], x_px.size),
                np.repeat(part, x_px.size),
                run.exposures,
                camera=run.cameras[camera].camera,
                table=rays,
            )
            yield part, corrections


def radial_columns(table: RadialTable) -> dict[str, object]:
    """The columns of an exported radial table, without camera and images.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> table = radial_table(standard_atmosphere("us1976"), 6000.0, 0.0, angles_to(45.0, 45.0))
    >>> radial_columns(table)["r_c_arcsec"].round(2).tolist()
    [0.0, 12.18]
    """
    n = table.r_c_rad.size
    return {
        "h_c_m": np.full(n, table.h_c_m),
        "h_g_m": np.full(n, table.h_g_m),
        "nadir_angle_deg": table.nadir_angle_rad / DEGREE,
        "r_c_arcsec": table.r_c_rad / ARCSEC,
        "r_c_urad": table.r_c_rad / MICRORADIAN,
        "shift_ground_m": table.shift_ground_m,
        "radius_px": table.radius_px,
        "dr_px": table.dr_px,
        "k_urad": np.full(n, table.k_rad / MICRORADIAN),
        "k_manual_urad": np.full(n, table.k_manual_rad / MICRORADIAN),
        "wavelength_m": np.full(n, table.wavelength_m),
        "status": np.array(STATUS_NAMES, dtype=object)[table.status],
    }


def radial_tables(run: FinishedRun, _: Values, ledger: Ledger) -> Tables:
    """A radial table for each camera and flying height, in the order of `flying_heights`.

    Warnings: the air changes during the flight, or a camera has a window, which the tables ignore.
    """
    most_airs = 0
    for name in run.cameras:
        airs = np.unique(run.air.profile_number[run.usable_rows(name)])
        most_airs = max(most_airs, airs.size)
    if most_airs > 1:
        ledger.add(messages.air_changes(where="profile.parquet", count=most_airs))
    for name, camera in run.cameras.items():
        if camera.has_window:
            ledger.add(messages.window_not_held(where=f"cameras.{name}.window", name=name))
    schema = schema_of(columns_of("radial"), run.metadata)
    groups = flying_heights(run, _SAME_HEIGHT, ledger)
    return schema, (_table_of_group(run, name, rows, schema) for name, rows in groups)


def _table_of_group(
    run: FinishedRun,
    name: str,
    rows: Integers,
    schema: pa.Schema,
) -> pa.Table:
    """The radial table of a group of stations (``rows``) of a camera.

    For their median height, ground height and latitude, in the air of the station in the middle of
    their times.
    """
    by_time = np.argsort(run.stations.time_ns[rows], kind="stable")
    middle = rows[by_time[rows.size // 2]]
    latitude = float(np.median(run.stations.lat_rad[rows]))
    # At 45 degrees of azimuth Euler's radius is the harmonic mean of the two principal ones.
    radius = run.exposures.radius_m or float(euler_radius(latitude, 0.25 * np.pi))
    camera = run.cameras[name].camera
    table = radial_table(
        run.air.profiles[run.air.profile_number[middle]],
        float(np.median(run.exposures.height_m[rows])),
        float(np.median(run.ground_m[rows])),
        angles_to(_LARGEST_DEG, _STEP_DEG),
        focal_px=0.5 * (camera.fx_px + camera.fy_px),
        radius=radius,
        method=run.method,
    )
    angles = table.r_c_rad.size
    columns = {
        "camera": np.full(angles, name, dtype=object),
        "images": np.full(angles, rows.size),
        **radial_columns(table),
    }
    return table_of(columns, schema)


def flying_heights(
    run: FinishedRun, tolerance: float, ledger: Ledger
) -> list[tuple[str, Integers]]:
    """Groups of stations at about one height above ground: the camera, and the rows (n,).

    Groups are in the order of the cameras, in each from the lowest. No station is higher above
    ground than the lowest of its group by more than ``tolerance`` (0.1 is 10 %). Usable stations
    without a ground below them are a loss.
    """
    groups: list[tuple[str, Integers]] = []
    for name in run.cameras:
        rows = run.usable_rows(name)
        above_ground = run.exposures.height_m[rows] - run.ground_m[rows]
        has_ground = above_ground > 0.0
        without_ground = int(np.sum(~has_ground))
        if without_ground:
            lost = messages.images_without_ground(where=f"camera {name}", count=without_ground)
            ledger.add(lost)
        rows = rows[has_ground]
        above_ground = above_ground[has_ground]
        while rows.size:
            is_near = above_ground <= (1.0 + tolerance) * above_ground.min()
            groups.append((name, rows[is_near]))
            rows = rows[~is_near]
            above_ground = above_ground[~is_near]
    return groups


_OF_LATTICE = (
    Option(
        "columns",
        int,
        21,
        "nodes of the lattice across an image",
        minimum=2,
        maximum=1000,
    ),
    Option(
        "rows",
        int,
        15,
        "nodes of the lattice down an image",
        minimum=2,
        maximum=1000,
    ),
)

FORMATS = (
    *parquet_and_csv("lattice", "dx, dy on a grid over each image", lattice_tables, _OF_LATTICE),
    *parquet_and_csv("radial", "refraction by nadir angle, for each flying height", radial_tables),
)
