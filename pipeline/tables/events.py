"""Exposure times from a CSV: image names with UTC times, or GPS week and seconds of week."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.tables.column_checks import no_such_column
from pipeline.tables.text_columns import text_table, utc_of_columns


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
    table = text_table(path, "EVENTS-CSV")
    for name in (columns.image, columns.time_utc, columns.gps_week, columns.gps_seconds,
                 columns.camera):  # fmt: skip
        if name is not None and name not in table.columns:
            raise no_such_column(
                "EVENTS-COLUMN", path, name, there=list(table.columns), key="events.csv.columns"
            )
    time_ns, good = utc_of_columns(table, columns.time_utc, columns.gps_week, columns.gps_seconds)
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
