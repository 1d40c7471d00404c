"""Records of a DataFlash log -> tables of columns."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import allocate, gather
from unbend.ingest.dataflash import messages
from unbend.ingest.dataflash.dataflash_records import RecordWalker
from unbend.ingest.dataflash.record_definitions import RecordDefinition
from unbend.ingest.message_tables import PLACE, Table, in_order
from unbend.messages import Ledger
from unbend.units import Integers, Mask

INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


class RecordRows(NamedTuple):
    """Some records of one definition, as a structured array, and their places in the file."""

    number: int
    rows: NDArray[Any]
    places: Integers


def read_records(found: RecordWalker, wanted: Mask) -> Iterator[RecordRows]:
    """The records of the wanted definitions, a block of the file at a time."""
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
            end = begin + int(counts[number])
            offsets = block.at[order[begin:end]]
            begin = end
            form = found.definitions[number]
            records = gather(raw, offsets, form.length).view(form.dtype)
            yield RecordRows(number, records, offsets.astype(np.int64) + block.base)


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
            tables[number] = _empty_table(form, wanted[form.name], count)
    _fill(tables, found)
    by_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        table = tables.pop(number)
        for name in list(table):
            if table[name].dtype.kind == "S":
                table[name] = texts(table[name])
        by_name.setdefault(found.definitions[number].name, []).append(table)
    return {name: merge_tables(several) for name, several in by_name.items()}


def _empty_table(form: RecordDefinition, is_wanted: Callable[[str], bool], count: int) -> Table:
    """Memory for the wanted fields of so many records."""
    table = {PLACE: allocate(count, np.int64)}
    for name in form.fields:
        if not is_wanted(name):
            continue
        kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
        table[name] = allocate(count, (kind.base, kind.shape))
    return table


def _fill(tables: Mapping[int, Table], found: RecordWalker) -> None:
    """Write the records into the tables of their definitions, in the order of the file."""
    is_wanted = np.zeros(len(found.definitions), np.bool_)
    is_wanted[list(tables)] = True
    filled = dict.fromkeys(tables, 0)
    for number, rows, places in read_records(found, is_wanted):
        begin = filled[number]
        end = begin + places.shape[0]
        filled[number] = end
        divisors = found.definitions[number].divisors
        for name, column in tables[number].items():
            if name == PLACE:
                column[begin:end] = places
            elif name in divisors:
                np.divide(rows[name], divisors[name], out=column[begin:end])
            else:
                column[begin:end] = rows[name]


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL: UTF-8, else Latin-1, as pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    if not raw.size:
        return np.empty(0, "U1")
    different, places = np.unique(raw, return_inverse=True)
    words = [_text(value) for value in different.tolist()]
    return np.array(words, np.str_)[places]


def _text(value: bytes) -> str:
    """One character field as text."""
    try:
        word = value.decode("utf-8")
    except UnicodeDecodeError:
        word = value.decode("latin-1")
    return word.split("\0", 1)[0]


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
    for field, column in table.items():
        if column.dtype.kind == "O":
            columns[field] = _of_one_kind(column, field, name, ledger)
    return columns


def _of_one_kind(column: NDArray[Any], field: str, message: str, ledger: Ledger) -> NDArray[Any]:
    """The texts or the numbers of a column of objects; values of the other kind are entered."""
    known = [value for value in column.tolist() if value is not None]
    if isinstance(known[-1], str):
        kept = [isinstance(value, str) for value in known]
        result: NDArray[Any] = _texts_only(column)
    else:
        kept = [isinstance(value, int | float) for value in known]
        result = _numbers_only(column)
    dropped = kept.count(False)
    if dropped:
        ledger.add(
            messages.field_redefined(message=message, field=field, count=dropped, total=len(known))
        )
    return result


def _texts_only(column: NDArray[Any]) -> NDArray[np.str_]:
    """The texts of a column of objects, "" elsewhere."""
    return np.array([value if isinstance(value, str) else "" for value in column.tolist()], np.str_)


def _numbers_only(column: NDArray[Any]) -> NDArray[np.float64]:
    """The numbers of a column of objects, NaN elsewhere."""
    is_number = [isinstance(value, int | float) for value in column.tolist()]
    numbers = np.full(column.shape, np.nan)
    numbers[is_number] = column[is_number].astype(np.float64)
    return numbers
