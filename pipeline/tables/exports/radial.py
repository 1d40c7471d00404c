"""Refraction by nadir angle, one table for each flying height of each camera of a run."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from pipeline.geodesy import euler_radius
from pipeline.ledger import Ledger
from pipeline.refraction.angle import RadialTable, angles_to, radial_table
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.tables.exports.format import FinishedRun, Values, parquet_and_csv
from pipeline.tables.schemas import columns_of, schema_of
from pipeline.tables.writing import table_of
from pipeline.units import ARCSEC, DEGREE, MICRORADIAN, Integers

_LARGEST_DEG, _STEP_DEG = 80.0, 1.0

_SAME_HEIGHT = 0.02
"""Heights above ground within 2 % of each other share a table: R differs by less than 2 %."""


def radial_columns(table: RadialTable) -> dict[str, object]:
    """A radial table in the units of its columns, without camera and images.

    >>> from pipeline.atmosphere import standard_atmosphere
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
        "status": np.array(STATUS_NAMES, dtype=object)[table.status],
    }


def radial_tables(
    run: FinishedRun, _: Values, ledger: Ledger
) -> tuple[pa.Schema, Iterator[pa.Table]]:
    """A table for each camera and each height above ground that its images share, lowest first."""
    if len(run.rays) > 1:
        ledger.warning("EXPORT-AIR-CHANGES", where="profile.parquet", count=len(run.rays))
    for name, camera in run.cameras.items():
        if camera.has_window:
            ledger.warning("EXPORT-WINDOW", where=f"cameras.{name}.window", name=name)
    schema = schema_of(columns_of("radial"), run.metadata)

    def table_of_group(name: str, rows: Integers) -> pa.Table:
        """For the median height, ground and latitude of some stations of a camera."""
        # At 45 degrees of azimuth Euler's radius is the harmonic mean of the two principal ones.
        latitude = float(np.median(run.stations.lat_rad[rows]))
        middle = rows[np.argsort(run.stations.time_ns[rows], kind="stable")[rows.size // 2]]
        camera = run.cameras[name].camera
        table = radial_table(
            run.air.profiles[run.air.profile_number[middle]],
            float(np.median(run.exposures.height_m[rows])),
            float(np.median(run.ground_m[rows])),
            angles_to(_LARGEST_DEG, _STEP_DEG),
            focal_px=0.5 * (camera.fx_px + camera.fy_px),
            radius=run.exposures.radius_m or float(euler_radius(latitude, 0.25 * np.pi)),
            method=run.method,
        )
        n = table.r_c_rad.size
        group = {"camera": np.full(n, name, dtype=object), "images": np.full(n, rows.size)}
        return table_of(group | radial_columns(table), schema)

    groups = flying_heights(run, _SAME_HEIGHT, ledger)
    return schema, (table_of_group(*group) for group in groups)


def flying_heights(
    run: FinishedRun, same_height: float, ledger: Ledger
) -> list[tuple[str, Integers]]:
    """The stations of each camera at about one height above the ground, lowest first.

    None is higher than the lowest of its group by more than the part ``same_height``. Images
    without a known ground are a loss.
    """
    groups: list[tuple[str, Integers]] = []
    for name in run.cameras:
        rows = run.rows_of(name)
        above_ground = run.exposures.height_m[rows] - run.ground_m[rows]
        known = above_ground > 0.0
        if not bool(known.all()):
            what = (
                f"left out: {int((~known).sum())} images of camera {name} without known ground "
                "below them"
            )
            ledger.loss("EXPORT-LEFT-OUT", what, where=f"camera {name}", count=int((~known).sum()))
        rows, above_ground = rows[known], above_ground[known]
        while rows.size:
            near = above_ground <= (1.0 + same_height) * above_ground.min()
            groups.append((name, rows[near]))
            rows, above_ground = rows[~near], above_ground[~near]
    return groups


FORMATS = parquet_and_csv("radial", "refraction by nadir angle, per flying height", radial_tables)
