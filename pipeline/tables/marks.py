"""What was done to a table of observations before: refraction removed from it, or applied to it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import pyarrow as pa

from pipeline.errors import InputError
from pipeline.tables.schemas import REFRACTION_APPLIED, REFRACTION_KEY, REFRACTION_REMOVED

Direction = Literal["remove", "apply"]


def refuse_done(path: Path, schema: pa.Schema, direction: Direction) -> None:
    """Refuse to do to a table what was done to it already.

    ``schema`` is the table's, ``direction`` what is to be done. The mark in the metadata is
    enough, and so is the column of our results without it: a CSV has no metadata.
    """
    if direction == "remove" and (why := _says(schema, REFRACTION_REMOVED, "x_corrected_px")):
        raise InputError(
            "OBS-ALREADY-CORRECTED",
            f"{why}; correcting it again would count it twice",
            where=str(path),
            remedy="give the measurements as they came from the images",
        )
    if direction == "apply" and (why := _says(schema, REFRACTION_APPLIED, "x_displaced_px")):
        raise InputError(
            "OBS-ALREADY-DISPLACED",
            f"{why}; displacing it again would count it twice",
            where=str(path),
            remedy="give ideal observations, free of refraction",
        )


def _says(schema: pa.Schema, mark: bytes, column: str) -> str:
    """How a table says that something was done to it; empty where it does not."""
    words = f'"refraction {mark.decode()}"'
    if (schema.metadata or {}).get(REFRACTION_KEY) == mark:
        return f"the table carries the mark {words}"
    return f"the table has a column {column}: {words}" if column in schema.names else ""


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
            raise InputError(
                "OBS-OTHER-PIXELS",
                f"the column {role} beside {right} holds pixels {what}, which is not what "
                f"refraction.direction: {direction} starts from",
                where=str(path),
                remedy=f"say observations.columns.{role}: {right}",
            )
