"""Records of a DataFlash log -> columns, one message type a table, as pymavlink would name them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.base import Table
from pipeline.ingest.dataflash_formats import Definition, texts
from pipeline.ingest.dataflash_records import Walk, records
from pipeline.ingest.window import Window


@dataclass(frozen=True)
class Decoded:
    """All messages of one type: columns (n,), and the places (n,) of the rows in the file.

    Numbers have the type they are logged in; scaled ones (letters c, C, e, E, L) are float64 and
    divided, as pymavlink does; characters are text.
    """

    columns: Table
    places: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_]) -> Decoded:
        """The rows of a mask."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return Decoded(columns, self.places[rows])


def decode(
    data: Window, found: Walk, wanted: Mapping[str, Callable[[str], bool]]
) -> dict[str, Decoded]:
    """The columns of some message types, in one pass over the file.

    Parameters
    ----------
    wanted : for each message type, which of its fields are wanted.

    Returns those that the log has. Memory: the columns, and a block of the file. Types of
    one name that differ in their fields are one table; what a row does not have is NaN or empty.
    """
    counts = found.counts
    tables = {
        number: _Filling(form, int(counts[number]), wanted[form.name])
        for number, form in enumerate(found.definitions)
        if form.name in wanted and counts[number]
    }
    mask = np.array([number in tables for number in range(len(found.definitions))], np.bool_)
    for number, rows, places in records(data, found, mask):
        tables[number].add(rows, places)
    by_name: dict[str, list[Decoded]] = {}
    for number in sorted(tables):
        by_name.setdefault(found.definitions[number].name, []).append(tables.pop(number).done())
    return {name: merged(several) for name, several in by_name.items()}


class _Filling:
    """Columns of a known length that are filled a block at a time."""

    def __init__(self, form: Definition, count: int, wanted: Callable[[str], bool]) -> None:
        self.form = form
        self.filled = 0
        self.places = np.empty(count, np.int64)
        self.columns: Table = {}
        for name in form.fields:
            if wanted(name):
                kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
                self.columns[name] = np.empty((count, *kind.shape), kind.base)

    def add(self, rows: NDArray[Any], places: NDArray[np.int64]) -> None:
        begin, end = self.filled, self.filled + rows.shape[0]
        for name, column in self.columns.items():
            divisor = self.form.divisors.get(name)
            if divisor is None:
                column[begin:end] = rows[name]
            else:
                np.divide(rows[name], divisor, out=column[begin:end])
        self.places[begin:end] = places
        self.filled = end

    def done(self) -> Decoded:
        columns = {
            name: texts(column) if column.dtype.kind == "S" else column
            for name, column in self.columns.items()
        }
        return Decoded(columns, self.places)


def merged(several: list[Decoded]) -> Decoded:
    """Tables of one message whose definition changed in the file, in the order of the file."""
    if len(several) == 1:
        return several[0]
    places = np.concatenate([one.places for one in several])
    order = np.argsort(places, kind="stable")
    names = dict.fromkeys(name for one in several for name in one.columns)
    return Decoded({name: _joined(name, several)[order] for name in names}, places[order])


def _joined(name: str, several: list[Decoded]) -> NDArray[Any]:
    """One column through all definitions; its last one says whether it is text or numbers."""
    model = [one.columns[name] for one in several if name in one.columns][-1]
    text, shape = model.dtype.kind == "U", model.shape[1:]
    missing: str | float = "" if text else np.nan
    pieces = []
    for one in several:
        column = one.columns.get(name)
        if column is None or (column.dtype.kind == "U") != text or column.shape[1:] != shape:
            column = np.full((one.places.size, *shape), missing)
        pieces.append(column)
    return np.concatenate(pieces)
