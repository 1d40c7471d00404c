"""The messages of one type of a log, as CSV or as a table of their fields."""

import csv
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

BLOCK = 8192  # rows made text at once

Columns = Mapping[str, NDArray[Any]]


def write_messages_csv(stream: TextIO, columns: Columns) -> None:
    """Columns of one length as CSV: numbers exactly, times as ISO 8601, an array as many columns.

    >>> import sys
    >>> write_messages_csv(sys.stdout, {"time_ns": np.array([0]), "Temp": np.array([2.5])})
    time_utc,Temp
    1970-01-01T00:00:00.000000000Z,2.5
    """
    flat = dict(_flat(columns))
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time_utc" if name == "time_ns" else name for name in flat])
    rows = len(next(iter(flat.values())))
    for begin in range(0, rows, BLOCK):
        block = (_values(name, column[begin : begin + BLOCK]) for name, column in flat.items())
        writer.writerows(zip(*block, strict=True))


def field_rows(columns: Columns) -> list[dict[str, str]]:
    """A row for each field: type, first value, and the range of its finite numbers."""
    rows = []
    for name, column in _flat(columns):
        values = _values(name, column[:1])
        row = {"field": name, "type": str(column.dtype), "first": str(values[0]) if values else ""}
        finite = column[np.isfinite(column)] if column.dtype.kind in "iuf" else column[:0]
        if finite.size and name != "time_ns":
            row |= {"lowest": f"{finite.min():.10g}", "highest": f"{finite.max():.10g}"}
        rows.append(row)
    return rows


def _flat(columns: Columns) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, column in columns.items():
        if column.ndim == 1:
            yield name, column
            continue
        wide = column.reshape(column.shape[0], -1)
        for k in range(wide.shape[1]):
            yield f"{name}[{k}]", wide[:, k]


def _values(name: str, column: NDArray[Any]) -> list[Any]:
    if name != "time_ns":
        return list(column.tolist())
    return [f"{text}Z" for text in np.datetime_as_string(column.astype("datetime64[ns]"))]
