"""Tables of messages: columns of any type, joined and put in the order of the log."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.limits import check_cells
from unbend.units import Mask, Rows

Table = dict[str, NDArray[Any]]
"""The columns of one message type, all of one length, named and measured as the log has them.

Where a format knows them it adds, first and in lower case: ``time_ns`` (int64, UTC; from boot, as
if in 1970, where UTC is unknown), ``boot``, ``system``, ``component``.
"""

Piece = NDArray[Any] | int
"""Some rows of a column; an integer n means n rows without a value."""

PLACE = "\0place"  # the column with the places of messages in the log; no field has such a name
MAX_TEXTS = 16 << 20  # [bytes] of a column of str; a larger one becomes a column of objects
_BYTES_OF_LETTER = 4  # of a str in numpy
EXACT = 1 << 53  # every integer up to here is a float64
_WORD = 1 << 64  # the first integer that needs more than 64 bits


def column_of(values: list[Any]) -> NDArray[Any]:
    """The values of a field in (n,) messages, None where one lacks it, as one column.

    The type is the first of these that alters no value:

    - str, if all values are texts, with "" for missing ones.
    - bool, int64 or uint64, if all are such and none is missing.
    - float64, if all are numbers, with NaN for missing ones. So is a column without any value.
    - object.

    >>> column_of([2**60 + 1, -5]).tolist(), column_of([1, None]), column_of([1, "n/a"])
    ([1152921504606846977, -5], array([ 1., nan]), array([1, 'n/a'], dtype=object))
    """
    kinds_with_none = {type(value) for value in values}
    kinds = kinds_with_none - {type(None)}
    is_complete = kinds == kinds_with_none
    if kinds == {str}:
        return text_column(_objects(_filled_values(values, "")))
    if kinds == {bool} and is_complete:
        return np.array(values, np.bool_)
    if kinds and kinds <= {bool, int} and is_complete and _fit_64_bits(values):
        return _integers(values)
    are_numbers = kinds <= {bool, int, float}
    if are_numbers and all(map(_is_exact_as_float, values)):
        return np.array(_filled_values(values, np.nan), np.float64)
    return _objects(values)


def text_column(texts: NDArray[Any]) -> NDArray[Any]:
    """A column of objects that are texts, as one of str if that takes no more than `MAX_TEXTS`.

    In a column of str each text takes as much memory as the longest one.

    >>> text_column(np.array(["a", "bcd"], object))
    array(['a', 'bcd'], dtype='<U3')
    """
    longest = max(map(len, texts.tolist()), default=0)
    size = longest * texts.shape[0] * _BYTES_OF_LETTER
    if size > MAX_TEXTS:
        return texts
    return texts.astype(np.str_)


def _filled_values(values: list[Any], missing: Any) -> list[Any]:
    """Values, with another value in place of None."""
    return [missing if value is None else value for value in values]


def _fit_64_bits(values: list[int]) -> bool:
    """Whether all of these integers fit int64, or all fit uint64."""
    low = min(values)
    high = max(values)
    half = _WORD // 2
    fit_signed = low >= -half and high < half
    fit_unsigned = low >= 0 and high < _WORD
    return fit_signed or fit_unsigned


def _integers(values: list[int]) -> NDArray[Any]:
    """Integers as int64 if all of them fit, else as uint64."""
    is_signed = min(values) < 0 or max(values) < _WORD // 2
    return np.array(values, np.int64 if is_signed else np.uint64)


def _is_exact_as_float(value: Any) -> bool:
    """Whether a value is unchanged as float64: False for some large integers.

    True for None, which becomes NaN.
    """
    if not isinstance(value, int) or abs(value) <= EXACT:
        return True
    is_convertible = abs(value) < _WORD  # far larger ones make float() fail
    return is_convertible and int(float(value)) == value


def _objects(values: list[Any]) -> NDArray[Any]:
    """Values of any kind as a column of objects."""
    column = np.empty(len(values), object)
    for row, value in enumerate(values):
        column[row] = value  # row by row: all at once, lists of equal length become a 2-D array
    return column


def rows_by_value(column: NDArray[Any]) -> Iterator[tuple[Any, Rows]]:
    """Yield each distinct value of a column, rising, with its rows.

    >>> [(value, rows.tolist()) for value, rows in rows_by_value(np.array([7, 5, 7]))]
    [(5, [1]), (7, [0, 2])]
    """
    order = np.argsort(column, kind="stable")
    sorted_values = column[order]
    is_new = sorted_values[1:] != sorted_values[:-1]
    first_of_each = np.flatnonzero(is_new) + 1  # without the first value, which begins at 0
    for rows in np.split(order, first_of_each):
        if rows.size:  # a column without values has no rows
            (value,) = column[rows[:1]].tolist()
            yield value, rows


def in_order(tables: Sequence[Table]) -> Table:
    """Join tables with `PLACE` to one table in the order of the log.

    Columns are joined by `join_pieces`. Several ``tables`` are emptied, column by column, so that
    no column is in memory twice.
    """
    whole = tables[0] if len(tables) == 1 else _joined(tables)
    places = whole[PLACE]
    is_in_order = bool(np.all(places[1:] > places[:-1]))
    if is_in_order:
        return whole
    order = np.argsort(places, kind="stable")
    return take_rows(whole, order)


def take_rows(table: Mapping[str, NDArray[Any]], rows: Mask | Rows) -> Table:
    """The table with some of its rows.

    >>> take_rows({"a": np.array([5, 6]), "b": np.array([7, 8])}, np.array([1]))
    {'a': array([6]), 'b': array([8])}
    """
    return {name: column[rows] for name, column in table.items()}


def _joined(tables: Sequence[Table]) -> Table:
    """Tables end to end; their columns are removed from them one by one, which frees memory."""
    names = dict.fromkeys(name for table in tables for name in table)
    counts = [table[PLACE].shape[0] for table in tables]
    filled = 0
    for table, count in zip(tables, counts, strict=True):
        filled += len(table) * count
    check_cells(len(names), sum(counts), filled)
    whole: Table = {}
    for name in names:
        pieces: list[Piece] = []
        for table, count in zip(tables, counts, strict=True):
            piece = table.pop(name, count)
            pieces.append(piece)
        whole[name] = join_pieces(pieces)
    return whole


def join_pieces(pieces: Sequence[Piece]) -> NDArray[Any]:
    """The pieces of a column end to end.

    Rows without a value become NaN, or "" among texts. Pieces that numpy cannot join without
    altering a value become a column as by `column_of`.

    >>> join_pieces([np.array([1.5]), 1]), join_pieces([np.array(["a"]), np.array([7])])
    (array([1.5, nan]), array(['a', 7], dtype=object))
    """
    joined = _joined_without_loss(pieces)
    if joined is not None:
        return joined
    values: list[Any] = []
    for piece in pieces:
        if isinstance(piece, int):
            values += [None] * piece
        else:
            values += piece.tolist()
    return column_of(values)


def _joined_without_loss(pieces: Sequence[Piece]) -> NDArray[Any] | None:
    """Pieces as one array of numbers or of texts; None where numpy would alter a value."""
    arrays = [piece for piece in pieces if isinstance(piece, np.ndarray)]
    kinds = {array.dtype.kind for array in arrays}
    shapes = {array.shape[1:] for array in arrays}
    are_texts = kinds == {"U"}
    are_numbers = kinds <= set("biuf")
    if len(shapes) != 1 or not (are_texts or are_numbers):
        return None
    if are_texts and _size_as_texts(pieces, arrays) > MAX_TEXTS:
        return None
    joined = np.concatenate(_filled(pieces, arrays))
    if joined.dtype.kind != "f":
        return joined  # only floats alter values: those of large integers
    # Floats although no piece has floats and no row is missing: from int64 joined with uint64.
    rows_are_missing = len(arrays) < len(pieces)
    if not rows_are_missing and "f" not in kinds:
        return None
    if not all(map(_fits_float, arrays)):
        return None
    return joined


def _size_as_texts(
    pieces: Sequence[Piece],
    arrays: Sequence[NDArray[Any]],
) -> int:
    """The bytes that pieces of texts, and the ``arrays`` among them, take as one column of str."""
    rows = 0
    for piece in pieces:
        rows += piece if isinstance(piece, int) else piece.shape[0]
    bytes_of_text = max(array.dtype.itemsize for array in arrays)
    return rows * bytes_of_text


def _filled(
    pieces: Sequence[Piece],
    arrays: Sequence[NDArray[Any]],
) -> list[NDArray[Any]]:
    """The pieces as arrays; rows without a value become NaN or empty texts, in the shape of others.

    Missing rows have the type of the first array of floats or texts, float64 among integers.
    """
    type_of_missing = np.dtype(np.float64)
    for array in arrays:
        if array.dtype.kind in "fU":
            type_of_missing = array.dtype
            break
    missing = "" if type_of_missing.kind == "U" else np.nan
    row_shape = arrays[0].shape[1:]
    filled = []
    for piece in pieces:
        if isinstance(piece, int):
            shape = (piece, *row_shape)
            piece_without_values = np.full(shape, missing, type_of_missing)
            filled.append(piece_without_values)
        else:
            filled.append(piece)
    return filled


def _fits_float(array: NDArray[Any]) -> bool:
    """Whether all values of an array are unchanged as float64.

    Only integers of 64 bits may be too large for that: they are compared with `EXACT`.
    """
    is_of_64_bits = array.dtype.kind in "iu" and array.dtype.itemsize == 8
    if not is_of_64_bits or not array.size:
        return True
    lowest = int(array.min())
    highest = int(array.max())
    return lowest >= -EXACT and highest <= EXACT
