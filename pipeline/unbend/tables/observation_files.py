"""Tables of observations as batches of rows: CSV, Parquet, blocks of other programs, and memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from unbend.tables import messages
from unbend.tables.delimited import csv_names, open_csv
from unbend.tables.imports.blocks import BLOCKS, block_rows
from unbend.tables.imports.blocks.image_points import rows_of_image

Records = Callable[[int, list[str] | None, int], Iterator[pa.RecordBatch]]
"""Reads a table: rows of a batch at most, where the file lets choose, which columns, from where."""


@dataclass(frozen=True)
class OpenedTable:
    """A table whose head was read: its format or "memory", its schema, and what reads its rows."""

    kind: str
    schema: pa.Schema
    records: Records


def open_file(path: Path, file_format: str | None) -> OpenedTable:
    """A file of observations, its schema that of Arrow; of a CSV all text until it is scanned."""
    kind = file_format or format_of_name(path)
    is_block = kind in BLOCKS
    is_there = path.exists() if is_block else path.is_file()
    if not is_there:
        raise messages.observations_missing(where=path)
    if is_block:
        rows = partial(_block_records, path, kind)
        first = next(rows(0, None, 0), rows_of_image("", []))
        return OpenedTable(kind, first.schema, rows)
    if kind == "csv":
        columns = [(name, pa.string()) for name in csv_names(path)]
        schema = pa.schema(columns)
        return OpenedTable(kind, schema, partial(csv_records, path, {}))
    if kind == "parquet":
        try:
            schema = pq.read_schema(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise messages.parquet_unreadable(where=path, error=str(error)) from None
        return OpenedTable(kind, schema, partial(_parquet_records, path))
    shown = path.suffix.lower() or "a file without extension"
    raise messages.observations_format(where=path, ending=shown, blocks=", ".join(BLOCKS))


def format_of_name(path: Path) -> str:
    """The format that the ending of a file says, or the ending itself."""
    ending = path.suffix.lower().removeprefix(".")
    other_endings = {
        "txt": "csv",
        "tsv": "csv",
        "pq": "parquet",
    }
    return other_endings.get(ending, ending)


def in_memory(table: pa.Table) -> OpenedTable:
    """A table in memory."""
    return OpenedTable("memory", table.schema, partial(_table_records, table))


def _block_records(
    path: Path,
    kind: str,
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    for batch in _from_row(first, block_rows(path, kind)):
        yield batch if only is None else batch.select(only)


def csv_records(
    path: Path,
    types: Mapping[str, pa.DataType],
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    """Rows of a CSV whose columns have known types; arguments as of `Records`."""
    with damage_in_table(path), open_csv(path, types, only) as reader:
        yield from _from_row(first, reader)


def _parquet_records(
    path: Path,
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    # Images have few names: the first of some columns is left as it is encoded.
    encoded = None if only is None else only[:1]
    # What is read ahead stays in memory until the end, as do the pages of a memory map.
    opened = partial(pq.ParquetFile, path, pre_buffer=False, buffer_size=1 << 20)
    with damage_in_table(path), opened(read_dictionary=encoded) as file:
        groups = range(file.num_row_groups)
        rows_of_group = [file.metadata.row_group(group).num_rows for group in groups]
        begin_of_group = np.cumsum([0, *rows_of_group])
        first_group = int(np.searchsorted(begin_of_group, first, "right")) - 1
        first_group = max(first_group, 0)
        rows_before = int(begin_of_group[first_group])
        batches = file.iter_batches(
            batch_size=rows,
            columns=only,
            row_groups=list(groups[first_group:]),
        )
        yield from _from_row(first - rows_before, batches)


def _table_records(
    table: pa.Table,
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    chosen = table if only is None else table.select(only)
    yield from chosen.slice(first).to_batches(max_chunksize=rows)


def _from_row(first: int, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Batches without the rows before the first."""
    for batch in batches:
        yield batch.slice(min(first, batch.num_rows))
        first = max(first - batch.num_rows, 0)


@contextmanager
def damage_in_table(path: Path) -> Iterator[None]:
    """Raise what Arrow says of a damaged table as InputError (OBS-DAMAGED)."""
    try:
        yield
    except (pa.ArrowException, OSError) as error:
        raise messages.observations_damaged(where=path, error=str(error)) from None
