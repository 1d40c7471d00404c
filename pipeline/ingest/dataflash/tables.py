"""Records of a DataFlash log -> one table a message type, with the columns that pymavlink gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import allocate
from pipeline.ingest.dataflash.fields import INSTANCE_FIELDS
from pipeline.ingest.dataflash.records import RecordDefinition, RecordWalker, read_records
from pipeline.ingest.log import Table
from pipeline.ingest.stacking import stack_tables
from pipeline.ledger import Ledger


@dataclass(frozen=True)
class Decoded:
    """All messages of one type: columns (n,), and the places (n,) of the rows in the file.

    Numbers have the type they are logged in; scaled ones (letters c, C, e, E, L) are float64 and
    divided, as pymavlink does; characters are text.
    """

    columns: Table
    places: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Decoded:
        """The rows of a mask or an index."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return Decoded(columns, self.places[rows])


def decode(found: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Decoded]:
    """The columns of some message types, in one pass over the file.

    Parameters
    ----------
    wanted : for each message type, which of its fields are wanted.

    Returns those that the log has. Memory: the columns, and a block of the file. Types of
    one name that differ in their fields are one table; what a row does not have is NaN or empty.
    A field that was text and number is a column of objects (`without_objects`).
    """
    counts, forms = found.counts.tolist(), found.definitions
    tables = {
        number: _TableBuilder(form, count, wanted[form.name])
        for number, (form, count) in enumerate(zip(forms, counts, strict=True))
        if form.name in wanted and count
    }
    mask = np.array([number in tables for number in range(len(forms))], np.bool_)
    for number, rows, places in read_records(found, mask):
        tables[number].add(rows, places)
    by_name: dict[str, list[Decoded]] = {}
    for number in sorted(tables):
        by_name.setdefault(forms[number].name, []).append(tables.pop(number).table())
    return {name: merge_tables(several) for name, several in by_name.items()}


class _TableBuilder:
    """Columns of a known length that are filled a block at a time."""

    def __init__(self, form: RecordDefinition, count: int, wanted: Callable[[str], bool]) -> None:
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

    def table(self) -> Decoded:
        columns = {
            name: texts(column) if column.dtype.kind == "S" else column
            for name, column in self.columns.items()
        }
        return Decoded(columns, self.places)


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL.

    UTF-8, or Latin-1 where a field is not valid UTF-8, which is what pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    different, places = np.unique(raw, return_inverse=True)
    words = []
    for value in different.tolist():
        try:
            word = value.decode("utf-8")
        except UnicodeDecodeError:
            word = value.decode("latin-1")
        words.append(word.split("\0", 1)[0])
    return np.array(words, np.str_)[places] if words else np.empty(0, "U1")


def merge_tables(several: list[Decoded]) -> Decoded:
    """Tables of one message whose definition changed in the file, in the order of the file.

    Every value is as it is logged, see `stack_tables`; missing numbers of instances, which tell
    rows apart, are -1.
    """
    if len(several) == 1:
        return several[0]
    counts = [table.places.size for table in several]
    for name in INSTANCE_FIELDS:
        present = [table.columns[name] for table in several if name in table.columns]
        if present and all(column.dtype.kind in "iu" for column in present):
            for table in several:
                table.columns.setdefault(name, np.full(table.places.size, -1))
    merged = stack_tables([table.columns for table in several], counts)
    places = np.concatenate([table.places for table in several])
    return Decoded(merged, places).take(np.argsort(places, kind="stable"))


def without_objects(decoded: Decoded, name: str, ledger: Ledger) -> Decoded:
    """A table without objects: the last value of a column decides between text and numbers."""
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
                "than in the last definition of the log: they are in its table, in no channel",
                where=name,
                count=lost,
            )
    return Decoded(columns, decoded.places)
