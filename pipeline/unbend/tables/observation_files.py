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
"""Reads a table: called with the most rows of a batch (some formats choose their own), the columns
to read (None for all), and the index of the first row."""


@dataclass(frozen=True)
class OpenedTable:
    """A table with its schema, before its rows are read.

    ``kind`` is csv, parquet, one of `BLOCKS`, or memory; ``records`` reads the rows.
    """

    kind: str
    schema: pa.Schema
    records: Records


def open_file(path: Path, file_format: str | None) -> OpenedTable:
    """Open a file of observations, or a folder of a block, and read its schema.

    ``file_format`` is csv, parquet or one of `BLOCKS`; None: by the ending. In the schema of a CSV
    all columns are text, until `scan_csv` has read their values.
    """
    kind = file_format or format_of_name(path)
    is_block = kind in BLOCKS
    is_there = path.is_file() or (is_block and path.is_dir())
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
    """The format of a file by its ending: csv, parquet, or the ending itself if it is another.

    >>> format_of_name(Path("points.TXT")), format_of_name(Path("points.xlsx"))
    ('csv', 'xlsx')
    """
    ending = path.suffix.lower().removeprefix(".")
    other_endings = {
        "txt": "csv",
        "tsv": "csv",
        "pq": "parquet",
    }
    return other_endings.get(ending, ending)


def in_memory(table: pa.Table) -> OpenedTable:
    """A table in memory as an `OpenedTable`."""
    return OpenedTable("memory", table.schema, partial(_table_records, table))


def _block_records(
    path: Path,
    kind: str,
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    """Rows of a block, one batch an image: ``rows`` has no effect. Other arguments: `Records`."""
    for batch in _from_row(first, block_rows(path, kind)):
        yield batch if only is None else batch.select(only)


def csv_records(
    path: Path,
    types: Mapping[str, pa.DataType],
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    """Rows of a CSV with ``types`` of its columns; ``rows`` has no effect.

    Other arguments: `Records`.
    """
    with damage_in_table(path), open_csv(path, types, only) as reader:
        yield from _from_row(first, reader)


def _parquet_records(
    path: Path,
    rows: int,
    only: list[str] | None,
    first: int,
) -> Iterator[pa.RecordBatch]:
    """Rows of a Parquet file; row groups before the first row are not read. Arguments: `Records`.

    The first column of ``only``, that of the images, is a dictionary: it has few different names.
    """
    encoded = None if only is None else only[:1]
    # Buffers read ahead, and pages of a memory map, would stay in memory until the end.
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
    """Rows of a table in memory; arguments as of `Records`."""
    selected = table if only is None else table.select(only)
    yield from selected.slice(first).to_batches(max_chunksize=rows)


def _from_row(first: int, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """The batches from row ``first`` on, counted over all of them; skipped ones become empty."""
    for batch in batches:
        yield batch.slice(min(first, batch.num_rows))
        first = max(first - batch.num_rows, 0)


@contextmanager
def damage_in_table(path: Path) -> Iterator[None]:
    """Raise errors of Arrow in the ``with`` block as InputError (OBS-DAMAGED)."""
    try:
        yield
    except (pa.ArrowException, OSError) as error:
        raise messages.observations_damaged(where=path, error=str(error)) from None


def plain_arrays(table: pa.Table) -> dict[str, pa.Array]:
    """The columns of a table by name, each as one array without chunks, dictionaries decoded."""
    arrays = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        decoded = column
        if pa.types.is_dictionary(column.type):
            decoded = column.cast(column.type.value_type)
        arrays[name] = decoded.combine_chunks()
    return arrays


def row_slices(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.Table]:
    """Join and cut record batches to tables of ``rows`` rows; the last one may have fewer."""
    waiting: list[pa.RecordBatch] = []  # parts of the next table, with ``count`` rows so far
    count = 0
    for batch in batches:
        remainder = batch
        while remainder.num_rows:
            part = remainder.slice(0, rows - count)
            waiting.append(part)
            count += part.num_rows
            remainder = remainder.slice(part.num_rows)
            if count == rows:
                yield pa.Table.from_batches(waiting)
                waiting = []
                count = 0
    if waiting:
        yield pa.Table.from_batches(waiting)
