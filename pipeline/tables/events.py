"""Exposure times from a CSV: image names with UTC times, or GPS week and seconds of week."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.flight.clock import utc_of_gps
from pipeline.ledger import Ledger
from pipeline.tables.column_checks import no_such_column


@dataclass(frozen=True, eq=False)
class EventTable:
    """Exposures as a table gave them; (m,) image, camera (or None), UTC [ns]."""

    image: NDArray[np.object_]
    camera: NDArray[np.object_] | None
    time_ns: NDArray[np.int64]


@dataclass(frozen=True)
class EventColumns:
    """The user's names of the columns."""

    image: str
    time_utc: str | None
    gps_week: str | None
    gps_seconds: str | None
    camera: str | None


def read_events(path: Path, columns: EventColumns, ledger: Ledger) -> EventTable:
    """Read a table of exposures; a row without a readable time is a loss in the ledger.

    Times without a zone are UTC. GPS seconds are reduced by the leap seconds of their date.
    """
    table = _table(path)
    for name in (columns.image, columns.time_utc, columns.gps_week, columns.gps_seconds,
                 columns.camera):  # fmt: skip
        if name is not None and name not in table.columns:
            raise no_such_column(
                "EVENTS-COLUMN", path, name, there=list(table.columns), key="events.csv.columns"
            )
    time_ns, good = _times(table, columns)
    if not bool(good.all()):
        rows = np.flatnonzero(~good)
        ledger.loss(
            "EVENTS-TIME",
            f"{rows.size} rows have no readable time, the first in line {rows[0] + 2}",
            where=path.name,
            count=int(rows.size),
        )
    if not bool(good.any()):
        raise InputError(
            "EVENTS-EMPTY", "no row has a readable time", where=str(path),
            remedy="times look like 2026-05-01T10:20:30.123Z",
        )  # fmt: skip
    table, time_ns = table[good], time_ns[good]
    camera = table[columns.camera].to_numpy(object) if columns.camera else None
    return EventTable(table[columns.image].to_numpy(object), camera, time_ns)


def _table(path: Path) -> pd.DataFrame:
    """All fields as text, under the names of the first line; a field that is not there is empty."""
    try:
        # The header is read as a row: pandas takes longer rows for an index and renames repeats.
        rows = pd.read_csv(
            path, header=None, dtype=str, keep_default_na=False, skipinitialspace=True,
            encoding="utf-8-sig",
        ).fillna("")  # fmt: skip
    except (OSError, ValueError) as error:
        raise _no_csv(path, str(error).strip()) from None
    names = rows.iloc[0].tolist()
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _no_csv(path, f"the columns {', '.join(twice)} stand there twice")
    return rows.iloc[1:].set_axis(names, axis="columns").reset_index(drop=True)


def _no_csv(path: Path, why: str) -> InputError:
    return InputError(
        "EVENTS-CSV",
        f"is no readable CSV: {why}",
        where=str(path),
        remedy="a table of exposures has a header line, commas, and as many fields in every row",
    )


def _times(
    table: pd.DataFrame, columns: EventColumns
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    if columns.time_utc is not None:
        stamps = pd.to_datetime(
            table[columns.time_utc], utc=True, errors="coerce", format="ISO8601"
        )
        good = stamps.notna().to_numpy()
        return stamps.to_numpy("datetime64[ns]").astype(np.int64), good
    week = pd.to_numeric(table[columns.gps_week], errors="coerce").to_numpy(np.float64)
    seconds = pd.to_numeric(table[columns.gps_seconds], errors="coerce").to_numpy(np.float64)
    good = np.isfinite(week) & np.isfinite(seconds) & (week > 0) & (week == np.floor(week))
    good &= (seconds >= 0.0) & (seconds <= 604_800.0)
    time_ns = np.zeros(good.shape, np.int64)
    time_ns[good] = utc_of_gps(week[good], seconds[good])
    return time_ns, good
