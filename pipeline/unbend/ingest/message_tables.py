"""Tables of messages: columns of any type, joined and put in the order of the log."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Table = dict[str, NDArray[Any]]
"""The columns of one message type, all of one length, named and measured as the log has them.

Where a format knows them it adds, first and in lower case: ``time_ns`` (int64, UTC; from boot, as
if in 1970, where UTC is unknown), ``boot``, ``system``, ``component``.
"""


PLACE = "\0place"  # the column of the places of messages in the log, beside their fields


EXACT = 1 << 53  # every integer up to here is a float64


_WORD = 1 << 64


def column_of(values: list[Any]) -> NDArray[Any]:
    """Values of one field, a message each (None without), as one column.

    bool, int64, uint64 or float64 where that alters no number (NaN where one is missing), str where
    all are texts ("" where one is missing), else objects.

    >>> column_of([2**60 + 1, -5]).tolist(), column_of([1, None]), column_of([1, "n/a"])
    ([1152921504606846977, -5], array([ 1., nan]), array([1, 'n/a'], dtype=object))
    """
    kinds = {type(value) for value in values}
    whole, there = type(None) not in kinds, kinds - {type(None)}
    if there == {str}:
        return np.array(["" if value is None else value for value in values], np.str_)
    if there == {bool} and whole:
        return np.array(values, np.bool_)
    if there and there <= {bool, int} and whole:
        low, high = min(values), max(values)
        if low >= -_WORD // 2 and high < _WORD // 2:
            return np.array(values, np.int64)
        if low >= 0 and high < _WORD:
            return np.array(values, np.uint64)
    if there <= {bool, int, float} and all(
        not isinstance(value, int)
        or abs(value) <= EXACT
        or (abs(value) < _WORD and int(float(value)) == value)
        for value in values
    ):
        return np.array([np.nan if value is None else value for value in values], np.float64)
    result = np.empty(len(values), object)
    for k, value in enumerate(values):  # at once, lists of one length would be an array
        result[k] = value
    return result


def in_order(tables: Sequence[Table]) -> Table:
    """Tables with `PLACE` as one in the order of the log, columns as `join_pieces`; used up."""
    whole = tables[0]
    if len(tables) > 1:
        names = dict.fromkeys(name for table in tables for name in table)
        pairs = [(table, table[PLACE].shape[0]) for table in tables]
        whole = {name: join_pieces([t.pop(name, count) for t, count in pairs]) for name in names}
    if bool(np.all(whole[PLACE][1:] > whole[PLACE][:-1])):
        return whole
    order = np.argsort(whole[PLACE], kind="stable")
    return {name: column[order] for name, column in whole.items()}


def join_pieces(pieces: Sequence[NDArray[Any] | int]) -> NDArray[Any]:
    """Pieces of a column end to end; an integer stands for so many rows without it (NaN, or "").

    What no type of numpy holds without loss is as `column_of` has it.

    >>> join_pieces([np.array([1.5]), 1]), join_pieces([np.array(["a"]), np.array([7])])
    (array([1.5, nan]), array(['a', 7], dtype=object))
    """
    arrays = [piece for piece in pieces if isinstance(piece, np.ndarray)]
    kinds, shapes = {a.dtype.kind for a in arrays}, {a.shape[1:] for a in arrays}
    if len(shapes) == 1 and (kinds == {"U"} or kinds <= set("biuf")):
        is_float = "f" in kinds or len(arrays) < len(pieces)
        kind = next((a.dtype for a in arrays if a.dtype.kind in "fU"), np.dtype(np.float64))
        missing = "" if kinds == {"U"} else np.nan
        filled = [
            np.full((p, *arrays[0].shape[1:]), missing, kind) if isinstance(p, int) else p
            for p in pieces
        ]
        joined = np.concatenate(filled)
        large = (a for a in arrays if a.dtype.kind in "iu" and a.dtype.itemsize == 8 and a.size)
        if joined.dtype.kind != "f" or (
            is_float and all(a.min() >= -EXACT and a.max() <= EXACT for a in large)
        ):
            return joined
    values: list[Any] = []
    for piece in pieces:
        values += [None] * piece if isinstance(piece, int) else piece.tolist()
    return column_of(values)
