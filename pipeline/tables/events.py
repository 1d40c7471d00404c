"""Exposure times from a CSV: image names with UTC times, or GPS week and seconds of week."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.tables.text_columns import text_table, utc_of_columns


@dataclass(frozen=True, eq=False)
class EventTable:
    """Exposures as a table gave them; (m,) image, camera (or None), UTC [ns]."""

    image: NDArray[np.object_]
    camera: NDArray[np.object_] | None
    time_ns: NDArray[np.int64]


def read_events(path: Path, columns: Mapping[str, str], ledger: Ledger) -> EventTable:
    """Read a table of exposures; a row without a readable time is a loss in the ledger.

    ``columns`` : image, time_utc or gps_week and gps_seconds, and camera where it is there -> the
    user's names. Times without a zone are UTC; GPS seconds are reduced by the leap seconds of
    their date.
    """
    table = text_table(path, columns, codes=("EVENTS-CSV", "EVENTS-COLUMN"),
                       key="events.csv.columns")  # fmt: skip
    clock = [columns.get(name) for name in ("time_utc", "gps_week", "gps_seconds")]
    time_ns, good = utc_of_columns(table, *clock)
    if not bool(good.all()):
        rows = np.flatnonzero(~good)
        what = f"{rows.size} rows have no readable time, the first in line {rows[0] + 2}"
        ledger.loss("EVENTS-TIME", what, where=path.name, count=int(rows.size))
    if not bool(good.any()):
        raise InputError(
            "EVENTS-EMPTY", "no row has a readable time", where=str(path),
            remedy="times look like 2026-05-01T10:20:30.123Z",
        )  # fmt: skip
    table, time_ns = table[good], time_ns[good]
    camera = table[columns["camera"]].to_numpy(object) if "camera" in columns else None
    return EventTable(table[columns["image"]].to_numpy(object), camera, time_ns)
