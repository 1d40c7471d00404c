"""Columns by the user's names: refusals of tables that lack one, or hold other pixels."""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from pipeline.errors import InputError
from pipeline.tables.refraction_mark import Direction


class WantedColumn(NamedTuple):
    """A quantity, the user's name of its column, and the key of the mission file for that."""

    quantity: str
    name: str
    key: str


def no_such_column(
    code: str, path: Path, name: str, *, there: Sequence[str], key: str, quantity: str = ""
) -> InputError:
    """The refusal of a table that lacks a column, with the name it may have been meant to be.

    ``there`` are the names of its columns, ``key`` is the mission file's, ``quantity`` what the
    column was to hold.

    >>> print(no_such_column("A-B", Path("o.csv"), "x_px", there=["image", "x_pix"], key="x"))
    A-B: there is no column 'x_px'; perhaps 'x_pix'?; there is image, x_pix
      where: o.csv
      to do: say what it is called: x
    """
    near = difflib.get_close_matches(name, there, 1, 0.5)
    hint = f"; perhaps {near[0]!r}?" if near else ""
    reason = f" for the {quantity}" if quantity else ""
    return InputError(
        code,
        f"there is no column {name!r}{reason}{hint}; there is {', '.join(there)}",
        where=str(path),
        remedy=f"say what it is called: {key}",
    )


def refuse_ambiguous_names(path: Path, schema: pa.Schema, wanted: Sequence[WantedColumn]) -> None:
    """Refuse a table with two columns of one name, and one column for two quantities."""
    twice = sorted({name for name in schema.names if schema.names.count(name) > 1})
    if twice:
        raise InputError.of("OBS-REPEATED-COLUMN", path, twice=", ".join(twice))
    names = [column.name for column in wanted]
    shared = sorted({name for name in names if names.count(name) > 1})
    if shared:
        raise InputError.of("OBS-COLUMN", path, shared=shared[0])


def require_columns(path: Path, schema: pa.Schema, wanted: Sequence[WantedColumn]) -> None:
    """Refuse a table that lacks a column, or has one of neither text nor numbers."""
    for quantity, name, key in wanted:
        if name not in schema.names:
            raise no_such_column(
                "OBS-COLUMN", path, name, there=schema.names, key=key, quantity=quantity
            )
        kind = schema.field(name).type
        if not (is_text(kind) or is_number(kind)):
            named = quantity in ("image", "point")
            what = f"the column {name} holds {kind}, not {'names' if named else 'numbers'}"
            remedy = f"write it as {'text' if named else 'float64'}"
            raise InputError("OBS-TYPE", what, where=str(path), remedy=remedy)


def is_text(kind: Any) -> bool:
    """Whether an Arrow type is text, a dictionary of texts included."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_number(kind: Any) -> bool:
    """Whether an Arrow type is a number or null throughout, a dictionary of these included."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(
        pa.types.is_floating(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    )


def refuse_other_pixels(
    path: Path, schema: pa.Schema, direction: Direction, columns: Mapping[str, str]
) -> None:
    """Refuse, in a table of our results, the pixels that went in where those that came out are due.

    ``columns`` : x_px, y_px -> the name of the column that is to be read.
    """
    due, what = ("displaced", "ideal") if direction == "remove" else ("corrected", "as measured")
    for role in ("x_px", "y_px"):
        right = f"{role[0]}_{due}_px"
        if right in schema.names and columns[role] == role:
            raise InputError.of(
                "OBS-OTHER-PIXELS", path, role=role, right=right, text=what, direction=direction
            )
