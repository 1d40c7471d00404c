"""`check` of ten million observations beside a pass over their names and a run of 20,000 rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import yaml

from unbend.batch.runs import check_mission, run_mission

REPOSITORY = Path(__file__).resolve().parents[1]
SAMPLES = REPOSITORY / "sample_logs"
ROWS = 10_000_000
FEW = 20_000


def mission(folder: Path, rows: int, height: object) -> Path:
    """The sample mission with its observations many times, each time under other points."""
    table = pq.read_table(SAMPLES / "observations.parquet").replace_schema_metadata(None)
    copies = -(-rows // table.num_rows)
    point, number = np.unique(table["point"].to_numpy(), return_inverse=True)
    names = pa.array([f"P{k:08d}" for k in range(copies * point.size)])
    copy = np.repeat(np.arange(copies), table.num_rows)[:rows]
    row = np.tile(np.arange(table.num_rows), copies)[:rows]
    table = table.take(pa.array(row)).set_column(
        1, "point", names.take(pa.array(copy * point.size + number[row]))
    )
    pq.write_table(table.sort_by("image"), folder / f"{rows}.parquet", row_group_size=1_000_000)
    text = (REPOSITORY / "configs" / "sample_bin.yaml").read_text(encoding="utf-8")
    sections = yaml.safe_load(text)
    sections["log"]["path"] = str(SAMPLES / "flight.bin")
    sections["observations"]["path"] = f"{rows}.parquet"
    sections["ground"] = height
    sections["output"]["path"] = f"results_{rows}"
    path = folder / f"{rows}.yaml"
    path.write_text(yaml.safe_dump(sections), encoding="utf-8")
    return path


def names_of(path: Path) -> None:
    """One pass over the names of images and points."""
    with pq.ParquetFile(path, memory_map=True) as file:
        for batch in file.iter_batches(batch_size=1 << 20, columns=["image", "point"]):
            pc.unique(batch.column(0))


def test_ten_million_rows_beside_their_names_and_a_small_run(ratios, tmp_path):
    for height, passes in (
        ({"height": {"column": "h_g_m"}, "reference": "msl"}, 1),
        ({"height": "intersected"}, 3),  # the points of the sample, and all of their rows
    ):
        large = mission(tmp_path, ROWS, height)
        small = mission(tmp_path, FEW, height)

        def allowed(small=small, passes=passes) -> None:
            run_mission(small, force=True)
            for _ in range(passes):
                names_of(tmp_path / f"{ROWS}.parquet")

        ratio = ratios.of_times(lambda large=large: check_mission(large), allowed, rounds=3)
        ratios.check("check of ten million rows, times names and a run", 1.0 / ratio, at_most=1.8)
