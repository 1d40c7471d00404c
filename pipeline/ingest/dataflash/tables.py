"""Records of a DataFlash log -> one table a message type, with the columns that pymavlink gives."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import allocate
from pipeline.ingest.dataflash.fields import INSTANCE_FIELDS
from pipeline.ingest.dataflash.records import RecordWalker, read_records
from pipeline.ingest.log import Table
from pipeline.ingest.stacking import PLACE, in_order
from pipeline.ledger import Ledger


def decode(found: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Table]:
    """The columns of some message types, in one pass over the file.

    ``wanted``: for each message type, which of its fields are wanted. Returns those that the log
    has, with `PLACE`, the byte where each row begins. Numbers have the type they are logged in;
    scaled ones (letters c, C, e, E, L) are float64 and divided, as pymavlink does; characters are
    text. Memory: the columns, and a block of the file. Types of one name that differ in their
    fields are one table; what a row does not have is NaN or empty. A field that was text and number
    is a column of objects (`without_objects`).
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


def merge_tables(several: list[Table]) -> Table:
    """Tables of one message whose definition changed in the file, in the order of the file.

    Every value is as it is logged, see `join_pieces`; missing numbers of instances, which
    separate rows, are -1.
    """
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
    for field, column in table.items():
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
            ledger.loss("LOG-REDEFINED", where=name, count=lost, total=len(known), field=field)
    return columns
