"""Streams of Arrow tables into one Parquet or CSV file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq


def write_parquet_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """One Parquet file of all the tables, zstd with page checksums; the number of rows."""
    rows = 0
    with pq.ParquetWriter(path, schema, compression="zstd", write_page_checksum=True) as writer:
        for table in tables:
            writer.write_table(table)
            rows += table.num_rows
    return rows


def write_csv_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """One CSV file of all the tables, null as nothing; the number of rows.

    Numbers have all the digits that tell them apart; text is quoted where it must be.
    """
    rows = 0
    with path.open("wb") as file:
        file.write((",".join(schema.names) + "\n").encode())
        for table in tables:
            style = "needed" if _has_special(table) else "none"
            options = pa_csv.WriteOptions(include_header=False, quoting_style=style)
            pa_csv.write_csv(table, file, options)
            rows += table.num_rows
    return rows


def _has_special(table: pa.Table) -> bool:
    """Whether a text column holds what CSV keeps for itself. Arrow quotes all text or none."""
    words = {
        str(word)
        for column in table.columns
        if pa.types.is_string(column.type)
        for word in column.unique().to_pylist()
    }
    return any(set(word) & set('",\r\n') for word in words)
