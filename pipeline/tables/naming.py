"""Columns by the user's names: what to say of one that is not there."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import InputError


def no_such_column(
    code: str, path: Path, name: str, there: Sequence[str], key: str, purpose: str = ""
) -> InputError:
    """The refusal of a table that lacks a column, with the name it may have been meant to be.

    ``there`` are the names of its columns, ``key`` the mission file's word for it, ``purpose``
    the quantity that it was to hold.

    >>> print(no_such_column("OBS-COLUMN", Path("o.csv"), "x_px", ["image", "x_pix"], "columns.x"))
    OBS-COLUMN: there is no column 'x_px'; perhaps 'x_pix'?; there is image, x_pix
      where: o.csv
      to do: say what it is called: columns.x
    """
    near = difflib.get_close_matches(name, there, 1, 0.5)
    hint = f"; perhaps {near[0]!r}?" if near else ""
    reason = f" for the {purpose}" if purpose else ""
    return InputError(
        code,
        f"there is no column {name!r}{reason}{hint}; there is {', '.join(there)}",
        where=str(path),
        remedy=f"say what it is called: {key}",
    )
