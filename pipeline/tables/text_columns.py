"""Small tables read as text, and their columns as numbers and times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.flight.clock import utc_of_gps


def text_table(path: Path, code: str) -> pd.DataFrame:
    """All fields as text, under the names of the first line; a field that is not there is empty.

    Commas, semicolons or tabs, whichever the first line has most of. Refuses (``code``) what is no
    table, and two columns of one name.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            head = file.readline()
        # The header is read as a row: pandas takes longer rows for an index and renames repeats.
        rows = pd.read_csv(
            path, header=None, dtype=str, keep_default_na=False, skipinitialspace=True,
            encoding="utf-8-sig", sep=max(",;\t", key=head.count),
        ).fillna("")  # fmt: skip
    except (OSError, ValueError) as error:
        raise _no_csv(path, str(error).strip(), code) from None
    names = rows.iloc[0].tolist()
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _no_csv(path, f"the columns {', '.join(twice)} stand there twice", code)
    return rows.iloc[1:].set_axis(names, axis="columns").reset_index(drop=True)


def _no_csv(path: Path, why: str, code: str) -> InputError:
    return InputError(
        code,
        f"is no readable CSV: {why}",
        where=str(path),
        remedy="a table has a header line, commas, and as many fields in every row",
    )


def numbers_of(table: pd.DataFrame, name: str, path: Path, code: str) -> NDArray[np.float64]:
    """(n,) a column as numbers, NaN where a field is empty; refuses (``code``) any other text."""
    values = pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64)
    wrong = np.flatnonzero(~np.isfinite(values) & (table[name].str.strip() != "").to_numpy())
    if wrong.size:
        raise InputError(
            code,
            f"{wrong.size} fields of column {name} are no numbers, the first "
            f"{table[name].iloc[wrong[0]]!r}",
            where=f"{path}, line {wrong[0] + 2}",
            remedy="write decimal numbers with a point, and leave what is unknown empty",
        )
    return values


def utc_of_columns(
    table: pd.DataFrame, time_utc: str | None, gps_week: str | None, gps_seconds: str | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(n,) Unix nanoseconds from a column of UTC times, or GPS week and seconds; which are good.

    Times without a zone are UTC; GPS seconds are reduced by the leap seconds of their date.
    """
    if time_utc is not None:
        stamps = pd.to_datetime(table[time_utc], utc=True, errors="coerce", format="ISO8601")
        good = stamps.notna().to_numpy()
        return stamps.to_numpy("datetime64[ns]").astype(np.int64), good
    week = pd.to_numeric(table[gps_week], errors="coerce").to_numpy(np.float64)
    seconds = pd.to_numeric(table[gps_seconds], errors="coerce").to_numpy(np.float64)
    good = np.isfinite(week) & np.isfinite(seconds) & (week > 0) & (week == np.floor(week))
    good &= (seconds >= 0.0) & (seconds <= 604_800.0)
    time_ns = np.zeros(good.shape, np.int64)
    time_ns[good] = utc_of_gps(week[good], seconds[good])
    return time_ns, good
