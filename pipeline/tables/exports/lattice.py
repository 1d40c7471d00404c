"""The correction lattice: the shift of the image points on a grid over every image."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from pipeline.ledger import Ledger
from pipeline.refraction.image import Corrections, correct_observations, lattice_nodes
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.tables.exports.format import FinishedRun, Option, Values, parquet_and_csv
from pipeline.tables.schemas import columns_of, schema_of
from pipeline.tables.writing import table_of
from pipeline.units import Array, Integers

_MOST_ROWS = 250_000
"""Rows held in memory at a time."""


def lattice_tables(
    run: FinishedRun, values: Values, ledger: Ledger
) -> tuple[pa.Schema, Iterator[pa.Table]]:
    """The lattices of all images; images without one, and without ground, are entered as losses."""
    usable = run.exposures.usable
    left_out = run.stations.image[~usable]
    if left_out.size:
        what = (
            f"{left_out.size} images have no usable station and no lattice, the first {left_out[0]}"
        )
        ledger.loss("EXPORT-LEFT-OUT", what, where="stations.parquet", count=int(left_out.size))
    groundless = run.stations.image[usable & ~np.isfinite(run.ground_m)]
    if groundless.size:
        what = (
            f"{groundless.size} images have a lattice without corrections: the run knows no ground "
            "height; --ground-height gives one"
        )
        ledger.loss("EXPORT-NO-GROUND", what, where="observations", count=int(groundless.size))
    columns, rows = values["columns"], values["rows"]
    layout = {"unbend.lattice": f"{columns} columns, {rows} rows, row by row"}
    schema = schema_of(columns_of("lattice"), dict(run.metadata) | layout)

    def tables() -> Iterator[pa.Table]:
        """Camera by camera, in each the images in their order, in tables of `_MOST_ROWS`."""
        for name, camera in run.cameras.items():
            x, y = lattice_nodes(camera.camera, columns, rows)
            for part, corrections in lattice_parts(run, name, run.rows_of(name), (x, y)):
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

    return schema, tables()


def lattice_parts(
    run: FinishedRun, camera: str, stations: Integers, nodes: tuple[Array, Array]
) -> Iterator[tuple[Integers, Corrections]]:
    """Corrections of a camera at the same nodes (k,) [px] of some stations, image by image.

    In parts of some stations in one air, (s,) rows and (s * k,) corrections, in their order. At a
    node nothing is approximated; between nodes the bilinear interpolation errs by an eighth of the
    curvature of the shift across a cell.
    """
    images_of_part = max(1, _MOST_ROWS // nodes[0].size)
    changes = np.flatnonzero(np.diff(run.air.profile_number[stations])) + 1
    for in_one_air in np.split(stations, changes):
        for first in range(0, in_one_air.size, images_of_part):
            part = in_one_air[first : first + images_of_part]
            rays = run.rays[run.air.profile_number[part[0]]]
            count = nodes[0].size
            corrections = correct_observations(
                np.tile(nodes[0], part.size), np.tile(nodes[1], part.size),
                np.repeat(run.ground_m[part], count), np.repeat(part, count), run.exposures,
                camera=run.cameras[camera].camera, table=rays,
            )  # fmt: skip
            yield part, corrections


FORMATS = parquet_and_csv(
    "lattice",
    "dx, dy on a grid over each image",
    lattice_tables,
    (
        Option("columns", int, 21, "nodes of the lattice across an image", "", 2, 1000),
        Option("rows", int, 15, "nodes of the lattice down an image", "", 2, 1000),
    ),
)
