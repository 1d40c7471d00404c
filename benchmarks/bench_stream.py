"""Ten million observations, Parquet to Parquet, beside reading and writing alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from survey import CAMERA, air, exposures, image_names, uncertainty, write_observations

from unbend.batch.run_files import PartsOfRun, correct_into
from unbend.batch.store import open_folder
from unbend.messages import Ledger
from unbend.refraction.ray import rays_by
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.ground_heights import GivenGround
from unbend.tables.manifest.whole import Manifest
from unbend.tables.observations import open_observations
from unbend.tables.writing import parquet_settings

IMAGES = 2_000
BATCH_ROWS = 250_000
ROWS = 10_000_000
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def correct(source: Path, out: Path) -> None:
    """What a run does to the observations, sigmas and all, without the log and the air."""
    names = image_names(IMAGES)
    seen_from = exposures(IMAGES)
    setup = CorrectionSetup(
        names,
        np.full(IMAGES, "nadir", object),
        seen_from,
        GivenGround(None, np.zeros(IMAGES), sigma_m=2.0),
        {"nadir": CAMERA},
        (rays_by(air(), "spherical"),),
        np.zeros(IMAGES, np.int64),
        uncertainties=(uncertainty(seen_from),),
    )
    observations = open_observations(source, COLUMNS, "h_g_m", Ledger())
    with open_folder(out) as folder:
        correct_into(PartsOfRun(folder), observations, setup, batch_rows=BATCH_ROWS, metadata={})
        outputs = [asdict(output) for output in folder.outputs()]
        folder.commit(Manifest({"outputs": outputs}))


def copy(source: Path, precomputed: list[pa.Table], out: Path) -> None:
    """Read the same input while two threads write the same columns, computed before."""
    out.mkdir(exist_ok=True)
    with pq.ParquetFile(source) as file, ThreadPoolExecutor(2) as pool:
        written = [
            pool.submit(
                pq.write_table,
                table,
                out / f"part-{number:05d}.parquet",
                **parquet_settings(table.schema),
            )
            for number, (_, table) in enumerate(
                zip(file.iter_batches(batch_size=BATCH_ROWS), precomputed, strict=True)
            )
        ]
        for part in written:
            part.result()


def test_ten_million_beside_reading_and_writing(ratios, tmp_path):
    source = tmp_path / "observations.parquet"
    write_observations(source, ROWS, IMAGES)
    correct(source, tmp_path / "run")
    parts = sorted((tmp_path / "run" / "observations").glob("*.parquet"))
    precomputed = [pq.read_table(part) for part in parts]
    ratio = ratios.of_times(
        lambda: correct(source, tmp_path / "run"),
        lambda: copy(source, precomputed, tmp_path / "copy"),
        rounds=3,
    )
    ratios.check("10 million observations, times reading and writing", 1.0 / ratio, at_most=3.5)
