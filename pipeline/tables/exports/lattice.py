"""The correction lattice: the shift of the image points on a grid over every image."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.ledger import Ledger
from pipeline.refraction.lattice import lattice_corrections, lattice_nodes
from pipeline.refraction.status import STATUS_NAMES
from pipeline.tables.exports.files import write_csv_stream, write_parquet_stream
from pipeline.tables.exports.run import ExportCamera, ExportOptions, FinishedRun
from pipeline.tables.schemas import schema_of
from pipeline.tables.writing import table_of

_F = pa.float64()

LATTICE_COLUMNS: Mapping[str, tuple[pa.DataType, str, str]] = {
    "image": (pa.string(), "", "name of the image"),
    "x_px": (_F, "px", "node, as measured in the image, distortion in"),
    "y_px": (_F, "px", "node, as measured in the image, distortion in"),
    "dx_px": (_F, "px", "to be added to a measured x at the node"),
    "dy_px": (_F, "px", "to be added to a measured y at the node"),
    "h_g_m": (_F, "m", "height of the ground above mean sea level that it is computed for"),
    "status": (pa.string(), "", "ok, or why there is no correction"),
}

_MOST_ROWS = 250_000
"""Rows held in memory at a time."""


def write_lattice(run: FinishedRun, options: ExportOptions, path: Path, ledger: Ledger) -> int:
    """The lattices of all images as one Parquet file; the number of rows."""
    schema = _schema(run, options)
    return write_parquet_stream(path, schema, _tables(run, options, schema, ledger))


def write_lattice_csv(run: FinishedRun, options: ExportOptions, path: Path, ledger: Ledger) -> int:
    """The lattices of all images as one CSV file; the number of rows."""
    schema = _schema(run, options)
    return write_csv_stream(path, schema, _tables(run, options, schema, ledger))


def _schema(run: FinishedRun, options: ExportOptions) -> pa.Schema:
    extra = {"unbend.lattice": f"{options.columns} columns, {options.rows} rows, row by row"}
    return schema_of(LATTICE_COLUMNS, dict(run.metadata) | extra)


def _tables(
    run: FinishedRun, options: ExportOptions, schema: pa.Schema, ledger: Ledger
) -> Iterator[pa.Table]:
    """Camera by camera, in each the images in the order of the stations."""
    _account(run, ledger)
    images = max(1, _MOST_ROWS // (options.columns * options.rows))
    for name, camera in run.cameras.items():
        rows = run.rows_of(name)
        changes = np.flatnonzero(np.diff(run.air.profile_number[rows])) + 1
        for alike in np.split(rows, changes):
            for first in range(0, alike.size, images):
                yield _table(run, camera, alike[first : first + images], options, schema)


def _table(
    run: FinishedRun,
    camera: ExportCamera,
    rows: np.ndarray[tuple[int], np.dtype[np.int64]],
    options: ExportOptions,
    schema: pa.Schema,
) -> pa.Table:
    """The lattices of images in the same air."""
    x, y = lattice_nodes(camera.camera, options.columns, options.rows)
    ground = run.ground_m[rows]
    rays = run.rays[run.air.profile_number[rows[0]]]
    found = lattice_corrections(x, y, ground, rows, run.exposures, camera.camera, rays)
    return table_of(
        {
            "image": np.repeat(run.stations.image[rows], x.size),
            "x_px": np.tile(run.pixels.from_colmap(x), rows.size),
            "y_px": np.tile(run.pixels.from_colmap(y), rows.size),
            "dx_px": found.dx_px,
            "dy_px": found.dy_px,
            "h_g_m": np.repeat(ground, x.size),
            "status": pa.array(STATUS_NAMES).take(pa.array(found.status)),
        },
        schema,
    )


def _account(run: FinishedRun, ledger: Ledger) -> None:
    """Say which images have no lattice, and which one without ground heights."""
    usable = run.exposures.usable
    left_out = run.stations.image[~usable]
    if left_out.size:
        ledger.loss(
            "EXPORT-LEFT-OUT",
            f"{left_out.size} images have no usable station and no lattice, the first "
            f"{left_out[0]}",
            where="stations.parquet",
            count=int(left_out.size),
        )
    groundless = run.stations.image[usable & ~np.isfinite(run.ground_m)]
    if groundless.size:
        ledger.loss(
            "EXPORT-NO-GROUND",
            f"{groundless.size} images have a lattice without corrections: the run knows no ground "
            "height; --ground-height gives one",
            where="observations",
            count=int(groundless.size),
        )
