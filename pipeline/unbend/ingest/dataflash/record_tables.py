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
    """Some records of one definition: a structured array, and their places in the file.

    ``number``: of the definition, as in `RecordWalker`.
    """

    number: int
    records: NDArray[Any]
    places: Integers


def read_records(walker: RecordWalker, is_wanted: Mask) -> Iterator[RecordRows]:
    """Yield the records of the wanted definitions, by block of the file and in it by definition.

    ``is_wanted`` (n,): by the number of a definition, whether to read its records.
    """
    for block in walker.kept_blocks:
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
            raw_records = gather(raw, offsets, form.length)
            yield RecordRows(
                number,
                records=raw_records.view(form.dtype),
                places=offsets.astype(np.int64) + block.base,
            )


def decode(
    walker: RecordWalker,
    wanted: Mapping[str, Callable[[str], bool]],
) -> dict[str, Table]:
    """The tables of the wanted message types by name, with `PLACE`, in one pass over the file.

    ``wanted``: for each type a test whether a field is wanted. Numbers keep their type, but scaled
    integers (c, C, e, E, L) are divided and become float64, as in pymavlink; characters become
    text. All definitions of one name give one table: a field that a definition lacks is NaN or
    empty in its rows. A field that is text in one definition and a number in another is a column of
    objects, which `without_objects` removes.
    """
    tables: dict[int, Table] = {}
    for number, count in enumerate(walker.counts.tolist()):
        form = walker.definitions[number]
        if form.name in wanted and count:
            tables[number] = _empty_table(form, wanted[form.name], count)
    _fill(tables, walker)
    tables_of_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        table = tables.pop(number)  # so that the characters are freed once they are text
        for field, column in table.items():
            if column.dtype.kind == "S":
                table[field] = texts(column)
        name = walker.definitions[number].name
        tables_of_name.setdefault(name, []).append(table)
    result = {}
    for name, several in tables_of_name.items():
        result[name] = merge_tables(several)
    return result


def _empty_table(
    form: RecordDefinition,
    is_wanted: Callable[[str], bool],
    count: int,
) -> Table:
    """A table for the wanted fields of ``count`` records; its values are not set yet."""
    table = {PLACE: allocate(count, np.int64)}
    for name in form.fields:
        if not is_wanted(name):
            continue
        kind = form.dtype[name]
        if name in form.divisors:
            kind = np.dtype(np.float64)
        table[name] = allocate(count, (kind.base, kind.shape))
    return table


def _fill(tables: Mapping[int, Table], walker: RecordWalker) -> None:
    """Write the records into the tables (by number of definition), in the order of the file.

    Scaled integers are divided here.
    """
    is_wanted = np.zeros(len(walker.definitions), np.bool_)
    is_wanted[list(tables)] = True
    filled_rows = dict.fromkeys(tables, 0)
    for number, records, places in read_records(walker, is_wanted):
        begin = filled_rows[number]
        end = begin + places.shape[0]
        filled_rows[number] = end
        divisors = walker.definitions[number].divisors
        for name, column in tables[number].items():
            block = column[begin:end]
            if name == PLACE:
                block[:] = places
            elif name in divisors:
                np.divide(records[name], divisors[name], out=block)
            else:
                block[:] = records[name]


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL: UTF-8, else Latin-1, as pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    if not raw.size:
        return np.empty(0, "U1")
    distinct, number_of_row = np.unique(raw, return_inverse=True)
    decoded = [_text(value) for value in distinct.tolist()]
    distinct_texts = np.array(decoded, np.str_)
    return distinct_texts[number_of_row]


def _text(value: bytes) -> str:
    """One character field as text, as by `texts`."""
    try:
        word = value.decode("utf-8")
    except UnicodeDecodeError:
        word = value.decode("latin-1")
    return word.split("\0", 1)[0]


def merge_tables(several: list[Table]) -> Table:
    """The tables of all definitions of a message as one table; ``several`` are emptied.

    A table without the field of instances, which others have, gets it with -1 in all rows: NaN in
    these rows would make the joined field floats.
    """
    if len(several) == 1:
        return several[0]
    for name in INSTANCE_FIELDS:
        kinds = {table[name].dtype.kind for table in several if name in table}
        if not kinds or not kinds <= {"i", "u"}:
            continue
        for table in several:
            rows = table[PLACE].size
            table.setdefault(name, np.full(rows, -1))
    return in_order(several)


def without_objects(table: Table, name: str, ledger: Ledger) -> Table:
    """The table with columns of objects replaced by columns of texts or of numbers.

    The last value of a column decides which; values of the other kind are dropped and reported with
    the ``name`` of the message.
    """
    columns = dict(table)
    for field, column in table.items():
        if column.dtype.kind != "O":
            continue
        values = _values_of_one_kind(column)
        columns[field] = values.column
        if values.dropped:
            redefined = messages.field_redefined(
                message=name,
                field=field,
                count=values.dropped,
                total=values.total,
            )
            ledger.add(redefined)
    return columns


class _ValuesOfOneKind(NamedTuple):
    """The texts or the numbers among the values of a field, "" or NaN in the other rows.

    ``dropped``: how many of the ``total`` values are of the other kind.
    """

    column: NDArray[Any]
    dropped: int
    total: int


def _values_of_one_kind(objects: NDArray[Any]) -> _ValuesOfOneKind:
    """The texts of a column of objects if its last value is a text, else its numbers.

    None in a row means that it has no value.
    """
    values = objects.tolist()
    is_value = np.array([value is not None for value in values])
    is_text = np.array([isinstance(value, str) for value in values])
    is_number = np.array([isinstance(value, int | float) for value in values])
    last_row = np.flatnonzero(is_value)[-1]
    if is_text[last_row]:
        is_kept = is_text
        texts_only = np.where(is_text, objects, "")
        column: NDArray[Any] = texts_only.astype(np.str_)
    else:
        is_kept = is_number
        column = np.full(objects.shape, np.nan)
        column[is_number] = objects[is_number].astype(np.float64)
    return _ValuesOfOneKind(
        column=column,
        dropped=int(np.count_nonzero(is_value & ~is_kept)),
        total=int(np.count_nonzero(is_value)),
    )
