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
    """Some records of the definition with a number: a structured array, and places in the file."""

    number: int
    rows: NDArray[Any]
    places: Integers


def read_records(walker: RecordWalker, is_wanted: Mask) -> Iterator[RecordRows]:
    """The records of the wanted definitions: block by block of the file, in each by definition.

    ``is_wanted``: (n,) by the number of a definition.
    """
    for block in walker.wanted:
        rows = np.flatnonzero(is_wanted[block.numbers])
        if rows.size == 0:
            continue
        numbers = block.numbers[rows]
        rows_by_number = rows[np.argsort(numbers, kind="stable")]
        counts = np.bincount(numbers, minlength=is_wanted.shape[0])
        raw = walker.data.array(block.base, block.end())
        begin = 0
        for number in np.flatnonzero(counts).tolist():
            end = begin + int(counts[number])
            offsets = block.at[rows_by_number[begin:end]]
            begin = end
            form = walker.definitions[number]
            records = gather(raw, offsets, form.length).view(form.dtype)
            yield RecordRows(number, records, offsets.astype(np.int64) + block.base)


def decode(walker: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Table]:
    """The tables of some message types by name, in one pass over the file, with `PLACE`.

    ``wanted``: for each type a test whether a field is wanted. Numbers keep their type, but scaled
    ones (c, C, e, E, L) become float64, divided as pymavlink does; characters become text. All
    definitions of one name give one table: a field that a definition lacks is NaN or empty in its
    rows, and a field that is text in one and a number in another is a column of objects, which
    `without_objects` removes.
    """
    tables: dict[int, Table] = {}
    for number, count in enumerate(walker.counts.tolist()):
        form = walker.definitions[number]
        if form.name in wanted and count:
            tables[number] = _empty_table(form, wanted[form.name], count)
    _fill(tables, walker)
    tables_of_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        table = tables.pop(number)
        for field, column in table.items():
            if column.dtype.kind == "S":
                table[field] = texts(column)
        tables_of_name.setdefault(walker.definitions[number].name, []).append(table)
    return {name: merge_tables(several) for name, several in tables_of_name.items()}


def _empty_table(form: RecordDefinition, is_wanted: Callable[[str], bool], count: int) -> Table:
    """A table with memory for the wanted fields of ``count`` records."""
    table = {PLACE: allocate(count, np.int64)}
    for name in form.fields:
        if not is_wanted(name):
            continue
        kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
        table[name] = allocate(count, (kind.base, kind.shape))
    return table


def _fill(tables: Mapping[int, Table], walker: RecordWalker) -> None:
    """Write the records into the tables of their definitions, in the order of the file.

    Numbers of scaled fields are divided here.
    """
    is_wanted = np.zeros(len(walker.definitions), np.bool_)
    is_wanted[list(tables)] = True
    filled_rows = dict.fromkeys(tables, 0)
    for number, rows, places in read_records(walker, is_wanted):
        begin = filled_rows[number]
        end = begin + places.shape[0]
        filled_rows[number] = end
        divisors = walker.definitions[number].divisors
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
    distinct, number_of_row = np.unique(raw, return_inverse=True)
    distinct_texts = [_text(value) for value in distinct.tolist()]
    return np.array(distinct_texts, np.str_)[number_of_row]


def _text(value: bytes) -> str:
    """One character field as text."""
    try:
        word = value.decode("utf-8")
    except UnicodeDecodeError:
        word = value.decode("latin-1")
    return word.split("\0", 1)[0]


def merge_tables(several: list[Table]) -> Table:
    """One table of those of all definitions of a message.

    Rows of a definition without the field of instances get the instance -1, which changes their
    table, so that the field stays one of integers.
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
    """The table with texts or numbers, as the last value is, in place of columns of objects.

    ``name`` is that of the message, for the loss of values of the other kind.
    """
    columns = dict(table)
    for field, column in table.items():
        if column.dtype.kind == "O":
            columns[field] = _of_one_kind(column, field, name, ledger)
    return columns


def _of_one_kind(column: NDArray[Any], field: str, message: str, ledger: Ledger) -> NDArray[Any]:
    """The texts or the numbers of a column of objects, as its last value is.

    Values of the other kind are dropped and reported.
    """
    values = [value for value in column.tolist() if value is not None]
    if isinstance(values[-1], str):
        is_kept = [isinstance(value, str) for value in values]
        result: NDArray[Any] = _texts_only(column)
    else:
        is_kept = [isinstance(value, int | float) for value in values]
        result = _numbers_only(column)
    dropped = is_kept.count(False)
    if dropped:
        redefined = messages.field_redefined(
            message=message, field=field, count=dropped, total=len(values)
        )
        ledger.add(redefined)
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
