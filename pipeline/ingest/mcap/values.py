"""Values of JSON and protobuf -> columns that alter none of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXACT = 1 << 53  # every integer up to here is a float64
_WORD = 1 << 64


def number(value: Any) -> float | None:
    """A number, or the text of one (as protobuf writes 64 bits into JSON); else None.

    >>> number("21.5"), number("n/a"), number(10**400)
    (21.5, None, None)
    """
    try:
        return float(value) if isinstance(value, bool | int | float | str) else None
    except (ValueError, OverflowError):
        return None


def column_of(values: list[Any]) -> NDArray[Any]:
    """Values of any kind as one column; None is a message that has none.

    Parameters
    ----------
    values : of one field, a message each.

    Returns bool, int64, uint64 or float64 where that alters no number (NaN where one is missing),
    str where all are texts ("" where one is missing), else the values as objects.

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
    if there <= {bool, int, float} and all(map(_exact, values)):
        return np.array([np.nan if value is None else value for value in values], np.float64)
    result = np.empty(len(values), object)
    for k, value in enumerate(values):  # at once, lists of one length would be an array
        result[k] = value
    return result


def _exact(value: Any) -> bool:
    if not isinstance(value, int) or abs(value) <= EXACT:
        return True
    return abs(value) < _WORD and int(float(value)) == value


def stacked(
    tables: Sequence[dict[str, NDArray[Any]]], counts: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """Tables of so many rows end to end, each column as `joined`; they are used up."""
    if len(tables) == 1:
        return tables[0]
    names = dict.fromkeys(name for table in tables for name in table)
    pairs = list(zip(tables, counts, strict=True))
    return {name: joined([table.pop(name, count) for table, count in pairs]) for name in names}


def joined(pieces: Sequence[NDArray[Any] | int]) -> NDArray[Any]:
    """Pieces of a column end to end; an integer stands for so many messages without it.

    >>> joined([np.array([1.5]), 1]), joined([np.array(["a"]), np.array([7])])
    (array([1.5, nan]), array(['a', 7], dtype=object))
    """
    arrays = [piece for piece in pieces if isinstance(piece, np.ndarray)]
    kinds = {(a.dtype if a.dtype.kind != "U" else np.dtype(np.str_), a.shape[1:]) for a in arrays}
    dtype, shape = next(iter(kinds), (np.dtype(np.float64), ()))
    if len(kinds) <= 1 and (len(arrays) == len(pieces) or dtype.kind in "fU"):
        none = "" if dtype.kind == "U" else np.nan
        return np.concatenate(
            [np.full((p, *shape), none, dtype) if isinstance(p, int) else p for p in pieces]
        )
    values: list[Any] = []
    for piece in pieces:
        values += [None] * piece if isinstance(piece, int) else piece.tolist()
    return column_of(values)
