"""Records of a DataFlash log -> columns, one message type a table, as pymavlink would name them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import FileView, allocate
from pipeline.ingest.dataflash.fields import INSTANCE_FIELDS
from pipeline.ingest.dataflash.formats import Definition, texts
from pipeline.ingest.dataflash.records import Walk, records
from pipeline.ingest.log import Table
from pipeline.ledger import Ledger

LAST_INT64 = (1 << 63) - 1


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
    data: FileView, found: Walk, wanted: Mapping[str, Callable[[str], bool]]
) -> dict[str, Decoded]:
    """The columns of some message types, in one pass over the file.

    Parameters
    ----------
    wanted : for each message type, which of its fields are wanted.

    Returns those that the log has. Memory: the columns, and a block of the file. Types of
    one name that differ in their fields are one table; what a row does not have is NaN or empty.
    A field that was text and number is a column of objects (`settled`).
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
        self.places = allocate(count, np.int64)
        self.columns: Table = {}
        for name in form.fields:
            if wanted(name):
                kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
                self.columns[name] = allocate(count, (kind.base, kind.shape))

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
    """One column through all definitions, every value as it is logged.

    Missing are NaN, in text the empty string, and -1 in numbers of instances, which tell rows
    apart. Where no type of numpy holds all values, text beside numbers or integers beyond 2^53
    beside others, they are objects, and None is missing.
    """
    columns = [one.columns.get(name) for one in several]
    present = [column for column in columns if column is not None]
    kinds = {column.dtype.kind for column in present}
    if len({column.shape[1:] for column in present}) > 1 or (kinds != {"U"} and "U" in kinds):
        return _objects(columns, several)
    if len(present) < len(columns):
        whole = name in INSTANCE_FIELDS and kinds <= set("iu")
        missing = "" if kinds == {"U"} else -1 if whole else np.nan
        shape = present[0].shape[1:]
        filled = [
            np.full((one.places.size, *shape), missing) if column is None else column
            for column, one in zip(columns, several, strict=True)
        ]
    else:
        filled = present
    joined = np.concatenate(filled)
    if joined.dtype.kind != "f" or all(map(_exact, filled)):
        return joined
    if all(column.dtype.kind in "iu" and not _beyond(column, LAST_INT64) for column in filled):
        return np.concatenate([column.astype(np.int64) for column in filled])
    return _objects(columns, several)


def _exact(column: NDArray[Any]) -> bool:
    """Whether float64 holds all values."""
    return column.dtype.kind == "f" or column.dtype.itemsize < 8 or not _beyond(column, 1 << 53)


def _beyond(column: NDArray[Any], limit: int) -> bool:
    return bool(column.size) and (int(column.max()) > limit or int(column.min()) < -limit)


def _objects(columns: list[NDArray[Any] | None], several: list[Decoded]) -> NDArray[Any]:
    result = np.empty(sum(one.places.size for one in several), object)
    row = 0
    for column, one in zip(columns, several, strict=True):
        for value in () if column is None else column.tolist():
            result[row] = value
            row += 1
        row += one.places.size if column is None else 0
    return result


def settled(decoded: Decoded, name: str, ledger: Ledger) -> Decoded:
    """A table without objects: the last value of a column says whether it is text or numbers."""
    columns = dict(decoded.columns)
    for field, column in decoded.columns.items():
        if column.dtype.kind != "O":
            continue
        known = [value for value in column.tolist() if value is not None]
        kind = str if isinstance(known[-1], str) else (int, float)
        lost = sum(not isinstance(value, kind) for value in known)
        if kind is str:
            words = [value if isinstance(value, str) else "" for value in column.tolist()]
            columns[field] = np.array(words, np.str_)
        else:
            numbers = [value if isinstance(value, kind) else np.nan for value in column.tolist()]
            columns[field] = np.array(numbers, np.float64)
        if lost:
            ledger.loss(
                "LOG-REDEFINED",
                f"{lost} of {len(known)} values of {field} are of another kind, text or numbers, "
                "than the last definition in the log says: no channel has them, the table has",
                where=name,
                count=lost,
            )
    return Decoded(columns, decoded.places)
