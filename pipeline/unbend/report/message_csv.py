"""The messages of one type in a log as CSV, and their fields as rows of a table."""

import csv
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.utc_evidence import is_utc

BLOCK = 8192  # rows that are converted to text at a time

Columns = Mapping[str, NDArray[Any]]
"""Name of a field -> its values (n,) or (n, ...), a row for each message."""


def write_messages_csv(stream: TextIO, columns: Columns) -> None:
    """Write columns as CSV: numbers with all digits, times as ISO 8601, arrays as several columns.

    The column ``time_ns`` is written as ``time_utc``, and is empty for times since a boot: other
    columns of the log contain these.

    >>> import sys
    >>> times_ns = np.array([1_500_000_000 * 10**9, 0])
    >>> write_messages_csv(sys.stdout, {"time_ns": times_ns, "Temp": np.array([2.5, 2.6])})
    time_utc,Temp
    2017-07-14T02:40:00.000000000Z,2.5
    ,2.6
    """
    flat = dict(flat_columns(columns))
    heads = {"time_ns": "time_utc"}
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([heads.get(name, name) for name in flat])
    rows = len(next(iter(flat.values())))
    for begin in range(0, rows, BLOCK):
        end = begin + BLOCK
        block = []
        for name, column in flat.items():
            values = values_of(name, column[begin:end])
            block.append(values)
        writer.writerows(zip(*block, strict=True))


def field_rows(columns: Columns) -> list[dict[str, str]]:
    """A row for each field: its name, type and first value, and the range of its finite numbers."""
    rows = []
    for name, column in flat_columns(columns):
        row = {
            "field": name,
            "type": str(column.dtype),
            "first": "",
        }
        for value in values_of(name, column[:1]):
            row["first"] = str(value)
        if column.dtype.kind in "iuf" and name != "time_ns":
            row |= range_of(column)
        rows.append(row)
    return rows


def range_of(numbers: NDArray[Any]) -> dict[str, str]:
    """Keys lowest and highest, of the finite numbers; empty without any."""
    finite = numbers[np.isfinite(numbers)]
    if finite.size == 0:
        return {}
    return {
        "lowest": f"{finite.min():.10g}",
        "highest": f"{finite.max():.10g}",
    }


def flat_columns(columns: Columns) -> Iterator[tuple[str, NDArray[Any]]]:
    """Names and columns (n,); a field of arrays becomes a column for each element: q[0], q[1]."""
    for name, column in columns.items():
        if column.ndim == 1:
            yield name, column
            continue
        wide = column.reshape(column.shape[0], -1)
        for number, part in enumerate(wide.T):
            yield f"{name}[{number}]", part


def values_of(name: str, column: NDArray[Any]) -> list[Any]:
    """The values of a column for CSV; ``time_ns`` as ISO 8601, or "" for times since a boot."""
    if name != "time_ns":
        return list(column.tolist())
    times = column.astype("datetime64[ns]")
    texts = np.char.add(np.datetime_as_string(times), "Z")
    in_utc = np.where(is_utc(column), texts, "")
    return list(in_utc.tolist())
