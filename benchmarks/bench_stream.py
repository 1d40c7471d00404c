"""Ten million observations, Parquet to Parquet, beside reading and writing alone."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from survey import exposures, write_observations
from table_correction import BATCH_ROWS, correct_table

from unbend.stages.ground_heights import GivenGround
from unbend.tables.writing import parquet_settings

IMAGES = 2_000
ROWS = 10_000_000


def correct(source: Path, out: Path):
    ground = GivenGround(None, np.zeros(IMAGES), sigma_m=2.0)
    correct_table(source, out, exposures(IMAGES), ground, "h_g_m")


def copy(source: Path, precomputed: list[pa.Table], out: Path):
    """Read the same input while two threads write the same columns, computed before."""
    out.mkdir(exist_ok=True)
    with pq.ParquetFile(source) as file, ThreadPoolExecutor(2) as pool:
        batches = file.iter_batches(batch_size=BATCH_ROWS)
        written = []
        for number, (_, table) in enumerate(zip(batches, precomputed, strict=True)):
            path = out / f"part-{number:05d}.parquet"
            settings = parquet_settings(table.schema)
            written.append(pool.submit(pq.write_table, table, path, **settings))
        for part in written:
            part.result()


def test_ten_million_beside_reading_and_writing(ratios, tmp_path):
    source = tmp_path / "observations.parquet"
    run = tmp_path / "run"
    write_observations(source, ROWS, IMAGES)
    correct(source, run)
    parts = sorted((run / "observations").glob("*.parquet"))
    precomputed = [pq.read_table(part) for part in parts]
    ratio = ratios.of_times(
        lambda: correct(source, run),
        lambda: copy(source, precomputed, tmp_path / "copy"),
        rounds=3,
    )
    ratios.check("10 million observations, times reading and writing", 1.0 / ratio, at_most=3.5)
