"""Records of a DataFlash log -> tables of columns."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import allocate, gather
from unbend.ingest.dataflash.dataflash_records import RecordWalker
from unbend.ingest.message_tables import PLACE, Table, in_order
from unbend.messages import Ledger
from unbend.units import Integers, Mask


def read_records(found: RecordWalker, wanted: Mask) -> Iterator[tuple[int, NDArray[Any], Integers]]:
    """The records of wanted definitions, a block of the file at a time.

    Yields the number of a definition, its records as a structured array, and their places.
    """
    for block in found.wanted:
        rows = np.flatnonzero(wanted[block.numbers])
        if rows.size == 0:
            continue
        numbers = block.numbers[rows]
        order = rows[np.argsort(numbers, kind="stable")]
        counts = np.bincount(numbers, minlength=wanted.shape[0])
        raw = found.data.array(block.base, block.end())
        begin = 0
        for number in np.flatnonzero(counts).tolist():
            at = block.at[order[begin : begin + counts[number]]]
            begin += int(counts[number])
            form = found.definitions[number]
            # Every place of the block seen as a record: the wanted ones are then one copy each.
            rows_of_type = gather(raw, at, form.length).view(form.dtype)
            yield number, rows_of_type, at.astype(np.int64) + block.base


INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


def decode(found: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Table]:
    """The columns of some message types, in one pass over the file, with `PLACE`.

    ``wanted``: by type, which fields. Numbers keep their type; scaled ones (c, C, e, E, L) are
    float64, divided as pymavlink does; characters are text. Types of one name are one table: what a
    row lacks is NaN or empty, a field that was text and number is of objects (`without_objects`).
    """
    tables: dict[int, Table] = {}
    for number, count in enumerate(found.counts.tolist()):
        form = found.definitions[number]
        if form.name in wanted and count:
            table = tables[number] = {PLACE: allocate(count, np.int64)}
            for name in filter(wanted[form.name], form.fields):
                kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
                table[name] = allocate(count, (kind.base, kind.shape))
    filled = dict.fromkeys(tables, 0)
    mask = np.array([number in tables for number in range(len(found.definitions))], np.bool_)
    for number, rows, places in read_records(found, mask):
        part = slice(filled[number], filled[number] + places.shape[0])
        filled[number] = part.stop
        for name, column in tables[number].items():
            divisor = found.definitions[number].divisors.get(name)
            if divisor is None:
                column[part] = places if name == PLACE else rows[name]
            else:
                np.divide(rows[name], divisor, out=column[part])
    by_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        columns = tables.pop(number).items()
        table = {name: texts(part) if part.dtype.kind == "S" else part for name, part in columns}
        by_name.setdefault(found.definitions[number].name, []).append(table)
    return {name: merge_tables(several) for name, several in by_name.items()}


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL: UTF-8, else Latin-1, as pymavlink does.

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


def merge_tables(several: list[Table]) -> Table:
    """Tables of one message whose definition changed, as one; missing instances are -1."""
    if len(several) == 1:
        return several[0]
    for name in INSTANCE_FIELDS:
        present = [table[name] for table in several if name in table]
        if present and all(column.dtype.kind in "iu" for column in present):
            for table in several:
                table.setdefault(name, np.full(table[PLACE].size, -1))
    return in_order(several)


def without_objects(table: Table, name: str, ledger: Ledger) -> Table:
    """A table without objects: the last value of a column decides between text and numbers."""
    columns = dict(table)
    for label, column in table.items():
        if column.dtype.kind != "O":
            continue
        known = [value for value in column.tolist() if value is not None]
        kind = str if isinstance(known[-1], str) else (int, float)
        lost = sum(not isinstance(value, kind) for value in known)
        missing, dtype = ("", np.str_) if kind is str else (np.nan, np.float64)
        values = [value if isinstance(value, kind) else missing for value in column.tolist()]
        columns[label] = np.array(values, dtype)
        if lost:
            ledger.loss("LOG-REDEFINED", where=name, count=lost, total=len(known), field=label)
    return columns
