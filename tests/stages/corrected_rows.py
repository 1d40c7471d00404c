"""A mission that was read is corrected in memory: its rows as a run writes them, and its record."""

from dataclasses import dataclass
from typing import Any

import pandas as pd
import pyarrow as pa

from unbend.flight.stations import station_columns
from unbend.library import corrected_table
from unbend.stages.story import PreparedMission


@dataclass(frozen=True)
class Corrected:
    """``record`` is what the manifest says of the results."""

    prepared: PreparedMission
    table: pa.Table
    record: dict[str, Any]

    def stations(self):
        return pd.DataFrame(station_columns(self.prepared.stations))

    def rows(self):
        """The rows with a correction, and the columns of their stations that have other names."""
        rows = self.table.to_pandas()
        stations = self.stations().drop(columns="status").set_index("image")
        return rows[rows["status"] == "ok"].join(stations, on="image")


def corrected(prepared):
    """The mission after its correction, in which nothing was lost."""
    table, results = corrected_table(prepared)
    assert not prepared.ledger.has_losses, list(prepared.ledger)
    return Corrected(prepared, table, results.row())
