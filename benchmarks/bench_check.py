"""`check` of ten million observations beside a pass over their names and a run of 20,000 rows."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import yaml

from unbend.batch.runs import check_mission, run_mission

REPOSITORY = Path(__file__).resolve().parents[1]
SAMPLES = REPOSITORY / "sample_logs"
ROWS = 10_000_000
FEW = 20_000
GIVEN_HEIGHTS = {"height": {"column": "h_g_m"}, "reference": "msl"}
INTERSECTED = {"height": "intersected"}


def observations(rows: int) -> pa.Table:
    """Those of the sample mission many times, each time under other points."""
    sample = pq.read_table(SAMPLES / "observations.parquet")
    sample = sample.replace_schema_metadata(None)
    copies = -(-rows // sample.num_rows)
    points, point = np.unique(sample["point"].to_numpy(), return_inverse=True)
    names = pa.array([f"P{k:08d}" for k in range(copies * points.size)])
    copy, row = np.divmod(np.arange(rows), sample.num_rows)
    number = copy * points.size + point[row]
    name = names.take(pa.array(number))
    table = sample.take(pa.array(row))
    table = table.set_column(1, "point", name)
    return table.sort_by("image")


def mission(folder: Path, rows: int, ground: dict) -> Path:
    """The sample mission with so many observations."""
    table = f"{rows}.parquet"
    pq.write_table(
        observations(rows),
        folder / table,
        row_group_size=1_000_000,
    )
    sample = REPOSITORY / "configs" / "sample_bin.yaml"
    sections = yaml.safe_load(sample.read_text("utf-8"))
    sections["log"]["path"] = str(SAMPLES / "flight.bin")
    sections["observations"]["path"] = table
    sections["ground"] = ground
    sections["output"]["path"] = f"results_{rows}"
    path = folder / f"{rows}.yaml"
    path.write_text(yaml.safe_dump(sections), "utf-8")
    return path


def read_names(path: Path):
    """One pass over the names of images and points."""
    with pq.ParquetFile(path, memory_map=True) as file:
        columns = ["image", "point"]
        for batch in file.iter_batches(batch_size=1 << 20, columns=columns):
            pc.unique(batch.column(0))


@pytest.mark.parametrize(
    ("ground", "passes"),
    [
        (GIVEN_HEIGHTS, 1),
        (INTERSECTED, 3),  # the points of the sample, and all of their rows
    ],
)
def test_ten_million_rows_beside_their_names_and_a_small_run(ratios, tmp_path, ground, passes):
    large = mission(tmp_path, ROWS, ground)
    small = mission(tmp_path, FEW, ground)

    def allowed():
        run_mission(small, force=True)
        for _ in range(passes):
            read_names(large.with_suffix(".parquet"))

    ratio = ratios.of_times(lambda: check_mission(large), allowed, rounds=3)
    ratios.check("check of ten million rows, times names and a run", 1.0 / ratio, at_most=1.8)
