"""Tables of observations that tests open."""

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from unbend.messages import Ledger
from unbend.tables.observations import open_observations

COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def opened(
    content,
    columns: dict[str, str | None] = COLUMNS,
    *,
    ground=None,
    csv=False,
    ledger=None,
    **options,
):
    """Text as a CSV; a table as one or as Parquet."""
    path = Path("o.csv")
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, str):
        path.write_text(content, encoding="utf-8", newline="")
    elif csv:
        pa_csv.write_csv(content, path)
    else:
        path = Path("o.parquet")
        pq.write_table(content, path)
    return open_observations(
        path, columns, ground, Ledger() if ledger is None else ledger, **options
    )


def columns_of(observations, rows=1000):
    """All that is read of a table, in batches of so many rows."""
    columns = {}
    for batch in observations.batches(rows):
        parts = {"image": batch.image, "point": batch.point, **batch.users}
        numbers = {"x_px": batch.x_px, "y_px": batch.y_px, "ground": batch.ground}
        parts |= {name: pa.array(values) for name, values in numbers.items() if values is not None}
        for name, values in parts.items():
            columns.setdefault(name, []).extend(values.to_pylist())
    return columns
