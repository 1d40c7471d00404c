"""Tables of observations that tests open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from unbend.messages import Ledger
from unbend.tables.observations import Observations, open_observations

COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def opened(
    content: str | bytes | pa.Table,
    columns: dict[str, str | None] = COLUMNS,
    *,
    ground: str | None = None,
    csv: bool = False,
    ledger: Ledger | None = None,
    **options: Any,
) -> Observations:
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


def columns_of(observations: Observations, rows: int = 1000) -> dict[str, list]:
    """All that is read of a table, in batches of so many rows."""
    columns: dict[str, list] = {}
    for batch in observations.batches(rows):
        parts = {"image": batch.image, "point": batch.point, **batch.users}
        numbers = {"x_px": batch.x_px, "y_px": batch.y_px, "ground": batch.ground}
        parts |= {name: pa.array(values) for name, values in numbers.items() if values is not None}
        for name, values in parts.items():
            columns.setdefault(name, []).extend(values.to_pylist())
    return columns
